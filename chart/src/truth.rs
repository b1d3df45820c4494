//! Reference images in the store, so that a chart traces each of them once.
//!
//! ```text
//! key      of all that the images depend on
//! chunks   image  [3, height, width, 3] f32: the whole image and its two halves        image  [height, width] u8: the mask, 0 or 1
//! data     samples a pixel u32, 0 u32, rays u64, cpu_seconds f64
//! ```
//!
//! No asset names them: `prelight gc` frees them after its grace time like all that no root reaches, and a chart traces what is gone again.

use prelight_bake::reference::ReferenceImages;
use prelight_manifests::{ChunkKind, Digest, Dtype};
use prelight_runtime::draw::image::Image;
use prelight_runtime::draw::metrics::relative_l2;
use prelight_store::{ChunkSource, Record, Store, StoreError};

/// Bytes of a record's data.
const DATA: usize = 24;

/// A reference and what it cost.
#[derive(Clone, Debug, PartialEq)]
pub struct KeptReference {
    /// The images.
    pub images: ReferenceImages,
    /// CPU time of all threads.
    pub cpu_seconds: f64,
}

impl KeptReference {
    /// Relative L2 of the noise in the whole image: half of the difference of its halves. `None` for black images.
    pub fn noise(&self) -> Option<f64> {
        self.images.noise.map(|noise| 0.5 * noise)
    }

    /// CPU time per pixel that a path tracer needs for a relative L2 of `error`, nanoseconds: its noise falls with the root of its samples.
    pub fn ns_per_pixel_at(&self, error: f64) -> Option<f64> {
        let per_pixel = 1e9 * self.cpu_seconds / self.images.mask.len().max(1) as f64;
        let noise = self.noise().filter(|noise| *noise > 0.0)?;
        (error > 0.0).then(|| per_pixel * (noise / error) * (noise / error))
    }

    /// Puts the images into the store, durably, under a key.
    ///
    /// # Errors
    /// What the store says.
    pub fn keep(&self, store: &Store, key: Digest) -> Result<(), StoreError> {
        let ReferenceImages { image, half_a, half_b, mask, rays, samples_per_pixel, .. } = &self.images;
        let (width, height) = (image.width as u64, image.height as u64);
        let mut pixels = Vec::with_capacity(3 * image.pixels.len());
        [image, half_a, half_b].into_iter().for_each(|image| pixels.extend_from_slice(&image.pixels));
        let mask: Vec<u8> = mask.iter().map(|set| u8::from(*set)).collect();
        let mut writer = store.writer();
        let chunks = vec![
            writer.put(ChunkKind::Image, Dtype::F32, vec![3, height, width, 3], bytemuck::cast_slice(&pixels))?,
            writer.put(ChunkKind::Image, Dtype::U8, vec![height, width], &mask)?,
        ];
        let mut data = Vec::with_capacity(DATA);
        data.extend(u64::from(*samples_per_pixel).to_le_bytes());
        data.extend(rays.to_le_bytes());
        data.extend(self.cpu_seconds.to_le_bytes());
        writer.record(key, Record { chunks, data });
        writer.commit()?;
        Ok(())
    }

    /// What was kept under a key. `None` where that is nothing, not of this size, or damaged: the reference is then traced again.
    ///
    /// # Errors
    /// What the system says.
    pub fn find(store: &Store, key: &Digest, [width, height]: [usize; 2]) -> Result<Option<Self>, StoreError> {
        let Some(Record { chunks, data }) = store.lookup(key)? else { return Ok(None) };
        let shapes = [vec![3, height as u64, width as u64, 3], vec![height as u64, width as u64]];
        let ([pixels, mask], Ok(data)) = (&chunks[..], <[u8; DATA]>::try_from(&data[..])) else { return Ok(None) };
        if [&pixels.shape, &mask.shape] != [&shapes[0], &shapes[1]] {
            return Ok(None);
        }
        let (pixels, mask) = match (store.chunk(pixels), store.chunk(mask)) {
            (Ok(pixels), Ok(mask)) => (pixels, mask),
            (Err(error), _) | (_, Err(error)) if error.is_corrupt() => return Ok(None),
            (Err(error), _) | (_, Err(error)) => return Err(error),
        };
        let (Ok(pixels), n) = (bytemuck::try_cast_slice::<u8, [f32; 3]>(&pixels), width * height) else { return Ok(None) };
        if pixels.len() != 3 * n || mask.len() != n {
            return Ok(None);
        }
        let image = |at: usize| Image { width, height, pixels: pixels[at * n..(at + 1) * n].to_vec() };
        let [image, half_a, half_b] = [image(0), image(1), image(2)];
        let mask: Vec<bool> = mask.iter().map(|byte| *byte == 1).collect();
        let everything = vec![true; n];
        let noise = relative_l2(&half_a, &half_b, if mask.contains(&true) { &mask } else { &everything });
        let [samples, rays, cpu] = [0, 8, 16].map(|at| std::array::from_fn(|k| data[at + k])).map(u64::from_le_bytes);
        let images = ReferenceImages { image, half_a, half_b, rays, samples_per_pixel: samples as u32, noise, mask };
        Ok(Some(KeptReference { images, cpu_seconds: f64::from_bits(cpu) }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn references_come_back_whole_or_not_at_all() {
        let image = |x: f32| Image { width: 3, height: 2, pixels: (0..6).map(|i| [x + i as f32, 0.5 * x, 2.0]).collect() };
        let (half_a, half_b) = (image(1.0), image(1.5));
        let mask = vec![true, true, false, true, true, true];
        let noise = relative_l2(&half_a, &half_b, &mask);
        let images = ReferenceImages { image: image(1.25), half_a, half_b, mask, rays: 77, samples_per_pixel: 8, noise };
        let kept = KeptReference { images, cpu_seconds: 1.5 };
        let (dir, key) = (tempfile::tempdir().unwrap(), Digest([3; 32]));
        let find = |key: &Digest, size| KeptReference::find(&Store::open(dir.path()).unwrap(), key, size).unwrap();
        kept.keep(&Store::open_or_create(dir.path()).unwrap(), key).unwrap();
        assert_eq!(find(&key, [3, 2]).as_ref(), Some(&kept));
        assert_eq!(find(&key, [2, 3]), None);
        assert_eq!(find(&Digest([4; 32]), [3, 2]), None);
        // A changed byte in any file that holds pixels: not there, until it is kept again.
        let packs: Vec<_> = std::fs::read_dir(dir.path().join("packs")).unwrap().map(|entry| entry.unwrap().path()).collect();
        let objects =
            std::fs::read_dir(dir.path().join("objects")).unwrap().flat_map(|folder| std::fs::read_dir(folder.unwrap().path()).unwrap());
        let files: Vec<_> = objects.map(|entry| entry.unwrap().path()).chain(packs).collect();
        assert!(!files.is_empty());
        for file in files {
            let mut bytes = std::fs::read(&file).unwrap();
            let pixel = 1.25f32.to_le_bytes();
            let at = bytes.windows(4).position(|four| four == pixel).expect("six pixels are not worth compressing");
            bytes[at] ^= 1;
            std::fs::write(&file, &bytes).unwrap();
        }
        assert_eq!(find(&key, [3, 2]), None);
        kept.keep(&Store::open(dir.path()).unwrap(), key).unwrap();
        assert_eq!(find(&key, [3, 2]).as_ref(), Some(&kept));
        // Half the error costs four times as much.
        let cost = |error| kept.ns_per_pixel_at(error).unwrap();
        assert!((cost(0.01) / cost(0.02) - 4.0).abs() < 1e-9);
    }
}

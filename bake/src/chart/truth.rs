//! Reference images as bytes, so that a chart traces each of them once.
//!
//! ```text
//! magic "PLRF", version, width, height, samples a pixel, 0: u32 each; rays u64; cpu_seconds f64
//! image, half_a, half_b    [height · width, 3] f32
//! mask                     [height · width] u8, 0 or 1
//! digest                   [32] blake3 of all before
//! ```

use crate::reference::ReferenceImages;
use prelight_runtime::draw::image::Image;
use prelight_runtime::draw::metrics::relative_l2;

const MAGIC: [u8; 4] = *b"PLRF";
const VERSION: u32 = 1;
const HEAD: usize = 40;
const DIGEST: usize = 32;

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

    /// See the module head.
    pub fn to_bytes(&self) -> Vec<u8> {
        let ReferenceImages { image, half_a, half_b, mask, rays, samples_per_pixel, .. } = &self.images;
        let mut bytes = MAGIC.to_vec();
        for number in [VERSION, image.width as u32, image.height as u32, *samples_per_pixel, 0] {
            bytes.extend(number.to_le_bytes());
        }
        bytes.extend(rays.to_le_bytes());
        bytes.extend(self.cpu_seconds.to_le_bytes());
        for image in [image, half_a, half_b] {
            image.pixels.as_flattened().iter().for_each(|value| bytes.extend(value.to_le_bytes()));
        }
        bytes.extend(mask.iter().map(|set| u8::from(*set)));
        let digest = blake3::hash(&bytes);
        bytes.extend(digest.as_bytes());
        bytes
    }

    /// `None` for bytes that are not whole, not of this version or of another size: the reference is then traced again.
    pub fn from_bytes(bytes: &[u8], [width, height]: [usize; 2]) -> Option<Self> {
        let n = width.checked_mul(height)?;
        if bytes.len() as u64 != (HEAD + DIGEST) as u64 + 37 * n as u64 {
            return None;
        }
        let (body, digest) = bytes.split_at(bytes.len() - DIGEST);
        if blake3::hash(body).as_bytes() != digest || body[..4] != MAGIC {
            return None;
        }
        let word = |at: usize| u32::from_le_bytes([body[at], body[at + 1], body[at + 2], body[at + 3]]);
        if [word(4), word(8), word(12)] != [VERSION, width as u32, height as u32] {
            return None;
        }
        let long = |at: usize| std::array::from_fn(|k| body[at + k]);
        let mut values = body[HEAD..HEAD + 36 * n].as_chunks::<12>().0.iter().map(|pixel| {
            let value = |k: usize| f32::from_le_bytes([pixel[4 * k], pixel[4 * k + 1], pixel[4 * k + 2], pixel[4 * k + 3]]);
            [value(0), value(1), value(2)]
        });
        let mut image = || Image { width, height, pixels: values.by_ref().take(n).collect() };
        let [image, half_a, half_b] = [image(), image(), image()];
        let mask: Vec<bool> = body[HEAD + 36 * n..].iter().map(|byte| *byte == 1).collect();
        let everything = vec![true; n];
        let over = if mask.contains(&true) { &mask } else { &everything };
        let noise = relative_l2(&half_a, &half_b, over);
        let (rays, cpu_seconds) = (u64::from_le_bytes(long(24)), f64::from_le_bytes(long(32)));
        let images = ReferenceImages { image, half_a, half_b, rays, samples_per_pixel: word(16), noise, mask };
        Some(KeptReference { images, cpu_seconds })
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
        let bytes = kept.to_bytes();
        assert_eq!(KeptReference::from_bytes(&bytes, [3, 2]).as_ref(), Some(&kept));
        assert_eq!(KeptReference::from_bytes(&bytes, [2, 3]), None);
        for at in [0, 5, 30, 100, bytes.len() - 1] {
            let mut damaged = bytes.clone();
            damaged[at] ^= 1;
            assert_eq!(KeptReference::from_bytes(&damaged, [3, 2]), None, "byte {at}");
        }
        assert_eq!(KeptReference::from_bytes(&bytes[..bytes.len() - 1], [3, 2]), None);
        // Half the error costs four times as much.
        let cost = |error| kept.ns_per_pixel_at(error).unwrap();
        assert!((cost(0.01) / cost(0.02) - 4.0).abs() < 1e-9);
    }
}

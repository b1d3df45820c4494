//! Claims about OpenEXR files as renderers write them: layers, primaries, luminance and chroma.

use std::io::Cursor;

use ::exr::compression::Compression;
use ::exr::meta::MetaData;
use ::exr::meta::attribute::Chromaticities;
use ::exr::prelude::*;

use super::super::{CleanReport, Environment, Limits, MapOptions};
use super::chroma;

/// A file of one part whose channels are constant.
fn constant(channels: &[(&str, f32)], attributes: impl FnOnce(&mut ImageAttributes)) -> Vec<u8> {
    let size = Vec2(8, 4);
    let list = channels.iter().map(|(name, value)| AnyChannel::new(*name, FlatSamples::F32(vec![*value; size.area()]))).collect();
    let encoding = Encoding { compression: Compression::ZIP16, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    let mut image = Image::from_layer(Layer::new(size, LayerAttributes::default(), encoding, AnyChannels::sort(list)));
    attributes(&mut image.attributes);
    let mut bytes = Cursor::new(Vec::new());
    image.write().non_parallel().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

fn decode(bytes: &[u8], layer: Option<&str>) -> std::result::Result<(Environment, CleanReport), String> {
    let options = MapOptions { layer: layer.map(str::to_owned), ..MapOptions::default() };
    Environment::decode_as("passes.exr", bytes, &options, &Limits::default()).map_err(|error| error.to_string())
}

const PASSES: [(&str, f32); 9] = [
    ("View.AO.R", 0.05),
    ("View.AO.G", 0.05),
    ("View.AO.B", 0.05),
    ("View.Combined.R", 1.0),
    ("View.Combined.G", 2.0),
    ("View.Combined.B", 3.0),
    ("View.DiffCol.R", 0.3),
    ("View.DiffCol.G", 0.3),
    ("View.DiffCol.B", 0.3),
];

#[test]
fn the_picture_is_chosen_among_passes_and_named() {
    let file = constant(&PASSES, |_| {});
    let (image, report) = decode(&file, None).unwrap();
    assert_eq!(image.pixels[3], [1.0, 2.0, 3.0]);
    let [warning] = &report.warnings()[..] else { panic!("{:?}", report.warnings()) };
    assert!(warning.contains("`View.Combined` is read") && warning.contains("`View.AO`"), "{warning}");
    // A layer without a name comes before all others.
    let with_root: Vec<_> = PASSES.into_iter().chain([("R", 7.0), ("G", 7.0), ("B", 7.0)]).collect();
    assert_eq!(decode(&constant(&with_root, |_| {}), None).unwrap().0.pixels[0], [7.0; 3]);
    for (name, value) in [("beauty", 5.0), ("RGBA", 6.0)] {
        let names = ["R", "G", "B"].map(|channel| format!("{name}.{channel}"));
        let channels: Vec<_> = PASSES[..3].iter().copied().chain(names.iter().map(|name| (name.as_str(), value))).collect();
        assert_eq!(decode(&constant(&channels, |_| {}), None).unwrap().0.pixels[0], [value; 3]);
    }
}

#[test]
fn a_layer_that_is_asked_for_is_read_and_others_are_listed() {
    let file = constant(&PASSES, |_| {});
    for name in ["View.DiffCol", "diffcol"] {
        let (image, report) = decode(&file, Some(name)).unwrap();
        assert_eq!((image.pixels[3], report.warnings().len()), ([0.3; 3], 0));
    }
    let error = decode(&file, Some("Depth")).unwrap_err();
    assert!(error.contains("no layer `Depth`") && error.contains("`View.AO`, `View.Combined`, `View.DiffCol`"), "{error}");
    assert!(
        Environment::decode_as("a.hdr", b"#?", &MapOptions { layer: Some("x".into()), ..MapOptions::default() }, &Limits::default())
            .is_err()
    );
}

#[test]
fn primaries_of_the_header_are_converted() {
    let rec2020 =
        Chromaticities { red: Vec2(0.708, 0.292), green: Vec2(0.170, 0.797), blue: Vec2(0.131, 0.046), white: Vec2(0.3127, 0.3290) };
    let read = |rgb: [f32; 3], primaries: Chromaticities| {
        let file = constant(&[("R", rgb[0]), ("G", rgb[1]), ("B", rgb[2])], |attributes| attributes.chromaticities = Some(primaries));
        let (image, report) = decode(&file, None).unwrap();
        (image.pixels[0], report.warnings().len())
    };
    let (pixel, warnings) = read([0.8, 0.6, 0.5], rec2020);
    // BT.2087 by hand: 1.6605 · 0.8 − 0.5876 · 0.6 − 0.0728 · 0.5, and so on.
    assert!(pixel.iter().zip([0.9394, 0.5759, 0.4844]).all(|(a, b): (&f32, f32)| (a - b).abs() < 1e-3) && warnings == 0, "{pixel:?}");
    let nonsense = Chromaticities { red: Vec2(0.0, 0.0), ..rec2020 };
    assert_eq!(read([0.8, 0.6, 0.5], nonsense), ([0.8, 0.6, 0.5], 1));
}

/// A file of luminance and chroma, chroma at every second pixel of every second row, as OpenEXR lays it out.
fn luminance_chroma(
    compression: Compression,
    [width, height]: [usize; 2],
    luminance: impl Fn(usize, usize) -> f32,
    chroma: [f32; 2],
) -> Vec<u8> {
    let list = ["BY", "RY", "Y"].map(|name| AnyChannel::new(name, FlatSamples::F16(vec![f16::ZERO; width * height])));
    let encoding = Encoding { compression, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    let layer = Layer::new((width, height), LayerAttributes::default(), encoding, AnyChannels::sort(list.into_iter().collect()));
    let mut bytes = Cursor::new(Vec::new());
    Image::from_layer(layer).write().non_parallel().to_buffered(&mut bytes).unwrap();
    let whole = bytes.into_inner();
    let mut cursor = Cursor::new(&whole[..]);
    let mut header = MetaData::read_from_buffered(&mut cursor, false).unwrap().headers.remove(0);
    let mut file = whole[..cursor.position() as usize].to_vec();
    for (channel, name) in [&b"BY\0\x01"[..], b"RY\0\x01"].into_iter().enumerate() {
        let at = file.windows(4).position(|bytes| bytes == name).unwrap() + 11;
        file[at] = 2;
        file[at + 4] = 2;
        header.channels.list[channel].sampling = Vec2(2, 2);
    }
    let rows = compression.scan_lines_per_block();
    let mut blocks = Vec::new();
    for top in (0..height).step_by(rows) {
        let rows = rows.min(height - top);
        let mut data = Vec::new();
        for y in top..top + rows {
            if y % 2 == 0 {
                [chroma[1], chroma[0]]
                    .iter()
                    .for_each(|value| (0..width / 2).for_each(|_| data.extend(f16::from_f32(*value).to_ne_bytes())));
            }
            (0..width).for_each(|x| data.extend(f16::from_f32(luminance(x, y)).to_ne_bytes()));
        }
        assert_eq!(data.len(), chroma::block_bytes(&header, top as i64, width, rows));
        header.channels.bytes_per_pixel = data.len() / (width * rows);
        let place = IntegerBounds::new((0, top as i32), (width, rows));
        blocks.push((top as u32, header.compression.compress_image_section_to_le(&header, data, place).unwrap()));
    }
    let mut offset = (file.len() + 8 * blocks.len()) as u64;
    for (_, data) in &blocks {
        file.extend(offset.to_le_bytes());
        offset += 8 + data.len() as u64;
    }
    for (top, data) in blocks {
        file.extend(top.to_le_bytes());
        file.extend((data.len() as u32).to_le_bytes());
        file.extend(data);
    }
    file
}

#[test]
fn luminance_and_chroma_are_colours_in_every_lossless_compression() {
    let luminance = |x: usize, y: usize| 0.25 + (x * 7 % 5) as f32 + (y % 3) as f32 * 0.5;
    for compression in [Compression::Uncompressed, Compression::RLE, Compression::ZIP1, Compression::ZIP16, Compression::PIZ] {
        let file = luminance_chroma(compression, [40, 38], luminance, [0.5, -0.25]);
        let (image, report) = decode(&file, None).unwrap_or_else(|error| panic!("{compression}: {error}"));
        assert_eq!(report.negative, 0);
        for (i, pixel) in image.pixels.iter().enumerate() {
            let y = luminance(i % 40, i / 40);
            let (red, blue) = (1.5 * y, 0.75 * y);
            let green = (y - 0.2126 * red - 0.0722 * blue) / 0.7152;
            assert!(pixel.iter().zip([red, green, blue]).all(|(a, b)| (a - b).abs() < 1e-3), "{compression} {i}: {pixel:?} of Y {y}");
        }
        // Damage ends in an error or a picture.
        for at in (0..file.len()).step_by(5) {
            let mut damaged = file.clone();
            damaged[at] ^= 0xff;
            let _ = Environment::decode_as("damaged", &damaged, &MapOptions::default(), &Limits::new(64 << 20));
        }
    }
    let without_colour = luminance_chroma(Compression::PIZ, [8, 8], |_, _| 2.0, [0.0; 2]);
    assert_eq!(decode(&without_colour, None).unwrap().0.pixels[9], [2.0; 3]);
}

//! Claims about decoding: orientations, encodings, EXR variants, labelled colours, damaged and hostile files.

use std::io::Cursor;

use ::exr::prelude::*;

use super::{CleanReport, Environment, LightCubemap, Limits};
use crate::error::RuntimeError;
use crate::sphere::cubemap::texel_unit_direction;

fn decode(bytes: &[u8]) -> Environment {
    decode_with_report(bytes).0
}

fn decode_with_report(bytes: &[u8]) -> (Environment, CleanReport) {
    Environment::decode("test", bytes, &Limits::default()).unwrap_or_else(|error| panic!("{error}"))
}

fn refuse(bytes: &[u8]) -> String {
    match Environment::decode("bad.hdr", bytes, &Limits::new(1 << 30)) {
        Err(error @ (RuntimeError::Environment { .. } | RuntimeError::Memory { .. })) => error.to_string(),
        Err(error) => panic!("wrong kind of error: {error:?}"),
        Ok((image, _)) => panic!("decoded {} x {}", image.width, image.height),
    }
}

// ---- Radiance ----

#[derive(Clone, Copy, PartialEq, Debug)]
enum Rle {
    None,
    Old,
    New,
}

/// An image that RGBE holds exactly, with runs in it.
fn rgbe_image(width: usize, height: usize) -> Vec<[u8; 4]> {
    let pixel = |i: usize| {
        let (x, y) = (i % width, i / width);
        if x % 7 < 4 { [128, 64, (y % 100) as u8, 129] } else { [130 + (x % 100) as u8, 3, (y % 256) as u8, 120 + (x % 9) as u8] }
    };
    (0..width * height).map(pixel).collect()
}

/// Writes a Radiance picture whose rows from the top are `pixels`, lying in the file as `resolution` ("-Y +X" and so on) says.
fn radiance_file(width: usize, height: usize, pixels: &[[u8; 4]], axes: [&str; 2], rle: Rle) -> Vec<u8> {
    let length = |axis: &str| if axis.ends_with('X') { width } else { height };
    let mut file = b"#?RADIANCE\n# a comment\nFORMAT=32-bit_rle_rgbe\n\n".to_vec();
    file.extend(format!("{} {} {} {}\n", axes[0], length(axes[0]), axes[1], length(axes[1])).bytes());
    for slow in 0..length(axes[0]) {
        let line: Vec<[u8; 4]> = (0..length(axes[1]))
            .map(|fast| {
                let (mut x, mut y) = (0, 0);
                for (axis, position) in [(axes[0], slow), (axes[1], fast)] {
                    match axis {
                        "+X" => x = position,
                        "-X" => x = width - 1 - position,
                        "-Y" => y = position,
                        _ => y = height - 1 - position,
                    }
                }
                pixels[y * width + x]
            })
            .collect();
        match rle {
            Rle::None => file.extend(line.iter().flatten()),
            Rle::Old => {
                let mut x = 0;
                while x < line.len() {
                    let run = line[x..].iter().take_while(|pixel| **pixel == line[x]).count();
                    file.extend(line[x]);
                    let mut rest = run - 1;
                    while rest > 0 {
                        file.extend([1, 1, 1, (rest % 256) as u8]);
                        rest /= 256;
                    }
                    x += run;
                }
            }
            Rle::New => {
                file.extend([2, 2, (line.len() >> 8) as u8, line.len() as u8]);
                for plane in 0..4 {
                    let mut x = 0;
                    while x < line.len() {
                        let run = line[x..].iter().take(127).take_while(|pixel| pixel[plane] == line[x][plane]).count();
                        if run > 1 {
                            file.extend([128 + run as u8, line[x][plane]]);
                        } else {
                            file.extend([1, line[x][plane]]);
                        }
                        x += run;
                    }
                }
            }
        }
    }
    file
}

const ORIENTATIONS: [[&str; 2]; 8] =
    [["-Y", "+X"], ["-Y", "-X"], ["+Y", "+X"], ["+Y", "-X"], ["+X", "-Y"], ["+X", "+Y"], ["-X", "-Y"], ["-X", "+Y"]];

#[test]
fn eight_orientations_and_three_encodings_give_one_image() {
    for (width, height) in [(5, 3), (12, 9), (300, 8), (9, 600)] {
        let pixels = rgbe_image(width, height);
        let expected: Vec<[f32; 3]> =
            pixels.iter().map(|[r, g, b, e]| [*r, *g, *b].map(|mantissa| f32::from(mantissa) * 2f32.powi(i32::from(*e) - 136))).collect();
        for axes in ORIENTATIONS {
            for rle in [Rle::None, Rle::Old, Rle::New] {
                let line = if axes[0].ends_with('Y') { width } else { height };
                if rle == Rle::New && line < 8 {
                    continue;
                }
                let image = decode(&radiance_file(width, height, &pixels, axes, rle));
                assert_eq!((image.width, image.height), (width, height), "{axes:?} {rle:?}");
                assert!(image.pixels == expected, "{width} x {height} {axes:?} {rle:?}");
            }
        }
    }
}

#[test]
fn old_repeats_chain_by_powers_of_256() {
    let mut file = b"#?RGBE\n\n-Y 1 +X 66000\n".to_vec();
    // 1 pixel + 207 + 1·256 + 1·65536 = 66000.
    for word in [[128, 0, 0, 129], [1, 1, 1, 207], [1, 1, 1, 1], [1, 1, 1, 1]] {
        file.extend::<[u8; 4]>(word);
    }
    let image = decode(&file);
    assert!(image.pixels.len() == 66_000 && image.pixels.iter().all(|pixel| *pixel == [1.0, 0.0, 0.0]));
}

#[test]
fn headers_are_read_leniently_and_say_what_they_pass_over() {
    let with = |header: &str| {
        let mut file = header.replace('\n', "\r\n").into_bytes();
        file.extend([128, 128, 128, 129]);
        decode_with_report(&file)
    };
    let (image, report) = with(
        "#?RADIANCE\nGAMMA=1\nsome command line\nEXPOSURE=1.0\nPRIMARIES=0 0 0 0 0 0 0 0\nPRIMARIES=0.640 0.330 0.290 0.600 0.150 0.060 0.333 0.333\n\n-Y 1 +X 1\n",
    );
    assert_eq!((image.pixels, report.warnings().len()), (vec![[1.0; 3]], 0));
    let (image, report) =
        with("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=2.5\nCOLORCORR= 1 0.5 1\nPRIMARIES= .7 .3 .2 .7 .15 .06 .33 .33\n\n-Y 1 +X 1\n");
    // The primaries are applied: white stays white.
    assert!(image.pixels[0].iter().all(|value| (value - 1.0).abs() < 1e-5), "{:?}", image.pixels);
    assert_eq!(report.warnings().len(), 2);
    assert!(report.warnings()[0].contains("EXPOSURE=2.5"));
    // XYZE: X = Y = Z is grey.
    let (image, _) = with("#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 1\n");
    assert!(image.pixels[0].iter().all(|value| (value - 1.0).abs() < 1e-6), "{:?}", image.pixels);
}

// ---- OpenEXR ----

fn colour(Vec2(x, y): Vec2<usize>) -> [f32; 3] {
    // Exact in half, and in u32 once scaled by 8.
    [x as f32, y as f32 + 0.5, (x * y % 5) as f32 * 0.125]
}

fn channel(name: &str, component: usize, kind: &str, size: Vec2<usize>) -> AnyChannel<FlatSamples> {
    let values = (0..size.area()).map(|i| colour(Vec2(i % size.0, i / size.0))[component.min(2)]);
    let samples = match kind {
        "half" => FlatSamples::F16(values.map(f16::from_f32).collect()),
        "float" => FlatSamples::F32(values.collect()),
        _ => FlatSamples::U32(values.map(|value| (value * 8.0) as u32).collect()),
    };
    AnyChannel::new(name, samples)
}

fn write<L>(image: Image<L>) -> Vec<u8>
where
    for<'a> L: ::exr::image::write::layers::WritableLayers<'a>,
{
    let mut bytes = Cursor::new(Vec::new());
    image.write().non_parallel().to_buffered(&mut bytes).unwrap_or_else(|error| panic!("{error}"));
    bytes.into_inner()
}

fn exr_layer(names: &[(&str, usize)], kind: &str, size: (usize, usize), encoding: Encoding) -> Layer<AnyChannels<FlatSamples>> {
    let list = names.iter().map(|(name, component)| channel(name, *component, kind, Vec2(size.0, size.1))).collect();
    Layer::new(size, LayerAttributes::named("layer"), encoding, AnyChannels::sort(list))
}

fn exr_file(names: &[(&str, usize)], kind: &str, size: (usize, usize), encoding: Encoding) -> Vec<u8> {
    write(Image::from_layer(exr_layer(names, kind, size, encoding)))
}

const RGB: [(&str, usize); 3] = [("R", 0), ("G", 1), ("B", 2)];

fn encoding(compression: Compression, blocks: Blocks) -> Encoding {
    Encoding { compression, blocks, line_order: LineOrder::Increasing }
}

#[test]
fn exr_sample_types_channels_and_compressions_give_one_image() {
    let size = (37, 21);
    let expected: Vec<[f32; 3]> = (0..37 * 21).map(|i| colour(Vec2(i % 37, i / 37))).collect();
    let compressions =
        [Compression::Uncompressed, Compression::RLE, Compression::ZIP1, Compression::ZIP16, Compression::PIZ, Compression::PXR24];
    for compression in compressions {
        for kind in ["half", "float", "u32"] {
            for blocks in [Blocks::ScanLines, Blocks::Tiles(Vec2(16, 8))] {
                let scale = if kind == "u32" { 8.0 } else { 1.0 };
                for names in [&RGB[..], &[("R", 0), ("G", 1), ("B", 2), ("A", 2)], &[("left.R", 0), ("left.G", 1), ("left.B", 2), ("Z", 1)]]
                {
                    let image = decode(&exr_file(names, kind, size, encoding(compression, blocks)));
                    assert_eq!((image.width, image.height), size);
                    for (found, expected) in image.pixels.iter().zip(&expected) {
                        assert_eq!(*found, expected.map(|value| value * scale), "{compression} {kind} {blocks:?} {names:?}");
                    }
                }
            }
        }
    }
    for compression in [Compression::B44, Compression::B44A, Compression::DWAA(None), Compression::DWAB(None)] {
        let image = decode(&exr_file(&RGB, "half", size, encoding(compression, Blocks::ScanLines)));
        for (found, expected) in image.pixels.iter().zip(&expected) {
            for c in 0..3 {
                // Lossy: B44 keeps 6 bits of a 4 x 4 block's range (up to 37), DWA's error is about the same here.
                assert!((found[c] - expected[c]).abs() < 1.5, "{compression}: {found:?} {expected:?}");
            }
        }
    }
}

#[test]
fn exr_luminance_is_grey_and_chroma_has_colour() {
    let plain = encoding(Compression::ZIP16, Blocks::ScanLines);
    let image = decode(&exr_file(&[("Y", 1)], "half", (5, 4), plain));
    assert_eq!(image.pixels[7], [1.5; 3]);
    // Y = 1.5, (R − Y)/Y = 2, (B − Y)/Y = 0.25, and green is what is left of Y.
    let pixel = decode(&exr_file(&[("Y", 1), ("RY", 0), ("BY", 2)], "half", (5, 4), plain)).pixels[7];
    assert!(pixel.iter().zip([4.5, 0.5703, 1.875]).all(|(a, b)| (a - b).abs() < 1e-3), "{pixel:?}");
    assert!(refuse(&exr_file(&[("Y", 1), ("RY", 0)], "half", (5, 4), plain)).contains("no layer has channels"));
    assert!(refuse(&exr_file(&[("Z", 1), ("N.x", 0)], "half", (5, 4), plain)).contains("N.x, Z"));
}

#[test]
fn exr_takes_the_first_layer_with_colour() {
    let plain = encoding(Compression::ZIP16, Blocks::ScanLines);
    let depth = exr_layer(&[("Z", 2)], "float", (5, 4), plain);
    let mut colour_layer = exr_layer(&[("R", 1), ("G", 1), ("B", 0)], "half", (5, 4), plain);
    colour_layer.attributes = LayerAttributes::named("second");
    let mut other = exr_layer(&RGB, "half", (5, 4), plain);
    other.attributes = LayerAttributes::named("third");
    let layers: Layers<AnyChannels<FlatSamples>> = smallvec(vec![depth, colour_layer, other]);
    let image = decode(&write(Image::from_layers(ImageAttributes::with_size((5, 4)), layers)));
    assert_eq!(image.pixels[7], [1.5, 1.5, 2.0]);
}

fn smallvec(layers: Vec<Layer<AnyChannels<FlatSamples>>>) -> Layers<AnyChannels<FlatSamples>> {
    layers.into_iter().collect()
}

#[test]
fn exr_data_windows_lie_anywhere_in_the_display_window() {
    for compression in [Compression::ZIP16, Compression::Uncompressed] {
        for (left, top) in [(3, 2), (-2, -1), (6, 0), (-100, 0)] {
            for blocks in [Blocks::ScanLines, Blocks::Tiles(Vec2(4, 4))] {
                let mut layer = exr_layer(&RGB, "float", (6, 5), encoding(compression, blocks));
                layer.attributes.layer_position = Vec2(left + 10, top + 20);
                let display = IntegerBounds::new((10, 20), (11, 8));
                let image = decode(&write(Image::new(ImageAttributes::new(display), layer)));
                assert_eq!((image.width, image.height), (11, 8));
                for y in 0..8 {
                    for x in 0..11 {
                        let (dx, dy) = (x - left, y - top);
                        let inside = (0..6).contains(&dx) && (0..5).contains(&dy);
                        let expected = if inside { colour(Vec2(dx as usize, dy as usize)) } else { [0.0; 3] };
                        assert_eq!(image.pixels[(y * 11 + x) as usize], expected, "{left} {top} at {x}, {y}");
                    }
                }
            }
        }
    }
}

#[test]
fn impossible_values_are_cleaned_and_counted_in_a_file() {
    let values = [1.0, f32::NAN, -3.0, f32::INFINITY, 8.0, f32::NEG_INFINITY];
    let pixel = move |Vec2(x, _): Vec2<usize>| (values[x], 2.0f32, 0.25f32);
    let (image, report) = decode_with_report(&write(Image::from_channels((6, 1), SpecificChannels::rgb(pixel))));
    let red: Vec<f32> = image.pixels.iter().map(|pixel| pixel[0]).collect();
    assert_eq!(red, [1.0, 0.0, 0.0, 8.0, 8.0, 0.0]);
    assert_eq!((report.nan, report.negative, report.infinite, report.largest), (1, 2, 1, 8.0));
}

// ---- Orientation and sign ----

/// Each axis has its own colour: +X red, −X cyan, +Y green, −Y magenta, +Z blue, −Z yellow.
const LABELS: [([f32; 3], [f32; 3]); 6] = [
    ([1.0, 0.0, 0.0], [1.0, 0.0, 0.0]),
    ([-1.0, 0.0, 0.0], [0.0, 1.0, 1.0]),
    ([0.0, 1.0, 0.0], [0.0, 1.0, 0.0]),
    ([0.0, -1.0, 0.0], [1.0, 0.0, 1.0]),
    ([0.0, 0.0, 1.0], [0.0, 0.0, 1.0]),
    ([0.0, 0.0, -1.0], [1.0, 1.0, 0.0]),
];

#[test]
fn a_labelled_map_shows_every_axis_in_its_own_colour() {
    // Built from u and v by hand, not by our own mapping: the image's rows from the top, 45° around each axis.
    let (width, height) = (64, 32);
    let label = |x: usize, y: usize| {
        let (u, v) = ((x as f64 + 0.5) / width as f64, (y as f64 + 0.5) / height as f64);
        if v < 0.25 {
            LABELS[2].1
        } else if v > 0.75 {
            LABELS[3].1
        } else {
            // u = atan2(z, x)/2π + 1/2: −X at 0, −Z at 1/4, +X at 1/2, +Z at 3/4.
            [LABELS[1].1, LABELS[5].1, LABELS[0].1, LABELS[4].1][((u * 4.0).round() as usize) % 4]
        }
    };
    let made = Environment::new(width, height, (0..width * height).map(|i| label(i % width, i / width)).collect());
    for bytes in [made.to_radiance_hdr(), made.to_exr().unwrap()] {
        let image = decode(&bytes);
        assert_eq!(image, made);
        let light = LightCubemap::from_environment(&image, 16);
        for (face, (axis, colour)) in LABELS.into_iter().enumerate() {
            assert_eq!(image.radiance(axis), colour, "{axis:?}");
            // Faces stand in the order of LABELS. The middle texels hold that colour alone, and their moment points along the axis.
            for (x, y) in [(7, 7), (8, 8), (7, 8)] {
                let texel = face * 256 + y * 16 + x;
                let direction = texel_unit_direction(16, face, x, y);
                for c in 0..3 {
                    assert_eq!(light.flux[texel][c] > 0.0, colour[c] > 0.0, "{axis:?}");
                    let length = light.flux[texel][c];
                    for k in 0..3 {
                        assert!((light.moment[texel][c][k] - length * direction[k]).abs() <= 0.02 * length, "{axis:?}");
                    }
                }
            }
        }
        // At 90 degrees what was at +X stands at −Z, −Z at −X, −X at +Z, +Z at +X; the poles stay.
        let turned = image.with_rotation(90.0);
        let light = LightCubemap::from_environment(&turned, 16);
        for (face, from) in [(5, 0), (1, 5), (4, 1), (0, 4), (2, 2), (3, 3)] {
            let colour = LABELS[from].1;
            assert_eq!(turned.radiance(LABELS[face].0), colour);
            let flux = light.flux[face * 256 + 8 * 16 + 8];
            assert!((0..3).all(|c| (flux[c] > 0.0) == (colour[c] > 0.0)), "face {face}");
        }
    }
}

// ---- Damage ----

#[test]
fn files_of_other_kinds_are_named() {
    for (bytes, word) in [(&b""[..], "empty"), (b"\x89PNG\r\n\x1a\n", "PNG"), (b"\xff\xd8\xff\xe0", "JPEG"), (b"hello", "neither")] {
        let message = refuse(bytes);
        assert!(message.contains(word) && message.contains("help:") && message.starts_with("bad.hdr"), "{message}");
    }
}

#[test]
fn damaged_radiance_files_are_refused_with_a_reason() {
    let start = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n".to_vec();
    let with = |rest: &[u8]| refuse(&[&start[..], rest].concat());
    for (rest, word) in [
        (&b"-Y 65535 +X 65535\n\x02\x02\x7f"[..], "65535 x 65535"),
        (b"-Y 4294967295 +X 4294967295\nxxxx", "4294967295"),
        (b"-Y 99999999999 +X 2\n", "resolution"),
        (b"-Y 0 +X 2\n", "resolution"),
        (b"-Y -5 +X 2\n", "resolution"),
        (b"-Y 5 +Y 2\n", "resolution"),
        (b"-Y 5 +X\n", "resolution"),
        (b"\xff\xfe\x00\x1b\n", "resolution"),
        (b"-Y 9000 +X 9000\n", "cut short"),
        (b"-Y 1 +X 3\n\x01\x01\x01\x02abcdabcd", "repeat at pixel 0"),
        (b"-Y 1 +X 3\nabcd\x01\x01\x01\x03abcd", "repeat at pixel 1"),
        (b"-Y 1 +X 8\n\x02\x02\x00\x09\x88a\x88a\x88a\x88a", "says 9 pixels"),
        (b"-Y 1 +X 8\n\x02\x02\x00\x08\x89a\x88a\x88a\x88a", "a run of 9 at pixel 0"),
        (b"-Y 1 +X 8\n\x02\x02\x00\x08\x00a\x88a\x88a\x88a", "a run of 0 at pixel 0"),
    ] {
        let message = with(rest);
        assert!(message.contains(word), "{message}");
    }
    assert!(refuse(b"#?RADIANCE\nFORMAT=hello\n\n-Y 1 +X 1\nabcd").contains("FORMAT=hello"));
    assert!(refuse(b"#?RADIANCE").contains("cut short"));
    // Old RLE claims much with few bytes: 40000 lines of 10 pixels each are fine, of 60000 exceed the gigabyte.
    let mut file = [&start[..], b"-Y 40000 +X 60000\n"].concat();
    for _ in 0..40_000 {
        file.extend([9, 9, 9, 9, 1, 1, 1, 255, 1, 1, 1, 255]);
    }
    assert!(refuse(&file).contains("the limit is 1073741824"));
}

/// A file with its display and data windows overwritten, and without the number of blocks (it is optional, and would give the game away).
fn with_windows(mut file: Vec<u8>, display: [i32; 4], data: [i32; 4]) -> Vec<u8> {
    if let Some(at) = file.windows(11).position(|bytes| bytes == b"chunkCount\0") {
        file[at] = b'x';
    }
    for (name, window) in [(&b"displayWindow\0box2i\0"[..], display), (b"dataWindow\0box2i\0", data)] {
        let at = file.windows(name.len()).position(|bytes| bytes == name).unwrap() + name.len() + 4;
        for (i, value) in window.into_iter().enumerate() {
            file[at + 4 * i..at + 4 * i + 4].copy_from_slice(&value.to_le_bytes());
        }
    }
    file
}

#[test]
fn exr_headers_that_claim_too_much_are_refused_before_allocation() {
    let scan = exr_file(&RGB, "half", (8, 8), encoding(Compression::ZIP16, Blocks::ScanLines));
    let tiled = exr_file(&RGB, "half", (8, 8), encoding(Compression::PIZ, Blocks::Tiles(Vec2(8, 8))));
    let small = [0, 0, 7, 7];
    for file in [&scan, &tiled] {
        for side in [65_534, 1 << 28, (1 << 30) - 3] {
            let huge = [0, 0, side, side];
            for (display, data) in [(huge, huge), (small, huge), (huge, small)] {
                let message = refuse(&with_windows(file.clone(), display, data));
                assert!(message.contains("cannot hold") || message.contains("limit") || message.contains("far larger"), "{message}");
            }
        }
        for window in [[i32::MIN, 0, i32::MAX, 1], [i32::MAX, 0, i32::MAX, 0], [i32::MIN, i32::MIN, i32::MAX, i32::MAX]] {
            refuse(&with_windows(file.clone(), window, window));
        }
    }
    // A long thin data window: one block of 16 lines would take 64 GiB.
    refuse(&with_windows(scan, small, [0, 0, (1 << 30) - 3, 0]));
    // Tiles of 2³¹ x 2³¹, and of no size.
    for side in [0u32, 1 << 20, u32::MAX / 2, u32::MAX] {
        let mut file = tiled.clone();
        let name = b"tiles\0tiledesc\0";
        let at = file.windows(name.len()).position(|bytes| bytes == name).unwrap() + name.len() + 4;
        file[at..at + 4].copy_from_slice(&side.to_le_bytes());
        file[at + 4..at + 8].copy_from_slice(&side.to_le_bytes());
        refuse(&file);
    }
}

#[test]
fn deep_exr_is_refused_by_name() {
    let mut file = exr_file(&RGB, "half", (8, 8), encoding(Compression::ZIP1, Blocks::ScanLines));
    file[5] |= 0x08;
    assert!(refuse(&file).contains("deep data"));
}

fn small_files() -> Vec<Vec<u8>> {
    let pixels = rgbe_image(11, 4);
    let mut files: Vec<Vec<u8>> = [Rle::None, Rle::Old, Rle::New].map(|rle| radiance_file(11, 4, &pixels, ["-Y", "+X"], rle)).to_vec();
    let compressions = [
        Compression::Uncompressed,
        Compression::RLE,
        Compression::ZIP16,
        Compression::PIZ,
        Compression::PXR24,
        Compression::B44,
        Compression::DWAA(None),
    ];
    for compression in compressions {
        files.push(exr_file(&RGB, "half", (11, 40), encoding(compression, Blocks::ScanLines)));
    }
    files.push(exr_file(&RGB, "float", (11, 9), encoding(Compression::ZIP16, Blocks::Tiles(Vec2(4, 4)))));
    files
}

#[test]
fn every_truncation_is_an_error_and_nothing_panics() {
    for file in small_files() {
        decode(&file);
        for length in 0..file.len() {
            match Environment::decode("cut", &file[..length], &Limits::default()) {
                Err(RuntimeError::Environment { .. } | RuntimeError::Memory { .. }) => {}
                other => panic!("{length} of {} bytes: {:?}", file.len(), other.map(|image| image.1)),
            }
        }
    }
}

#[test]
fn changed_bytes_give_an_image_or_an_error() {
    let mut state = 12345u32;
    let mut next = |below: usize| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as usize % below
    };
    let limits = Limits::new(64 << 20);
    for file in small_files() {
        for _ in 0..400 {
            let mut damaged = file.clone();
            for _ in 0..=next(3) {
                let at = next(damaged.len());
                damaged[at] = [0, 1, 0x7f, 0x80, 0xff, next(256) as u8][next(6)];
            }
            if let Ok((image, _)) = Environment::decode("damaged", &damaged, &limits) {
                assert!(image.pixels.iter().flatten().all(|value| value.is_finite() && *value >= 0.0));
            }
        }
    }
}

// ---- Real maps ----

#[test]
fn real_maps_decode_and_keep_their_energy() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/envmaps");
    for name in [
        "aristea_wreck_puresky_1k.exr",
        "noon_grass_1k.hdr",
        "st_peters_square_night_1k.exr",
        "studio_small_05_1k.exr",
        "thatch_chapel_1k.hdr",
    ] {
        let Ok(bytes) = std::fs::read(folder.join(name)) else {
            eprintln!("SKIPPED: {name} is not in {}", folder.display());
            continue;
        };
        let (image, report) = Environment::decode(name, &bytes, &Limits::default()).unwrap_or_else(|error| panic!("{error}"));
        let (_, energy) = LightCubemap::with_energy(&image, 64);
        eprintln!(
            "{name}: {} x {}, largest {}, warnings {:?}, energy {:?}",
            image.width,
            image.height,
            report.largest,
            report.warnings(),
            energy
        );
        assert_eq!((image.width, image.height), (1024, 512));
        assert!(energy.relative_loss() < 1e-6, "{name}: {energy:?}");
        // The mean luminance over the sphere of every one of them lies between 0.3 and 1.
        let mean = (0.2126 * energy.before[0] + 0.7152 * energy.before[1] + 0.0722 * energy.before[2]) / (4.0 * std::f64::consts::PI);
        assert!(mean > 0.3 && mean < 1.0, "{name}: {mean}");
    }
}

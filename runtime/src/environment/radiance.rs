//! Radiance pictures (.hdr, .pic): header, orientation and colour. The scan lines are in `scanline`.
//!
//! ```text
//! #?RADIANCE                  magic: "#?" and any name
//! FORMAT=32-bit_rle_rgbe      or 32-bit_rle_xyze; other lines are variables or # comments
//!                             an empty line ends the header
//! -Y 512 +X 1024              the slow axis first, + when its coordinate grows along the file
//! ```
//!
//! A pixel is (r, g, b, e) with value = mantissa · 2^(e − 136), and black for e = 0: exact in f32. Radiance itself adds half a step to each mantissa; like
//! most readers this one does not, so that a mantissa of 0 is black. EXPOSURE and COLORCORR are passed over with a note, as three.js and Blender
//! do: pixel values are taken as radiance.

use super::primaries::{Primaries, convert};
use super::scanline;
use super::source::{Decoded, Source};
use crate::error::RuntimeError;

pub(super) const HELP: &str = "export it again as Radiance .hdr or OpenEXR";

/// How the file's scan lines lie in the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Orientation {
    width: usize,
    height: usize,
    /// Scan lines are rows (Y is the slow axis); otherwise they are columns.
    rows: bool,
    /// x falls along the file.
    flip_x: bool,
    /// y grows (upwards) along the file, so its first line is the bottom.
    flip_y: bool,
}

struct Header {
    orientation: Orientation,
    /// CIE XYZ instead of RGB.
    xyz: bool,
    /// The matrix to Rec.709 of RGB that is another.
    matrix: Option<[[f64; 3]; 3]>,
    notes: Vec<String>,
    /// Where the scan lines start.
    data: usize,
}

pub(super) fn decode(source: Source<'_>) -> Result<Decoded, RuntimeError> {
    let header = read_header(source)?;
    let Orientation { width, height, rows, .. } = header.orientation;
    let (line_length, n_lines) = if rows { (width, height) } else { (height, width) };
    let upright = rows && !header.orientation.flip_x && !header.orientation.flip_y;
    // Turning an image over takes a second one. The scan line buffer is 4 bytes a pixel.
    let copies = if upright { 12 } else { 24 };
    let needed = (width as u64).saturating_mul(height as u64).saturating_mul(copies).saturating_add(line_length as u64 * 4);
    let _decoding = source.take_memory(&format!("an image of {width} x {height}"), needed)?;

    let lines = scanline::decode(source, header.data, line_length, n_lines)?;
    let mut pixels = if upright { lines } else { turn_upright(source, &lines, header.orientation)? };
    if header.xyz {
        pixels.iter_mut().for_each(|pixel| *pixel = rgb_from_xyz(*pixel));
    } else if let Some(matrix) = &header.matrix {
        convert(&mut pixels, matrix);
    }
    Ok(Decoded { width, height, pixels, notes: header.notes, projection: None })
}

fn read_header(source: Source<'_>) -> Result<Header, RuntimeError> {
    let mut at = 0;
    let mut next_line = || -> Result<String, RuntimeError> {
        let rest = &source.bytes[at..];
        let length = rest.iter().position(|byte| *byte == b'\n').ok_or_else(|| source.truncated("its header has no end"))?;
        at += length + 1;
        // Headers are ASCII; what is not cannot matter here and must not stop a message.
        Ok(String::from_utf8_lossy(&rest[..length]).trim_end_matches('\r').to_owned())
    };
    next_line()?;
    let (mut xyz, mut matrix, mut notes) = (false, None, Vec::new());
    loop {
        let line = next_line()?;
        let line = line.trim();
        if line.is_empty() {
            break;
        }
        if line.starts_with('#') {
            continue;
        }
        let Some((name, value)) = line.split_once('=') else { continue };
        let (name, value) = (name.trim(), value.trim());
        match name {
            "FORMAT" => {
                xyz = match value {
                    "32-bit_rle_rgbe" => false,
                    "32-bit_rle_xyze" => true,
                    _ => return Err(source.error(format!("FORMAT={value} is not a Radiance pixel format known here"), HELP)),
                }
            }
            "EXPOSURE" | "COLORCORR" if !value.split_whitespace().all(|number| number.parse() == Ok(1.0f64)) => {
                notes.push(format!(
                    "{name}={value} in the header is not applied: pixel values are taken as radiance (use intensity to scale)"
                ));
            }
            "PRIMARIES" if !is_rec709(value) => {
                matrix = parse_primaries(value).and_then(Primaries::to_rec709);
                if matrix.is_none() {
                    notes.push(format!("PRIMARIES={value} in the header are none: colours are taken as Rec.709"));
                }
            }
            _ => {}
        }
    }
    let line = next_line()?;
    let orientation = parse_resolution(&line)
        .ok_or_else(|| source.error(format!("its resolution line `{}` is not of the form `-Y 512 +X 1024`", shorten(&line)), HELP))?;
    Ok(Header { orientation, xyz, matrix, notes, data: at })
}

/// Whether a PRIMARIES line gives the red, green and blue of Rec.709 (Radiance's own default is within 0.01), or only zeros as some
/// writers do.
fn is_rec709(value: &str) -> bool {
    value.split_whitespace().all(|number| number.parse() == Ok(0.0f64)) || parse_primaries(value).is_some_and(|own| own.is_rec709())
}

/// The eight numbers of a PRIMARIES line: x and y of red, green, blue and white.
fn parse_primaries(value: &str) -> Option<Primaries> {
    let numbers: Vec<f64> = value.split_whitespace().map_while(|number| number.parse().ok()).collect();
    let [red, green, blue, white] = [0, 2, 4, 6].map(|at| Some([*numbers.get(at)?, *numbers.get(at + 1)?]));
    Some(Primaries { red: red?, green: green?, blue: blue?, white: white? })
}

/// At most 40 characters of text from a file.
fn shorten(text: &str) -> String {
    text.chars().take(40).flat_map(char::escape_default).collect()
}

fn parse_resolution(line: &str) -> Option<Orientation> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let [slow, slow_length, fast, fast_length] = words[..] else { return None };
    let length = |word: &str| word.parse::<u32>().ok().filter(|length| *length > 0).map(|length| length as usize);
    let (slow_length, fast_length) = (length(slow_length)?, length(fast_length)?);
    let (y, x, rows) = match (slow, fast) {
        ("-Y" | "+Y", "-X" | "+X") => (slow, fast, true),
        ("-X" | "+X", "-Y" | "+Y") => (fast, slow, false),
        _ => return None,
    };
    let (height, width) = if rows { (slow_length, fast_length) } else { (fast_length, slow_length) };
    Some(Orientation { width, height, rows, flip_x: x == "-X", flip_y: y == "+Y" })
}

/// Rows from the top, left to right, out of scan lines in file order.
fn turn_upright(source: Source<'_>, lines: &[[f32; 3]], orientation: Orientation) -> Result<Vec<[f32; 3]>, RuntimeError> {
    let Orientation { width, height, rows, flip_x, flip_y } = orientation;
    let mut pixels = source.reserve_pixels(width * height)?;
    for y in 0..height {
        let line_y = if flip_y { height - 1 - y } else { y };
        for x in 0..width {
            let line_x = if flip_x { width - 1 - x } else { x };
            pixels.push(lines[if rows { line_y * width + line_x } else { line_x * height + line_y }]);
        }
    }
    Ok(pixels)
}

/// Rec.709 primaries with the equal-energy white that XYZE pictures assume: X = Y = Z is grey. Can be negative outside the gamut.
fn rgb_from_xyz(xyz: [f32; 3]) -> [f32; 3] {
    // Inverse of the matrix whose columns are the primaries' XYZ, each scaled so that the sum of columns is (1, 1, 1).
    const RGB_FROM_XYZ: [[f64; 3]; 3] = [
        [2.689655172413793, -1.2758620689655173, -0.41379310344827586],
        [-1.0221081721279115, 1.9782866166600868, 0.043821555467824715],
        [0.061224489795918366, -0.22448979591836735, 1.163265306122449],
    ];
    let [x, y, z] = xyz.map(f64::from);
    RGB_FROM_XYZ.map(|row| (row[0] * x + row[1] * y + row[2] * z) as f32)
}

//! EXT_meshopt_compression and KHR_meshopt_compression: buffer views that hold compressed bytes.
//!
//! A compressed view says where its bytes are (`buffer`, `byteOffset`, `byteLength`), what comes out (`count` elements of
//! `byteStride` bytes) and how: `mode` ATTRIBUTES, TRIANGLES or INDICES, then a `filter`. The view's own buffer is only where an
//! uncompressed copy would lie; a buffer marked `fallback` that nothing else reads need not exist and is not read.
//!
//! The decoder is the crate `meshopt`; it is safe on any bytes but stops the process on sizes that the format does not have, so
//! every size is checked here first: against the format, the bytes present, and the memory limit. Filters compute in f32 with SSE2,
//! the same on every x86-64.

use super::accessor::Buffers;
use super::error::{Budget, SceneError, Source};
use gltf::json::Root;
use meshopt::encoding as codec;
use rayon::prelude::*;
use serde_json::Value;

/// The two names of one extension.
pub(crate) const NAMES: [&str; 2] = ["KHR_meshopt_compression", "EXT_meshopt_compression"];

/// No stream holds more bytes a byte: a block of 256 elements takes at least a quarter of a byte for each of theirs; three u32
/// indices take at least a byte, one index of a sequence too.
const MOST_EXPANSION: [u64; 3] = [1024, 12, 4];

#[derive(Clone, Copy, Debug, PartialEq)]
enum Mode {
    Attributes,
    Triangles,
    Indices,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Filter {
    None,
    Octahedral,
    Quaternion,
    Exponential,
    Color,
}

/// A compressed view, checked.
struct Compressed<'a> {
    at: String,
    bytes: &'a [u8],
    count: usize,
    stride: usize,
    mode: Mode,
    filter: Filter,
}

/// The extension of a buffer view.
fn extension(root: &Root, view: usize) -> Option<(&'static str, &Value)> {
    let others = &root.buffer_views[view].extensions.as_ref()?.others;
    NAMES.into_iter().find_map(|name| Some((name, others.get(name)?)))
}

/// Whether a buffer exists only as the place of what compressed views hold, so that its bytes are not needed.
pub(crate) fn is_placeholder(root: &Root, buffer: usize) -> bool {
    let others = root.buffers[buffer].extensions.as_ref().map(|e| &e.others);
    let marked = |name: &str| others.and_then(|o| o.get(name)).and_then(|e| e.get("fallback")).and_then(Value::as_bool) == Some(true);
    NAMES.into_iter().any(marked)
        && (0..root.buffer_views.len()).all(|view| root.buffer_views[view].buffer.value() != buffer || extension(root, view).is_some())
}

/// Decodes every compressed view, on all threads. `[views]`, `None` for plain ones.
pub(crate) fn decode(buffers: &Buffers, budget: &mut Budget) -> Result<Vec<Option<Vec<u8>>>, SceneError> {
    let mut checked = Vec::with_capacity(buffers.root.buffer_views.len());
    for view in 0..buffers.root.buffer_views.len() {
        let compressed = extension(buffers.root, view).map(|(name, value)| check(buffers, view, name, value)).transpose()?;
        if let Some(c) = &compressed {
            let size = c.count as u64 * c.stride as u64;
            // Filled as elements, then kept as bytes.
            budget.charge(c.at.clone(), &format!("{} compressed elements of {} bytes", c.count, c.stride), 2 * size)?;
        }
        checked.push(compressed);
    }
    let size: u64 = checked.iter().flatten().map(|c| c.count as u64 * c.stride as u64).sum();
    let decoded: Vec<Result<Option<Vec<u8>>, SceneError>> =
        checked.par_iter().map(|c| c.as_ref().map(|c| elements(buffers.source, c)).transpose()).collect();
    budget.release(size);
    decoded.into_iter().collect()
}

fn check<'a>(buffers: &'a Buffers, view: usize, name: &str, value: &Value) -> Result<Compressed<'a>, SceneError> {
    let at = format!("bufferViews[{view}].extensions.{name}");
    let invalid = |what: String| buffers.source.invalid(at.clone(), what);
    let number = |key: &str| -> Result<u64, SceneError> {
        value.get(key).and_then(Value::as_u64).ok_or_else(|| invalid(format!("{key} is not a count")))
    };
    let offset = value.get("byteOffset").map_or(Ok(0), |_| number("byteOffset"))?;
    let bytes = buffers.range(number("buffer")? as usize, offset, number("byteLength")?, &at)?;
    let (count, stride) = (number("count")?, number("byteStride")?);
    let text = |key: &str| value.get(key).map(|v| v.as_str().unwrap_or("?"));
    let mode = match text("mode") {
        Some("ATTRIBUTES") => Mode::Attributes,
        Some("TRIANGLES") => Mode::Triangles,
        Some("INDICES") => Mode::Indices,
        _ => return Err(invalid("mode is neither ATTRIBUTES, TRIANGLES nor INDICES".into())),
    };
    let filter = match text("filter") {
        None | Some("NONE") => Filter::None,
        Some("OCTAHEDRAL") => Filter::Octahedral,
        Some("QUATERNION") => Filter::Quaternion,
        Some("EXPONENTIAL") => Filter::Exponential,
        Some("COLOR") => Filter::Color,
        Some(_) => return Err(invalid("a filter that this build does not know".into())),
    };
    let fits = match (mode, filter) {
        (Mode::Attributes, Filter::None | Filter::Exponential) => stride % 4 == 0 && (4..=256).contains(&stride),
        (Mode::Attributes, Filter::Octahedral | Filter::Color) => stride == 4 || stride == 8,
        (Mode::Attributes, Filter::Quaternion) => stride == 8,
        (Mode::Triangles, Filter::None) => (stride == 2 || stride == 4) && count % 3 == 0,
        (Mode::Indices, Filter::None) => stride == 2 || stride == 4,
        _ => false,
    };
    if !fits {
        return Err(invalid(format!("{count} elements of {stride} bytes do not go with its mode and filter")));
    }
    let size = count.checked_mul(stride).filter(|&size| size == buffers.root.buffer_views[view].byte_length.0);
    let Some(size) = size else {
        return Err(invalid(format!("{count} elements of {stride} bytes are not the view's byteLength")));
    };
    if size > MOST_EXPANSION[mode as usize].saturating_mul(bytes.len() as u64) {
        return Err(invalid(format!("it claims {size} bytes in {} compressed ones", bytes.len())));
    }
    Ok(Compressed { at, bytes, count: count as usize, stride: stride as usize, mode, filter })
}

fn elements(source: Source, c: &Compressed) -> Result<Vec<u8>, SceneError> {
    if c.count == 0 {
        return Ok(Vec::new());
    }
    let decoded = match (c.mode, c.filter, c.stride) {
        (Mode::Triangles, _, 2) => codec::decode_index_buffer::<u16>(c.bytes, c.count).map(|list| bytemuck::cast_slice(&list).to_vec()),
        (Mode::Triangles, ..) => codec::decode_index_buffer::<u32>(c.bytes, c.count).map(|list| bytemuck::cast_slice(&list).to_vec()),
        (Mode::Indices, _, 2) => codec::decode_index_sequence::<u16>(c.bytes, c.count).map(|list| bytemuck::cast_slice(&list).to_vec()),
        (Mode::Indices, ..) => codec::decode_index_sequence::<u32>(c.bytes, c.count).map(|list| bytemuck::cast_slice(&list).to_vec()),
        (_, Filter::None, _) => attributes(c),
        (_, Filter::Octahedral, 4) => filtered(c, codec::decode_filter_oct::<i8>),
        (_, Filter::Octahedral, _) => filtered(c, codec::decode_filter_oct::<i16>),
        (_, Filter::Quaternion, _) => filtered(c, codec::decode_filter_quat),
        (_, Filter::Color, 4) => filtered(c, codec::decode_filter_color::<u8>),
        (_, Filter::Color, _) => filtered(c, codec::decode_filter_color::<u16>),
        (_, Filter::Exponential, _) => attributes(c).map(|bytes| {
            // Each component is decoded on its own, whatever the stride.
            let mut words: Vec<[u32; 1]> = bytes.chunks_exact(4).map(|b| [u32::from_le_bytes([b[0], b[1], b[2], b[3]])]).collect();
            codec::decode_filter_exp(&mut words);
            bytemuck::cast_slice(&words).to_vec()
        }),
    };
    decoded.map_err(|_| source.invalid(c.at.clone(), "its compressed bytes are damaged"))
}

fn filtered<T: Copy + Default + bytemuck::Pod>(c: &Compressed, filter: impl Fn(&mut [[T; 4]])) -> meshopt::Result<Vec<u8>> {
    let mut list = codec::decode_vertex_buffer::<[T; 4]>(c.bytes, c.count)?;
    filter(&mut list);
    Ok(bytemuck::cast_slice(&list).to_vec())
}

/// An element of a size that arrays have no default for.
#[derive(Clone, Copy)]
struct Element<const N: usize>([u8; N]);

impl<const N: usize> Default for Element<N> {
    fn default() -> Self {
        Element([0; N])
    }
}

/// The crate takes the stride from a type, so each of the 64 strides of the format gets one.
fn attributes(c: &Compressed) -> meshopt::Result<Vec<u8>> {
    fn decode<const N: usize>(c: &Compressed) -> meshopt::Result<Vec<u8>> {
        let list = codec::decode_vertex_buffer::<Element<N>>(c.bytes, c.count)?;
        Ok(list.iter().flat_map(|element| element.0).collect())
    }
    macro_rules! by_stride {
        ($($stride:literal)*) => {
            match c.stride {
                $($stride => decode::<$stride>(c),)*
                _ => unreachable!("the stride was checked"),
            }
        };
    }
    by_stride!(4 8 12 16 20 24 28 32 36 40 44 48 52 56 60 64 68 72 76 80 84 88 92 96 100 104 108 112 116 120 124 128
        132 136 140 144 148 152 156 160 164 168 172 176 180 184 188 192 196 200 204 208 212 216 220 224 228 232 236 240 244 248 252 256)
}

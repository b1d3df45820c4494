//! KHR_draco_mesh_compression: primitives whose vertices and indices are one Draco stream.
//!
//! The stream's attributes go by their unique ids to the accessors that the primitive names, and its faces to the accessor of the
//! indices; each is packed in that accessor's own type, so that all later checks (extents, finite numbers, indices in range) see what
//! they always see. Accessors that have a buffer view of their own are a fallback: then the stream is not looked at.
//!
//! The stream's counts are compared with the accessors' before the decoder runs, and charged to the memory limit; the decoder (no `unsafe`,
//! and it sizes nothing by a claim that no bytes stand behind) is given the same limits, runs under `catch_unwind`, silently, and what it
//! returns is checked again: sizes, types, indices.

use super::accessor::Buffers;
use super::error::{Budget, SceneError, Source};
use gltf::json::mesh::Primitive;
use gltf::json::validation::Checked;
use serde_json::{Map, Value};
use std::collections::BTreeMap;

/// Name of the extension.
pub(crate) const NAME: &str = "KHR_draco_mesh_compression";

/// A compressed primitive, checked as far as JSON goes.
#[cfg_attr(not(feature = "draco"), allow(dead_code))]
pub(crate) struct Stream {
    at: String,
    view: usize,
    /// (accessor, the stream's attribute).
    attributes: Vec<(usize, u64)>,
    indices: usize,
    points: u64,
    faces: u64,
}

fn extension(primitive: &Primitive) -> Option<&Value> {
    primitive.extensions.as_ref()?.others.get(NAME)
}

/// The streams of the meshes in use that have to be decoded; each stands for one primitive or several that share all accessors.
pub(crate) fn streams(buffers: &Buffers, meshes: &[usize]) -> Result<Vec<Stream>, SceneError> {
    let (root, source) = (buffers.root, buffers.source);
    let mut streams: Vec<Stream> = Vec::new();
    let mut taken: BTreeMap<usize, (usize, u64)> = BTreeMap::new();
    for &m in meshes {
        for (p, primitive) in root.meshes[m].primitives.iter().enumerate() {
            let Some(value) = extension(primitive) else { continue };
            let at = format!("meshes[{m}].primitives[{p}].extensions.{NAME}");
            let invalid = |what: &str| source.invalid(at.clone(), what);
            let view = value.get("bufferView").and_then(Value::as_u64).filter(|&view| view < root.buffer_views.len() as u64);
            let view = view.ok_or_else(|| invalid("no buffer view"))? as usize;
            let empty = Map::new();
            let ids = value.get("attributes").and_then(Value::as_object).unwrap_or(&empty);
            let mut attributes = Vec::new();
            for (semantic, accessor) in &primitive.attributes {
                let Checked::Valid(semantic) = semantic else { continue };
                let Some(id) = ids.get(&semantic.to_string()) else { continue };
                let id = id.as_u64().ok_or_else(|| invalid("an attribute's id is not a number"))?;
                attributes.push((accessor.value(), id));
            }
            attributes.sort_unstable();
            let indices = primitive.indices.ok_or_else(|| invalid("compressed faces, but no accessor for indices"))?.value();
            let bare = |accessor: usize| root.accessors[accessor].buffer_view.is_none();
            if !bare(indices) && attributes.iter().all(|&(accessor, _)| !bare(accessor)) {
                continue;
            }
            // u64::MAX stands for the faces.
            let claims = attributes.iter().copied().chain([(indices, u64::MAX)]);
            let mut known = 0;
            for (accessor, id) in claims.clone() {
                match taken.insert(accessor, (view, id)) {
                    None => {}
                    Some(before) if before == (view, id) => known += 1,
                    Some(_) => return Err(invalid("an accessor that another compressed primitive fills otherwise")),
                }
            }
            if known == claims.count() {
                continue;
            }
            let points = attributes.first().map_or(0, |&(accessor, _)| root.accessors[accessor].count.0);
            if attributes.iter().any(|&(accessor, _)| root.accessors[accessor].count.0 != points) {
                return Err(invalid("accessors of different counts"));
            }
            let faces = root.accessors[indices].count.0;
            if faces % 3 != 0 {
                return Err(invalid("indices that are no triangles"));
            }
            streams.push(Stream { at, view, attributes, indices, points, faces: faces / 3 });
        }
    }
    Ok(streams)
}

/// What this build says without a decoder.
#[cfg(not(feature = "draco"))]
pub(crate) fn decode(buffers: &Buffers, streams: &[Stream], _: &mut Budget) -> Result<BTreeMap<usize, Vec<u8>>, SceneError> {
    let Some(first) = streams.first() else { return Ok(BTreeMap::new()) };
    let (file, name) = (buffers.source.name(), NAME.to_string());
    let used_by = format!("used by {} primitives", streams.len());
    Err(SceneError::Extension { file, name, at: first.at.clone(), used_by, help: WAY_OUT.to_string() })
}

/// What to do without a decoder.
pub(crate) const WAY_OUT: &str = "build with the feature `draco`, or export it without Draco compression (Blender: untick Compression)";

#[cfg(feature = "draco")]
pub(crate) use decoder::decode;

#[cfg(feature = "draco")]
mod decoder {
    use super::super::warnings::quote;
    use super::*;
    use draco_core::{DataType, DecodeLimits, DecoderBuffer, Mesh, MeshDecoder, PointAttribute, PointIndex};
    use gltf::json::Root;
    use gltf::json::accessor::ComponentType;
    use rayon::prelude::*;
    use std::cell::Cell;
    use std::panic::{AssertUnwindSafe, catch_unwind};
    use std::sync::Once;

    /// Bytes that decoding takes for a face and for each value of a point, beside what is kept; measured on spheres, rounded up.
    const BYTES_PER_FACE: u64 = 256;
    const BYTES_PER_VALUE: u64 = 64;

    impl Stream {
        /// What decoding may take, in bytes.
        fn bytes(&self) -> u64 {
            let values = self.points.saturating_mul(1 + self.attributes.len() as u64);
            self.faces.saturating_mul(BYTES_PER_FACE).saturating_add(values.saturating_mul(BYTES_PER_VALUE))
        }
    }

    /// Decodes the streams on all threads: accessor -> its elements.
    pub fn decode(buffers: &Buffers, streams: &[Stream], budget: &mut Budget) -> Result<BTreeMap<usize, Vec<u8>>, SceneError> {
        for stream in streams {
            super::counts::check(buffers.source, stream, buffers.view(stream.view)?)?;
            budget.charge(stream.at.clone(), &format!("{} compressed triangles", stream.faces), stream.bytes())?;
        }
        let results: Vec<Result<Vec<(usize, Vec<u8>)>, SceneError>> = streams.par_iter().map(|stream| one(buffers, stream)).collect();
        let mut accessors = BTreeMap::new();
        for result in results {
            accessors.extend(result?);
        }
        Ok(accessors)
    }

    fn one(buffers: &Buffers, stream: &Stream) -> Result<Vec<(usize, Vec<u8>)>, SceneError> {
        let invalid = |what: String| buffers.source.invalid(stream.at.clone(), what);
        let bytes = buffers.view(stream.view)?;
        let limits = DecodeLimits::default().with_max_points(stream.points).with_max_faces(stream.faces);
        let mut mesh = Mesh::new();
        quietly(|| {
            let mut stream = DecoderBuffer::new(bytes).with_limits(limits.with_max_decoded_bytes(stream.bytes()));
            MeshDecoder::new().decode(&mut stream, &mut mesh)
        })
        .ok_or_else(|| invalid("its Draco stream is damaged: the decoder gave up".into()))?
        .map_err(|e| invalid(format!("its Draco stream cannot be decoded: {}", quote(&e.to_string()))))?;
        let (points, faces) = (stream.points as usize, stream.faces as usize);
        if mesh.num_faces() != faces {
            return Err(invalid(format!("{} triangles in the stream, its indices say {faces}", mesh.num_faces())));
        }
        if mesh.num_points() > points {
            return Err(invalid(format!("{} vertices in the stream, its accessors say {points}", mesh.num_points())));
        }
        let mut out = Vec::with_capacity(stream.attributes.len() + 1);
        for &(accessor, id) in &stream.attributes {
            let found = u32::try_from(id).ok().and_then(|id| mesh.attribute_by_unique_id(id));
            let found = found.ok_or_else(|| invalid(format!("no attribute {id} in the stream")))?;
            out.push((accessor, values(buffers.root, accessor, found, mesh.num_points(), points).map_err(invalid)?));
        }
        out.push((stream.indices, indices(buffers.root, stream.indices, &mesh).map_err(invalid)?));
        Ok(out)
    }

    /// The attribute's value at every point, in the accessor's type; the last one again for vertices that the stream leaves out.
    fn values(root: &Root, accessor: usize, attribute: &PointAttribute, decoded: usize, points: usize) -> Result<Vec<u8>, String> {
        let json = &root.accessors[accessor];
        let (Checked::Valid(component), Checked::Valid(kind)) = (json.component_type, &json.type_) else {
            return Err("an accessor of a type that glTF does not have".into());
        };
        let same = matches!(
            (component.0, attribute.data_type()),
            (ComponentType::I8, DataType::Int8)
                | (ComponentType::U8, DataType::Uint8)
                | (ComponentType::I16, DataType::Int16)
                | (ComponentType::U16, DataType::Uint16)
                | (ComponentType::U32, DataType::Uint32)
                | (ComponentType::F32, DataType::Float32)
        );
        let size = component.0.size() * kind.multiplicity();
        if !same || usize::from(attribute.num_components()) != kind.multiplicity() {
            let found = (attribute.num_components(), attribute.data_type());
            return Err(format!("accessors[{accessor}] is of another type than the stream's {} x {:?}", found.0, found.1));
        }
        let (bytes, stride) = (attribute.buffer().data(), usize::try_from(attribute.byte_stride()).unwrap_or(0));
        let mut out = Vec::with_capacity(points * size);
        for point in 0..decoded {
            let value = attribute.mapped_index(PointIndex(point as u32)).0 as usize;
            let value = value.checked_mul(stride).and_then(|at| bytes.get(at..)?.get(..size));
            out.extend_from_slice(value.ok_or("a value beyond the stream's own")?);
        }
        let last = out.len().saturating_sub(size);
        while out.len() < points * size {
            let again = out.get(last..last + size).map_or_else(|| vec![0; size], <[u8]>::to_vec);
            out.extend_from_slice(&again);
        }
        Ok(out)
    }

    fn indices(root: &Root, accessor: usize, mesh: &Mesh) -> Result<Vec<u8>, String> {
        let width = match root.accessors[accessor].component_type {
            Checked::Valid(component) if matches!(component.0, ComponentType::U8 | ComponentType::U16 | ComponentType::U32) => {
                component.0.size()
            }
            _ => return Err(format!("accessors[{accessor}]: indices are neither u8, u16 nor u32")),
        };
        let mut out = Vec::with_capacity(3 * width * mesh.num_faces());
        for point in mesh.faces().iter().flatten() {
            if point.0 as usize >= mesh.num_points() {
                return Err(format!("a triangle beyond its {} vertices", mesh.num_points()));
            }
            let index = u64::from(point.0);
            if index >> (8 * width) != 0 {
                return Err(format!("accessors[{accessor}] is too narrow for vertex {index}"));
            }
            out.extend_from_slice(&index.to_le_bytes()[..width]);
        }
        Ok(out)
    }

    thread_local! {
        static QUIET: Cell<bool> = const { Cell::new(false) };
    }

    /// Runs what may panic; `None` if it did. The message that Rust would print is held back, on this thread only.
    fn quietly<T>(run: impl FnOnce() -> T) -> Option<T> {
        static HOOK: Once = Once::new();
        HOOK.call_once(|| {
            let before = std::panic::take_hook();
            std::panic::set_hook(Box::new(move |info| {
                if !QUIET.get() {
                    before(info);
                }
            }));
        });
        QUIET.set(true);
        let result = catch_unwind(AssertUnwindSafe(run));
        QUIET.set(false);
        result.ok()
    }
}

/// The counts at the front of a stream, read before any of it is decoded.
///
/// ```text
/// "DRACO" | u8 major = 2 | u8 minor = 2 | u8 kind = 1 mesh | u8 method: 0 sequential, 1 edgebreaker | u16 flags, 0x8000 metadata
/// [metadata]                      n {id, entries}, then entries of the whole; an entry is name, length, bytes; they nest
/// sequential:  faces, points
/// edgebreaker: u8 traversal, vertices, faces, u8 attribute streams, symbols, split symbols, splits       (LEB128 unless u8)
/// ```
#[cfg(feature = "draco")]
mod counts {
    use super::*;

    struct Reader<'a>(&'a [u8]);

    impl<'a> Reader<'a> {
        fn take(&mut self, n: u64) -> Option<&'a [u8]> {
            let (head, tail) = self.0.split_at_checked(usize::try_from(n).ok()?)?;
            self.0 = tail;
            Some(head)
        }

        fn byte(&mut self) -> Option<u8> {
            Some(self.take(1)?[0])
        }

        fn leb128(&mut self) -> Option<u64> {
            let mut value = 0u64;
            for shift in (0..63).step_by(7) {
                let byte = self.byte()?;
                value |= u64::from(byte & 0x7F) << shift;
                if byte & 0x80 == 0 {
                    return Some(value);
                }
            }
            None
        }

        /// Entries and, in depth-first order, whatever is nested in them.
        fn skip_metadata(&mut self) -> Option<()> {
            let mut left = 1u64;
            let mut first = true;
            while left > 0 {
                left -= 1;
                if !std::mem::replace(&mut first, false) {
                    let name = self.byte()?;
                    self.take(u64::from(name))?;
                }
                for _ in 0..self.leb128()? {
                    let name = self.byte()?;
                    self.take(u64::from(name))?;
                    let length = self.leb128()?;
                    self.take(length)?;
                }
                left = left.checked_add(self.leb128()?)?;
            }
            Some(())
        }
    }

    /// Refuses a stream whose counts are beyond those of its accessors.
    pub fn check(source: Source, stream: &Stream, bytes: &[u8]) -> Result<(), SceneError> {
        let invalid = |what: &str| source.invalid(stream.at.clone(), what);
        let fits = |bytes: &[u8]| -> Option<bool> {
            let mut r = Reader(bytes.get(7..)?);
            let [kind, method] = [r.byte()?, r.byte()?];
            let flags = u16::from_le_bytes([r.byte()?, r.byte()?]);
            if flags & 0x8000 != 0 {
                for _ in 0..r.leb128()? {
                    r.leb128()?;
                    r.skip_metadata()?;
                }
                r.skip_metadata()?;
            }
            let (points, faces) = (stream.points, stream.faces);
            if method == 0 {
                return Some(kind == 1 && r.leb128()? == faces && r.leb128()? == points);
            }
            let _traversal = r.byte()?;
            let (vertices, n_faces, _, symbols, split_symbols) = (r.leb128()?, r.leb128()?, r.byte()?, r.leb128()?, r.leb128()?);
            let splits = r.leb128()?;
            // A vertex becomes at least one point; a symbol makes a face.
            Some(
                kind == 1
                    && method == 1
                    && n_faces == faces
                    && vertices <= points
                    && symbols <= faces
                    && split_symbols <= symbols
                    && splits <= faces,
            )
        };
        if !bytes.starts_with(b"DRACO") {
            return Err(invalid("its bytes are no Draco stream"));
        }
        if !bytes[5..].starts_with(&[2, 2]) {
            return Err(invalid("its Draco stream is of another version than glTF's, 2.2"));
        }
        match fits(bytes) {
            None => Err(invalid("its Draco stream is cut short")),
            Some(false) => Err(invalid("its Draco stream has other counts than its accessors")),
            Some(true) => Ok(()),
        }
    }
}

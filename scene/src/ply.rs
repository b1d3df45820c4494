//! Stanford PLY: ASCII and binary, either byte order.
//!
//! Read: `vertex` with x y z, and where there are all of them nx ny nz, s t (also u v, texture_u texture_v), red green blue with alpha
//! (bytes, 16 bits or 0..1); `face` with `vertex_indices` or `vertex_index`, and `tristrips`. Colours are sRGB, as scanners write them.
//! Everything else in a file is skipped. A face of more than three corners becomes a fan.
//!
//! The crate `ply-rs-bw` reads; before it does, the counts of the header are held against the bytes that are there, because an
//! element without properties costs a file nothing and a reader everything.

use super::assemble::{self, Parts, linear_from_srgb, plain};
use super::error::{Budget, SceneError, Source};
use super::gltf::LoadLimits;
use super::origin::Bounds;
use super::warnings::{Warnings, quote};
use super::{Mesh, Primitive, Scene};
use ply_rs_bw::parser::{ParseError, Parser, Reader};
use ply_rs_bw::ply::{BeginList, ElementDef, Encoding, Header, Property, PropertyAccess, PropertyAccessResult, PropertyType, ScalarType};
use std::path::Path;

const HELP: &str = "export the file again, or convert it to .glb";

/// Loads a PLY file.
pub(crate) fn load(path: &Path, limits: &LoadLimits) -> Result<Scene, SceneError> {
    assemble::load(path, limits, parse)
}

/// A vertex or a face, whichever the element is; what the file does not set is absent.
#[derive(Default)]
struct Element {
    position: [f64; 3],
    normal: [f32; 3],
    uv: [f32; 2],
    color: [f64; 4],
    signed: Vec<i32>,
    unsigned: Vec<u32>,
    strips: Vec<i32>,
}

/// Sums over a vertex element: which of a vertex's values a header promises.
#[derive(Default)]
struct Promised {
    normals: bool,
    uvs: bool,
    colors: bool,
}

const UV_NAMES: [[&str; 2]; 3] = [["s", "t"], ["u", "v"], ["texture_u", "texture_v"]];
const COLOR_NAMES: [[&str; 4]; 2] = [["red", "green", "blue", "alpha"], ["diffuse_red", "diffuse_green", "diffuse_blue", "diffuse_alpha"]];

impl Promised {
    fn new(element: &ElementDef) -> Self {
        let all = |names: &[&str]| names.iter().all(|name| element.properties.contains_key(*name));
        Promised {
            normals: all(&["nx", "ny", "nz"]),
            uvs: UV_NAMES.iter().any(|names| all(names)),
            colors: COLOR_NAMES.iter().any(|names| all(&names[..3])),
        }
    }
}

/// The place of a name in a table of names.
fn component<const N: usize>(tables: &[[&str; N]], name: &str) -> Option<usize> {
    tables.iter().find_map(|names| names.iter().position(|known| *known == name))
}

impl PropertyAccess for Element {
    fn new() -> Self {
        Element { color: [0.0, 0.0, 0.0, 1.0], ..Element::default() }
    }

    fn set_property(&mut self, name: &str, value: Property) -> PropertyAccessResult {
        let is_list = matches!(name, "vertex_indices" | "vertex_index");
        if is_list && let Some(indices) = value.to_u32_list() {
            self.unsigned = indices;
            return PropertyAccessResult::Set;
        }
        let Some((number, full)) = number(&value) else {
            return if is_list { PropertyAccessResult::UnsupportedType } else { PropertyAccessResult::Ignored };
        };
        if let Some(axis) = component(&[["x", "y", "z"]], name) {
            self.position[axis] = number;
        } else if let Some(axis) = component(&[["nx", "ny", "nz"]], name) {
            self.normal[axis] = number as f32;
        } else if let Some(axis) = component(&UV_NAMES, name) {
            self.uv[axis] = number as f32;
        } else if let Some(channel) = component(&COLOR_NAMES, name) {
            self.color[channel] = number / full;
        } else {
            return PropertyAccessResult::Ignored;
        }
        PropertyAccessResult::Set
    }

    fn begin_list_int(&mut self, name: &str, _: usize) -> BeginList<'_, i32> {
        match name {
            "vertex_indices" | "vertex_index" => BeginList::Fill(&mut self.signed),
            "tristrips" => BeginList::Fill(&mut self.strips),
            _ => BeginList::UseSetter,
        }
    }

    fn begin_list_uint(&mut self, name: &str, _: usize) -> BeginList<'_, u32> {
        match name {
            "vertex_indices" | "vertex_index" => BeginList::Fill(&mut self.unsigned),
            _ => BeginList::UseSetter,
        }
    }
}

/// A scalar, and what stands for 1 in a colour of its type.
fn number(value: &Property) -> Option<(f64, f64)> {
    Some(match value {
        Property::Char(x) => (f64::from(*x), 127.0),
        Property::UChar(x) => (f64::from(*x), 255.0),
        Property::Short(x) => (f64::from(*x), 32767.0),
        Property::UShort(x) => (f64::from(*x), 65535.0),
        Property::Int(x) => (f64::from(*x), 255.0),
        Property::UInt(x) => (f64::from(*x), 255.0),
        Property::Float(x) => (f64::from(*x), 1.0),
        Property::Double(x) => (*x, 1.0),
        _ => return None,
    })
}

/// The crate's words on one line; it quotes whole lines of the file.
fn syntax(source: Source, error: &ParseError) -> SceneError {
    let text = error.to_string();
    let what = text.lines().next().unwrap_or_default().trim_end_matches('.');
    let cause = text.lines().last().filter(|last| *last != what).and_then(|last| last.trim().strip_prefix("Error: "));
    let what = match cause {
        Some(cause) => format!("{what}: {cause}"),
        None => what.to_string(),
    };
    let at = error.line().map_or("the file".to_string(), |line| format!("line or element {line}"));
    let what = format!("not a readable PLY file: {}", quote(&what).trim_matches('"'));
    SceneError::Invalid { file: source.name(), at, what, help: HELP.to_string() }
}

fn parse(source: Source, file: &[u8], budget: &mut Budget) -> Result<Parts, SceneError> {
    let mut warnings = Warnings::default();
    let parser = Parser::<Element>::new();
    let mut reader = Reader::new(file);
    let header = parser.read_header(&mut reader).map_err(|error| syntax(source, &error))?;
    let left = reader.get_ref().len() as u64;
    check_counts(source, &header, left)?;
    let longest = if header.encoding == Encoding::Ascii { longest_line(reader.get_ref()) } else { 0 };
    budget.charge("the file", "its longest line", longest.saturating_mul(24))?;

    let mut found = Found::default();
    for element in header.elements.values() {
        let n = element.count as u64;
        let at = format!("element {}", element.name);
        // As read, then as arrays. Lists are held as bytes of the file at most eightfold: 4 bytes an index from half a byte of text.
        let held = n.saturating_mul(size_of::<Element>() as u64 + 64).saturating_add(left.saturating_mul(8));
        budget.charge(&at, &format!("{n} elements"), held)?;
        let read = parser.read_payload_for_element(&mut reader, element, &header).map_err(|error| syntax(source, &error))?;
        match element.name.as_str() {
            "vertex" => found.vertices(source, element, read)?,
            "face" | "tristrips" => found.faces(source, read, &mut warnings)?,
            "range_grid" | "camera" | "material" => {}
            _ => warnings.note("elements other than vertex, face and tristrips are not read", || quote(&element.name)),
        }
        budget.release(held);
        budget.charge(&at, &format!("{n} elements"), n.saturating_mul(64))?;
    }
    found.parts(source, warnings)
}

/// Smallest number of bytes that an element takes, against the bytes that there are.
fn check_counts(source: Source, header: &Header, left: u64) -> Result<(), SceneError> {
    let size = |scalar: &ScalarType| match scalar {
        ScalarType::Char | ScalarType::UChar => 1u64,
        ScalarType::Short | ScalarType::UShort => 2,
        ScalarType::Int | ScalarType::UInt | ScalarType::Float => 4,
        ScalarType::Double => 8,
    };
    let ascii = header.encoding == Encoding::Ascii;
    let mut needed = 0u64;
    for element in header.elements.values() {
        let least: u64 = (element.properties.values())
            .map(|property| match &property.data_type {
                // A digit and a separator.
                _ if ascii => 2,
                PropertyType::Scalar(scalar) | PropertyType::List(scalar, _) => size(scalar),
            })
            .sum();
        let invalid = |what: String| {
            let (file, at) = (source.name(), format!("element {}", element.name));
            SceneError::Invalid { file, at, what, help: HELP.to_string() }
        };
        if least == 0 && element.count > 0 {
            return Err(invalid(format!("it claims {} elements without properties", element.count)));
        }
        needed = needed.saturating_add(least.saturating_mul(element.count as u64));
        // The last line of a text needs no end.
        if needed > left + u64::from(ascii) {
            return Err(invalid(format!("the header claims {} of them, {needed} bytes or more, the file has {left} left", element.count)));
        }
    }
    Ok(())
}

fn longest_line(text: &[u8]) -> u64 {
    text.split(|byte| *byte == b'\n').map(|line| line.len() as u64).max().unwrap_or(0)
}

/// What has been read so far.
#[derive(Default)]
struct Found {
    primitive: Primitive,
    /// What positions are counted from.
    origin: [f64; 3],
    has_vertices: bool,
    /// Corners of faces are looked up once all vertices are there; most files list vertices first.
    triangles: Vec<[i64; 3]>,
}

impl Found {
    fn vertices(&mut self, source: Source, element: &ElementDef, read: Vec<Element>) -> Result<(), SceneError> {
        let promised = Promised::new(element);
        if !["x", "y", "z"].iter().all(|name| element.properties.contains_key(*name)) {
            let (file, what) = (source.name(), "vertices without x, y and z".to_string());
            return Err(SceneError::Invalid { file, at: "element vertex".to_string(), what, help: HELP.to_string() });
        }
        self.has_vertices = true;
        let (mut normals, mut uvs, mut colors) = (Vec::new(), Vec::new(), Vec::new());
        let mut positions = Vec::with_capacity(read.len());
        let mut bounds = Bounds::default();
        read.iter().for_each(|vertex| bounds.point(vertex.position));
        self.origin = bounds.origin();
        for (i, vertex) in read.iter().enumerate() {
            let position: [f32; 3] = std::array::from_fn(|k| (vertex.position[k] - self.origin[k]) as f32);
            let all = position.iter().chain(&vertex.normal).chain(&vertex.uv);
            if !all.clone().all(|x| x.is_finite()) || !vertex.color.iter().all(|x| x.is_finite()) {
                let (file, at) = (source.name(), format!("vertex {i}"));
                return Err(SceneError::Invalid { file, at, what: "a number that is not finite".to_string(), help: HELP.to_string() });
            }
            positions.push(position);
            if promised.normals {
                normals.push(vertex.normal);
            }
            if promised.uvs {
                // PLY counts t from the bottom, glTF from the top.
                uvs.push([vertex.uv[0], 1.0 - vertex.uv[1]]);
            }
            if promised.colors {
                let [r, g, b, a] = vertex.color;
                let [r, g, b] = [r, g, b].map(linear_from_srgb);
                colors.push([r, g, b, a.clamp(0.0, 1.0) as f32]);
            }
        }
        self.primitive.positions = positions;
        self.primitive.normals = promised.normals.then_some(normals);
        self.primitive.uvs[0] = promised.uvs.then_some(uvs);
        self.primitive.colors = promised.colors.then_some(colors);
        Ok(())
    }

    fn faces(&mut self, source: Source, read: Vec<Element>, warnings: &mut Warnings) -> Result<(), SceneError> {
        for (i, face) in read.iter().enumerate() {
            let corners: Vec<i64> = face.signed.iter().map(|x| i64::from(*x)).chain(face.unsigned.iter().map(|x| i64::from(*x))).collect();
            if corners.len() < 3 && face.strips.is_empty() {
                warnings.note("faces of fewer than three corners are left out", || format!("face {i}"));
            }
            if corners.len() > 4 {
                warnings.note("faces of more than four corners are cut into fans, which is right where they are convex", || {
                    format!("face {i}")
                });
            }
            for pair in corners.get(1..).unwrap_or_default().windows(2) {
                self.triangles.push([corners[0], pair[0], pair[1]]);
            }
            // Strips are divided by -1; every second triangle runs the other way.
            for strip in face.strips.split(|index| *index == -1) {
                for (k, window) in strip.windows(3).enumerate() {
                    let [a, b, c] = [window[0], window[1], window[2]].map(i64::from);
                    self.triangles.push(if k % 2 == 0 { [a, b, c] } else { [a, c, b] });
                }
            }
        }
        if u32::try_from(self.triangles.len()).is_err() {
            return Err(source.unsupported("element face", format!("{} triangles", self.triangles.len()), "split the file"));
        }
        Ok(())
    }

    fn parts(mut self, source: Source, warnings: Warnings) -> Result<Parts, SceneError> {
        let n = self.primitive.positions.len();
        let empty = |what: &str| {
            let (file, help) = (source.name(), "make a surface of it first: only triangles can be baked".to_string());
            SceneError::Empty { file, at: "the file".to_string(), what: what.to_string(), help }
        };
        if !self.has_vertices || n == 0 {
            return Err(empty("it has no vertices"));
        }
        if self.triangles.is_empty() {
            return Err(empty("it is a cloud of points without faces"));
        }
        let mut triangles = Vec::with_capacity(self.triangles.len());
        for (i, triangle) in self.triangles.iter().enumerate() {
            if let Some(index) = triangle.iter().find(|index| !(0..n as i64).contains(*index)) {
                let (file, at) = (source.name(), format!("triangle {i} of the faces"));
                let what = format!("a face names vertex {index}, the file has {n}");
                return Err(SceneError::Invalid { file, at, what, help: HELP.to_string() });
            }
            triangles.push(triangle.map(|index| index as u32));
        }
        self.primitive.triangles = triangles;
        let name = source.0.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        // A colour of its own would tint those of the vertices.
        let grey = if self.primitive.colors.is_some() { 1.0 } else { 0.8 };
        Ok(Parts {
            origin: self.origin,
            objects: vec![(name.clone(), Mesh { primitives: vec![self.primitive] })],
            materials: vec![plain(&name, [grey, grey, grey, 1.0])],
            images: Vec::new(),
            warnings: warnings.lines(),
        })
    }
}

#[cfg(test)]
mod tests;

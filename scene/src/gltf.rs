//! Reads `.glb` and `.gltf` files.
//!
//! In this order, so that nothing is done for a file that will be refused, and nothing is allocated before it is counted: the
//! description (`document`), the node tree, buffers, what is compressed in them, every accessor against its buffer, materials, sizes of meshes and images,
//! then pixels and vertices on all threads.

use super::accessor::Buffers;
use super::document::{self, Document, Extras};
use super::error::{Budget, SceneError, Source};
use super::mesh::{self, Palette, Plan};
use super::warnings::{Warnings, label};
use super::world::{Placement, WorldSize, has_area};
use super::{Mesh, Object, Scene, draco, instance, material, meshopt, node, origin, pose, resource, texture};
use gltf::json::Root;
use rayon::prelude::*;
use serde_json::{Map, Value, json};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

/// What loading may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LoadLimits {
    /// Bytes held at the same time: the file, its decoded meshes and textures, and the flattened [`super::world::World`].
    pub max_bytes: u64,
}

impl Default for LoadLimits {
    /// 8 GiB.
    fn default() -> Self {
        LoadLimits { max_bytes: 8 << 30 }
    }
}

/// Loads a scene. The kind of file is told by its first bytes, not by its name.
pub fn load(path: &Path, limits: &LoadLimits) -> Result<Scene, SceneError> {
    load_variant(path, limits, None)
}

/// Loads a scene with the materials that one of its variants (KHR_materials_variants) has. An unknown name is an error that lists them.
pub fn load_variant(path: &Path, limits: &LoadLimits, variant: Option<&str>) -> Result<Scene, SceneError> {
    let source = Source(path);
    let mut budget = Budget::new(source, limits.max_bytes);
    let file = resource::read_file(path, "the file", None, &mut budget)?;
    load_slice(source, &file, variant, &mut budget)
}

/// Loads bytes as if they had been read from `path`, which messages name and other files are looked for beside.
pub fn load_bytes(path: &Path, bytes: &[u8], limits: &LoadLimits) -> Result<Scene, SceneError> {
    let source = Source(path);
    let mut budget = Budget::new(source, limits.max_bytes);
    budget.charge("the file", "its bytes", bytes.len() as u64)?;
    load_slice(source, bytes, None, &mut budget)
}

/// The description of a file, as far as it can be read.
pub(crate) fn description(path: &Path, file: &[u8]) -> Option<Value> {
    let json = match super::glb::is_glb(file) {
        true => super::glb::parse(Source(path), file).ok().map(|chunks| &file[chunks.json])?,
        false => file,
    };
    serde_json::from_slice(json).ok()
}

/// Relative files that buffers and images name, percent signs decoded. Nothing where the description cannot be read.
pub(crate) fn uris(path: &Path, file: &[u8]) -> Vec<String> {
    let Some(root) = description(path, file) else { return Vec::new() };
    let lists = ["buffers", "images"].iter().filter_map(|list| root.get(list)?.as_array());
    let uris = lists.flatten().filter_map(|entry| entry.get("uri")?.as_str()).filter(|uri| !uri.starts_with("data:"));
    uris.filter_map(|uri| Some(percent_encoding::percent_decode_str(uri).decode_utf8().ok()?.into_owned())).collect()
}

/// Loads what has been read from the file.
pub(crate) fn load_slice(source: Source, file: &[u8], variant: Option<&str>, budget: &mut Budget) -> Result<Scene, SceneError> {
    let mut warnings = Warnings::default();
    let Document { root, far, extras, binary } = document::parse(source, file, variant, budget, &mut warnings)?;
    node::check(source, &root, &mut warnings)?;
    let scene = choose_scene(source, &root, &mut warnings)?;
    let mut with_path = vec![false; root.nodes.len()];
    extras.nodes.iter().for_each(|(index, _)| with_path[*index] = true);
    let mut tree = node::walk(source, (&root, &far), scene, &with_path, budget, &mut warnings)?;
    let mut used: Vec<usize> = tree.meshes.iter().filter_map(|placed| root.nodes[placed.node].mesh).map(|mesh| mesh.value()).collect();
    used.sort_unstable();
    used.dedup();
    let nothing = |what: &str| {
        let (file, at, what) = (source.name(), format!("scenes[{scene}]"), what.to_string());
        SceneError::Empty { file, at, what, help: "export a file whose scene holds at least one mesh with triangles".to_string() }
    };
    if used.is_empty() {
        return Err(nothing(match tree.hidden {
            true => "every node with a mesh is hidden (KHR_node_visibility)",
            false => "no node of the scene has a mesh",
        }));
    }

    let bytes = read_buffers(source, &root, file, binary, budget)?;
    let mut buffers = Buffers { source, root: &root, far: &far, bytes, views: Vec::new(), accessors: BTreeMap::new() };
    buffers.views = meshopt::decode(&buffers, budget)?;
    buffers.accessors = draco::decode(&buffers, &draco::streams(&buffers, &used)?, budget)?;
    for index in 0..root.accessors.len() {
        buffers.accessor(index)?;
    }
    let mut placed = instance::expand(&buffers, std::mem::take(&mut tree.meshes), budget)?;
    let nodes: Vec<usize> = placed.iter().map(|placed| placed.node).collect();
    let worlds: Vec<node::Matrix> = placed.iter().map(|placed| placed.world_from_local).collect();
    let (mut shapes, shape_of) = pose::shapes(&buffers, &nodes, &worlds, &mut warnings)?;
    let mut joints = pose::joints(&buffers, &shapes, scene, budget)?;
    let origin = origin::of_nodes(&buffers, &placed, (&shapes, &shape_of), &joints);
    origin::move_nodes(origin, &mut placed, &mut shapes, &mut joints);
    node::move_cameras(&root, &mut tree, origin);
    let mut palette = Vec::with_capacity(root.materials.len());
    let mut wanted = texture::Wanted::default();
    let in_use = materials_in_use(&root, &used);
    for index in 0..root.materials.len() {
        palette.push(material::read(source, &root, index, in_use[index], &mut wanted, &mut warnings)?);
    }
    let mut palette = Palette::new(palette);
    let unskinned = Arc::new(Vec::new());
    let plan = |shape: &pose::Shape| {
        let joints = shape.skin.map_or(&unskinned, |skin| &joints[skin]);
        mesh::plan(&buffers, shape, joints, &mut palette, budget, &mut warnings)
    };
    let plans: Vec<Vec<Plan>> = shapes.iter().map(plan).collect::<Result<_, _>>()?;
    count_instances(source, &shape_of, &plans, budget)?;
    if plans.iter().all(Vec::is_empty) {
        return Err(nothing("its meshes have no triangles"));
    }

    let textures = texture::decode(&buffers, &wanted, budget, &mut warnings)?;
    let meshes: Vec<Option<Arc<Mesh>>> = (mesh::read(&buffers, &plans)?.into_iter())
        .map(|mesh| if mesh.primitives.is_empty() { None } else { Some(Arc::new(mesh)) })
        .collect();
    let mut objects = Vec::with_capacity(placed.len());
    for (placed, shape) in placed.into_iter().zip(shape_of) {
        if let Some(mesh) = meshes[shape].clone() {
            // Skinned vertices are in world space already.
            let world_from_local = if shapes[shape].skin.is_some() { node::IDENTITY } else { placed.world_from_local };
            objects.push(Object { name: placed.name, mesh, world_from_local });
        }
    }
    if count_degenerate(&objects, &mut warnings) == 0 {
        return Err(nothing("all of its triangles have zero area"));
    }
    Ok(Scene {
        objects,
        materials: palette.resolved.into_iter().map(|resolved| resolved.material).collect(),
        textures,
        tables: Vec::new(),
        cameras: tree.cameras,
        origin,
        extras: gather_extras(&root, extras, scene, &tree.paths),
        warnings: warnings.lines(),
    })
}

/// The default scene, else the first; a file without scenes shows nothing.
fn choose_scene(source: Source, root: &Root, warnings: &mut Warnings) -> Result<usize, SceneError> {
    let index = root.scene.map_or(0, |scene| scene.value());
    if index >= root.scenes.len() {
        let (file, at, what) = (source.name(), "scenes".to_string(), "the file has no scene".to_string());
        return Err(SceneError::Empty { file, at, what, help: "export it with a scene".to_string() });
    }
    let others = root.scenes.len() as u64 - 1;
    let first = if index == 0 { 1 } else { 0 };
    warnings.count("only the default scene is read, others are left out", others, || {
        label("scenes", first, root.scenes[first].name.as_deref())
    });
    Ok(index)
}

fn read_buffers<'a>(
    source: Source,
    root: &Root,
    file: &'a [u8],
    binary: Option<Range<usize>>,
    budget: &mut Budget,
) -> Result<Vec<Cow<'a, [u8]>>, SceneError> {
    let mut buffers = Vec::with_capacity(root.buffers.len());
    for (index, buffer) in root.buffers.iter().enumerate() {
        let at = label("buffers", index, buffer.name.as_deref());
        let length = buffer.byte_length.0;
        if meshopt::is_placeholder(root, index) {
            buffers.push(Cow::Borrowed(&[][..]));
            continue;
        }
        let bytes: Cow<[u8]> = match (&buffer.uri, &binary) {
            (Some(uri), _) => Cow::Owned(resource::read_uri(source, uri, &at, Some(length), budget)?),
            (None, Some(range)) if index == 0 => Cow::Borrowed(&file[range.clone()]),
            (None, _) => return Err(source.invalid(at, "a buffer without bytes: it has no uri, and the file has no binary part for it")),
        };
        if (bytes.len() as u64) < length {
            return Err(source.invalid(at, format!("it claims {length} bytes, there are {}", bytes.len())));
        }
        let length = length as usize;
        buffers.push(match bytes {
            Cow::Borrowed(bytes) => Cow::Borrowed(&bytes[..length]),
            Cow::Owned(mut bytes) => {
                bytes.truncate(length);
                Cow::Owned(bytes)
            }
        });
    }
    Ok(buffers)
}

fn materials_in_use(root: &Root, meshes: &[usize]) -> Vec<bool> {
    let mut in_use = vec![false; root.materials.len()];
    for material in meshes.iter().flat_map(|&mesh| &root.meshes[mesh].primitives).filter_map(|primitive| primitive.material) {
        in_use[material.value()] = true;
    }
    in_use
}

/// Counts the flattened scene: instances of one mesh each have their own triangles there.
fn count_instances(source: Source, shape_of: &[usize], plans: &[Vec<Plan>], budget: &mut Budget) -> Result<(), SceneError> {
    // Summed per mesh first: a million nodes times a million primitives must not be walked.
    let total = |plans: &Vec<Plan>| plans.iter().fold((0, 0), |(t, v), plan| (t + plan.triangles, v + plan.vertices));
    let totals: Vec<(u64, u64)> = plans.iter().map(total).collect();
    let mut size = WorldSize::default();
    for &shape in shape_of {
        size.add(totals[shape].0, totals[shape].1);
    }
    if size.triangles > u64::from(u32::MAX) {
        let what = format!("{} triangles with all instances, more than {}", size.triangles, u32::MAX);
        return Err(source.unsupported("nodes", what, "split the scene"));
    }
    budget.charge("nodes", &format!("{} triangles with all instances", size.triangles), size.bytes)
}

/// Counts triangles that no ray can hit, and returns how many can be hit.
fn count_degenerate(objects: &[Object], warnings: &mut Warnings) -> u64 {
    let counts: Vec<[u64; 3]> = (objects.par_iter())
        .map(|object| {
            let placement = Placement::new(object.world_from_local);
            let mut counts = [0; 3];
            for primitive in &object.mesh.primitives {
                let world: Vec<[f32; 3]> = primitive.positions.iter().map(|&p| placement.point(p)).collect();
                for corners in primitive.triangles.iter().map(|t| t.map(|v| world[v as usize])) {
                    let finite = corners.iter().flatten().all(|x| x.is_finite());
                    counts[if !finite { 1 } else { usize::from(has_area(&corners)) * 2 }] += 1;
                }
            }
            counts
        })
        .collect();
    for (object, [no_area, infinite, _]) in objects.iter().zip(&counts) {
        warnings.count("triangles with zero area are left out", *no_area, || object.name.clone());
        warnings.count("triangles beyond the range of numbers are left out", *infinite, || object.name.clone());
    }
    counts.iter().map(|[_, _, good]| good).sum()
}

/// `{"asset": …, "scene": …, "nodes": {path: …}, "materials": [{"index", "name", "extras"}]}`; empty parts are left out.
fn gather_extras(root: &Root, extras: Extras, scene: usize, paths: &[(usize, String)]) -> Value {
    let mut all = Map::new();
    if let Some(asset) = extras.asset {
        all.insert("asset".into(), asset);
    }
    if let Some((_, value)) = extras.scenes.into_iter().find(|(index, _)| *index == scene) {
        all.insert("scene".into(), value);
    }
    let mut by_node: std::collections::HashMap<usize, Value> = extras.nodes.into_iter().collect();
    let nodes: Map<String, Value> = paths.iter().filter_map(|(node, path)| Some((path.clone(), by_node.remove(node)?))).collect();
    if !nodes.is_empty() {
        all.insert("nodes".into(), Value::Object(nodes));
    }
    let material = |(index, extras): (usize, Value)| json!({ "index": index, "name": root.materials[index].name, "extras": extras });
    let materials: Vec<Value> = extras.materials.into_iter().map(material).collect();
    if !materials.is_empty() {
        all.insert("materials".into(), Value::Array(materials));
    }
    if all.is_empty() { Value::Null } else { Value::Object(all) }
}

//! Primitives: first planned (every size known and counted), then read on all threads.

use super::accessor::{Buffers, View};
use super::error::{Budget, SceneError};
use super::material::{Resolved, Slot};
use super::node::Matrix;
use super::pose::{self, Pose, Shape, Target};
use super::warnings::{Warnings, label};
use super::world::Placement;
use super::{Mesh, Primitive, tangent};
use gltf::json::mesh::{Mode, Semantic};
use gltf::json::validation::Checked;
use prelight_runtime::surface::TextureRef;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;

/// JOINTS_n and WEIGHTS_n that are read, four joints each.
const MOST_INFLUENCE_SETS: u32 = 4;

/// What one primitive will become.
pub(crate) struct Plan {
    mode: Mode,
    positions: usize,
    normals: Option<usize>,
    tangents: Option<usize>,
    colors: Option<usize>,
    uvs: [Option<(usize, Slot)>; 2],
    indices: Option<usize>,
    material: u32,
    pose: Pose,
    /// Set of texture coordinates for which tangents have to be made, and the texture along which.
    make_tangents: Option<(usize, Option<TextureRef>)>,
    /// Upper bounds, for the count of a flattened scene.
    pub triangles: u64,
    pub vertices: u64,
}

/// Materials of the scene while they grow: the file's, then glTF's default, then variants without some textures.
pub(crate) struct Palette {
    pub resolved: Vec<Resolved>,
    default: Option<u32>,
    /// (material, which sets of texture coordinates are missing, whether there are tangents) -> variant.
    bare: BTreeMap<(u32, [bool; 2], bool), u32>,
}

impl Palette {
    pub fn new(resolved: Vec<Resolved>) -> Self {
        Palette { resolved, default: None, bare: BTreeMap::new() }
    }

    fn default_material(&mut self) -> u32 {
        *self.default.get_or_insert_with(|| {
            self.resolved.push(Resolved::default());
            self.resolved.len() as u32 - 1
        })
    }

    /// The same material without what a surface cannot have: the number of textures that read missing coordinates, and whether
    /// anisotropy is lost because neither tangents nor coordinates give it a direction.
    fn without(&mut self, material: u32, missing: [bool; 2], has_tangents: bool) -> (u32, u64, bool) {
        let mut bare = self.resolved[material as usize].clone();
        let mut dropped = 0;
        let directed = has_tangents || bare.material.tangent_uv_set().is_none_or(|set| !missing[set as usize]);
        let undirected = bare.material.anisotropy > 0.0 && !directed;
        if undirected {
            bare.material.anisotropy = 0.0;
        }
        for texture in bare.material.texture_slots() {
            if texture.is_some_and(|t: TextureRef| missing[t.uv_set as usize]) {
                *texture = None;
                dropped += 1;
            }
        }
        if dropped == 0 && !undirected {
            return (material, 0, false);
        }
        let resolved = &mut self.resolved;
        let index = *self.bare.entry((material, missing, has_tangents)).or_insert_with(|| {
            resolved.push(bare);
            resolved.len() as u32 - 1
        });
        (index, dropped, undirected)
    }
}

/// Plans all primitives of one shape; those without triangles are left out and counted. `joints` are the matrices of its skin.
pub(crate) fn plan(
    buffers: &Buffers,
    shape: &Shape,
    joints: &Arc<Vec<Matrix>>,
    palette: &mut Palette,
    budget: &mut Budget,
    warnings: &mut Warnings,
) -> Result<Vec<Plan>, SceneError> {
    let mesh = shape.mesh;
    let json = &buffers.root.meshes[mesh];
    let name = label("meshes", mesh, json.name.as_deref());
    let mut plans = Vec::new();
    for (p, primitive) in json.primitives.iter().enumerate() {
        let at = || format!("{name}.primitives[{p}]");
        let mode = match primitive.mode {
            Checked::Valid(mode @ (Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan)) => mode,
            _ => {
                warnings.note("points and lines are not read", at);
                continue;
            }
        };
        let attribute = |semantic: Semantic| primitive.attributes.get(&Checked::Valid(semantic)).map(|index| index.value());
        let Some(positions) = attribute(Semantic::Positions) else {
            warnings.note("primitives without POSITION are not drawn", at);
            continue;
        };
        let view = buffers.accessor(positions)?;
        let count = view.count as u64;
        let matching = |index: Option<usize>| -> Result<Option<usize>, SceneError> {
            let Some(index) = index else { return Ok(None) };
            let view = buffers.accessor(index)?;
            if view.count as u64 == count {
                return Ok(Some(index));
            }
            Err(buffers.source.invalid(view.at(), format!("{} elements beside {count} positions ({})", view.count, at())))
        };
        let corners = match primitive.indices {
            Some(index) => buffers.accessor(index.value())?.count as u64,
            None => count,
        };
        let (triangles, left_over) = match mode {
            Mode::Triangles => (corners / 3, corners % 3),
            _ => (corners.saturating_sub(2), 0),
        };
        warnings.count("corners beyond a multiple of three are left out", left_over, at);
        if triangles == 0 || count == 0 {
            warnings.note("primitives without triangles", at);
            continue;
        }
        let mut pose = Pose::default();
        for (target, &weight) in primitive.targets.iter().flatten().zip(&shape.weights).filter(|(_, weight)| **weight != 0.0) {
            let index = |index: Option<gltf::json::Index<gltf::json::Accessor>>| matching(index.map(|index| index.value()));
            let (positions, normals, tangents) = (index(target.positions)?, index(target.normals)?, index(target.tangents)?);
            pose.targets.push(Target { weight, positions, normals, tangents });
        }
        if shape.skin.is_some() {
            for set in 0..MOST_INFLUENCE_SETS {
                let (of, by) = (matching(attribute(Semantic::Joints(set)))?, matching(attribute(Semantic::Weights(set)))?);
                let (Some(of), Some(by)) = (of, by) else { break };
                pose.influences.push((of, by));
            }
            pose.rigid = pose.influences.is_empty();
            pose.joints = if let (true, Some(rest)) = (pose.rigid, shape.rest) { Arc::new(vec![rest]) } else { joints.clone() };
        }

        let mut material = match primitive.material {
            Some(material) => material.value() as u32,
            None => palette.default_material(),
        };
        let slots = palette.resolved[material as usize].slots;
        let mut uvs = [None; 2];
        for (uv, slot) in uvs.iter_mut().zip(slots) {
            *uv = matching(attribute(Semantic::TexCoords(slot.set)))?.map(|index| (index, slot));
        }
        let normals = matching(attribute(Semantic::Normals))?;
        let tangents = matching(attribute(Semantic::Tangents))?.filter(|_| normals.is_some());
        let (bare, dropped, undirected) = palette.without(material, [uvs[0].is_none(), uvs[1].is_none()], tangents.is_some());
        warnings.count("textures on surfaces without texture coordinates are left out", dropped, at);
        warnings.count("anisotropy without tangents and texture coordinates is left out", u64::from(undirected), at);
        material = bare;

        let colors = matching(attribute(Semantic::Colors(0)))?;
        let surface = &palette.resolved[material as usize].material;
        let make_tangents = surface.tangent_uv_set().filter(|_| tangents.is_none()).map(|set| (set as usize, surface.tangent_texture()));
        // Making tangents may split vertices, at most into one a corner.
        let vertices = if make_tangents.is_some() { count.max(3 * triangles) } else { count };
        let with_normals = normals.is_some() || make_tangents.is_some();
        let per_vertex = 12
            + if with_normals { 12 } else { 0 }
            + if tangents.is_some() || make_tangents.is_some() { 16 } else { 0 }
            + if colors.is_some() { 16 } else { 0 }
            + 8 * uvs.iter().flatten().count() as u64;
        // Indices are held twice while they are put together; tangents are summed in f64.
        let morphing = if pose.targets.is_empty() { 0 } else { 48 * count };
        let skinning = if pose.influences.is_empty() && !pose.rigid { 0 } else { (32 + 128 + size_of::<Placement>() as u64) * count };
        let scratch = morphing + skinning + if make_tangents.is_some() { 48 * vertices } else { 0 };
        let bytes = vertices * per_vertex + 12 * triangles + 4 * corners + scratch;
        budget.charge(at(), &format!("{count} vertices and {triangles} triangles"), bytes)?;
        let indices = primitive.indices.map(|index| index.value());
        plans.push(Plan { mode, positions, normals, tangents, colors, uvs, indices, material, pose, make_tangents, triangles, vertices });
    }
    Ok(plans)
}

/// Reads all planned meshes on all threads; the error is that of the first broken primitive, whatever the threads did.
pub(crate) fn read(buffers: &Buffers, plans: &[Vec<Plan>]) -> Result<Vec<Mesh>, SceneError> {
    let results: Vec<Result<Mesh, SceneError>> = (plans.par_iter())
        .map(|plans| {
            let primitives: Vec<Result<Primitive, SceneError>> = plans.par_iter().map(|plan| primitive(buffers, plan)).collect();
            Ok(Mesh { primitives: primitives.into_iter().collect::<Result<_, _>>()? })
        })
        .collect();
    results.into_iter().collect()
}

fn primitive(buffers: &Buffers, plan: &Plan) -> Result<Primitive, SceneError> {
    let positions = buffers.accessor(plan.positions)?.floats::<3>(false)?;
    let triangles = triangles(buffers, plan, positions.len())?;
    let normals = plan.normals.map(|index| buffers.accessor(index)?.floats::<3>(false)).transpose()?;
    let tangents = plan.tangents.map(|index| buffers.accessor(index)?.floats::<4>(false)).transpose()?;
    let tangents = tangents.map(|list| list.into_iter().map(|[x, y, z, w]| [x, y, z, 1.0f32.copysign(w)]).collect());
    let colors = plan.colors.map(|index| colors(&buffers.accessor(index)?)).transpose()?;
    let uv = |k: usize| -> Result<Option<Vec<[f32; 2]>>, SceneError> {
        let Some((index, slot)) = plan.uvs[k] else { return Ok(None) };
        Ok(Some(buffers.accessor(index)?.floats::<2>(false)?.into_iter().map(|uv| slot.apply(uv)).collect()))
    };
    let uvs = [uv(0)?, uv(1)?];
    let mut primitive = Primitive { positions, normals, tangents, uvs, colors, triangles, material: plan.material };
    pose::apply(buffers, &plan.pose, &mut primitive)?;
    if let Some((set, texture)) = plan.make_tangents {
        tangent::make(&mut primitive, set, texture);
    }
    Ok(primitive)
}

fn triangles(buffers: &Buffers, plan: &Plan, vertices: usize) -> Result<Vec<[u32; 3]>, SceneError> {
    let corners: Vec<u32> = match plan.indices {
        None => (0..vertices as u32).collect(),
        Some(index) => {
            let view = buffers.accessor(index)?;
            let corners = view.indices()?;
            if let Some(at) = corners.iter().position(|&vertex| vertex as usize >= vertices) {
                let what = format!("element {at} is vertex {}, but there are {vertices}", corners[at]);
                return Err(buffers.source.invalid(view.at(), what));
            }
            corners
        }
    };
    Ok(match plan.mode {
        Mode::Triangles => corners.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
        // Every second triangle of a strip is turned, so that all keep the winding of the first.
        Mode::TriangleStrip => {
            let turned = |(i, w): (usize, &[u32])| if i % 2 == 0 { [w[0], w[1], w[2]] } else { [w[0], w[2], w[1]] };
            corners.windows(3).enumerate().map(turned).collect()
        }
        _ => corners[1..].windows(2).map(|w| [w[0], w[1], corners[0]]).collect(),
    })
}

/// RGB or RGBA, floats or fractions.
fn colors(view: &View) -> Result<Vec<[f32; 4]>, SceneError> {
    if view.lanes == 3 {
        return Ok(view.floats::<3>(true)?.into_iter().map(|[r, g, b]| [r, g, b, 1.0]).collect());
    }
    view.floats::<4>(true)
}

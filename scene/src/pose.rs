//! Morph targets at their given weights, skins in the pose of their nodes.
//!
//! ```text
//! morph  p' = p + Σ_k w_k·Δp_k, the same for normals (made unit again) and tangents; w from the node, else from the mesh
//! skin   M  = Σ_j w_j·G_j·B_j / Σ_j w_j,  p' = M·p',  G_j the world transform of joint j as its node stands, B_j its inverse bind matrix
//! ```
//!
//! A skinned mesh ignores the transform of its own node, as glTF says: its vertices end in world space. Sums run in f64 in a fixed
//! order and are rounded once. A vertex without weights follows the first joint. Where M mirrors, triangles turn.

use super::Primitive;
use super::accessor::Buffers;
use super::error::{Budget, SceneError};
use super::node::{self, Matrix};
use super::warnings::{Warnings, label};
use super::world::Placement;
use gltf::json::mesh::Semantic;
use gltf::json::validation::Checked;
use std::collections::BTreeMap;
use std::sync::Arc;

/// A mesh as one node shows it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Shape {
    pub mesh: usize,
    /// Weights of the morph targets; empty where none moves anything.
    pub weights: Vec<f32>,
    /// Index of the skin.
    pub skin: Option<usize>,
    /// Where the node stands, for parts of a skinned mesh that no joint moves.
    pub rest: Option<Matrix>,
}

/// How many of a mesh's primitives name joints and weights, of how many.
fn influenced(root: &gltf::json::Root, mesh: usize) -> (usize, usize) {
    let has = |primitive: &gltf::json::mesh::Primitive, semantic: Semantic| primitive.attributes.contains_key(&Checked::Valid(semantic));
    let primitives = &root.meshes[mesh].primitives;
    let skinned = primitives.iter().filter(|p| has(p, Semantic::Joints(0)) && has(p, Semantic::Weights(0))).count();
    (skinned, primitives.len())
}

/// The shapes of the scene's nodes, each once, in the order of mesh, weights and skin, and the shape of each node asked for.
///
/// A skin on a primitive without joints and weights does not move it: it stays where its node is. `worlds` are those of `nodes`.
pub(crate) fn shapes(
    buffers: &Buffers,
    nodes: &[usize],
    worlds: &[Matrix],
    warnings: &mut Warnings,
) -> Result<(Vec<Shape>, Vec<usize>), SceneError> {
    let root = buffers.root;
    // Shapes with parts that stay with their node are each node's own.
    type Key = (usize, Vec<u32>, Option<usize>, Option<usize>);
    let mut known: BTreeMap<Key, Vec<usize>> = BTreeMap::new();
    for (k, &index) in nodes.iter().enumerate() {
        let node = &root.nodes[index];
        let mesh = node.mesh.map_or(0, |mesh| mesh.value());
        let weights = node.weights.as_ref().or(root.meshes[mesh].weights.as_ref());
        let mut weights = weights.cloned().unwrap_or_default();
        if let Some(bad) = weights.iter().find(|w| !w.is_finite()) {
            return Err(buffers.source.invalid(format!("nodes[{index}].weights"), format!("{bad} is not a finite number")));
        }
        let targets = root.meshes[mesh].primitives.iter().map(|p| p.targets.as_ref().map_or(0, Vec::len)).max().unwrap_or(0);
        weights.truncate(targets);
        if weights.iter().all(|&w| w == 0.0) {
            weights.clear();
        }
        let (skinned, all) = influenced(root, mesh);
        if node.skin.is_some() && skinned < all {
            let at = || label("meshes", mesh, root.meshes[mesh].name.as_deref());
            warnings.note("a skin on primitives without JOINTS_0 and WEIGHTS_0: they stay with their node", at);
        }
        let skin = node.skin.map(|skin| skin.value()).filter(|_| skinned > 0);
        let own = (skin.is_some() && skinned < all).then_some(k);
        let key = (mesh, weights.iter().map(|w| w.to_bits()).collect(), skin, own);
        known.entry(key).or_default().push(k);
    }
    let mut of_node = vec![0; nodes.len()];
    let mut shapes = Vec::with_capacity(known.len());
    for ((mesh, weights, skin, own), users) in known {
        let rest = own.map(|k| worlds[k]);
        users.into_iter().for_each(|k| of_node[k] = shapes.len());
        shapes.push(Shape { mesh, weights: weights.into_iter().map(f32::from_bits).collect(), skin, rest });
    }
    Ok((shapes, of_node))
}

/// Joint matrices G·B of every skin in use. `[skins]`, empty for the others.
pub(crate) fn joints(buffers: &Buffers, shapes: &[Shape], scene: usize, budget: &mut Budget) -> Result<Vec<Arc<Vec<Matrix>>>, SceneError> {
    let root = buffers.root;
    let mut joints: Vec<Arc<Vec<Matrix>>> = root.skins.iter().map(|_| Arc::default()).collect();
    if shapes.iter().all(|shape| shape.skin.is_none()) {
        return Ok(joints);
    }
    budget.charge("nodes", "their world transforms", (root.nodes.len() * (size_of::<Matrix>() + 8)) as u64)?;
    let worlds = node::worlds(buffers.source, (root, buffers.far), scene)?;
    for (index, skin) in root.skins.iter().enumerate() {
        if !shapes.iter().any(|shape| shape.skin == Some(index)) {
            continue;
        }
        let at = format!("skins[{index}]");
        budget.charge(at.clone(), "its joints", (skin.joints.len() * 2 * size_of::<Matrix>()) as u64)?;
        let inverse = match skin.inverse_bind_matrices {
            None => None,
            Some(accessor) => {
                let view = buffers.accessor(accessor.value())?;
                if view.count < skin.joints.len() {
                    let what = format!("{} inverse bind matrices for {} joints", view.count, skin.joints.len());
                    return Err(buffers.source.invalid(at, what));
                }
                budget.charge(at.clone(), "its matrices", 64 * view.count as u64)?;
                Some(view.floats::<16>(false)?)
            }
        };
        let matrix = |(k, joint): (usize, &gltf::json::Index<gltf::json::Node>)| match &inverse {
            None => worlds[joint.value()],
            Some(inverse) => node::multiply(&worlds[joint.value()], &inverse[k].map(f64::from)),
        };
        joints[index] = Arc::new(skin.joints.iter().enumerate().map(matrix).collect());
    }
    Ok(joints)
}

/// One morph target with its weight; accessors of displacements.
pub(crate) struct Target {
    pub weight: f32,
    pub positions: Option<usize>,
    pub normals: Option<usize>,
    pub tangents: Option<usize>,
}

/// What moves the vertices of one primitive.
#[derive(Default)]
pub(crate) struct Pose {
    pub targets: Vec<Target>,
    /// Accessors of joints and weights, four of each a vertex.
    pub influences: Vec<(usize, usize)>,
    pub joints: Arc<Vec<Matrix>>,
    /// A skin is there and moves nothing: all vertices follow the first of `joints`.
    pub rigid: bool,
}

/// Moves the vertices.
pub(crate) fn apply(buffers: &Buffers, pose: &Pose, primitive: &mut Primitive) -> Result<(), SceneError> {
    if !pose.targets.is_empty() {
        morph(buffers, pose, primitive)?;
    }
    if !pose.influences.is_empty() || pose.rigid {
        skin(buffers, pose, primitive)?;
    }
    Ok(())
}

fn morph(buffers: &Buffers, pose: &Pose, primitive: &mut Primitive) -> Result<(), SceneError> {
    let moved = |list: &[[f32; 3]], pick: fn(&Target) -> Option<usize>| -> Result<Option<Vec<[f32; 3]>>, SceneError> {
        if pose.targets.iter().all(|target| pick(target).is_none()) {
            return Ok(None);
        }
        let mut sums: Vec<[f64; 3]> = list.iter().map(|v| v.map(f64::from)).collect();
        for target in &pose.targets {
            let Some(accessor) = pick(target) else { continue };
            for (sum, delta) in sums.iter_mut().zip(buffers.accessor(accessor)?.floats::<3>(false)?) {
                (0..3).for_each(|k| sum[k] += f64::from(target.weight) * f64::from(delta[k]));
            }
        }
        Ok(Some(sums.into_iter().map(|v| v.map(|x| x as f32)).collect()))
    };
    if let Some(positions) = moved(&primitive.positions, |t| t.positions)? {
        if let Some(vertex) = positions.iter().position(|p| p.iter().any(|x| !x.is_finite())) {
            let what = format!("vertex {vertex} is moved beyond the range of numbers");
            return Err(buffers.source.invalid("morph targets", what));
        }
        primitive.positions = positions;
    }
    let unit = |v: [f32; 3]| glam::DVec3::from(v.map(f64::from)).normalize_or_zero().as_vec3().to_array();
    if let Some(normals) = primitive.normals.as_ref().map(|list| moved(list, |t| t.normals)).transpose()?.flatten() {
        primitive.normals = Some(normals.into_iter().map(unit).collect());
    }
    if let Some(tangents) = &mut primitive.tangents {
        let list: Vec<[f32; 3]> = tangents.iter().map(|t| [t[0], t[1], t[2]]).collect();
        if let Some(list) = moved(&list, |t| t.tangents)? {
            for (tangent, moved) in tangents.iter_mut().zip(list) {
                let [x, y, z] = unit(moved);
                *tangent = [x, y, z, tangent[3]];
            }
        }
    }
    Ok(())
}

fn skin(buffers: &Buffers, pose: &Pose, primitive: &mut Primitive) -> Result<(), SceneError> {
    let n_vertices = primitive.positions.len();
    let mut sums: Vec<Matrix> = vec![[0.0; 16]; n_vertices];
    for &(joints, weights) in &pose.influences {
        let at = buffers.accessor(joints)?.at();
        let joints = buffers.accessor(joints)?.floats::<4>(false)?;
        let weights = buffers.accessor(weights)?.floats::<4>(true)?;
        for (v, (sum, (joints, weights))) in sums.iter_mut().zip(joints.iter().zip(&weights)).enumerate() {
            for (joint, &weight) in joints.iter().zip(weights).filter(|(_, weight)| **weight > 0.0) {
                let Some(matrix) = pose.joints.get(*joint as usize) else {
                    let what = format!("vertex {v} follows joint {joint}, but there are {}", pose.joints.len());
                    return Err(buffers.source.invalid(at, what));
                };
                (0..15).for_each(|k| sum[k] += f64::from(weight) * matrix[k]);
                // The corner that is always 1 counts the weights.
                sum[15] += f64::from(weight);
            }
        }
    }
    let rest = pose.joints.first().copied().ok_or_else(|| buffers.source.invalid("skins", "a skin without joints"))?;
    let placements: Vec<Placement> = (sums.iter())
        .map(|sum| {
            let matrix = if sum[15] > 0.0 { sum.map(|x| x / sum[15]) } else { rest };
            Placement::new(matrix)
        })
        .collect();
    for (v, (position, placement)) in primitive.positions.iter_mut().zip(&placements).enumerate() {
        *position = placement.point(*position);
        if position.iter().any(|x| !x.is_finite()) {
            return Err(buffers.source.invalid("skins", format!("vertex {v} is moved beyond the range of numbers")));
        }
    }
    for (normal, placement) in primitive.normals.iter_mut().flatten().zip(&placements) {
        *normal = placement.normal(*normal);
    }
    for (tangent, placement) in primitive.tangents.iter_mut().flatten().zip(&placements) {
        *tangent = placement.tangent(*tangent);
    }
    for t in &mut primitive.triangles {
        if t.iter().filter(|&&v| placements[v as usize].mirrored).count() >= 2 {
            t.swap(1, 2);
        }
    }
    Ok(())
}

//! EXT_mesh_gpu_instancing: a node that stands for many.
//!
//! Instance i of a node has the transform node · T_i·R_i·S_i, each from an accessor with one element an instance; absent ones are the
//! identity. The first keeps the node's name, the others are `name#2`, `name#3`, as repeated nodes are.

use super::accessor::Buffers;
use super::error::{Budget, SceneError};
use super::node::{self, Placed, Unique};
use gltf::json::Node;
use serde_json::Value;

/// Name of the extension.
pub(crate) const NAME: &str = "EXT_mesh_gpu_instancing";

fn extension(node: &Node) -> Option<&Value> {
    node.extensions.as_ref()?.others.get(NAME)
}

/// Puts the instances of such nodes in the place of the nodes. Skinned nodes stand where their joints stand, once.
pub(crate) fn expand(buffers: &Buffers, placed: Vec<Placed>, budget: &mut Budget) -> Result<Vec<Placed>, SceneError> {
    let nodes = &buffers.root.nodes;
    let is_many = |placed: &Placed| extension(&nodes[placed.node]).is_some() && nodes[placed.node].skin.is_none();
    if !placed.iter().any(is_many) {
        return Ok(placed);
    }
    let mut unique = Unique::default();
    placed.iter().for_each(|placed| drop(unique.take(&placed.name)));
    let mut out = Vec::with_capacity(placed.len());
    for parent in placed {
        if !is_many(&parent) {
            out.push(parent);
            continue;
        }
        for (i, local) in transforms(buffers, &parent, budget)?.iter().enumerate() {
            let name = if i == 0 { parent.name.clone() } else { unique.take(&parent.name) };
            out.push(Placed { node: parent.node, name, world_from_local: node::multiply(&parent.world_from_local, local) });
        }
    }
    Ok(out)
}

fn transforms(buffers: &Buffers, placed: &Placed, budget: &mut Budget) -> Result<Vec<node::Matrix>, SceneError> {
    let at = format!("nodes[{}].extensions.{NAME}", placed.node);
    let invalid = |what: String| buffers.source.invalid(at.clone(), what);
    let attributes = extension(&buffers.root.nodes[placed.node]).and_then(|e| e.get("attributes"));
    let accessor = |name: &str| -> Result<Option<usize>, SceneError> {
        match attributes.and_then(|a| a.get(name)) {
            None => Ok(None),
            Some(index) => index.as_u64().map(|i| Some(i as usize)).ok_or_else(|| invalid(format!("{name} is not an accessor"))),
        }
    };
    let [t, r, s] = [accessor("TRANSLATION")?, accessor("ROTATION")?, accessor("SCALE")?];
    let Some(first) = t.or(r).or(s) else { return Err(invalid("neither TRANSLATION, ROTATION nor SCALE".into())) };
    let count = buffers.accessor(first)?.count;
    for other in [t, r, s].into_iter().flatten() {
        let n = buffers.accessor(other)?.count;
        if n != count {
            return Err(invalid(format!("accessors[{other}] has {n} elements, accessors[{first}] {count}")));
        }
    }
    // A matrix in the list, a place, and two copies of a name that grows by its number; then the three lists of floats.
    let each = size_of::<node::Matrix>() + size_of::<Placed>() + 4 * (placed.name.len() + 12) + 40;
    budget.charge(at.clone(), &format!("{count} instances"), count as u64 * each as u64)?;
    let t = t.map(|i| buffers.accessor(i)?.floats::<3>(false)).transpose()?;
    let r = r.map(|i| buffers.accessor(i)?.floats::<4>(false)).transpose()?;
    let s = s.map(|i| buffers.accessor(i)?.floats::<3>(false)).transpose()?;
    (0..count)
        .map(|i| {
            let t = t.as_ref().map_or([0.0; 3], |t| t[i]);
            let r = r.as_ref().map_or([0.0, 0.0, 0.0, 1.0], |r| r[i]);
            let s = s.as_ref().map_or([1.0; 3], |s| s[i]);
            node::compose(t, r, s).ok_or_else(|| invalid(format!("instance {i} has a rotation of length 0")))
        })
        .collect()
}

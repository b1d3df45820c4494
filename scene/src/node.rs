//! The node tree: checked to be a tree, walked without recursion, transforms composed in f64.
//!
//! Local transform: the matrix as given, or T·R·S with R from the normalised quaternion by arithmetic alone:
//! R = 1 + s·(…), s = 2/|q|². World = parent·local, each entry ((a·b + c·d) + e·f) + g in this order. No function of the standard
//! library whose bits differ between CPUs takes part.

use super::error::{Budget, SceneError, Source};
use super::warnings::{Warnings, label};
use gltf::json::camera::Type as CameraType;
use gltf::json::validation::Checked;
use gltf::json::{Node, Root};
use prelight_runtime::draw::camera::{Camera, SceneCamera};
use std::collections::{HashMap, HashSet};

/// Column-major affine matrix.
pub(crate) type Matrix = [f64; 16];

pub(crate) const IDENTITY: Matrix = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];

/// A node of the scene that has something to show.
pub(crate) struct Placed {
    pub node: usize,
    /// Path of names, unique in the scene.
    pub name: String,
    pub world_from_local: Matrix,
}

/// What a walk finds.
#[derive(Default)]
pub(crate) struct Tree {
    /// Nodes with a mesh, in depth-first order.
    pub meshes: Vec<Placed>,
    pub cameras: Vec<SceneCamera>,
    /// Paths of the nodes asked for.
    pub paths: Vec<(usize, String)>,
}

/// Every node has at most one parent and none is its own ancestor.
pub(crate) fn check(source: Source, root: &Root) -> Result<(), SceneError> {
    let nodes = &root.nodes;
    let mut parent: Vec<Option<usize>> = vec![None; nodes.len()];
    for (index, node) in nodes.iter().enumerate() {
        for child in node.children.iter().flatten() {
            let child = child.value();
            match parent[child] {
                None => parent[child] = Some(index),
                Some(other) => {
                    let at = label("nodes", child, nodes[child].name.as_deref());
                    return Err(source.invalid(at, format!("a node with two parents, nodes[{other}] and nodes[{index}]")));
                }
            }
        }
    }
    // With one parent each, what cannot be reached from a node without parents lies on or under a cycle.
    let mut reached = 0;
    let mut stack: Vec<usize> = (0..nodes.len()).filter(|&node| parent[node].is_none()).collect();
    let mut seen = vec![false; nodes.len()];
    while let Some(node) = stack.pop() {
        reached += 1;
        seen[node] = true;
        stack.extend(nodes[node].children.iter().flatten().map(|child| child.value()));
    }
    if reached < nodes.len() {
        let node = seen.iter().position(|seen| !seen).expect("some node was not reached");
        return Err(source.invalid(label("nodes", node, nodes[node].name.as_deref()), "a node is its own ancestor"));
    }
    for (s, scene) in root.scenes.iter().enumerate() {
        let mut listed = HashSet::new();
        for node in &scene.nodes {
            let node = node.value();
            if parent[node].is_some() || !listed.insert(node) {
                let at = format!("scenes[{s}].nodes");
                return Err(source.invalid(at, format!("nodes[{node}] is listed twice, or is the child of another node")));
            }
        }
    }
    Ok(())
}

/// Walks one scene. `with_path[node]` asks for the path of a node that has no mesh.
pub(crate) fn walk(
    source: Source,
    root: &Root,
    scene: usize,
    with_path: &[bool],
    budget: &mut Budget,
    warnings: &mut Warnings,
) -> Result<Tree, SceneError> {
    struct Step {
        node: usize,
        name: String,
        prefix: usize,
        parent: Matrix,
    }
    let mut tree = Tree::default();
    let mut stack: Vec<Step> = Vec::new();
    let roots: Vec<usize> = root.scenes[scene].nodes.iter().map(|n| n.value()).collect();
    stack.extend(named(root, &roots).into_iter().rev().map(|(node, name)| Step { node, name, prefix: 0, parent: IDENTITY }));
    let mut path = String::new();
    let mut unique = Unique::default();
    while let Some(Step { node: index, name, prefix, parent }) = stack.pop() {
        let node = &root.nodes[index];
        path.truncate(prefix);
        if prefix > 0 {
            path.push('/');
        }
        path.push_str(&name);
        let world = multiply(&parent, &local(source, index, node)?);
        if node.mesh.is_some() || with_path[index] {
            budget.charge(label("nodes", index, node.name.as_deref()), "the path of its name", 2 * path.len() as u64)?;
            let name = unique.take(&path);
            if with_path[index] {
                tree.paths.push((index, name.clone()));
            }
            if node.mesh.is_some() {
                tree.meshes.push(Placed { node: index, name, world_from_local: world });
            }
        }
        if let Some(camera) = node.camera {
            let at = || label("nodes", index, node.name.as_deref());
            match perspective(root, camera.value(), &world) {
                Ok(camera_) => {
                    let own = root.cameras[camera.value()].name.as_deref().filter(|name| !name.is_empty());
                    let name = node.name.as_deref().filter(|name| !name.is_empty()).or(own).unwrap_or(&name).to_string();
                    tree.cameras.push(SceneCamera { name, camera: camera_ });
                }
                Err(why) => warnings.note(why, at),
            }
        }
        let children: Vec<usize> = node.children.iter().flatten().map(|child| child.value()).collect();
        let prefix = path.len();
        stack.extend(named(root, &children).into_iter().rev().map(|(node, name)| Step { node, name, prefix, parent: world }));
    }
    let mut names = Unique::default();
    for camera in &mut tree.cameras {
        camera.name = names.take(&camera.name);
    }
    Ok(tree)
}

/// World transforms of all nodes, by index, in whatever scene they are. The nodes must be a forest ([`check`]).
pub(crate) fn worlds(source: Source, root: &Root) -> Result<Vec<Matrix>, SceneError> {
    let mut worlds = vec![IDENTITY; root.nodes.len()];
    let mut has_parent = vec![false; root.nodes.len()];
    root.nodes.iter().flat_map(|node| node.children.iter().flatten()).for_each(|child| has_parent[child.value()] = true);
    let mut stack: Vec<usize> = (0..root.nodes.len()).filter(|&node| !has_parent[node]).collect();
    for &node in &stack {
        worlds[node] = local(source, node, &root.nodes[node])?;
    }
    while let Some(parent) = stack.pop() {
        for child in root.nodes[parent].children.iter().flatten().map(|child| child.value()) {
            worlds[child] = multiply(&worlds[parent], &local(source, child, &root.nodes[child])?);
            stack.push(child);
        }
    }
    Ok(worlds)
}

/// Names that have been given out.
#[derive(Default)]
pub(crate) struct Unique {
    taken: HashSet<String>,
    /// The next number to try for a name, so that many equal names stay linear.
    next: HashMap<String, u64>,
}

impl Unique {
    /// The name itself the first time, then `name#2`, `name#3`.
    pub fn take(&mut self, name: &str) -> String {
        let mut result = name.to_string();
        while self.taken.contains(&result) {
            let n = self.next.entry(name.to_string()).or_insert(2);
            result = format!("{name}#{n}");
            *n += 1;
        }
        self.taken.insert(result.clone());
        result
    }
}

/// Siblings with names that differ from each other; a node without a name is called by its index.
fn named(root: &Root, siblings: &[usize]) -> Vec<(usize, String)> {
    let mut unique = Unique::default();
    let name = |node: usize| match root.nodes[node].name.as_deref() {
        Some(name) if !name.is_empty() => name.to_string(),
        _ => format!("node_{node}"),
    };
    siblings.iter().map(|&node| (node, unique.take(&name(node)))).collect()
}

fn local(source: Source, index: usize, node: &Node) -> Result<Matrix, SceneError> {
    let at = || label("nodes", index, node.name.as_deref());
    if let Some(matrix) = node.matrix {
        if !matrix.iter().all(|x| x.is_finite()) {
            return Err(source.invalid(at(), "a matrix with a number that is not finite"));
        }
        if [matrix[3], matrix[7], matrix[11], matrix[15]] != [0.0, 0.0, 0.0, 1.0] {
            return Err(source.invalid(at(), "a matrix that is not affine: its last row must be 0 0 0 1"));
        }
        return Ok(matrix.map(f64::from));
    }
    let t = node.translation.unwrap_or([0.0; 3]);
    let s = node.scale.unwrap_or([1.0; 3]);
    let q = node.rotation.unwrap_or_default().0;
    if !t.iter().chain(&s).chain(&q).all(|x| x.is_finite()) {
        return Err(source.invalid(at(), "a translation, rotation or scale that is not finite"));
    }
    compose(t, q, s).ok_or_else(|| source.invalid(at(), "a rotation of length 0"))
}

/// T·R·S; `None` for a quaternion of length 0.
pub(crate) fn compose(t: [f32; 3], q: [f32; 4], s: [f32; 3]) -> Option<Matrix> {
    let (t, s) = (t.map(f64::from), s.map(f64::from));
    let [x, y, z, w] = q.map(f64::from);
    let length = (x * x + y * y) + (z * z + w * w);
    if length <= 0.0 {
        return None;
    }
    let k = 2.0 / length;
    let columns = [
        [1.0 - k * (y * y + z * z), k * (x * y + z * w), k * (x * z - y * w)],
        [k * (x * y - z * w), 1.0 - k * (x * x + z * z), k * (y * z + x * w)],
        [k * (x * z + y * w), k * (y * z - x * w), 1.0 - k * (x * x + y * y)],
    ];
    let mut m = IDENTITY;
    for c in 0..3 {
        for r in 0..3 {
            m[4 * c + r] = columns[c][r] * s[c];
        }
    }
    m[12..15].copy_from_slice(&t);
    Some(m)
}

pub(crate) fn multiply(a: &Matrix, b: &Matrix) -> Matrix {
    let mut m = IDENTITY;
    for c in 0..4 {
        for r in 0..3 {
            let sum = (a[r] * b[4 * c] + a[4 + r] * b[4 * c + 1]) + a[8 + r] * b[4 * c + 2];
            m[4 * c + r] = if c == 3 { sum + a[12 + r] } else { sum };
        }
    }
    m
}

/// A glTF camera looks along its −Z with +Y up.
fn perspective(root: &Root, index: usize, world: &Matrix) -> Result<Camera, &'static str> {
    let json = &root.cameras[index];
    let Some(lens) = json.perspective.as_ref().filter(|_| matches!(json.type_, Checked::Valid(CameraType::Perspective))) else {
        return Err("orthographic cameras are not read");
    };
    let unit = |c: usize| {
        let v = glam::DVec3::new(world[4 * c], world[4 * c + 1], world[4 * c + 2]);
        let length = v.length();
        (length > 0.0 && length.is_finite()).then(|| v / length)
    };
    let eye = glam::DVec3::new(world[12], world[13], world[14]);
    let (Some(up), Some(back), true) = (unit(1), unit(2), lens.yfov.is_finite() && lens.yfov > 0.0) else {
        return Err("a camera without direction or field of view is left out");
    };
    // Far from the origin a point one metre away would keep few bits of the direction.
    let distance = 1.0f64.max(eye.abs().max_element());
    let camera = Camera {
        eye: eye.as_vec3().to_array(),
        look_at: (eye - back * distance).as_vec3().to_array(),
        up: up.as_vec3().to_array(),
        fov_y_deg: (f64::from(lens.yfov).to_degrees() as f32).clamp(1.0, 179.0),
    };
    let finite = camera.eye.iter().chain(&camera.look_at).all(|x| x.is_finite());
    if finite { Ok(camera) } else { Err("a camera without direction or field of view is left out") }
}

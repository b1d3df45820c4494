//! The node tree: checked to be a tree, walked without recursion, transforms composed in f64.
//!
//! Local transform: the matrix as given, or T·R·S with R from the normalised quaternion by arithmetic alone:
//! R = 1 + s·(…), s = 2/|q|². World = parent·local, each entry ((a·b + c·d) + e·f) + g in this order. No function of the standard
//! library whose bits differ between CPUs takes part.

use super::error::{Budget, SceneError, Source};
use super::origin::Far;
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
    /// For each of them, its index in the file and its transform.
    pub camera_worlds: Vec<(usize, Matrix)>,
    /// A node with a mesh was left out because it is hidden.
    pub hidden: bool,
    /// Paths of the nodes asked for.
    pub paths: Vec<(usize, String)>,
}

/// Refuses a node with two parents and one that is its own ancestor.
///
/// A child that its own parent lists twice, and a root that is listed twice or is also a child, are read once, with a warning.
pub(crate) fn check(source: Source, root: &Root, warnings: &mut Warnings) -> Result<(), SceneError> {
    let nodes = &root.nodes;
    let mut parent: Vec<Option<usize>> = vec![None; nodes.len()];
    for (index, node) in nodes.iter().enumerate() {
        for child in node.children.iter().flatten() {
            let child = child.value();
            match parent[child] {
                None => parent[child] = Some(index),
                Some(other) if other == index && other != child => {
                    warnings.note("a child that is listed twice is read once", || label("nodes", child, nodes[child].name.as_deref()));
                }
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
            let at = || format!("scenes[{s}].nodes, {}", label("nodes", node, nodes[node].name.as_deref()));
            if !listed.insert(node) {
                warnings.note("a root of the scene that is listed twice is read once", at);
            } else if parent[node].is_some() {
                warnings.note("a root of the scene that is also the child of a node is read once", at);
            }
        }
    }
    Ok(())
}

/// Walks one scene. `with_path[node]` asks for the path of a node that has no mesh.
pub(crate) fn walk(
    source: Source,
    (root, far): (&Root, &Far),
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
        hidden: bool,
    }
    let mut tree = Tree::default();
    let mut stack: Vec<Step> = Vec::new();
    let roots = roots(root, scene);
    let first = |(node, name)| Step { node, name, prefix: 0, parent: IDENTITY, hidden: false };
    stack.extend(named(root, &roots).into_iter().rev().map(first));
    let mut path = String::new();
    let mut unique = Unique::default();
    while let Some(Step { node: index, name, prefix, parent, hidden }) = stack.pop() {
        let node = &root.nodes[index];
        let hidden = hidden || !is_visible(source, index, node)?;
        path.truncate(prefix);
        if prefix > 0 {
            path.push('/');
        }
        path.push_str(&name);
        let world = multiply(&parent, &local(source, index, node, far)?);
        if node.matrix.is_some_and(|matrix| last_row(&matrix) != LAST_ROW) {
            warnings.note("a matrix whose last row is off by rounding is read as 0 0 0 1", || label("nodes", index, node.name.as_deref()));
        }
        if node.mesh.is_some() || with_path[index] {
            budget.charge(label("nodes", index, node.name.as_deref()), "the path of its name", 2 * path.len() as u64)?;
            let name = unique.take(&path);
            if with_path[index] {
                tree.paths.push((index, name.clone()));
            }
            if node.mesh.is_some() && hidden {
                tree.hidden = true;
                warnings.note("nodes hidden by KHR_node_visibility are left out", || name);
            } else if node.mesh.is_some() {
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
                    tree.camera_worlds.push((camera.value(), world));
                }
                Err(why) => warnings.note(why, at),
            }
        }
        let children = each_once(node.children.iter().flatten().map(|child| child.value()));
        let prefix = path.len();
        let below = |(node, name)| Step { node, name, prefix, parent: world, hidden };
        stack.extend(named(root, &children).into_iter().rev().map(below));
    }
    let mut names = Unique::default();
    for camera in &mut tree.cameras {
        camera.name = names.take(&camera.name);
    }
    Ok(tree)
}

/// Counts the cameras of a walk from an origin.
pub(crate) fn move_cameras(root: &Root, tree: &mut Tree, origin: [f64; 3]) {
    if origin == [0.0; 3] {
        return;
    }
    for (camera, (index, world)) in tree.cameras.iter_mut().zip(&mut tree.camera_worlds) {
        super::origin::shift(world, origin, -1.0);
        camera.camera = perspective(root, *index, world).unwrap_or(camera.camera);
    }
}

/// Nodes that a scene begins with, each once, in its order. One that stands below another of them is reached from there.
fn roots(root: &Root, scene: usize) -> Vec<usize> {
    let listed = each_once(root.scenes[scene].nodes.iter().map(|node| node.value()));
    let mut is_listed = vec![false; root.nodes.len()];
    listed.iter().for_each(|&node| is_listed[node] = true);
    let mut below = vec![false; root.nodes.len()];
    let mut stack = listed.clone();
    while let Some(node) = stack.pop() {
        for child in root.nodes[node].children.iter().flatten().map(|child| child.value()) {
            // A listed child is on the stack for itself.
            if !std::mem::replace(&mut below[child], true) && !is_listed[child] {
                stack.push(child);
            }
        }
    }
    listed.into_iter().filter(|&node| !below[node]).collect()
}

/// Indices without repeats, in their order.
fn each_once(indices: impl Iterator<Item = usize>) -> Vec<usize> {
    let mut seen = HashSet::new();
    indices.filter(|&index| seen.insert(index)).collect()
}

/// KHR_node_visibility; a node without it is visible.
fn is_visible(source: Source, index: usize, node: &Node) -> Result<bool, SceneError> {
    let visible = node.extensions.as_ref().and_then(|all| all.others.get("KHR_node_visibility")).and_then(|own| own.get("visible"));
    visible.map_or(Some(true), serde_json::Value::as_bool).ok_or_else(|| {
        source.invalid(
            format!("{}.extensions.KHR_node_visibility", label("nodes", index, node.name.as_deref())),
            "visible is not true or false",
        )
    })
}

/// World transforms of all nodes, by index, in whatever scene they are; the roots of `scene` stand where they stand in it. The nodes must
/// be a forest ([`check`]).
pub(crate) fn worlds(source: Source, (root, far): (&Root, &Far), scene: usize) -> Result<Vec<Matrix>, SceneError> {
    let mut worlds = vec![IDENTITY; root.nodes.len()];
    let mut has_parent = vec![false; root.nodes.len()];
    root.nodes.iter().flat_map(|node| node.children.iter().flatten()).for_each(|child| has_parent[child.value()] = true);
    let roots = roots(root, scene);
    roots.iter().for_each(|&node| has_parent[node] = false);
    let mut is_root = vec![false; root.nodes.len()];
    roots.iter().for_each(|&node| is_root[node] = true);
    let mut stack: Vec<usize> = (0..root.nodes.len()).filter(|&node| !has_parent[node]).collect();
    for &node in &stack {
        worlds[node] = local(source, node, &root.nodes[node], far)?;
    }
    while let Some(parent) = stack.pop() {
        for child in root.nodes[parent].children.iter().flatten().map(|child| child.value()).filter(|&child| !is_root[child]) {
            worlds[child] = multiply(&worlds[parent], &local(source, child, &root.nodes[child], far)?);
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

/// Last row of an affine matrix.
const LAST_ROW: [f32; 4] = [0.0, 0.0, 0.0, 1.0];
/// Distance from `LAST_ROW` that rounding explains: an inverted matrix in f32 is off by some 1e-7.
const ROW_TOLERANCE: f32 = 1e-5;

fn last_row(matrix: &[f32; 16]) -> [f32; 4] {
    [matrix[3], matrix[7], matrix[11], matrix[15]]
}

fn local(source: Source, index: usize, node: &Node, far: &Far) -> Result<Matrix, SceneError> {
    let at = || label("nodes", index, node.name.as_deref());
    if let Some(matrix) = node.matrix {
        if !matrix.iter().all(|x| x.is_finite()) {
            return Err(source.invalid(at(), "a matrix with a number that is not finite"));
        }
        if last_row(&matrix).iter().zip(LAST_ROW).any(|(found, expected)| (found - expected).abs() > ROW_TOLERANCE) {
            return Err(source.invalid(at(), "a matrix that is not affine: its last row must be 0 0 0 1"));
        }
        let mut matrix = matrix.map(f64::from);
        (0..4).for_each(|c| matrix[4 * c + 3] = f64::from(LAST_ROW[c]));
        if let Some(exact) = far.get(&index) {
            matrix[12..15].copy_from_slice(exact);
        }
        return Ok(matrix);
    }
    let t = node.translation.unwrap_or([0.0; 3]);
    let s = node.scale.unwrap_or([1.0; 3]);
    let q = node.rotation.unwrap_or_default().0;
    if !t.iter().chain(&s).chain(&q).all(|x| x.is_finite()) {
        return Err(source.invalid(at(), "a translation, rotation or scale that is not finite"));
    }
    let mut matrix = compose(t, q, s).ok_or_else(|| source.invalid(at(), "a rotation of length 0"))?;
    if let Some(exact) = far.get(&index) {
        matrix[12..15].copy_from_slice(exact);
    }
    Ok(matrix)
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
pub(crate) fn perspective(root: &Root, index: usize, world: &Matrix) -> Result<Camera, &'static str> {
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

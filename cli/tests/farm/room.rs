//! The room of these tests, its bake by threads, and how commands are run.

use crate::command::{prelight, stderr, summary};
use prelight_scene::export::{GlbBuilder, Transform};
use prelight_scene::{Mesh, Primitive};
use serde_json::Value;
use std::path::Path;
use std::process::Command;
use std::sync::OnceLock;

/// Bakes the room; engines are added.
pub const BAKE: [&str; 5] = ["bake", "scene.toml", "--json", "--jobs=2", "--least-work=0"];

/// The summary of a command that must succeed.
pub fn done(command: &mut Command) -> Value {
    let output = command.output().expect("the command starts");
    assert_eq!(output.status.code(), Some(0), "{command:?}: {}", stderr(&output));
    summary(&output)
}

pub fn digest(summary: &Value) -> String {
    summary["asset_digest"].as_str().expect("a bake has a digest").to_string()
}

/// Exit code and what was said.
pub fn said(command: &mut Command) -> (i32, String) {
    let output = command.output().expect("the command starts");
    (output.status.code().expect("it ends by itself"), format!("{}{}", String::from_utf8_lossy(&output.stdout), stderr(&output)))
}

fn boxed(size: [f32; 3]) -> Primitive {
    let corner = |k: usize| [0, 1, 2].map(|axis| if k >> axis & 1 == 1 { size[axis] } else { 0.0 });
    let mut primitive = Primitive::default();
    for face in [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]] {
        let first = primitive.positions.len() as u32;
        primitive.positions.extend(face.map(corner));
        primitive.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }
    primitive
}

/// A slab and two boxes, one of them standing in it, so that points are buried; one has indirect light as well.
pub fn room() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut glb = GlbBuilder::new();
    let paint = glb.material(&Default::default());
    let things = [
        ("Floor", [3.0, 0.1, 3.0], [0.0, -0.1, 0.0]),
        ("Chest", [1.1, 0.6, 0.8], [0.3, -0.05, 0.4]),
        ("Stool", [0.5, 0.5, 0.5], [1.6, 0.01, 1.9]),
    ];
    for (name, size, at) in things {
        let mesh = glb.mesh(name, &Mesh { primitives: vec![Primitive { material: paint, ..boxed(size) }] });
        glb.node(name, None, Transform::translation(at), Some(mesh));
    }
    std::fs::write(folder.path().join("room.glb"), glb.to_glb()).unwrap();
    let text = "format = 1\nscene.gltf = \"room.glb\"\n[bake]\nedge_length = 0.14\n[[object]]\nmatch = \"Stool\"\n\
        technique = \"vmf_transfer\"\nedge_length = 0.5\n";
    std::fs::write(folder.path().join("scene.toml"), text).unwrap();
    folder
}

/// Digest of the room as threads bake it.
pub fn expected() -> &'static str {
    static DIGEST: OnceLock<String> = OnceLock::new();
    DIGEST.get_or_init(|| {
        let folder = room();
        let summary = done(prelight(folder.path()).args(BAKE));
        assert!((1000..20_000).contains(&summary["points"].as_u64().unwrap()), "{summary}");
        assert!(summary["points_buried"].as_u64().unwrap() > 0 && summary["transfer"]["slices"].as_u64().unwrap() > 0, "{summary}");
        digest(&summary)
    })
}

/// Rounds of a store, as `farm status` has them.
pub fn rounds(folder: &Path) -> Vec<Value> {
    let status = done(prelight(folder).args(["farm", "status", "--json"]));
    status["rounds"].as_array().expect("a list").clone()
}

//! Writes a hall of statues, each a dense scan-like surface, instanced on pedestals: `cargo run --release -p prelight-measure --bin statues -- OUT.glb`.
//!
//! One statue of 131 072 triangles stands ten times, by EXT_mesh_gpu_instancing: 1.3 million triangles in the flattened scene. The surface is a
//! sphere pushed out by sums of waves, so that it has folds, hollows and fine relief as scans do, and nothing is random.

use prelight_runtime::surface::Material;
use prelight_scene::export::{GlbBuilder, Transform, write_glb};
use prelight_scene::{Mesh, Primitive};
use serde_json::json;

/// Points around and down a statue.
const COLUMNS: u32 = 256;
const ROWS: u32 = 256;
/// Statues in a row, and rows.
const PLACES: [u32; 2] = [5, 2];

/// Radius in a direction: a torso with a neck, folds, and relief of a centimetre.
fn statue(around: f64, down: f64) -> [f32; 3] {
    let (s, c) = (libm::sin, libm::cos);
    let folds = 0.06 * s(9.0 * around + 4.0 * s(3.0 * down)) * s(down);
    let relief = 0.012 * s(61.0 * around + 3.0 * s(7.0 * down)) * s(53.0 * down) + 0.02 * s(23.0 * down + 2.0 * c(5.0 * around));
    let radius = (0.35 + 0.12 * c(2.0 * down) + 0.08 * c(5.0 * down) + folds + relief) * s(down).max(0.0);
    [radius * c(around), 0.9 - 0.9 * c(std::f64::consts::PI - down), -radius * s(around)].map(|x| x as f32)
}

fn main() {
    let Some(path) = std::env::args().nth(1) else {
        eprintln!("usage: statues OUT.glb");
        std::process::exit(2);
    };
    let mut shape = Primitive::default();
    for j in 0..=ROWS {
        for i in 0..COLUMNS {
            let around = f64::from(i) / f64::from(COLUMNS) * std::f64::consts::TAU;
            shape.positions.push(statue(around, f64::from(j) / f64::from(ROWS) * std::f64::consts::PI));
        }
    }
    for j in 0..ROWS {
        for i in 0..COLUMNS {
            let next = (i + 1) % COLUMNS;
            let [a, b, c, d] = [j * COLUMNS + i, j * COLUMNS + next, (j + 1) * COLUMNS + i, (j + 1) * COLUMNS + next];
            shape.triangles.extend([[a, c, b], [b, c, d]]);
        }
    }
    let mut normals = vec![glam::DVec3::ZERO; shape.positions.len()];
    for t in &shape.triangles {
        let [a, b, c] = t.map(|v| glam::DVec3::from(shape.positions[v as usize].map(f64::from)));
        let normal = (b - a).cross(c - a);
        t.iter().for_each(|&v| normals[v as usize] += normal);
    }
    shape.normals = Some(normals.iter().map(|n| n.normalize_or(glam::DVec3::Y).as_vec3().to_array()).collect());

    let mut glb = GlbBuilder::new();
    let marble =
        Material { name: "Marble".into(), base_color: [0.8, 0.78, 0.74, 1.0], metallic: 0.0, roughness: 0.4, ..Material::default() };
    let stone = Material { name: "Stone".into(), base_color: [0.4, 0.4, 0.42, 1.0], metallic: 0.0, roughness: 0.8, ..Material::default() };
    let (marble, stone) = (glb.material(&marble), glb.material(&stone));
    shape.material = marble;
    let statue = glb.mesh("Statue", &Mesh { primitives: vec![shape] });
    // A unit cube on the ground.
    let corner = |k: u32| [if k & 1 == 0 { -0.5 } else { 0.5 }, if k & 2 == 0 { 0.0 } else { 1.0 }, if k & 4 == 0 { -0.5 } else { 0.5 }];
    let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let triangles = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    let cube = Primitive { positions: (0..8).map(corner).collect(), triangles, material: stone, ..Primitive::default() };
    let cube = glb.mesh("Block", &Mesh { primitives: vec![cube] });
    glb.node("Floor", None, Transform { scale: [14.0, 0.1, 7.0], ..Transform::translation([0.0, -0.1, 0.0]) }, Some(cube));
    let statues = glb.node("Statues", None, Transform::translation([0.0, 0.8, 0.0]), Some(statue));
    let pedestals = glb.node("Pedestals", None, Transform { scale: [0.9, 0.8, 0.9], ..Transform::default() }, Some(cube));

    let places: Vec<[f32; 3]> =
        (0..PLACES[0] * PLACES[1]).map(|k| [(k % PLACES[0]) as f32 * 2.4 - 4.8, 0.0, (k / PLACES[0]) as f32 * 3.0 - 1.5]).collect();
    let (mut json, mut binary) = (glb.json(), glb.binary().to_vec());
    for (node, divide) in [(statues, 1.0f32), (pedestals, 0.9)] {
        let bytes: Vec<u8> = places.iter().flatten().flat_map(|x| (x / divide).to_le_bytes()).collect();
        let (views, offset) = (json["bufferViews"].as_array_mut().expect("there are views"), binary.len());
        views.push(json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes.len() }));
        let view = views.len() - 1;
        binary.extend_from_slice(&bytes);
        let accessors = json["accessors"].as_array_mut().expect("there are accessors");
        accessors.push(json!({ "bufferView": view, "componentType": 5126, "count": places.len(), "type": "VEC3" }));
        let attributes = json!({ "TRANSLATION": accessors.len() - 1 });
        json["nodes"][node as usize]["extensions"] = json!({ "EXT_mesh_gpu_instancing": { "attributes": attributes } });
    }
    json["buffers"][0]["byteLength"] = json!(binary.len());
    json["extensionsUsed"] = json!(["EXT_mesh_gpu_instancing"]);
    json["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
    std::fs::write(&path, write_glb(&json, &binary)).unwrap_or_else(|e| panic!("{path}: {e}"));
}

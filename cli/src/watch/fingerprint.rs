//! A scene's objects by name, and what became of them between two readings.
//!
//! A fingerprint holds digests, not geometry, so that two versions of a large scene need no memory for two.

use prelight_bake::mesh::PointParams;
use prelight_runtime::surface::Material;
use prelight_scene::{Mesh, Object, Scene};
use std::collections::BTreeMap;
use std::sync::Arc;

type Digest = [u8; 32];

/// Everything about an object that a bake may depend on.
#[derive(Clone, Debug, PartialEq)]
struct Print {
    shape: Digest,
    place: [u64; 16],
    materials: Digest,
    params: PointParams,
}

/// A scene's objects by name.
#[derive(Clone, Debug, Default)]
pub struct Fingerprint {
    objects: BTreeMap<String, Print>,
}

impl Fingerprint {
    /// The fingerprint of a scene and its objects' knobs, one each.
    pub fn new(scene: &Scene, params: &[PointParams]) -> Self {
        let textures: Vec<Digest> = (scene.textures.iter())
            .map(|texture| {
                let mut hasher = blake3::Hasher::new();
                hasher.update(format!("{:?} {} {}", texture.encoding, texture.width, texture.height).as_bytes());
                hasher.update(&texture.texels);
                *hasher.finalize().as_bytes()
            })
            .collect();
        let materials: Vec<Digest> = scene.materials.iter().map(|material| material_digest(material, &textures)).collect();
        let mut shapes: BTreeMap<*const Mesh, Digest> = BTreeMap::new();
        let print = |(object, params): (&Object, &PointParams)| {
            let shape = *shapes.entry(Arc::as_ptr(&object.mesh)).or_insert_with(|| shape_digest(&object.mesh));
            let mut hasher = blake3::Hasher::new();
            object.mesh.primitives.iter().for_each(|primitive| {
                hasher.update(&materials[primitive.material as usize]);
            });
            let materials = *hasher.finalize().as_bytes();
            (object.name.clone(), Print { shape, place: object.world_from_local.map(f64::to_bits), materials, params: *params })
        };
        Fingerprint { objects: scene.objects.iter().zip(params).map(print).collect() }
    }

    /// From this scene to a later one: kinds of change, each with the names of its objects in their order. Kinds without any are left out.
    pub fn changes(&self, later: &Fingerprint) -> Vec<(&'static str, Vec<String>)> {
        let mut kinds: Vec<(&'static str, Vec<String>)> =
            ["added", "removed", "reshaped", "moved", "repainted", "other knobs"].iter().map(|kind| (*kind, Vec::new())).collect();
        for (name, now) in &later.objects {
            let mut note = |kind: usize, is: bool| {
                if is {
                    kinds[kind].1.push(name.clone());
                }
            };
            match self.objects.get(name) {
                None => note(0, true),
                Some(before) => {
                    note(2, before.shape != now.shape);
                    note(3, before.place != now.place);
                    note(4, before.materials != now.materials);
                    note(5, before.params != now.params);
                }
            }
        }
        kinds[1].1 = self.objects.keys().filter(|name| !later.objects.contains_key(*name)).cloned().collect();
        kinds.retain(|(_, names)| !names.is_empty());
        kinds
    }
}

/// A material as written down, with what its textures show instead of their numbers.
fn material_digest(material: &Material, textures: &[Digest]) -> Digest {
    let mut hasher = blake3::Hasher::new();
    for reference in material.textures() {
        hasher.update(&textures[reference.texture as usize]);
    }
    let mut plain = material.clone();
    plain.texture_slots().into_iter().flatten().for_each(|reference| reference.texture = 0);
    hasher.update(serde_json::to_string(&plain).expect("materials are plain numbers and text").as_bytes());
    *hasher.finalize().as_bytes()
}

fn shape_digest(mesh: &Mesh) -> Digest {
    let mut hasher = blake3::Hasher::new();
    let mut add = |bytes: &[u8]| {
        hasher.update(&(bytes.len() as u64).to_le_bytes());
        hasher.update(bytes);
    };
    for primitive in &mesh.primitives {
        add(bytemuck::cast_slice(&primitive.positions));
        add(bytemuck::cast_slice(&primitive.triangles));
        add(primitive.normals.as_deref().map_or(&[], bytemuck::cast_slice));
        add(primitive.tangents.as_deref().map_or(&[], bytemuck::cast_slice));
        add(primitive.colors.as_deref().map_or(&[], bytemuck::cast_slice));
        for uvs in &primitive.uvs {
            add(uvs.as_deref().map_or(&[], bytemuck::cast_slice));
        }
    }
    *hasher.finalize().as_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;
    use prelight_chart::stability::scenes::{cuboid, scene};
    use prelight_manifests::Quality;

    #[test]
    fn every_kind_of_change_is_told_by_name_and_nothing_else() {
        let names = ["Box", "Lamp", "Sofa", "Table"];
        let before = scene(names.iter().enumerate().map(|(k, name)| (*name, cuboid([0.0; 3], [1.0 + k as f32; 3], 0))).collect());
        let params = |scene: &Scene| vec![PointParams::new(&Quality::Medium.knobs(), 0.1); scene.objects.len()];
        let print = |scene: &Scene| Fingerprint::new(scene, &params(scene));
        let changes = |after: &Scene| -> Vec<(&'static str, Vec<String>)> { print(&before).changes(&print(after)) };
        assert!(changes(&before.clone()).is_empty());

        let mut after = before.clone();
        after.objects[0].world_from_local[12] = 0.5;
        after.objects[1].name = "Lantern".into();
        Arc::make_mut(&mut after.objects[2].mesh).primitives[0].positions[0][0] = -1.0;
        let expected = [("added", "Lantern"), ("removed", "Lamp"), ("reshaped", "Sofa"), ("moved", "Box")];
        assert_eq!(changes(&after), expected.map(|(kind, name)| (kind, vec![name.to_string()])));

        let mut painted = before.clone();
        painted.materials[0].roughness *= 0.5;
        assert_eq!(changes(&painted), [("repainted", ["Box", "Lamp", "Sofa", "Table"].map(String::from).to_vec())]);
        let mut finer = params(&before);
        finer[3].edge_length = 0.05;
        assert_eq!(print(&before).changes(&Fingerprint::new(&before, &finer)), [("other knobs", vec!["Table".to_string()])]);
    }
}

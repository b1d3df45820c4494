//! Sealing: the chunks that belong to the scene as a whole, the manifest, and the file that the user sees.

use crate::error::BakeError;
use prelight_manifests::asset::{self, AssetContent, AssetManifest};
use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype, version};
use prelight_scene::Scene;
use prelight_scene::world::World;
use prelight_store::Store;
use std::collections::{BTreeMap, HashSet};

/// Materials, textures, cameras, names: so that an asset never needs its source again.
pub(crate) struct SceneChunks {
    materials: Descriptor,
    textures: Vec<Descriptor>,
    brdfs: Vec<Descriptor>,
    cameras: Descriptor,
    names: Descriptor,
    origin: [f64; 3],
    pub bytes_stored: u64,
}

impl SceneChunks {
    pub(crate) fn put(scene: &Scene, store: &Store) -> Result<Self, BakeError> {
        let mut writer = store.writer();
        let mut json = |kind, count: usize, value: serde_json::Result<Vec<u8>>| {
            let bytes = value.expect("materials, cameras and extras have string keys and finite numbers");
            writer.put(kind, Dtype::U8, vec![count as u64], &bytes)
        };
        let materials = json(ChunkKind::Materials, scene.materials.len(), serde_json::to_vec(&scene.materials))?;
        let cameras = json(ChunkKind::Cameras, scene.cameras.len(), serde_json::to_vec(&scene.cameras))?;
        let names = json(ChunkKind::Names, scene.objects.len(), serde_json::to_vec(&scene.extras))?;
        let mut textures = Vec::new();
        for texture in &scene.textures {
            let shape = vec![u64::from(texture.height), u64::from(texture.width), 4];
            textures.push(writer.put(ChunkKind::Texture, Dtype::U8, shape, &texture.to_chunk())?);
        }
        let mut brdfs = Vec::new();
        for table in &scene.tables {
            let shape = table.grid().iter().map(|n| *n as u64).chain([3]).collect();
            brdfs.push(writer.put(ChunkKind::Brdf, Dtype::F32, shape, &table.to_chunk())?);
        }
        let bytes_stored = writer.commit()?.bytes_stored;
        Ok(SceneChunks { materials, textures, brdfs, cameras, names, origin: scene.origin, bytes_stored })
    }

    pub(crate) fn content(self, world: &World, face_resolution: u32, objects: Vec<asset::AssetObject>) -> AssetContent {
        AssetContent {
            algorithm_version: version::ALGORITHM_VERSION,
            face_resolution,
            objects,
            materials: self.materials,
            textures: self.textures,
            brdfs: self.brdfs,
            cameras: self.cameras,
            names: self.names,
            bounds: bounds(world),
            origin: self.origin,
        }
    }
}

/// Plain bytes of every chunk, each counted once.
pub(crate) fn resident_bytes(content: &AssetContent) -> u64 {
    let mut seen = HashSet::new();
    content.descriptors().filter(|descriptor| seen.insert(descriptor.digest)).map(|descriptor| descriptor.bytes).sum()
}

/// Publishes a finished bake: the manifest goes into the store and gets a root. The file that the user sees is the caller's to write.
pub(crate) fn seal(
    content: AssetContent,
    asset_digest: Digest,
    report: BTreeMap<String, serde_json::Value>,
    store: &Store,
) -> Result<AssetManifest, BakeError> {
    let manifest = AssetManifest { format: version::ASSET_FORMAT, asset_digest, content, report };
    store.seal(asset_digest, manifest.to_text().as_bytes())?;
    Ok(manifest)
}

/// Bounds of all triangles that have finite corners; zeros when there is none.
fn bounds(world: &World) -> [[f32; 3]; 2] {
    let mut bounds = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
    for corner in world.positions.iter().filter(|triangle| triangle.as_flattened().iter().all(|x| x.is_finite())).flatten() {
        for axis in 0..3 {
            bounds[0][axis] = bounds[0][axis].min(corner[axis]);
            bounds[1][axis] = bounds[1][axis].max(corner[axis]);
        }
    }
    if bounds[0][0] <= bounds[1][0] { bounds } else { [[0.0; 3]; 2] }
}

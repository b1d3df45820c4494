//! Sealing: the chunks that belong to the scene as a whole, the manifest, and the file that the user sees.

use crate::bake::{Baked, commit};
use crate::error::BakeError;
use crate::scene::world::World;
use crate::scene::{Mesh, Object, Primitive, Scene};
use prelight_manifests::asset::{self, AssetContent, AssetManifest};
use prelight_manifests::{ChunkKind, Descriptor, Dtype, version};
use prelight_runtime::asset::base::{self, BasePrimitive};
use prelight_runtime::asset::{Asset, AssetObject};
use prelight_runtime::surface::Texture;
use prelight_store::{ChunkSource, Store};
use std::borrow::Cow;
use std::collections::{BTreeMap, HashSet};
use std::sync::Arc;

/// Materials, textures, cameras, names: so that an asset never needs its source again.
pub(crate) struct SceneChunks {
    materials: Descriptor,
    textures: Vec<Descriptor>,
    brdfs: Vec<Descriptor>,
    cameras: Descriptor,
    names: Descriptor,
    pub bytes_stored: u64,
}

impl SceneChunks {
    pub fn put(scene: &Scene, store: &Store) -> Result<Self, BakeError> {
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
        let bytes_stored = commit(writer)?;
        Ok(SceneChunks { materials, textures, brdfs, cameras, names, bytes_stored })
    }

    pub fn content(self, world: &World, face_resolution: u32, objects: Vec<asset::AssetObject>) -> AssetContent {
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
        }
    }
}

/// The base chunk of a mesh.
pub(crate) fn base_chunk(mesh: &Mesh) -> Vec<u8> {
    let primitives: Vec<BasePrimitive> = (mesh.primitives.iter())
        .map(|primitive| BasePrimitive {
            positions: &primitive.positions,
            triangles: &primitive.triangles,
            material: primitive.material,
            normals: primitive.normals.as_deref(),
            tangents: primitive.tangents.as_deref(),
            uvs: [primitive.uvs[0].as_deref(), primitive.uvs[1].as_deref()],
            colors: primitive.colors.as_deref(),
        })
        .collect();
    base::to_chunk(&primitives)
}

fn owned(primitive: BasePrimitive) -> Primitive {
    Primitive {
        positions: primitive.positions.to_vec(),
        triangles: primitive.triangles.to_vec(),
        material: primitive.material,
        normals: primitive.normals.map(<[_]>::to_vec),
        tangents: primitive.tangents.map(<[_]>::to_vec),
        uvs: primitive.uvs.map(|uv| uv.map(<[_]>::to_vec)),
        colors: primitive.colors.map(<[_]>::to_vec),
    }
}

/// The scene that an asset was baked from, from its chunks alone.
pub fn scene_from_asset(asset: &Asset) -> Scene {
    let object = |(i, object): (usize, &AssetObject)| Object {
        name: object.name.clone(),
        mesh: Arc::new(Mesh { primitives: asset.base(i).into_iter().map(owned).collect() }),
        world_from_local: object.world_from_local,
    };
    let textures = asset.textures().into_iter().map(|texture| Texture { texels: Cow::Owned(texture.texels.into_owned()), ..texture });
    Scene {
        objects: asset.objects().iter().enumerate().map(object).collect(),
        materials: asset.materials().to_vec(),
        textures: textures.collect(),
        tables: asset.tables().to_vec(),
        cameras: asset.cameras().to_vec(),
        ..Scene::default()
    }
}

/// Geometry and opacity of the scene that an asset was baked from, read from the few chunks that hold them: what a later scene is compared
/// with. An asset of some objects only gives those.
///
/// # Errors
/// A chunk that is missing, corrupt, or not what the manifest calls it.
pub fn occluding_scene(content: &AssetContent, store: &dyn ChunkSource) -> Result<Scene, BakeError> {
    let unreadable = |error: serde_json::Error| BakeError::Unsupported {
        what: format!("the asset's materials cannot be read: {error}"),
        help: "it was written by another version of prelight; bake again".to_string(),
    };
    let materials = serde_json::from_slice(&store.chunk(&content.materials)?).map_err(unreadable)?;
    let mut textures = Vec::with_capacity(content.textures.len());
    for descriptor in &content.textures {
        let chunk = store.chunk(descriptor)?;
        let texture = Texture::from_chunk(&chunk)?;
        textures.push(Texture { texels: Cow::Owned(texture.texels.into_owned()), ..texture });
    }
    let mut objects = Vec::with_capacity(content.objects.len());
    for object in &content.objects {
        let chunk = store.chunk(&object.base)?;
        let primitives = base::from_chunk(&chunk)?.into_iter().map(owned).collect();
        let (name, world_from_local) = (object.name.clone(), object.world_from_local);
        objects.push(Object { name, mesh: Arc::new(Mesh { primitives }), world_from_local });
    }
    Ok(Scene { objects, materials, textures, ..Scene::default() })
}

/// Plain bytes of every chunk, each counted once.
pub(crate) fn resident_bytes(content: &AssetContent) -> u64 {
    let mut seen = HashSet::new();
    content.descriptors().filter(|descriptor| seen.insert(descriptor.digest)).map(|descriptor| descriptor.bytes).sum()
}

/// Publishes a finished bake: the manifest goes into the store and gets a root. The file that the user sees is the caller's to write.
pub fn seal(baked: &Baked, report: BTreeMap<String, serde_json::Value>, store: &Store) -> Result<AssetManifest, BakeError> {
    let content = baked.content.clone();
    let manifest = AssetManifest { format: version::ASSET_FORMAT, asset_digest: baked.asset_digest, content, report };
    store.seal(baked.asset_digest, manifest.to_text().as_bytes())?;
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

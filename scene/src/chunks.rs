//! A scene in the chunks of an asset: how a mesh is written as its source gave it, and how a scene is read back from them.

use super::{Mesh, Object, Primitive, Scene};
use crate::error::SceneError;
use prelight_manifests::asset::AssetContent;
use prelight_runtime::asset::base::{self, BasePrimitive};
use prelight_runtime::asset::{Asset, AssetObject};
use prelight_runtime::surface::Texture;
use prelight_store::ChunkSource;
use std::borrow::Cow;
use std::sync::Arc;

/// The base chunk of a mesh.
pub fn base_chunk(mesh: &Mesh) -> Vec<u8> {
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

/// A mesh as its base chunk has it.
///
/// # Errors
/// A chunk that is no base chunk.
pub fn mesh_from_chunk(chunk: &[u8]) -> Result<Mesh, SceneError> {
    Ok(Mesh { primitives: base::from_chunk(chunk)?.into_iter().map(owned).collect() })
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
pub fn occluding_scene(content: &AssetContent, store: &dyn ChunkSource) -> Result<Scene, SceneError> {
    let unreadable = |error: serde_json::Error| SceneError::Refused {
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
        let mesh = Arc::new(mesh_from_chunk(&store.chunk(&object.base)?)?);
        let (name, world_from_local) = (object.name.clone(), object.world_from_local);
        objects.push(Object { name, mesh, world_from_local });
    }
    Ok(Scene { objects, materials, textures, ..Scene::default() })
}

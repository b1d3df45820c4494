//! A scene as workers read it: chunks of the store, named by one small file that is a chunk itself.
//!
//! Beside geometry, materials and textures it has whatever decides a bake for all patches alike: face resolution, layers, shades, edge lengths,
//! and the parameters of techniques that another process can make. Same scene and options, same digest.

use crate::error::BakeError;
use crate::factor::Technique;
use crate::options::BakeOptions;
use crate::seal::SceneChunks;
use crate::trace::TreeQuality;
use crate::vmf_transfer::VmfTransfer;
use prelight_manifests::asset::{AssetContent, AssetManifest};
use prelight_manifests::quality::Shades;
use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype, Technique as Name, version};
use prelight_runtime::asset::Asset;
use prelight_scene::chunks::{base_chunk, mesh_from_chunk, scene_from_asset};
use prelight_scene::world::World;
use prelight_scene::{Object, Scene};
use prelight_store::{ChunkSource, Store};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Version of the file.
const FORMAT: u32 = 1;
/// Kind of the file's chunk.
const KIND: ChunkKind = ChunkKind::custom("farm:scene");

/// The file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneFile {
    format: u32,
    /// Content of the scene as a whole, as an asset has it; it has no objects.
    content: AssetContent,
    objects: Vec<ObjectFile>,
    tree: String,
    /// Techniques that another process can make, in the order of the bake.
    techniques: Vec<TechniqueFile>,
}

/// An object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ObjectFile {
    name: String,
    base: Descriptor,
    world_from_local: [f64; 16],
    edge_length: f32,
    /// Where the manifest fixes it.
    layer: Option<u8>,
    shades: Shades,
}

/// A technique.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct TechniqueFile {
    name: String,
    parameters: Value,
}

/// A scene in a worker's memory.
pub struct WorkerScene {
    /// The scene, without cameras and names.
    pub scene: Scene,
    /// Triangles of the scene, flattened.
    pub world: World,
    /// `[objects]` metres.
    pub edge_lengths: Vec<f32>,
    /// `[objects]` layers, where the manifest fixes them.
    pub layers: Vec<Option<u8>>,
    /// `[objects]`.
    pub shades: Vec<Shades>,
    /// Texels along the side of a face.
    pub face_resolution: u32,
    /// Effort of the tree's builder.
    pub tree: TreeQuality,
    /// Techniques by name.
    pub techniques: Vec<Arc<dyn Technique>>,
}

impl SceneFile {
    /// Puts a scene and what decides its bake into a store; names the file. What is there already is not written again.
    ///
    /// # Errors
    /// What the store says.
    pub fn put(scene: &Scene, world: &World, options: &BakeOptions, store: &Store) -> Result<(Self, Descriptor), BakeError> {
        let content = SceneChunks::put(scene, store)?.content(world, options.face_resolution, Vec::new());
        let mut writer = store.writer();
        let mut objects = Vec::with_capacity(scene.objects.len());
        for (i, object) in scene.objects.iter().enumerate() {
            let shape = vec![object.mesh.primitives.len() as u64];
            objects.push(ObjectFile {
                name: object.name.clone(),
                base: writer.put(ChunkKind::Base, Dtype::U8, shape, &base_chunk(&object.mesh))?,
                world_from_local: object.world_from_local,
                edge_length: options.points[i].edge_length,
                layer: options.rebake.layers.get(i).copied().flatten(),
                shades: options.shades_of(i as u32),
            });
        }
        let described = |technique: &Arc<dyn Technique>| {
            let parameters = technique.parameters()?;
            Some(TechniqueFile { name: technique.name().to_string(), parameters })
        };
        let techniques = options.techniques.iter().filter_map(described).collect();
        let file = SceneFile { format: FORMAT, content, objects, tree: tree_name(options.tree).to_string(), techniques };
        let bytes = serde_json::to_vec(&file).expect("scene files have string keys and finite numbers");
        let descriptor = writer.put(KIND, Dtype::U8, vec![bytes.len() as u64], &bytes)?;
        writer.commit()?;
        Ok((file, descriptor))
    }

    /// Whether a worker can make the technique.
    pub fn has(&self, technique: &str) -> bool {
        technique == Name::BLOCK_PRODUCT.name() || self.techniques.iter().any(|known| known.name == technique)
    }

    /// Reads the file of a scene, and the scene.
    ///
    /// # Errors
    /// A chunk that is missing or corrupt, a file of another version of prelight, and what does not hold in it.
    pub fn load(descriptor: &Descriptor, store: &dyn ChunkSource) -> Result<WorkerScene, BakeError> {
        let file: SceneFile = super::round::parse("scene", FORMAT, &store.chunk(descriptor)?)?;
        super::round::check_algorithm(file.content.algorithm_version)?;
        let asset_digest = Digest(*blake3::hash(&file.content.canonical()).as_bytes());
        let face_resolution = file.content.face_resolution;
        let manifest = AssetManifest { format: version::ASSET_FORMAT, asset_digest, content: file.content, report: BTreeMap::new() };
        let mut scene = scene_from_asset(&Asset::open(manifest, store)?);
        let mut meshes = BTreeMap::new();
        for object in &file.objects {
            let mesh = match meshes.get(&object.base.digest) {
                Some(mesh) => Arc::clone(mesh),
                None => {
                    let mesh = Arc::new(mesh_from_chunk(&store.chunk(&object.base)?)?);
                    if mesh.primitives.iter().any(|primitive| primitive.material as usize >= scene.materials.len()) {
                        return Err(super::round::damaged("scene", &format!("{} has a material that is not there", object.name)));
                    }
                    meshes.insert(object.base.digest, Arc::clone(&mesh));
                    mesh
                }
            };
            scene.objects.push(Object { name: object.name.clone(), mesh, world_from_local: object.world_from_local });
        }
        let world = World::build(&scene);
        Ok(WorkerScene {
            scene,
            world,
            edge_lengths: file.objects.iter().map(|object| object.edge_length).collect(),
            layers: file.objects.iter().map(|object| object.layer).collect(),
            shades: file.objects.iter().map(|object| object.shades).collect(),
            face_resolution,
            tree: TREES.into_iter().find(|(_, name)| *name == file.tree).map_or(TreeQuality::default(), |(tree, _)| tree),
            techniques: file.techniques.into_iter().map(technique).collect::<Result<_, _>>()?,
        })
    }
}

/// Makes a technique of another process again.
fn technique(of: TechniqueFile) -> Result<Arc<dyn Technique>, BakeError> {
    let unreadable = || super::round::damaged("scene", &format!("technique `{}` is not known here", of.name));
    match of.name == Name::VMF_TRANSFER.name() {
        true => Ok(Arc::new(serde_json::from_value::<VmfTransfer>(of.parameters.clone()).map_err(|_| unreadable())?)),
        false => Err(unreadable()),
    }
}

const TREES: [(TreeQuality, &str); 6] = [
    (TreeQuality::Fastest, "fastest"),
    (TreeQuality::VeryFast, "very_fast"),
    (TreeQuality::Fast, "fast"),
    (TreeQuality::Medium, "medium"),
    (TreeQuality::Slow, "slow"),
    (TreeQuality::VerySlow, "very_slow"),
];

fn tree_name(tree: TreeQuality) -> &'static str {
    TREES.iter().find(|(known, _)| *known == tree).map_or("medium", |(_, name)| name)
}

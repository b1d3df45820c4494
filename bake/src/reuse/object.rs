//! What an earlier bake knows of an object: all of it, or which of its patches no edit has reached since.
//!
//! ```text
//! object key   = H(versions, light key, base mesh, materials, digests of their textures, state of the light)
//! record       chunks: base, mesh, per patch points, surface
//!              data:   version u8, counts 4 u32
//! ```
//!
//! An object is looked up by its light ([`crate::reach::seen`]); where no patch of it was touched and a record of the object is there for the state
//! of that light, it is taken over **whole**, without being planned. Otherwise its patches are taken over one by one, and the object's other
//! chunks wherever no edge was split in another way. Records are a cache: without them the bits are the same.

use crate::cost::counts::hash_arrays;
use crate::error::BakeError;
use crate::mesh::PointParams;
use crate::options::BakeOptions;
use crate::points::patch::PATCH_ORDER;
use crate::reach::edit::SceneDiff;
use crate::reach::key::Hasher;
use crate::reach::pieces::{Pieces, side};
use crate::reach::seen::{KnownPatch, SeenRecord};
use crate::reach::shaft::Raster;
use crate::reach::snapshot::{Snapshot, Source};
use prelight_manifests::asset::{AssetObject, AssetPatch};
use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype, Technique};
use prelight_scene::chunks::base_chunk;
use prelight_scene::world::World;
use prelight_scene::{Object, Scene};
use prelight_store::{Chunk, ChunkSource, Record, Store, StoreError};
use rayon::prelude::*;
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

const VERSION: u8 = 2;

/// Counts that a report gives of an object.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct ObjectCounts {
    /// Refined triangles.
    pub triangles: u32,
    /// Points inside other solids.
    pub buried: u32,
    /// Points added at leaks.
    pub split: u32,
    /// Tiles above the horizon of some point.
    pub live: u32,
}

/// Chunks of an object beside its visibility.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ObjectChunks {
    /// What the report says.
    pub counts: ObjectCounts,
    /// The mesh as it was read.
    pub base: Descriptor,
    /// The refined mesh.
    pub mesh: Descriptor,
    /// `[patches]` points and surface.
    pub patches: Vec<[Descriptor; 2]>,
}

impl ObjectChunks {
    /// The chunks of a finished object.
    pub(crate) fn new(object: &AssetObject, counts: ObjectCounts) -> ObjectChunks {
        let patches = object.patches.iter().map(|patch| [patch.points.clone(), patch.surface.clone()]).collect();
        ObjectChunks { counts, base: object.base.clone(), mesh: object.mesh.clone(), patches }
    }

    /// As a record of the ledger.
    pub(crate) fn encode(&self) -> Record {
        let ObjectCounts { triangles, buried, split, live } = self.counts;
        let mut data = vec![VERSION];
        [triangles, buried, split, live].iter().for_each(|count| data.extend_from_slice(&count.to_le_bytes()));
        let chunks = [&self.base, &self.mesh].into_iter().chain(self.patches.as_flattened()).cloned().collect();
        Record { chunks, data }
    }

    /// From a record of the ledger; `None` where it is not one of an object of so many patches.
    pub(crate) fn decode(record: Record, n_patches: usize) -> Option<ObjectChunks> {
        let (&version, counts) = record.data.split_first()?;
        let counts: &[u8; 16] = counts.try_into().ok()?;
        let count = |k: usize| u32::from_le_bytes(std::array::from_fn(|i| counts[4 * k + i]));
        let counts = ObjectCounts { triangles: count(0), buried: count(1), split: count(2), live: count(3) };
        let [base, mesh, rest @ ..] = &record.chunks[..] else { return None };
        let (patches, tail) = rest.as_chunks::<2>();
        let kinds = |patch: &[Descriptor; 2]| patch[0].kind == ChunkKind::Points && patch[1].kind == ChunkKind::Surface;
        let fits = version == VERSION && base.kind == ChunkKind::Base && mesh.kind == ChunkKind::Mesh && patches.iter().all(kinds);
        let whole = fits && tail.is_empty() && patches.len() == n_patches;
        whole.then(|| ObjectChunks { counts, base: base.clone(), mesh: mesh.clone(), patches: patches.to_vec() })
    }

    /// The object's part of the manifest.
    pub(crate) fn object(&self, scene: &Scene, options: &BakeOptions, object: usize, seen: &SeenRecord) -> AssetObject {
        let source = &scene.objects[object];
        let patches: Vec<AssetPatch> = (seen.patches.iter().zip(&self.patches))
            .map(|(seen, [points, surface])| AssetPatch {
                n_points: seen.n_points,
                points: points.clone(),
                surface: surface.clone(),
                factors: vec![seen.visibility.clone()],
            })
            .collect();
        AssetObject {
            name: source.name.clone(),
            technique: Technique::BLOCK_PRODUCT.name().to_string(),
            n_points: patches.iter().map(|patch| patch.n_points).sum(),
            n_triangles: self.counts.triangles,
            base: self.base.clone(),
            world_from_local: source.world_from_local,
            edge_length: options.points[object].edge_length,
            mesh: self.mesh.clone(),
            patches,
            moves: None,
        }
    }
}

/// Where records of an object are found.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ObjectKey {
    /// Its light.
    pub seen: Digest,
    /// Its mesh as it was read, and where that stands.
    pub source: Source,
    /// All that its other chunks come from, but for the light.
    whole: Digest,
}

impl ObjectKey {
    /// Where its chunks are found, given the state of its light.
    pub(crate) fn chunks(&self, state: &Digest) -> Digest {
        let mut hasher = Hasher::new("prelight object chunks");
        hasher.bytes(&self.whole.0);
        hasher.bytes(&state.0);
        hasher.finish()
    }
}

/// An object of which an earlier bake knows the patches.
pub(crate) struct KnownPatches {
    /// As they were found.
    pub seen: SeenRecord,
    /// `[patches]` whether a patch may not be as it was.
    pub touched: Vec<bool>,
    /// `[patches]` their visibility; filled by [`KnownPatches::load`].
    pub visibility: Vec<Chunk>,
    /// What was done to the scene since.
    pub edit: Arc<SceneDiff>,
    /// Its other chunks as they were, if the object is what it was.
    pub chunks: Option<ObjectChunks>,
}

impl KnownPatches {
    /// Reads the patches' chunks.
    ///
    /// # Errors
    /// What the store says. A damaged chunk is set aside: without this record, its patch is traced again.
    pub(crate) fn load(&mut self, store: &Store) -> Result<(), StoreError> {
        self.visibility = self.seen.patches.par_iter().map(|patch| store.chunk(&patch.visibility)).collect::<Result<_, _>>()?;
        Ok(())
    }

    /// A patch, by its index.
    pub(crate) fn patch(&self, index: usize) -> Option<KnownPatch<'_>> {
        let (seen, chunk) = (self.seen.patches.get(index)?, self.visibility.get(index)?);
        Some(KnownPatch { seen, chunk, edit: self.touched[index].then_some(&self.edit) })
    }
}

/// What an earlier bake knows of an object.
pub(crate) enum Known {
    /// Nothing.
    Nothing,
    /// All of it: the part of the manifest, and what the report says.
    Whole(Box<AssetObject>, ObjectCounts),
    /// What its patches saw.
    Patches(Box<KnownPatches>),
}

/// `[objects]` keys of those that are `wanted`; `None` for the others.
pub(crate) fn object_keys(
    scene: &Scene,
    world: &World,
    pieces: &Pieces,
    options: &BakeOptions,
    wanted: &(dyn Fn(usize) -> bool + Sync),
) -> Vec<Option<ObjectKey>> {
    let objects = || (0..scene.objects.len()).filter(|object| wanted(*object));
    let primitives = objects().flat_map(|object| &scene.objects[object].mesh.primitives);
    let materials = primitives.filter_map(|primitive| scene.materials.get(primitive.material as usize));
    let used: BTreeSet<u32> = materials.flat_map(|material| material.textures()).map(|reference| reference.texture).collect();
    let digest = |texture: u32| Some((texture, *blake3::hash(&scene.textures.get(texture as usize)?.to_chunk()).as_bytes()));
    let textures: BTreeMap<u32, [u8; 32]> = used.into_par_iter().filter_map(digest).collect();
    let key = |object: usize| {
        let Object { mesh, world_from_local, .. } = &scene.objects[object];
        let bytes = base_chunk(mesh);
        let digest = Digest(*blake3::hash(&bytes).as_bytes());
        let shape = vec![mesh.primitives.len() as u64];
        let base = Descriptor { kind: ChunkKind::Base, digest, bytes: bytes.len() as u64, dtype: Dtype::U8, shape };
        let seen = seen_key(scene, world, pieces, options, object);
        let whole = whole_key(scene, object, &seen, &digest, &textures);
        ObjectKey { seen, source: Source { base, world_from_local: *world_from_local }, whole }
    };
    (0..scene.objects.len()).into_par_iter().map(|object| wanted(object).then(|| key(object))).collect()
}

/// Covers what points come from, and what blocks them: nothing of a material but its opacity, its sides, and what cuts vertices.
fn seen_key(scene: &Scene, world: &World, pieces: &Pieces, options: &BakeOptions, object: usize) -> Digest {
    // Named one by one: a new knob must find its way into the key.
    let PointParams { edge_length, normal_angle_deg, area_floor, max_level, coarser, quarters, max_shadow_gap, max_triangles } =
        options.points[object];
    let source = &scene.objects[object];
    let mut hasher = Hasher::new("prelight object light");
    let shades = options.shades_of(object as u32).steps().unwrap_or(0);
    hasher.words(&[options.face_resolution, shades, max_level, max_triangles, u32::from(coarser) | u32::from(quarters) << 1, PATCH_ORDER]);
    hasher.floats(&[edge_length, normal_angle_deg, area_floor, max_shadow_gap]);
    source.world_from_local.iter().for_each(|value| hasher.bytes(&value.to_le_bytes()));
    // Materials by the order in which they come: which primitives share one, not which one it is.
    let mut ranks: Vec<u32> = Vec::new();
    for primitive in &source.mesh.primitives {
        let material = scene.materials.get(primitive.material as usize);
        let (sides, set) = material.map_or((0, None), |material| (1 + u32::from(material.double_sided), material.tangent_uv_set()));
        let rank = ranks.iter().position(|known| *known == primitive.material).unwrap_or(ranks.len());
        if rank == ranks.len() {
            ranks.push(primitive.material);
        }
        hasher.words(&[rank as u32, sides, set.map_or(0, |set| 1 + set)]);
        hash_arrays(primitive, &mut hasher);
    }
    let ids = world.object_start[object]..world.object_start[object + 1];
    let mut own = Vec::with_capacity(17 * ids.len());
    for id in ids {
        own.extend_from_slice(pieces.triangle(id));
        own.push(side(scene, world, id));
    }
    hasher.bytes(&own);
    hasher.finish()
}

fn whole_key(scene: &Scene, object: usize, seen: &Digest, mesh: &Digest, textures: &BTreeMap<u32, [u8; 32]>) -> Digest {
    let mut hasher = Hasher::new("prelight object");
    hasher.bytes(&seen.0);
    hasher.bytes(&mesh.0);
    for primitive in &scene.objects[object].mesh.primitives {
        let material = scene.materials.get(primitive.material as usize);
        let json = serde_json::to_vec(&material).expect("materials have string keys and finite numbers");
        hasher.bytes(&(json.len() as u64).to_le_bytes());
        hasher.bytes(&json);
        for reference in material.into_iter().flat_map(|material| material.textures()) {
            hasher.bytes(textures.get(&reference.texture).unwrap_or(&[0; 32]));
        }
    }
    hasher.finish()
}

/// The snapshot of what blocks light now.
pub(crate) fn snapshot(pieces: &Pieces, keys: &[Option<ObjectKey>]) -> Snapshot {
    Snapshot::new(pieces, keys.iter().map(|key| Some(key.as_ref()?.source.clone())).collect())
}

/// What the shafts of an object's patches need to know of a bake.
pub(crate) fn raster(options: &BakeOptions, object: u32) -> Raster {
    Raster::new(options.face_resolution, options.shades_of(object))
}

/// `[objects]` what earlier bakes know of those that have a key and are `wanted`.
///
/// # Errors
/// What the store says.
pub(crate) fn known_objects(
    scene: &Scene,
    options: &BakeOptions,
    keys: &[Option<ObjectKey>],
    now: &Snapshot,
    store: &Store,
    wanted: &dyn Fn(usize) -> bool,
) -> Result<Vec<Known>, BakeError> {
    let mut snapshots: BTreeMap<Digest, Option<Arc<SceneDiff>>> = BTreeMap::new();
    let mut find = |object: usize, key: &ObjectKey| -> Result<Known, BakeError> {
        let raster = raster(options, object as u32);
        let mut best: Option<KnownPatches> = None;
        for record in store.lookup_all(&key.seen)? {
            let Some((snapshot, seen)) = SeenRecord::decode(record) else { continue };
            let edit = match snapshots.entry(snapshot) {
                Entry::Occupied(edit) => edit.into_mut(),
                Entry::Vacant(missing) => {
                    let records = store.lookup_all(&snapshot)?;
                    let mut whole = records.iter().filter(|record| Snapshot::key_of(&record.data) == snapshot);
                    let then = whole.find_map(|record| Snapshot::decode(&record.data));
                    missing.insert(then.map(|then| Arc::new(SceneDiff::new(&then, now))))
                }
            };
            let Some(edit) = edit.clone() else { continue };
            let touched: Vec<bool> = seen.patches.par_iter().map(|patch| patch.reach.is_touched(&edit.changes, raster)).collect();
            let count = |touched: &[bool]| touched.iter().filter(|touched| **touched).count();
            if best.as_ref().is_none_or(|best| count(&touched) < count(&best.touched)) {
                best = Some(KnownPatches { seen, touched, visibility: Vec::new(), edit, chunks: None });
            }
        }
        let Some(mut best) = best else { return Ok(Known::Nothing) };
        let n_patches = best.seen.patches.len();
        let records = store.lookup_all(&key.chunks(&best.seen.state()))?;
        best.chunks = records.into_iter().find_map(|record| ObjectChunks::decode(record, n_patches));
        let is_touched = best.touched.contains(&true);
        Ok(match &best.chunks {
            Some(chunks) if !is_touched => Known::Whole(Box::new(chunks.object(scene, options, object, &best.seen)), chunks.counts),
            _ => Known::Patches(Box::new(best)),
        })
    };
    let known = keys.iter().enumerate().map(|(object, key)| match key {
        Some(key) if wanted(object) => find(object, key),
        _ => Ok(Known::Nothing),
    });
    known.collect()
}

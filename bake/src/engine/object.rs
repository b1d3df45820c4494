//! Whole objects of an earlier bake, taken over without planning them again.
//!
//! ```text
//! object key   = H(versions, face resolution, shades of gray, knobs, transform, base mesh, materials, digests of their textures)
//! record       chunks: base, mesh, per patch points, surface, visibility
//!              data:   version u8, layers u8, counts 4 u32, key of the snapshot 32, then per patch:
//!                      points u16, bounds of the origins 6 f32, reach f64, per layer open cells 6 u64
//! ```
//!
//! The key covers all that an object's own points, mesh and surfaces come from; the record says what its bits and its buried points
//! could depend on besides. The object is as it was if no piece that is new or gone since the record's [`Snapshot`]
//!
//! - reaches, from the origins of one of its patches, a cell that the layers before the piece's own left open, or
//! - lies within the reach of the rays that told the patch's buried points.
//!
//! That is what keys of tiles ask too ([`super::patch`]), with the box of the patch in the place of its points: never less careful.
//! Bits decide where edges at leaks are split, so with the bits all patches stand. Records are a cache: without them the bits are the same.

use crate::bake::BakeOptions;
use crate::error::BakeError;
use crate::plan::PointParams;
use crate::plan::key::Hasher;
use crate::plan::patch::PATCH_ORDER;
use crate::plan::shaft::{Bounds, Raster, reached_cells};
use crate::plan::snapshot::{Snapshot, SnapshotPiece};
use crate::scene::Scene;
use crate::seal::base_chunk;
use prelight_manifests::asset::{AssetObject, AssetPatch};
use prelight_manifests::quality::Shades;
use prelight_manifests::{ChunkKind, Descriptor, Digest};
use prelight_store::{MAX_RECORD_DATA, Record, Store};
use rayon::prelude::*;
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};

const VERSION: u8 = 1;

/// What a patch depends on beside its own object.
#[derive(Clone, Debug, PartialEq)]
pub struct PatchReach {
    /// Bounds of the ray origins.
    pub origins: Bounds,
    /// `[layers][faces]` cells that were open, to some point, before the layer.
    pub open: Vec<[u64; 6]>,
    /// Metres from the origins within which lies what told its buried points; below 0 where no point was asked.
    pub buried: f64,
}

impl PatchReach {
    fn is_touched_by(&self, piece: &SnapshotPiece, raster: Raster) -> bool {
        let Some(open) = self.open.get(usize::from(piece.layer)) else { return true };
        let blocks = |face: usize| open[face] != 0 && reached_cells(face, &piece.bounds, &self.origins, raster) & open[face] != 0;
        piece.bounds.distance(&self.origins) <= self.buried || (0..6).any(blocks)
    }
}

/// Counts that a report gives of an object.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ObjectCounts {
    /// Refined triangles.
    pub triangles: u32,
    /// Points inside other solids.
    pub buried: u32,
    /// Points added at leaks.
    pub split: u32,
    /// Tiles above the horizon of some point.
    pub live: u32,
}

/// A finished object, as it is recorded.
pub struct ObjectRecord<'a> {
    /// What the manifest says.
    pub object: &'a AssetObject,
    /// What the report says.
    pub counts: ObjectCounts,
    /// One per patch.
    pub reaches: &'a [PatchReach],
}

impl ObjectRecord<'_> {
    /// As a record of the ledger; `None` where it would be too long for one.
    pub fn encode(&self, snapshot: &Digest) -> Option<Record> {
        let layers = self.reaches.first().map_or(0, |reach| reach.open.len());
        let mut data = vec![VERSION, layers as u8];
        let ObjectCounts { triangles, buried, split, live } = self.counts;
        [triangles, buried, split, live].iter().for_each(|count| data.extend_from_slice(&count.to_le_bytes()));
        data.extend_from_slice(&snapshot.0);
        for (patch, reach) in self.object.patches.iter().zip(self.reaches) {
            data.extend_from_slice(&(patch.n_points as u16).to_le_bytes());
            data.extend_from_slice(&reach.origins.to_le_bytes());
            data.extend_from_slice(&reach.buried.to_le_bytes());
            reach.open.as_flattened().iter().for_each(|cells| data.extend_from_slice(&cells.to_le_bytes()));
        }
        let patches = self.object.patches.iter().flat_map(|patch| [&patch.points, &patch.surface, &patch.visibility]);
        let chunks = [&self.object.base, &self.object.mesh].into_iter().chain(patches).cloned().collect();
        (data.len() <= MAX_RECORD_DATA).then_some(Record { chunks, data })
    }
}

/// A record, read.
struct Parsed {
    counts: ObjectCounts,
    snapshot: Digest,
    base: Descriptor,
    mesh: Descriptor,
    patches: Vec<AssetPatch>,
    reaches: Vec<PatchReach>,
}

/// `None` where it is no record of an object.
fn parse(record: Record) -> Option<Parsed> {
    let (&[version, layers], rest) = record.data.split_first_chunk::<2>()?;
    let (counts, rest) = rest.split_first_chunk::<16>()?;
    let (snapshot, rest) = rest.split_first_chunk::<32>()?;
    let patch_bytes = 2 + 24 + 8 + 48 * usize::from(layers);
    let mut chunks = record.chunks.into_iter();
    let (base, mesh) = (chunks.next()?, chunks.next()?);
    let fits = version == VERSION && rest.len() % patch_bytes == 0 && chunks.len() == rest.len() / patch_bytes * 3;
    if !fits || base.kind != ChunkKind::Base || mesh.kind != ChunkKind::Mesh {
        return None;
    }
    let (mut patches, mut reaches) = (Vec::new(), Vec::new());
    for bytes in rest.chunks_exact(patch_bytes) {
        let (n_points, bytes) = bytes.split_first_chunk::<2>()?;
        let (origins, bytes) = bytes.split_first_chunk::<24>()?;
        let (buried, open) = bytes.split_first_chunk::<8>()?;
        let open = open.as_chunks::<48>().0.iter();
        let cells = |bytes: &[u8; 48]| std::array::from_fn(|face| u64::from_le_bytes(std::array::from_fn(|i| bytes[8 * face + i])));
        reaches.push(PatchReach {
            origins: Bounds::from_le_bytes(origins),
            open: open.map(cells).collect(),
            buried: f64::from_le_bytes(*buried),
        });
        let (points, surface, visibility) = (chunks.next()?, chunks.next()?, chunks.next()?);
        let kinds = [points.kind, surface.kind, visibility.kind];
        let n_points = u32::from(u16::from_le_bytes(*n_points));
        if kinds != [ChunkKind::Points, ChunkKind::Surface, ChunkKind::Visibility] || !(1..=256).contains(&n_points) {
            return None;
        }
        patches.push(AssetPatch { n_points, points, surface, visibility, transfer: None });
    }
    let count = |k: usize| u32::from_le_bytes(std::array::from_fn(|i| counts[4 * k + i]));
    let counts = ObjectCounts { triangles: count(0), buried: count(1), split: count(2), live: count(3) };
    Some(Parsed { counts, snapshot: Digest(*snapshot), base, mesh, patches, reaches })
}

/// An object that needs no work.
pub struct KnownObject {
    /// What the manifest says.
    pub object: AssetObject,
    /// What the report says.
    pub counts: ObjectCounts,
}

/// `[objects]` keys of those that are `wanted`; the others get zeros.
pub fn object_keys(scene: &Scene, options: &BakeOptions, wanted: &(dyn Fn(usize) -> bool + Sync)) -> Vec<Digest> {
    let objects = || (0..scene.objects.len()).filter(|object| wanted(*object));
    let primitives = objects().flat_map(|object| &scene.objects[object].mesh.primitives);
    let materials = primitives.filter_map(|primitive| scene.materials.get(primitive.material as usize));
    let used: BTreeSet<u32> = materials.flat_map(|material| material.textures()).map(|reference| reference.texture).collect();
    let digest = |texture: u32| Some((texture, *blake3::hash(&scene.textures.get(texture as usize)?.to_chunk()).as_bytes()));
    let textures: BTreeMap<u32, [u8; 32]> = used.into_par_iter().filter_map(digest).collect();
    let key = |object: usize| if wanted(object) { object_key(scene, options, object, &textures) } else { Digest([0; 32]) };
    (0..scene.objects.len()).into_par_iter().map(key).collect()
}

fn object_key(scene: &Scene, options: &BakeOptions, object: usize, textures: &BTreeMap<u32, [u8; 32]>) -> Digest {
    // Named one by one: a new knob must find its way into the key.
    let PointParams { edge_length, normal_angle_deg, area_floor, max_level, coarser, max_triangles } = options.points[object];
    let source = &scene.objects[object];
    let mut hasher = Hasher::new("prelight object");
    let shades = options.visibility.steps().unwrap_or(0);
    hasher.words(&[options.face_resolution, shades, max_level, max_triangles, u32::from(coarser), PATCH_ORDER]);
    hasher.floats(&[edge_length, normal_angle_deg, area_floor]);
    source.world_from_local.iter().for_each(|value| hasher.bytes(&value.to_le_bytes()));
    let base = base_chunk(&source.mesh);
    hasher.bytes(&(base.len() as u64).to_le_bytes());
    hasher.bytes(&base);
    for primitive in &source.mesh.primitives {
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

/// `[objects]` those of an earlier bake that nothing has touched since, by their keys; only those that are `wanted`.
///
/// # Errors
/// What the store says.
pub fn known_objects(
    scene: &Scene,
    options: &BakeOptions,
    keys: &[Digest],
    now: &Snapshot,
    store: &Store,
    wanted: &(dyn Fn(usize) -> bool + Sync),
) -> Result<Vec<Option<KnownObject>>, BakeError> {
    let mut snapshots: BTreeMap<Digest, Option<Vec<SnapshotPiece>>> = BTreeMap::new();
    let raster = Raster { face_resolution: options.face_resolution as usize, in_part: options.visibility != Shades::Binary };
    let mut find = |object: usize| -> Result<Option<KnownObject>, BakeError> {
        for record in store.lookup_all(&keys[object])? {
            let Some(parsed) = parse(record) else { continue };
            let changes = match snapshots.entry(parsed.snapshot) {
                Entry::Occupied(changes) => changes.into_mut(),
                Entry::Vacant(missing) => {
                    let records = store.lookup_all(&parsed.snapshot)?;
                    let then =
                        records.iter().find_map(|record| Snapshot::decode(&record.data).filter(|then| then.key() == parsed.snapshot));
                    missing.insert(then.map(|then| then.changes(now)))
                }
            };
            let Some(changes) = changes else { continue };
            let touched = |reach: &PatchReach| changes.iter().any(|piece| reach.is_touched_by(piece, raster));
            if !parsed.reaches.par_iter().any(touched) {
                return Ok(Some(known(scene, options, object, parsed)));
            }
        }
        Ok(None)
    };
    (0..scene.objects.len()).map(|object| if wanted(object) { find(object) } else { Ok(None) }).collect()
}

fn known(scene: &Scene, options: &BakeOptions, object: usize, parsed: Parsed) -> KnownObject {
    let source = &scene.objects[object];
    let Parsed { counts, base, mesh, patches, .. } = parsed;
    let object = AssetObject {
        name: source.name.clone(),
        technique: "block_product".to_string(),
        n_points: patches.iter().map(|patch| patch.n_points).sum(),
        n_triangles: counts.triangles,
        base,
        world_from_local: source.world_from_local,
        edge_length: options.points[object].edge_length,
        mesh,
        patches,
    };
    KnownObject { object, counts }
}

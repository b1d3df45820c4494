//! An edit: what blocks light in one of two bakes only, cut into trees of its own, so that a patch asks these and not the whole scene.
//!
//! ```text
//! new    triangles of the scene inside a piece that only the later bake has
//! gone   triangles of the earlier bake's objects inside a piece that only it has: its base chunks, placed as they were then
//! ```
//!
//! Both may hold more than what really changed. Of what is new, too much is no harm: it is there. Of what is gone, too much only asks a
//! texel again; cut-outs are taken as solid. Where a chunk of what is gone is not in the store any more, the boxes of its pieces stand for
//! the triangles ([`crate::block_product::visibility::delta`]).

use crate::reach::pieces::Pieces;
use crate::reach::shaft::Bounds;
use crate::reach::snapshot::{Changes, Snapshot, SnapshotPiece};
use crate::trace::{OccluderOptions, Occluders};
use prelight_manifests::{Descriptor, Digest};
use prelight_runtime::asset::base;
use prelight_scene::world::World;
use prelight_scene::{Mesh, Object, Primitive, Scene};
use prelight_store::{ChunkSource, Store};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, OnceLock};

/// What was done to a scene since a bake.
#[derive(Debug, Default)]
pub(crate) struct SceneDiff {
    /// Pieces that only one of the two has.
    pub changes: Changes,
    /// Objects that pieces which are gone belonged to, with the bounds of those pieces; `None` where one is not known.
    gone: Option<Vec<RemovedObject>>,
    traced: OnceLock<EditOccluders>,
}

/// An object as it was.
#[derive(Clone, Debug)]
struct RemovedObject {
    base: Descriptor,
    world_from_local: [f64; 16],
    bounds: Vec<Bounds>,
}

/// The same, ready to be traced.
#[derive(Debug)]
pub(crate) struct EditOccluders {
    /// What is new: ids are those of the scene.
    pub new: Occluders,
    /// What is gone: ids mean nothing. `None` where it cannot be had.
    pub gone: Option<Occluders>,
}

impl SceneDiff {
    /// From one snapshot to another.
    pub(crate) fn new(then: &Snapshot, now: &Snapshot) -> SceneDiff {
        let changes = then.changes(now);
        let mut gone: BTreeMap<(Digest, [u64; 16]), RemovedObject> = BTreeMap::new();
        let mut add = |piece: &SnapshotPiece| {
            let source = then.source(piece)?;
            let placed = source.world_from_local.map(f64::to_bits);
            let new = || RemovedObject { base: source.base.clone(), world_from_local: source.world_from_local, bounds: Vec::new() };
            gone.entry((source.base.digest, placed)).or_insert_with(new).bounds.push(piece.bounds);
            Some(())
        };
        let all_known = changes.gone.iter().all(|piece| add(piece).is_some());
        SceneDiff { changes, gone: all_known.then(|| gone.into_values().collect()), traced: OnceLock::new() }
    }

    /// Cuts the trees, once.
    pub(crate) fn prepare(&self, scene: &Scene, world: &World, pieces: &Pieces, options: OccluderOptions, store: &Store) {
        self.traced.get_or_init(|| EditOccluders {
            new: self.new_occluders(scene, world, pieces, options),
            gone: self.gone.as_ref().and_then(|gone| gone_occluders(gone, options, store)),
        });
    }

    /// What [`SceneDiff::prepare`] cut.
    pub(crate) fn occluders(&self) -> Option<&EditOccluders> {
        self.traced.get()
    }

    fn new_occluders(&self, scene: &Scene, world: &World, pieces: &Pieces, options: OccluderOptions) -> Occluders {
        let fresh: BTreeSet<[u8; 24]> = self.changes.new.iter().map(|piece| piece.bounds.to_le_bytes()).collect();
        let mut of_object: BTreeMap<u32, Vec<Bounds>> = BTreeMap::new();
        for piece in pieces.pieces.iter().filter(|piece| fresh.contains(&piece.bounds.to_le_bytes())) {
            of_object.entry(piece.object).or_default().push(piece.bounds);
        }
        let ids = of_object.iter().flat_map(|(object, bounds)| {
            let range = world.object_start[*object as usize]..world.object_start[*object as usize + 1];
            range.filter(|id| holds(bounds, &world.positions[*id as usize]))
        });
        Occluders::build_of(world, &scene.textures, options, ids.collect())
    }
}

/// Whether one of the boxes holds a triangle.
fn holds(boxes: &[Bounds], corners: &[[f32; 3]; 3]) -> bool {
    let inside = |bounds: &Bounds, p: &[f32; 3]| (0..3).all(|axis| bounds.lower[axis] <= p[axis] && p[axis] <= bounds.upper[axis]);
    boxes.iter().any(|bounds| corners.iter().all(|corner| inside(bounds, corner)))
}

/// `None` where a chunk is not there or not whole.
fn gone_occluders(gone: &[RemovedObject], options: OccluderOptions, store: &Store) -> Option<Occluders> {
    let mut scene = Scene::default();
    for object in gone {
        let chunk = store.chunk(&object.base).ok()?;
        let primitives = base::from_chunk(&chunk).ok()?;
        let primitives = primitives.iter().map(|primitive| Primitive {
            positions: primitive.positions.to_vec(),
            triangles: primitive.triangles.to_vec(),
            ..Primitive::default()
        });
        let mesh = Arc::new(Mesh { primitives: primitives.collect() });
        scene.objects.push(Object { name: String::new(), mesh, world_from_local: object.world_from_local });
    }
    scene.materials.push(Default::default());
    let world = World::build(&scene);
    let ids = gone.iter().enumerate().flat_map(|(at, object)| {
        let world = &world;
        let range = world.object_start[at]..world.object_start[at + 1];
        range.filter(move |id| holds(&object.bounds, &world.positions[*id as usize]))
    });
    Some(Occluders::build_of(&world, &[], options, ids.collect()))
}

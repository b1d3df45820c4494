//! What a bake would trace, without tracing: the patches of every object as far as planning alone knows them, looked up in a store.
//!
//! Objects that an earlier bake knows are asked by what their patches saw ([`crate::reach::seen`]): a tile is stale where a piece that is
//! new or gone reaches one of its open cells. That is at most what a bake traces again. Of others the keys of tiles are looked up: exact for
//! the first layer that misses a tile; what later layers would find is not needed to say that the tile is stale. Patches that refinement at
//! leaks would add to those are not counted: whether they change is known only once their neighbours are traced.

use crate::block_product::visibility::patch::{PatchInputs, Shadowing, candidates, stale_tiles};
use crate::error::BakeError;
use crate::options::BakeOptions;
use crate::points::plan_object;
use crate::progress::{Progress, check};
use crate::reach::changes::StalePatch;
use crate::reach::layer::{MAX_LAYERS, layers};
use crate::reach::pieces::Pieces;
use crate::reach::shaft::Bounds;
use crate::reach::tile::{N_TILES, TileSet, TileTable};
use crate::reuse::object::{Known, known_objects, object_keys, raster, snapshot};
use crate::trace::Occluders;
use prelight_scene::Scene;
use prelight_scene::world::World;
use prelight_store::Store;
use rayon::prelude::*;

/// What is stale.
#[derive(Clone, Debug, Default)]
pub struct Stale {
    /// Patches looked at.
    pub patches: u64,
    /// Their live tiles.
    pub live: u64,
    /// Live tiles that are to be traced.
    pub tiles: u64,
    /// Points times the share of their live tiles to trace: what time goes with.
    pub points: f64,
    /// Patches with a tile to trace.
    pub stale: Vec<StalePatch>,
}

impl Stale {
    /// Counts a patch.
    fn add(&mut self, object: usize, (origins, n_points): (Bounds, u32), live: TileSet, tiles: TileSet, is_new: bool) {
        self.patches += 1;
        self.live += u64::from(live.count_ones());
        self.tiles += u64::from(tiles.count_ones());
        self.points += f64::from(n_points) * f64::from(tiles.count_ones()) / f64::from(live.count_ones().max(1));
        if tiles != 0 || is_new {
            self.stale.push(StalePatch { object: object as u32, origins, tiles, is_new });
        }
    }
}

/// Looks all patches up. Objects that the options leave out are not looked at.
pub fn find_stale(scene: &Scene, world: &World, options: &BakeOptions, store: &Store, progress: &dyn Progress) -> Result<Stale, BakeError> {
    let pieces = Pieces::build(scene, world, &layers(scene, world, &options.rebake.layers), MAX_LAYERS);
    let nothing = Occluders::default();
    let of = Shadowing { pieces: &pieces, occluders: &nothing, face_resolution: options.face_resolution, shades: &options.visibility };
    let wanted = |object: usize| options.rebake.wants(object);
    let keys = object_keys(scene, world, &pieces, options, &wanted);
    let is_direct = |object: usize| options.technique_of(object as u32).is_none();
    let known = known_objects(scene, options, &keys, &snapshot(&pieces, &keys), store, &is_direct)?;
    let of_object = |object: usize| -> Result<Stale, BakeError> {
        check(progress)?;
        match &known[object] {
            Known::Nothing => {}
            Known::Whole(made, counts) => {
                return Ok(Stale { patches: made.patches.len() as u64, live: u64::from(counts.live), ..Stale::default() });
            }
            Known::Patches(known) => {
                let (mut found, raster) = (Stale::default(), raster(options, object as u32));
                for (patch, touched) in known.seen.patches.iter().zip(&known.touched) {
                    let tiles = if *touched { patch.reach.stale(&known.edit.changes, raster) } else { 0 };
                    found.add(object, (patch.reach.origins, patch.n_points), patch.reach.live(), tiles, false);
                }
                return Ok(found);
            }
        }
        let plan = plan_object(scene, world, object, &options.points[object])?;
        let mut found = Stale::default();
        for patch in &plan.patches {
            let inputs = PatchInputs::new(&of, &plan, patch);
            let tables: Vec<TileTable> = candidates(store, &inputs)?.into_iter().map(|candidate| candidate.row).collect();
            let (live, missed) = stale_tiles(&of, &inputs, &tables);
            let is_new = tables.is_empty();
            let tiles = if is_new { live } else { missed };
            found.add(object, (inputs.origins.patch, patch.n_points), live, tiles, is_new);
        }
        Ok(found)
    };
    let objects = (0..scene.objects.len()).into_par_iter().filter(|object| wanted(*object));
    let objects: Vec<Stale> = objects.map(of_object).collect::<Result<_, _>>()?;
    let mut all = Stale::default();
    for object in objects {
        all.patches += object.patches;
        all.live += object.live;
        all.tiles += object.tiles;
        all.points += object.points;
        all.stale.extend(object.stale);
    }
    debug_assert!(all.tiles <= all.patches * N_TILES as u64);
    Ok(all)
}

//! Counts and times of a bake.

use crate::block_product::visibility::baker::Traced;
use crate::bounces::BounceWork;
use crate::budget::ObjectError;
use crate::factor::Tally;
use crate::reach::changes::StalePatch;
use crate::reuse::object::ObjectCounts;
use prelight_manifests::asset::AssetObject;
use std::collections::BTreeMap;
use std::time::Instant;

/// Counts and times of a bake.
#[derive(Clone, Debug, Default)]
pub struct BakeStats {
    /// Points of all objects.
    pub points: u64,
    /// Points inside other solids.
    pub buried: u64,
    /// Refined triangles.
    pub triangles: u64,
    /// Patches of all objects.
    pub patches: u64,
    /// Patches of which a tile was traced; the rest came from the store whole.
    pub patches_traced: u64,
    /// Tiles: what was taken, what was traced.
    pub tiles: TileStats,
    /// Patches of which a tile was traced, and where they lie: what reasons are found from.
    pub stale: Vec<StalePatch>,
    /// Points added because neighbours saw different things.
    pub points_split: u64,
    /// Counts of the factors that techniques add to visibility, by the technique's name.
    pub tallies: BTreeMap<String, Tally>,
    /// Rays of bounced light: cast by this bake, and all of them where any were looked at.
    pub bounce_rays: [u64; 2],
    /// Points of objects that were worked on, not taken over whole from an earlier bake.
    pub points_made: u64,
    /// Plain bytes of all chunks that the asset names, each once.
    pub bytes_resident: u64,
    /// Bytes that this bake added to the store.
    pub bytes_stored: u64,
    /// Fields of objects that move: traced.
    pub fields_made: u64,
    /// Fields that the store had.
    pub fields_known: u64,
    /// Errors between points, per object, where they were measured.
    pub errors: Vec<ObjectError>,
    /// Seconds per stage, in order.
    pub seconds: Vec<(&'static str, f64)>,
}

impl BakeStats {
    pub(super) fn count(&mut self, object: &AssetObject, counts: &ObjectCounts) {
        self.points += u64::from(object.n_points);
        self.buried += u64::from(counts.buried);
        self.triangles += u64::from(counts.triangles);
        self.patches += object.patches.len() as u64;
        self.points_split += u64::from(counts.split);
    }

    /// Counts what links took.
    pub(super) fn count_bounces(&mut self, work: &BounceWork) {
        self.bytes_stored += work.bytes_stored;
        self.bounce_rays = [work.rays_cast, work.rays];
    }

    /// Adds what the bake of an object alone counted.
    pub(super) fn absorb(&mut self, own: BakeStats) {
        for (sum, count) in [
            (&mut self.points, own.points),
            (&mut self.buried, own.buried),
            (&mut self.triangles, own.triangles),
            (&mut self.patches, own.patches),
            (&mut self.patches_traced, own.patches_traced),
            (&mut self.points_split, own.points_split),
            (&mut self.points_made, own.points_made),
            (&mut self.bytes_stored, own.bytes_stored),
            (&mut self.fields_made, own.fields_made),
            (&mut self.fields_known, own.fields_known),
        ] {
            *sum += count;
        }
        self.tiles.absorb(&own.tiles);
        self.errors.extend(own.errors);
    }

    /// A count of a technique's factors; 0 where nothing was counted.
    pub fn tally(&self, technique: &str, name: &str) -> u64 {
        self.tallies.get(technique).map_or(0, |tally| tally.of(name))
    }

    /// Counts an object that needs no work.
    pub(super) fn take(&mut self, object: AssetObject, counts: &ObjectCounts) -> AssetObject {
        self.count(&object, counts);
        self.tiles.live += u64::from(counts.live);
        self.tiles.known += u64::from(counts.live);
        object
    }
}

/// What became of tiles. A tile is a 96th of the directions of one patch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TileStats {
    /// Above the horizon of some point.
    pub live: u64,
    /// Live tiles of patches that no record knew.
    pub new: u64,
    /// Tiles of patches that a record knew, traced because something that reaches them is not as it was.
    pub redone: u64,
    /// Tiles among those whose bits really changed.
    pub changed: u64,
    /// Live tiles of patches that a record knew.
    pub known: u64,
    /// Made by this bake: all 96 of a new patch, the redone ones of others.
    pub traced: u64,
}

impl TileStats {
    fn absorb(&mut self, own: &TileStats) {
        let TileStats { live, new, redone, changed, known, traced } = *own;
        (self.live, self.new, self.redone) = (self.live + live, self.new + new, self.redone + redone);
        (self.changed, self.known, self.traced) = (self.changed + changed, self.known + known, self.traced + traced);
    }

    pub(super) fn add(&mut self, result: &Traced) {
        let live = u64::from(result.live.count_ones());
        self.live += live;
        if result.is_new {
            self.new += live;
            self.traced += crate::reach::tile::N_TILES as u64;
        } else {
            self.known += live;
            self.redone += u64::from(result.redone.count_ones());
            self.traced += u64::from(result.redone.count_ones());
            self.changed += u64::from(result.changed.count_ones());
        }
    }
}

/// Seconds per stage; a stage that comes again adds up.
pub(super) struct Clock {
    last: Instant,
    pub laps: Vec<(&'static str, f64)>,
}

impl Default for Clock {
    fn default() -> Self {
        Clock { last: Instant::now(), laps: Vec::new() }
    }
}

impl Clock {
    pub(crate) fn lap(&mut self, stage: &'static str) {
        let now = Instant::now();
        let seconds = (now - self.last).as_secs_f64();
        self.last = now;
        match self.laps.iter_mut().find(|(name, _)| *name == stage) {
            Some((_, sum)) => *sum += seconds,
            None => self.laps.push((stage, seconds)),
        }
    }
}

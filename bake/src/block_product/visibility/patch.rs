//! One patch: which of its tiles hold, and what the others are.
//!
//! ```text
//! open = cells above the horizon
//! for each layer, big things first:
//!     pieces of the layer that reach an open cell -> a key a tile
//!     a record of the same points has the key: its result is taken, nothing is traced
//!     else: the tile's bits are traced by this layer (and, if they were not at hand, by the layers before it)
//! bits of tiles that held are copied out of a record whose final bits have the same name
//! ```
//!
//! A layer's key holds the bits that the layer before left, not what made them: a lamp moved behind a wall stops at the wall.
//! Records are only ever a cache: with none at hand every tile is traced, and the bits are the same.

use crate::block_product::visibility::bits::PatchBits;
use crate::error::BakeError;
use crate::factor::{Candidate, LoadChunk};
use crate::points::{ObjectPlan, Patch};
use crate::reach::key::{points_key, tile_key};
use crate::reach::pieces::Pieces;
use crate::reach::shaft::{OriginBoxes, Raster};
use crate::reach::tile::{CLOSED, HORIZON, N_TILES, OpenCells, Reach, TileRow, TileSet, TileTable, tiles};
use crate::trace::Occluders;
use prelight_manifests::Digest;
use prelight_manifests::quality::Shades;
use prelight_runtime::block_product::visibility::Visibility;
use prelight_store::{Chunk, Record, Store};

/// What blocks light, cut for keys and ready to be traced.
#[derive(Clone, Copy)]
pub struct Shadowing<'a> {
    /// For keys.
    pub pieces: &'a Pieces,
    /// The same triangles; one tree a layer.
    pub occluders: &'a Occluders,
    /// Texels along a cubemap face's side.
    pub face_resolution: u32,
    /// One per object: binary, or how many shades of gray. May be shorter: the others are binary.
    pub shades: &'a [Shades],
}

impl Shadowing<'_> {
    /// What the shafts of an object's patches need to know of the tracer.
    pub(crate) fn raster(&self, object: u32) -> Raster {
        Raster::new(self.face_resolution, shades_of(self.shades, object))
    }

    /// Steps of an object's grayscale; `None` of binary.
    pub(crate) fn steps(&self, object: u32) -> Option<u32> {
        shades_of(self.shades, object).steps()
    }
}

/// An object's shades in a list that may be shorter than the objects are many: the others are binary.
pub(crate) fn shades_of(visibility: &[Shades], object: u32) -> Shades {
    visibility.get(object as usize).copied().unwrap_or_default()
}

/// A patch about to be looked up.
pub struct PatchInputs<'a> {
    /// Its object.
    pub plan: &'a ObjectPlan,
    /// The patch.
    pub patch: &'a Patch,
    /// Name of its points in the ledger.
    pub key: Digest,
    /// Where its rays start.
    pub origins: OriginBoxes,
}

impl<'a> PatchInputs<'a> {
    /// Hashes the points.
    pub fn new(of: &Shadowing, plan: &'a ObjectPlan, patch: &'a Patch) -> Self {
        let key = points_key(of.pieces, of.face_resolution, of.steps(plan.object), patch.range().map(|point| plan.trace_origin(point)));
        let origins = OriginBoxes::new(plan.origin[patch.range()].iter().copied());
        PatchInputs { plan, patch, key, origins }
    }
}

/// Records of a patch's points in a store, perhaps among other occluders.
///
/// # Errors
/// What the store says.
pub fn candidates(store: &Store, inputs: &PatchInputs) -> Result<Vec<Candidate<TileTable>>, BakeError> {
    let candidate = |record: Record| {
        let [descriptor] = <[_; 1]>::try_from(record.chunks).ok()?;
        Some(Candidate { row: TileTable::decode(&record.data, inputs.origins.boxes.len())?, descriptor })
    };
    Ok(store.lookup_all(&inputs.key)?.into_iter().filter_map(candidate).collect())
}

/// What became of a patch.
pub struct Resolved {
    /// Keys as they are now.
    pub table: TileTable,
    /// Tiles above the horizon of some point.
    pub live: TileSet,
    /// `[layers]` cells that were open before each.
    pub open: Vec<[u64; 6]>,
    /// Tiles that were traced.
    pub redone: TileSet,
    /// Tiles among those whose bits no candidate has; none where there was no candidate.
    pub changed: TileSet,
    /// The candidate whose chunk is this patch's, if there is one, and the chunk; else the bits are in [`PatchBits`].
    pub same: Option<(usize, Chunk)>,
}

/// How looking a patch up ended.
pub enum Resolution {
    /// It is known.
    Done(Resolved),
    /// The chunk of this candidate is of no use: try again without it.
    Unusable(usize),
}

/// The walk over the layers, without bits.
struct LayerLookup<'a> {
    of: &'a Shadowing<'a>,
    inputs: &'a PatchInputs<'a>,
    open: OpenCells,
    /// What was open before each layer so far.
    before: Vec<[u64; 6]>,
    names: [[u8; 16]; N_TILES],
    /// Bit k: pieces of layer k reach the tile.
    reached: [u8; N_TILES],
    rows: Vec<TileRow>,
}

impl<'a> LayerLookup<'a> {
    fn new(of: &'a Shadowing<'a>, inputs: &'a PatchInputs<'a>) -> Self {
        let open = OpenCells::above_horizon(&inputs.plan.normal[inputs.patch.range()], of.face_resolution as usize);
        LayerLookup { of, inputs, open, before: Vec::new(), names: [HORIZON; N_TILES], reached: [0; N_TILES], rows: Vec::new() }
    }

    /// Looks a layer's tiles up, but for those of `skip`; returns those that no candidate knows, with their keys in `keys`.
    fn layer<'c>(
        &mut self,
        layer: usize,
        skip: TileSet,
        tables: impl Iterator<Item = &'c TileTable> + Clone,
        keys: &mut [[u8; 16]; N_TILES],
    ) -> (TileSet, TileSet) {
        self.before.push(*self.open.faces());
        let reach = Reach::new(self.of.pieces, layer, &self.inputs.origins, &self.open, self.of.raster(self.inputs.plan.object));
        let (mut missed, mut bits_changed) = (0, 0);
        for tile in tiles(reach.tiles & !skip) {
            let at = usize::from(tile);
            let (sum, count) = reach.of(tile);
            let key = tile_key(&self.inputs.key, tile, &self.names[at], sum, count);
            self.reached[at] |= 1 << layer;
            keys[at] = key;
            match tables.clone().find_map(|table| table.tile(tile).iter().find(|row| row.key == key)) {
                Some(row) => {
                    bits_changed |= TileSet::from(self.names[at] != row.name) << tile;
                    self.settle(*row);
                }
                None => missed |= 1 << tile,
            }
        }
        self.open.settle();
        (missed, bits_changed)
    }

    fn settle(&mut self, row: TileRow) {
        self.names[usize::from(row.tile)] = row.name;
        self.open.set_tile(row.tile, row.cells);
        self.rows.push(row);
    }
}

/// Tiles that would be traced, as far as that can be said without tracing: (live, stale). Tiles that a layer misses are not followed
/// to the next: their share of what is stale is certain, and no other tile depends on them.
pub fn stale_tiles(of: &Shadowing, inputs: &PatchInputs, tables: &[TileTable]) -> (TileSet, TileSet) {
    let mut walk = LayerLookup::new(of, inputs);
    let (live, mut stale) = (walk.open.live(), 0);
    let mut keys = [[0; 16]; N_TILES];
    for layer in 0..of.pieces.n_layers() {
        let (missed, _) = walk.layer(layer, stale, tables.iter(), &mut keys);
        stale |= missed;
    }
    (live, stale)
}

/// Looks up, copies and traces one patch. Of candidates with equal keys the first is used.
///
/// # Errors
/// What reading a chunk says.
pub fn resolve(
    of: &Shadowing,
    inputs: &PatchInputs,
    candidates: &[Candidate<TileTable>],
    load: &LoadChunk,
    bits: &mut PatchBits,
) -> Result<Resolution, BakeError> {
    let mut walk = LayerLookup::new(of, inputs);
    let live = walk.open.live();
    bits.reset(of.face_resolution, of.steps(inputs.plan.object), inputs.patch.n_points as usize);
    // Tiles whose bits in `bits` are those that the layers so far left; those that were traced at all.
    let (mut held, mut redone) = (0, 0);
    let mut keys = [[0; 16]; N_TILES];
    for layer in 0..of.pieces.n_layers() {
        let tables = candidates.iter().map(|candidate| &candidate.row);
        let (missed, bits_changed) = walk.layer(layer, 0, tables, &mut keys);
        held &= !bits_changed;
        if missed == 0 {
            continue;
        }
        trace_up_to(of, inputs, bits, &walk.reached, layer, missed & !held);
        held |= missed;
        redone |= missed;
        let changed = bits.trace(of.occluders, layer, inputs.plan, inputs.patch, missed);
        for tile in tiles(missed) {
            let at = usize::from(tile);
            let (name, cells) = if changed >> tile & 1 == 1 { bits.summarise(tile) } else { (walk.names[at], walk.open.tile(tile)) };
            walk.settle(TileRow { tile, key: keys[at], name, cells });
        }
        walk.open.settle();
    }
    let has_bits = |candidate: &Candidate<TileTable>, tile: u8| candidate.row.final_name(tile) == walk.names[usize::from(tile)];
    let named = |set: TileSet, name: [u8; 16]| only(set, |tile| walk.names[tile] == name);
    let changed = if candidates.is_empty() { 0 } else { redone };
    let changed = only(changed, |tile| !candidates.iter().any(|candidate| has_bits(candidate, tile as u8)));
    let mut same = None;
    if let Some(index) = candidates.iter().position(|candidate| tiles(live).all(|tile| has_bits(candidate, tile))) {
        let Some(chunk) = load(&candidates[index].descriptor)? else { return Ok(Resolution::Unusable(index)) };
        same = Some((index, chunk));
    } else {
        // What held is not at hand: copied where a candidate has it, closed or horizon where the name says so, else traced after all.
        let mut wanted = live & !held;
        let (closed, above) = (named(wanted, CLOSED), named(wanted, HORIZON));
        bits.clear(closed);
        bits.set_horizon(inputs.plan, inputs.patch, above);
        wanted &= !(closed | above);
        for (index, candidate) in candidates.iter().enumerate() {
            let ready = only(wanted, |tile| has_bits(candidate, tile as u8));
            if ready != 0 {
                let Some(chunk) = load(&candidate.descriptor)? else { return Ok(Resolution::Unusable(index)) };
                bits.copy(&Visibility::from_chunk(&chunk)?, ready);
                wanted &= !ready;
            }
        }
        trace_up_to(of, inputs, bits, &walk.reached, of.pieces.n_layers(), wanted);
        redone |= wanted;
    }
    let table = TileTable::new(walk.rows, inputs.origins.boxes.len());
    Ok(Resolution::Done(Resolved { table, live, open: walk.before, redone, changed, same }))
}

/// The tiles of a set for which something holds.
fn only(set: TileSet, holds: impl Fn(usize) -> bool) -> TileSet {
    tiles(set).filter(|tile| holds(usize::from(*tile))).fold(0, |set, tile| set | 1 << tile)
}

/// Traces tiles from the horizon by the layers before `end` that reach them.
fn trace_up_to(of: &Shadowing, inputs: &PatchInputs, bits: &mut PatchBits, reached: &[u8; N_TILES], end: usize, set: TileSet) {
    if set == 0 {
        return;
    }
    bits.set_horizon(inputs.plan, inputs.patch, set);
    for layer in 0..end {
        let touched = only(set, |tile| reached[tile] >> layer & 1 == 1);
        if touched != 0 {
            bits.trace(of.occluders, layer, inputs.plan, inputs.patch, touched);
        }
    }
}

/// A tile of those that held whose bits are not what tracing gives, if there is one among `suspects`: traced from the horizon by all
/// occluders, whatever the shafts say.
pub(crate) fn false_hit(
    of: &Shadowing,
    inputs: &PatchInputs,
    visibility: &Visibility,
    suspects: TileSet,
    bits: &mut PatchBits,
) -> Option<u8> {
    bits.reset(of.face_resolution, of.steps(inputs.plan.object), inputs.patch.n_points as usize);
    bits.set_horizon(inputs.plan, inputs.patch, suspects);
    for layer in 0..of.pieces.n_layers() {
        bits.trace(of.occluders, layer, inputs.plan, inputs.patch, suspects);
    }
    tiles(suspects).find(|tile| !bits.equals(visibility, *tile))
}

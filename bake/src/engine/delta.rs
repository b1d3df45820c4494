//! A patch traced again only where an edit can be seen.
//!
//! ```text
//! for each point, of every piece that is gone or new, of layer k:
//!     R = texels of its rectangle (as the tracer computes it, from this point) in cells that were open before layer k
//!     may open:  R of pieces that are gone, above the horizon, closed until now
//!     may close: R of pieces that are new, open until now
//! trace those texels from scratch, by all layers; every other bit stays
//! ```
//!
//! Exact. A texel's bit is the OR over all triangles of one predicate, which says no outside of a triangle's rectangle. A texel that was open
//! can close only by a triangle that is new; one that was closed can open only if all that covered it is gone, and of that the layer that
//! comes first found its cell open. So the bits are those of a clean bake, whatever the record's open cells hold beyond the truth.
//!
//! Binary visibility only: a level of gray does not say which samples are open.

use super::light::{PatchReach, Touch};
use crate::block_product::visibility::{encode_changed, open_bits};
use crate::plan::shaft::{Bounds, CELLS, Raster, reached_texels};
use crate::plan::tile::{FACE_TILES, TileSet};
use crate::plan::{ObjectPlan, Patch};
use crate::trace::horizon::above_horizon_of_face;
use crate::trace::{Occluders, Scratch};
use prelight_runtime::block_product::visibility::{Visibility, open_words};

/// Working memory of one thread.
#[derive(Default)]
pub struct Delta {
    /// Points that are not as they were, ascending, and their bits.
    changed_points: Vec<usize>,
    open: Vec<u64>,
    /// Of the point at hand, bits as they were; those of faces that no piece reaches are not to be read.
    point: Vec<u64>,
    /// Of one point, `[6, n, n/64]` each: what may open, what may close, and what is being traced.
    opening: Vec<u64>,
    closing: Vec<u64>,
    work: Vec<u64>,
    horizon: Vec<u64>,
    /// Over all points: bits that were traced, and those that are not as they were.
    traced: Vec<u64>,
    changed: Vec<u64>,
    scratch: Scratch,
}

/// What came of tracing again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Retraced {
    /// Tiles of which a texel was traced.
    pub redone: TileSet,
    /// Of those, the ones of which a bit is not as it was.
    pub changed: TileSet,
}

/// A patch as an earlier bake found it, and what may have changed that.
#[derive(Clone, Copy)]
pub struct Before<'a> {
    /// Its bits.
    pub visibility: &'a Visibility<'a>,
    /// Cells that were open before each layer.
    pub reach: &'a PatchReach,
    /// Pieces that its rays may tell.
    pub touches: &'a [Touch],
}

impl Delta {
    /// Brings the bits up to date. They can be encoded afterwards.
    pub fn retrace(&mut self, occluders: &Occluders, plan: &ObjectPlan, patch: &Patch, before: Before) -> Retraced {
        let n = before.visibility.face_resolution();
        let (words, row_words) = (open_words(n), n / 64);
        let face_words = words / 6;
        let raster = Raster { face_resolution: n, in_part: false };
        let faces_touched = before.touches.iter().fold(0, |all, touch| all | touch.faces);
        let has = |set: u8, face: usize| set >> face & 1 == 1;
        for buffer in [&mut self.opening, &mut self.closing, &mut self.work, &mut self.horizon] {
            buffer.clear();
            buffer.resize(words, 0);
        }
        for buffer in [&mut self.traced, &mut self.changed] {
            buffer.clear();
            buffer.resize(words, 0);
        }
        self.open.clear();
        self.changed_points.clear();
        self.point.resize(words, 0);
        let masks = CellRows::new(before.reach, n);
        for (local, point) in patch.range().enumerate() {
            let at = Bounds::at(plan.origin[point]);
            let (mut may_open, mut may_close) = (0u8, 0u8);
            for face in (0..6).filter(|face| has(faces_touched, *face)) {
                self.opening[face_words * face..face_words * (face + 1)].fill(0);
                self.closing[face_words * face..face_words * (face + 1)].fill(0);
            }
            for touch in before.touches {
                for face in (0..6).filter(|face| has(touch.faces, *face)) {
                    let Some([x, y]) = reached_texels(face, &touch.bounds, &at, raster) else { continue };
                    let (rows, set) = if touch.is_new { (&mut self.closing, &mut may_close) } else { (&mut self.opening, &mut may_open) };
                    *set |= 1 << face;
                    for row in y[0]..=y[1] {
                        let cells = masks.row(touch.layer, face, row as usize);
                        for (word, cells) in cells.iter().enumerate() {
                            rows[face_words * face + row as usize * row_words + word] |= span(x, word) & cells;
                        }
                    }
                }
            }
            let touched = may_open | may_close;
            if touched == 0 {
                continue;
            }
            let own = before.visibility.point(local);
            open_bits(&own, n, touched, &mut self.point);
            let mut asked = 0u8;
            for face in (0..6).filter(|face| has(touched, *face)) {
                let of_face = face_words * face..face_words * (face + 1);
                if has(may_open, face) {
                    above_horizon_of_face(plan.normal[point], n, face, &mut self.horizon[of_face.clone()]);
                }
                let mut any = 0;
                for word in of_face {
                    let up = if has(may_open, face) { self.opening[word] & self.horizon[word] & !self.point[word] } else { 0 };
                    let work = up | self.closing[word] & self.point[word];
                    self.work[word] = work;
                    self.traced[word] |= work;
                    any |= work;
                }
                asked |= u8::from(any != 0) << face;
            }
            if asked == 0 {
                continue;
            }
            let faces = || (0..6).filter(|face| has(asked, *face));
            let asked_words = || faces().flat_map(|face| face_words * face..face_words * (face + 1));
            // What was to be traced, kept beside what is left of it.
            asked_words().for_each(|word| self.horizon[word] = self.work[word]);
            occluders.close_covered_on(faces(), &plan.trace_origin(point), n, &mut self.scratch, &mut self.work);
            let differs = |word: usize| (self.point[word] & self.horizon[word]) ^ self.work[word];
            if asked_words().all(|word| differs(word) == 0) {
                continue;
            }
            open_bits(&own, n, !touched & 63, &mut self.point);
            for word in asked_words() {
                let other = (self.point[word] & self.horizon[word]) ^ self.work[word];
                self.changed[word] |= other;
                self.point[word] ^= other;
            }
            self.changed_points.push(local);
            self.open.extend_from_slice(&self.point);
        }
        Retraced { redone: tiles_with(&self.traced, n), changed: tiles_with(&self.changed, n) }
    }

    /// The chunk of the patch that was traced again last.
    pub fn encode(&self, before: &Visibility) -> Vec<u8> {
        let words = open_words(before.face_resolution());
        let of_point = |at: usize| self.open.get(words * at..words * (at + 1));
        encode_changed(before, |local| self.changed_points.binary_search(&local).ok().and_then(of_point))
    }
}

/// Bits of a word of a row that lie in columns x, ends included.
fn span(x: [u32; 2], word: usize) -> u64 {
    let first = 64 * word as u32;
    let (from, to) = (x[0].max(first), x[1].min(first + 63));
    if from > to { 0 } else { (u64::MAX << (from - first)) & (u64::MAX >> (63 - (to - first))) }
}

/// Tiles that have a bit.
fn tiles_with(bits: &[u64], n: usize) -> TileSet {
    let side = n / FACE_TILES;
    let mut set = 0;
    for (row, words) in bits.chunks_exact(n / 64).enumerate() {
        let (face, y) = (row / n, row % n / side);
        for x in 0..FACE_TILES {
            let bits = words[x * side / 64] >> (x * side % 64) & (u64::MAX >> (64 - side));
            set |= TileSet::from(bits != 0) << (16 * face + 4 * y + x);
        }
    }
    set
}

/// Open cells as rows of texels.
struct CellRows {
    /// `[layers][faces][rows of cells][words]`.
    rows: Vec<u64>,
    n: usize,
    all: Vec<u64>,
}

impl CellRows {
    fn new(reach: &PatchReach, n: usize) -> CellRows {
        let (side, words) = (n / CELLS, n / 64);
        let mut rows = Vec::with_capacity(reach.open.len() * 6 * CELLS * words);
        for cells in reach.open.as_flattened() {
            for y in 0..CELLS {
                for word in 0..words {
                    let mut bits = 0;
                    for x in (0..CELLS).filter(|x| x * side / 64 == word && cells >> (8 * y + x) & 1 == 1) {
                        bits |= (u64::MAX >> (64 - side)) << (x * side % 64);
                    }
                    rows.push(bits);
                }
            }
        }
        CellRows { rows, n, all: vec![u64::MAX; words] }
    }

    /// One row of texels of a face: bits in cells that were open before a layer; all of them for a layer that is not known.
    fn row(&self, layer: usize, face: usize, row: usize) -> &[u64] {
        let words = self.n / 64;
        let at = ((6 * layer + face) * CELLS + row * CELLS / self.n) * words;
        self.rows.get(at..at + words).unwrap_or(&self.all)
    }
}

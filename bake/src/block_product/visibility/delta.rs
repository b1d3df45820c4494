//! A patch traced again only where an edit can be seen.
//!
//! ```text
//! for each point, only in cells that were open before the layer of a piece that touches the patch:
//!     may open:  closed until now, above the horizon, in the rectangle of what is gone
//!     asked:     of these, what nothing of a bigger layer covers now and something that is gone covered
//!     closes:    open until now, and something that is new covers it
//!     opens:     asked, and neither anything new nor, traced from scratch by all layers, anything else covers it
//!     every other bit stays
//! ```
//!
//! Exact. A texel's bit is the OR over all triangles of one predicate. A texel that was open closes if and only if a triangle that is new
//! covers it. One that was closed can open only if something that is gone covered it, and of all that covered it the layer that comes first
//! found its cell open. So the bits are those of a clean bake, whatever the record's open cells hold beyond the truth, and whatever is
//! asked beyond it: where the geometry of what is gone cannot be had ([`crate::reach::edit`]), rectangles of its pieces stand for it.
//!
//! Most closed texels lie behind something big: asking that first is what makes a dense thing cheap to move.
//!
//! Binary visibility only: a level of gray does not say which samples are open.

use crate::block_product::visibility::encode::{encode_changed, open_bits, open_bits_in};
use crate::points::{ObjectPlan, Patch};
use crate::reach::edit::EditOccluders;
use crate::reach::seen::{DiffHit, PatchReach};
use crate::reach::shaft::{Bounds, CELLS, Raster, reached_texels};
use crate::reach::tile::{FACE_TILES, TileSet};
use crate::trace::horizon::above_horizon_of_rows;
use crate::trace::{Occluders, Scratch, TraceOrigin};
use prelight_runtime::block_product::visibility::{Visibility, open_words};
use prelight_runtime::sphere::cubemap::BLOCK_SIDE;
use std::collections::BTreeSet;
use std::ops::Range;

/// Working memory of one thread.
#[derive(Default)]
pub(crate) struct PatchRetracer {
    /// Points that are not as they were, ascending, and their bits.
    changed_points: Vec<usize>,
    open: Vec<u64>,
    /// Bits of the point at hand as they were; those of faces that nothing reaches are not to be read.
    point: Vec<u64>,
    /// Masks of one point, `[6, n, n/64]` each: where what is gone, and what is new, may be seen; what is being traced; what is asked; what is
    /// above the horizon.
    gone: Vec<u64>,
    new: Vec<u64>,
    work: Vec<u64>,
    asked: Vec<u64>,
    horizon: Vec<u64>,
    /// Over all points: bits that were asked or closed, and those that are not as they were.
    traced: Vec<u64>,
    changed: Vec<u64>,
    scratch: Scratch,
}

/// What came of tracing again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Retraced {
    /// Tiles of which a texel was traced.
    pub redone: TileSet,
    /// Tiles among those of which a bit is not as it was.
    pub changed: TileSet,
}

/// A patch as an earlier bake found it, and what may have changed that.
#[derive(Clone, Copy)]
pub(crate) struct PatchBefore<'a> {
    /// Its bits.
    pub visibility: &'a Visibility<'a>,
    /// Cells that were open before each layer.
    pub reach: &'a PatchReach,
    /// Pieces that its rays may tell.
    pub touches: &'a [DiffHit],
    /// The pieces' triangles.
    pub edit: &'a EditOccluders,
}

/// Where pieces of one kind may be seen on one face.
struct Seen {
    /// Bounds of all of them; `None` where there is none.
    bounds: Option<Bounds>,
    /// The first layer that one of them is in.
    layer: usize,
    /// `[rows of texels][words]` bits in cells that were open before the layer of one of them.
    rows: Vec<u64>,
}

impl Seen {
    fn new(touches: &[DiffHit], face: usize, is_new: bool, masks: &CellRows) -> Seen {
        let mut seen = Seen { bounds: None, layer: usize::MAX, rows: Vec::new() };
        let mut layers = BTreeSet::new();
        for touch in touches.iter().filter(|touch| touch.is_new == is_new && touch.faces >> face & 1 == 1) {
            seen.bounds.get_or_insert(touch.bounds).join(&touch.bounds);
            seen.layer = seen.layer.min(touch.layer);
            layers.insert(touch.layer);
        }
        if seen.bounds.is_some() {
            for row in 0..masks.n {
                let first = seen.rows.len();
                seen.rows.resize(first + masks.n / 64, 0);
                for layer in &layers {
                    seen.rows[first..].iter_mut().zip(masks.row(*layer, face, row)).for_each(|(all, cells)| *all |= cells);
                }
            }
        }
        seen
    }

    /// Sets the bits of a face that one place may have of these pieces, zeros until then; gives the rows, if there are any.
    fn set(&self, face: usize, at: &Bounds, raster: Raster, bits: &mut [u64]) -> Option<Range<usize>> {
        let [x, y] = reached_texels(face, self.bounds.as_ref()?, at, raster)?;
        let words = raster.face_resolution / 64;
        let mut any = 0;
        for row in y[0] as usize..=y[1] as usize {
            for word in 0..words {
                let seen = span(x, word) & self.rows[row * words + word];
                bits[row * words + word] = seen;
                any |= seen;
            }
        }
        (any != 0).then_some(y[0] as usize..y[1] as usize + 1)
    }
}

impl PatchRetracer {
    /// Brings the bits up to date. They can be encoded afterwards.
    pub(crate) fn retrace(&mut self, occluders: &Occluders, plan: &ObjectPlan, patch: &Patch, before: PatchBefore) -> Retraced {
        let n = before.visibility.face_resolution();
        let (words, row_words) = (open_words(n), n / 64);
        let face_words = words / 6;
        let raster = Raster { face_resolution: n, in_part: false };
        let faces_touched = before.touches.iter().fold(0, |all, touch| all | touch.faces);
        let has = |set: u8, face: usize| set >> face & 1 == 1;
        let of_face = |face: usize| face_words * face..face_words * (face + 1);
        for buffer in [&mut self.gone, &mut self.new, &mut self.work, &mut self.asked, &mut self.traced, &mut self.changed] {
            buffer.clear();
            buffer.resize(words, 0);
        }
        self.horizon.resize(words, 0);
        self.point.resize(words, 0);
        self.open.clear();
        self.changed_points.clear();
        let masks = CellRows::new(before.reach, n);
        let seen: [Option<[Seen; 2]>; 6] = std::array::from_fn(|face| {
            has(faces_touched, face).then(|| [false, true].map(|is_new| Seen::new(before.touches, face, is_new, &masks)))
        });
        // Per face the first layer of what is gone, before which what is asked is asked already; 0 where that cannot be told.
        let first_layer = |face: usize| match (&before.edit.gone, &seen[face]) {
            (Some(_), Some([gone, _])) => gone.layer.min(occluders.n_layers()),
            _ => 0,
        };
        // Per face the rows that something of the edit may have; outside of them the buffers of a point hold zeros.
        let mut rows: [Range<usize>; 6] = std::array::from_fn(|_| 0..0);
        for (local, point) in patch.range().enumerate() {
            let at = Bounds::at(plan.origin[point]);
            // Left by the point before.
            for (face, rows) in rows.iter_mut().enumerate().filter(|(_, rows)| rows.start < rows.end) {
                for buffer in [&mut self.gone, &mut self.new, &mut self.work, &mut self.asked] {
                    buffer[face_words * face + rows.start * row_words..face_words * face + rows.end * row_words].fill(0);
                }
                *rows = 0..0;
            }
            let (mut may_open, mut may_close) = (0u8, 0u8);
            for face in (0..6).filter(|face| has(faces_touched, *face)) {
                let Some([gone, new]) = &seen[face] else { continue };
                let opens = match &before.edit.gone {
                    Some(_) => gone.set(face, &at, raster, &mut self.gone[of_face(face)]),
                    None => rectangles(before.touches, face, &at, raster, &masks, &mut self.gone[of_face(face)]),
                };
                let closes = new.set(face, &at, raster, &mut self.new[of_face(face)]);
                may_open |= u8::from(opens.is_some()) << face;
                may_close |= u8::from(closes.is_some()) << face;
                rows[face] = match (opens, closes) {
                    (Some(a), Some(b)) => a.start.min(b.start)..a.end.max(b.end),
                    (a, b) => a.or(b).unwrap_or(0..0),
                };
            }
            if may_open | may_close == 0 {
                continue;
            }
            let own = before.visibility.point(local);
            open_bits_in(&own, n, |face, y| y < rows[face].end && y + BLOCK_SIDE > rows[face].start, &mut self.point);
            let from = plan.trace_origin(point);
            let words_of = |face: usize| face_words * face + rows[face].start * row_words..face_words * face + rows[face].end * row_words;
            let (mut asked, mut differs) = (0u8, 0);
            for face in (0..6).filter(|face| has(may_open | may_close, *face)) {
                if has(may_open, face) {
                    above_horizon_of_rows(plan.normal[point], n, face, rows[face].clone(), &mut self.horizon[of_face(face)]);
                    words_of(face).for_each(|word| self.asked[word] = self.gone[word] & self.horizon[word] & !self.point[word]);
                    let gone = before.edit.gone.as_ref().map(|gone| (gone, first_layer(face)));
                    self.ask(occluders, gone, face, words_of(face), &from, n);
                }
                let mut any = 0;
                for word in words_of(face) {
                    self.new[word] &= self.point[word];
                    self.work[word] = self.asked[word] | self.new[word];
                    any |= self.work[word];
                }
                if any == 0 {
                    continue;
                }
                before.edit.new.close_covered_from(0, std::iter::once(face), &from, n, &mut self.scratch, &mut self.work);
                let mut left = 0;
                for word in words_of(face) {
                    self.new[word] &= !self.work[word];
                    self.traced[word] |= self.asked[word] | self.new[word];
                    self.work[word] &= self.asked[word];
                    left |= self.work[word];
                    differs |= self.new[word];
                }
                asked |= u8::from(left != 0) << face;
            }
            if asked != 0 {
                let faces = || (0..6).filter(|face| has(asked, *face));
                for face in faces() {
                    // What the layers before cover is not asked any more.
                    let first = first_layer(face);
                    occluders.close_covered_from(first, std::iter::once(face), &from, n, &mut self.scratch, &mut self.work);
                }
                differs |= faces().flat_map(words_of).fold(0, |any, word| any | self.work[word]);
            }
            if differs == 0 {
                continue;
            }
            open_bits(&own, n, 63, &mut self.point);
            for word in (0..6).flat_map(words_of) {
                let other = self.work[word] | self.new[word];
                self.changed[word] |= other;
                self.point[word] ^= other;
            }
            self.changed_points.push(local);
            self.open.extend_from_slice(&self.point);
        }
        Retraced { redone: tiles_with(&self.traced, n), changed: tiles_with(&self.changed, n) }
    }

    /// Leaves of the bits of `asked` on a face, which all lie in `words`, those that no layer before the `first` covers and that something
    /// which is gone covered.
    fn ask(
        &mut self,
        occluders: &Occluders,
        gone: Option<(&Occluders, usize)>,
        face: usize,
        words: Range<usize>,
        from: &TraceOrigin,
        n: usize,
    ) {
        let Some((gone, first)) = gone else { return };
        let any = |bits: &[u64]| bits.iter().any(|word| *word != 0);
        for layer in 0..first {
            if !any(&self.asked[words.clone()]) {
                return;
            }
            occluders.close_covered_by(layer, std::iter::once(face), from, n, &mut self.scratch, &mut self.asked);
        }
        if !any(&self.asked[words.clone()]) {
            return;
        }
        self.work[words.clone()].copy_from_slice(&self.asked[words.clone()]);
        // Ids of what is gone mean nothing here.
        let then = TraceOrigin { origin: from.origin, normal: from.normal, base_triangles: &[] };
        gone.close_covered_from(0, std::iter::once(face), &then, n, &mut self.scratch, &mut self.work);
        words.for_each(|word| self.asked[word] &= !self.work[word]);
    }

    /// The chunk of the patch that was traced again last.
    pub(crate) fn encode(&self, before: &Visibility) -> Vec<u8> {
        let words = open_words(before.face_resolution());
        let of_point = |at: usize| self.open.get(words * at..words * (at + 1));
        encode_changed(before, |local| self.changed_points.binary_search(&local).ok().and_then(of_point))
    }
}

/// Rectangles of pieces that are gone, piece by piece, in their open cells, in a face of zeros; its rows, if there is a texel.
fn rectangles(touches: &[DiffHit], face: usize, at: &Bounds, raster: Raster, masks: &CellRows, bits: &mut [u64]) -> Option<Range<usize>> {
    let words = raster.face_resolution / 64;
    let mut any = 0;
    for touch in touches.iter().filter(|touch| !touch.is_new && touch.faces >> face & 1 == 1) {
        let Some([x, y]) = reached_texels(face, &touch.bounds, at, raster) else { continue };
        for row in y[0] as usize..=y[1] as usize {
            for (word, cells) in masks.row(touch.layer, face, row).iter().enumerate() {
                bits[row * words + word] |= span(x, word) & cells;
                any |= bits[row * words + word];
            }
        }
    }
    (any != 0).then_some(0..raster.face_resolution)
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

//! Tiles of a patch: which are open, what reaches them, and the table of their keys that a ledger record carries.
//!
//! A tile is a 4×4th part of a cubemap face: 16×16 texels at 64², 32×32 at 128²; number face·16 + 4·y + x, 96 a patch. It has 2×2 cells
//! ([`crate::reach::shaft`]). Open cells are kept per box of 16 points: a piece enters a tile's key only if it reaches, from one of the boxes, a cell
//! in which one of the points of that box is open.
//!
//! ```text
//! record data   version u8, boxes u8, rows u16, then rows, by tile, then by layer:
//!   tile u8: bit 7 says that all is closed now; key 16; then, unless closed:
//!   name 16 (open bits left), cells 8: bit 4·box + cell, of the 2×2 cells y, then x
//! ```
//!
//! A layer without a piece that reaches a tile has no row there. The last row's name is that of the tile's bits in the record's chunk; a
//! tile without rows has the bits of the horizon.

use crate::reach::pieces::{DigestSum, NO_PIECE, Pieces};
use crate::reach::shaft::{BOX_POINTS, MAX_BOXES, OriginBoxes, Raster, horizon_cells, reached_cells};

/// Tiles of a patch.
pub const N_TILES: usize = 96;
/// Tiles along a side of a face.
pub(crate) const FACE_TILES: usize = 4;

/// Name of bits that only the horizon closed.
pub(crate) const HORIZON: [u8; 16] = [0; 16];
/// Name of bits that are all closed.
pub(crate) const CLOSED: [u8; 16] = [0xFF; 16];

/// A set of tiles: bit t.
pub(crate) type TileSet = u128;

/// Tiles of a set, ascending.
pub(crate) fn tiles(set: TileSet) -> impl Iterator<Item = u8> {
    let mut rest = set;
    std::iter::from_fn(move || {
        (rest != 0).then(|| {
            let tile = rest.trailing_zeros() as u8;
            rest &= rest - 1;
            tile
        })
    })
}

/// Bits of a face's tiles that hold a cell of `cells`: bit 4·y + x.
#[inline]
pub(crate) fn tiles_of_cells(cells: u64) -> u16 {
    let any = (cells | cells >> 1 | cells >> 8 | cells >> 9) & 0x0055_0055_0055_0055;
    let pairs = (any | any >> 1) & 0x0033_0033_0033_0033;
    let rows = (pairs | pairs >> 2) & 0x000f_000f_000f_000f;
    (rows | rows >> 12 | rows >> 24 | rows >> 36) as u16
}

/// Cells of one tile, as bits 0..4 from y, then x.
fn cells_of_tile(cells: u64, tile: u8) -> u64 {
    let (x, y) = (tile % 4, tile / 4 % 4);
    let at = cells >> (16 * y + 2 * x);
    at & 3 | at >> 6 & 12
}

/// The same, put back.
fn place_cells(four: u64, tile: u8) -> u64 {
    let (x, y) = (tile % 4, tile / 4 % 4);
    (four & 3 | (four & 12) << 6) << (16 * y + 2 * x)
}

/// Open cells of a patch's boxes.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct OpenCells {
    /// `[boxes][faces]`.
    boxes: Vec<[u64; 6]>,
    /// Cells of all boxes together.
    patch: [u64; 6],
}

impl OpenCells {
    /// What is above the horizon, by the normals of the patch's points in order.
    pub(crate) fn above_horizon(normals: &[[f32; 3]], face_resolution: usize) -> OpenCells {
        let of_box = |normals: &[[f32; 3]]| std::array::from_fn(|face| horizon_cells(face, normals, face_resolution));
        let mut boxes: Vec<[u64; 6]> = Vec::with_capacity(MAX_BOXES);
        let mut before: &[[f32; 3]] = &[];
        for part in normals.chunks(BOX_POINTS) {
            // A flat wall: the box before has the same normals.
            let same = !before.is_empty() && before.iter().chain(part).all(|normal| *normal == before[0]);
            let cells = if same { boxes[boxes.len() - 1] } else { of_box(part) };
            boxes.push(cells);
            before = part;
        }
        let mut open = OpenCells { boxes, patch: [0; 6] };
        open.refresh();
        open
    }

    fn refresh(&mut self) {
        for face in 0..6 {
            self.patch[face] = self.boxes.iter().fold(0, |all, cells| all | cells[face]);
        }
    }

    /// `[faces]` cells that are open to some point.
    pub(crate) fn faces(&self) -> &[u64; 6] {
        &self.patch
    }

    /// Tiles with an open cell.
    pub(crate) fn live(&self) -> TileSet {
        (0..6).fold(0, |set, face| set | TileSet::from(tiles_of_cells(self.patch[face])) << (16 * face))
    }

    /// Cells of a tile, bit 4·box + cell.
    pub(crate) fn tile(&self, tile: u8) -> u64 {
        let face = usize::from(tile / 16);
        self.boxes.iter().enumerate().fold(0, |all, (i, cells)| all | cells_of_tile(cells[face], tile) << (4 * i))
    }

    /// Replaces the cells of a tile; [`OpenCells::settle`] must follow.
    pub(crate) fn set_tile(&mut self, tile: u8, cells: u64) {
        let face = usize::from(tile / 16);
        for (i, open) in self.boxes.iter_mut().enumerate() {
            open[face] = open[face] & !place_cells(15, tile) | place_cells(cells >> (4 * i) & 15, tile);
        }
    }

    /// Ends a run of [`OpenCells::set_tile`].
    pub(crate) fn settle(&mut self) {
        self.refresh();
    }
}

/// Which pieces of a layer reach the open cells of each tile.
#[derive(Clone, Debug)]
pub(crate) struct Reach {
    /// Tiles that a piece reaches.
    pub tiles: TileSet,
    sums: [DigestSum; N_TILES],
    counts: [u32; N_TILES],
}

impl Reach {
    /// Searches one layer.
    pub(crate) fn new(pieces: &Pieces, layer: usize, origins: &OriginBoxes, open: &OpenCells, raster: Raster) -> Reach {
        let mut reach = Reach { tiles: 0, sums: [DigestSum::default(); N_TILES], counts: [0; N_TILES] };
        let nodes = &pieces.nodes[layer];
        let mut at = 0;
        while let Some(node) = nodes.get(at) {
            let leaf = node.piece != NO_PIECE;
            let mut any = false;
            for face in (0..6).filter(|&face| open.patch[face] != 0) {
                let wide = reached_cells(face, &node.bounds, &origins.patch, raster) & open.patch[face];
                if wide == 0 {
                    continue;
                }
                if !leaf {
                    any = true;
                    break;
                }
                let possible = tiles_of_cells(wide);
                let mut found = 0;
                for (bounds, open) in origins.boxes.iter().zip(&open.boxes) {
                    if open[face] & wide == 0 {
                        continue;
                    }
                    found |= tiles_of_cells(reached_cells(face, &node.bounds, bounds, raster) & open[face]);
                    if found == possible {
                        break;
                    }
                }
                let digest = &pieces.pieces[node.piece as usize].digest;
                let mut rest = found;
                while rest != 0 {
                    let tile = 16 * face + rest.trailing_zeros() as usize;
                    rest &= rest - 1;
                    reach.sums[tile].add(digest);
                    reach.counts[tile] += 1;
                }
                reach.tiles |= TileSet::from(found) << (16 * face);
            }
            at = if leaf || any { at + 1 } else { node.next as usize };
        }
        reach
    }

    /// Sum and number of the pieces that reach a tile.
    pub(crate) fn of(&self, tile: u8) -> (&DigestSum, u32) {
        (&self.sums[usize::from(tile)], self.counts[usize::from(tile)])
    }
}

/// One layer's result for one tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileRow {
    /// The tile.
    pub tile: u8,
    /// What the result depends on.
    pub key: [u8; 16],
    /// Name of the open bits left.
    pub name: [u8; 16],
    /// Cells with an open bit, bit 4·box + cell.
    pub cells: u64,
}

/// Rows of one record, by tile, then by layer.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TileTable {
    rows: Vec<TileRow>,
    n_boxes: u8,
}

const TABLE_VERSION: u8 = 1;

impl TileTable {
    /// From rows in the order in which layers made them.
    pub(crate) fn new(mut rows: Vec<TileRow>, n_boxes: usize) -> TileTable {
        rows.sort_by_key(|row| row.tile);
        TileTable { rows, n_boxes: n_boxes as u8 }
    }

    /// All rows.
    pub fn rows(&self) -> &[TileRow] {
        &self.rows
    }

    /// Rows of one tile, in the order of layers.
    pub(crate) fn tile(&self, tile: u8) -> &[TileRow] {
        let first = self.rows.partition_point(|row| row.tile < tile);
        let end = self.rows.partition_point(|row| row.tile <= tile);
        &self.rows[first..end]
    }

    /// Name of a tile's final bits.
    pub(crate) fn final_name(&self, tile: u8) -> [u8; 16] {
        self.tile(tile).last().map_or(HORIZON, |row| row.name)
    }

    /// As a record's data.
    pub fn encode(&self) -> Vec<u8> {
        let mut data = vec![TABLE_VERSION, self.n_boxes];
        data.extend_from_slice(&(self.rows.len() as u16).to_le_bytes());
        for row in &self.rows {
            let closed = row.cells == 0;
            data.push(row.tile | u8::from(closed) << 7);
            data.extend_from_slice(&row.key);
            if !closed {
                data.extend_from_slice(&row.name);
                data.extend_from_slice(&row.cells.to_le_bytes());
            }
        }
        data
    }

    /// From a record's data. `None` where it is not a table for so many boxes.
    pub(crate) fn decode(data: &[u8], n_boxes: usize) -> Option<TileTable> {
        let (head, mut rest) = data.split_first_chunk::<4>()?;
        if head[0] != TABLE_VERSION || usize::from(head[1]) != n_boxes {
            return None;
        }
        let mut rows: Vec<TileRow> = Vec::new();
        for _ in 0..u16::from_le_bytes([head[2], head[3]]) {
            let (&[first], tail) = rest.split_first_chunk::<1>()?;
            let (key, mut tail) = tail.split_first_chunk::<16>()?;
            let (mut name, mut cells) = (CLOSED, 0);
            if first < 128 {
                let (open, end) = tail.split_first_chunk::<16>()?;
                let (bits, end) = end.split_first_chunk::<8>()?;
                (name, cells, tail) = (*open, u64::from_le_bytes(*bits), end);
            }
            let row = TileRow { tile: first & 127, key: *key, name, cells };
            let fits = usize::from(row.tile) < N_TILES && (n_boxes == MAX_BOXES || row.cells >> (4 * n_boxes) == 0);
            if !fits || rows.last().is_some_and(|before| before.tile > row.tile) {
                return None;
            }
            rows.push(row);
            rest = tail;
        }
        rest.is_empty().then_some(TileTable { rows, n_boxes: n_boxes as u8 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn cells_fold_into_tiles_and_come_apart_again() {
        for cell in 0..64 {
            let tile = (cell / 16 * 4 + cell % 8 / 2) as u8;
            assert_eq!(tiles_of_cells(1 << cell), 1 << tile, "cell {cell}");
            for other in 0..16 {
                let four = cells_of_tile(1 << cell, other);
                assert_eq!(four.count_ones(), u32::from(other == tile));
                assert_eq!(place_cells(four, other), if other == tile { 1 << cell } else { 0 });
            }
        }
    }

    #[test]
    fn a_tiles_cells_are_kept_box_by_box() {
        let normals: Vec<[f32; 3]> = (0..200).map(|i| if i < 16 { [0.0, 1.0, 0.0] } else { [1.0, 0.0, 0.0] }).collect();
        let mut open = OpenCells::above_horizon(&normals, 64);
        // Tile 0 looks along +X: only the later boxes see all of it; half a face is above the first box's horizon.
        assert_eq!(open.tile(0), 0x000f_ffff_ffff_fff0_u64 & ((1 << 52) - 1));
        let before = open.clone();
        let cells = open.tile(6);
        open.set_tile(6, 0);
        open.settle();
        assert_eq!(open.live(), before.live() & !(1 << 6));
        open.set_tile(6, cells);
        open.settle();
        assert_eq!(open, before);
        assert_eq!(tiles(open.live()).count() as u32, open.live().count_ones());
    }

    #[test]
    fn tables_round_trip_and_strangers_are_refused() {
        let row = |tile: u8, k: u8| TileRow { tile, key: [k; 16], name: [tile; 16], cells: u64::from(k) };
        let closed = TileRow { name: CLOSED, cells: 0, ..row(3, 2) };
        let table = TileTable::new(vec![row(3, 1), row(95, 1), closed, row(0, 3)], 7);
        assert_eq!(table.tile(3), [row(3, 1), closed]);
        assert_eq!((table.final_name(95), table.final_name(4)), ([95; 16], [0; 16]));
        let data = table.encode();
        assert_eq!(TileTable::decode(&data, 7), Some(table));
        assert_eq!(TileTable::decode(&data, 8), None);
        assert_eq!(TileTable::decode(&data[..data.len() - 1], 7), None);
        assert_eq!(TileTable::decode(&TileTable::new(vec![row(96, 1)], 7).encode(), 7), None);
        let stray = TileRow { cells: 1 << 60, ..row(1, 1) };
        assert_eq!(TileTable::decode(&TileTable::new(vec![stray], 7).encode(), 7), None, "a cell of a box that is not there");
    }

    proptest! {
        #[test]
        fn any_bytes_decode_or_are_refused(data in prop::collection::vec(any::<u8>(), 0..300), boxes in 1usize..=16) {
            let _ = TileTable::decode(&data, boxes);
            let mut near = TileTable::new(vec![TileRow { tile: 3, key: [1; 16], name: [2; 16], cells: 3 }; 4], boxes).encode();
            for (at, byte) in data.iter().enumerate().take(near.len()) {
                near[at] ^= byte & 1;
            }
            let _ = TileTable::decode(&near, boxes);
        }
    }
}

//! A patch that an earlier bake found, taken over: what an edit may have changed of it is traced again, texels, or in grayscale tiles.

use super::baker::{PatchTask, Scratch, Traced, VisibilityBaker};
use super::bits::PatchBits;
use super::delta::PatchBefore;
use super::patch::Shadowing;
use crate::error::BakeError;
use crate::factor::Taken;
use crate::points::buried::Boxes;
use crate::reach::edit::EditOccluders;
use crate::reach::seen::{DiffHit, KnownPatch};
use crate::reach::shaft::{BOX_POINTS, Bounds};
use crate::reach::tile::{TileSet, tiles};
use prelight_runtime::block_product::visibility::Visibility;
use prelight_store::Chunk;

/// Pieces that an edit may have touched a patch with, up to which its points are asked one by one where; only where the triangles of what is
/// gone cannot be had.
const MAX_TOUCHES: usize = 1024;

impl VisibilityBaker<'_> {
    /// Takes over a patch that an earlier bake found, and traces again what an edit may have changed of it. `None` where that cannot be told
    /// from the record.
    pub(crate) fn take(&self, task: &PatchTask, known: &KnownPatch, scratch: &mut Scratch) -> Result<Option<Taken<Traced>>, BakeError> {
        let seen = known.seen;
        let live = seen.reach.live();
        let kept = Traced { buried: seen.buried.clone(), reach: seen.reach.clone(), is_new: false, live, redone: 0, changed: 0 };
        let taken = Taken { descriptor: Some(seen.visibility.clone()), chunk: known.chunk.clone(), kept };
        let Some(edit) = known.edit else { return Ok(Some(taken)) };
        let Some(occluders) = edit.occluders() else { return Ok(None) };
        let (changes, raster) = (&edit.changes, self.shadowing.raster(task.plan.object));
        let touches = seen.reach.touches(changes, raster);
        if occluders.gone.is_none() && touches.len() > MAX_TOUCHES {
            return Ok(None);
        }
        let mut taken = taken;
        if !touches.is_empty() {
            self.retrace(task, known, (&touches, occluders), scratch, &mut taken)?;
        }
        let all = changes.gone.iter().chain(&changes.new);
        let asked: Vec<Bounds> = all.filter(|piece| seen.reach.asks_about(piece)).map(|piece| piece.bounds).collect();
        let mut buried_reach = seen.reach.buried;
        if taken.kept.changed != 0 || !asked.is_empty() {
            let chunks = [known.chunk, &taken.chunk];
            (taken.kept.buried, buried_reach) = self.buried_again(task, seen, chunks, (&Boxes::new(&asked), occluders))?;
        }
        taken.kept.reach = seen.reach.after(changes, buried_reach, raster);
        Ok(Some(taken))
    }

    /// Traces what pieces that are new or gone may have changed.
    fn retrace(
        &self,
        task: &PatchTask,
        known: &KnownPatch,
        (touches, edit): (&[DiffHit], &EditOccluders),
        Scratch { bits, delta }: &mut Scratch,
        taken: &mut Taken<Traced>,
    ) -> Result<(), BakeError> {
        let (reach, raster) = (&known.seen.reach, self.shadowing.raster(task.plan.object));
        let before = Visibility::from_chunk(known.chunk)?;
        let (redone, changed, bytes) = if raster.in_part {
            let redone = reach.stale_from(touches, task.plan.origin[task.patch.range()].chunks(BOX_POINTS), raster);
            let changed = self.retrace_tiles(task, &before, taken.kept.live, redone, bits);
            (redone, changed, if changed == 0 { Vec::new() } else { bits.encode() })
        } else {
            let what = PatchBefore { visibility: &before, reach, touches, edit };
            let retraced = delta.retrace(self.shadowing.occluders, task.plan, task.patch, what);
            (retraced.redone, retraced.changed, if retraced.changed == 0 { Vec::new() } else { delta.encode(&before) })
        };
        (taken.kept.redone, taken.kept.changed) = (redone, changed);
        if changed != 0 {
            (taken.descriptor, taken.chunk) = (None, Chunk::from_plain(&bytes));
        }
        Ok(())
    }

    /// Traces some of the live tiles from the horizon, by all layers, and copies the others; gives those that are not as they were. The patch
    /// is then in `bits`.
    fn retrace_tiles(&self, task: &PatchTask, before: &Visibility, live: TileSet, stale: TileSet, bits: &mut PatchBits) -> TileSet {
        if stale == 0 {
            return 0;
        }
        let Shadowing { pieces, occluders, face_resolution, .. } = self.shadowing;
        bits.reset(face_resolution, self.shadowing.steps(task.plan.object), task.patch.n_points as usize);
        bits.copy(before, live & !stale);
        bits.set_horizon(task.plan, task.patch, stale);
        for layer in 0..pieces.n_layers() {
            bits.trace(occluders, layer, task.plan, task.patch, stale);
        }
        tiles(stale).filter(|tile| !bits.equals(before, *tile)).fold(0, |set, tile| set | 1 << tile)
    }
}

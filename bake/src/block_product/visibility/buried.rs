//! Points of a patch that lie inside solids: asked of those that see nothing, and kept in a record of their own.
//!
//! It depends on which surfaces are double-sided, which visibility does not.

use super::baker::{PatchTask, VisibilityBaker};
use super::patch::PatchInputs;
use crate::error::BakeError;
use crate::factor::Ledger;
use crate::points::buried::{Boxes, Meets, Verdict, local_edge};
use crate::reach::edit::EditOccluders;
use crate::reach::key::{BlindPoint, buried_key, buried_question};
use crate::reach::seen::SeenPatch;
use prelight_manifests::Digest;
use prelight_runtime::block_product::visibility::Visibility;
use prelight_store::{Chunk, Record};

impl VisibilityBaker<'_> {
    /// Points inside a solid, and the metres within which lies what told: of points that were blind already and whose rays meet nothing of the
    /// edit, what was found before.
    pub(crate) fn buried_again(
        &self,
        task: &PatchTask,
        light: &SeenPatch,
        [before, now]: [&Chunk; 2],
        (boxes, edit): (&Boxes, &EditOccluders),
    ) -> Result<(Vec<u8>, f64), BakeError> {
        let (before, now) = (Visibility::from_chunk(before)?, Visibility::from_chunk(now)?);
        let (mut buried, mut reach) = (Vec::new(), light.reach.buried);
        for local in (0..now.len()).filter(|local| now.point(*local).is_blind()) {
            let point = task.patch.first + local as u32;
            let own = task.plan.base_triangles(point as usize);
            let meets = |origin, direction, t_max| {
                let gone = edit.gone.as_ref().is_none_or(|gone| gone.occluded(origin, direction, t_max, &[]));
                gone || edit.new.occluded(origin, direction, t_max, own)
            };
            let meets: Option<&Meets> = if edit.gone.is_some() { Some(&meets) } else { None };
            let is_known = before.point(local).is_blind() && !self.probe.may_meet(task.plan, point, boxes, light.reach.buried, meets);
            let is_buried = if is_known {
                light.buried.contains(&(local as u8))
            } else {
                let verdict = self.ask(task, point);
                reach = reach.max(verdict.reach);
                verdict.is_buried
            };
            if is_buried {
                buried.push(local as u8);
            }
        }
        Ok((buried, reach))
    }

    /// Whether a point that sees nothing lies inside a solid.
    fn ask(&self, task: &PatchTask, point: u32) -> Verdict {
        let own = task.plan.base_triangles(point as usize);
        let closest = |origin, direction| {
            let hit = self.shadowing.occluders.closest_hit(origin, direction, own)?;
            Some((hit.t, hit.triangle, hit.back_face))
        };
        self.probe.ask(task.plan, point, task.edge_length, &closest)
    }

    /// Points that see nothing are asked whether they lie inside a solid. Kept in a record of its own: it depends on which surfaces are
    /// double-sided, visibility does not. Also gives the metres within which lies what decided; below 0 where no point was asked.
    pub(crate) fn buried(
        &self,
        task: &PatchTask,
        inputs: &PatchInputs,
        chunk: &Chunk,
        ledger: &mut Ledger,
    ) -> Result<(Vec<u8>, f64), BakeError> {
        let visibility = Visibility::from_chunk(chunk)?;
        let blind: Vec<u8> = (0..visibility.len()).filter(|i| visibility.point(*i).is_blind()).map(|i| i as u8).collect();
        if blind.is_empty() {
            return Ok((Vec::new(), -1.0));
        }
        let first = task.patch.range().start;
        let point = |local: u8| first + usize::from(local);
        let described = blind.iter().map(|&index| BlindPoint {
            index,
            geometric_normal: task.plan.geometric_normal[point(index)],
            local_edge: local_edge(task.plan, point(index) as u32, task.edge_length),
            sides: task.plan.base_triangles(point(index)).iter().map(|id| self.probe.side(*id)).collect(),
        });
        let question = buried_question(&inputs.key, task.edge_length, described);
        let key = |reach: f64| buried_key(&question, self.shadowing.pieces, &inputs.origins.patch, reach);
        for record in ledger.lookup_all(&question)? {
            if let Some((reach, made_for, points)) = parse_buried(&record.data)
                && points.iter().all(|i| blind.contains(i))
                && key(reach) == made_for
            {
                return Ok((points.to_vec(), reach));
            }
        }
        let (mut buried, mut reach) = (Vec::new(), 0.0f64);
        for local in blind {
            let verdict = self.ask(task, point(local) as u32);
            reach = reach.max(verdict.reach);
            if verdict.is_buried {
                buried.push(local);
            }
        }
        let data = [&reach.to_le_bytes()[..], &key(reach).0, &buried].concat();
        ledger.record(question, Record { chunks: Vec::new(), data });
        Ok((buried, reach))
    }
}

/// Reach, key and points of a record of buried points.
fn parse_buried(data: &[u8]) -> Option<(f64, Digest, &[u8])> {
    let (reach, rest) = data.split_at_checked(8)?;
    let (key, points) = rest.split_at_checked(32)?;
    let reach = f64::from_le_bytes(std::array::from_fn(|i| reach[i]));
    Some((reach, Digest(std::array::from_fn(|i| key[i])), points))
}

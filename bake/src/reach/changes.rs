//! What differs between two scenes, object by object, as far as light is blocked: the reasons that `plan` and `bake` give.
//!
//! Objects are matched by name. Two objects differ where their pieces do ([`crate::reach::pieces`]): a piece that only one of them has is where
//! an edit happened, and a stale tile that such a piece reaches is put down to it. Reasons are for people. What is stale is decided by
//! keys alone.

use crate::reach::layer::{MAX_LAYERS, layers};
use crate::reach::pieces::{Piece, Pieces};
use crate::reach::shaft::{Bounds, Raster, reached_cells};
use crate::reach::tile::{TileSet, tiles_of_cells};
use prelight_scene::world::World;
use prelight_scene::{Object, Scene};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

/// What was done to an object.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Change {
    /// It is new.
    Added,
    /// It is gone.
    Removed,
    /// Its transform differs: moved, turned or scaled.
    Moved,
    /// Its mesh differs.
    Reshaped,
    /// Its material lets light through where it did not, or the other way round.
    Opacity,
    /// Its material became double-sided, or is no more.
    Sides,
}

impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Change::Added => "added",
            Change::Removed => "removed",
            Change::Moved => "moved",
            Change::Reshaped => "reshaped",
            Change::Opacity => "changed its opacity",
            Change::Sides => "changed its sides",
        })
    }
}

/// An object that is not as it was.
#[derive(Clone, Debug, PartialEq)]
pub struct ChangedObject {
    /// Its name.
    pub name: String,
    /// Its index in the new scene, where it is still there.
    pub object: Option<u32>,
    /// What was done.
    pub change: Change,
    /// Pieces that only one of the scenes has.
    pub bounds: Vec<Bounds>,
}

/// A scene cut into pieces.
struct Side<'a> {
    scene: &'a Scene,
    pieces: Pieces,
    by_name: BTreeMap<&'a str, u32>,
    of_object: Vec<Vec<u32>>,
}

impl<'a> Side<'a> {
    fn new(scene: &'a Scene, world: &World, fixed: &[Option<u8>]) -> Side<'a> {
        let pieces = Pieces::build(scene, world, &layers(scene, world, fixed), MAX_LAYERS);
        let mut of_object = vec![Vec::new(); scene.objects.len()];
        pieces.pieces.iter().enumerate().for_each(|(i, piece)| of_object[piece.object as usize].push(i as u32));
        let by_name = scene.objects.iter().zip(0..).map(|(object, index)| (object.name.as_str(), index)).collect();
        Side { scene, pieces, by_name, of_object }
    }

    fn pieces(&self, object: Option<u32>) -> Vec<&Piece> {
        let mine = object.map_or(&[][..], |object| &self.of_object[object as usize]);
        mine.iter().map(|piece| &self.pieces.pieces[*piece as usize]).collect()
    }
}

/// Objects that differ, by name. `layers`: one per object of the new scene, as in a bake's options; may be shorter.
pub fn changes(old: (&Scene, &World), new: (&Scene, &World), layers: &[Option<u8>]) -> Vec<ChangedObject> {
    let fixed = |object: usize| layers.get(object).copied().flatten();
    let new_index: BTreeMap<&str, usize> = new.0.objects.iter().enumerate().map(|(i, object)| (object.name.as_str(), i)).collect();
    // Cut alike, whatever layers the old scene's manifest had.
    let old_layers: Vec<Option<u8>> =
        old.0.objects.iter().map(|object| new_index.get(object.name.as_str()).and_then(|index| fixed(*index))).collect();
    let (old, new) = (Side::new(old.0, old.1, &old_layers), Side::new(new.0, new.1, layers));
    let names: BTreeSet<&str> = old.by_name.keys().chain(new.by_name.keys()).copied().collect();
    let mut changed = Vec::new();
    for name in names {
        let (before, now) = (old.by_name.get(name).copied(), new.by_name.get(name).copied());
        let (was, is) = (old.pieces(before), new.pieces(now));
        let mut bounds = only_in_one(&was, &is, |piece| piece.digest.0);
        let objects = (before.map(|i| &old.scene.objects[i as usize]), now.map(|i| &new.scene.objects[i as usize]));
        let change = match objects {
            (None, _) => Change::Added,
            (_, None) => Change::Removed,
            (Some(before), Some(now)) if before.world_from_local != now.world_from_local => Change::Moved,
            (Some(before), Some(now)) if !same_geometry(before, now) => Change::Reshaped,
            _ if !bounds.is_empty() => Change::Opacity,
            _ => {
                bounds = only_in_one(&was, &is, |piece| piece.sides.0);
                if bounds.is_empty() {
                    continue;
                }
                Change::Sides
            }
        };
        changed.push(ChangedObject { name: name.to_string(), object: now, change, bounds });
    }
    changed
}

/// Bounds of the pieces that only one of two objects has; copies count.
fn only_in_one(a: &[&Piece], b: &[&Piece], digest: impl Fn(&Piece) -> [u64; 4]) -> Vec<Bounds> {
    let mut count: BTreeMap<[u64; 4], i64> = BTreeMap::new();
    a.iter().for_each(|piece| *count.entry(digest(piece)).or_default() += 1);
    b.iter().for_each(|piece| *count.entry(digest(piece)).or_default() -= 1);
    a.iter().chain(b).filter(|piece| count[&digest(piece)] != 0).map(|piece| piece.bounds).collect()
}

fn same_geometry(a: &Object, b: &Object) -> bool {
    let (a, b) = (&a.mesh.primitives, &b.mesh.primitives);
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.positions == b.positions && a.triangles == b.triangles && a.normals == b.normals)
}

/// A patch with something to trace.
#[derive(Clone, Debug, PartialEq)]
pub struct StalePatch {
    /// Its object.
    pub object: u32,
    /// Where its rays start.
    pub origins: Bounds,
    /// Tiles to trace.
    pub tiles: TileSet,
    /// No record knows its points.
    pub is_new: bool,
}

/// What an object's change is to blame for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reason {
    /// The object's name.
    pub name: String,
    /// What was done to it.
    pub change: Change,
    /// Its own patches.
    pub own_patches: u64,
    /// Patches of others with a stale tile that it reaches, or reached.
    pub seen_by: u64,
    /// Stale tiles of those.
    pub tiles: u64,
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.name, self.change)?;
        match (self.own_patches, self.seen_by) {
            (0, 0) => write!(f, ": nothing to do"),
            (own, 0) => write!(f, ": {own} own patches"),
            (0, seen) => write!(f, ": {seen} patches that see it ({} tiles)", self.tiles),
            (own, seen) => write!(f, ": {own} own patches, {seen} that see it ({} tiles)", self.tiles),
        }
    }
}

/// Puts stale patches down to changed objects, the costliest first. A patch may have several reasons, or none that is known here.
pub fn reasons(stale: &[StalePatch], changed: &[ChangedObject], face_resolution: u32) -> Vec<Reason> {
    let mut reasons: Vec<Reason> = Vec::new();
    for cause in changed {
        let mut reason = Reason { name: cause.name.clone(), change: cause.change, own_patches: 0, seen_by: 0, tiles: 0 };
        for patch in stale {
            if cause.object == Some(patch.object) {
                reason.own_patches += 1;
            } else if !patch.is_new {
                let reached = reached_tiles(&cause.bounds, &patch.origins, face_resolution) & patch.tiles;
                reason.seen_by += u64::from(reached != 0);
                reason.tiles += u64::from(reached.count_ones());
            }
        }
        reasons.push(reason);
    }
    reasons.sort_by_key(|reason| std::cmp::Reverse(96 * reason.own_patches + reason.tiles));
    reasons
}

fn reached_tiles(bounds: &[Bounds], origins: &Bounds, face_resolution: u32) -> TileSet {
    // The wider of the two: a reason too many is better than one too few.
    let raster = Raster { face_resolution: face_resolution as usize, in_part: true };
    let mut cells = [0u64; 6];
    for piece in bounds {
        for (face, cells) in cells.iter_mut().enumerate() {
            *cells |= reached_cells(face, piece, origins, raster);
        }
    }
    (0..6).fold(0, |set, face| set | TileSet::from(tiles_of_cells(cells[face])) << (16 * face))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::test_scenes::*;
    use prelight_runtime::surface::{AlphaMode, Material};

    fn boxes() -> Scene {
        let mut scene = scene();
        scene.materials.push(Material::default());
        for (i, name) in ["a", "b", "c", "d", "e"].into_iter().enumerate() {
            add(
                &mut scene,
                name,
                vec![cuboid([0.0; 3], [1.0; 3], false, if i == 3 { 2 } else { 0 })],
                translation(3.0 * i as f64, 0.0, 0.0),
            );
        }
        scene
    }

    #[test]
    fn each_kind_of_edit_is_called_by_its_name_and_the_rest_is_not_named() {
        let old = boxes();
        let mut new = old.clone();
        new.objects[0].world_from_local[13] = 0.5;
        new.objects.remove(1);
        std::sync::Arc::make_mut(&mut new.objects[1].mesh).primitives[0].positions[0] = [-0.1; 3];
        new.materials[2].alpha_mode = AlphaMode::Blend;
        new.materials[2].base_color[3] = 0.1;
        add(&mut new, "f", vec![cuboid([0.0; 3], [1.0; 3], false, 0)], translation(0.0, 0.0, 9.0));
        let found = changes((&old, &World::build(&old)), (&new, &World::build(&new)), &[]);
        let said: Vec<(&str, Change)> = found.iter().map(|changed| (changed.name.as_str(), changed.change)).collect();
        let expected =
            [("a", Change::Moved), ("b", Change::Removed), ("c", Change::Reshaped), ("d", Change::Opacity), ("f", Change::Added)];
        assert_eq!(said, expected);
        assert_eq!(found.iter().map(|changed| changed.bounds.len()).collect::<Vec<_>>(), [2, 1, 2, 1, 1]);

        let mut sides = old.clone();
        sides.materials[2].double_sided = true;
        sides.materials[0].roughness = 0.3;
        let found = changes((&old, &World::build(&old)), (&sides, &World::build(&sides)), &[Some(2)]);
        assert_eq!(found.iter().map(|changed| (changed.name.as_str(), changed.change)).collect::<Vec<_>>(), [("d", Change::Sides)]);
    }

    #[test]
    fn stale_tiles_are_put_down_to_what_reaches_them() {
        let at = |x: f32| Bounds { lower: [x, 0.0, 0.0], upper: [x + 0.1, 0.1, 0.1] };
        // Wide enough to cover texels from there.
        let wide = |x: f32| Bounds { lower: [x, -1.0, -1.0], upper: [x + 1.0, 1.0, 1.0] };
        let cause = |name: &str, object, x| ChangedObject { name: name.into(), object, change: Change::Moved, bounds: vec![wide(x)] };
        // Seen from the origin one lies along +X, the other along −X.
        let changed = [cause("left", Some(1), -9.0), cause("right", None, 9.0)];
        let patch = |object, tiles, is_new| StalePatch { object, origins: at(0.0), tiles, is_new };
        let right: TileSet = 0xFFFF;
        let stale = [patch(0, right, false), patch(2, right, false), patch(1, TileSet::MAX >> 32, true), patch(3, right, true)];
        let found = reasons(&stale, &changed, 64);
        let counts: Vec<_> = found.iter().map(|reason| (reason.name.as_str(), reason.own_patches, reason.seen_by)).collect();
        assert_eq!(counts, [("left", 1, 0), ("right", 0, 2)]);
        assert!(found[1].tiles >= 2 && found[1].to_string().starts_with("right moved: 2 patches that see it"), "{}", found[1]);
    }
}

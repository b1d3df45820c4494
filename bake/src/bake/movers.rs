//! Objects that move: baked alone and in their own space, and left out of what blocks the others.

use super::stats::BakeStats;
use crate::error::BakeError;
use crate::options::{BakeOptions, Movers, RebakeOptions};
use crate::progress::Progress;
use crate::reach::pieces::Pieces;
use crate::square_light::{FieldOptions, field_key, trace_field};
use prelight_manifests::asset::AssetMover;
use prelight_manifests::{ChunkKind, Descriptor, Dtype};
use prelight_runtime::square_light::pose::{Pose, split};
use prelight_scene::world::{Occlusion, World};
use prelight_scene::{Object, Scene};
use prelight_store::{Record, Store};

/// Scales along an object's axes, without which it is in its own space.
pub(super) fn own_scale(object: &Object) -> Result<[f64; 3], BakeError> {
    split(&object.world_from_local).map(|(_, scale)| scale).ok_or_else(|| BakeError::Unsupported {
        what: format!("object '{}' moves, but its transform shears it, flattens it, or is not finite", object.name),
        help: "scale it along its own axes only, or take `moves` from its rule in scene.toml".to_string(),
    })
}

/// A scene of one object in its own space; `shared` has what scenes have beside objects.
pub(super) fn own_scene(shared: &mut Scene, object: &Object, scale: [f64; 3]) {
    shared.objects = vec![Object { world_from_local: Pose::default().matrix(scale), ..object.clone() }];
}

/// Options of a bake of one object alone.
pub(super) fn own_options(options: &BakeOptions, object: usize) -> BakeOptions {
    BakeOptions {
        points: vec![options.points[object]],
        visibility: vec![options.shades_of(object as u32)],
        techniques: Vec::new(),
        bounces: None,
        movers: Movers { moves: Vec::new(), ..options.movers },
        rebake: RebakeOptions {
            layers: vec![options.rebake.layers.get(object).copied().flatten()],
            only: None,
            paranoid: options.rebake.paranoid,
            measure: options.rebake.measure.clone(),
        },
        ..options.clone()
    }
}

/// The world in which objects that move block nothing.
pub(super) fn still_world(world: &World, movers: &Movers) -> World {
    let mut still = world.clone();
    for object in (0..world.object_start.len() - 1).filter(|object| movers.is_mover(*object)) {
        still.occlusion[world.object_start[object] as usize..world.object_start[object + 1] as usize].fill(Occlusion::None);
    }
    still
}

/// The field of the one object of a scene, from the store or traced.
pub(super) fn field(
    scene: &Scene,
    world: &World,
    options: &BakeOptions,
    store: &Store,
    stats: &mut BakeStats,
    progress: &dyn Progress,
) -> Result<Option<Descriptor>, BakeError> {
    let of = FieldOptions::of(options.movers.field_quality);
    let pieces = Pieces::build(scene, world, &vec![0; world.positions.len()], 1);
    let key = field_key(world, &pieces, of);
    let known = store.lookup(&key)?.and_then(|record| record.chunks.into_iter().next()).filter(|chunk| chunk.kind == ChunkKind::Field);
    if let Some(known) = known {
        stats.fields_known += 1;
        return Ok(Some(known));
    }
    let Some(bytes) = trace_field(scene, world, of, progress)? else { return Ok(None) };
    let mut writer = store.writer();
    let field = writer.put(ChunkKind::Field, Dtype::U8, vec![of.m as u64, of.res as u64], &bytes)?;
    writer.record(key, Record { chunks: vec![field.clone()], data: Vec::new() });
    stats.bytes_stored += writer.commit()?.bytes_stored;
    stats.fields_made += 1;
    Ok(Some(field))
}

/// A mover's part of the manifest beside the object's.
pub(super) fn moves(scale: [f64; 3], field: Option<Descriptor>) -> Option<AssetMover> {
    Some(AssetMover { scale, field })
}

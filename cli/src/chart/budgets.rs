//! `prelight chart --budgets`: the planner beside one setting for all objects.

use super::args::ChartArgs;
use crate::loaded::Loaded;
use crate::{Context, Failure, Summary};
use prelight_bake::budget::knapsack::{Contest, candidates, contest};
use prelight_bake::trace::{OccluderOptions, Occluders};
use prelight_chart::page::{Section, contest_section};
use prelight_manifests::quality::Shades;

/// The section of the page; the summary gets `contests`.
pub fn section(args: &ChartArgs, context: &Context, summary: &mut Summary) -> Result<Section, Failure> {
    // Warnings were told when the scene was baked.
    let loaded = Loaded::open_quietly(&args.scene.scene, None, &args.knobs, context)?;
    let (scene, world, options) = (&loaded.scene, &loaded.world, &loaded.settings.options);
    let occluders = Occluders::build(world, &scene.textures, OccluderOptions { quality: options.tree, ..OccluderOptions::default() });
    let settings = &loaded.settings;
    let shades: Vec<Shades> = settings.pinned.iter().map(|shades| shades.unwrap_or_default()).collect();
    let all = candidates(scene, world, &occluders, &settings.unbudgeted, options.face_resolution, &shades, context.progress())?;
    let contests: Vec<Contest> = args.budgets.iter().map(|budget| contest(&all, *budget)).collect();
    summary.set("contests", serde_json::to_value(&contests).map_err(anyhow::Error::new)?);
    Ok(contest_section(&contests, scene.objects.len()))
}

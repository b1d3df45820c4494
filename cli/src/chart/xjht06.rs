//! `prelight chart --paper xjht06`: its tables over all views of each light, and what the scene's movers take.

use super::args::ChartArgs;
use crate::opened::short_name;
use crate::output::write_atomically;
use crate::{Context, Failure, Summary};
use prelight_chart::cell::ChartLight;
use prelight_chart::measure;
use prelight_chart::papers::xjht06::{light_row, mover_row, square_text, surface_rows};
use prelight_chart::views::ChartView;
use prelight_runtime::asset::Asset;
use std::sync::Arc;

/// The tables, as text and JSON.
pub fn xjht06(
    args: &ChartArgs,
    asset: &Arc<Asset>,
    lights: &[ChartLight],
    views: &[ChartView],
    context: &Context,
) -> Result<Summary, Failure> {
    let sample = measure::sample(asset, args.timed_points as usize);
    let (mut light_rows, mut rows, mut movers) = (Vec::new(), Vec::new(), Vec::new());
    for light in lights {
        let name = short_name(&light.name);
        light_rows.push(light_row(&name, &light.cubemap));
        rows.extend(surface_rows(asset, &sample, views, (&name, &light.cubemap), context.progress())?);
        movers.extend(mover_row(asset, &sample, (&name, &light.cubemap)));
    }
    let text = square_text(&light_rows, &rows, &movers);
    let path = args.output.join("paper-xjht06.txt");
    write_atomically(&path, |out| out.write_all(text.as_bytes()))?;
    let json = |value: serde_json::Result<serde_json::Value>| value.map_err(anyhow::Error::new);
    let mut summary = Summary::new();
    summary.set("tables", path.display().to_string()).set("asset_digest", asset.manifest().asset_digest.to_string());
    summary.set("lights", json(serde_json::to_value(&light_rows))?).set("rows", json(serde_json::to_value(&rows))?);
    summary.set("movers", json(serde_json::to_value(&movers))?).set_text(text);
    Ok(summary)
}

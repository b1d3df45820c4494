//! `prelight chart --paper ifl`: its tables over all views of each light.

use super::args::ChartArgs;
use crate::opened::short_name;
use crate::output::write_atomically;
use crate::{Context, Failure, Summary};
use prelight_chart::cell::ChartLight;
use prelight_chart::measure;
use prelight_chart::papers::ifl::{paper_rows, paper_text, partly_lit, terms_svg};
use prelight_chart::views::ChartView;
use prelight_runtime::asset::Asset;

/// The tables, as text and JSON, and the map of Fig. 2.
pub fn ifl(args: &ChartArgs, asset: &Asset, lights: &[ChartLight], views: &[ChartView], context: &Context) -> Result<Summary, Failure> {
    let sample = measure::sample(asset, args.timed_points as usize);
    let mut rows = Vec::new();
    for light in lights {
        let name = short_name(&light.name);
        rows.extend(paper_rows(asset, &sample, views, (&name, &light.cubemap), context.progress())?);
    }
    let partly = partly_lit(asset, &sample);
    let text = paper_text(&rows, partly);
    let path = args.output.join("paper-ifl.txt");
    write_atomically(&path, |out| out.write_all(text.as_bytes()))?;
    if let Some(svg) = views.first().and_then(|view| terms_svg(asset, &sample, view)) {
        write_atomically(&args.output.join("paper-ifl-terms.svg"), |out| out.write_all(svg.as_bytes()))?;
    }
    let mut summary = Summary::new();
    summary.set("tables", path.display().to_string()).set("asset_digest", asset.manifest().asset_digest.to_string());
    summary.set("partly_lit", partly).set("rows", serde_json::to_value(&rows).map_err(anyhow::Error::new)?).set_text(text);
    Ok(summary)
}

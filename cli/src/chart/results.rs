//! What a chart leaves: the table, a picture per plot, the page, and how it compares with an older one.

use super::args::ChartArgs;
use super::machine::machine;
use crate::output::write_atomically;
use crate::{ExitCode, Failure};
use prelight_chart::against::{Against, against};
use prelight_chart::look::Heading;
use prelight_chart::motion::Motion;
use prelight_chart::page::{Cell, Section, page, plots};
use prelight_chart::row::{Row, to_csv};
use prelight_chart::svg::Palette;
use prelight_runtime::asset::Asset;
use prelight_runtime::block_product::SimdPath;
use std::path::{Path, PathBuf};

/// Rows against the text of an older chart's table.
pub fn compared(path: &Path, older: &str, context: &[String; 6], rows: &[Row]) -> Result<Against, Failure> {
    against(older, context, rows).map_err(|what| {
        let help = "name the chart.csv that an older `prelight chart` wrote";
        Failure::text(ExitCode::Input, format!("{} is not the table of a chart: {what}\n  help: {help}", path.display()))
    })
}

/// Differences to an older chart that people are told; the page has as many.
pub const LISTED: usize = 40;

/// Values of the columns that are the same for every row.
pub fn constants(args: &ChartArgs, asset: &Asset) -> [String; 6] {
    let (width, height) = args.size;
    [
        env!("CARGO_PKG_VERSION").to_string(),
        format!("{}, {:?}", machine(), SimdPath::detect()),
        args.scene.scene.display().to_string(),
        asset.manifest().asset_digest.to_string(),
        width.to_string(),
        height.to_string(),
    ]
}

/// CSV, one SVG per chart, the page; returns the page's path.
pub fn write_results(
    args: &ChartArgs,
    asset: &Asset,
    (cells, rows): (&[Cell], &[Row]),
    told: &[String],
    extra: &[Section],
    palette: &Palette,
) -> Result<PathBuf, Failure> {
    let (width, height) = args.size;
    let context = constants(args, asset);
    let machine = &context[1];
    let csv = to_csv(&context, rows);
    write_atomically(&args.output.join("chart.csv"), |out| out.write_all(csv.as_bytes()))?;
    for (i, cell) in cells.iter().enumerate() {
        // Still, moving light, moving view of one view under one light, as they were made.
        let kind = ["", "moving-light-", "moving-view-"][i % Motion::ALL.len()];
        for (name, svg) in plots(&cell.rows, palette) {
            let name = format!("{:02}-{kind}{name}.svg", i / Motion::ALL.len() + 1);
            write_atomically(&args.output.join(name), |out| out.write_all(svg.as_bytes()))?;
        }
    }
    let lines = vec![
        "How fast, how small and how exact each technique is on this scene. Errors at points are against the sum over all texels \
         (pixel_product) with the same texels and bits; errors of pictures are against a path tracer."
            .to_string(),
        "Times are CPU time of one thread, medians, techniques interleaved. Nothing was tuned on views that are marked held back."
            .to_string(),
        format!("{machine}; asset {:.16}; pictures {width}x{height}, references {} samples a pixel.", context[3], args.reference),
    ];
    let title = format!("prelight chart: {}", args.scene.scene.display());
    let path = args.output.join("index.html");
    let heading = Heading { title, lines, told: told.to_vec() };
    write_atomically(&path, |out| out.write_all(page(&heading, cells, extra, palette).as_bytes()))?;
    Ok(path)
}

/// The means over all cells, for people.
pub fn text(cells: &[Cell], page: &Path, seconds: f64) -> String {
    let mut text = "technique      budget              ns/point  + projection  bytes/point   at points   picture\n".to_string();
    let stills: Vec<&[Row]> = cells.iter().step_by(Motion::ALL.len()).map(|cell| &cell.rows[..]).collect();
    let mean = |i: usize, value: &dyn Fn(&Row) -> f64| stills.iter().map(|rows| value(&rows[i])).sum::<f64>() / stills.len().max(1) as f64;
    for (i, row) in stills.first().copied().unwrap_or_default().iter().enumerate() {
        text += &format!(
            "{:<14} {:<18} {:>9.0} {:>13.0} {:>12.0} {:>11.2e} {:>9.2e}\n",
            row.technique,
            row.budget,
            mean(i, &|row| row.ns_per_point),
            mean(i, &|row| row.projection_ns),
            row.bytes_per_point,
            mean(i, &|row| row.points_relative_l2.unwrap_or(f64::NAN)),
            mean(i, &|row| row.unbiased_relative_l2.unwrap_or(f64::NAN)),
        );
    }
    text + &format!("\nMeans over {} stills; errors are relative L2. All in {seconds:.0} s: {}\n", stills.len(), page.display())
}

//! `prelight chart --stability`: every known way in which a method fails, with its figures and bounds, as a page.

use super::args::ChartArgs;
use super::machine::machine;
use crate::opened::{read_environment_named, short_name};
use crate::output::write_atomically;
use crate::{Context, ExitCode, Failure, Summary};
use prelight_chart::stability::page::{MapOutcome, page};
use prelight_chart::stability::temporal::MOST_JUMP;
use prelight_chart::stability::{Bench, Sizes, run_all, run_map};
use serde_json::json;
use std::time::Instant;

/// Runs the suite; `--environment` maps are turned over its still life as well. Ends with 4 where something does not hold.
pub fn run(args: &ChartArgs, context: &Context) -> Result<Summary, Failure> {
    let start = Instant::now();
    let sizes = if args.reduced { Sizes::REDUCED } else { Sizes::FULL };
    let environments = (args.environment.iter())
        .map(|name| Ok((name.clone(), read_environment_named(name, context)?)))
        .collect::<Result<Vec<_>, Failure>>()?;
    let folder = args.output.join("stability");
    std::fs::create_dir_all(&folder).map_err(|source| prelight_bake::BakeError::output(&folder, source))?;
    let bench = Bench::new(sizes, &folder, context.progress());
    let outcomes = run_all(&bench)?;
    let mut maps: Vec<MapOutcome> = Vec::new();
    for (path, environment) in &environments {
        let name = short_name(path);
        context.progress().message(&name);
        let (found, bound) = run_map(&bench, &name, environment)?;
        maps.push((name, found, bound));
    }
    let path = args.output.join("stability.html");
    let html = page(&outcomes, &maps, &sizes, &machine());
    write_atomically(&path, |out| out.write_all(html.as_bytes()))?;

    let mut csv = "mode,technique,figure,found,bound,holds\n".to_string();
    let mut rows = Vec::new();
    let mut text = String::new();
    let mut failing = 0;
    let mut row = |mode: &str, method: &str, figure: &str, found: f64, bound: Option<f64>| {
        let holds = bound.is_none_or(|bound| found <= bound);
        failing += usize::from(!holds);
        csv += &format!("\"{mode}\",{method},\"{figure}\",{found:e},{},{holds}\n", bound.map_or(String::new(), |bound| bound.to_string()));
        let mark = if holds { "  " } else { "! " };
        text += &format!("{mark}{mode:<46} {figure:<44} {found:>11.3e}  {}\n", bound.map_or("-".to_string(), |bound| format!("{bound:e}")));
        rows.push(json!({ "mode": mode, "technique": method, "figure": figure, "found": found, "bound": bound, "holds": holds }));
    };
    for outcome in &outcomes {
        for (limit, figure, _) in outcome.figures() {
            row(outcome.mode.name, outcome.mode.method, limit.name, figure, Some(limit.most));
        }
    }
    for (name, found, bound) in &maps {
        row(name, "block_product", "99.9th percentile, of 255", found.figures[0], *bound);
        row(name, "block_product", "maximum, of 255", found.figures[1], None);
        row(name, "block_product", "worst frame, times the median frame", found.figures[2], Some(MOST_JUMP));
    }
    let csv_path = args.output.join("stability.csv");
    write_atomically(&csv_path, |out| out.write_all(csv.as_bytes()))?;
    let mut summary = Summary::new();
    if failing > 0 {
        summary.exit_code = ExitCode::Found;
    }
    text += &format!("\n{failing} figures beyond their bounds. All in {:.0} s: {}\n", start.elapsed().as_secs_f64(), path.display());
    summary
        .set("page", path.display().to_string())
        .set("csv", csv_path.display().to_string())
        .set("failing", failing)
        .set("figures", rows)
        .set("seconds.total", start.elapsed().as_secs_f64())
        .set_text(text);
    Ok(summary)
}

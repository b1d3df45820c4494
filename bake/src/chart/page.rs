//! The table page: plain HTML, no scripts, charts inside.

use super::row::{Row, fields};
use super::svg::{Mark, Plot, escaped};
use std::fmt::Write;

/// What stands above the tables.
#[derive(Clone, Debug, Default)]
pub struct Heading {
    /// Title.
    pub title: String,
    /// Lines below it.
    pub lines: Vec<String>,
}

/// Cost and error of a chart, and which front its marks are filled by.
struct Axes {
    name: &'static str,
    cost_name: &'static str,
    error_name: &'static str,
    pair: fn(&Row) -> (f64, Option<f64>),
    is_front: fn(&Row) -> bool,
    has_line: bool,
}

const AXES: [Axes; 4] = [
    Axes {
        name: "points",
        cost_name: "ns per point, CPU time of one thread, projection of the surface included",
        error_name: "relative L2 at points against pixel_product",
        pair: |row| (row.ns_per_point + row.projection_ns, row.points_relative_l2),
        is_front: |row| row.pareto_points,
        has_line: false,
    },
    Axes {
        name: "picture",
        cost_name: "ns per point (line: ns per pixel), CPU time of one thread, projection included",
        error_name: "relative L2 of the picture, freed of noise",
        pair: |row| (row.ns_per_point + row.projection_ns, row.unbiased_relative_l2),
        is_front: |row| row.pareto_picture,
        has_line: true,
    },
    Axes {
        name: "bytes",
        cost_name: "bytes of visibility per point",
        error_name: "relative L2 at points against pixel_product",
        pair: |row| (row.bytes_per_point, row.points_relative_l2),
        is_front: |row| row.pareto_bytes,
        has_line: false,
    },
    Axes {
        name: "bake",
        cost_name: "seconds to bake the asset for the technique",
        error_name: "relative L2 at points against pixel_product",
        pair: |row| (row.bake_seconds, row.points_relative_l2),
        is_front: |_| false,
        has_line: false,
    },
];

/// The charts of one cell: name and SVG.
pub fn plots(cell: &[Row]) -> Vec<(&'static str, String)> {
    let Some(first) = cell.first() else { return Vec::new() };
    let held_back = if first.held_back { ", held back" } else { "" };
    AXES.iter()
        .map(|axes| {
            let mark = |row: &Row| {
                let (cost, error) = (axes.pair)(row);
                let (series, label) = (row.technique.clone(), row.budget.clone());
                Mark { series, label, cost, error: error.unwrap_or(f64::NAN), is_front: (axes.is_front)(row) }
            };
            let plot = Plot {
                title: format!("{}, {}{held_back}", first.environment, first.view),
                cost_name: axes.cost_name.to_string(),
                error_name: axes.error_name.to_string(),
                marks: cell.iter().map(mark).collect(),
                line: axes.has_line.then(|| ("path tracer at equal error".to_string(), reference_line(cell))),
            };
            (axes.name, plot.to_svg())
        })
        .collect()
}

/// Cost of the path tracer over six decades of error: its noise falls with the root of its cost.
fn reference_line(cell: &[Row]) -> Vec<(f64, f64)> {
    let known = cell.iter().find_map(|row| Some((row.reference_ns_per_pixel?, row.unbiased_relative_l2.filter(|error| *error > 0.0)?)));
    let Some((cost, error)) = known else { return Vec::new() };
    (-6..=1).map(|decade| 10f64.powi(decade)).map(|e| (cost * (error / e) * (error / e), e)).collect()
}

/// The page: heading, then each cell's charts and table. `cells` are the rows of one environment and view each.
pub fn page(heading: &Heading, cells: &[Vec<Row>]) -> String {
    let mut out = format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{0}</title>\n<style>\
         body{{font:14px sans-serif;margin:2em;max-width:1500px}}table{{border-collapse:collapse;font-size:12px}}\
         td,th{{padding:3px 8px;text-align:right;border-bottom:1px solid #ddd}}td.name,th.name{{text-align:left}}\
         tr.front{{background:#eef5ee}}.charts svg{{width:48%;min-width:420px}}</style></head><body>\n<h1>{0}</h1>\n",
        escaped(&heading.title)
    );
    for line in &heading.lines {
        let _ = writeln!(out, "<p>{}</p>", escaped(line));
    }
    for cell in cells {
        let Some(first) = cell.first() else { continue };
        let held_back = if first.held_back { " (held back)" } else { "" };
        let _ = writeln!(out, "<h2>{}, {}{held_back}</h2>\n<div class=\"charts\">", escaped(&first.environment), escaped(&first.view));
        plots(cell).iter().for_each(|(_, svg)| out += svg);
        out += "</div>\n<table><tr>";
        // Environment, view and held_back stand in the heading.
        for (name, _) in fields(first).iter().skip(3) {
            let _ = write!(out, "<th>{}</th>", escaped(&name.replace('_', " ")));
        }
        out += "</tr>\n";
        for row in cell {
            out += if row.pareto_points || row.pareto_picture { "<tr class=\"front\">" } else { "<tr>" };
            for (name, value) in fields(row).iter().skip(3) {
                let class = if ["technique", "budget"].contains(&name.as_str()) { " class=\"name\"" } else { "" };
                let value = match value.as_str() {
                    "true" => "yes",
                    "false" => "",
                    other => other,
                };
                let _ = write!(out, "<td{class}>{}</td>", escaped(value));
            }
            out += "</tr>\n";
        }
        out += "</table>\n";
    }
    out + "</body></html>\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_has_every_row_and_four_charts_a_cell() {
        let row = |budget: &str, ns: f64, error: f64| Row {
            environment: "noon & night".into(),
            technique: "haar_triple".into(),
            budget: budget.into(),
            ns_per_point: ns,
            bytes_per_point: 10.0 * ns,
            bake_seconds: 3.0,
            points_relative_l2: Some(error),
            unbiased_relative_l2: Some(2.0 * error),
            reference_ns_per_pixel: Some(1e5),
            ..Row::default()
        };
        let mut cell = vec![row("1 %", 100.0, 0.1), row("10 %", 300.0, 0.01)];
        super::super::row::mark_fronts(&mut cell);
        let text = page(&Heading { title: "a < b".into(), lines: vec!["one".into()] }, &[cell.clone(), Vec::new()]);
        assert!(text.contains("<h1>a &lt; b</h1>") && text.contains("noon &amp; night"));
        assert_eq!(text.matches("<tr class=\"front\">").count(), 2);
        assert_eq!(text.matches("</svg>").count(), 4);
        let line = reference_line(&cell);
        // At the picture's error the line has the row's cost.
        let at = |e: f64| line.iter().find(|(_, error)| *error == e).unwrap().0;
        assert!((at(0.1) - 1e5 * 4.0).abs() < 1.0 && (at(0.01) / at(0.1) - 100.0).abs() < 1e-6);
    }
}

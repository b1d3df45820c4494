//! The page of a chart: what all scenes' figures say at a glance, then each cell with its charts, its pictures and its table.
//!
//! Stills, moving lights and moving views stand apart, and so does what nothing was ever tuned on. One file ([`super::look`]).

use super::look::{Heading, picture, whole};
use super::motion::Motion;
use super::row::{Row, fields, significant};
use super::svg::{Mark, Palette, Plot, Unit, escaped, in_unit};
use super::thumbnail::scale;
use prelight_bake::budget::knapsack::Contest;
use std::fmt::Write;

/// One view under one light in one motion.
#[derive(Clone, Debug, Default)]
pub struct Cell {
    /// A row for each technique and budget.
    pub rows: Vec<Row>,
    /// PNG of the path tracer's picture.
    pub truth: Option<Vec<u8>>,
    /// PNG of the picture and of its error, a pair a row, where there are any.
    pub pictures: Vec<Option<[Vec<u8>; 2]>>,
}

/// A section of the page that is not of cells: anchor, text of its link, HTML.
pub type Section = (String, String, String);

/// Cost and error of a chart, and which front its marks are filled by.
struct Axes {
    name: &'static str,
    title: &'static str,
    cost_name: &'static str,
    unit: Unit,
    error_name: &'static str,
    pair: fn(&Row) -> (f64, Option<f64>),
    is_front: fn(&Row) -> bool,
    has_line: bool,
}

const POINTS: &str = "relative L2 at points, against pixel_product";

const AXES: [Axes; 4] = [
    Axes {
        name: "picture",
        title: "Error of the picture against time",
        cost_name: "CPU time per point of one thread, projection included (line: per pixel)",
        unit: Unit::Nanoseconds,
        error_name: "relative L2 against the path tracer, freed of noise",
        pair: |row| (row.frame_ns(), row.unbiased_relative_l2),
        is_front: |row| row.pareto_picture,
        has_line: true,
    },
    Axes {
        name: "points",
        title: "Error at points against time",
        cost_name: "CPU time per point of one thread, projection included",
        unit: Unit::Nanoseconds,
        error_name: POINTS,
        pair: |row| (row.frame_ns(), row.points_relative_l2),
        is_front: |row| row.pareto_points,
        has_line: false,
    },
    Axes {
        name: "bytes",
        title: "Error at points against memory",
        cost_name: "bytes of visibility per point",
        unit: Unit::Bytes,
        error_name: POINTS,
        pair: |row| (row.bytes_per_point, row.points_relative_l2),
        is_front: |row| row.pareto_bytes,
        has_line: false,
    },
    Axes {
        name: "bake",
        title: "Error at points against the bake",
        cost_name: "time to bake the asset for the technique",
        unit: Unit::Seconds,
        error_name: POINTS,
        pair: |row| (row.bake_seconds, row.points_relative_l2),
        is_front: |_| false,
        has_line: false,
    },
];

/// What is charted of things that move.
const MOVING: [Axes; 2] = [
    Axes {
        name: "points",
        title: "Error at points against a frame's time",
        cost_name: "CPU time per point and frame, with its share of preparing a moving light",
        unit: Unit::Nanoseconds,
        error_name: POINTS,
        pair: |row| (row.frame_ns(), row.points_relative_l2),
        is_front: |row| row.pareto_points,
        has_line: false,
    },
    Axes {
        name: "temporal",
        title: "Flicker against a frame's time",
        cost_name: "CPU time per point and frame, with its share of preparing a moving light",
        unit: Unit::Nanoseconds,
        error_name: "temporal error, 99.9th percentile, steps of 1/255",
        pair: |row| (row.frame_ns(), row.temporal_p999),
        is_front: |_| false,
        has_line: false,
    },
];

/// What stands beside a mark.
fn short(budget: &str) -> String {
    budget.replace("tolerance ", "").replace(", ", " ").replace(" coefficients", "")
}

/// What hovering says.
fn hover(row: &Row) -> Vec<String> {
    let figure = |value: Option<f64>| value.map_or("-".to_string(), significant);
    let mut lines = vec![
        format!("{}, {}", row.technique, row.budget),
        format!("{} a point{}", in_unit(row.frame_ns(), Unit::Nanoseconds), if row.pareto_points { ", on the Pareto front" } else { "" }),
        format!("{} a point, bake {}", in_unit(row.bytes_per_point, Unit::Bytes), in_unit(row.bake_seconds, Unit::Seconds)),
        format!("light prepared in {}", in_unit(row.prepare_seconds.max(1e-6), Unit::Seconds)),
        format!("error at points {}", figure(row.points_relative_l2)),
    ];
    if row.unbiased_relative_l2.is_some() {
        let (error, psnr, flip) = (figure(row.unbiased_relative_l2), figure(row.psnr_db), figure(row.flip));
        lines.push(format!("error of the picture {error}, {psnr} dB, FLIP {flip}"));
    }
    if let (Some(p999), Some(max)) = (row.temporal_p999, row.temporal_max) {
        lines.push(format!("temporal error {} of 255 at 99.9 %, {} at most", significant(p999), significant(max)));
    }
    lines
}

/// The charts of one cell: name and SVG.
pub fn plots(rows: &[Row], palette: &Palette) -> Vec<(&'static str, String)> {
    let Some(first) = rows.first() else { return Vec::new() };
    let axes: &[Axes] = if first.motion == Motion::Still.name() { &AXES } else { &MOVING };
    (axes.iter())
        .map(|axes| {
            let mark = |(row, of): (usize, &Row)| {
                let (cost, error) = (axes.pair)(of);
                let (series, label) = (of.technique.clone(), short(&of.budget));
                Mark { series, label, hover: hover(of), row, cost, error: error.unwrap_or(f64::NAN), is_front: (axes.is_front)(of) }
            };
            let plot = Plot {
                title: axes.title.to_string(),
                cost_name: axes.cost_name.to_string(),
                unit: axes.unit,
                error_name: axes.error_name.to_string(),
                marks: rows.iter().enumerate().map(mark).collect(),
                line: axes.has_line.then(|| ("path tracer at equal error".to_string(), reference_line(rows))),
                palette: palette.clone(),
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

/// Geometric mean of the values above 0; `None` without one.
fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let logs: Vec<f64> = values.filter(|value| *value > 0.0).map(f64::ln).collect();
    (!logs.is_empty()).then(|| (logs.iter().sum::<f64>() / logs.len() as f64).exp())
}

/// Geometric means of each technique and budget over stills, seen or held back.
fn means(cells: &[Cell], held_back: bool) -> Vec<Row> {
    let stills: Vec<&Cell> = (cells.iter())
        .filter(|cell| cell.rows.first().is_some_and(|row| row.motion == Motion::Still.name() && row.held_back == held_back))
        .collect();
    let Some(first) = stills.first() else { return Vec::new() };
    let mut rows: Vec<Row> = (0..first.rows.len())
        .map(|i| {
            let all = || stills.iter().filter_map(|cell| cell.rows.get(i));
            let over = |value: fn(&Row) -> Option<f64>| mean(all().filter_map(value));
            Row {
                ns_per_point: over(|row| Some(row.ns_per_point)).unwrap_or(0.0),
                projection_ns: over(|row| Some(row.projection_ns)).unwrap_or(0.0),
                prepare_seconds: over(|row| Some(row.prepare_seconds)).unwrap_or(0.0),
                points_relative_l2: over(|row| row.points_relative_l2),
                unbiased_relative_l2: over(|row| row.unbiased_relative_l2),
                psnr_db: over(|row| row.psnr_db),
                flip: over(|row| row.flip),
                reference_ns_per_pixel: over(|row| row.reference_ns_per_pixel),
                ..first.rows[i].clone()
            }
        })
        .collect();
    super::row::mark_fronts(&mut rows);
    rows
}

/// The page. `extra`: what stands before the cells.
pub fn page(heading: &Heading, cells: &[Cell], extra: &[Section], palette: &Palette) -> String {
    let mut links = vec![("glance".to_string(), "At a glance".to_string())];
    let mut body = glance(cells, palette);
    for (anchor, link, html) in extra {
        links.push((anchor.clone(), link.clone()));
        let _ = writeln!(body, "<section id=\"{}\">\n{html}</section>", escaped(anchor));
    }
    for motion in Motion::ALL {
        for held_back in [false, true] {
            let chosen: Vec<&Cell> = (cells.iter())
                .filter(|cell| cell.rows.first().is_some_and(|row| row.motion == motion.name() && row.held_back == held_back))
                .collect();
            if chosen.is_empty() {
                continue;
            }
            let (kind, says) = match motion {
                Motion::Still => (
                    "Stills",
                    "Each picture stands beside its error against the path tracer, whose own noise is taken out (local means over 5 × 5 pixels).",
                ),
                Motion::Light => (
                    "Moving light",
                    "The light turns by 0.25° a frame. The right picture is what flickers: the change between two frames, less that of the plain sum over texels.",
                ),
                Motion::View => (
                    "Moving view",
                    "The eye circles by 0.25° a frame; who can, keeps diffuse light. The right picture is what flickers: the change between two frames, less that of the plain sum over texels.",
                ),
            };
            let title = format!("{kind}{}", if held_back { ", held back" } else { "" });
            let anchor = title.to_lowercase().replace([' ', ','], "-");
            let held = if held_back { " No constant of prelight was chosen by looking at these." } else { "" };
            let _ = writeln!(body, "<h2 id=\"{anchor}\">{title}</h2>\n<p class=\"soft\">{says}{held}</p>\n{}", scale());
            links.push((anchor, title));
            chosen.iter().for_each(|cell| article(&mut body, cell, palette));
        }
    }
    whole(heading, &links, &body)
}

/// The planner of budgets beside one edge length for all objects.
pub fn contest_section(contests: &[Contest], objects: usize) -> Section {
    let marks = contests.iter().enumerate().flat_map(|(row, contest)| {
        let sides =
            [("planner", contest.planner_points, contest.ratio() <= 1.0), ("one setting", contest.single_points, contest.ratio() >= 1.0)];
        sides.map(|(series, points, is_front)| Mark {
            series: series.to_string(),
            label: significant(contest.budget),
            hover: vec![
                format!("{series}, error of at most {}", contest.budget),
                format!("{points} points"),
                format!("{} objects declared", contest.declared),
            ],
            row,
            cost: points as f64,
            error: contest.budget,
            is_front,
        })
    });
    let plot = Plot {
        title: "What a budget of error takes".to_string(),
        cost_name: "points, to which bytes and work are in proportion".to_string(),
        unit: Unit::Number,
        error_name: "budget: relative L2 between points".to_string(),
        marks: marks.collect(),
        line: None,
        palette: Palette::new([("planner", Some(5)), ("one setting", Some(6))]),
    };
    let mut out = format!(
        "<h2>The planner and one setting for all</h2>\n<p>For each budget the planner takes of each object the cheapest edge length and border of shadows \
         that meet it; beside it, the cheapest setting for all objects at which every object that can meet the budget does: with borders, and of \
         edge lengths alone. Same technique, directions and bits; objects that are declared are on neither side.</p>\n\
         <article><div class=\"plots\">{}</div>\n<table><tr><th>budget</th><th>declared, of {objects}</th><th>points, planner</th>\
         <th>points, one for all</th><th>its edge length, times each own</th><th>its unrest, times each own²</th><th>planner / one for all</th>\
         <th>points, edge lengths alone</th></tr>\n",
        plot.to_svg()
    );
    for (row, contest) in contests.iter().enumerate() {
        let _ = writeln!(
            out,
            "<tr data-row=\"{row}\"><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            contest.budget,
            contest.declared,
            contest.planner_points,
            contest.single_points,
            contest.single_share,
            contest.single_unrest.map_or("none".to_string(), |unrest| significant(f64::from(unrest))),
            significant(contest.ratio()),
            contest.plain_points.map_or("none meets".to_string(), |points| points.to_string()),
        );
    }
    out += "</table></article>\n";
    ("planner".to_string(), "The planner".to_string(), out)
}

fn glance(cells: &[Cell], palette: &Palette) -> String {
    let mut out = "<h2 id=\"glance\">At a glance</h2>\n<p>Lower is more accurate, further left is cheaper. Hover a mark for its settings and pictures. \
                   Geometric means over all stills.</p>\n"
        .to_string();
    for (held_back, name) in [(false, "Views and lights that were looked at"), (true, "Held back: never tuned on")] {
        let rows = means(cells, held_back);
        if rows.is_empty() {
            continue;
        }
        let _ = writeln!(out, "<article><header><h3>{name}</h3></header>\n<div class=\"plots\">");
        plots(&rows, palette).into_iter().take(3).for_each(|(_, svg)| out += &svg);
        out += "</div>\n<div class=\"wide\"><table><tr><th class=\"name\">technique</th><th class=\"name\">budget</th><th>time a point</th>\
                <th>bytes a point</th><th>error at points</th><th>error of the picture</th><th>PSNR dB</th><th>FLIP</th>\
                <th>path tracer, a pixel at equal error</th></tr>\n";
        for (i, row) in rows.iter().enumerate() {
            let figure = |value: Option<f64>| value.map_or(String::new(), significant);
            let class = if row.pareto_points || row.pareto_picture { " class=\"front\"" } else { "" };
            let _ = writeln!(
                out,
                "<tr{class} data-row=\"{i}\"><td class=\"name\"><span class=\"dot\" style=\"background:{}\"></span>{}</td><td class=\"name\">{}</td>\
                 <td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
                palette.colour(&row.technique),
                escaped(&row.technique),
                escaped(&row.budget),
                in_unit(row.frame_ns(), Unit::Nanoseconds),
                in_unit(row.bytes_per_point, Unit::Bytes),
                figure(row.points_relative_l2),
                figure(row.unbiased_relative_l2),
                figure(row.psnr_db),
                figure(row.flip),
                row.reference_ns_per_pixel.map_or(String::new(), |ns| in_unit(ns, Unit::Nanoseconds)),
            );
        }
        out += "</table></div></article>\n";
    }
    out
}

fn article(out: &mut String, cell: &Cell, palette: &Palette) {
    let Some(first) = cell.rows.first() else { return };
    let held_back = if first.held_back { "<span class=\"badge held\">held back</span>" } else { "" };
    let _ = writeln!(
        out,
        "<article><header><h3>{}, {}</h3><span class=\"badge\">{}</span>{held_back}</header>\n<div class=\"plots\">",
        escaped(&first.environment),
        escaped(&first.view),
        escaped(&first.motion)
    );
    plots(&cell.rows, palette).iter().for_each(|(_, svg)| *out += svg);
    *out += "</div>\n<div class=\"cards\">\n";
    if let Some(truth) = &cell.truth {
        let noise = first.reference_noise.map_or(String::new(), |noise| format!("<br>its noise {}", significant(noise)));
        let _ = writeln!(
            out,
            "<figure class=\"truth\"><div class=\"pair\">{}</div><figcaption><b>path tracer</b>{noise}</figcaption></figure>",
            picture(truth, "path tracer")
        );
    }
    for (i, row) in cell.rows.iter().enumerate() {
        let Some(Some([shown, error])) = cell.pictures.get(i) else { continue };
        let class = if row.pareto_points || row.pareto_picture { " class=\"front\"" } else { "" };
        let says: Vec<String> = hover(row).iter().skip(1).map(|line| escaped(line)).collect();
        let name = format!("{} {}", row.technique, row.budget);
        let _ = writeln!(
            out,
            "<figure data-row=\"{i}\"><div class=\"pair\">{}{}</div><figcaption{class}><span class=\"dot\" style=\"background:{}\"></span>\
             <b>{}</b> {}<br>{}</figcaption></figure>",
            picture(shown, &name),
            picture(error, &format!("error of {name}")),
            palette.colour(&row.technique),
            escaped(&row.technique),
            escaped(&row.budget),
            says.join("<br>")
        );
    }
    *out += "</div>\n";
    table(out, &cell.rows);
    *out += "</article>\n";
}

/// All figures of a cell. Environment, view, held_back and motion stand in the heading; columns without a figure are left out.
fn table(out: &mut String, rows: &[Row]) {
    let lines: Vec<Vec<(String, String)>> = rows.iter().map(|row| fields(row).split_off(4)).collect();
    let shown: Vec<usize> = (0..lines[0].len()).filter(|i| lines.iter().any(|line| !line[*i].1.is_empty())).collect();
    *out += "<details><summary>All figures</summary><div class=\"wide\"><table><tr>";
    let class = |name: &str| if ["technique", "budget"].contains(&name) { " class=\"name\"" } else { "" };
    for i in &shown {
        let name = &lines[0][*i].0;
        let _ = write!(out, "<th{}>{}</th>", class(name), escaped(&name.replace('_', " ")));
    }
    *out += "</tr>\n";
    for (i, (row, line)) in rows.iter().zip(&lines).enumerate() {
        let front = if row.pareto_points || row.pareto_picture { " class=\"front\"" } else { "" };
        let _ = write!(out, "<tr{front} data-row=\"{i}\">");
        for (name, value) in shown.iter().map(|i| &line[*i]) {
            let value = match value.as_str() {
                "true" => "yes",
                "false" => "",
                other => other,
            };
            let _ = write!(out, "<td{}>{}</td>", class(name), escaped(value));
        }
        *out += "</tr>\n";
    }
    *out += "</table></div></details>\n";
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(budget: &str, ns: f64, error: f64) -> Row {
        Row {
            environment: "noon & night".into(),
            motion: Motion::Still.name().into(),
            technique: "haar_triple".into(),
            budget: budget.into(),
            ns_per_point: ns,
            bytes_per_point: 10.0 * ns,
            bake_seconds: 3.0,
            points_relative_l2: Some(error),
            unbiased_relative_l2: Some(2.0 * error),
            reference_ns_per_pixel: Some(1e5),
            ..Row::default()
        }
    }

    #[test]
    fn a_page_has_every_row_its_charts_and_its_pictures_and_keeps_held_back_apart() {
        let mut rows = vec![row("1 %", 100.0, 0.1), row("10 %", 300.0, 0.01)];
        super::super::row::mark_fronts(&mut rows);
        let seen = Cell { rows: rows.clone(), truth: Some(vec![1]), pictures: vec![Some([vec![2], vec![3]]), None] };
        let mut held = seen.clone();
        held.rows.iter_mut().for_each(|row| row.held_back = true);
        let mut moving = Cell { rows, ..Cell::default() };
        moving.rows.iter_mut().for_each(|row| (row.motion, row.temporal_p999) = (Motion::Light.name().into(), Some(1.0)));
        let heading = Heading { title: "a < b".into(), lines: vec!["one".into()], told: Vec::new() };
        let extra = [("own".to_string(), "Own".to_string(), "<p>mine</p>\n".to_string())];
        let text = page(&heading, &[seen.clone(), held, moving, Cell::default()], &extra, &Palette::default());
        assert!(text.contains("<h1>a &lt; b</h1>") && text.contains("noon &amp; night") && text.contains("<p>mine</p>"));
        // Three at a glance for each of seen and held back, four a still, two for what moves.
        assert_eq!(text.matches("</svg>").count(), 2 * 3 + 2 * 4 + 2);
        assert_eq!(text.matches("<img").count(), 2 * 3);
        let place = |what: &str| text.find(what).unwrap_or_else(|| panic!("{what}"));
        assert!(
            place("id=\"stills\"") < place("id=\"stills--held-back\"") && place("id=\"stills--held-back\"") < place("id=\"moving-light\"")
        );
        let line = reference_line(&seen.rows);
        // At the picture's error the line has the row's cost.
        let at = |e: f64| line.iter().find(|(_, error)| *error == e).unwrap().0;
        assert!((at(0.1) - 1e5 * 4.0).abs() < 1.0 && (at(0.01) / at(0.1) - 100.0).abs() < 1e-6);
    }

    #[test]
    fn the_planners_section_shows_both_sides_of_each_budget() {
        let contest = |budget: f64| Contest {
            budget,
            declared: 1,
            planner_points: 500,
            single_share: 2.0,
            single_unrest: None,
            single_points: 1000,
            plain_points: None,
        };
        let (anchor, _, html) = contest_section(&[contest(0.1), contest(0.05)], 7);
        assert_eq!((anchor.as_str(), html.matches("<tr data-row").count(), html.matches("class=\"mark\"").count()), ("planner", 2, 4));
        assert!(html.contains("0.5000") && html.contains("of 7"), "{html}");
    }

    #[test]
    fn means_are_of_logarithms() {
        assert_eq!(mean([].into_iter()), None);
        assert!((mean([1.0, 100.0, 0.0].into_iter()).unwrap() - 10.0).abs() < 1e-12);
    }
}

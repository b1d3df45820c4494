//! The page of the suite: each mode with its figures, its bounds, how it went and what it looked like.

use super::{Found, Outcome, Sizes};
use crate::look::{Heading, picture, whole};
use crate::row::significant;
use crate::svg::escaped;
use crate::thumbnail::scale;
use std::fmt::Write;

/// A map that was turned, what it gave, and its bound where one is known.
pub type MapOutcome = (String, Found, Option<f64>);

/// A sparkline of a series, 0 at the bottom; the bound as a line where it is within sight.
fn spark(series: &[f64], bound: f64) -> String {
    const SIZE: [f64; 2] = [200.0, 46.0];
    let most = series.iter().copied().filter(|x| x.is_finite()).fold(0.0f64, f64::max);
    if series.len() < 2 || most <= 0.0 {
        return String::new();
    }
    let top = if bound <= 3.0 * most { most.max(bound) } else { most } * 1.08;
    let y = |value: f64| SIZE[1] - 3.0 - (SIZE[1] - 6.0) * (value / top).clamp(0.0, 1.0);
    let x = |i: usize| 2.0 + (SIZE[0] - 4.0) * i as f64 / (series.len() - 1) as f64;
    let path: Vec<String> = series.iter().enumerate().map(|(i, value)| format!("{:.1},{:.1}", x(i), y(*value))).collect();
    let line = if bound <= top {
        format!("<path d=\"M0 {0:.1}H{1}\" stroke=\"#d1603d\" stroke-dasharray=\"4 3\"/>", y(bound), SIZE[0])
    } else {
        String::new()
    };
    format!(
        "<svg class=\"spark\" viewBox=\"0 0 {0} {1}\"><rect width=\"{0}\" height=\"{1}\" rx=\"4\" fill=\"#f5f4f1\"/>{line}\
         <polyline points=\"{2}\" fill=\"none\" stroke=\"#1f5fa8\" stroke-width=\"1.4\"/></svg>",
        SIZE[0],
        SIZE[1],
        path.join(" ")
    )
}

fn verdict(holds: bool) -> &'static str {
    if holds { "<span class=\"badge good\">holds</span>" } else { "<span class=\"badge bad\">fails</span>" }
}

/// A bound as it was written: small ones as powers of ten.
fn bound(most: f64) -> String {
    if most > 0.0 && most < 1e-3 { format!("{most:e}") } else { most.to_string() }
}

/// The page.
pub fn page(outcomes: &[Outcome], maps: &[MapOutcome], sizes: &Sizes, machine: &str) -> String {
    let holding = outcomes.iter().filter(|outcome| outcome.holds()).count();
    let heading = Heading {
        title: "prelight: where methods fail".to_string(),
        lines: vec![
            format!("{holding} of {} known ways to fail stay within their bounds.", outcomes.len()),
            format!(
                "Pictures {}x{}, {} frames, references {} samples a pixel; incremental sums over {} frames. {machine}.",
                sizes.size[0], sizes.size[1], sizes.frames, sizes.samples, sizes.drift
            ),
            "Temporal error of a pixel: its change between two frames less that of the path tracer with the same seed, on a display whose exposure \
             stands still, in steps of 1/255."
                .to_string(),
        ],
        told: Vec::new(),
    };
    let mut body =
        "<h2 id=\"modes\">Modes</h2>\n<div class=\"wide\"><table><tr><th class=\"name\">mode</th><th class=\"name\">technique</th>\
                    <th class=\"name\">figure</th><th>found</th><th>bound</th><th></th><th class=\"name\">over frames or places</th></tr>\n"
            .to_string();
    for outcome in outcomes {
        for (i, (limit, figure, kept)) in outcome.figures().enumerate() {
            let first = |text: &str| if i == 0 { escaped(text) } else { String::new() };
            let spark = if i == 0 { spark(&outcome.found.series, limit.most) } else { String::new() };
            let _ = writeln!(
                body,
                "<tr><td class=\"name\"><b title=\"{}\">{}</b></td><td class=\"name\">{}</td><td class=\"name\">{}</td><td>{}</td><td>{}</td>\
                 <td>{}</td><td class=\"name\">{spark}</td></tr>",
                escaped(outcome.mode.says),
                first(outcome.mode.name),
                first(outcome.mode.method),
                escaped(limit.name),
                significant(figure),
                bound(limit.most),
                verdict(kept)
            );
        }
    }
    body += "</table></div>\n";
    let mut links = vec![("modes".to_string(), "Modes".to_string())];
    if !maps.is_empty() {
        links.push(("maps".to_string(), "Maps".to_string()));
        body += "<h2 id=\"maps\">Maps that turn by 0.25° a frame</h2>\n<div class=\"wide\"><table><tr><th class=\"name\">map</th><th>99.9th percentile</th>\
                 <th>bound</th><th>maximum</th><th>worst frame, times the median</th><th></th><th class=\"name\">over frames</th></tr>\n";
        for (name, found, bound) in maps {
            let holds = bound.is_none_or(|bound| found.figures[0] <= bound) && found.figures[2] <= 3.0;
            let _ = writeln!(
                body,
                "<tr><td class=\"name\">{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td class=\"name\">{}</td></tr>",
                escaped(name),
                significant(found.figures[0]),
                bound.map_or("none yet".to_string(), |bound| bound.to_string()),
                significant(found.figures[1]),
                significant(found.figures[2]),
                verdict(holds),
                spark(&found.series, bound.unwrap_or(f64::INFINITY))
            );
        }
        body += "</table></div>\n";
    }
    links.push(("what".to_string(), "What is done".to_string()));
    let _ = writeln!(body, "<h2 id=\"what\">What is done</h2>\n{}<div class=\"plots\">", scale());
    let says = |name: &str, says: &str, found: &Found, badge: &str| {
        let pictures = found.pictures.as_ref().map_or(String::new(), |[shown, error]| {
            format!(
                "<figure><div class=\"pair\">{}{}</div><figcaption>the worst frame, and what flickers in it</figcaption></figure>",
                picture(shown, name),
                picture(error, "temporal error")
            )
        });
        format!("<article><header><h3>{}</h3>{badge}</header><p>{}</p>{pictures}</article>\n", escaped(name), escaped(says))
    };
    for outcome in outcomes {
        body += &says(outcome.mode.name, outcome.mode.says, &outcome.found, verdict(outcome.holds()));
    }
    for (name, found, _) in maps {
        body += &says(name, "The map turns by 0.25° a frame over the still life.", found, "");
    }
    whole(&heading, &links, &(body + "</div>\n"))
}

#[cfg(test)]
mod tests {
    use super::super::MODES;
    use super::*;

    #[test]
    fn the_page_shows_every_mode_and_which_fail() {
        let outcome = |i: usize| {
            let figures = MODES[i].limits.iter().map(|limit| if i == 2 { limit.most + 1.0 } else { limit.most }).collect();
            Outcome { mode: &MODES[i], found: Found { figures, series: vec![0.5, 1.0, 0.2], pictures: None }, sizes: Sizes::FULL }
        };
        let outcomes: Vec<Outcome> = (0..MODES.len()).map(outcome).collect();
        let map = Found { figures: vec![2.0, 3.0, 4.0], series: vec![1.0, 2.0], pictures: Some([vec![1], vec![2]]) };
        let text = page(&outcomes, &[("noon & night".to_string(), map, Some(4.0))], &Sizes::REDUCED, "a machine");
        assert!(MODES.iter().all(|mode| text.contains(&escaped(mode.name)) && text.contains(&escaped(mode.says))));
        assert!(text.contains(&format!("{} of {} known", MODES.len() - 1, MODES.len())) && text.contains("noon &amp; night"));
        // All figures of the third mode, its own badge, and the map, whose worst frame is more than three medians.
        assert_eq!(text.matches("badge bad\">").count(), MODES[2].limits.len() + 2);
        assert!(spark(&[1.0], 1.0).is_empty() && spark(&[0.0, 0.0], 1.0).is_empty());
    }

    #[test]
    fn a_figure_that_is_missing_or_no_number_does_not_hold() {
        let mode = &MODES[0];
        let with = |figures: Vec<f64>| Outcome { mode, found: Found { figures, ..Found::default() }, sizes: Sizes::FULL }.holds();
        let kept: Vec<f64> = mode.limits.iter().map(|limit| limit.most).collect();
        assert!(with(kept.clone()) && !with(kept[1..].to_vec()) && !with(Vec::new()));
        assert!(!with(kept.iter().map(|_| f64::NAN).collect()));
    }
}

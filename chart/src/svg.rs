//! Error against cost, both logarithmic: one colour and one shape per series, a thin line through its budgets, the Pareto front as a pale band
//! with its marks filled.
//!
//! Labels stand where they hide nothing: each tries eight places around its mark and stays away when all are taken; hovering says it anyway.

use std::fmt::Write;

/// One mark.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mark {
    /// Series that it belongs to.
    pub series: String,
    /// What stands beside it: short.
    pub label: String,
    /// What hovering says, a line each.
    pub hover: Vec<String>,
    /// Number that ties it to other things on a page.
    pub row: usize,
    /// Horizontal, above 0.
    pub cost: f64,
    /// Vertical, above 0.
    pub error: f64,
    /// On the Pareto front.
    pub is_front: bool,
}

/// What an axis counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Unit {
    /// A number.
    #[default]
    Number,
    /// Nanoseconds, written in the unit that suits.
    Nanoseconds,
    /// Seconds, the same.
    Seconds,
    /// Bytes, the same.
    Bytes,
}

/// A chart of marks and, if there is one, a line.
#[derive(Clone, Debug, Default)]
pub struct Plot {
    /// Above the chart.
    pub title: String,
    /// Below the axis.
    pub cost_name: String,
    /// Unit of the cost.
    pub unit: Unit,
    /// Beside the axis.
    pub error_name: String,
    /// Marks; those that are not positive and finite are left out.
    pub marks: Vec<Mark>,
    /// A line of (cost, error), and its name.
    pub line: Option<(String, Vec<(f64, f64)>)>,
    /// Colours of the series.
    pub palette: Palette,
}

const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 400.0;
/// Left, top, right, bottom.
const MARGIN: [f64; 4] = [62.0, 64.0, 18.0, 48.0];
/// Told apart by people who see few colours as well: they differ in lightness too.
pub const COLOURS: [&str; 7] = ["#1f5fa8", "#d1603d", "#2f8f5b", "#8a4f9e", "#b58a1b", "#3a9fb0", "#5a5a5a"];
/// Which colour and shape each series has: the same in every chart of a page, whatever else is in it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Palette {
    /// Names and numbers among [`COLOURS`], which begin anew where they end.
    series: Vec<(String, usize)>,
}

impl Palette {
    /// Series by name, with the number of their colour; those without get the first ones that are free, in this order.
    pub fn new<'a>(series: impl IntoIterator<Item = (&'a str, Option<usize>)>) -> Self {
        let wanted: Vec<(&str, Option<usize>)> = series.into_iter().collect();
        let taken: Vec<usize> = wanted.iter().filter_map(|(_, number)| *number).collect();
        let mut free = (0..).filter(|number| !taken.contains(number));
        let mut number = |wanted: Option<usize>| wanted.or_else(|| free.next()).unwrap_or_default();
        Palette { series: wanted.into_iter().map(|(name, wanted)| (name.to_string(), number(wanted))).collect() }
    }

    /// Number of a series; unknown ones have those after all that are known, in the order of `others`.
    fn style(&self, series: &str, others: &[&str]) -> usize {
        let known = |name: &str| self.series.iter().find(|(known, _)| known == name).map(|(_, number)| *number);
        known(series).unwrap_or_else(|| {
            let after = self.series.iter().map(|(_, number)| number + 1).max().unwrap_or(0);
            after + others.iter().filter(|name| known(name).is_none()).take_while(|name| **name != series).count()
        })
    }

    /// Colour of a series, for what stands beside a chart.
    pub fn colour(&self, series: &str) -> &'static str {
        COLOURS[self.style(series, &[]) % COLOURS.len()]
    }
}

/// Ends of an axis, logarithms to base 10.
#[derive(Clone, Copy)]
struct Range {
    low: f64,
    high: f64,
}

impl Range {
    fn of(logs: impl Iterator<Item = f64> + Clone) -> Self {
        let (low, high) = (logs.clone().fold(f64::INFINITY, f64::min), logs.fold(f64::NEG_INFINITY, f64::max));
        let pad = (0.06 * (high - low)).max(0.12);
        Range { low: low - pad, high: high + pad }
    }

    /// Values with a number: 1, 2, 5 of each decade while there is room, else decades, else every so many.
    fn ticks(&self) -> Vec<f64> {
        let decades = self.high - self.low;
        let steps: &[f64] = if decades < 1.7 { &[1.0, 2.0, 5.0] } else { &[1.0] };
        let every = (decades / 7.0).ceil().max(1.0) as i32;
        let first = self.low.floor() as i32;
        let all = (first..=self.high.ceil() as i32).filter(|decade| decade.rem_euclid(every) == 0);
        let all = all.flat_map(|decade| steps.iter().map(move |step| step * 10f64.powi(decade)));
        all.filter(|value| (self.low..=self.high).contains(&value.log10())).collect()
    }

    /// Values with a line only.
    fn lines(&self) -> Vec<f64> {
        if self.high - self.low > 4.0 {
            return Vec::new();
        }
        let all =
            (self.low.floor() as i32..=self.high.ceil() as i32).flat_map(|decade| (2..10).map(move |i| f64::from(i) * 10f64.powi(decade)));
        all.filter(|value| (self.low..=self.high).contains(&value.log10())).collect()
    }
}

/// Places of labels and marks that are taken: left, top, right, bottom.
type Box4 = [f64; 4];

fn overlap(a: &Box4, b: &Box4) -> bool {
    a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3]
}

impl Plot {
    /// The chart as SVG. A plot without a mark says so.
    pub fn to_svg(&self) -> String {
        let shown = |cost: f64, error: f64| cost > 0.0 && error > 0.0 && cost.is_finite() && error.is_finite();
        let marks: Vec<&Mark> = self.marks.iter().filter(|mark| shown(mark.cost, mark.error)).collect();
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" font-family=\"system-ui, sans-serif\" font-size=\"11\">\n\
             <rect width=\"{WIDTH}\" height=\"{HEIGHT}\" rx=\"6\" fill=\"#ffffff\"/>\n\
             <text x=\"{}\" y=\"24\" font-size=\"14\" font-weight=\"600\" fill=\"#222222\">{}</text>\n",
            MARGIN[0],
            escaped(&self.title)
        );
        if marks.is_empty() {
            let _ = write!(out, "<text x=\"{}\" y=\"80\" fill=\"#666666\">no figures</text>\n</svg>\n", MARGIN[0]);
            return out;
        }
        let (across, up) = (Range::of(marks.iter().map(|mark| mark.cost.log10())), Range::of(marks.iter().map(|mark| mark.error.log10())));
        let (right, bottom) = (WIDTH - MARGIN[2], HEIGHT - MARGIN[3]);
        let x = |cost: f64| MARGIN[0] + (cost.log10() - across.low) / (across.high - across.low) * (right - MARGIN[0]);
        let y = |error: f64| bottom - (error.log10() - up.low) / (up.high - up.low) * (bottom - MARGIN[1]);
        self.axes(&mut out, (&across, &x), (&up, &y));
        self.line(&mut out, &across, &up, &x, &y);

        let at = |mark: &Mark| [x(mark.cost), y(mark.error)];
        let series = series_of(&marks);
        self.bands(&mut out, &marks, &series, &at);
        self.marks(&mut out, &marks, &series, &at);
        self.legend(&mut out, &series, marks.iter().any(|mark| mark.is_front));
        out + "</svg>\n"
    }

    /// The Pareto front as a pale band, and a thin line through the budgets of each series.
    fn bands(&self, out: &mut String, marks: &[&Mark], series: &[&str], at: &dyn Fn(&Mark) -> [f64; 2]) {
        let point = |mark: &&Mark| {
            let [x, y] = at(mark);
            format!("{x:.1},{y:.1}")
        };
        let path = |marks: &[&Mark]| marks.iter().map(point).collect::<Vec<_>>().join(" ");
        let mut front: Vec<&Mark> = marks.iter().copied().filter(|mark| mark.is_front).collect();
        front.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        let _ = writeln!(
            out,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"#f2c94c\" stroke-opacity=\"0.45\" stroke-width=\"9\" stroke-linejoin=\"round\" \
             stroke-linecap=\"round\"/>",
            path(&front)
        );
        for name in series {
            let mut own: Vec<&Mark> = marks.iter().copied().filter(|mark| mark.series == *name).collect();
            own.sort_by(|a, b| a.cost.total_cmp(&b.cost).then(b.error.total_cmp(&a.error)));
            let colour = COLOURS[self.palette.style(name, series) % COLOURS.len()];
            let _ = writeln!(out, "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-opacity=\"0.35\"/>", path(&own));
        }
    }

    /// The marks, with labels where there is room.
    fn marks(&self, out: &mut String, marks: &[&Mark], series: &[&str], at: &dyn Fn(&Mark) -> [f64; 2]) {
        let inside = [MARGIN[0], MARGIN[1], WIDTH - MARGIN[2], HEIGHT - MARGIN[3]];
        let mut taken: Vec<Box4> = marks.iter().map(|mark| at(mark)).map(|[x, y]| [x - 6.0, y - 6.0, x + 6.0, y + 6.0]).collect();
        for (i, mark) in marks.iter().enumerate() {
            let (centre, kind) = (at(mark), self.palette.style(&mark.series, series));
            let colour = COLOURS[kind % COLOURS.len()];
            let hover = if mark.hover.is_empty() { format!("{} {}", mark.series, mark.label) } else { mark.hover.join("\n") };
            let _ = write!(out, "<g class=\"mark\" data-row=\"{}\"><title>{}</title>", mark.row, escaped(&hover));
            shape(out, kind, centre, colour, mark.is_front);
            let width = 6.0 * mark.label.chars().count() as f64;
            if let Some((place, [left, baseline])) = free_place(centre, width, &taken, i, inside) {
                taken.push(place);
                let _ = write!(out, "<text x=\"{left:.1}\" y=\"{baseline:.1}\" fill=\"{colour}\">{}</text>", escaped(&mark.label));
            }
            *out += "</g>\n";
        }
    }

    /// Names of the series above the plot.
    fn legend(&self, out: &mut String, series: &[&str], has_front: bool) {
        let mut left = MARGIN[0];
        for name in series {
            let kind = self.palette.style(name, series);
            shape(out, kind, [left + 5.0, 44.0], COLOURS[kind % COLOURS.len()], true);
            let _ = writeln!(out, "<text x=\"{}\" y=\"48\" fill=\"#444444\">{}</text>", left + 14.0, escaped(&name.replace('_', " ")));
            left += 28.0 + 6.0 * name.chars().count() as f64;
        }
        if has_front {
            let _ = writeln!(
                out,
                "<path d=\"M{left:.0} 44h18\" stroke=\"#f2c94c\" stroke-opacity=\"0.6\" stroke-width=\"8\" stroke-linecap=\"round\"/>\
                 <text x=\"{}\" y=\"48\" fill=\"#444444\">Pareto front</text>",
                left + 26.0
            );
        }
    }

    fn axes(&self, out: &mut String, (across, x): (&Range, &dyn Fn(f64) -> f64), (up, y): (&Range, &dyn Fn(f64) -> f64)) {
        let (right, bottom) = (WIDTH - MARGIN[2], HEIGHT - MARGIN[3]);
        let lines = |values: Vec<f64>, vertical: bool, colour: &str| {
            let one = |value: f64| match vertical {
                true => format!("M{:.1} {}V{bottom}", x(value), MARGIN[1]),
                false => format!("M{} {:.1}H{right}", MARGIN[0], y(value)),
            };
            format!("<path d=\"{}\" stroke=\"{colour}\" fill=\"none\"/>\n", values.into_iter().map(one).collect::<String>())
        };
        *out += &lines(across.lines(), true, "#f3f3f3");
        *out += &lines(up.lines(), false, "#f3f3f3");
        *out += &lines(across.ticks(), true, "#dddddd");
        *out += &lines(up.ticks(), false, "#dddddd");
        for value in across.ticks() {
            let text = in_unit(value, self.unit);
            let _ =
                writeln!(out, "<text x=\"{:.1}\" y=\"{}\" text-anchor=\"middle\" fill=\"#444444\">{text}</text>", x(value), bottom + 16.0);
        }
        for value in up.ticks() {
            let text = power(value);
            let _ = writeln!(
                out,
                "<text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\" fill=\"#444444\">{text}</text>",
                MARGIN[0] - 7.0,
                y(value) + 4.0
            );
        }
        let _ = writeln!(out, "<path d=\"M{} {}V{bottom}H{right}\" stroke=\"#888888\" fill=\"none\"/>", MARGIN[0], MARGIN[1]);
        let (middle, axis) = (0.5 * (MARGIN[0] + right), bottom + 37.0);
        let _ =
            writeln!(out, "<text x=\"{middle}\" y=\"{axis}\" text-anchor=\"middle\" fill=\"#222222\">{}</text>", escaped(&self.cost_name));
        let centre = 0.5 * (MARGIN[1] + bottom);
        let turned = format!("transform=\"rotate(-90 15 {centre})\" text-anchor=\"middle\" fill=\"#222222\"");
        let _ = writeln!(out, "<text x=\"15\" y=\"{centre}\" {turned}>{}</text>", escaped(&self.error_name));
    }

    /// The line, clipped to the plot, its name at the upper end of what is seen.
    fn line(&self, out: &mut String, across: &Range, up: &Range, x: &dyn Fn(f64) -> f64, y: &dyn Fn(f64) -> f64) {
        let Some((name, points)) = &self.line else { return };
        let shown = points.iter().filter(|(cost, error)| *cost > 0.0 && *error > 0.0);
        let logs: Vec<[f64; 2]> = shown.map(|(cost, error)| [cost.log10(), error.log10()]).collect();
        let mut label = None;
        for ends in logs.windows(2) {
            let Some([a, b]) = clipped(ends[0], ends[1], across, up) else { continue };
            let at = |p: [f64; 2]| (x(10f64.powf(p[0])), y(10f64.powf(p[1])));
            let ((x0, y0), (x1, y1)) = (at(a), at(b));
            let _ = writeln!(
                out,
                "<path d=\"M{x0:.1} {y0:.1}L{x1:.1} {y1:.1}\" stroke=\"#333333\" stroke-width=\"1.3\" stroke-dasharray=\"6 4\" fill=\"none\"><title>{}</title></path>",
                escaped(name)
            );
            let upper = if y0 < y1 { (x0, y0) } else { (x1, y1) };
            label = label.filter(|(_, y): &(f64, f64)| *y <= upper.1).or(Some(upper));
        }
        match label {
            // Left of its end, or right where that would leave the plot.
            Some((left, top)) => {
                let anchor = if left < MARGIN[0] + 0.5 * (WIDTH - MARGIN[0]) { ("start", left + 8.0) } else { ("end", left - 8.0) };
                let _ = writeln!(
                    out,
                    "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"{}\" fill=\"#333333\" font-style=\"italic\">{}</text>",
                    anchor.1,
                    top + 13.0,
                    anchor.0,
                    escaped(name)
                );
            }
            None => {
                let _ = writeln!(
                    out,
                    "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\" fill=\"#333333\" font-style=\"italic\">{}: dearer than all here</text>",
                    WIDTH - MARGIN[2] - 6.0,
                    MARGIN[1] + 13.0,
                    escaped(name)
                );
            }
        }
    }
}

/// Names of the series, in the order of their first marks.
fn series_of<'a>(marks: &[&'a Mark]) -> Vec<&'a str> {
    let mut series: Vec<&str> = Vec::new();
    for mark in marks {
        if !series.contains(&mark.series.as_str()) {
            series.push(&mark.series);
        }
    }
    series
}

/// The part of a segment inside the plot (Liang and Barsky).
fn clipped(a: [f64; 2], b: [f64; 2], across: &Range, up: &Range) -> Option<[[f64; 2]; 2]> {
    let (mut near, mut far) = (0.0f64, 1.0f64);
    for (k, range) in [across, up].into_iter().enumerate() {
        let d = b[k] - a[k];
        if d == 0.0 {
            if !(range.low..=range.high).contains(&a[k]) {
                return None;
            }
            continue;
        }
        let (from, to) = ((range.low - a[k]) / d, (range.high - a[k]) / d);
        (near, far) = (near.max(from.min(to)), far.min(from.max(to)));
    }
    let at = |t: f64| std::array::from_fn(|k| a[k] + t * (b[k] - a[k]));
    (near < far).then(|| [at(near), at(far)])
}

/// A free box for a label of a mark, and where its text starts.
fn free_place([x, y]: [f64; 2], width: f64, taken: &[Box4], own: usize, inside: Box4) -> Option<(Box4, [f64; 2])> {
    const HEIGHT: f64 = 12.0;
    let (after, before, middle) = (x + 8.0, x - 8.0 - width, x - 0.5 * width);
    let places = [
        [after, y - 14.0],
        [after, y - 6.0],
        [after, y + 3.0],
        [before, y - 14.0],
        [before, y - 6.0],
        [before, y + 3.0],
        [middle, y - 20.0],
        [middle, y + 8.0],
    ];
    places.into_iter().find_map(|[left, top]| {
        let place = [left, top, left + width, top + HEIGHT];
        let fits = place[0] >= inside[0] && place[1] >= inside[1] && place[2] <= inside[2] && place[3] <= inside[3];
        let is_free = taken.iter().enumerate().all(|(i, other)| i == own || !overlap(&place, other));
        (fits && is_free).then_some((place, [left, top + 10.0]))
    })
}

/// Circle, square, diamond or triangle about a centre.
fn shape(out: &mut String, kind: usize, [x, y]: [f64; 2], colour: &str, is_filled: bool) {
    let fill = if is_filled { colour } else { "#ffffff" };
    let look = format!("fill=\"{fill}\" stroke=\"{colour}\" stroke-width=\"1.6\"");
    let _ = match kind % 4 {
        0 => write!(out, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4.6\" {look}/>"),
        1 => write!(out, "<path d=\"M{:.1} {:.1}h8.4v8.4h-8.4z\" {look}/>", x - 4.2, y - 4.2),
        2 => write!(out, "<path d=\"M{x:.1} {:.1}l5.6 5.6l-5.6 5.6l-5.6 -5.6z\" {look}/>", y - 5.6),
        _ => write!(out, "<path d=\"M{x:.1} {:.1}l5.2 9h-10.4z\" {look}/>", y - 5.6),
    };
}

const SUPERSCRIPTS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];

/// `0.2`, `10⁻³`: short for an axis.
fn power(value: f64) -> String {
    let decade = value.log10().round() as i32;
    if (-2..=3).contains(&decade) || (value / 10f64.powi(decade) - 1.0).abs() > 1e-6 {
        return super::row::significant(value).trim_end_matches('0').trim_end_matches('.').to_string();
    }
    let digits: String = decade.unsigned_abs().to_string().bytes().map(|digit| SUPERSCRIPTS[usize::from(digit - b'0')]).collect();
    format!("10{}{digits}", if decade < 0 { "⁻" } else { "" })
}

/// A value in the unit that keeps it short: `20 µs`, `1.5 kB`, `2 min`.
pub fn in_unit(value: f64, unit: Unit) -> String {
    let scales: &[(f64, &str)] = match unit {
        Unit::Number => return power(value),
        Unit::Nanoseconds => &[(1e9, "s"), (1e6, "ms"), (1e3, "µs"), (0.0, "ns")],
        Unit::Seconds => &[(3600.0, "h"), (120.0, "min"), (1.0, "s"), (1e-3, "ms"), (0.0, "µs")],
        Unit::Bytes => &[(1e9, "GB"), (1e6, "MB"), (1e3, "kB"), (0.0, "B")],
    };
    let (scale, name) = scales.iter().find(|(scale, _)| value >= 0.999_999 * scale).copied().unwrap_or((1.0, ""));
    let scale = match (unit, name) {
        (Unit::Seconds, "µs") => 1e-6,
        (Unit::Seconds, "min") => 60.0,
        _ if scale > 0.0 => scale,
        _ => 1.0,
    };
    let number = value / scale;
    let text = if number >= 99.5 { format!("{number:.0}") } else { format!("{number:.*}", if number < 10.0 { 2 } else { 1 }) };
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    format!("{text} {name}")
}

/// Text that stands inside an element.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mark(series: &str, cost: f64, error: f64, is_front: bool) -> Mark {
        Mark { series: series.into(), label: "a < b".into(), cost, error, is_front, ..Mark::default() }
    }

    /// Values of an attribute, in order.
    fn values(svg: &str, name: &str) -> Vec<f64> {
        let parse = |rest: &str| rest[..rest.find('"').unwrap()].parse().unwrap();
        svg.match_indices(name).map(|(at, _)| parse(&svg[at + name.len()..])).collect()
    }

    #[test]
    fn marks_lie_inside_better_ones_lower_and_text_is_escaped() {
        let plot = Plot {
            title: "t & u".into(),
            marks: vec![mark("block_product", 100.0, 1e-2, true), mark("block_product", 1e4, 1e-4, false), mark("two", 0.0, 1.0, false)],
            line: Some(("path tracer".into(), vec![(1e2, 1.0), (1e6, 1e-5)])),
            ..Plot::default()
        };
        let svg = plot.to_svg();
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
        assert!(svg.contains("t &amp; u") && svg.contains("a &lt; b") && !svg.contains("a < b"));
        assert_eq!(svg.matches("<title>").count(), 3, "the mark without cost is left out");
        let (x, y) = (values(&svg, " cx=\""), values(&svg, " cy=\""));
        assert!(x[0] < x[1] && y[0] < y[1], "{svg}");
        assert!(x.iter().all(|x| (0.0..WIDTH).contains(x)) && y.iter().all(|y| (0.0..HEIGHT).contains(y)));
        assert!(Plot::default().to_svg().contains("no figures"));
    }

    #[test]
    fn labels_never_lie_on_one_another() {
        let marks = (0..40).map(|i| mark("block_product", 100.0 + f64::from(i), 0.01 + 1e-5 * f64::from(i), false)).collect();
        let svg = Plot { marks, ..Plot::default() }.to_svg();
        let labels: Vec<(f64, f64)> = svg
            .lines()
            .filter(|line| line.contains("class=\"mark\"") && line.contains("<text"))
            .map(|line| (values(line, "<text x=\"")[0], values(line, " y=\"")[0]))
            .collect();
        assert!(!labels.is_empty() && labels.len() < 40, "{}", labels.len());
        for (i, a) in labels.iter().enumerate() {
            assert!(labels[..i].iter().all(|b| (a.0 - b.0).abs() >= 30.0 || (a.1 - b.1).abs() >= 12.0), "{labels:?}");
        }
    }

    #[test]
    fn a_series_keeps_its_colour_and_a_new_one_gets_a_free_one() {
        let palette = Palette::new([("a", Some(0)), ("new", None), ("b", Some(2)), ("newer", None)]);
        let numbers = ["a", "new", "b", "newer", "x", "y"].map(|name| palette.style(name, &["y", "a", "x"]));
        assert_eq!(numbers, [0, 1, 2, 3, 5, 4], "those that nobody named come after all that were");
        assert_eq!((palette.colour("a"), palette.colour("newer")), (COLOURS[0], COLOURS[3]));
    }

    #[test]
    fn lines_are_cut_at_the_edges() {
        let range = |low: f64, high: f64| Range { low, high };
        let whole = clipped([-1.0, -1.0], [2.0, 2.0], &range(0.0, 1.0), &range(0.0, 1.0)).unwrap();
        assert!(whole.iter().flatten().zip([0.0, 0.0, 1.0, 1.0]).all(|(a, b): (&f64, f64)| (a - b).abs() < 1e-12), "{whole:?}");
        assert_eq!(clipped([-1.0, 0.5], [-0.1, 0.5], &range(0.0, 1.0), &range(0.0, 1.0)), None);
        assert_eq!(clipped([0.0, 5.0], [1.0, 5.0], &range(0.0, 1.0), &range(0.0, 1.0)), None);
    }

    #[test]
    fn numbers_on_axes_are_short() {
        let told = [(2e4, Unit::Nanoseconds), (1500.0, Unit::Bytes), (1e-5, Unit::Number), (0.2, Unit::Number), (180.0, Unit::Seconds)];
        assert_eq!(told.map(|(value, unit)| in_unit(value, unit)), ["20 µs", "1.5 kB", "10⁻⁵", "0.2", "3 min"]);
        assert_eq!(in_unit(2e-5, Unit::Seconds), "20 µs");
    }
}

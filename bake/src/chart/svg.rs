//! Error against cost, both logarithmic, one colour per technique, the Pareto front joined and its marks filled.

use std::fmt::Write;

/// One mark.
#[derive(Clone, Debug, PartialEq)]
pub struct Mark {
    /// Series that it belongs to.
    pub series: String,
    /// What stands beside it.
    pub label: String,
    /// Horizontal, above 0.
    pub cost: f64,
    /// Vertical, above 0.
    pub error: f64,
    /// On the Pareto front.
    pub is_front: bool,
}

/// A chart of marks and, if there is one, a line.
#[derive(Clone, Debug, Default)]
pub struct Plot {
    /// Above the chart.
    pub title: String,
    /// Below the axis.
    pub cost_name: String,
    /// Beside the axis.
    pub error_name: String,
    /// Marks; those that are not positive and finite are left out.
    pub marks: Vec<Mark>,
    /// A line of (cost, error), and its name.
    pub line: Option<(String, Vec<(f64, f64)>)>,
}

const WIDTH: f64 = 720.0;
const HEIGHT: f64 = 420.0;
/// Left, top, right, bottom.
const MARGIN: [f64; 4] = [70.0, 36.0, 150.0, 50.0];
const COLOURS: [&str; 6] = ["#1b6ca8", "#c8553d", "#3c8d40", "#8e5aa8", "#7a6a52", "#444444"];

impl Plot {
    /// The chart as SVG. A plot without a mark says so.
    pub fn to_svg(&self) -> String {
        let shown = |cost: f64, error: f64| cost > 0.0 && error > 0.0 && cost.is_finite() && error.is_finite();
        let marks: Vec<&Mark> = self.marks.iter().filter(|mark| shown(mark.cost, mark.error)).collect();
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" font-family=\"sans-serif\" font-size=\"11\">\n\
             <rect width=\"{WIDTH}\" height=\"{HEIGHT}\" fill=\"#ffffff\"/>\n<text x=\"{}\" y=\"22\" font-size=\"14\">{}</text>\n",
            MARGIN[0],
            escaped(&self.title)
        );
        if marks.is_empty() {
            let _ = write!(out, "<text x=\"{}\" y=\"80\">no figures</text>\n</svg>\n", MARGIN[0]);
            return out;
        }
        let range = |value: &dyn Fn(&Mark) -> f64| {
            let logs = || marks.iter().map(|mark| value(mark).log10());
            let (low, high) = (logs().fold(f64::INFINITY, f64::min).floor(), logs().fold(f64::NEG_INFINITY, f64::max).ceil());
            (low, if high > low { high } else { low + 1.0 })
        };
        let (x_range, y_range) = (range(&|mark| mark.cost), range(&|mark| mark.error));
        let (right, bottom) = (WIDTH - MARGIN[2], HEIGHT - MARGIN[3]);
        let x = |cost: f64| MARGIN[0] + (cost.log10() - x_range.0) / (x_range.1 - x_range.0) * (right - MARGIN[0]);
        let y = |error: f64| bottom - (error.log10() - y_range.0) / (y_range.1 - y_range.0) * (bottom - MARGIN[1]);
        for decade in x_range.0 as i32..=x_range.1 as i32 {
            let at = x(10f64.powi(decade));
            let _ = writeln!(out, "<path d=\"M{at:.1} {} V{bottom}\" stroke=\"#dddddd\"/>", MARGIN[1]);
            let _ = writeln!(out, "<text x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\">1e{decade}</text>", bottom + 16.0);
        }
        for decade in y_range.0 as i32..=y_range.1 as i32 {
            let at = y(10f64.powi(decade));
            let _ = writeln!(out, "<path d=\"M{} {at:.1} H{right}\" stroke=\"#dddddd\"/>", MARGIN[0]);
            let _ = writeln!(out, "<text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">1e{decade}</text>", MARGIN[0] - 6.0, at + 4.0);
        }
        let (middle, axis) = (0.5 * (MARGIN[0] + right), bottom + 36.0);
        let _ = writeln!(out, "<text x=\"{middle}\" y=\"{axis}\" text-anchor=\"middle\">{}</text>", escaped(&self.cost_name));
        let centre = 0.5 * (MARGIN[1] + bottom);
        let turned = format!("transform=\"rotate(-90 16 {centre})\" text-anchor=\"middle\"");
        let _ = writeln!(out, "<text x=\"16\" y=\"{centre}\" {turned}>{}</text>", escaped(&self.error_name));
        self.line(&mut out, &x, &y, [MARGIN[0], MARGIN[1], right, bottom]);
        let mut front: Vec<&Mark> = marks.iter().copied().filter(|mark| mark.is_front).collect();
        front.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        let path: Vec<String> = front.iter().map(|mark| format!("{:.1},{:.1}", x(mark.cost), y(mark.error))).collect();
        let _ = writeln!(out, "<polyline points=\"{}\" fill=\"none\" stroke=\"#999999\" stroke-dasharray=\"3 3\"/>", path.join(" "));
        let mut series: Vec<&str> = Vec::new();
        for mark in &marks {
            if !series.contains(&mark.series.as_str()) {
                series.push(&mark.series);
            }
            let colour = COLOURS[series.iter().position(|name| *name == mark.series).unwrap_or(0) % COLOURS.len()];
            let (cx, cy) = (x(mark.cost), y(mark.error));
            let fill = if mark.is_front { colour } else { "#ffffff" };
            let _ = writeln!(
                out,
                "<circle cx=\"{cx:.1}\" cy=\"{cy:.1}\" r=\"4.5\" fill=\"{fill}\" stroke=\"{colour}\" stroke-width=\"1.5\"><title>{0} {1}</title></circle>\n\
                 <text x=\"{2:.1}\" y=\"{3:.1}\" fill=\"{colour}\">{1}</text>",
                escaped(&mark.series),
                escaped(&mark.label),
                cx + 7.0,
                cy - 5.0
            );
        }
        for (i, name) in series.iter().enumerate() {
            let at = MARGIN[1] + 12.0 + 18.0 * i as f64;
            let colour = COLOURS[i % COLOURS.len()];
            let _ = writeln!(out, "<circle cx=\"{}\" cy=\"{at}\" r=\"4.5\" fill=\"{colour}\"/>", right + 16.0);
            let _ = writeln!(out, "<text x=\"{}\" y=\"{}\">{}</text>", right + 26.0, at + 4.0, escaped(name));
        }
        let note = MARGIN[1] + 12.0 + 18.0 * series.len() as f64;
        let _ = write!(out, "<text x=\"{}\" y=\"{}\" fill=\"#666666\">filled: Pareto front</text>\n</svg>\n", right + 10.0, note + 6.0);
        out
    }

    /// The line, clipped to the plot.
    fn line(&self, out: &mut String, x: &dyn Fn(f64) -> f64, y: &dyn Fn(f64) -> f64, [left, top, right, bottom]: [f64; 4]) {
        let Some((name, points)) = &self.line else { return };
        let shown = points.iter().filter(|(cost, error)| *cost > 0.0 && *error > 0.0);
        let path: Vec<String> = shown.map(|(cost, error)| format!("{:.1},{:.1}", x(*cost), y(*error))).collect();
        let _ = writeln!(
            out,
            "<clipPath id=\"plot\"><rect x=\"{left}\" y=\"{top}\" width=\"{0}\" height=\"{1}\"/></clipPath>\n\
             <polyline points=\"{2}\" clip-path=\"url(#plot)\" fill=\"none\" stroke=\"#222222\" stroke-width=\"1.2\"><title>{3}</title></polyline>\n\
             <text x=\"{left}\" y=\"{4}\" fill=\"#222222\">— {3}</text>",
            right - left,
            bottom - top,
            path.join(" "),
            escaped(name),
            bottom + 48.0,
        );
    }
}

/// Text that stands inside an element.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mark(series: &str, cost: f64, error: f64, is_front: bool) -> Mark {
        Mark { series: series.into(), label: "a < b".into(), cost, error, is_front }
    }

    #[test]
    fn marks_lie_inside_better_ones_lower_and_text_is_escaped() {
        let plot = Plot {
            title: "t & u".into(),
            marks: vec![mark("one", 100.0, 1e-2, true), mark("two", 1e4, 1e-4, false), mark("two", 0.0, 1.0, false)],
            line: Some(("path tracer".into(), vec![(10.0, 1.0), (1e6, 1e-5)])),
            ..Plot::default()
        };
        let svg = plot.to_svg();
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
        assert!(svg.contains("t &amp; u") && svg.contains("a &lt; b") && !svg.contains("a < b"));
        assert_eq!(svg.matches("<title>").count(), 3, "the mark without cost is left out");
        let value = |name: &str, nth: usize| -> f64 {
            let mut at = svg.match_indices(name).skip(nth);
            let rest = &svg[at.next().unwrap().0 + name.len()..];
            rest[..rest.find('"').unwrap()].parse().unwrap()
        };
        assert!(value(" cx=\"", 0) < value(" cx=\"", 1) && value(" cy=\"", 0) < value(" cy=\"", 1), "{svg}");
        assert!(Plot::default().to_svg().contains("no figures"));
    }
}

//! A line of the table: one technique at one budget in one cell.

use super::motion::Motion;
use serde::{Deserialize, Serialize};

/// Every figure of a technique in a cell. Times are CPU time of one thread.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Environment, as the user named it.
    pub environment: String,
    /// Name of the view.
    pub view: String,
    /// No constant was ever chosen by looking from here.
    pub held_back: bool,
    /// `still`, `moving light` or `moving view`.
    pub motion: String,
    /// Name of the technique.
    pub technique: String,
    /// Its budget.
    pub budget: String,
    /// Shading, without projecting the surface.
    pub ns_per_point: f64,
    /// Projecting the surface on the fly, 0 where there is nothing to project.
    pub projection_ns: f64,
    /// Visibility in memory.
    pub bytes_per_point: f64,
    /// Preparing the light.
    pub prepare_seconds: f64,
    /// Baking the asset, as it was done, and converting its visibility for this technique.
    pub bake_seconds: f64,
    /// Points of the patches in view.
    pub points_in_view: usize,
    /// Against `pixel_product` at points.
    pub points_relative_l2: Option<f64>,
    /// The same in decibels of exposed colours.
    pub points_psnr_db: Option<f64>,
    /// Relative L2 of the picture against the path tracer.
    pub relative_l2: Option<f64>,
    /// The same freed of the reference's noise.
    pub unbiased_relative_l2: Option<f64>,
    /// Peak signal to noise of the picture, dB.
    pub psnr_db: Option<f64>,
    /// FLIP of the picture.
    pub flip: Option<f64>,
    /// Relative L2 of the noise in the reference.
    pub reference_noise: Option<f64>,
    /// The path tracer's CPU time per pixel at the error of this picture.
    pub reference_ns_per_pixel: Option<f64>,
    /// Flicker of what moves: 99.9th percentile of |Δours − Δtruth| between frames over points, in steps of 1/255 of the display.
    pub temporal_p999: Option<f64>,
    /// The most of the same.
    pub temporal_max: Option<f64>,
    /// No other row of the cell is both faster and closer to `pixel_product`.
    pub pareto_points: bool,
    /// No other row of the cell is both faster and closer to the path tracer.
    pub pareto_picture: bool,
    /// No other row of the cell is both smaller and closer to `pixel_product`.
    pub pareto_bytes: bool,
}

impl Row {
    /// What a frame costs a point, nanoseconds: shading, projecting the surface where that is needed, and, while the light moves, its share of
    /// preparing the light for the points in view.
    pub fn frame_ns(&self) -> f64 {
        let light = if self.motion == Motion::Light.name() { 1e9 * self.prepare_seconds / self.points_in_view.max(1) as f64 } else { 0.0 };
        self.ns_per_point + self.projection_ns + light
    }
}

/// Which of `(cost, error)` no other beats in both; equal ones stay together. NaN is never on the front.
pub fn pareto(points: &[(f64, f64)]) -> Vec<bool> {
    let beaten = |(cost, error): (f64, f64)| {
        points.iter().any(|(c, e)| *c <= cost && *e <= error && (*c < cost || *e < error)) || cost.is_nan() || error.is_nan()
    };
    points.iter().map(|point| !beaten(*point)).collect()
}

/// Marks the fronts of the rows of one cell.
pub fn mark_fronts(rows: &mut [Row]) {
    let front = |pair: &dyn Fn(&Row) -> (f64, Option<f64>)| {
        let points: Vec<(f64, f64)> = rows.iter().map(pair).map(|(cost, error)| (cost, error.unwrap_or(f64::NAN))).collect();
        pareto(&points)
    };
    let time = Row::frame_ns;
    let points = front(&|row| (time(row), row.points_relative_l2));
    let picture = front(&|row| (time(row), row.unbiased_relative_l2));
    let bytes = front(&|row| (row.bytes_per_point, row.points_relative_l2));
    for (i, row) in rows.iter_mut().enumerate() {
        (row.pareto_points, row.pareto_picture, row.pareto_bytes) = (points[i], picture[i], bytes[i]);
    }
}

/// Names of the columns that [`to_csv`] puts before a row's own.
pub const CONTEXT: [&str; 6] = ["prelight", "machine", "scene", "asset_digest", "width", "height"];

/// The table as CSV: the six constant columns, then a row's fields in their order. Missing figures are empty.
pub fn to_csv(context: &[String; 6], rows: &[Row]) -> String {
    let names: Vec<String> = fields(&Row::default()).into_iter().map(|(name, _)| name).collect();
    let mut text = format!("{},{}\n", CONTEXT.join(","), names.join(","));
    for row in rows {
        let values = context.iter().cloned().chain(fields(row).into_iter().map(|(_, value)| value));
        text += &values.map(|value| quoted(&value)).collect::<Vec<_>>().join(",");
        text.push('\n');
    }
    text
}

/// A row's fields as text, in the order of the struct.
pub fn fields(row: &Row) -> Vec<(String, String)> {
    let Row {
        environment,
        view,
        held_back,
        motion,
        technique,
        budget,
        ns_per_point,
        projection_ns,
        bytes_per_point,
        prepare_seconds,
        bake_seconds,
        points_in_view,
        points_relative_l2,
        points_psnr_db,
        relative_l2,
        unbiased_relative_l2,
        psnr_db,
        flip,
        reference_noise,
        reference_ns_per_pixel,
        temporal_p999,
        temporal_max,
        pareto_points,
        pareto_picture,
        pareto_bytes,
    } = row;
    let optional = |value: &Option<f64>| value.map_or(String::new(), significant);
    let named: [(&str, String); 25] = [
        ("environment", environment.clone()),
        ("view", view.clone()),
        ("held_back", held_back.to_string()),
        ("motion", motion.clone()),
        ("technique", technique.clone()),
        ("budget", budget.clone()),
        ("ns_per_point", significant(*ns_per_point)),
        ("projection_ns", significant(*projection_ns)),
        ("bytes_per_point", significant(*bytes_per_point)),
        ("prepare_seconds", significant(*prepare_seconds)),
        ("bake_seconds", significant(*bake_seconds)),
        ("points_in_view", points_in_view.to_string()),
        ("points_relative_l2", optional(points_relative_l2)),
        ("points_psnr_db", optional(points_psnr_db)),
        ("relative_l2", optional(relative_l2)),
        ("unbiased_relative_l2", optional(unbiased_relative_l2)),
        ("psnr_db", optional(psnr_db)),
        ("flip", optional(flip)),
        ("reference_noise", optional(reference_noise)),
        ("reference_ns_per_pixel", optional(reference_ns_per_pixel)),
        ("temporal_p999", optional(temporal_p999)),
        ("temporal_max", optional(temporal_max)),
        ("pareto_points", pareto_points.to_string()),
        ("pareto_picture", pareto_picture.to_string()),
        ("pareto_bytes", pareto_bytes.to_string()),
    ];
    named.into_iter().map(|(name, value)| (name.to_string(), value)).collect()
}

/// Four significant digits.
pub fn significant(number: f64) -> String {
    if number == 0.0 || !number.is_finite() {
        return number.to_string();
    }
    let magnitude = number.abs().log10().floor() as i32;
    if (-4..6).contains(&magnitude) { format!("{number:.*}", (3 - magnitude).max(0) as usize) } else { format!("{number:.3e}") }
}

fn quoted(value: &str) -> String {
    if value.contains([',', '"', '\n']) { format!("\"{}\"", value.replace('"', "\"\"")) } else { value.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_front_holds_what_nothing_beats() {
        let points = [(1.0, 5.0), (2.0, 2.0), (3.0, 2.0), (4.0, 1.0), (4.0, 1.0), (0.5, f64::NAN), (5.0, 4.0)];
        assert_eq!(pareto(&points), [true, true, false, true, true, false, false]);
        assert!(pareto(&[]).is_empty());
    }

    #[test]
    fn csv_has_one_value_per_column_and_quotes_names() {
        let context = ["1", "machine", "a \"b\", c", "d", "640", "360"].map(str::to_string);
        let text = to_csv(&context, &[Row { points_relative_l2: Some(1.23456e-5), ..Row::default() }]);
        let mut lines = text.lines();
        let (head, line) = (lines.next().unwrap(), lines.next().unwrap());
        assert!(line.contains("\"a \"\"b\"\", c\"") && line.contains("1.235e-5"), "{line}");
        // The quoted comma is one more than there are columns.
        assert_eq!(head.split(',').count() + 1, line.split(',').count());
        let json = serde_json::to_value(Row::default()).unwrap();
        let names: Vec<String> = fields(&Row::default()).into_iter().map(|(name, _)| name).collect();
        let keys = json.as_object().unwrap();
        assert!(names.len() == keys.len() && names.iter().all(|name| keys.contains_key(name)), "CSV and JSON name the same fields");
    }

    #[test]
    fn a_fast_row_whose_surface_is_slow_to_project_is_not_on_the_front() {
        let row = |ns: f64, projection: f64, error: f64| Row {
            ns_per_point: ns,
            projection_ns: projection,
            points_relative_l2: Some(error),
            ..Row::default()
        };
        let mut rows = [row(10.0, 1e5, 0.01), row(100.0, 0.0, 0.01), row(50.0, 0.0, 0.1)];
        mark_fronts(&mut rows);
        assert_eq!(rows.map(|row| row.pareto_points), [false, true, true]);
    }
}

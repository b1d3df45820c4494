//! How many points a uniform mesh needs for the error of an adaptive one.
//!
//! ```text
//! error(mesh)  = √(mean of squared relative L2 errors over views and lights)
//! equal points = where the line through the uniform meshes' (points, error), both logarithmic, has the adaptive mesh's error
//! share        = adaptive points / equal points
//! ```
//!
//! Between two meshes the line joins them; beyond the finest it goes on with the last slope, which is said. Source: \[LD09\] section 7, whose
//! adaptive mesh has 10.5 % of the vertices of a uniform one of equal look; here looks are errors, of the whole picture and of its indirect light
//! alone (picture less direct light, against paths less direct paths): the mesh is refined for the latter.

use crate::svg::{Mark, Palette, Plot, Unit};
use serde::{Deserialize, Serialize};
use std::fmt::Write;

/// A mesh and its error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeshError {
    /// Edge length aimed at, metres.
    pub edge_length: f64,
    /// Points.
    pub points: u64,
    /// Relative L2 of the whole picture.
    pub error: f64,
    /// Relative L2 of its indirect light.
    pub indirect: f64,
    /// Plain bytes of its lobes.
    pub bytes: u64,
}

/// What a uniform mesh of equal error would need.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EqualPoints {
    /// Its points.
    pub points: f64,
    /// It is finer, or coarser, than every mesh that was baked.
    pub is_beyond: bool,
}

/// The errors that meshes are compared by.
pub const ERRORS: [(&str, fn(&MeshError) -> f64); 2] = [("whole picture", |mesh| mesh.error), ("indirect light", |mesh| mesh.indirect)];

/// Root of the mean of squares.
pub fn root_mean_square(errors: &[f64]) -> Option<f64> {
    (!errors.is_empty()).then(|| (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt())
}

/// Points at which uniform meshes reach `error`, by `of` them. `None` with fewer than two of them, or where their error does not fall.
pub fn equal_points(uniform: &[MeshError], error: f64, of: fn(&MeshError) -> f64) -> Option<EqualPoints> {
    let mut sorted: Vec<(f64, f64)> =
        uniform.iter().filter(|mesh| mesh.points > 0 && of(mesh) > 0.0).map(|mesh| ((mesh.points as f64).ln(), of(mesh).ln())).collect();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let target = error.ln();
    if sorted.len() < 2 || !target.is_finite() {
        return None;
    }
    let at = |[a, b]: [(f64, f64); 2]| {
        let slope = (b.1 - a.1) / (b.0 - a.0);
        (slope < 0.0 && slope.is_finite()).then(|| (a.0 + (target - a.1) / slope).exp())
    };
    let inside = sorted.windows(2).find(|pair| (pair[1].1..=pair[0].1).contains(&target));
    if let Some(pair) = inside {
        return at([pair[0], pair[1]]).map(|points| EqualPoints { points, is_beyond: false });
    }
    let n = sorted.len();
    let ends = if target > sorted[0].1 { [sorted[0], sorted[1]] } else { [sorted[n - 2], sorted[n - 1]] };
    at(ends).map(|points| EqualPoints { points, is_beyond: true })
}

/// The table as text.
pub fn uniform_text(adaptive: &MeshError, uniform: &[MeshError]) -> String {
    let mut text = "mesh              edge, mm     points    rel. L2   indirect   bytes/point\n".to_string();
    let named = std::iter::once(("adaptive", adaptive)).chain(uniform.iter().map(|mesh| ("uniform", mesh)));
    for (name, mesh) in named {
        let (edge, per_point) = (1e3 * mesh.edge_length, mesh.bytes as f64 / mesh.points.max(1) as f64);
        let (error, indirect) = (mesh.error, mesh.indirect);
        let _ = writeln!(text, "{name:<15} {edge:>10.2} {:>10} {error:>10.4} {indirect:>10.4} {per_point:>13.0}", mesh.points);
    }
    for (what, of) in ERRORS {
        match equal_points(uniform, of(adaptive), of) {
            Some(EqualPoints { points, is_beyond }) => {
                let beyond = if is_beyond { ", extrapolated" } else { "" };
                let share = 100.0 * adaptive.points as f64 / points;
                let _ = writeln!(
                    text,
                    "{what}: a uniform mesh of equal error has {points:.0} points{beyond}; the adaptive one {share:.1} % of them"
                );
            }
            None => {
                let _ = writeln!(text, "{what}: the error of uniform meshes does not fall, there is no mesh of equal error");
            }
        }
    }
    text
}

/// Error of indirect light against points.
pub fn uniform_plot(adaptive: &MeshError, uniform: &[MeshError]) -> Plot {
    let mark = |series: &str, mesh: &MeshError| Mark {
        series: series.to_string(),
        label: format!("{:.1} mm", 1e3 * mesh.edge_length),
        hover: vec![
            format!("{series}, edges of {:.2} mm", 1e3 * mesh.edge_length),
            format!("{} points, {} bytes", mesh.points, mesh.bytes),
        ],
        row: 0,
        cost: mesh.points as f64,
        error: mesh.indirect,
        is_front: series == "adaptive",
    };
    Plot {
        title: "Adaptive against uniform meshes".to_string(),
        cost_name: "points".to_string(),
        unit: Unit::Number,
        error_name: "relative L2 of indirect light".to_string(),
        marks: std::iter::once(mark("adaptive", adaptive)).chain(uniform.iter().map(|mesh| mark("uniform", mesh))).collect(),
        line: None,
        palette: Palette::new([("adaptive", Some(6)), ("uniform", Some(7))]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mesh(points: u64, error: f64) -> MeshError {
        MeshError { edge_length: 0.01, points, error, indirect: error, bytes: 100 * points }
    }

    #[test]
    fn equal_points_lie_on_the_line_between_meshes() {
        // error = 10 / √points
        let uniform = [400, 10000, 1600].map(|points| mesh(points, 10.0 / (points as f64).sqrt()));
        for (error, points, is_beyond) in [(0.2, 2500.0, false), (0.5, 400.0, false), (0.05, 40000.0, true), (1.0, 100.0, true)] {
            let got = equal_points(&uniform, error, |mesh| mesh.error).unwrap();
            assert!((got.points / points - 1.0).abs() < 1e-9 && got.is_beyond == is_beyond, "{error}: {got:?}");
        }
        assert!(uniform_text(&mesh(500, 0.2), &uniform).contains("2500 points; the adaptive one 20.0 % of them"));
        assert_eq!(equal_points(&uniform[..1], 0.2, |mesh| mesh.error), None);
        assert_eq!(equal_points(&[mesh(100, 0.1), mesh(200, 0.3)], 0.05, |mesh| mesh.error), None, "an error that grows");
        assert_eq!(equal_points(&uniform, f64::NAN, |mesh| mesh.indirect), None);
        assert_eq!(root_mean_square(&[3.0, 4.0]), Some(12.5f64.sqrt()));
        assert_eq!(root_mean_square(&[]), None);
    }
}

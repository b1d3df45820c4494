//! Tables of directional albedo: what share of a white sky a lobe returns, by view and width.
//!
//! Bilinear, `[width][view][term]`. The view axis is √(n·v): grazing albedo bends most there. Below n·v ~ alpha it is a function of their
//! ratio, so the width axis is the fourth root of alpha (√roughness), from the floor of alpha to 1, to hold neighbouring rows together there.

use super::frame::{ALPHA_MIN, N_DOT_V_MIN, view};

/// A table of `VIEWS` × `WIDTHS` nodes.
pub(super) struct AlbedoTable<const VIEWS: usize, const WIDTHS: usize> {
    terms: Vec<[f32; 2]>,
}

impl<const VIEWS: usize, const WIDTHS: usize> AlbedoTable<VIEWS, WIDTHS> {
    /// Fills the nodes with `albedo(n·v, alpha)`.
    pub(crate) fn new(albedo: impl Fn(f64, f64) -> [f64; 2]) -> Self {
        let mut terms = Vec::with_capacity(VIEWS * WIDTHS);
        for row in 0..WIDTHS {
            let root = Self::first_width() + (1.0 - Self::first_width()) * row as f64 / (WIDTHS - 1) as f64;
            let square = root * root;
            let alpha = (square * square).max(ALPHA_MIN);
            for column in 0..VIEWS {
                let first = N_DOT_V_MIN.sqrt();
                let root = first + (1.0 - first) * column as f64 / (VIEWS - 1) as f64;
                terms.push(albedo(root * root, alpha).map(|term| term as f32));
            }
        }
        AlbedoTable { terms }
    }

    /// [`ALPHA_MIN`] to the fourth root.
    fn first_width() -> f64 {
        ALPHA_MIN.sqrt().sqrt()
    }

    /// The terms at a view and a perceptual roughness (√alpha); both are clamped.
    pub(crate) fn lookup(&self, n_dot_v: f32, roughness: f32) -> [f32; 2] {
        let place = |unit: f32, nodes: usize| {
            let at = unit.clamp(0.0, 1.0) * (nodes - 1) as f32;
            let low = (at as usize).min(nodes - 2);
            (low, at - low as f32)
        };
        let (first, width) = ((N_DOT_V_MIN as f32).sqrt(), Self::first_width() as f32);
        let (column, fc) = place((n_dot_v.max(0.0).sqrt() - first) / (1.0 - first), VIEWS);
        let (row, fr) = place((roughness.max(0.0).sqrt() - width) / (1.0 - width), WIDTHS);
        let at = |r: usize, c: usize| self.terms[r * VIEWS + c];
        std::array::from_fn(|k| {
            let near = at(row, column)[k] + (at(row, column + 1)[k] - at(row, column)[k]) * fc;
            let far = at(row + 1, column)[k] + (at(row + 1, column + 1)[k] - at(row + 1, column)[k]) * fc;
            near + (far - near) * fr
        })
    }
}

/// The same of two widths: multilinear over the larger width, the ratio of the smaller one to it, the view and its azimuth from the axis of
/// the larger one.
pub(super) struct StretchedTable {
    terms: Vec<[f32; 2]>,
}

impl StretchedTable {
    /// Widths, ratios, views, azimuths. Widths, ratios and views are spaced as in [`AlbedoTable`].
    const NODES: [usize; 4] = [9, 6, 13, 5];

    /// Fills the nodes with `albedo(v, widths)`.
    pub(crate) fn new(albedo: impl Fn([f64; 3], [f64; 2]) -> [f64; 2]) -> Self {
        let fourth_root = |i: usize, nodes: usize| {
            let first = ALPHA_MIN.sqrt().sqrt();
            first + (1.0 - first) * i as f64 / (nodes - 1) as f64
        };
        let [widths, ratios, views, azimuths] = Self::NODES;
        let mut terms = Vec::with_capacity(widths * ratios * views * azimuths);
        for i in 0..widths * ratios * views * azimuths {
            let large = fourth_root(i / (ratios * views * azimuths), widths).powi(4);
            let ratio = fourth_root(i / (views * azimuths) % ratios, ratios).powi(4);
            let root = i as f64 / azimuths as f64;
            let root = N_DOT_V_MIN.sqrt() + (1.0 - N_DOT_V_MIN.sqrt()) * (root.floor() % views as f64) / (views - 1) as f64;
            let azimuth = std::f64::consts::FRAC_PI_2 * (i % azimuths) as f64 / (azimuths - 1) as f64;
            let [sine, _, cosine] = view(root * root);
            let v = [sine * libm::cos(azimuth), sine * libm::sin(azimuth), cosine];
            terms.push(albedo(v, [large, (large * ratio).max(ALPHA_MIN)]).map(|term| term as f32));
        }
        StretchedTable { terms }
    }

    /// The terms at a local view direction and widths along tangent and bitangent.
    pub(crate) fn lookup(&self, v: [f64; 3], alpha: [f64; 2]) -> [f32; 2] {
        let (large, small) = (alpha[0].max(alpha[1]), alpha[0].min(alpha[1]));
        let (along, across) = if alpha[0] >= alpha[1] { (v[0], v[1]) } else { (v[1], v[0]) };
        let first = ALPHA_MIN.sqrt().sqrt();
        let unit = [
            (large.sqrt().sqrt() - first) / (1.0 - first),
            ((small / large).sqrt().sqrt() - first) / (1.0 - first),
            (v[2].max(0.0).sqrt() - N_DOT_V_MIN.sqrt()) / (1.0 - N_DOT_V_MIN.sqrt()),
            libm::atan2(across.abs(), along.abs()) / std::f64::consts::FRAC_PI_2,
        ];
        let place: [(usize, f64); 4] = std::array::from_fn(|axis| {
            let at = unit[axis].clamp(0.0, 1.0) * (Self::NODES[axis] - 1) as f64;
            let low = (at as usize).min(Self::NODES[axis] - 2);
            (low, at - low as f64)
        });
        let mut sum = [0.0; 2];
        for corner in 0..16 {
            let (mut index, mut weight) = (0, 1.0);
            for axis in 0..4 {
                let upper = corner >> axis & 1;
                index = index * Self::NODES[axis] + place[axis].0 + upper;
                weight *= if upper == 1 { place[axis].1 } else { 1.0 - place[axis].1 };
            }
            (0..2).for_each(|term| sum[term] += weight * f64::from(self.terms[index][term]));
        }
        sum.map(|term| term as f32)
    }
}

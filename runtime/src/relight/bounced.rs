//! Bounced light of an asset with links: solved after direct light of all points, added to what drawing reads.

use super::surfaces::Surfaces;
use crate::asset::Asset;
use crate::bounces::Solver;
use crate::bounces::albedo::fill_senders;
use crate::light::layer::{Bounces, Indirect, LightOptions};
use crate::light::{Glossy, PointLobe};
use crate::sphere::frame::dot;
use crate::square_light::Share;
use std::f32::consts::PI;

/// Share of the mean irradiance below which progressive steps change nothing that anybody sees.
const AT_REST: f32 = 1e-4;

/// A solver, and what it was solved for.
pub(super) struct Bounced {
    solver: Solver,
    /// `[points][channel][axis]` direct vector irradiance, W·m⁻².
    pub direct: Vec<[[f32; 3]; 3]>,
    bounces: Bounces,
    /// Edition of the materials that the senders are of.
    edition: Option<u64>,
    /// Direct light, materials and options are those of the last solution.
    is_current: bool,
    /// Share of the mean irradiance that the last step changed.
    pub change: f32,
}

impl Bounced {
    /// For an asset with links; `None` for others.
    pub(super) fn new(asset: &Asset) -> Option<Self> {
        let solver = asset.bounce_solver()?;
        let direct = vec![[[0.0; 3]; 3]; asset.n_points()];
        Some(Bounced { solver, direct, bounces: Bounces::default(), edition: None, is_current: false, change: 0.0 })
    }

    /// Takes options.
    pub(super) fn configure(&mut self, options: &LightOptions) {
        let bounces = if options.indirect == Indirect::Added { options.bounces } else { Bounces::Off };
        self.is_current &= bounces == self.bounces;
        self.bounces = bounces;
    }

    /// Whether anything is added.
    pub(super) fn is_on(&self) -> bool {
        self.bounces != Bounces::Off
    }

    /// Solves where something changed, or where light that moves is not yet at rest, and writes the sum with direct light to `irradiance`.
    pub(super) fn update(&mut self, asset: &Asset, surfaces: &Surfaces, is_relit: bool, irradiance: &mut [[[f32; 3]; 3]]) {
        let is_repainted = self.edition != Some(surfaces.edition());
        if is_repainted {
            self.paint(asset, surfaces);
        }
        let is_moving = self.bounces == Bounces::Progressive && self.change > AT_REST;
        if is_relit || is_repainted || !self.is_current || is_moving {
            let patch = |index: usize| asset.patches()[index].bounce_input();
            self.change = self.solver.solve(self.bounces, &self.direct, &patch);
            self.is_current = true;
            for ((sum, direct), bounced) in irradiance.iter_mut().zip(&self.direct).zip(self.solver.vector()) {
                *sum = std::array::from_fn(|c| std::array::from_fn(|k| direct[c][k] + bounced[c][k]));
            }
        }
    }

    /// Takes albedo and emission from the materials as they are now.
    fn paint(&mut self, asset: &Asset, surfaces: &Surfaces) {
        let textures = asset.textures();
        for (at, object) in asset.objects().iter().enumerate() {
            let senders = &mut self.solver.senders()[object.points.clone()];
            fill_senders(&asset.mesh(at), surfaces.materials(), &textures, surfaces.tables(), senders);
        }
        self.edition = Some(surfaces.edition());
    }

    /// The share of the whole light that movers leave of a point where they leave this much of its direct light: they block none of what bounces.
    pub(super) fn left(&self, point: usize, share: &Share) -> Share {
        let [direct, bounced] = self.solver.of(point);
        let of = |c: usize| {
            let all = direct[c] + bounced[c];
            if all > 0.0 { (share.diffuse[c] * direct[c] + bounced[c]) / all } else { share.diffuse[c] }
        };
        Share { diffuse: std::array::from_fn(of), ..*share }
    }

    /// Bounced vector irradiance of a run of points.
    pub(super) fn of(&self, points: std::ops::Range<usize>) -> &[[[f32; 3]; 3]] {
        &self.solver.vector()[points]
    }
}

/// Adds what a lobe reflects of bounced light toward the unit direction `view`.
///
/// ```text
/// L(r) = E/π + 3/(2π) · W_t·r_t     from vector irradiance W about n: the radiance a + b·ω that has it
/// ```
///
/// Lossy: reflections are as soft as that, whatever the roughness.
pub(super) fn add_glossy(vector: &[[f32; 3]; 3], normal: [f32; 3], lobe: &PointLobe, view: [f32; 3], glossy: &mut Glossy) {
    let height = dot(lobe.normal, view);
    if height <= 0.0 {
        return;
    }
    let reflected: [f32; 3] = std::array::from_fn(|k| 2.0 * height * lobe.normal[k] - view[k]);
    let across = dot(reflected, normal);
    let sine = (1.0 - height * height).max(0.0).sqrt();
    let terms = lobe.lobe.albedo_terms([f64::from(sine), 0.0, f64::from(height)]);
    for c in 0..3 {
        let along = dot(vector[c], normal);
        let radiance = (along / PI + 1.5 / PI * (dot(vector[c], reflected) - along * across)).max(0.0);
        (0..2).for_each(|term| glossy[term][c] += terms[term][c] * radiance);
    }
}

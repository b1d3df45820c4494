//! Layers in their order, and where the memory of each lies in a point's row.

use super::layer::{Corners, Diffuse, Held, Layer, LightOptions, Patch, Rows, Sight};
use super::{Glossy, PointLobe};
use crate::environment::LightCubemap;

/// What sums the light of an asset.
#[derive(Default)]
pub struct Layers {
    layers: Vec<Placed>,
    /// Floats of a row.
    diffuse: usize,
    glossy: usize,
}

/// A layer, and its part of the rows.
struct Placed {
    layer: Box<dyn Layer>,
    diffuse: [usize; 2],
    glossy: [usize; 2],
}

impl Layers {
    /// In this order.
    pub(crate) fn new(layers: Vec<Box<dyn Layer>>) -> Self {
        let placed = |layer| Placed { layer, diffuse: [0; 2], glossy: [0; 2] };
        let mut layers = Layers { layers: layers.into_iter().map(placed).collect(), ..Layers::default() };
        layers.place();
        layers
    }

    /// Floats that a point's rows of diffuse and of glossy memory have.
    pub(crate) fn row_lengths(&self) -> [usize; 2] {
        [self.diffuse, self.glossy]
    }

    fn place(&mut self) {
        (self.diffuse, self.glossy) = (0, 0);
        for placed in &mut self.layers {
            let wanted = placed.layer.remembers();
            (placed.diffuse, placed.glossy) = ([self.diffuse, wanted.diffuse], [self.glossy, wanted.glossy]);
            (self.diffuse, self.glossy) = (self.diffuse + wanted.diffuse, self.glossy + wanted.glossy);
        }
    }

    /// Hands options to all; whether diffuse light must be summed anew.
    pub(crate) fn configure(&mut self, options: &LightOptions, light: Option<&LightCubemap>) -> bool {
        let mut anew = false;
        for placed in &mut self.layers {
            anew |= placed.layer.configure(options, light);
        }
        self.place();
        anew
    }

    /// Makes a light ready in all.
    pub(crate) fn prepare(&mut self, light: &LightCubemap, before: Option<&LightCubemap>) {
        self.layers.iter_mut().for_each(|placed| placed.layer.prepare(light, before));
        self.place();
    }

    /// Diffuse light of a patch; `rows` holds its points' rows.
    pub(crate) fn diffuse(&self, patch: &Patch, held: Held, rows: &mut [f32], out: &mut Diffuse) {
        for Placed { layer, diffuse: [first, len], .. } in &self.layers {
            layer.diffuse(patch, held, &mut Rows::new(rows, self.diffuse, *first, *len), out);
        }
        // Black where no layer added anything.
        out.sums();
    }

    /// Glossy light of a patch; `rows` holds its points' rows.
    pub(crate) fn glossy(&self, patch: &Patch, sight: &Sight, rows: &mut [f32], out: &mut [Glossy]) {
        out.fill(Glossy::default());
        for Placed { layer, glossy: [first, len], .. } in &self.layers {
            layer.glossy(patch, sight, &mut Rows::new(rows, self.glossy, *first, *len), out);
        }
    }

    /// Glossy light of a patch's clear coats.
    pub(crate) fn coat(&self, patch: &Patch, sight: &Sight, out: &mut [Glossy]) {
        out.fill(Glossy::default());
        self.layers.iter().for_each(|placed| placed.layer.coat(patch, sight, out));
    }

    /// Their say between points whose rows are `rows`; `None` where none has any.
    pub(crate) fn between<'a>(&'a self, rows: &'a [f32]) -> Option<Between<'a>> {
        self.layers.iter().any(|placed| placed.layer.has_between()).then_some(Between { layers: self, rows })
    }
}

/// What glossy light between points is beyond their interpolated light.
pub trait BetweenPoints: Sync {
    /// Points of the object that it knows.
    fn n_points(&self) -> usize;

    /// Corrects glossy light that was interpolated between three points, toward the unit direction `view`; `own`: what the pixel reflects with,
    /// where textures make that its own. The result is not negative.
    fn correct(&self, points: [usize; 3], weights: [f32; 3], view: [f32; 3], own: Option<&PointLobe>, glossy: &mut Glossy);
}

/// The say of layers between the points of an object.
#[derive(Clone, Copy)]
pub(crate) struct Between<'a> {
    layers: &'a Layers,
    rows: &'a [f32],
}

impl BetweenPoints for Between<'_> {
    fn n_points(&self) -> usize {
        self.rows.len().checked_div(self.layers.glossy).unwrap_or(usize::MAX)
    }

    fn correct(&self, points: [usize; 3], weights: [f32; 3], view: [f32; 3], own: Option<&PointLobe>, glossy: &mut Glossy) {
        for Placed { layer, glossy: [first, len], .. } in self.layers.layers.iter().filter(|placed| placed.layer.has_between()) {
            let row = |point: usize| {
                let start = point * self.layers.glossy + first;
                &self.rows[start..start + len]
            };
            layer.between(&Corners { rows: points.map(row), weights }, view, own, glossy);
        }
        // Differences of sums may fall below nothing by their rounding.
        glossy.iter_mut().flatten().for_each(|value| *value = value.max(0.0));
    }
}

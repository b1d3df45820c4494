//! Light at points, patch by patch, on all threads.

use super::bounced::{Bounced, add_glossy};
use super::moving::{MoverView, MovingRest, MovingWork};
use super::surfaces::Surfaces;
use crate::asset::AssetPatch;
use crate::brdf::surface::COAT_F0;
use crate::chunk::layout::PATCH_POINTS;
use crate::light::layer::{Diffuse, Held, Patch, Sight};
use crate::light::lune::BentLight;
use crate::light::{Glossy, Layers, PointLobe};
use crate::surface::detail::is_bent;
use prelight_manifests::ChunkKind;
use std::sync::atomic::{AtomicU64, Ordering};

/// Patches that are not worth splitting: about a millisecond.
const GRAIN: usize = 8;

/// What is computed, the same for all patches.
#[derive(Clone, Copy)]
pub(super) struct Work<'a> {
    pub layers: &'a Layers,
    pub surfaces: &'a Surfaces,
    /// `None`: diffuse light alone.
    pub eye: Option<[f32; 3]>,
    pub wanted: Option<&'a [bool]>,
    /// Bounced light that lobes reflect.
    pub bounced: Option<&'a Bounced>,
    /// `None` where nothing moves.
    pub moving: Option<MovingWork<'a>>,
    /// Points whose irradiance is summed are counted here.
    pub summed: &'a AtomicU64,
}

/// Which light the irradiance of a patch is of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Lit {
    /// None that is known.
    #[default]
    No,
    /// The one before, of which the current light is a change.
    Before,
    /// The current one.
    Now,
}

/// Patches and their part of every buffer.
pub(super) struct Part<'a> {
    pub patches: &'a [AssetPatch],
    /// One a patch.
    pub lit: Rest<'a, Lit>,
    pub irradiance: Rest<'a, [[f32; 3]; 3]>,
    /// Empty while no material has a normal map.
    pub lune: Rest<'a, BentLight>,
    pub glossy: Rest<'a, Glossy>,
    /// Empty while no material has a clear coat.
    pub coat: Rest<'a, [f32; 3]>,
    /// Memory of the layers.
    pub diffuse_rows: Rest<'a, f32>,
    pub glossy_rows: Rest<'a, f32>,
    /// Empty where nothing moves.
    pub moving: MovingRest<'a>,
}

/// What is left of a buffer, with so many elements a point.
#[derive(Default)]
pub(super) struct Rest<'a, T> {
    pub(super) elements: &'a mut [T],
    per_point: usize,
}

impl<'a, T> Rest<'a, T> {
    /// One element a point, or none at all.
    pub(crate) fn new(elements: &'a mut [T]) -> Self {
        let per_point = usize::from(!elements.is_empty());
        Rest { elements, per_point }
    }

    /// Rows of `per_point`.
    pub(crate) fn rows(elements: &'a mut [T], per_point: usize) -> Self {
        Rest { elements, per_point }
    }

    /// Takes the elements of the first `n` points out.
    pub(super) fn take(&mut self, n: usize) -> Self {
        let (first, rest) = std::mem::take(&mut self.elements).split_at_mut(n * self.per_point);
        self.elements = rest;
        Rest { elements: first, per_point: self.per_point }
    }
}

impl<'a> Part<'a> {
    /// Takes the first `n` patches out.
    fn take(&mut self, n: usize) -> Part<'a> {
        let (patches, rest) = self.patches.split_at(n);
        self.patches = rest;
        let points = patches.iter().map(|patch| patch.points.len()).sum();
        Part {
            patches,
            lit: self.lit.take(n),
            irradiance: self.irradiance.take(points),
            lune: self.lune.take(points),
            glossy: self.glossy.take(points),
            coat: self.coat.take(points),
            diffuse_rows: self.diffuse_rows.take(points),
            glossy_rows: self.glossy_rows.take(points),
            moving: self.moving.take(n, points),
        }
    }
}

impl Work<'_> {
    /// Shades the patches that hold a wanted point, halves on two threads where there are any; returns how many points that were.
    pub(crate) fn run(&self, mut part: Part) -> usize {
        if part.patches.len() <= GRAIN || cfg!(not(feature = "parallel")) {
            return self.run_here(part);
        }
        let first = part.take(part.patches.len() / 2);
        let (a, b) = join(|| self.run(first), || self.run(part));
        a + b
    }

    fn run_here(&self, mut part: Part) -> usize {
        let mut shaded = 0;
        while let [patch, ..] = part.patches {
            let own = part.take(1);
            if self.wanted.is_none_or(|wanted| wanted[patch.points.clone()].contains(&true)) {
                self.patch(patch, own);
                shaded += patch.points.len();
            }
        }
        shaded
    }

    fn patch(&self, patch: &AssetPatch, mut part: Part) {
        let (seen, first) = (patch.view(), patch.points.start);
        let held = match std::mem::replace(&mut part.lit.elements[0], Lit::Now) {
            Lit::Now => None,
            Lit::Before => Some(Held::LightBefore),
            Lit::No => Some(Held::Nothing),
        };
        let mover = self.moving.as_ref().and_then(|moving| moving.mover_of(first));
        if let Some(held) = held {
            self.diffuse(&seen, held, mover, &mut part);
            self.summed.fetch_add(seen.len() as u64, Ordering::Relaxed);
        }
        let Some(world_eye) = self.eye else {
            return self.moving.iter().for_each(|moving| moving.shares(&seen, first, None, std::mem::take(&mut part.moving)));
        };
        {
            let eye = mover.map_or(world_eye, |mover| mover.pose.own_place(world_eye));
            let layers = self.layers_of(mover);
            let mut lobes = [PointLobe::NONE; PATCH_POINTS];
            let lobes = &mut lobes[..seen.len()];
            lobes.iter_mut().enumerate().for_each(|(i, lobe)| *lobe = self.surfaces.lobe(&seen.surfaces, i, first + i));
            layers.glossy(&seen, &Sight { eye, lobes }, part.glossy_rows.elements, part.glossy.elements);
            if let Some(bounced) = self.bounced {
                self.reflect(&seen, &Sight { eye, lobes }, bounced.of(patch.points.clone()), part.glossy.elements);
            }
            if !part.coat.elements.is_empty() {
                self.coat(&seen, first, (eye, layers), part.coat.elements);
            }
            if let Some(moving) = &self.moving {
                moving.shares(&seen, first, Some(&Sight { eye: world_eye, lobes }), part.moving);
            }
        }
    }

    /// Adds what lobes reflect of bounced light, where no transfer says it better.
    fn reflect(&self, patch: &Patch, sight: &Sight, bounced: &[[[f32; 3]; 3]], glossy: &mut [Glossy]) {
        if patch.factor(ChunkKind::Transfer).is_some() {
            return;
        }
        for (i, glossy) in glossy.iter_mut().enumerate() {
            let view = toward(patch.points.position[i], sight.eye);
            add_glossy(&bounced[i], patch.points.normal[i], &sight.lobes[i], view, glossy);
        }
    }

    /// Layers with the light in the axes of a mover's points, or of the world.
    fn layers_of<'b>(&'b self, mover: Option<MoverView<'b>>) -> &'b Layers {
        mover.and_then(|mover| mover.layers).unwrap_or(self.layers)
    }

    /// Vector irradiance, and what bent normals need beside it.
    fn diffuse(&self, patch: &Patch, held: Held, mover: Option<MoverView>, part: &mut Part) {
        let mut second = [[0.0; 6]; PATCH_POINTS];
        let is_bent = !part.lune.elements.is_empty() && is_bent(&patch.surfaces, self.surfaces.baked());
        let second = if is_bent { &mut second[..patch.len()] } else { &mut [] };
        let irradiance = &mut *part.irradiance.elements;
        let layers = self.layers_of(mover);
        // Layers of a mover's own do not follow the light by its changes.
        let held = if mover.is_some_and(|mover| mover.layers.is_some()) { Held::Nothing } else { held };
        layers.diffuse(patch, held, part.diffuse_rows.elements, &mut Diffuse::new(irradiance, second));
        for (at, second) in second.iter().enumerate() {
            part.lune.elements[at] = BentLight::new(&irradiance[at], *second, patch.points.normal[at]);
        }
        let Some(pose) = mover.filter(|mover| mover.layers.is_some()).map(|mover| mover.pose) else { return };
        irradiance.as_flattened_mut().iter_mut().for_each(|e| *e = pose.direction(*e));
        let n_bent = second.len();
        part.lune.elements.iter_mut().take(n_bent).for_each(|lune| *lune = lune.turned(&pose.rotation));
    }

    /// Radiance of a whole clear coat, where the patch has one.
    fn coat(&self, patch: &Patch, first: usize, (eye, layers): ([f32; 3], &Layers), coat: &mut [[f32; 3]]) {
        let (averages, surfaces) = (&patch.surfaces, self.surfaces);
        if !averages.material.iter().any(|material| surfaces.materials()[*material as usize].clearcoat > 0.0) {
            return;
        }
        let (mut lobes, mut terms) = ([PointLobe::NONE; PATCH_POINTS], [Glossy::default(); PATCH_POINTS]);
        let (lobes, terms) = (&mut lobes[..patch.len()], &mut terms[..patch.len()]);
        lobes.iter_mut().enumerate().for_each(|(i, lobe)| *lobe = surfaces.coat(averages, i, first + i));
        layers.coat(patch, &Sight { eye, lobes }, terms);
        for (coat, [base, rest]) in coat.iter_mut().zip(terms) {
            *coat = std::array::from_fn(|k| COAT_F0 * base[k] + rest[k]);
        }
    }
}

/// Unit direction from a point to the eye.
fn toward(position: [f32; 3], eye: [f32; 3]) -> [f32; 3] {
    let away: [f32; 3] = std::array::from_fn(|k| eye[k] - position[k]);
    let length = away.iter().map(|x| x * x).sum::<f32>().sqrt().max(f32::MIN_POSITIVE);
    away.map(|x| x / length)
}

#[cfg(feature = "parallel")]
use rayon::join;

#[cfg(not(feature = "parallel"))]
fn join<A, B>(a: impl FnOnce() -> A, b: impl FnOnce() -> B) -> (A, B) {
    (a(), b())
}

//! Light at points, patch by patch, on all threads.

use super::{Indirect, Surfaces};
use crate::asset::AssetPatch;
use crate::block_product::{Light, shade_lobes, shade_moments};
use crate::brdf::surface::COAT_F0;
use crate::chunk::layout::PATCH_POINTS;
use crate::light::lune::Lune;
use crate::light::{Accuracy, Glossy, SimdPath};
use crate::surface::detail::is_bent;
use crate::vmf_transfer::FilteredLight;
use crate::vmf_transfer::highlight::{Highlight, keep_highlights};
use crate::vmf_transfer::pixel::EyeLobes;
use crate::vmf_transfer::shade::{add_glossy, add_irradiance};

/// Patches that are not worth splitting: about a millisecond.
const GRAIN: usize = 8;

/// What is computed, the same for all patches.
#[derive(Clone, Copy)]
pub(super) struct Work<'a> {
    pub light: &'a Light,
    pub surfaces: &'a Surfaces<'a>,
    pub accuracy: Accuracy,
    /// Indirect light, where it is on.
    pub indirect: Option<(&'a Indirect, &'a FilteredLight)>,
    /// The light in which highlights are looked up, where they are on.
    pub highlights: Option<&'a FilteredLight>,
    /// `None`: diffuse light alone.
    pub eye: Option<[f32; 3]>,
    pub wanted: Option<&'a [bool]>,
}

/// Patches and their part of every buffer: one element per patch in `is_lit`, per point elsewhere.
pub(super) struct Part<'a> {
    pub patches: &'a [AssetPatch],
    pub is_lit: &'a mut [bool],
    pub irradiance: &'a mut [[[f32; 3]; 3]],
    /// Empty while no material has a normal map.
    pub lune: &'a mut [Lune],
    pub glossy: &'a mut [Glossy],
    /// Empty while no material has a clear coat.
    pub coat: &'a mut [[f32; 3]],
    /// Empty without transfer.
    pub lobes: &'a mut [EyeLobes],
    /// Empty while highlights are off.
    pub highlights: &'a mut [Highlight],
}

/// The two parts of a buffer that may be empty.
fn split<T>(buffer: &mut [T], at: usize) -> (&mut [T], &mut [T]) {
    let at = at.min(buffer.len());
    buffer.split_at_mut(at)
}

impl<'a> Part<'a> {
    /// Halves of the patches.
    fn halves(self) -> [Part<'a>; 2] {
        let (patches, later) = self.patches.split_at(self.patches.len() / 2);
        let points = later[0].points.start - patches[0].points.start;
        let is_lit = split(self.is_lit, patches.len());
        let (irradiance, lune, glossy) = (split(self.irradiance, points), split(self.lune, points), split(self.glossy, points));
        let (coat, lobes, highlights) = (split(self.coat, points), split(self.lobes, points), split(self.highlights, points));
        let first = Part {
            patches,
            is_lit: is_lit.0,
            irradiance: irradiance.0,
            lune: lune.0,
            glossy: glossy.0,
            coat: coat.0,
            lobes: lobes.0,
            highlights: highlights.0,
        };
        let second = Part {
            patches: later,
            is_lit: is_lit.1,
            irradiance: irradiance.1,
            lune: lune.1,
            glossy: glossy.1,
            coat: coat.1,
            lobes: lobes.1,
            highlights: highlights.1,
        };
        [first, second]
    }
}

impl Work<'_> {
    /// Shades the patches that hold a wanted point, halves on two threads where there are any; returns how many points that were.
    pub fn run(&self, part: Part) -> usize {
        if part.patches.len() <= GRAIN || cfg!(not(feature = "parallel")) {
            return self.run_here(part);
        }
        let [first, second] = part.halves();
        let (a, b) = join(|| self.run(first), || self.run(second));
        a + b
    }

    fn run_here(&self, part: Part) -> usize {
        let start = part.patches.first().map_or(0, |patch| patch.points.start);
        let mut shaded = 0;
        for (patch, is_lit) in part.patches.iter().zip(part.is_lit) {
            if self.wanted.is_some_and(|wanted| !wanted[patch.points.clone()].contains(&true)) {
                continue;
            }
            let range = patch.points.start - start..patch.points.end - start;
            if !std::mem::replace(is_lit, true) {
                self.diffuse(patch, &mut part.irradiance[range.clone()], part.lune.get_mut(range.clone()).unwrap_or_default());
            }
            shaded += patch.points.len();
            let Some(eye) = self.eye else { continue };
            let glossy = &mut part.glossy[range.clone()];
            self.glossy(patch, eye, glossy, part.highlights.get_mut(range.clone()).unwrap_or_default());
            if let Some(((indirect, light), transfer)) = self.indirect.zip(patch.transfer()) {
                let (position, normal) = (patch.points().position, patch.surfaces().normal);
                add_glossy(light, &indirect.solid, &transfer, position, normal, eye, glossy, &mut part.lobes[range.clone()]);
            }
            if let Some(coat) = part.coat.get_mut(range) {
                self.coat(patch, eye, coat);
            }
        }
        shaded
    }

    /// Vector irradiance, and what bent normals need beside it; `lune` may be empty.
    fn diffuse(&self, patch: &AssetPatch, irradiance: &mut [[[f32; 3]; 3]], lune: &mut [Lune]) {
        let mut second = [[0.0; 6]; PATCH_POINTS];
        let is_bent = !lune.is_empty() && is_bent(&patch.surfaces(), self.surfaces.baked);
        let second = if is_bent { &mut second[..patch.points.len()] } else { &mut [] };
        shade_moments(SimdPath::detect(), self.light, &patch.visibility(), irradiance, second);
        let normal = patch.points().normal;
        if let Some(((_, light), transfer)) = self.indirect.zip(patch.transfer()) {
            add_irradiance(light, &transfer, normal, irradiance, second);
        }
        for (at, second) in second.iter().enumerate() {
            lune[at] = Lune::new(&irradiance[at], *second, normal[at]);
        }
    }

    /// Direct glossy light, and what pixels between points need of it; `highlights` may be empty.
    fn glossy(&self, patch: &AssetPatch, eye: [f32; 3], glossy: &mut [Glossy], highlights: &mut [Highlight]) {
        let (position, averages, first) = (patch.points().position, patch.surfaces(), patch.points.start);
        let lobe = |i: usize| self.surfaces.lobe(&averages, i, first + i);
        shade_lobes(SimdPath::detect(), self.accuracy, self.light, position, lobe, &patch.visibility(), eye, glossy);
        if let Some(light) = self.highlights {
            keep_highlights(light, position, lobe, eye, glossy, highlights);
        }
    }

    /// Radiance of a whole clear coat, where the patch has one.
    fn coat(&self, patch: &AssetPatch, eye: [f32; 3], coat: &mut [[f32; 3]]) {
        let (averages, first, surfaces) = (patch.surfaces(), patch.points.start, self.surfaces);
        if !averages.material.iter().any(|material| surfaces.materials[*material as usize].clearcoat > 0.0) {
            return;
        }
        let mut terms = [Glossy::default(); PATCH_POINTS];
        let terms = &mut terms[..patch.points.len()];
        let lobe = |i: usize| surfaces.coat(&averages, i, first + i);
        shade_lobes(SimdPath::detect(), self.accuracy, self.light, patch.points().position, lobe, &patch.visibility(), eye, terms);
        for (coat, [base, rest]) in coat.iter_mut().zip(terms) {
            *coat = std::array::from_fn(|k| COAT_F0 * base[k] + rest[k]);
        }
    }
}

#[cfg(feature = "parallel")]
use rayon::join;

#[cfg(not(feature = "parallel"))]
fn join<A, B>(a: impl FnOnce() -> A, b: impl FnOnce() -> B) -> (A, B) {
    (a(), b())
}

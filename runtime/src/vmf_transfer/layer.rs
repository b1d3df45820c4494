//! The layer: light over other surfaces at points, and lobes looked up between them, indirect and direct.
//!
//! A point's row: its lobes toward the eye ([`EyeLobes`]) where the asset has transfer, then its direct light ([`Highlight`]) where highlights are
//! wanted. Direct light is what the layers before this one summed.

use super::highlight::{self, Highlight};
use super::pixel::{EyeLobes, move_lobes};
use super::shade::{add_glossy_at, add_irradiance};
use super::{FilteredLight, Transfer};
use crate::environment::LightCubemap;
use crate::light::layer::{Bounces, Corners, Diffuse, Held, Highlights, Indirect, Layer, LightOptions, Patch, Remembered, Rows, Sight};
use crate::light::{Glossy, PointLobe};
use crate::sphere::icosahedron::{Icosahedron, MAX_LEVEL};
use bytemuck::{bytes_of, cast_slice, from_bytes};
use prelight_manifests::ChunkKind;

/// Floats of a point's lobes.
const LOBE_FLOATS: usize = size_of::<EyeLobes>() / 4;
/// Floats of a point's direct light.
const HIGHLIGHT_FLOATS: usize = size_of::<Highlight>() / 4;

/// Light in von Mises–Fisher lobes.
pub(crate) struct VmfTransfer {
    /// Directions of slices; `None` where no patch has any.
    solid: Option<Icosahedron>,
    /// `None` before the first light, and where it is not looked up.
    light: Option<FilteredLight>,
    indirect: Indirect,
    highlights: Highlights,
    bounces: Bounces,
}

impl VmfTransfer {
    /// A layer for an asset with transfer or without; without, it is there for highlights alone.
    pub(crate) fn new(has_transfer: bool) -> Self {
        let LightOptions { indirect, highlights, bounces, .. } = LightOptions::default();
        VmfTransfer { solid: has_transfer.then(|| Icosahedron::new(MAX_LEVEL)), light: None, indirect, highlights, bounces }
    }

    fn is_wanted(&self) -> bool {
        self.solid.is_some() || self.highlights == Highlights::PerPixel
    }

    /// Light, directions and chunk of indirect light, where it is added.
    fn indirect<'a>(&'a self, patch: &Patch<'a>) -> Option<(&'a FilteredLight, &'a Icosahedron, Transfer<'a>)> {
        let chunk = patch.factor(ChunkKind::Transfer).filter(|_| self.indirect == Indirect::Added)?;
        Some((self.light.as_ref()?, self.solid.as_ref()?, Transfer::from_proven_chunk(chunk)))
    }

    /// Floats of a row before the highlight's.
    fn lobe_floats(&self) -> usize {
        if self.solid.is_some() { LOBE_FLOATS } else { 0 }
    }
}

impl Layer for VmfTransfer {
    fn remembers(&self) -> Remembered {
        let highlight = if self.highlights == Highlights::PerPixel { HIGHLIGHT_FLOATS } else { 0 };
        Remembered { glossy: self.lobe_floats() + highlight, ..Remembered::default() }
    }

    fn configure(&mut self, options: &LightOptions, light: Option<&LightCubemap>) -> bool {
        let anew = self.solid.is_some() && (self.indirect, self.bounces) != (options.indirect, options.bounces);
        (self.indirect, self.highlights, self.bounces) = (options.indirect, options.highlights, options.bounces);
        match light.filter(|_| self.is_wanted()) {
            Some(light) if self.light.is_none() => self.light = Some(FilteredLight::prepare(light)),
            Some(_) => {}
            None => self.light = None,
        }
        anew
    }

    fn prepare(&mut self, light: &LightCubemap, _: Option<&LightCubemap>) {
        self.light = self.is_wanted().then(|| FilteredLight::prepare(light));
    }

    fn diffuse(&self, patch: &Patch, _: Held, _: &mut Rows, out: &mut Diffuse) {
        // What links bring is the same light, with albedo that can be edited.
        let has_links = self.bounces != Bounces::Off && patch.factor(ChunkKind::Links).is_some();
        if let Some((light, _, transfer)) = self.indirect(patch).filter(|_| !has_links) {
            let (irradiance, second) = out.sums();
            add_irradiance(light, &transfer, patch.points.normal, irradiance, second);
        }
    }

    fn glossy(&self, patch: &Patch, sight: &Sight, rows: &mut Rows, out: &mut [Glossy]) {
        let (position, normal, first) = (patch.points.position, patch.surfaces.normal, self.lobe_floats());
        if let Some(light) = self.light.as_ref().filter(|_| self.highlights == Highlights::PerPixel) {
            for i in 0..patch.len() {
                let own = Highlight::toward(light, &sight.lobes[i], position[i], sight.eye, &out[i]);
                rows.of(i)[first..].copy_from_slice(cast_slice(bytes_of(&own)));
            }
        }
        if let Some((light, solid, transfer)) = self.indirect(patch) {
            for i in 0..patch.len() {
                let own = add_glossy_at(light, solid, &transfer.point(i), position[i], normal[i], sight.eye, &mut out[i]);
                rows.of(i)[..first].copy_from_slice(cast_slice(bytes_of(&own)));
            }
        }
    }

    fn has_between(&self) -> bool {
        self.light.is_some()
    }

    fn between(&self, corners: &Corners, view: [f32; 3], own: Option<&PointLobe>, glossy: &mut Glossy) {
        let (Some(light), first) = (&self.light, self.lobe_floats()) else { return };
        if self.highlights == Highlights::PerPixel {
            let points = corners.rows.map(|row| from_bytes::<Highlight>(cast_slice(&row[first..])));
            highlight::correct(light, points, corners.weights, view, own, glossy);
        }
        if first > 0 {
            let points = corners.rows.map(|row| from_bytes::<EyeLobes>(cast_slice(&row[..first])));
            move_lobes(light, points, corners.weights, glossy);
        }
    }
}

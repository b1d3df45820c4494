//! What a point reflects with.

use crate::brdf::{Lobe, ggx};

/// What a point reflects with: a lobe, and how it stands in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointLobe<'a> {
    /// The lobe.
    pub lobe: Lobe<'a>,
    /// Unit normal of the lobe.
    pub normal: [f32; 3],
    /// Direction of an anisotropic lobe's first width; need not be perpendicular to the normal. Zero: any.
    pub tangent: [f32; 3],
}

impl PointLobe<'_> {
    /// Reflects nothing.
    pub(crate) const NONE: PointLobe<'static> = PointLobe { lobe: Lobe::None, normal: [0.0; 3], tangent: [0.0; 3] };

    /// An isotropic GGX lobe of a perceptual roughness.
    pub fn ggx(normal: [f32; 3], roughness: f32) -> Self {
        PointLobe { lobe: Lobe::Ggx { alpha: [ggx::alpha(roughness); 2] }, normal, tangent: [0.0; 3] }
    }
}

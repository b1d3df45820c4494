//! Every base triangle of the scene in world space: what rays meet and what points lie on.

/// World-space base triangles of all objects, in object order, then primitive order, then index order.
///
/// A base triangle's id is its index here. Zero-area and non-finite triangles are kept as ids but never occlude and carry no points.
#[derive(Clone, Debug, Default)]
pub struct World {
    /// `[n]` corner positions as traced, f32 rounded once from the f64 product, −0 replaced by 0. Wound so that the front is
    /// counter-clockwise (mirrored transforms are already flipped).
    pub positions: Vec<[[f32; 3]; 3]>,
    /// `[n]` how the triangle blocks light.
    pub occlusion: Vec<Occlusion>,
    /// `[n]` index of the primitive in `primitives`.
    pub primitive: Vec<u32>,
    /// One per (object, primitive).
    pub primitives: Vec<WorldPrimitive>,
    /// `[objects + 1]` first triangle id of each object.
    pub object_start: Vec<u32>,
    /// Cut-outs that `Occlusion::Mask` names.
    pub masks: Vec<AlphaMask>,
}

/// How a triangle blocks light. Both faces block, whatever the material's sidedness.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Occlusion {
    /// Light passes: BLEND below opacity 0.5, zero area, or not finite.
    #[default]
    None,
    /// Solid.
    Opaque,
    /// Blocks where the alpha of `masks[mask]` at the hit reaches its cutoff; `corner` is the triangle's row in the mask's uv.
    Mask {
        /// Index into [`World::masks`].
        mask: u32,
        /// Index into [`AlphaMask::uv`].
        corner: u32,
    },
}

/// Alpha cut-out of one (object, primitive).
#[derive(Clone, Debug)]
pub struct AlphaMask {
    /// Index into the scene's textures.
    pub texture: u32,
    /// How it is sampled.
    pub reference: prelight_runtime::surface::TextureRef,
    /// Factor on the texture's alpha (base colour factor).
    pub factor: f32,
    /// Blocks at and above this.
    pub cutoff: f32,
    /// `[triangles of the primitive]` texture coordinates of the three corners.
    pub uv: Vec<[[f32; 2]; 3]>,
    /// `[triangles of the primitive]` vertex-colour alpha of the three corners (1 where there is none).
    pub alpha: Vec<[f32; 3]>,
}

/// Attributes of one (object, primitive) in world space, indexed like the local primitive.
#[derive(Clone, Debug, Default)]
pub struct WorldPrimitive {
    /// Index into the scene's objects.
    pub object: u32,
    /// Index into the object's mesh.
    pub primitive: u32,
    /// Index into the scene's materials.
    pub material: u32,
    /// First base triangle id of this primitive.
    pub first_triangle: u32,
    /// `[triangles]` vertex indices as wound in [`World::positions`].
    pub triangles: Vec<[u32; 3]>,
    /// `[vertices]` world position, the same bits as in [`World::positions`].
    pub positions: Vec<[f32; 3]>,
    /// `[vertices]` unit world normal; empty when the primitive is flat. A zero vector marks a vertex whose normal is unusable (flat there).
    pub normals: Vec<[f32; 3]>,
    /// `[vertices]` unit world tangent and bitangent sign, or empty.
    pub tangents: Vec<[f32; 4]>,
    /// The transform mirrors: triangles were flipped.
    pub mirrored: bool,
}

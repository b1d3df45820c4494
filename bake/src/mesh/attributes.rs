//! Optional attributes of the draw mesh: texture coordinates, tangents, colours.

use crate::mesh::weld::Vertices;
use prelight_scene::world::WorldPrimitive;
use prelight_scene::{Primitive, Scene};

/// Which optional arrays the object's vertices have.
pub(crate) struct Wanted {
    pub uv: [bool; 2],
    pub tangent: bool,
    pub color: bool,
}

impl Wanted {
    pub(crate) fn of(scene: &Scene, object: usize, parts: &[WorldPrimitive]) -> Wanted {
        let primitives = &scene.objects[object].mesh.primitives;
        let local = |p: &WorldPrimitive| &primitives[p.primitive as usize];
        Wanted {
            uv: [0, 1].map(|set| parts.iter().any(|p| local(p).uvs[set].is_some())),
            tangent: parts.iter().any(|p| has_tangents(scene, p)),
            color: parts.iter().any(|p| local(p).colors.is_some()),
        }
    }

    pub(crate) fn push(&self, vertices: &mut Vertices, corner: &Corner) {
        for set in 0..2 {
            if self.uv[set] {
                vertices.uv[set].push(corner.uv[set]);
            }
        }
        if self.tangent {
            vertices.tangent.push(corner.tangent);
        }
        if self.color {
            vertices.color.push(corner.color);
        }
    }
}

/// The optional attributes of one corner.
#[derive(Clone, Copy)]
pub(crate) struct Corner {
    pub uv: [[f32; 2]; 2],
    pub tangent: [f32; 4],
    pub color: [f32; 4],
}

/// Reads the corners of one (object, primitive).
pub(crate) struct Corners<'a> {
    local: &'a Primitive,
    part: &'a WorldPrimitive,
    has_tangents: bool,
}

impl<'a> Corners<'a> {
    pub(crate) fn new(scene: &Scene, local: &'a Primitive, part: &'a WorldPrimitive) -> Self {
        Corners { local, part, has_tangents: has_tangents(scene, part) }
    }

    /// Attributes at vertex `v` of the primitive.
    pub(crate) fn at(&self, v: u32, flipped: bool) -> Corner {
        let v = v as usize;
        let uv = [0, 1].map(|set| self.local.uvs[set].as_ref().map_or([0.0; 2], |uv| uv[v]));
        let color = self.local.colors.as_ref().map_or([1.0; 4], |colors| colors[v]);
        let mut tangent = if self.has_tangents { self.part.tangents[v] } else { [0.0; 4] };
        // A negated normal needs a negated sign to keep the bitangent sign · n × t.
        if flipped {
            tangent[3] = -tangent[3];
        }
        Corner { uv, tangent, color }
    }
}

/// Tangents matter to normal maps and anisotropy only.
fn has_tangents(scene: &Scene, part: &WorldPrimitive) -> bool {
    scene.materials[part.material as usize].tangent_uv_set().is_some() && !part.tangents.is_empty()
}

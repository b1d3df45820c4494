//! Pinhole cameras.

use serde::{Deserialize, Serialize};

/// A camera of the scene, as the asset keeps it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneCamera {
    /// Name of the node or camera, may be empty.
    pub name: String,
    /// Where it is and how it looks.
    pub camera: Camera,
}

/// A perspective camera. Right-handed, looks from `eye` to `look_at`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// World position, metres.
    pub eye: [f32; 3],
    /// A point on the optical axis.
    pub look_at: [f32; 3],
    /// Roughly up; not parallel to the axis.
    pub up: [f32; 3],
    /// Vertical field of view, degrees, in 1..=179.
    pub fov_y_deg: f32,
}

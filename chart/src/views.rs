//! The fixed views of a chart.
//!
//! The scene's cameras (or the automatic view), then, around what they look at and a little nearer, views that nothing was ever tuned on:
//! turned by 24° to one side, to the other, and so on. Every second view is held back.

use prelight_runtime::asset::Asset;
use prelight_runtime::asset::mesh::Mesh;
use prelight_runtime::draw::camera::Camera;
use prelight_runtime::draw::framing::automatic_view;

/// Turn of a held-back view about its target, degrees; every further pair turns as much again.
const TURN_DEG: f64 = 24.0;
/// Its distance, relative to the camera's.
const NEARER: f64 = 0.85;

/// A place to look from.
#[derive(Clone, Debug, PartialEq)]
pub struct ChartView {
    /// The camera's name, with the turn where it is held back.
    pub name: String,
    /// The camera.
    pub camera: Camera,
    /// No constant of prelight was chosen by looking from here.
    pub held_back: bool,
}

/// `count` views of an asset, at least one; the same for the same asset and count.
pub fn views(asset: &Asset, aspect: f32, count: usize) -> Vec<ChartView> {
    let meshes: Vec<Mesh> = (0..asset.objects().len()).map(|object| asset.mesh(object)).collect();
    let automatic = || ("automatic".to_string(), automatic_view(&meshes, asset.materials(), &asset.textures(), aspect));
    let mut cameras: Vec<(String, Camera)> = asset.cameras().iter().map(|camera| (camera.name.clone(), camera.camera)).collect();
    if cameras.is_empty() {
        cameras.push(automatic());
    }
    around(&cameras, count)
}

fn around(cameras: &[(String, Camera)], count: usize) -> Vec<ChartView> {
    let n = cameras.len();
    let mut views = Vec::new();
    for i in 0..count.max(1) {
        // Seen, held back, seen, held back: pair by pair through the cameras.
        let (pair, held_back) = (i / 2, i % 2 == 1);
        let (name, camera) = &cameras[pair % n];
        // The first time around the seen view is the camera itself.
        let turn = TURN_DEG * if held_back { (pair / n + 1) as f64 } else { -((pair / n) as f64) };
        if turn == 0.0 {
            views.push(ChartView { name: name.clone(), camera: *camera, held_back });
        } else {
            views.push(ChartView { name: format!("{name} {turn:+}"), camera: orbited(camera, turn, NEARER), held_back });
        }
    }
    views
}

/// About the vertical through what it looks at, at `share` of its distance.
pub fn orbited(camera: &Camera, degrees: f64, share: f64) -> Camera {
    let (sine, cosine) = (libm::sin(degrees.to_radians()), libm::cos(degrees.to_radians()));
    let away: [f64; 3] = std::array::from_fn(|k| share * f64::from(camera.eye[k] - camera.look_at[k]));
    let away = [cosine * away[0] + sine * away[2], away[1], cosine * away[2] - sine * away[0]];
    let eye = std::array::from_fn(|k| (f64::from(camera.look_at[k]) + away[k]) as f32);
    Camera { eye, ..*camera }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_of_the_views_are_held_back_and_none_repeats() {
        let camera = |x: f32| Camera::upright([x, 1.0, 4.0], [0.0, 1.0, 0.0], 45.0).unwrap();
        let cameras = vec![("a".to_string(), camera(0.0)), ("b".to_string(), camera(2.0))];
        let views = around(&cameras, 6);
        assert_eq!(views[0].camera, cameras[0].1);
        assert_eq!(views.iter().filter(|view| view.held_back).count(), 3);
        for (i, view) in views.iter().enumerate() {
            assert!(views[..i].iter().all(|other| other.camera != view.camera && other.name != view.name), "{view:?}");
            assert!(!view.held_back || view.name.contains('+'), "{view:?}");
        }
        let distance = |eye: [f32; 3]| (eye[0].powi(2) + eye[2].powi(2)).sqrt();
        assert!((distance(views[1].camera.eye) - 3.4).abs() < 1e-5);
        assert_eq!(around(&cameras, 0).len(), 1);
    }
}

//! Flaws that need no ray.

use super::Finding;
use super::thin::length;
use prelight_scene::Scene;
use prelight_scene::world::{Occlusion, World};

/// Scenes smaller than this are hardly in metres, metres along their longest side.
const SMALLEST: f32 = 0.05;
/// Larger ones too.
const LARGEST: f32 = 2000.0;
/// Distance from the origin beyond which f32 positions are coarser than a tenth of a millimetre: 2⁻²³ · 1 km.
const FAR: f32 = 1000.0;

pub(super) fn findings(scene: &Scene, world: &World) -> Vec<Finding> {
    let mut found = Vec::new();
    let mut finding = |kind, names: Vec<String>, text: String, help| {
        if !names.is_empty() {
            found.push(Finding { kind, text, names, help });
        }
    };
    let of = |wanted: &dyn Fn(usize) -> bool| -> Vec<String> {
        (0..scene.objects.len()).filter(|object| wanted(*object)).map(|object| scene.objects[object].name.clone()).collect()
    };
    let names = of(&|object| {
        let range = world.object_start[object] as usize..world.object_start[object + 1] as usize;
        world.occlusion[range].iter().all(|occlusion| *occlusion == Occlusion::None)
    });
    let text = format!("{} no light: see-through, or without area", super::count(names.len(), "object blocks", "objects block"));
    finding("empty", names, text, "if they should cast shadows: [[material]] occludes = true");

    let finite = world.positions.iter().flatten().filter(|corner| corner.iter().all(|x| x.is_finite()));
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for corner in finite {
        for k in 0..3 {
            low[k] = low[k].min(corner[k]);
            high[k] = high[k].max(corner[k]);
        }
    }
    let longest = (0..3).map(|k| high[k] - low[k]).fold(0.0, f32::max);
    let whole = || vec!["the scene".to_string()];
    if longest > LARGEST {
        let text = format!("the scene is {} long: is it in centimetres or millimetres? glTF counts metres", length(longest));
        finding("scale", whole(), text, "as a [[scene.part]], scale = 0.01 or 0.001");
    } else if longest < SMALLEST {
        let text = format!("the scene is {} long: is it in kilometres, or scaled to fit? glTF counts metres", length(longest));
        finding("scale", whole(), text, "as a [[scene.part]], scale = 1000, or whatever makes it true to life");
    }
    let farthest = low.iter().chain(&high).map(|x| x.abs()).filter(|x| x.is_finite()).fold(0.0, f32::max);
    if farthest > FAR && farthest > 4.0 * longest {
        let text = format!("the scene stands {} from the origin, where positions are coarse", length(farthest));
        finding("far_from_origin", whole(), text, "as a [[scene.part]], translate it to the origin");
    }
    found
}

//! The walk over three trees.

use super::tree::{HaarTree, Node};
use super::visibility::{self, VisibilityTree};

/// A square that at least two factors still vary in.
#[derive(Clone, Copy)]
struct Square<const R: usize> {
    light: u16,
    lobe: u16,
    visibility: u16,
    /// Texels of a child.
    child_area: u16,
    light_mean: [f32; 3],
    lobe_mean: [f32; R],
}

/// Levels at 128² times the children that wait on each, and the one in hand.
const DEPTH: usize = 7 * 3 + 1;

/// The sums `[function of the lobe][channel]` of light × visibility × lobe.
///
/// Panics where resolutions differ. Does not allocate. Error against the same three functions at texels: f32 rounding.
pub fn triple_product(light: &HaarTree, visibility: &VisibilityTree, lobe: &HaarTree) -> [[f32; 3]; 3] {
    product::<3>(light, visibility, lobe)
}

/// The first function of the lobe alone, `[channel]`: what a grey surface costs.
pub fn triple_product_of_one(light: &HaarTree, visibility: &VisibilityTree, lobe: &HaarTree) -> [f32; 3] {
    product::<1>(light, visibility, lobe)[0]
}

fn product<const R: usize>(light: &HaarTree, visibility: &VisibilityTree, lobe: &HaarTree) -> [[f32; 3]; R] {
    let n = light.face_resolution;
    assert!(visibility.face_resolution == n && lobe.face_resolution == n, "three functions on the same cubemap");
    // `[function][channel]`, the children's lanes apart until the end.
    let mut sums = [[[0.0f32; 4]; 3]; R];
    let empty = Square { light: 0, lobe: 0, visibility: 0, child_area: 0, light_mean: [0.0; 3], lobe_mean: [0.0; R] };
    let mut stack = [empty; DEPTH];
    for face in 0..6 {
        if visibility.sum[face] == 0 {
            continue;
        }
        let root = Square {
            light: light.root[face],
            lobe: lobe.root[face],
            visibility: visibility.root[face],
            child_area: (n * n / 4) as u16,
            light_mean: light.mean[face],
            lobe_mean: std::array::from_fn(|t| lobe.mean[face][t]),
        };
        if details(root.light, root.lobe, root.visibility) <= 1 {
            let open = f32::from(visibility.sum[face]);
            for (sums, lobe) in sums.iter_mut().zip(root.lobe_mean) {
                (0..3).for_each(|c| sums[c][0] += lobe * root.light_mean[c] * open);
            }
            continue;
        }
        stack[0] = root;
        let mut waiting = 1;
        while waiting > 0 {
            waiting -= 1;
            let square = stack[waiting];
            let l: &Node = &light.nodes[usize::from(square.light)];
            let r: &Node = &lobe.nodes[usize::from(square.lobe)];
            let whole = visibility::Node { sum: [square.child_area; 4], child: [0; 4] };
            let v = if square.visibility == 0 { &whole } else { &visibility.nodes[usize::from(square.visibility)] };
            let light_mean: [[f32; 4]; 3] = std::array::from_fn(|c| l.delta[c].map(|delta| square.light_mean[c] + delta));
            let lobe_mean: [[f32; 4]; R] = std::array::from_fn(|t| r.delta[t].map(|delta| square.lobe_mean[t] + delta));
            let mut open = v.sum.map(f32::from);
            for child in 0..4 {
                if v.sum[child] == 0 || details(l.child[child], r.child[child], v.child[child]) <= 1 {
                    continue;
                }
                open[child] = 0.0;
                stack[waiting] = Square {
                    light: l.child[child],
                    lobe: r.child[child],
                    visibility: v.child[child],
                    child_area: square.child_area / 4,
                    light_mean: std::array::from_fn(|c| light_mean[c][child]),
                    lobe_mean: std::array::from_fn(|t| lobe_mean[t][child]),
                };
                waiting += 1;
            }
            for (sums, lobe) in sums.iter_mut().zip(&lobe_mean) {
                let open: [f32; 4] = std::array::from_fn(|k| open[k] * lobe[k]);
                for (sums, light) in sums.iter_mut().zip(&light_mean) {
                    (0..4).for_each(|k| sums[k] += open[k] * light[k]);
                }
            }
        }
    }
    sums.map(|sums| sums.map(|lanes| (lanes[0] + lanes[1]) + (lanes[2] + lanes[3])))
}

/// How many factors vary inside a square.
fn details(light: u16, lobe: u16, visibility: u16) -> u32 {
    u32::from(light != 0) + u32::from(lobe != 0) + u32::from(visibility != 0)
}

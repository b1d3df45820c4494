//! The tree against slow truths.

use super::moments::{Fit, LUMINANCE, Moments};
use super::tree::{Tree, neighbours};
use crate::environment::LightCubemap;
use crate::sphere::cubemap::{texel_solid_angle, texel_unit_direction};

/// A light of one value a texel and channel, spread evenly over each texel.
pub(crate) fn even_light(n: usize, radiance: impl Fn(usize) -> [f32; 3]) -> LightCubemap {
    let mut light = LightCubemap::black(n);
    for texel in 0..6 * n * n {
        let (face, x, y) = (texel / (n * n), texel % n, texel / n % n);
        let (area, d) = (texel_solid_angle(n, x, y) as f32, texel_unit_direction(n, face, x, y));
        light.flux[texel] = radiance(texel).map(|l| l * area);
        light.moment[texel] = light.flux[texel].map(|flux| d.map(|d| flux * d * (1.0 - area / 12.0)));
    }
    light
}

/// Numbers in 0..1 without a pattern.
pub(crate) fn noise(i: usize) -> f32 {
    let mut x = (i as u32).wrapping_mul(0x9E37_79B9) ^ 0x85EB_CA6B;
    x = (x ^ (x >> 15)).wrapping_mul(0x2C1B_3C6D);
    x = (x ^ (x >> 12)).wrapping_mul(0x297A_2D39);
    (x >> 8) as f32 / (1 << 24) as f32
}

/// Bright spots on a dim ground, coloured.
pub(crate) fn spots(n: usize, seed: usize) -> LightCubemap {
    even_light(n, |texel| {
        let cell = texel / 13 + 7 * (texel / n) + seed;
        let bright = if noise(cell) > 0.98 { 200.0 } else { 0.0 };
        std::array::from_fn(|c| 0.2 + 0.3 * noise(3 * texel + c + seed) + bright * noise(cell + c))
    })
}

/// The tree by looking at all pairs before every join.
fn slow_joins(light: &LightCubemap, until: usize) -> Vec<[u32; 2]> {
    let n = light.face_resolution;
    let texels = 6 * n * n;
    let whole = Tree::build(light);
    let mut moments: Vec<Option<Moments>> = (0..texels).map(|texel| Some(*whole.moments(texel as u32))).collect();
    let mut of: Vec<usize> = (0..texels).collect();
    let mut joins = Vec::new();
    while texels - joins.len() > until {
        let mut best: Option<(f64, usize, usize)> = None;
        for texel in 0..texels {
            for other in neighbours(n, texel) {
                let (a, b) = (of[texel].min(of[other as usize]), of[texel].max(of[other as usize]));
                if a != b {
                    let cost = moments[a].unwrap().joined(&moments[b].unwrap()).cost();
                    if best.is_none_or(|best| (cost, a, b) < best) {
                        best = Some((cost, a, b));
                    }
                }
            }
        }
        let (_, a, b) = best.unwrap();
        moments.push(Some(moments[a].unwrap().joined(&moments[b].unwrap())));
        (moments[a], moments[b]) = (None, None);
        let node = moments.len() - 1;
        of.iter_mut().filter(|node| **node == a || **node == b).for_each(|own| *own = node);
        joins.push([a as u32, b as u32]);
    }
    joins
}

#[test]
fn neighbours_know_each_other() {
    for n in [4, 16, 64] {
        for texel in 0..6 * n * n {
            for other in neighbours(n, texel) {
                assert!(neighbours(n, other as usize).contains(&(texel as u32)), "{n}: {texel} {other}");
            }
        }
    }
}

#[test]
fn the_heap_joins_as_looking_at_all_pairs_would() {
    for seed in 0..3 {
        let light = spots(8, 100 * seed);
        let tree = Tree::build(&light);
        let slow = slow_joins(&light, 1);
        assert_eq!(tree.joins_of(), &slow[..], "{seed}");
    }
}

#[test]
fn tree_conserves_energy_at_every_cut() {
    let black = LightCubemap::black(16);
    let one = even_light(16, |texel| if texel == 700 { [5.0, 1.0, 0.0] } else { [0.0; 3] });
    for light in [black, one, even_light(16, |_| [1.0, 2.0, 3.0]), spots(16, 3)] {
        let tree = Tree::build(&light);
        let total: [f64; 3] = std::array::from_fn(|c| light.flux.iter().map(|flux| f64::from(flux[c])).sum());
        for k in [1, 2, 7, 30, 100, 1536] {
            let cut = tree.cut(k);
            assert_eq!(cut.len(), k);
            for fit in [Fit::Energy, Fit::Area] {
                let squares = tree.squares(&cut, fit);
                for c in 0..3 {
                    let sum: f64 = squares.iter().map(|square| f64::from(square.flux[c])).sum();
                    assert!((sum - total[c]).abs() <= 1e-6 * total[c], "{k} {fit:?}: {sum} {}", total[c]);
                }
                let floats = |square: &super::Square| [square.centre, square.mean_direction, [square.half_side, square.gamma, square.area]];
                assert!(squares.iter().flat_map(floats).flatten().all(|x| x.is_finite()), "{k} {fit:?}");
            }
            let area: f64 = cut.iter().map(|node| tree.moments(*node).area).sum();
            assert!((area - 4.0 * std::f64::consts::PI).abs() < 1e-9);
            let regions = tree.regions(&cut);
            assert!((0..k).all(|region| regions.contains(&(region as u16))));
        }
        assert!(tree.base_cut(30).len() <= 30 && tree.base_cut(1).len() == 1);
    }
}

#[test]
fn one_lit_texel_is_one_square() {
    let n = 64;
    for texel in [0, 2080, 4095, 12_345, 24_575] {
        let light = even_light(n, |t| if t == texel { [3.0, 4.0, 5.0] } else { [0.0; 3] });
        let (face, x, y) = (texel / (n * n), texel % n, texel / n % n);
        let d = texel_unit_direction(n, face, x, y);
        let area = texel_solid_angle(n, x, y) as f32;
        let tree = Tree::build(&light);
        for k in [10, 30] {
            let squares = tree.squares(&tree.cut(k), Fit::Energy);
            let lit: Vec<_> = squares.iter().filter(|square| square.flux[0] > 0.0).collect();
            assert_eq!(lit.len(), 1);
            let cosine: f32 = (0..3).map(|k| d[k] * lit[0].centre[k]).sum();
            assert!(cosine.clamp(-1.0, 1.0).acos() < 0.5 * area.sqrt(), "{texel}");
            assert!((lit[0].solid_angle() / area - 1.0).abs() < 0.2, "{texel}: {} {area}", lit[0].solid_angle());
        }
    }
}

#[test]
fn same_tree_on_any_machine() {
    let digest = |light: &LightCubemap| {
        let joins: Vec<u8> = Tree::build(light).joins_of().iter().flatten().flat_map(|node| node.to_le_bytes()).collect();
        blake3::hash(&joins).to_hex()[..16].to_string()
    };
    let gradient = even_light(16, |texel| [texel as f32; 3]);
    let lights = [LightCubemap::black(16), even_light(16, |_| [1.0; 3]), gradient, spots(16, 1), spots(64, 2)];
    let found: Vec<String> = lights.iter().map(digest).collect();
    assert_eq!(found, ["5106edf55cc4cf35", "1c35cb4f2fc63a25", "90280c7aec50c344", "723234fbca4515a0", "24d7882003c8a235"]);
}

#[test]
fn turned_squares_are_those_of_the_turned_light() {
    // A quarter turn about z takes texels to texels: x → y.
    let (n, rotation) = (16, [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]);
    let light = spots(n, 9);
    let turned = even_light(n, |texel| {
        let d = texel_unit_direction(n, texel / (n * n), texel % n, texel / n % n).map(f64::from);
        let (face, s, t) = crate::sphere::cubemap::face_from_direction([d[1], -d[0], d[2]]);
        let index = |c: f64| ((c + 1.0) * 0.5 * n as f64) as usize;
        let from = (face * n + index(t)) * n + index(s);
        let area = texel_solid_angle(n, index(s), index(t)) as f32;
        light.flux[from].map(|flux| flux / area)
    });
    let key = |square: &super::Square| (square.flux[0].to_bits() >> 8, square.flux[1].to_bits() >> 8);
    let (tree, other) = (Tree::build(&light), Tree::build(&turned));
    let mut squares: Vec<_> = tree.squares(&tree.cut(20), Fit::Energy).iter().map(|square| square.turned(&rotation)).collect();
    let mut expected = other.squares(&other.cut(20), Fit::Energy);
    squares.sort_by_key(key);
    expected.sort_by_key(key);
    for (a, b) in squares.iter().zip(&expected) {
        assert!((0..3).all(|k| (a.centre[k] - b.centre[k]).abs() < 1e-4), "{a:?}\n{b:?}");
    }
}

#[test]
fn luminance_is_that_of_the_channels() {
    let moments = Moments { energy: [1.0, 2.0, 3.0], ..Moments::default() };
    assert_eq!(moments.luminance(), LUMINANCE[0] + 2.0 * LUMINANCE[1] + 3.0 * LUMINANCE[2]);
}

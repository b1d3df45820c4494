//! Updating only what changed in a light against shading it anew.

#[path = "support/occluders.rs"]
mod occluders;

use occluders::{Patch, decibels, sky};
use prelight_runtime::block_product::change::{LightChange, update_diffuse};
use prelight_runtime::block_product::{Light, SimdPath, shade_diffuse_with};
use prelight_runtime::environment::LightCubemap;

/// The sky with a block of texels `gain` times as bright.
fn with_lamp(base: &LightCubemap, block: usize, gain: f32) -> LightCubemap {
    let (n, mut texels) = (base.face_resolution, base.clone());
    let blocks = n / 16;
    let (face, row, column) = (block / (blocks * blocks), block / blocks % blocks, block % blocks);
    for y in 16 * row + 4..16 * row + 7 {
        for x in 16 * column + 5..16 * column + 9 {
            let texel = face * n * n + y * n + x;
            texels.flux[texel] = texels.flux[texel].map(|f| f * gain);
            texels.moment[texel] = texels.moment[texel].map(|m| m.map(|w| w * gain));
        }
    }
    texels
}

fn full(texels: &LightCubemap, patch: &Patch) -> Vec<[[f32; 3]; 3]> {
    let mut out = vec![[[0.0; 3]; 3]; patch.position.len()];
    shade_diffuse_with(SimdPath::Scalar, &Light::prepare(texels), &patch.visibility(), &mut out);
    out
}

fn decibels_of(test: &[[[f32; 3]; 3]], truth: &[[[f32; 3]; 3]]) -> f64 {
    let flat = |v: &[[[f32; 3]; 3]]| v.as_flattened().as_flattened().iter().map(|x| f64::from(*x)).collect::<Vec<_>>();
    decibels(flat(test).into_iter(), flat(truth).into_iter())
}

#[test]
fn an_update_is_a_full_pass_wherever_the_light_changed() {
    for n in [64, 128] {
        let patch = Patch::among_occluders(n, 20, 5);
        let base = sky(n, 1e3);
        for block in [0, 1, 37, 6 * n * n / 256 - 1, 6 * n * n / 512 + 5] {
            let lit = with_lamp(&base, block, 300.0);
            let change = LightChange::between(&base, &lit);
            assert!(change.share() > 0.0 && change.share() < 0.02);
            let (mut got, mut rest) = (full(&base, &patch), vec![[[0.0; 3]; 3]; 20]);
            update_diffuse(&change, &patch.visibility(), &mut got, &mut rest);
            // Both passes round to f32.
            let db = decibels_of(&got, &full(&lit, &patch));
            assert!(db > 115.0, "n {n} block {block}: {db:.1} dB");
        }
        assert_eq!(LightChange::between(&base, &base).share(), 0.0);
        // All blocks at once.
        let dim = LightCubemap { moment: base.moment.iter().map(|m| m.map(|c| c.map(|w| 0.5 * w))).collect(), ..base.clone() };
        let change = LightChange::between(&base, &dim);
        assert!(change.share() > 0.9 && !change.allows(1.0, 1.0));
        let (mut got, mut rest) = (full(&base, &patch), vec![[[0.0; 3]; 3]; 20]);
        update_diffuse(&change, &patch.visibility(), &mut got, &mut rest);
        assert!(decibels_of(&got, &full(&dim, &patch)) > 110.0);
    }
}

/// Errata 3.2: one light flashing 10⁴ times as bright, again and again, must not leave anything behind.
#[test]
fn flashes_leave_no_drift() {
    let patch = Patch::among_occluders(64, 8, 5);
    let base = sky(64, 10.0);
    let lights = [base.clone(), with_lamp(&base, 37, 1e4), with_lamp(&base, 37, 0.3), with_lamp(&base, 40, 700.0)];
    let changes: Vec<LightChange> = (0..4).map(|i| LightChange::between(&lights[i], &lights[(i + 1) % 4])).collect();
    let (mut got, mut rest) = (full(&base, &patch), vec![[[0.0; 3]; 3]; 8]);
    let start = got.clone();
    let visibility = patch.visibility();
    for frame in 0..4000 {
        update_diffuse(&changes[frame % 4], &visibility, &mut got, &mut rest);
    }
    for (got, start) in got.as_flattened().iter().zip(start.as_flattened()) {
        let (off, size) = ((0..3).map(|k| (got[k] - start[k]).abs()).sum::<f32>(), (0..3).map(|k| start[k].abs()).sum::<f32>());
        assert!(off <= 1e-5 * size, "{got:?} {start:?}");
    }
    assert!(LightChange::between(&lights[1], &base).allows(1.0, 0.5) && !LightChange::between(&lights[1], &base).allows(1e4, 1.0));
}

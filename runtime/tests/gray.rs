//! Grayscale visibility: shading with texels open in part against the oracle under a light that is dimmed texel by texel instead.

#[path = "support/occluders.rs"]
mod occluders;

use occluders::{Noise, Patch, decibels, sky, studio};
use prelight_runtime::baseline::pixel_product;
use prelight_runtime::block_product::brdf::PointLobe;
use prelight_runtime::block_product::change::{LightChange, update_diffuse};
use prelight_runtime::block_product::visibility::fractions::Fractions;
use prelight_runtime::block_product::visibility::{STREAM_PADDING, Visibility, block_count, open_words};
use prelight_runtime::block_product::{Accuracy, Glossy, Light, SimdPath, shade_diffuse_with, shade_lobes, shade_moments};
use prelight_runtime::brdf::Lobe;
use prelight_runtime::environment::LightCubemap;
use prelight_runtime::sphere::cubemap::hilbert_from_xy;

const EYE: [f32; 3] = [3.0, 2.0, 4.5];

/// A patch whose texels beside an edge are open in part: levels, row-major per point, and the chunk in words.
struct Gray {
    patch: Patch,
    steps: u32,
    levels: Vec<Vec<u32>>,
    chunk: Vec<u64>,
}

/// What lists of positions by blocks look like, straight from the definition.
fn lists(n: usize, points: &[Vec<usize>], after: &[Vec<u8>]) -> (Vec<u32>, Vec<u32>, Vec<u8>) {
    let (mut start, mut blocks, mut stream) = (vec![0u32], Vec::new(), Vec::new());
    for (positions, after) in points.iter().zip(after) {
        let mut mask = vec![0u32; block_count(n) / 32];
        for block in 0..block_count(n) {
            let count = positions.iter().filter(|p| **p / 256 == block).count();
            if count > 0 {
                mask[block / 32] |= 1 << (block % 32);
                stream.push((count - 1) as u8);
            }
        }
        stream.extend(positions.iter().map(|p| (p % 256) as u8));
        stream.extend(after);
        blocks.extend(mask);
        start.push(stream.len() as u32);
    }
    stream.resize(stream.len() + STREAM_PADDING, 0);
    (start, blocks, stream)
}

impl Gray {
    /// Levels are made up beside edges of the binary patch; the base of a texel in part is whatever chance says, which any chunk may hold.
    fn new(n: usize, points: usize, steps: u32) -> Self {
        let patch = Patch::among_occluders(n, points, 5);
        let mut noise = Noise(u64::from(steps));
        let (mut runs, mut parts, mut corrections, mut levels) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for point in 0..points {
            let open = patch.open_of(point);
            let bit = |texel: usize| open[texel / 64] >> (texel % 64) & 1;
            let mut own: Vec<u32> = (0..6 * n * n).map(|texel| bit(texel) as u32 * steps).collect();
            for texel in 1..6 * n * n {
                if bit(texel) != bit(texel - 1) || noise.next() < 1e-3 {
                    own[texel] = 1 + (noise.next() * f64::from(steps - 1)) as u32 % (steps - 1);
                }
            }
            let mut along = vec![0; 6 * n * n];
            for (texel, level) in own.iter().enumerate() {
                along[texel / (n * n) * n * n + hilbert_from_xy(n, texel % n, texel / n % n)] = *level;
            }
            let (mut last, mut transitions, mut positions, mut bytes) = (false, Vec::new(), Vec::new(), Vec::new());
            for (position, level) in along.iter().enumerate() {
                let in_part = *level != 0 && *level != steps;
                let mut base = if in_part { noise.next() < 0.5 } else { *level == steps };
                if in_part {
                    let correction = |base: bool| *level as i32 - if base { steps as i32 } else { 0 };
                    base ^= i8::try_from(correction(base)).is_err();
                    positions.push(position);
                    bytes.push(correction(base) as i8 as u8);
                }
                if base != last {
                    transitions.push(position);
                    last = base;
                }
            }
            runs.push(transitions);
            parts.push(positions);
            corrections.push(bytes);
            levels.push(own);
        }
        let none = vec![Vec::new(); points];
        let (start, blocks, stream) = lists(n, &runs, &none);
        let (part_start, part_blocks, part_stream) = lists(n, &parts, &corrections);
        let fractions = Fractions { steps, start: &part_start, blocks: &part_blocks, stream: &part_stream };
        let bytes = Visibility::to_gray_chunk(n, &start, &blocks, &stream, &fractions);
        let mut chunk = vec![0u64; bytes.len() / 8];
        bytemuck::cast_slice_mut(&mut chunk).copy_from_slice(&bytes);
        Gray { patch, steps, levels, chunk }
    }

    fn visibility(&self) -> Visibility<'_> {
        Visibility::from_chunk(bytemuck::cast_slice(&self.chunk)).unwrap()
    }

    /// The light as a point sees it.
    fn dimmed(&self, texels: &LightCubemap, point: usize) -> LightCubemap {
        let mut dimmed = texels.clone();
        for (texel, level) in self.levels[point].iter().enumerate() {
            let share = *level as f32 / self.steps as f32;
            dimmed.flux[texel] = dimmed.flux[texel].map(|f| f * share);
            dimmed.moment[texel] = dimmed.moment[texel].map(|m| m.map(|w| w * share));
        }
        dimmed
    }
}

fn flat(out: &[[[f32; 3]; 3]]) -> impl Iterator<Item = f64> {
    out.as_flattened().as_flattened().iter().map(|x| f64::from(*x))
}

#[test]
fn a_chunk_tells_levels_and_the_nearest_bits() {
    for (n, steps) in [(64, 3), (64, 63), (128, 64), (64, 255)] {
        let gray = Gray::new(n, 6, steps);
        let visibility = gray.visibility();
        assert_eq!(visibility.steps(), Some(steps));
        let mut in_part = 0;
        for point in 0..6 {
            let (own, levels) = (visibility.point(point), &gray.levels[point]);
            let mut bits = vec![0; open_words(n)];
            own.to_open_bits(n, &mut bits);
            for (texel, level) in levels.iter().enumerate() {
                assert_eq!(bits[texel / 64] >> (texel % 64) & 1 == 1, 2 * level >= steps, "texel {texel}");
            }
            let mut seen = 0;
            own.for_each_fraction(|position, base, correction| {
                let level = if base { steps as i32 } else { 0 } + i32::from(correction);
                assert!((1..steps as i32).contains(&level), "position {position}");
                seen += 1;
            });
            assert_eq!(seen, levels.iter().filter(|level| **level != 0 && **level != steps).count());
            assert!(seen > 0 && !own.is_blind());
            in_part += seen;
        }
        assert!(in_part > 100, "{in_part} texels in part");
    }
}

#[test]
fn diffuse_light_is_that_of_a_light_dimmed_texel_by_texel() {
    for (n, steps) in [(64, 3), (64, 63), (64, 255), (128, 63)] {
        let gray = Gray::new(n, 12, steps);
        let texels = sky(n, 1e3);
        let light = Light::prepare(&texels);
        let everything = vec![u64::MAX; open_words(n)];
        let truth: Vec<[[f64; 3]; 3]> = (0..12).map(|point| pixel_product::diffuse(&gray.dimmed(&texels, point), &everything)).collect();
        let (mut first, mut second) = (vec![[[0.0; 3]; 3]; 12], vec![[0.0; 6]; 12]);
        shade_moments(SimdPath::Scalar, &light, &gray.visibility(), &mut first, &mut second);
        let db = decibels(flat(&first), truth.iter().flatten().flatten().copied());
        // As binary visibility: differences of f32 suffix sums.
        assert!(db > 100.0, "n {n}, {steps} steps: {db:.1} dB");
        for path in SimdPath::all_available() {
            let (mut out, mut moments) = (vec![[[0.0; 3]; 3]; 12], vec![[0.0; 6]; 12]);
            shade_moments(path, &light, &gray.visibility(), &mut out, &mut moments);
            assert_eq!((&out, &moments), (&first, &second), "{path:?} gives the scalar path's bits");
        }
        for (point, second) in second.iter().enumerate() {
            let dimmed = gray.dimmed(&texels, point);
            let fluence: f64 = dimmed.flux.as_flattened().iter().map(|flux| f64::from(*flux)).sum();
            let got: f64 = second[..3].iter().map(|moment| f64::from(*moment)).sum();
            // A trace is the fluence: what is left of all light after differences of suffixes.
            assert!((got - fluence).abs() < 1e-4 * fluence + 1e-2, "n {n}, {steps} steps: {got} {fluence}");
        }
    }
}

#[test]
fn points_with_thousands_of_texels_in_part_are_summed_in_pieces() {
    // Every second texel in part: more than any piece holds.
    let (n, steps) = (64, 15);
    let mut gray = Gray::new(n, 1, steps);
    let positions: Vec<usize> = (0..6 * n * n).step_by(2).collect();
    let bytes: Vec<u8> = positions.iter().map(|p| (1 + p % 14) as u8).collect();
    let (start, blocks, stream) = lists(n, &[Vec::new()], &[Vec::new()]);
    let (part_start, part_blocks, part_stream) = lists(n, std::slice::from_ref(&positions), std::slice::from_ref(&bytes));
    let fractions = Fractions { steps, start: &part_start, blocks: &part_blocks, stream: &part_stream };
    let chunk = Visibility::to_gray_chunk(n, &start, &blocks, &stream, &fractions);
    gray.chunk = vec![0; chunk.len() / 8];
    bytemuck::cast_slice_mut(&mut gray.chunk).copy_from_slice(&chunk);
    let light = Light::prepare(&sky(n, 10.0));
    let mut first = [[[0.0; 3]; 3]];
    shade_diffuse_with(SimdPath::Scalar, &light, &gray.visibility(), &mut first);
    assert!(first[0][1][1] > 0.1);
    for path in SimdPath::all_available() {
        let mut out = [[[0.0; 3]; 3]];
        shade_diffuse_with(path, &light, &gray.visibility(), &mut out);
        assert_eq!(out, first, "{path:?}");
    }
}

#[test]
fn glossy_light_is_that_of_a_light_dimmed_texel_by_texel() {
    let n = 64;
    for (name, texels) in [("sky", sky(n, 5e3)), ("studio", studio(n))] {
        let gray = Gray::new(n, 10, 63);
        let light = Light::prepare(&texels);
        let everything = vec![u64::MAX; open_words(n)];
        for lobe in [Lobe::Phong { exponent: 50.0 }, Lobe::Ggx { alpha: [0.16; 2] }, Lobe::Ward { alpha: [0.1, 0.3] }] {
            let point = |i: usize| PointLobe { lobe, normal: gray.patch.normal[i], tangent: [0.8, 0.0, 0.6] };
            let toward = |i: usize| {
                let d: [f32; 3] = std::array::from_fn(|k| EYE[k] - gray.patch.position[i][k]);
                let length = d.iter().map(|x| x * x).sum::<f32>().sqrt();
                d.map(|x| x / length)
            };
            let truth: Vec<[[f64; 3]; 2]> =
                (0..10).map(|i| pixel_product::lobe(&gray.dimmed(&texels, i), &everything, &point(i), toward(i))).collect();
            for (path, relative, least) in SimdPath::all_available().into_iter().flat_map(|path| [(path, 0.0, 90.0), (path, 1e-3, 50.0)]) {
                let mut out = vec![Glossy::default(); 10];
                let accuracy = Accuracy { relative, floor: 1e-2 };
                shade_lobes(path, accuracy, &light, &gray.patch.position, point, &gray.visibility(), EYE, &mut out);
                let test = out.as_flattened().as_flattened().iter().map(|x| f64::from(*x));
                let db = decibels(test, truth.as_flattened().as_flattened().iter().copied());
                assert!(db > least, "{name}, {lobe:?}, {path:?}, relative {relative}: {db:.1} dB");
            }
        }
    }
}

#[test]
fn a_change_of_light_updates_texels_in_part() {
    let n = 64;
    let gray = Gray::new(n, 16, 63);
    let base = sky(n, 100.0);
    let mut lit = base.clone();
    for texel in (n * n..n * n + 5 * n).chain(2 * n * n + 20 * n..2 * n * n + 30 * n) {
        lit.flux[texel] = lit.flux[texel].map(|f| 3.0 * f);
        lit.moment[texel] = lit.moment[texel].map(|m| m.map(|w| 3.0 * w));
    }
    let full = |texels: &LightCubemap| {
        let mut out = vec![[[0.0; 3]; 3]; 16];
        shade_diffuse_with(SimdPath::Scalar, &Light::prepare(texels), &gray.visibility(), &mut out);
        out
    };
    let change = LightChange::between(&base, &lit);
    let (mut got, mut rest) = (full(&base), vec![[[0.0; 3]; 3]; 16]);
    update_diffuse(&change, &gray.visibility(), &mut got, &mut rest);
    let db = decibels(flat(&got), flat(&full(&lit)));
    assert!(db > 110.0, "{db:.1} dB");
    assert!(decibels(flat(&got), flat(&full(&base))) < 60.0, "the change must be seen");
}

/// One lit texel, a straight edge drawn across it point by point: irradiance falls step by step, where binary visibility has one jump.
#[test]
fn one_lit_texel_shows_a_smooth_shadow_edge() {
    let (n, steps, points) = (64, 63, 64);
    let texel = 2 * n * n + 33 * n + 40;
    let mut texels = LightCubemap { face_resolution: n, flux: vec![[0.0; 3]; 6 * n * n], moment: vec![[[0.0; 3]; 3]; 6 * n * n] };
    texels.flux[texel] = [1.0; 3];
    texels.moment[texel] = [[0.1, 0.9, 0.1]; 3];
    let position = texel / (n * n) * n * n + hilbert_from_xy(n, texel % n, texel / n % n);
    // Point i sees i/63 of the texel, and nothing else.
    let parts: Vec<Vec<usize>> = (0..points).map(|i| if i % steps == 0 { vec![] } else { vec![position] }).collect();
    let bytes: Vec<Vec<u8>> = (0..points).map(|i| if i % steps == 0 { vec![] } else { vec![i as u8] }).collect();
    let runs: Vec<Vec<usize>> = (0..points).map(|i| if i == steps { vec![position, position + 1] } else { vec![] }).collect();
    let (start, blocks, stream) = lists(n, &runs, &vec![Vec::new(); points]);
    let (part_start, part_blocks, part_stream) = lists(n, &parts, &bytes);
    let fractions = Fractions { steps: steps as u32, start: &part_start, blocks: &part_blocks, stream: &part_stream };
    let chunk = Visibility::to_gray_chunk(n, &start, &blocks, &stream, &fractions);
    let mut words = vec![0u64; chunk.len() / 8];
    bytemuck::cast_slice_mut(&mut words).copy_from_slice(&chunk);
    let visibility = Visibility::from_chunk(bytemuck::cast_slice(&words)).unwrap();
    let mut out = vec![[[0.0; 3]; 3]; points];
    shade_diffuse_with(SimdPath::detect(), &Light::prepare(&texels), &visibility, &mut out);
    for (i, irradiance) in out.iter().enumerate() {
        let expected = 0.9 * i as f32 / steps as f32;
        assert!((irradiance[1][1] - expected).abs() < 1e-6, "point {i}: {} {expected}", irradiance[1][1]);
        assert_eq!(visibility.point(i).is_blind(), i == 0);
    }
}

#[test]
fn corrections_that_lead_out_of_a_texel_are_refused() {
    let n = 64;
    let chunk = |steps: u32, run: &[usize], correction: i8| {
        let (start, blocks, stream) = lists(n, &[run.to_vec()], &[Vec::new()]);
        let (part_start, part_blocks, part_stream) = lists(n, &[vec![300]], &[vec![correction as u8]]);
        let fractions = Fractions { steps, start: &part_start, blocks: &part_blocks, stream: &part_stream };
        let bytes = Visibility::to_gray_chunk(n, &start, &blocks, &stream, &fractions);
        let mut words = vec![0u64; bytes.len() / 8];
        bytemuck::cast_slice_mut(&mut words).copy_from_slice(&bytes);
        words
    };
    let is_read = |words: &[u64]| Visibility::from_chunk(bytemuck::cast_slice(words)).is_ok();
    for steps in [3, 15, 63, 64, 255] {
        let most = (steps - 1).min(127) as i8;
        assert!(is_read(&chunk(steps, &[], most)) && is_read(&chunk(steps, &[256, 400], -most)));
        assert!(!is_read(&chunk(steps, &[], -1)) && !is_read(&chunk(steps, &[], 0)) && !is_read(&chunk(steps, &[256, 400], 1)));
        if steps < 100 {
            assert!(!is_read(&chunk(steps, &[], steps as i8)) && !is_read(&chunk(steps, &[256, 400], -(steps as i8))));
        }
    }
    assert!(!is_read(&chunk(7, &[], 1)), "seven steps are none of the quantisations");
}

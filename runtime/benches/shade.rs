//! Shading against the dense products it replaces: `cargo bench -p prelight-runtime --bench shade`.
//!
//! Thread CPU time, methods interleaved round by round, medians. (Criterion measures one method after the other in wall time, which a
//! busy machine turns into noise; hence a table of our own.) Every row stands beside its distance from the f64 oracle; a row that is wrong
//! fails the bench.

#[path = "../tests/support/occluders.rs"]
mod occluders;

use occluders::{Patch, decibels, sky};
use prelight_runtime::asset::surface::PointSurfaces;
use prelight_runtime::baseline::dense::{self, PixelLight};
use prelight_runtime::baseline::pixel_product;
use prelight_runtime::block_product::change::{LightChange, update_diffuse};
use prelight_runtime::block_product::visibility::{Visibility, block_count};
use prelight_runtime::block_product::{GLOSSY_TOLERANCE, Light, SimdPath, shade_diffuse_with, shade_glossy_with};
use prelight_runtime::environment::LightCubemap;
use std::hint::black_box;

const PATCHES: usize = 4;
const POINTS: usize = 256;
const ROUNDS: usize = 9;
const EYE: [f32; 3] = [3.0, 2.0, 4.5];

fn thread_nanoseconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 * 1e9 + time.tv_nsec as f64
}

/// A method: its name, decibels from the oracle, points per run, and the run.
struct Method<'a> {
    name: String,
    decibels: f64,
    points: usize,
    run: Box<dyn FnMut() + 'a>,
    nanoseconds: Vec<f64>,
}

impl Method<'_> {
    fn median(&self) -> f64 {
        let mut sorted = self.nanoseconds.clone();
        sorted.sort_by(f64::total_cmp);
        sorted[sorted.len() / 2]
    }
}

fn main() {
    let n = 64;
    let quick = std::env::args().any(|argument| argument == "--test");
    let patches: Vec<Patch> = (0..PATCHES).map(|seed| Patch::among_occluders(n, POINTS, 3 + seed as u64)).collect();
    let visibilities: Vec<Visibility> = patches.iter().map(Patch::visibility).collect();
    let cubemap = sky(n, 5e4);
    let (light, pixels) = (Light::prepare(&cubemap), PixelLight::new(&cubemap));
    statistics(n, &patches);

    let vectors: Vec<Vec<[[f64; 3]; 3]>> =
        patches.iter().map(|patch| (0..POINTS).map(|point| pixel_product::diffuse(&cubemap, patch.open_of(point))).collect()).collect();
    let at_normal = |patch: usize, point: usize| {
        let normal = patches[patch].normal[point].map(f64::from);
        vectors[patch][point].map(|e| e[0] * normal[0] + e[1] * normal[1] + e[2] * normal[2])
    };
    let truth: Vec<f64> = (0..POINTS).flat_map(|point| at_normal(0, point)).collect();
    let vector_truth: Vec<f64> = vectors[0].iter().flatten().flatten().copied().collect();
    let flat = |out: &[[f32; 3]]| out.as_flattened().iter().map(|x| f64::from(*x)).collect::<Vec<_>>();
    let compare = |test: &[[f32; 3]], truth: &[f64]| decibels(flat(test).into_iter(), truth[..3 * test.len()].iter().copied());

    let lit = with_lamp(&cubemap);
    let change = LightChange::between(&cubemap, &lit);
    let mut methods: Vec<Method> = Vec::new();
    let mut add = |name: String, decibels: f64, points: usize, run: Box<dyn FnMut()>| {
        methods.push(Method { name, decibels, points, run, nanoseconds: Vec::new() });
    };
    let mut out = vec![[0.0f32; 3]; POINTS];
    let few = 8;
    let words = patches[0].open.len() / POINTS;
    dense::irradiance_scalar(&pixels, &patches[0].open[..few * words], &patches[0].normal, &mut out[..few]);
    let db = compare(&out[..few], &truth);
    let (patch, pixels, light) = (&patches[0], &pixels, &light);
    add("dense, scalar".into(), db, few, {
        let mut out = vec![[0.0; 3]; few];
        Box::new(move || dense::irradiance_scalar(pixels, &patch.open[..few * words], &patch.normal, black_box(&mut out)))
    });
    for path in [SimdPath::Avx2, SimdPath::Avx512].into_iter().filter(|path| path.available() == *path) {
        dense::irradiance_tiled(path, pixels, &patch.open, &patch.normal, &mut out);
        add(format!("dense, tiled, {path:?}"), compare(&out, &truth), POINTS, {
            let mut out = vec![[0.0; 3]; POINTS];
            Box::new(move || dense::irradiance_tiled(path, pixels, &patch.open, &patch.normal, black_box(&mut out)))
        });
        let mut vectors = vec![[[0.0f32; 3]; 3]; POINTS];
        dense::vector_tiled(path, pixels, &patch.open, &mut vectors);
        add(format!("dense, tiled, vector, {path:?}"), compare(vectors.as_flattened(), &vector_truth), POINTS, {
            let mut out = vec![[[0.0; 3]; 3]; POINTS];
            Box::new(move || dense::vector_tiled(path, pixels, &patch.open, black_box(&mut out)))
        });
        dense::irradiance_sparse(path, pixels, &patch.open, &patch.normal, &mut out);
        add(format!("sparse, {path:?}"), compare(&out, &truth), POINTS, {
            let mut out = vec![[0.0; 3]; POINTS];
            Box::new(move || dense::irradiance_sparse(path, pixels, &patch.open, &patch.normal, black_box(&mut out)))
        });
    }
    let visibilities = &visibilities;
    for path in SimdPath::all_available() {
        let mut vectors = vec![[[0.0f32; 3]; 3]; POINTS];
        shade_diffuse_with(path, light, &visibilities[0], &mut vectors);
        add(format!("exact diffuse, {path:?}"), compare(vectors.as_flattened(), &vector_truth), PATCHES * POINTS, {
            let mut out = vec![[[0.0; 3]; 3]; POINTS];
            Box::new(move || {
                visibilities.iter().for_each(|visibility| shade_diffuse_with(path, light, visibility, black_box(&mut out)));
            })
        });
    }
    let lit_truth: Vec<f64> =
        (0..POINTS).flat_map(|point| pixel_product::diffuse(&lit, patches[0].open_of(point)).into_iter().flatten()).collect();
    let (mut vectors, mut rest) = (vec![[[0.0f32; 3]; 3]; POINTS], vec![[[0.0; 3]; 3]; POINTS]);
    shade_diffuse_with(SimdPath::detect(), light, &visibilities[0], &mut vectors);
    update_diffuse(&change, &visibilities[0], &mut vectors, &mut rest);
    let db = compare(vectors.as_flattened(), &lit_truth);
    add(format!("exact diffuse, light change in {:.1} % of blocks", 100.0 * change.share()), db, PATCHES * POINTS, {
        let change = &change;
        Box::new(move || visibilities.iter().for_each(|visibility| update_diffuse(change, visibility, black_box(&mut vectors), &mut rest)))
    });
    for (roughness, path) in
        [0.0f32, 0.2, 0.4, 0.7, 1.0].into_iter().flat_map(|r| SimdPath::all_available().into_iter().map(move |p| (r, p)))
    {
        let roughnesses = vec![roughness; POINTS];
        let truth: Vec<f64> = (0..POINTS)
            .step_by(8)
            .flat_map(|i| {
                let toward: [f64; 3] = std::array::from_fn(|k| f64::from(EYE[k] - patch.position[i][k]));
                let length = toward.iter().map(|x| x * x).sum::<f64>().sqrt();
                let v = toward.map(|x| (x / length) as f32);
                pixel_product::glossy(&cubemap, patch.open_of(i), patch.normal[i], v, roughness).into_iter().flatten()
            })
            .collect();
        let mut out = vec![[[0.0f32; 3]; 2]; POINTS];
        let surfaces = PointSurfaces { normal: &patch.normal, roughness: &roughnesses, metallic: &[], material: &[] };
        shade_glossy_with(path, GLOSSY_TOLERANCE, light, &patch.position, &surfaces, &visibilities[0], EYE, &mut out);
        let some: Vec<[[f32; 3]; 2]> = out.iter().step_by(8).copied().collect();
        add(format!("glossy, roughness {roughness}, {path:?}"), compare(some.as_flattened(), &truth), POINTS, {
            let mut out = vec![[[0.0; 3]; 2]; POINTS];
            Box::new(move || {
                let surfaces = PointSurfaces { normal: &patch.normal, roughness: &roughnesses, metallic: &[], material: &[] };
                shade_glossy_with(path, GLOSSY_TOLERANCE, light, &patch.position, &surfaces, &visibilities[0], EYE, black_box(&mut out));
            })
        });
    }

    // A word on the command line picks the methods that hold it, for profiling.
    if let Some(word) = std::env::args().skip(1).find(|argument| !argument.starts_with("--")) {
        methods.retain(|method| method.name.contains(&word));
    }
    for round in 0..if quick { 1 } else { ROUNDS } {
        for method in &mut methods {
            (method.run)();
            let before = thread_nanoseconds();
            (method.run)();
            let spent = thread_nanoseconds() - before;
            if round > 0 || quick {
                method.nanoseconds.push(spent / method.points as f64);
            }
        }
    }
    let median = |name: &str| methods.iter().find(|method| method.name == name).map_or(f64::NAN, Method::median);
    println!("{:<40} {:>10} {:>12} {:>12} {:>8}", "method", "ns/point", "x Avx2 tiled", "x Avx512", "dB");
    for method in &methods {
        let ns = method.median();
        let best = |path: &str| median(&format!("dense, tiled, {path}")).min(median(&format!("dense, tiled, vector, {path}")));
        let (avx2, avx512) = (best("Avx2") / ns, best("Avx512") / ns);
        println!("{:<40} {ns:>10.0} {avx2:>12.1} {avx512:>12.1} {:>8.1}", method.name, method.decibels);
    }
    // Far below what these fixed scenes give: a guard against a wrong answer, not a statement of accuracy.
    for method in &methods {
        let mark = if method.name.starts_with("glossy") { 50.0 } else { 100.0 };
        assert!(method.decibels >= mark, "{}: {:.1} dB", method.name, method.decibels);
    }
}

/// The sky with four blocks overhead, side by side, thirty times as bright.
fn with_lamp(base: &LightCubemap) -> LightCubemap {
    let (n, mut texels) = (base.face_resolution, base.clone());
    for (y, x) in (16..48).flat_map(|y| (16..48).map(move |x| (y, x))) {
        let texel = 2 * n * n + y * n + x;
        texels.flux[texel] = texels.flux[texel].map(|flux| 30.0 * flux);
        texels.moment[texel] = texels.moment[texel].map(|moment| moment.map(|w| 30.0 * w));
    }
    texels
}

/// What a point sees, and its bytes: the figures that decide all times.
fn statistics(n: usize, patches: &[Patch]) {
    let (mut full, mut partial, mut transitions, mut points, mut bytes) = (0, 0, 0, 0, 0);
    for patch in patches {
        bytes += patch.chunk_bytes();
        for point in 0..patch.position.len() {
            points += 1;
            transitions += patch.visibility().point(point).transitions();
            let mut open = vec![0usize; block_count(n)];
            let face_blocks = n * n / 256;
            for (texel, block) in (0..6 * n * n).map(|t| (t, t / (n * n) * face_blocks + t / n % n / 16 * (n / 16) + t % n / 16)) {
                open[block] += (patch.open_of(point)[texel / 64] >> (texel % 64) & 1) as usize;
            }
            full += open.iter().filter(|count| **count == 256).count();
            partial += open.iter().filter(|count| **count > 0 && **count < 256).count();
        }
    }
    let per_point = |sum: usize| sum as f64 / points as f64;
    println!(
        "{points} points of {n}²: {:.1} full and {:.1} partial blocks, {:.0} transitions, {:.0} bytes a point",
        per_point(full),
        per_point(partial),
        per_point(transitions),
        per_point(bytes)
    );
}

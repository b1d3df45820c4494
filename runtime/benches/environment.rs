//! Splat of an environment into a cubemap: milliseconds per image, on one thread and on all; and of filtering the cubemap for lobes, all levels
//! (mark: a 1k image in 0.5 s and 64 MB).

use criterion::{Criterion, criterion_group, criterion_main};
use prelight_runtime::environment::{Environment, LightCubemap, Splatter};
use prelight_runtime::vmf_transfer::FilteredLight;

fn splat(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("splat");
    group.sample_size(20);
    for (width, height, n) in [(1024, 512, 64), (1024, 512, 128), (4096, 2048, 64), (64, 32, 64)] {
        let pixels = (0..width * height).map(|i| [1.0 + (i % 7) as f32, (i % 11) as f32, (i % 3) as f32]).collect();
        let environment = Environment::new(width, height, pixels).with_rotation(30.0);
        let (mut splatter, mut light) = (Splatter::new(n), LightCubemap::black(n));
        let report = light.update_from(&environment, &mut splatter);
        assert!(report.relative_loss() < 1e-6, "the splat must keep energy");
        group.bench_function(format!("{width}x{height} to {n}"), |bencher| {
            bencher.iter(|| light.update_from(&environment, &mut splatter));
        });
    }
}

fn filter(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("filter");
    group.sample_size(10);
    for n in [64, 128] {
        let (width, height) = (1024, 512);
        let pixels = (0..width * height).map(|i| [1.0 + (i % 7) as f32, (i % 11) as f32, (i % 3) as f32]).collect();
        let environment = Environment::new(width, height, pixels);
        let light = LightCubemap::from_environment(&environment, n);
        let filtered = FilteredLight::prepare(&light);
        let mean: f64 = light.flux.iter().map(|flux| f64::from(flux[0])).sum::<f64>() / (4.0 * std::f64::consts::PI);
        let got = f64::from(filtered.lookup([0.6, 0.0, 0.8], 8.0)[0]);
        assert!((got / mean - 1.0).abs() < 0.05 && filtered.bytes() <= 64 << 20, "{got} {mean} {}", filtered.bytes());
        println!("{n}: {:.1} MB", filtered.bytes() as f64 / 1e6);
        group.bench_function(format!("1024x512 at {n}"), |bencher| bencher.iter(|| FilteredLight::prepare(&light)));
    }
}

criterion_group!(benches, splat, filter);
criterion_main!(benches);

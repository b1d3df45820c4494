//! Splat of an environment into a cubemap: milliseconds per image, on one thread and on all.

use criterion::{Criterion, criterion_group, criterion_main};
use prelight_runtime::environment::{Environment, LightCubemap, Splatter};

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

criterion_group!(benches, splat);
criterion_main!(benches);

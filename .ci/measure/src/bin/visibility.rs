//! What visibility costs in baked assets: `cargo run --release -p prelight-measure --bin visibility -- binary.prelight.json gray.prelight.json ...`.
//!
//! Bytes in memory, transitions and texels open in part per point that sees anything, and exact diffuse light per such point in thread CPU
//! time: assets interleaved round by round, medians.

use prelight_runtime::asset::Asset;
use prelight_runtime::block_product::{Light, SimdPath, shade_diffuse};
use prelight_runtime::environment::LightCubemap;
use prelight_runtime::sphere::cubemap::{texel_solid_angle, texel_unit_direction};
use std::hint::black_box;
use std::path::PathBuf;

const ROUNDS: usize = 7;

fn thread_nanoseconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 * 1e9 + time.tv_nsec as f64
}

/// A sky that is brighter above.
fn sky(n: usize) -> LightCubemap {
    let mut texels = LightCubemap { face_resolution: n, flux: Vec::new(), moment: Vec::new() };
    for texel in 0..6 * n * n {
        let (x, y) = (texel % n, texel / n % n);
        let d = texel_unit_direction(n, texel / (n * n), x, y);
        let flux = [1.0, 1.2, 1.5].map(|l: f64| (l * (1.2 + f64::from(d[1])) * texel_solid_angle(n, x, y)) as f32);
        texels.flux.push(flux);
        texels.moment.push(flux.map(|f| d.map(|w| f * w)));
    }
    texels
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let paths: Vec<PathBuf> = std::env::args().skip(1).map(PathBuf::from).collect();
    let assets: Vec<Asset> = paths.iter().map(|path| Asset::open_file(path, None)).collect::<Result<_, _>>()?;
    let lights: Vec<Light> = assets.iter().map(|asset| Light::prepare(&sky(asset.manifest().content.face_resolution as usize))).collect();
    println!("{:?}", SimdPath::detect());
    println!("{:<40}{:>9}{:>9}{:>13}{:>13}{:>10}{:>10}", "asset", "points", "seeing", "bytes/point", "transitions", "in part", "ns/point");
    let mut rows = Vec::new();
    for asset in &assets {
        let (mut bytes, mut points, mut seeing, mut transitions, mut parts) = (0, 0, 0, 0, 0);
        for patch in asset.patches() {
            let visibility = patch.visibility();
            points += visibility.len();
            for point in (0..visibility.len()).map(|point| visibility.point(point)) {
                let own = point.fractions.map_or(0, |parts| parts.len());
                transitions += point.transitions();
                parts += own;
                seeing += usize::from(!point.is_blind());
                bytes += 4 + size_of_val(point.blocks) + point.counts.len() + point.transitions();
                bytes += point.fractions.map_or(0, |parts| 4 + size_of_val(parts.blocks) + parts.counts.len() + 2 * own);
            }
        }
        rows.push((points, seeing, bytes, transitions, parts));
    }
    let mut times = vec![Vec::new(); assets.len()];
    let mut out = vec![[[0.0; 3]; 3]; 256];
    for _ in 0..ROUNDS {
        for ((asset, light), times) in assets.iter().zip(&lights).zip(&mut times) {
            let visible: Vec<_> = asset.patches().iter().map(|patch| patch.visibility()).collect();
            let before = thread_nanoseconds();
            for visibility in &visible {
                shade_diffuse(light, visibility, black_box(&mut out[..visibility.len()]));
            }
            times.push(thread_nanoseconds() - before);
        }
    }
    for ((path, times), (points, seeing, bytes, transitions, parts)) in paths.iter().zip(&mut times).zip(rows) {
        times.sort_by(f64::total_cmp);
        let each = |sum: usize| sum as f64 / seeing.max(1) as f64;
        println!(
            "{:<40}{points:>9}{seeing:>9}{:>13.1}{:>13.1}{:>10.1}{:>10.1}",
            path.display(),
            each(bytes),
            each(transitions),
            each(parts),
            times[ROUNDS / 2] / seeing.max(1) as f64
        );
    }
    Ok(())
}

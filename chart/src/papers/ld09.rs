//! The tables and figures of \[LD09\], from an asset whose indirect light was baked as lobes.
//!
//! | here | there |
//! |---|---|
//! | points before and after refinement, seconds of the bake | Table 1 |
//! | bytes of lobes, frames a second | Table 2 |
//! | [`mesh_svg`]: the refined mesh as the camera sees it | Fig. 1, 7 |
//! | [`level_svg`]: the levels of its points' views | Fig. 8 |
//! | [`super::uniform`]: points that a uniform mesh of equal error needs | the count of section 7 |
//! | error of the picture with lobes and without, against paths of as many bounces | Fig. 9 |
//!
//! A frame is shading of what the view shows, for an eye that moved under a light that did not, and drawing; on the CPU, where the paper
//! had a GPU: hold rows against one another, not against print.

use prelight_manifests::ChunkKind;
use prelight_runtime::asset::Asset;
use prelight_runtime::draw::camera::{Camera, CameraRays};
use prelight_runtime::sphere::icosahedron::{Icosahedron, MAX_LEVEL};
use serde::{Deserialize, Serialize};
use std::fmt::Write;

/// What lobes take.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LobeSizes {
    /// Points of the asset.
    pub points: u64,
    /// Those with slices on each level of the icosahedron; the last count is of points without.
    pub levels: Vec<u64>,
    /// Directions of view that points have slices for, kept or left to their neighbours.
    pub directions: u64,
    /// Lobes stored.
    pub lobes: u64,
    /// Plain bytes of the transfer chunks.
    pub bytes: u64,
}

/// One view under one light.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GlossyRow {
    /// Environment.
    pub environment: String,
    /// View.
    pub view: String,
    /// Relative L2 of the direct picture, against the reference with bounces.
    pub direct_relative_l2: Option<f64>,
    /// With indirect light.
    pub relative_l2: Option<f64>,
    /// Free of the reference's noise, where that can be told.
    pub unbiased_relative_l2: Option<f64>,
    /// Relative L2 of indirect light alone: picture less direct picture, against paths less direct paths; free of their noise.
    pub indirect_relative_l2: Option<f64>,
    /// L2 of indirect light over that of the whole, in the references.
    pub indirect_share: Option<f64>,
    /// With indirect light.
    pub psnr_db: Option<f64>,
    /// Seconds of a frame.
    pub frame_seconds: f64,
}

/// Counts the lobes of an asset.
pub fn lobe_sizes(asset: &Asset) -> LobeSizes {
    let solid = Icosahedron::new(MAX_LEVEL);
    let mut sizes = LobeSizes { points: asset.n_points() as u64, levels: vec![0; MAX_LEVEL + 2], ..LobeSizes::default() };
    for patch in asset.patches() {
        let Some(transfer) = patch.transfer() else {
            sizes.levels[MAX_LEVEL + 1] += patch.points.len() as u64;
            continue;
        };
        for i in 0..transfer.len() {
            let point = transfer.point(i);
            sizes.levels[point.level.unwrap_or(MAX_LEVEL + 1)] += 1;
            sizes.directions += point.level.map_or(0, |level| solid.stored(level).len() as u64);
            sizes.lobes += point.n_records() as u64;
        }
    }
    let chunks =
        asset.manifest().content.objects.iter().flat_map(|object| &object.patches).filter_map(|patch| patch.factor(ChunkKind::Transfer));
    sizes.bytes = chunks.map(|descriptor| descriptor.bytes).sum();
    sizes
}

/// Level of every point's views, `None` without slices.
fn levels(asset: &Asset) -> Vec<Option<usize>> {
    let of = |patch: &prelight_runtime::asset::AssetPatch| -> Vec<Option<usize>> {
        match patch.transfer() {
            Some(transfer) => (0..transfer.len()).map(|i| transfer.point(i).level).collect(),
            None => vec![None; patch.points.len()],
        }
    };
    asset.patches().iter().flat_map(of).collect()
}

/// Fills, coarse to fine; the last is for points without slices.
const FILLS: [&str; MAX_LEVEL + 2] = ["#d8e6f3", "#a9cbe6", "#6d9ec9", "#e8c268", "#e0803d", "#b8332a", "#f2f2f2"];

/// The mesh as a camera sees it.
pub fn mesh_svg(asset: &Asset, camera: &Camera, size: [usize; 2]) -> Option<String> {
    Some(svg(&shapes(asset, camera, size)?, size, &|_| "#ffffff", "#203040"))
}

/// The levels of views of its points as a camera sees them: a triangle has the finest of its corners.
pub fn level_svg(asset: &Asset, camera: &Camera, size: [usize; 2]) -> Option<String> {
    let mut out = svg(&shapes(asset, camera, size)?, size, &|level| FILLS[level], "#00000060");
    out.truncate(out.len() - "</svg>\n".len());
    for (level, fill) in FILLS.iter().enumerate() {
        let (y, name) = (8 + 14 * level, if level > MAX_LEVEL { "no slices".to_string() } else { format!("level {level}") });
        let _ = writeln!(out, "<rect x=\"6\" y=\"{y}\" width=\"10\" height=\"10\" fill=\"{fill}\" stroke=\"#888888\"/>");
        let _ = writeln!(out, "<text x=\"20\" y=\"{}\">{name}</text>", y + 9);
    }
    Some(out + "</svg>\n")
}

/// A triangle that faces the camera, in pixels.
struct Shape {
    /// Sum of its corners' depths.
    depth: f64,
    /// Finest level of its corners' views, [`MAX_LEVEL`] + 1 without slices.
    level: usize,
    corners: [[f64; 2]; 3],
}

/// What a camera sees, nearest last.
fn shapes(asset: &Asset, camera: &Camera, size: [usize; 2]) -> Option<Vec<Shape>> {
    let rays = CameraRays::new(camera, size[0], size[1]).ok()?;
    let levels = levels(asset);
    let mut shapes = Vec::new();
    for (index, object) in asset.objects().iter().enumerate() {
        let mesh = asset.mesh(index);
        for triangle in mesh.triangles {
            let corners = triangle.map(|v| rays.homogeneous(mesh.position[v as usize]));
            // Not clipped: a triangle that reaches behind the camera is left out.
            if corners.iter().any(|c| c[2] <= 1e-6) {
                continue;
            }
            let flat = corners.map(|c| [c[0] / c[2], c[1] / c[2]]);
            let [a, b, c] = flat;
            let outside = (0..2).any(|k| flat.iter().all(|p| p[k] < 0.0) || flat.iter().all(|p| p[k] > size[k] as f64));
            // Pixels run down, so what winds counter-clockwise seen from the front has a negative area.
            let is_front = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) < 0.0;
            // A vertex of a coarser mesh has up to four points.
            let lit = triangle.map(|v| if is_front { mesh.front(v as usize) } else { mesh.back(v as usize) });
            let points: Vec<u32> = lit.iter().flat_map(|lit| lit.shares()).filter(|share| share.1 > 0.0).map(|share| share.0).collect();
            if outside || (!is_front && points.is_empty()) {
                continue;
            }
            let level = points.iter().filter_map(|point| levels[object.points.start + *point as usize]).max().unwrap_or(MAX_LEVEL + 1);
            shapes.push(Shape { depth: corners.iter().map(|c| c[2]).sum(), level, corners: flat });
        }
    }
    shapes.sort_by(|a, b| b.depth.total_cmp(&a.depth));
    Some(shapes)
}

fn svg(shapes: &[Shape], [width, height]: [usize; 2], fill: &dyn Fn(usize) -> &'static str, stroke: &str) -> String {
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" font-size=\"11\">\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"#ffffff\"/>\n<g stroke=\"{stroke}\" stroke-width=\"0.3\">\n"
    );
    for Shape { level, corners: [a, b, c], .. } in shapes {
        let _ = writeln!(
            out,
            "<path fill=\"{}\" d=\"M{:.1} {:.1}L{:.1} {:.1}L{:.1} {:.1}Z\"/>",
            fill(*level),
            a[0],
            a[1],
            b[0],
            b[1],
            c[0],
            c[1]
        );
    }
    out + "</g>\n</svg>\n"
}

/// The tables as text. `first`: points before refinement; Seconds: of the bake, by the clock and of all processors.
pub fn glossy_text(sizes: &LobeSizes, first: u64, [seconds, cpu_seconds]: [f64; 2], rows: &[GlossyRow]) -> String {
    let per_point = sizes.bytes as f64 / sizes.points.max(1) as f64;
    let mut text = String::from("[LD09]: exact direct light, and lobes for what other surfaces send.\n\n");
    let _ = writeln!(text, "points {first} to {}, bake {seconds:.1} s, {cpu_seconds:.1} s of processors", sizes.points);
    let _ = writeln!(text, "lobes {}, {:.1} MB, {per_point:.0} bytes a point", sizes.lobes, sizes.bytes as f64 / 1e6);
    let _ = writeln!(text, "points with views on level 0 to {MAX_LEVEL}, and without slices: {:?}\n", sizes.levels);
    let _ =
        writeln!(text, "{:<20} {:<10} | direct only   with lobes   less noise | indirect   share |   PSNR |    fps", "environment", "view");
    for row in rows {
        let figure = |value: Option<f64>| value.map_or("-".to_string(), |value| format!("{value:.4}"));
        let psnr = row.psnr_db.map_or("-".to_string(), |psnr| format!("{psnr:.2}"));
        let _ = writeln!(
            text,
            "{:<20} {:<10} | {:>11} {:>12} {:>12} | {:>8} {:>7} | {psnr:>6} | {:>6.1}",
            row.environment,
            row.view,
            figure(row.direct_relative_l2),
            figure(row.relative_l2),
            figure(row.unbiased_relative_l2),
            figure(row.indirect_relative_l2),
            figure(row.indirect_share),
            1.0 / row.frame_seconds.max(1e-9)
        );
    }
    text
}

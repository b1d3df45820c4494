//! A bake that is coarser than its meshes: fewer points, nearly the same picture, and each choice local.

use prelight_bake::options::BakeOptions;
use prelight_manifests::Digest;
use prelight_runtime::asset::Asset;
use prelight_runtime::asset::mesh::Lit;
use prelight_runtime::draw::camera::Camera;
use prelight_runtime::draw::metrics::compare;
use prelight_runtime::draw::shade::Frame;
use prelight_runtime::draw::{Background, Style};
use prelight_runtime::environment::{LightCubemap, sky};
use prelight_runtime::relight::Relighter;
use prelight_scene::{Primitive, Scene};
use prelight_store::Store;
use prelight_tests::{bake_into, cuboid, options, scene, sphere};
use std::collections::BTreeSet;
use std::sync::Arc;

/// A flat square of n² cells about the origin, facing up.
fn grid(side: f32, n: u32, material: u32) -> Primitive {
    let at = |i: u32| side * (i as f32 / n as f32 - 0.5);
    let positions = (0..=n).flat_map(|z| (0..=n).map(move |x| [at(x), 0.0, at(z)])).collect();
    let cell = |x: u32, z: u32| {
        let a = z * (n + 1) + x;
        [[a, a + n + 1, a + 1], [a + 1, a + n + 1, a + n + 2]]
    };
    let triangles = (0..n).flat_map(|z| (0..n).flat_map(move |x| cell(x, z))).collect();
    Primitive { positions, triangles, material, ..Primitive::default() }
}

/// A finely scanned ball that rests on a finely scanned table.
fn scan() -> Scene {
    scene(vec![("table", grid(1.2, 120, 0)), ("ball", sphere([0.05, 0.2, 0.0], 0.2, 160, 100, 1))])
}

fn coarser(scene: &Scene, edge_length: f32) -> BakeOptions {
    let mut options = options(scene, edge_length);
    options.points.iter_mut().for_each(|params| params.coarser = true);
    options
}

fn baked(scene: &Scene, options: &BakeOptions) -> Arc<Asset> {
    let folder = tempfile::tempdir().unwrap();
    let baked = bake_into(scene, options, folder.path());
    let store = Store::open(folder.path()).unwrap();
    Arc::new(Asset::open(baked.seal(Default::default(), &store).unwrap(), &store).unwrap())
}

fn draw(asset: &Arc<Asset>, clay: bool) -> Frame {
    let mut relighter = Relighter::new(asset.clone());
    relighter.set_light(&LightCubemap::from_environment(&sky([0.5, 0.7, 0.4]), 64)).unwrap();
    let camera = Camera::upright([0.3, 0.75, 1.1], [0.0, 0.1, 0.0], 40.0).unwrap();
    let view = relighter.view(&camera, [240, 180], 16).unwrap();
    relighter.shade(camera.eye, Some(&view.points)).unwrap();
    relighter.draw(&view, Background::Black, Style::clay_if(clay)).unwrap()
}

#[test]
fn a_dense_scan_at_a_coarse_edge_length_holds_its_picture() {
    let scene = scan();
    let full = baked(&scene, &options(&scene, 0.03));
    let coarse = baked(&scene, &coarser(&scene, 0.03));
    let share = coarse.n_points() as f64 / full.n_points() as f64;
    // Full: a centimetre between points. Asked for: three.
    assert!(share < 0.3, "{} of {} points", coarse.n_points(), full.n_points());
    for (clay, bound) in [(true, 36.0), (false, 34.0)] {
        let (test, reference) = (draw(&coarse, clay), draw(&full, clay));
        let metrics = compare(&test.image, &reference.image, &reference.mask, None, None).unwrap();
        println!("clay {clay}: {} of {} points, {:?} dB", coarse.n_points(), full.n_points(), metrics.mask.psnr_db);
        assert!(metrics.mask_share > 0.5);
        assert!(metrics.mask.psnr_db.unwrap() >= bound, "clay {clay}: {:?}", metrics.mask);
    }
}

#[test]
fn a_coarser_bake_of_a_coarse_mesh_is_the_plain_one() {
    let scene = scene(vec![("table", grid(1.2, 12, 0)), ("crate", cuboid([-0.2, 0.1, -0.2], [0.2, 0.4, 0.1], 1))]);
    let digest = |options: &BakeOptions| -> Digest { bake_into(&scene, options, tempfile::tempdir().unwrap().path()).asset_digest };
    // Every edge of either mesh is longer than the cells.
    assert_eq!(digest(&coarser(&scene, 0.02)), digest(&options(&scene, 0.02)));
}

#[test]
fn what_is_baked_of_a_surface_does_not_depend_on_the_rest_of_it() {
    let positions = |scene: &Scene| -> BTreeSet<[u32; 3]> {
        let asset = baked(scene, &coarser(scene, 0.06));
        let mesh = asset.mesh(0);
        let own = (0..mesh.position.len()).filter(|v| matches!(mesh.front(*v), Lit::Point(_)));
        own.map(|v| mesh.position[v].map(f32::to_bits)).collect()
    };
    let whole = grid(1.2, 60, 0);
    let mut cut = whole.clone();
    // The half with x > 0.3 goes; what is left keeps its points but for the cells at the cut.
    cut.triangles.retain(|triangle| triangle.iter().all(|v| whole.positions[*v as usize][0] < 0.3));
    let far = |all: BTreeSet<[u32; 3]>| -> BTreeSet<[u32; 3]> { all.into_iter().filter(|p| f32::from_bits(p[0]) < 0.2).collect() };
    let (of_whole, of_cut) = (far(positions(&scene(vec![("table", whole)]))), far(positions(&scene(vec![("table", cut)]))));
    assert!(of_whole.len() > 100, "{}", of_whole.len());
    assert_eq!(of_whole, of_cut);
}

#[test]
fn no_point_is_lost_and_blends_are_means_of_near_points_with_like_normals() {
    let scene = scan();
    let asset = baked(&scene, &coarser(&scene, 0.05));
    let mut blended = 0;
    for object in 0..2 {
        let mesh = asset.mesh(object);
        let mut place = vec![None; asset.objects()[object].points.len()];
        for v in 0..mesh.position.len() {
            if let Lit::Point(point) = mesh.front(v) {
                place[point as usize] = Some((mesh.position[v], mesh.normal[v]));
            }
        }
        let area: f32 = asset.patches()[asset.objects()[object].patches.clone()].iter().flat_map(|patch| patch.points().area).sum();
        let expected = if object == 0 { 1.44 } else { 4.0 * std::f32::consts::PI * 0.04 };
        assert!((area / expected - 1.0).abs() < 2e-3, "areas of points sum to the surface: {area} {expected}");
        for v in 0..mesh.position.len() {
            assert_ne!(mesh.front(v), Lit::Nowhere);
            let Lit::Blend(_) = mesh.front(v) else { continue };
            blended += 1;
            for (point, _) in mesh.front(v).shares() {
                let (position, normal) = place[point as usize].expect("each point has a vertex");
                let squared: f32 = (0..3).map(|k| (position[k] - mesh.position[v][k]).powi(2)).sum();
                let cosine: f32 = (0..3).map(|k| normal[k] * mesh.normal[v][k]).sum();
                assert!(squared.sqrt() <= 4.0 * 0.05 && cosine > 0.5, "{} {cosine}", squared.sqrt());
            }
        }
    }
    assert!(blended > 10_000, "{blended}");
}

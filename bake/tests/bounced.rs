//! Bounced light of whole bakes: against paths traced by brute force, closed forms, walls that let nothing through, and edits without a bake.

use prelight_bake::bake::bake;
use prelight_bake::bounces::BounceOptions;
use prelight_bake::engine::Threads;
use prelight_bake::mesh::PointParams;
use prelight_bake::options::{BakeOptions, RebakeOptions};
use prelight_bake::progress::Silent;
use prelight_bake::trace::TreeQuality;
use prelight_manifests::Quality;
use prelight_runtime::asset::Asset;
use prelight_runtime::environment::{Environment, LightCubemap};
use prelight_runtime::light::layer::Bounces;
use prelight_runtime::relight::Relighter;
use prelight_runtime::surface::{Material, Model};
use prelight_scene::{Mesh, Object, Primitive, Scene};
use prelight_store::Store;
use std::f64::consts::PI;
use std::sync::Arc;

/// Corners of a rectangle and its material; the front is on the side of the product of its edges.
type Quad = ([f64; 3], [f64; 3], [f64; 3], u32);

fn material(albedo: f32) -> Material {
    Material { base_color: [albedo, albedo, albedo, 1.0], model: Model::Lambert, ..Material::default() }
}

/// The six faces of a box, seen from outside or inside.
fn faces(lower: [f64; 3], upper: [f64; 3], inside: bool, material: u32) -> Vec<Quad> {
    let size: [f64; 3] = std::array::from_fn(|k| upper[k] - lower[k]);
    let mut quads = Vec::new();
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let edge = |k: usize| std::array::from_fn(|i| if i == k { size[k] } else { 0.0 });
        for (end, flip) in [(upper[axis], inside), (lower[axis], !inside)] {
            let mut corner = lower;
            corner[axis] = end;
            let (a, b) = if flip { (v, u) } else { (u, v) };
            quads.push((corner, edge(a), edge(b), material));
        }
    }
    quads
}

/// A scene of named groups of rectangles.
fn scene(groups: &[(&str, Vec<Quad>)], materials: Vec<Material>) -> Scene {
    let mut scene = Scene { materials, ..Scene::default() };
    for (name, quads) in groups {
        let primitive = |(p, e, f, material): &Quad| {
            let at = |u: f64, v: f64| std::array::from_fn(|k| (p[k] + u * e[k] + v * f[k]) as f32);
            let positions = vec![at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)];
            Primitive { positions, triangles: vec![[0, 1, 2], [0, 2, 3]], material: *material, ..Primitive::default() }
        };
        let mesh = Arc::new(Mesh { primitives: quads.iter().map(primitive).collect() });
        let identity = std::array::from_fn(|i| if i % 5 == 0 { 1.0 } else { 0.0 });
        scene.objects.push(Object { name: name.to_string(), mesh, world_from_local: identity });
    }
    scene
}

fn options(scene: &Scene, edge_length: f32, bounces: BounceOptions) -> BakeOptions {
    let points = PointParams::new(&Quality::Draft.knobs(), edge_length);
    BakeOptions {
        points: vec![points; scene.objects.len()],
        face_resolution: 64,
        visibility: Vec::new(),
        tree: TreeQuality::Fast,
        memory: 1 << 30,
        techniques: Vec::new(),
        bounces: Some(bounces),
        movers: Default::default(),
        engine: Arc::new(Threads::default()),
        rebake: RebakeOptions::default(),
    }
}

/// In memory where that can be had: an edit here costs less than the disk's sync.
fn new_store() -> (tempfile::TempDir, Store) {
    let folder = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).expect("a temporary folder");
    let store = Store::open_or_create(folder.path()).expect("a new store");
    (folder, store)
}

fn relighter(scene: &Scene, edge_length: f32, bounces: BounceOptions) -> Relighter {
    let (_folder, store) = new_store();
    let baked = bake(scene, &options(scene, edge_length, bounces), &store, &Silent).expect("this scene bakes");
    Relighter::new(Asset::open(baked.seal(Default::default(), &store).expect("room on the disk"), &store).expect("just sealed"))
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Paths by brute force: every rectangle is asked by every ray.
struct Brute<'a> {
    quads: Vec<Quad>,
    albedo: &'a [f64],
    sky: &'a dyn Fn([f64; 3]) -> f64,
    state: u64,
}

impl Brute<'_> {
    fn unit(&mut self) -> f64 {
        self.state = self.state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.state >> 11) as f64 / (1u64 << 53) as f64
    }

    fn cosine(&mut self, n: [f64; 3]) -> [f64; 3] {
        let (u, angle) = (self.unit(), 2.0 * PI * self.unit());
        let helper = if n[0].abs() < 0.5 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
        let t = cross(n, helper);
        let length = dot(t, t).sqrt();
        let t = t.map(|x| x / length);
        let b = cross(n, t);
        let (r, z) = (u.sqrt(), (1.0 - u).sqrt());
        std::array::from_fn(|k| r * angle.cos() * t[k] + r * angle.sin() * b[k] + z * n[k])
    }

    /// Distance, normal toward the ray and material of the nearest front; a back is black: `None` inside.
    fn hit(&self, from: [f64; 3], d: [f64; 3]) -> Option<(f64, Option<([f64; 3], u32)>)> {
        let mut best: Option<(f64, Option<([f64; 3], u32)>)> = None;
        for (p, e, f, material) in &self.quads {
            let n = cross(*e, *f);
            let (det, away) = (dot(n, d), std::array::from_fn(|k| p[k] - from[k]));
            let t = dot(n, away) / det;
            if det == 0.0 || t < 1e-6 || best.as_ref().is_some_and(|(known, _)| t >= *known) {
                continue;
            }
            let local: [f64; 3] = std::array::from_fn(|k| from[k] + t * d[k] - p[k]);
            let (u, v) = (dot(local, *e) / dot(*e, *e), dot(local, *f) / dot(*f, *f));
            if (0.0..=1.0).contains(&u) && (0.0..=1.0).contains(&v) {
                let length = dot(n, n).sqrt();
                best = Some((t, (det < 0.0).then(|| (n.map(|x| x / length), *material))));
            }
        }
        best
    }

    /// Bounced irradiance of a point, from so many paths.
    fn bounced(&mut self, position: [f64; 3], normal: [f64; 3], paths: usize) -> f64 {
        let mut sum = 0.0;
        for _ in 0..paths {
            let (mut at, mut n, mut share) = (std::array::from_fn(|k| position[k] + 1e-5 * normal[k]), normal, 1.0);
            for bounce in 0..24 {
                let d = self.cosine(n);
                match self.hit(at, d) {
                    None => {
                        sum += if bounce > 0 { share * (self.sky)(d) } else { 0.0 };
                        break;
                    }
                    Some((_, None)) => break,
                    Some((t, Some((normal, material)))) => {
                        share *= self.albedo[material as usize];
                        at = std::array::from_fn(|k| at[k] + t * d[k] + 1e-9 * normal[k]);
                        n = normal;
                    }
                }
            }
        }
        sum * PI / paths as f64
    }
}

/// A room of 4 x 5 m with one window and a table in it.
fn room() -> Vec<(&'static str, Vec<Quad>)> {
    let mut shell = faces([0.0, 0.0, 0.0], [4.0, 2.7, 5.0], true, 0);
    // The wall at x = 0 leaves a window of 1.6 x 1.3 m.
    shell.retain(|(p, e, f, _)| !(p[0] == 0.0 && e[0] == 0.0 && f[0] == 0.0));
    let wall = |y: [f64; 2], z: [f64; 2]| ([0.0, y[0], z[0]], [0.0, y[1] - y[0], 0.0], [0.0, 0.0, z[1] - z[0]], 0);
    shell.extend([wall([0.0, 0.9], [0.0, 5.0]), wall([2.2, 2.7], [0.0, 5.0]), wall([0.9, 2.2], [0.0, 1.7]), wall([0.9, 2.2], [3.3, 5.0])]);
    let mut table = faces([1.5, 0.7, 1.5], [2.5, 0.75, 3.2], false, 1);
    for (x, z) in [(1.5, 1.5), (2.4, 1.5), (1.5, 3.1), (2.4, 3.1)] {
        table.extend(faces([x, 0.0, z], [x + 0.1, 0.7, z + 0.1], false, 1));
    }
    vec![("shell", shell), ("table", table)]
}

fn sky(d: [f64; 3]) -> f64 {
    1.0 + 0.6 * d[1] + 0.4 * d[2]
}

fn environment(f: impl Fn([f64; 3]) -> f64) -> Environment {
    let (width, height) = (256usize, 128usize);
    let mut image = Environment::new(width, height, vec![[0.0; 3]; width * height]);
    for at in 0..width * height {
        let direction = image.direction_from_pixel((at % width) as f64 + 0.5, (at / width) as f64 + 0.5);
        image.pixels[at] = [f(direction) as f32; 3];
    }
    image
}

/// `[points]` bounced irradiance along the normal, position, normal, area and whether the point counts.
struct Lit {
    bounced: Vec<f64>,
    whole: Vec<f64>,
    position: Vec<[f64; 3]>,
    normal: Vec<[f64; 3]>,
    area: Vec<f64>,
    is_buried: Vec<bool>,
}

fn light(relighter: &mut Relighter, environment: &Environment) -> Lit {
    relighter.set_light(&LightCubemap::from_environment(environment, 64)).expect("the bake's faces");
    let mut total = |bounces: Bounces| -> Vec<[f32; 3]> {
        relighter.set_bounces(bounces);
        relighter.shade_diffuse(None).expect("there is light");
        relighter.irradiance().iter().map(|vector| vector[1]).collect()
    };
    let (whole, direct) = (total(Bounces::Settled(1e-4)), total(Bounces::Off));
    let asset = relighter.asset().clone();
    let mut lit = Lit { bounced: vec![], whole: vec![], position: vec![], normal: vec![], area: vec![], is_buried: vec![] };
    for (patch, first) in asset.patches().iter().map(|patch| (patch.points(), patch.points.start)) {
        for i in 0..patch.flags.len() {
            let normal = patch.normal[i].map(f64::from);
            let along = |vector: [f32; 3]| dot(vector.map(f64::from), normal).max(0.0);
            lit.whole.push(along(whole[first + i]));
            lit.bounced.push(along(whole[first + i]) - along(direct[first + i]));
            lit.position.push(patch.position[i].map(f64::from));
            lit.normal.push(normal);
            lit.area.push(f64::from(patch.area[i]));
            lit.is_buried.push(patch.flags[i] & 2 != 0);
        }
    }
    lit
}

#[test]
fn a_room_with_a_window_has_the_light_of_traced_paths() {
    let groups = room();
    let albedo = [0.7, 0.5];
    let mut relighter = relighter(&scene(&groups, albedo.map(|a| material(a as f32)).to_vec()), 0.12, BounceOptions::default());
    let lit = light(&mut relighter, &environment(sky));
    let quads = groups.into_iter().flat_map(|(_, quads)| quads).collect();
    let mut brute = Brute { quads, albedo: &albedo, sky: &sky, state: 7 };
    let (mut squares, mut product, mut truths, mut sum, mut found_sum) = (0.0, 0.0, 0.0, 0.0, 0.0);
    let mut ratios = Vec::new();
    let step = lit.bounced.len() / 60;
    for i in (step / 2..lit.bounced.len()).step_by(step).filter(|i| !lit.is_buried[*i]) {
        // A hair into the room: on an edge, half of the paths would start behind a wall.
        let inward = |k: usize| (1.0 - lit.normal[i][k].abs()) * 1e-3 * ([2.0, 1.35, 2.5][k] - lit.position[i][k]);
        let place = std::array::from_fn(|k| lit.position[i][k] + inward(k));
        let [a, b] = [0, 1].map(|_| brute.bounced(place, lit.normal[i], 3000));
        // Two halves: their noise is not in the sums of products.
        squares += (lit.bounced[i] - a) * (lit.bounced[i] - b);
        product += a * b;
        let direct = lit.whole[i] - lit.bounced[i];
        truths += (direct + a) * (direct + b);
        (sum, found_sum) = (sum + 0.5 * (a + b) + direct, found_sum + lit.whole[i]);
        ratios.push(lit.whole[i] / (direct + 0.5 * (a + b)));
    }
    ratios.sort_by(f64::total_cmp);
    let (energy, median) = (found_sum / sum, ratios[ratios.len() / 2]);
    let (own, whole) = ((squares.max(0.0) / product).sqrt(), (squares.max(0.0) / truths).sqrt());
    eprintln!("{} points: energy {energy:.4}, median {median:.4}, bounced {own:.4}, whole {whole:.4}", lit.bounced.len());
    assert!((0.97..=1.03).contains(&energy) && (0.95..=1.05).contains(&median), "{energy} {median}");
    assert!(whole < 0.06, "{whole}");
    // Spread over the far wall above the table: against a plane fitted through it.
    let on_wall = |p: [f64; 3], n: [f64; 3]| n[0] < -0.9 && p[0] > 3.9 && (0.4..2.3).contains(&p[1]) && (0.5..4.5).contains(&p[2]);
    let direct: Vec<f64> = lit.whole.iter().zip(&lit.bounced).map(|(whole, bounced)| whole - bounced).collect();
    let [whole, bounced, direct] = [&lit.whole, &lit.bounced, &direct].map(|values| spread(&lit, values, &lit.whole, on_wall));
    eprintln!("spread of the far wall {whole:.4}: bounced {bounced:.4}, direct {direct:.4}");
    assert!(bounced < 0.02, "{bounced}");
}

/// Deviation of a flat wall's values from the mean of their neighbours within 35 cm, relative to `of`.
fn spread(lit: &Lit, values: &[f64], of: &[f64], on: impl Fn([f64; 3], [f64; 3]) -> bool) -> f64 {
    let points: Vec<usize> = (0..lit.whole.len()).filter(|i| on(lit.position[*i], lit.normal[*i])).collect();
    assert!(points.len() > 50, "{}", points.len());
    let (mut squares, mut all) = (0.0, 0.0);
    for &i in &points {
        let near = points.iter().filter(|&&j| {
            let away: [f64; 3] = std::array::from_fn(|k| lit.position[j][k] - lit.position[i][k]);
            dot(away, away) < 0.35 * 0.35
        });
        let (mut sum, mut n) = (0.0, 0.0);
        near.for_each(|&j| (sum, n) = (sum + values[j], n + 1.0));
        squares += (values[i] - sum / n) * (values[i] - sum / n);
        all += of[i] * of[i];
    }
    (squares / all).sqrt()
}

#[test]
fn a_white_room_that_is_closed_holds_what_its_albedo_says() {
    // A lamp for a ceiling, so that light is there at all: B = emitted, and E = E0 / (1 - albedo) where all surfaces send alike.
    let shell = vec![("shell", faces([0.0; 3], [2.0, 2.0, 3.0], true, 0))];
    for albedo in [0.5f32, 0.9] {
        let glowing = Material { emissive: [1.0; 3], ..material(albedo) };
        let mut relighter = relighter(&scene(&shell, vec![glowing]), 0.3, BounceOptions::default());
        let lit = light(&mut relighter, &environment(|_| 5.0));
        let expected = PI / (1.0 - f64::from(albedo));
        let bound = if albedo < 0.6 { 0.01 } else { 0.03 };
        let mean: f64 = lit.whole.iter().sum::<f64>() / lit.whole.len() as f64;
        assert!((mean / expected - 1.0).abs() < bound, "{albedo}: {mean} {expected}");
    }
}

#[test]
fn nothing_passes_a_millimetre_of_wall() {
    // Two rooms on one floor: one has no ceiling, the other is closed.
    let mut quads = faces([0.0, 0.0, 0.0], [4.0, 2.0, 2.0], true, 0);
    quads.retain(|(p, e, f, _)| !(p[1] == 2.0 && e[1] == 0.0 && f[1] == 0.0));
    let ceiling = ([2.0, 2.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 2.0], 0);
    let wall = faces([2.0, 0.0, 0.0], [2.001, 2.0, 2.0], false, 0);
    let scene = scene(&[("shell", quads), ("ceiling", vec![ceiling]), ("wall", wall)], vec![material(0.7)]);
    let mut relighter = relighter(&scene, 0.13, BounceOptions::default());
    let lit = light(&mut relighter, &environment(|_| 1.0));
    let dark: Vec<usize> =
        (0..lit.whole.len()).filter(|i| !lit.is_buried[*i] && lit.position[*i][0] > 2.0015 && lit.position[*i][1] < 1.999).collect();
    let bright = (0..lit.whole.len()).filter(|i| !lit.is_buried[*i] && lit.position[*i][0] < 1.9);
    let (sum, n) = bright.fold((0.0, 0.0), |(sum, n), i| (sum + lit.whole[i], n + 1.0));
    let most = dark.iter().map(|i| lit.whole[*i]).fold(0.0, f64::max);
    let mean = dark.iter().map(|i| lit.whole[*i]).sum::<f64>() / dark.len() as f64;
    eprintln!("behind a wall: mean {:.5}, most {:.5} of the lit room's mean", mean / (sum / n), most / (sum / n));
    assert!(dark.len() > 200 && sum / n > 1.0 && mean < 1e-3 * sum / n && most < 5e-3 * sum / n, "{mean} {most} {}", sum / n);
}

#[test]
fn repainting_needs_no_bake() {
    let groups = room();
    let mut first = relighter(&scene(&groups, vec![material(0.7), material(0.5)]), 0.3, BounceOptions::default());
    let mut second = relighter(&scene(&groups, vec![material(0.35), material(0.5)]), 0.3, BounceOptions::default());
    let environment = environment(sky);
    let before = light(&mut first, &environment);
    first.set_material(0, material(0.35)).expect("a colour may change");
    let (edited, baked) = (light(&mut first, &environment), light(&mut second, &environment));
    assert_eq!(edited.whole, baked.whole);
    assert!(before.bounced.iter().sum::<f64>() > 1.5 * edited.bounced.iter().sum::<f64>());
}

#[test]
fn an_edited_scene_has_the_links_of_a_clean_bake_and_casts_few_rays() {
    let (_folder, store) = new_store();
    let bake_in =
        |scene: &Scene, store: &Store| bake(scene, &options(scene, 0.25, BounceOptions::default()), store, &Silent).expect("it bakes");
    let mut scene = scene(&room(), vec![material(0.7), material(0.5)]);
    let cup = |x: f64| Object {
        name: "cup".into(),
        mesh: scene_of(&[("cup", faces([1.8, 0.75, 2.0], [1.9, 0.85, 2.1], false, 1))]).objects[0].mesh.clone(),
        world_from_local: std::array::from_fn(|i| {
            if i == 12 {
                x
            } else if i % 5 == 0 {
                1.0
            } else {
                0.0
            }
        }),
    };
    bake_in(&scene, &store);
    type Edit<'a> = (&'a str, &'a dyn Fn(&mut Scene), f64);
    let edits: [Edit; 9] = [
        ("nothing", &|_| {}, 0.0),
        ("a colour", &|scene| scene.materials[1].base_color[0] = 0.1, 0.0),
        ("a new cup", &|scene| scene.objects.push(cup(0.0)), 0.35),
        ("the cup moved", &|scene| scene.objects[2] = cup(0.3), 0.35),
        ("the cup moved back", &|scene| scene.objects[2] = cup(0.0), 0.35),
        ("another order", &|scene| scene.objects.swap(1, 2), 1.0),
        ("a table with backs", &|scene| scene.materials[1].double_sided = true, 1.0),
        ("no cup", &|scene| drop(scene.objects.remove(1)), 0.35),
        ("no table", &|scene| drop(scene.objects.remove(1)), 1.0),
    ];
    for (name, edit, most) in edits {
        edit(&mut scene);
        let (_clean_folder, clean_store) = new_store();
        let (again, clean) = (bake_in(&scene, &store), bake_in(&scene, &clean_store));
        assert_eq!(again.asset_digest, clean.asset_digest, "{name}");
        let ([cast, _], [all, _]) = (again.stats.bounce_rays, clean.stats.bounce_rays);
        eprintln!("{name}: {cast} of {all} rays");
        assert!(all > 100_000 && cast as f64 <= most * all as f64, "{name}: {cast} of {all}");
    }
}

#[test]
fn threads_and_repetition_change_no_bit() {
    let scene = scene(&room(), vec![material(0.7), material(0.5)]);
    let digest = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        let (_folder, store) = new_store();
        pool.install(|| bake(&scene, &options(&scene, 0.3, BounceOptions::default()), &store, &Silent).expect("it bakes").asset_digest)
    };
    assert_eq!(digest(1), digest(4));
}

fn scene_of(groups: &[(&str, Vec<Quad>)]) -> Scene {
    scene(groups, vec![material(0.7), material(0.5)])
}

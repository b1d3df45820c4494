//! The development scenes, where they are: counts as their list gives them.

use super::gltf::{LoadLimits, load};
use super::world::World;
use std::path::Path;

#[test]
fn development_scenes_load_with_their_triangle_counts() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/scenes");
    // (file, triangles with instances, objects, materials, textures)
    let scenes = [
        ("teapot", 6_320, 1, 1, 0),
        ("bunny", 69_451, 1, 1, 0),
        ("bunny_plane", 77_643, 2, 2, 0),
        ("dragon", 202_520, 1, 1, 0),
        ("bas_relief", 180_218, 1, 1, 0),
        ("apartment", 176_420, 57, 67, 0),
        ("table_chairs", 92_839, 41, 10, 0),
        ("flight_helmet", 94_722, 6, 6, 15),
    ];
    for (name, triangles, objects, materials, textures) in scenes {
        let path = folder.join(name).with_extension("glb");
        if !path.exists() {
            eprintln!("SKIPPED: {} is not there", path.display());
            continue;
        }
        let scene = load(&path, &LoadLimits::default()).unwrap_or_else(|e| panic!("{e}"));
        let world = World::build(&scene);
        let found = (world.positions.len(), scene.objects.len(), scene.materials.len(), scene.textures.len());
        assert_eq!(found, (triangles, objects, materials, textures), "{name}");
        println!("{name}: {:?}", scene.warnings);
        let mut names: Vec<&str> = scene.objects.iter().map(|o| o.name.as_str()).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), objects, "{name}: names are unique");
        assert!(world.positions.iter().flatten().flatten().all(|x| x.is_finite()));
    }
}

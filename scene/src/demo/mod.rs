//! The scene of `prelight demo`, made in code: the corner of a room with a table and a window of sun.
//!
//! [`write_scene`] writes a folder that is a scene like any other:
//!
//! ```text
//! scene.toml          what `prelight bake` reads
//! room.glb            geometry, textures, two cameras: "room" and "table"
//! env/noon.exr        a clear sky; the sun falls through the window onto the table and the floor
//! env/evening.hdr     a low, red sun that reaches the back wall
//! ```
//!
//! The same bytes on every machine.

mod paint;
mod room;
mod shapes;

use crate::error::SceneError;
use prelight_runtime::environment::{Environment, sky};
use std::path::{Path, PathBuf};

/// Direction to the noon sun: through the window, down onto the table.
const NOON_SUN: [f32; 3] = [-0.84, 0.46, 0.2];
/// Direction to the evening sun: through the window, across the table, onto the back wall.
const EVENING_SUN: [f32; 3] = [-0.85, 0.15, 0.45];
/// The manifest.
const SCENE: &str = r#"# The scene of `prelight demo`. Written by it; change what you like and bake it again:
#   prelight bake scene.toml
#   prelight render scene.prelight.json -e evening --camera table
format = 1

[scene]
gltf = "room.glb"

[[environment]]
name = "noon"
image = "env/noon.exr"

[[environment]]
name = "evening"
image = "env/evening.hdr"

[bake]
quality = "medium"
edge_length = 0.04          # metres
area_floor = 1.0            # no finer at shadow borders: the edges below are fine enough

[[object]]                  # where the sun draws its patches
match = "{Floor,Rug}"
edge_length = 0.025

[[object]]                  # shadows of the window and the plant
match = "Back wall"
edge_length = 0.018

[[object]]                  # seen from near
match = "{Table,Block*,Books}"
edge_length = 0.014
"#;

/// What [`write_scene`] wrote.
#[derive(Clone, Debug)]
pub struct DemoScene {
    /// `scene.toml`.
    pub manifest: PathBuf,
    /// Names of the environments in it, the best one for a first picture first.
    pub environments: [&'static str; 2],
    /// Names of the cameras, the best one for a first picture first.
    pub cameras: [&'static str; 2],
}

/// Writes the demo's scene into a folder, which is made if it is missing; files of the same names are replaced.
///
/// # Errors
/// When a file cannot be written.
pub fn write_scene(folder: &Path) -> Result<DemoScene, SceneError> {
    let environments = folder.join("env");
    std::fs::create_dir_all(&environments).map_err(|source| SceneError::output(&environments, source))?;
    let write = |name: &str, bytes: &[u8]| {
        let path = folder.join(name);
        std::fs::write(&path, bytes).map_err(|source| SceneError::output(&path, source))?;
        Ok::<PathBuf, SceneError>(path)
    };
    write("room.glb", &room::glb()?)?;
    write("env/noon.exr", &landscape(sky(NOON_SUN), [0.52, 0.47, 0.40]).to_exr()?)?;
    write("env/evening.hdr", &landscape(sky(EVENING_SUN), [0.9, 0.85, 0.8]).to_radiance_hdr())?;
    let manifest = write("scene.toml", SCENE.as_bytes())?;
    Ok(DemoScene { manifest, environments: ["noon", "evening"], cameras: room::CAMERAS })
}

/// Puts a landscape under a sky: a meadow and two wooded ridges in the haze, so that the window has something to show.
///
/// `dim` multiplies all but the sun's disc: the room is open to half the sky, which would drown the patch of sun.
fn landscape(mut sky: Environment, dim: [f32; 3]) -> Environment {
    const DISC: f32 = 20.0;
    for pixel in sky.pixels.iter_mut().filter(|pixel| pixel[0] < DISC) {
        (0..3).for_each(|c| pixel[c] *= dim[c]);
    }
    let (width, height) = (sky.width, sky.height);
    // Just above the horizon, by longitude: what haze fades to. The sun stands higher than this row in both skies.
    let haze: Vec<[f32; 3]> = (0..width).map(|x| sky.pixels[(height / 2 - 1) * width + x]).collect();
    let mean = haze.iter().map(|p| p[1]).sum::<f32>() / width as f32;
    let pixel_height = std::f64::consts::PI / height as f64;
    for y in 0..height {
        for x in 0..width {
            let up = sky.direction_from_pixel(x as f64 + 0.5, y as f64 + 0.5)[1];
            let turn = 2.0 * std::f64::consts::PI * (x as f64 + 0.5) / width as f64;
            let ridge = |base: f64, phase: f64| base + 0.018 * libm::sin(5.0 * turn + phase) + 0.010 * libm::sin(13.0 * turn + 2.0 * phase);
            // Top, colour and how much haze lies before it; the farthest first.
            let layers = [
                (ridge(0.055, 1.0), [0.15, 0.21, 0.18], 0.60),
                (ridge(0.012, 4.0), [0.11, 0.17, 0.09], 0.35),
                (-0.02, [0.20, 0.24, 0.09], 0.5 * libm::exp((up + 0.02).min(0.0) * 10.0)),
            ];
            for (top, colour, veil) in layers {
                // Tops fade over a pixel and a half.
                let covered = ((top - up) / (1.5 * pixel_height) + 0.5).clamp(0.0, 1.0) as f32;
                let pixel = &mut sky.pixels[y * width + x];
                *pixel = std::array::from_fn(|c| {
                    let ground = colour[c] * mean;
                    let seen = ground + (haze[x][c].min(1.2 * mean) - ground) * veil as f32;
                    pixel[c] + (seen - pixel[c]) * covered
                });
            }
        }
    }
    sky
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gltf::{LoadLimits, load};
    use crate::world::World;
    use prelight_manifests::SceneManifest;
    use prelight_runtime::environment::Limits;

    #[test]
    fn the_scene_loads_without_a_warning_and_its_lights_are_what_they_say() {
        let folder = tempfile::tempdir().unwrap();
        let demo = write_scene(folder.path()).unwrap();
        let text = std::fs::read_to_string(&demo.manifest).unwrap();
        let manifest = SceneManifest::parse("scene.toml", &text).unwrap();
        let scene = load(&folder.path().join(manifest.gltf()), &LoadLimits::default()).unwrap();
        assert_eq!(scene.warnings, Vec::<String>::new());
        let cameras: Vec<&str> = scene.cameras.iter().map(|camera| camera.name.as_str()).collect();
        assert_eq!(cameras, demo.cameras);
        for (name, sun) in demo.environments.into_iter().zip([NOON_SUN, EVENING_SUN]) {
            let bytes = std::fs::read(folder.path().join(&manifest.environment(name).unwrap().image)).unwrap();
            let (decoded, _) = Environment::decode(name, &bytes, &Limits::default()).unwrap();
            let at_sun = decoded.radiance(sun.map(|v| v / sun.iter().map(|x| x * x).sum::<f32>().sqrt()));
            assert!(at_sun[0] > 100.0, "{name} {at_sun:?}");
        }
        // Nothing stands outside the room, nothing is huge, and a second writing gives the same bytes.
        let world = World::build(&scene);
        assert!((10_000..80_000).contains(&world.positions.len()), "{}", world.positions.len());
        assert!(world.positions.iter().flatten().all(|p| (-2.3..=3.3).contains(&p[0]) && (0.0..=4.9).contains(&p[1])));
        let first = std::fs::read(folder.path().join("room.glb")).unwrap();
        assert_eq!(first, room::glb().unwrap());
    }
}

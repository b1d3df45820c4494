//! What the files hold and nothing shows: it costs loading time and hints at an export gone wrong.

use super::Finding;
use prelight_scene::input::SceneInput;
use prelight_scene::unused::unused;

pub(super) fn findings(input: &SceneInput) -> Vec<Finding> {
    let mut found = Vec::new();
    for path in input.scene_files() {
        let unused = unused(&path);
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let kinds =
            [("texture", "textures", unused.textures), ("material", "materials", unused.materials), ("mesh", "meshes", unused.meshes)];
        for (one, many, names) in kinds {
            if !names.is_empty() {
                let text = format!("{} of {name} used by nothing in its scene", super::count(names.len(), one, many));
                found.push(Finding { kind: "unused", text, names, help: "" });
            }
        }
    }
    found
}

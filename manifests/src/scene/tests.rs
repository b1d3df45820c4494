use super::position::{line_column, nearest};
use super::template::Template;
use super::*;
use crate::quality::Shades;
use crate::{ByteSize, ChunkKind, Quality, Technique, TechniqueInfo, Techniques};

/// A whole manifest around some lines; `format` and `[scene]` take the first three.
fn with(lines: &str) -> String {
    format!("format = 1\n[scene]\ngltf = \"a.glb\"\n{lines}\n")
}

fn refused(text: &str) -> String {
    SceneManifest::parse("scene.toml", text).expect_err(text).to_string()
}

#[test]
fn an_edge_length_may_have_a_unit_and_what_is_none_shows_the_form() {
    let read = |value: &str| {
        SceneManifest::parse("scene.toml", &format!("format = 1\n[scene]\ngltf = \"a.glb\"\n[bake]\nedge_length = {value}\n"))
    };
    assert_eq!(read("\"3cm\"").unwrap().bake.edge_length, Some(0.03));
    assert_eq!(read("2").unwrap().bake.edge_length, Some(2.0));
    for bad in ["\"3 parsec\"", "[1]", "true"] {
        let error = read(bad).unwrap_err().to_string();
        assert!(error.contains("3cm") && error.contains("scene.toml:5:15"), "{error}");
    }
}

#[test]
fn every_key_of_the_design_is_read() {
    let text = r#"
        format = 1
        [scene]
        gltf = "room.glb"
        [[environment]]
        name = "noon"
        image = "env/noon_1k.hdr"
        rotate_y_deg = 30
        [[environment]]
        name = "night"
        image = "env/night.exr"
        intensity = 0.5
        [bake]
        quality = "high"
        edge_length = 0.05
        max_error = 0.02
        technique = "auto"
        normal_angle_deg = 20
        area_floor = 0.25
        face_resolution = 128
        bvh = "slow"
        [[material]]
        match = "**/Vase"
        base_color = [0.1, 0.2, 0.3]
        roughness = 0.4
        metallic = 1
        emissive = [0, 1, 2.5]
        alpha_mode = "mask"
        alpha_cutoff = 0.25
        occludes = false
        double_sided = true
        [[object]]
        match = "Sofa*"
        technique = "block_product"
        quality = "draft"
        edge_length = 1
        visibility = "gray6"
        [limits]
        memory = "12GiB"
    "#;
    let manifest = SceneManifest::parse("scene.toml", text).unwrap();
    assert_eq!(manifest.gltf(), "room.glb");
    assert_eq!(manifest.environment("noon").map(|entry| (entry.rotate_y_deg, entry.intensity)), Some((30.0, 1.0)));
    assert_eq!(manifest.environment("night").map(|entry| entry.intensity), Some(0.5));
    assert!(manifest.environment("dusk").is_none());
    let knobs = manifest.bake.knobs();
    assert_eq!((knobs.normal_angle_deg, knobs.area_floor, knobs.face_resolution, knobs.max_error), (20.0, 0.25, 128, 0.02));
    assert_eq!(knobs.points, Quality::High.knobs().points, "what is not set comes from the preset");
    assert_eq!(manifest.bake.edge_length, Some(0.05));
    assert_eq!(manifest.object[0].technique, Some(Technique::BLOCK_PRODUCT));
    assert_eq!((manifest.object[0].visibility, manifest.bake.visibility, knobs.visibility), (Some(Shades::Gray6), None, Shades::Binary));
    assert_eq!(manifest.material[0].emissive, Some([0.0, 1.0, 2.5]));
    assert_eq!(manifest.limits.memory, Some(ByteSize(12 << 30)));
}

#[test]
fn unknown_keys_name_the_nearest_known_one_and_their_place() {
    let cases = [
        ("[bake]\negde_length = 1", "scene.toml:5:1", "unknown key `egde_length`", "did you mean `edge_length`?"),
        ("[bake]\n  qualty = \"high\"", "scene.toml:5:3", "unknown key `qualty`", "did you mean `quality`?"),
        ("[bake]\nQuality = \"high\"", "scene.toml:5:1", "unknown key `Quality`", "did you mean `quality`?"),
        ("[bake]\nangle = 3", "scene.toml:5:1", "unknown key `angle`", "did you mean `normal_angle_deg`?"),
        ("[bake]\nzzz = 3", "scene.toml:5:1", "unknown key `zzz`", "known here: quality, edge_length"),
        ("[[enviroment]]\nname = \"a\"", "scene.toml:4:3", "unknown key `enviroment`", "did you mean `environment`?"),
        ("[bake]\ntechnique = \"vmf_tranfer\"", "scene.toml:5:13", "unknown name `vmf_tranfer`", "did you mean `vmf_transfer`?"),
        ("[[object]]\nmatch = \"a\"\ntechnique = \"haar\"", "scene.toml:6:13", "unknown name `haar`", "known here: auto, block_product"),
        ("[bake.vmf_transfer]\nbounce = 2", "scene.toml:5:1", "unknown key `bounce`", "did you mean `bounces`?"),
        ("[bake]\nquality = \"mediun\"", "scene.toml:5:11", "unknown name `mediun`", "did you mean `medium`?"),
        ("[[object]]\nmatch = \"a\"\nvisibility = \"grey6\"", "scene.toml:6:14", "unknown name `grey6`", "did you mean `gray6`?"),
        ("[[material]]\nmatch = \"a\"\nbrdf = { wart = { } }", "scene.toml:6:10", "unknown name `wart`", "did you mean `ward`?"),
        ("[limits]\nmemroy = \"1GiB\"", "scene.toml:5:1", "unknown key `memroy`", "did you mean `memory`?"),
    ];
    for (lines, place, what, help) in cases {
        let message = refused(&with(lines));
        assert!(message.starts_with(&format!("{place}: ")), "{lines}: {message}");
        assert!(message.contains(what), "{lines}: {message}");

        assert!(message.contains(help), "{lines}: {message}");
    }
}

#[test]
fn values_out_of_range_name_field_place_and_what_may_stand_there() {
    let cases = [
        ("[bake]\nedge_length = 0", "bake.edge_length = 0"),
        ("[bake]\nedge_length = \"-3cm\"", "bake.edge_length = -0.03"),
        ("[bake]\nedge_length = -1.5", "bake.edge_length = -1.5"),
        ("[bake]\nedge_length = nan", "bake.edge_length = NaN"),
        ("[bake]\nedge_length = inf", "bake.edge_length = inf"),
        ("[bake]\nmax_error = 2", "bake.max_error = 2"),
        ("[bake]\nnormal_angle_deg = 0.5", "bake.normal_angle_deg = 0.5"),
        ("[bake]\nsmooth_angle_deg = -1", "bake.smooth_angle_deg = -1"),
        ("[[object]]\nmatch = \"a\"\nsmooth_angle_deg = 181", "object[0].smooth_angle_deg = 181"),
        ("[bake]\narea_floor = 0", "bake.area_floor = 0"),
        ("[bake]\nbounces = 0", "bake.bounces = 0"),
        ("[bake.vmf_transfer]\nbounces = 65", "bake.vmf_transfer.bounces = 65"),
        ("[bake]\nface_resolution = 100", "bake.face_resolution = 100"),
        ("[limits]\nmemory = 17", "limits.memory = 17 B"),
        ("[[object]]\nmatch = \"\"", "object[0].match = \"\""),
        ("[[object]]\nmatch = \"a\"\nedge_length = 1e30", "object[0].edge_length = 1"),
        ("[[material]]\nmatch = \"a\"\nroughness = 1.1", "material[0].roughness = 1.1"),
        ("[[material]]\nmatch = \"a\"\nbase_color = [1, 1]", "material[0].base_color = [1.0, 1.0]"),
        ("[[material]]\nmatch = \"a\"\nbase_color = [1, 1, 2]", "material[0].base_color"),
        ("[[material]]\nmatch = \"a\"\nemissive = [1, 1, -2]", "material[0].emissive"),
        ("[[environment]]\nname = \"a\"\nimage = \"\"", "environment[0].image"),
        ("[[environment]]\nname = \"a\"\nimage = \"b\"\nintensity = -1", "environment[0].intensity = -1"),
        ("[[environment]]\nname = \"a\"\nimage = \"b\"\n[[environment]]\nname = \"a\"\nimage = \"c\"", "environment[1].name = \"a\""),
    ];
    for (lines, what) in cases {
        let text = with(lines);
        let error = SceneManifest::parse("scene.toml", &text).expect_err(lines);
        assert!(matches!(error, ManifestError::Range { .. }), "{lines}: {error:?}");
        let message = error.to_string();
        assert!(message.contains(what) && message.contains(", expected "), "{lines}: {message}");
        // The place is that of the value: the last line of the case that is not empty.
        let (line, column) = (text.trim_end().lines().count(), text.trim_end().lines().last().unwrap().find("= "));
        if !lines.contains("name = \"a\"\nimage = \"c\"") {
            assert!(message.starts_with(&format!("scene.toml:{line}:{}: ", column.unwrap() + 3)), "{lines}: {message}");
        }
    }
}

#[test]
fn what_this_build_cannot_do_is_named_with_a_way_out() {
    let cases = [
        ("format = 1\n[scene]\n".to_string(), "[scene] names no file"),
        (with("[bake]\nbounces = 2\n[bake.vmf_transfer]\nbounces = 3"), "`bounces` is 2 in [bake] and 3 in [bake.vmf_transfer]"),
        ("format = 1\n[scene]\nvariant = \"b\"\n".to_string(), "a variant of parts"),
        ("format = 1\n[scene]\ngltf = \"a\"\n[[scene.part]]\ngltf = \"b\"\nname = \"c\"\n".to_string(), "both `gltf` and `part`"),
    ];
    for (text, what) in cases {
        let error = SceneManifest::parse("scene.toml", &text).expect_err(&text);
        assert!(matches!(error, ManifestError::Unsupported { .. }), "{error:?}");
        assert!(error.to_string().contains(what) && error.to_string().contains("help: "), "{error}");
    }
}

#[test]
fn parts_have_places_and_names_of_their_own() {
    let parts = |second: &str| format!("format = 1\n[[scene.part]]\ngltf = \"rooms/a.b.glb\"\n[[scene.part]]\n{second}\n");
    let read = |second: &str| SceneManifest::parse("scene.toml", &parts(second));
    let manifest =
        read("gltf = \"rooms/a.b.glb\"\nname = \"twin\"\ntranslate = [1, 0, -2.5]\nrotate_deg = [-90, 0, 0]\nscale = 1e-3").unwrap();
    let [first, twin] = &manifest.scene.part[..] else { panic!() };
    assert_eq!((first.name(), first.translate, first.rotate_deg, first.scale), ("a.b", [0.0; 3], [0.0; 3], 1.0));
    assert_eq!((twin.name(), twin.translate, twin.rotate_deg, twin.scale), ("twin", [1.0, 0.0, -2.5], [-90.0, 0.0, 0.0], 0.001));
    assert_eq!(serde_json::from_slice::<SceneManifest>(&manifest.canonical()).unwrap(), manifest);

    let cases = [
        ("gltf = \"x/a.b.gltf\"", "scene.toml:5:8: scene.part[1].gltf = \"a.b\", expected a `name` in this part"),
        ("gltf = \"c.glb\"\nname = \"a.b\"", "scene.toml:6:8: scene.part[1].name = \"a.b\", expected a name that no part before it has"),
        ("gltf = \"c.glb\"\nname = \"a/b\"", "scene.part[1].name = \"a/b\", expected a name without `/`"),
        ("gltf = \"c.glb\"\nname = \"\"", "scene.part[1].name = \"\""),
        ("gltf = \"\"", "scene.part[1].gltf = \"\""),
        ("gltf = \"c.glb\"\ntranslate = [0, nan, 0]", "scene.toml:6:13: scene.part[1].translate = [0.0, NaN, 0.0]"),
        ("gltf = \"c.glb\"\nrotate_deg = [0, 1e9, 0]", "scene.part[1].rotate_deg"),
        ("gltf = \"c.glb\"\nscale = 0", "scene.toml:6:9: scene.part[1].scale = 0"),
        ("gltf = \"c.glb\"\nscale = -1", "scene.part[1].scale = -1"),
        ("gltf = \"c.glb\"\nrotate = [0, 1, 0]", "did you mean `rotate_deg`?"),
        ("name = \"c\"", "missing field `gltf`"),
    ];
    for (second, words) in cases {
        let message = refused(&parts(second));
        assert!(message.contains(words), "{second}: {message}");
    }
}

#[test]
fn versions_are_looked_at_before_keys() {
    let newer = refused("format = 2\n[scene]\ngltf = \"a\"\nportal = 1\n");
    assert!(newer.contains("format 2") && newer.contains("newer prelight"), "{newer}");
    assert!(refused("[scene]\ngltf = \"a\"\n").contains("`format = 1`"));
    assert!(refused("format = 0\n[scene]\ngltf = \"a\"\n").contains("format = 0, expected 1"));
    assert!(refused("format = \"one\"\n").starts_with("scene.toml:1:10: "));
}

#[test]
fn text_that_is_no_manifest_is_refused_with_a_place() {
    for (text, place) in [
        ("", "scene.toml:1:1: "),
        ("format = 1\n[scene\n", "scene.toml:2:"),
        ("format = 1\nformat = 1\n", "scene.toml:2:1: "),
        ("glTF\u{0}\u{1}binary", "scene.toml:1:"),
        ("format = 1\n", "scene.toml:1:1: "),
        ("format = 1\n[scene]\ngltf = 3\n", "scene.toml:3:8: "),
        ("format = 1\n# é é é\n[scene]\ngltf = \"é\", x\n", "scene.toml:4:11: "),
    ] {
        let message = refused(text);
        assert!(message.starts_with(place), "{text:?}: {message}");
        assert!(message.lines().count() <= 2, "{message}");
    }
    // Deep nesting must neither crash nor hang.
    assert!(refused(&format!("format = 1\nx = {}", "[".repeat(100_000))).starts_with("scene.toml:2:"));
    assert!(refused(&format!("format = 1\n[{}a]\n", "a.".repeat(100_000))).starts_with("scene.toml:"));
}

#[test]
fn canonical_form_depends_on_values_only() {
    let one = SceneManifest::parse("a", &with("[bake]\nquality = \"high\"\nedge_length = 0.5")).unwrap();
    let other = SceneManifest::parse("b", &with("# note\nbake.edge_length = 5e-1 # half\nbake.quality = 'high'")).unwrap_err();
    assert!(other.to_string().contains("unknown key `bake`"), "dotted keys after [scene] belong to it: {other}");
    let text =
        "bake.edge_length = 5e-1 # half\nbake.technique = 'auto'\nbake.quality = 'high'\nformat = 1\nscene.gltf = \"\"\"a.glb\"\"\"\n";
    let other = SceneManifest::parse("b", text).unwrap();
    assert_eq!(String::from_utf8(one.canonical()), String::from_utf8(other.canonical()));
    let changed = SceneManifest::parse("a", &with("[bake]\nquality = \"high\"\nedge_length = 0.25")).unwrap();
    assert_ne!(one.canonical(), changed.canonical());
    let back: SceneManifest = serde_json::from_slice(&one.canonical()).unwrap();
    assert_eq!(back, one);
}

#[test]
fn bounces_are_read_at_their_old_place_too() {
    let places = ["[bake]\nbounces = 3", "[bake.vmf_transfer]\nbounces = 3", "[bake]\nbounces = 3\n[bake.vmf_transfer]\nbounces = 3"];
    let read = places.map(|lines| SceneManifest::parse("scene.toml", &with(lines)).unwrap());
    assert_eq!(read[0].bake.vmf_transfer.bounces, Some(3));
    assert!(read.iter().all(|manifest| *manifest == read[0] && manifest.canonical() == read[0].canonical()));
}

const CONSTANT: TechniqueInfo =
    TechniqueInfo { name: "constant", factors: &[ChunkKind::custom("toy:constant")], summary: "One light.", paper: "" };

#[test]
fn a_technique_from_outside_is_known_where_it_was_added() {
    let text = with("[bake]\ntechnique = \"constant\"");
    let manifest = SceneManifest::parse_with("scene.toml", &text, &Techniques::built_in().with(CONSTANT)).unwrap();
    assert_eq!(manifest.bake.technique, Technique::named("constant"));
    assert!(refused(&text).contains("unknown name `constant`"));
}

#[test]
fn a_bare_gltf_means_the_empty_manifest_for_it() {
    assert_eq!(SceneManifest::for_gltf("a.glb"), SceneManifest::parse("scene.toml", &with("")).unwrap());
}

#[test]
fn examples_parse() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let mut n_examples = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let text = std::fs::read_to_string(&path).unwrap();
        SceneManifest::parse(&path.display().to_string(), &text).unwrap();
        n_examples += 1;
    }
    assert!(n_examples >= 3, "examples are missing");
}

#[test]
fn the_template_parses_as_it_is_and_with_its_comments_taken_off() {
    let odd = Template {
        gltf: "rooms/My \"room\" \\ 1\n.glb".into(),
        edge_length: Some(0.05),
        edge_length_reason: "about 200 000 points\nreally".into(),
        materials: vec!["Glass [clear]*\n\"x\"".into()],
        objects: vec!["root/Sofa\\{1}".into()],
    };
    for template in [Template { gltf: "a.glb".into(), ..Template::default() }, odd] {
        let text = template.text();
        let plain = SceneManifest::parse("scene.toml", &text).unwrap_or_else(|error| panic!("{error}\n{text}"));
        assert_eq!(plain.bake.edge_length, template.edge_length);
        let uncommented: Vec<&str> = text.lines().map(|line| uncomment(line).unwrap_or(line)).collect();
        let all = SceneManifest::parse("scene.toml", &uncommented.join("\n")).unwrap_or_else(|error| panic!("{error}\n{text}"));
        assert_eq!((all.environment.len(), all.material.len(), all.object.len()), (1, 1, 1));
        assert_eq!(all.bake.knobs(), plain.bake.knobs(), "comments must show the defaults");
        assert!(all.limits.memory.is_some() && all.bake.vmf_transfer.bounces == Some(1));
    }
}

/// `# key = value` and `# [table]` without the `# `.
fn uncomment(line: &str) -> Option<&str> {
    let rest = line.strip_prefix("# ")?;
    let key = rest.split(" = ").next().filter(|key| *key != rest && key.bytes().all(|b| b.is_ascii_lowercase() || b == b'_'));
    (key.is_some() || rest.starts_with('[')).then_some(rest)
}

#[test]
fn schema_knows_every_key_and_forbids_others() {
    let schema = schema();
    assert_eq!(schema["additionalProperties"], false);
    for key in ["format", "scene", "environment", "bake", "material", "object", "limits"] {
        assert!(schema["properties"][key].is_object(), "{key}");
        assert!(schema["properties"][key]["description"].is_string(), "{key} has no description");
    }
    let bake = &schema["$defs"]["BakeSection"]["properties"];
    for key in [
        "quality",
        "edge_length",
        "max_error",
        "technique",
        "bounces",
        "normal_angle_deg",
        "area_floor",
        "face_resolution",
        "visibility",
        "bvh",
        "vmf_transfer",
    ] {
        assert!(bake[key].is_object(), "{key}");
    }
    assert!(schema["$defs"]["VmfTransferSection"]["properties"]["bounces"]["description"].is_string());
    let techniques = schema["$defs"]["Technique"]["oneOf"].as_array().unwrap();
    let names: Vec<&str> = techniques.iter().map(|one| one["const"].as_str().unwrap()).collect();
    assert_eq!(names, ["auto", "block_product", "vmf_transfer"]);
    assert!(schema["$defs"]["MaterialRule"]["properties"]["match"].is_object());
    assert!(schema["$defs"]["ObjectRule"]["properties"]["visibility"].is_object());
    assert_eq!(schema.to_string(), super::schema().to_string());
}

#[test]
fn places_count_characters_and_lines_from_one() {
    assert_eq!(line_column("", 0), (1, 1));
    assert_eq!(line_column("a\nbc", 3), (2, 2));
    assert_eq!(line_column("é é", 3), (1, 3));
    assert_eq!(line_column("é", 1), (1, 1), "inside a character");
    assert_eq!(line_column("a\r\nb", 99), (2, 2));
}

#[test]
fn nearest_word_is_near_or_none() {
    let known = ["edge_length", "quality", "bvh"];
    for (found, near) in [("edgelength", Some("edge_length")), ("length", Some("edge_length")), ("bhv", Some("bvh")), ("colour", None)] {
        assert_eq!(nearest(found, &known), near, "{found}");
    }
    assert_eq!(nearest("x", &[]), None);
}

#[test]
fn surfaces_that_return_more_than_they_get_or_have_no_width_are_refused() {
    let brdf = "[[material]]\nmatch = \"a\"\nbrdf = { ward = { diffuse = [0.1,0.1,0.1], specular = [0.3,0.3,0.3], alpha = [0.08, 0.25] } }";
    assert!(SceneManifest::parse("scene.toml", &with(brdf)).is_ok());
    let cases = [
        ("0.08", "0.0", "0.001..=1"),
        ("0.25", "1.5", "0.001..=1"),
        ("[0.3,0.3,0.3]", "[0.95,0.3,0.3]", "at most 1 per channel"),
        ("[0.1,0.1,0.1]", "[0.1,-0.1,0.1]", "three numbers in 0..=1"),
    ];
    for (from, to, what) in cases {
        let error = SceneManifest::parse("scene.toml", &with(&brdf.replace(from, to))).expect_err(to);
        assert!(matches!(error, ManifestError::Range { .. }) && error.to_string().contains(what), "{error}");
    }
}

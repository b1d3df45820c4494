use super::*;
use crate::{Dtype, TechniqueInfo};
use serde_json::{Value, json};

fn descriptor(kind: ChunkKind, seed: u8) -> Descriptor {
    Descriptor { kind, digest: Digest([seed; 32]), bytes: 64, dtype: Dtype::U8, shape: vec![64] }
}

fn patch(n_points: u32, seed: u8) -> AssetPatch {
    AssetPatch {
        n_points,
        points: descriptor(ChunkKind::Points, seed),
        surface: descriptor(ChunkKind::Surface, seed + 1),
        factors: vec![descriptor(ChunkKind::Visibility, seed + 2)],
    }
}

fn object(name: &str, seed: u8) -> AssetObject {
    AssetObject {
        name: name.into(),
        technique: "block_product".into(),
        n_points: 300,
        n_triangles: 2,
        base: descriptor(ChunkKind::Base, seed + 8),
        world_from_local: [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.1, -0.25, 1e-300, 1.0],
        edge_length: 0.05,
        mesh: descriptor(ChunkKind::Mesh, seed),
        patches: vec![patch(256, seed + 1), patch(44, seed + 4)],
        moves: None,
    }
}

fn manifest() -> AssetManifest {
    AssetManifest {
        format: version::ASSET_FORMAT,
        asset_digest: Digest([7; 32]),
        content: AssetContent {
            algorithm_version: 1,
            face_resolution: 64,
            objects: vec![object("root/Sofa", 10), object("root/Sofa#2", 30)],
            materials: descriptor(ChunkKind::Materials, 1),
            textures: vec![descriptor(ChunkKind::Texture, 2)],
            brdfs: Vec::new(),
            cameras: descriptor(ChunkKind::Cameras, 3),
            names: descriptor(ChunkKind::Names, 4),
            bounds: [[-1.5, 0.0, 0.1], [2.0, 3.4028235e38, 1e-40]],
            origin: [0.0; 3],
        },
        report: BTreeMap::from([("seconds".into(), json!({ "total": 1.25 }))]),
    }
}

#[test]
fn text_round_trips_bit_by_bit() {
    let manifest = manifest();
    let text = manifest.to_text();
    let back = AssetManifest::parse("a", &text).unwrap();
    assert_eq!(back, manifest);
    assert_eq!(back.content.canonical(), manifest.content.canonical());
    assert_eq!(back.to_text(), text);
    assert!(text.ends_with("}\n"));
}

#[test]
fn canonical_form_holds_the_content_and_only_that() {
    let one = manifest();
    let mut other = one.clone();
    other.report.insert("machine".into(), "another".into());
    other.asset_digest = Digest([0; 32]);
    assert_eq!(one.content.canonical(), other.content.canonical());
    other.content.objects[1].patches[0].factors[0].digest = Digest([99; 32]);
    assert_ne!(one.content.canonical(), other.content.canonical());
    let canonical = String::from_utf8(one.content.canonical()).unwrap();
    assert!(canonical.starts_with("{\"algorithm_version\":1,\"face_resolution\":64,\"objects\":[{\"name\":\"root/Sofa\""), "{canonical}");
    assert!(!canonical.contains(' '));
}

#[test]
fn descriptors_name_every_chunk_in_a_fixed_order() {
    let manifest = manifest();
    let seeds: Vec<u8> = manifest.content.descriptors().map(|descriptor| descriptor.digest.0[0]).collect();
    let objects = [10u8, 30].into_iter().flat_map(|mesh| std::iter::once(mesh + 8).chain(mesh..mesh + 7));
    assert_eq!(seeds, [1, 3, 4, 2].into_iter().chain(objects).collect::<Vec<u8>>());
    // Every digest of the text is one of them, but for the asset's own.
    let text = serde_json::to_string(&manifest.content).unwrap();
    assert_eq!(text.matches("\"digest\"").count(), seeds.len());
}

#[test]
fn wrong_content_is_refused_with_the_field_that_is_wrong() {
    let cases: [(&str, Value, &str); 15] = [
        ("/content/face_resolution", json!(65), "content.face_resolution = 65, expected 64 or 128"),
        ("/content/objects/1/name", json!("root/Sofa"), "content.objects[1].name"),
        ("/content/objects/0/n_points", json!(301), "content.objects[0].n_points = 301, expected 300"),
        ("/content/objects/0/patches/1/n_points", json!(0), "content.objects[0].patches[1].n_points = 0, expected 1..=256"),
        ("/content/objects/0/patches/1/n_points", json!(257), "content.objects[0].patches[1].n_points = 257"),
        ("/content/objects/0/technique", json!("square_light"), "technique `square_light` is not in this build, which has: block_product"),
        (
            "/content/objects/0/technique",
            json!("vmf_transfer"),
            "patches[0].factors[1].kind = none, expected transfer: vmf_transfer has visibility, transfer",
        ),
        ("/content/objects/0/technique", json!("auto"), "technique `auto`"),
        ("/content/objects/0/mesh/kind", json!("points"), "content.objects[0].mesh.kind = points, expected mesh"),
        ("/content/objects/1/patches/0/factors/0/kind", json!("image"), "content.objects[1].patches[0].factors[0].kind = image, expected"),
        ("/content/objects/1/patches/1/factors", json!([]), "patches[1].factors[0].kind = none, expected visibility"),
        ("/content/textures/0/kind", json!("mesh"), "content.textures[0].kind = mesh, expected texture"),
        ("/content/objects/0/base/kind", json!("mesh"), "content.objects[0].base.kind = mesh, expected base"),
        ("/content/objects/1/edge_length", json!(0.0), "content.objects[1].edge_length = 0, expected a finite length above 0"),
        ("/format", json!(3), "room.prelight.json has format 3, this build reads up to 2\n  help: use a newer prelight"),
    ];
    for (pointer, value, words) in cases {
        let mut json: Value = serde_json::from_str(&manifest().to_text()).unwrap();
        *json.pointer_mut(pointer).expect(pointer) = value;
        let error = AssetManifest::parse("room.prelight.json", &json.to_string()).expect_err(pointer).to_string();
        assert!(error.contains("room.prelight.json") && error.contains(words), "{pointer}: {error}");
    }
}

/// A manifest of both techniques.
fn with_transfer() -> AssetManifest {
    let mut manifest = manifest();
    let object = &mut manifest.content.objects[1];
    object.technique = "vmf_transfer".into();
    for (patch, seed) in object.patches.iter_mut().zip(50..) {
        patch.factors.push(descriptor(ChunkKind::Transfer, seed));
    }
    manifest
}

#[test]
fn factors_must_be_those_of_the_technique_in_its_order() {
    let manifest = with_transfer();
    let back = AssetManifest::parse("a", &manifest.to_text()).unwrap();
    assert_eq!(back, manifest);
    let patch = &back.content.objects[1].patches[0];
    assert_eq!(patch.factor(ChunkKind::Transfer).unwrap().digest, Digest([50; 32]));
    assert_eq!(back.content.objects[0].patches[0].factor(ChunkKind::Transfer), None);

    let refused = |change: &dyn Fn(&mut Vec<Descriptor>)| {
        let mut manifest = with_transfer();
        change(&mut manifest.content.objects[1].patches[0].factors);
        AssetManifest::parse("a", &manifest.to_text()).expect_err("wrong factors").to_string()
    };
    let swapped = refused(&|factors| factors.swap(0, 1));
    assert!(swapped.contains("factors[0].kind = transfer, expected visibility: vmf_transfer has visibility, transfer"), "{swapped}");
    let doubled = refused(&|factors| factors.push(factors[1].clone()));
    assert!(doubled.contains("factors[2].kind = transfer, expected none"), "{doubled}");
}

#[test]
fn a_technique_from_outside_is_read_where_it_was_added() {
    const CONSTANT: ChunkKind = ChunkKind::custom("toy:constant");
    let mut manifest = manifest();
    manifest.content.objects[0].technique = "constant".into();
    manifest.content.objects[0].patches.iter_mut().for_each(|patch| patch.factors[0].kind = CONSTANT);
    let text = manifest.to_text();
    let refused = AssetManifest::parse("a", &text).expect_err("unknown").to_string();
    assert!(refused.contains("technique `constant` is not in this build"), "{refused}");
    let toy = TechniqueInfo { name: "constant", factors: &[CONSTANT], summary: "One light.", paper: "" };
    assert_eq!(AssetManifest::parse_with("a", &text, &Techniques::built_in().with(toy)).unwrap(), manifest);
}

#[test]
fn format_1_is_read_and_written_as_it_was() {
    let manifest = AssetManifest { format: 1, ..with_transfer() };
    let text = manifest.to_text();
    assert!(!text.contains("factors"), "{text}");
    let json: Value = serde_json::from_str(&text).unwrap();
    let patch = &json["content"]["objects"][1]["patches"][0];
    assert_eq!((&patch["visibility"]["kind"], &patch["transfer"]["kind"]), (&json!("visibility"), &json!("transfer")));
    assert!(json["content"]["objects"][0]["patches"][0].get("transfer").is_none());

    let back = AssetManifest::parse("a", &text).unwrap();
    assert_eq!(back, manifest, "the same values, and it remembers its format");
    assert_eq!((back.to_text(), back.canonical()), (text.clone(), manifest.canonical()));
    // Hashed as it stands in the file, without spaces.
    let content = String::from_utf8(back.canonical()).unwrap();
    assert_eq!(serde_json::from_str::<Value>(&content).unwrap(), json["content"]);
    assert!(content.starts_with("{\"algorithm_version\":1,\"face_resolution\":64,\"objects\":[{\"name\":\"root/Sofa\""), "{content}");
    assert_ne!(back.canonical(), with_transfer().canonical(), "the formats are hashed apart");

    let mut wrong = json.clone();
    wrong["content"]["objects"][0]["technique"] = json!("vmf_transfer");
    let error = AssetManifest::parse("a", &wrong.to_string()).expect_err("no transfer").to_string();
    assert!(error.contains("content.objects[0].patches[0].transfer.kind = none, expected transfer"), "{error}");
    for format in [1, 2] {
        let text = AssetManifest { format, ..manifest.clone() }.to_text();
        let mislabelled = text.replacen(&format!("\"format\": {format}"), &format!("\"format\": {}", 3 - format), 1);
        let error = AssetManifest::parse("a", &mislabelled).expect_err("the other format's patches");
        assert!(matches!(error, ManifestError::Syntax { .. }), "{error}");
    }
}

#[test]
fn text_that_is_no_asset_is_refused_with_a_place() {
    let whole = manifest().to_text();
    let cut: String = whole.chars().take(whole.len() / 2).collect();
    let mut extra: Value = serde_json::from_str(&whole).unwrap();
    extra["content"]["extra"] = json!(1);
    let mut digest: Value = serde_json::from_str(&whole).unwrap();
    digest["asset_digest"] = json!("12");
    let deep = format!("{{\"format\":1,\"x\":{}", "[".repeat(100_000));
    for text in
        ["", "[]", "{}", "{\"format\":-1}", "{\"format\":1}", "{\"format\":2}", &cut, &extra.to_string(), &digest.to_string(), &deep]
    {
        let error = AssetManifest::parse("a.json", text).expect_err(text);
        assert!(matches!(error, ManifestError::Syntax { .. }), "{error:?}");
        assert!(error.to_string().starts_with("a.json:"), "{error}");
    }
}

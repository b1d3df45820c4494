//! A technique that no crate of this repository knows: its chunks go through ledger, manifest and pack, and an asset of it opens where it
//! was added.

use prelight_bake::bake::bake;
use prelight_bake::progress::Silent;
use prelight_manifests::{AssetManifest, ChunkKind, Dtype, TechniqueInfo, Techniques};
use prelight_runtime::asset::{Asset, OpenOptions, PatchFacts};
use prelight_runtime::error::RuntimeError;
use prelight_store::{AssetPackWriter, ChunkSource, FormChoice, Record, Store, digest_of};
use prelight_tests::{options, quad, scene};

/// The same light at every point: one RGB radiance a patch, f32.
const LIGHT: ChunkKind = ChunkKind::custom("toy:constant");

const CONSTANT: TechniqueInfo = TechniqueInfo { name: "constant", factors: &[LIGHT], summary: "The same light at every point.", paper: "" };

fn is_light(bytes: &[u8], _: PatchFacts) -> Result<(), RuntimeError> {
    if bytes.len() == 12 {
        return Ok(());
    }
    Err(RuntimeError::Chunk { kind: "toy:constant", digest: String::new(), what: "not three floats".to_string() })
}

fn with_constant() -> OpenOptions {
    OpenOptions::new().technique(CONSTANT).proof(LIGHT, is_light)
}

/// Bakes two sheets and gives the second `light` in place of its visibility.
fn manifest_of(store: &Store, light: &[u8]) -> AssetManifest {
    let scene = scene(vec![
        ("floor", quad([0.0; 3], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], 0)),
        ("board", quad([0.2, 0.3, 0.2], [0.0, 0.0, 0.3], [0.3, 0.0, 0.0], 0)),
    ]);
    let baked = bake(&scene, &options(&scene, 0.5), store, &Silent).unwrap();
    let mut manifest = baked.seal(Default::default(), store).unwrap();
    let mut writer = store.writer();
    let chunk = writer.put(LIGHT, Dtype::F32, vec![3], light).unwrap();
    let key = digest_of(b"everything that constant light depends on");
    writer.record(key, Record { chunks: vec![chunk.clone()], data: Vec::new() });
    writer.commit().unwrap();
    assert_eq!(store.lookup(&key).unwrap().unwrap().chunks, std::slice::from_ref(&chunk), "the ledger keeps kinds that it does not know");
    let board = &mut manifest.content.objects[1];
    board.technique = CONSTANT.name.to_string();
    board.patches.iter_mut().for_each(|patch| patch.factors = vec![chunk.clone()]);
    manifest.asset_digest = digest_of(&manifest.canonical());
    store.seal(manifest.asset_digest, manifest.to_text().as_bytes()).unwrap();
    manifest
}

#[test]
fn an_asset_of_a_technique_from_outside_is_packed_and_opens_where_it_was_added() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open_or_create(folder.path().join("store")).unwrap();
    let light: Vec<u8> = [1.0f32, 0.5, 0.25].iter().flat_map(|value| value.to_le_bytes()).collect();
    let manifest = manifest_of(&store, &light);
    let path = folder.path().join("toy.prelight");
    let mut writer = AssetPackWriter::create(&path, manifest.to_text().as_bytes()).unwrap();
    for descriptor in manifest.content.descriptors() {
        writer.add(&store.chunk(descriptor).unwrap(), FormChoice::Auto).unwrap();
    }
    writer.finish().unwrap();

    let refused = Asset::open_file(&path, None).expect_err("an unknown technique").to_string();
    assert!(refused.contains("technique `constant` is not in this build, which has: block_product, vmf_transfer"), "{refused}");
    let unproved = OpenOptions::new().technique(CONSTANT).open_file(&path, None).expect_err("no proof").to_string();
    assert!(unproved.contains("toy:constant"), "{unproved}");

    let asset = with_constant().open_file(&path, None).unwrap();
    assert_eq!(asset.manifest(), &manifest);
    for (object, kind) in asset.objects().iter().zip([ChunkKind::Visibility, LIGHT]) {
        let patch = &asset.patches()[object.patches.start];
        assert_eq!(patch.kinds().collect::<Vec<_>>(), [kind]);
        assert_eq!(patch.factor(LIGHT), (kind == LIGHT).then_some(&light[..]));
    }
    let text = manifest.to_text();
    assert!(AssetManifest::parse("toy", &text).is_err());
    assert_eq!(AssetManifest::parse_with("toy", &text, &Techniques::built_in().with(CONSTANT)).unwrap(), manifest);
}

#[test]
fn a_chunk_that_its_proof_refuses_is_named_with_its_digest() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open_or_create(folder.path()).unwrap();
    let manifest = manifest_of(&store, b"no light");
    let error = with_constant().open(manifest, &store).expect_err("eight bytes").to_string();
    assert!(error.contains("not three floats") && error.contains(&digest_of(b"no light").short()), "{error}");
}

//! A technique that no crate of ours knows, through public extension points alone: constant light at every point is baked, recorded, sealed,
//! packed, opened and drawn.

use prelight_bake::bake::{BakeOptions, Baked, bake};
use prelight_bake::error::BakeError;
use prelight_bake::factor::plain::Plain;
use prelight_bake::factor::{ObjectFactor, SceneFactors, SceneInputs, Tally, Technique};
use prelight_bake::points::surface::ObjectSurfaces;
use prelight_bake::points::{ObjectPlan, Patch as PlannedPatch};
use prelight_bake::progress::Silent;
use prelight_manifests::{AssetManifest, ChunkKind, Digest, TechniqueInfo};
use prelight_runtime::asset::{Asset, OpenOptions, PatchFacts};
use prelight_runtime::draw::FrameOptions;
use prelight_runtime::draw::camera::Camera;
use prelight_runtime::environment::{LightCubemap, sky};
use prelight_runtime::error::RuntimeError;
use prelight_runtime::light::layer::{Corners, Diffuse, Held, Layer, Patch, Remembered, Rows, Sight};
use prelight_runtime::light::{Glossy, PointLobe};
use prelight_runtime::relight::{Relighter, Techniques};
use prelight_scene::Scene;
use prelight_store::{AssetPackWriter, Chunk, ChunkSource, FormChoice, Store, digest_of};
use prelight_tests::{baked_asset, options, still_life};
use std::path::Path;
use std::sync::Arc;

/// How much of the mean flux each point of a patch has, one f32 a patch.
const SHARE: ChunkKind = ChunkKind::custom("toy:share");

const CONSTANT: TechniqueInfo =
    TechniqueInfo { name: "constant", factors: &[ChunkKind::Visibility, SHARE], summary: "The same light at every point.", paper: "" };

/// The bake's half: a share for all objects but the first, which stays `block_product`.
#[derive(Debug)]
struct Share(f32);

impl Technique for Share {
    fn name(&self) -> &str {
        CONSTANT.name
    }

    fn takes(&self, object: u32) -> bool {
        object > 0
    }

    fn begin<'a>(&'a self, _: &'a SceneInputs<'a>) -> Box<dyn SceneFactors + 'a> {
        Box::new(ShareOfScene(self.0))
    }
}

struct ShareOfScene(f32);

impl SceneFactors for ShareOfScene {
    fn object<'b>(&'b self, plan: &'b ObjectPlan, _: &'b ObjectSurfaces) -> Vec<Box<dyn ObjectFactor + 'b>> {
        vec![Box::new(ShareOfObject(self.0, plan.object))]
    }
}

/// A share, and the object that has it.
struct ShareOfObject(f32, u32);

impl ObjectFactor for ShareOfObject {
    fn kind(&self) -> ChunkKind {
        SHARE
    }

    fn key(&self, patch: &PlannedPatch) -> Digest {
        digest_of(format!("toy:share {} {} {}", self.0, self.1, patch.first).as_bytes())
    }

    fn bake(&self, _: &PlannedPatch) -> Result<(Vec<u8>, Plain), BakeError> {
        let mut tally = Tally::default();
        tally.add("shares", 1);
        Ok((self.0.to_le_bytes().to_vec(), Plain { tally, ..Plain::default() }))
    }

    fn fits(&self, _: &PlannedPatch, chunk: &Chunk, data: &[u8]) -> bool {
        chunk.len() == 4 && data.is_empty()
    }
}

/// The runtime's half: the mean flux of the light, from along each point's normal; what it adds to glossy light it takes out again between points.
#[derive(Default)]
struct Constant {
    mean: f32,
}

impl Layer for Constant {
    fn remembers(&self) -> Remembered {
        Remembered { glossy: 1, ..Remembered::default() }
    }

    fn prepare(&mut self, light: &LightCubemap, _: Option<&LightCubemap>) {
        self.mean = light.flux.as_flattened().iter().sum::<f32>() / light.flux.len() as f32;
    }

    fn diffuse(&self, patch: &Patch, _: Held, _: &mut Rows, out: &mut Diffuse) {
        let share = patch.factor(SHARE).map_or(1.0, |bytes| f32::from_le_bytes(bytes.try_into().expect("proved")));
        let (irradiance, _) = out.sums();
        for (sum, normal) in irradiance.iter_mut().zip(patch.points.normal) {
            sum.iter_mut().for_each(|channel| (0..3).for_each(|axis| channel[axis] += share * self.mean * normal[axis]));
        }
    }

    fn glossy(&self, patch: &Patch, _: &Sight, rows: &mut Rows, out: &mut [Glossy]) {
        for i in 0..patch.len() {
            rows.of(i)[0] = self.mean;
            out[i].as_flattened_mut().iter_mut().for_each(|term| *term += self.mean);
        }
    }

    fn has_between(&self) -> bool {
        true
    }

    fn between(&self, corners: &Corners, _: [f32; 3], _: Option<&PointLobe>, glossy: &mut Glossy) {
        let added: f32 = (0..3).map(|k| corners.weights[k] * corners.rows[k][0]).sum();
        glossy.as_flattened_mut().iter_mut().for_each(|term| *term -= added);
    }
}

fn is_share(bytes: &[u8], _: PatchFacts) -> Result<(), RuntimeError> {
    let what = || RuntimeError::Chunk { kind: "toy:share", digest: String::new(), what: "not one float".to_string() };
    if bytes.len() == 4 { Ok(()) } else { Err(what()) }
}

fn with_constant() -> OpenOptions {
    OpenOptions::new().technique(CONSTANT).proof(SHARE, is_share)
}

fn baked(scene: &Scene, share: f32, store: &Store) -> Baked {
    let options = BakeOptions { techniques: vec![Arc::new(Share(share))], ..options(scene, 0.2) };
    bake(scene, &options, store, &Silent).unwrap()
}

fn pack(manifest: &AssetManifest, store: &Store, path: &Path) {
    let mut writer = AssetPackWriter::create(path, manifest.to_text().as_bytes()).unwrap();
    for descriptor in manifest.content.descriptors() {
        writer.add(&store.chunk(descriptor).unwrap(), FormChoice::Auto).unwrap();
    }
    writer.finish().unwrap();
}

fn lit(asset: &Arc<Asset>, techniques: Techniques) -> Relighter {
    let mut relighter = Relighter::with_techniques(asset.clone(), techniques.with(|_| Some(Box::new(Constant::default()))));
    relighter.set_light(&LightCubemap::from_environment(&sky([0.3, 0.8, 0.2]), asset.face_resolution())).unwrap();
    relighter
}

#[test]
fn a_technique_of_a_test_crate_is_baked_resumed_packed_opened_and_drawn() {
    let (scene, folder) = (still_life(), tempfile::tempdir().unwrap());
    let store = Store::open_or_create(folder.path().join("store")).unwrap();
    let first = baked(&scene, 0.5, &store);
    let techniques: Vec<&str> = first.content.objects.iter().map(|object| object.technique.as_str()).collect();
    assert_eq!(techniques, ["block_product", "constant", "constant", "constant"]);
    let patches: u64 = first.content.objects[1..].iter().map(|object| object.patches.len() as u64).sum();
    assert_eq!(first.stats.tally("constant", "shares"), patches, "each patch once, whatever the rounds");
    let again = baked(&scene, 0.5, &store);
    assert_eq!((again.asset_digest, again.stats.tally("constant", "shares")), (first.asset_digest, 0), "the ledger knows them");
    assert_ne!(baked(&scene, 0.25, &store).asset_digest, first.asset_digest);

    let manifest = first.seal(Default::default(), &store).unwrap();
    let path = folder.path().join("toy.prelight");
    pack(&manifest, &store, &path);
    let refused = Asset::open_file(&path, None).expect_err("an unknown technique").to_string();
    assert!(refused.contains("technique `constant` is not in this build, which has: block_product, vmf_transfer"), "{refused}");
    let unproved = OpenOptions::new().technique(CONSTANT).open_file(&path, None).expect_err("no proof").to_string();
    assert!(unproved.contains("toy:share"), "{unproved}");
    let asset = Arc::new(with_constant().open_file(&path, None).unwrap());

    let mut relighter = lit(&asset, Techniques::none());
    relighter.shade([1.0; 3], None).unwrap();
    let length = |point: usize| relighter.irradiance()[point][0].iter().map(|x| x * x).sum::<f32>().sqrt();
    let (floor, board) = (length(0), length(asset.objects()[1].points.start));
    assert!((board / floor - 0.5).abs() < 1e-3, "{board} of {floor}");
    let camera = Camera::upright([1.0, 1.0, 2.0], [0.0, 0.2, 0.0], 45.0).unwrap();
    let picture = |techniques| lit(&asset, techniques).frame(&camera, [32, 24], FrameOptions::default().samples(4)).unwrap().image;
    let (alone, beside) = (picture(Techniques::none()), picture(Techniques::built_in()));
    assert!(alone.pixels.iter().flatten().any(|x| *x > 0.0));
    assert!(beside.pixels.iter().zip(&alone.pixels).all(|(beside, alone)| (0..3).all(|c| beside[c] >= alone[c])));
}

#[test]
fn a_chunk_that_its_proof_refuses_is_named_with_its_digest() {
    let (scene, folder) = (still_life(), tempfile::tempdir().unwrap());
    let store = Store::open_or_create(folder.path()).unwrap();
    let mut manifest = baked(&scene, 0.5, &store).seal(Default::default(), &store).unwrap();
    let mut writer = store.writer();
    let wrong = writer.put(SHARE, prelight_manifests::Dtype::U8, vec![8], b"no float").unwrap();
    writer.commit().unwrap();
    manifest.content.objects[1].patches[0].factors[1] = wrong.clone();
    manifest.asset_digest = digest_of(&manifest.canonical());
    let error = with_constant().open(manifest, &store).expect_err("eight bytes").to_string();
    assert!(error.contains("not one float") && error.contains(&wrong.digest.short()), "{error}");
}

#[test]
fn a_technique_of_a_test_crate_lights_an_asset_alone_and_beside_those_built_in() {
    let asset = baked_asset(&still_life(), 0.1);
    let light = LightCubemap::from_environment(&sky([0.3, 0.8, 0.2]), asset.face_resolution());
    let mean = light.flux.as_flattened().iter().sum::<f32>() / light.flux.len() as f32;
    let toy = |techniques: Techniques| techniques.with(|_| Some(Box::new(Constant::default())));
    let camera = Camera::upright([1.0, 1.0, 2.0], [0.0, 0.2, 0.0], 45.0).unwrap();
    let lit = |techniques: Techniques| {
        let mut relighter = Relighter::with_techniques(asset.clone(), techniques);
        relighter.set_light(&light).unwrap();
        let frame = relighter.frame(&camera, [32, 24], FrameOptions::default().samples(4)).unwrap();
        relighter.shade(camera.eye, None).unwrap();
        (relighter.irradiance().to_vec(), relighter.glossy().to_vec(), frame)
    };
    let (alone, glossy, frame) = lit(toy(Techniques::none()));
    assert!(alone.iter().flatten().all(|e| (e.iter().map(|x| x * x).sum::<f32>().sqrt() / mean - 1.0).abs() < 1e-3));
    assert!(glossy.iter().flatten().flatten().all(|term| *term == mean));
    assert!(frame.image.pixels.iter().flatten().any(|x| *x > 0.0));
    let (known, ..) = lit(Techniques::built_in());
    let (both, ..) = lit(toy(Techniques::built_in()));
    for ((both, known), alone) in
        both.iter().flatten().flatten().zip(known.iter().flatten().flatten()).zip(alone.iter().flatten().flatten())
    {
        assert!((both - known - alone).abs() <= 1e-5 * (known.abs() + mean), "{both} {known} {alone}");
    }
    let (black, ..) = lit(Techniques::none());
    assert!(black.iter().flatten().flatten().all(|x| *x == 0.0));
}

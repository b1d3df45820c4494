//! Opening a sealed bake: every chunk fetched, verified against its digest and parsed once; what is kept is known to parse.
//!
//! Objects, patches and points are numbered through the whole asset: object `o` owns the patches `objects[o].patches`, a patch owns the
//! points `patches[p].points`.

use super::account::{Account, charge, check_repeats, list_bytes, listed_bytes, point_bytes};
use super::options::OpenOptions;
use super::proof::PatchFacts;
use crate::block_product::visibility::Visibility;
use crate::bounces::{self, Links, PatchInput, Solver};
use crate::brdf::Measured;
use crate::camera::SceneCamera;
use crate::chunk::base::{self, BasePrimitive};
use crate::chunk::mesh::Mesh;
use crate::chunk::points::Points;
use crate::chunk::surface::PointSurfaces;
use crate::error::RuntimeError;
use crate::light::layer::{Factors, Patch};
use crate::square_light::field::FieldChunk;
use crate::square_light::pose::{Pose, split};
use crate::surface::detail::has_detail;
use crate::surface::{Material, Texture};
use crate::vmf_transfer::Transfer;
use prelight_manifests::asset::{AssetContent, AssetMover};
use prelight_manifests::{AssetManifest, ChunkKind, Descriptor, Digest};
use prelight_store::{Budget, Chunk, ChunkSource};
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

/// A bake, ready to be lit.
#[derive(Debug)]
pub struct Asset {
    manifest: AssetManifest,
    materials: Vec<Material>,
    cameras: Vec<SceneCamera>,
    textures: Vec<Chunk>,
    tables: Vec<Measured>,
    objects: Vec<AssetObject>,
    patches: Vec<AssetPatch>,
    /// First nodes of the patches that links of bounced light name; empty where there are none.
    link_targets: Arc<[u32]>,
    account: Account,
}

/// An object of an open asset.
#[derive(Debug)]
pub struct AssetObject {
    /// Path of node names.
    pub name: String,
    /// Its points, in the asset's numbering.
    pub points: Range<usize>,
    /// Its patches, in the asset's numbering.
    pub patches: Range<usize>,
    /// Column-major affine transform of its base geometry.
    pub world_from_local: [f64; 16],
    /// Longest edge of its refined mesh, metres.
    pub edge_length: f32,
    /// What makes it an object that moves: its mesh and its points are in its own space then.
    pub moves: Option<Mover>,
    base: Chunk,
    mesh: Chunk,
}

/// What an object that moves has beside the others.
#[derive(Debug)]
pub struct Mover {
    /// Where the scene has it.
    pub pose: Pose,
    /// Scale along the axes of its base geometry.
    pub scale: [f64; 3],
    field: Option<Chunk>,
}

impl Mover {
    fn open(moves: &AssetMover, world_from_local: &[f64; 16], source: &dyn ChunkSource) -> Result<Mover, RuntimeError> {
        let field = moves.field.as_ref().map(|field| source.chunk(field)).transpose()?;
        if let Some((chunk, descriptor)) = field.as_ref().zip(moves.field.as_ref()) {
            FieldChunk::from_chunk(chunk).map_err(|error| named(error, descriptor))?;
        }
        let pose = split(world_from_local).map(|(pose, _)| pose).unwrap_or_default();
        Ok(Mover { pose, scale: moves.scale, field })
    }

    /// What it blocks; `None` where nothing of it does.
    pub fn field(&self) -> Option<FieldChunk<'_>> {
        self.field.as_ref().map(|chunk| FieldChunk::from_chunk(chunk).expect(PROVEN))
    }
}

/// A patch of an open asset: 1..=256 points.
#[derive(Debug)]
pub struct AssetPatch {
    /// Its points, in the asset's numbering.
    pub points: Range<usize>,
    points_chunk: Chunk,
    surfaces_chunk: Chunk,
    /// In the order of the manifest.
    factors: Vec<(ChunkKind, Chunk)>,
}

impl Asset {
    /// Fetches and proves every chunk that the manifest names.
    ///
    /// # Errors
    /// A digest of the manifest that is not that of its content; a chunk that is missing, corrupt or does not parse; counts that disagree.
    pub fn open(manifest: AssetManifest, source: &dyn ChunkSource) -> Result<Self, RuntimeError> {
        OpenOptions::default().open(manifest, source)
    }

    pub(super) fn open_with(manifest: AssetManifest, source: &dyn ChunkSource, options: &OpenOptions) -> Result<Self, RuntimeError> {
        // Who made it need not have parsed it.
        manifest.check(&format!("asset {}", manifest.asset_digest.short()), options.techniques())?;
        let digest = Digest(*blake3::hash(&manifest.canonical()).as_bytes());
        if digest != manifest.asset_digest {
            let what = format!("its content hashes to {}, the file was edited", digest.short());
            return Err(RuntimeError::Chunk { kind: "asset", digest: manifest.asset_digest.short(), what });
        }
        let content = &manifest.content;
        let refused = |what: String| RuntimeError::Chunk { kind: "asset", digest: manifest.asset_digest.short(), what };
        check_repeats(content).map_err(refused)?;
        let mut account = Account::new(options.budget_of(source));
        account.take("the manifest", listed_bytes(content))?;
        let materials: Vec<Material> = parse_json("materials", source, &content.materials, &mut account)?;
        let cameras: Vec<SceneCamera> = parse_json("cameras", source, &content.cameras, &mut account)?;
        let textures: Vec<Chunk> = content.textures.iter().map(|texture| source.chunk(texture)).collect::<Result<_, _>>()?;
        for (chunk, descriptor) in textures.iter().zip(&content.textures) {
            Texture::from_chunk(chunk).map_err(|error| named(error, descriptor))?;
        }
        let tables = open_tables(content, source, &mut account)?;
        let (mut objects, mut patches, mut wanted) = (Vec::new(), Vec::new(), Vec::new());
        let mut n_points = 0;
        for object in &content.objects {
            let (first_point, first_patch) = (n_points, wanted.len());
            for patch in &object.patches {
                wanted.push((patch, n_points..n_points + patch.n_points as usize));
                n_points += patch.n_points as usize;
            }
            let (mesh, base) = (source.chunk(&object.mesh)?, source.chunk(&object.base)?);
            let (points, patches) = (first_point..n_points, first_patch..wanted.len());
            let (name, world_from_local, edge_length) = (object.name.clone(), object.world_from_local, object.edge_length);
            let moves = object.moves.as_ref().map(|moves| Mover::open(moves, &world_from_local, source)).transpose()?;
            objects.push(AssetObject { name, points, patches, world_from_local, edge_length, moves, base, mesh });
        }
        let per_point = point_bytes(content, materials.iter().any(|m| m.normal_texture.is_some()), materials.iter().any(has_detail));
        account.take("the light at its points", per_point.saturating_mul(n_points as u64))?;
        prove_meshes(&objects, content, &mut account)?;
        let opening = Opening { options, source, face_resolution: content.face_resolution as usize, n_materials: materials.len() };
        let open = |(patch, points): &(&prelight_manifests::asset::AssetPatch, Range<usize>)| opening.patch(patch, points.clone());
        #[cfg(feature = "parallel")]
        {
            use rayon::prelude::*;
            wanted.par_iter().with_min_len(8).map(open).collect_into_vec(&mut patches);
        }
        #[cfg(not(feature = "parallel"))]
        patches.extend(wanted.iter().map(open));
        let patches = patches.into_iter().collect::<Result<Vec<AssetPatch>, RuntimeError>>()?;
        let mut asset = Asset { materials, cameras, textures, tables, objects, patches, manifest, account, link_targets: Arc::new([]) };
        super::references::check(&asset)?;
        if asset.has_links() {
            asset.link_targets = bounces::solve::resolve(&asset.bounce_inputs(), &asset.points_digests())?.into();
        }
        Ok(asset)
    }

    /// The manifest.
    pub fn manifest(&self) -> &AssetManifest {
        &self.manifest
    }

    /// Objects in the manifest's order.
    pub fn objects(&self) -> &[AssetObject] {
        &self.objects
    }

    /// Patches of all objects, object after object.
    pub fn patches(&self) -> &[AssetPatch] {
        &self.patches
    }

    /// Texels along a side of the cubemap's faces that a light must have.
    pub fn face_resolution(&self) -> usize {
        self.manifest.content.face_resolution as usize
    }

    /// Materials, as meshes and point surfaces number them.
    pub fn materials(&self) -> &[Material] {
        &self.materials
    }

    /// Where the zero of all positions (meshes, points, cameras) lies in the scene file's own space, metres: a position of the file is this
    /// plus the asset's. Zero but for scenes far from the file's zero.
    pub fn origin(&self) -> [f64; 3] {
        self.manifest.content.origin
    }

    /// Cameras of the scene.
    pub fn cameras(&self) -> &[SceneCamera] {
        &self.cameras
    }

    /// Textures, as materials number them.
    pub fn textures(&self) -> Vec<Texture<'_>> {
        self.textures.iter().map(|chunk| Texture::from_chunk(chunk).expect(PROVEN)).collect()
    }

    /// Number of textures.
    pub(crate) fn n_textures(&self) -> usize {
        self.textures.len()
    }

    /// Measured surfaces, as materials number them.
    pub fn tables(&self) -> &[Measured] {
        &self.tables
    }

    /// Points of all objects.
    pub fn n_points(&self) -> usize {
        self.objects.last().map_or(0, |object| object.points.end)
    }

    /// Whether light over other surfaces was baked for any patch.
    pub(crate) fn has_transfer(&self) -> bool {
        self.patches.iter().any(|patch| patch.factor(ChunkKind::Transfer).is_some())
    }

    /// Whether links of bounced light were baked for any patch.
    pub fn has_links(&self) -> bool {
        self.patches.iter().any(|patch| patch.factor(ChunkKind::Links).is_some())
    }

    /// A solver of bounced light; `None` where no links were baked.
    pub(crate) fn bounce_solver(&self) -> Option<Solver> {
        self.has_links().then(|| Solver::new(&self.bounce_inputs(), self.link_targets.clone()))
    }

    fn bounce_inputs(&self) -> Vec<PatchInput<'_>> {
        self.patches.iter().map(AssetPatch::bounce_input).collect()
    }

    /// `[patches]` first half of the digest of each points chunk.
    fn points_digests(&self) -> Vec<[u8; 16]> {
        let patches = self.manifest.content.objects.iter().flat_map(|object| &object.patches);
        patches.map(|patch| std::array::from_fn(|i| patch.points.digest.0[i])).collect()
    }

    /// Refined triangles of an object.
    pub fn mesh(&self, object: usize) -> Mesh<'_> {
        Mesh::from_proven_chunk(&self.objects[object].mesh)
    }

    /// Geometry of an object as its source gave it, local space.
    pub fn base(&self, object: usize) -> Vec<BasePrimitive<'_>> {
        base::from_proven_chunk(&self.objects[object].base)
    }

    /// Bytes that the chunks take in memory, mapped or not.
    pub fn resident_bytes(&self) -> u64 {
        let patches = (self.patches.iter())
            .flat_map(|patch| [&patch.points_chunk, &patch.surfaces_chunk].into_iter().chain(patch.factors.iter().map(|(_, chunk)| chunk)));
        let chunks = self.objects.iter().map(|object| &object.mesh).chain(&self.textures).chain(patches);
        chunks.map(|chunk| chunk.len() as u64).sum()
    }

    /// What opening it was charged to: for what else is made of its chunks.
    pub fn budget(&self) -> &Budget {
        self.account.budget()
    }
}

/// Most measured surfaces that are different: each is integrated when it is opened, for some milliseconds.
const MOST_TABLES: usize = 256;
/// A vertex as seen by a camera, and a triangle in the lists of the raster, bytes.
const VERTEX_BYTES: u64 = 24;
const TRIANGLE_BYTES: u64 = 16;

/// Why parsing again cannot fail.
const PROVEN: &str = "parsed when the asset was opened, and chunks never change";

/// What opening a patch reads beside the patch.
struct Opening<'a> {
    options: &'a OpenOptions,
    source: &'a dyn ChunkSource,
    face_resolution: usize,
    n_materials: usize,
}

impl Opening<'_> {
    fn patch(&self, patch: &prelight_manifests::asset::AssetPatch, points: Range<usize>) -> Result<AssetPatch, RuntimeError> {
        let points_chunk = self.source.chunk(&patch.points)?;
        let surfaces_chunk = self.source.chunk(&patch.surface)?;
        let n = points.len();
        let disagrees = |kind, descriptor: &Descriptor, what: &str| {
            Err(RuntimeError::Chunk { kind, digest: descriptor.digest.short(), what: what.to_string() })
        };
        if Points::from_chunk(&points_chunk).map_err(|error| named(error, &patch.points))?.len() != n {
            return disagrees("points", &patch.points, "holds another number of points than the manifest says");
        }
        let surfaces = PointSurfaces::from_chunk(&surfaces_chunk).map_err(|error| named(error, &patch.surface))?;
        if surfaces.roughness.len() != n || surfaces.material.iter().any(|material| *material as usize >= self.n_materials) {
            return disagrees("surface", &patch.surface, "holds another number of points, or a material that is not there");
        }
        let factors = patch.factors.iter().map(|factor| self.factor(factor, n)).collect::<Result<_, _>>()?;
        Ok(AssetPatch { points, points_chunk, surfaces_chunk, factors })
    }

    fn factor(&self, factor: &Descriptor, n_points: usize) -> Result<(ChunkKind, Chunk), RuntimeError> {
        let Some(proof) = self.options.proof_of(factor.kind) else {
            let what = format!("nothing was said to prove chunks of kind {}", factor.kind);
            return Err(RuntimeError::Chunk { kind: "factor", digest: factor.digest.short(), what });
        };
        let chunk = self.source.chunk(factor)?;
        proof(&chunk, PatchFacts { n_points, face_resolution: self.face_resolution }).map_err(|error| named(error, factor))?;
        Ok((factor.kind, chunk))
    }
}

impl AssetPatch {
    /// The patch as layers see it.
    pub fn view(&self) -> Patch<'_> {
        Patch::new(self.points(), self.surfaces(), self)
    }

    /// Where its points are.
    pub fn points(&self) -> Points<'_> {
        Points::from_proven_chunk(&self.points_chunk)
    }

    /// Averaged material parameters of its points.
    pub fn surfaces(&self) -> PointSurfaces<'_> {
        PointSurfaces::from_chunk(&self.surfaces_chunk).expect(PROVEN)
    }

    /// The proved chunk of a factor, where the object's technique has one of that kind.
    pub fn factor(&self, kind: ChunkKind) -> Option<&[u8]> {
        self.factors.iter().find(|(known, _)| *known == kind).map(|(_, chunk)| &chunk[..])
    }

    /// Kinds of its factors, in the order of the manifest.
    pub fn kinds(&self) -> impl Iterator<Item = ChunkKind> {
        self.factors.iter().map(|(kind, _)| *kind)
    }

    /// What reaches its points over other surfaces, where that was baked.
    pub fn transfer(&self) -> Option<Transfer<'_>> {
        self.factor(ChunkKind::Transfer).map(Transfer::from_proven_chunk)
    }

    /// What solving bounced light reads.
    pub(crate) fn bounce_input(&self) -> PatchInput<'_> {
        PatchInput {
            points: Points::from_proven_chunk(&self.points_chunk),
            links: self.factor(ChunkKind::Links).map(Links::from_proven_chunk),
        }
    }

    /// What its points see.
    ///
    /// # Panics
    /// When the object's technique, one from outside, has no visibility.
    pub fn visibility(&self) -> Visibility<'_> {
        Visibility::from_proven_chunk(self.factor(ChunkKind::Visibility).expect("every built-in technique has visibility"))
    }
}

impl Factors for AssetPatch {
    fn factor(&self, kind: ChunkKind) -> Option<&[u8]> {
        AssetPatch::factor(self, kind)
    }
}

/// Measured surfaces; one that is named again is made ready once.
fn open_tables(content: &AssetContent, source: &dyn ChunkSource, account: &mut Account) -> Result<Vec<Measured>, RuntimeError> {
    let mut known: BTreeMap<Digest, Measured> = BTreeMap::new();
    for descriptor in &content.brdfs {
        if known.contains_key(&descriptor.digest) {
            continue;
        }
        if known.len() == MOST_TABLES {
            let what = format!("more than {MOST_TABLES} measured surfaces");
            return Err(RuntimeError::Chunk { kind: "brdf", digest: descriptor.digest.short(), what });
        }
        account.take("a measured surface", descriptor.bytes.saturating_add(1 << 14))?;
        let table = Measured::from_chunk(&source.chunk(descriptor)?).map_err(|error| named(error, descriptor))?;
        known.insert(descriptor.digest, table);
    }
    account.take("measured surfaces", 3 * size_of::<Measured>() as u64 * content.brdfs.len() as u64)?;
    Ok(content.brdfs.iter().map(|descriptor| known[&descriptor.digest].clone()).collect())
}

/// Proves the geometry of all objects, after all of it was found, and charges what drawing it takes.
fn prove_meshes(objects: &[AssetObject], content: &AssetContent, account: &mut Account) -> Result<(), RuntimeError> {
    for (object, entry) in objects.iter().zip(&content.objects) {
        let mesh = Mesh::from_chunk(&object.mesh, entry.n_points).map_err(|error| named(error, &entry.mesh))?;
        if mesh.triangles.len() != entry.n_triangles as usize {
            let (kind, digest) = ("mesh", entry.mesh.digest.short());
            return Err(RuntimeError::Chunk { kind, digest, what: "holds another number of triangles than the manifest says".to_string() });
        }
        let primitives = base::from_chunk(&object.base).map_err(|error| named(error, &entry.base))?.len();
        let drawn = VERTEX_BYTES * mesh.position.len() as u64 + TRIANGLE_BYTES * mesh.triangles.len() as u64;
        account.take("drawing an object", drawn + (size_of::<BasePrimitive>() * primitives) as u64)?;
    }
    Ok(())
}

fn parse_json<T: serde::de::DeserializeOwned>(
    kind: &'static str,
    source: &dyn ChunkSource,
    descriptor: &Descriptor,
    account: &mut Account,
) -> Result<Vec<T>, RuntimeError> {
    let chunk = source.chunk(descriptor)?;
    // Lists that grow need more than what is left of them in the end.
    let growing = charge(account.budget(), kind, list_bytes::<T>(&chunk))?;
    let error = |error: serde_json::Error| RuntimeError::Chunk { kind, digest: descriptor.digest.short(), what: error.to_string() };
    let list: Vec<T> = serde_json::from_slice(&chunk).map_err(error)?;
    drop(growing);
    account.take(kind, 4 * size_of::<T>() as u64 * list.len() as u64 + 4 * chunk.len() as u64)?;
    Ok(list)
}

/// Adds the digest that the parser of a chunk does not know.
fn named(error: RuntimeError, descriptor: &Descriptor) -> RuntimeError {
    match error {
        RuntimeError::Chunk { kind, what, .. } => RuntimeError::Chunk { kind, digest: descriptor.digest.short(), what },
        other => other,
    }
}

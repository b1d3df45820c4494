//! The factor `transfer`: indirect light of an object's patches, one shard a patch, about a second of work.
//!
//! ```text
//! scene key = H(versions, bounces, per object: base chunk, transform, edge length; materials; textures; measured tables)
//! patch key = H(scene key, options, per point: origin, n_s, positions of its base triangles, glossy normal, roughness, material, tangent)
//! ```
//!
//! Paths cross the whole scene, so its geometry and materials are in every key: right, not yet sharp. A record's data is the noise of each point's
//! slices, f32, which refinement of the mesh reads ([`crate::vmf_transfer::edges`]). Once paths record the lattice cells that they crossed, those follow.

use crate::error::BakeError;
use crate::factor::plain::{Differs, Plain};
use crate::factor::{ObjectFactor, PatchChunk, SceneFactors, SceneInputs, Tally};
use crate::points::surface::ObjectSurfaces;
use crate::points::{ObjectPlan, Patch};
use crate::trace::path::PathTracer;
use crate::vmf_transfer::edges::{End, Made, is_coarse};
use crate::vmf_transfer::technique::VmfTransfer;
use crate::vmf_transfer::transfer::{PointWork, TransferOptions, bake_point};
use prelight_manifests::{ChunkKind, Digest, version};
use prelight_runtime::asset::mesh::NO_POINT;
use prelight_runtime::asset::points::BURIED;
use prelight_runtime::sphere::icosahedron::{Icosahedron, MAX_LEVEL};
use prelight_runtime::surface::detail::point_lobe;
use prelight_runtime::vmf_transfer::Transfer;
use prelight_runtime::vmf_transfer::transfer::PointRecords;
use prelight_scene::Scene;
use prelight_scene::chunks::base_chunk;
use prelight_store::Chunk;

/// Version of what decides bits here, besides [`version::ALGORITHM_VERSION`].
const TRANSFER_VERSION: u32 = 4;
/// Turns all random numbers of paths and fits.
const SEED: u64 = 0x6c64_3039;

/// Names of counts of points with slices on a level.
pub(crate) const LEVELS: [&str; MAX_LEVEL + 1] = ["level 0", "level 1", "level 2", "level 3", "level 4", "level 5"];

/// What baking transfer reads of a scene.
pub(crate) struct SceneTransfer<'a> {
    technique: &'a VmfTransfer,
    inputs: &'a SceneInputs<'a>,
    paths: PathTracer<'a>,
    solid: Icosahedron,
    key: Digest,
}

impl<'a> SceneTransfer<'a> {
    pub(crate) fn new(technique: &'a VmfTransfer, inputs: &'a SceneInputs<'a>) -> Self {
        let SceneInputs { scene, world, edge_lengths, .. } = inputs;
        SceneTransfer {
            technique,
            inputs,
            paths: PathTracer::new(scene, world, inputs.occluders(), edge_lengths, technique.bounces, SEED),
            solid: Icosahedron::new(MAX_LEVEL),
            key: scene_key(scene, edge_lengths, technique.bounces),
        }
    }
}

impl SceneFactors for SceneTransfer<'_> {
    fn object<'b>(&'b self, plan: &'b ObjectPlan, surfaces: &'b ObjectSurfaces) -> Vec<Box<dyn ObjectFactor + 'b>> {
        let Some(options) = self.technique.options_of(plan.object) else { return Vec::new() };
        vec![Box::new(ObjectTransfer { of: self, plan, surfaces, options })]
    }
}

/// Transfer of one object.
struct ObjectTransfer<'a> {
    of: &'a SceneTransfer<'a>,
    plan: &'a ObjectPlan,
    surfaces: &'a ObjectSurfaces,
    options: &'a TransferOptions,
}

fn floats(hasher: &mut blake3::Hasher, values: &[f32]) {
    // Zeros of both signs are one value to the tracer.
    values.iter().for_each(|value| {
        hasher.update(&(value + 0.0).to_le_bytes());
    });
}

/// Digest of everything that a path may meet.
fn scene_key(scene: &Scene, edge_lengths: &[f32], bounces: u32) -> Digest {
    let mut hasher = blake3::Hasher::new();
    hasher.update(b"prelight transport");
    hasher.update(&version::ALGORITHM_VERSION.to_le_bytes());
    hasher.update(&TRANSFER_VERSION.to_le_bytes());
    hasher.update(&bounces.to_le_bytes());
    for (object, edge_length) in scene.objects.iter().zip(edge_lengths) {
        hasher.update(blake3::hash(&base_chunk(&object.mesh)).as_bytes());
        object.world_from_local.iter().for_each(|x| {
            hasher.update(&x.to_le_bytes());
        });
        floats(&mut hasher, &[*edge_length]);
    }
    let materials = serde_json::to_vec(&scene.materials).expect("materials have string keys and finite numbers");
    hasher.update(blake3::hash(&materials).as_bytes());
    for texture in &scene.textures {
        hasher.update(blake3::hash(&texture.to_chunk()).as_bytes());
    }
    for table in &scene.tables {
        hasher.update(blake3::hash(&table.to_chunk()).as_bytes());
    }
    Digest(*hasher.finalize().as_bytes())
}

impl ObjectFactor for ObjectTransfer<'_> {
    fn kind(&self) -> ChunkKind {
        ChunkKind::Transfer
    }

    fn key(&self, patch: &Patch) -> Digest {
        let ObjectTransfer { of, plan, surfaces, options } = self;
        let mut hasher = blake3::Hasher::new();
        hasher.update(b"prelight transfer");
        hasher.update(&of.key.0);
        let views = options.views;
        let steps = [views.start as u64, views.max as u64, u64::from(options.most_paths)];
        for word in steps.into_iter().chain([views.budget, views.floor, options.thin].map(f64::to_bits)) {
            hasher.update(&word.to_le_bytes());
        }
        hasher.update(&(options.eyes.len() as u64).to_le_bytes());
        floats(&mut hasher, options.eyes.as_flattened());
        hasher.update(&patch.n_points.to_le_bytes());
        for i in patch.range() {
            let from = plan.trace_origin(i);
            floats(&mut hasher, &from.origin);
            floats(&mut hasher, &from.normal);
            floats(&mut hasher, &surfaces.normal[i]);
            floats(&mut hasher, &[surfaces.roughness[i]]);
            hasher.update(&surfaces.material[i].to_le_bytes());
            if let Some(detail) = surfaces.details.get(i) {
                floats(&mut hasher, &detail.tangent);
                floats(&mut hasher, &[detail.anisotropy]);
            }
            hasher.update(&(plan.flags[i] & BURIED).to_le_bytes());
            hasher.update(&(from.base_triangles.len() as u32).to_le_bytes());
            from.base_triangles.iter().for_each(|id| floats(&mut hasher, of.inputs.world.positions[*id as usize].as_flattened()));
        }
        Digest(*hasher.finalize().as_bytes())
    }

    fn bake(&self, patch: &Patch) -> Result<(Vec<u8>, Plain), BakeError> {
        let ObjectTransfer { of, plan, surfaces, options } = self;
        let scene = of.inputs.scene;
        let n = patch.n_points as usize;
        let (mut points, mut noise, mut tally) = (Vec::with_capacity(n), Vec::with_capacity(4 * n), Tally::default());
        for i in patch.range() {
            let (material, detail) = (surfaces.material[i] as usize, surfaces.details.get(i).copied().unwrap_or_default());
            let receiver = point_lobe(&scene.materials[material], surfaces.roughness[i], surfaces.normal[i], &detail, &scene.tables);
            let (own, work) = if plan.flags[i] & BURIED != 0 {
                // Nothing is interpolated from it.
                (PointRecords::DARK, PointWork::default())
            } else {
                bake_point(&of.paths, &of.solid, &plan.trace_origin(i), &receiver, options, SEED)
            };
            count(&mut tally, &own, &work);
            points.push(own);
            noise.extend_from_slice(&work.noise.to_le_bytes());
        }
        tally.add("patches_traced", 1);
        Ok((Transfer::to_chunk(&points), Plain { data: noise, tally, ..Plain::default() }))
    }

    fn fits(&self, patch: &Patch, chunk: &Chunk, data: &[u8]) -> bool {
        let (words, rest) = data.as_chunks::<4>();
        let n = patch.n_points as usize;
        let noise = || words.iter().map(|bytes| f32::from_le_bytes(*bytes));
        let fits = words.len() == n && rest.is_empty() && noise().all(|x| x >= 0.0);
        fits && Transfer::from_chunk(chunk, &self.of.solid).is_ok_and(|transfer| transfer.len() == n)
    }

    /// Points between which lobes differ too much to be interpolated.
    fn differing<'b>(&'b self, patches: &'b [PatchChunk<Plain>]) -> Option<Box<Differs<'b>>> {
        let ObjectTransfer { of, plan, surfaces, options, .. } = self;
        let transfers: Vec<Transfer> = patches.iter().map(|patch| Transfer::from_proven_chunk(&patch.chunk)).collect();
        let first: Vec<u32> = plan.patches.iter().map(|patch| patch.first).collect();
        Some(Box::new(move |a, b| {
            let end = |point: u32| {
                let patch = first.partition_point(|first| *first <= point) - 1;
                let local = (point - first[patch]) as usize;
                let noise = f32::from_le_bytes(patches[patch].kept.data.as_chunks::<4>().0[local]);
                End { transfer: transfers[patch].point(local), normal: surfaces.normal[point as usize], noise }
            };
            let made = |point: u32| {
                let source = plan.source[point as usize];
                let side = if plan.front[source as usize] == point { &plan.front } else { &plan.back };
                let parents = plan.refined.parents[source as usize];
                // Where a bake is coarser than its mesh, one of them may not be baked.
                let baked = parents.map(|parent| side[parent as usize]).into_iter().all(|parent| parent != NO_POINT);
                let parents = (parents[0] != source && baked).then(|| parents.map(|parent| end(side[parent as usize])));
                Made { end: end(point), parents }
            };
            is_coarse(&of.solid, &made(a), &made(b), &options.mesh)
        }))
    }
}

fn count(tally: &mut Tally, point: &PointRecords, work: &PointWork) {
    tally.add("rays", work.rays);
    tally.add("slices", work.slices);
    tally.add("noise_limited", u64::from(work.noise_limited));
    tally.add("lobes", point.view().n_records() as u64);
    tally.add("lit_points", u64::from(!point.irradiance.is_empty()));
    if let Some(level) = point.view().level {
        tally.add(LEVELS[level], 1);
        tally.add("effective_samples", work.samples.round() as u64);
    }
}

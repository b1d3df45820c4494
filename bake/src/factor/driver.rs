//! A round of one factor: each patch looked up in the ledger, baked where it is not there, put and recorded.

use super::{Baked, Candidate, Candidates, Factor, Ledger, Made, PatchChunk, Source, Taken};
use crate::engine::{Engine, Round, RoundFactor};
use crate::error::BakeError;
use crate::progress::{Progress, check};
use prelight_manifests::{Descriptor, Digest, Dtype};
use prelight_store::{Chunk, ChunkSource, Record, ShardWriter, Store};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The patches of a round, and what came of those that ran in this process.
pub(crate) struct FactorRound<'a, F: Factor> {
    factor: &'a F,
    store: &'a Store,
    progress: &'a dyn Progress,
    done: Vec<OnceLock<PatchChunk<F::Kept>>>,
}

impl<'a, F: Factor> FactorRound<'a, F> {
    /// All patches of a factor.
    pub(crate) fn new(factor: &'a F, store: &'a Store, progress: &'a dyn Progress) -> Self {
        let done = (0..factor.n_patches()).map(|_| OnceLock::new()).collect();
        FactorRound { factor, store, progress, done }
    }

    /// Bakes the round on an engine. Gives the patches in their order, and the bytes that were added to the store.
    ///
    /// What the engine ran elsewhere is looked up. A patch whose records are not there although the engine says so is baked here,
    /// with a warning.
    ///
    /// # Errors
    /// What the engine says, and what looking up says.
    pub(crate) fn bake(self, engine: &dyn Engine) -> Result<(Vec<PatchChunk<F::Kept>>, u64), BakeError> {
        let mut bytes_stored = engine.ensure(&self, self.store, self.progress)?;
        let FactorRound { factor, store, progress, done } = self;
        let n_lost = AtomicUsize::new(0);
        let elsewhere = |(patch, done): (usize, OnceLock<PatchChunk<F::Kept>>)| match done.into_inner() {
            Some(done) => Ok((done, 0)),
            None => {
                check(progress)?;
                let mut writer = store.writer();
                let found = patch_of(factor, (store, progress), patch, &mut writer, &mut F::Scratch::default())?;
                let bytes = writer.commit()?.bytes_stored;
                n_lost.fetch_add(usize::from(bytes > 0), Ordering::Relaxed);
                Ok((found, bytes))
            }
        };
        let done: Vec<_> = done.into_par_iter().enumerate().map(elsewhere).collect::<Result<_, BakeError>>()?;
        if n_lost.load(Ordering::Relaxed) > 0 {
            let of = done.len();
            progress.warning(&format!("{} of {of} patches were not in the store although they were done: baked here", n_lost.into_inner()));
        }
        let patches = done.into_iter().map(|(patch, bytes)| {
            bytes_stored += bytes;
            patch
        });
        Ok((patches.collect(), bytes_stored))
    }
}

impl<F: Factor> FactorRound<'_, F> {
    /// Results of the patches, once all of them ran in this process: their chunks, and a digest of what is kept beside them.
    pub(crate) fn into_evidence(self) -> Option<(Vec<Descriptor>, Digest)> {
        let mut hasher = blake3::Hasher::new();
        let mut chunks = Vec::with_capacity(self.done.len());
        for done in self.done {
            let PatchChunk { descriptor, kept, .. } = done.into_inner()?;
            let evidence = self.factor.evidence(&kept);
            hasher.update(&(evidence.len() as u64).to_le_bytes());
            hasher.update(&evidence);
            chunks.push(descriptor);
        }
        Some((chunks, Digest(*hasher.finalize().as_bytes())))
    }
}

impl<F: Factor> Round for FactorRound<'_, F> {
    fn factor(&self) -> RoundFactor<'_> {
        self.factor.factor()
    }

    fn n_points(&self, patches: Range<usize>) -> u64 {
        patches.map(|patch| u64::from(self.factor.n_points(patch))).sum()
    }

    fn describe(&self, patches: Range<usize>) -> Option<Vec<u8>> {
        self.factor.describe(patches)
    }

    fn n_patches(&self) -> usize {
        self.factor.n_patches()
    }

    fn shard_patches(&self) -> usize {
        self.factor.shard_patches()
    }

    fn run(&self, patches: Range<usize>, writer: &mut ShardWriter) -> Result<(), BakeError> {
        let mut scratch = F::Scratch::default();
        for patch in patches {
            let done = patch_of(self.factor, (self.store, self.progress), patch, writer, &mut scratch)?;
            self.progress.advance(u64::from(self.factor.n_points(patch)));
            // Run twice, the first result stays: it is the same.
            let _ = self.done[patch].set(done);
        }
        Ok(())
    }
}

/// Takes over, finds or makes one patch; chunks and records that are new go to the shard.
fn patch_of<F: Factor>(
    factor: &F,
    (store, progress): (&Store, &dyn Progress),
    patch: usize,
    writer: &mut ShardWriter,
    scratch: &mut F::Scratch,
) -> Result<PatchChunk<F::Kept>, BakeError> {
    let shape = || vec![u64::from(factor.n_points(patch))];
    if let Some(Taken { descriptor, chunk, kept }) = factor.take(patch, scratch)? {
        let descriptor = match descriptor {
            Some(descriptor) => descriptor,
            None => writer.put(factor.kind(), Dtype::U8, shape(), &chunk)?,
        };
        return Ok(PatchChunk { descriptor, chunk, kept });
    }
    let inputs = factor.inputs(patch);
    let key = factor.key(&inputs);
    let mut found = candidates(factor, &inputs, store.lookup_all(&key)?);
    let load = |descriptor: &Descriptor| load(store, progress, descriptor, &|chunk| factor.fits(&inputs, chunk));
    let Made { source, record, mut kept } = loop {
        match factor.bake(&inputs, &found, &load, scratch)? {
            Baked::Made(made) => break made,
            Baked::Unusable(index) => drop(found.list.remove(index)),
        }
    };
    let (descriptor, chunk) = match source {
        Source::Found(index, chunk) => (found.list.swap_remove(index).descriptor, chunk),
        Source::Made(bytes) => (writer.put(factor.kind(), Dtype::U8, shape(), &bytes)?, Chunk::from_plain(&bytes)),
    };
    if let Some(data) = record {
        writer.record(key, Record { chunks: vec![descriptor.clone()], data });
    }
    factor.finish(&inputs, &chunk, &mut kept, scratch, &mut Ledger { store, writer })?;
    Ok(PatchChunk { descriptor, chunk, kept })
}

/// The records that are of a factor, each with its chunk's name.
fn candidates<F: Factor>(factor: &F, inputs: &F::Inputs, records: Vec<Record>) -> Candidates<F::Row> {
    let candidate = |record: Record| {
        let Ok([descriptor]) = <[Descriptor; 1]>::try_from(record.chunks) else { return None };
        (descriptor.kind == factor.kind()).then(|| factor.row(inputs, record.data).map(|row| Candidate { row, descriptor }))?
    };
    let list: Vec<_> = records.into_iter().filter_map(candidate).collect();
    Candidates { is_new: list.is_empty(), list }
}

/// A chunk of a record, if it is there and fits.
fn load(
    store: &Store,
    progress: &dyn Progress,
    descriptor: &Descriptor,
    fits: &dyn Fn(&Chunk) -> bool,
) -> Result<Option<Chunk>, BakeError> {
    match store.chunk(descriptor) {
        Ok(chunk) => Ok(fits(&chunk).then_some(chunk)),
        // Set aside and named by the store; baking again is the repair.
        Err(error) if error.is_corrupt() => {
            progress.warning(&format!("{error}: traced again"));
            Ok(None)
        }
        Err(error) => Err(error.into()),
    }
}

//! Factors: what is baked for each patch into one chunk, and the one driver that looks them up, bakes, puts and records them.
//!
//! | file | what |
//! |---|---|
//! | [`driver`] | a round of one factor: look up, load, set corrupt chunks aside, bake, put, record |
//! | [`plain`] | factors whose record is found by one key and taken as it is, behind `dyn` |
//! | [`technique`] | a technique as a bake sees it: the factors that it adds to visibility |
//!
//! A [`Factor`] says what its key covers, when a chunk of an earlier bake fits, and how to make one. It never touches the store's chunks itself.

pub mod driver;
pub mod plain;
pub mod technique;

pub(crate) use driver::FactorRound;
pub use plain::ObjectFactor;
pub use technique::{SceneFactors, SceneInputs, Tally, Technique};

use crate::engine::RoundFactor;
use crate::error::BakeError;
use prelight_manifests::{ChunkKind, Descriptor, Digest};
use prelight_store::{Chunk, Record, ShardWriter, Store};
use std::ops::Range;

/// What became of a patch: its chunk, and what the factor keeps beside it.
#[derive(Clone, Debug)]
pub struct PatchChunk<K> {
    /// Names the chunk.
    pub descriptor: Descriptor,
    /// Its plain bytes.
    pub chunk: Chunk,
    /// What the factor says of the patch.
    pub kept: K,
}

/// A record under a patch's key.
pub struct Candidate<R> {
    /// What the record says.
    pub row: R,
    /// Its chunk.
    pub descriptor: Descriptor,
}

/// Records under a patch's key, without those whose chunks turned out to be of no use.
pub struct Candidates<R> {
    /// In the ledger's order.
    pub list: Vec<Candidate<R>>,
    /// The ledger had none at all.
    pub is_new: bool,
}

/// Where a patch's chunk comes from.
pub(crate) enum Source {
    /// From the candidate of this index, read.
    Found(usize, Chunk),
    /// It was made: plain bytes.
    Made(Vec<u8>),
}

/// A patch that was found or made.
pub(crate) struct Made<K> {
    /// Its chunk.
    pub source: Source,
    /// Data of a record that names the chunk under the patch's key; `None` where one does already.
    pub record: Option<Vec<u8>>,
    /// What the factor says of the patch.
    pub kept: K,
}

/// How baking a patch ended.
pub(crate) enum Baked<K> {
    /// It is there.
    Made(Made<K>),
    /// The chunk of this candidate is of no use: try again without it.
    Unusable(usize),
}

/// Reads a candidate's chunk: `None` where it is corrupt or does not fit.
pub(crate) type LoadChunk<'a> = dyn Fn(&Descriptor) -> Result<Option<Chunk>, BakeError> + 'a;

/// A shard's way to records: what the store has, and what the shard adds.
pub struct Ledger<'a> {
    pub(crate) store: &'a Store,
    pub(crate) writer: &'a mut ShardWriter,
}

impl Ledger<'_> {
    /// Records under a key that are published.
    ///
    /// # Errors
    /// What the store says.
    pub(crate) fn lookup_all(&self, key: &Digest) -> Result<Vec<Record>, BakeError> {
        Ok(self.store.lookup_all(key)?)
    }

    /// Adds a record to the shard.
    pub(crate) fn record(&mut self, key: Digest, record: Record) {
        self.writer.record(key, record);
    }
}

/// One factor of the patches of a round, numbered from 0.
pub(crate) trait Factor: Sync {
    /// What is worked out of a patch before anything is looked up.
    type Inputs;
    /// What a record says beside its chunk.
    type Row;
    /// Memory that a thread keeps between patches.
    type Scratch: Default;
    /// What is kept of a patch beside its chunk.
    type Kept: Send + Sync;

    /// Which factor it is.
    fn factor(&self) -> RoundFactor<'_>;

    /// As [`crate::engine::Round::describe`].
    fn describe(&self, patches: Range<usize>) -> Option<Vec<u8>>;

    /// Bytes of what is kept of a patch: of two runs of it they must be the same.
    fn evidence(&self, kept: &Self::Kept) -> Vec<u8>;

    /// Kind of the chunks.
    fn kind(&self) -> ChunkKind;

    /// Number of patches.
    fn n_patches(&self) -> usize;

    /// Patches of a shard at most: about a second of work.
    fn shard_patches(&self) -> usize;

    /// Points of a patch.
    fn n_points(&self, patch: usize) -> u32;

    /// The patch as an earlier bake found it and an edit changed it, where that is cheaper than looking it up; `None` where it is not known.
    ///
    /// # Errors
    /// What reading the earlier chunk says.
    fn take(&self, _patch: usize, _scratch: &mut Self::Scratch) -> Result<Option<Taken<Self::Kept>>, BakeError> {
        Ok(None)
    }

    /// Works out what a patch is looked up by.
    fn inputs(&self, patch: usize) -> Self::Inputs;

    /// Digest of everything that [`Factor::bake`] reads.
    fn key(&self, inputs: &Self::Inputs) -> Digest;

    /// Reads a record's data; `None` where it is none of this factor.
    fn row(&self, inputs: &Self::Inputs, data: Vec<u8>) -> Option<Self::Row>;

    /// Whether a chunk is what the patch needs: right layout, as many points.
    fn fits(&self, inputs: &Self::Inputs, chunk: &Chunk) -> bool;

    /// Finds a patch among the candidates, or makes it.
    ///
    /// # Errors
    /// What loading a candidate's chunk says.
    fn bake(
        &self,
        inputs: &Self::Inputs,
        found: &Candidates<Self::Row>,
        load: &LoadChunk,
        scratch: &mut Self::Scratch,
    ) -> Result<Baked<Self::Kept>, BakeError>;

    /// Completes what is kept, once the chunk is known.
    ///
    /// # Errors
    /// What the store says, and a hit that turns out to be false.
    fn finish(
        &self,
        _inputs: &Self::Inputs,
        _chunk: &Chunk,
        _kept: &mut Self::Kept,
        _scratch: &mut Self::Scratch,
        _ledger: &mut Ledger,
    ) -> Result<(), BakeError> {
        Ok(())
    }
}

/// A patch taken over from an earlier bake.
pub struct Taken<K> {
    /// Names its chunk; `None` where an edit made it another, which is to be put.
    pub descriptor: Option<Descriptor>,
    /// The chunk as it is now.
    pub chunk: Chunk,
    /// What the factor says of the patch.
    pub kept: K,
}

//! A round as workers read it: the scene, the factor, and the patches of each shard, by digest; and what of it is done.
//!
//! ```text
//! round file   JSON chunk: scene file, technique, number of the factor, shards: points, chunk of its patches (points/bare.rs)
//! ledger       digest of the round file          -> the round file
//!              H("prelight rounds")              -> one record a round: what `prelight farm status` lists
//!              H("prelight shard", versions, scene, factor, patches) -> chunks of the patches in order; data: digest of what is kept beside them
//! ```
//!
//! Nothing of it has a clock, a path or a machine's name in it but the list of rounds, so the same round has the same name wherever it is made.

use crate::error::BakeError;
use crate::reach::key::Hasher;
use prelight_manifests::{ChunkKind, Descriptor, Digest, Dtype, version};
use prelight_store::{ChunkSource, Record, Store};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Version of the round file and of what workers record.
const FORMAT: u32 = 1;
/// Kind of the file's chunk.
const ROUND: ChunkKind = ChunkKind::custom("farm:round");
/// Kind of the chunks of patches.
pub(crate) const SHARD: ChunkKind = ChunkKind::custom("farm:shard");

/// A round.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RoundFile {
    format: u32,
    algorithm_version: u32,
    /// File of the scene.
    pub scene: Descriptor,
    /// Technique that adds the factor; `block_product` for visibility.
    pub technique: String,
    /// Number of the factor among those that it adds.
    pub factor: u32,
    /// Shards: each is run, recorded and lost as one.
    pub shards: Vec<ShardFile>,
}

/// A shard of a round.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShardFile {
    /// Points of its patches together.
    pub points: u64,
    /// Its patches.
    pub patches: Descriptor,
}

/// A round that was submitted.
#[derive(Clone, Debug, PartialEq)]
pub struct Listed {
    /// Names it.
    pub round: Digest,
    /// Seconds since 1970 when it was submitted first, by the clock of the machine that did.
    pub submitted: u64,
}

impl RoundFile {
    /// A round of shards.
    pub fn new(scene: Descriptor, technique: &str, factor: u32, shards: Vec<ShardFile>) -> Self {
        let technique = technique.to_string();
        RoundFile { format: FORMAT, algorithm_version: version::ALGORITHM_VERSION, scene, technique, factor, shards }
    }

    /// Puts the round into a store, and names it. `now`: seconds since 1970, for the list of rounds.
    ///
    /// # Errors
    /// What the store says.
    pub fn put(&self, store: &Store, now: u64) -> Result<Digest, BakeError> {
        let bytes = serde_json::to_vec(self).expect("round files have string keys and numbers");
        let mut writer = store.writer();
        let file = writer.put(ROUND, Dtype::U8, vec![bytes.len() as u64], &bytes)?;
        let round = file.digest;
        if !list(store)?.iter().any(|listed| listed.round == round) {
            writer.record(rounds_key(), Record { chunks: vec![file.clone()], data: now.to_le_bytes().to_vec() });
        }
        writer.record(round, Record { chunks: vec![file], data: Vec::new() });
        writer.commit()?;
        Ok(round)
    }

    /// Reads a round.
    ///
    /// # Errors
    /// [`BakeError::Unsupported`] when the store has none of that name or another version of prelight wrote it; a chunk that is corrupt.
    pub fn read(round: &Digest, store: &Store) -> Result<Self, BakeError> {
        let record = store.lookup(round)?.filter(|record| record.chunks.len() == 1);
        let Some(record) = record else {
            return Err(BakeError::Unsupported {
                what: format!("the store {} has no round {round}", store.dir().display()),
                help: "check --round and --store; a round that nobody used for a day may have been swept away: run `prelight bake` again"
                    .into(),
            });
        };
        let file: RoundFile = parse("round", FORMAT, &store.chunk(&record.chunks[0])?)?;
        check_algorithm(file.algorithm_version)?;
        Ok(file)
    }

    /// Name of a shard in the ledger.
    pub fn key(&self, shard: usize) -> Digest {
        let mut hasher = Hasher::new("prelight shard");
        hasher.words(&[FORMAT, self.factor, self.technique.len() as u32]);
        hasher.bytes(self.technique.as_bytes());
        hasher.bytes(&self.scene.digest.0);
        hasher.bytes(&self.shards[shard].patches.digest.0);
        hasher.finish()
    }

    /// Whether a shard is done: its record is here, and all that it names. The store is seen as it was when it was last refreshed.
    ///
    /// # Errors
    /// [`BakeError::Differs`] when two results were recorded; what the store says.
    pub fn is_done(&self, shard: usize, store: &Store) -> Result<bool, BakeError> {
        Ok(self.result(shard, store)?.is_some())
    }

    /// The record of a shard that is done.
    ///
    /// # Errors
    /// As [`RoundFile::is_done`].
    pub fn result(&self, shard: usize, store: &Store) -> Result<Option<Record>, BakeError> {
        let key = self.key(shard);
        let mut records = store.lookup_all(&key)?;
        match records.len() {
            0 | 1 => Ok(records.pop()),
            _ => Err(differs(key, shard, &records)),
        }
    }
}

/// Two results of a shard, in words.
fn differs(key: Digest, shard: usize, records: &[Record]) -> BakeError {
    let mut patches: Vec<usize> = Vec::new();
    for other in &records[1..] {
        let n = records[0].chunks.len().max(other.chunks.len());
        patches.extend((0..n).filter(|i| records[0].chunks.get(*i) != other.chunks.get(*i)));
    }
    patches.sort_unstable();
    patches.dedup();
    let what = match &patches[..] {
        [] => "what is kept beside the chunks differs".to_string(),
        [first, ..] => format!("chunks of {} patches differ, the first of patch {first}", patches.len()),
    };
    BakeError::Differs { key, shard, what }
}

/// The rounds of a store, the latest first; those whose file was swept away are left out.
///
/// # Errors
/// What the store says.
pub fn list(store: &Store) -> Result<Vec<Listed>, BakeError> {
    let mut rounds: Vec<Listed> = Vec::new();
    for record in store.lookup_all(&rounds_key())? {
        let (Some(file), Ok(submitted)) = (record.chunks.first(), <[u8; 8]>::try_from(&record.data[..])) else { continue };
        let submitted = u64::from_le_bytes(submitted);
        match rounds.iter_mut().find(|known| known.round == file.digest) {
            Some(known) => known.submitted = known.submitted.min(submitted),
            None => rounds.push(Listed { round: file.digest, submitted }),
        }
    }
    rounds.sort_by(|a, b| b.submitted.cmp(&a.submitted).then(a.round.cmp(&b.round)));
    Ok(rounds)
}

fn rounds_key() -> Digest {
    Hasher::new("prelight rounds").finish()
}

/// A file of a farm that cannot be used.
pub(crate) fn damaged(file: &str, what: &str) -> BakeError {
    BakeError::Unsupported {
        what: format!("the {file} that this task was given cannot be used: {what}"),
        help: "run `prelight bake` again with this build of prelight on all machines".to_string(),
    }
}

/// Reads one of a farm's JSON files, of this version.
pub(crate) fn parse<T: DeserializeOwned>(file: &str, format: u32, bytes: &[u8]) -> Result<T, BakeError> {
    let value: Value = serde_json::from_slice(bytes).map_err(|error| damaged(file, &error.to_string()))?;
    match value["format"].as_u64() {
        Some(found) if found == u64::from(format) => serde_json::from_value(value).map_err(|error| damaged(file, &error.to_string())),
        _ => Err(damaged(file, &format!("it has format {}, this build has {format}", value["format"]))),
    }
}

/// Refuses what another version of the algorithm planned: its keys are others.
pub(crate) fn check_algorithm(found: u32) -> Result<(), BakeError> {
    match found == version::ALGORITHM_VERSION {
        true => Ok(()),
        false => Err(damaged("round", &format!("it was planned by algorithm {found}, this build has {}", version::ALGORITHM_VERSION))),
    }
}

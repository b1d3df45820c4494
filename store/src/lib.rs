//! Content-addressed chunks of baked data; knows no rendering.
//!
//! A **chunk** is immutable bytes; its **digest** is blake3 of its plain bytes, whatever **form** (raw, zstd) it has on disk. A **record**
//! says which chunks were baked for a **key**. A **shard**'s chunks and records become visible together, durably, or not at all. Nothing
//! is handed out that does not have its digest. Terms, tree, byte maps and invariants: FORMAT.md.
//!
//! ```
//! # #[cfg(feature = "fs")] {
//! use prelight_manifests::{ChunkKind, Digest, Dtype};
//! use prelight_store::{ChunkSource, Record, Store};
//! # let dir = tempfile::tempdir().unwrap();
//! # let dir = dir.path();
//! let store = Store::open_or_create(dir)?;
//! let mut shard = store.writer();
//! let chunk = shard.put(ChunkKind::Points, Dtype::F32, vec![2], bytemuck::bytes_of(&[1.0f32, 2.0]))?;
//! let key = Digest([7; 32]);
//! shard.record(key, Record { chunks: vec![chunk], data: Vec::new() });
//! shard.commit()?;
//!
//! let record = store.lookup(&key)?.expect("it was just committed");
//! let bytes = store.chunk(&record.chunks[0])?;
//! assert_eq!(bytemuck::cast_slice::<u8, f32>(&bytes), [1.0, 2.0]);
//! # }
//! # Ok::<(), prelight_store::StoreError>(())
//! ```
//!
//! Without feature `fs` there are headers, forms, pack reading and [`ChunkSource`] over bytes in memory ([`MemorySource`]): what a browser
//! needs. `zstd` (C, reads and writes) or `ruzstd` (Rust, reads) decodes compressed chunks.

mod aligned;
pub mod budget;
pub mod chunk;
pub mod error;
pub mod form;
pub mod header;
pub mod memory;
pub mod pack;

#[cfg(feature = "fs")]
pub mod asset_pack;
#[cfg(feature = "fs")]
mod backend;
#[cfg(feature = "fs")]
mod bad;
#[cfg(feature = "fs")]
pub mod check;
#[cfg(feature = "fs")]
pub mod doctor;
#[cfg(feature = "fs")]
pub mod fault;
#[cfg(feature = "fs")]
mod foreign;
#[cfg(feature = "fs")]
mod hold;
#[cfg(feature = "fs")]
mod identity;
#[cfg(feature = "fs")]
mod index;
#[cfg(feature = "fs")]
mod lease;
#[cfg(feature = "fs")]
pub mod ledger;
#[cfg(all(feature = "fs", target_os = "linux"))]
mod machine;
#[cfg(feature = "fs")]
mod map;
#[cfg(feature = "fs")]
mod names;
#[cfg(feature = "fs")]
mod os;
#[cfg(feature = "fs")]
mod publish;
#[cfg(feature = "fs")]
pub mod put;
#[cfg(feature = "fs")]
pub mod put_back;
#[cfg(feature = "fs")]
mod reach;
#[cfg(feature = "fs")]
mod read;
#[cfg(feature = "fs")]
pub mod repair;
#[cfg(feature = "fs")]
mod rooted;
#[cfg(feature = "fs")]
pub mod roots;
#[cfg(feature = "fs")]
pub mod stats;
#[cfg(feature = "fs")]
pub mod store;
#[cfg(feature = "fs")]
pub mod sweep;

pub use aligned::CHUNK_ALIGN;
pub use budget::Budget;
pub use chunk::{Chunk, ChunkSource, SharedBytes, digest_of};
pub use error::StoreError;
pub use form::{Form, FormChoice};
pub use memory::MemorySource;

#[cfg(feature = "fs")]
pub use asset_pack::AssetPackWriter;
#[cfg(feature = "fs")]
pub use check::{CheckOptions, CheckReport, Finding};
#[cfg(feature = "fs")]
pub use doctor::Doctor;
#[cfg(feature = "fs")]
pub use fault::FaultPoint;
#[cfg(all(feature = "fs", feature = "fault-injection"))]
pub use fault::{CallHook, FaultHook, with_call_hook};
#[cfg(feature = "fs")]
pub use ledger::{MAX_RECORD_DATA, Record};
#[cfg(feature = "fs")]
pub use put::{CommitReport, OBJECT_BYTES, ShardWriter};
#[cfg(feature = "fs")]
pub use put_back::PutBack;
#[cfg(feature = "fs")]
pub use repair::RepairReport;
#[cfg(feature = "fs")]
pub use roots::Root;
#[cfg(feature = "fs")]
pub use stats::Stats;
#[cfg(feature = "fs")]
pub use store::{Mapping, Store, StoreOptions};
#[cfg(feature = "fs")]
pub use sweep::{SweepOptions, SweepReport, Swept};

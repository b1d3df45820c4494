//! Beyond this machine: rounds of a bake as jobs of an engine that people already have, and the worker that such a job runs.
//!
//! ```text
//! bake ── scene, once ───────────> store: chunk set, named by one digest
//!      ── round: patches in bytes > store: one chunk a shard, one list; its digest names the round
//!      ── task numbers ──────────> queue (processes here, Slurm, …) ──> worker: round + number
//!                                                                          │ shards of the task, each one commit:
//!      <── records of shards ─── store <────────────────────────────────── chunks, records of patches, record of the shard
//! ```
//!
//! A worker reads the store and nothing of the machine that submitted it. A shard is done when its record is in the store, whatever the queue
//! says: queues lose jobs, run them twice and give their numbers out again. Records name their chunks, so a lost chunk is a shard that is not
//! done. Two runs of a shard must give the same; another result is kept beside the first, and is [`BakeError::Differs`](crate::BakeError::Differs).
//!
//! | file | what |
//! |---|---|
//! | [`index`] | the number of a task, from the environment that an engine gives it |
//! | [`scene`] | a scene as workers read it |
//! | [`round`] | a round as workers read it, and what of it is done |
//! | [`worker`] | the shards of a task |
//! | [`queue`] | trait `Queue`: submit, ask, cancel |
//! | [`engine`] | an [`Engine`](crate::engine::Engine) over any queue: submits, watches the store, submits again what is missing |
//! | [`local`], [`slurm`], [`external`] | queues: processes here, job arrays, whatever a command of the user's submits to |
//! | [`template`] | job files for engines that have no queue here |

pub mod engine;
pub mod external;
pub mod index;
pub mod local;
pub mod queue;
pub mod round;
pub mod scene;
pub mod slurm;
pub mod template;
pub mod worker;

pub use engine::{Farm, FarmOptions};
pub use queue::{Alive, Queue, Submission};
pub use round::RoundFile;

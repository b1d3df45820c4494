//! Bakes light transport: **plan, run, seal, check**. Opens no window and never prints; progress goes through a trait.
//!
//! The folders are floors: each imports only from those above it in this list.
//!
//! | folder | holds |
//! |---|---|
//! | `error`, `progress` | what can go wrong; how work is told of and stopped |
//! | [`mesh`] | an object's mesh: welded, and refined edge by edge |
//! | [`trace`] | everything that casts rays |
//! | [`reach`] | what can be seen from where: pieces, tiles, keys, and what an edit reaches |
//! | [`points`] | points and patches of an object |
//! | [`engine`] | who runs the shards |
//! | [`factor`] | what a patch is baked for, and the one driver |
//! | [`block_product`], [`vmf_transfer`] | what belongs to one technique |
//! | [`square_light`] | fields of objects that move |
//! | [`budget`] | the fewest points that keep to a budget of error |
//! | [`options`] | what decides a bake |
//! | [`cost`] | points counted, memory and time estimated |
//! | [`reuse`] | what an earlier bake knows |
//! | [`seal`], [`bake`] | the bake and its manifest |
//! | [`farm`] | rounds beyond this machine: queues, and the worker that they run |
//! | [`settings`] | from scene.toml to options |
//! | [`reference`](mod@reference), [`check`] | the path tracer; what will look wrong |

pub mod bake;
pub mod block_product;
pub mod bounces;
pub mod budget;
pub mod check;
pub mod cost;
pub mod engine;
pub mod error;
pub mod factor;
pub mod farm;
pub mod mesh;
pub mod options;
pub mod points;
pub mod progress;
pub mod reach;
pub mod reference;
pub mod reuse;
pub mod seal;
pub mod settings;
pub mod square_light;
pub mod trace;
pub mod vmf_transfer;

pub use error::BakeError;
pub use progress::Progress;

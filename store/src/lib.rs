//! Content-addressed chunks of baked data; knows no rendering.

pub mod error;

pub use error::StoreError;

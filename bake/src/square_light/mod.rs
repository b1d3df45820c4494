//! The fields of objects that move. What points see is baked as for block products.

pub mod occluder;

pub use occluder::{FieldOptions, field_key, trace_field};

//! What a bake costs: points counted (and kept in the store), edge lengths found for a number of points, memory and time estimated.

pub mod counts;
pub mod density;
pub mod estimate;

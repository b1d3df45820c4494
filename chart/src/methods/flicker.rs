//! The rows whose flicker under a slowly turning light the stability suite bounds.

use super::{BlockProduct, HaarTriple, ShProduct};
use crate::contestants::Contestants;
use crate::limit::{Limit, grown, limit};
use prelight_runtime::block_product::Accuracy;
use std::sync::Arc;

/// Temporal errors that the rows of [`flicker`] must keep below, in their order.
pub const FLICKER_LIMITS: &[Limit] = &[
    limit("block_product 0.01, of 255", 0.01),
    limit("block_product 0.1, of 255", 0.1),
    limit("haar_triple 10 %, of 255", 0.5),
    limit("haar_triple 1 %, of 255", 3.0),
    grown("sh_product 25, of 255", 0.5, 20.0),
];

/// Methods at the budgets that are bounded.
pub fn flicker() -> Contestants {
    let accuracies = [1e-2, 1e-1].map(|relative| Accuracy { relative, ..Accuracy::FINE }).to_vec();
    Contestants::new()
        .with(Arc::new(BlockProduct { accuracies }))
        .with(Arc::new(HaarTriple { shares: vec![0.1, 0.01] }))
        .with(Arc::new(ShProduct { bands: vec![5] }))
}

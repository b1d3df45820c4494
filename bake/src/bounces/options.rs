//! Knobs of bounced light.

/// How links are baked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BounceOptions {
    /// Rays of a point that gathers, 32..=255.
    pub rays: u32,
    /// Ward's bound: a point interpolates where a gathering one lies within this share of how far both see, angles counted in. 0: all gather.
    pub spacing: f32,
    /// Share of a point's rays that one cluster of points may stand for.
    pub cluster_weight: f32,
    /// How much the views of a cluster's points may differ from their mean, 0 the same .. 1 nothing in common.
    pub similarity: f32,
}

impl Default for BounceOptions {
    fn default() -> Self {
        BounceOptions { rays: 64, spacing: 0.05, cluster_weight: 0.05, similarity: 0.5 }
    }
}

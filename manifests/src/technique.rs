//! Ways to represent transport, by name.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A technique that this build knows. `auto` is a wish in a scene manifest, never in an asset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Technique {
    /// The planner chooses: `block_product` until budgets exist.
    #[default]
    Auto,
    /// Visibility in blocks of directions times light and surface, \[IFL\].
    BlockProduct,
}

impl Technique {
    /// Every name that an asset may carry.
    pub const BUILT_IN: &'static [&'static str] = &["block_product"];

    /// What `self` bakes as.
    pub fn resolved(self) -> Technique {
        match self {
            Technique::Auto | Technique::BlockProduct => Technique::BlockProduct,
        }
    }
}

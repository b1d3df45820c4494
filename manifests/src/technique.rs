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
    /// The same for direct light, and one bounce of indirect light in von Mises–Fisher lobes, \[LD09\].
    VmfTransfer,
}

impl Technique {
    /// Every name that an asset may carry.
    pub const BUILT_IN: &'static [&'static str] = &["block_product", "vmf_transfer"];

    /// As written in manifests.
    pub fn name(self) -> &'static str {
        match self {
            Technique::Auto => "auto",
            Technique::BlockProduct => "block_product",
            Technique::VmfTransfer => "vmf_transfer",
        }
    }

    /// What `self` bakes as; never [`Technique::Auto`].
    pub fn resolved(self) -> Technique {
        match self {
            Technique::Auto | Technique::BlockProduct => Technique::BlockProduct,
            Technique::VmfTransfer => Technique::VmfTransfer,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_agree_with_serde_and_resolve_to_what_is_built_in() {
        for technique in [Technique::Auto, Technique::BlockProduct, Technique::VmfTransfer] {
            assert_eq!(serde_json::to_value(technique).unwrap(), technique.name());
            assert!(Technique::BUILT_IN.contains(&technique.resolved().name()));
        }
        assert!(!Technique::BUILT_IN.contains(&Technique::Auto.name()), "an asset never says auto");
    }
}

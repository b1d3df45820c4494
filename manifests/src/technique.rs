//! Ways to represent transport: a technique is a name and the factors that it bakes for each patch.
//!
//! [`TECHNIQUES`] is the one list of those that this build has. One from outside is added to a [`Techniques`], which parsing and opening
//! take:
//!
//! ```
//! use prelight_manifests::{ChunkKind, TechniqueInfo, Techniques};
//! const CONSTANT: TechniqueInfo = TechniqueInfo {
//!     name: "constant",
//!     factors: &[ChunkKind::custom("toy:constant")],
//!     summary: "The same light at every point.",
//!     paper: "",
//! };
//! let techniques = Techniques::built_in().with(CONSTANT);
//! assert_eq!(techniques.get("constant"), Some(&CONSTANT));
//! ```

use crate::{ChunkKind, Name};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::borrow::Cow;

/// Every technique that this build has by itself.
pub const TECHNIQUES: &[TechniqueInfo] = &[
    TechniqueInfo {
        name: "block_product",
        factors: &[ChunkKind::Visibility],
        summary: "Visibility in blocks of directions times light and surface.",
        paper: "IFL",
    },
    TechniqueInfo {
        name: "vmf_transfer",
        factors: &[ChunkKind::Visibility, ChunkKind::Transfer],
        summary: "Direct light as block_product, indirect light in von Mises-Fisher lobes.",
        paper: "LD09",
    },
];

/// Kinds of chunks that the patches of any technique may have after its own: what is baked beside it.
pub const COMMON_FACTORS: &[ChunkKind] = &[ChunkKind::Links];

/// A technique: what stands in an asset for it, and what people read about it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TechniqueInfo {
    /// Name in manifests; 1 to 32 of `a-z`, `0-9` and `_`.
    pub name: &'static str,
    /// Kinds of the chunks of every patch, in the order in which a manifest has them.
    pub factors: &'static [ChunkKind],
    /// One sentence, for help and schemas.
    pub summary: &'static str,
    /// Key of its paper in PAPERS.md; empty where there is none.
    pub paper: &'static str,
}

/// The techniques that a program knows: [`TECHNIQUES`], and those that were added.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Techniques {
    known: Vec<TechniqueInfo>,
}

impl Default for Techniques {
    fn default() -> Self {
        Self::built_in()
    }
}

impl Techniques {
    /// The built-in techniques, [`TECHNIQUES`].
    pub fn built_in() -> Self {
        Techniques { known: TECHNIQUES.to_vec() }
    }

    /// The list with one technique more.
    ///
    /// # Panics
    /// When its name is taken, `auto` or not one that [`Technique::named`] takes, or when it has no factor or one twice.
    #[must_use]
    pub fn with(mut self, info: TechniqueInfo) -> Self {
        let name = Technique::named(info.name);
        assert!(name != Technique::AUTO && self.get(info.name).is_none(), "a technique `{name}` is known already");
        let is_new = |i: usize| !info.factors[..i].contains(&info.factors[i]);
        assert!(!info.factors.is_empty() && (0..info.factors.len()).all(is_new), "`{name}` needs factors, each of a kind of its own");
        self.known.push(info);
        self
    }

    /// The technique of that name.
    pub fn get(&self, name: &str) -> Option<&TechniqueInfo> {
        self.known.iter().find(|info| info.name == name)
    }

    /// Every technique, the built-in ones first.
    pub fn iter(&self) -> impl Iterator<Item = &TechniqueInfo> {
        self.known.iter()
    }

    /// Names of all techniques, in the same order.
    pub fn names(&self) -> Vec<&'static str> {
        self.iter().map(|info| info.name).collect()
    }
}

/// A technique by its name, as a scene manifest asks for it. [`Technique::AUTO`] is a wish, never in an asset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Technique(Name<32>);

impl Technique {
    /// The planner chooses: [`Technique::BLOCK_PRODUCT`] today.
    pub const AUTO: Technique = Technique::named("auto");
    /// Visibility in blocks of directions times light and surface, \[IFL\].
    pub const BLOCK_PRODUCT: Technique = Technique::named("block_product");
    /// Direct light as [`Technique::BLOCK_PRODUCT`], indirect light in von Mises–Fisher lobes, \[LD09\].
    pub const VMF_TRANSFER: Technique = Technique::named("vmf_transfer");

    /// The technique of a name.
    ///
    /// # Panics
    /// When the name is empty, longer than 32, or has letters other than `a-z`, `0-9` and `_`. In a `const` that is an error of the
    /// compiler.
    pub const fn named(name: &str) -> Technique {
        match Self::parse(name) {
            Some(technique) => technique,
            None => panic!("a technique is named in 1 to 32 of a-z, 0-9 and _"),
        }
    }

    const fn parse(name: &str) -> Option<Technique> {
        let mut i = 0;
        while i < name.len() {
            if name.as_bytes()[i] == b':' {
                return None;
            }
            i += 1;
        }
        match Name::parse(name) {
            Some(name) => Some(Technique(name)),
            None => None,
        }
    }

    /// Name in manifests.
    pub fn name(&self) -> &str {
        self.0.as_str()
    }

    /// What `self` bakes as; never [`Technique::AUTO`].
    pub fn resolved(self) -> Technique {
        if self == Technique::AUTO { Technique::BLOCK_PRODUCT } else { self }
    }
}

impl Default for Technique {
    fn default() -> Self {
        Technique::AUTO
    }
}

impl std::fmt::Display for Technique {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl Serialize for Technique {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

/// Any well-formed name is read; [`crate::SceneManifest::parse_with`] asks whether it is known.
impl<'de> Deserialize<'de> for Technique {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        Technique::parse(&name).ok_or_else(|| serde::de::Error::custom("a technique is named in 1 to 32 of a-z, 0-9 and _"))
    }
}

impl JsonSchema for Technique {
    fn schema_name() -> Cow<'static, str> {
        "Technique".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        let auto = (Technique::AUTO.name(), "The planner chooses.");
        let names = std::iter::once(auto).chain(TECHNIQUES.iter().map(|info| (info.name, info.summary)));
        let one_of: Vec<Schema> =
            names.map(|(name, summary)| json_schema!({ "type": "string", "const": name, "description": summary })).collect();
        json_schema!({ "description": "How transport is represented.", "oneOf": one_of })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONSTANT: TechniqueInfo =
        TechniqueInfo { name: "constant", factors: &[ChunkKind::custom("toy:constant")], summary: "One light.", paper: "" };

    #[test]
    fn names_agree_with_serde_and_resolve_to_what_is_built_in() {
        let techniques = Techniques::built_in();
        for technique in [Technique::AUTO, Technique::BLOCK_PRODUCT, Technique::VMF_TRANSFER] {
            assert_eq!(serde_json::to_value(technique).unwrap(), technique.name());
            assert_eq!(serde_json::from_value::<Technique>(technique.name().into()).unwrap(), technique);
            assert!(techniques.get(technique.resolved().name()).is_some());
        }
        assert!(techniques.get(Technique::AUTO.name()).is_none(), "an asset never says auto");
        assert!(["", "Block", "a:b", "a-b"].iter().all(|name| serde_json::from_value::<Technique>((*name).into()).is_err()));
    }

    #[test]
    fn the_table_is_made_as_an_addition_would_be() {
        let rebuilt = TECHNIQUES.iter().fold(Techniques { known: Vec::new() }, |known, info| known.with(*info));
        assert_eq!(rebuilt, Techniques::default());
        let extended = rebuilt.with(CONSTANT);
        assert_eq!(extended.get("constant"), Some(&CONSTANT));
        assert_eq!(extended.names().last(), Some(&"constant"));
    }

    #[test]
    fn a_name_that_is_taken_and_missing_or_doubled_factors_are_bugs() {
        const TWICE: &[ChunkKind] = &[ChunkKind::Visibility, ChunkKind::Visibility];
        let wrong = [
            TechniqueInfo { name: "auto", ..CONSTANT },
            TechniqueInfo { name: "block_product", ..CONSTANT },
            TechniqueInfo { factors: &[], ..CONSTANT },
            TechniqueInfo { factors: TWICE, ..CONSTANT },
        ];
        for info in wrong {
            assert!(std::panic::catch_unwind(|| Techniques::built_in().with(info)).is_err(), "{info:?}");
        }
    }
}

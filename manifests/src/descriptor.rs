//! The only way to refer to a chunk: what it is, its digest, its size and its shape.

use crate::{Digest, Name};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;

/// What a chunk holds. The layout of each is in the module of `prelight-runtime` that reads it.
///
/// Manifests and the ledger write a kind by its name, at most 16 bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub enum ChunkKind {
    /// Shading points of one patch.
    Points,
    /// Material parameters of one patch's points, averaged over each point's footprint.
    Surface,
    /// Which texels each point of one patch sees.
    Visibility,
    /// Light that reaches each point of one patch over other surfaces.
    Transfer,
    /// From where each point of one patch receives bounced light.
    Links,
    /// What the rays of each point of one patch met: a cache of bakes, in no asset.
    Rows,
    /// Refined triangle mesh of one object.
    Mesh,
    /// Materials of the asset, JSON.
    Materials,
    /// Texels of one texture.
    Texture,
    /// Cameras of the scene, JSON.
    Cameras,
    /// Names and extras of nodes and materials, JSON.
    Names,
    /// An image traced once and kept: reference of a chart.
    Image,
    /// Geometry of one object as its source gave it.
    Base,
    /// Measured surface: values over the angles of half and difference vector.
    Brdf,
    /// What an object that moves blocks, seen from around it.
    Field,
    /// A factor of a technique that lives outside of this repository: see [`ChunkKind::custom`].
    Custom(Name<16>),
}

/// Every kind that this crate lists, with its name.
const NAMED: [(ChunkKind, &str); 15] = [
    (ChunkKind::Points, "points"),
    (ChunkKind::Surface, "surface"),
    (ChunkKind::Visibility, "visibility"),
    (ChunkKind::Transfer, "transfer"),
    (ChunkKind::Links, "links"),
    (ChunkKind::Rows, "rows"),
    (ChunkKind::Mesh, "mesh"),
    (ChunkKind::Materials, "materials"),
    (ChunkKind::Texture, "texture"),
    (ChunkKind::Cameras, "cameras"),
    (ChunkKind::Names, "names"),
    (ChunkKind::Image, "image"),
    (ChunkKind::Base, "base"),
    (ChunkKind::Brdf, "brdf"),
    (ChunkKind::Field, "field"),
];

impl ChunkKind {
    /// A kind for a factor of a technique of your own: `owner:factor`, 16 bytes at most.
    ///
    /// The colon keeps it apart from every kind that this crate lists or will list. A slip of the pen in a manifest has none, and is
    /// refused.
    ///
    /// # Panics
    /// When the name has no colon, is longer, or has letters other than `a-z`, `0-9` and `_`. In a `const` that is an error of the
    /// compiler.
    pub const fn custom(name: &str) -> ChunkKind {
        match Self::parse_custom(name) {
            Some(kind) => kind,
            None => panic!("a kind of one's own is named owner:factor, in at most 16 of a-z, 0-9 and _"),
        }
    }

    const fn parse_custom(name: &str) -> Option<ChunkKind> {
        let bytes = name.as_bytes();
        let (mut colons, mut i) = (0, 0);
        while i < bytes.len() {
            let is_inside = i > 0 && i + 1 < bytes.len();
            if bytes[i] == b':' {
                colons += if is_inside { 1 } else { 2 };
            }
            i += 1;
        }
        match Name::parse(name) {
            Some(name) if colons == 1 => Some(ChunkKind::Custom(name)),
            _ => None,
        }
    }

    /// The kind of that name; `None` where this build knows none.
    pub fn from_name(name: &str) -> Option<ChunkKind> {
        let listed = NAMED.iter().find(|(_, known)| *known == name).map(|(kind, _)| *kind);
        listed.or_else(|| Self::parse_custom(name))
    }

    /// Name in manifests and in the ledger.
    pub fn name(&self) -> &str {
        match self {
            ChunkKind::Custom(name) => name.as_str(),
            kind => NAMED.iter().find(|(known, _)| known == kind).map_or("", |(_, name)| *name),
        }
    }

    /// Whether shading or drawing reads the chunk where it lies, so that it is best stored uncompressed. The others are looked at once,
    /// when an asset is opened, or never by an app.
    pub fn is_hot(&self) -> bool {
        use ChunkKind::{Base, Brdf, Cameras, Field, Image, Materials, Names, Rows};
        !matches!(self, Materials | Cameras | Names | Image | Base | Brdf | Field | Rows)
    }
}

impl fmt::Display for ChunkKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl Serialize for ChunkKind {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl<'de> Deserialize<'de> for ChunkKind {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        let unknown = || serde::de::Error::custom(format_args!("unknown kind of chunk `{}`", name.chars().take(80).collect::<String>()));
        ChunkKind::from_name(&name).ok_or_else(unknown)
    }
}

/// Element type of a chunk's main array.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Dtype {
    /// Bytes, or a layout with a header of its own.
    U8,
    /// Little-endian unsigned 32-bit.
    U32,
    /// Little-endian IEEE 754 single precision.
    F32,
}

/// A reference to a chunk.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Descriptor {
    /// What the bytes mean.
    pub kind: ChunkKind,
    /// blake3 of the plain bytes.
    pub digest: Digest,
    /// Length of the plain bytes.
    pub bytes: u64,
    /// Element type.
    pub dtype: Dtype,
    /// Shape in memory order, outermost first. For layouts with a header: their leading count.
    pub shape: Vec<u64>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_is_found_by_its_name_and_fits_into_the_ledger() {
        let custom = ChunkKind::custom("toy:constant");
        for kind in NAMED.iter().map(|(kind, _)| *kind).chain([custom]) {
            assert!(!kind.name().is_empty() && kind.name().len() <= 16, "{kind:?}");
            assert_eq!(ChunkKind::from_name(kind.name()), Some(kind));
            assert_eq!(serde_json::from_str::<ChunkKind>(&serde_json::to_string(&kind).unwrap()).unwrap(), kind);
        }
        assert_eq!(serde_json::to_string(&custom).unwrap(), "\"toy:constant\"");
    }

    #[test]
    fn names_that_are_neither_listed_nor_owned_are_no_kinds() {
        for name in ["", "visibilty", "Points", "distances", "a:b:c", ":constant", "toy:", "toy:a_long_factor", "Toy:constant"] {
            assert_eq!(ChunkKind::from_name(name), None, "{name}");
            assert!(serde_json::from_value::<ChunkKind>(name.into()).is_err(), "{name}");
        }
    }
}

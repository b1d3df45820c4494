//! What must hold in an asset manifest beyond its types, and errors that name the field where it does not.

use super::{AssetManifest, AssetObject, AssetPatch, format_1};
use crate::{ChunkKind, Descriptor, ManifestError, TechniqueInfo, Techniques};
use std::collections::BTreeSet;
use std::fmt::Display;

struct Checker<'a> {
    file: &'a str,
    format: u32,
    techniques: &'a Techniques,
}

impl AssetManifest {
    /// What [`AssetManifest::parse`] checks: ranges, kinds of chunks, techniques, unique names, sums. For a manifest that was made, not
    /// read.
    ///
    /// # Errors
    /// What does not hold, and in which field; `file` names the manifest.
    pub fn check(&self, file: &str, techniques: &Techniques) -> Result<(), ManifestError> {
        let checker = Checker { file, format: self.format, techniques };
        let content = &self.content;
        if content.face_resolution != 64 && content.face_resolution != 128 {
            return Err(checker.range("content.face_resolution".into(), content.face_resolution, "64 or 128"));
        }
        if let Some((i, corner)) = content.bounds.iter().flatten().enumerate().find(|(_, x)| !x.is_finite()) {
            return Err(checker.range(format!("content.bounds[{}]", i / 3), corner, "finite numbers"));
        }
        checker.kind("content.materials", &content.materials, ChunkKind::Materials)?;
        checker.kind("content.cameras", &content.cameras, ChunkKind::Cameras)?;
        checker.kind("content.names", &content.names, ChunkKind::Names)?;
        for (i, texture) in content.textures.iter().enumerate() {
            checker.kind(&format!("content.textures[{i}]"), texture, ChunkKind::Texture)?;
        }
        for (i, brdf) in content.brdfs.iter().enumerate() {
            checker.kind(&format!("content.brdfs[{i}]"), brdf, ChunkKind::Brdf)?;
        }
        let mut names = BTreeSet::new();
        for (i, object) in content.objects.iter().enumerate() {
            let field = format!("content.objects[{i}]");
            if !names.insert(&object.name) {
                return Err(checker.range(field + ".name", format_args!("{:?}", object.name), "a name that no object before it has"));
            }
            checker.object(&field, object)?;
        }
        Ok(())
    }
}

impl Checker<'_> {
    fn range(&self, field: String, value: impl Display, expected: &str) -> ManifestError {
        ManifestError::Range { file: self.file.to_string(), field, value: value.to_string(), expected: expected.to_string() }
    }

    fn kind(&self, field: &str, descriptor: &Descriptor, expected: ChunkKind) -> Result<(), ManifestError> {
        if descriptor.kind == expected {
            return Ok(());
        }
        Err(self.range(format!("{field}.kind"), descriptor.kind, expected.name()))
    }

    fn object(&self, field: &str, object: &AssetObject) -> Result<(), ManifestError> {
        if !(object.edge_length > 0.0 && object.edge_length.is_finite()) {
            return Err(self.range(format!("{field}.edge_length"), object.edge_length, "a finite length above 0"));
        }
        if let Some(bad) = object.world_from_local.iter().find(|x| !x.is_finite()) {
            return Err(self.range(format!("{field}.world_from_local"), bad, "finite numbers"));
        }
        self.kind(&format!("{field}.base"), &object.base, ChunkKind::Base)?;
        self.kind(&format!("{field}.mesh"), &object.mesh, ChunkKind::Mesh)?;
        let technique = self.techniques.get(&object.technique).ok_or_else(|| ManifestError::Technique {
            file: self.file.to_string(),
            found: object.technique.clone(),
            known: self.techniques.names().join(", "),
        })?;
        for (k, patch) in object.patches.iter().enumerate() {
            self.patch(&format!("{field}.patches[{k}]"), patch, technique)?;
        }
        let sum: u64 = object.patches.iter().map(|patch| u64::from(patch.n_points)).sum();
        if sum != u64::from(object.n_points) {
            let expected = format!("{sum}, the sum over its patches");
            return Err(self.range(format!("{field}.n_points"), object.n_points, &expected));
        }
        Ok(())
    }

    fn patch(&self, field: &str, patch: &AssetPatch, technique: &TechniqueInfo) -> Result<(), ManifestError> {
        if !(1..=256).contains(&patch.n_points) {
            return Err(self.range(format!("{field}.n_points"), patch.n_points, "1..=256"));
        }
        self.kind(&format!("{field}.points"), &patch.points, ChunkKind::Points)?;
        self.kind(&format!("{field}.surface"), &patch.surface, ChunkKind::Surface)?;
        let (found, expected): (Vec<ChunkKind>, _) = (patch.factors.iter().map(|factor| factor.kind).collect(), technique.factors);
        let Some(index) = (0..found.len().max(expected.len())).find(|i| found.get(*i) != expected.get(*i)) else { return Ok(()) };
        let (found, wanted) = (found.get(index), expected.get(index));
        let place = match (self.format, format_1::FACTORS.get(index)) {
            (1, Some(name)) => format!("{field}.{name}"),
            _ => format!("{field}.factors[{index}]"),
        };
        let name = |kind: Option<&ChunkKind>| kind.map_or("none".to_string(), ChunkKind::to_string);
        let all: Vec<String> = expected.iter().map(ChunkKind::to_string).collect();
        Err(self.range(place + ".kind", name(found), &format!("{}: {} has {}", name(wanted), technique.name, all.join(", "))))
    }
}

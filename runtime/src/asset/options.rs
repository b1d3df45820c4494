//! Options of opening: which techniques an asset may have beside the built-in ones, and how their chunks are proved.

use super::Asset;
use super::proof::{PatchFacts, Proof, built_in};
use crate::environment::Limits;
use crate::error::RuntimeError;
use prelight_manifests::{AssetManifest, ChunkKind, TechniqueInfo, Techniques};
use prelight_store::{Budget, ChunkSource, MemorySource};
use std::fmt;
use std::sync::Arc;

/// How assets are opened. [`Asset::open`] and its sisters open with the default: the built-in techniques.
///
/// ```
/// use prelight_manifests::{ChunkKind, TechniqueInfo};
/// use prelight_runtime::asset::OpenOptions;
/// const LIGHT: ChunkKind = ChunkKind::custom("toy:constant");
/// const CONSTANT: TechniqueInfo = TechniqueInfo { name: "constant", factors: &[LIGHT], summary: "One light.", paper: "" };
/// let options = OpenOptions::new().technique(CONSTANT).proof(LIGHT, |bytes, patch| {
///     assert_eq!(bytes.len(), 12 * patch.n_points);
///     Ok(())
/// });
/// ```
#[derive(Clone)]
pub struct OpenOptions {
    techniques: Techniques,
    proofs: Vec<(ChunkKind, Proof)>,
    limits: Option<Limits>,
}

impl fmt::Debug for OpenOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let proofs: Vec<&ChunkKind> = self.proofs.iter().map(|(kind, _)| kind).collect();
        f.debug_struct("OpenOptions").field("techniques", &self.techniques.names()).field("proofs", &proofs).finish()
    }
}

impl Default for OpenOptions {
    fn default() -> Self {
        OpenOptions { techniques: Techniques::built_in(), proofs: built_in(), limits: None }
    }
}

impl OpenOptions {
    /// Options that open the built-in techniques.
    pub fn new() -> Self {
        Self::default()
    }

    /// Knows one technique more.
    ///
    /// # Panics
    /// As [`Techniques::with`].
    #[must_use]
    pub fn technique(mut self, info: TechniqueInfo) -> Self {
        self.techniques = self.techniques.with(info);
        self
    }

    /// Proves chunks of a kind that no built-in technique has; a technique may also use the built-in ones.
    ///
    /// # Panics
    /// When there is a proof of that kind already.
    #[must_use]
    pub fn proof(mut self, kind: ChunkKind, proof: impl Fn(&[u8], PatchFacts) -> Result<(), RuntimeError> + Send + Sync + 'static) -> Self {
        assert!(self.proof_of(kind).is_none(), "chunks of {kind} have a proof already");
        self.proofs.push((kind, Arc::new(proof)));
        self
    }

    /// Memory that opening may take, with what its file decodes to and one relighter. Without: what the source of the chunks has, which is a quarter
    /// of the machine's for a store, and bounded by the file's length for a pack.
    #[must_use]
    pub fn limits(mut self, limits: &Limits) -> Self {
        self.limits = Some(limits.clone());
        self
    }

    pub(super) fn given_budget(&self) -> Option<&Budget> {
        self.limits.as_ref().map(Limits::budget)
    }

    pub(super) fn budget_of(&self, source: &dyn ChunkSource) -> Budget {
        self.given_budget().cloned().unwrap_or_else(|| source.budget())
    }

    /// A source of packs whose decoded chunks count toward what opening may take.
    pub(super) fn memory_source(&self) -> MemorySource {
        self.given_budget().map_or_else(MemorySource::new, MemorySource::sharing)
    }

    /// Techniques that an asset may have.
    pub(crate) fn techniques(&self) -> &Techniques {
        &self.techniques
    }

    pub(super) fn proof_of(&self, kind: ChunkKind) -> Option<&Proof> {
        self.proofs.iter().find(|(known, _)| *known == kind).map(|(_, proof)| proof)
    }

    /// [`Asset::open`] with these options.
    ///
    /// # Errors
    /// As [`Asset::open`].
    pub fn open(&self, manifest: AssetManifest, source: &dyn ChunkSource) -> Result<Asset, RuntimeError> {
        Asset::open_with(manifest, source, self)
    }
}

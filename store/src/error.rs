//! What can go wrong with a store.

/// Why the store could not do it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// placeholder
    #[error("not implemented")]
    NotImplemented,
}

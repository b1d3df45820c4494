//! The one place where drawing meets threads: with feature `parallel` on rayon, without it in order. Results never depend on which.

/// `f(0), f(1), ..` up to `n`, in order.
#[cfg(feature = "parallel")]
pub(super) fn map_indices<T: Send>(n: usize, f: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    use rayon::prelude::*;
    (0..n).into_par_iter().map(f).collect()
}

/// `f(0), f(1), ..` up to `n`, in order.
#[cfg(not(feature = "parallel"))]
pub(super) fn map_indices<T>(n: usize, f: impl Fn(usize) -> T) -> Vec<T> {
    (0..n).map(f).collect()
}

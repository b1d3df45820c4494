//! Bounds of figures.

/// A figure of a mode and the most that it may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limit {
    /// What it is.
    pub name: &'static str,
    /// Largest value that is allowed.
    pub most: f64,
    /// Largest value of the reduced suite, as the tests run it: few frames meet fewer bad ones.
    pub most_reduced: f64,
}

/// A bound that is the same for the reduced and the whole suite.
pub const fn limit(name: &'static str, most: f64) -> Limit {
    grown(name, most, most)
}

/// A bound of a figure whose whole sequence meets worse frames than the reduced one.
pub const fn grown(name: &'static str, most_reduced: f64, most: f64) -> Limit {
    Limit { name, most, most_reduced }
}

impl Limit {
    /// What holds for the reduced suite, or for the whole.
    pub(super) fn of(&self, is_reduced: bool) -> Limit {
        Limit { most: if is_reduced { self.most_reduced } else { self.most }, ..*self }
    }
}

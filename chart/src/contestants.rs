//! The list of what competes.

use crate::contestant::Contestant;
use crate::entrant::{Budgets, Entrant};
use crate::svg::Palette;
use prelight_runtime::asset::Asset;
use std::sync::Arc;

/// Contestants in the order of tables. [`Contestants::built_in`] are those of this crate.
#[derive(Clone, Default)]
pub struct Contestants {
    list: Vec<Arc<dyn Budgets>>,
}

impl Contestants {
    /// A list of nobody.
    pub fn new() -> Self {
        Self::default()
    }

    /// The list with one more at its end.
    ///
    /// # Panics
    /// When its name is taken, or when two of its budgets have the same label.
    #[must_use]
    pub fn with<C: Contestant>(mut self, contestant: Arc<C>) -> Self {
        let name = Contestant::name(&*contestant);
        assert!(self.list.iter().all(|other| other.name() != name), "a contestant `{name}` is there already");
        let labels = contestant.labels();
        assert!((1..labels.len()).all(|i| !labels[..i].contains(&labels[i])), "two budgets of `{name}` have the same label: {labels:?}");
        self.list.push(contestant);
        self
    }

    /// Names, in the order of tables.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.list.iter().map(|contestant| contestant.name())
    }

    /// Everyone at every budget, a row each, with tables for a face resolution.
    pub fn entrants(&self, face_resolution: usize) -> Vec<Arc<dyn Entrant>> {
        self.list.iter().flat_map(|contestant| contestant.clone().entrants(face_resolution)).collect()
    }

    /// The rows of an asset: of those whom it has what they need for.
    pub fn entrants_of(&self, asset: &Asset) -> Vec<Arc<dyn Entrant>> {
        let list = self.list.iter().filter(|contestant| contestant.is_for(asset)).cloned().collect();
        Contestants { list }.entrants(asset.manifest().content.face_resolution as usize)
    }

    /// Colours and shapes of their marks.
    pub fn palette(&self) -> Palette {
        Palette::new(self.list.iter().map(|contestant| (contestant.name(), contestant.style())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::PixelSums;

    #[test]
    fn every_row_has_a_label_of_its_own_and_every_method_a_look() {
        let all = Contestants::built_in();
        let mut labels: Vec<String> = all.entrants(32).iter().map(|entrant| format!("{} {}", entrant.name(), entrant.budget())).collect();
        let n = labels.len();
        labels.sort();
        labels.dedup();
        assert_eq!(labels.len(), n, "{labels:?}");
        let mut looks: Vec<&str> = all.names().map(|name| all.palette().colour(name)).collect();
        looks.sort_unstable();
        looks.dedup();
        assert_eq!(looks.len(), all.names().count());
    }

    #[test]
    #[should_panic(expected = "is there already")]
    fn a_name_competes_once() {
        let _ = Contestants::built_in().with(Arc::new(PixelSums));
    }
}

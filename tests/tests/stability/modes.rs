//! Every mode of `chart::stability::MODES`, small. `prelight chart --stability` runs the same table whole.

use prelight_bake::progress::Silent;
use prelight_chart::stability::{Bench, MODES, Outcome, Sizes, run_all};

#[test]
fn every_known_way_to_fail_stays_within_its_bounds() {
    let folder = tempfile::tempdir().unwrap();
    let outcomes = run_all(&Bench::new(Sizes::REDUCED, folder.path(), &Silent)).unwrap();
    for outcome in &outcomes {
        for (limit, figure, kept) in outcome.figures() {
            println!("{}{}: {}: {figure:.3e} of {:e}", if kept { "" } else { "FAILS " }, outcome.mode.name, limit.name, limit.most);
        }
    }
    let failing: Vec<&str> = outcomes.iter().filter(|outcome| !outcome.holds()).map(|outcome| outcome.mode.name).collect();
    assert!(failing.is_empty(), "{failing:?}");
    assert_eq!(outcomes.len(), MODES.len());
}

#[test]
fn no_mode_is_listed_twice_or_without_a_bound() {
    let mut names: Vec<&str> = MODES.iter().map(|mode| mode.name).collect();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), MODES.len());
    for mode in MODES {
        assert!(!mode.limits.is_empty() && mode.limits.iter().all(|limit| limit.most >= 0.0 && limit.most.is_finite()), "{}", mode.name);
        assert!(mode.limits.iter().all(|limit| (0.0..=limit.most).contains(&limit.most_reduced)), "{}", mode.name);
        let none = Outcome { mode, found: Default::default(), sizes: Sizes::FULL };
        assert!(!none.holds(), "{}: without figures nothing is shown", mode.name);
    }
}

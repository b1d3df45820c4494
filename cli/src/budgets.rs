//! Budgets of error: what was chosen for them, what was reached, in words and in JSON.

use super::bake::round;
use super::loaded::Loaded;
use super::read::{map_options, read_environment};
use super::{Context, Failure};
use prelight_bake::budget::{ObjectError, Probes, Sums};
use prelight_runtime::environment::Environment;
use serde_json::{Value, json};
use std::sync::Arc;

/// Lines that plan shows: those that miss, then a count of the rest.
const LISTED: usize = 12;

/// Lights that errors are measured under once a bake is done: those held back, then the scene's own.
pub fn probes(loaded: &Loaded, context: &Context) -> Result<Probes, Failure> {
    let face_resolution = loaded.settings.options.face_resolution;
    let mut probes = Probes::held_back(face_resolution);
    let mut own: Vec<(String, Environment)> = Vec::new();
    for (index, entry) in loaded.input.manifest.environment.iter().enumerate() {
        loaded.input.find_environment(index)?;
        let (environment, _) = read_environment(&loaded.input.environment_path(entry), &map_options(entry), &context.budget)?;
        own.push((entry.name.clone(), environment.with_rotation(entry.rotate_y_deg).with_intensity(entry.intensity as f32)));
    }
    probes.extend(Probes::new(own, face_resolution));
    Ok(probes)
}

/// Asks the bake to measure, where something needs it.
pub fn measure(loaded: &mut Loaded, asked: bool, context: &Context) -> Result<(), Failure> {
    if asked || !loaded.settings.choices.is_empty() {
        loaded.settings.options.rebake.measure = Some(Arc::new(probes(loaded, context)?));
    }
    Ok(())
}

/// What the budgets chose, worst first.
pub fn lines(loaded: &Loaded) -> Vec<String> {
    let choices = &loaded.settings.choices;
    if choices.is_empty() {
        return Vec::new();
    }
    let mut declared: Vec<_> = choices.iter().filter(|choice| choice.is_declared).collect();
    declared.sort_by(|a, b| b.predicted.total_cmp(&a.predicted));
    let met = choices.len() - declared.len();
    let options = &loaded.settings.options;
    let shades = options.shades_counted();
    let others = shades[1..].iter().map(|(shades, objects)| format!(", on {objects} of them \"{}\"", shades.name()));
    let mut lines = vec![format!(
        "{met} of {} objects are expected to meet theirs, with face_resolution = {} and visibility = \"{}\"{}",
        choices.len(),
        options.face_resolution,
        shades[0].0.name(),
        others.collect::<String>()
    )];
    for choice in declared.iter().take(LISTED) {
        let name = &loaded.scene.objects[choice.object].name;
        let (floor, budget, at_points) = (choice.predicted, choice.budget, choice.at_points);
        let beyond = if floor > budget { ">".to_string() } else { "too near".to_string() };
        lines.push(format!("floor {floor:.3} {beyond} {budget} on {name}, of which directions alone {at_points:.3}"));
    }
    if declared.len() > LISTED {
        lines.push(format!("and {} more", declared.len() - LISTED));
    }
    if !declared.is_empty() {
        lines.push(
            "a floor is the error under nine lights of ten; where directions alone are most of it, a finer visibility or face_resolution goes lower, \
             else a shorter edge_length"
                .to_string(),
        );
    }
    lines
}

/// The same for machines, all of them.
pub fn to_json(loaded: &Loaded) -> Vec<Value> {
    let one = |choice: &prelight_bake::budget::Choice| {
        json!({
            "object": loaded.scene.objects[choice.object].name, "max_error": choice.budget, "predicted": choice.predicted,
            "at_points": choice.is_declared.then_some(choice.at_points), "edge_length": round(choice.params.edge_length), "points": choice.points,
            "max_shadow_gap": choice.params.max_shadow_gap.is_finite().then_some(choice.params.max_shadow_gap), "visibility": choice.shades.name(),
            "declared": choice.is_declared,
        })
    };
    loaded.settings.choices.iter().map(one).collect()
}

/// What an asset's report keeps of each object that was measured: the budget, if any, and the error under each light.
pub fn measured_json(loaded: &Loaded, errors: &[ObjectError]) -> Vec<Value> {
    let Some(probes) = &loaded.settings.options.rebake.measure else { return Vec::new() };
    let n_held_back = probes.n_held_back();
    let one = |error: &ObjectError| {
        let choice = loaded.settings.choices.iter().find(|choice| choice.object == error.object);
        let by_light = |sums: &Sums| -> serde_json::Map<String, Value> {
            probes.lights.iter().enumerate().map(|(i, light)| (light.name.clone(), sums.under(i..i + 1).into())).collect()
        };
        let held_back = error.sums.judged(0..n_held_back);
        let worst = error.sums.each(0..n_held_back).last().copied();
        json!({
            "object": loaded.scene.objects[error.object].name, "max_error": choice.map(|choice| choice.budget),
            "predicted": choice.map(|choice| choice.predicted), "declared": choice.is_some_and(|choice| choice.is_declared),
            "held_back": held_back, "held_back_worst": worst, "lights": by_light(&error.sums),
            "grid": error.grid.under(0..n_held_back), "grid_lights": by_light(&error.grid),
        })
    };
    errors.iter().map(one).collect()
}

/// How many of the budgets that were not declared are met under the held-back lights, of how many.
pub fn met(measured: &[Value]) -> (usize, usize) {
    let undeclared = |entry: &&Value| entry["max_error"].is_number() && entry["declared"] == false;
    let is_met = |entry: &&Value| entry["held_back"].as_f64() <= entry["max_error"].as_f64();
    (measured.iter().filter(undeclared).filter(is_met).count(), measured.iter().filter(undeclared).count())
}

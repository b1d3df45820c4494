//! The number of a task, from the environment that an engine gives it.

use crate::error::BakeError;

/// Variables that engines number their tasks with, in the order in which they are asked. `PRELIGHT_TASK_INDEX` is for engines that let people
/// name the variable.
pub const VARIABLES: [(&str, &str); 8] = [
    ("PRELIGHT_TASK_INDEX", "any engine"),
    ("SLURM_ARRAY_TASK_ID", "Slurm"),
    ("JOB_COMPLETION_INDEX", "Kubernetes"),
    ("AWS_BATCH_JOB_ARRAY_INDEX", "AWS Batch"),
    ("PBS_ARRAY_INDEX", "PBS"),
    ("LSB_JOBINDEX", "LSF"),
    ("SGE_TASK_ID", "Grid Engine"),
    ("CUE_IFRAME", "OpenCue"),
];

/// Reads the index: of `named` alone where a variable is named, else of the first of [`VARIABLES`] that is set. `variable` gives an environment
/// variable. Empty values and Grid Engine's `undefined` (no array) count as not set.
///
/// # Errors
/// [`BakeError::Unsupported`] when none is set, a value is no number, or two say different numbers.
pub fn from_environment(named: Option<&str>, variable: &dyn Fn(&str) -> Option<String>) -> Result<i64, BakeError> {
    let value = |name: &str| variable(name).map(|text| text.trim().to_string()).filter(|text| !text.is_empty() && text != "undefined");
    let number = |name: &str, text: &str| {
        text.parse::<i64>().map_err(|_| refused(format!("{name} is `{text}`, expected a number"), "give --index N, or --index-env NAME"))
    };
    if let Some(name) = named {
        let unset = || refused(format!("{name}, named by --index-env, is not set"), "give --index N, or another variable");
        return number(name, &value(name).ok_or_else(unset)?);
    }
    let mut found: Option<(&str, i64)> = None;
    for (name, _) in VARIABLES {
        let Some(text) = value(name) else { continue };
        let index = number(name, &text)?;
        match found {
            Some((first, known)) if known != index => {
                return Err(refused(
                    format!("{first} is {known} and {name} is {index}"),
                    "say which counts: --index-env NAME, or --index N",
                ));
            }
            Some(_) => {}
            None => found = Some((name, index)),
        }
    }
    let names = || VARIABLES.map(|(name, _)| name).join(", ");
    found
        .map(|(_, index)| index)
        .ok_or_else(|| refused("no index of a task is given".into(), &format!("give --index N; else one of {} is read", names())))
}

fn refused(what: String, help: &str) -> BakeError {
    BakeError::Usage { what, help: help.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(named: Option<&str>, set: &[(&str, &str)]) -> Result<i64, String> {
        let variable = |name: &str| set.iter().find(|(known, _)| *known == name).map(|(_, value)| value.to_string());
        from_environment(named, &variable).map_err(|error| error.to_string())
    }

    #[test]
    fn each_engine_gives_its_number_and_the_first_that_is_set_counts() {
        for (name, _) in VARIABLES {
            assert_eq!(read(None, &[(name, "12")]), Ok(12), "{name}");
        }
        assert_eq!(read(None, &[("SLURM_ARRAY_TASK_ID", "4"), ("SGE_TASK_ID", "undefined"), ("LSB_JOBINDEX", "")]), Ok(4));
        assert_eq!(read(None, &[("SLURM_ARRAY_TASK_ID", "4"), ("JOB_COMPLETION_INDEX", "4")]), Ok(4));
        assert_eq!(read(Some("FRAME"), &[("FRAME", " 7 "), ("SLURM_ARRAY_TASK_ID", "4")]), Ok(7));
    }

    #[test]
    fn none_two_that_disagree_and_no_number_are_refused_with_what_to_do() {
        for (named, set, part) in [
            (None, &[][..], "no index of a task is given"),
            (None, &[("SGE_TASK_ID", "undefined")], "no index"),
            (None, &[("SLURM_ARRAY_TASK_ID", "4"), ("CUE_IFRAME", "5")], "SLURM_ARRAY_TASK_ID is 4 and CUE_IFRAME is 5"),
            (None, &[("PBS_ARRAY_INDEX", "1[3]")], "PBS_ARRAY_INDEX is `1[3]`"),
            (Some("FRAME"), &[("SLURM_ARRAY_TASK_ID", "4")], "FRAME, named by --index-env, is not set"),
        ] {
            let error = read(named, set).unwrap_err();
            assert!(error.contains(part) && error.contains("help: "), "{error}");
        }
    }
}

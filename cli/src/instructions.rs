//! `PRELIGHT_SIMD`: the instructions that a user asks for.

use super::{ExitCode, Failure};
use prelight_runtime::light::SimdPath;

const VARIABLE: &str = "PRELIGHT_SIMD";
/// What it may say; nothing means the best that the CPU has.
const VALUES: [&str; 3] = ["scalar", "avx2", "avx512"];

/// A misspelt wish would silently be the best path, and a comparison of paths would compare nothing.
pub fn check() -> Result<(), Failure> {
    match std::env::var_os(VARIABLE) {
        Some(value) => check_value(&value.to_string_lossy()),
        None => Ok(()),
    }
}

fn check_value(value: &str) -> Result<(), Failure> {
    if value.is_empty() || VALUES.contains(&value) {
        return Ok(());
    }
    let text = format!("{VARIABLE} = \"{value}\" names no instructions\n  help: set it to {}, or unset it", VALUES.join(", "));
    Err(Failure::text(ExitCode::Usage, text))
}

/// The instructions in force, the variable heeded.
pub fn in_force() -> String {
    let shading = SimdPath::detect();
    // There is no wider path for tracing.
    let tracing = shading.min(SimdPath::Avx2);
    format!("tracing {tracing:?}, shading {shading:?}").to_lowercase()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn misspelt_instructions_are_a_usage_error_that_names_the_right_ones() {
        for good in ["", "scalar", "avx2", "avx512"] {
            assert!(check_value(good).is_ok(), "{good}");
        }
        for bad in ["avx", "AVX2", "none", " scalar"] {
            let failure = check_value(bad).unwrap_err();
            assert_eq!(failure.code, ExitCode::Usage);
            assert_eq!(failure.words().help, ["set it to scalar, avx2, avx512, or unset it"]);
        }
    }
}

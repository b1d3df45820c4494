//! OBJ and MTL text, checked line by line and written again in the plainest form: absolute indices that exist, finite numbers, one
//! statement a line, UTF-8, no comments.

use crate::error::{Budget, SceneError, Source};
use crate::origin::Bounds;
use crate::warnings::{Warnings, quote};
use std::fmt::Write;

const HELP: &str = "export the file again, or convert it to .glb";

/// An OBJ file without surprises.
pub(super) struct Clean {
    pub text: Vec<u8>,
    /// Corners of all faces.
    pub corners: u64,
    /// What its positions are counted from.
    pub origin: [f64; 3],
}

/// Statements: lines, with those joined that end in a backslash. Gives (number of the first line, text).
fn statements(bytes: &[u8]) -> impl Iterator<Item = (usize, String)> + '_ {
    let mut lines = bytes.split(|byte| *byte == b'\n').enumerate();
    std::iter::from_fn(move || {
        let (number, first) = lines.next()?;
        let mut statement = first.trim_ascii_end().to_vec();
        while statement.last() == Some(&b'\\') {
            statement.pop();
            statement.push(b' ');
            match lines.next() {
                Some((_, more)) => statement.extend_from_slice(more.trim_ascii_end()),
                None => break,
            }
        }
        // Old files name things in Latin-1; a control character in a name would end up in a terminal.
        let text: String = String::from_utf8_lossy(&statement).chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
        Some((number + 1, text))
    })
}

/// Keyword and the rest.
fn split(statement: &str) -> (&str, &str) {
    let statement = statement.trim();
    statement.split_once(char::is_whitespace).map_or((statement, ""), |(keyword, rest)| (keyword, rest.trim()))
}

/// Numbers up to a comment.
fn words(rest: &str) -> impl Iterator<Item = &str> {
    rest.split('#').next().unwrap_or_default().split_whitespace()
}

struct Checker<'a> {
    source: Source<'a>,
}

impl Checker<'_> {
    fn error(&self, line: usize, what: impl Into<String>) -> SceneError {
        let (file, at, what) = (self.source.name(), format!("line {line}"), what.into());
        SceneError::Invalid { file, at, what, help: HELP.to_string() }
    }

    /// Finite f32 numbers, each kept as it is spelt.
    fn numbers<'t>(&self, line: usize, rest: &'t str, what: &str) -> Result<Vec<(&'t str, f32)>, SceneError> {
        let number = |word: &'t str| match word.parse::<f32>() {
            Ok(number) if number.is_finite() => Ok((word, number)),
            _ => Err(self.error(line, format!("{} in a {what} is not a finite number", quote(word)))),
        };
        // Nothing in OBJ has more than eight; a line may be as long as the file.
        words(rest).take(9).map(number).collect()
    }
}

/// How many of each there are in the whole file.
#[derive(Default)]
struct Counts {
    positions: u64,
    coloured: u64,
    uvs: u64,
    normals: u64,
}

/// Checks an OBJ file.
pub(super) fn obj(source: Source, bytes: &[u8], budget: &mut Budget, warnings: &mut Warnings) -> Result<Clean, SceneError> {
    // Faces with relative indices grow when they are made absolute: at most from "-1 " to twenty digits, thrice.
    budget.charge("the file", "its text, checked", (bytes.len() as u64).saturating_mul(2))?;
    let checker = Checker { source };
    let mut all = Counts::default();
    let (mut bounds, mut has_weights) = (Bounds::default(), false);
    for (_, statement) in statements(bytes) {
        let (keyword, rest) = split(&statement);
        match keyword {
            "v" => {
                all.positions += 1;
                let numbers: Vec<f64> = words(rest).take(5).map_while(|word| word.parse().ok()).collect();
                has_weights |= numbers.len() == 4;
                if let [x, y, z, ..] = numbers[..] {
                    bounds.point([x, y, z]);
                }
                all.coloured += u64::from(words(rest).take(7).count() >= 6);
            }
            "vt" => all.uvs += 1,
            "vn" => all.normals += 1,
            _ => {}
        }
    }
    // In f64, while the text has all digits.
    let origin = if has_weights { [0.0; 3] } else { bounds.origin() };
    let coloured = all.coloured == all.positions;
    if all.coloured > 0 && !coloured {
        warnings.count("colours that some vertices lack are left out", all.coloured, || "v".to_string());
    }
    let mut out = String::new();
    let mut corners = 0u64;
    let mut sofar = Counts::default();
    for (line, statement) in statements(bytes) {
        let (keyword, rest) = split(&statement);
        match keyword {
            "v" => {
                let numbers = checker.numbers(line, rest, "position")?;
                let text = |range: std::ops::Range<usize>| numbers[range].iter().map(|(word, _)| *word).collect::<Vec<_>>().join(" ");
                let counted = |k: usize| match numbers[k].0.parse::<f64>() {
                    Ok(exact) if origin[k] != 0.0 => (exact - origin[k]).to_string(),
                    _ => numbers[k].0.to_string(),
                };
                let place = || [0, 1, 2].map(counted).join(" ");
                match numbers.len() {
                    4 if numbers[3].1 == 0.0 => return Err(checker.error(line, "a position with w = 0 lies at infinity")),
                    3 => writeln!(out, "v {}", place()),
                    4 => writeln!(out, "v {}", text(0..4)),
                    n @ 6..=8 if coloured => writeln!(out, "v {} {}", place(), text(n.min(7) - 3..n.min(7))),
                    5..=8 => writeln!(out, "v {}", place()),
                    n => return Err(checker.error(line, format!("a position of {n} numbers, expected 3, or 6 with a colour"))),
                }
                .expect("writing to a string");
                sofar.positions += 1;
            }
            "vt" => {
                let numbers = checker.numbers(line, rest, "texture coordinate")?;
                let Some((u, _)) = numbers.first() else { return Err(checker.error(line, "a texture coordinate without numbers")) };
                writeln!(out, "vt {u} {}", numbers.get(1).map_or("0", |(v, _)| v)).expect("writing to a string");
                sofar.uvs += 1;
            }
            "vn" => {
                let numbers = checker.numbers(line, rest, "normal")?;
                let [(x, _), (y, _), (z, _), ..] = numbers[..] else {
                    return Err(checker.error(line, format!("a normal of {} numbers, expected 3", numbers.len())));
                };
                writeln!(out, "vn {x} {y} {z}").expect("writing to a string");
                sofar.normals += 1;
            }
            "f" | "fo" => {
                let n = words(rest).count() as u64;
                if n < 3 {
                    warnings.note("faces of fewer than three corners are left out", || format!("line {line}"));
                    continue;
                }
                if n > 4 {
                    warnings.note("faces of more than four corners are cut into fans, which is right where they are convex", || {
                        format!("line {line}")
                    });
                }
                out.push('f');
                for corner in words(rest) {
                    face_corner(&checker, line, corner, &all, &sofar, &mut out)?;
                }
                out.push('\n');
                // A fan has three corners a triangle.
                corners += 3 * (n - 2);
            }
            "o" | "g" => writeln!(out, "o {}", if rest.is_empty() { "default" } else { rest }).expect("writing to a string"),
            "usemtl" if !rest.is_empty() => writeln!(out, "usemtl {rest}").expect("writing to a string"),
            "mtllib" if !rest.is_empty() => writeln!(out, "mtllib {rest}").expect("writing to a string"),
            "p" | "l" => warnings.note("points and lines are not read", || format!("line {line}")),
            "curv" | "curv2" | "surf" => warnings.note("free-form curves and surfaces are not read", || format!("line {line}")),
            _ => {}
        }
    }
    if corners == 0 {
        let what = if all.positions > 0 { "it has vertices and no faces" } else { "it has no vertices and no faces" };
        let (file, help) = (source.name(), "is this a Wavefront OBJ file? Point clouds need a surface first".to_string());
        return Err(SceneError::Empty { file, at: "the file".to_string(), what: what.to_string(), help });
    }
    budget.charge("the file", "its text, checked", (out.len() as u64).saturating_sub(2 * bytes.len() as u64))?;
    Ok(Clean { text: out.into_bytes(), corners, origin })
}

/// `v`, `v/vt`, `v//vn` or `v/vt/vn`, made absolute.
fn face_corner(checker: &Checker, line: usize, corner: &str, all: &Counts, sofar: &Counts, out: &mut String) -> Result<(), SceneError> {
    let kinds =
        [("position", all.positions, sofar.positions), ("texture coordinate", all.uvs, sofar.uvs), ("normal", all.normals, sofar.normals)];
    let mut indices = [None; 3];
    for (k, text) in corner.split('/').enumerate() {
        let Some((what, count, sofar)) = kinds.get(k) else {
            return Err(checker.error(line, format!("{} is no corner of a face: expected v, v/vt, v//vn or v/vt/vn", quote(corner))));
        };
        if text.is_empty() && k > 0 {
            continue;
        }
        let index: i64 = text.parse().map_err(|_| checker.error(line, format!("{} is no corner of a face", quote(corner))))?;
        let absolute = if index < 0 { *sofar as i64 + 1 + index.max(-(1 << 60)) } else { index };
        if absolute < 1 || absolute as u64 > *count {
            return Err(checker.error(line, format!("a face names {what} {index}, the file has {count}")));
        }
        indices[k] = Some(absolute);
    }
    match indices {
        [Some(v), None, None] => write!(out, " {v}"),
        [Some(v), Some(vt), None] => write!(out, " {v}/{vt}"),
        [Some(v), None, Some(vn)] => write!(out, " {v}//{vn}"),
        [Some(v), Some(vt), Some(vn)] => write!(out, " {v}/{vt}/{vn}"),
        [None, ..] => return Err(checker.error(line, format!("{} is no corner of a face: it names no position", quote(corner)))),
    }
    .expect("writing to a string");
    Ok(())
}

/// Checks a material library; statements that are not read are left out.
pub(super) fn mtl(source: Source, bytes: &[u8], budget: &mut Budget, warnings: &mut Warnings) -> Result<Vec<u8>, SceneError> {
    // Each material becomes a struct of half a kilobyte from at least ten letters.
    budget.charge("mtllib", "its materials", (bytes.len() as u64).saturating_mul(64))?;
    let checker = Checker { source };
    let mut out = String::new();
    for (line, statement) in statements(bytes) {
        let (keyword, rest) = split(&statement);
        match keyword {
            "newmtl" if !rest.is_empty() => writeln!(out, "newmtl {rest}").expect("writing to a string"),
            "Kd" | "Ke" | "Ks" => match checker.numbers(line, rest, keyword) {
                Ok(numbers) if !numbers.is_empty() => {
                    // One number is grey.
                    let at = |k: usize| numbers.get(k).unwrap_or(&numbers[0]).0;
                    writeln!(out, "{keyword} {} {} {}", at(0), at(1), at(2)).expect("writing to a string");
                }
                _ => warnings.note("colours of materials that are no numbers are left out", || format!("line {line} of a library")),
            },
            "d" => match rest.split_whitespace().next_back().and_then(|word| word.parse::<f32>().ok()).filter(|d| d.is_finite()) {
                Some(d) => writeln!(out, "d {d}").expect("writing to a string"),
                None => warnings.note("opacities of materials that are no numbers are left out", || format!("line {line} of a library")),
            },
            "Tr" | "map_Kd" | "map_Ka" | "map_Ks" | "map_Bump" | "map_bump" | "map_d" | "norm" | "disp" | "bump" if !rest.is_empty() => {
                writeln!(out, "{keyword} {rest}").expect("writing to a string");
            }
            _ => {}
        }
    }
    Ok(out.into_bytes())
}

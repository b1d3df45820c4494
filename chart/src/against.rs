//! A chart against an older one: what got slower, larger or less accurate.
//!
//! Rows are the same where scene, environment, view, motion, technique and budget are (charts without motion are of stills), and so is the size of the picture. Times are CPU time of one
//! thread and vary by ten percent and more between runs, so they count from [`SLOWER`] on; errors and bytes are the same bits in every run
//! of the same code, so they count from [`WORSE`] on.

use super::motion::Motion;
use super::row::{CONTEXT, Row, fields, significant};
use serde::Serialize;
use std::collections::HashMap;

/// Share by which a time must grow to count.
pub const SLOWER: f64 = 0.25;
/// Share by which an error or a size must grow to count.
pub const WORSE: f64 = 0.01;

/// A figure that is not as it was.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Environment, view, motion, technique and budget.
    pub row: [String; 5],
    /// Name of the column.
    pub column: &'static str,
    /// In the older chart.
    pub before: f64,
    /// Now.
    pub now: f64,
    /// It grew; all these figures are better small.
    pub is_worse: bool,
}

/// What became of a chart since another.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Against {
    /// Rows that both have.
    pub compared: usize,
    /// Rows that the older one lacks.
    pub unknown: usize,
    /// What changed by more than runs do, worse ones first, the largest change before the others.
    pub differences: Vec<Difference>,
}

/// Columns that are compared, whether they are times, and the smallest change that counts at all.
const COLUMNS: [(&str, bool, f64); 6] = [
    ("ns_per_point", true, 1.0),
    ("projection_ns", true, 1.0),
    ("prepare_seconds", true, 1e-3),
    ("bytes_per_point", false, 0.01),
    ("points_relative_l2", false, 1e-7),
    ("unbiased_relative_l2", false, 1e-4),
];

/// Compares rows with the text of an older chart's CSV. `context` are the values of [`CONTEXT`] now.
///
/// # Errors
/// A text that is not such a table.
pub fn against(text: &str, context: &[String; 6], rows: &[Row]) -> Result<Against, String> {
    let mut lines = records(text).into_iter();
    let head = lines.next().ok_or("it is empty")?;
    let column = |name: &str| head.iter().position(|column| column == name).ok_or(format!("it has no column `{name}`"));
    let kept = ["scene", "width", "height", "environment", "view", "technique", "budget"];
    let keys: Vec<usize> = kept.into_iter().map(column).collect::<Result<_, _>>()?;
    let motion = column("motion").ok();
    let values: Vec<usize> = COLUMNS.iter().map(|(name, ..)| column(name)).collect::<Result<_, _>>()?;
    let mut before: HashMap<Vec<String>, Vec<Option<f64>>> = HashMap::new();
    for (number, line) in lines.enumerate() {
        if line.len() != head.len() {
            return Err(format!("line {} has {} values, the head {}", number + 2, line.len(), head.len()));
        }
        let motion = motion.map_or(Motion::Still.name().to_string(), |at| line[at].clone());
        before.insert(
            keys.iter().map(|i| line[*i].clone()).chain([motion]).collect(),
            values.iter().map(|i| line[*i].parse().ok()).collect(),
        );
    }
    let mut found = Against::default();
    for row in rows {
        let named: HashMap<String, String> = fields(row).into_iter().collect();
        let of = |name: &str| match CONTEXT.iter().position(|constant| *constant == name) {
            Some(i) => context[i].clone(),
            None => named[name].clone(),
        };
        let key: Vec<String> = kept.map(of).into_iter().chain([row.motion.clone()]).collect();
        let Some(old) = before.get(&key) else {
            found.unknown += 1;
            continue;
        };
        found.compared += 1;
        for ((column, is_time, smallest), before) in COLUMNS.iter().zip(old) {
            let (Some(before), Ok(now)) = (*before, named[*column].parse::<f64>()) else { continue };
            let margin = if *is_time { SLOWER } else { WORSE };
            if (now - before).abs() > smallest.max(margin * before.abs()) {
                let row = ["environment", "view", "motion", "technique", "budget"].map(|name| named[name].clone());
                found.differences.push(Difference { row, column, before, now, is_worse: now > before });
            }
        }
    }
    let growth = |d: &Difference| (d.now / d.before.max(f64::MIN_POSITIVE)).ln().abs();
    found.differences.sort_by(|a, b| b.is_worse.cmp(&a.is_worse).then(growth(b).total_cmp(&growth(a))));
    Ok(found)
}

impl Against {
    /// Figures that grew.
    pub fn worse(&self) -> usize {
        self.differences.iter().filter(|difference| difference.is_worse).count()
    }

    /// One line a difference, at most `listed`.
    pub fn lines(&self, listed: usize) -> Vec<String> {
        let one = |d: &Difference| {
            let word = if d.is_worse { "WORSE" } else { "better" };
            let [environment, view, motion, technique, budget] = &d.row;
            let (column, percent) = (d.column.replace('_', " "), 100.0 * (d.now / d.before - 1.0));
            format!(
                "{word}: {technique} {budget}, {environment}, {view}, {motion}: {column} {} -> {} ({percent:+.0} %)",
                significant(d.before),
                significant(d.now)
            )
        };
        let mut lines: Vec<String> = self.differences.iter().take(listed).map(one).collect();
        if self.differences.len() > listed {
            lines.push(format!("and {} more", self.differences.len() - listed));
        }
        lines
    }
}

/// Records of a CSV text with quoted values.
fn records(text: &str) -> Vec<Vec<String>> {
    let (mut records, mut record, mut value, mut quoted) = (Vec::new(), Vec::new(), String::new(), false);
    let mut letters = text.chars().peekable();
    while let Some(letter) = letters.next() {
        match letter {
            '"' if quoted && letters.peek() == Some(&'"') => value.extend(letters.next()),
            '"' => quoted = !quoted,
            ',' if !quoted => record.push(std::mem::take(&mut value)),
            '\r' if !quoted => {}
            '\n' if !quoted => {
                record.push(std::mem::take(&mut value));
                records.push(std::mem::take(&mut record));
            }
            letter => value.push(letter),
        }
    }
    if !value.is_empty() || !record.is_empty() {
        record.push(value);
        records.push(record);
    }
    records
}

#[cfg(test)]
mod tests {
    use super::super::row::to_csv;
    use super::*;

    fn row(technique: &str, ns: f64, error: f64) -> Row {
        Row {
            technique: technique.into(),
            environment: "a, \"b\"".into(),
            motion: Motion::Still.name().into(),
            ns_per_point: ns,
            points_relative_l2: Some(error),
            ..Row::default()
        }
    }

    fn context(scene: &str) -> [String; 6] {
        ["1", "machine", scene, "digest", "640", "360"].map(str::to_string)
    }

    #[test]
    fn slower_and_less_accurate_rows_are_marked_and_noise_is_not() {
        let old = to_csv(&context("room"), &[row("a", 100.0, 0.01), row("b", 100.0, 0.01), row("c", 100.0, 0.01)]);
        let now = [row("a", 140.0, 0.01), row("b", 110.0, 0.02), row("c", 60.0, 0.01), row("d", 1.0, 1.0)];
        let found = against(&old, &context("room"), &now).unwrap();
        assert_eq!((found.compared, found.unknown, found.worse()), (3, 1, 2));
        let told: Vec<(&str, &str, bool)> = found.differences.iter().map(|d| (d.row[3].as_str(), d.column, d.is_worse)).collect();
        assert_eq!(told, [("b", "points_relative_l2", true), ("a", "ns_per_point", true), ("c", "ns_per_point", false)]);
        assert!(found.lines(2)[0].contains("WORSE: b") && found.lines(2).len() == 3);
        let other = against(&old, &context("hall"), &now).unwrap();
        assert_eq!((other.compared, other.unknown), (0, 4), "another scene is not compared");
    }

    #[test]
    fn what_is_no_chart_is_refused() {
        for (bad, expected) in [("", "empty"), ("a,b\n1,2\n", "no column `scene`")] {
            let error = against(bad, &context("room"), &[]).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
        let short = to_csv(&context("room"), &[row("a", 1.0, 0.1)]) + "1,2\n";
        assert!(against(&short, &context("room"), &[]).unwrap_err().contains("line 3"));
    }
}

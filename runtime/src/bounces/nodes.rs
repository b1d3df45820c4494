//! Nodes of a patch: its points, then runs of 4, 16, 64 and 256 consecutive points, one level after the other.

/// Points of the runs of each level above single points.
pub const RUNS: [usize; 4] = [4, 16, 64, 256];

/// Number of nodes of a patch of `n` points.
pub const fn count(n: usize) -> usize {
    n + n.div_ceil(RUNS[0]) + n.div_ceil(RUNS[1]) + n.div_ceil(RUNS[2]) + n.div_ceil(RUNS[3])
}

/// First node of a level: 0 is that of single points, `RUNS.len()` the root's.
pub fn first(n: usize, level: usize) -> usize {
    n * usize::from(level > 0) + RUNS.iter().take(level.saturating_sub(1)).map(|run| n.div_ceil(*run)).sum::<usize>()
}

/// Number of nodes of a level.
pub fn len(n: usize, level: usize) -> usize {
    if level == 0 { n } else { n.div_ceil(RUNS[level - 1]) }
}

/// The node of a level that holds a point.
pub fn holding(n: usize, level: usize, point: usize) -> usize {
    if level == 0 { point } else { first(n, level) + point / RUNS[level - 1] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_follow_one_another_and_every_point_has_one_node_a_level() {
        for n in [1, 3, 4, 5, 17, 64, 255, 256] {
            let mut next = 0;
            for level in 0..=RUNS.len() {
                assert_eq!(first(n, level), next, "{n} points, level {level}");
                let held: Vec<usize> = (0..n).map(|point| holding(n, level, point)).collect();
                assert!(held.windows(2).all(|w| w[1] == w[0] || w[1] == w[0] + 1));
                assert_eq!((held[0], held[n - 1]), (next, next + len(n, level) - 1));
                next += len(n, level);
            }
            assert_eq!(next, count(n));
        }
        assert_eq!(count(256), 341);
    }
}

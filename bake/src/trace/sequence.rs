//! Low-discrepancy numbers from (seed, pixel, half, sample, dimension): Sobol pairs, Owen-scrambled by hashing, so that any thread may
//! ask for any of them.
//!
//! ```text
//! pair(g) of sample i:  j = scramble(i, h_0),   x = scramble(sobol_0(j), h_1),   y = scramble(sobol_1(j), h_2)        h = hash(seed, pixel, half, g)
//! ```
//!
//! Every pair of dimensions g is the same (0, 2)-sequence in another order and under another scrambling, so pairs are independent of
//! one another and each is stratified over any first 2ᵏ samples. Source: Burley 2020, "Practical hash-based Owen scrambling"
//! (nested uniform scrambling of reversed bits by a Laine–Karras permutation).

/// Numbers of one sample of one pixel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sequence {
    key: u64,
    index: u32,
}

/// SplitMix64's output function: one bit of input turns half of the output.
fn mix(x: u64) -> u64 {
    let z = (x ^ x >> 30).wrapping_mul(0xbf58476d1ce4e5b9);
    let z = (z ^ z >> 27).wrapping_mul(0x94d049bb133111eb);
    z ^ z >> 31
}

/// Permutation in which each bit is turned by a hash of the bits below it.
fn laine_karras(mut x: u32, seed: u32) -> u32 {
    x = x.wrapping_add(seed);
    for factor in [0x6c50b47c, 0xb82f1e52, 0xc7afe638, 0x8d22f6e6] {
        x ^= x.wrapping_mul(factor);
    }
    x
}

/// Owen scrambling: each bit is turned by a hash of the bits above it.
fn scramble(x: u32, seed: u32) -> u32 {
    laine_karras(x.reverse_bits(), seed).reverse_bits()
}

/// Second Sobol dimension; the first is the bits of the index reversed.
fn sobol_1(index: u32) -> u32 {
    let (mut rest, mut column, mut value) = (index, 1u32 << 31, 0);
    while rest != 0 {
        if rest & 1 == 1 {
            value ^= column;
        }
        column ^= column >> 1;
        rest >>= 1;
    }
    value
}

impl Sequence {
    /// Sample `index` of a stream. Streams with different (seed, pixel, half) are independent.
    pub(crate) fn new(seed: u64, pixel: u64, half: u64, index: u32) -> Self {
        let key = mix(
            mix(seed.wrapping_add(0x9e3779b97f4a7c15)) ^ mix(pixel.wrapping_mul(2).wrapping_add(half).wrapping_add(0x632be59bd9b4e019))
        );
        Sequence { key, index }
    }

    /// Two numbers in 0..1, multiples of 2⁻³².
    pub(crate) fn pair(&self, group: u32) -> [f64; 2] {
        let h = mix(self.key ^ mix(u64::from(group) + 1));
        let index = scramble(self.index, h as u32);
        let x = scramble(index.reverse_bits(), (h >> 32) as u32);
        let y = scramble(sobol_1(index), mix(h) as u32);
        [x, y].map(|bits| f64::from(bits) / 4294967296.0)
    }
}

/// A number in 0..1 rounded down to f32, so that it stays below 1.
pub(crate) fn narrow(u: f64) -> f32 {
    ((u * 16777216.0) as u32) as f32 / 16777216.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_power_of_two_fills_every_cell_once() {
        for (seed, group) in [(1, 0), (2, 7), (3, 31)] {
            for log in [2u32, 4, 8, 10] {
                let n = 1u32 << log;
                let pairs: Vec<[f64; 2]> = (0..n).map(|i| Sequence::new(seed, 5, 0, i).pair(group)).collect();
                for columns_log in 0..=log {
                    let (columns, rows) = (1 << columns_log, 1 << (log - columns_log));
                    let mut seen = vec![0; n as usize];
                    for [x, y] in &pairs {
                        seen[(x * f64::from(columns)) as usize * rows as usize + (y * f64::from(rows)) as usize] += 1;
                    }
                    assert!(seen.iter().all(|&count| count == 1), "{n} samples in {columns} x {rows} cells");
                }
            }
        }
    }

    #[test]
    fn groups_pixels_and_halves_are_independent() {
        let stream =
            |pixel, half, group| (0..4096).map(move |i| Sequence::new(9, pixel, half, i).pair(group)[0] - 0.5).collect::<Vec<f64>>();
        let first = stream(0, 0, 0);
        for other in [stream(0, 0, 1), stream(0, 1, 0), stream(1, 0, 0), stream(2, 0, 0)] {
            let correlation: f64 = first.iter().zip(&other).map(|(a, b)| a * b * 12.0 / 4096.0).sum();
            // Four standard deviations of independent numbers.
            assert!(correlation.abs() < 4.0 / 64.0, "{correlation}");
        }
    }

    #[test]
    fn narrow_numbers_stay_below_one() {
        assert!(narrow(1.0 - 1.0 / 4294967296.0) < 1.0);
        assert_eq!(narrow(0.0), 0.0);
    }
}

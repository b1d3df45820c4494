//! Summed areas of small tables in u32 fixed point: the mean over any rectangle from four corners.
//!
//! ```text
//! sums[(y)·(n + 1) + x] = Σ_{j < y, i < x} value[j·n + i]        wrapping; exact for every rectangle whose own sum fits
//! ```
//!
//! Between texels the sums are taken bilinearly, which is the integral of values that are even over their texels. Source:
//! errata 2.5 of \[XJHT06\], whose
//! 16-bit floats lose a texel's whole value.

/// Fills `[(n + 1)²]` sums of `n`² values.
pub(crate) fn fill(n: usize, value: impl Fn(usize) -> u32, sums: &mut [u32]) {
    let stride = n + 1;
    assert_eq!(sums.len(), stride * stride, "one sum a corner");
    sums[..stride].fill(0);
    for y in 0..n {
        let mut row = 0u32;
        sums[(y + 1) * stride] = 0;
        for x in 0..n {
            row = row.wrapping_add(value(y * n + x));
            sums[(y + 1) * stride + x + 1] = sums[y * stride + x + 1].wrapping_add(row);
        }
    }
}

/// Cell and place in it of a coordinate in texels, taken to 0..=n.
#[inline(always)]
fn cell(n: usize, x: f32) -> (usize, f32) {
    let x = x.clamp(0.0, n as f32);
    let at = (x as usize).min(n - 1);
    (at, x - at as f32)
}

/// Sum over the rectangle from `low` to `high`, in texels; what lies outside of the table is 0. Whole sums must lie below 2³²; corners are
/// subtracted before anything is rounded.
#[inline]
pub(crate) fn rectangle(n: usize, sums: &[u32], low: [f32; 2], high: [f32; 2]) -> f32 {
    let stride = n + 1;
    let [(x0, fx0), (x1, fx1)] = [cell(n, low[0]), cell(n, high[0])];
    let [(y0, fy0), (y1, fy1)] = [cell(n, low[1]), cell(n, high[1])];
    let row = |y: usize| &sums[y * stride..][..stride];
    // Rows `from..to` over the width, exact but for the two columns that are cut. Subtracted before they are rounded.
    let strip = |from: usize, to: usize| {
        let (from, to) = (row(from), row(to));
        let below = |x: usize| to[x].wrapping_sub(from[x]);
        let columns = |from: usize, to: usize| below(to).wrapping_sub(below(from)) as f32;
        columns(x0, x1) + fx1 * columns(x1, x1 + 1) - fx0 * columns(x0, x0 + 1)
    };
    strip(y0, y1) + fy1 * strip(y1, y1 + 1) - fy0 * strip(y0, y0 + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::square_light::tree_tests::noise;

    /// Area-weighted sum, texel by texel, in f64.
    fn slow(n: usize, values: &[u32], low: [f32; 2], high: [f32; 2]) -> f64 {
        let overlap = |i: usize, low: f32, high: f32| (f64::from(high).min(i as f64 + 1.0) - f64::from(low).max(i as f64)).max(0.0);
        (0..n * n).map(|i| f64::from(values[i]) * overlap(i % n, low[0], high[0]) * overlap(i / n, low[1], high[1])).sum()
    }

    #[test]
    fn rectangles_are_sums_of_texels() {
        let n = 32;
        let values: Vec<u32> = (0..n * n).map(|i| (255.0 * noise(i)) as u32).collect();
        let mut sums = vec![7; (n + 1) * (n + 1)];
        fill(n, |i| values[i], &mut sums);
        assert_eq!(rectangle(n, &sums, [0.0; 2], [32.0; 2]), values.iter().sum::<u32>() as f32);
        assert_eq!(rectangle(n, &sums, [3.0; 2], [3.0; 2]), 0.0);
        for i in 0..2000 {
            let [x, y, w, h] = std::array::from_fn(|k| 40.0 * noise(4 * i + k) - 4.0);
            let (low, high) = ([x, y], [x + w.abs(), y + h.abs()]);
            let (found, expected) = (f64::from(rectangle(n, &sums, low, high)), slow(n, &values, low, high));
            assert!((found - expected).abs() < 1e-5 * 130_560.0, "{low:?} {high:?}: {found} {expected}");
        }
    }

    #[test]
    fn sums_may_wrap_where_no_rectangle_does() {
        let n = 4;
        let mut sums = vec![0; 25];
        fill(n, |i| if i == 5 { 3_000_000_000 } else { 2_000_000_000 }, &mut sums);
        assert_eq!(rectangle(n, &sums, [1.0; 2], [2.0; 2]), 3e9);
    }
}

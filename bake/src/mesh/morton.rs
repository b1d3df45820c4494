//! Morton order: cells that are near one another in space are near in the order.

/// Morton code of a cell: the lower 21 bits of x, y, z in turn from the top bit.
pub(crate) fn interleave(cell: [u64; 3]) -> u64 {
    spread(cell[0]) << 2 | spread(cell[1]) << 1 | spread(cell[2])
}

/// Puts two zero bits after each of the lower 21 bits.
fn spread(x: u64) -> u64 {
    let mut x = x & 0x1f_ffff;
    x = (x | x << 32) & 0x001f_0000_0000_ffff;
    x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn morton_codes_interleave_bit_by_bit() {
        for x in [0u64, 1, 2, 0x15_5555, 0x1f_ffff, 0x12_3456] {
            let slow: u64 = (0..21).map(|bit| (x >> bit & 1) << (3 * bit)).sum();
            assert_eq!(spread(x), slow, "{x:#x}");
        }
    }
}

//! Sixteen numbers at a time: the arithmetic that glossy products are written in once, for portable code, AVX2 and AVX-512.
//!
//! [`Lanes`] is a set of instructions as a value; who holds one may use them. [`run`] picks one and runs a [`Kernel`] with it. The portable
//! [`Plain`] is the scalar twin: kernels are tested to give its results on every path, up to the rounding of fused and approximate
//! operations (2⁻²² relative where an operation says nothing else).

#[cfg(target_arch = "x86_64")]
mod simd;

use crate::light::SimdPath;

/// Numbers worked on at a time: runs of a group, cells of a block, texels of a cell.
pub(crate) const WIDTH: usize = 16;

/// Instructions for sixteen f32 and sixteen bits.
pub(crate) trait Lanes: Copy {
    /// Sixteen f32.
    type V: Copy;
    /// Sixteen truths.
    type M: Copy;

    fn splat(self, x: f32) -> Self::V;
    fn load(self, x: &[f32; WIDTH]) -> Self::V;
    fn store(self, x: Self::V) -> [f32; WIDTH];
    fn add(self, a: Self::V, b: Self::V) -> Self::V;
    fn sub(self, a: Self::V, b: Self::V) -> Self::V;
    fn mul(self, a: Self::V, b: Self::V) -> Self::V;
    /// a·b + c.
    fn fma(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// c − a·b.
    fn fnma(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    fn min(self, a: Self::V, b: Self::V) -> Self::V;
    fn max(self, a: Self::V, b: Self::V) -> Self::V;
    fn abs(self, a: Self::V) -> Self::V;
    /// 1/a within 2⁻¹¹.
    fn rough_reciprocal(self, a: Self::V) -> Self::V;
    /// 1/√a within 2⁻¹¹, a > 0.
    fn rough_inverse_root(self, a: Self::V) -> Self::V;
    /// 2ᵃ for −100 ≤ a ≤ 126, rounded to the nearest integer, and that integer's power.
    fn whole_power(self, a: Self::V) -> (Self::V, Self::V);
    /// Mantissa m in 0.75..1.5 and exponent e of a normal a = m·2ᵉ > 0.
    fn split(self, a: Self::V) -> (Self::V, Self::V);
    fn greater(self, a: Self::V, b: Self::V) -> Self::M;
    /// `a` where the mask holds, 0 elsewhere.
    fn keep(self, mask: Self::M, a: Self::V) -> Self::V;
    /// `a` where the mask holds, `b` elsewhere.
    fn select(self, mask: Self::M, a: Self::V, b: Self::V) -> Self::V;
    fn bits(self, mask: Self::M) -> u16;
    fn mask(self, bits: u16) -> Self::M;
    fn both(self, a: Self::M, b: Self::M) -> Self::M;
    fn sum(self, a: Self::V) -> f32;

    /// Texels of a block of 16×16 from where they change: the bit at a position is `before` changed by every position up to it.
    #[inline(always)]
    fn cells(self, positions: &[u8], before: bool) -> Cells {
        let mut words = [0u64; 4];
        for position in positions {
            words[usize::from(position / 64)] |= 1 << (position % 64);
        }
        let mut carry = if before { u64::MAX } else { 0 };
        for word in &mut words {
            for shift in [1, 2, 4, 8, 16, 32] {
                *word ^= *word << shift;
            }
            *word ^= carry;
            carry = if *word >> 63 == 1 { u64::MAX } else { 0 };
        }
        let texels: [u16; WIDTH] = std::array::from_fn(|cell| (words[cell / 4] >> (16 * (cell % 4))) as u16);
        let bits = |holds: fn(u16) -> bool| (0..WIDTH).fold(0, |bits, cell| bits | u16::from(holds(texels[cell])) << cell);
        Cells { texels, whole: bits(|texels| texels == u16::MAX), none: bits(|texels| texels == 0) }
    }

    /// 1/a, one Newton step behind the rough one; a not 0.
    #[inline(always)]
    fn reciprocal(self, a: Self::V) -> Self::V {
        let guess = self.rough_reciprocal(a);
        self.mul(guess, self.fnma(a, guess, self.splat(2.0)))
    }

    /// √a by 1/√a and one Newton step; a > 0.
    #[inline(always)]
    fn quick_root(self, a: Self::V) -> Self::V {
        let guess = self.rough_inverse_root(a);
        let half = self.mul(self.mul(self.splat(0.5), a), guess);
        self.mul(a, self.mul(guess, self.fnma(half, guess, self.splat(1.5))))
    }

    /// 2ᵃ within 3e-7 relative; 0 below −100.
    #[inline(always)]
    fn exp2(self, a: Self::V) -> Self::V {
        const TERMS: [f32; 6] = [1.540_353e-4, 1.333_355_8e-3, 9.618_129e-3, 5.550_411e-2, 0.240_226_5, std::f32::consts::LN_2];
        let clamped = self.max(a, self.splat(-100.0));
        let (whole, power) = self.whole_power(clamped);
        let rest = self.sub(clamped, whole);
        let mut sum = self.splat(TERMS[0]);
        for term in &TERMS[1..] {
            sum = self.fma(sum, rest, self.splat(*term));
        }
        let value = self.mul(self.fma(sum, rest, self.splat(1.0)), power);
        self.keep(self.greater(a, self.splat(-100.0)), value)
    }

    /// log2(1 + a) for a > −1, within 3e-7 of itself: what adding 1 rounds away is put back.
    #[inline(always)]
    fn log2_1p(self, a: Self::V) -> Self::V {
        let one = self.splat(1.0);
        let y = self.add(one, a);
        let lost = self.sub(a, self.sub(y, one));
        let (m, e) = self.split(y);
        let u = self.mul(self.sub(m, one), self.reciprocal(self.add(m, one)));
        let uu = self.mul(u, u);
        // 2/ln2 · (u + u³/3 + u⁵/5 + u⁷/7)
        let series = self.fma(uu, self.splat(0.412_198_6), self.splat(0.577_078));
        let series = self.fma(series, uu, self.splat(0.961_796_7));
        let series = self.fma(series, uu, self.splat(2.885_390_1));
        self.fma(lost, self.splat(std::f32::consts::LOG2_E), self.fma(series, u, e))
    }
}

/// A block's sixteen cells of 4×4 texels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Cells {
    /// Bits of each cell's texels.
    pub texels: [u16; WIDTH],
    /// Cells with all texels.
    pub whole: u16,
    /// Cells without any.
    pub none: u16,
}

impl Cells {
    /// All texels.
    pub(crate) const WHOLE: Cells = Cells { texels: [u16::MAX; WIDTH], whole: u16::MAX, none: 0 };
}

/// Work that is written once for every set of instructions.
pub(crate) trait Kernel {
    /// Its result.
    type Output;
    /// Does it. Must be `#[inline(always)]`, so that it is compiled for the instructions of `lanes`.
    fn run<L: Lanes>(self, lanes: L) -> Self::Output;
}

/// Runs a kernel; `path` must be available.
#[inline]
pub(crate) fn run<K: Kernel>(path: SimdPath, kernel: K) -> K::Output {
    match path {
        #[cfg(target_arch = "x86_64")]
        SimdPath::Avx512 => simd::run_avx512(kernel),
        #[cfg(target_arch = "x86_64")]
        SimdPath::Avx2 => simd::run_avx2(kernel),
        _ => kernel.run(Plain),
    }
}

/// Portable code, one number after the other.
#[derive(Clone, Copy)]
pub(crate) struct Plain;

fn map(a: [f32; WIDTH], f: impl Fn(f32) -> f32) -> [f32; WIDTH] {
    a.map(f)
}

fn zip(a: [f32; WIDTH], b: [f32; WIDTH], f: impl Fn(f32, f32) -> f32) -> [f32; WIDTH] {
    std::array::from_fn(|i| f(a[i], b[i]))
}

impl Lanes for Plain {
    type V = [f32; WIDTH];
    type M = u16;

    fn splat(self, x: f32) -> Self::V {
        [x; WIDTH]
    }
    fn load(self, x: &[f32; WIDTH]) -> Self::V {
        *x
    }
    fn store(self, x: Self::V) -> [f32; WIDTH] {
        x
    }
    fn add(self, a: Self::V, b: Self::V) -> Self::V {
        zip(a, b, |a, b| a + b)
    }
    fn sub(self, a: Self::V, b: Self::V) -> Self::V {
        zip(a, b, |a, b| a - b)
    }
    fn mul(self, a: Self::V, b: Self::V) -> Self::V {
        zip(a, b, |a, b| a * b)
    }
    fn fma(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V {
        std::array::from_fn(|i| a[i] * b[i] + c[i])
    }
    fn fnma(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V {
        std::array::from_fn(|i| c[i] - a[i] * b[i])
    }
    fn min(self, a: Self::V, b: Self::V) -> Self::V {
        zip(a, b, |a, b| if a < b { a } else { b })
    }
    fn max(self, a: Self::V, b: Self::V) -> Self::V {
        zip(a, b, |a, b| if a > b { a } else { b })
    }
    fn abs(self, a: Self::V) -> Self::V {
        map(a, f32::abs)
    }
    fn rough_reciprocal(self, a: Self::V) -> Self::V {
        map(a, |a| 1.0 / a)
    }
    fn rough_inverse_root(self, a: Self::V) -> Self::V {
        map(a, |a| 1.0 / a.sqrt())
    }
    fn whole_power(self, a: Self::V) -> (Self::V, Self::V) {
        let whole = map(a, |a| a.round_ties_even());
        (whole, map(whole, |n| f32::from_bits(((n as i32 + 127) as u32) << 23)))
    }
    fn split(self, a: Self::V) -> (Self::V, Self::V) {
        // Subtracting the bits of 0.75 first puts the border between exponents there.
        let exponent = map(a, |a| ((a.to_bits().wrapping_sub(0x3f40_0000) as i32) >> 23) as f32);
        let mantissa = zip(a, exponent, |a, e| f32::from_bits(a.to_bits().wrapping_sub((e as i32 as u32) << 23)));
        (mantissa, exponent)
    }
    fn greater(self, a: Self::V, b: Self::V) -> Self::M {
        (0..WIDTH).fold(0, |bits, i| bits | u16::from(a[i] > b[i]) << i)
    }
    fn keep(self, mask: Self::M, a: Self::V) -> Self::V {
        std::array::from_fn(|i| if mask >> i & 1 == 1 { a[i] } else { 0.0 })
    }
    fn select(self, mask: Self::M, a: Self::V, b: Self::V) -> Self::V {
        std::array::from_fn(|i| if mask >> i & 1 == 1 { a[i] } else { b[i] })
    }
    fn bits(self, mask: Self::M) -> u16 {
        mask
    }
    fn mask(self, bits: u16) -> Self::M {
        bits
    }
    fn both(self, a: Self::M, b: Self::M) -> Self::M {
        a & b
    }
    fn sum(self, a: Self::V) -> f32 {
        a.iter().sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Functions([f32; WIDTH]);

    impl Kernel for Functions {
        type Output = [[f32; WIDTH]; 6];

        #[inline(always)]
        fn run<L: Lanes>(self, lanes: L) -> Self::Output {
            let a = lanes.load(&self.0);
            let positive = lanes.max(lanes.abs(a), lanes.splat(1e-30));
            let above = lanes.greater(a, lanes.splat(0.5));
            [
                lanes.exp2(lanes.min(a, lanes.splat(120.0))),
                lanes.log2_1p(positive),
                lanes.reciprocal(positive),
                lanes.quick_root(positive),
                lanes.select(above, a, lanes.splat(-7.0)),
                lanes.keep(lanes.both(lanes.mask(0x5a5a), above), lanes.splat(lanes.sum(lanes.splat(0.25)) + f32::from(lanes.bits(above)))),
            ]
            .map(|values| lanes.store(values))
        }
    }

    #[test]
    fn every_path_computes_the_functions_of_the_plain_one() {
        let mut x = 0.123_456_7f32;
        for round in 0..4000 {
            let input: [f32; WIDTH] = std::array::from_fn(|_| {
                x = (x * 997.13 + 0.618_034).fract();
                match round % 4 {
                    0 => x * 2.0 - 1.0,
                    1 => x * 140.0 - 120.0,
                    2 => x * 1e-6,
                    _ => 1e6 * x * x * x,
                }
            });
            let twin = run(SimdPath::Scalar, Functions(input));
            for path in SimdPath::all_available() {
                let got = run(path, Functions(input));
                for function in 0..6 {
                    for lane in 0..WIDTH {
                        let (a, b) = (got[function][lane], twin[function][lane]);
                        assert!((a - b).abs() <= 1e-6 * b.abs(), "{path:?} function {function} of {}: {a} {b}", input[lane]);
                    }
                }
            }
            for (lane, a) in input.into_iter().enumerate() {
                let exact = if a > -100.0 { libm::exp2(f64::from(a)) } else { 0.0 };
                if a < 120.0 {
                    assert!((f64::from(twin[0][lane]) - exact).abs() <= 4e-7 * exact, "2^{a}: {}", twin[0][lane]);
                }
                let exact = libm::log1p(f64::from(a.abs().max(1e-30))) * std::f64::consts::LOG2_E;
                assert!((f64::from(twin[1][lane]) - exact).abs() <= 4e-7 * exact, "log2(1 + {a}): {} {exact}", twin[1][lane]);
            }
        }
    }

    #[test]
    fn logarithms_close_to_minus_one_and_to_zero_hold() {
        for a in [-0.999_999f64, -0.9, -0.5, -0.3, -0.1, -1e-3, -1e-7, -1e-12, 0.0] {
            struct Log(f32);
            impl Kernel for Log {
                type Output = f32;
                #[inline(always)]
                fn run<L: Lanes>(self, lanes: L) -> f32 {
                    lanes.store(lanes.log2_1p(lanes.splat(self.0)))[0]
                }
            }
            let exact = libm::log1p(f64::from(a as f32)) * std::f64::consts::LOG2_E;
            for path in SimdPath::all_available() {
                let got = f64::from(run(path, Log(a as f32)));
                assert!((got - exact).abs() <= 1e-6 * exact.abs(), "{path:?} {a}: {got} {exact}");
            }
        }
    }

    struct Unpack(Vec<u8>, bool);

    impl Kernel for Unpack {
        type Output = Cells;

        #[inline(always)]
        fn run<L: Lanes>(self, lanes: L) -> Cells {
            lanes.cells(&self.0, self.1)
        }
    }

    #[test]
    fn cells_of_transitions_are_the_texels_between_them_on_every_path() {
        let lists: [Vec<u8>; 7] = [
            vec![],
            vec![0],
            vec![255],
            (0..=255).collect(),
            vec![63, 64, 127, 128, 191, 192],
            vec![16, 32, 200],
            (0..=255).filter(|p| p % 7 == 3 || p % 64 == 0).collect(),
        ];
        for (list, before) in lists.iter().flat_map(|list| [(list, false), (list, true)]) {
            let mut texel = before;
            let texels: Vec<bool> = (0..=255)
                .map(|p| {
                    texel ^= list.contains(&p);
                    texel
                })
                .collect();
            for path in SimdPath::all_available() {
                let Cells { texels: got, whole, none } = run(path, Unpack(list.clone(), before));
                for cell in 0..WIDTH {
                    let own = &texels[cell * WIDTH..][..WIDTH];
                    assert!((0..WIDTH).all(|texel| (got[cell] >> texel & 1 == 1) == own[texel]), "{path:?}, {list:?}, cell {cell}");
                    assert_eq!(whole >> cell & 1 == 1, own.iter().all(|texel| *texel), "{path:?}, {list:?}, cell {cell}");
                    assert_eq!(none >> cell & 1 == 1, !own.contains(&true), "{path:?}, {list:?}, cell {cell}");
                }
            }
        }
    }
}

//! Glossy products by going over the texels of a cubemap with SIMD: what block products of lobes are measured against.
//!
//! ```text
//! B[s][c] = Σ_texels V · flux_c · g_s(l)
//! ```
//!
//! How they are tuned. The very formulas of `block_product`, sixteen texels at a time, cheap powers and exponentials included (2ᵃ by a
//! polynomial, logarithms by four terms); lobes come ready, energy and all. *Tiled*: four points share the six loads of a group of texels.
//! *Sparse*: one point at a time, groups of hidden texels are skipped.

use super::dense::PixelLight;
use crate::block_product::glossy::formula::{BlinnPhong, CookTorrance, Formula, Ggx, Lobe, Phong, Registers, Ward};
use crate::light::lanes::{self, Kernel, Lanes, WIDTH};
use crate::light::texel_lobe::{Shape, TexelLobe};
use crate::light::{Glossy, SimdPath};

/// Points that share the loads of a group.
const TILE: usize = 4;

/// Glossy radiance of every point, `lobes` one each, all of one formula. `open`: the points' words one after the other.
///
/// Panics when lengths disagree, when formulas differ, or for measured lobes.
pub fn glossy_tiled(path: SimdPath, light: &PixelLight, open: &[u64], lobes: &[TexelLobe], out: &mut [Glossy]) {
    run(path, light, open, lobes, out, false);
}

/// [`glossy_tiled`], one point at a time, skipping hidden groups.
pub fn glossy_sparse(path: SimdPath, light: &PixelLight, open: &[u64], lobes: &[TexelLobe], out: &mut [Glossy]) {
    run(path, light, open, lobes, out, true);
}

fn run(path: SimdPath, light: &PixelLight, open: &[u64], lobes: &[TexelLobe], out: &mut [Glossy], sparse: bool) {
    assert!(lobes.len() == out.len() && 64 * open.len() == light.texels * out.len(), "one lobe and one set of words per point");
    let Some(first) = lobes.first() else { return };
    assert!(lobes.iter().all(|lobe| lobe.shape == first.shape), "one formula");
    let path = path.available();
    let stretched = lobes.iter().any(|lobe| lobe.smith[0] != lobe.smith[2] || lobe.smith[1] != 0.0);
    let lobes: Vec<Lobe> = lobes.iter().map(Lobe::new).collect();
    macro_rules! product {
        ($formula:ty) => {
            lanes::run(path, Product::<$formula> { light, open, lobes: &lobes, out, sparse, formula: std::marker::PhantomData })
        };
    }
    match first.shape {
        Shape::None => out.fill(Glossy::default()),
        Shape::Ggx if stretched => product!(Ggx<true>),
        Shape::Ggx => product!(Ggx<false>),
        Shape::Ward => product!(Ward),
        Shape::CookTorrance => product!(CookTorrance),
        Shape::BlinnPhong => product!(BlinnPhong),
        Shape::Phong => product!(Phong),
        Shape::Measured => panic!("a measured lobe has no formula"),
    }
}

struct Product<'a, F> {
    light: &'a PixelLight,
    open: &'a [u64],
    lobes: &'a [Lobe<'a>],
    out: &'a mut [Glossy],
    sparse: bool,
    formula: std::marker::PhantomData<F>,
}

impl<F: Formula> Kernel for Product<'_, F> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let Product { light, open, lobes, out, sparse, .. } = self;
        let groups = light.texels / WIDTH;
        let bits_of = |point: usize, group: usize| (open[(point * groups + group) / 4] >> (16 * (group % 4))) as u16;
        let zero = lanes.splat(0.0);
        let part = |values: &[f32], group: usize| lanes.load(&values.as_chunks::<WIDTH>().0[group]);
        let step = if sparse { 1 } else { TILE };
        for first in (0..out.len()).step_by(step) {
            let tile: [usize; TILE] = std::array::from_fn(|k| (first + k).min(out.len() - 1));
            let registers = [
                Registers::new(lanes, &lobes[tile[0]]),
                Registers::new(lanes, &lobes[tile[1]]),
                Registers::new(lanes, &lobes[tile[2]]),
                Registers::new(lanes, &lobes[tile[3]]),
            ];
            let mut sums = [[[zero; 3]; 2]; TILE];
            for group in 0..groups {
                if sparse && bits_of(first, group) == 0 {
                    continue;
                }
                let d = [part(&light.direction[0], group), part(&light.direction[1], group), part(&light.direction[2], group)];
                let flux = [part(&light.flux[0], group), part(&light.flux[1], group), part(&light.flux[2], group)];
                for k in 0..step {
                    let lobe = &registers[k];
                    let local = lobe.local(lanes, d);
                    let lit = lanes.both(lanes.mask(bits_of(tile[k], group)), lanes.greater(local[2], zero));
                    let (value, hh) = F::value(lanes, lobe, local);
                    let value = lanes.keep(lit, value);
                    let rest = if F::SCHLICK { lanes.keep(lit, lanes.mul(value, lobe.schlick(lanes, hh))) } else { zero };
                    let base = if F::SCHLICK { lanes.sub(value, rest) } else { value };
                    for channel in 0..3 {
                        sums[k][0][channel] = lanes.fma(flux[channel], base, sums[k][0][channel]);
                        if F::SCHLICK {
                            sums[k][1][channel] = lanes.fma(flux[channel], rest, sums[k][1][channel]);
                        }
                    }
                }
            }
            for k in 0..step {
                for term in 0..2 {
                    for channel in 0..3 {
                        out[tile[k]][term][channel] = lanes.sum(sums[k][term][channel]);
                    }
                }
            }
        }
    }
}

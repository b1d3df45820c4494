//! Means of a lobe over squares of directions, from summed areas or by its formula.
//!
//! ```text
//! ρ(θ_o, R) = ∫_R f n·l dp / |R|        R whole: below the horizon the lobe is 0, and that is counted here and nowhere else
//! table     u32 [planes][32 θ_o][33][33]: sums over a disc of 32² texels, 4 x 4 samples each; azimuth of ω_o at +x; θ_o evenly 0..=89°
//! planes    the two Schlick terms, and the square of their sum, which gives the variance
//! ```
//!
//! A square of less than two texels a side is taken by formula at its centre. One table a lobe; of a family of lobes sixteen, evenly in
//! √α, two of which
//! are blended. Stretched and measured lobes are sampled in every square. Source: \[XJHT06\] section 6.1; errata 2.4 and 2.5 of \[XJHT06\].

use super::summed_area;
use crate::brdf::{Lobe, lift, phong, tangents};
use crate::light::{Glossy, PointLobe};
use crate::sphere::disc::{direction_from_disc, disc_from_direction};
use crate::sphere::frame::dot;
use std::sync::OnceLock;

/// Texels along the disc.
const TEXELS: usize = 32;
/// Samples along a texel.
const SAMPLES: usize = 4;
/// Angles of the view.
const VIEWS: usize = 32;
/// The last of them, degrees.
const LAST_VIEW: f64 = 89.0;
/// Half sides below which the formula is taken at the centre: two texels a side.
pub const SMALL: f32 = 1.0 / 16.0;
/// Planes of a table.
const PLANES: usize = 3;
/// Widths that have a table, evenly in √α.
const WIDTHS: usize = 16;
/// √α of the first width.
const FIRST_WIDTH: f64 = 0.1;
/// Samples along a square of a lobe without a table.
const DIRECT: usize = 4;

/// Sums of one lobe.
#[derive(Clone, Debug)]
pub struct BrdfTable {
    /// `[planes][views][(TEXELS + 1)²]`
    sums: Vec<u32>,
    /// `[planes][views]` the value of one unit.
    unit: Vec<f32>,
}

/// The terms of a lobe of one colour.
fn gray(lobe: &Lobe, v: [f64; 3], l: [f64; 3]) -> [f64; 2] {
    let [base, rest] = lobe.terms(v, l);
    [base[1], rest[1]]
}

/// Local view direction of slice `k`.
fn view(k: usize) -> [f64; 3] {
    let (sine, cosine) = libm::sincos((LAST_VIEW * k as f64 / (VIEWS - 1) as f64).to_radians());
    lift([sine, 0.0, cosine])
}

impl BrdfTable {
    /// Samples an isotropic lobe of one colour.
    pub fn new(lobe: &Lobe) -> BrdfTable {
        let corners = (TEXELS + 1) * (TEXELS + 1);
        let mut table = BrdfTable { sums: vec![0; PLANES * VIEWS * corners], unit: vec![0.0; PLANES * VIEWS] };
        let mut means = vec![[0.0f64; PLANES]; TEXELS * TEXELS];
        for slice in 0..VIEWS {
            let v = view(slice);
            // Both halves of the disc are alike: the view is on the x axis.
            for texel in 0..TEXELS * TEXELS / 2 {
                let mut sum = [0.0; PLANES];
                for s in 0..SAMPLES * SAMPLES {
                    let at = |i: usize, s: usize| 2.0 * (i as f64 + (s as f64 + 0.5) / SAMPLES as f64) / TEXELS as f64 - 1.0;
                    let p = [at(texel % TEXELS, s % SAMPLES), at(texel / TEXELS, s / SAMPLES)];
                    if p[0] * p[0] + p[1] * p[1] < 1.0 {
                        let [base, rest] = gray(lobe, v, direction_from_disc(p));
                        [base, rest, (base + rest) * (base + rest)].iter().zip(&mut sum).for_each(|(value, sum)| *sum += value);
                    }
                }
                let mean = sum.map(|sum| sum / (SAMPLES * SAMPLES) as f64);
                means[texel] = mean;
                means[(TEXELS - 1 - texel / TEXELS) * TEXELS + texel % TEXELS] = mean;
            }
            for plane in 0..PLANES {
                let total: f64 = means.iter().map(|mean| mean[plane]).sum();
                // Room for the rounding of every texel.
                let scale = if total > 0.0 { f64::from(u32::MAX - 1024) / total } else { 0.0 };
                let at = plane * VIEWS + slice;
                table.unit[at] = if total > 0.0 { (1.0 / scale) as f32 } else { 0.0 };
                let value = |i: usize| (means[i][plane] * scale + 0.5) as u32;
                summed_area::fill(TEXELS, value, &mut table.sums[at * corners..][..corners]);
            }
        }
        table
    }

    /// Means of the planes over a square of the disc, half its side `half`; the azimuth of the view is +x.
    pub fn mean(&self, n_dot_v: f32, p: [f32; 2], half: f32) -> [f32; PLANES] {
        let corners = (TEXELS + 1) * (TEXELS + 1);
        let angle = n_dot_v.clamp(0.0, 1.0).acos().to_degrees() * ((VIEWS - 1) as f32 / LAST_VIEW as f32);
        let slice = (angle as usize).min(VIEWS - 2);
        let between = (angle - slice as f32).min(1.0);
        let scale = 0.5 * TEXELS as f32;
        let (at, half) = (p.map(|x| (x + 1.0) * scale), half * scale);
        let (low, high) = (at.map(|x| x - half), at.map(|x| x + half));
        let area = 4.0 * half * half;
        std::array::from_fn(|plane| {
            let sum = |slice: usize| {
                let at = plane * VIEWS + slice;
                summed_area::rectangle(TEXELS, &self.sums[at * corners..][..corners], low, high) * self.unit[at]
            };
            let (near, far) = (sum(slice), sum(slice + 1));
            (near + between * (far - near)) / area
        })
    }
}

/// Tables of families of lobes, each made when it is first asked for (about 20 ms).
#[derive(Debug, Default)]
pub struct Tables {
    families: [[OnceLock<BrdfTable>; WIDTHS]; 5],
}

impl Tables {
    /// The two tables around a lobe, and how far it is toward the second; `None` for lobes without.
    fn around(&self, lobe: &Lobe) -> Option<(&BrdfTable, &BrdfTable, f32)> {
        let (family, alpha) = match *lobe {
            Lobe::Ggx { alpha } if alpha[0] == alpha[1] => (0, alpha[0]),
            Lobe::Phong { exponent } => (1, phong::alpha(exponent)),
            Lobe::BlinnPhong { exponent } => (2, phong::alpha(exponent)),
            Lobe::Ward { alpha } if alpha[0] == alpha[1] => (3, alpha[0]),
            Lobe::CookTorrance { slope } => (4, slope),
            _ => return None,
        };
        let at = (alpha.sqrt() - FIRST_WIDTH) / (1.0 - FIRST_WIDTH) * (WIDTHS - 1) as f64;
        let (first, between) = match at {
            // Narrower lobes than the first are narrower than a texel, too.
            at if at < 0.0 => return None,
            at => (at as usize, at - (at as usize).min(WIDTHS - 2) as f64),
        };
        let first = first.min(WIDTHS - 2);
        let table = |k: usize| {
            self.families[family][k].get_or_init(|| {
                let width = FIRST_WIDTH + (1.0 - FIRST_WIDTH) * k as f64 / (WIDTHS - 1) as f64;
                BrdfTable::new(&of_width(family, width * width))
            })
        };
        Some((table(first), table(first + 1), between as f32))
    }
}

fn of_width(family: usize, alpha: f64) -> Lobe<'static> {
    match family {
        0 => Lobe::Ggx { alpha: [alpha; 2] },
        1 => Lobe::Phong { exponent: phong::exponent(alpha) },
        2 => Lobe::BlinnPhong { exponent: phong::exponent(alpha) },
        3 => Lobe::Ward { alpha: [alpha; 2] },
        _ => Lobe::CookTorrance { slope: alpha },
    }
}

/// A point's lobe toward an eye, asked for squares of world directions.
pub struct SquareLobe<'a> {
    lobe: &'a Lobe<'a>,
    tables: Option<(&'a BrdfTable, &'a BrdfTable, f32)>,
    /// Rows: axes of the disc; the view's azimuth on the first, but for stretched lobes, where it is the tangent.
    axes: [[f64; 3]; 3],
    view: [f64; 3],
}

impl<'a> SquareLobe<'a> {
    /// Toward the unit `view`; `None` where the point reflects nothing there.
    pub fn new(point: &'a PointLobe<'a>, tables: &'a Tables, view: [f32; 3]) -> Option<SquareLobe<'a>> {
        if point.lobe == Lobe::None {
            return None;
        }
        let normal = point.normal.map(f64::from);
        let length = dot(normal, normal).sqrt();
        let n = if length > 0.0 { normal.map(|x| x / length) } else { return None };
        let v = view.map(f64::from);
        let is_stretched = matches!(point.lobe, Lobe::Ggx { alpha } | Lobe::Ward { alpha } if alpha[0] != alpha[1]);
        let along = if is_stretched { point.tangent.map(f64::from) } else { v };
        let height = dot(along, n);
        let x: [f64; 3] = std::array::from_fn(|k| along[k] - height * n[k]);
        let length = dot(x, x).sqrt();
        let x = if length > 1e-6 { x.map(|c| c / length) } else { tangents(n).0 };
        let y = [n[1] * x[2] - n[2] * x[1], n[2] * x[0] - n[0] * x[2], n[0] * x[1] - n[1] * x[0]];
        let local = lift([dot(x, v), dot(y, v), dot(n, v)]);
        Some(SquareLobe { lobe: &point.lobe, tables: tables.around(&point.lobe), axes: [x, y, n], view: local })
    }

    /// Mean of the lobe over a square around a unit direction, `[term][channel]`, sr⁻¹; 0 below the horizon.
    pub fn mean(&self, centre: [f32; 3], half: f32) -> Glossy {
        let c = centre.map(f64::from);
        let local = self.axes.map(|axis| dot(axis, c));
        if half < SMALL {
            return if local[2] > 0.0 { self.lobe.terms(self.view, local).map(|term| term.map(|x| x as f32)) } else { Glossy::default() };
        }
        let p = disc_from_direction(local.map(|x| x as f32));
        // No corner of the square is above the horizon.
        let reach = 1.0 + std::f32::consts::SQRT_2 * half;
        if p[0] * p[0] + p[1] * p[1] > reach * reach {
            return Glossy::default();
        }
        match self.tables {
            Some((near, far, between)) => {
                let [near, far] = [near, far].map(|table| table.mean(self.view[2] as f32, p, half));
                std::array::from_fn(|term| [near[term] + between * (far[term] - near[term]); 3])
            }
            None => sampled(self.lobe, self.view, p, half, DIRECT).map(|term| term.map(|x| x as f32)),
        }
    }
}

impl SquareLobe<'_> {
    /// [`SquareLobe::mean`], and the standard deviation over the square of the sum of its terms. In small squares the deviation falls with
    /// their side.
    pub fn mean_and_deviation(&self, centre: [f32; 3], half: f32) -> (Glossy, f32) {
        let c = centre.map(f64::from);
        let local = self.axes.map(|axis| dot(axis, c));
        let p = disc_from_direction(local.map(|x| x as f32));
        let (wide, mean) = (half.max(SMALL), self.mean(centre, half));
        let (sum, square) = match self.tables {
            Some((near, far, between)) => {
                let [near, far] = [near, far].map(|table| table.mean(self.view[2] as f32, p, wide));
                let [base, rest, square] = std::array::from_fn(|k| near[k] + between * (far[k] - near[k]));
                (base + rest, square)
            }
            None => {
                let values: [f32; DIRECT * DIRECT] = std::array::from_fn(|s| {
                    let at = |k: usize, i: usize| p[k] + wide * (2.0 * (i as f32 + 0.5) / DIRECT as f32 - 1.0);
                    let place = [at(0, s % DIRECT), at(1, s / DIRECT)].map(f64::from);
                    let inside = place[0] * place[0] + place[1] * place[1] < 1.0;
                    let [base, rest] = if inside { self.lobe.terms(self.view, direction_from_disc(place)) } else { [[0.0; 3]; 2] };
                    (base[1] + rest[1]) as f32
                });
                let n = values.len() as f32;
                (values.iter().sum::<f32>() / n, values.iter().map(|value| value * value).sum::<f32>() / n)
            }
        };
        let deviation = (square - sum * sum).max(0.0).sqrt();
        (mean, deviation * (half / wide))
    }
}

/// Mean of a lobe over a square of its disc by `n`² samples: what tables are held against.
pub fn sampled(lobe: &Lobe, view: [f64; 3], p: [f32; 2], half: f32, n: usize) -> [[f64; 3]; 2] {
    let mut sum = [[0.0; 3]; 2];
    for s in 0..n * n {
        let at = |k: usize, i: usize| f64::from(p[k]) + f64::from(half) * (2.0 * (i as f64 + 0.5) / n as f64 - 1.0);
        let place = [at(0, s % n), at(1, s / n)];
        if place[0] * place[0] + place[1] * place[1] < 1.0 {
            let value = lobe.terms(view, direction_from_disc(place));
            (0..6).for_each(|k| sum[k / 3][k % 3] += value[k / 3][k % 3]);
        }
    }
    sum.map(|term| term.map(|x| x / (n * n) as f64))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::square_light::tree_tests::noise;

    #[test]
    fn tables_are_means_of_their_lobe() {
        let lobes = [
            Lobe::Ggx { alpha: [0.36; 2] },
            Lobe::Ggx { alpha: [0.09; 2] },
            Lobe::Phong { exponent: 10.0 },
            Lobe::Phong { exponent: 50.0 },
            Lobe::BlinnPhong { exponent: 40.0 },
            Lobe::Ward { alpha: [0.3; 2] },
            Lobe::CookTorrance { slope: 0.25 },
        ];
        let tables = Tables::default();
        for lobe in lobes {
            let point = PointLobe { lobe, normal: [0.0, 0.0, 1.0], tangent: [0.0; 3] };
            let (mut off, mut all) = (0.0, 0.0);
            for i in 0..300 {
                let angle = 1.5 * noise(4 * i);
                let asked = SquareLobe::new(&point, &tables, [angle.sin(), 0.0, angle.cos()]).unwrap();
                // About the mirror direction, where there is something to find.
                let p: [f32; 2] = std::array::from_fn(|k| 1.4 * (noise(4 * i + 1 + k) - 0.5));
                let p = [p[0] - 0.8 * (angle / 2.0).sin(), p[1]];
                let half = SMALL + 0.5 * noise(4 * i + 3).powi(2);
                if p[0] * p[0] + p[1] * p[1] > 1.9 {
                    continue;
                }
                let centre = direction_from_disc(p.map(f64::from)).map(|x| x as f32);
                let (found, expected) = (asked.mean(centre, half), sampled(&lobe, asked.view, p, half, 48));
                for term in 0..2 {
                    off += (f64::from(found[term][0]) - expected[term][0]).powi(2);
                    all += expected[term][0].powi(2);
                }
            }
            let error = (off / all).sqrt();
            println!("{lobe:?}: {error:.4}");
            assert!(error < 0.08, "{lobe:?}: {error}");
        }
    }

    #[test]
    fn small_squares_are_the_formula_and_what_is_below_is_dark() {
        let point = PointLobe::ggx([0.0, 0.0, 1.0], 0.3);
        let tables = Tables::default();
        let asked = SquareLobe::new(&point, &tables, [0.6, 0.0, 0.8]).unwrap();
        let expected = point.lobe.terms([0.6, 0.0, 0.8], [-0.6, 0.0, 0.8]);
        let found = asked.mean([-0.6, 0.0, 0.8], 0.01);
        assert!((f64::from(found[0][0]) / expected[0][0] - 1.0).abs() < 1e-4);
        assert_eq!(asked.mean([0.0, 0.6, -0.8], 0.01), Glossy::default());
        assert_eq!(asked.mean([0.0, 0.1, -0.995], 0.2), Glossy::default());
        assert!(SquareLobe::new(&PointLobe::NONE, &tables, [0.0, 0.0, 1.0]).is_none());
    }
}

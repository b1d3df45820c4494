//! What is charted.

use prelight_runtime::asset::Asset;
use prelight_runtime::block_product::Accuracy;

/// A technique at one budget.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Technique {
    /// Block products: exact diffuse, glossy to an accuracy.
    BlockProduct {
        /// A relative 0 is the plain sum.
        accuracy: Accuracy,
    },
    /// Sums over texels: tiled SIMD for diffuse, over the open texels for glossy.
    PixelSums,
    /// \[NRH04\], a share of the coefficients of light and of surface kept.
    HaarTriple {
        /// 0..=1 of 6·n² per channel.
        share: f64,
    },
    /// \[SKS02\].
    ShProduct {
        /// 5: 25 coefficients, 10: 100.
        bands: usize,
    },
    /// Block products with the lobes of \[LD09\] for light that came over another surface; only of assets that have lobes.
    VmfTransfer,
}

impl Technique {
    /// All that show direct light, in the order of tables.
    pub const ALL: [Technique; 10] = [
        Technique::block_product(0.3, Accuracy::DISPLAY.floor),
        Technique::block_product(Accuracy::DISPLAY.relative, Accuracy::DISPLAY.floor),
        Technique::block_product(Accuracy::FINE.relative, Accuracy::FINE.floor),
        Technique::block_product(1e-4, Accuracy::FINE.floor),
        Technique::PLAIN,
        Technique::PixelSums,
        Technique::HaarTriple { share: 0.01 },
        Technique::HaarTriple { share: 0.1 },
        Technique::ShProduct { bands: 5 },
        Technique::ShProduct { bands: 10 },
    ];

    /// Block products without any tolerance: the exact sum in f32.
    pub const PLAIN: Technique = Technique::block_product(0.0, Accuracy::FINE.floor);

    /// Block products to [`Accuracy`] `relative` and `floor`.
    pub const fn block_product(relative: f32, floor: f32) -> Technique {
        Technique::BlockProduct { accuracy: Accuracy { relative, floor } }
    }

    /// What can be charted of an asset: [`Technique::ALL`], and lobes where there are any.
    pub fn of(asset: &Asset) -> Vec<Technique> {
        let has_lobes = asset.patches().iter().any(|patch| patch.transfer().is_some());
        Self::ALL.into_iter().chain(has_lobes.then_some(Technique::VmfTransfer)).collect()
    }

    /// Whether `pixel_product` is its truth at points: lobes add light that it has not.
    pub fn is_direct(&self) -> bool {
        *self != Technique::VmfTransfer
    }

    /// Whether diffuse light is kept while only the eye moves.
    pub fn keeps_diffuse(&self) -> bool {
        matches!(self, Technique::BlockProduct { .. } | Technique::PixelSums | Technique::VmfTransfer)
    }

    /// Name of the technique without its budget.
    pub fn name(&self) -> &'static str {
        match self {
            Technique::BlockProduct { .. } => "block_product",
            Technique::PixelSums => "pixel_sums",
            Technique::HaarTriple { .. } => "haar_triple",
            Technique::ShProduct { .. } => "sh_product",
            Technique::VmfTransfer => "vmf_transfer",
        }
    }

    /// Its budget, as tables print it.
    pub fn budget(&self) -> String {
        match self {
            Technique::BlockProduct { accuracy } => match *accuracy {
                Accuracy::DISPLAY => format!("display, {}", accuracy.relative),
                Accuracy::FINE => format!("fine, {}", accuracy.relative),
                _ => format!("tolerance {}", accuracy.relative),
            },
            Technique::PixelSums => "all texels".to_string(),
            Technique::HaarTriple { share } => format!("{} %", 100.0 * share),
            Technique::ShProduct { bands } => format!("{} coefficients", bands * bands),
            Technique::VmfTransfer => "one bounce".to_string(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_has_a_label_of_its_own() {
        let mut labels: Vec<String> = Technique::ALL.iter().map(|t| format!("{} {}", t.name(), t.budget())).collect();
        labels.sort();
        labels.dedup();
        assert_eq!(labels.len(), Technique::ALL.len(), "{labels:?}");
    }
}

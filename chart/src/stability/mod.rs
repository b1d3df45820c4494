//! Where each method fails: every known mode with its figures and the bounds that they must keep.
//!
//! One table, [`MODES`], is what the tests run (small: [`Sizes::REDUCED`]) and what `prelight chart --stability` shows (whole:
//! [`Sizes::FULL`]). A bound is the figure of today with room for other sizes, or what was promised where that is more; a figure that outgrows
//! it is a fault.
//!
//! | file | modes |
//! |---|---|
//! | [`temporal`] | turning light, circling eye: pictures against the path tracer, frame by frame |
//! | [`light`] | one texel that sweeps over borders, steps and scales of exposure, drift of incremental sums |
//! | [`surfaces`] | thin sheets, coincident surfaces, order and names in files |
//! | [`lobes`] | limits of half floats, lobes unlike each other, widths without end |
//! | [`limit`] | bounds of figures |
//! | [`page`] | the page |

pub mod light;
pub mod lobes;
pub mod page;
pub mod scenes;
pub mod surfaces;
pub mod temporal;

pub use crate::limit::Limit;
use crate::limit::{grown, limit};
use crate::methods::FLICKER_LIMITS;
use prelight_bake::error::BakeError;
use prelight_bake::progress::{Progress, check};
use prelight_runtime::asset::Asset;
use prelight_runtime::environment::Environment;
use prelight_scene::Scene;
use std::path::Path;
use std::sync::{Arc, OnceLock};

/// How much of each mode is run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sizes {
    /// Frames of a sequence of pictures.
    pub frames: usize,
    /// Their width and height.
    pub size: [usize; 2],
    /// Samples a pixel of their references. A quarter of them shows the flicker of the path tracer, not ours.
    pub samples: u32,
    /// Places of a light that sweeps.
    pub sweep: usize,
    /// Frames of incremental sums.
    pub drift: usize,
}

impl Sizes {
    /// For tests: seconds.
    pub const REDUCED: Sizes = Sizes { frames: 5, size: [64, 36], samples: 256, sweep: 48, drift: 2_000 };
    /// For the page: minutes.
    pub const FULL: Sizes = Sizes { frames: 200, size: [96, 54], samples: 256, sweep: 720, drift: 100_000 };
}

/// A way in which a method can fail.
pub struct Mode {
    /// For people.
    pub name: &'static str,
    /// Technique that it is about.
    pub method: &'static str,
    /// What is done and what would be seen.
    pub says: &'static str,
    /// Its figures.
    pub limits: &'static [Limit],
    /// Makes them.
    pub run: fn(&Bench) -> Result<Found, BakeError>,
}

/// What a mode gave.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Found {
    /// In the order of [`Mode::limits`].
    pub figures: Vec<f64>,
    /// How the first figure went over frames or places, if it did.
    pub series: Vec<f64>,
    /// PNG of the worst frame and of what flickers in it.
    pub pictures: Option<[Vec<u8>; 2]>,
}

/// What modes share.
pub struct Bench<'a> {
    /// How much is run.
    pub sizes: Sizes,
    /// For stores of what is baked.
    pub folder: &'a Path,
    /// Progress and cancelling.
    pub progress: &'a dyn Progress,
    still: OnceLock<(Scene, Arc<Asset>)>,
}

impl<'a> Bench<'a> {
    /// Nothing is baked yet. `folder` is there and may be filled.
    pub fn new(sizes: Sizes, folder: &'a Path, progress: &'a dyn Progress) -> Self {
        Bench { sizes, folder, progress, still: OnceLock::new() }
    }

    /// A floor, a box, a ball and a sheet, baked once.
    pub(super) fn still_life(&self) -> Result<(&Scene, &Arc<Asset>), BakeError> {
        if self.still.get().is_none() {
            let scene = scenes::still_life();
            let asset = self.baked(&scene, 0.025)?;
            let _ = self.still.set((scene, asset));
        }
        let (scene, asset) = self.still.get().expect("set above");
        Ok((scene, asset))
    }

    pub(super) fn baked(&self, scene: &Scene, edge_length: f32) -> Result<Arc<Asset>, BakeError> {
        scenes::baked(scene, edge_length, self.folder, self.progress)
    }
}

/// A mode with what it gave.
pub struct Outcome {
    /// The mode.
    pub mode: &'static Mode,
    /// Its figures.
    pub found: Found,
    /// What of it was run.
    pub sizes: Sizes,
}

impl Outcome {
    /// Each figure with its limit, and whether it is kept: NaN is not.
    pub fn figures(&self) -> impl Iterator<Item = (Limit, f64, bool)> {
        let limits = self.mode.limits.iter().map(|limit| limit.of(self.sizes == Sizes::REDUCED));
        limits.zip(&self.found.figures).map(|(limit, figure)| (limit, *figure, *figure <= limit.most))
    }

    /// All figures are there and within their limits.
    pub fn holds(&self) -> bool {
        self.found.figures.len() == self.mode.limits.len() && self.figures().all(|(.., kept)| kept)
    }
}

/// Runs every mode.
///
/// # Errors
/// A scene that cannot be baked, [`BakeError::Cancelled`].
pub fn run_all(bench: &Bench) -> Result<Vec<Outcome>, BakeError> {
    let one = |mode: &'static Mode| {
        check(bench.progress)?;
        bench.progress.message(mode.name);
        Ok(Outcome { mode, found: (mode.run)(bench)?, sizes: bench.sizes })
    };
    MODES.iter().map(one).collect()
}

/// Maps whose bound under a light that turns by 0.25° a frame is known: 99.9th percentile of the temporal error, steps of 1/255. The first was
/// promised, the others are recorded.
pub const MAPS: [(&str, f64); 5] = [
    ("aristea_wreck_puresky", 4.0),
    ("noon_grass", 2.0),
    ("st_peters_square_night", 6.0),
    ("studio_small_05", 4.0),
    ("thatch_chapel", 5.0),
];

/// A map's temporal error in the still life, and its bound where one is known.
///
/// # Errors
/// As [`run_all`].
pub fn run_map(bench: &Bench, name: &str, environment: &Environment) -> Result<(Found, Option<f64>), BakeError> {
    let found = temporal::pictures(bench, environment, crate::motion::Motion::Light, 0.25)?;
    Ok((found, MAPS.iter().find(|(known, _)| name.contains(known)).map(|(_, most)| *most)))
}

/// Figures of a sequence of pictures, reduced and whole.
const fn sequence(p999: [f64; 2], max: [f64; 2], jump: f64) -> [Limit; 3] {
    [
        grown("99.9th percentile, of 255", p999[0], p999[1]),
        grown("maximum, of 255", max[0], max[1]),
        limit("worst frame, times the median frame", jump),
    ]
}

const SLOW: &[Limit] = &sequence([9.0; 2], [16.0; 2], temporal::MOST_JUMP);
const FAST: &[Limit] = &sequence([30.0, 50.0], [45.0, 150.0], temporal::MOST_JUMP);
const ORBIT: &[Limit] = &sequence([9.0, 13.0], [16.0, 40.0], temporal::MOST_JUMP);

/// Every mode.
pub const MODES: &[Mode] = &[
    Mode {
        name: "light turning slowly",
        method: "block_product",
        says: "A sky with a sun turns by 0.25° a frame. Shadow borders that jump from texel to texel would flicker.",
        limits: SLOW,
        run: temporal::slow_light,
    },
    Mode {
        name: "light turning fast",
        method: "block_product",
        says: "The same sky, 5° a frame: every texel of the sun is another one in each frame.",
        limits: FAST,
        run: temporal::fast_light,
    },
    Mode {
        name: "eye circling",
        method: "block_product",
        says: "The eye goes around the scene by 0.25° a frame. Highlights that pop between points or levels would flicker; outlines alias in both.",
        limits: ORBIT,
        run: temporal::moving_view,
    },
    Mode {
        name: "flicker of each technique",
        method: "all",
        says: "At points, against the sum over texels, while the light turns by 0.25° a frame: what drops coefficients flickers.",
        limits: FLICKER_LIMITS,
        run: temporal::flicker_of_all,
    },
    Mode {
        name: "one bright texel over block and face borders",
        method: "block_product",
        says: "All light in one pixel of the sky, which goes around at 20° and at 50°: an open floor must see the cosine, whatever texel holds it.",
        limits: &[limit("irradiance off the cosine, share", 1e-5), limit("jump between neighbours, share", 1e-5)],
        run: light::sweep_around,
    },
    Mode {
        name: "one bright texel over the horizon",
        method: "block_product",
        says: "The pixel rises from 3° below the floor's horizon to 6° above. A texel on the horizon is in or out as a whole.",
        limits: &[limit("irradiance off the cosine, share of the zenith's", 0.01)],
        run: light::sweep_horizon,
    },
    Mode {
        name: "exposure steps",
        method: "block_product",
        says: "Light times powers of two: all figures of all points must be the same bits, scaled.",
        limits: &[limit("worst relative difference", 0.0)],
        run: light::exposure_steps,
    },
    Mode {
        name: "1e-4 and 1e5 times the light",
        method: "block_product",
        says: "Nothing may vanish, overflow or change its share. Glossy light is computed to a tolerance of 1e-3, which other roundings meet otherwise.",
        limits: &[limit("diffuse: worst difference, of the brightest", 2e-6), limit("glossy: the same", 1e-3), limit("not finite", 0.0)],
        run: light::scales,
    },
    Mode {
        name: "no light",
        method: "block_product",
        says: "Black in, black out: to the last bit.",
        limits: &[limit("most that is left", 0.0)],
        run: light::darkness,
    },
    Mode {
        name: "drift of incremental sums",
        method: "block_product",
        says: "One block of the light flashes 10⁴ times brighter every 200 frames and jitters between; only that block is summed again. Against a fresh sum at the end.",
        limits: &[limit("worst relative difference", 1e-4)],
        run: light::drift,
    },
    Mode {
        name: "a sheet 0.1 mm over a floor",
        method: "block_product",
        says: "Rays start beside their surface: what is nearer than that start would be missed, and the floor lit through the sheet.",
        limits: &[limit("points below that see light, share", 0.0)],
        run: surfaces::thin_sheet,
    },
    Mode {
        name: "coincident surfaces",
        method: "block_product",
        says: "A rug in the very plane of its floor: neither may blacken the other where it is shown.",
        limits: &[limit("shown points off the bare floor by 1 %, share", 0.0)],
        run: surfaces::coincident,
    },
    Mode {
        name: "objects in another order",
        method: "block_product",
        says: "The same scene with its objects listed backwards: the same light at the same place, to the last bit.",
        limits: &[limit("points that differ", 0.0)],
        run: surfaces::reordered,
    },
    Mode {
        name: "nodes with other names",
        method: "block_product",
        says: "Names decide in which order points are stored, never what they see.",
        limits: &[limit("points that differ", 0.0)],
        run: surfaces::renamed,
    },
    Mode {
        name: "limits of half floats",
        method: "vmf_transfer",
        says: "Weights and widths of 0, 6e-8, 65519, 65520, 1e6, infinity and NaN through a record: nothing comes back infinite or not a number.",
        limits: &[limit("not finite", 0.0), limit("relative rounding of what fits", 4.9e-4)],
        run: lobes::half_floats,
    },
    Mode {
        name: "interpolation between unlike lobes",
        method: "vmf_transfer",
        says: "Opposite, black, narrow and wide lobes, all weights on one or spread: weight is kept and nothing is not a number.",
        limits: &[limit("not finite", 0.0), limit("weight lost or made, share", 1e-6)],
        run: lobes::unlike,
    },
    Mode {
        name: "widths without end",
        method: "vmf_transfer",
        says: "κ of 0, 1e-30 to 1e6: density and mean cosine stay finite and on the reference values.",
        limits: &[
            limit("not finite", 0.0),
            limit("relative error of the density, f32", 5e-7),
            limit("relative error of the mean cosine, f64", 1e-12),
        ],
        run: lobes::widths,
    },
    Mode {
        name: "a lobe against itself",
        method: "vmf_transfer",
        says: "The distance of equal lobes is exactly 0, that of opposite ones finite: refinement decides by it.",
        limits: &[limit("distance of equal lobes", 0.0), limit("not finite", 0.0)],
        run: lobes::distances,
    },
];

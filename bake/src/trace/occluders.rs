//! The public face: what blocks light in a scene, and the questions that can be asked of it.

use super::coverage::{self, Excluded, Scalar, Waiting, Window};
use super::horizon;
use super::mask::MaskTable;
use super::predicate::{View, canonical_order};
use super::ray::{self, Hit, ORDERS, RayScene};
use super::samples::Sampled;
#[cfg(target_arch = "x86_64")]
use super::simd;
use super::tree::{EMPTY, Tree};
use super::{SimdPath, TraceOrigin};
use obvhs::BvhBuildParams;
use prelight_runtime::surface::Texture;
use prelight_scene::world::World;
use rayon::prelude::*;

/// How much work goes into the tree. Changes time, never an answer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TreeQuality {
    /// obvhs' preset of that name.
    Fastest,
    /// obvhs' preset of that name.
    VeryFast,
    /// obvhs' preset of that name.
    Fast,
    /// obvhs' preset of that name; about 0.75 s of CPU per million triangles.
    #[default]
    Medium,
    /// obvhs' preset of that name, without splits.
    Slow,
    /// obvhs' preset of that name, without splits; about 6 s of CPU per million triangles, for final bakes.
    VerySlow,
}

impl TreeQuality {
    /// All of them, fastest first.
    #[cfg(test)]
    pub(crate) const ALL: [TreeQuality; 6] =
        [TreeQuality::Fastest, TreeQuality::VeryFast, TreeQuality::Fast, TreeQuality::Medium, TreeQuality::Slow, TreeQuality::VerySlow];

    fn params(self) -> BvhBuildParams {
        match self {
            TreeQuality::Fastest => BvhBuildParams::fastest_build(),
            TreeQuality::VeryFast => BvhBuildParams::very_fast_build(),
            TreeQuality::Fast => BvhBuildParams::fast_build(),
            TreeQuality::Medium => BvhBuildParams::medium_build(),
            TreeQuality::Slow => BvhBuildParams::slow_build(),
            TreeQuality::VerySlow => BvhBuildParams::very_slow_build(),
        }
    }
}

/// How occluders are built and asked. None of it changes an answer.
#[derive(Clone, Copy, Debug)]
pub struct OccluderOptions {
    /// Effort of the builder.
    pub quality: TreeQuality,
    /// Triangles of a leaf at most, 8..=120. Coverage likes 64, single rays 8 to 16.
    pub leaf_size: usize,
    /// Instructions to use.
    pub simd: SimdPath,
}

impl Default for OccluderOptions {
    fn default() -> Self {
        OccluderOptions { quality: TreeQuality::default(), leaf_size: 64, simd: SimdPath::detect() }
    }
}

/// Everything in a scene that blocks light, as one tree or as one a layer. Shared by all threads.
#[derive(Clone, Debug, Default)]
pub struct Occluders {
    /// In the order in which coverage asks them.
    trees: Vec<Tree>,
    masks: MaskTable,
    /// `[triangles]` index into `ray::ORDERS`.
    orders: Vec<u8>,
    simd: SimdPath,
}

/// Working memory of one thread; reused, nothing is allocated per point once it has grown.
#[derive(Clone, Debug)]
pub struct Scratch {
    stack: Vec<Waiting>,
    excluded: Excluded,
    window: Window,
}

impl Default for Scratch {
    fn default() -> Self {
        Scratch { stack: Vec::new(), excluded: Excluded::default(), window: Window::closed() }
    }
}

impl Occluders {
    /// Builds from all triangles that block. `textures` are the scene's; only those that cut-outs name are kept.
    ///
    /// # Panics
    /// If an index of `world` is out of range.
    pub fn build(world: &World, textures: &[Texture<'static>], options: OccluderOptions) -> Self {
        Self::build_where(world, textures, options, |_| true)
    }

    /// Builds from the blocking triangles whose id `keep` accepts.
    pub(crate) fn build_where(world: &World, textures: &[Texture<'static>], options: OccluderOptions, keep: impl Fn(u32) -> bool) -> Self {
        let tree = Tree::build(world, options.quality.params(), options.leaf_size, keep);
        Self::of_trees(world, textures, options, vec![tree])
    }

    /// Builds from a few triangles, by id: those of them that block. Only what they need of the world is looked at.
    ///
    /// # Panics
    /// If an id is out of range.
    pub(crate) fn build_of(world: &World, textures: &[Texture<'static>], options: OccluderOptions, mut ids: Vec<u32>) -> Self {
        ids.sort_unstable();
        ids.dedup();
        let tree = Tree::build_of(world, options.quality.params(), options.leaf_size, ids);
        Self::of_trees(world, textures, options, vec![tree])
    }

    /// Builds one tree a layer: `layer_of[id]` is that of a triangle, 0 is asked first. Big things first, so that most of what is small is
    /// never looked at; the answers are those of one tree.
    ///
    /// # Panics
    /// If an index of `world` is out of range or `layer_of` has another length.
    pub fn build_layers(world: &World, textures: &[Texture<'static>], options: OccluderOptions, layer_of: &[u8], n_layers: usize) -> Self {
        assert_eq!(layer_of.len(), world.positions.len(), "one layer a triangle");
        let build =
            |layer: usize| Tree::build(world, options.quality.params(), options.leaf_size, |id| layer_of[id as usize] as usize == layer);
        let trees = (0..n_layers).into_par_iter().map(build).collect();
        Self::of_trees(world, textures, options, trees)
    }

    fn of_trees(world: &World, textures: &[Texture<'static>], options: OccluderOptions, trees: Vec<Tree>) -> Self {
        let order_of = |corners: &[[f32; 3]; 3]| {
            let order = canonical_order(corners);
            ORDERS.iter().position(|o| *o == order).unwrap_or(0) as u8
        };
        Occluders {
            trees,
            masks: MaskTable::new(world, textures),
            orders: world.positions.iter().map(order_of).collect(),
            simd: options.simd.available(),
        }
    }

    /// Trees that coverage asks one after the other.
    pub(crate) fn n_layers(&self) -> usize {
        self.trees.len()
    }

    /// Which texels see past everything: n_s·ω > 0 and no occluder.
    ///
    /// `open`: one bit a texel, 1 = open, shape `[6, n, n / 64]` u64 for n = `face_resolution` (64, 128, ...): texel (face, y, x) is bit
    /// x mod 64 of word (face·n + y)·(n / 64) + x / 64. Overwritten.
    ///
    /// # Panics
    /// If `face_resolution` is not a power of two from 64 up or `open` has another length.
    pub fn open_texels(&self, from: &TraceOrigin, face_resolution: usize, scratch: &mut Scratch, open: &mut [u64]) {
        horizon::above_horizon(from.normal, face_resolution, open);
        self.close_covered(from, face_resolution, scratch, open);
    }

    /// The same with 8×8 samples of every texel (`trace::samples`): a bit of `open` says that a sample of the texel is open; `parts` lists, by
    /// number of texel (face·n² + y·n + x), the open samples of those texels of which some are not. Both are overwritten.
    ///
    /// # Panics
    /// As `open_texels`.
    pub(crate) fn open_samples(
        &self,
        from: &TraceOrigin,
        face_resolution: usize,
        scratch: &mut Scratch,
        open: &mut [u64],
        parts: &mut Vec<(u32, u64)>,
    ) {
        horizon::above_horizon(from.normal, face_resolution, open);
        parts.clear();
        for layer in 0..self.trees.len() {
            self.close_samples_by(layer, 0..6, from, face_resolution, scratch, (open, parts));
        }
    }

    /// Clears the bits of `open` that an occluder covers; bits that are already 0 cost nothing. `from.normal` is not read.
    ///
    /// A texel's new bit depends only on its old one, so work can be cut by texels or by layers of occluders in any way.
    pub(crate) fn close_covered(&self, from: &TraceOrigin, face_resolution: usize, scratch: &mut Scratch, open: &mut [u64]) {
        (0..self.trees.len()).for_each(|layer| self.close_covered_by(layer, 0..6, from, face_resolution, scratch, open));
    }

    /// [`Occluders::close_covered`] by the layers from `first` on, on some of the faces: for few open texels, of which each face is set up once
    /// for all layers.
    ///
    /// # Panics
    /// If there are fewer layers than `first`, and as `close_covered`.
    pub(crate) fn close_covered_from(
        &self,
        first: usize,
        faces: impl Iterator<Item = usize>,
        from: &TraceOrigin,
        face_resolution: usize,
        scratch: &mut Scratch,
        open: &mut [u64],
    ) {
        check_size(face_resolution, open);
        let Scratch { stack, excluded, window } = scratch;
        close_windows(faces, face_resolution, window, open, |face, corner, window| {
            let view = View::new(from.origin, face_resolution, face, corner);
            for tree in self.trees[first..].iter().filter(|tree| tree.root != EMPTY) {
                stack.reserve(tree.stack_size);
                excluded.set(tree, from.base_triangles);
                self.cover(coverage::Scene { tree, masks: &self.masks, excluded }, &view, window, stack);
                if window.any == 0 {
                    break;
                }
            }
        });
    }

    /// [`Occluders::close_covered`] by the occluders of one layer alone, on some of the faces.
    ///
    /// # Panics
    /// If there is no such layer, and as `close_covered`.
    pub(crate) fn close_covered_by(
        &self,
        layer: usize,
        faces: impl Iterator<Item = usize>,
        from: &TraceOrigin,
        face_resolution: usize,
        scratch: &mut Scratch,
        open: &mut [u64],
    ) {
        check_size(face_resolution, open);
        let tree = &self.trees[layer];
        if tree.root == EMPTY {
            return;
        }
        let Scratch { stack, excluded, window } = scratch;
        stack.reserve(tree.stack_size);
        excluded.set(tree, from.base_triangles);
        let scene = coverage::Scene { tree, masks: &self.masks, excluded };
        close_windows(faces, face_resolution, window, open, |face, corner, window| {
            self.cover(scene, &View::new(from.origin, face_resolution, face, corner), window, stack);
        });
    }

    /// [`Occluders::close_covered_by`] for samples (`trace::samples`). A bit of `open` says that a sample of the texel is open; `parts` lists,
    /// by number of texel (face·n² + y·n + x), the open samples of those texels of which some are not, and is brought up to date.
    ///
    /// # Panics
    /// As `close_covered_by`.
    pub fn close_samples_by(
        &self,
        layer: usize,
        faces: impl Iterator<Item = usize>,
        from: &TraceOrigin,
        face_resolution: usize,
        scratch: &mut Scratch,
        (open, parts): (&mut [u64], &mut Vec<(u32, u64)>),
    ) {
        check_size(face_resolution, open);
        let (n, tree) = (face_resolution, &self.trees[layer]);
        if tree.root == EMPTY {
            return;
        }
        let Scratch { stack, excluded, window } = scratch;
        stack.reserve(tree.stack_size);
        window.samples.resize(64 * 64, 0);
        excluded.set(tree, from.base_triangles);
        let scene = coverage::Scene { tree, masks: &self.masks, excluded };
        let mut done = Vec::with_capacity(parts.len());
        close_windows(faces, n, window, open, |face, [x0, y0], window| {
            let from_texel = |face: usize| parts.partition_point(|(texel, _)| *texel < (face * n * n) as u32);
            window.parts = [0; 64];
            for (texel, samples) in &parts[from_texel(face)..from_texel(face + 1)] {
                let (y, x) = (*texel as usize / n % n, *texel as usize % n);
                if (y / 64 * 64, x / 64 * 64) == (y0, x0) {
                    window.parts[y % 64] |= 1 << (x % 64);
                    window.samples[y % 64 * 64 + x % 64] = *samples;
                }
            }
            self.cover_samples(scene, &View::new(from.origin, n, face, [x0, y0]).for_samples(), window, stack);
            for y in 0..64 {
                let mut rest = window.rows[y] & window.parts[y];
                while rest != 0 {
                    let x = rest.trailing_zeros() as usize;
                    rest &= rest - 1;
                    done.push((((face * n + y0 + y) * n + x0 + x) as u32, window.samples[64 * y + x]));
                }
            }
        });
        if n > 64 {
            done.sort_unstable_by_key(|(texel, _)| *texel);
        }
        *parts = done;
    }

    fn cover_samples(&self, scene: coverage::Scene, view: &View, window: &mut Window, stack: &mut Vec<Waiting>) {
        #[cfg(target_arch = "x86_64")]
        if self.simd >= SimdPath::Avx2
            && let Some(kernel) = simd::Avx2::detect()
        {
            return kernel.cover_samples(scene, view, window, stack);
        }
        coverage::cover(Sampled(Scalar), scene, view, window, stack);
    }

    fn cover(&self, scene: coverage::Scene, view: &View, window: &mut Window, stack: &mut Vec<Waiting>) {
        #[cfg(target_arch = "x86_64")]
        if self.simd >= SimdPath::Avx2
            && let Some(kernel) = simd::Avx2::detect()
        {
            return kernel.cover(scene, view, window, stack);
        }
        coverage::cover(Scalar, scene, view, window, stack);
    }

    fn ray_scenes<'a>(&'a self, excluded: &'a [u32]) -> impl Iterator<Item = RayScene<'a>> {
        self.trees.iter().map(move |tree| RayScene { tree, masks: &self.masks, orders: &self.orders, excluded })
    }

    /// Whether anything blocks the ray for 0 <= t <= `t_max` (t in units of the direction's length). `excluded`: ids that never block.
    pub(crate) fn occluded(&self, origin: [f32; 3], direction: [f32; 3], t_max: f32, excluded: &[u32]) -> bool {
        self.ray_scenes(excluded).any(|scene| {
            #[cfg(target_arch = "x86_64")]
            if self.simd >= SimdPath::Avx2
                && let Some(kernel) = simd::Avx2::detect()
            {
                return kernel.occluded(scene, origin, direction, t_max);
            }
            ray::occluded(scene, origin, direction, t_max)
        })
    }

    /// The nearest surface along the ray, t >= 0. Both faces count; MASK is cut. `excluded`: ids that are passed through.
    pub(crate) fn closest_hit(&self, origin: [f32; 3], direction: [f32; 3], excluded: &[u32]) -> Option<Hit> {
        let in_tree = |scene: RayScene, t_max: f32| {
            #[cfg(target_arch = "x86_64")]
            if self.simd >= SimdPath::Avx2
                && let Some(kernel) = simd::Avx2::detect()
            {
                return kernel.closest_hit(scene, origin, direction, t_max);
            }
            ray::closest_hit(scene, origin, direction, t_max)
        };
        // No tree is asked beyond what those before it met. As within a tree: of hits at equal t the smallest id.
        self.ray_scenes(excluded).fold(None, |best: Option<Hit>, scene| {
            let found = in_tree(scene, best.map_or(f32::INFINITY, |hit| hit.t * ray::BEYOND));
            best.into_iter().chain(found).min_by(|a, b| a.t.total_cmp(&b.t).then(a.triangle.cmp(&b.triangle)))
        })
    }
}

fn check_size(n: usize, open: &[u64]) {
    assert!(n.is_power_of_two() && n >= 64, "face resolution {n} is not a power of two from 64 up");
    assert_eq!(open.len(), 6 * n * (n / 64), "one bit a texel");
}

/// Calls `close` with the face, the first column and row, and the open texels of every window of 64² that has some, and keeps what it
/// leaves open.
#[inline(always)]
fn close_windows(
    faces: impl Iterator<Item = usize>,
    n: usize,
    window: &mut Window,
    open: &mut [u64],
    mut close: impl FnMut(usize, [usize; 2], &mut Window),
) {
    let words = n / 64;
    for face in faces {
        for (wy, wx) in (0..words).flat_map(|y| (0..words).map(move |x| (y, x))) {
            let at = |y: usize| (face * n + wy * 64 + y) * words + wx;
            for y in 0..64 {
                window.rows[y] = open[at(y)];
            }
            window.refresh();
            if window.any == 0 {
                continue;
            }
            close(face, [wx * 64, wy * 64], window);
            for y in 0..64 {
                open[at(y)] = window.rows[y];
            }
        }
    }
}

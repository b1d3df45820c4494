//! Objects that move: where they are, how the light stands in their own axes, and what they take of the light of all points.
//!
//! What moves has its points in its own space. Its own light is exact: the light is turned into that space and summed over what the object itself leaves open. What
//! moves takes of others by shares ([`crate::square_light::share`]): exact still light is kept, and multiplied when it is drawn. A move redoes shares
//! alone, and of the object that turned its own light; nothing at all where the object cannot be seen.

use super::work::Rest;
use crate::asset::Asset;
use crate::block_product::visibility::Visibility;
use crate::chunk::layout::PATCH_POINTS;
use crate::environment::LightCubemap;
use crate::light::layer::{LightOptions, Patch, Sight};
use crate::light::{Layers, PointLobe};
use crate::sphere::frame::dot;
use crate::square_light::brdf::{SquareLobe, Tables};
use crate::square_light::field::Field;
use crate::square_light::regions::{ALL, MOST_REGIONS, Regions};
use crate::square_light::share::{Share, cosine_above, share};
use crate::square_light::{Fit, Pose, Square, Tree};
use prelight_manifests::ChunkKind;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

/// The work that frames took so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WorkCounts {
    /// Points whose irradiance was summed.
    pub summed: u64,
    /// Points whose shares were computed, because a mover may reach them.
    pub shared: u64,
    /// Lights turned into the axes of an object.
    pub turned: u64,
}

/// What a patch's shares are of.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Shared {
    /// Light under which the patch's view of the regions was found; 0: none.
    light: u32,
    /// State of movers and light that the shares are of.
    state: u32,
    eye: Option<[f32; 3]>,
    /// Every share is [`Share::ALL`].
    is_all: bool,
}

/// One object that moves.
struct Mover {
    object: usize,
    points: Range<usize>,
    patches: Range<usize>,
    field: Option<Field>,
    pose: Pose,
    /// The base squares in its own space: centre and half a side.
    squares: Vec<([f32; 3], f32)>,
    /// For light in its own axes; of use where those are not the world's.
    layers: Layers,
    /// Regions of the light in its own axes; `None` where those are the world's.
    turned: Option<Regions>,
}

impl Mover {
    /// What shading its own points needs.
    fn view(&self) -> MoverView<'_> {
        MoverView { pose: &self.pose, layers: self.turned.as_ref().map(|_| &self.layers) }
    }
}

/// The base squares of a light.
struct Squares {
    squares: Vec<Square>,
    /// `[texels]` row-major.
    region_of: Vec<u16>,
    regions: Regions,
}

/// All that moves in an asset.
pub(super) struct Moving {
    movers: Vec<Mover>,
    base: Option<Squares>,
    tables: Tables,
    options: LightOptions,
    casts: bool,
    /// Numbers of the light, and of the state of movers under it.
    light: u32,
    state: u32,
    shared: AtomicU64,
    turned: u64,
    /// `[points]`
    pub shares: Vec<Share>,
    /// `[points]` of 255: what of each region's light a point sees of the still scene.
    pub open: Vec<[u8; MOST_REGIONS]>,
    /// `[patches]`
    pub patches: Vec<Shared>,
}

impl Moving {
    /// `None` where nothing moves. `layers` makes those of the asset anew.
    pub(crate) fn new(asset: &Asset, layers: impl Fn() -> Layers) -> Option<Moving> {
        let mover = |(object, of): (usize, &crate::asset::AssetObject)| {
            let moves = of.moves.as_ref()?;
            let field = moves.field().map(|chunk| Field::open(&chunk));
            Some(Mover {
                object,
                points: of.points.clone(),
                patches: of.patches.clone(),
                field,
                pose: moves.pose,
                squares: Vec::new(),
                layers: layers(),
                turned: None,
            })
        };
        let movers: Vec<Mover> = asset.objects().iter().enumerate().filter_map(mover).collect();
        let n = asset.n_points();
        (!movers.is_empty()).then(|| Moving {
            movers,
            base: None,
            tables: Tables::default(),
            options: LightOptions::default(),
            casts: true,
            light: 0,
            state: 0,
            shared: AtomicU64::new(0),
            turned: 0,
            shares: vec![Share::ALL; n],
            open: vec![[0; MOST_REGIONS]; n],
            patches: vec![Shared::default(); asset.patches().len()],
        })
    }

    /// Takes options for layers of its own.
    pub(crate) fn configure(&mut self, options: &LightOptions, light: Option<&LightCubemap>) {
        self.options = *options;
        for mover in &mut self.movers {
            // The answer is about rows that these layers do not have.
            mover.layers.configure(options, None);
        }
        if let Some(light) = light {
            (0..self.movers.len()).for_each(|mover| self.turn(mover, light));
        }
    }

    /// Makes a light ready.
    pub(crate) fn prepare(&mut self, light: &LightCubemap) {
        let tree = Tree::build(light);
        let cut = tree.base_cut(MOST_REGIONS);
        let region_of = tree.regions(&cut);
        let regions = Regions::build(&region_of, cut.len(), light);
        self.base = Some(Squares { squares: tree.squares(&cut, Fit::Energy), region_of, regions });
        (self.light, self.state) = (self.light + 1, self.state + 1);
        (0..self.movers.len()).for_each(|mover| self.turn(mover, light));
    }

    /// Puts an object somewhere; whether its own light must be summed anew.
    pub(crate) fn place(&mut self, object: usize, pose: Pose, light: Option<&LightCubemap>) -> bool {
        let Some(at) = self.movers.iter().position(|mover| mover.object == object) else { return false };
        let before = std::mem::replace(&mut self.movers[at].pose, pose);
        if before == pose {
            return false;
        }
        self.state += 1;
        let is_turned = before.rotation != pose.rotation;
        match light {
            Some(light) if is_turned => self.turn(at, light),
            _ => {}
        }
        if is_turned {
            // What its points see of each region is another part of the light.
            self.patches[self.movers[at].patches.clone()].fill(Shared::default());
        }
        is_turned
    }

    /// Whether movers take light from anything.
    pub(crate) fn set_casts(&mut self, casts: bool) {
        self.state += u32::from(self.casts != casts);
        self.casts = casts;
    }

    /// Brings the light into the axes of a mover.
    fn turn(&mut self, at: usize, light: &LightCubemap) {
        let mover = &mut self.movers[at];
        if let Some(base) = &self.base {
            mover.squares.clear();
            mover.squares.extend(base.squares.iter().map(|square| (mover.pose.own_direction(square.centre), square.half_side)));
        }
        if mover.pose.is_shift() {
            mover.turned = None;
            return;
        }
        let Some(base) = &self.base else { return };
        let r = mover.pose.rotation;
        let own_from_world = std::array::from_fn(|i| std::array::from_fn(|k| r[k][i]));
        let own = light.turned(&own_from_world);
        mover.layers.prepare(&own, None);
        // What options need of a light is the turned one's.
        mover.layers.configure(&self.options, Some(&own));
        let region_of = turned_regions(&base.region_of, light.face_resolution, &mover.pose);
        mover.turned = Some(Regions::build(&region_of, base.regions.len(), &own));
        self.turned += 1;
    }

    /// Layers with the light in an object's own axes, where those are not the world's.
    pub(crate) fn layers_of(&self, object: usize) -> Option<&Layers> {
        self.movers.iter().find(|mover| mover.object == object)?.view().layers
    }

    /// Counts of its work; those of sums are the caller's.
    pub(crate) fn counts(&self) -> WorkCounts {
        WorkCounts { summed: 0, shared: self.shared.load(Ordering::Relaxed), turned: self.turned }
    }

    /// Parts of its buffers, to be written patch by patch.
    pub(crate) fn split(&mut self) -> (MovingRest<'_>, MovingWork<'_>) {
        let Moving { movers, base, tables, casts, light, state, shared, shares, open, patches, .. } = self;
        let rest = MovingRest { shares: Rest::new(shares), open: Rest::new(open), patches: Rest::new(patches) };
        let work = MovingWork { movers, base: base.as_ref(), tables, casts: *casts, light: *light, state: *state, shared };
        (rest, work)
    }
}

/// Regions of the texels of own space.
fn turned_regions(region_of: &[u16], n: usize, pose: &Pose) -> Vec<u16> {
    use crate::sphere::cubemap::{face_from_direction, texel_direction};
    let r = &pose.rotation;
    let texel = |texel: usize| {
        let d = texel_direction(n, texel / (n * n), texel % n, texel / n % n).map(f64::from);
        let (face, s, t) = face_from_direction(r.map(|row| dot(row, d)));
        let index = |c: f64| (((c + 1.0) * 0.5 * n as f64) as usize).min(n - 1);
        region_of[(face * n + index(t)) * n + index(s)]
    };
    (0..region_of.len()).map(texel).collect()
}

/// What shading a mover's own points needs.
#[derive(Clone, Copy)]
pub(super) struct MoverView<'a> {
    pub pose: &'a Pose,
    /// With the light in its own axes; `None` where those are the world's.
    pub layers: Option<&'a Layers>,
}

/// Buffers of some patches.
#[derive(Default)]
pub(super) struct MovingRest<'a> {
    pub shares: Rest<'a, Share>,
    pub open: Rest<'a, [u8; MOST_REGIONS]>,
    pub patches: Rest<'a, Shared>,
}

impl<'a> MovingRest<'a> {
    /// Takes those of the first patches out, which have so many points.
    pub(crate) fn take(&mut self, patches: usize, points: usize) -> MovingRest<'a> {
        MovingRest { shares: self.shares.take(points), open: self.open.take(points), patches: self.patches.take(patches) }
    }
}

/// What all patches share.
#[derive(Clone, Copy)]
pub(super) struct MovingWork<'a> {
    movers: &'a [Mover],
    base: Option<&'a Squares>,
    tables: &'a Tables,
    casts: bool,
    light: u32,
    state: u32,
    shared: &'a AtomicU64,
}

impl<'a> MovingWork<'a> {
    /// The mover that a point belongs to.
    pub(crate) fn mover_of(&self, point: usize) -> Option<MoverView<'a>> {
        Some(self.movers.iter().find(|mover| mover.points.contains(&point))?.view())
    }

    /// Shares of a patch whose first point is `first`; glossy ones toward the world's `sight`, whose lobes are in the space of the points.
    pub(crate) fn shares(&self, patch: &Patch, first: usize, sight: Option<&Sight>, rest: MovingRest) {
        let Some(base) = self.base else { return };
        let MovingRest { shares, open, patches } = rest;
        let (shares, open, state) = (shares.elements, open.elements, &mut patches.elements[0]);
        let eye = sight.map(|sight| sight.eye);
        if state.state == self.state && (eye.is_none() || eye == state.eye || state.is_all) {
            return;
        }
        let own = self.movers.iter().find(|mover| mover.points.contains(&first));
        let mut reaching = [0usize; MOST_NEAR];
        let n = self.reaching(patch, own, &mut reaching);
        if n == 0 {
            if !state.is_all {
                shares.fill(Share::ALL);
            }
            *state = Shared { light: state.light, state: self.state, eye, is_all: true };
            return;
        }
        if state.light != self.light {
            let regions = own.and_then(|own| own.turned.as_ref()).unwrap_or(&base.regions);
            if let Some(visibility) = patch.factor(ChunkKind::Visibility).map(Visibility::from_proven_chunk) {
                for (i, open) in open.iter_mut().enumerate() {
                    *open = regions.open(&visibility.point(i)).map(|part| part.div_ceil(257).min(255) as u8);
                }
            }
        }
        for (i, share) in shares.iter_mut().enumerate() {
            *share = self.point(patch, i, own, &reaching[..n], (sight, &open[i], &base.squares));
        }
        self.shared.fetch_add(shares.len() as u64, Ordering::Relaxed);
        *state = Shared { light: self.light, state: self.state, eye, is_all: false };
    }

    /// Movers that may block light of a patch: not its own, and not below every horizon. The nearest [`MOST_NEAR`] at most.
    fn reaching(&self, patch: &Patch, own: Option<&Mover>, found: &mut [usize; MOST_NEAR]) -> usize {
        if !self.casts {
            return 0;
        }
        let place = |p: [f32; 3]| own.map_or(p, |own| own.pose.place(p));
        let direction = |n: [f32; 3]| own.map_or(n, |own| own.pose.direction(n));
        let mut n_found = 0;
        for (at, mover) in self.movers.iter().enumerate() {
            let Some(field) = mover.field.as_ref().filter(|_| own.is_none_or(|own| own.object != mover.object)) else { continue };
            let centre = mover.pose.place(field.centre());
            let above = |i: usize| {
                let (p, n) = (place(patch.points.position[i]), direction(patch.points.normal[i]));
                let to: [f32; 3] = std::array::from_fn(|k| centre[k] - p[k]);
                dot(to, n) > -field.radius()
            };
            if n_found < MOST_NEAR && (0..patch.len()).any(above) {
                found[n_found] = at;
                n_found += 1;
            }
        }
        n_found
    }

    /// The share of one point.
    fn point(
        &self,
        patch: &Patch,
        i: usize,
        own: Option<&Mover>,
        reaching: &[usize],
        (sight, open, squares): (Option<&Sight>, &[u8; MOST_REGIONS], &[Square]),
    ) -> Share {
        let (mut position, mut normal) = (patch.points.position[i], patch.points.normal[i]);
        if let Some(own) = own {
            (position, normal) = (own.pose.place(position), own.pose.direction(normal));
        }
        let mut left = [1.0f32; MOST_REGIONS];
        let mut is_touched = false;
        for mover in reaching.iter().map(|at| &self.movers[*at]) {
            let Some(field) = &mover.field else { continue };
            let place = mover.pose.own_place(position);
            let to: [f32; 3] = std::array::from_fn(|k| field.centre()[k] - place[k]);
            if dot(to, mover.pose.own_direction(normal)) <= -field.radius() {
                continue;
            }
            let at = field.at(place);
            for (k, (centre, half)) in mover.squares.iter().enumerate().filter(|(k, _)| open[*k] > 0) {
                let blocked = field.blocked(&at, *centre, *half);
                left[k] *= 1.0 - blocked;
                is_touched |= blocked > 0.0;
            }
        }
        if !is_touched {
            return Share::ALL;
        }
        let blocked = left.map(|left| 1.0 - left);
        let diffuse = share(squares, open, |k| cosine_above(&squares[k], normal), &blocked);
        let glossy = sight.and_then(|sight| self.glossy(sight, i, position, own, (open, squares, &blocked)));
        Share { diffuse, glossy: glossy.unwrap_or(diffuse) }
    }

    /// The share of what a point reflects as a lobe; `None` where it has none.
    fn glossy(
        &self,
        sight: &Sight,
        i: usize,
        position: [f32; 3],
        own: Option<&Mover>,
        (open, squares, blocked): (&[u8; MOST_REGIONS], &[Square], &[f32; MOST_REGIONS]),
    ) -> Option<[f32; 3]> {
        let mut lobe: PointLobe = sight.lobes[i];
        if let Some(own) = own {
            (lobe.normal, lobe.tangent) = (own.pose.direction(lobe.normal), own.pose.direction(lobe.tangent));
        }
        let to: [f32; 3] = std::array::from_fn(|k| sight.eye[k] - position[k]);
        let length = dot(to, to).sqrt();
        let view = (length > 0.0).then(|| to.map(|x| x / length))?;
        let asked = SquareLobe::new(&lobe, self.tables, view)?;
        let mut weight = [0.0; MOST_REGIONS];
        for (k, square) in squares.iter().enumerate().filter(|(k, _)| open[*k] > 0) {
            let [base, rest] = asked.mean(square.centre, square.half_side);
            weight[k] = (0..3).map(|c| base[c] + rest[c]).sum::<f32>();
        }
        Some(share(squares, open, |k| weight[k], blocked))
    }
}

/// Movers that take light from one point at most.
const MOST_NEAR: usize = PATCH_POINTS;
/// The parts of a region are kept in 255ths.
const _: () = assert!(ALL == 255 * 257);

//! Pieces: what enters a key. Each object's occluding triangles, layer by layer, in a tree of its own down to 256 triangles.
//!
//! ```text
//! triangle digest = H(kind, positions in canonical order; MASK: alpha texels, factor, cutoff, sampler, uv and vertex alpha)
//! piece digest    = H(triangle digests, ascending)                  what visibility reads
//! sides digest    = H(per triangle: digest, winding, double-sided)  what the search for buried points reads besides
//! ```
//!
//! Triangles lie in Morton order of their centroids on a **fixed** lattice (2⁻⁷ m), and a node is cut at the highest bit in which its
//! triangles differ: moving one vertex re-cuts nothing elsewhere, as medians or changing bounds would. No index, name, path or order of
//! files enters a digest, nor does winding or sidedness enter the visibility's: both faces block. Only what is traced is here: triangles
//! with an area, that block, within the tracer's range.
//!
//! Keys combine pieces as a wrapping sum of digests, lane by lane: no order to sort by, and two coincident copies do not cancel as they
//! would under exclusive or.

use crate::reach::key::Hasher;
use crate::reach::shaft::Bounds;
use crate::trace::predicate::{canonical_order, is_traceable};
use prelight_manifests::Digest;
use prelight_scene::Scene;
use prelight_scene::world::{Occlusion, World};
use rayon::prelude::*;

/// Triangles of a piece at most.
pub(crate) const PIECE_TRIANGLES: usize = 256;

/// Cells of the lattice a metre.
const LATTICE: f64 = 128.0;

/// A sum of digests: 256 bits in four lanes that wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DigestSum(pub [u64; 4]);

impl DigestSum {
    /// Adds another.
    #[inline]
    pub(crate) fn add(&mut self, other: &DigestSum) {
        for (lane, term) in self.0.iter_mut().zip(other.0) {
            *lane = lane.wrapping_add(term);
        }
    }

    fn of(digest: Digest) -> DigestSum {
        DigestSum(std::array::from_fn(|lane| u64::from_le_bytes(std::array::from_fn(|i| digest.0[8 * lane + i]))))
    }
}

/// Triangles of one object and layer that lie together.
#[derive(Clone, Debug)]
pub struct Piece {
    /// Index of the object in the scene; enters no key.
    pub object: u32,
    /// Bounds of the positions as traced.
    pub bounds: Bounds,
    /// What visibility reads.
    pub digest: DigestSum,
    /// What the search for buried points reads besides.
    pub sides: DigestSum,
}

/// A node of the search, in preorder.
#[derive(Clone, Debug)]
pub(crate) struct PieceNode {
    pub bounds: Bounds,
    /// The node after this one's subtree.
    pub next: u32,
    /// Index of the piece, or [`NO_PIECE`].
    pub piece: u32,
}

/// A node that has children.
pub(crate) const NO_PIECE: u32 = u32::MAX;

/// All pieces of a scene.
#[derive(Clone, Debug, Default)]
pub struct Pieces {
    /// Object by object, layer by layer.
    pub pieces: Vec<Piece>,
    /// `[layers]` trees of all objects, one after the other.
    pub(crate) nodes: Vec<Vec<PieceNode>>,
    /// `[triangles of the world]` digests.
    triangles: Vec<[u8; 16]>,
}

impl Pieces {
    /// Cuts all objects. `layer_of`: `[triangles]`, below `n_layers`.
    pub fn build(scene: &Scene, world: &World, layer_of: &[u8], n_layers: usize) -> Pieces {
        let textures: Vec<Digest> = world.masks.iter().map(|mask| alpha_digest(scene, mask.texture)).collect();
        let triangles: Vec<[u8; 16]> = (0..world.positions.len()).into_par_iter().map(|id| triangle_digest(world, &textures, id)).collect();
        let of_object = |object: usize| -> Vec<(Vec<Piece>, Vec<PieceNode>)> {
            (0..n_layers).map(|layer| cut_object(scene, world, &triangles, layer_of, object, layer as u8)).collect()
        };
        let objects: Vec<_> = (0..scene.objects.len()).into_par_iter().map(of_object).collect();
        let mut all = Pieces { pieces: Vec::new(), nodes: vec![Vec::new(); n_layers], triangles };
        for (layer, (pieces, nodes)) in objects.into_iter().flat_map(|object| object.into_iter().enumerate()) {
            let (first_piece, first_node) = (all.pieces.len() as u32, all.nodes[layer].len() as u32);
            all.pieces.extend(pieces);
            all.nodes[layer].extend(nodes.into_iter().map(|node| {
                let piece = if node.piece == NO_PIECE { NO_PIECE } else { node.piece + first_piece };
                PieceNode { next: node.next + first_node, piece, ..node }
            }));
        }
        all
    }

    /// Every piece with its layer.
    pub(crate) fn by_layer(&self) -> impl Iterator<Item = (u8, &Piece)> {
        let leaves = |nodes: &'_ Vec<PieceNode>| nodes.iter().map(|node| node.piece).filter(|piece| *piece != NO_PIECE).collect::<Vec<_>>();
        let layers = self.nodes.iter().zip(0..).flat_map(move |(nodes, layer)| leaves(nodes).into_iter().map(move |piece| (layer, piece)));
        layers.map(|(layer, piece)| (layer, &self.pieces[piece as usize]))
    }

    /// Number of layers.
    pub(crate) fn n_layers(&self) -> usize {
        self.nodes.len()
    }

    /// Digest of a triangle, by its id in the world.
    pub(crate) fn triangle(&self, id: u32) -> &[u8; 16] {
        &self.triangles[id as usize]
    }

    /// Sum over the pieces, sides included, that come within `reach` metres of a box; an infinite reach means all of them.
    pub(crate) fn within(&self, of: &Bounds, reach: f64) -> (DigestSum, u32) {
        let (mut sum, mut count) = (DigestSum::default(), 0);
        for nodes in &self.nodes {
            let mut at = 0;
            while let Some(node) = nodes.get(at) {
                if node.bounds.distance(of) > reach {
                    at = node.next as usize;
                    continue;
                }
                if node.piece != NO_PIECE {
                    sum.add(&self.pieces[node.piece as usize].sides);
                    count += 1;
                }
                at += 1;
            }
        }
        (sum, count)
    }
}

/// Alpha is all that a cut-out reads of a texture.
fn alpha_digest(scene: &Scene, texture: u32) -> Digest {
    let texture = &scene.textures[texture as usize];
    let mut hasher = Hasher::new("prelight cut-out");
    hasher.words(&[texture.width, texture.height]);
    let alpha: Vec<u8> = texture.texels.iter().skip(3).step_by(4).copied().collect();
    hasher.bytes(&alpha);
    hasher.finish()
}

fn triangle_digest(world: &World, textures: &[Digest], id: usize) -> [u8; 16] {
    let corners = &world.positions[id];
    let order = canonical_order(corners);
    let mut hasher = Hasher::new("prelight triangle");
    match world.occlusion[id] {
        Occlusion::None => hasher.words(&[0]),
        Occlusion::Opaque => hasher.words(&[1]),
        Occlusion::Mask { mask, corner } => {
            let cut = &world.masks[mask as usize];
            hasher.words(&[2]);
            hasher.bytes(&textures[mask as usize].0);
            hasher.floats(&[cut.factor, cut.cutoff]);
            hasher.floats(order.map(|i| cut.uv[corner as usize][i]).as_flattened());
            hasher.floats(&order.map(|i| cut.alpha[corner as usize][i]));
            hasher.words(&[cut.reference.wrap[0] as u32, cut.reference.wrap[1] as u32, u32::from(cut.reference.nearest)]);
        }
    }
    hasher.floats(order.map(|i| corners[i]).as_flattened());
    hasher.finish_short()
}

/// Whether the canonical order of corners runs against the world's.
fn is_odd(order: [usize; 3]) -> bool {
    matches!(order, [0, 2, 1] | [1, 0, 2] | [2, 1, 0])
}

/// What the search for buried points reads of a triangle besides its digest: winding against the canonical order, and whether its back
/// is a surface.
pub(crate) fn side(scene: &Scene, world: &World, id: u32) -> u8 {
    let primitive = &world.primitives[world.primitive[id as usize] as usize];
    let double_sided = scene.materials.get(primitive.material as usize).is_some_and(|material| material.double_sided);
    u8::from(is_odd(canonical_order(&world.positions[id as usize]))) | u8::from(double_sided) << 1
}

fn cut_object(
    scene: &Scene,
    world: &World,
    digests: &[[u8; 16]],
    layer_of: &[u8],
    object: usize,
    layer: u8,
) -> (Vec<Piece>, Vec<PieceNode>) {
    let traced = |id: &u32| {
        let i = *id as usize;
        layer_of[i] == layer && world.occlusion[i] != Occlusion::None && is_traceable(&world.positions[i])
    };
    let ids = (world.object_start[object]..world.object_start[object + 1]).filter(traced);
    let mut sorted: Vec<(u64, u32)> = ids.map(|id| (lattice_code(&world.positions[id as usize]), id)).collect();
    sorted.sort_unstable();
    let mut cut = Cut { scene, world, digests, object: object as u32, pieces: Vec::new(), nodes: Vec::new() };
    if !sorted.is_empty() {
        cut.node(&sorted);
    }
    (cut.pieces, cut.nodes)
}

/// Morton code of a triangle's centroid: 21 bits an axis around the world's origin, clamped.
fn lattice_code(corners: &[[f32; 3]; 3]) -> u64 {
    let cell = |axis: usize| {
        let sum = (f64::from(corners[0][axis]) + f64::from(corners[1][axis])) + f64::from(corners[2][axis]);
        ((sum * (LATTICE / 3.0)).floor() + f64::from(1 << 20)).clamp(0.0, f64::from((1 << 21) - 1)) as u64
    };
    crate::mesh::morton::interleave([cell(0), cell(1), cell(2)])
}

struct Cut<'a> {
    scene: &'a Scene,
    world: &'a World,
    digests: &'a [[u8; 16]],
    object: u32,
    pieces: Vec<Piece>,
    nodes: Vec<PieceNode>,
}

impl Cut<'_> {
    /// Each call has one differing bit less: recursion is at most 64 deep.
    fn node(&mut self, sorted: &[(u64, u32)]) -> Bounds {
        let at = self.nodes.len();
        self.nodes.push(PieceNode { bounds: Bounds::EMPTY, next: 0, piece: NO_PIECE });
        let differing = sorted[0].0 ^ sorted[sorted.len() - 1].0;
        let bounds = if sorted.len() <= PIECE_TRIANGLES {
            self.nodes[at].piece = self.pieces.len() as u32;
            self.piece(sorted)
        } else if differing == 0 {
            let mut bounds = Bounds::EMPTY;
            sorted.chunks(PIECE_TRIANGLES).for_each(|part| bounds.join(&self.node(part)));
            bounds
        } else {
            let bit = 63 - differing.leading_zeros();
            let middle = sorted.partition_point(|(code, _)| code >> bit & 1 == 0);
            let mut bounds = self.node(&sorted[..middle]);
            bounds.join(&self.node(&sorted[middle..]));
            bounds
        };
        self.nodes[at].bounds = bounds;
        self.nodes[at].next = self.nodes.len() as u32;
        bounds
    }

    fn piece(&mut self, sorted: &[(u64, u32)]) -> Bounds {
        let mut bounds = Bounds::EMPTY;
        let mut members: Vec<([u8; 16], u8)> = Vec::with_capacity(sorted.len());
        for &(_, id) in sorted {
            let corners = &self.world.positions[id as usize];
            corners.iter().for_each(|corner| bounds.add(*corner));
            members.push((self.digests[id as usize], side(self.scene, self.world, id)));
        }
        members.sort_unstable();
        let (mut digest, mut sides) = (Hasher::new("prelight piece"), Hasher::new("prelight sides"));
        for (triangle, side) in &members {
            digest.bytes(triangle);
            sides.bytes(triangle);
            sides.bytes(&[*side]);
        }
        let (digest, sides) = (DigestSum::of(digest.finish()), DigestSum::of(sides.finish()));
        self.pieces.push(Piece { object: self.object, bounds, digest, sides });
        bounds
    }
}

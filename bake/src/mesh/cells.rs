//! How a base triangle is cut once its edges are.
//!
//! Edges are halved again and again by a pure function of their ends, so the border of a triangle is given. Then:
//!
//! ```text
//! cut(triangle):
//!   s = longest piece of its border, height = 2·area / longest edge
//!   every edge halved and height > s:   four triangles between the midpoints; halve the three inner edges; cut each
//!   else:                               a strip: no inner point, rungs from the edge with most pieces to the other two
//! ```
//!
//! So a sliver is cut along its length only. Strips matter: with the templates 1-to-2, 1-to-3 and 1-to-4 alone, whose diagonals are
//! split again in each round, a needle of 2ᵏ pieces becomes 3ᵏ triangles instead of 2·2ᵏ, and apartment.glb at 5 cm 2.2 M instead of
//! 1.3 M. Rungs are the only edges that may be longer than the rule allows, by up to √2.

use glam::DVec3;

/// A mesh that can be cut: what nodes are is its business.
pub(crate) trait Cut {
    /// A corner or a point on an edge.
    type Node: Copy;
    /// The middle of an edge that is split; symmetric but for what a node carries.
    fn middle(&mut self, a: Self::Node, b: Self::Node) -> Option<Self::Node>;
    /// An edge inside the triangle comes into being; from now on `middle` knows it.
    fn inner_edge(&mut self, a: Self::Node, b: Self::Node);
    /// World position.
    fn position(&self, node: Self::Node) -> DVec3;
    /// A final triangle, counter-clockwise like its base.
    fn emit(&mut self, corners: [Self::Node; 3]);
    /// No more triangles are wanted.
    fn is_full(&self) -> bool;
}

/// Cuts a triangle whose edges are settled.
pub(crate) fn cut<C: Cut>(mesh: &mut C, triangle: [C::Node; 3]) {
    let mut cells = vec![triangle];
    let mut border: [Vec<C::Node>; 3] = [Vec::new(), Vec::new(), Vec::new()];
    while let Some(corners) = cells.pop() {
        if mesh.is_full() {
            return;
        }
        let [a, b, c] = corners;
        for (side, (p, q)) in border.iter_mut().zip([(a, b), (b, c), (c, a)]) {
            side.clear();
            side.push(p);
            pieces(mesh, p, q, side);
        }
        if border.iter().all(|side| side.len() == 2) {
            mesh.emit(corners);
        } else if border.iter().all(|side| side.len() > 2) && is_fat(mesh, corners, &border) {
            let mut middle = |p, q| mesh.middle(p, q).expect("a side of several pieces is split");
            let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
            for (p, q) in [(ab, bc), (bc, ca), (ca, ab)] {
                mesh.inner_edge(p, q);
            }
            // Popped in the order of the corners.
            cells.extend([[ab, bc, ca], [ca, bc, c], [ab, b, bc], [a, ab, ca]]);
        } else {
            strip(mesh, &border);
        }
    }
}

/// Appends the ends of the pieces of an edge, without its first end.
fn pieces<C: Cut>(mesh: &mut C, a: C::Node, b: C::Node, ends: &mut Vec<C::Node>) {
    // Depth is bounded by the levels of an edge, 15.
    match mesh.middle(a, b) {
        Some(middle) => {
            pieces(mesh, a, middle, ends);
            pieces(mesh, middle, b, ends);
        }
        None => ends.push(b),
    }
}

fn is_fat<C: Cut>(mesh: &C, corners: [C::Node; 3], border: &[Vec<C::Node>; 3]) -> bool {
    let [a, b, c] = corners.map(|k| mesh.position(k));
    let longest_edge = (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
    let pieces = border.iter().flat_map(|side| side.windows(2));
    let piece = pieces.map(|w| (mesh.position(w[1]) - mesh.position(w[0])).length_squared()).fold(0.0, f64::max);
    // height > s, squared and without the division: (2·area)² > s²·longest².
    (b - a).cross(c - a).length_squared() > piece * longest_edge
}

/// Joins the side with most pieces (the bottom, from P to Q) with the other two (the top, from P over R to Q) by rungs, the shorter of
/// the two possible ones each time. Neither end is reached before the last triangle, so none is degenerate.
fn strip<C: Cut>(mesh: &mut C, border: &[Vec<C::Node>; 3]) {
    let length = |mesh: &C, side: &[C::Node]| (mesh.position(side[side.len() - 1]) - mesh.position(side[0])).length_squared();
    let mut base = 0;
    for k in 1..3 {
        let (n, most) = (border[k].len(), border[base].len());
        if n > most || (n == most && length(mesh, &border[k]) > length(mesh, &border[base])) {
            base = k;
        }
    }
    let bottom = &border[base];
    let (from_q, from_r) = (&border[(base + 1) % 3], &border[(base + 2) % 3]);
    let mut top: Vec<C::Node> = from_r.iter().rev().copied().collect();
    top.extend(from_q.iter().rev().skip(1));
    let (last_bottom, last_top) = (bottom.len() - 2, top.len() - 2);
    let (mut i, mut j) = (1, 1);
    mesh.emit([bottom[0], bottom[1], top[1]]);
    while i < last_bottom || j < last_top {
        let rung = |mesh: &C, i: usize, j: usize| (mesh.position(bottom[i]) - mesh.position(top[j])).length_squared();
        if j == last_top || (i < last_bottom && rung(mesh, i + 1, j) <= rung(mesh, i, j + 1)) {
            mesh.emit([bottom[i], bottom[i + 1], top[j]]);
            i += 1;
        } else {
            mesh.emit([bottom[i], top[j + 1], top[j]]);
            j += 1;
        }
    }
    mesh.emit([bottom[i], bottom[i + 1], top[j]]);
}

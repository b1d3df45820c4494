//! Directions of view: an icosahedron with a corner at +Z, its faces cut in four again and again.
//!
//! | level | corners on the sphere | mean spacing | stored: at least one face of theirs reaches above the horizon |
//! |---|---|---|---|
//! | n | 10·4ⁿ + 2 | 63.4° / 2ⁿ | 11, 26, 91, 341, 1321 for n = 0..=4 |
//!
//! Levels are nested: the corners of a level are the first ones of the next. A direction is interpolated from the three corners of the
//! face that holds it; those of a face that crosses the horizon may lie below it.

/// Finest level.
pub const MAX_LEVEL: usize = 5;

/// Corners and faces of all levels up to one.
#[derive(Clone, Debug)]
pub struct Icosahedron {
    /// Unit corners; those of level n are the first 10·4ⁿ + 2.
    pub corners: Vec<[f32; 3]>,
    /// `[level]` corners of each face; the four parts of face i are 4i..4i + 4 of the next level.
    faces: Vec<Vec<[u32; 3]>>,
    /// `[level]` corners that views from above the horizon need, ascending.
    stored: Vec<Vec<u32>>,
    /// `[level][corner]` place in `stored`, `u32::MAX` for the others.
    place: Vec<Vec<u32>>,
    /// `[corner − 12]` the two corners whose edge it halves.
    parents: Vec<[u32; 2]>,
}

/// Three corners and their shares, which are at least 0 and sum to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Located {
    /// Places in [`Icosahedron::stored`] of the level.
    pub places: [usize; 3],
    /// Barycentric weights.
    pub weights: [f32; 3],
}

fn normalise(v: [f64; 3]) -> [f64; 3] {
    let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    v.map(|c| c / length)
}

fn triple(a: [f32; 3], b: [f32; 3], c: [f32; 3]) -> f32 {
    a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])
}

impl Icosahedron {
    /// All levels up to `level`, at most [`MAX_LEVEL`].
    pub fn new(level: usize) -> Self {
        assert!(level <= MAX_LEVEL, "level {level} is above {MAX_LEVEL}");
        let (height, radius) = (1.0 / 5f64.sqrt(), 2.0 / 5f64.sqrt());
        let mut exact = vec![[0.0, 0.0, 1.0]];
        for (ring, sign) in [(0.0, 1.0), (0.5, -1.0)] {
            for i in 0..5 {
                let turn = 2.0 * std::f64::consts::PI * (f64::from(i) + ring) / 5.0;
                exact.push([radius * libm::cos(turn), radius * libm::sin(turn), sign * height]);
            }
        }
        exact.push([0.0, 0.0, -1.0]);
        let (mut faces, mut parents) = (vec![Vec::new()], Vec::new());
        for i in 0..5u32 {
            let next = (i + 1) % 5;
            let (a, b, c, d) = (1 + i, 1 + next, 6 + i, 6 + next);
            faces[0].extend([[0, a, b], [a, c, b], [b, c, d], [11, d, c]]);
        }
        for n in 0..level {
            let mut middle = std::collections::BTreeMap::new();
            let mut next = Vec::with_capacity(4 * faces[n].len());
            for [a, b, c] in faces[n].clone() {
                let mut between = |x: u32, y: u32| {
                    *middle.entry((x.min(y), x.max(y))).or_insert_with(|| {
                        let (p, q) = (exact[x as usize], exact[y as usize]);
                        exact.push(normalise(std::array::from_fn(|k| p[k] + q[k])));
                        parents.push([x.min(y), x.max(y)]);
                        exact.len() as u32 - 1
                    })
                };
                let (ab, bc, ca) = (between(a, b), between(b, c), between(c, a));
                next.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
            }
            faces.push(next);
        }
        let corners: Vec<[f32; 3]> = exact.iter().map(|c| c.map(|x| x as f32)).collect();
        let needed = |faces: &Vec<[u32; 3]>| {
            // Rounding must not decide: corners that lie on the horizon count as on it.
            let reaches = |face: &&[u32; 3]| face.iter().any(|c| corners[*c as usize][2] > 1e-6);
            let mut needed: Vec<u32> = faces.iter().filter(reaches).flatten().copied().collect();
            needed.sort_unstable();
            needed.dedup();
            needed
        };
        let stored: Vec<Vec<u32>> = faces.iter().map(needed).collect();
        let place = (stored.iter())
            .map(|stored| {
                let mut place = vec![u32::MAX; corners.len()];
                stored.iter().enumerate().for_each(|(i, corner)| place[*corner as usize] = i as u32);
                place
            })
            .collect();
        Icosahedron { corners, faces, stored, place, parents }
    }

    /// Corners of a level that views from above the horizon need, ascending.
    pub fn stored(&self, level: usize) -> &[u32] {
        &self.stored[level]
    }

    /// Where a corner stands in [`Self::stored`] of a level; `None` if it is not there.
    pub fn place(&self, level: usize, corner: u32) -> Option<usize> {
        let place = self.place[level][corner as usize];
        (place != u32::MAX).then_some(place as usize)
    }

    /// The two corners of coarser levels that a corner lies half way between; `None` for those of level 0.
    pub fn parents(&self, corner: u32) -> Option<[u32; 2]> {
        (corner as usize).checked_sub(12).map(|i| self.parents[i])
    }

    /// The face of a level that holds a direction (unit; below the horizon it is taken to the horizon).
    pub fn locate(&self, level: usize, direction: [f32; 3]) -> Located {
        let d = [direction[0], direction[1], direction[2].max(0.0)];
        let shares = |face: &[u32; 3]| -> [f32; 3] {
            let [a, b, c] = face.map(|c| self.corners[c as usize]);
            [triple(d, b, c), triple(a, d, c), triple(a, b, d)]
        };
        let least = |s: &[f32; 3]| s[0].min(s[1]).min(s[2]);
        // Of the candidates the one that the direction is furthest inside of, so that rounding at an edge finds one of its two faces.
        let best = |range: std::ops::Range<usize>, faces: &[[u32; 3]]| {
            let mut best = (range.start, [0.0; 3], f32::NEG_INFINITY);
            for i in range {
                let s = shares(&faces[i]);
                let inside = least(&s) / (s[0] + s[1] + s[2]).abs().max(f32::MIN_POSITIVE);
                // The face on the other side of the sphere has the signs of all shares turned.
                if s[0] + s[1] + s[2] > 0.0 && inside > best.2 {
                    best = (i, s, inside);
                }
            }
            best
        };
        let mut found = best(0..20, &self.faces[0]);
        for n in 1..=level {
            found = best(4 * found.0..4 * found.0 + 4, &self.faces[n]);
        }
        let face = self.faces[level][found.0];
        let weights = found.1.map(|s| s.max(0.0));
        let sum = weights[0] + weights[1] + weights[2];
        let (mut places, mut shares) = ([0; 3], [0.0; 3]);
        for k in 0..3 {
            // A corner without a place belongs to no face above the horizon, so rounding alone can name it, with no weight.
            let place = self.place(level, face[k]);
            places[k] = place.unwrap_or(0);
            shares[k] = if place.is_some() && sum > 0.0 { weights[k] / sum } else { 0.0 };
        }
        Located { places, weights: shares }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_have_their_corners_and_nest() {
        let solid = Icosahedron::new(4);
        for (level, stored) in [11, 26, 91, 341, 1321].into_iter().enumerate() {
            assert_eq!(solid.faces[level].len(), 20 << (2 * level));
            let largest = solid.faces[level].iter().flatten().max().unwrap();
            assert_eq!(*largest as usize + 1, 10 * (1 << (2 * level)) + 2);
            assert_eq!(solid.stored(level).len(), stored, "level {level}");
        }
        for level in 1..=4 {
            assert!(
                solid.stored(level - 1).iter().filter(|c| solid.corners[**c as usize][2] > 0.0).all(|c| solid.place(level, *c).is_some())
            );
        }
        for corner in 0..solid.corners.len() as u32 {
            let Some([a, b]) = solid.parents(corner) else { continue };
            let [a, b, own] = [a, b, corner].map(|c| solid.corners[c as usize]);
            let middle = normalise(std::array::from_fn(|k| f64::from(a[k] + b[k])));
            assert!((0..3).all(|k| (middle[k] - f64::from(own[k])).abs() < 1e-6), "{corner}");
        }
        for face in &solid.faces[3] {
            let [a, b, c] = face.map(|i| solid.corners[i as usize]);
            assert!(triple(a, b, c) > 0.0, "faces run counter-clockwise seen from outside");
        }
    }

    #[test]
    fn located_weights_give_the_direction_back() {
        let solid = Icosahedron::new(4);
        for level in 0..=4 {
            for i in 0..500 {
                let z = (i as f32 + 0.5) / 500.0;
                let phi = i as f32 * 2.399_963;
                let radius = (1.0 - z * z).sqrt();
                let d = [radius * phi.cos(), radius * phi.sin(), z];
                let found = solid.locate(level, d);
                let sum: [f32; 3] = std::array::from_fn(|k| {
                    (0..3).map(|j| found.weights[j] * solid.corners[solid.stored(level)[found.places[j]] as usize][k]).sum()
                });
                let length = sum.iter().map(|c| c * c).sum::<f32>().sqrt();
                for k in 0..3 {
                    assert!((sum[k] / length - d[k]).abs() < 2e-5, "level {level}: {d:?} {found:?}");
                }
                assert!(found.weights.iter().all(|w| *w >= 0.0) && (found.weights.iter().sum::<f32>() - 1.0).abs() < 1e-5);
            }
        }
        for (corner, place) in solid.stored(3).iter().zip(0..) {
            let d = solid.corners[*corner as usize];
            if d[2] > 0.0 {
                let found = solid.locate(3, d);
                let at = found.weights.iter().position(|w| *w > 0.9999).unwrap();
                assert_eq!(found.places[at], place);
            }
        }
    }
}

//! Links chunk of a patch: from which clusters of points its points receive bounced light, and what share of it.
//!
//! Counts: `n` points (1..=256), `g` points that gather, `l` links, `t` target patches, `rays` N of a point that gathers (1..=255). Arrays:
//!
//! | array | shape | meaning |
//! |---|---|---|
//! | targets | `[t, 16]` u8 | first half of the digest of each target patch's points chunk |
//! | gather | `[g]` u8 | points of this patch that gather, ascending |
//! | end | `[g]` u32 | where each one's links end; they begin where the one before ends |
//! | target | `[l]` u16 | index into `targets` |
//! | node | `[l]` u16 | [`super::nodes`] of that patch |
//! | count | `[l]` u8 | rays of N that ended there, at least 1; at most N in sum |
//! | direction | `[l, 2]` i8 | octahedral mean direction of those rays, world space |
//! | source | `[n, 8]` u8 | index into `gather` |
//! | weight | `[n, 8]` u8 | shares of the sources, 255 in sum; all 0 where nothing is known (buried points) |
//! | seen | `[n]` u8 | share of a point's rays that end on a surface not close by: how much it counts in the mean of its clusters |
//!
//! Whether a node lies in its patch can be told once the target is open: [`super::solve`] does.

use super::nodes;
use crate::chunk::layout::{PATCH_POINTS, Reader, Writer};
use crate::error::RuntimeError;

const MAGIC: &[u8; 4] = b"PLLK";
const VERSION: u32 = 1;

/// Points that gather for one other, at most.
pub const SOURCES: usize = 8;

/// The arrays of one patch, borrowed from its chunk.
#[derive(Clone, Copy, Debug, Default)]
pub struct Links<'a> {
    /// Rays of a point that gathers.
    pub rays: u32,
    /// `[t]` first half of the digest of a points chunk.
    pub targets: &'a [[u8; 16]],
    /// `[g]` points that gather.
    pub gather: &'a [u8],
    /// `[g]` ends of their links.
    pub end: &'a [u32],
    /// `[l]` index into `targets`.
    pub target: &'a [u16],
    /// `[l]` node of the target.
    pub node: &'a [u16],
    /// `[l]` rays.
    pub count: &'a [u8],
    /// `[l]` octahedral mean direction.
    pub direction: &'a [[i8; 2]],
    /// `[n]` indices into `gather`.
    pub source: &'a [[u8; SOURCES]],
    /// `[n]` shares in 255ths.
    pub weight: &'a [[u8; SOURCES]],
    /// `[n]` share in 255ths.
    pub seen: &'a [u8],
}

impl<'a> Links<'a> {
    /// Number of points.
    pub fn len(&self) -> usize {
        self.seen.len()
    }

    /// Never true for a parsed chunk.
    pub fn is_empty(&self) -> bool {
        self.seen.is_empty()
    }

    /// The links of gathering point `g`.
    pub fn of(&self, g: usize) -> std::ops::Range<usize> {
        let start = if g == 0 { 0 } else { self.end[g - 1] as usize };
        start..self.end[g] as usize
    }

    /// The chunk's bytes.
    pub fn to_chunk(&self) -> Vec<u8> {
        let (n, g, l, t) = (self.seen.len(), self.gather.len(), self.target.len(), self.targets.len());
        Writer::new(MAGIC, VERSION, [n as u32, g as u32, l as u32, t as u32, self.rays, 0])
            .array(self.targets)
            .array(self.gather)
            .array(self.end)
            .array(self.target)
            .array(self.node)
            .array(self.count)
            .array(self.direction)
            .array(self.source)
            .array(self.weight)
            .array(self.seen)
            .finish()
    }

    /// Borrows from a chunk.
    ///
    /// # Errors
    /// What does not hold of the table above.
    pub fn from_chunk(bytes: &'a [u8]) -> Result<Self, RuntimeError> {
        let mut reader = Self::reader(bytes)?;
        let [n, g, ..] = reader.counts.map(|count| count as usize);
        if !(1..=PATCH_POINTS).contains(&n) || g > n {
            return Err(reader.error("a patch has 1..=256 points, and at most all of them gather"));
        }
        let links = Self::borrow(&mut reader)?;
        if let Some(what) = links.fault() {
            return Err(reader.error(what));
        }
        reader.finish()?;
        Ok(links)
    }

    /// Borrows again from a chunk that [`Links::from_chunk`] has proved.
    ///
    /// # Panics
    /// Where even the header is wrong.
    pub fn from_proven_chunk(bytes: &'a [u8]) -> Self {
        Self::reader(bytes).and_then(|mut reader| Self::borrow(&mut reader)).expect("a chunk that was proved before")
    }

    fn reader(bytes: &'a [u8]) -> Result<Reader<'a>, RuntimeError> {
        Reader::new("links", MAGIC, VERSION, bytes)
    }

    fn borrow(reader: &mut Reader<'a>) -> Result<Self, RuntimeError> {
        let [n, g, l, t, ..] = reader.counts.map(|count| count as usize);
        Ok(Links {
            rays: reader.counts[4],
            targets: reader.array(t)?,
            gather: reader.array(g)?,
            end: reader.array(g)?,
            target: reader.array(l)?,
            node: reader.array(l)?,
            count: reader.array(l)?,
            direction: reader.array(l)?,
            source: reader.array(n)?,
            weight: reader.array(n)?,
            seen: reader.array(n)?,
        })
    }

    fn fault(&self) -> Option<&'static str> {
        let (n, g, l, t) = (self.seen.len(), self.gather.len(), self.target.len(), self.targets.len());
        if !(1..=255).contains(&self.rays) {
            return Some("a point that gathers has 1..=255 rays");
        }
        if self.gather.iter().any(|point| usize::from(*point) >= n) || self.gather.windows(2).any(|w| w[0] >= w[1]) {
            return Some("points that gather are not in order, or not there");
        }
        if self.end.windows(2).any(|w| w[0] > w[1]) || self.end.last().map_or(0, |end| *end as usize) != l {
            return Some("ends of links are not in order, or leave some over");
        }
        if self.target.iter().any(|target| usize::from(*target) >= t)
            || self.node.iter().any(|node| usize::from(*node) >= nodes::count(PATCH_POINTS))
        {
            return Some("a link names a target or a node that is not there");
        }
        let counts = |g: usize| self.count[self.of(g)].iter().map(|count| u32::from(*count)).sum::<u32>();
        if self.count.contains(&0) || (0..g).any(|g| counts(g) > self.rays) {
            return Some("links have no ray, or more than the point sent");
        }
        let sums = |weight: &[u8; SOURCES]| weight.iter().map(|w| u32::from(*w)).sum::<u32>();
        if self.weight.iter().any(|weight| ![0, 255].contains(&sums(weight))) {
            return Some("shares of sources are not 255 in sum");
        }
        let known =
            |(source, weight): (&[u8; SOURCES], &[u8; SOURCES])| source.iter().zip(weight).all(|(s, w)| *w == 0 || usize::from(*s) < g);
        if !self.source.iter().zip(self.weight).all(known) {
            return Some("a point names a source that does not gather");
        }
        None
    }
}

/// Octahedral direction in two signed bytes. Error: at most 1.3 degrees.
pub fn encode_direction(direction: [f32; 3]) -> [i8; 2] {
    let sum = direction.iter().map(|x| x.abs()).sum::<f32>();
    if sum <= 0.0 {
        return [0, 0];
    }
    let [x, y, z] = direction.map(|c| c / sum);
    let sign = |v: f32| if v < 0.0 { -1.0 } else { 1.0 };
    let [u, v] = if z >= 0.0 { [x, y] } else { [(1.0 - y.abs()) * sign(x), (1.0 - x.abs()) * sign(y)] };
    [u, v].map(|c| (c * 127.0 + 0.5 * sign(c)) as i8)
}

/// Unit direction of [`encode_direction`].
#[inline]
pub fn decode_direction(bytes: [i8; 2]) -> [f32; 3] {
    let [u, v] = bytes.map(|b| f32::from(b) / 127.0);
    let z = 1.0 - u.abs() - v.abs();
    let sign = |v: f32| if v < 0.0 { -1.0 } else { 1.0 };
    let [x, y] = if z >= 0.0 { [u, v] } else { [(1.0 - v.abs()) * sign(u), (1.0 - u.abs()) * sign(v)] };
    let length = (x * x + y * y + z * z).sqrt();
    [x, y, z].map(|c| c / length)
}

#[cfg(test)]
mod tests {
    use super::*;
    use prelight_store::Chunk;

    const ALL: [u8; 8] = [255, 0, 0, 0, 0, 0, 0, 0];
    const GOOD: Links<'static> = Links {
        rays: 4,
        targets: &[[7; 16], [9; 16]],
        gather: &[0, 2],
        end: &[2, 3],
        target: &[0, 1, 1],
        node: &[0, 340, 12],
        count: &[1, 3, 2],
        direction: &[[0, 0], [127, 0], [-64, -64]],
        source: &[[0; 8], [0, 1, 0, 0, 0, 0, 0, 0], [1, 0, 0, 0, 0, 0, 0, 0], [9; 8]],
        weight: &[ALL, [100, 155, 0, 0, 0, 0, 0, 0], ALL, [0; 8]],
        seen: &[255, 0, 3, 4],
    };

    #[test]
    fn a_chunk_round_trips_and_no_cut_of_it_is_taken() {
        let chunk = Chunk::from_plain(&GOOD.to_chunk());
        let read = Links::from_chunk(&chunk).unwrap();
        assert_eq!((read.of(0), read.of(1)), (0..2, 2..3));
        assert_eq!((read.node, read.count, read.weight), (GOOD.node, GOOD.count, GOOD.weight));
        for cut in 0..chunk.len() {
            assert!(Links::from_chunk(&chunk[..cut]).is_err(), "{cut}");
        }
    }

    #[test]
    fn what_is_wrong_is_named() {
        let wrong = [
            (Links { rays: 0, ..GOOD }, "rays"),
            (Links { gather: &[2, 0], ..GOOD }, "gather"),
            (Links { gather: &[0, 4], ..GOOD }, "gather"),
            (Links { end: &[2, 2], ..GOOD }, "ends"),
            (Links { end: &[3, 2], ..GOOD }, "ends"),
            (Links { target: &[0, 1, 2], ..GOOD }, "target"),
            (Links { node: &[0, 341, 0], ..GOOD }, "node"),
            (Links { count: &[1, 4, 2], ..GOOD }, "ray"),
            (Links { count: &[1, 0, 2], ..GOOD }, "ray"),
            (Links { weight: &[[254, 0, 0, 0, 0, 0, 0, 0], ALL, ALL, [0; 8]], ..GOOD }, "255"),
            (Links { source: &[[0; 8], [0, 2, 0, 0, 0, 0, 0, 0], [1, 0, 0, 0, 0, 0, 0, 0], [0; 8]], ..GOOD }, "source"),
        ];
        for (links, word) in wrong {
            let error = Links::from_chunk(&Chunk::from_plain(&links.to_chunk())).unwrap_err().to_string();
            assert!(error.contains(word), "{error} / {word}");
        }
    }

    #[test]
    fn directions_keep_to_a_degree_and_a_third() {
        for i in 0..2000 {
            let (z, phi) = (1.0 - 2.0 * (i as f32 + 0.5) / 2000.0, i as f32 * 2.399_963);
            let r = (1.0 - z * z).sqrt();
            let direction = [r * phi.cos(), r * phi.sin(), z];
            let back = decode_direction(encode_direction(direction));
            let cosine: f32 = direction.iter().zip(back).map(|(a, b)| a * b).sum();
            assert!(cosine > 1.3f32.to_radians().cos(), "{direction:?} {back:?}");
        }
        assert_eq!(decode_direction(encode_direction([0.0, 0.0, -1.0])), [0.0, 0.0, -1.0]);
    }
}

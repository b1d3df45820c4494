//! Slices that their neighbours predict are not stored.
//!
//! ```text
//! a lobe is kept where  D(predicted, computed) > tolerance,     predicted = middle of the corner's two parents as they will be read
//! ```
//!
//! Corners come parents first, so what is read never drifts from what was computed by more than the tolerance. Black lobes among black
//! ones cost nothing, and a wide lobe keeps few of its corners on whatever level the sharpest asks for. Own.

use prelight_runtime::sphere::icosahedron::Icosahedron;
use prelight_runtime::vmf_transfer::interpolate::middle;
use prelight_runtime::vmf_transfer::transfer::{PointRecords, SLICE_LOBES, TransferLobe, decode, encode, n_words};

/// Chooses what to keep of `slices`, `[stored corners of the level][slot]`, and encodes it. `tolerance`: L2 norm, sr^-½.
#[cfg(test)]
pub(crate) fn thin_slices(solid: &Icosahedron, level: usize, slices: &[[TransferLobe; SLICE_LOBES]], tolerance: f64) -> PointRecords {
    thin_wanted(solid, level, slices, tolerance, &vec![true; slices.len()])
}

/// The same where some corners are never read: `wanted`, in the order of `slices`. Nothing is kept for the others.
pub(crate) fn thin_wanted(
    solid: &Icosahedron,
    level: usize,
    slices: &[[TransferLobe; SLICE_LOBES]],
    tolerance: f64,
    wanted: &[bool],
) -> PointRecords {
    let stored = solid.stored(level);
    assert_eq!([slices.len(), wanted.len()], [stored.len(); 2], "a slice for each stored corner");
    let mut point = PointRecords { level: level as u32, kept: vec![0; n_words(solid, level)], ..PointRecords::DARK };
    let mut read: Vec<[TransferLobe; SLICE_LOBES]> = Vec::with_capacity(stored.len());
    for (place, (corner, own)) in stored.iter().zip(slices).enumerate() {
        let parents = solid.parents(*corner).map(|pair| pair.map(|parent| solid.place(level, parent)));
        read.push(std::array::from_fn(|slot| {
            let predicted = parents.map_or(TransferLobe::default(), |pair| {
                let [a, b] = pair.map(|place| place.map_or(TransferLobe::default(), |place| read[place][slot]));
                middle(&a, &b)
            });
            if !wanted[place] || predicted.lobe.distance(&own[slot].lobe) <= tolerance {
                return predicted;
            }
            let record = encode(&own[slot]);
            let bit = place * SLICE_LOBES + slot;
            point.kept[bit / 32] |= 1 << (bit % 32);
            point.slices.push(record);
            decode(&record)
        }));
    }
    point
}

#[cfg(test)]
mod tests {
    use super::*;
    use prelight_runtime::sphere::icosahedron::MAX_LEVEL;
    use prelight_runtime::vmf_transfer::Lobe;

    /// A mirror image whose weight falls off around one direction, in slot 1.
    fn slices(solid: &Icosahedron, level: usize, kappa: f32) -> Vec<[TransferLobe; SLICE_LOBES]> {
        let lobe = |corner: &u32| {
            let v = solid.corners[*corner as usize];
            let weight = 0.5 * (v[0] - 0.2).max(0.0);
            let lobe = Lobe { weight: [weight; 3], mu: [-v[0], -v[1], v[2]], kappa };
            [TransferLobe::default(), TransferLobe { lobe, grazing: 0.3 }]
        };
        solid.stored(level).iter().map(lobe).collect()
    }

    #[test]
    fn what_is_read_is_within_the_tolerance_and_takes_less() {
        let solid = Icosahedron::new(MAX_LEVEL);
        let mut counts = Vec::new();
        for (kappa, tolerance) in [(60.0, 0.0), (60.0, 0.02), (60.0, 0.1), (3.0, 0.02)] {
            let dense = slices(&solid, 3, kappa);
            let point = thin_slices(&solid, 3, &dense, tolerance);
            counts.push(point.slices.len());
            let largest = dense.iter().map(|own| own[1].lobe.norm()).fold(0.0, f64::max);
            for (place, own) in dense.iter().enumerate() {
                let got = point.view().slice(&solid, place, 1).lobe;
                // What is kept is rounded to halves and 16 bits.
                assert!(got.distance(&own[1].lobe) <= tolerance + 5e-3 * largest, "{kappa} {tolerance} {place}");
                assert_eq!(point.view().slice(&solid, place, 0), TransferLobe::default());
            }
        }
        let lit = slices(&solid, 3, 60.0).iter().filter(|own| own[1].lobe.weight[0] > 0.0).count();
        assert!(counts[0] <= lit + lit / 2, "black among black is free: {counts:?}, {lit} lit");
        assert!(counts[1] < counts[0] && counts[2] < counts[1] && counts[3] < counts[1], "{counts:?}");
    }
}

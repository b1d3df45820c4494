//! Fields against objects whose coverage is known.

use super::field::{CHUNK_LIMITS, Field, FieldChunk, RADII, frame, node, width};
use super::tree_tests::noise;
use crate::sphere::disc::{direction_from_disc, disc_from_direction};
use crate::sphere::frame::{dot, tangents};

/// The field of a ball of radius `ball` metres around a point, in a sphere of radius 1 around `centre`.
pub(crate) fn field_of_a_ball(m: usize, res: usize, centre: [f32; 3], ball: f64, off: [f64; 3]) -> Vec<u8> {
    let mut coverage = Vec::new();
    for d in RADII {
        let w = width(f64::from(d));
        for face in 0..6 {
            for j in 0..=m {
                for i in 0..=m {
                    let outward = node(face, m, i, j);
                    let axes = frame(face, outward);
                    let place = outward.map(|x| x * f64::from(d));
                    for texel in 0..res * res {
                        let mut hits = 0;
                        for s in 0..4 {
                            let at = |i: usize, s: usize| w * (2.0 * (i as f64 + (s as f64 + 0.5) / 2.0) / res as f64 - 1.0);
                            let p = [at(texel % res, s % 2), at(texel / res, s / 2)];
                            let local = direction_from_disc(p);
                            let l: [f64; 3] = std::array::from_fn(|k| (0..3).map(|a| local[a] * axes[a][k]).sum());
                            let is_inside = p[0] * p[0] + p[1] * p[1] <= w * w;
                            hits += u32::from(is_inside && meets_ball(place, l, ball, off));
                        }
                        coverage.push((hits * 255 / 4) as u8);
                    }
                }
            }
        }
    }
    FieldChunk { m, res, centre, radius: 1.0, radii: &RADII, coverage: &coverage }.to_chunk()
}

fn meets_ball(from: [f64; 3], l: [f64; 3], ball: f64, off: [f64; 3]) -> bool {
    let to: [f64; 3] = std::array::from_fn(|k| off[k] - from[k]);
    let along = dot(to, l);
    let square = dot(to, to) - along * along;
    dot(to, to) < ball * ball || (along > 0.0 && square < ball * ball)
}

fn aligned(bytes: &[u8]) -> Vec<u64> {
    bytes.chunks_exact(8).map(|c| u64::from_le_bytes(c.try_into().unwrap())).collect()
}

/// Part of a square that the ball blocks, by many rays.
fn truth(field: &Field, place: [f32; 3], c: [f32; 3], half: f32, ball: f64, off: [f64; 3]) -> f64 {
    let (t, b) = tangents(c);
    let from: [f64; 3] = std::array::from_fn(|k| f64::from(place[k] - field.centre()[k]));
    // How a square stands is left open: the mean over its turns.
    let (n, turns) = (16, 8);
    let mut hits = 0;
    for s in 0..n * n * turns {
        let at = |i: usize| f64::from(half) * (2.0 * (i as f64 + 0.5) / n as f64 - 1.0);
        let (sine, cosine) = (std::f64::consts::FRAC_PI_2 * (s / (n * n)) as f64 / turns as f64).sin_cos();
        let [x, y] = [at(s % n), at(s / n % n)];
        let local = direction_from_disc([cosine * x - sine * y, sine * x + cosine * y]);
        let l = std::array::from_fn(|k| local[0] * f64::from(t[k]) + local[1] * f64::from(b[k]) + local[2] * f64::from(c[k]));
        hits += usize::from(meets_ball(from, l, ball, off));
    }
    hits as f64 / (n * n * turns) as f64
}

fn unit(i: usize) -> [f32; 3] {
    let (z, angle) = (2.0 * noise(2 * i) - 1.0, std::f32::consts::TAU * noise(2 * i + 1));
    let s = (1.0 - z * z).sqrt();
    [s * angle.cos(), s * angle.sin(), z]
}

#[test]
fn field_of_a_ball_is_a_disc() {
    let (centre, ball, off) = ([0.3, -1.0, 2.0], 0.5, [0.3, 0.1, -0.2]);
    let bytes = aligned(&field_of_a_ball(8, 16, centre, ball, off));
    let field = Field::open(&FieldChunk::from_chunk(bytemuck::cast_slice(&bytes)).unwrap());
    // Inside of the sphere, where the ball is as near as a tenth of its size, and outside.
    for (from, to, [rms, worst]) in [(0.75, 1.05, [0.1, 0.6]), (1.05, 2.0, [0.05, 0.4]), (2.0, 10.0, [0.02, 0.12])] {
        let found = ball_errors(&field, (centre, ball, off), [from, to]);
        println!("from {from} to {to} radii: rms {:.4} worst {:.3}, the most blocked {:.2}", found[0], found[1], found[2]);
        assert!(found[0] < rms && found[1] < worst && found[2] > 0.9, "{found:?}");
    }
}

/// Error of squares of 0.01 to 1 sr about a ball from places in a shell: root mean square and largest, and the most that was blocked.
fn ball_errors(field: &Field, (centre, ball, off): ([f32; 3], f64, [f64; 3]), [from, to]: [f32; 2]) -> [f64; 3] {
    let (mut square, mut worst, mut n, mut largest) = (0.0, 0.0f64, 0, 0.0f64);
    for i in 0..200 {
        let (outward, d) = (unit(i), from + (to - from) * noise(i + 5000));
        let place = std::array::from_fn(|k| centre[k] + d * outward[k]);
        let at = field.at(place);
        for j in 0..4 {
            let aside = unit(7919 * i + j);
            let spread = 0.8 * noise(3 * i + j);
            let toward: [f32; 3] = std::array::from_fn(|k| -outward[k] + spread * aside[k]);
            let length = dot(toward, toward).sqrt();
            let c = toward.map(|x| x / length);
            let half = crate::sphere::disc::half_side(0.01 * 100f32.powf(noise(i * 4 + j)));
            let (found, expected) = (f64::from(field.blocked(&at, c, half)), truth(field, place, c, half, ball, off));
            square += (found - expected).powi(2);
            worst = worst.max((found - expected).abs());
            largest = largest.max(expected);
            n += 1;
        }
    }
    [(square / f64::from(n)).sqrt(), worst, largest]
}

#[test]
fn field_is_continuous_across_faces_shells_and_the_sphere() {
    let (ball, off) = (0.6, [0.2, 0.1, 0.0]);
    let bytes = aligned(&field_of_a_ball(8, 16, [0.0; 3], ball, off));
    let field = Field::open(&FieldChunk::from_chunk(bytemuck::cast_slice(&bytes)).unwrap());
    let walks: [([f32; 3], [f32; 3]); 4] = [
        ([2.0, 1.9, 0.3], [1.9, 2.0, 0.3]),
        ([1.0, 0.1, 0.2], [1.1, 0.1, 0.2]),
        ([6.3, 0.5, 1.0], [6.9, 0.5, 1.0]),
        ([0.3, -2.0, 1.95], [0.3, -1.95, 2.05]),
    ];
    for (from, to) in walks {
        let steps = (1000.0 * (0..3).map(|k| (to[k] - from[k]).powi(2)).sum::<f32>().sqrt()) as usize + 1;
        for toward in 0..6 {
            let mut before: Option<f32> = None;
            let middle: [f32; 3] = std::array::from_fn(|k| -0.5 * (from[k] + to[k]) + 0.4 * unit(toward)[k]);
            let length = dot(middle, middle).sqrt();
            for step in 0..=steps {
                let f = step as f32 / steps as f32;
                let place = std::array::from_fn(|k| from[k] + f * (to[k] - from[k]));
                let now = field.blocked(&field.at(place), middle.map(|x| x / length), 0.15);
                assert!((0.0..=1.0).contains(&now));
                assert!(before.is_none_or(|before| (now - before).abs() < 0.02), "{from:?} {step}: {before:?} {now}");
                before = Some(now);
            }
        }
    }
}

#[test]
fn places_without_a_direction_and_far_away_are_answered() {
    let bytes = aligned(&field_of_a_ball(4, 8, [0.0; 3], 0.9, [0.0; 3]));
    let field = Field::open(&FieldChunk::from_chunk(bytemuck::cast_slice(&bytes)).unwrap());
    for place in [[0.0; 3], [1e-20, 0.0, 0.0], [1.0, 1.0, 1.0], [0.0, 0.0, -1e6], [1e6, 1e6, -1e6]] {
        let at = field.at(place);
        for i in 0..200 {
            let blocked = field.blocked(&at, unit(i), 0.001 + noise(i));
            assert!((0.0..=1.0).contains(&blocked), "{place:?}: {blocked}");
        }
    }
    let behind = field.blocked(&field.at([0.0, 0.0, 5.0]), [0.0, 0.0, 1.0], 0.1);
    assert_eq!(behind, 0.0);
    // As many texels of a cone are blocked as the ball's own cone has: at 5 r it is 0.9² of it, nearly.
    let all = field.blocked(&field.at([0.0, 0.0, 5.0]), [0.0, 0.0, -1.0], 0.05);
    assert!(all > 0.9999, "{all}");
}

#[test]
fn chunks_that_lie_are_refused() {
    let good = field_of_a_ball(1, 4, [0.0; 3], 0.5, [0.0; 3]);
    let read = |bytes: &[u8]| {
        let aligned = aligned(bytes);
        FieldChunk::from_chunk(bytemuck::cast_slice(&aligned)).map(|_| ())
    };
    assert!(read(&good).is_ok());
    // Magic, version, counts of shells, steps and texels, the sphere's centre and radius, a shell.
    let wrong = [(0, 1u32), (4, 2), (8, 0), (8, 12), (12, 0), (12, 1 << 31), (16, 0), (16, 1 << 20), (64, 0x7fc0_0000), (76, 0), (132, 0)];
    for (at, value) in wrong {
        let mut bytes = good.clone();
        bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
        assert!(read(&bytes).is_err(), "{at}: {value}");
    }
    assert!(read(&good[..good.len() - 64]).is_err() && read(&[]).is_err());
    assert!(CHUNK_LIMITS.iter().all(|most| *most > 0));
}

#[test]
fn disc_of_the_cone_is_its_width() {
    for d in [1.03, 1.5, 6.5, 1e4] {
        let sine: f64 = 1.0 / d;
        let edge = disc_from_direction([sine as f32, 0.0, (1.0 - sine * sine).sqrt() as f32])[0];
        assert!((f64::from(edge) / width(d) - 1.0).abs() < 1e-3, "{d}");
    }
}

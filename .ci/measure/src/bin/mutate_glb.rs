//! Damages whole .glb files and loads them, for as many minutes as asked: `cargo run -p prelight-measure --bin mutate_glb -- MINUTES FILE.glb...`.
//!
//! What it looks for is a panic, an abort or a hang; each round says its number first when `PRELIGHT_TELL` is set, so that the last line
//! names the round that ended the process. Rounds are counter-based: `FROM=ROUND` begins there.

use prelight_scene::gltf::{LoadLimits, load_bytes};
use prelight_scene::world::World;
use std::path::Path;
use std::time::{Duration, Instant};

/// splitmix64 of a counter.
fn random(state: &mut u64) -> usize {
    *state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((z ^ (z >> 31)) >> 8) as usize
}

fn damage(bytes: &mut Vec<u8>, state: &mut u64) {
    const WORDS: [u32; 8] = [0, 1, 0x7F, 0xFF, 0xFFFF, 0x7FFF_FFFF, 0xFFFF_FFFF, 0x8000_0000];
    let text_end = 20 + bytes.get(12..16).map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])) as usize;
    for _ in 0..1 + random(state) % 4 {
        let at = random(state) % bytes.len();
        match random(state) % 6 {
            0 | 1 => bytes[at] = random(state) as u8,
            2 => bytes[at] ^= 1 << (random(state) % 8),
            3 if at + 4 <= bytes.len() => bytes[at..at + 4].copy_from_slice(&WORDS[random(state) % 8].to_le_bytes()),
            // A digit of the description, which keeps it JSON.
            _ => {
                let digits: Vec<usize> = (20..text_end.min(bytes.len())).filter(|&i| bytes[i].is_ascii_digit()).collect();
                if !digits.is_empty() {
                    bytes[digits[random(state) % digits.len()]] = b'0' + (random(state) % 10) as u8;
                }
            }
        }
    }
    if random(state).is_multiple_of(50) {
        let keep = random(state) % bytes.len();
        bytes.truncate(keep);
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let minutes: Option<f64> = arguments.first().and_then(|text| text.parse().ok());
    let files: Vec<Vec<u8>> = arguments.iter().skip(1).map(|path| std::fs::read(path).unwrap_or_else(|e| panic!("{path}: {e}"))).collect();
    let (Some(minutes), false) = (minutes, files.is_empty()) else {
        eprintln!("usage: mutate_glb MINUTES FILE.glb...");
        std::process::exit(2);
    };
    let tell = std::env::var_os("PRELIGHT_TELL").is_some();
    let (start, from) = (Instant::now(), std::env::var("FROM").ok().and_then(|text| text.parse().ok()).unwrap_or(0u64));
    let (mut loaded, mut refused, mut longest) = (0u64, 0u64, Duration::ZERO);
    for round in from.. {
        if start.elapsed().as_secs_f64() > 60.0 * minutes {
            break;
        }
        if tell {
            eprintln!("{round}");
        }
        let mut state = round.wrapping_mul(0xD134_2543_DE82_EF95);
        let mut bytes = files[round as usize % files.len()].clone();
        damage(&mut bytes, &mut state);
        let began = Instant::now();
        match load_bytes(Path::new("mutated.glb"), &bytes, &LoadLimits { max_bytes: 256 << 20 }) {
            Ok(scene) => {
                World::build(&scene);
                loaded += 1;
            }
            Err(error) => {
                assert!(error.to_string().contains("help: "), "{error}");
                refused += 1;
            }
        }
        longest = longest.max(began.elapsed());
    }
    println!("{loaded} loaded, {refused} refused, the longest took {:.2} s", longest.as_secs_f64());
}

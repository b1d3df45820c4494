//! `prelight chart` on the demo's room, coarse and small: stopped, resumed, and what it says.

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const ROWS: usize = 10;

fn chart(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_prelight"));
    command.current_dir(folder).stdin(Stdio::null());
    for variable in ["PRELIGHT_JOBS", "PRELIGHT_MEMORY", "PRELIGHT_STORE"] {
        command.env_remove(variable);
    }
    command.args(["chart", "scene.toml", "-o", "out", "-e", "noon", "--views", "2", "--size", "320x180", "--json"]);
    command.args(["--reference", "4", "--samples", "4", "--timed-points", "96"]);
    command
}

fn summary(stdout: &[u8]) -> Value {
    let text = String::from_utf8_lossy(stdout);
    serde_json::from_str(text.lines().last().unwrap_or_default()).unwrap_or_else(|_| panic!("no summary: {text}"))
}

/// The demo's room with few points.
fn coarse_room(folder: &Path) {
    let scene = prelight_scene::demo::write_scene(folder).unwrap();
    let text = std::fs::read_to_string(&scene.manifest).unwrap();
    let coarse: String = text
        .lines()
        .map(|line| match line.strip_prefix("edge_length = ") {
            Some(_) => "edge_length = 0.5\n".to_string(),
            None => format!("{line}\n"),
        })
        .collect();
    std::fs::write(&scene.manifest, coarse).unwrap();
}

#[test]
#[cfg(unix)]
fn a_chart_stops_resumes_and_says_what_each_technique_costs_and_errs() {
    let folder = tempfile::tempdir().unwrap();
    coarse_room(folder.path());
    let mut first = chart(folder.path()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let cells = folder.path().join("out/cells");
    let since = Instant::now();
    let made = || {
        std::fs::read_dir(&cells)
            .map_or(0, |entries| entries.filter(|e| e.as_ref().unwrap().path().extension().is_some_and(|e| e == "json")).count())
    };
    while made() == 0 && first.try_wait().unwrap().is_none() {
        assert!(since.elapsed() < Duration::from_secs(300), "no chart in five minutes");
        std::thread::sleep(Duration::from_millis(20));
    }
    assert!(Command::new("kill").args(["-INT", &first.id().to_string()]).status().unwrap().success());
    let first = first.wait_with_output().unwrap();
    assert_eq!(first.status.code(), Some(130), "{}", String::from_utf8_lossy(&first.stderr));
    assert!(String::from_utf8_lossy(&first.stdout).contains("charts to make, about"), "wall time is said first");

    let second = chart(folder.path()).output().unwrap();
    assert_eq!(second.status.code(), Some(0), "{}", String::from_utf8_lossy(&second.stderr));
    let result = summary(&second.stdout);
    assert_eq!((&result["charts"]["kept"], &result["charts"]["made"]), (&1.into(), &1.into()), "{result}");
    let rows = result["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 2 * 3 * ROWS, "still, moving light and moving view of two views");
    assert_eq!(rows.iter().filter(|row| row["held_back"] == true).count(), 3 * ROWS);
    let error = |row: &Value, name: &str| row[name].as_f64().unwrap_or_else(|| panic!("no {name}: {row}"));
    for (at, cell) in rows.chunks(ROWS).enumerate() {
        assert!(cell.iter().all(|row| row["motion"] == ["still", "moving light", "moving view"][at % 3]), "{cell:?}");
        let find = |technique: &str, budget: &str| {
            cell.iter()
                .find(|row| row["technique"] == technique && row["budget"] == budget)
                .unwrap_or_else(|| panic!("{technique} {budget}"))
        };
        let at_points = |technique, budget| error(find(technique, budget), "points_relative_l2");
        // The plain sum is the oracle's but for f32; what is dropped costs what is expected of it.
        assert!(at_points("block_product", "tolerance 0") < 1e-4, "{cell:?}");
        assert!(at_points("block_product", "fine, 0.001") < at_points("block_product", "tolerance 0.3"), "{cell:?}");
        assert!(at_points("haar_triple", "10 %") < at_points("haar_triple", "1 %"), "{cell:?}");
        assert!(at_points("sh_product", "25 coefficients") > 10.0 * at_points("block_product", "display, 0.02"), "{cell:?}");
        assert!(cell.iter().any(|row| row["pareto_points"] == true) && cell.iter().any(|row| row["pareto_bytes"] == true));
        // What is exact does not flicker; 25 harmonics do, more or less.
        if at % 3 > 0 {
            let flicker = |technique, budget| error(find(technique, budget), "temporal_max");
            assert!(flicker("block_product", "tolerance 0") < 0.1 && flicker("sh_product", "25 coefficients") > 0.0, "{cell:?}");
            assert!((at % 3 == 1) == (error(find("pixel_sums", "all texels"), "prepare_seconds") > 0.0));
            continue;
        }
        for row in cell {
            let positive = ["ns_per_point", "bytes_per_point", "bake_seconds", "relative_l2", "psnr_db", "flip", "reference_noise"];
            assert!(positive.iter().all(|name| error(row, name) > 0.0), "{row}");
            assert_eq!(row["technique"] == "haar_triple", error(row, "projection_ns") > 0.0, "{row}");
        }
        assert_eq!(find("sh_product", "25 coefficients")["bytes_per_point"], 100.0);
    }
    let out = folder.path().join("out");
    let read = |name: &str| std::fs::read_to_string(out.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
    assert_eq!(read("chart.csv").lines().count(), 1 + 2 * 3 * ROWS);
    let page = read("index.html");
    // A truth and a pair a row for each still; pairs of two block products and of 25 harmonics for what moves.
    assert_eq!(page.matches("data:image/png;base64,").count(), 2 * (1 + 2 * ROWS) + 4 * 2 * 3);
    let own = page.replace("xmlns=\"http://www.w3.org/2000/svg\"", "");
    assert!(["http:", "https:", "<link", "src=\"/", "@import"].iter().all(|outside| !own.contains(outside)), "nothing from elsewhere");
    assert!(read("02-moving-light-temporal.svg").contains("Flicker"));
    assert!(page.contains("held back") && read("02-picture.svg").contains("path tracer at equal error"));

    // References are records of the store: a cell that is made again finds its own there.
    let ledger = || std::fs::read_dir(out.join(".prelight/ledger")).unwrap().count();
    let before = ledger();
    let cell = std::fs::read_dir(&cells).unwrap().map(|e| e.unwrap().path()).find(|p| p.extension().is_some_and(|e| e == "json"));
    std::fs::remove_file(cell.unwrap()).unwrap();
    let third = summary(&chart(folder.path()).output().unwrap().stdout);
    assert_eq!((&third["charts"]["kept"], &third["charts"]["made"]), (&1.into(), &1.into()), "{third}");
    assert_eq!(ledger(), before);
}

/// The paper's tables on the same room: shares sum to 100, and its algorithm does what it says.
#[test]
fn the_tables_of_the_paper_add_up() {
    let folder = tempfile::tempdir().unwrap();
    coarse_room(folder.path());
    let output = chart(folder.path()).args(["--paper", "ifl"]).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let result = summary(&output.stdout);
    let rows = result["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 5);
    for row in rows {
        let sum = |name: &str| row[name].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).sum::<f64>();
        assert!((sum("lines") - 100.0).abs() < 1e-6 && (sum("samples") - 100.0).abs() < 1e-6, "{row}");
        let number = |name: &str| row[name].as_f64().unwrap_or_else(|| panic!("no {name}: {row}"));
        // A handful of points under a low sun, which the paper's samples a block hold to about 22 dB.
        assert!(number("ns_per_point") > 0.0 && number("points") > 0.0 && number("psnr_db") > 15.0, "{row}");
        assert!((1.0..=256.0).contains(&number("transitions_per_block")), "{row}");
    }
    assert_eq!(result["partly_lit"], 0.0, "binary visibility has no penumbra under one texel");
    assert_eq!(rows[0]["samples"][0], 100.0, "a diffuse surface needs a sample a block");
    assert!(rows[4]["samples"][3].as_f64().unwrap() > 0.0, "mirrors are sampled at texels");
}

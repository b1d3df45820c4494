//! `prelight gc`: sweeps what no asset needs.
//!
//! Assets are kept until they are forgotten: by digest or by the name of their file (`--forget`), or all but the last few of each scene
//! (`--keep-last`). What then nothing reaches goes to the trash, and with a gc after the grace time for good.

use super::opened_store::open_store;
use super::{Context, ExitCode, Failure, Summary};
use clap::Args;
use prelight_bake::progress::Stage;
use prelight_manifests::{ByteSize, Digest};
use prelight_store::{Root, Store, SweepOptions, SweepReport, Swept};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::time::Duration;

/// Files named in the text for people; the JSON has them all.
const MAX_LISTED: usize = 20;

/// Sweep what no asset needs; what goes now is deleted by a gc after the grace time
#[derive(Args, Debug)]
pub struct GcArgs {
    /// Keep what was used within this time, as 90s, 30m, 12h, 7d; deleting waits for as long
    #[arg(long, value_name = "TIME", default_value = "24h", value_parser = duration)]
    pub grace: Duration,
    /// Give up an asset: its digest (or how it begins), or the name of its file; may be given several times
    #[arg(long, value_name = "ASSET")]
    pub forget: Vec<String>,
    /// Give up all but the last N bakes of each scene
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub keep_last: Option<u32>,
}

/// `90`, `90s`, `30m`, `12h`, `7d`.
fn duration(text: &str) -> Result<Duration, String> {
    let expected = || "expected a time, as in 90s, 30m, 12h or 7d".to_string();
    let (number, unit) = match text.char_indices().last() {
        Some((at, 's')) => (&text[..at], 1),
        Some((at, 'm')) => (&text[..at], 60),
        Some((at, 'h')) => (&text[..at], 3600),
        Some((at, 'd')) => (&text[..at], 86_400),
        _ => (text, 1),
    };
    let number: u32 = number.parse().map_err(|_| expected())?;
    Ok(Duration::from_secs(u64::from(number) * unit))
}

/// A root, and what its manifest's report says of where it came from.
struct Known {
    root: Root,
    sealed: u64,
    scene: String,
    asset: String,
}

/// Runs the verb.
pub fn run(args: GcArgs, context: &Context) -> Result<Summary, Failure> {
    let store = open_store(context)?;
    let _stage = Stage::begin(context.progress(), "gc", None, "files");
    let known = known_assets(&store)?;
    let mut forget = Vec::new();
    for name in &args.forget {
        forget.extend(named(name, &known)?);
    }
    if let Some(keep) = args.keep_last {
        forget.extend(superseded(&known, keep as usize));
    }
    forget.sort();
    forget.dedup();
    let options = SweepOptions { grace: args.grace, forget, dry_run: context.dry_run, ..SweepOptions::default() };
    let report = store.sweep(&options)?;
    Ok(summary(&report, args.grace, context.dry_run))
}

/// A root whose manifest cannot be read belongs to no scene; the sweep itself says what is wrong with it.
fn known_assets(store: &Store) -> Result<Vec<Known>, Failure> {
    let mut known = Vec::new();
    for (root, sealed) in store.roots_by_time()? {
        let manifest: Value = store.manifest(&root).ok().and_then(|text| serde_json::from_slice(&text).ok()).unwrap_or_default();
        let text = |value: &Value| value.as_str().unwrap_or_default().to_string();
        let report = &manifest["report"];
        known.push(Known { root, sealed, scene: text(&report["scene"]), asset: text(&report["bake"]["asset"]) });
    }
    Ok(known)
}

fn named(name: &str, known: &[Known]) -> Result<Vec<Digest>, Failure> {
    let file = |known: &Known| known.asset == name || known.asset.rsplit(['/', '\\']).next() == Some(name);
    let is_digest = name.len() >= 8 && name.bytes().all(|byte| byte.is_ascii_hexdigit());
    let begins = |known: &Known| is_digest && known.root.asset.to_string().starts_with(name);
    let by_digest: Vec<Digest> = known.iter().filter(|known| begins(known)).map(|known| known.root.asset).collect();
    if by_digest.len() > 1 {
        return Err(Failure::text(ExitCode::Usage, format!("{} assets begin with {name}\n  help: give more digits", by_digest.len())));
    }
    let found =
        if by_digest.is_empty() { known.iter().filter(|known| file(known)).map(|known| known.root.asset).collect() } else { by_digest };
    if found.is_empty() {
        let names: Vec<String> = known.iter().map(|known| format!("{} ({})", known.asset, known.root.asset.short())).collect();
        let help = if names.is_empty() { "there is none".to_string() } else { format!("it has: {}", names.join(", ")) };
        return Err(Failure::text(ExitCode::Usage, format!("the store has no asset {name}\n  help: {help}")));
    }
    Ok(found)
}

/// All but the last `keep` of each scene and file; assets that name no scene stay.
fn superseded(known: &[Known], keep: usize) -> Vec<Digest> {
    let mut groups: BTreeMap<(&str, &str), Vec<(u64, Digest)>> = BTreeMap::new();
    for known in known.iter().filter(|known| !known.scene.is_empty()) {
        groups.entry((&known.scene, &known.asset)).or_default().push((known.sealed, known.root.asset));
    }
    let mut old = Vec::new();
    for mut group in groups.into_values() {
        group.sort();
        group.truncate(group.len().saturating_sub(keep));
        old.extend(group.into_iter().map(|(_, asset)| asset));
    }
    old
}

fn bytes(files: &[Swept]) -> u64 {
    files.iter().map(|swept| swept.bytes).sum()
}

fn summary(report: &SweepReport, grace: Duration, dry_run: bool) -> Summary {
    let mut summary = Summary::new();
    let forgotten: Vec<String> = report.forgotten.iter().map(Digest::to_string).collect();
    summary
        .set("dry_run", dry_run)
        .set("assets", report.roots)
        .set("chunks_live", report.live_chunks)
        .set("leases", report.leases)
        .set("forgotten", forgotten.clone())
        .set("waiting.files", report.waiting)
        .set("waiting.bytes", report.waiting_bytes)
        .set("remains", report.remains);
    let mut text = format!("{} assets reach {} chunks", report.roots, report.live_chunks);
    text += &if report.leases > 0 { format!("; {} writers are at work\n", report.leases) } else { "\n".to_string() };
    forgotten.iter().for_each(|asset| text += &format!("forgotten  {asset}\n"));
    let verbs =
        if dry_run { ["would be deleted", "would come back", "would go to the trash"] } else { ["deleted", "came back", "to the trash"] };
    let mut listed = 0;
    for (name, verb, files) in
        [("deleted", verbs[0], &report.deleted), ("restored", verbs[1], &report.restored), ("condemned", verbs[2], &report.condemned)]
    {
        let json: Vec<Value> =
            files.iter().map(|swept| json!({ "file": swept.file, "bytes": swept.bytes, "reason": swept.reason })).collect();
        summary.set(&format!("{name}.files"), files.len()).set(&format!("{name}.bytes"), bytes(files)).set(&format!("{name}.list"), json);
        text += &format!("{verb}: {} files, {}\n", files.len(), ByteSize(bytes(files)));
        if dry_run {
            for swept in files.iter().take(MAX_LISTED - listed.min(MAX_LISTED)) {
                text += &format!("  {} ({}): {}\n", swept.file, ByteSize(swept.bytes), swept.reason);
                listed += 1;
            }
        }
    }
    if report.waiting > 0 {
        text += &format!("in the trash already: {} files, {}\n", report.waiting, ByteSize(report.waiting_bytes));
    }
    if !dry_run && !report.condemned.is_empty() {
        text += &format!("a gc {} hours from now deletes what went to the trash\n", grace.as_secs().div_ceil(3600));
    }
    summary.set_text(text);
    summary
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_read_or_refused() {
        let seconds = |text: &str| duration(text).map(|time| time.as_secs());
        assert_eq!([seconds("90"), seconds("90s"), seconds("30m"), seconds("12h")], [Ok(90), Ok(90), Ok(1800), Ok(43_200)]);
        assert_eq!(seconds("7d"), Ok(604_800));
        for bad in ["", "s", "1w", "-1h", "1.5h", "h1", "99999999999d", "é"] {
            assert!(duration(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn the_last_bakes_of_each_scene_and_file_are_kept() {
        let known = |n: u8, sealed: u64, scene: &str, asset: &str| Known {
            root: Root { asset: Digest([n; 32]), manifest: Digest([n; 32]), manifest_bytes: 0 },
            sealed,
            scene: scene.into(),
            asset: asset.into(),
        };
        let all = [known(1, 30, "a", "a"), known(2, 10, "a", "a"), known(3, 20, "a", "a"), known(4, 1, "a", "b"), known(5, 1, "", "a")];
        assert_eq!(superseded(&all, 1), [Digest([2; 32]), Digest([3; 32])]);
        assert_eq!(superseded(&all, 2), [Digest([2; 32])]);
        assert_eq!(superseded(&all, 3), []);
        assert_eq!(named("b", &all).unwrap(), [Digest([4; 32])]);
        assert_eq!(named("01010101", &all).unwrap(), [Digest([1; 32])]);
        assert!(named("c", &all).is_err() && named("0101", &all).is_err());
    }
}

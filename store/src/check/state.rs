//! `verify.state`: how far a check has come, so that one that was stopped can go on.
//!
//! A note is a saving of time, never a reason to call something right. It holds for one store (its id), one sample, one day, and only as long as
//! all files that it stands for are those that were read: it has a digest of their names, lengths and times of change, taken before each was
//! read. The time of change is the one that the system keeps (ctime), which no program can set back, so a file that was written to, replaced
//! or touched since makes the next check begin anew. Lines:
//!
//! ```text
//! prelight verify 2
//! store ID
//! sample SHARE SEED
//! seen DIGEST
//! done FILE
//! counts FILES CHUNKS BYTES
//! finding FILE<tab>OFFSET<tab>DIGEST or -<tab>WHAT      (any number)
//! check DIGEST
//! ```
//!
//! Another user who may write to the store's folder can make a file of this name, but not one that belongs to whoever runs the check: such a note,
//! and one that others may write to, is not believed. Whoever can act as that user has no need of a note; `--restart` believes nobody.

use super::{CheckOptions, CheckReport, Finding};
use crate::os::{self, FileTime, Metadata, RootedPath};
use crate::{StoreError, digest_of};
use prelight_manifests::Digest;

const NAME: &str = "verify.state";
const MAX_BYTES: u64 = 256 << 20;

/// How long a note is believed: bytes go bad by lying there, too.
const MAX_AGE: FileTime = 86_400_000_000_000;

/// Digest of what was known about the files that a note stands for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Seen(Digest);

impl Seen {
    /// With one more file; `None` is one that has gone.
    pub fn and(self, file: &str, metadata: Option<&Metadata>) -> Self {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&self.0.0).update(&(file.len() as u64).to_le_bytes()).update(file.as_bytes());
        if let Some(metadata) = metadata {
            for number in [metadata.len(), os::modified(metadata), metadata.changed()] {
                hasher.update(&number.to_le_bytes());
            }
        }
        Seen(Digest(*hasher.finalize().as_bytes()))
    }
}

/// What an earlier check has noted.
#[derive(Debug)]
pub(super) struct Note {
    pub done: String,
    pub seen: Seen,
    pub report: CheckReport,
}

/// Where the note of one kind of check lies.
pub(super) struct State {
    path: RootedPath,
    head: String,
    /// Else something that is no file has its name.
    may_write: bool,
}

impl State {
    /// The place, and what it holds that may be believed now; whether the files are the same is for the caller to see.
    pub fn open(dir: &RootedPath, id: &str, options: &CheckOptions) -> Result<(Self, Option<Note>), StoreError> {
        let path = dir.join(NAME);
        let head = format!("prelight verify 2\nstore {id}\nsample {} {}\n", options.sample, options.seed);
        let bytes = os::if_ours(os::read_small(&path, MAX_BYTES));
        let may_write = !matches!(bytes, Ok(None));
        // A note that cannot be read is none.
        let bytes = bytes.ok().flatten().flatten().unwrap_or_default();
        let state = State { path, head, may_write };
        let note = parse(&bytes, &state.head).filter(|_| options.resume && state.may_be_believed());
        Ok((state, note))
    }

    /// Whether the note is young, and could only have been written by whoever runs this check: it belongs to the owner of a file that is made now,
    /// and no other user may write to it.
    fn may_be_believed(&self) -> bool {
        let Ok(Some(note)) = os::metadata(&self.path) else { return false };
        let temp = self.temp();
        let Ok((_, own)) = os::create_private(&temp) else { return false };
        os::remove_temp_file(&temp);
        note.is_private_to(&own) && os::local_now().abs_diff(os::modified(&note)) < MAX_AGE
    }

    fn temp(&self) -> RootedPath {
        self.path.sibling(&format!("{NAME}.{}.part", os::unique_name()))
    }

    /// Best effort: a store that cannot be written can be verified all the same, but not in parts.
    pub fn write(&self, done: &str, seen: Seen, report: &CheckReport) {
        if !self.may_write {
            return;
        }
        let mut text = format!("{}seen {}\ndone {done}\ncounts {} {} {}\n", self.head, seen.0, report.files, report.chunks, report.bytes);
        for finding in &report.findings {
            let digest = finding.digest.map_or("-".to_string(), |digest| digest.to_string());
            let what = finding.what.replace(['\n', '\t'], " ");
            text += &format!("finding {}\t{}\t{digest}\t{what}\n", finding.file.replace(['\n', '\t'], "?"), finding.offset);
        }
        text += &format!("check {}\n", digest_of(text.as_bytes()));
        let temp = self.temp();
        let Ok((mut file, _)) = os::create_private(&temp) else { return };
        if os::write(&mut file, &temp, text.as_bytes()).and_then(|()| os::rename(&temp, &self.path)).is_err() {
            os::remove_temp_file(&temp);
        }
    }

    /// The check is through.
    pub fn remove(&self) {
        os::remove_temp_file(&self.path);
    }
}

fn parse(bytes: &[u8], head: &str) -> Option<Note> {
    let text = std::str::from_utf8(bytes).ok()?;
    let (body, check) = text.rsplit_once("check ")?;
    if check.trim_end() != digest_of(body.as_bytes()).to_string() {
        return None;
    }
    let mut lines = body.strip_prefix(head)?.lines();
    let seen = Seen(lines.next()?.strip_prefix("seen ")?.parse().ok()?);
    let done = lines.next()?.strip_prefix("done ")?.to_string();
    let counts: Vec<u64> = lines.next()?.strip_prefix("counts ")?.split(' ').map(|n| n.parse().ok()).collect::<Option<_>>()?;
    let &[files, chunks, bytes] = &counts[..] else { return None };
    let finding = |line: &str| {
        let mut fields = line.strip_prefix("finding ")?.split('\t');
        let (file, offset) = (fields.next()?.to_string(), fields.next()?.parse().ok()?);
        let digest = fields.next()?.parse().ok();
        Some(Finding { file, offset, digest, what: fields.next()?.to_string() })
    };
    let findings = lines.map(finding).collect::<Option<_>>()?;
    Some(Note { done, seen, report: CheckReport { files, chunks, bytes, findings, ..CheckReport::default() } })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn any_bytes_are_read_without_a_panic_and_believed_by_nobody(
            bytes in prop::collection::vec(any::<u8>(), 0..300),
            text in "head\n(seen [0-9a-f]{64}\n)?(done .{0,9}\n)?(counts [0-9 ]{1,60}\n)?.{0,80}(check [0-9a-f]{64}\n)?",
        ) {
            prop_assert!(parse(&bytes, "head\n").is_none() && parse(text.as_bytes(), "head\n").is_none());
            let signed = format!("{text}check {}\n", digest_of(text.as_bytes()));
            let _ = parse(signed.as_bytes(), "head\n");
        }
    }
}

//! What the machine says about a file system: its kind, whether other machines share it, how much is free.

use std::path::Path;

/// Kinds of file system by the magic number of statfs(2), and whether another machine may change files there. Unknown ones count as local.
#[cfg(target_os = "linux")]
const FILE_SYSTEMS: [(u32, &str, bool); 24] = [
    (0xEF53, "ext2/3/4", false),
    (0x9123_683E, "btrfs", false),
    (0x5846_5342, "xfs", false),
    (0x0102_1994, "tmpfs", false),
    (0x794C_7630, "overlayfs", false),
    (0x2FC1_2FC1, "zfs", false),
    (0xF2F5_2010, "f2fs", false),
    (0x4D44, "fat", false),
    (0x6969, "nfs", true),
    (0x517B, "smb", true),
    (0xFE53_4D42, "smb2", true),
    (0xFF53_4D42, "cifs", true),
    (0x5346_414F, "afs", true),
    (0x6B41_4653, "afs", true),
    (0x7375_7245, "coda", true),
    (0x00C3_6400, "ceph", true),
    (0x0102_1997, "9p", true),
    (0x6573_5546, "fuse", true),
    (0x0BD0_0BD0, "lustre", true),
    (0x4750_4653, "gpfs", true),
    (0x7461_636F, "ocfs2", true),
    (0x0116_1970, "gfs2", true),
    (0x1983_0326, "beegfs", true),
    (0x564C, "ncp", true),
];

/// The file system's name and whether other machines may change files on it, so that mapping them is not safe.
#[cfg(target_os = "linux")]
pub(crate) fn file_system(path: &Path) -> (&'static str, bool) {
    let Ok(stat) = rustix::fs::statfs(path) else { return ("unknown", false) };
    let known = FILE_SYSTEMS.iter().find(|(magic, ..)| *magic == stat.f_type as u32);
    known.map_or(("unknown", false), |&(_, name, network)| (name, network))
}

/// Not known on this system, so taken for local.
#[cfg(not(target_os = "linux"))]
pub(crate) fn file_system(_path: &Path) -> (&'static str, bool) {
    ("unknown", false)
}

/// Whether files here may be changed by other machines.
pub(crate) fn is_network(path: &Path) -> bool {
    file_system(path).1
}

/// Bytes and files that an ordinary user may still add, where the system says.
#[cfg(target_os = "linux")]
pub(crate) fn free_space(path: &Path) -> Option<(u64, u64)> {
    let stat = rustix::fs::statvfs(path).ok()?;
    Some((stat.f_bavail.saturating_mul(stat.f_frsize), stat.f_favail))
}

/// Bytes and files that an ordinary user may still add. Not known on this system.
#[cfg(not(target_os = "linux"))]
pub(crate) fn free_space(_path: &Path) -> Option<(u64, u64)> {
    None
}

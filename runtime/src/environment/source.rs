//! The file that is decoded: its bytes, what is said of it, and what may be allocated for it.

use crate::error::RuntimeError;
use prelight_manifests::scene::Projection;
use prelight_store::Budget;
use prelight_store::budget::Charge;

/// What a person says of a map's file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MapOptions {
    /// How the sphere lies in the image. `None`: as the file declares, else by its shape.
    pub projection: Option<Projection>,
    /// Layer of an OpenEXR file to read, without regard to case. `None`: the likeliest.
    pub layer: Option<String>,
}

/// Images up to 128 MiB of pixels need no bytes to justify them: they may be one colour, or black around a small window.
const SMALL_IMAGE: u128 = 128 << 20;
/// Beyond that, bytes of pixels per byte of the file.
const IMAGE_RATIO: u128 = 2048;

/// Memory that opening assets and decoding images may take together, beside the files themselves. Clones share it, so one app has one.
///
/// An asset takes its part as long as it is open, and what one relighter of it holds is in that; an image 12 bytes a pixel as long as there is a copy
/// of it. What does not fit is [`RuntimeError::Memory`], said before anything is allocated.
#[derive(Clone, Debug, Default)]
pub struct Limits {
    budget: Budget,
}

impl Limits {
    /// So many bytes. [`Limits::default`] is a quarter of the memory that this process may use.
    pub fn new(max_bytes: u64) -> Self {
        Limits { budget: Budget::new(max_bytes) }
    }

    /// What a budget has left.
    pub fn sharing(budget: &Budget) -> Self {
        Limits { budget: budget.clone() }
    }

    /// The budget that is charged.
    pub fn budget(&self) -> &Budget {
        &self.budget
    }
}

/// An image as it stood in the file, and what was passed over in it.
pub(super) struct Decoded {
    pub width: usize,
    pub height: usize,
    pub pixels: Vec<[f32; 3]>,
    pub notes: Vec<String>,
    /// What the file declares.
    pub projection: Option<Projection>,
}

/// The file being decoded: its name for messages, its bytes, and what may be allocated for it.
#[derive(Clone, Copy)]
pub(super) struct Source<'a> {
    pub file: &'a str,
    pub bytes: &'a [u8],
    pub limits: &'a Limits,
}

impl Source<'_> {
    /// An error about this file.
    pub(crate) fn error(&self, what: impl Into<String>, help: &str) -> RuntimeError {
        RuntimeError::Environment { file: self.file.to_owned(), what: what.into(), help: help.to_owned() }
    }

    /// An error for a file that ends too early.
    pub(crate) fn truncated(&self, what: &str) -> RuntimeError {
        self.error(format!("the file is cut short: {what}"), "copy or download it again")
    }

    /// Charges `needed` bytes for as long as what it gives lives; fails when they are more than what is left.
    pub(crate) fn take_memory(&self, what: &str, needed: u64) -> Result<Charge, RuntimeError> {
        let budget = self.limits.budget();
        let refused = || RuntimeError::Memory { what: format!("{what} of {}", self.file), needed, limit: budget.left() };
        budget.charge(needed).ok_or_else(refused)
    }

    /// Fails when so many pixels are claimed by so few bytes that none but a hostile file says so.
    pub(super) fn check_ratio(&self, width: usize, height: usize, help: &str) -> Result<(), RuntimeError> {
        let (pixels, present) = (width as u128 * height as u128, self.bytes.len() as u128);
        if pixels * 12 <= SMALL_IMAGE.max(present * IMAGE_RATIO) {
            return Ok(());
        }
        Err(self.error(format!("{width} x {height} pixels are far more than its {present} bytes stand for"), help))
    }

    /// An empty vector with room for `count` pixels; an error instead of an abort when the system has not that much.
    pub(crate) fn reserve_pixels(&self, count: usize) -> Result<Vec<[f32; 3]>, RuntimeError> {
        let mut pixels = Vec::new();
        match pixels.try_reserve_exact(count) {
            Ok(()) => Ok(pixels),
            Err(_) => Err(self.out_of_memory("pixels", (count as u64).saturating_mul(12))),
        }
    }

    /// The system has not as much as the limits allow.
    pub(super) fn out_of_memory(&self, what: &str, needed: u64) -> RuntimeError {
        RuntimeError::Memory { what: format!("{what} of {}", self.file), needed, limit: self.limits.budget().left() }
    }
}

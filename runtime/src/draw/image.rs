//! Linear RGB images in memory.

/// Linear RGB f32 image. Shape of `pixels`: `[height, width]`, rows from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Pixels along a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Linear Rec.709 radiance.
    pub pixels: Vec<[f32; 3]>,
}

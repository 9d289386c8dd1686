//! The size of an image.

/// Width and height of an image, in pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Image {
    pub width: u32,
    pub height: u32,
}

impl Image {
    /// Number of pixels.
    pub fn pixels(self) -> u32 {
        self.width * self.height
    }
}

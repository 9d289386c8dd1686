//! What can go wrong with a preview.

use thiserror::Error;

/// Why there is no preview.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum PreviewError {
    /// The image has no pixel.
    #[error("camera: an image of {width} x {height} pixels has nothing to preview")]
    EmptyImage {
        /// Image width, pixels.
        width: u32,
        /// Image height, pixels.
        height: u32,
    },
    /// The image has more pixels than are held at once.
    #[error("camera: an image of {width} x {height} pixels exceeds the limit of {limit} pixels")]
    ImageTooLarge {
        /// Image width, pixels.
        width: u32,
        /// Image height, pixels.
        height: u32,
        /// Most pixels of an image.
        limit: u64,
    },
    /// The camera is not a camera.
    #[error("camera: {0} is not finite, or the field of view is not positive")]
    Camera(&'static str),
    /// The GPU was asked for and there is none that can do it.
    #[error("no usable Vulkan device: {0}")]
    NoDevice(String),
    /// The scene does not fit the device.
    #[error("the scene's {what} take {bytes} bytes; the device takes {limit} in one buffer")]
    DoesNotFit {
        /// What does not fit.
        what: &'static str,
        /// Bytes needed.
        bytes: u64,
        /// Bytes that the device takes.
        limit: u64,
    },
    /// The device did not answer in time.
    #[error("the Vulkan device did not answer within {seconds} s")]
    Timeout {
        /// How long was waited, seconds.
        seconds: u64,
    },
    /// The device failed or was lost.
    #[error("the Vulkan device failed: {0}")]
    Device(String),
}

//! Errors of a preview.

use thiserror::Error;

/// Why a preview could not be made.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum PreviewError {
    /// The image has no pixel.
    #[error("camera: the image has {width} x {height} pixels; both must be at least 1")]
    EmptyImage {
        /// Image width in pixels.
        width: u32,
        /// Image height in pixels.
        height: u32,
    },
    /// The image has more pixels than fit in memory at once.
    #[error("camera: an image of {width} x {height} pixels exceeds the limit of {limit} pixels")]
    ImageTooLarge {
        /// Image width in pixels.
        width: u32,
        /// Image height in pixels.
        height: u32,
        /// Largest number of pixels of an image.
        limit: u64,
    },
    /// The camera has a vector that is not finite, or a field of view that is not positive.
    #[error("camera: {0} is not finite, or the field of view is not positive")]
    Camera(&'static str),
    /// The GPU was requested, but no usable Vulkan device was found.
    #[error("no usable Vulkan device: {0}")]
    NoDevice(String),
    /// A buffer of the scene exceeds a limit of the device.
    #[error("the scene's {what} need {bytes} bytes, but a buffer of the device holds at most {limit}")]
    DoesNotFit {
        /// What the buffer holds.
        what: &'static str,
        /// Size of the buffer in bytes.
        bytes: u64,
        /// Limit of the device in bytes.
        limit: u64,
    },
    /// The device did not answer in time.
    #[error("the Vulkan device did not answer within {seconds} s")]
    Timeout {
        /// Time waited, in seconds.
        seconds: u64,
    },
    /// The device failed or was lost.
    #[error("the Vulkan device failed: {0}")]
    Device(String),
}

//! The camera of one frame.

use glam::{Vec2, Vec3};

/// A pinhole or thin-lens camera at one instant. `right`, `up` and `forward` are orthonormal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Centre of projection, metres.
    pub origin: Vec3,
    /// Unit vector towards the right edge of the image.
    pub right: Vec3,
    /// Unit vector towards the top edge of the image.
    pub up: Vec3,
    /// Unit vector of the view direction.
    pub forward: Vec3,
    /// Tangent of half the horizontal field of view.
    pub tan_half_x: f32,
    /// Tangent of half the vertical field of view.
    pub tan_half_y: f32,
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Radius of the lens, metres; 0 is a pinhole.
    pub aperture_radius: f32,
    /// Distance of the plane in focus along `forward`, metres.
    pub focus_distance: f32,
}

impl Camera {
    /// Direction, not normalised, through the image point `pixel` in pixels from the top-left corner
    /// (the centre of the first pixel is (0.5, 0.5)); its component along `forward` is 1.
    pub fn direction(&self, pixel: Vec2) -> Vec3 {
        let x = (2.0 * pixel.x / self.width as f32 - 1.0) * self.tan_half_x;
        let y = (1.0 - 2.0 * pixel.y / self.height as f32) * self.tan_half_y;
        self.forward + x * self.right + y * self.up
    }

    /// The same camera with another image size, square pixels; the field of view along `x` stays.
    pub fn resized(mut self, width: u32, height: u32) -> Self {
        self.width = width;
        self.height = height;
        self.tan_half_y = self.tan_half_x * height as f32 / width as f32;
        self
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }
}

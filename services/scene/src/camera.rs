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
    /// Radius of the lens, metres. 0 is a pinhole.
    pub aperture_radius: f32,
    /// Distance of the focus plane along `forward`, metres.
    pub focus_distance: f32,
}

impl Camera {
    /// Direction through an image point, with the component 1 along `forward`. `pixel` is in pixels from the
    /// top-left corner; the first centre is (0.5, 0.5).
    pub fn direction(&self, pixel: Vec2) -> Vec3 {
        let x = (2.0 * pixel.x / self.width as f32 - 1.0) * self.tan_half_x;
        let y = (1.0 - 2.0 * pixel.y / self.height as f32) * self.tan_half_y;
        self.forward + x * self.right + y * self.up
    }

    /// The pixel (column, row) of a point through a pinhole. `None` behind the camera or outside the image.
    pub fn pixel_of(&self, point: Vec3) -> Option<(u32, u32)> {
        let offset = point - self.origin;
        let depth = offset.dot(self.forward);
        let x = (offset.dot(self.right) / (depth * self.tan_half_x) + 1.0) * 0.5 * self.width as f32;
        let y = (1.0 - offset.dot(self.up) / (depth * self.tan_half_y)) * 0.5 * self.height as f32;
        let inside = depth > 0.0 && x >= 0.0 && y >= 0.0 && x < self.width as f32 && y < self.height as f32;
        inside.then_some((x as u32, y as u32))
    }

    /// The same camera with another image size and square pixels. The horizontal field of view is kept.
    pub fn resized(mut self, width: u32, height: u32) -> Self {
        self.width = width;
        self.height = height;
        self.tan_half_y = self.tan_half_x * height as f32 / width as f32;
        self
    }

    /// Like [`Self::resized`], but keeps the vertical field of view. An image of the same shape has the same
    /// bits.
    pub(crate) fn resized_by_height(mut self, width: u32, height: u32) -> Self {
        let shape = |width: u32, height: u32| width as f32 / height as f32;
        self.tan_half_x *= shape(width, height) / shape(self.width, self.height);
        self.resized(width, height)
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_along_a_pixels_direction_lies_on_that_pixel() {
        let camera = Camera {
            origin: Vec3::new(1.0, 2.0, 3.0),
            right: Vec3::X,
            up: Vec3::Y,
            forward: Vec3::NEG_Z,
            tan_half_x: 0.7,
            tan_half_y: 0.4,
            width: 7,
            height: 4,
            aperture_radius: 0.0,
            focus_distance: 1.0,
        };
        for (x, y) in (0..4).flat_map(|y| (0..7).map(move |x| (x, y))) {
            let direction = camera.direction(Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
            assert_eq!(camera.pixel_of(camera.origin + 9.0 * direction), Some((x, y)));
            assert_eq!(camera.pixel_of(camera.origin - 9.0 * direction), None);
        }
        assert_eq!(camera.pixel_of(camera.origin + camera.direction(Vec2::new(7.5, 2.0))), None);
        assert_eq!(camera.pixel_of(camera.origin), None);
    }
}

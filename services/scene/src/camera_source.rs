//! Sources of a shot's camera: a look-at description, or a node of a glTF file.

use crate::Camera;
use crate::animation::Animated;
use glam::{DMat4, DVec3};
use serde::{Deserialize, Serialize};

/// The image axis along which the field of view is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum FovAxis {
    #[default]
    X,
    Y,
}

/// A camera at `origin` that looks at `target`.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct LookAt {
    pub(crate) origin: Animated<DVec3>,
    pub(crate) target: Animated<DVec3>,
    pub(crate) up: Animated<DVec3>,
    /// Full angle of view along `fov_axis`, degrees.
    pub(crate) fov_deg: Animated<f64>,
    pub(crate) fov_axis: FovAxis,
    /// The angle of view along this axis stays as it is if the image gets another shape.
    pub(crate) kept_axis: FovAxis,
    pub(crate) width: u32,
    pub(crate) height: u32,
    /// Lens radius, metres. 0 is a pinhole.
    pub(crate) aperture_radius: f64,
    /// Distance of the focus plane, metres. `None` focuses on the target.
    pub(crate) focus_distance: Option<f64>,
}

impl LookAt {
    /// The camera at a frame, in coordinates relative to `scene_origin`, or the reason why there is none.
    pub(crate) fn at(&self, frame: f64, scene_origin: DVec3) -> Result<Camera, String> {
        let (origin, target) = (self.origin.at(frame), self.target.at(frame));
        let view = target - origin;
        let distance = view.length();
        if !(distance > 1e-9 && distance.is_finite()) {
            return Err(format!("`target` is `origin` at frame {frame}"));
        }
        let forward = view / distance;
        let up = self.up.at(frame).normalize_or_zero();
        let Some(right) = forward.cross(up).try_normalize().filter(|_| forward.cross(up).length() > 1e-6)
        else {
            return Err(format!("`up` is zero or along the view direction at frame {frame}"));
        };
        let fov = self.fov_deg.at(frame);
        if !(fov > 0.0 && fov < 180.0) {
            return Err(format!("`fov_deg` is {fov} at frame {frame}; it must be between 0 and 180 degrees"));
        }
        let tangent = libm::tan(fov.to_radians() / 2.0);
        let ratio = f64::from(self.height) / f64::from(self.width);
        let (tan_half_x, tan_half_y) = match self.fov_axis {
            FovAxis::X => (tangent, tangent * ratio),
            FovAxis::Y => (tangent / ratio, tangent),
        };
        Ok(Camera {
            origin: (origin - scene_origin).as_vec3(),
            right: right.as_vec3(),
            up: right.cross(forward).as_vec3(),
            forward: forward.as_vec3(),
            tan_half_x: tan_half_x as f32,
            tan_half_y: tan_half_y as f32,
            width: self.width,
            height: self.height,
            aperture_radius: self.aperture_radius as f32,
            focus_distance: self.focus_distance.unwrap_or(distance) as f32,
        })
    }
}

/// A perspective camera on a node. It looks along the node's −z.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct NodeCamera {
    /// Index into the shot's nodes.
    pub(crate) node: usize,
    /// Full vertical angle of view, radians.
    pub(crate) yfov: f64,
    /// As in [`LookAt`].
    pub(crate) kept_axis: FovAxis,
    pub(crate) width: u32,
    pub(crate) height: u32,
}

impl NodeCamera {
    /// The camera for the node's world matrix, or the reason why there is none.
    pub(crate) fn at(&self, world: &DMat4) -> Result<Camera, String> {
        let forward = (-world.z_axis.truncate()).try_normalize();
        let right = forward.and_then(|f| f.cross(world.y_axis.truncate()).try_normalize());
        let (Some(forward), Some(right)) = (forward, right) else {
            return Err("the camera's node has no orientation (its scale is zero)".into());
        };
        let tan_half_y = libm::tan(self.yfov / 2.0);
        Ok(Camera {
            origin: world.w_axis.truncate().as_vec3(),
            right: right.as_vec3(),
            up: right.cross(forward).as_vec3(),
            forward: forward.as_vec3(),
            tan_half_x: (tan_half_y * f64::from(self.width) / f64::from(self.height)) as f32,
            tan_half_y: tan_half_y as f32,
            width: self.width,
            height: self.height,
            aperture_radius: 0.0,
            focus_distance: 1.0,
        })
    }
}

/// Image height, in pixels, of a camera that does not specify it.
pub(crate) const DEFAULT_HEIGHT: u32 = 720;
/// Aspect ratio of a camera that does not specify it.
pub(crate) const DEFAULT_ASPECT: f64 = 16.0 / 9.0;

/// The default view, 1280 × 720 pixels, 40° high, from the front right and above. The sphere around the
/// bounding box from `lowest` to `highest` fills the height of the image.
pub(crate) fn default_view(lowest: DVec3, highest: DVec3) -> LookAt {
    const FOV_DEG: f64 = 40.0;
    let (centre, radius) = ((lowest + highest) / 2.0, ((highest - lowest).length() / 2.0).max(1e-3));
    let distance = radius / libm::sin(FOV_DEG.to_radians() / 2.0);
    let origin = centre + DVec3::new(0.5, 0.4, 1.0).normalize() * distance;
    LookAt {
        origin: Animated::Constant(origin),
        target: Animated::Constant(centre),
        up: Animated::Constant(DVec3::Y),
        fov_deg: Animated::Constant(FOV_DEG),
        fov_axis: FovAxis::Y,
        // A tall image shows the whole width, too.
        kept_axis: FovAxis::X,
        width: 1280,
        height: DEFAULT_HEIGHT,
        aperture_radius: 0.0,
        focus_distance: None,
    }
}

/// The source of a shot's camera.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) enum CameraSource {
    LookAt(Box<LookAt>),
    Node(NodeCamera),
}

impl CameraSource {
    /// One of its cameras with another image size and square pixels.
    pub(crate) fn resized(&self, camera: Camera, width: u32, height: u32) -> Camera {
        let kept = match self {
            Self::LookAt(look_at) => look_at.kept_axis,
            Self::Node(node) => node.kept_axis,
        };
        match kept {
            FovAxis::X => camera.resized(width, height),
            FovAxis::Y => camera.resized_by_height(width, height),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn look_at() -> LookAt {
        let mut view = default_view(DVec3::splat(-1.0), DVec3::splat(1.0));
        view.origin = Animated::Constant(DVec3::new(0.0, 0.0, 5.0));
        view.target = Animated::Constant(DVec3::ZERO);
        view
    }

    #[test]
    fn a_look_at_camera_has_x_to_the_right_and_y_up() {
        let mut view = look_at();
        (view.width, view.height) = (200, 100);
        (view.fov_deg, view.fov_axis) = (Animated::Constant(90.0), FovAxis::X);
        let camera = view.at(0.0, DVec3::ZERO).unwrap();
        assert_eq!((camera.right, camera.up, camera.forward), (Vec3::X, Vec3::Y, -Vec3::Z));
        assert!((camera.tan_half_x - 1.0).abs() < 1e-6 && (camera.tan_half_y - 0.5).abs() < 1e-6);
        assert_eq!(camera.focus_distance, 5.0);
    }

    #[test]
    fn a_field_of_view_along_y_widens_with_the_image() {
        let mut view = look_at();
        (view.width, view.height) = (200, 100);
        (view.fov_deg, view.fov_axis) = (Animated::Constant(90.0), FovAxis::Y);
        let camera = view.at(0.0, DVec3::ZERO).unwrap();
        assert!((camera.tan_half_x - 2.0).abs() < 1e-6 && (camera.tan_half_y - 1.0).abs() < 1e-6);
    }

    #[test]
    fn a_node_camera_looks_along_minus_z_whatever_the_scale() {
        let source = NodeCamera { node: 0, yfov: 1.0, kept_axis: FovAxis::X, width: 16, height: 9 };
        let world = DMat4::from_translation(DVec3::new(1.0, 2.0, 3.0)) * DMat4::from_scale(DVec3::splat(7.0));
        let camera = source.at(&world).unwrap();
        assert_eq!((camera.origin, camera.forward), (Vec3::new(1.0, 2.0, 3.0), -Vec3::Z));
        assert_eq!((camera.right, camera.up), (Vec3::X, Vec3::Y));
        assert!((camera.tan_half_x / camera.tan_half_y - 16.0 / 9.0).abs() < 1e-6);
    }

    #[test]
    fn the_angle_along_the_kept_axis_is_kept() {
        let mut view = look_at();
        (view.width, view.height) = (200, 100);
        let camera = view.at(0.0, DVec3::ZERO).unwrap();
        for (kept_axis, width, height, x, y) in [
            (FovAxis::X, 100, 100, 1.0, 2.0),
            (FovAxis::Y, 100, 100, 0.5, 1.0),
            (FovAxis::Y, 300, 50, 3.0, 1.0),
        ] {
            let source = CameraSource::LookAt(Box::new(LookAt { kept_axis, ..view.clone() }));
            let resized = source.resized(camera, width, height);
            assert_eq!((resized.width, resized.height), (width, height));
            assert!((resized.tan_half_x / camera.tan_half_x - x).abs() < 1e-6);
            assert!((resized.tan_half_y / camera.tan_half_y - y).abs() < 1e-6);
            for (width, height) in [(200, 100), (14, 7)] {
                assert_eq!(source.resized(camera, width, height), camera.resized(width, height));
            }
        }
    }

    #[test]
    fn the_default_view_sees_the_whole_bounding_box() {
        let (lowest, highest) = (DVec3::new(-3.0, 0.0, 1.0), DVec3::new(2.0, 9.0, 4.0));
        let camera = default_view(lowest, highest).at(0.0, DVec3::ZERO).unwrap();
        for i in 0..8 {
            let pick = |bit: usize, axis: usize| if i >> bit & 1 == 0 { lowest[axis] } else { highest[axis] };
            let corner = DVec3::new(pick(0, 0), pick(1, 1), pick(2, 2)).as_vec3() - camera.origin;
            let depth = corner.dot(camera.forward);
            assert!(corner.dot(camera.right).abs() <= depth * camera.tan_half_x);
            assert!(corner.dot(camera.up).abs() <= depth * camera.tan_half_y);
        }
    }
}

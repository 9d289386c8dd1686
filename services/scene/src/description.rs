//! Reads and checks `scene.json`, version 1. Serde rejects unknown keys and wrong types, then every value is
//! checked. All errors give the JSON pointer.

use crate::animation::Animated;
use crate::camera_source::{FovAxis, LookAt};
use crate::checker::{BRIGHTEST, Checker};
use crate::error::SceneError;
use crate::light_source::LightSource;
use crate::limits::{LARGEST_COORDINATE, Limits};
use crate::tracks::{self, ObjectTrack, RawTrack};
use glam::DVec3;
use serde::Deserialize;

/// The version of the format that this crate reads.
const VERSION: u64 = 1;

/// Frames per second of a scene that does not specify it.
pub(crate) const DEFAULT_FPS: f64 = 24.0;

/// Longest accepted name, in characters. Job names have the same limit.
const LONGEST_NAME: usize = 200;

/// A checked `scene.json`.
#[derive(Debug)]
pub(crate) struct Description {
    pub(crate) name: Option<String>,
    /// Paths of the geometry files in the bundle.
    pub(crate) geometry: Vec<String>,
    pub(crate) camera: Option<LookAt>,
    pub(crate) environment: EnvironmentSource,
    pub(crate) lights: Vec<LightSource>,
    pub(crate) fps: f64,
    pub(crate) frames: Option<Frames>,
    /// Tracks that move objects. Tracks of camera and lights are already applied.
    pub(crate) object_tracks: Vec<ObjectTrack>,
}

/// Number of frames of a shot.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Frames {
    /// Given in `scene.json`.
    Given(u32),
    /// Not specified: the shot ends at the last key of a track.
    Keyed(u32),
}

#[derive(Debug)]
pub(crate) enum EnvironmentSource {
    Black,
    Constant(DVec3),
    Image { path: String, scale: f64, rotation_deg: f64 },
}

#[derive(Deserialize)]
struct VersionOnly {
    version: Option<serde_json::Value>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawScene {
    #[serde(rename = "version")]
    _version: u64,
    name: Option<String>,
    geometry: Vec<String>,
    camera: Option<RawCamera>,
    environment: Option<RawEnvironment>,
    #[serde(default)]
    lights: Vec<RawLight>,
    animation: Option<RawAnimation>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawCamera {
    origin: [f64; 3],
    target: [f64; 3],
    #[serde(default = "up")]
    up: [f64; 3],
    fov_deg: f64,
    #[serde(default)]
    fov_axis: FovAxis,
    width: u32,
    height: u32,
    #[serde(default)]
    aperture_radius: f64,
    focus_distance: Option<f64>,
}

fn up() -> [f64; 3] {
    [0.0, 1.0, 0.0]
}

/// All keys of all kinds of environment. Which belong to `type` is checked later, because an internally
/// tagged enum would lose the JSON pointer of an error.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawEnvironment {
    r#type: String,
    radiance: Option<[f64; 3]>,
    path: Option<String>,
    scale: Option<f64>,
    rotation_deg: Option<f64>,
}

/// All keys of all kinds of light; see [`RawEnvironment`].
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawLight {
    r#type: String,
    corner: Option<[f64; 3]>,
    edge_u: Option<[f64; 3]>,
    edge_v: Option<[f64; 3]>,
    radiance: Option<[f64; 3]>,
    position: Option<[f64; 3]>,
    intensity: Option<[f64; 3]>,
    direction: Option<[f64; 3]>,
    irradiance: Option<[f64; 3]>,
    angle_deg: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawAnimation {
    fps: Option<f64>,
    frames: Option<u32>,
    #[serde(default)]
    tracks: Vec<RawTrack>,
}

impl Description {
    /// Parses the text of a `scene.json`. `file` is its path in error messages.
    pub(crate) fn parse(file: &str, text: &[u8], limits: &Limits) -> Result<Self, SceneError> {
        // Skip a byte order mark, which some editors write.
        let text = text.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(text);
        check_version(file, text)?;
        let mut deserializer = serde_json::Deserializer::from_slice(text);
        let raw: RawScene = serde_path_to_error::deserialize(&mut deserializer)
            .map_err(|e| SceneError::pointer(file, json_pointer(e.path()), e.inner().to_string()))?;
        deserializer.end().map_err(|e| SceneError::file(file, e.to_string()))?;
        Checker { file }.scene(raw, limits)
    }
}

/// Checks the version first. Another version may have other keys, and the error should say so.
fn check_version(file: &str, text: &[u8]) -> Result<(), SceneError> {
    let probe: VersionOnly =
        serde_json::from_slice(text).map_err(|e| SceneError::file(file, e.to_string()))?;
    match probe.version {
        Some(version) if version.as_u64() == Some(VERSION) => Ok(()),
        Some(version) => Err(SceneError::pointer(
            file,
            "/version",
            format!("version {version} is not supported; this program reads version {VERSION}"),
        )),
        None => Err(SceneError::pointer(
            file,
            "/version",
            format!("is missing; this program reads version {VERSION}"),
        )),
    }
}

/// The path of a deserialisation error as a JSON pointer (RFC 6901).
pub(crate) fn json_pointer(path: &serde_path_to_error::Path) -> String {
    use serde_path_to_error::Segment;
    let mut pointer = String::new();
    for segment in path.iter() {
        pointer.push('/');
        match segment {
            Segment::Seq { index } => pointer.push_str(&index.to_string()),
            Segment::Map { key } => pointer.push_str(&key.replace('~', "~0").replace('/', "~1")),
            Segment::Enum { variant } => pointer.push_str(variant),
            Segment::Unknown => pointer.push('?'),
        }
    }
    pointer
}

impl Checker<'_> {
    /// Checks the scene's name. It appears in tables, logs and the names of jobs.
    fn name(&self, name: String) -> Result<String, SceneError> {
        if !(1..=LONGEST_NAME).contains(&name.chars().count()) || name.contains(char::is_control) {
            let reason = format!("must have 1 to {LONGEST_NAME} characters, and no control characters");
            return self.fail("/name", reason);
        }
        Ok(name)
    }

    fn scene(&self, raw: RawScene, limits: &Limits) -> Result<Description, SceneError> {
        if raw.geometry.is_empty() {
            return self.fail("/geometry", "must name at least one file");
        }
        let mut geometry = Vec::new();
        for (i, reference) in raw.geometry.iter().enumerate() {
            geometry.push(self.path(&format!("/geometry/{i}"), reference)?);
        }
        let mut camera = raw.camera.map(|c| self.camera(c, limits)).transpose()?;
        let environment = raw.environment.map_or(Ok(EnvironmentSource::Black), |e| self.environment(e))?;
        let mut lights = Vec::new();
        for (i, light) in raw.lights.into_iter().enumerate() {
            lights.push(self.light_source(&format!("/lights/{i}"), light)?);
        }
        let animation = raw.animation.unwrap_or(RawAnimation { fps: None, frames: None, tracks: Vec::new() });
        let fps = animation.fps.unwrap_or(DEFAULT_FPS);
        if !(fps > 0.0 && fps <= 10_000.0) {
            return self.fail("/animation/fps", format!("{fps}: must be more than 0 and at most 10000"));
        }
        let (object_tracks, last_key) = tracks::apply(self, animation.tracks, camera.as_mut(), &mut lights)?;
        let frames = match animation.frames {
            Some(0) => return self.fail("/animation/frames", "a shot must have at least one frame"),
            Some(frames) if frames > limits.frames => {
                let (found, limit) = (u64::from(frames), u64::from(limits.frames));
                let file = format!("{}: /animation/frames", self.file);
                return Err(SceneError::Limit { file, what: "frames", found, limit });
            }
            Some(frames) => Some(Frames::Given(frames)),
            // The cast saturates. `Scene::load` checks the result against the limit.
            None => last_key.map(|frame| Frames::Keyed((frame.ceil().max(0.0) as u32).saturating_add(1))),
        };
        let name = raw.name.map(|name| self.name(name)).transpose()?;
        Ok(Description { name, geometry, camera, environment, lights, fps, frames, object_tracks })
    }

    fn path(&self, pointer: &str, reference: &str) -> Result<String, SceneError> {
        crate::bundle::resolve(self.file, reference).or_else(|reason| self.fail(pointer, reason))
    }

    fn camera(&self, raw: RawCamera, limits: &Limits) -> Result<LookAt, SceneError> {
        for (pointer, size) in [("/camera/width", raw.width), ("/camera/height", raw.height)] {
            if size == 0 {
                return self.fail(pointer, "an image must have at least one pixel");
            }
        }
        let pixels = u64::from(raw.width) * u64::from(raw.height);
        if pixels > limits.image_pixels {
            let (file, limit) = (format!("{}: /camera", self.file), limits.image_pixels);
            return Err(SceneError::Limit { file, what: "pixels of the image", found: pixels, limit });
        }
        if !(0.0..=LARGEST_COORDINATE).contains(&raw.aperture_radius) {
            return self.fail("/camera/aperture_radius", "must not be negative");
        }
        if let Some(distance) = raw.focus_distance
            && !(distance > 0.0 && distance <= LARGEST_COORDINATE)
        {
            return self.fail("/camera/focus_distance", "must be more than 0");
        }
        Ok(LookAt {
            origin: Animated::Constant(self.coordinates("/camera/origin", raw.origin)?),
            target: Animated::Constant(self.coordinates("/camera/target", raw.target)?),
            up: Animated::Constant(self.coordinates("/camera/up", raw.up)?),
            fov_deg: Animated::Constant(self.field_of_view("/camera/fov_deg", raw.fov_deg)?),
            fov_axis: raw.fov_axis,
            kept_axis: raw.fov_axis,
            width: raw.width,
            height: raw.height,
            aperture_radius: raw.aperture_radius,
            focus_distance: raw.focus_distance,
        })
    }

    fn environment(&self, raw: RawEnvironment) -> Result<EnvironmentSource, SceneError> {
        let keys = [
            ("radiance", raw.radiance.is_some()),
            ("path", raw.path.is_some()),
            ("scale", raw.scale.is_some()),
            ("rotation_deg", raw.rotation_deg.is_some()),
        ];
        match raw.r#type.as_str() {
            "constant" => {
                self.only("/environment", "a constant environment", &["radiance"], &keys)?;
                let radiance = self.required("/environment/radiance", raw.radiance)?;
                Ok(EnvironmentSource::Constant(self.light("/environment/radiance", radiance)?))
            }
            "image" => {
                self.only("/environment", "an image environment", &["path", "scale", "rotation_deg"], &keys)?;
                let reference = self.required("/environment/path", raw.path)?;
                let (scale, rotation_deg) = (raw.scale.unwrap_or(1.0), raw.rotation_deg.unwrap_or(0.0));
                if !(0.0..=BRIGHTEST).contains(&scale) {
                    return self
                        .fail("/environment/scale", format!("must be in the range 0 to {BRIGHTEST:e}"));
                }
                if rotation_deg.abs() > 1e6 {
                    return self.fail("/environment/rotation_deg", "must be in the range -1e6 to 1e6");
                }
                let path = self.path("/environment/path", &reference)?;
                Ok(EnvironmentSource::Image { path, scale, rotation_deg })
            }
            other => self.fail("/environment/type", format!("`{other}` is not one of `constant`, `image`")),
        }
    }

    fn light_source(&self, at: &str, raw: RawLight) -> Result<LightSource, SceneError> {
        let keys = [
            ("corner", raw.corner.is_some()),
            ("edge_u", raw.edge_u.is_some()),
            ("edge_v", raw.edge_v.is_some()),
            ("radiance", raw.radiance.is_some()),
            ("position", raw.position.is_some()),
            ("intensity", raw.intensity.is_some()),
            ("direction", raw.direction.is_some()),
            ("irradiance", raw.irradiance.is_some()),
            ("angle_deg", raw.angle_deg.is_some()),
        ];
        let pointer = |key: &str| format!("{at}/{key}");
        let point = |key, value| self.coordinates(&pointer(key), self.required(&pointer(key), value)?);
        let light = |key, value| {
            let value = self.light(&pointer(key), self.required(&pointer(key), value)?)?;
            Ok::<_, SceneError>(Animated::Constant(value))
        };
        match raw.r#type.as_str() {
            "quad" => {
                self.only(at, "a quad light", &["corner", "edge_u", "edge_v", "radiance"], &keys)?;
                let corner = point("corner", raw.corner)?;
                let (edge_u, edge_v) = (point("edge_u", raw.edge_u)?, point("edge_v", raw.edge_v)?);
                // The sine of the angle between the edges. It is NaN if an edge has zero length.
                let sine = edge_u.cross(edge_v).length() / (edge_u.length() * edge_v.length());
                if sine.is_nan() || sine < 1e-6 {
                    return self.fail(at, "`edge_u` and `edge_v` are parallel or have zero length");
                }
                Ok(LightSource::Quad { corner, edge_u, edge_v, radiance: light("radiance", raw.radiance)? })
            }
            "point" => {
                self.only(at, "a point light", &["position", "intensity"], &keys)?;
                let position = point("position", raw.position)?;
                Ok(LightSource::Point { position, intensity: light("intensity", raw.intensity)? })
            }
            "sun" => {
                self.only(at, "a sun", &["direction", "irradiance", "angle_deg"], &keys)?;
                let given = self.required(&pointer("direction"), raw.direction)?;
                let direction = self.direction(&pointer("direction"), given)?;
                let angle_deg = raw.angle_deg.unwrap_or(0.0);
                if !(0.0..180.0).contains(&angle_deg) {
                    return self.fail(&pointer("angle_deg"), "must be at least 0 and less than 180 degrees");
                }
                Ok(LightSource::Sun {
                    direction,
                    irradiance: light("irradiance", raw.irradiance)?,
                    angle_deg,
                })
            }
            other => self.fail(&pointer("type"), format!("`{other}` is not one of `quad`, `point`, `sun`")),
        }
    }
}

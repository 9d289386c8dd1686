//! The animation tracks of `scene.json`, and the properties that they animate.

use crate::animation::{Animated, Curve, Interpolation};
use crate::camera_source::LookAt;
use crate::checker::Checker;
use crate::error::SceneError;
use crate::light_source::LightSource;
use crate::limits::LARGEST_COORDINATE;
use glam::{DQuat, DVec3, DVec4};
use serde::Deserialize;
use std::collections::BTreeSet;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawTrack {
    target: String,
    property: String,
    interpolation: RawInterpolation,
    keys: Vec<RawKey>,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "snake_case")]
enum RawInterpolation {
    Step,
    Linear,
    CatmullRom,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawKey {
    frame: f64,
    #[serde(deserialize_with = "numbers")]
    value: Vec<f64>,
}

/// Deserialises a list of numbers, or a single number.
fn numbers<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<Vec<f64>, D::Error> {
    struct Numbers;
    impl<'de> serde::de::Visitor<'de> for Numbers {
        type Value = Vec<f64>;
        fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            f.write_str("a number or a list of numbers")
        }
        fn visit_f64<E>(self, value: f64) -> Result<Vec<f64>, E> {
            Ok(vec![value])
        }
        fn visit_i64<E>(self, value: i64) -> Result<Vec<f64>, E> {
            Ok(vec![value as f64])
        }
        fn visit_u64<E>(self, value: u64) -> Result<Vec<f64>, E> {
            Ok(vec![value as f64])
        }
        fn visit_seq<A: serde::de::SeqAccess<'de>>(self, mut seq: A) -> Result<Vec<f64>, A::Error> {
            let mut values = Vec::new();
            while let Some(value) = seq.next_element()? {
                values.push(value);
            }
            Ok(values)
        }
    }
    deserializer.deserialize_any(Numbers)
}

/// One animated local property of an object or node.
#[derive(Debug, Clone)]
pub(crate) enum Motion {
    Translation(Curve<DVec3>),
    Rotation(Curve<DQuat>),
    Scale(Curve<DVec3>),
}

/// A track for an object. The object is looked up once the geometry is loaded.
#[derive(Debug)]
pub(crate) struct ObjectTrack {
    /// JSON pointer of the track's target, for error messages.
    pub(crate) pointer: String,
    pub(crate) object: String,
    pub(crate) motion: Motion,
}

/// Applies the tracks of camera and lights. Returns the tracks of objects, and the frame of the last key.
pub(crate) fn apply(
    check: &Checker<'_>,
    tracks: Vec<RawTrack>,
    mut camera: Option<&mut LookAt>,
    lights: &mut [LightSource],
) -> Result<(Vec<ObjectTrack>, Option<f64>), SceneError> {
    let mut seen = BTreeSet::new();
    let (mut objects, mut last_key) = (Vec::new(), None::<f64>);
    for (i, track) in tracks.into_iter().enumerate() {
        let at = format!("/animation/tracks/{i}");
        if !seen.insert((track.target.clone(), track.property.clone())) {
            let reason = format!("`{}` of `{}` has two tracks", track.property, track.target);
            return check.fail(&at, reason);
        }
        let end = check_times(check, &at, &track.keys)?;
        last_key = Some(last_key.map_or(end, |l| l.max(end)));
        let target_pointer = format!("{at}/target");
        if track.target == "camera" {
            match camera.as_deref_mut() {
                Some(camera) => camera_track(check, &at, track, camera)?,
                None => return check.fail(&target_pointer, "the scene has no `camera` to animate"),
            }
        } else if let Some(index) = track.target.strip_prefix("light:") {
            let light = index.parse::<usize>().ok().and_then(|i| lights.get_mut(i));
            match light {
                Some(light) => light_track(check, &at, track, light)?,
                None => {
                    let reason =
                        format!("there is no light `{index}`; the scene has {} lights", lights.len());
                    return check.fail(&target_pointer, reason);
                }
            }
        } else if let Some(object) = track.target.strip_prefix("object:") {
            let object = object.to_owned();
            objects.push(ObjectTrack { pointer: target_pointer, object, motion: motion(check, &at, track)? });
        } else {
            let reason = format!("`{}` is not `camera`, `object:NAME` or `light:INDEX`", track.target);
            return check.fail(&target_pointer, reason);
        }
    }
    Ok((objects, last_key))
}

/// Checks that there are keys and that they ascend. Returns the frame of the last key.
fn check_times(check: &Checker<'_>, at: &str, keys: &[RawKey]) -> Result<f64, SceneError> {
    let Some(last) = keys.last() else {
        return check.fail(&format!("{at}/keys"), "a track must have at least one key");
    };
    for (k, pair) in keys.windows(2).enumerate() {
        if pair[1].frame <= pair[0].frame {
            let reason = format!("frame {} does not come after frame {}", pair[1].frame, pair[0].frame);
            return check.fail(&format!("{at}/keys/{}/frame", k + 1), reason);
        }
    }
    for (k, key) in keys.iter().enumerate() {
        if key.frame.abs() > 1e9 {
            return check
                .fail(&format!("{at}/keys/{k}/frame"), "a frame number must be in the range -1e9 to 1e9");
        }
    }
    Ok(last.frame)
}

fn camera_track(
    check: &Checker<'_>,
    at: &str,
    track: RawTrack,
    camera: &mut LookAt,
) -> Result<(), SceneError> {
    let positions =
        |track| curve::<3, _>(check, at, track, |p, v| check.coordinates(p, v)).map(Animated::Curve);
    match track.property.as_str() {
        "origin" => camera.origin = positions(track)?,
        "target" => camera.target = positions(track)?,
        "up" => camera.up = positions(track)?,
        "fov_deg" => {
            let angles = curve::<1, _>(check, at, track, |p, [v]| check.field_of_view(p, v))?;
            camera.fov_deg = Animated::Curve(angles);
        }
        other => return unknown_property(check, at, "a camera", other, "origin, target, up, fov_deg"),
    }
    Ok(())
}

fn light_track(
    check: &Checker<'_>,
    at: &str,
    track: RawTrack,
    light: &mut LightSource,
) -> Result<(), SceneError> {
    let (what, property, value) = match light {
        LightSource::Quad { radiance, .. } => ("a quad light", "radiance", radiance),
        LightSource::Point { intensity, .. } => ("a point light", "intensity", intensity),
        LightSource::Sun { irradiance, .. } => ("a sun", "irradiance", irradiance),
    };
    if track.property != property {
        return unknown_property(check, at, what, &track.property, property);
    }
    *value = Animated::Curve(curve::<3, _>(check, at, track, |p, v| check.light(p, v))?);
    Ok(())
}

fn motion(check: &Checker<'_>, at: &str, track: RawTrack) -> Result<Motion, SceneError> {
    let vectors = |track| curve::<3, _>(check, at, track, |p, v| check.coordinates(p, v));
    match track.property.as_str() {
        "translation" => Ok(Motion::Translation(vectors(track)?)),
        "scale" => Ok(Motion::Scale(vectors(track)?)),
        "rotation" => Ok(Motion::Rotation(curve::<4, _>(check, at, track, |p, v| rotation(check, p, v))?)),
        other => unknown_property(check, at, "an object", other, "translation, rotation, scale"),
    }
}

/// Checks a quaternion x y z w, and normalises it.
fn rotation(check: &Checker<'_>, pointer: &str, value: [f64; 4]) -> Result<DQuat, SceneError> {
    let v = DVec4::from_array(value);
    match v.try_normalize() {
        Some(unit) if v.abs().max_element() <= LARGEST_COORDINATE => Ok(DQuat::from_vec4(unit)),
        _ => check.fail(pointer, "a rotation must be a unit quaternion x y z w"),
    }
}

fn unknown_property<T>(
    check: &Checker<'_>,
    at: &str,
    what: &str,
    property: &str,
    known: &str,
) -> Result<T, SceneError> {
    check.fail(&format!("{at}/property"), format!("{what} has no property `{property}`; it has {known}"))
}

/// The curve through a track's keys, each of `N` numbers. `convert` checks and converts a key's value.
fn curve<const N: usize, T: crate::animation::Keyed>(
    check: &Checker<'_>,
    at: &str,
    track: RawTrack,
    convert: impl Fn(&str, [f64; N]) -> Result<T, SceneError>,
) -> Result<Curve<T>, SceneError> {
    let (mut times, mut values) = (Vec::new(), Vec::new());
    for (k, key) in track.keys.iter().enumerate() {
        let pointer = format!("{at}/keys/{k}/value");
        let Ok(numbers) = <[f64; N]>::try_from(key.value.as_slice()) else {
            let (property, found) = (&track.property, key.value.len());
            return check.fail(&pointer, format!("`{property}` takes {N} numbers, not {found}"));
        };
        times.push(key.frame);
        values.push(convert(&pointer, numbers)?);
    }
    let interpolation = match track.interpolation {
        RawInterpolation::Step => Interpolation::Step,
        RawInterpolation::Linear => Interpolation::Linear,
        RawInterpolation::CatmullRom => Interpolation::CatmullRom,
    };
    let curve = Curve::new(times, values, interpolation);
    curve.map_or_else(|| check.fail(&format!("{at}/keys"), "a track must have at least one key"), Ok)
}

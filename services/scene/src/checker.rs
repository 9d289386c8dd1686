//! Checks the values of `scene.json`. Every error names the JSON pointer of the value.

use crate::error::SceneError;
use crate::limits::LARGEST_COORDINATE;
use glam::DVec3;

/// Largest accepted radiance, intensity or irradiance, in its own unit.
pub(crate) const BRIGHTEST: f64 = 1e12;

/// Checks values. `file` is the file's path in error messages.
pub(crate) struct Checker<'a> {
    pub(crate) file: &'a str,
}

impl Checker<'_> {
    /// An error at a JSON pointer.
    pub(crate) fn fail<T>(&self, pointer: &str, reason: impl Into<String>) -> Result<T, SceneError> {
        Err(SceneError::pointer(self.file, pointer, reason))
    }

    /// Checks a position or an edge, in metres.
    pub(crate) fn coordinates(&self, pointer: &str, value: [f64; 3]) -> Result<DVec3, SceneError> {
        if value.iter().any(|c| c.abs() > LARGEST_COORDINATE) {
            return self.fail(pointer, format!("a coordinate is larger than {LARGEST_COORDINATE:e} m"));
        }
        Ok(DVec3::from_array(value))
    }

    /// Checks a direction, and returns it as a unit vector.
    pub(crate) fn direction(&self, pointer: &str, value: [f64; 3]) -> Result<DVec3, SceneError> {
        let direction = self.coordinates(pointer, value)?.try_normalize();
        direction.map_or_else(|| self.fail(pointer, "the vector has zero length"), Ok)
    }

    /// Checks a radiance, intensity or irradiance.
    pub(crate) fn light(&self, pointer: &str, value: [f64; 3]) -> Result<DVec3, SceneError> {
        if value.iter().any(|c| !(0.0..=BRIGHTEST).contains(c)) {
            return self.fail(pointer, format!("every channel must be in the range 0 to {BRIGHTEST:e}"));
        }
        Ok(DVec3::from_array(value))
    }

    /// Checks an angle of view, in degrees.
    pub(crate) fn field_of_view(&self, pointer: &str, value: f64) -> Result<f64, SceneError> {
        if !(value > 0.0 && value < 180.0) {
            return self
                .fail(pointer, format!("{value}: the field of view must be between 0 and 180 degrees"));
        }
        Ok(value)
    }

    /// Returns a value that must be present.
    pub(crate) fn required<T>(&self, pointer: &str, value: Option<T>) -> Result<T, SceneError> {
        value.map_or_else(|| self.fail(pointer, "is missing"), Ok)
    }

    /// Rejects keys that belong to another kind of light or environment.
    pub(crate) fn only(
        &self,
        at: &str,
        what: &str,
        allowed: &[&str],
        keys: &[(&str, bool)],
    ) -> Result<(), SceneError> {
        match keys.iter().find(|(key, given)| *given && !allowed.contains(key)) {
            Some((key, _)) => self.fail(&format!("{at}/{key}"), format!("{what} has no key `{key}`")),
            None => Ok(()),
        }
    }
}

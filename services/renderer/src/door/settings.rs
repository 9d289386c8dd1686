//! Settings in two parts: what all renderers have, and what is the renderer's own.

use forelight_protocol::ShotSettings;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

/// Settings that all renderers have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Common {
    /// Width of the image, pixels.
    pub width: u32,
    /// Height of the image, pixels.
    pub height: u32,
    /// Samples per pixel; with adaptive sampling, the most of them.
    pub samples: u32,
    /// Seed of random numbers.
    pub seed: u32,
}

impl Common {
    /// Number of pixels.
    pub fn pixels(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }

    /// The same image with at most about this number of pixels, and at most `scale` times as wide and high.
    #[must_use]
    pub fn smaller(mut self, pixels: u64, scale: f64) -> Self {
        let scale = (pixels as f64 / self.pixels() as f64).sqrt().min(scale);
        for side in [&mut self.width, &mut self.height] {
            *side = ((f64::from(*side) * scale).round() as u32).max(1);
        }
        self
    }
}

/// How a frame is rendered.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Settings {
    /// What all renderers have.
    #[serde(flatten)]
    pub common: Common,
    /// The renderer's own settings, as its schema says.
    #[serde(default)]
    pub own: Map<String, Value>,
}

/// A setting is out of its range, or unknown.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("setting {path}: {reason}")]
pub struct SettingsError {
    /// JSON pointer of the setting.
    pub path: String,
    /// What is wrong with it.
    pub reason: String,
}

impl SettingsError {
    fn new(path: impl Into<String>, reason: impl Into<String>) -> Self {
        Self { path: path.into(), reason: reason.into() }
    }
}

impl Settings {
    /// Checks the sizes and, by the renderer's schema, its own settings.
    ///
    /// # Errors
    /// The first setting that is wrong, or a schema that is none.
    pub fn check(&self, schema: &Value) -> Result<(), SettingsError> {
        let Common { width, height, samples, .. } = self.common;
        for (name, value) in [("width", width), ("height", height), ("samples", samples)] {
            if value == 0 {
                return Err(SettingsError::new(format!("/{name}"), "must be at least 1"));
            }
        }
        // The name is only that of a place: nothing is fetched.
        const NAME: &str = "https://forelight.invalid/settings.json";
        let unusable = |error: boon::CompileError| SettingsError::new("/own", error.to_string());
        let (mut schemas, mut compiler) = (boon::Schemas::new(), boon::Compiler::new());
        compiler.add_resource(NAME, schema.clone()).map_err(unusable)?;
        let compiled = compiler.compile(NAME, &mut schemas).map_err(unusable)?;
        schemas.validate(&Value::Object(self.own.clone()), compiled).map_err(|error| first_wrong(&error))
    }

    /// The same settings, with the renderer's own ones replaced where `by` has them.
    #[must_use]
    pub fn with_own(mut self, by: &Map<String, Value>) -> Self {
        self.own.extend(by.iter().map(|(name, value)| (name.clone(), value.clone())));
        self
    }

    /// These settings of a scene, with what a job changes. A width or height alone keeps the shape of the
    /// image.
    #[must_use]
    pub fn changed_by(&self, job: &ShotSettings) -> Self {
        let Common { width, height, samples, seed } = self.common;
        let size = |asked: Option<u32>, other: Option<u32>, own: u32, others: u32| match (asked, other) {
            (Some(asked), _) => asked,
            (None, Some(other)) => {
                (f64::from(own) * f64::from(other) / f64::from(others.max(1))).round().max(1.0) as u32
            }
            (None, None) => own,
        };
        let common = Common {
            width: size(job.width, job.height, width, height),
            height: size(job.height, job.width, height, width),
            samples: job.samples.unwrap_or(samples),
            seed: job.seed.unwrap_or(seed),
        };
        Self { common, own: self.own.clone() }.with_own(&job.own)
    }

    /// The settings as a job has them, complete.
    pub fn complete(&self) -> ShotSettings {
        let Common { width, height, samples, seed } = self.common;
        ShotSettings {
            width: Some(width),
            height: Some(height),
            samples: Some(samples),
            seed: Some(seed),
            own: self.own.clone(),
        }
    }

    /// Number of pixels.
    pub fn pixels(&self) -> u64 {
        self.common.pixels()
    }
}

/// The first setting that is wrong, of a tree of errors.
fn first_wrong(error: &boon::ValidationError<'_, '_>) -> SettingsError {
    match error.causes.first() {
        Some(cause) => first_wrong(cause),
        None => SettingsError::new(format!("/own{}", error.instance_location), error.kind.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn settings(own: Value) -> Settings {
        let common = Common { width: 4, height: 2, samples: 1, seed: 0 };
        Settings { common, own: own.as_object().unwrap().clone() }
    }

    #[test]
    fn a_wrong_setting_is_named_with_its_reason() {
        let schema = json!({"type": "object", "additionalProperties": false,
            "properties": {"bounces": {"type": "integer", "minimum": 0, "default": 3}}});
        assert_eq!(settings(json!({"bounces": 2})).check(&schema), Ok(()));
        let error = settings(json!({"bounces": -1})).check(&schema).unwrap_err();
        assert_eq!(error.path, "/own/bounces");
        assert!(error.reason.contains("-1"), "{error}");
        let unknown = settings(json!({"depth": 2})).check(&schema).unwrap_err();
        assert!(unknown.reason.contains("depth"), "{unknown}");
        let mut empty = settings(json!({}));
        empty.common.samples = 0;
        assert_eq!(empty.check(&schema).unwrap_err().path, "/samples");
    }

    #[test]
    fn a_job_overrides_single_settings_of_the_scene() {
        let scene = settings(json!({"denoise": true, "threshold": 0.1}));
        let job = json!({"denoise": false});
        assert_eq!(
            scene.with_own(job.as_object().unwrap()),
            settings(json!({"denoise": false, "threshold": 0.1}))
        );
    }
}

//! Renderers: names, versions, and settings of renderers other than our own.

use std::fmt;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use utoipa::ToSchema;

use crate::RenderSettings;

/// Name and version of a renderer. Costs and forecasts hold for one of these.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RendererId {
    /// Name, such as `cycles`: 1 to 50 lower-case letters, digits, `-` and `_`.
    #[schema(min_length = 1, max_length = 50, pattern = "^[a-z0-9_-]+$")]
    pub name: String,
    /// Version as the program states it, such as `5.0.1`: 1 to 50 letters, digits, `.`, `-`, `+` and `_`.
    #[schema(min_length = 1, max_length = 50, pattern = "^[A-Za-z0-9._+-]+$")]
    pub version: String,
}

/// Name of forelight's own renderer among a node's renderers. Jobs leave `renderer` out for it.
pub const OWN_RENDERER: &str = "forelight";

/// The version of forelight's own renderer that renders a job. Images and costs of other versions may differ.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
pub struct RenderedBy {
    /// The version, such as `tracer-13`. Only nodes with it get tasks of the job.
    pub version: String,
    /// Why frames of the job come from more than one version. Absent if they do not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mixed: Option<String>,
}

impl fmt::Display for RendererId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.name, self.version)
    }
}

impl RendererId {
    /// Our own renderer with this version of its tracer.
    pub fn own(tracer: u32) -> Self {
        Self { name: OWN_RENDERER.to_owned(), version: format!("tracer-{tracer}") }
    }

    /// Checks name and version. The error names the field.
    pub fn check(&self) -> Result<(), (&'static str, String)> {
        check_name(&self.name)?;
        check_version(&self.version)
    }

    /// All ways in which a job can ask for this renderer: `cycles`, `cycles 5`, `cycles 5.0`, `cycles 5.0.1`.
    pub fn answers_to(&self) -> Vec<String> {
        let ends = self.version.match_indices('.').map(|(at, _)| at).chain([self.version.len()]);
        let with_version = ends.map(|end| format!("{} {}", self.name, &self.version[..end]));
        std::iter::once(self.name.clone()).chain(with_version).collect()
    }
}

/// The renderer of a job, and which versions of it may render the job.
#[derive(Clone, PartialEq, Eq, Hash, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RendererRequest {
    /// Name, such as `cycles`: 1 to 50 lower-case letters, digits, `-` and `_`.
    #[schema(min_length = 1, max_length = 50, pattern = "^[a-z0-9_-]+$")]
    pub name: String,
    /// Version, or how it begins: `5` and `5.0` include 5.0.1. If absent, any version. The version that
    /// previews the job also renders it, so a previewed job has a complete version.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 50, pattern = "^[A-Za-z0-9._+-]+$")]
    pub version: Option<String>,
}

impl fmt::Display for RendererRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.version {
            Some(version) => write!(f, "{} {version}", self.name),
            None => f.write_str(&self.name),
        }
    }
}

impl From<&RendererId> for RendererRequest {
    fn from(id: &RendererId) -> Self {
        Self { name: id.name.clone(), version: Some(id.version.clone()) }
    }
}

impl RendererRequest {
    /// Exactly this version of our own renderer.
    pub fn own(version: &str) -> Self {
        Self { name: OWN_RENDERER.to_owned(), version: Some(version.to_owned()) }
    }

    /// Whether this renderer is one of those asked for.
    pub fn allows(&self, id: &RendererId) -> bool {
        id.answers_to().contains(&self.to_string())
    }

    /// Checks name and version. The error names the field.
    pub fn check(&self) -> Result<(), (&'static str, String)> {
        check_name(&self.name)?;
        self.version.as_deref().map_or(Ok(()), check_version)
    }
}

fn check_name(name: &str) -> Result<(), (&'static str, String)> {
    let fits = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || "-_".contains(c);
    if (1..=50).contains(&name.len()) && name.chars().all(fits) {
        return Ok(());
    }
    Err(("name", "the name of a renderer is 1 to 50 lower-case letters, digits, `-` and `_`".to_owned()))
}

fn check_version(version: &str) -> Result<(), (&'static str, String)> {
    let fits = |c: char| c.is_ascii_alphanumeric() || "._+-".contains(c);
    if (1..=50).contains(&version.len()) && version.chars().all(fits) {
        return Ok(());
    }
    Err(("version", "a version is 1 to 50 letters, digits, `.`, `-`, `+` and `_`".to_owned()))
}

/// Settings of a job of a renderer other than our own. What is absent has the scene's value; once a job is
/// previewed, nothing is absent.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ShotSettings {
    /// Image width in pixels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub width: Option<u32>,
    /// Image height in pixels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub height: Option<u32>,
    /// Samples per pixel; with adaptive sampling, the most of them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub samples: Option<u32>,
    /// Seed of all random numbers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<u32>,
    /// The renderer's own settings, by its schema.
    #[schema(value_type = Object)]
    pub own: Map<String, Value>,
}

impl ShotSettings {
    /// Number of pixels of the image; `None` while the scene's size is unknown.
    pub fn pixels(&self) -> Option<u64> {
        Some(u64::from(self.width?) * u64::from(self.height?))
    }
}

/// Complete settings of a job: those of our own renderer, or of another one.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(untagged)]
pub enum JobSettings {
    /// Of our own renderer.
    Own(RenderSettings),
    /// Of another renderer.
    Shot(ShotSettings),
}

impl JobSettings {
    /// The settings of our own renderer; `None` for another one.
    pub const fn own(&self) -> Option<&RenderSettings> {
        match self {
            JobSettings::Own(settings) => Some(settings),
            JobSettings::Shot(_) => None,
        }
    }

    /// The settings of another renderer; `None` for our own.
    pub const fn shot(&self) -> Option<&ShotSettings> {
        match self {
            JobSettings::Own(_) => None,
            JobSettings::Shot(settings) => Some(settings),
        }
    }

    /// Image size in pixels (width, height); `None` while it is the scene's and unknown.
    pub fn size(&self) -> Option<(u32, u32)> {
        match self {
            JobSettings::Own(settings) => Some((settings.width, settings.height)),
            JobSettings::Shot(settings) => settings.width.zip(settings.height),
        }
    }

    /// Samples per pixel; `None` while they are the scene's and unknown.
    pub const fn samples(&self) -> Option<u32> {
        match self {
            JobSettings::Own(settings) => Some(settings.spp),
            JobSettings::Shot(settings) => settings.samples,
        }
    }
}

impl From<RenderSettings> for JobSettings {
    fn from(settings: RenderSettings) -> Self {
        JobSettings::Own(settings)
    }
}

impl From<ShotSettings> for JobSettings {
    fn from(settings: ShotSettings) -> Self {
        JobSettings::Shot(settings)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::RenderSettingsRequest;

    #[test]
    fn a_request_allows_the_versions_that_begin_like_it() {
        let id = RendererId { name: "cycles".to_owned(), version: "5.0.1".to_owned() };
        let asks = |version: Option<&str>| {
            RendererRequest { name: "cycles".to_owned(), version: version.map(str::to_owned) }.allows(&id)
        };
        assert!(asks(None) && asks(Some("5")) && asks(Some("5.0")) && asks(Some("5.0.1")));
        assert!(!asks(Some("5.0.10")) && !asks(Some("5.")) && !asks(Some("4")));
        assert!(!RendererRequest { name: "cycle".to_owned(), version: None }.allows(&id));
    }

    #[test]
    fn settings_say_by_their_fields_whose_they_are() {
        let own = JobSettings::Own(RenderSettingsRequest::default().complete((8, 6)));
        let shot = JobSettings::Shot(ShotSettings { samples: Some(4), ..ShotSettings::default() });
        for settings in [own, shot] {
            let json = serde_json::to_string(&settings).unwrap();
            assert_eq!(serde_json::from_str::<JobSettings>(&json).unwrap(), settings);
        }
    }
}

//! What is in a scene.

use super::answers::Cost;
use super::asset::{Asset, AssetState};
use super::error::RendererError;
use super::settings::Settings;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Frames of a shot by the scene's own numbers: `first`, `first + step`, …, at most `last`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Frames {
    /// Number of the first frame.
    pub first: i32,
    /// No frame has a greater number.
    pub last: i32,
    /// Difference between two frames, at least 1.
    pub step: u32,
}

impl Frames {
    /// All numbers, ascending.
    pub fn numbers(&self) -> impl Iterator<Item = i32> + use<> {
        (self.first..=self.last).step_by(self.step.max(1) as usize)
    }

    /// Whether the shot has this frame.
    pub fn contains(&self, frame: i32) -> bool {
        (self.first..=self.last).contains(&frame)
            && frame.abs_diff(self.first).is_multiple_of(self.step.max(1))
    }
}

/// Such as `2 to 10 in steps of 4`.
impl fmt::Display for Frames {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { first, last, step } = self;
        write!(f, "{first} to {last}")?;
        if *step > 1 { write!(f, " in steps of {step}") } else { Ok(()) }
    }
}

/// A camera.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Camera {
    /// Its name.
    pub name: String,
    /// Whether frames are rendered with it.
    pub active: bool,
}

/// An object.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Object {
    /// Its name.
    pub name: String,
    /// Its kind in the renderer's words, such as `MESH`.
    pub kind: String,
    /// Number of its triangles. `None` if it is made of something else.
    pub triangles: Option<u64>,
}

/// What is in a scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Description {
    /// Frames of the shot.
    pub frames: Frames,
    /// Frames per second of time.
    pub frames_per_second: f64,
    /// All cameras. Empty if the renderer does not know any.
    pub cameras: Vec<Camera>,
    /// Layers that are rendered.
    pub layers: Vec<String>,
    /// Objects that are rendered. `None` if the renderer does not know them.
    pub objects: Option<Vec<Object>>,
    /// Materials. `None` if the renderer does not know them.
    pub materials: Option<Vec<String>>,
    /// Settings of the scene, and defaults where it says nothing.
    pub settings: Settings,
    /// Files that it refers to.
    pub assets: Vec<Asset>,
    /// What a user should know, such as scripts that are not run.
    pub notes: Vec<String>,
    /// Cost of starting the renderer and of loading the scene, once per process.
    pub opening: Cost,
}

impl Description {
    /// Assets that do not exist.
    pub fn missing(&self) -> impl Iterator<Item = &Asset> {
        self.assets.iter().filter(|asset| asset.state == AssetState::Missing)
    }

    /// Assets that exist outside of the scene.
    pub fn outside(&self) -> impl Iterator<Item = &Asset> {
        self.assets.iter().filter(|asset| asset.state == AssetState::Present)
    }

    /// Fails if assets are missing.
    ///
    /// # Errors
    /// Names every missing asset.
    pub fn require_assets(&self) -> Result<(), RendererError> {
        let missing: Vec<Asset> = self.missing().cloned().collect();
        if missing.is_empty() { Ok(()) } else { Err(RendererError::MissingAssets(missing)) }
    }
}

#[cfg(test)]
mod tests {
    use super::Frames;

    #[test]
    fn frames_have_the_scenes_own_numbers() {
        let numbers = |first, last, step| Frames { first, last, step }.numbers().collect::<Vec<_>>();
        assert_eq!(numbers(-1, 4, 2), [-1, 1, 3]);
        assert_eq!(numbers(7, 7, 0), [7]);
        assert!(numbers(2, 1, 1).is_empty());
    }
}

//! The four questions that any renderer is asked, in neutral words.
//!
//! | question | answer |
//! | --- | --- |
//! | describe | [`Renderer::open`] and [`Shot::description`]: frames, size, objects, settings, assets |
//! | preview | [`Shot::preview`]: pixels per (object, material) of each frame |
//! | measure | [`Shot::measure`]: the cost of a part of a frame, and what a render may take over of it |
//! | render | [`Shot::render`]: the files of a frame, and their cost |
//!
//! A renderer that measures single pixels is asked for them in several steps: [`Shot::profile_pixels`].
//!
//! A [`Capability`] is what not every renderer can do. A renderer with none of them can still be asked for
//! whole frames, and be forecast from these. Any renderer measures a whole frame: all of its samples.

mod answers;
mod artefact;
mod asset;
mod description;
mod error;
mod part;
mod pixels;
mod run;
mod settings;

pub use answers::{
    BlockCosts, Cost, FixedCosts, FrameCounts, Measured, PieceCost, PixelCount, Rendered, Stopping,
    StratumCost, TakenOver,
};
pub use artefact::Artefact;
pub use asset::{Asset, AssetState};
pub use description::{Camera, Description, Frames, Object};
pub use error::{Ending, RendererError};
pub use forelight_protocol::{PreviewBackend, RendererId};
pub use part::{Part, Region};
pub use pixels::{PixelCost, PixelProfiler, ProfiledPixels, Shown};
pub use run::{Limits, Pause, Run};
pub use settings::{Common, Settings, SettingsError};

use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::path::Path;

/// What a renderer may be able to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Capability {
    /// Measures a share of the samples of a frame.
    MeasureSamples,
    /// Measures regions of a frame.
    MeasureRegions,
    /// Measures many regions at once: each costs little beyond its pixels.
    MeasureManyRegions,
    /// Measures single pixels of a frame.
    MeasurePixels,
    /// Renders frames at other sizes. What a smaller frame costs tells what a larger one will cost.
    Resize,
    /// A render takes over measured samples.
    TakeOverSamples,
    /// A render takes over measured pixels.
    TakeOverPixels,
    /// Frames can share an irradiance cache.
    ShareCache,
    /// A render can stop at a budget of time.
    StopAtBudget,
    /// Costs have a deterministic count of work.
    CountWork,
    /// Measured parts say where in the image time goes.
    LocateCosts,
    /// Several processes can render parts of one frame.
    SplitFrame,
    /// The error of the image is known from its samples.
    ErrorFromSamples,
}

/// All that a renderer can do.
pub type Capabilities = BTreeSet<Capability>;

/// A renderer on this machine.
pub trait Renderer: Send + Sync {
    /// Its name and version.
    fn id(&self) -> &RendererId;

    /// JSON schema of its own settings. `default` of a property is what it takes where neither the scene nor
    /// the job says anything.
    fn settings_schema(&self) -> serde_json::Value;

    /// All that it can do, at the best of settings.
    fn capabilities(&self) -> Capabilities;

    /// Opens a scene and describes it. A missing asset is no error here: see [`Description::require_assets`].
    ///
    /// # Errors
    /// If the scene cannot be read.
    fn open(&self, scene: &Path, run: &Run<'_>) -> Result<Box<dyn Shot>, RendererError>;
}

/// An open scene. Every question checks its settings.
pub trait Shot: Send + Sync {
    /// What is in it.
    fn description(&self) -> &Description;

    /// What the renderer can do with this scene at these settings.
    fn capabilities(&self, settings: &Settings) -> Capabilities;

    /// How names of its images end, without the dot: of the files that it writes, and `png` if it has a
    /// picture.
    fn image_extensions(&self, _settings: &Settings) -> Vec<String> {
        ["exr", "png"].map(str::to_owned).to_vec()
    }

    /// Names of an object and a material that a preview counted. `None` where there is no such name.
    fn names(&self, shown: Shown) -> (Option<String>, Option<String>) {
        let found = self.description();
        let object = shown.object.and_then(|o| Some(found.objects.as_ref()?.get(o as usize)?.name.clone()));
        let material = shown.material.and_then(|m| found.materials.as_ref()?.get(m as usize).cloned());
        (object, material)
    }

    /// Writes a copy of the scene that holds all files that it refers to. `false`: it holds them already, and
    /// nothing is written.
    ///
    /// # Errors
    /// If files are missing or cannot be inside a scene, or the renderer has no such scenes.
    fn pack(&self, settings: &Settings, out: &Path, run: &Run<'_>) -> Result<bool, RendererError> {
        let _ = (settings, out, run);
        Err(RendererError::Unsupported("the renderer has no scenes that hold all of their files".to_owned()))
    }

    /// What every pixel of these frames shows, as counts, in the order of `frames`.
    ///
    /// # Errors
    /// If a frame cannot be previewed, or the run is stopped.
    fn preview(
        &self,
        frames: &[i32],
        settings: &Settings,
        run: &Run<'_>,
    ) -> Result<Vec<FrameCounts>, RendererError>;

    /// Renders a part of a frame and says what it cost.
    ///
    /// # Errors
    /// If the renderer cannot do such a part, the render fails, or the run is stopped.
    fn measure(
        &self,
        frame: i32,
        settings: &Settings,
        part: &Part,
        run: &Run<'_>,
    ) -> Result<Measured, RendererError>;

    /// Begins to measure single pixels of a frame: [`Capability::MeasurePixels`].
    ///
    /// # Errors
    /// If the renderer cannot measure single pixels, cannot begin, or the run is stopped.
    fn profile_pixels<'a>(
        &'a self,
        frame: i32,
        settings: &'a Settings,
        run: &'a Run<'a>,
    ) -> Result<Box<dyn PixelProfiler + 'a>, RendererError> {
        let _ = (frame, settings, run);
        Err(RendererError::Unsupported("the renderer cannot measure single pixels".to_owned()))
    }

    /// Renders a frame, less what it takes over. The files are in the run's scratch folder.
    ///
    /// # Errors
    /// If an artefact does not fit the frame and its settings, the render fails, or the run is stopped.
    fn render(
        &self,
        frame: i32,
        settings: &Settings,
        taken_over: &[Artefact],
        run: &Run<'_>,
    ) -> Result<Rendered, RendererError>;
}

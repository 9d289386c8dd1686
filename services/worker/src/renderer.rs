//! The small door behind which the renderer stands.
//!
//! A [`Renderer`] is a bundle, opened; a [`FrameRenderer`] one frame of it at one quality, ready to be previewed, profiled and
//! rendered, with what each took. Nothing else of the farm knows how light is traced: another renderer can be put behind this
//! door. Ours, over `scene`, `preview` and `tracer`, is in [`crate::ambient`].

use forelight_preview::{Counts, Preview, PreviewError};
use forelight_protocol::{FixedCosts, PreviewBackend, RenderSettings, SceneSummary, Spent, StratumName};
use forelight_scene::{Frame, MaterialClass, SceneError};
use forelight_tracer::{Image, Pixel, Profile, ProfileError, SettingsError};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Why a bundle cannot be rendered as asked.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// The bundle, or a frame of it, cannot be had.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The frame cannot be previewed.
    #[error(transparent)]
    Preview(#[from] PreviewError),
    /// A setting is out of its range.
    #[error("settings: {0}")]
    Settings(#[from] SettingsError),
    /// The bytes are not a profile.
    #[error("profile: {0}")]
    Profile(#[from] ProfileError),
    /// The profile was made from another scene, another frame, at another quality, or by another version.
    #[error(
        "profile: it belongs to another image (of frame {frame}); make it again with the same bundle and settings"
    )]
    ForeignProfile {
        /// The frame that the profile says it is of.
        frame: u32,
    },
}

impl RenderError {
    /// Whether trying again with the same input would give the same error.
    pub fn is_permanent(&self) -> bool {
        match self {
            // Storage may be away for a moment.
            Self::Scene(SceneError::Io { .. }) => false,
            Self::Preview(PreviewError::EmptyImage { .. } | PreviewError::ImageTooLarge { .. }) => true,
            Self::Preview(error) => matches!(error, PreviewError::Camera(_)),
            Self::Scene(_) | Self::Settings(_) | Self::Profile(_) | Self::ForeignProfile { .. } => true,
        }
    }
}

/// An (object, material) pair of the scene.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StratumInfo {
    /// Names of object and material.
    pub name: StratumName,
    /// Object id.
    pub object: u32,
    /// Material index.
    pub material: u32,
    /// Class of the material, by which the first samples are spread.
    pub class: MaterialClass,
}

/// What a bundle holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ShotInfo {
    /// What there is.
    pub summary: SceneSummary,
    /// All (object, material) pairs; the same for every frame of the shot.
    pub strata: Vec<StratumInfo>,
    /// What loading the bundle took. Paid once per process, not per frame.
    pub load: Spent,
}

/// What a frame shows, in numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Counted {
    /// Pixels per stratum, and of the background.
    pub counts: Counts,
    /// Who counted.
    pub backend: PreviewBackend,
    /// What it took.
    pub spent: Spent,
}

/// What a frame shows, pixel by pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct Previewed {
    /// Stratum, position and normal per pixel.
    pub preview: Preview,
    /// Who made it.
    pub backend: PreviewBackend,
    /// What it took.
    pub spent: Spent,
}

/// Opens bundles.
pub trait OpenRenderer: Send + Sync {
    /// Opens the bundle at `path`, a folder or a zip file.
    fn open(&self, path: &Path) -> Result<Arc<dyn Renderer>, RenderError>;
}

/// A bundle, opened.
pub trait Renderer: Send + Sync {
    /// What it holds.
    fn info(&self) -> &ShotInfo;

    /// How many pixels of a frame show each stratum.
    fn count(&self, frame: u32, settings: &RenderSettings) -> Result<Counted, RenderError>;

    /// One frame, ready for everything else.
    fn frame(
        &self,
        frame: u32,
        settings: &RenderSettings,
    ) -> Result<Box<dyn FrameRenderer + '_>, RenderError>;
}

/// One frame at one quality.
pub trait FrameRenderer: Send + Sync {
    /// The frame as it is traced.
    fn frame(&self) -> &Frame;

    /// What each pixel shows.
    fn preview(&self) -> Result<Previewed, RenderError>;

    /// What every render of this frame costs whatever its pixels show: setting it up (`load`), and building its acceleration
    /// structure (`build`), if something moves in the shot so that its frames cannot share one. Whether a structure was kept from
    /// before makes no difference: a frame's cost does not depend on what was done before it.
    fn fixed(&self) -> FixedCosts;

    /// What setting the frame up took this time, with any acceleration structure that had to be built for it: also that of the
    /// shot, which is in no frame's cost, for it is built once per process.
    fn spent_on_setup(&self) -> Spent;

    /// The effects that the frame calls for, by name, sorted.
    fn effects(&self) -> Vec<String>;

    /// Finished pixels by index, in the order given, on the current thread pool.
    fn trace(&self, pixels: &[u32]) -> Vec<Pixel>;

    /// The same for runs of pixels: those of a run are traced one after the other by one thread, as a tile's are in a render.
    fn trace_runs(&self, runs: &[Vec<u32>]) -> Vec<Vec<Pixel>>;

    /// Finished pixels as something that [`FrameRenderer::render`] can take over.
    fn profile(&self, pixels: Vec<(u32, Pixel)>) -> Profile;

    /// The image, on the current thread pool; pixels of `reuse` are taken over. `progress` is told the number of pixels done.
    /// `None` if `cancel` was set.
    fn render(
        &self,
        reuse: Option<&Profile>,
        progress: &(dyn Fn(u64) + Sync),
        cancel: &AtomicBool,
    ) -> Result<Option<Image>, RenderError>;
}

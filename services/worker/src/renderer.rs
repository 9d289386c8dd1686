//! The interface of a renderer. Other renderers can implement it; ours is [`crate::own`].
//!
//! A [`Renderer`] is an opened bundle. A [`FrameRenderer`] is one frame of it at one quality, ready to be
//! previewed, profiled and rendered, each with its cost.

use forelight_forecast::accuracy::PixelNoise;
use forelight_preview::{Counts, Preview, PreviewError};
use forelight_protocol::{
    BadSetting, ByClass, FixedCosts, LeftOut, PlanCount, PreviewBackend, ProcessCosts, RenderSettings,
    SceneSummary, Spent, StratumName,
};
use forelight_scene::{Frame, MaterialClass, SceneError};
use forelight_tracer::{
    Cache, CacheError, CacheTotals, Image, Passes, Pixel, PixelsFinished, Profile, ProfileError, RecordCost,
    SampleCounts, SampleCountsError, Shared, Totals,
};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Why a bundle cannot be rendered as asked.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// The bundle, or a frame of it, cannot be loaded.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The frame cannot be previewed.
    #[error(transparent)]
    Preview(#[from] PreviewError),
    /// A setting is out of its range.
    #[error("settings: {0}")]
    Settings(#[from] BadSetting),
    /// The bytes are not a profile.
    #[error("profile: {0}")]
    Profile(#[from] ProfileError),
    /// An irradiance cache cannot be used.
    #[error("{0}")]
    Cache(#[from] CacheError),
    /// The numbers of camera samples do not fit the image.
    #[error("camera samples: {0}")]
    Samples(#[from] SampleCountsError),
    /// The profile belongs to another scene, frame, quality or version.
    #[error(
        "profile: made for another image ({differs}); make it again with this bundle, frame and settings"
    )]
    ForeignProfile {
        /// What differs.
        differs: String,
    },
}

impl RenderError {
    /// Whether the same input would always give this error.
    pub fn is_permanent(&self) -> bool {
        match self {
            // Storage may be temporarily unavailable.
            Self::Scene(SceneError::Io { .. }) => false,
            Self::Preview(PreviewError::EmptyImage { .. } | PreviewError::ImageTooLarge { .. }) => true,
            Self::Preview(error) => matches!(error, PreviewError::Camera(_)),
            Self::Scene(_)
            | Self::Settings(_)
            | Self::Profile(_)
            | Self::Cache(_)
            | Self::Samples(_)
            | Self::ForeignProfile { .. } => true,
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

/// Contents of a bundle.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ShotInfo {
    /// Its summary.
    pub summary: SceneSummary,
    /// The renderer, with all versions that costs or forecasts may depend on.
    pub renderer: String,
    /// All (object, material) pairs; the same for every frame of the shot.
    pub strata: Vec<StratumInfo>,
}

/// Counts of a frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Counted {
    /// Pixels per stratum, and of the background.
    pub counts: Counts,
    /// Planned records of the frame's irradiance cache by level. Empty without a cache.
    pub cache_records: Vec<u32>,
    /// Cost of that plan. `None` without a cache.
    pub cache_plan: Option<PlanCount>,
    /// For each light of the scene, whether it shines.
    pub shining: Vec<bool>,
    /// Triangles, seen or not.
    pub triangles: u64,
    /// The previewer that counted.
    pub backend: PreviewBackend,
    /// Cost of counting.
    pub spent: Spent,
}

/// The preview of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Previewed {
    /// Stratum, position and normal per pixel.
    pub preview: Preview,
    /// The previewer that made it.
    pub backend: PreviewBackend,
    /// Cost of the preview.
    pub spent: Spent,
}

/// The steps of a render.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// Planning the irradiance cache, as one step.
    Planning,
    /// Gathering its records.
    Filling,
    /// Tracing the pixels.
    Tracing,
}

/// Progress of a render: `done` of `all` parts of a step. Without an irradiance cache there is only one step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// The step.
    pub step: Step,
    /// Records or pixels done.
    pub done: u64,
    /// All of them.
    pub all: u64,
}

/// A frame, rendered.
#[derive(Debug, Clone)]
pub struct Finished {
    /// The image.
    pub image: Image,
    /// Its irradiance cache, if it has one.
    pub cache: Option<CacheUse>,
}

/// Totals of an irradiance cache.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CacheUse {
    /// The whole cache.
    pub all: CacheTotals,
    /// The part that was taken over from a profile.
    pub taken_over: CacheTotals,
    /// Records of the shared cache, valid and invalid here. Their cost is the shot's.
    pub shared: Shared,
}

/// Opens bundles.
pub trait OpenRenderer: Send + Sync {
    /// Opens the bundle at `path`, a folder or a zip file.
    fn open(&self, path: &Path) -> Result<Arc<dyn Renderer>, RenderError>;
}

/// A bundle, opened.
pub trait Renderer: Send + Sync {
    /// Contents of the bundle.
    fn info(&self) -> &ShotInfo;

    /// Counts a frame's pixels by stratum, and its planned records. On the current thread pool.
    fn count(&self, frame: u32, settings: &RenderSettings) -> Result<Counted, RenderError>;

    /// Sets up one frame.
    fn frame(
        &self,
        frame: u32,
        settings: &RenderSettings,
    ) -> Result<Box<dyn FrameRenderer + '_>, RenderError>;

    /// Plans a shared cache for these frames, in their order, on the current thread pool. `progress` receives
    /// the frames done. `None` if `cancel` was set or no cache is needed.
    fn plan_cache(
        &self,
        frames: &[u32],
        settings: &RenderSettings,
        progress: &dyn Fn(u64),
        cancel: &AtomicBool,
    ) -> Result<Option<Cache>, RenderError>;

    /// Fills a part, from 0, of the cache's deepest level that is not full, or all levels if there is one
    /// part. `progress` receives the level's records: done, and all. `None` if `cancel` was set.
    fn fill_cache(
        &self,
        cache: Cache,
        settings: &RenderSettings,
        part: (u32, u32),
        progress: &(dyn Fn(u64, u64) + Sync),
        cancel: &AtomicBool,
    ) -> Result<Option<Cache>, RenderError>;
}

/// One frame at one quality.
pub trait FrameRenderer: Send + Sync {
    /// The frame as it is traced.
    fn frame(&self) -> &Frame;

    /// What each pixel shows.
    fn preview(&self) -> Result<Previewed, RenderError>;

    /// Costs of every render of this frame that do not depend on its pixels: set-up (`load`), the cache
    /// plan (`plan`, made now if needed) and, if something moves in the shot, an acceleration structure
    /// (`build`). Reusing a structure changes nothing: the cost does not depend on earlier work.
    fn fixed(&self) -> FixedCosts;

    /// What this process has paid once for the shot: loading, and a shared acceleration structure.
    fn once(&self) -> ProcessCosts;

    /// Records of the irradiance cache by level, which is planned now if needed. Empty without a cache.
    fn cache_records(&self) -> Vec<u32>;

    /// Cost of setting the frame up this time, without the cache plan. Includes any acceleration structure
    /// that was built, even the shot's, which is in no frame's cost.
    fn spent_on_setup(&self) -> Spent;

    /// Effects of the frame by name, sorted.
    fn effects(&self) -> Vec<String>;

    /// Lights and objects that cannot matter to the image, and why.
    fn left_out(&self) -> Vec<LeftOut>;

    /// Work by class of everything traced so far: of pixels, and of gathering records.
    fn work_by_class(&self) -> (ByClass, ByClass);

    /// Traces pixels by index, in order, on the current thread pool. Returns them with their noise. Their
    /// colours are final once the irradiance cache, if there is one, is filled ([`FrameRenderer::fill_for`]).
    fn trace(&self, pixels: &[u32]) -> Vec<(Pixel, PixelNoise)> {
        self.trace_unless(pixels, &|| false).unwrap_or_default()
    }

    /// The same. `None` if `stop` returned true.
    fn trace_unless(
        &self,
        pixels: &[u32],
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Option<Vec<(Pixel, PixelNoise)>>;

    /// Fills the irradiance cache as far as these pixels need, on the current thread pool. Colours are then
    /// nearly final: a full cache averages its records. `None` if `stop` returned true.
    fn fill_for(&self, pixels: &[u32], stop: &(dyn Fn() -> bool + Sync)) -> Option<Spent>;

    /// Plans and fills any irradiance cache, on the current thread pool. `false` if `cancel` was set.
    fn fill(&self, progress: &(dyn Fn(Progress) + Sync), cancel: &AtomicBool) -> bool;

    /// Cost of the irradiance cache so far: planning and gathering. Zero without one.
    fn spent_on_cache(&self) -> Spent;

    /// Whether traced pixels have the image's colours: without an irradiance cache, or once it is filled.
    fn has_final_colours(&self) -> bool;

    /// Sets the camera samples of every pixel. Can be called once.
    fn allot(&self, samples: SampleCounts) -> Result<(), RenderError>;

    /// Starts an image in passes, without samples.
    fn begin(&self) -> Passes;

    /// Brings pixels to these camera samples, on the current thread pool. Any irradiance cache must be
    /// filled. `stop` is checked before each pixel. `progress` is called [`Passes::parts`] times.
    fn go_on(
        &self,
        passes: &mut Passes,
        wanted: &SampleCounts,
        stop: &(dyn Fn() -> bool + Sync),
        progress: &(dyn Fn() + Sync),
    ) -> Result<Totals, RenderError>;

    /// The image so far.
    fn finished(&self, passes: &Passes) -> Finished;

    /// As [`FrameRenderer::trace_unless`] for runs of pixels. One thread traces a run in order, like a tile.
    fn trace_runs(
        &self,
        runs: &[Vec<u32>],
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Option<Vec<Vec<(Pixel, PixelNoise)>>>;

    /// Costs of gathering `each` records of every level, chosen uniformly, on the current thread pool.
    fn sample_records(&self, each: usize, seed: u64) -> Vec<RecordCost>;

    /// A profile for [`FrameRenderer::render`]: these pixels or, with an irradiance cache, the cache so far.
    fn profile(&self, pixels: &[(u32, Pixel)]) -> Profile;

    /// Checks that [`FrameRenderer::render`] can take over a profile.
    fn check(&self, profile: &Profile) -> Result<(), RenderError>;

    /// Gives the frame the shared cache, before anything is planned. Records whose light has changed here are
    /// dropped, and the frame plans what it lacks. Returns both counts.
    fn share(&self, cache: Cache) -> Result<Shared, RenderError>;

    /// Renders the image on the current thread pool, taking over `reuse`. `None` if `cancel` was set.
    fn render(
        &self,
        reuse: Option<&Profile>,
        progress: &(dyn Fn(Progress) + Sync),
        finished: &PixelsFinished<'_>,
        cancel: &AtomicBool,
    ) -> Result<Option<Finished>, RenderError>;
}

//! The small door behind which the renderer stands.
//!
//! A [`Renderer`] is a bundle, opened; a [`FrameRenderer`] one frame of it at one quality, ready to be previewed, profiled and
//! rendered, with what each took. Nothing else of the farm knows how light is traced: another renderer can be put behind this
//! door. Ours, over `scene`, `preview` and `tracer`, is in [`crate::own`].

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
    /// The bundle, or a frame of it, cannot be had.
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
    /// Numbers of camera samples do not fit the image.
    #[error("camera samples: {0}")]
    Samples(#[from] SampleCountsError),
    /// The profile was made from another scene, another frame, at another quality, or by another version.
    #[error(
        "profile: it was made for another image ({differs}); make it again with the bundle, frame and settings of this one"
    )]
    ForeignProfile {
        /// What is another there.
        differs: String,
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

/// What a bundle holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ShotInfo {
    /// What there is.
    pub summary: SceneSummary,
    /// The renderer, with all versions that costs or their forecasts may depend on.
    pub renderer: String,
    /// All (object, material) pairs; the same for every frame of the shot.
    pub strata: Vec<StratumInfo>,
}

/// What a frame shows, in numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Counted {
    /// Pixels per stratum, and of the background.
    pub counts: Counts,
    /// Records of the frame's irradiance cache by level, as planned; empty without a cache.
    pub cache_records: Vec<u32>,
    /// What planning it takes; nothing without a cache.
    pub cache_plan: Option<PlanCount>,
    /// Whether each of the scene's lights shines.
    pub shining: Vec<bool>,
    /// Triangles, seen or not.
    pub triangles: u64,
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

/// The steps of a render.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// Finding out where the irradiance cache needs records. It is all one step.
    Planning,
    /// Gathering these records.
    Filling,
    /// Tracing the pixels.
    Tracing,
}

/// How far a render is: `done` of `all` parts of a step. Without an irradiance cache there is but one step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// The step.
    pub step: Step,
    /// Records or pixels that are done.
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

/// What an irradiance cache came to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CacheUse {
    /// All of it.
    pub all: CacheTotals,
    /// The part of it that was taken over from a profile.
    pub taken_over: CacheTotals,
    /// Records of the shot's cache that it was given, and those that do not hold in this frame; their cost is the shot's.
    pub shared: Shared,
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

    /// How many pixels of a frame show each stratum, and how many records its irradiance cache has. On the current thread pool.
    fn count(&self, frame: u32, settings: &RenderSettings) -> Result<Counted, RenderError>;

    /// One frame, ready for everything else.
    fn frame(
        &self,
        frame: u32,
        settings: &RenderSettings,
    ) -> Result<Box<dyn FrameRenderer + '_>, RenderError>;

    /// Plans an irradiance cache for all of these frames, in their order, on the current thread pool; `progress` is told the frames done.
    /// `None` if `cancel` was set, and where there is no use for one.
    fn plan_cache(
        &self,
        frames: &[u32],
        settings: &RenderSettings,
        progress: &dyn Fn(u64),
        cancel: &AtomicBool,
    ) -> Result<Option<Cache>, RenderError>;

    /// Fills a part of such a cache, from 0, of its deepest level that is not full; all levels, if there is but one part. `progress` is told
    /// the records done, and all records of the level. `None` if `cancel` was set.
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

    /// What every render of this frame costs whatever its pixels show: setting it up (`load`), building its acceleration
    /// structure (`build`), if something moves in the shot so that its frames cannot share one, and planning its irradiance cache
    /// (`plan`), which is done now if it was not. Whether a structure was kept from before makes no difference: a frame's cost does
    /// not depend on what was done before it.
    fn fixed(&self) -> FixedCosts;

    /// What this process has paid once for the shot: reading it, and building the acceleration structure that its frames share.
    fn once(&self) -> ProcessCosts;

    /// Records of the frame's irradiance cache by level, which is planned now if it was not; none without a cache.
    fn cache_records(&self) -> Vec<u32>;

    /// What setting the frame up took this time, without the plan of its irradiance cache, with any acceleration structure that had to be built for it: also that of the
    /// shot, which is in no frame's cost, for it is built once per process.
    fn spent_on_setup(&self) -> Spent;

    /// The effects that the frame calls for, by name, sorted.
    fn effects(&self) -> Vec<String>;

    /// Lights and objects that cannot matter to the frame's image, and why.
    fn left_out(&self) -> Vec<LeftOut>;

    /// Work by class of all that was traced of it so far: of pixels, and of gathering records.
    fn work_by_class(&self) -> (ByClass, ByClass);

    /// Finished pixels by index, in the order given, on the current thread pool, with what their camera samples say of their error. With an
    /// irradiance cache all but their colours is final: the cache is planned, but not filled; see [`FrameRenderer::fill_for`].
    fn trace(&self, pixels: &[u32]) -> Vec<(Pixel, PixelNoise)> {
        self.trace_unless(pixels, &|| false).unwrap_or_default()
    }

    /// The same, unless `stop` says at some time on the way that it is not wanted any more: then nothing.
    fn trace_unless(
        &self,
        pixels: &[u32],
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Option<Vec<(Pixel, PixelNoise)>>;

    /// Fills the irradiance cache as far as the colours of these pixels need it, on the current thread pool, and says what that took. The
    /// colours are then close to the image's: a whole cache is a little less noisy, for its records are averaged. Nothing if `stop` says on the way
    /// that they are not wanted any more.
    fn fill_for(&self, pixels: &[u32], stop: &(dyn Fn() -> bool + Sync)) -> Option<Spent>;

    /// Plans and fills the irradiance cache, if there is one, on the current thread pool. `false` if `cancel` was set.
    fn fill(&self, progress: &(dyn Fn(Progress) + Sync), cancel: &AtomicBool) -> bool;

    /// What planning the irradiance cache, and gathering as much of it as is gathered, takes; nothing without one.
    fn spent_on_cache(&self) -> Spent;

    /// Whether pixels that are traced have the image's colours: without an irradiance cache, or once it is filled.
    fn has_final_colours(&self) -> bool;

    /// Gives every pixel a number of camera samples of its own; once.
    fn allot(&self, samples: SampleCounts) -> Result<(), RenderError>;

    /// An image that is made in passes, with no sample yet.
    fn begin(&self) -> Passes;

    /// Brings its pixels to these numbers of camera samples, on the current thread pool, and says what that took; the irradiance cache has to be filled. Before
    /// each pixel `stop` is asked whether to leave the others as they are; `progress` is called [`Passes::parts`] times.
    fn go_on(
        &self,
        passes: &mut Passes,
        wanted: &SampleCounts,
        stop: &(dyn Fn() -> bool + Sync),
        progress: &(dyn Fn() + Sync),
    ) -> Result<Totals, RenderError>;

    /// The image, as far as it has come.
    fn finished(&self, passes: &Passes) -> Finished;

    /// The same as [`FrameRenderer::trace_unless`] for runs of pixels: those of a run are traced one after the other by one thread, as a
    /// tile's are in a render.
    fn trace_runs(
        &self,
        runs: &[Vec<u32>],
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Option<Vec<Vec<(Pixel, PixelNoise)>>>;

    /// What gathering records of the irradiance cache takes: of `each` of every level, chosen by `seed` so that all have the same
    /// chance, on the current thread pool. None without a cache.
    fn sample_records(&self, each: usize, seed: u64) -> Vec<RecordCost>;

    /// What can be taken over by [`FrameRenderer::render`]: these pixels or, with an irradiance cache, that, as far as it was filled.
    fn profile(&self, pixels: &[(u32, Pixel)]) -> Profile;

    /// Whether [`FrameRenderer::render`] can take over what a profile holds.
    fn check(&self, profile: &Profile) -> Result<(), RenderError>;

    /// Gives the frame the cache of its shot: before anything is planned. Records whose light something that moved has changed are
    /// dropped; what the frame needs beyond the others will be planned anew. Says what became of them.
    fn share(&self, cache: Cache) -> Result<Shared, RenderError>;

    /// The image, on the current thread pool; what `reuse` holds is taken over. `finished` is given pixels as they are finished. `None` if
    /// `cancel` was set.
    fn render(
        &self,
        reuse: Option<&Profile>,
        progress: &(dyn Fn(Progress) + Sync),
        finished: &PixelsFinished<'_>,
        cancel: &AtomicBool,
    ) -> Result<Option<Finished>, RenderError>;
}

//! From a shot to its quote: preview all frames, choose some, profile these, estimate all.
//!
//! The service does the same steps spread over workers: a preview task is [`count_frames`], a profile task [`profile_frame`],
//! and choosing and estimating happen in the service. Offline, [`crate::quote`] does all of it.

use crate::renderer::{Counted, RenderError, Renderer, StratumInfo};
use crate::warm_clock;
use forelight_forecast::{Cost, FrameDesign, Observation, Stratum};
use forelight_preview::NOTHING;
use forelight_protocol::{FixedCosts, MaterialMode, PreviewBackend, RenderSettings, Spent};
use forelight_scene::{Frame, MaterialClass};
use forelight_tracer::{Pixel, Profile};

/// What can go wrong on the way to a quote.
#[derive(Debug, thiserror::Error)]
pub enum ShotError {
    /// The renderer's part.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// The statistics' part.
    #[error(transparent)]
    Forecast(#[from] forelight_forecast::ForecastError),
    /// It was told to stop.
    #[error("stopped")]
    Cancelled,
}

/// Told how far a step is; says whether to go on.
pub trait Observer: Sync {
    /// `done` of `all` frames have been previewed.
    fn previewed(&self, done: usize, all: usize);
    /// `done` of `all` frames have been profiled.
    fn profiled(&self, done: usize, all: usize);
    /// Whether to stop as soon as possible.
    fn is_cancelled(&self) -> bool;
}

/// The shot's strata as the forecast wants them, the background as the last.
///
/// The prior costs only steer where the first samples go: a pixel of glass sends out several times the rays of a wall's pixel, an
/// empty one next to none.
pub fn forecast_strata(strata: &[StratumInfo], settings: &RenderSettings) -> Vec<Stratum> {
    const TRANSPARENT: f64 = 3.0;
    const SPECULAR: f64 = 2.0;
    const DIFFUSE: f64 = 1.0;
    const BACKGROUND: f64 = 0.1;
    let prior = |class| match (settings.materials, class) {
        (MaterialMode::Lambert, _) | (_, MaterialClass::Diffuse) => DIFFUSE,
        (_, MaterialClass::Specular) => SPECULAR,
        (_, MaterialClass::Transparent) => TRANSPARENT,
    };
    let known =
        strata.iter().map(|s| Stratum { object: s.object, material: s.material, prior_cost: prior(s.class) });
    let background = Stratum { object: u32::MAX, material: u32::MAX, prior_cost: BACKGROUND };
    known.chain([background]).collect()
}

/// What all frames show, in the order of `frames`.
#[derive(Debug, Clone)]
pub struct CountedFrames {
    /// Per frame, pixels by stratum, the background as the last: one number for each of [`forecast_strata`].
    pub counts: Vec<Vec<u32>>,
    /// Who counted the last frame.
    pub backend: PreviewBackend,
    /// What it took.
    pub spent: Spent,
}

/// Previews frames for their counts.
pub fn count_frames(
    renderer: &dyn Renderer,
    frames: &[u32],
    settings: &RenderSettings,
    observer: &dyn Observer,
) -> Result<CountedFrames, ShotError> {
    let mut all = CountedFrames {
        counts: Vec::with_capacity(frames.len()),
        backend: PreviewBackend::Cpu,
        spent: Spent::default(),
    };
    for (index, &frame) in frames.iter().enumerate() {
        if observer.is_cancelled() {
            return Err(ShotError::Cancelled);
        }
        let Counted { counts, backend, spent } = renderer.count(frame, settings)?;
        let mut pixels = counts.per_stratum;
        pixels.push(counts.background);
        all.counts.push(pixels);
        all.backend = backend;
        all.spent = plus(all.spent, spent);
        observer.previewed(index + 1, frames.len());
    }
    Ok(all)
}

/// A profiled frame.
#[derive(Debug, Clone)]
pub struct ProfiledFrame {
    /// Frame number.
    pub frame: u32,
    /// Stratum and cost of each profiled pixel, in the order of `profile.pixels`; the times are those that it would have taken
    /// in a render (see `warm_clock`).
    pub observations: Vec<Observation>,
    /// The finished pixels, for the render to take over: the profiled ones, then neighbours that were traced for their time.
    pub profile: Profile,
    /// What every render of the frame costs whatever its pixels show; without writing its files, which is for those who write
    /// them to add.
    pub fixed: FixedCosts,
    /// What setting the frame up took this time.
    pub setup: Spent,
    /// The frame's preview.
    pub preview: Spent,
    /// What was spent on all finished pixels.
    pub pixels: Spent,
    /// The preview as a picture.
    pub picture: image::RgbImage,
    /// The frame as it was traced.
    pub scene: Frame,
}

impl ProfiledFrame {
    /// Everything that profiling this frame took.
    pub fn spent(&self) -> Spent {
        plus(self.spent_for_good(), self.pixels)
    }

    /// The part of it that a render does not get back: the profiled pixels are finished pixels, the rest is done again.
    pub fn spent_for_good(&self) -> Spent {
        plus(self.setup, self.preview)
    }
}

/// Profiles about `samples` pixels of one frame in two phases: the first spread by strata, the second where the first found
/// cost and variation. `seed` chooses the pixels; the pixels' own random numbers come from the settings, as in the render.
pub fn profile_frame(
    renderer: &dyn Renderer,
    frame: u32,
    settings: &RenderSettings,
    samples: u32,
    seed: u64,
    observer: &dyn Observer,
) -> Result<ProfiledFrame, ShotError> {
    let ready = renderer.frame(frame, settings)?;
    let seen = ready.preview()?;
    let strata = forecast_strata(&renderer.info().strata, settings);
    // The background is the last stratum.
    let background = renderer.info().strata.len() as u32;
    let ids: Vec<u32> =
        seen.preview.stratum.iter().map(|&s| if s == NOTHING { background } else { s }).collect();
    let design = FrameDesign::new(&strata, &ids, settings.width, samples, seed, i64::from(frame))?;
    let mut observations = Vec::with_capacity(samples as usize);
    let mut finished = Vec::with_capacity(samples as usize);
    let mut trace = |picks: &[forelight_forecast::Pick], observations: &mut Vec<Observation>| {
        let indices: Vec<u32> = picks.iter().map(|pick| pick.pixel).collect();
        for (pick, pixel) in picks.iter().zip(ready.trace(&indices)) {
            observations.push(Observation { stratum: pick.stratum, cost: cost_of(&pixel) });
            finished.push((pick.pixel, pixel));
        }
    };
    if observer.is_cancelled() {
        return Err(ShotError::Cancelled);
    }
    trace(&design.first_phase(), &mut observations);
    if observer.is_cancelled() {
        return Err(ShotError::Cancelled);
    }
    trace(&design.second_phase(&observations)?, &mut observations);
    let warmth = warm_clock::measure(&*ready, design.counts(), &observations, &finished);
    for observation in &mut observations {
        let cpu_nanos = &mut observation.cost.cpu_nanos;
        *cpu_nanos = (*cpu_nanos as f64 * warmth.factor).round() as u64;
    }
    finished.extend(warmth.pixels);
    let pixels = finished.iter().fold(Spent::default(), |sum, (_, pixel)| {
        plus(sum, Spent { work: pixel.work, cpu_nanos: pixel.cpu_nanos })
    });
    Ok(ProfiledFrame {
        frame,
        observations,
        fixed: ready.fixed(),
        setup: ready.spent_on_setup(),
        preview: seen.spent,
        pixels,
        picture: forelight_preview::picture(&seen.preview, ready.frame()),
        scene: ready.frame().clone(),
        profile: ready.profile(finished),
    })
}

/// The sum of two costs.
pub fn plus(a: Spent, b: Spent) -> Spent {
    Spent { work: a.work.saturating_add(b.work), cpu_nanos: a.cpu_nanos.saturating_add(b.cpu_nanos) }
}

fn cost_of(pixel: &Pixel) -> Cost {
    Cost { work: pixel.work, cpu_nanos: pixel.cpu_nanos, rays: pixel.rays.map(u64::from) }
}

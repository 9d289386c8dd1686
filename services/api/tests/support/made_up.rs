//! Made-up results. A quad covers 48 of 64 pixels. A pixel of it costs 1000 in frame 0, and 1 % more in each
//! later frame.

use super::Farm;
use forelight_protocol::{
    AccuracyDoc, AccuracyRung, AllottedStats, ArtifactHash, ByClass, DenoisedStats, Described, DivideResult,
    DivideSpec, ErrorTarget, FinishedPart, FixedCosts, FixedPart, FrameStrata, ImageError, LadderKind, Lease,
    MeasuredFrame, MeasuredShare, MissingLadder, NoiseCell, NoiseSample, PartPixels, PartRange, PixelRange,
    PreviewBackend, PreviewResult, PreviewSpec, ProfileArtifacts, ProfileResult, ProfileSample, ProfileSpec,
    Profiled, Quantiles, Rays, RenderArtifacts, RenderPartResult, RenderPartSpec, RenderResult, RenderSpec,
    RenderStats, RendererId, SampleCost, SampleRange, SampleShare, SamplesForError, SceneSummary,
    ShotSettings, Spent, SpentOnForecast, Stratum, StratumName, StratumTime, TaskResult, TaskSpec, Varied,
    VideoFile, VideoResult, VideoSpec,
};

/// CPU time of removing the noise of a made-up frame, nanoseconds.
pub const DENOISING: u64 = 200_000_000_000;

/// Share of a rung's error that is left, in ladders of jobs whose noise is removed.
pub const DENOISED_SHARE: f64 = 0.375;

impl Farm {
    /// The result of a task. Its artefacts are stored.
    pub async fn made_up_result(&self, lease: &Lease) -> TaskResult {
        match &lease.spec {
            TaskSpec::Preview(spec) => TaskResult::Preview(preview(spec)),
            TaskSpec::Profile(spec) if spec.renderer.is_some() => {
                TaskResult::Measured(self.measured(spec).await)
            }
            TaskSpec::Profile(spec) => TaskResult::Profile(self.profile(spec).await),
            TaskSpec::CachePlan(_) | TaskSpec::CacheFill(_) | TaskSpec::CacheMerge(_) => {
                panic!("these scenes have no irradiance caches")
            }
            TaskSpec::Divide(spec) => {
                let coarse = self.artifact(b"a coarse picture").await;
                TaskResult::Divide(divide(spec, coarse, self.artifact(b"samples of a pass").await))
            }
            TaskSpec::RenderPart(spec) => TaskResult::RenderPart(self.render_part(spec).await),
            TaskSpec::Render(spec) => TaskResult::Render(self.render(spec).await),
            TaskSpec::Video(spec) => TaskResult::Video(self.video(spec).await),
        }
    }

    /// 4 of 32 samples: 10 ms without samples, and 2 ms for each sample and 1 % more in each later frame.
    async fn measured(&self, spec: &ProfileSpec) -> MeasuredFrame {
        let sample = 2_000_000 + 20_000 * u64::from(spec.frame);
        let cost = |amount: u32| SampleCost { amount, cpu_nanos: 10_000_000 + u64::from(amount) * sample };
        let hash = Some(self.artifact(format!("samples of {}", spec.frame).as_bytes()).await);
        MeasuredFrame {
            frame: spec.frame,
            renderer: another_renderer(),
            varied: Varied::Samples,
            whole: 32,
            costs: vec![cost(0), cost(4)],
            fixed: vec![FixedPart { name: "tree".to_owned(), cpu_nanos: 10_000_000 }],
            strata: vec![StratumTime { object: Some(0), material: Some(0), nanos: 4 * sample }],
            shares: vec![MeasuredShare { offset: 0, count: 4, cpu_nanos: 4 * sample, hash }],
            preview_png: Some(self.artifact(b"a preview").await),
            spent: Spent { work: 18_000, cpu_nanos: 18_000_000 },
            peak_memory_bytes: 1 << 20,
        }
    }

    /// A file that begins like a video, and names the pictures.
    async fn video(&self, spec: &VideoSpec) -> VideoResult {
        let content = format!("....ftyp{:?} at {}", spec.pictures, spec.frames_per_second);
        let frames = u32::try_from(spec.pictures.len()).expect("few frames");
        let hash = self.artifact(content.as_bytes()).await;
        let file = VideoFile { hash, bytes: content.len() as u64, frames };
        VideoResult { file, spent: Spent { work: 0, cpu_nanos: 1_000_000 }, peak_memory_bytes: 1 << 20 }
    }

    /// A part whose pixels cost their share of the frame's work.
    async fn render_part(&self, spec: &RenderPartSpec) -> RenderPartResult {
        let name = format!("part {} of frame {}", spec.part, spec.frame);
        let hash = self.artifact(name.as_bytes()).await;
        let work = frame_work(spec.frame) / u64::from(spec.parts);
        let cost = Spent { work, cpu_nanos: work * 1_000_000 };
        let finished = match spec.assigned_range().expect("a part is handed out once it is known") {
            PartRange::Pixels(PixelRange { from, to }) => {
                FinishedPart::Pixels(PartPixels { hash, count: to - from, cost })
            }
            PartRange::Samples(SampleRange { offset, count }) => {
                FinishedPart::Samples(SampleShare { offset, count, cpu_nanos: cost.cpu_nanos, hash })
            }
        };
        RenderPartResult { finished, rest: None, spent: cost, peak_memory_bytes: 1 << 20 }
    }

    async fn profile(&self, spec: &ProfileSpec) -> ProfileResult {
        let samples = (0..spec.samples.min(64)).map(|pixel| {
            let background = pixel % 4 == 3;
            let work = if background { 10 } else { pixel_work(spec.frame) };
            ProfileSample {
                pixel,
                stratum: u32::from(background),
                work,
                extra_work: 0,
                work_by_ray: [work - work / 4, 0, 0, 0, 0, work / 4, 0],
                cpu_nanos: work * 1_000_000,
                rays: [u64::from(spec.settings.own().unwrap().spp), 0, 0, 0, 0, 2, 0],
            }
        });
        ProfileResult {
            frame: spec.frame,
            strata: vec![stratum()],
            samples: samples.collect(),
            uncovered: None,
            shared_samples: Vec::new(),
            shared_cache_samples: Vec::new(),
            cache_samples: Vec::new(),
            noise: made_up_noise(spec.settings.own().unwrap().spp),
            samples_for_error: spec.error_target.map(|target| {
                let p50 = 2.0 / target.share() + 0.25;
                SamplesForError { p50, p80: 1.1 * p50, p95: 1.25 * p50 }
            }),
            effects: vec!["ambient".to_owned()],
            work_by_class: Some(ByClass { rays: 800, memory: 200, ..ByClass::default() }),
            left_out: Vec::new(),
            renderer: Some("made up 1".to_owned()),
            fixed: FixedCosts {
                load: Spent { work: 5, cpu_nanos: 5_000_000 },
                denoise: Spent { work: 0, cpu_nanos: if spec.denoise { DENOISING } else { 0 } },
                ..FixedCosts::default()
            },
            file_bytes: Some(5000),
            once: None,
            ladders: spec.ladders.then(|| Box::new(made_up_ladders(spec))),
            spent: Spent { work: 1000, cpu_nanos: 1_000_000 },
            artifacts: ProfileArtifacts {
                profile: self.artifact(format!("profile of {}", spec.frame).as_bytes()).await,
                preview_png: Some(self.artifact(b"a preview").await),
            },
        }
    }

    async fn render(&self, spec: &RenderSpec) -> RenderResult {
        let work = match spec.renderer {
            None => frame_work(spec.frame) + 5,
            // CPU time in microseconds.
            Some(_) => 10_000 + 32 * (2000 + 20 * u64::from(spec.frame)),
        };
        let cpu_seconds = if spec.renderer.is_some() { work as f64 * 1e-6 } else { work as f64 * 1e-3 };
        RenderResult {
            stats: RenderStats {
                frame: spec.frame,
                width: spec.settings.size().unwrap().0,
                height: spec.settings.size().unwrap().1,
                spp: spec.settings.samples().unwrap() + u32::from(spec.work.is_some()),
                denoised: spec.denoise.then(made_up_denoised),
                allotted: spec.work.map(|_| {
                    Box::new(AllottedStats {
                        least: 1,
                        most: 4 * spec.settings.own().unwrap().spp,
                        mean: f64::from(spec.settings.own().unwrap().spp + 1),
                        error: match spec.error_target.map(ErrorTarget::share) {
                            Some(share) => ImageError { p05: share, p50: share, p80: share, p95: share },
                            None => ImageError { p05: 0.01, p50: 0.02, p80: 0.03, p95: 0.04 },
                        },
                        forecast: None,
                        within: None,
                    })
                }),
                effects: vec!["ambient".to_owned()],
                left_out: Vec::new(),
                rays: Rays { primary: 1024, ..Rays::default() },
                cache_records: Vec::new(),
                cache: None,
                cache_choice: None,
                work,
                work_by_class: None,
                work_by_ray: Some(Rays { primary: work / 2, ..Rays::default() }),
                cpu_seconds,
                once: None,
                wall_seconds: work as f64 * 1e-3,
                peak_rss_bytes: 1,
                reused_pixels: 0,
                reused_rays: 0,
                reused_work: 0,
                reused_cpu_seconds: 0.0,
            },
            artifacts: RenderArtifacts {
                image_exr: self.artifact(format!("image {}", spec.frame).as_bytes()).await,
                image_png: self.artifact(format!("picture {}", spec.frame).as_bytes()).await,
                cost_map_png: self.artifact(b"a cost map").await,
                preview_png: None,
            },
        }
    }
}

fn preview(spec: &PreviewSpec) -> PreviewResult {
    PreviewResult {
        strata: vec![stratum()],
        background_prior_cost: 0.1,
        record_prior_cost: None,
        frames: spec
            .frames
            .iter()
            .map(|&frame| FrameStrata {
                frame,
                pixels: vec![48],
                background: 16,
                cache_records: Vec::new(),
                cache_plan: None,
                lights: 0,
                shining: 0,
                triangles: 0,
                preview_png: None,
            })
            .collect(),
        backend: PreviewBackend::Cpu,
        spent: Spent { work: 100, cpu_nanos: 100_000 },
        described: spec.renderer.as_ref().map(|_| Box::new(described(spec))),
    }
}

/// What a made-up worker says of removing noise.
pub fn made_up_denoised() -> DenoisedStats {
    let error = |error| ImageError { p05: error / 2.0, p50: error, p80: error, p95: 2.0 * error };
    DenoisedStats {
        by: "a denoiser 1".to_owned(),
        error: error(0.02),
        noisy: error(0.05),
        measured_pixels: 1,
        measured_samples: 64,
        denoiser_cpu_seconds: 0.01,
        features_cpu_seconds: 0.01,
        measuring_cpu_seconds: 0.01,
    }
}

/// A renderer that is not our own.
pub fn another_renderer() -> RendererId {
    RendererId { name: "cycles".to_owned(), version: "5.0.1".to_owned() }
}

/// A scene of 8 × 8 pixels and 32 samples. The job may ask for other samples.
fn described(spec: &PreviewSpec) -> Described {
    let job = spec.settings.shot().unwrap();
    Described {
        renderer: another_renderer(),
        scene: SceneSummary {
            name: "shot".to_owned(),
            digest: spec.digest,
            frames: 250,
            width: 8,
            height: 8,
            objects: 1,
            materials: 1,
            triangles: 2,
            frames_per_second: None,
        },
        settings: ShotSettings {
            width: Some(8),
            height: Some(8),
            samples: job.samples.or(Some(32)),
            seed: Some(0),
            own: job.own.clone(),
        },
        notes: vec!["a script is not run".to_owned()],
    }
}

/// Mean 2 and variance 1 / n at n samples for the quad's pixels, exactly 1 for the background's.
fn made_up_noise(spp: u32) -> Vec<NoiseCell> {
    let doublings = spp.ilog2() as i32;
    let drops = |variance: f32| (1..=doublings).map(|k| variance * 0.5f32.powi(k)).collect();
    let cell = |pixels, brightness, variance| NoiseCell {
        pixels,
        samples: vec![NoiseSample { brightness, drops: drops(variance) }; 4],
    };
    vec![cell(48, 2.0, 1.0), cell(16, 1.0, 0.0)]
}

/// Factor on cost and error of a made-up rung. With a cache a tenth of its place on the ladder, else above 1.
pub fn made_up_times(kind: LadderKind, place: u32) -> f64 {
    match kind {
        LadderKind::CachedSamples => f64::from(place) / 10.0,
        _ => f64::from(place) + 1.0,
    }
}

/// Of a rung with this error.
fn made_up_denoised_error(error: f64) -> ImageError {
    let error = DENOISED_SHARE * error;
    ImageError { p05: error, p50: error, p80: error, p95: error }
}

fn made_up_ladders(spec: &ProfileSpec) -> AccuracyDoc {
    let even = |value| Quantiles { mean: value, p50: value, p80: value, p95: value };
    let rungs = LadderKind::ALL.into_iter().flat_map(|kind| {
        let rungs = forelight_quote::ladder(kind, spec.settings.own().unwrap()).unwrap_or_default();
        (1..).zip(rungs).map(move |(place, settings)| {
            let times = if Some(&settings) == spec.settings.own() { 1.0 } else { made_up_times(kind, place) };
            let error = times / 100.0;
            AccuracyRung {
                ladder: kind,
                asked_for: Some(&settings) == spec.settings.own(),
                settings,
                work: even(500.0 * times),
                cpu_seconds: even(2.0 * times),
                error: Some(ImageError { p05: error, p50: error, p80: error, p95: error }),
                denoised_error: spec.denoise.then(|| made_up_denoised_error(error)),
                worth_taking: false,
                next: None,
                measured: None,
            }
        })
    });
    AccuracyDoc {
        frames: 1,
        settings: spec.settings.own().unwrap().clone(),
        rungs: rungs.collect(),
        missing: vec![MissingLadder { ladder: LadderKind::Divisions, reason: "too dear".to_owned() }],
        profiled: Profiled { frames: vec![spec.frame], pixels: 99 },
        spent: SpentOnForecast { work: 400, cpu_seconds: 1e-4, fraction_of_forecast: 0.5 },
        calibrated: false,
    }
}

/// Work of all pixels of a frame.
fn frame_work(frame: u32) -> u64 {
    48 * pixel_work(frame) + 16 * 10
}

/// Parts of equally many of the 64 pixels. A frame in passes has one of them, with these samples.
fn divide(spec: &DivideSpec, coarse: ArtifactHash, samples: ArtifactHash) -> DivideResult {
    let work = frame_work(spec.frame) / u64::from(spec.parts);
    let is_over = spec.passes.as_ref().is_some_and(|passes| !passes.before.is_empty());
    let parts = if is_over { 0 } else { spec.parts };
    DivideResult {
        ends: (1..=parts).map(|part| 64 * part / spec.parts).collect(),
        work: vec![work; parts as usize],
        cache: None,
        coarse_png: Some(coarse),
        samples: Some(samples).filter(|_| spec.passes.is_some() && !is_over),
        expected_work: None,
        spent: Spent { work: 10, cpu_nanos: 10_000_000 },
    }
}

fn pixel_work(frame: u32) -> u64 {
    1000 + 10 * u64::from(frame)
}

fn stratum() -> Stratum {
    let name = StratumName { object: "quad".to_owned(), material: "paint".to_owned() };
    Stratum { name, object: 0, material: 0, prior_cost: 1.0 }
}

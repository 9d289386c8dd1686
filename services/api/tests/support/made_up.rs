//! Made-up results. A quad covers 48 of 64 pixels. A pixel of it costs 1000 in frame 0, and 1 % more in each
//! later frame.

use super::Farm;
use forelight_protocol::{
    AccuracyDoc, AccuracyRung, AllottedStats, ByClass, FixedCosts, FrameStrata, ImageError, LadderKind,
    Lease, MissingLadder, NoiseCell, NoiseSample, PreviewBackend, PreviewResult, PreviewSpec,
    ProfileArtifacts, ProfileResult, ProfileSample, ProfileSpec, Profiled, Quantiles, Rays, RenderArtifacts,
    RenderResult, RenderSpec, RenderStats, Spent, SpentOnForecast, Stratum, StratumName, TaskResult,
    TaskSpec,
};

impl Farm {
    /// The result of a task. Its artefacts are stored.
    pub async fn made_up_result(&self, lease: &Lease) -> TaskResult {
        match &lease.spec {
            TaskSpec::Preview(spec) => TaskResult::Preview(preview(spec)),
            TaskSpec::Profile(spec) => TaskResult::Profile(self.profile(spec).await),
            TaskSpec::CachePlan(_) | TaskSpec::CacheFill(_) | TaskSpec::CacheMerge(_) => {
                panic!("these scenes have no irradiance caches")
            }
            TaskSpec::Render(spec) => TaskResult::Render(self.render(spec).await),
        }
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
                rays: [u64::from(spec.settings.spp), 0, 0, 0, 0, 2, 0],
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
            noise: made_up_noise(spec.settings.spp),
            effects: vec!["ambient".to_owned()],
            work_by_class: Some(ByClass { rays: 800, memory: 200, ..ByClass::default() }),
            left_out: Vec::new(),
            renderer: Some("made up 1".to_owned()),
            fixed: FixedCosts { load: Spent { work: 5, cpu_nanos: 5_000_000 }, ..FixedCosts::default() },
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
        let work = 48 * pixel_work(spec.frame) + 16 * 10 + 5;
        RenderResult {
            stats: RenderStats {
                frame: spec.frame,
                width: spec.settings.width,
                height: spec.settings.height,
                spp: spec.settings.spp + u32::from(spec.work.is_some()),
                allotted: spec.work.map(|_| {
                    Box::new(AllottedStats {
                        least: 1,
                        most: 4 * spec.settings.spp,
                        mean: f64::from(spec.settings.spp + 1),
                        error: ImageError { p05: 0.01, p50: 0.02, p80: 0.03, p95: 0.04 },
                        forecast: None,
                        within: None,
                    })
                }),
                effects: vec!["ambient".to_owned()],
                left_out: Vec::new(),
                rays: Rays { primary: 1024, ..Rays::default() },
                cache_records: Vec::new(),
                cache: None,
                work,
                work_by_class: None,
                work_by_ray: Some(Rays { primary: work / 2, ..Rays::default() }),
                cpu_seconds: work as f64 * 1e-3,
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
                image_png: self.artifact(b"a picture").await,
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

fn made_up_ladders(spec: &ProfileSpec) -> AccuracyDoc {
    let even = |value| Quantiles { mean: value, p50: value, p80: value, p95: value };
    let rungs = LadderKind::ALL.into_iter().flat_map(|kind| {
        let rungs = forelight_quote::ladder(kind, &spec.settings).unwrap_or_default();
        (1..).zip(rungs).map(move |(place, settings)| {
            let times = if settings == spec.settings { 1.0 } else { made_up_times(kind, place) };
            let error = times / 100.0;
            AccuracyRung {
                ladder: kind,
                asked_for: settings == spec.settings,
                settings,
                work: even(500.0 * times),
                cpu_seconds: even(2.0 * times),
                error: Some(ImageError { p05: error, p50: error, p80: error, p95: error }),
                worth_taking: false,
                next: None,
                measured: None,
            }
        })
    });
    AccuracyDoc {
        frames: 1,
        settings: spec.settings.clone(),
        rungs: rungs.collect(),
        missing: vec![MissingLadder { ladder: LadderKind::Divisions, reason: "too dear".to_owned() }],
        profiled: Profiled { frames: vec![spec.frame], pixels: 99 },
        spent: SpentOnForecast { work: 400, cpu_seconds: 1e-4, fraction_of_forecast: 0.5 },
        calibrated: false,
    }
}

fn pixel_work(frame: u32) -> u64 {
    1000 + 10 * u64::from(frame)
}

fn stratum() -> Stratum {
    let name = StratumName { object: "quad".to_owned(), material: "paint".to_owned() };
    Stratum { name, object: 0, material: 0, prior_cost: 1.0 }
}

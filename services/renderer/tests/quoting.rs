//! Quotes of a renderer whose costs are known: a line in samples and pixels, which changes over time.

use forelight_protocol::{SceneDigest, Varied};
use forelight_renderer::door::RendererId;
use forelight_renderer::door::{
    Artefact, BlockCosts, Capabilities, Capability, Common, Cost, Description, FixedCosts, FrameCounts,
    Frames, Limits, Measured, Part, PieceCost, PixelCount, PreviewBackend, Region, Rendered, RendererError,
    Run, Settings, Shot, Stopping,
};
use forelight_renderer::{ShotQuote, Wanted, locates_costs, quote_shot};
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

/// Starting the program, nanoseconds.
const START: u64 = 30_000_000;

struct Known {
    description: Description,
    can: Capabilities,
    /// Cost of a sample of a pixel in frame 0, nanoseconds.
    unit: u64,
    /// Samples of a pixel if pixels stop by their noise.
    stops_at: Option<fn(i32) -> f64>,
    asked: Mutex<Vec<Part>>,
}

impl Known {
    fn new(can: &[Capability], unit: u64) -> Self {
        let description = Description {
            frames: Frames { first: 0, last: 23, step: 1 },
            frames_per_second: 24.0,
            cameras: Vec::new(),
            layers: Vec::new(),
            objects: None,
            materials: None,
            settings: Settings {
                common: Common { width: 320, height: 180, samples: 64, seed: 0 },
                own: Default::default(),
            },
            assets: Vec::new(),
            notes: Vec::new(),
            opening: Cost::default(),
        };
        Self {
            description,
            can: can.iter().copied().collect(),
            unit,
            stops_at: None,
            asked: Mutex::default(),
        }
    }

    /// A region's pixels cost more at the right.
    fn cost(&self, frame: i32, samples: u32, region: Region, width: u32) -> u64 {
        let unit = self.unit + self.unit * u64::from(frame.unsigned_abs()) / 24;
        let centre = f64::from(2 * region.x + region.width) / f64::from(2 * width);
        let pixels = f64::from(region.width * region.height) * (0.5 + centre);
        START + (pixels * (u64::from(samples) * unit) as f64) as u64
    }

    fn truth(&self) -> f64 {
        let Common { width, height, samples, .. } = self.description.settings.common;
        let whole = Region { x: 0, y: 0, width, height };
        let cost =
            |frame, samples: f64| START as f64 + (self.cost(frame, 1, whole, width) - START) as f64 * samples;
        (0..24).map(|frame| cost(frame, self.stops_at.map_or(f64::from(samples), |stops| stops(frame)))).sum()
    }

    fn quote(&self) -> ShotQuote {
        let cancelled = AtomicBool::new(false);
        let run = Run::silent(&cancelled, Path::new("/"), Limits::default());
        let frames: Vec<u32> = (0..24).collect();
        let id = RendererId { name: "known".to_owned(), version: "1".to_owned() };
        let (of, settings) = (("shot", SceneDigest([0; 32])), &self.description.settings);
        let wanted = Wanted { frames: Some(5), ..Wanted::default() };
        quote_shot((&id, self), of, &frames, settings, wanted, &|_| {}, &run).unwrap()
    }
}

impl Shot for Known {
    fn description(&self) -> &Description {
        &self.description
    }

    fn capabilities(&self, _: &Settings) -> Capabilities {
        self.can.clone()
    }

    fn preview(
        &self,
        frames: &[i32],
        settings: &Settings,
        _: &Run<'_>,
    ) -> Result<Vec<FrameCounts>, RendererError> {
        let whole = PixelCount { object: None, material: None, pixels: settings.pixels() };
        let counts = |&frame| FrameCounts {
            frame,
            counts: vec![whole],
            sampled_pixels: 0,
            backend: PreviewBackend::Renderer,
            cost: Cost::default(),
        };
        Ok(frames.iter().map(counts).collect())
    }

    fn measure(
        &self,
        frame: i32,
        settings: &Settings,
        part: &Part,
        _: &Run<'_>,
    ) -> Result<Measured, RendererError> {
        let Common { width, height, samples, .. } = settings.common;
        let whole = Region { x: 0, y: 0, width, height };
        self.asked.lock().unwrap().push(part.clone());
        let pieces: Vec<PieceCost> = match part {
            Part::Regions(regions) => regions
                .iter()
                .map(|&region| PieceCost { region, cpu_nanos: self.cost(frame, samples, region, width) })
                .collect(),
            &Part::Samples { count, .. } => {
                vec![PieceCost { region: whole, cpu_nanos: self.cost(frame, count, whole, width) }]
            }
            Part::Pixels(_) => Vec::new(),
        };
        let cpu_nanos = pieces.iter().map(|piece| piece.cpu_nanos).sum();
        Ok(Measured {
            cost: Cost { cpu_nanos, ..Cost::default() },
            fixed: FixedCosts::new(),
            pieces,
            strata: Vec::new(),
            // The lower blocks have 20 rows of pixels.
            blocks: self.can.contains(&Capability::LocateCosts).then(|| {
                let nanos = |(x, y, height)| {
                    self.cost(frame, samples, Region { x, y, width: 160, height }, width) - START
                };
                let nanos = [(0, 0, 160), (160, 0, 160), (0, 160, 20), (160, 160, 20)].map(nanos).to_vec();
                BlockCosts { side: 160, columns: 2, nanos }
            }),
            ids: None,
            artefact: None,
            stopping: self.stops_at.filter(|_| matches!(part, Part::Samples { offset: 0, .. })).map(
                |stops| Stopping {
                    samples: stops(frame),
                    cost: Cost { cpu_nanos: START, ..Cost::default() },
                },
            ),
        })
    }

    fn render(&self, _: i32, _: &Settings, _: &[Artefact], _: &Run<'_>) -> Result<Rendered, RendererError> {
        Err(RendererError::Unsupported("nothing is rendered here".to_owned()))
    }
}

#[test]
fn any_renderer_is_quoted_by_what_it_can() {
    for (can, varied, within) in [
        (&[Capability::MeasureSamples, Capability::Resize][..], Varied::Samples, 0.01),
        (&[Capability::Resize, Capability::MeasureRegions], Varied::Size, 0.01),
        (&[Capability::MeasureRegions], Varied::Regions, 0.03),
        (&[], Varied::Nothing, 0.01),
    ] {
        let shot = Known::new(can, 1000);
        let quote = shot.quote();
        let truth = shot.truth() * 1e-9;
        assert!(quote.measured.iter().all(|frame| frame.result.varied == varied));
        let error = quote.document.total.cpu_seconds.mean / truth - 1.0;
        assert!(error.abs() < within, "{varied:?}: {error}");
        assert_eq!(quote.measured.len(), 5);
        // Frames are chosen over all of the time.
        let early = quote.measured.iter().filter(|frame| frame.result.frame < 12).count();
        assert!((2..=3).contains(&early), "{:?}", quote.measured);
        let share = quote.document.spent.cpu_seconds / truth;
        println!("{varied:?}: error {error:+.4}, {share:.3} of the cost");
        assert!(share < if varied == Varied::Nothing { 0.25 } else { 0.05 }, "{varied:?}: {share}");
    }
}

#[test]
fn a_renderer_whose_pixels_stop_by_their_noise_is_quoted_by_the_samples_that_they_take() {
    let shot = Known {
        stops_at: Some(|frame| 20.3 + 0.1 * f64::from(frame)),
        ..Known::new(&[Capability::MeasureSamples], 1000)
    };
    let quote = shot.quote();
    let error = quote.document.total.cpu_seconds.mean / (shot.truth() * 1e-9) - 1.0;
    assert!(error.abs() < 0.01, "{error}");
    // What it costs to know that is part of the quote.
    let spent: u64 = quote.measured.iter().map(|frame| frame.result.spent.cpu_nanos).sum();
    let asked = |part: &Part| matches!(part, Part::Samples { count, .. } if *count <= 20 / 4);
    assert!(spent > 5 * 2 * START && shot.asked.lock().unwrap().iter().all(asked), "{spent}");
}

#[test]
fn pixels_of_a_measured_frame_add_up_to_its_forecast_without_fixed_costs() {
    let shot = Known::new(&[Capability::MeasureSamples, Capability::LocateCosts], 1000);
    let settings = &shot.description.settings;
    assert!(locates_costs(&shot, settings));
    let quote = shot.quote();
    let (frame, costs) = quote.pixel_costs(settings).unwrap().unwrap();
    let forecast = quote.document.frames.iter().find(|forecast| forecast.frame == frame).unwrap();
    let sum = costs.iter().sum::<f64>() + START as f64;
    assert!((sum * 1e-9 / forecast.cpu_seconds.mean - 1.0).abs() < 1e-3, "{sum} {:?}", forecast.cpu_seconds);
    // A pixel costs 0.75 in the left half, and 1.25 in the right one.
    let [left, right] = [&costs[..160], &costs[320 * 170 + 160..320 * 171]];
    let ratio = right.iter().sum::<f64>() / left.iter().sum::<f64>();
    assert!((ratio * 0.75 / 1.25 - 1.0).abs() < 1e-6, "{ratio}");
    for can in [&[Capability::MeasureSamples][..], &[Capability::Resize, Capability::LocateCosts]] {
        let shot = Known::new(can, 1000);
        assert!(!locates_costs(&shot, settings));
    }
    assert_eq!(Known::new(&[Capability::Resize], 1000).quote().pixel_costs(settings).unwrap(), None);
}

#[test]
fn more_is_measured_where_fixed_costs_hide_what_is_varied() {
    let measured = |unit| {
        let shot = Known::new(&[Capability::Resize], unit);
        shot.quote();
        shot.asked.into_inner().unwrap().len()
    };
    // Two sizes of each of five frames, and a third of two of them.
    assert_eq!((measured(1000), measured(1)), (12, 15));
}

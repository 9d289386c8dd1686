//! `forelight bench renderers`: quotes shots of other renderers with several seeds, and compares them with the
//! full renders.
//!
//! Quotes and renders alternate, and so do scenes, so that a machine that slows down slows all. The true cost of a
//! frame is the median of its renders.
//!
//! A quote and the render of its seed are also what a farm has of a job: see [`coverage`].

mod coverage;

use crate::report::Report;
use crate::statistics::{mean_absolute, median, relative_error};
use anyhow::{Context, Result};
use forelight_protocol::{FrameSet, Quantiles, SceneDigest};
use forelight_renderer::door::{Cost, Rendered, RendererId, Settings};
use forelight_renderer::{ShotQuote, Wanted, quote_shot};
use forelight_terminal::atomic_file;
use forelight_terminal::failure::Interrupted;
use forelight_terminal::foreign::{Foreign, OwnSetting, own_setting};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::json_file;
use forelight_terminal::options::{MachineOptions, QualityOptions};
use forelight_terminal::output::Bars;
use forelight_terminal::quantities::seconds;
use forelight_terminal::table::{Align, Table};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Quote shots of other renderers with many seeds, and compare with their full renders
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight bench renderers kitchen.blend --frames 0 --samples 64,256 --seeds 5
  forelight bench renderers hall.blend --frames 0-47 --samples 32 --seeds 1
  forelight bench renderers hall.rif --frames 1 --pixels 256 --seeds 30 --set ambient_accuracy=0
  forelight bench renderers hall.blend --frames 0 --samples 64 --set adaptive_sampling=true --set noise_threshold=0.1

Costs are CPU time, so nothing else should run on the machine. Every frame is rendered once for each seed. \
With some dozens of quotes of a renderer, a second table says how often its jobs cost at most P80 and P95.")]
pub struct Args {
    /// Scenes of other renderers, such as .blend and .rif files
    #[arg(required = true)]
    scenes: Vec<PathBuf>,
    /// Frames, such as 0-47 or 0,5,9-12 [default: the whole shot]
    #[arg(long, value_name = "LIST")]
    frames: Option<FrameSet>,
    /// Samples per pixel to try [default: --spp, or the scene's]
    #[arg(long, value_name = "LIST", value_delimiter = ',', conflicts_with = "spp")]
    samples: Vec<u32>,
    /// Seeds to try
    #[arg(long, value_name = "COUNT", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    seeds: u32,
    /// Largest number of frames to measure [default: 5]
    #[arg(long, value_name = "FRAMES", value_parser = clap::value_parser!(u32).range(1..=1000))]
    profile_frames: Option<u32>,
    /// Pixels to profile in each measured frame, if the renderer measures single pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pixels: u32,
    /// Change a setting of the scene, such as adaptive_sampling=false. May be repeated
    #[arg(long = "set", value_name = "NAME=VALUE", value_parser = own_setting())]
    own: Vec<OwnSetting>,
    /// Also write the measurements to this file as JSON
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Print the measurements as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    quality: QualityOptions,
    #[command(flatten)]
    machine: MachineOptions,
}

/// One scene at one number of samples.
#[derive(Debug, Serialize)]
struct Case {
    scene: String,
    renderer: RendererId,
    settings: Settings,
    frames: Vec<u32>,
    /// True cost of all frames: the sum of the frames' medians.
    actual_cpu_seconds: f64,
    /// Mean over seeds of |forecast mean / actual − 1| of all frames together.
    error: f64,
    /// Mean over seeds of forecast mean / actual − 1 of all frames together.
    bias: f64,
    /// Mean over seeds of Σ |forecast − actual| / Σ actual over the frames.
    frame_error: f64,
    /// Error of first, middle and last frame at full price, interpolated over time. `None` for few frames.
    three_frames_error: Option<f64>,
    /// Largest difference of the renders of a frame from their median.
    noise: f64,
    /// Cost of a quote, relative to the actual cost: the mean.
    spent_fraction: f64,
    /// The part of that which renders cannot take over.
    lost_fraction: f64,
    seeds: Vec<Trial>,
}

#[derive(Debug, Serialize)]
struct Trial {
    seed: u32,
    cpu_seconds: Quantiles,
    /// Standard deviation of the logarithm, as calibration takes it.
    spread: f64,
    /// Signed, relative to the actual.
    error: f64,
    /// Measured frames.
    measured: Vec<u32>,
    frames: Vec<f64>,
    spent_cpu_seconds: f64,
    /// CPU seconds of measured samples that a render takes over.
    taken_over_cpu_seconds: f64,
    /// CPU seconds of each frame's render.
    rendered: Vec<f64>,
}

pub fn run(args: &Args, interrupt: &Interrupt) -> Result<Report> {
    atomic_file::check([args.out.as_deref()])?;
    let bars = Bars::new(args.json);
    let samples: Vec<Option<u32>> = match args.samples.as_slice() {
        [] => vec![args.quality.spp],
        list => list.iter().copied().map(Some).collect(),
    };
    let open = |scene: &PathBuf| Foreign::open(scene, &args.machine, &bars, interrupt);
    let opened: Vec<Foreign> = args.scenes.iter().map(open).collect::<Result<_>>()?;
    let mut shots = Vec::new();
    for (scene, foreign) in args.scenes.iter().zip(&opened) {
        for &spp in &samples {
            let quality = QualityOptions { spp, ..args.quality.clone() };
            shots.push(ToMeasure::new(args, scene, foreign, &quality)?);
        }
    }
    let steps: usize = shots.iter().map(|shot| shot.frames.len() + 1).sum();
    let bar = bars.bar("quoting and rendering", u64::from(args.seeds) * steps as u64);
    let mut trials: Vec<Vec<Trial>> = shots.iter().map(|_| Vec::new()).collect();
    for seed in 0..args.seeds {
        for (shot, trials) in shots.iter().zip(&mut trials) {
            let trial = shot.trial(args, seed, &|| bar.inc(1), interrupt);
            trials.push(trial.with_context(|| format!("scene {}", shot.name))?);
        }
    }
    bar.finish_and_clear();
    let cases: Vec<Case> = shots.into_iter().zip(trials).map(|(shot, trials)| case(shot, trials)).collect();
    json_file::write(args.out.as_deref(), &cases)?;
    report(&cases).printed(args.json, &cases)
}

/// A shot to quote and render.
struct ToMeasure<'a> {
    foreign: &'a Foreign,
    name: String,
    digest: SceneDigest,
    settings: Settings,
    frames: Vec<u32>,
}

impl<'a> ToMeasure<'a> {
    fn new(args: &Args, scene: &Path, foreign: &'a Foreign, quality: &QualityOptions) -> Result<Self> {
        let settings = foreign.settings(quality, &args.own)?;
        let frames = foreign.frames(args.frames.as_ref())?;
        let (name, digest) = foreign.scene(scene)?;
        Ok(Self { foreign, name, digest, settings, frames })
    }

    /// Quotes and renders the shot with another seed.
    fn trial(&self, args: &Args, seed: u32, step: &dyn Fn(), interrupt: &Interrupt) -> Result<Trial> {
        let Self { foreign, name, digest, settings, frames } = self;
        let mut settings = settings.clone();
        settings.common.seed = settings.common.seed.wrapping_add(seed);
        let run = foreign.run(interrupt);
        let shot = (foreign.renderer.id(), &*foreign.shot);
        let frames_at_most = args.profile_frames.map(|most| most as usize);
        let wanted = Wanted { frames: frames_at_most, samples: args.pixels, seed: u64::from(seed) };
        let quote = quote_shot(shot, (name, *digest), frames, &settings, wanted, &|_| {}, &run)?;
        step();
        let mut rendered = Vec::with_capacity(frames.len());
        for &frame in frames {
            if interrupt.is_set() {
                return Err(Interrupted.into());
            }
            let number = i32::try_from(frame).context("the frame's number is too large")?;
            let Rendered { cost: Cost { cpu_nanos, .. }, files, .. } =
                foreign.shot.render(number, &settings, &[], &run)?;
            files.iter().try_for_each(std::fs::remove_file).context("cannot remove the image")?;
            rendered.push(cpu_nanos as f64 * 1e-9);
            step();
        }
        Ok(trial(settings.common.seed, &quote, rendered))
    }
}

fn trial(seed: u32, quote: &ShotQuote, rendered: Vec<f64>) -> Trial {
    let shares = quote.measured.iter().flat_map(|frame| &frame.result.shares);
    let of_pixels = quote.profiled.iter().map(|profile| &profile.artefact);
    for artefact in quote.measured.iter().flat_map(|frame| &frame.artefacts).chain(of_pixels) {
        // It is not used here, and a file that cannot be removed only takes space.
        let _ = std::fs::remove_file(&artefact.path);
    }
    Trial {
        seed,
        cpu_seconds: quote.document.total.cpu_seconds,
        spread: quote.spread,
        error: 0.0,
        measured: quote.document.profiled.frames.clone(),
        frames: quote.document.frames.iter().map(|frame| frame.cpu_seconds.mean).collect(),
        spent_cpu_seconds: quote.document.spent.cpu_seconds,
        taken_over_cpu_seconds: (shares.map(|share| share.cpu_nanos).sum::<u64>()
            + quote.profiled.iter().map(|profile| profile.taken_over_nanos).sum::<u64>())
            as f64
            * 1e-9,
        rendered,
    }
}

fn case(shot: ToMeasure<'_>, mut seeds: Vec<Trial>) -> Case {
    let ToMeasure { foreign, name: scene, settings, frames, .. } = shot;
    let of_frame =
        |frame: usize| median(&seeds.iter().map(|trial| trial.rendered[frame]).collect::<Vec<_>>());
    let actual: Vec<f64> = (0..frames.len()).map(of_frame).collect();
    let whole: f64 = actual.iter().sum();
    let noise = seeds
        .iter()
        .flat_map(|trial| trial.rendered.iter().zip(&actual))
        .map(|(&one, &median)| relative_error(one, median).abs())
        .fold(0.0, f64::max);
    for trial in &mut seeds {
        trial.error = relative_error(trial.cpu_seconds.mean, whole);
    }
    let wape = |trial: &Trial| {
        let off: f64 =
            trial.frames.iter().zip(&actual).map(|(forecast, actual)| (forecast - actual).abs()).sum();
        off / whole
    };
    let count = seeds.len() as f64;
    let spent: f64 = seeds.iter().map(|trial| trial.spent_cpu_seconds).sum::<f64>() / count / whole;
    let taken: f64 = seeds.iter().map(|trial| trial.taken_over_cpu_seconds).sum::<f64>() / count / whole;
    Case {
        scene,
        renderer: foreign.renderer.id().clone(),
        settings,
        actual_cpu_seconds: whole,
        error: mean_absolute(seeds.iter().map(|trial| trial.error)),
        bias: seeds.iter().map(|trial| trial.error).sum::<f64>() / count,
        frame_error: seeds.iter().map(wape).sum::<f64>() / count,
        three_frames_error: three_frames(&actual).map(|forecast| relative_error(forecast, whole)),
        noise,
        spent_fraction: spent,
        lost_fraction: (spent - taken).max(0.0),
        frames,
        seeds,
    }
}

/// Cost of all frames from the first, the middle and the last one, interpolated over time: what practice
/// does.
fn three_frames(costs: &[f64]) -> Option<f64> {
    let (first, last) = (0, costs.len().checked_sub(1).filter(|&last| last >= 3)?);
    let middle = last / 2;
    let between = |from: usize, to: usize, frame: usize| {
        let share = (frame - from) as f64 / (to - from) as f64;
        costs[from] + share * (costs[to] - costs[from])
    };
    let of_frame = |frame| {
        if frame <= middle { between(first, middle, frame) } else { between(middle, last, frame) }
    };
    Some((0..costs.len()).map(of_frame).sum())
}

fn report(cases: &[Case]) -> Report {
    let mut table = Table::new(&[
        ("scene", Align::Left),
        ("renderer", Align::Left),
        ("samples", Align::Right),
        ("frames", Align::Right),
        ("CPU time", Align::Right),
        ("error", Align::Right),
        ("bias", Align::Right),
        ("of frames", Align::Right),
        ("3 frames", Align::Right),
        ("quote costs", Align::Right),
        ("lost", Align::Right),
        ("noise", Align::Right),
    ]);
    let share = |fraction: f64| format!("{:.1} %", fraction * 100.0);
    for case in cases {
        table.row([
            case.scene.clone(),
            case.renderer.to_string(),
            case.settings.common.samples.to_string(),
            case.frames.len().to_string(),
            seconds(case.actual_cpu_seconds),
            share(case.error),
            format!("{:+.1} %", case.bias * 100.0),
            share(case.frame_error),
            case.three_frames_error.map_or_else(String::new, |error| share(error.abs())),
            share(case.spent_fraction),
            share(case.lost_fraction),
            share(case.noise),
        ]);
    }
    let seeds = cases.first().map_or(0, |case| case.seeds.len());
    let note = format!(
        "\nMeans of |forecast / actual - 1| over {seeds} seeds: of all frames together, and of single frames \
         (WAPE). \"bias\": mean of forecast / actual - 1 of all frames together. \"3 frames\": first, middle and \
         last frame at full price. \"lost\": what renders cannot take over. \"noise\": largest difference of a render \
         from the median of its seeds.\n\n"
    );
    let jobs = coverage::table(cases);
    let jobs_note = "\nJobs in the order in which they ended: the share whose cost is at most the quote's quantile, as \
                     quoted, and as calibrated by the jobs before. Intervals (95 %) take jobs as independent.\n";
    Report::default().table(table).text(&note).table(jobs).text(jobs_note)
}

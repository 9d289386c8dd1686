//! `forelight bench shots`: all frames of shots, forecast from a few of them, against the full render of each, and against what farms
//! do instead.

mod plot;
mod practice;
mod report;
mod truth;

use crate::conventions::slug;
use crate::statistics::{mean_absolute, relative_error};
use anyhow::{Context, Result};
use forelight_protocol::{CacheMode, FrameSet, Quantiles, RenderSettings, RenderStats, Spent};
use forelight_terminal::atomic_file::{self, write_bytes};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::local::Local;
use forelight_terminal::options::{MachineOptions, QualityOptions};
use forelight_terminal::output::{self, Bars};
use forelight_terminal::watching::QuoteWatcher;
use forelight_worker::{Quote, QuoteOptions, Renderer};
use practice::Practice;
use serde::Serialize;
use std::path::PathBuf;

/// Forecast shots from a few of their frames, against the full render of all, and against what farms do instead
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight bench shots kitchen/ corridor/
  forelight bench shots kitchen/ --frames 0-47 --width 192 --spp 16 --truth rendered/ --svg plots/
  forelight bench shots corridor/ --profile-frames 12 --samples 128 --seeds 10 --json > shots.json

Every frame is previewed, a few are profiled, all are forecast, as by `forelight forecast`; then every frame is rendered whole. \
Beside the forecast stands what farms do today: render one frame, the first, the middle and the last, or every tenth, and \
take the others to be like these; at the price of the same full renders.

The profiled pixels are finished pixels, which a render takes over. What the quote takes \"for good\" is the rest: previews, and \
setting up the profiled frames. Images are small unless a size is asked for, so that the truth is known in minutes; the share of the shot that a quote \
takes falls with the size of the image.")]
pub struct Args {
    /// Scene bundles: folders or zip files
    #[arg(required = true, value_name = "BUNDLE")]
    bundles: Vec<PathBuf>,
    /// Frames, such as 0-47 or 0,5,9-12 [default: the first 48 of the shot]
    #[arg(long, value_name = "LIST")]
    frames: Option<FrameSet>,
    /// Pixels to profile in a profiled frame, 1 to a million
    #[arg(long, value_name = "PIXELS", default_value_t = QuoteOptions::default().samples, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    samples: u32,
    /// Frames to profile at most [default: 5, and up to 16 if that leaves the forecast unsure and more would cost less than 1 % of the shot]
    #[arg(long, value_name = "FRAMES", value_parser = clap::value_parser!(u32).range(1..=1000))]
    profile_frames: Option<u32>,
    /// Quotes to make, each with another choice of pixels
    #[arg(long, value_name = "COUNT", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    seeds: u32,
    /// Keep what full renders took in this folder, and render no frame whose cost lies there already
    #[arg(long, value_name = "DIR")]
    truth: Option<PathBuf>,
    /// Write a plot of every shot into this folder: cost by frame, with the forecast's band and the truth
    #[arg(long, value_name = "DIR")]
    svg: Option<PathBuf>,
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

/// Image width, camera samples and ambient bounces unless others are asked for.
const SMALL: (u32, u32, u32) = (128, 4, 1);

/// Frames of a shot unless others are asked for.
const FRAMES: usize = 48;

/// A shot, forecast and rendered.
#[derive(Debug, Serialize)]
pub struct Measured {
    bundle: String,
    width: u32,
    height: u32,
    spp: u32,
    ambient_bounces: u32,
    cache: CacheMode,
    samples: u32,
    /// Work of all frames.
    actual_work: f64,
    /// CPU seconds of all frames, as measured when they were rendered.
    actual_cpu_seconds: f64,
    /// Over all quotes.
    forecast: Outcome,
    /// What farms do instead.
    practices: Vec<PracticeOutcome>,
    /// One for each seed.
    quotes: Vec<Trial>,
    /// The first quote, frame by frame.
    frames: Vec<Frame>,
}

impl Measured {
    /// The error of the total over that which the mean of first, middle and last frame has; absent where that has none.
    fn against_first_middle_last(&self) -> Option<f64> {
        let theirs = self.practices.iter().find(|p| p.practice == Practice::FirstMiddleLast)?.outcome;
        (theirs.total_error > 0.0).then(|| self.forecast.total_error / theirs.total_error)
    }
}

/// How good a way to say what a shot costs was, and what it took.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Outcome {
    /// |forecast / actual − 1| of the work of the whole shot; of several quotes the mean.
    total_error: f64,
    /// Σ |forecast − actual| / Σ actual over the frames' work (weighted absolute percentage error); of several quotes the mean.
    wape: f64,
    /// Work that it takes as a share of the shot's.
    spent: f64,
    /// The part of it that renders do not get back.
    spent_for_good: f64,
}

#[derive(Debug, Serialize)]
struct PracticeOutcome {
    practice: Practice,
    #[serde(flatten)]
    outcome: Outcome,
}

/// One quote.
#[derive(Debug, Serialize)]
struct Trial {
    seed: u64,
    profiled: Vec<u32>,
    work: Total,
    cpu_seconds: Total,
    wape: f64,
    /// Mean over frames of |forecast mean / actual − 1|.
    frame_error_work: f64,
    frame_error_cpu_seconds: f64,
    /// Share of the frames whose actual work was at or below the quantile.
    frames_within_p80: f64,
    frames_within_p95: f64,
    spent: Shares,
    spent_for_good: Shares,
}

#[derive(Debug, Serialize)]
struct Total {
    forecast: Quantiles,
    actual: f64,
    /// Signed, relative to the actual.
    error: f64,
}

impl Total {
    fn new(forecast: Quantiles, actual: f64) -> Self {
        Self { forecast, actual, error: relative_error(forecast.mean, actual) }
    }
}

/// Of the actual total.
#[derive(Debug, Clone, Copy, Serialize)]
struct Shares {
    work: f64,
    cpu_seconds: f64,
}

#[derive(Debug, Serialize)]
struct Frame {
    frame: u32,
    profiled: bool,
    work: Total,
    cpu_seconds: Total,
}

/// Runs the command.
pub fn run(args: &Args, interrupt: &Interrupt) -> Result<()> {
    atomic_file::check([args.out.as_deref()])?;
    let bars = Bars::new(args.json);
    let mut shots = Vec::with_capacity(args.bundles.len());
    for bundle in &args.bundles {
        let local = Local::open(bundle, &args.machine, &bars)?;
        let measured = measure(args, &local, bundle, &bars, interrupt);
        shots.push(measured.with_context(|| format!("bundle {}", bundle.display()))?);
    }
    if let Some(folder) = &args.svg {
        for (place, shot) in shots.iter().enumerate() {
            let path = folder.join(format!("{}.svg", slug(place, &shot.bundle)));
            write_bytes(&path, plot::svg(shot)?.as_bytes())?;
        }
    }
    if let Some(path) = &args.out {
        write_bytes(path, (output::pretty(&shots)? + "\n").as_bytes())?;
    }
    if args.json { output::json(&shots) } else { output::print(&report::text(&shots)) }
}

fn measure(
    args: &Args,
    local: &Local,
    bundle: &std::path::Path,
    bars: &Bars,
    interrupt: &Interrupt,
) -> Result<Measured> {
    let mut quality = args.quality.clone();
    if quality.width.is_none() && quality.height.is_none() {
        quality.width = Some(SMALL.0);
    }
    quality.spp = quality.spp.or(Some(SMALL.1));
    quality.ambient_bounces = quality.ambient_bounces.or(Some(SMALL.2));
    let settings = local.settings(&quality)?;
    let mut frames = local.frames(args.frames.as_ref())?;
    if args.frames.is_none() {
        frames.truncate(FRAMES);
    }
    let mut quotes = Vec::with_capacity(args.seeds as usize);
    for seed in 0..u64::from(args.seeds) {
        let options = QuoteOptions {
            samples: args.samples,
            profile_frames: args.profile_frames.map(|frames| frames as usize),
            seed,
            ..QuoteOptions::default()
        };
        let watcher = QuoteWatcher::new(bars, frames.len(), interrupt);
        quotes.push((seed, watcher.quote(local, bundle, &frames, &settings, &options)?));
    }
    let actual = truth::of_frames(local, &frames, &settings, args.truth.as_deref(), bars, interrupt)?;
    Ok(compare(&local.shot.info().summary.name, &settings, args.samples, &quotes, &actual))
}

fn compare(
    bundle: &str,
    settings: &RenderSettings,
    samples: u32,
    quotes: &[(u64, Quote)],
    actual: &[RenderStats],
) -> Measured {
    let work: Vec<f64> = actual.iter().map(|stats| stats.work as f64).collect();
    let total = work.iter().sum::<f64>();
    let trials: Vec<Trial> = quotes.iter().map(|(seed, quote)| trial(*seed, quote, actual)).collect();
    let mean = |of: &dyn Fn(&Trial) -> f64| trials.iter().map(of).sum::<f64>() / trials.len().max(1) as f64;
    let practices = Practice::ALL.map(|practice| {
        let said = practice.forecast(&work);
        let spent = practice.rendered(work.len()).iter().map(|&t| work[t]).sum::<f64>() / total;
        // Rendered frames are finished frames.
        let outcome = Outcome {
            total_error: relative_error(said.iter().sum(), total).abs(),
            wape: wape(&said, &work),
            spent,
            spent_for_good: 0.0,
        };
        PracticeOutcome { practice, outcome }
    });
    let frames = quotes.first().map(|(_, quote)| frames(quote, actual)).unwrap_or_default();
    Measured {
        bundle: bundle.to_owned(),
        width: settings.width,
        height: settings.height,
        spp: settings.spp,
        ambient_bounces: settings.ambient_bounces,
        cache: settings.cache,
        samples,
        actual_work: total,
        actual_cpu_seconds: actual.iter().map(|stats| stats.cpu_seconds).sum(),
        forecast: Outcome {
            total_error: mean(&|trial| trial.work.error.abs()),
            wape: mean(&|trial| trial.wape),
            spent: mean(&|trial| trial.spent.work),
            spent_for_good: mean(&|trial| trial.spent_for_good.work),
        },
        practices: practices.into(),
        quotes: trials,
        frames,
    }
}

fn frames(quote: &Quote, actual: &[RenderStats]) -> Vec<Frame> {
    let document = &quote.document;
    let frame = |(forecast, actual): (&forelight_protocol::FrameForecast, &RenderStats)| Frame {
        frame: actual.frame,
        profiled: document.profiled.frames.contains(&actual.frame),
        work: Total::new(forecast.work, actual.work as f64),
        cpu_seconds: Total::new(forecast.cpu_seconds, actual.cpu_seconds),
    };
    document.frames.iter().zip(actual).map(frame).collect()
}

fn trial(seed: u64, quote: &Quote, actual: &[RenderStats]) -> Trial {
    let document = &quote.document;
    let frames = frames(quote, actual);
    let work: f64 = actual.iter().map(|stats| stats.work as f64).sum();
    let cpu_seconds: f64 = actual.iter().map(|stats| stats.cpu_seconds).sum();
    let shares = |spent: Spent| Shares {
        work: spent.work as f64 / work,
        cpu_seconds: forelight_worker::seconds(spent.cpu_nanos) / cpu_seconds,
    };
    let within = |quantile: fn(&Quantiles) -> f64| {
        let held = frames.iter().filter(|f| f.work.actual <= quantile(&f.work.forecast));
        held.count() as f64 / frames.len().max(1) as f64
    };
    let said: Vec<f64> = frames.iter().map(|frame| frame.work.forecast.mean).collect();
    let is: Vec<f64> = frames.iter().map(|frame| frame.work.actual).collect();
    Trial {
        seed,
        profiled: document.profiled.frames.clone(),
        work: Total::new(document.total.work, work),
        cpu_seconds: Total::new(document.total.cpu_seconds, cpu_seconds),
        wape: wape(&said, &is),
        frame_error_work: mean_absolute(frames.iter().map(|f| f.work.error)),
        frame_error_cpu_seconds: mean_absolute(frames.iter().map(|f| f.cpu_seconds.error)),
        frames_within_p80: within(|q| q.p80),
        frames_within_p95: within(|q| q.p95),
        spent: shares(quote.spent()),
        spent_for_good: shares(quote.spent_for_good()),
    }
}

/// Σ |forecast − actual| / Σ actual; 0 where nothing was forecast and nothing was to be.
fn wape(forecast: &[f64], actual: &[f64]) -> f64 {
    let off: f64 = forecast.iter().zip(actual).map(|(forecast, actual)| (forecast - actual).abs()).sum();
    if off == 0.0 { 0.0 } else { off / actual.iter().sum::<f64>() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_terminal::options::parsed;

    const SCENE: &str = r#"{"version":1,"name":"a block","geometry":["t.obj"],
        "lights":[{"type":"point","position":[2,5,3],"intensity":[40,40,40]}],
        "camera":{"origin":[0,3,6],"target":[0,0,0],"up":[0,1,0],"fov_deg":50,"fov_axis":"x","width":16,"height":9},
        "animation":{"fps":24,"frames":60,"tracks":[{"target":"camera","property":"origin","interpolation":"linear",
            "keys":[{"frame":0,"value":[0,3,6]},{"frame":59,"value":[0,3,12]}]}]}}"#;
    const MESH: &str = "o floor\nv -9 0 -9\nv 9 0 -9\nv 9 0 9\nv -9 0 9\nf 1 4 3 2\n\
                        o block\nv -1 0 0\nv 1 0 0\nv 1 2 0\nv -1 2 0\nf 5 6 7 8\n";

    fn measured(folder: &std::path::Path, flags: &[&str]) -> Measured {
        std::fs::write(folder.join("scene.json"), SCENE).unwrap();
        std::fs::write(folder.join("t.obj"), MESH).unwrap();
        let bundle = folder.display().to_string();
        let fixed = ["shots", &bundle, "--json", "--preview", "cpu"];
        let args: Args = parsed(fixed.iter().chain(flags));
        let bars = Bars::new(true);
        let local = Local::open(folder, &args.machine, &bars).unwrap();
        let found = measure(&args, &local, folder, &bars, &Interrupt::default()).unwrap();
        run(&args, &Interrupt::default()).unwrap();
        found
    }

    #[test]
    fn a_shot_is_measured_at_its_first_48_frames_and_plotted_and_a_second_time_nothing_is_rendered() {
        let folder = tempfile::tempdir().unwrap();
        let (kept, plots) = (folder.path().join("kept"), folder.path().join("plots"));
        let (kept_name, plots_name) = (kept.display().to_string(), plots.display().to_string());
        let flags =
            ["--width", "16", "--spp", "1", "--samples", "40", "--truth", &kept_name, "--svg", &plots_name];
        let first = measured(folder.path(), &flags);
        assert_eq!((first.frames.len(), first.quotes.len(), first.practices.len()), (48, 3, 4));
        assert!(first.forecast.total_error < 0.2 && first.forecast.wape >= first.forecast.total_error * 0.99);
        assert!(first.forecast.spent >= first.forecast.spent_for_good);
        let files: Vec<_> = std::fs::read_dir(&kept).unwrap().map(|file| file.unwrap().path()).collect();
        assert_eq!(files.len(), 48);
        // Whoever changes what was kept is believed: so it was read.
        let mut stats: RenderStats = json_file(&files[0]);
        stats.work *= 1000;
        std::fs::write(&files[0], serde_json::to_string(&stats).unwrap()).unwrap();
        let second = measured(folder.path(), &flags);
        assert!(second.actual_work > 2.0 * first.actual_work);
        let plot = std::fs::read_to_string(plots.join("1-a-block.svg")).unwrap();
        roxmltree::Document::parse(&plot).unwrap();
        assert!(!plot.contains("NaN"));
    }

    fn json_file(path: &std::path::Path) -> RenderStats {
        forelight_terminal::json_file::read(path).unwrap()
    }

    #[test]
    fn all_pixels_of_all_frames_leave_no_error() {
        let folder = tempfile::tempdir().unwrap();
        let flags =
            ["--width", "8", "--spp", "1", "--samples", "1000", "--profile-frames", "9", "--frames", "0-8"];
        let found = measured(folder.path(), &flags);
        assert!(found.forecast.wape < 1e-9, "{}", found.forecast.wape);
        assert_eq!(found.quotes[0].profiled.len(), 9);
    }

    #[test]
    fn errors_of_frames_do_not_cancel_in_the_weighted_error() {
        assert_eq!(wape(&[150.0, 50.0], &[100.0, 100.0]), 0.5);
        assert_eq!(wape(&[0.0], &[0.0]), 0.0);
    }
}

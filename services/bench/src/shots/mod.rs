//! `forelight bench shots`: forecasts shots from a few of their frames, and compares with full renders and
//! current practice.

mod measured;
mod plot;
mod practice;
mod report;
mod truth;

use crate::conventions::slug;
use crate::report::Report;
use anyhow::{Context, Result};
use forelight_protocol::FrameSet;
use forelight_renderer_own::QuoteOptions;
use forelight_terminal::atomic_file::{self, write_bytes};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::json_file;
use forelight_terminal::local::Local;
use forelight_terminal::options::{MachineOptions, QualityOptions};
use forelight_terminal::output::Bars;
use forelight_terminal::watching::QuoteWatcher;
use measured::{Measured, compare};
use std::path::PathBuf;

/// Forecast shots from a few of their frames, and compare with full renders and with current practice
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight bench shots kitchen/ corridor/
  forelight bench shots kitchen/ --frames 0-47 --width 192 --spp 16 --truth rendered/ --svg plots/
  forelight bench shots corridor/ --profile-frames 12 --samples 128 --seeds 10 --json > shots.json

Every frame is previewed, a few are profiled, and all are forecast, as by `forelight forecast`. Then every \
frame is rendered in full. The forecast is compared with current practice: render one frame, the first, the \
middle and the last, or every tenth, and extrapolate. Both use the same full renders.

Profiled pixels are finished pixels, which a render takes over. \"Not reused\" is the rest of the quote: \
previews, and setting up the profiled frames. Images are small by default, so that the truth takes minutes. \
The relative cost of a quote falls with the size of the image.")]
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
    /// Maximum number of frames to profile
    /// [default: 5, or up to 16 if the forecast stays uncertain and more cost less than 1 % of the shot]
    #[arg(long, value_name = "FRAMES", value_parser = clap::value_parser!(u32).range(1..=1000))]
    profile_frames: Option<u32>,
    /// Quotes to make, each with another choice of pixels
    #[arg(long, value_name = "COUNT", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    seeds: u32,
    /// Folder for the costs of full renders; frames found there are not rendered
    #[arg(long, value_name = "DIR")]
    truth: Option<PathBuf>,
    /// Folder for a plot of each shot: cost by frame, with the forecast's band and the truth
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

/// Default image width, camera samples and ambient bounces.
const SMALL: (u32, u32, u32) = (128, 4, 1);

const FRAMES: usize = 48;

pub fn run(args: &Args, interrupt: &Interrupt) -> Result<Report> {
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
    json_file::write(args.out.as_deref(), &shots)?;
    report::of(&shots).printed(args.json, &shots)
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

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_protocol::RenderStats;
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
        // The second run must read the changed file.
        let mut stats: RenderStats = stats(&files[0]);
        stats.work *= 1000;
        std::fs::write(&files[0], serde_json::to_string(&stats).unwrap()).unwrap();
        let second = measured(folder.path(), &flags);
        assert!(second.actual_work > 2.0 * first.actual_work);
        let plot = std::fs::read_to_string(plots.join("1-a-block.svg")).unwrap();
        roxmltree::Document::parse(&plot).unwrap();
        assert!(!plot.contains("NaN"));
    }

    fn stats(path: &std::path::Path) -> RenderStats {
        json_file::read(path).unwrap()
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
}

//! `forelight bench paper`: the paper's experiment, whole: seven strategies and two of ours, at four ambient levels, with many seeds.

mod chart;
mod figures;
mod level;
mod noise;
mod picture;
mod report;
mod trial;

use crate::conventions::{PAPER_SIZE, slug};
use anyhow::{Context, Result};
use figures::File;
use forelight_forecast::Strategy;
use forelight_terminal::atomic_file::write_bytes;
use forelight_terminal::failure::Interrupted;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::local::Local;
use forelight_terminal::options::MachineOptions;
use forelight_terminal::output::{self, Bars};
use forelight_worker::Renderer;
use level::{Level, Seen, Task, Truth};
use rayon::prelude::*;
use serde::Serialize;
use std::path::{Path, PathBuf};
use trial::{Columns, Forecast, Outcome, Records, Score};

/// The paper's experiment: nine ways to forecast a frame, at four ambient levels, with many seeds
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight bench paper kitchen/ corridor/
  forelight bench paper kitchen/ --size 128 --seeds 100 --out kitchen-report/
  forelight bench paper kitchen/ --out report/ --json > paper.json

The frame is rendered once at each level, with one camera ray a pixel, and every strategy forecasts it from the costs of its pixels, \
once with each seed. The folder gets report.md, with tables like the paper's 1 to 5 and the ones that it does not print, the \
pictures of its figures 1 to 9, and the error against the number of profiled pixels as SVG.")]
pub struct Args {
    /// Scene bundles: folders or zip files
    #[arg(required = true, value_name = "BUNDLE")]
    bundles: Vec<PathBuf>,
    /// Frame number
    #[arg(long, value_name = "N", default_value_t = 0)]
    frame: u32,
    /// Width and height of the image in pixels
    #[arg(long, value_name = "PIXELS", default_value_t = PAPER_SIZE, value_parser = clap::value_parser!(u32).range(1..=4096))]
    size: u32,
    /// Pixels to profile, 1 to a million
    #[arg(long, value_name = "PIXELS", default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    samples: u32,
    /// Forecasts by each strategy at each level
    #[arg(long, value_name = "COUNT", default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    seeds: u32,
    /// Renders at each level, of whose CPU times the median counts, pixel by pixel
    #[arg(long, value_name = "TIMES", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=99))]
    repeats: u32,
    /// Rays of a gather of indirect light, with a cache and without one: 48, 192, 432, 768, ...
    #[arg(long, value_name = "RAYS", default_value_t = 192, value_parser = clap::value_parser!(u32).range(48..=65_536))]
    gather_rays: u32,
    /// Folder for the report
    #[arg(long, value_name = "DIR", default_value = "report")]
    out: PathBuf,
    /// Print the measurements as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    machine: MachineOptions,
}

/// Numbers of profiled pixels at which errors are compared.
const LADDER: [u32; 5] = [16, 64, 256, 1024, 4096];

/// One bundle's frame.
#[derive(Debug, Serialize)]
pub struct Study {
    bundle: String,
    frame: u32,
    size: u32,
    samples: u32,
    seeds: u32,
    gather_rays: u32,
    /// Pairs of object and material that the preview shows, the background among them.
    strata_seen: usize,
    levels: Vec<LevelStudy>,
    curves: Vec<Curve>,
}

/// One ambient level.
#[derive(Debug, Serialize)]
pub struct LevelStudy {
    level: Level,
    actual: Columns<f64>,
    /// The least root mean square error of work that pixels of known surfaces can have: see [`noise::floor`].
    noise_floor: f64,
    /// Records of the cache, by level.
    records: Vec<u32>,
    /// As the paper has its strategies; ours as it is.
    outcomes: Vec<Outcome>,
    /// All strategies with the cache's records planned; empty without a cache.
    planned: Vec<Outcome>,
}

/// Errors of a strategy by number of profiled pixels. With a cache its records are planned, and more of them are gathered the more
/// pixels are profiled.
#[derive(Debug, Serialize)]
pub struct Curve {
    level: Level,
    strategy: Strategy,
    points: Vec<CurvePoint>,
}

/// A point of it.
#[derive(Debug, Serialize)]
pub struct CurvePoint {
    /// Pixels profiled.
    pixels: usize,
    /// CPU seconds of profiling: of these pixels, and of the records that were gathered; the mean over the seeds.
    cpu_seconds: f64,
    /// Errors of work.
    error: Score,
}

impl Curve {
    /// Pixels profiled, and root mean square of the errors of work.
    fn points(&self) -> impl Iterator<Item = (f64, f64)> {
        self.points.iter().map(|point| (point.pixels as f64, point.error.root_mean_square))
    }
}

/// Runs the command.
pub fn run(args: &Args, interrupt: &Interrupt) -> Result<()> {
    let bars = Bars::new(args.json);
    let mut studies = Vec::with_capacity(args.bundles.len());
    let mut files = Vec::new();
    for (place, bundle) in args.bundles.iter().enumerate() {
        let local = Local::open(bundle, &args.machine, &bars)?;
        let folder = slug(place, &local.shot.info().summary.name);
        let study = study(args, &local, &folder, &mut files, &bars, interrupt);
        studies.push((folder, study.with_context(|| format!("bundle {}", bundle.display()))?));
    }
    // Nothing is written before all is measured.
    files.push(File { path: "report.md".into(), contents: report::markdown(&studies).into_bytes() });
    for File { path, contents } in &files {
        write_bytes(&args.out.join(path), contents)?;
    }
    let studies: Vec<Study> = studies.into_iter().map(|(_, study)| study).collect();
    if args.json {
        return output::json(&studies);
    }
    output::print(&report::summary(&studies))?;
    output::line(format!("\nThe report is {}.", args.out.join("report.md").display()))
}

fn study(
    args: &Args,
    local: &Local,
    folder: &str,
    files: &mut Vec<File>,
    bars: &Bars,
    interrupt: &Interrupt,
) -> Result<Study> {
    let &Args { frame, size, samples, seeds, repeats, gather_rays, .. } = args;
    for level in Level::ALL {
        level.settings(size, gather_rays).check().map_err(|wrong| {
            forelight_terminal::failure::BadInput::new(format!("--size or --gather-rays: {}", wrong.reason))
        })?;
    }
    let task = Task { local, frame, size, gather_rays, samples, seeds, repeats };
    let (seen, truths) = task.measure(bars, interrupt)?;
    let trials = Trials { args, local, seen: &seen, interrupt };
    let steps = 2 * truths.len();
    let bar = bars.bar("forecasts", (steps * Strategy::ALL.len()) as u64);
    let done = || bar.inc(1);
    let mut levels = Vec::with_capacity(truths.len());
    for truth in &truths {
        levels.push(trials.at(truth, &done)?);
    }
    let mut curves = Vec::new();
    for truth in &truths {
        for strategy in Strategy::ALL {
            curves.push(trials.curve(strategy, truth)?);
            done();
        }
    }
    bar.finish_and_clear();
    files.extend(figures::of(Path::new(folder), &seen, &truths, &curves, size, samples)?);
    let mut shown = seen.ids.clone();
    shown.sort_unstable();
    shown.dedup();
    Ok(Study {
        bundle: local.shot.info().summary.name.clone(),
        frame,
        size,
        samples,
        seeds,
        gather_rays,
        strata_seen: shown.len(),
        levels,
        curves,
    })
}

/// Forecasts of one frame.
struct Trials<'a> {
    args: &'a Args,
    local: &'a Local,
    seen: &'a Seen,
    interrupt: &'a Interrupt,
}

impl Trials<'_> {
    /// All seeds, in their order.
    fn all(
        &self,
        strategy: Strategy,
        records: Records,
        truth: &Truth,
        samples: u32,
    ) -> Result<Vec<Forecast>> {
        let one = |seed: u32| {
            if self.interrupt.is_set() {
                return Err(Interrupted.into());
            }
            trial::forecast(strategy, records, (self.seen, truth), self.args.size, samples, seed.into())
        };
        self.local.pool.install(|| (0..self.args.seeds).into_par_iter().map(one).collect())
    }

    fn at(&self, truth: &Truth, done: &dyn Fn()) -> Result<LevelStudy> {
        let actual = Columns::of(&truth.total());
        let outcome = |strategy, records| -> Result<Outcome> {
            let forecasts = self.all(strategy, records, truth, self.args.samples)?;
            Ok(Outcome::new(strategy, records, &forecasts, actual))
        };
        let mut outcomes = Vec::with_capacity(Strategy::ALL.len());
        let mut planned = Vec::new();
        for strategy in Strategy::ALL {
            outcomes.push(outcome(strategy, Records::of(strategy))?);
            if truth.level.is_cached() {
                planned.push(outcome(strategy, Records::Planned)?);
            }
            done();
        }
        let Args { size, samples, .. } = self.args;
        let noise_floor = noise::floor(&self.seen.ids, *size, &truth.pixels, *samples, actual.work);
        Ok(LevelStudy {
            level: truth.level,
            actual,
            noise_floor,
            records: truth.records.clone(),
            outcomes,
            planned,
        })
    }

    fn curve(&self, strategy: Strategy, truth: &Truth) -> Result<Curve> {
        let actual = truth.total().work as f64;
        let pixels = self.seen.ids.len();
        let mut points = Vec::with_capacity(LADDER.len());
        for samples in LADDER.into_iter().filter(|&samples| samples as usize <= pixels) {
            let records = if truth.level.is_cached() { Records::Planned } else { Records::Unknown };
            let forecasts = self.all(strategy, records, truth, samples)?;
            let seconds = forecasts.iter().map(|forecast| forecast.profiling_seconds).sum::<f64>();
            points.push(CurvePoint {
                pixels: forecasts.first().map_or(0, |forecast| forecast.picks),
                cpu_seconds: seconds / forecasts.len().max(1) as f64,
                error: Score::new(forecasts.iter().map(|f| f.mean.work), actual),
            });
        }
        Ok(Curve { level: truth.level, strategy, points })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_terminal::options::parsed;

    /// Runs the experiment on a floor with a block on it, under a lamp or in the dark; the report, and the measurements.
    fn experiment(lamp: &str, flags: &[&str]) -> (tempfile::TempDir, Vec<(String, Study)>) {
        let folder = tempfile::tempdir().unwrap();
        let scene = format!(
            r#"{{"version":1,"name":"a|block","geometry":["t.obj"],"lights":[{lamp}],
            "camera":{{"origin":[0,3,6],"target":[0,0,0],"up":[0,1,0],"fov_deg":50,"fov_axis":"x","width":4,"height":4}}}}"#
        );
        std::fs::write(folder.path().join("scene.json"), scene).unwrap();
        let mesh = "o floor\nv -9 0 -9\nv 9 0 -9\nv 9 0 9\nv -9 0 9\nf 1 4 3 2\n\
                    o block\nv -1 0 0\nv 1 0 0\nv 1 2 0\nv -1 2 0\nf 5 6 7 8\n";
        std::fs::write(folder.path().join("t.obj"), mesh).unwrap();
        let (bundle, out) = (folder.path().display().to_string(), folder.path().join("report"));
        let out = out.display().to_string();
        let fixed = ["paper", &bundle, "--out", &out, "--json", "--preview", "cpu", "--gather-rays", "48"];
        let args: Args = parsed(fixed.iter().chain(flags));
        let bars = Bars::new(true);
        let local = Local::open(folder.path(), &args.machine, &bars).unwrap();
        let mut files = Vec::new();
        let study = study(&args, &local, "1-t", &mut files, &bars, &Interrupt::default()).unwrap();
        let studies = vec![("1-t".to_owned(), study)];
        run(&args, &Interrupt::default()).unwrap();
        (folder, studies)
    }

    const LAMP: &str = r#"{"type":"point","position":[2,5,3],"intensity":[40,40,40]}"#;

    #[test]
    fn the_experiment_writes_a_whole_report_and_every_number_of_it_is_one() {
        for (lamp, flags) in [
            (LAMP, ["--size", "24", "--samples", "40", "--seeds", "3"]),
            ("", ["--size", "1", "--samples", "1000", "--seeds", "1"]),
        ] {
            let (folder, studies) = experiment(lamp, &flags);
            let out = folder.path().join("report");
            let report = std::fs::read_to_string(out.join("report.md")).unwrap();
            for word in ["NaN", "inf ", "inf%"] {
                assert!(!report.contains(word), "{report}");
            }
            let pictures: Vec<&str> = report
                .match_indices("](")
                .map(|(at, _)| {
                    let rest = &report[at + 2..];
                    &rest[..rest.find(')').unwrap()]
                })
                .collect();
            assert!(pictures.len() > 60);
            for picture in pictures {
                assert!(out.join(picture).is_file(), "{picture}");
            }
            let text = serde_json::to_string(&studies).unwrap();
            assert!(!text.contains("null,\"work\"") && !text.contains("NaN"), "{text}");
            assert_eq!(studies[0].1.levels.len(), 4);
        }
    }

    #[test]
    fn as_many_samples_as_pixels_leave_no_error_but_that_of_the_records() {
        let (_folder, studies) = experiment(LAMP, &["--size", "12", "--samples", "144", "--seeds", "2"]);
        for level in &studies[0].1.levels {
            assert!(level.actual.work > 0.0);
            for outcome in level.outcomes.iter().filter(|_| !level.level.is_cached()) {
                let error = outcome.error.work;
                assert!(error.largest < 1e-12, "{:?} {:?}: {error:?}", level.level, outcome.strategy);
            }
            assert_eq!(level.records.is_empty(), !level.level.is_cached());
        }
    }
}

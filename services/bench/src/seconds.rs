//! `forelight bench seconds`: how well a quote made here predicts CPU times on another machine.
//!
//! The other machine is a program: another build of this one, or a script that runs it elsewhere
//! (`ssh rack-7 forelight "$@"`, with equal paths on both). It is calibrated as by a user. The quote is made
//! here and carried over, as by `forelight forecast --for-node`. The truth is the CPU time that both programs
//! report. Each round does all of this in turns, because load varies, and the medians of the rounds count.

use crate::conventions::bounces_to_try;
use crate::report::Report;
use crate::statistics::{mean_absolute, median, relative_error};
use anyhow::{Context, Result};
use forelight_protocol::{
    CacheMode, FrameSet, Integrator, MaterialMode, NodeCalibration, NodeSeconds, RenderSettings, RenderStats,
};
use forelight_renderer_own::QuoteOptions;
use forelight_terminal::atomic_file;
use forelight_terminal::failure::{BadInput, Interrupted};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::json_file;
use forelight_terminal::local::Local;
use forelight_terminal::options::{MachineOptions, QualityOptions};
use forelight_terminal::output::Bars;
use forelight_terminal::quantities::{percent, seconds};
use forelight_terminal::table::{Align, Table};
use forelight_terminal::watching::QuoteWatcher;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Carry quotes to another machine, and compare them with its CPU times
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight bench seconds kitchen/ corridor/ --other ./forelight-of-rack-7 --width 128
  forelight bench seconds kitchen/ --other ./on-rack-7.sh --bounces 1 --cache on --frames 0,24

The other program gets the same arguments as this one. It may be a script that runs forelight on another \
machine, if bundles and the folder for temporary files have the same paths there. Without --other it is \
this program, which shows the noise of the measurement.")]
pub struct Args {
    #[arg(required = true)]
    bundles: Vec<PathBuf>,
    #[arg(long, value_name = "PROGRAM")]
    other: Option<PathBuf>,
    /// Frames to quote and to render
    #[arg(long, value_name = "LIST", default_value = "0")]
    frames: FrameSet,
    /// Ambient bounces to try [default: --ambient-bounces, or 0,1]
    #[arg(long, value_name = "LIST", value_delimiter = ',', conflicts_with = "ambient_bounces")]
    bounces: Vec<u32>,
    /// Pixels to profile in a frame
    #[arg(long, value_name = "PIXELS", default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    samples: u32,
    /// Number of calibrations of each program, of quotes, and of renders of each frame
    #[arg(long, value_name = "TIMES", default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..=1000))]
    rounds: u16,
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

/// One bundle at one ambient level, in CPU seconds of all frames.
#[derive(Debug, Serialize)]
struct Case {
    bundle: String,
    ambient_bounces: u32,
    /// CPU time of the frames, by round.
    took: Pair<Vec<f64>>,
    /// Quotes by round, each with new calibrations.
    quoted: Pair<Vec<f64>>,
    /// Median of the quotes over median of the CPU times, minus one.
    error: Pair<f64>,
    /// Quoted ratio of there to here, over the actual ratio, minus one: the error of carrying over.
    carried: f64,
}

/// Here, where the quote is made, and there, where nothing was profiled.
#[derive(Debug, Clone, Copy, Default, Serialize)]
struct Pair<T> {
    here: T,
    there: T,
}

pub fn run(args: &Args, interrupt: &Interrupt) -> Result<Report> {
    atomic_file::check([args.out.as_deref()])?;
    let bars = Bars::new(args.json);
    let own = std::env::current_exe().context("cannot find this program")?;
    let other = args.other.as_deref().unwrap_or(&own);
    // Threads that share caches slow each other, and machines differ in how much.
    let machine = MachineOptions { threads: args.machine.threads.or(Some(1)), ..args.machine.clone() };
    let mut ready = Vec::new();
    for bundle in &args.bundles {
        let local = Local::open(bundle, &machine, &bars)?;
        let mut settings = Vec::new();
        for bounces in bounces_to_try(&args.bounces, &args.quality) {
            let quality = QualityOptions { ambient_bounces: Some(bounces), ..args.quality.clone() };
            settings.push(local.settings(&quality)?);
        }
        let frames = local.frames(Some(&args.frames))?;
        ready.push((bundle, local, settings, frames));
    }
    let mut cases = Vec::new();
    for (bundle, local, settings, frames) in &ready {
        for settings in settings {
            let trial = Trial { bundle, settings, frames, threads: local.pool.current_num_threads() };
            let case = trial.measure(args, local, Pair { here: &own, there: other }, interrupt);
            cases.push(case.with_context(|| format!("bundle {}", bundle.display()))?);
        }
    }
    json_file::write(args.out.as_deref(), &cases)?;
    report(&cases).printed(args.json, &cases)
}

/// Calibration that a program reports for its machine.
fn calibration(program: &Path) -> Result<NodeCalibration> {
    let answer = answer(Command::new(program).args(["calibrate", "--json"]))?;
    let calibration: NodeCalibration = serde_json::from_slice(&answer)
        .map_err(|error| BadInput::new(format!("{}: calibrate --json: {error}", program.display())))?;
    calibration.check().map_err(|(field, reason)| {
        BadInput::new(format!("{}: calibrate --json: {field} {reason}", program.display()))
    })?;
    Ok(calibration)
}

fn answer(command: &mut Command) -> Result<Vec<u8>> {
    let program = command.get_program().to_string_lossy().into_owned();
    let done = command
        .stdin(Stdio::null())
        .output()
        .map_err(|error| BadInput::new(format!("--other: cannot start {program}: {error}")))?;
    if !done.status.success() {
        let said = String::from_utf8_lossy(&done.stderr);
        let last = said.lines().rfind(|line| !line.trim().is_empty()).unwrap_or("it printed nothing");
        return Err(BadInput::new(format!("{program} failed: {last}")).into());
    }
    Ok(done.stdout)
}

struct Trial<'a> {
    bundle: &'a Path,
    settings: &'a RenderSettings,
    frames: &'a [u32],
    threads: usize,
}

impl Trial<'_> {
    fn measure(
        &self,
        args: &Args,
        local: &Local,
        programs: Pair<&Path>,
        interrupt: &Interrupt,
    ) -> Result<Case> {
        let bars = Bars::new(args.json);
        let frames = self.frames;
        let folder = tempfile::tempdir().context("cannot create a folder for render statistics")?;
        let stats = folder.path().join("stats.json");
        let bar = bars.bar("rendering", u64::from(args.rounds) * 2 * frames.len() as u64);
        let [mut took, mut quoted] = [const { Pair { here: Vec::new(), there: Vec::new() } }; 2];
        for _ in 0..args.rounds {
            let quote = self.quote(args, local, programs, interrupt)?;
            quoted.here.push(quote.here);
            quoted.there.push(quote.there);
            let mut sums = Pair::<f64>::default();
            for &frame in frames {
                for (program, sum) in [(programs.here, &mut sums.here), (programs.there, &mut sums.there)] {
                    if interrupt.is_set() {
                        return Err(Interrupted.into());
                    }
                    answer(self.render(program, frame).arg("--stats").arg(&stats))?;
                    *sum += json_file::read::<RenderStats>(&stats)?.cpu_seconds;
                    bar.inc(1);
                }
            }
            took.here.push(sums.here);
            took.there.push(sums.there);
        }
        bar.finish_and_clear();
        let truth = Pair { here: median(&took.here), there: median(&took.there) };
        let said = Pair { here: median(&quoted.here), there: median(&quoted.there) };
        Ok(Case {
            bundle: local.shot.info().summary.name.clone(),
            ambient_bounces: self.settings.ambient_bounces,
            error: Pair {
                here: relative_error(said.here, truth.here),
                there: relative_error(said.there, truth.there),
            },
            carried: relative_error(said.there * truth.here, truth.there * said.here),
            quoted,
            took,
        })
    }

    /// Quotes for both machines, with new calibrations.
    fn quote(
        &self,
        args: &Args,
        local: &Local,
        programs: Pair<&Path>,
        interrupt: &Interrupt,
    ) -> Result<Pair<f64>> {
        let bars = Bars::new(args.json);
        let spinner = bars.spinner("calibrating");
        let calibrations = Pair { here: calibration(programs.here)?, there: calibration(programs.there)? };
        spinner.finish_and_clear();
        let options = QuoteOptions { samples: args.samples, ..QuoteOptions::default() };
        let watcher = QuoteWatcher::new(&bars, self.frames.len(), interrupt);
        let quote = watcher.quote(local, self.bundle, self.frames, self.settings, &options)?.document;
        let there = NodeSeconds::carried(&quote, "there".to_owned(), &calibrations.here, &calibrations.there);
        let there = there.context("the quote has no work by class")?;
        Ok(Pair { here: quote.total.cpu_seconds.mean, there: there.cpu_seconds.mean })
    }

    /// The command that renders a frame with the quoted settings.
    fn render(&self, program: &Path, frame: u32) -> Command {
        let RenderSettings {
            width,
            height,
            spp,
            integrator,
            ambient_bounces,
            ambient_divisions,
            max_depth,
            cache,
            cache_accuracy,
            cache_rays,
            materials,
            seed,
        } = *self.settings;
        let mut command = Command::new(program);
        command.arg("render").arg(self.bundle).args(["--frame", &frame.to_string()]);
        let mut flag = |name: &str, value: &dyn ToString| {
            command.args([name, &value.to_string()]);
        };
        flag("--width", &width);
        flag("--height", &height);
        flag("--spp", &spp);
        let integrator = match integrator {
            Integrator::Ambient => "ambient",
            Integrator::Path => "path",
        };
        flag("--integrator", &integrator);
        flag("--ambient-bounces", &ambient_bounces);
        flag("--ambient-divisions", &ambient_divisions);
        flag("--max-depth", &max_depth);
        if cache == CacheMode::On {
            flag("--cache", &"on");
            flag("--cache-accuracy", &(f64::from(cache_accuracy) / 1000.0));
            flag("--cache-rays", &cache_rays);
        }
        let materials = match materials {
            MaterialMode::Full => "full",
            MaterialMode::Lambert => "lambert",
        };
        flag("--materials", &materials);
        flag("--seed", &seed);
        flag("--threads", &self.threads);
        command
    }
}

/// Half of the range of the rounds, relative to their median.
fn noise(values: &[f64]) -> f64 {
    let (low, high) = values.iter().fold((f64::MAX, 0.0f64), |(low, high), &v| (low.min(v), high.max(v)));
    0.5 * (high - low) / median(values).max(f64::MIN_POSITIVE)
}

fn report(cases: &[Case]) -> Report {
    let mut table = Table::new(&[
        ("bundle", Align::Left),
        ("bounces", Align::Right),
        ("here: quoted", Align::Right),
        ("took", Align::Right),
        ("error", Align::Right),
        ("there: quoted", Align::Right),
        ("took", Align::Right),
        ("error", Align::Right),
        ("carried over", Align::Right),
        ("rounds differ by", Align::Right),
        ("quotes by", Align::Right),
    ]);
    for Case { bundle, ambient_bounces, took, quoted, error, carried } in cases {
        table.row([
            bundle.clone(),
            ambient_bounces.to_string(),
            seconds(median(&quoted.here)),
            seconds(median(&took.here)),
            percent(error.here),
            seconds(median(&quoted.there)),
            seconds(median(&took.there)),
            percent(error.there),
            percent(*carried),
            format!("±{:.0} %", 100.0 * noise(&took.here).max(noise(&took.there))),
            format!("±{:.0} %", 100.0 * noise(&quoted.here).max(noise(&quoted.there))),
        ]);
    }
    let mean = |error: fn(&Case) -> f64| 100.0 * mean_absolute(cases.iter().map(error));
    Report::default().table(table).text(format!(
        "\nmean absolute error: {:.1} % here, {:.1} % there, of which {:.1} % by carrying the quote over\n",
        mean(|case| case.error.here),
        mean(|case| case.error.there),
        mean(|case| case.carried),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_terminal::options::parsed;

    #[test]
    fn noise_is_half_of_the_range_over_the_median() {
        assert_eq!(noise(&[2.0, 1.0, 3.0]), 0.5);
    }

    #[test]
    fn frames_are_rendered_as_they_were_quoted() {
        let settings: RenderSettings = serde_json::from_str(
            r#"{"width": 31, "height": 17, "spp": 3, "integrator": "ambient", "ambient_bounces": 2, "ambient_divisions": 9,
                "max_depth": 5, "cache": "on", "cache_accuracy": 150, "cache_rays": 192, "materials": "lambert", "seed": 7}"#,
        )
        .unwrap();
        let trial = Trial { bundle: Path::new("b"), settings: &settings, frames: &[4], threads: 1 };
        let command = trial.render(Path::new("forelight"), 4);
        let typed: Vec<&str> = command.get_args().map(|arg| arg.to_str().unwrap()).collect();
        assert_eq!(&typed[..4], ["render", "b", "--frame", "4"]);
        // The parsed flags of `render` must equal the quoted settings.
        let read = parsed::<QualityOptions>([&["render"], &typed[4..typed.len() - 2]].concat());
        assert_eq!(forelight_terminal::local::settings_request(&read, (4, 4)).complete((4, 4)), settings);
    }

    #[test]
    fn a_program_that_fails_is_named_with_what_it_said() {
        let said = answer(Command::new("sh").args(["-c", "echo first >&2; echo no such flag >&2; exit 2"]));
        assert_eq!(said.unwrap_err().to_string(), "sh failed: no such flag");
        let none = answer(&mut Command::new("/nowhere/forelight")).unwrap_err().to_string();
        assert!(none.contains("cannot start /nowhere/forelight"), "{none}");
    }
}

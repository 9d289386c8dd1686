//! `forelight forecast`: the quote of a shot, on this machine.

use crate::atomic_file::write_bytes;
use crate::failure::Interrupted;
use crate::interrupt::Interrupt;
use crate::local::Local;
use crate::options::{MachineOptions, QualityOptions};
use crate::output::{self, Bars};
use crate::quantities::{count, seconds};
use crate::table::{Align, Table};
use anyhow::{Context, Result};
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use forelight_forecast::Strategy;
use forelight_protocol::{ForecastDoc, FrameSet, LeftOut, Quantiles, RenderSettings};
use forelight_worker::{Observer, Quote, QuoteOptions, ShotError, quote};
use indicatif::ProgressBar;
use std::path::{Path, PathBuf};

/// Say what frames will cost, before they are rendered
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight forecast kitchen/ --frames 0-47
  forelight forecast kitchen/ --frames 12 --width 1920 --spp 64 --json > quote.json
  forelight forecast kitchen/ --frames 0-47 --save-profile profiles/
  forelight forecast kitchen/ --frames 12 --strategy jittered

All frames are previewed; of at most --profile-frames of them, --samples pixels each are traced. These are finished pixels: \
with --save-profile, `forelight render --profile` takes them over. With --cache on, the irradiance cache of every frame is \
planned with its preview, so that the number of records is known; some of them are gathered to see what that takes. Work is a count of operations that two runs agree on; \
CPU time is this machine's.")]
pub struct Args {
    /// Scene bundle: a folder or a zip file
    bundle: PathBuf,
    /// Frames, such as 0-47 or 0,5,9-12 [default: the whole shot]
    #[arg(long, value_name = "LIST")]
    frames: Option<FrameSet>,
    /// Pixels to trace in a profiled frame
    #[arg(long, value_name = "PIXELS", default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    samples: u32,
    /// Frames to profile at most
    #[arg(long, value_name = "FRAMES", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    profile_frames: u32,
    /// How the pixels are chosen, and what they cost is expanded to the frame
    #[arg(long, value_name = "NAME", default_value = Strategy::Snapshot.name(), value_parser = strategies())]
    strategy: Strategy,
    /// Seed of the choice of pixels
    #[arg(long, value_name = "NUMBER", default_value_t = 0)]
    phase_seed: u64,
    /// Write what a render can take over of each profiled frame into this folder: its pixels, or its irradiance cache
    #[arg(long, value_name = "DIR")]
    save_profile: Option<PathBuf>,
    /// Print the quote as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    quality: QualityOptions,
    #[command(flatten)]
    machine: MachineOptions,
}

/// Reads the name of a strategy.
fn strategies() -> impl TypedValueParser<Value = Strategy> {
    let possible = |strategy: Strategy| PossibleValue::new(strategy.name()).help(strategy.summary());
    PossibleValuesParser::new(Strategy::ALL.map(possible)).try_map(|name| {
        let found = Strategy::ALL.into_iter().find(|strategy| strategy.name() == name);
        found.ok_or("there is no such strategy")
    })
}

/// Runs the command.
pub fn run(args: &Args, interrupt: &Interrupt) -> Result<()> {
    let bars = Bars::new(args.json);
    let local = Local::open(&args.bundle, &args.machine, &bars)?;
    let settings = local.settings(&args.quality)?;
    let frames = local.frames(args.frames.as_ref())?;
    let options = QuoteOptions {
        samples: args.samples,
        profile_frames: args.profile_frames as usize,
        seed: args.phase_seed,
        strategy: args.strategy,
    };
    let watcher = Watcher::new(&bars, frames.len(), interrupt);
    let quoted = watcher.quote(&local, &args.bundle, &frames, &settings, &options)?;
    if let Some(folder) = &args.save_profile {
        save_profiles(&quoted, folder)?;
    }
    if args.json { output::json(&quoted.document) } else { output::print(&report(&quoted.document)) }
}

/// Bars for the steps of a quote, and the user's wish to stop.
pub struct Watcher<'a> {
    previews: ProgressBar,
    profiles: ProgressBar,
    interrupt: &'a Interrupt,
}

impl<'a> Watcher<'a> {
    /// Bars for a quote of so many frames.
    pub fn new(bars: &Bars, frames: usize, interrupt: &'a Interrupt) -> Self {
        Self { previews: bars.bar("previews", frames as u64), profiles: bars.bar("profiling", 0), interrupt }
    }

    /// A quote of the bundle that was opened as `local`, watched, until the user stops it.
    pub fn quote(
        &self,
        local: &Local,
        bundle: &Path,
        frames: &[u32],
        settings: &RenderSettings,
        options: &QuoteOptions,
    ) -> Result<Quote> {
        let quoted = local.pool.install(|| quote(&local.shot, frames, settings, options, self));
        self.previews.finish_and_clear();
        self.profiles.finish_and_clear();
        match quoted {
            Err(ShotError::Cancelled) => Err(Interrupted.into()),
            Err(ShotError::Render(error)) => {
                Err(error).with_context(|| format!("bundle {}", bundle.display()))
            }
            other => Ok(other?),
        }
    }
}

impl Observer for Watcher<'_> {
    fn previewed(&self, done: usize, all: usize) {
        self.previews.set_length(all as u64);
        self.previews.set_position(done as u64);
    }

    fn profiled(&self, done: usize, all: usize) {
        self.profiles.set_length(all as u64);
        self.profiles.set_position(done as u64);
    }

    fn is_cancelled(&self) -> bool {
        self.interrupt.is_set()
    }
}

fn save_profiles(quote: &Quote, folder: &Path) -> Result<()> {
    for profiled in &quote.profiled {
        let path = folder.join(format!("frame-{:04}.profile", profiled.frame));
        write_bytes(&path, &profiled.profile.to_bytes())?;
    }
    Ok(())
}

/// The quote for people.
fn report(quote: &ForecastDoc) -> String {
    let head = [
        ("frame", Align::Right),
        ("work P50", Align::Right),
        ("P80", Align::Right),
        ("P95", Align::Right),
        ("CPU time P50", Align::Right),
        ("P80", Align::Right),
        ("P95", Align::Right),
    ];
    let cached = !quote.total.cache_records.is_empty();
    let records_head = cached.then_some(("records", Align::Right));
    let head: Vec<_> = head.into_iter().chain(records_head).chain([("", Align::Left)]).collect();
    let row = |name: String, work: &Quantiles, cpu: &Quantiles, records: &[Quantiles], remark: &str| {
        let work = [work.p50, work.p80, work.p95].map(count);
        let cpu = [cpu.p50, cpu.p80, cpu.p95].map(seconds);
        let levels: Vec<String> = records.iter().map(|level| format!("{:.0}", level.mean)).collect();
        let cells = [name].into_iter().chain(work).chain(cpu);
        cells.chain(cached.then(|| levels.join(" + "))).chain([remark.to_owned()]).collect::<Vec<_>>()
    };
    let mut table = Table::new(&head);
    for frame in &quote.frames {
        let remark = if quote.profiled.frames.contains(&frame.frame) { "profiled" } else { "" };
        let number = frame.frame.to_string();
        table.row(row(number, &frame.work, &frame.cpu_seconds, &frame.cache_records, remark));
    }
    table.footer();
    let total = &quote.total;
    table.row(row("all".into(), &total.work, &total.cpu_seconds, &total.cache_records, ""));
    let spent = &quote.spent;
    let frames = quote.profiled.frames.len();
    let plural = if frames == 1 { "" } else { "s" };
    let calibrated = if quote.calibrated {
        "The quantiles are calibrated on past jobs."
    } else {
        "The quantiles rest on the statistics of this shot alone; they are not calibrated on past jobs."
    };
    let left_out =
        quote.left_out.iter().map(|LeftOut { what, reason }| format!("left out: {what}: {reason}\n"));
    table.render()
        + &format!(
            "\nsimulated: {}\n{}{} pixels of {frames} frame{plural} were profiled. The quote took {} CPU time and {:.1} % of the work that it forecasts.\n{calibrated}\n",
            quote.effects.join(", "),
            left_out.collect::<String>(),
            quote.profiled.pixels,
            seconds(spent.cpu_seconds),
            spent.fraction_of_forecast * 100.0,
        )
}

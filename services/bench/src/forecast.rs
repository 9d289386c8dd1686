//! `forelight bench forecast`: forecasts one frame of each bundle with several seeds, and compares it with
//! the full render.
//!
//! Each forecast traces its own pixels, as `forelight forecast` does. `bench paper` compares many more
//! forecasts on costs that are traced once.

use crate::conventions::{PAPER_SIZE, bounces_to_try};
use crate::report::Report;
use crate::statistics::{mean_absolute, relative_error};
use anyhow::{Context, Result};
use forelight_protocol::Rays;
use forelight_renderer_own::{Given, QuoteOptions, quote, render_frame};
use forelight_terminal::atomic_file;
use forelight_terminal::failure::Interrupted;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::json_file;
use forelight_terminal::local::Local;
use forelight_terminal::options::{MachineOptions, QualityOptions};
use forelight_terminal::output::{Bars, RenderBar};
use forelight_terminal::quantities::{count, percent, seconds};
use forelight_terminal::table::{Align, Table};
use forelight_terminal::watching::QuoteWatcher;
use serde::Serialize;
use std::path::PathBuf;

/// Forecast one frame with many seeds, and compare with its full render
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight bench forecast kitchen/ corridor/
  forelight bench forecast kitchen/ --bounces 1 --seeds 30 --samples 512 --json > forecast.json

The image is 256 x 256 as in the paper, unless --width or --height is given.")]
pub struct Args {
    /// Scene bundles: folders or zip files
    #[arg(required = true)]
    bundles: Vec<PathBuf>,
    /// Frame number
    #[arg(long, value_name = "N", default_value_t = 0)]
    frame: u32,
    /// Ambient bounces to try [default: --ambient-bounces, or 0,1]
    #[arg(long, value_name = "LIST", value_delimiter = ',', conflicts_with = "ambient_bounces")]
    bounces: Vec<u32>,
    /// Seeds to try
    #[arg(long, value_name = "COUNT", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    seeds: u32,
    /// Pixels to profile
    #[arg(long, value_name = "PIXELS", default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    samples: u32,
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

/// One bundle at one ambient level.
#[derive(Debug, Serialize)]
struct Case {
    bundle: String,
    frame: u32,
    width: u32,
    height: u32,
    spp: u32,
    ambient_bounces: u32,
    samples: u32,
    /// Share of the pixels that were profiled.
    sampled_fraction: f64,
    actual: Actual,
    /// Means over seeds of |forecast mean / actual − 1|.
    mean_absolute_error: Errors,
    /// Mean over seeds of forecast mean / actual − 1.
    bias: Errors,
    /// Share of the seeds whose actual work was at or below the quantile.
    covered: Covered,
    /// Mean over seeds of the work of preview and profiling, relative to the actual work.
    spent_fraction: f64,
    seeds: Vec<Trial>,
}

#[derive(Debug, Serialize)]
struct Actual {
    work: u64,
    cpu_seconds: f64,
    rays: Rays,
}

#[derive(Debug, Clone, Copy, Serialize)]
struct Errors {
    work: f64,
    cpu_seconds: f64,
    rays: f64,
}

#[derive(Debug, Serialize)]
struct Covered {
    p50: f64,
    p80: f64,
    p95: f64,
}

#[derive(Debug, Serialize)]
struct Trial {
    seed: u64,
    work: f64,
    work_p50: f64,
    work_p80: f64,
    work_p95: f64,
    cpu_seconds: f64,
    rays: f64,
    /// Signed, relative to the actual.
    error: Errors,
    spent_work: u64,
}

pub fn run(args: &Args, interrupt: &Interrupt) -> Result<Report> {
    atomic_file::check([args.out.as_deref()])?;
    let bars = Bars::new(args.json);
    let mut cases = Vec::new();
    for bundle in &args.bundles {
        let local = Local::open(bundle, &args.machine, &bars)?;
        for bounces in bounces_to_try(&args.bounces, &args.quality) {
            let case = measure(args, &local, bounces, &bars, interrupt);
            cases.push(case.with_context(|| format!("bundle {}", bundle.display()))?);
        }
    }
    json_file::write(args.out.as_deref(), &cases)?;
    report(&cases).printed(args.json, &cases)
}

fn measure(args: &Args, local: &Local, bounces: u32, bars: &Bars, interrupt: &Interrupt) -> Result<Case> {
    let mut quality = args.quality.clone();
    quality.ambient_bounces = Some(bounces);
    quality.width = quality.width.or(Some(PAPER_SIZE));
    quality.height = quality.height.or(Some(PAPER_SIZE));
    let settings = local.settings(&quality)?;
    let bar = RenderBar::new(bars);
    let progress = |progress| bar.show(progress);
    let rendered = local
        .pool
        .install(|| {
            render_frame(&local.shot, args.frame, &settings, Given::default(), &progress, interrupt.flag())
        })?
        .ok_or(Interrupted)?;
    drop(bar);
    let actual = rendered.stats;
    let mut seeds = Vec::with_capacity(args.seeds as usize);
    let bar = bars.bar("forecasts", u64::from(args.seeds));
    for seed in 0..u64::from(args.seeds) {
        let options =
            QuoteOptions { samples: args.samples, profile_frames: Some(1), seed, ..QuoteOptions::default() };
        let watcher = QuoteWatcher::new(&Bars::new(true), 1, interrupt);
        let quoted = local.pool.install(|| quote(&local.shot, &[args.frame], &settings, &options, &watcher));
        let total = match quoted {
            Err(forelight_renderer_own::ShotError::Cancelled) => return Err(Interrupted.into()),
            other => other?.document,
        };
        let rays: f64 = total.total.rays.to_array().iter().map(|category| category.mean).sum();
        let work = total.total.work;
        let cpu_seconds = total.total.cpu_seconds.mean;
        seeds.push(Trial {
            seed,
            work: work.mean,
            work_p50: work.p50,
            work_p80: work.p80,
            work_p95: work.p95,
            cpu_seconds,
            rays,
            error: Errors {
                work: relative_error(work.mean, actual.work as f64),
                cpu_seconds: relative_error(cpu_seconds, actual.cpu_seconds),
                rays: relative_error(rays, actual.rays.total() as f64),
            },
            spent_work: total.spent.work,
        });
        bar.inc(1);
    }
    bar.finish_and_clear();
    let trials = seeds.len() as f64;
    let errors = |fold: &dyn Fn(&mut dyn Iterator<Item = f64>) -> f64| Errors {
        work: fold(&mut seeds.iter().map(|s| s.error.work)),
        cpu_seconds: fold(&mut seeds.iter().map(|s| s.error.cpu_seconds)),
        rays: fold(&mut seeds.iter().map(|s| s.error.rays)),
    };
    let covered = |quantile: fn(&Trial) -> f64| {
        seeds.iter().filter(|trial| actual.work as f64 <= quantile(trial)).count() as f64 / trials
    };
    Ok(Case {
        bundle: local.shot.info().summary.name.clone(),
        frame: args.frame,
        width: settings.width,
        height: settings.height,
        spp: settings.spp,
        ambient_bounces: bounces,
        samples: args.samples,
        sampled_fraction: f64::from(args.samples) / settings.pixels() as f64,
        mean_absolute_error: errors(&|errors| mean_absolute(errors)),
        bias: errors(&|errors| errors.sum::<f64>() / trials),
        covered: Covered {
            p50: covered(|t| t.work_p50),
            p80: covered(|t| t.work_p80),
            p95: covered(|t| t.work_p95),
        },
        spent_fraction: seeds.iter().map(|s| s.spent_work as f64).sum::<f64>()
            / trials
            / actual.work.max(1) as f64,
        actual: Actual { work: actual.work, cpu_seconds: actual.cpu_seconds, rays: actual.rays },
        seeds,
    })
}

fn report(cases: &[Case]) -> Report {
    let head = [
        ("bundle", Align::Left),
        ("bounces", Align::Right),
        ("work", Align::Right),
        ("CPU", Align::Right),
        ("|error| work", Align::Right),
        ("CPU", Align::Right),
        ("rays", Align::Right),
        ("bias work", Align::Right),
        ("<=P50", Align::Right),
        ("<=P80", Align::Right),
        ("<=P95", Align::Right),
        ("spent", Align::Right),
        ("work errors by seed", Align::Left),
    ];
    let mut table = Table::new(&head);
    let share = |fraction: f64| format!("{:.1} %", fraction * 100.0);
    let whole = |fraction: f64| format!("{:.0} %", fraction * 100.0);
    for case in cases {
        let errors = &case.mean_absolute_error;
        let by_seed: Vec<String> =
            case.seeds.iter().map(|s| format!("{:+.1}", s.error.work * 100.0)).collect();
        table.row([
            case.bundle.clone(),
            case.ambient_bounces.to_string(),
            count(case.actual.work as f64),
            seconds(case.actual.cpu_seconds),
            share(errors.work),
            share(errors.cpu_seconds),
            share(errors.rays),
            percent(case.bias.work),
            whole(case.covered.p50),
            whole(case.covered.p80),
            whole(case.covered.p95),
            share(case.spent_fraction),
            by_seed.join(" "),
        ]);
    }
    Report::default().table(table)
}

//! `forelight bench shot`: all frames of a shot, forecast from a few of them, against the full render of each.

use super::{mean_absolute, relative_error};
use crate::atomic_file::write_bytes;
use crate::commands::forecast::Watcher;
use crate::failure::Interrupted;
use crate::interrupt::Interrupt;
use crate::local::Local;
use crate::options::{MachineOptions, QualityOptions};
use crate::output::{self, Bars};
use crate::quantities::{count, percent, seconds};
use crate::table::{Align, Table};
use anyhow::Result;
use forelight_protocol::{FrameSet, Quantiles, RenderSettings, RenderStats, Spent};
use forelight_worker::{Given, Quote, QuoteOptions, Renderer, render_frame};
use serde::Serialize;
use std::path::PathBuf;

/// Forecast a shot from a few of its frames, against the full render of all
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight bench shot kitchen/ --frames 0-47 --width 192 --height 108
  forelight bench shot corridor/ --profile-frames 3 --ambient-bounces 1 --json > shot.json

What a quote takes for good are its previews and setting up the profiled frames; the profiled pixels are finished pixels, \
which the renders take over, here as on the farm.")]
pub struct Args {
    /// Scene bundle: a folder or a zip file
    bundle: PathBuf,
    /// Frames, such as 0-47 or 0,5,9-12 [default: the whole shot]
    #[arg(long, value_name = "LIST")]
    frames: Option<FrameSet>,
    /// Pixels to profile in a profiled frame
    #[arg(long, value_name = "PIXELS", default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    samples: u32,
    /// Frames to profile at most
    #[arg(long, value_name = "FRAMES", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    profile_frames: u32,
    /// Seed of the choice of pixels
    #[arg(long, value_name = "NUMBER", default_value_t = 0)]
    phase_seed: u64,
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

/// A shot, forecast and rendered.
#[derive(Debug, Serialize)]
struct Measured {
    bundle: String,
    width: u32,
    height: u32,
    spp: u32,
    ambient_bounces: u32,
    samples: u32,
    profiled: Vec<u32>,
    work: Total,
    cpu_seconds: Total,
    /// Mean over frames of |forecast mean / actual − 1|.
    frame_error_work: f64,
    frame_error_cpu_seconds: f64,
    /// Share of the frames whose actual work was at or below the quantile.
    frames_within_p80: f64,
    frames_within_p95: f64,
    /// What previews and profiling took, as shares of the actual total.
    spent: Shares,
    /// The part of it that the renders do not get back.
    spent_for_good: Shares,
    reused_pixels: u64,
    frames: Vec<Frame>,
}

#[derive(Debug, Serialize)]
struct Total {
    forecast: Quantiles,
    actual: f64,
    /// Signed, relative to the actual.
    error: f64,
}

#[derive(Debug, Serialize)]
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
    let bars = Bars::new(args.json);
    let local = Local::open(&args.bundle, &args.machine, &bars)?;
    let settings = local.settings(&args.quality)?;
    let frames = local.frames(args.frames.as_ref())?;
    let options = QuoteOptions {
        samples: args.samples,
        profile_frames: args.profile_frames as usize,
        seed: args.phase_seed,
        ..QuoteOptions::default()
    };
    let watcher = Watcher::new(&bars, frames.len(), interrupt);
    let quoted = watcher.quote(&local, &args.bundle, &frames, &settings, &options)?;
    let bar = bars.bar("rendering", frames.len() as u64);
    let mut actual = Vec::with_capacity(frames.len());
    for &frame in &frames {
        let profile = quoted.profiled.iter().find(|p| p.frame == frame).map(|p| &p.profile);
        let rendered = local
            .pool
            .install(|| {
                render_frame(
                    &local.shot,
                    frame,
                    &settings,
                    Given { profile, cache: None },
                    &|_| (),
                    interrupt.flag(),
                )
            })?
            .ok_or(Interrupted)?;
        actual.push(rendered.stats);
        bar.inc(1);
    }
    bar.finish_and_clear();
    let measured = compare(&local.shot.info().summary.name, &settings, args.samples, &quoted, &actual);
    if let Some(path) = &args.out {
        write_bytes(path, (output::pretty(&measured)? + "\n").as_bytes())?;
    }
    if args.json { output::json(&measured) } else { output::print(&report(&measured)) }
}

fn compare(
    bundle: &str,
    settings: &RenderSettings,
    samples: u32,
    quote: &Quote,
    actual: &[RenderStats],
) -> Measured {
    let total = |forecast: Quantiles, actual: f64| Total {
        forecast,
        actual,
        error: relative_error(forecast.mean, actual),
    };
    let document = &quote.document;
    let frames: Vec<Frame> = document
        .frames
        .iter()
        .zip(actual)
        .map(|(forecast, actual)| Frame {
            frame: actual.frame,
            profiled: document.profiled.frames.contains(&actual.frame),
            work: total(forecast.work, actual.work as f64),
            cpu_seconds: total(forecast.cpu_seconds, actual.cpu_seconds),
        })
        .collect();
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
    Measured {
        bundle: bundle.to_owned(),
        width: settings.width,
        height: settings.height,
        spp: settings.spp,
        ambient_bounces: settings.ambient_bounces,
        samples,
        profiled: document.profiled.frames.clone(),
        work: total(document.total.work, work),
        cpu_seconds: total(document.total.cpu_seconds, cpu_seconds),
        frame_error_work: mean_absolute(frames.iter().map(|f| f.work.error)),
        frame_error_cpu_seconds: mean_absolute(frames.iter().map(|f| f.cpu_seconds.error)),
        frames_within_p80: within(|q| q.p80),
        frames_within_p95: within(|q| q.p95),
        spent: shares(quote.spent()),
        spent_for_good: shares(quote.spent_for_good()),
        reused_pixels: actual.iter().map(|stats| stats.reused_pixels).sum(),
        frames,
    }
}

fn report(measured: &Measured) -> String {
    let head = [
        ("frame", Align::Right),
        ("forecast", Align::Right),
        ("P80", Align::Right),
        ("actual", Align::Right),
        ("error", Align::Right),
        ("CPU forecast", Align::Right),
        ("actual", Align::Right),
        ("error", Align::Right),
        ("", Align::Left),
    ];
    let row = |name: String, work: &Total, cpu: &Total, remark: &str| {
        [
            name,
            count(work.forecast.mean),
            count(work.forecast.p80),
            count(work.actual),
            percent(work.error),
            seconds(cpu.forecast.mean),
            seconds(cpu.actual),
            percent(cpu.error),
            remark.to_owned(),
        ]
    };
    let mut table = Table::new(&head);
    for frame in &measured.frames {
        let remark = if frame.profiled { "profiled" } else { "" };
        table.row(row(frame.frame.to_string(), &frame.work, &frame.cpu_seconds, remark));
    }
    table.footer();
    table.row(row("all".into(), &measured.work, &measured.cpu_seconds, ""));
    let share = |fraction: f64| format!("{:.2} %", fraction * 100.0);
    table.render()
        + &format!(
            "\nmean |error| of a frame   {} work, {} CPU\nframes at or below        {:.0} % P80, {:.0} % P95\n\
             the quote took            {} of the work, {} of the CPU time\nof it for good            {} of the work, {} of the CPU time\n",
            share(measured.frame_error_work),
            share(measured.frame_error_cpu_seconds),
            measured.frames_within_p80 * 100.0,
            measured.frames_within_p95 * 100.0,
            share(measured.spent.work),
            share(measured.spent.cpu_seconds),
            share(measured.spent_for_good.work),
            share(measured.spent_for_good.cpu_seconds),
        )
}

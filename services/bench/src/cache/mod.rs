//! `forelight bench cache`: the error that an irradiance cache leaves in blocks of pixels.

mod measure;

use crate::images::Quality;
use crate::report::{Report, share};
use anyhow::Result;
use forelight_protocol::MaterialMode;
use forelight_terminal::atomic_file;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::local::thread_pool;
use forelight_terminal::options::positive;
use forelight_terminal::output::Bars;
use forelight_terminal::quantities::count;
use forelight_terminal::table::{Align, Table};
use measure::{Measured, Rung};
use std::path::{Path, PathBuf};

/// Measure the error that an irradiance cache leaves, against light gathered at every point
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight bench cache kitchen/ corridor/
  forelight bench cache kitchen/ --error 0.5,1,2,4
  forelight bench cache kitchen/ --rung '--cache on' --rung '--cache on --cache-accuracy 0.1'

The error is a root mean square over blocks of 4 x 4 pixels, as a share of the image's mean. Only indirect light \
differs. The noise of pixels and of the reference is taken off: two images are made from each cache by independent \
camera samples, and compared to independent references by the same camera samples. `random` is the part that differs \
from seed to seed, and `constant` the part that is the same in all. `structure` is the correlation of the \
differences of pixels that are 8 pixels apart. `choice` is the work of choosing settings for --error, as a share of \
the cache's.")]
pub struct Args {
    /// Scene bundles: folders or zip files
    #[arg(required = true, value_name = "BUNDLE")]
    pub bundles: Vec<PathBuf>,
    /// Frame number
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub frame: u32,
    /// Width of the images in pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 256, value_parser = clap::value_parser!(u32).range(32..=4096))]
    pub size: u32,
    /// Their height [default: as the width]
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(32..=4096))]
    pub height: Option<u32>,
    /// Diffuse bounces of indirect light
    #[arg(long, value_name = "BOUNCES", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=8))]
    pub ambient_bounces: u32,
    /// Use materials as they are, or Lambert surfaces of their base colour
    #[arg(long, value_name = "KIND", default_value = "lambert")]
    pub materials: MaterialMode,
    /// Settings of the cache to measure, as flags of `forelight render`; may be repeated
    /// [default: --cache on, unless --error is given]
    #[arg(long, value_name = "FLAGS", allow_hyphen_values = true)]
    pub rung: Vec<Quality>,
    /// Errors in percent for which settings are chosen, as by `forelight render --cache-error`; may be repeated
    #[arg(long, value_name = "PERCENT", value_parser = positive, value_delimiter = ',')]
    pub error: Vec<f64>,
    /// Number of caches for each of the settings
    #[arg(long, value_name = "NUMBER", default_value_t = 5, value_parser = clap::value_parser!(u64).range(2..=99))]
    pub seeds: u64,
    /// Camera samples per pixel of each image
    #[arg(long, value_name = "SAMPLES", default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub spp: u32,
    /// Rays of a gather of the reference, from each camera sample
    #[arg(long, value_name = "RAYS", default_value_t = 96, value_parser = clap::value_parser!(u32).range(1..=65_536))]
    pub reference_rays: u32,
    /// Threads that trace light [default: one per core]
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Also write the measurements to this file as JSON
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Print the measurements as JSON to standard output
    #[arg(long)]
    pub json: bool,
}

pub fn run(args: &Args, interrupt: &Interrupt) -> Result<Report> {
    atomic_file::check([args.out.as_deref()])?;
    let bars = Bars::new(args.json);
    let rungs = if args.rung.is_empty() && args.error.is_empty() {
        vec!["--cache on".parse().expect("valid flags")]
    } else {
        args.rung.clone()
    };
    let pool = thread_pool(args.threads)?;
    let measured = |bundle: &Path| pool.install(|| measure::bundle(args, bundle, &rungs, &bars, interrupt));
    let report = |measured: &Measured| of(args, measured);
    Report::of_each(&args.bundles, (args.json, args.out.as_deref()), measured, report)
}

fn of(args: &Args, measured: &Measured) -> Report {
    let mut table = Table::new(&[
        ("settings", Align::Left),
        ("records", Align::Right),
        ("work", Align::Right),
        ("choice", Align::Right),
        ("forecast", Align::Right),
        ("error", Align::Right),
        ("from", Align::Right),
        ("to", Align::Right),
        ("random", Align::Right),
        ("constant", Align::Right),
        ("structure", Align::Right),
    ]);
    for rung in &measured.rungs {
        let Rung { flags, error, lowest, highest, random, constant, structure, .. } = rung;
        table.row([
            flags.clone(),
            count(rung.records),
            count(rung.work),
            rung.choosing.map_or(String::new(), |share| format!("{:.0} %", share * 100.0)),
            rung.forecast.map_or(String::new(), share),
            share(*error),
            share(*lowest),
            share(*highest),
            share(*random),
            share(*constant),
            format!("{structure:+.2}"),
        ]);
    }
    let Args { size, ambient_bounces, materials, seeds, .. } = args;
    let height = args.height.unwrap_or(*size);
    let text = format!(
        "{}, {size} x {height}, {ambient_bounces} bounces, {} materials, {seeds} seeds\n\n",
        measured.bundle,
        materials.name()
    );
    Report::default().text(text).table(table).text("\n\n")
}

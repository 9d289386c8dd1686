//! `forelight bench`: measures what the documentation claims, on bundles that the user names.

mod cache;
mod conventions;
mod coverage;
mod divide;
mod effects;
mod farm;
mod forecast;
mod images;
mod paper;
mod plan;
mod preview;
mod rays;
mod renderers;
mod report;
mod seconds;
mod share;
mod shots;
mod statistics;

use anyhow::Result;
use clap::Subcommand;
use forelight_terminal::atomic_file;
use forelight_terminal::interrupt::Interrupt;
use report::{Origin, page};
use std::path::PathBuf;

/// Measure the accuracy of forecasts and the capacity of a farm
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight bench cache kitchen/ corridor/
  forelight bench coverage kitchen/ corridor/ --svg reliability.svg
  forelight bench divide kitchen/ corridor/
  forelight bench effects kitchen/ corridor/
  forelight bench forecast kitchen/ corridor/ --out forecast.json
  forelight bench images kitchen/ --size 256 --pictures images/
  forelight bench preview kitchen/
  forelight bench rays kitchen/
  forelight bench renderers kitchen.blend --frames 0 --samples 64,256
  forelight bench paper kitchen/ corridor/ --out report/
  forelight bench leases
  forelight bench workers --workers 5000
  forelight bench plan
  forelight bench seconds kitchen/ --other ./forelight-of-rack-7
  forelight bench shots kitchen/ corridor/ --svg plots/
  forelight bench plan --write docs/")]
pub struct Args {
    #[command(subcommand)]
    bench: Bench,
    /// Also write the tables into this Markdown file, with command, date, commit and processor. They replace
    /// the bench's section; other sections stay. A folder, such as docs/, means its benchmarks.md
    #[arg(long, global = true, value_name = "FILE.md")]
    write: Option<PathBuf>,
}

#[derive(Debug, Subcommand)]
enum Bench {
    Cache(cache::Args),
    Coverage(coverage::Args),
    Divide(divide::Args),
    Effects(effects::Args),
    Forecast(forecast::Args),
    Paper(paper::Args),
    Leases(farm::leases::Args),
    Workers(farm::workers::Args),
    Plan(plan::Args),
    Images(images::Args),
    Preview(preview::Args),
    Rays(rays::Args),
    Seconds(seconds::Args),
    Shots(shots::Args),
    Renderers(renderers::Args),
}

/// Runs the command.
pub fn run(args: &Args, interrupt: &Interrupt) -> Result<()> {
    let file = args.write.as_deref().map(page::file).transpose()?;
    atomic_file::check([file.as_deref()])?;
    let (name, report) = match &args.bench {
        Bench::Cache(args) => ("cache", cache::run(args, interrupt)?),
        Bench::Coverage(args) => ("coverage", coverage::run(args, interrupt)?),
        Bench::Divide(args) => ("divide", divide::run(args, interrupt)?),
        Bench::Effects(args) => ("effects", effects::run(args, interrupt)?),
        Bench::Forecast(args) => ("forecast", forecast::run(args, interrupt)?),
        Bench::Paper(args) => ("paper", paper::run(args, interrupt)?),
        Bench::Leases(args) => ("leases", farm::leases::run(args, interrupt)?),
        Bench::Workers(args) => ("workers", farm::workers::run(args, interrupt)?),
        Bench::Plan(args) => ("plan", plan::run(args)?),
        Bench::Images(args) => ("images", images::run(args, interrupt)?),
        Bench::Preview(args) => ("preview", preview::run(args, interrupt)?),
        Bench::Rays(args) => ("rays", rays::run(args, interrupt)?),
        Bench::Seconds(args) => ("seconds", seconds::run(args, interrupt)?),
        Bench::Shots(args) => ("shots", shots::run(args, interrupt)?),
        Bench::Renderers(args) => ("renderers", renderers::run(args, interrupt)?),
    };
    match file {
        Some(file) => page::write(&file, name, &Origin::of(&file)?, &report),
        None => Ok(()),
    }
}

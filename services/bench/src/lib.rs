//! `forelight bench`: measurements of what this program promises, on bundles that the user names.

mod conventions;
mod coverage;
mod effects;
mod farm;
mod forecast;
mod images;
mod paper;
mod plan;
mod rays;
mod seconds;
mod shots;
mod statistics;

use anyhow::Result;
use clap::Subcommand;
use forelight_terminal::interrupt::Interrupt;

/// Measure how good forecasts are, and how much the farm bears
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight bench coverage kitchen/ corridor/ --svg reliability.svg
  forelight bench effects kitchen/ corridor/
  forelight bench forecast kitchen/ corridor/ --out forecast.json
  forelight bench images kitchen/ --size 256 --pictures images/
  forelight bench rays kitchen/
  forelight bench paper kitchen/ corridor/ --out report/
  forelight bench leases
  forelight bench workers --workers 5000
  forelight bench plan
  forelight bench seconds kitchen/ --other ./forelight-of-rack-7
  forelight bench shots kitchen/ corridor/ --svg plots/")]
pub struct Args {
    #[command(subcommand)]
    bench: Bench,
}

#[derive(Debug, Subcommand)]
enum Bench {
    Coverage(coverage::Args),
    Effects(effects::Args),
    Forecast(forecast::Args),
    Paper(paper::Args),
    Leases(farm::leases::Args),
    Workers(farm::workers::Args),
    Plan(plan::Args),
    Images(images::Args),
    Rays(rays::Args),
    Seconds(seconds::Args),
    Shots(shots::Args),
}

/// Runs the command.
pub fn run(args: &Args, interrupt: &Interrupt) -> Result<()> {
    match &args.bench {
        Bench::Coverage(args) => coverage::run(args, interrupt),
        Bench::Effects(args) => effects::run(args, interrupt),
        Bench::Forecast(args) => forecast::run(args, interrupt),
        Bench::Paper(args) => paper::run(args, interrupt),
        Bench::Leases(args) => farm::leases::run(args, interrupt),
        Bench::Workers(args) => farm::workers::run(args, interrupt),
        Bench::Plan(args) => plan::run(args),
        Bench::Images(args) => images::run(args, interrupt),
        Bench::Rays(args) => rays::run(args, interrupt),
        Bench::Seconds(args) => seconds::run(args, interrupt),
        Bench::Shots(args) => shots::run(args, interrupt),
    }
}

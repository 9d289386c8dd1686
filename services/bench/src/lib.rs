//! `forelight bench`: measurements of what this program promises, on bundles that the user names.

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

use anyhow::Result;
use clap::Subcommand;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::options::QualityOptions;

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

/// Width and height of the image of the paper's experiment, pixels.
const PAPER_SIZE: u32 = 256;

/// The ambient levels that are tried: those that were listed, the one that the quality has, or direct light and one bounce.
fn bounces_to_try(listed: &[u32], quality: &QualityOptions) -> Vec<u32> {
    match (listed, quality.ambient_bounces) {
        ([], Some(bounces)) => vec![bounces],
        ([], None) => vec![0, 1],
        _ => listed.to_vec(),
    }
}

/// forecast / actual − 1; 0 if both are 0.
fn relative_error(forecast: f64, actual: f64) -> f64 {
    if actual == forecast { 0.0 } else { forecast / actual - 1.0 }
}

/// Mean of the absolute values; 0 of none.
fn mean_absolute(errors: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = errors.fold((0.0, 0u32), |(sum, count), error| (sum + error.abs(), count + 1));
    if count == 0 { 0.0 } else { sum / f64::from(count) }
}

/// Name of what is written of a bundle: its own as far as it is plain, and its place, so that no two are the same.
fn slug(place: usize, name: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '-' };
    format!("{}-{}", place + 1, name.chars().take(40).map(plain).collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_terminal::options::parsed;

    #[test]
    fn names_of_files_are_plain_and_never_the_same() {
        assert_eq!(slug(0, "A kitchen/../x"), "1-a-kitchen----x");
        assert_ne!(slug(0, "same"), slug(1, "same"));
    }

    #[test]
    fn the_levels_that_are_listed_are_tried_or_the_one_that_the_quality_has() {
        let quality = |flags: &[&str]| parsed::<QualityOptions>([&["bench"], flags].concat());
        assert_eq!(bounces_to_try(&[], &quality(&["--ambient-bounces", "2"])), [2]);
        assert_eq!(bounces_to_try(&[], &quality(&[])), [0, 1]);
        assert_eq!(bounces_to_try(&[1, 3], &quality(&[])), [1, 3]);
    }

    #[test]
    fn errors_have_a_sign_and_their_mean_has_none() {
        assert_eq!(relative_error(150.0, 100.0), 0.5);
        assert_eq!(relative_error(0.0, 0.0), 0.0);
        assert_eq!(mean_absolute([0.5, -0.25].into_iter()), 0.375);
        assert_eq!(mean_absolute(std::iter::empty()), 0.0);
    }
}

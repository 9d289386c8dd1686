//! `forelight bench images`: the cost of an image error with an irradiance cache, without one, and in other
//! programs.

mod args;
mod ladder;
mod measure;
mod measured;
mod opened;
mod peer;
mod picture;
mod quality;
mod rendered;
mod report;

pub use args::Args;
pub use quality::Quality;

use crate::report::Report;
use anyhow::Result;
use forelight_terminal::atomic_file;
use forelight_terminal::failure::BadInput;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::output::Bars;
use std::path::Path;

pub fn run(args: &Args, interrupt: &Interrupt) -> Result<Report> {
    if args.bundles.len() > 1 && !args.peer.is_empty() {
        return Err(BadInput::new("--peer: an image belongs to one bundle, so name only one").into());
    }
    atomic_file::check([args.out.as_deref()])?;
    let bars = Bars::new(args.json);
    let rungs = if args.rung.is_empty() { quality::ladder() } else { args.rung.clone() };
    let measured = |bundle: &Path| {
        measure::Bench::open(args, bundle, &rungs, &bars, interrupt).and_then(|bench| bench.measure(&rungs))
    };
    Report::of_each(&args.bundles, (args.json, args.out.as_deref()), measured, report::of)
}

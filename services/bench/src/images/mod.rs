//! `forelight bench images`: what an image error costs, with an irradiance cache, without one, and in other programs.

mod allotted;
mod args;
mod ladder;
mod measure;
mod measured;
mod peer;
mod picture;
mod quality;
mod rendered;
mod report;

pub use args::Args;

use anyhow::Result;
use forelight_terminal::atomic_file::{self, write_bytes};
use forelight_terminal::failure::BadInput;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::output::{self, Bars};

/// Runs the command.
pub fn run(args: &Args, interrupt: &Interrupt) -> Result<()> {
    if args.bundles.len() > 1 && !args.peer.is_empty() {
        return Err(BadInput::new("--peer: an image belongs to one bundle, and there are several").into());
    }
    atomic_file::check([args.out.as_deref()])?;
    let bars = Bars::new(args.json);
    let rungs = if args.rung.is_empty() { quality::ladder() } else { args.rung.clone() };
    let mut measured = Vec::with_capacity(args.bundles.len());
    for bundle in &args.bundles {
        let bench = measure::Bench::open(args, bundle, &rungs, &bars, interrupt)?;
        let scene = bench.measure(&rungs)?;
        if !args.json {
            output::print(&report::text(&scene))?;
        }
        measured.push(scene);
    }
    if let Some(path) = &args.out {
        write_bytes(path, (output::pretty(&measured)? + "\n").as_bytes())?;
    }
    if args.json { output::json(&measured) } else { Ok(()) }
}

//! `forelight cache`: plans the irradiance cache of a shot, and fills it in any number of processes.

use super::cache_error::{Asker, CacheErrorOption};
use anyhow::{Context, Result};
use clap::Subcommand;
use forelight_protocol::{CACHE_BYTES, FrameSet};
use forelight_renderer_own::{RenderError, seconds as seconds_of};
use forelight_terminal::atomic_file::{self, write_bytes};
use forelight_terminal::bounded_file;
use forelight_terminal::failure::{BadInput, Interrupted};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::local::Local;
use forelight_terminal::options::{MachineOptions, QualityOptions};
use forelight_terminal::output::{self, Bars};
use forelight_terminal::quantities::{count, seconds};
use forelight_tracer::{Cache, CacheTotals};
use serde::Serialize;
use std::path::{Path, PathBuf};

pub const NO_USE_FOR_A_CACHE: &str = "these settings use no irradiance cache: it needs the integrator `ambient` and at least one ambient bounce";

/// Plan, fill and merge the irradiance cache of a shot, for `forelight render --cache-file`
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight cache plan kitchen/ --frames 0-47 --ambient-bounces 1 --out plan.cache
  forelight cache fill kitchen/ --ambient-bounces 1 --cache-file plan.cache --part 1/2 --out 1.cache
  forelight cache fill kitchen/ --ambient-bounces 1 --cache-file plan.cache --part 2/2 --out 2.cache
  forelight cache merge 1.cache 2.cache --out shot.cache
  forelight render kitchen/ --frame 12 --ambient-bounces 1 --cache-file shot.cache --out 12.exr

Planning finds the number of records that the shot needs, before any light is gathered. Any processes on any \
machines may fill parts, and merge them in any order: the images have the same bits. Every bounce has a \
level of records, and the deepest is filled first. Fill and merge the parts once for each level then, or fill \
without --part. A frame replaces the records whose light has changed because an object or a light has moved.

\
The later steps need the same quality. After `plan --cache-error`, give them the --cache-accuracy and --cache-rays that \
it prints.")]
pub struct Args {
    #[command(subcommand)]
    step: Step,
}

#[derive(Debug, Subcommand)]
enum Step {
    Plan(Plan),
    Fill(Fill),
    Merge(Merge),
}

/// Plan where the frames of a shot need records
#[derive(Debug, clap::Args)]
struct Plan {
    /// Scene: a .glb or .gltf file, or a bundle, which is a folder or a zip file
    bundle: PathBuf,
    /// Frames, such as 0-47 or 0,5,9-12. The first one holds the records' positions [default: the whole shot]
    #[arg(long, value_name = "LIST")]
    frames: Option<FrameSet>,
    #[command(flatten)]
    written: Written,
    #[command(flatten)]
    quality: QualityOptions,
    #[command(flatten)]
    cache_error: CacheErrorOption,
    #[command(flatten)]
    machine: MachineOptions,
}

/// Gather the light of a planned cache, or of one part of it
#[derive(Debug, clap::Args)]
struct Fill {
    /// Scene: a .glb or .gltf file, or a bundle, which is a folder or a zip file
    bundle: PathBuf,
    /// Cache to fill, from `plan`, `fill` or `merge`
    #[arg(long, value_name = "FILE")]
    cache_file: PathBuf,
    /// Part to fill, such as 1/4 of the deepest level that is not full [default: all parts]
    #[arg(long, value_name = "PART/PARTS", value_parser = part)]
    part: Option<(u32, u32)>,
    #[command(flatten)]
    written: Written,
    #[command(flatten)]
    quality: QualityOptions,
    #[command(flatten)]
    machine: MachineOptions,
}

/// Merge parts of one plan that were filled separately
#[derive(Debug, clap::Args)]
struct Merge {
    /// Caches from the same plan
    #[arg(required = true, value_name = "CACHE")]
    parts: Vec<PathBuf>,
    #[command(flatten)]
    written: Written,
}

#[derive(Debug, clap::Args)]
struct Written {
    /// File to write the cache to
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Print the numbers of the cache (records, work, CPU time) as JSON to standard output
    #[arg(long)]
    json: bool,
}

impl Written {
    fn check(&self) -> Result<()> {
        atomic_file::check([Some(&*self.out)])
    }
}

#[derive(Debug, Serialize)]
struct Held {
    /// The frame of the records' positions.
    frame: u32,
    records: Vec<u64>,
    filled: u64,
    /// Records with infinite or undefined values. They are never used.
    rejected: u64,
    plan_work: u64,
    plan_cpu_seconds: f64,
    fill_work: u64,
    fill_cpu_seconds: f64,
    bytes: u64,
}
pub fn run(args: &Args, interrupt: &Interrupt) -> Result<()> {
    match &args.step {
        Step::Plan(args) => plan(args, interrupt),
        Step::Fill(args) => fill(args, interrupt),
        Step::Merge(args) => merge(args),
    }
}

fn plan(args: &Plan, interrupt: &Interrupt) -> Result<()> {
    args.written.check()?;
    let bars = Bars::new(args.written.json);
    let local = Local::open(&args.bundle, &args.machine, &bars)?;
    let mut settings = local.settings(&args.quality.cached()?)?;
    let frames = local.frames(args.frames.as_ref())?;
    let middle = local.middle_frame(args.frames.as_ref())?;
    let here = Asker { local: &local, bundle: &args.bundle, bars: &bars, interrupt };
    args.cache_error.choose(&mut settings, middle, &here)?;
    let bar = bars.bar("planning", frames.len() as u64);
    let planned = local.pool.install(|| {
        local.shot.plan_cache(&frames, &settings, &|done| bar.set_position(done), interrupt.flag())
    });
    bar.finish_and_clear();
    let planned = planned.with_context(|| format!("bundle {}", args.bundle.display()))?;
    if interrupt.is_set() {
        return Err(Interrupted.into());
    }
    write(&planned.ok_or_else(|| BadInput::new(NO_USE_FOR_A_CACHE))?, &args.written)
}

fn fill(args: &Fill, interrupt: &Interrupt) -> Result<()> {
    args.written.check()?;
    let cache = read_cache(&args.cache_file)?;
    let bars = Bars::new(args.written.json);
    let local = Local::open(&args.bundle, &args.machine, &bars)?;
    let settings = local.settings(&args.quality.cached()?)?;
    let bar = bars.bar("filling", 0);
    let progress = |done, all| {
        bar.set_length(all);
        bar.set_position(done);
    };
    let part = args.part.unwrap_or((0, 1));
    let filled =
        local.pool.install(|| local.shot.fill_cache(cache, &settings, part, &progress, interrupt.flag()));
    bar.finish_and_clear();
    let filled = filled.with_context(|| format!("--cache-file {}", args.cache_file.display()))?;
    write(&filled.ok_or(Interrupted)?, &args.written)
}

fn merge(args: &Merge) -> Result<()> {
    args.written.check()?;
    let mut merged: Option<Cache> = None;
    for path in &args.parts {
        let part = read_cache(path)?;
        match &mut merged {
            None => merged = Some(part),
            Some(whole) => {
                whole.merge(&part).map_err(RenderError::from).with_context(|| path.display().to_string())?;
            }
        }
    }
    let merged = merged.ok_or_else(|| BadInput::new("there is no cache to merge"))?;
    merged.smooth_full();
    write(&merged, &args.written)
}

pub fn read_cache(path: &Path) -> Result<Cache> {
    let bytes = bounded_file::read(path, CACHE_BYTES)?;
    Cache::from_bytes(&bytes).map_err(RenderError::from).with_context(|| path.display().to_string())
}

/// Reads a cache for frames to share. Fails if it is not full.
pub fn read_full_cache(path: &Path) -> Result<Cache> {
    let cache = read_cache(path)?;
    if !cache.is_complete() {
        let CacheTotals { records, filled, .. } = cache.totals();
        let reason = format!(
            "{}: the irradiance cache is not full: {filled} of {} records are filled. Each frame would gather the rest itself, with its own noise",
            path.display(),
            records.iter().sum::<u64>()
        );
        return Err(BadInput::new(reason)
            .hint("fill it with `forelight cache fill`, and merge its parts with `forelight cache merge`")
            .into());
    }
    Ok(cache)
}

fn write(cache: &Cache, to: &Written) -> Result<()> {
    let bytes = cache.to_bytes();
    write_bytes(&to.out, &bytes)?;
    let CacheTotals { records, plan, fill, filled, rejected, .. } = cache.totals();
    let held = Held {
        frame: cache.frame(),
        records,
        filled,
        rejected,
        plan_work: plan.work,
        plan_cpu_seconds: seconds_of(plan.cpu_nanos),
        fill_work: fill.work,
        fill_cpu_seconds: seconds_of(fill.cpu_nanos),
        bytes: bytes.len() as u64,
    };
    if to.json { output::json(&held) } else { output::print(&report(&held)) }
}

fn report(held: &Held) -> String {
    let levels: Vec<String> = held.records.iter().map(|&records| count(records as f64)).collect();
    let cost =
        |work: u64, cpu: f64| format!("{} operations, {} of CPU time", count(work as f64), seconds(cpu));
    let mut text = format!("records   {} at the positions of frame {}\n", levels.join(" + "), held.frame);
    let missing = held.records.iter().sum::<u64>().saturating_sub(held.filled);
    let rest =
        if missing > 0 { format!("; {} are not filled yet", count(missing as f64)) } else { String::new() };
    text += &format!("filled    {}{rest}\n", count(held.filled as f64));
    if held.rejected > 0 {
        text += &format!("rejected  {}: their values are not finite, so they are not used\n", held.rejected);
    }
    text += &format!("planning  {}\n", cost(held.plan_work, held.plan_cpu_seconds));
    text += &format!("filling   {}\n", cost(held.fill_work, held.fill_cpu_seconds));
    text
}

/// Reads `2/4` as part 1, counted from 0, of 4.
fn part(text: &str) -> Result<(u32, u32), String> {
    let numbers =
        text.split_once('/').and_then(|(part, parts)| Some((part.parse().ok()?, parts.parse().ok()?)));
    match numbers {
        Some((part, parts)) if (1..=parts).contains(&part) => Ok((part - 1, parts)),
        _ => Err("expected PART/PARTS, such as 1/4".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::part;

    #[test]
    fn parts_are_counted_from_one() {
        assert_eq!(part("1/4"), Ok((0, 4)));
        assert_eq!(part("4/4"), Ok((3, 4)));
        for wrong in ["0/4", "5/4", "4", "1/0", "a/b", "-1/2", "1/2/3", ""] {
            assert!(part(wrong).is_err(), "{wrong}");
        }
    }
}

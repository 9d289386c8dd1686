//! `forelight render`: one frame on this machine, with its true cost.

use super::allot::{self, AllotArgs, Stopping};
use super::cache::read_cache;
use crate::atomic_file::{write_bytes, write_with};
use crate::failure::{BadInput, Interrupted};
use crate::interrupt::Interrupt;
use crate::local::Local;
use crate::options::{MachineOptions, QualityOptions};
use crate::output::{self, Bars, RenderBar};
use crate::quantities::{count, seconds};
use crate::table::{Align, Table};
use anyhow::{Context, Result};
use clap::ValueEnum;
use forelight_protocol::{CacheMode, LeftOut, Rays, RenderStats};
use forelight_tracer::Profile;
use forelight_worker::{Given, RenderError, Rendered, png, render_allotted, render_frame};
use std::fs;
use std::path::{Path, PathBuf};

/// Render one frame, and say what it took
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight render kitchen/ --frame 12 --out 12.exr
  forelight render kitchen.zip --width 640 --spp 16 --out f.exr --stats f.json
  forelight render kitchen/ --profile profiles/frame-0000.profile --out 0.png
  forelight render kitchen/ --cache on --cache-accuracy 0.1 --out smooth.png
  forelight render kitchen/ --frame 12 --cache-file shot.cache --out 12.exr
  forelight render kitchen/ --integrator path --spp 256 --out caustics.png
  forelight render kitchen/ --cache on --within 60 --out minute.png
  forelight render kitchen/ --cache on --error 2 --confidence p95 --out clean.exr

The image has the same bits whatever the threads, and whether or not a profile was taken over. An .exr holds \
linear colour and, beside it, object and material ids, cost and rays of every pixel; a .png is for looking at.")]
pub struct Args {
    /// Scene bundle: a folder or a zip file
    bundle: PathBuf,
    /// Frame number
    #[arg(long, value_name = "N", default_value_t = 0)]
    frame: u32,
    /// Image to write, .exr or .png
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Also write the cost of every pixel in colour: cyan is cheap, red is dear
    #[arg(long, value_name = "FILE.png")]
    cost_map: Option<PathBuf>,
    /// Write the frame's cost as JSON
    #[arg(long, value_name = "FILE")]
    stats: Option<PathBuf>,
    /// Take over the finished pixels, or the irradiance cache, of a profile that `forelight forecast --save-profile` wrote
    #[arg(long, value_name = "FILE")]
    profile: Option<PathBuf>,
    /// Take over the irradiance cache of the shot that `forelight cache` made; implies --cache on
    #[arg(long, value_name = "FILE", conflicts_with = "profile")]
    cache_file: Option<PathBuf>,
    /// Trace with code for what the scene calls for alone, or for everything, with nothing left out: the image has the same bits
    #[arg(long, value_name = "WHICH", default_value = "called-for")]
    effects: EffectsSwitch,
    /// Print the cost as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    allot: AllotArgs,
    #[command(flatten)]
    quality: QualityOptions,
    #[command(flatten)]
    machine: MachineOptions,
}

/// Which effects the code that traces a frame holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum EffectsSwitch {
    /// Those that the frame calls for.
    CalledFor,
    /// All, and lights and objects that cannot matter stay in.
    All,
}

/// Formats that an image can be written in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    Exr,
    Png,
}

/// Runs the command.
pub fn run(args: &Args, interrupt: &Interrupt) -> Result<()> {
    let format = args.out.as_deref().map(format_of).transpose()?;
    let profile = args.profile.as_deref().map(read_profile).transpose()?;
    let cache = args.cache_file.as_deref().map(read_cache).transpose()?;
    let bars = Bars::new(args.json);
    let mut local = Local::open(&args.bundle, &args.machine, &bars)?;
    if args.effects == EffectsSwitch::All {
        local.shot = local.shot.with_everything();
    }
    let mut settings = local.settings(&args.quality)?;
    if cache.is_some() {
        settings.cache = CacheMode::On;
    }
    let bar = RenderBar::new(&bars);
    let progress = |progress| bar.show(progress);
    let rendered = local
        .pool
        .install(|| {
            let given = Given { profile: profile.as_ref(), cache };
            match args.allot.options() {
                None => {
                    Ok(render_frame(&local.shot, args.frame, &settings, given, &progress, interrupt.flag())?)
                }
                Some(options) => {
                    let stopping = Stopping(interrupt);
                    render_allotted(&local.shot, args.frame, &settings, given, &options, &progress, &stopping)
                        .map_err(allot::failure)
                }
            }
        })
        .with_context(|| format!("bundle {}", args.bundle.display()))?;
    drop(bar);
    let rendered = rendered.ok_or(Interrupted)?;
    if let (Some(path), Some(format)) = (&args.out, format) {
        write_image(&rendered, path, format)?;
    }
    if let Some(path) = &args.cost_map {
        write_bytes(path, &png(&rendered.image.cost_map())?)?;
    }
    if let Some(path) = &args.stats {
        write_bytes(path, (output::pretty(&rendered.stats)? + "\n").as_bytes())?;
    }
    if args.json { output::json(&rendered.stats) } else { output::print(&report(&rendered.stats)) }
}

fn format_of(path: &Path) -> Result<Format> {
    match path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).as_deref() {
        Some("exr") => Ok(Format::Exr),
        Some("png") => Ok(Format::Png),
        _ => {
            Err(BadInput::new(format!("--out {}: the name must end in .exr or .png", path.display())).into())
        }
    }
}

fn read_profile(path: &Path) -> Result<Profile> {
    let bytes = fs::read(path).map_err(|e| BadInput::new(format!("--profile {}: {e}", path.display())))?;
    Profile::from_bytes(&bytes)
        .map_err(RenderError::from)
        .with_context(|| format!("--profile {}", path.display()))
}

fn write_image(rendered: &Rendered, path: &Path, format: Format) -> Result<()> {
    match format {
        Format::Exr => {
            write_with(path, |temporary| Ok(rendered.image.write_exr(temporary, &rendered.frame)?))
        }
        Format::Png => write_bytes(path, &png(&rendered.image.picture())?),
    }
}

/// The cost of a frame for people.
fn report(stats: &RenderStats) -> String {
    let mut table = Table::new(&[("rays", Align::Left), ("count", Align::Right)]);
    for (name, rays) in Rays::NAMES.iter().zip(stats.rays.to_array()).filter(|(_, rays)| *rays > 0) {
        table.row([(*name).to_owned(), count(rays as f64)]);
    }
    table.footer();
    table.row(["all".into(), count(stats.rays.total() as f64)]);
    let mut text = table.render();
    let RenderStats { frame, width, height, spp, .. } = stats;
    text += &format!("\nframe {frame}, {width} x {height}, {spp} samples per pixel\n");
    text += &stats.allotted.as_ref().map_or_else(String::new, allot::report);
    text += &format!("effects     {}\n", stats.effects.join(", "));
    for LeftOut { what, reason } in &stats.left_out {
        text += &format!("left out    {what}: {reason}\n");
    }
    text += &format!("work        {} operations\n", count(stats.work as f64));
    text += &format!("CPU time    {}\n", seconds(stats.cpu_seconds));
    text += &format!("wall time   {}\n", seconds(stats.wall_seconds));
    if let Some(cache) = &stats.cache {
        let levels: Vec<String> = stats.cache_records.iter().map(u64::to_string).collect();
        let share = |work: u64| 100.0 * work as f64 / stats.work.max(1) as f64;
        text += &format!(
            "cache       {} records; {:.1} % of the work for planning, {:.1} % for filling; {} points uncovered\n",
            levels.join(" + "),
            share(cache.plan_work),
            share(cache.fill_work),
            cache.uncovered
        );
        if cache.shared_records + cache.dropped_records > 0 {
            let records: u64 = stats.cache_records.iter().sum();
            text += &format!(
                "            {} records are the shot's, {} of the shot's do not hold here, {} were made for this frame\n",
                cache.shared_records,
                cache.dropped_records,
                records.saturating_sub(cache.shared_records)
            );
        }
        if cache.rejected > 0 {
            text += &format!("            {} records are not finite and were not used\n", cache.rejected);
        }
    }
    if stats.reused_work > 0 {
        let reused = stats.cache.map_or(0, |cache| cache.reused_records);
        text += &format!(
            "taken over  {} pixels, {reused} records, {} of the CPU time above\n",
            stats.reused_pixels,
            seconds(stats.reused_cpu_seconds)
        );
    }
    text
}

//! `forelight render`: renders frames on this machine, or one on a farm, and reports their true cost.

mod on_farm;
mod sequence;

use self::on_farm::FarmOptions;
use super::allot::{self, AllotArgs};
use super::cache::read_full_cache;
use super::cache_error::{Asker, CacheErrorOption};
use super::explain;
use super::forecast::once_costs;
use super::foreign;
use crate::job_options::png_file;
use anyhow::{Context, Result};
use clap::ValueEnum;
use forelight_denoise::Denoiser;
use forelight_protocol::words::counted;
use forelight_protocol::{
    CACHE_BYTES, CacheChoice, DenoisedStats, FrameSet, LeftOut, Rays, RenderSettings, RenderStats,
};
use forelight_renderer_own::{
    Given, Progress, RenderError, png, render_allotted, render_as_allotted, render_frame,
};
use forelight_scene::Frame;
use forelight_terminal::atomic_file::{self, write_bytes, write_with};
use forelight_terminal::bounded_file;
use forelight_terminal::failure::{BadInput, Interrupted};
use forelight_terminal::foreign::{OwnSetting, is_foreign, own_setting, refuse, refuse_own_settings};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::json_file;
use forelight_terminal::local::Local;
use forelight_terminal::options::{MachineOptions, QualityOptions};
use forelight_terminal::output::{self, Bars, RenderBar};
use forelight_terminal::quantities::{count, seconds};
use forelight_terminal::table::{Align, Table};
use forelight_terminal::watching::{Stopping, allotment_failure};
use forelight_tracer::{Cache, Image, Profile};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Render a frame, or several, and report their cost
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight render kitchen/ --frame 12 --out 12.exr
  forelight render kitchen.zip --width 640 --spp 16 --out f.exr --stats f.json
  forelight render kitchen/ --frames 0-47 --out images/####.exr
  forelight render kitchen/ --profile profiles/frame-0000.profile --out 0.png
  forelight render kitchen/ --cache-error 1 --out smooth.png
  forelight render kitchen/ --frame 12 --cache-file shot.cache --out 12.exr
  forelight render kitchen/ --integrator path --spp 256 --out caustics.png
  forelight render kitchen/ --cache on --within 60 --out minute.png --samples-map minute-samples.png
  forelight render kitchen/ --cache on --samples-from minute-samples.png --out again.png
  forelight render kitchen/ --cache on --within-money 0.25 --price 1.80 --out quarter.exr
  forelight render kitchen/ --cache on --error 2 --confidence p95 --out clean.exr
  forelight render kitchen/ --spp 16 --denoise --out draft.exr
  forelight render kitchen/ --server http://farm:7878 --parts 16 --watch growing.png --out 0.exr

The image has the same bits for any number of threads, with or without a profile. An .exr file holds linear colour, \
object and material ids, and the cost and rays of every pixel. A .png file is for viewing.

With --frames, the scene is read once. The last row of # in a file's name becomes the frame's number. Quote a name that \
begins with #, which a shell would take for a comment. --json prints one line for each frame.")]
pub struct Args {
    /// Scene: a .glb or .gltf file, or a bundle, which is a folder or a zip file. Or a .blend file, which
    /// Blender Cycles renders, or a .rif file or octree, which Radiance renders
    bundle: PathBuf,
    /// Frame number [default: the first frame]
    #[arg(long, value_name = "N")]
    frame: Option<i32>,
    /// Frames to render one after the other, such as 0-47 or 0,5,9-12. In names of files, #### becomes the
    /// frame's number
    #[arg(long, value_name = "LIST", conflicts_with_all = ["frame", "server"])]
    frames: Option<FrameSet>,
    /// Image file to write, .exr or .png
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Write the cost of each pixel as a picture: cyan is cheap, red is expensive
    #[arg(long, value_name = "FILE.png", value_parser = png_file)]
    cost_map: Option<PathBuf>,
    /// Write the frame's cost as JSON into this file
    #[arg(long, value_name = "FILE")]
    stats: Option<PathBuf>,
    /// Take over the finished pixels or the irradiance cache of a profile from
    /// `forelight forecast --save-profile`
    #[arg(long, value_name = "FILE", conflicts_with = "cache_error")]
    profile: Option<PathBuf>,
    /// Take over the shot's irradiance cache from `forelight cache`. Implies --cache on
    #[arg(long, value_name = "FILE", conflicts_with_all = ["profile", "cache_error"])]
    cache_file: Option<PathBuf>,
    /// Remove the noise of the image by Open Image Denoise, if it is installed, and measure the error that is
    /// left. An .exr file keeps the noisy image as noisy.R, G, B
    #[arg(long, conflicts_with_all = ["within", "within_money", "error", "samples_from"])]
    denoise: bool,
    /// Code to trace with: only the effects that the frame needs, or all of them. The image has the same bits
    #[arg(long, value_name = "WHICH", default_value = "called-for")]
    effects: EffectsSwitch,
    /// Change a setting of another renderer, such as adaptive_sampling=false. May be repeated
    #[arg(long = "set", value_name = "NAME=VALUE", value_parser = own_setting())]
    own: Vec<OwnSetting>,
    /// Print the cost as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    allot: AllotArgs,
    #[command(flatten)]
    quality: QualityOptions,
    #[command(flatten)]
    cache_error: CacheErrorOption,
    #[command(flatten)]
    machine: MachineOptions,
    #[command(flatten)]
    farm: FarmOptions,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum EffectsSwitch {
    /// Only the effects that the frame needs
    CalledFor,
    /// All effects, with the lights and objects that nothing sees
    All,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    Exr,
    Png,
}

pub async fn run(args: Args, interrupt: Interrupt) -> Result<()> {
    args.allot.check()?;
    if args.farm.is_asked() {
        return on_farm::run(&args, &interrupt).await;
    }
    args.farm.refuse_without_server()?;
    // Tracing light would block the runtime, so it has a thread of its own.
    super::blocking(move || render_here(&args, &interrupt)).await
}

fn render_here(args: &Args, interrupt: &Interrupt) -> Result<()> {
    if is_foreign(&args.bundle) {
        return render_foreign(args, interrupt);
    }
    refuse_own_settings(&args.own)?;
    if let Some(frames) = &args.frames {
        return sequence::render(args, frames, interrupt);
    }
    let frame = args.frame.unwrap_or(0);
    let frame =
        u32::try_from(frame).map_err(|_| BadInput::new(format!("--frame {frame}: frames begin at 0")))?;
    let wish = args.allot.wish(Instant::now());
    let samples_map = args.allot.check_map()?;
    let files = Files::new(args.out.as_deref(), args.cost_map.as_deref())?;
    atomic_file::check([args.out.as_deref(), args.cost_map.as_deref(), args.stats.as_deref(), samples_map])?;
    let profile = args.profile.as_deref().map(read_profile).transpose()?;
    let bars = Bars::new(args.json);
    let mut opened = Opened::new(args, &bars)?;
    opened.choose_cache(args, frame, &bars, interrupt)?;
    let size = (opened.settings.width, opened.settings.height);
    let samples = args.allot.given_samples(size)?;
    // If writing fails, the final write reports it.
    let rehearse = |image: &Image, frame: &Frame| drop(files.rehearse(image, frame));
    let options = wish.options(&rehearse)?;
    let stopping = Stopping(interrupt);
    let cache = opened.cache.take();
    let rendered = opened.trace(profile.as_ref(), cache, &bars, |given, progress| {
        let (shot, settings) = (&opened.local.shot, &opened.settings);
        match (&samples, &options) {
            (Some(samples), _) => {
                let again = render_as_allotted(shot, frame, settings, given, samples, progress, &stopping);
                Ok(again?.map(|allotted| (allotted.rendered, Some(allotted.samples))))
            }
            (None, Some(options)) => {
                let made = render_allotted(shot, frame, settings, given, options, progress, &stopping);
                let made = made.map_err(|error| allotment_failure(args.allot.limit(), error))?;
                Ok(made.map(|allotted| (allotted.rendered, Some(allotted.samples))))
            }
            (None, None) => {
                let made = render_frame(shot, frame, settings, given, progress, interrupt.flag())?;
                Ok(made.map(|rendered| (rendered, None)))
            }
        }
    })?;
    let (mut rendered, samples) = rendered.ok_or(Interrupted)?;
    opened.local.pool.install(|| files.write(&rendered.image, &rendered.frame))?;
    if let Some(samples) = &samples {
        args.allot.write_samples(samples, size)?;
    }
    if let Some(within) = rendered.stats.allotted.as_mut().and_then(|allotted| allotted.within.as_mut()) {
        wish.settle(within);
    }
    rendered.stats.cache_choice = opened.choice;
    json_file::write(args.stats.as_deref(), &rendered.stats)?;
    if args.json {
        output::json(&rendered.stats)?;
    } else {
        output::print(&report(&rendered.stats, args.effects))?;
        if args.out.is_none() && args.cost_map.is_none() {
            bars.note("the image was not written; --out FILE keeps it");
        }
    }
    rendered.stats.allotted.as_deref().map_or(Ok(()), |allotted| args.allot.check_error(allotted))
}

/// A scene and how it is rendered.
struct Opened {
    bundle: PathBuf,
    local: Local,
    settings: RenderSettings,
    cache: Option<Cache>,
    denoiser: Option<Denoiser>,
    /// How the settings of the cache were chosen.
    choice: Option<CacheChoice>,
}

impl Opened {
    fn new(args: &Args, bars: &Bars) -> Result<Self> {
        let denoiser = args.denoise.then(Denoiser::find).transpose().context("--denoise")?;
        let cache = args.cache_file.as_deref().map(read_full_cache).transpose()?;
        let mut local = Local::open(&args.bundle, &args.machine, bars)?;
        if args.effects == EffectsSwitch::All {
            local.shot = local.shot.with_everything();
        }
        let quality = if cache.is_some() { args.quality.cached()? } else { args.quality.clone() };
        let settings = local.settings(&args.cache_error.quality(&quality)?)?;
        Ok(Self { bundle: args.bundle.clone(), local, settings, cache, denoiser, choice: None })
    }

    /// Chooses the settings of the cache on a frame, if an error is given.
    fn choose_cache(&mut self, args: &Args, frame: u32, bars: &Bars, interrupt: &Interrupt) -> Result<()> {
        let here = Asker { local: &self.local, bundle: &self.bundle, bars, interrupt };
        self.choice = args.cache_error.choose(&mut self.settings, frame, &here)?;
        Ok(())
    }

    /// Runs `trace` on all threads, with what is given to the frame and a bar for its progress.
    fn trace<T: Send>(
        &self,
        profile: Option<&Profile>,
        cache: Option<Cache>,
        bars: &Bars,
        trace: impl FnOnce(Given<'_>, &(dyn Fn(Progress) + Sync)) -> Result<T> + Send,
    ) -> Result<T> {
        let given = Given { profile, cache, denoiser: self.denoiser.as_ref() };
        let bar = RenderBar::new(bars);
        let traced = self.local.pool.install(|| trace(given, &|progress| bar.show(progress)));
        traced.with_context(|| format!("bundle {}", self.bundle.display()))
    }
}

/// Renders frames of a scene that another renderer renders.
fn render_foreign(args: &Args, interrupt: &Interrupt) -> Result<()> {
    refuse(&[
        ("--cost-map", args.cost_map.is_some()),
        ("--profile", args.profile.is_some()),
        ("--cache-file", args.cache_file.is_some()),
        ("--denoise", args.denoise),
        ("--cache-error", args.cache_error.is_given()),
        ("--effects", args.effects != EffectsSwitch::CalledFor),
        ("--within, --within-money, --error and --samples-from", args.allot.is_given()),
    ])?;
    let asked = foreign::AskedRender {
        scene: &args.bundle,
        frame: args.frame,
        frames: args.frames.as_ref(),
        out: args.out.as_deref(),
        stats: args.stats.as_deref(),
        quality: &args.quality,
        own: &args.own,
        machine: &args.machine,
        json: args.json,
    };
    foreign::render(&asked, interrupt)
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
    let bytes = bounded_file::read(path, CACHE_BYTES).context("--profile")?;
    Profile::from_bytes(&bytes)
        .map_err(RenderError::from)
        .with_context(|| format!("--profile {}", path.display()))
}

struct Files<'a> {
    image: Option<(&'a Path, Format)>,
    cost_map: Option<&'a Path>,
}

impl<'a> Files<'a> {
    fn new(image: Option<&'a Path>, cost_map: Option<&'a Path>) -> Result<Self> {
        let format = image.map(format_of).transpose()?;
        Ok(Self { image: image.zip(format), cost_map })
    }

    fn write(&self, image: &Image, frame: &Frame) -> Result<()> {
        if let Some((path, format)) = self.image {
            write_image(image, frame, path, format)?;
        }
        self.cost_map.map_or(Ok(()), |path| write_bytes(path, &png(&image.cost_map())?))
    }

    /// Writes the same files next to the real ones, then removes them.
    fn rehearse(&self, image: &Image, frame: &Frame) -> Result<()> {
        let Some(first) = self.image.map(|(path, _)| path).or(self.cost_map) else { return Ok(()) };
        let beside = first.parent().filter(|folder| !folder.as_os_str().is_empty());
        let folder = tempfile::tempdir_in(beside.unwrap_or(Path::new(".")))?;
        let (out, cost_map) = (folder.path().join("image"), folder.path().join("cost-map"));
        let image_there = self.image.map(|(_, format)| (&*out, format));
        Files { image: image_there, cost_map: self.cost_map.map(|_| &*cost_map) }.write(image, frame)
    }
}

fn write_image(image: &Image, frame: &Frame, path: &Path, format: Format) -> Result<()> {
    match format {
        Format::Exr => write_with(path, |temporary| Ok(image.write_exr(temporary, frame)?)),
        Format::Png => write_bytes(path, &png(&image.picture())?),
    }
}

/// What the process pays once, in a line.
fn once(stats: &RenderStats) -> String {
    stats.once.and_then(once_costs).map_or_else(String::new, |costs| {
        format!("once        {costs} of CPU time, once for each process; in no frame's work or CPU time\n")
    })
}

/// What denoising left, in lines.
fn denoised(stats: &DenoisedStats) -> String {
    let DenoisedStats { by, error, noisy, measured_pixels, measured_samples, .. } = stats;
    let percent = |share: f64| 100.0 * share;
    format!(
        "denoised    by {by}: error {:.2} % of the mean ({:.2} to {:.2} %) in place of {:.1} %\n            \
         measured at {measured_pixels} pixels by {measured_samples} other camera samples each\n            \
         {} of CPU time for denoising, {} for measuring\n",
        percent(error.p50),
        percent(error.p05),
        percent(error.p95),
        percent(noisy.p50),
        seconds(stats.denoiser_cpu_seconds + stats.features_cpu_seconds),
        seconds(stats.measuring_cpu_seconds)
    )
}

fn report(stats: &RenderStats, effects: EffectsSwitch) -> String {
    let mut table = Table::new(&[
        ("rays", Align::Left),
        ("count", Align::Right),
        ("work for them", Align::Right),
        ("share", Align::Right),
    ]);
    let share = |work: u64| format!("{:.1} %", 100.0 * work as f64 / stats.work.max(1) as f64);
    let by_ray = stats.work_by_ray.unwrap_or_default();
    let kinds = Rays::NAMES.iter().zip(stats.rays.to_array()).zip(by_ray.to_array());
    for ((name, rays), work) in kinds.filter(|((_, rays), work)| rays + work > 0) {
        table.row([(*name).to_owned(), count(rays as f64), count(work as f64), share(work)]);
    }
    let rest = stats.work.saturating_sub(by_ray.total());
    table.row(["none: loading, building".into(), "-".into(), count(rest as f64), share(rest)]);
    table.footer();
    table.row(["all".into(), count(stats.rays.total() as f64), count(stats.work as f64), share(stats.work)]);
    let mut text = table.render();
    let RenderStats { frame, width, height, spp, .. } = stats;
    text += explain::WORK_FOR_RAYS;
    text += &format!("\nframe {frame}, {width} x {height}, {} per pixel\n", counted(*spp, "sample"));
    text += &stats.allotted.as_deref().map_or_else(String::new, allot::report);
    text += &stats.denoised.as_ref().map_or_else(String::new, denoised);
    let code = match effects {
        EffectsSwitch::CalledFor => "",
        EffectsSwitch::All => " (with code for all effects, and nothing left out)",
    };
    text += &format!("effects     {}{code}\n", output::list(&stats.effects));
    for LeftOut { what, reason } in &stats.left_out {
        text += &format!("left out    {what}: {reason}\n");
    }
    text += &format!("work        {} operations\n", count(stats.work as f64));
    text += &format!("CPU time    {}\n", seconds(stats.cpu_seconds));
    text += &format!("wall time   {}\n", seconds(stats.wall_seconds));
    text += &once(stats);
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
        if cache.secondary_lights > 0 {
            text += &format!(
                "            {} secondary lights: small bright places that every point samples\n",
                cache.secondary_lights
            );
        }
        if cache.shared_records + cache.dropped_records > 0 {
            let records: u64 = stats.cache_records.iter().sum();
            text += &format!(
                "            {} records are from the shared cache, {} of its records are not valid here, {} were made for this frame\n",
                cache.shared_records,
                cache.dropped_records,
                records.saturating_sub(cache.shared_records)
            );
        }
        if cache.rejected > 0 {
            text += &format!(
                "            {} records have infinite or undefined values and were not used\n",
                cache.rejected
            );
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

//! `forelight export`: writes a shot as a job for another farm's scheduler.

mod checked;
mod openjd;
mod template;

use super::cache_error::{Asker, CacheErrorOption};
use anyhow::Result;
use checked::{FrameStats, exported};
use clap::ValueEnum;
use forelight_protocol::words::counted;
use forelight_protocol::{ForecastDoc, FrameSet, JobSettings, RendererId, SceneDigest};
use forelight_terminal::failure::BadInput;
use forelight_terminal::foreign::{
    Foreign, OwnSetting, is_foreign, own_setting, refuse, refuse_own_settings,
};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::json_file;
use forelight_terminal::local::Local;
use forelight_terminal::options::{Keep, MachineOptions, PreviewBackend, QualityOptions, duration};
use forelight_terminal::output::{self, Bars};
use forelight_terminal::quantities::seconds;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

/// Write a shot as a job that other render farms can run
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight export kitchen/ --frames 0-47 --out job.json
  forelight export kitchen/ --cache on --cache-parts 8 --width 1920 --spp 64 --out job.json
  forelight export kitchen/ --frames 0-47 --forecast quote.json --stats 12.json --threads 8 --out job.json
  forelight export kitchen/ --frames 0-47 --forecast quote.json --threads 8 --chunk 10m --out job.json
  forelight export shot.blend --frames 1-48 --set denoise=false --forecast quote.json --threads 8 --chunk 10m --out job.json

The job is an Open Job Description template. `openjd run job.json` runs it on this machine, and so does every farm \
that reads such templates. The flags become defaults of the job's parameters, which may be changed at submission. \
The parameter Bundle has a default only if the bundle is in the template's folder or below it, since a template may \
not point elsewhere. Otherwise set it at submission.

Scenes of other renderers are rendered by `forelight render` too, which machines need beside the renderer. Only the \
file that is named is an input of the job: what it refers to must be inside it, or on storage that the machines share.

With --cache on or --cache-error, steps before the renders make the irradiance cache of the shot, in a folder that all \
machines must share. --threads sets the cores that a machine must have, and --stats its memory. With --forecast, a \
task is stopped after four times its forecast CPU time (P95, on one core), and not before 10 minutes.

With --chunk, a task renders as many frames as take about that long with --threads, but at most 150, and reads the \
scene once, unless the renderer is a program that is started for each frame. The farm must know the extension \
TASK_CHUNKING, and adapts the number to what it measures. The time limit is that of the dearest task. It stays the \
same where the parameters ChunkFrames and ChunkSeconds are changed.")]
pub struct Args {
    /// Scene: a .glb or .gltf file, or a bundle, which is a folder or a zip file. Or a scene of another
    /// renderer: a .blend file, a .rif file, an octree, or NAME.command.toml
    bundle: PathBuf,
    /// Frames, such as 0-47 or 0,5,9-12 [default: the whole shot]
    #[arg(long, value_name = "LIST")]
    frames: Option<FrameSet>,
    /// Format of the job
    #[arg(long, value_name = "FORMAT", default_value = "openjd")]
    format: Format,
    /// File to write the template to, NAME.json [default: standard output]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Name of the job [default: the scene's name]
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    /// Number of tasks that fill each level of the cache. Needs --cache on or --cache-error
    #[arg(long, value_name = "COUNT", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=256))]
    cache_parts: u32,
    /// Threads of a task, and cores that a machine must have [default: all cores, and no requirement]
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Statistics of a frame from `forelight render --stats`. They set the memory that a machine must have
    #[arg(long, value_name = "FILE")]
    stats: Option<PathBuf>,
    /// Quote of the same frames and quality, from `forelight forecast --json`. It sets the time limits
    #[arg(long, value_name = "FILE")]
    forecast: Option<PathBuf>,
    /// Time limit of a task, such as 30m or 2h [default: from --forecast, if given]
    #[arg(long, value_name = "DURATION", value_parser = duration)]
    timeout: Option<Duration>,
    /// Render several frames in a task, which should take this time, such as 10m. Needs --forecast and
    /// --threads
    #[arg(long, value_name = "DURATION", value_parser = duration, requires_all = ["forecast", "threads"])]
    chunk: Option<Duration>,
    /// Change a setting of another renderer, such as adaptive_sampling=false. May be repeated
    #[arg(long = "set", value_name = "NAME=VALUE", value_parser = own_setting())]
    own: Vec<OwnSetting>,
    #[command(flatten)]
    quality: QualityOptions,
    #[command(flatten)]
    cache_error: CacheErrorOption,
}

/// What is exported, whichever renderer renders it.
struct Source {
    name: String,
    digest: SceneDigest,
    /// `None`: our own.
    renderer: Option<RendererId>,
    settings: JobSettings,
    /// Settings of another renderer that differ from the scene's.
    set: BTreeMap<String, Value>,
    /// Formats of images, the usual one first.
    formats: Vec<String>,
    frames: Vec<u32>,
}

impl Source {
    fn of_own(args: &Args, machine: &MachineOptions, bars: &Bars, interrupt: &Interrupt) -> Result<Self> {
        refuse_own_settings(&args.own)?;
        let local = Local::open(&args.bundle, machine, bars)?;
        let here = Asker { local: &local, bundle: &args.bundle, bars, interrupt };
        let settings = args.cache_error.settings(&args.quality, args.frames.as_ref(), &here)?;
        let scene = &local.shot.info().summary;
        Ok(Self {
            name: scene.name.clone(),
            digest: scene.digest,
            renderer: None,
            settings: settings.into(),
            set: BTreeMap::new(),
            formats: ["exr", "png"].map(str::to_owned).to_vec(),
            frames: local.frames(args.frames.as_ref())?,
        })
    }

    fn of_other(args: &Args, machine: &MachineOptions, bars: &Bars, interrupt: &Interrupt) -> Result<Self> {
        refuse(&[("--cache-parts", args.cache_parts > 1), ("--cache-error", args.cache_error.is_given())])?;
        let foreign = Foreign::open(&args.bundle, machine, bars, interrupt)?;
        let settings = foreign.settings(&args.quality, &args.own)?;
        let (name, digest) = foreign.scene(&args.bundle)?;
        let set = args.own.iter().map(OwnSetting::name);
        if let Some(name) = set.clone().find(|name| name.contains(['{', '}'])) {
            return Err(
                BadInput::new(format!("--set {name}: a template cannot hold braces in a name")).into()
            );
        }
        Ok(Self {
            name,
            digest,
            renderer: Some(foreign.renderer.id().clone()),
            set: set.filter_map(|name| Some((name.to_owned(), settings.own.get(name)?.clone()))).collect(),
            formats: foreign.shot.image_extensions(&settings),
            settings: JobSettings::Shot(settings.complete()),
            frames: foreign.frames(args.frames.as_ref())?,
        })
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    /// Open Job Description, revision 2023-09, as JSON.
    Openjd,
}

pub fn run(args: &Args, interrupt: &Interrupt) -> Result<()> {
    if let Some(out) = args.out.as_deref().filter(|out| out.extension().is_none_or(|end| end != "json")) {
        let why = "the name must end in .json, because other programs choose the format by it";
        return Err(BadInput::new(format!("--out {}: {why}", out.display())).into());
    }
    let quote = |path| json_file::read_written_by("forelight forecast --json", path);
    let forecast: Option<ForecastDoc> = args.forecast.as_deref().map(quote).transpose()?;
    let stats = |path| json_file::read_written_by("forelight render --stats", path);
    let stats: Option<FrameStats> = args.stats.as_deref().map(stats).transpose()?;
    // Light is traced only to choose a cache.
    let threads = if args.cache_error.is_given() { None } else { Some(1) };
    let machine = MachineOptions { threads, preview: PreviewBackend::Cpu, keep: Keep::Off };
    let bars = Bars::new(args.out.is_none());
    let source = match is_foreign(&args.bundle) {
        true => Source::of_other(args, &machine, &bars, interrupt)?,
        false => Source::of_own(args, &machine, &bars, interrupt)?,
    };
    let Format::Openjd = args.format;
    let shot = exported(args, source, forecast.as_ref(), stats.as_ref())?;
    let template = shot.template();
    let Some(out) = &args.out else {
        return output::json(&template);
    };
    json_file::write(Some(out), &template)?;
    let steps: Vec<&str> = template.steps.iter().map(|step| step.name.as_str()).collect();
    let mut report = format!("steps   {}\nframes  {}\n", steps.join(", "), shot.frames);
    if let Some(chunk) = shot.chunk {
        report += &format!(
            "chunk   at most {} in a task, for about {}\n",
            counted(chunk.frames, "frame"),
            seconds(chunk.seconds as f64)
        );
    }
    if shot.bundle.is_none() {
        report += "bundle  no default, since it is not in the template's folder; set the parameter Bundle at submission\n";
    }
    output::print(&report)
}

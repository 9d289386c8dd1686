//! `forelight accuracy`: the error of images against CPU time.

mod plot;
mod table;

use super::blocking;
use super::cancel::find_any;
use crate::connection::ConnectionOptions;
use crate::connection::connect;
use crate::job_options::svg_file;
use anyhow::{Context, Result};
use forelight_denoise::Denoiser;
use forelight_protocol::{AccuracyDoc, LadderKind};
use forelight_renderer_own::{
    AccuracyObserver as _, AccuracyOptions, DenoiseBy, MeasureOptions, measure, predict,
};
use forelight_terminal::atomic_file::{self, write_bytes};
use forelight_terminal::failure::BadInput;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::local::Local;
use forelight_terminal::options::{MachineOptions, QualityOptions};
use forelight_terminal::output::{self, Bars};
use forelight_terminal::watching::AccuracyWatcher;
use std::path::{Path, PathBuf};

/// Forecast error against CPU time for ladders of qualities
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight accuracy kitchen/ --frame 12 --out accuracy.svg
  forelight accuracy kitchen/ --width 1920 --spp 64 --json > accuracy.json
  forelight accuracy kitchen/ --width 160 --measure --out accuracy.svg
  forelight accuracy kitchen/ --width 320 --spp 4 --denoise
  forelight accuracy --job 0197a8a5-0000-7000-8000-000000000000 --out accuracy.svg

A ladder is a row of qualities that differ in one setting. The ladders around the requested quality are: camera \
samples (for both integrators, and with a cache), accuracy of the cache, rays of a gather, and resolution. \
Profiles of --samples pixels at each kind of setting give the CPU time and the error of every rung. The error is the \
root mean square over pixels and channels against the converged image, as a share of its mean.

Rungs marked * are worth taking: no other rung is both cheaper and better. With --denoise, that is judged by what is \
left of the error, and all times include denoising. --measure also renders every rung, and \
compares it with converged images. This takes far longer than the forecast.

--job shows the quote of a job on the farm: the cost of all its frames at every rung. It has all ladders if the job \
was submitted with --ladders.")]
pub struct Args {
    /// Scene: a .glb or .gltf file, or a bundle, which is a folder or a zip file
    bundle: Option<PathBuf>,
    /// Show the ladders in the quote of this job on the farm, by its id or name, instead of a bundle's
    #[arg(long, value_name = "JOB", conflicts_with_all = ["bundle", "frame", "samples", "phase_seed", "measure", "denoise", "QualityOptions", "MachineOptions"])]
    job: Option<String>,
    /// Frame number
    #[arg(long, value_name = "N", default_value_t = 0)]
    frame: u32,
    /// Number of pixels to profile at each kind of setting, 16 to a million
    #[arg(long, value_name = "PIXELS", default_value_t = 256, value_parser = clap::value_parser!(u32).range(16..=1_000_000))]
    samples: u32,
    /// Seed of the choice of pixels
    #[arg(long, value_name = "NUMBER", default_value_t = 0)]
    phase_seed: u64,
    /// Also render every rung, and show its true time and error beside the forecast
    #[arg(long)]
    measure: bool,
    /// Also forecast the error that is left once Open Image Denoise, if it is installed, has removed the
    /// noise. With --measure, every rung is denoised, too
    #[arg(long)]
    denoise: bool,
    /// Camera samples per pixel of the converged images, which are made in two halves. Needs --measure
    #[arg(long, value_name = "SAMPLES", default_value_t = 512, requires = "measure", value_parser = clap::value_parser!(u32).range(2..=131_072))]
    reference_spp: u32,
    /// Plot error against CPU time into this SVG file
    #[arg(long, value_name = "FILE.svg", value_parser = svg_file)]
    out: Option<PathBuf>,
    /// Print the ladders as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    quality: QualityOptions,
    #[command(flatten)]
    machine: MachineOptions,
    #[command(flatten)]
    connection: ConnectionOptions,
}
pub async fn run(args: Args, interrupt: Interrupt) -> Result<()> {
    atomic_file::check([args.out.as_deref()])?;
    match (args.job.clone(), args.bundle.clone()) {
        (Some(job), _) => of_job(&args, &job).await,
        (None, Some(bundle)) => blocking(move || of_bundle(&args, &bundle, &interrupt)).await,
        (None, None) => Err(BadInput::new("name a bundle, or a job by --job").into()),
    }
}

async fn of_job(args: &Args, wanted: &str) -> Result<()> {
    let client = connect(&args.connection)?;
    let id = find_any(&client, wanted).await?;
    let document =
        client.accuracy(id).await.with_context(|| format!("cannot read the ladders of job {id}"))?;
    let job = client.job(id).await.with_context(|| format!("cannot read job {id}"))?;
    show(args, &format!("job {}, frames {}", job.name, job.frames), &document)
}

fn of_bundle(args: &Args, bundle: &Path, interrupt: &Interrupt) -> Result<()> {
    let denoiser = args.denoise.then(Denoiser::find).transpose().context("--denoise")?;
    let bars = Bars::new(args.json);
    let local = Local::open(bundle, &args.machine, &bars)?;
    let settings = local.settings(&args.quality)?;
    local.check_frame("--frame", args.frame)?;
    let watcher = AccuracyWatcher::new(&bars, "profiling", interrupt);
    let predicted = |denoise: Option<DenoiseBy<'_>>| {
        let options = AccuracyOptions { samples: args.samples, seed: args.phase_seed, denoise };
        predict(&local.shot, args.frame, &settings, &LadderKind::ALL, &options, &watcher)
    };
    let predicted = local.pool.install(|| match &denoiser {
        None => predicted(None),
        Some(denoiser) => DenoiseBy::here(denoiser, watcher.cancel(), |by| predicted(Some(by))),
    });
    let mut document = watcher.done(predicted, bundle)?;
    if args.measure {
        let options = MeasureOptions { reference_spp: args.reference_spp, denoiser: denoiser.as_ref() };
        let watcher = AccuracyWatcher::new(&bars, "rendering", interrupt);
        let measured =
            local.pool.install(|| measure(&local.shot, args.frame, &mut document, &options, &watcher));
        watcher.done(measured, bundle)?;
    }
    show(args, &format!("{}, frame {}", local.shot.info().summary.name, args.frame), &document)
}

fn show(args: &Args, title: &str, document: &AccuracyDoc) -> Result<()> {
    if let Some(path) = &args.out {
        write_bytes(path, plot::svg(title, document)?.as_bytes())?;
    }
    if args.json { output::json(document) } else { output::print(&table::text(document)) }
}

/// The value that differs along a rung's ladder.
fn value(document: &AccuracyDoc, rung: usize) -> String {
    let rung = &document.rungs[rung];
    let settings = &rung.settings;
    match rung.ladder {
        LadderKind::Ambient | LadderKind::Path | LadderKind::CachedSamples => format!("{} spp", settings.spp),
        LadderKind::Cache => format!("error {}", thousandths(settings.cache_accuracy)),
        LadderKind::Divisions => format!("{} rays", settings.ambient_divisions),
        LadderKind::Resolution => format!("{} x {}", settings.width, settings.height),
    }
}

/// `0.15` of 150.
fn thousandths(value: u32) -> f64 {
    f64::from(value) / 1000.0
}

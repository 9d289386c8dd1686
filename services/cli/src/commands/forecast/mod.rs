//! `forelight forecast`: quotes a shot on this machine.

mod cost_map;
mod sharing;

use super::cache_error::{Asker, CacheErrorOption};
use super::explain::{self, Unit};
use super::{calibrate, foreign};
use crate::caches;
use crate::job_options::png_file;
use crate::storage::stored;
use anyhow::{Context, Result};
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use forelight_denoise::Denoiser;
use forelight_forecast::{Correction, Corrections, LEAST_JOBS, Strategy};
use forelight_protocol::words::counted;
use forelight_protocol::{
    CacheSharing, CalibratedQuantiles, CalibrationDoc, FixedCosts, ForecastDoc, FrameSet, LeftOut,
    NodeSeconds, ProcessCosts, Quantiles, RenderSettings, Spent,
};
use forelight_renderer_own::{Quote, QuoteOptions, ROUNDS, png};
use forelight_terminal::atomic_file::{self, write_bytes};
use forelight_terminal::failure::BadInput;
use forelight_terminal::foreign::{OwnSetting, is_foreign, own_setting, refuse, refuse_own_settings};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::json_file;
use forelight_terminal::local::Local;
use forelight_terminal::options::{MachineOptions, QualityOptions};
use forelight_terminal::output::{self, Bars};
use forelight_terminal::quantities::{count, seconds};
use forelight_terminal::table::{Align, Table};
use forelight_terminal::watching::QuoteWatcher;
use std::path::{Path, PathBuf};

/// Forecast what frames cost before they are rendered
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight forecast kitchen/ --frames 0-47
  forelight forecast kitchen/ --frames 12 --width 1920 --spp 64 --json > quote.json
  forelight forecast kitchen/ --frames 0-47 --save-profile profiles/
  forelight forecast kitchen/ --frames 12 --strategy jittered
  forelight forecast kitchen/ --frames 0-47 --explain
  forelight forecast kitchen/ --frames 12 --cost-map map.png
  forelight forecast kitchen/ --calibration calibration.json
  forelight forecast kitchen/ --for-node rack-7.json
  forelight forecast kitchen/ --frames 0-47 --cache on --cache-sharing auto
  forelight forecast kitchen/ --frames 0-47 --cache-error 1
  forelight forecast kitchen/ --frames 0-47 --spp 4 --denoise

All frames are previewed. --samples pixels are profiled in each of five frames, or of more frames if the forecast is \
still uncertain. Around a few of these pixels, blocks of neighbours are traced, to measure the time of pixels that lie \
next to each other. All of them are finished pixels. --save-profile keeps them, and `forelight render --profile` takes \
them over.

With --cache on, each frame's irradiance cache is planned with its preview, which gives the number of records. Some \
records are gathered to measure their cost. No pixel is finished before the cache is full, so --save-profile keeps the \
plan and those records instead. --cache-sharing also plans one cache for all frames, as a farm does, and \
reports which one costs less.

Work is a count of operations, and is the same in every run. CPU time is that of this machine.")]
pub struct Args {
    /// Scene: a .glb or .gltf file, or a bundle, which is a folder or a zip file. Or a .blend file, which
    /// Blender Cycles renders, or a .rif file or octree, which Radiance renders
    bundle: PathBuf,
    /// Frames, such as 0-47 or 0,5,9-12 [default: the whole shot]
    #[arg(long, value_name = "LIST")]
    frames: Option<FrameSet>,
    /// Number of pixels to profile in each profiled frame, 1 to a million. The forecast of work rests on them
    #[arg(long, value_name = "PIXELS", default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    samples: u32,
    /// Largest number of frames to profile [default: 5, and up to 16 if the forecast is still uncertain and
    /// they cost less than 1 % of the shot]
    #[arg(long, value_name = "FRAMES", value_parser = clap::value_parser!(u32).range(1..=1000))]
    profile_frames: Option<u32>,
    /// How the pixels are chosen, and how their cost is extended to the frame
    #[arg(long, value_name = "NAME", default_value = Strategy::Snapshot.name(), value_parser = strategies())]
    strategy: Strategy,
    /// Seed of the choice of pixels
    #[arg(long, value_name = "NUMBER", default_value_t = 0)]
    phase_seed: u64,
    /// Write the finished pixels or irradiance cache of each profiled frame into this folder, for
    /// `forelight render --profile`
    #[arg(long, value_name = "DIR")]
    save_profile: Option<PathBuf>,
    /// Calibrate the quantiles on a farm's past jobs. The file holds the response of the farm's
    /// /v1/forecasts/calibration
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Also forecast the CPU time on another machine, from its `forelight calibrate --out`. This machine is
    /// calibrated first, for a few seconds
    #[arg(long, value_name = "FILE")]
    for_node: Option<PathBuf>,
    /// Share one irradiance cache between frames, or give each frame its own. Needs --cache on or --cache-error
    #[arg(long, value_name = "HOW", value_enum, default_value_t = CacheSharing::Private)]
    cache_sharing: CacheSharing,
    /// Write the forecast cost of each pixel of the first frame as a picture, in the colours of a render's
    /// cost map. Other renderers draw the first measured frame
    #[arg(long, value_name = "FILE.png", value_parser = png_file)]
    cost_map: Option<PathBuf>,
    /// What the cost map shows
    #[arg(long, value_name = "WHAT", value_enum, default_value_t = cost_map::At::Mean, requires = "cost_map")]
    cost_map_at: cost_map::At,
    /// Also explain the cost: parts, objects, rays, and changes that would halve it. Each frame has its own
    /// cache
    #[arg(long, conflicts_with = "cache_sharing")]
    explain: bool,
    /// Forecast images whose noise is removed by Open Image Denoise, as by `forelight render --denoise`
    #[arg(long)]
    denoise: bool,
    /// Change a setting of another renderer, such as adaptive_sampling=false. May be repeated
    #[arg(long = "set", value_name = "NAME=VALUE", value_parser = own_setting())]
    own: Vec<OwnSetting>,
    /// Print the quote as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    quality: QualityOptions,
    #[command(flatten)]
    cache_error: CacheErrorOption,
    #[command(flatten)]
    machine: MachineOptions,
}

fn strategies() -> impl TypedValueParser<Value = Strategy> {
    let possible = |strategy: Strategy| PossibleValue::new(strategy.name()).help(strategy.summary());
    PossibleValuesParser::new(Strategy::ALL.map(possible)).try_map(|name| {
        let found = Strategy::ALL.into_iter().find(|strategy| strategy.name() == name);
        found.ok_or("this strategy does not exist")
    })
}
pub fn run(args: &Args, interrupt: &Interrupt) -> Result<()> {
    if is_foreign(&args.bundle) {
        return forecast_foreign(args, interrupt);
    }
    refuse_own_settings(&args.own)?;
    sharing::check(args.cache_sharing, args.strategy, &args.cache_error.quality(&args.quality)?)?;
    if args.cost_map.is_some() {
        cost_map::check(args.cost_map_at, args.strategy, args.samples)?;
    }
    let first_profile = args.save_profile.as_ref().map(|folder| folder.join("profile"));
    atomic_file::check([first_profile.as_deref(), args.cost_map.as_deref()])?;
    let bars = Bars::new(args.json);
    let other = args.for_node.as_deref().map(calibrate::read).transpose()?;
    let local = Local::open(&args.bundle, &args.machine, &bars)?;
    let frames = local.frames(args.frames.as_ref())?;
    let here = Asker { local: &local, bundle: &args.bundle, bars: &bars, interrupt };
    let settings = args.cache_error.settings(&args.quality, args.frames.as_ref(), &here)?;
    let trial = || Denoiser::find().and_then(|denoiser| denoiser.try_out(None));
    let trial = args.denoise.then(trial).transpose().context("--denoise")?;
    let options = QuoteOptions {
        denoiser_nanos_per_pixel: trial.map(|trial| trial.nanos_per_pixel),
        samples: args.samples,
        profile_frames: args.profile_frames.map(|frames| frames as usize),
        seed: args.phase_seed,
        strategy: args.strategy,
        // The quote does not show the error of the image.
        scans: false,
        corrections: match &args.calibration {
            Some(path) => Some(corrections(path, args.strategy, &local, &settings)?),
            None => None,
        },
    };
    let watcher = QuoteWatcher::new(&bars, frames.len(), interrupt);
    let mut quoted = watcher.quote(&local, &args.bundle, &frames, &settings, &options)?;
    if let Some(document) = sharing::quote(&here, &settings, args.cache_sharing, &frames, &quoted)? {
        quoted.document = document;
    }
    if let Some((name, other)) = other {
        let here = calibrate::measured(ROUNDS, &bars);
        quoted.document.cpu_seconds_on.extend(NodeSeconds::carried(&quoted.document, name, &here, &other));
    }
    if let Some(folder) = &args.save_profile {
        save_profiles(&quoted, folder)?;
    }
    let explain = || quoted.measured().explain(&settings, None);
    let explained = args.explain.then(explain).transpose()?;
    if args.json {
        output::json(&explain::Explained { quote: &quoted.document, explanation: explained.as_ref() })?;
    } else {
        let why = explained.as_ref().map_or_else(String::new, |found| explain::text(found, Unit::Operations));
        output::print(&(report(&quoted.document) + &why))?;
    }
    match &args.cost_map {
        Some(path) => {
            let picture = cost_map::picture(args.cost_map_at, &local, &quoted, &settings, &bars)?;
            write_bytes(path, &png(&picture)?)
        }
        None => Ok(()),
    }
}

/// The quote of a scene that another renderer renders.
fn forecast_foreign(args: &Args, interrupt: &Interrupt) -> Result<()> {
    refuse(&[
        ("--strategy", args.strategy != Strategy::Snapshot),
        ("--save-profile", args.save_profile.is_some()),
        ("--calibration", args.calibration.is_some()),
        ("--for-node", args.for_node.is_some()),
        ("--cache-sharing", args.cache_sharing != CacheSharing::Private),
        ("--cost-map-at", args.cost_map_at != cost_map::At::Mean),
        ("--cache-error", args.cache_error.is_given()),
        ("--denoise", args.denoise),
    ])?;
    let asked = foreign::AskedForecast {
        scene: &args.bundle,
        frames: args.frames.as_ref(),
        measured_frames: args.profile_frames,
        samples: args.samples,
        seed: args.phase_seed,
        quality: &args.quality,
        own: &args.own,
        machine: &args.machine,
        explain: args.explain,
        cost_map: args.cost_map.as_deref(),
        json: args.json,
    };
    foreign::forecast(&asked, interrupt)
}

/// The corrections of quantiles from a farm's finished jobs, for a quote like this one.
fn corrections(
    path: &Path,
    strategy: Strategy,
    local: &Local,
    settings: &RenderSettings,
) -> Result<Corrections> {
    let document: CalibrationDoc = json_file::read_written_by("curl FARM/v1/forecasts/calibration", path)?;
    if strategy != Strategy::Snapshot {
        let reason = "--calibration: farms quote with the strategy snapshot, so their jobs cannot calibrate another strategy";
        return Err(BadInput::new(reason).into());
    }
    let (renderer, class) = (&local.shot.info().renderer, settings.feature_class());
    let kind = document.kinds.iter().find(|kind| kind.renderer == *renderer && kind.feature_class == class);
    let Some(known) = kind.and_then(|kind| kind.corrections) else {
        let jobs = kind.map_or(0, |kind| kind.jobs);
        let reason = format!(
            "{}: {jobs} finished jobs of the renderer `{renderer}` and the class `{class}`; calibration needs at least {LEAST_JOBS}",
            path.display()
        );
        return Err(BadInput::new(reason)
            .hint("leave out --calibration for a quote that is not calibrated")
            .into());
    };
    let correction = |name: &str, CalibratedQuantiles { p50, p80, p95 }: CalibratedQuantiles| {
        if p50 <= p80 && p80 <= p95 {
            return Ok(Correction { p50, p80, p95 });
        }
        Err(BadInput::new(format!("{}: {name}: p50, p80 and p95 must be in ascending order", path.display())))
    };
    Ok(Corrections {
        frame_work: correction("frame_work", known.frame_work)?,
        frame_cpu: correction("frame_cpu", known.frame_cpu)?,
        job_work: correction("job_work", known.job_work)?,
        job_cpu: correction("job_cpu", known.job_cpu)?,
    })
}

fn save_profiles(quote: &Quote, folder: &Path) -> Result<()> {
    for profiled in &quote.profiled {
        let path = folder.join(format!("frame-{:04}.profile", profiled.frame));
        write_bytes(&path, &profiled.profile.to_bytes())?;
    }
    Ok(())
}

fn report(quote: &ForecastDoc) -> String {
    let head = [
        ("frame", Align::Right),
        ("work P50", Align::Right),
        ("P80", Align::Right),
        ("P95", Align::Right),
        ("CPU time P50", Align::Right),
        ("P80", Align::Right),
        ("P95", Align::Right),
    ];
    let cached = !quote.total.cache_records.is_empty();
    let records_head = cached.then_some(("records", Align::Right));
    let head: Vec<_> = head.into_iter().chain(records_head).chain([("", Align::Left)]).collect();
    let row = |name: String, work: &Quantiles, cpu: &Quantiles, records: &[Quantiles], remark: &str| {
        let work = [work.p50, work.p80, work.p95].map(count);
        let cpu = [cpu.p50, cpu.p80, cpu.p95].map(seconds);
        let levels: Vec<String> = records.iter().map(|level| format!("{:.0}", level.mean)).collect();
        let cells = [name].into_iter().chain(work).chain(cpu);
        cells.chain(cached.then(|| levels.join(" + "))).chain([remark.to_owned()]).collect::<Vec<_>>()
    };
    let mut table = Table::new(&head);
    for frame in &quote.frames {
        let remark = if quote.profiled.frames.contains(&frame.frame) { "profiled" } else { "" };
        let number = frame.frame.to_string();
        table.row(row(number, &frame.work, &frame.cpu_seconds, &frame.cache_records, remark));
    }
    table.footer();
    let total = &quote.total;
    match quote.cache.as_ref().and_then(|cache| cache.shared_cache.as_ref()) {
        None => table.row(row("all".into(), &total.work, &total.cpu_seconds, &total.cache_records, "")),
        Some(shared) => {
            let records: Vec<Quantiles> =
                shared.records.iter().map(|&records| Quantiles::known(records.into())).collect();
            table.row(row("frames".into(), &total.work, &total.cpu_seconds, &[], ""));
            table.row(row(
                "shared cache".into(),
                &shared.work,
                &shared.cpu_seconds,
                &records,
                "before the frames",
            ));
            let (work, cpu) = (total.work.plus(&shared.work), total.cpu_seconds.plus(&shared.cpu_seconds));
            table.row(row("all".into(), &work, &cpu, &[], ""));
        }
    }
    let spent = &quote.spent;
    let frames = counted(quote.profiled.frames.len(), "frame");
    let calibrated = if quote.calibrated {
        "The quantiles are calibrated on past jobs."
    } else {
        "The quantiles rest on the statistics of this shot alone; they are not calibrated on past jobs."
    };
    let left_out =
        quote.left_out.iter().map(|LeftOut { what, reason }| format!("left out: {what}: {reason}\n"));
    table.render()
        + &quote.fixed.map_or_else(String::new, fixed_costs)
        + &quote
            .once
            .and_then(once_costs)
            .map_or_else(String::new, |costs| format!("once for each process, in no frame: {costs}\n"))
        + &format!(
            "\nsimulated: {}\n{}{} pixels of {frames} were profiled, and blocks of neighbours were traced for their time. The quote took {} CPU time, and {:.1} % of the work that it forecasts.\n{calibrated}\n",
            output::list(&quote.effects),
            left_out.collect::<String>(),
            quote.profiled.pixels,
            seconds(spent.cpu_seconds),
            spent.fraction_of_forecast * 100.0,
        )
        + &quote.cache.as_ref().map_or_else(String::new, caches::ways)
        + &quote
            .cache
            .as_ref()
            .and_then(|cache| cache.shared_cache.as_ref())
            .map_or_else(String::new, |shared| caches::shared(shared) + "\n")
        + &quote.storage.as_ref().map_or_else(String::new, stored)
        + &on_others(&quote.cpu_seconds_on)
}

/// The costs of a frame that do not depend on its pixels, by part.
fn fixed_costs(fixed: FixedCosts) -> String {
    let FixedCosts { load, build, plan, write, denoise, .. } = fixed;
    let parts = [
        ("setting up", load),
        ("building the tree", build),
        ("planning the cache", plan),
        ("writing", write),
        ("denoising", denoise),
    ];
    taken(&parts).map_or_else(String::new, |parts| format!("\nof that, in each frame: {parts}\n"))
}

/// The costs that a process pays once for a shot. `None` if there are none.
pub fn once_costs(once: ProcessCosts) -> Option<String> {
    let ProcessCosts { load, build } = once;
    taken(&[("loading", load), ("building the tree", build)])
}

/// The CPU time of each part that has a cost.
fn taken(parts: &[(&str, Spent)]) -> Option<String> {
    let taken = parts.iter().filter(|(_, spent)| *spent != Spent::default());
    let part = |(name, spent): &(&str, Spent)| format!("{name} {}", seconds(spent.cpu_nanos as f64 * 1e-9));
    let parts: Vec<String> = taken.map(part).collect();
    (!parts.is_empty()).then(|| parts.join(", "))
}

fn on_others(nodes: &[NodeSeconds]) -> String {
    let line = |NodeSeconds { node, cpu_seconds, .. }: &NodeSeconds| {
        let [p50, p80, p95] = [cpu_seconds.p50, cpu_seconds.p80, cpu_seconds.p95].map(seconds);
        format!("on {node}: CPU time p50 {p50}, p80 {p80}, p95 {p95}\n")
    };
    nodes.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_renderer_own::quote;
    use forelight_terminal::options::parsed;

    #[test]
    fn a_farms_calibration_is_taken_for_its_own_kind_of_quote_alone() {
        let folder = tempfile::tempdir().unwrap();
        let scene = r#"{"version":1,"name":"floor","geometry":["t.obj"],
            "lights":[{"type":"point","position":[2,5,3],"intensity":[40,40,40]}],
            "camera":{"origin":[0,3,6],"target":[0,0,0],"up":[0,1,0],"fov_deg":50,"fov_axis":"x","width":8,"height":8}}"#;
        std::fs::write(folder.path().join("scene.json"), scene).unwrap();
        std::fs::write(folder.path().join("t.obj"), "v -9 0 -9\nv 9 0 -9\nv 9 0 9\nf 1 3 2\n").unwrap();
        let (bundle, file) = (folder.path().display().to_string(), folder.path().join("calibration.json"));
        let path = file.display().to_string();
        let args = |more: &[&str]| {
            let fixed = [
                "forecast",
                &bundle,
                "--samples",
                "16",
                "--spp",
                "1",
                "--preview",
                "cpu",
                "--calibration",
                &path,
            ];
            parsed::<Args>(fixed.iter().chain(more))
        };
        let local = Local::open(folder.path(), &args(&[]).machine, &Bars::new(true)).unwrap();
        let renderer = local.shot.info().renderer.clone();
        let write = |class: &str, p95: f64| {
            let quantiles = CalibratedQuantiles { p50: 0.5, p80: 1.0, p95 };
            let corrections = forelight_protocol::Corrections {
                frame_work: quantiles,
                frame_cpu: quantiles,
                job_work: quantiles,
                job_cpu: quantiles,
            };
            let kind = forelight_protocol::CalibrationKind {
                renderer: renderer.clone(),
                feature_class: class.to_owned(),
                jobs: 20,
                corrections: Some(corrections),
            };
            let document = CalibrationDoc { kinds: vec![kind] };
            std::fs::write(&file, serde_json::to_string(&document).unwrap()).unwrap();
        };
        write("gathered", 2.0);
        let wanted = args(&["--ambient-bounces", "1"]);
        let settings = local.settings(&wanted.quality).unwrap();
        let found = corrections(&file, Strategy::Snapshot, &local, &settings).unwrap();
        let options = QuoteOptions { samples: 16, corrections: Some(found), ..QuoteOptions::default() };
        let quoted = quote(
            &local.shot,
            &[0],
            &settings,
            &options,
            &QuoteWatcher::new(&Bars::new(true), 1, &Interrupt::default()),
        );
        let total = quoted.unwrap().document;
        assert!(total.calibrated && total.total.work.p50 > total.total.work.mean);
        run(&wanted, &Interrupt::default()).unwrap();

        let refused = |args: &Args| run(args, &Interrupt::default()).unwrap_err().to_string();
        let none = refused(&args(&["--ambient-bounces", "0"]));
        assert!(none.contains("0 finished jobs") && none.contains("`direct`"), "{none}");
        assert!(refused(&args(&["--strategy", "jittered"])).contains("snapshot"));
        write("gathered", 0.7);
        assert!(refused(&wanted).contains("frame_work: p50, p80 and p95 must be in ascending order"));
    }
}

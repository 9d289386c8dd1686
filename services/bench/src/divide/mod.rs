//! `forelight bench divide`: one frame on many nodes, divided by forecast cost, by area, and into buckets.
//!
//! Each frame is rendered in one piece for the true work of its pixels. From this, the makespans of three
//! ways to divide it follow for any number of nodes. It is also really rendered in parts, task by task.

mod tasks;
mod ways;

use crate::report::Report;
use anyhow::{Context, Result, ensure};
use forelight_forecast::PixelCurve;
use forelight_kept::Folder;
use forelight_protocol::{CacheMode, Integrator, RenderSettings};
use forelight_renderer_own::{OwnFrame, Rendered, render_ready};
use forelight_terminal::failure::Interrupted;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::local::Local;
use forelight_terminal::options::{MachineOptions, QualityOptions};
use forelight_terminal::output::Bars;
use forelight_terminal::quantities::{count, seconds};
use forelight_terminal::table::{Align, Table};
use serde::Serialize;
use std::path::{Path, PathBuf};
use tasks::{InParts, Tasks};
use ways::{Makespans, Overhead, makespans};

/// Divide frames among nodes by cost, by area and into buckets, and compare when they are finished
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight bench divide kitchen/ corridor/
  forelight bench divide kitchen/ --spp 16 --ambient-bounces 1 --cache on --parts 16 --nodes 16,128

Costs are counted in work. Every node also pays for opening the scene, its acceleration structure and reading \
the irradiance cache. Nodes keep scenes and structures in one folder, as workers of one machine or home folder do, so \
one of them builds the structure, and the others read it. Costs by forecast also pay for the samples that the forecast is made from. Buckets are \
squares of 64 pixels in rows, which nodes take as they become free. The command fails if an image in parts \
differs from that in one piece.")]
pub struct Args {
    /// Scene bundles: folders or zip files
    #[arg(required = true, value_name = "BUNDLE")]
    bundles: Vec<PathBuf>,
    /// Frame number
    #[arg(long, value_name = "N", default_value_t = 0)]
    frame: u32,
    /// Numbers of nodes to compare
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_values_t = [8, 64, 512], value_parser = clap::value_parser!(u32).range(1..=512))]
    nodes: Vec<u32>,
    /// Number of parts to really render
    #[arg(long, value_name = "COUNT", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=512))]
    parts: u32,
    /// Nodes share no folder: each loads the bundle and builds the acceleration structure itself
    #[arg(long)]
    apart: bool,
    /// Print the measurements as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    quality: QualityOptions,
    #[command(flatten)]
    machine: MachineOptions,
}

/// One frame.
#[derive(Debug, Serialize)]
struct Case {
    bundle: String,
    frame: u32,
    settings: RenderSettings,
    /// The frame in one piece.
    work: u64,
    cpu_seconds: f64,
    pixel_work: u64,
    /// The same frame, really rendered in parts.
    in_parts: InParts,
    nodes: Vec<OnNodes>,
}

/// The frame on so many nodes, in work.
#[derive(Debug, Serialize)]
struct OnNodes {
    nodes: u32,
    /// Work of the samples that the forecast is made from.
    probing_work: u64,
    /// Work of all pixels over the number of nodes.
    mean: f64,
    makespans: Makespans,
}

pub fn run(args: &Args, interrupt: &Interrupt) -> Result<Report> {
    let bars = Bars::new(args.json);
    let mut cases = Vec::new();
    for bundle in &args.bundles {
        let local = Local::open(bundle, &args.machine, &bars)?;
        let settings = local.settings(&args.quality)?;
        local.check_frame("--frame", args.frame)?;
        let spinner = bars.spinner(format!("rendering {}", bundle.display()));
        let kept = if args.apart { None } else { Some(tempfile::tempdir()?) };
        let kept = kept.as_ref().map(|folder| Folder::new(folder.path())).transpose()?;
        let case = local.pool.install(|| measure(args, (bundle, kept), &local, settings, interrupt));
        spinner.finish_and_clear();
        cases.push(case.with_context(|| format!("bundle {}", bundle.display()))?);
    }
    report(&cases).printed(args.json, &cases)
}

fn measure(
    args: &Args,
    (bundle, kept): (&Path, Option<Folder>),
    local: &Local,
    settings: RenderSettings,
    interrupt: &Interrupt,
) -> Result<Case> {
    let ready = local.shot.frame(args.frame, &settings)?;
    let whole = render_ready(&ready, &settings, None, &|_| (), &|_| (), interrupt.flag())?;
    let Rendered { image, stats, .. } = whole.ok_or(Interrupted)?;
    let tasks = Tasks::new(bundle, local.shot.info().summary.digest, args.frame, &settings, kept);
    let in_parts = tasks.render(args.parts, &stats, interrupt)?;
    let picture = forelight_pictures::png(&image.picture())?;
    ensure!(in_parts.has_image(&picture), "the image in parts differs from that in one piece");
    let totals = image.totals();
    let curve = PixelCurve::new(settings.width, settings.height);
    let work: Vec<u64> = image.pixels.iter().map(|pixel| pixel.work).collect();
    // Opening a scene is time alone: it counts as the work that pixels do in that time.
    let speed = totals.work as f64 / totals.cpu_nanos.max(1) as f64;
    let part = (in_parts.overhead_nanos as f64 * speed) as u64;
    let mut nodes = Vec::new();
    for &number in &args.nodes {
        nodes.push(on_nodes(number, part, &ready, &curve, &work, interrupt)?);
    }
    Ok(Case {
        bundle: local.shot.info().summary.name.clone(),
        frame: args.frame,
        settings,
        work: stats.work,
        cpu_seconds: stats.cpu_seconds,
        pixel_work: totals.work,
        in_parts,
        nodes,
    })
}

fn on_nodes(
    nodes: u32,
    part: u64,
    ready: &OwnFrame<'_>,
    curve: &PixelCurve,
    work: &[u64],
    interrupt: &Interrupt,
) -> Result<OnNodes> {
    let divided = ready.divide(nodes, &[], &|| interrupt.is_set()).ok_or(Interrupted)?;
    let probing_work = divided.spent.work;
    let ends: Vec<u32> = divided.parts.iter().map(|part| part.to).collect();
    let makespans = makespans(curve, work, &ends, Overhead { part, division: part + probing_work });
    let mean = work.iter().sum::<u64>() as f64 / f64::from(nodes);
    Ok(OnNodes { nodes, probing_work, mean, makespans })
}

fn report(cases: &[Case]) -> Report {
    let mut rendered = Table::new(&[
        ("bundle", Align::Left),
        ("light", Align::Left),
        ("work", Align::Right),
        ("CPU", Align::Right),
        ("parts", Align::Right),
        ("longest / mean", Align::Right),
        ("all / whole", Align::Right),
        ("all / whole, CPU", Align::Right),
        ("a part's own", Align::Right),
    ]);
    let mut compared = Table::new(&[
        ("bundle", Align::Left),
        ("nodes", Align::Right),
        ("probed", Align::Right),
        ("equal cost", Align::Right),
        ("equal areas", Align::Right),
        ("buckets", Align::Right),
    ]);
    for case in cases {
        let InParts { parts, longest, work, cpu_seconds, overhead_nanos, .. } = case.in_parts;
        rendered.row([
            case.bundle.clone(),
            light(&case.settings),
            count(case.work as f64),
            seconds(case.cpu_seconds),
            parts.to_string(),
            format!("{longest:.3}"),
            format!("{:.3}", work as f64 / case.work as f64),
            format!("{:.3}", cpu_seconds / case.cpu_seconds),
            seconds(overhead_nanos as f64 * 1e-9),
        ]);
        for OnNodes { nodes, probing_work, mean, makespans } in &case.nodes {
            let over_mean = |makespan: u64| format!("{:.2}", makespan as f64 / mean);
            compared.row([
                case.bundle.clone(),
                nodes.to_string(),
                format!("{:.2} %", *probing_work as f64 * 100.0 / case.pixel_work as f64),
                over_mean(makespans.equal_cost),
                over_mean(makespans.equal_areas),
                over_mean(makespans.buckets),
            ]);
        }
    }
    let head = "Really rendered in parts; all tasks of the frame against the frame in one piece:\n\n";
    let next = "\nMakespan over the mean work of a node, without any cost of dividing:\n\n";
    Report::default().text(head).table(rendered).text(next).table(compared)
}

fn light(settings: &RenderSettings) -> String {
    let RenderSettings { width, height, spp, ambient_bounces, .. } = settings;
    let method = match (settings.integrator, settings.cache) {
        (Integrator::Path, _) => "path",
        (_, CacheMode::On) => "cache",
        (_, CacheMode::Off) => "ambient",
    };
    format!("{width} × {height}, {spp} spp, {method}, {ambient_bounces} bounces")
}

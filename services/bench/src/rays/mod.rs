//! `forelight bench rays`: speed of ray queries, alone or compared with another program on the same rays.

mod export;
mod peer;
mod workload;

use crate::report::Report;
use crate::statistics::{sorted, upper_median};
use anyhow::{Context, Result};
use export::Answer;
use forelight_bvh::{Bvh, Traversal};
use forelight_scene::{Geometry, Limits, Scene};
use forelight_terminal::failure::{BadInput, Interrupted};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::output::Bars;
use forelight_terminal::table::{Align, Table};
use forelight_tracer::clocked;
use peer::Peer;
use serde::Serialize;
use std::path::{Path, PathBuf};
use workload::{Query, RaySet, workload};

/// Measure the speed of ray queries
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight bench rays kitchen/ corridor/
  forelight bench rays kitchen/ --rays 1000000 --export kitchen.rays --json
  forelight bench rays kitchen/ --peer target/embree

One thread traces the rays of each kind several times, and the median CPU time counts. Every surface is \
opaque. A peer is a program that traces the rays of an exported file, in turns with this one, such as \
tests/peers/embree.cpp.")]
pub struct Args {
    /// Scene bundles: folders or zip files
    #[arg(required = true)]
    bundles: Vec<PathBuf>,
    /// Approximate number of rays of each kind
    #[arg(long, value_name = "NUMBER", default_value_t = 200_000, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    rays: u32,
    /// Number of times to trace the rays of each kind
    #[arg(long, value_name = "NUMBER", default_value_t = 9, value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeats: u32,
    /// Seed of the rays
    #[arg(long, value_name = "NUMBER", default_value_t = 1)]
    seed: u64,
    /// Frame of the shot
    #[arg(long, value_name = "NUMBER", default_value_t = 0)]
    frame: u32,
    /// Also write the triangles, rays and hits of the only bundle to this file, for other programs
    #[arg(long, value_name = "FILE")]
    export: Option<PathBuf>,
    /// Program to compare with
    #[arg(long, value_name = "PROGRAM")]
    peer: Option<PathBuf>,
    /// Print the measurements as JSON to standard output
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Measured {
    /// Name that the peer reports.
    #[serde(skip_serializing_if = "Option::is_none")]
    peer: Option<String>,
    scenes: Vec<MeasuredScene>,
}

#[derive(Debug, Serialize)]
struct MeasuredScene {
    bundle: String,
    triangles: usize,
    /// CPU time of building the tree.
    build_seconds: f64,
    tree_nodes: usize,
    tree_groups: usize,
    tree_bytes_per_triangle: f64,
    /// Positions, normals, texture coordinates, indices and strata.
    geometry_bytes_per_triangle: f64,
    kinds: Vec<Kind>,
}

#[derive(Debug, Serialize)]
struct Kind {
    kind: &'static str,
    query: &'static str,
    rays: usize,
    /// Share of the rays that hit something.
    hits: f64,
    rays_per_second: f64,
    nodes_per_ray: f64,
    /// Triangle tests, counted in lanes.
    triangles_per_ray: f64,
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    beside: Option<Beside>,
}

/// The peer on the same rays.
#[derive(Debug, Serialize)]
struct Beside {
    peer_rays_per_second: f64,
    /// Median over the repeats of the peer's time over ours. Above 1 we are faster.
    ratio: f64,
    /// Number of rays with different results.
    differing: usize,
}

pub fn run(args: &Args, interrupt: &Interrupt) -> Result<Report> {
    if args.export.is_some() && args.bundles.len() > 1 {
        return Err(BadInput::new("--export: a file holds the rays of one bundle, so name only one").into());
    }
    let bars = Bars::new(args.json);
    let mut measured = Measured { peer: None, scenes: Vec::new() };
    for bundle in &args.bundles {
        let spinner = bars.spinner(format!("tracing {}", bundle.display()));
        let scene = measure(args, bundle, &mut measured.peer, interrupt)?;
        spinner.finish_and_clear();
        measured.scenes.push(scene);
    }
    report(&measured).printed(args.json, &measured)
}

fn measure(
    args: &Args,
    bundle: &Path,
    peer_name: &mut Option<String>,
    interrupt: &Interrupt,
) -> Result<MeasuredScene> {
    let frame = Scene::load(bundle, &Limits::default())
        .and_then(|scene| scene.frame(args.frame))
        .map_err(|error| BadInput::new(format!("bundle {}: {error}", bundle.display())))?;
    let geometry = &*frame.geometry;
    let (bvh, build_nanos) = clocked(|| Bvh::build(&geometry.positions, &geometry.triangles));
    let sets = workload(&frame, &bvh, args.rays, args.seed);
    let mut answers: Vec<Vec<Answer>> =
        sets.iter().map(|set| vec![Answer::NOTHING; set.rays.len()]).collect();
    for (set, answers) in sets.iter().zip(&mut answers) {
        trace(&bvh, set, answers);
    }
    if let Some(path) = &args.export {
        export::write(path, geometry, &sets, &answers)?;
    }
    // The peer reads our hits to compare them.
    let folder = tempfile::tempdir().context("cannot make a temporary folder")?;
    let mut peer = None;
    if let Some(program) = &args.peer {
        let path = folder.path().join("scene.rays");
        export::write(&path, geometry, &sets, &answers)?;
        let (started, name) = Peer::start(program, &path)?;
        *peer_name = Some(name);
        peer = Some(started);
    }
    let mut kinds = Vec::new();
    for (index, (set, answers)) in sets.iter().zip(&mut answers).enumerate() {
        let peer = peer.as_mut().map(|peer| (peer, index));
        kinds.push(measure_kind(args.repeats, &bvh, set, answers, peer, interrupt)?);
    }
    if let Some(peer) = peer {
        peer.finish()?;
    }
    let triangles = geometry.triangles.len();
    let (tree_nodes, tree_groups) = bvh.size();
    Ok(MeasuredScene {
        bundle: bundle.display().to_string(),
        triangles,
        build_seconds: build_nanos as f64 * 1e-9,
        tree_nodes,
        tree_groups,
        tree_bytes_per_triangle: bvh.bytes() as f64 / triangles.max(1) as f64,
        geometry_bytes_per_triangle: geometry_bytes(geometry) as f64 / triangles.max(1) as f64,
        kinds,
    })
}

/// Traces a set of rays several times. The peer, if there is one, takes turns, with the set of this index.
fn measure_kind(
    repeats: u32,
    bvh: &Bvh,
    set: &RaySet,
    answers: &mut [Answer],
    mut peer: Option<(&mut Peer, usize)>,
    interrupt: &Interrupt,
) -> Result<Kind> {
    let (mut ours, mut theirs, mut ratios) = (Vec::new(), Vec::new(), Vec::new());
    let mut steps = Traversal::default();
    for _ in 0..repeats {
        if interrupt.is_set() {
            return Err(Interrupted.into());
        }
        let (traced, nanos) = clocked(|| trace(bvh, set, answers));
        steps = traced;
        let own = nanos as f64 * 1e-9;
        ours.push(own);
        if let Some((peer, index)) = &mut peer {
            let other = peer.trace(*index)?;
            theirs.push(other);
            ratios.push(other / own);
        }
    }
    let rays = set.rays.len();
    let beside = match peer {
        None => None,
        Some((peer, index)) => Some(Beside {
            peer_rays_per_second: rays as f64 / median(theirs),
            ratio: median(ratios),
            differing: peer.differing(index)?,
        }),
    };
    let per_ray = |count: u64| count as f64 / rays.max(1) as f64;
    Ok(Kind {
        kind: set.name,
        query: match set.query {
            Query::Closest => "closest",
            Query::Any => "any",
        },
        rays,
        hits: per_ray(answers.iter().filter(|a| **a != Answer::NOTHING).count() as u64),
        rays_per_second: rays as f64 / median(ours),
        nodes_per_ray: per_ray(steps.nodes),
        triangles_per_ray: per_ray(steps.triangles),
        beside,
    })
}

fn trace(bvh: &Bvh, set: &RaySet, answers: &mut [Answer]) -> Traversal {
    let mut steps = Traversal::default();
    match set.query {
        Query::Closest => {
            for (answer, ray) in answers.iter_mut().zip(&set.rays) {
                *answer = bvh
                    .closest(ray, |_| true, &mut steps)
                    .map_or(Answer::NOTHING, |hit| Answer { triangle: hit.primitive, t: hit.t });
            }
        }
        Query::Any => {
            for (answer, ray) in answers.iter_mut().zip(&set.rays) {
                let met = bvh.any(ray, |_| true, &mut steps);
                *answer = if met { Answer::SOMETHING } else { Answer::NOTHING };
            }
        }
    }
    steps
}

fn geometry_bytes(geometry: &Geometry) -> usize {
    size_of_val(geometry.positions.as_slice())
        + size_of_val(geometry.normals.as_slice())
        + size_of_val(geometry.uvs.as_slice())
        + size_of_val(geometry.triangles.as_slice())
        + size_of_val(geometry.triangle_stratum.as_slice())
}

/// Upper median. Zero without values.
fn median(values: Vec<f64>) -> f64 {
    upper_median(&sorted(values)).unwrap_or(0.0)
}

fn report(measured: &Measured) -> Report {
    let mut head = vec![
        ("rays", Align::Left),
        ("asked", Align::Left),
        ("number", Align::Right),
        ("hit", Align::Right),
        ("nodes", Align::Right),
        ("triangles", Align::Right),
        ("M/s", Align::Right),
    ];
    if let Some(peer) = &measured.peer {
        head.extend([(peer.as_str(), Align::Right), ("ratio", Align::Right), ("differ", Align::Right)]);
    }
    let mut report = Report::default();
    for scene in &measured.scenes {
        let text = format!(
            "{}: {} triangles; tree {:.1} and geometry {:.1} bytes a triangle; built in {:.2} s\n",
            scene.bundle,
            scene.triangles,
            scene.tree_bytes_per_triangle,
            scene.geometry_bytes_per_triangle,
            scene.build_seconds,
        );
        let mut table = Table::new(&head);
        for kind in &scene.kinds {
            let mut cells = vec![
                kind.kind.to_owned(),
                kind.query.to_owned(),
                kind.rays.to_string(),
                format!("{:.1} %", kind.hits * 100.0),
                format!("{:.2}", kind.nodes_per_ray),
                format!("{:.2}", kind.triangles_per_ray),
                format!("{:.2}", kind.rays_per_second * 1e-6),
            ];
            if let Some(beside) = &kind.beside {
                cells.extend([
                    format!("{:.2}", beside.peer_rays_per_second * 1e-6),
                    format!("{:.2}", beside.ratio),
                    beside.differing.to_string(),
                ]);
            }
            table.row(cells);
        }
        report = report.text(text).table(table).text("\n");
    }
    report
}

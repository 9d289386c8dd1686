//! `forelight bench coverage`: how often the truth stays below the quantiles of a forecast.

mod case;
mod fields;
mod plot;
mod report;
mod rows;
mod scenes;

use crate::report::Report;
use anyhow::{Context, Result};
use case::Effort;
use fields::Family;
use forelight_terminal::atomic_file::{self, write_bytes};
use forelight_terminal::failure::{BadInput, Interrupted};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::json_file;
use forelight_terminal::local::Local;
use forelight_terminal::options::MachineOptions;
use forelight_terminal::output::Bars;
use rayon::prelude::*;
use rows::{Coverage, Group, Level, row};
use std::path::PathBuf;

/// Measure how often the truth stays below forecast quantiles, before and after calibration
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight bench coverage
  forelight bench coverage kitchen/ corridor/ --svg reliability.svg --out coverage.json
  forelight bench coverage --fields 4000 --json

Each case is a quote of a shot whose true cost per pixel is known. Synthetic shots have light and heavy \
tails and are all different. Bundles add some of their frames at several qualities and seeds. Quantiles of \
work are judged for strata of profiled frames, for frames and for whole shots, before calibration and after \
it. Synthetic shots are calibrated on the other half of the synthetic shots, scenes on all other scenes, \
and single pixels by the profile of their own frame. The 95 % intervals count shots, because frames of a \
shot share their errors.")]
pub struct Args {
    /// Scene bundles to judge as well: folders or zip files
    #[arg(value_name = "BUNDLE")]
    bundles: Vec<PathBuf>,
    /// Synthetic shots; half of them calibrate the others
    #[arg(long, value_name = "COUNT", default_value_t = 2000, value_parser = clap::value_parser!(u32).range(0..=1_000_000))]
    fields: u32,
    /// Quotes of every scene at every quality, each with another choice of pixels
    #[arg(long, value_name = "COUNT", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    seeds: u32,
    /// Frames of every scene
    #[arg(long, value_name = "FRAMES", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=1000))]
    views: u32,
    /// Image width in pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=4096))]
    width: u32,
    /// Pixels to profile in a profiled frame
    #[arg(long, value_name = "PIXELS", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    samples: u32,
    /// Maximum number of frames to profile
    #[arg(long, value_name = "FRAMES", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    profile_frames: u32,
    /// Write a reliability diagram to this file
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
    /// Also write the measurements to this file as JSON
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Print the measurements as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    machine: MachineOptions,
}

pub fn run(args: &Args, interrupt: &Interrupt) -> Result<Report> {
    atomic_file::check([args.svg.as_deref(), args.out.as_deref()])?;
    let bars = Bars::new(args.json);
    let report = measure(args, &bars, interrupt)?;
    if report.rows.is_empty() {
        let reason = format!("--fields {}: too few shots to judge", args.fields);
        return Err(BadInput::new(reason).hint("raise --fields, or name bundles").into());
    }
    if let Some(path) = &args.svg {
        write_bytes(path, plot::svg(&report)?.as_bytes())?;
    }
    json_file::write(args.out.as_deref(), &report)?;
    report::of(&report).printed(args.json, &report)
}

fn measure(args: &Args, bars: &Bars, interrupt: &Interrupt) -> Result<Coverage> {
    let effort = Effort { frames: args.profile_frames as usize, samples: args.samples };
    let synthetic = synthetic(args, effort, bars, interrupt)?;
    let mut scenes: Vec<(String, Vec<Group>)> = Vec::with_capacity(args.bundles.len());
    for bundle in &args.bundles {
        let local = Local::open(bundle, &args.machine, bars)?;
        let name = local.shot.info().summary.name.clone();
        let groups = of_scene(args, &local, &name, effort, bars, interrupt);
        scenes.push((name, groups.with_context(|| format!("bundle {}", bundle.display()))?));
    }
    let mut rows = Vec::new();
    let (teachers, judged): (Vec<&Group>, Vec<&Group>) = synthetic.iter().partition(|group| group.calibrates);
    if !judged.is_empty() {
        rows.extend(Level::ALL.map(|level| row("synthetic: all", level, &judged, &teachers)));
        for family in Family::ALL {
            let own: Vec<&Group> =
                judged.iter().copied().filter(|group| group.family == family.title()).collect();
            rows.extend(Level::ALL.map(|level| row(family.title(), level, &own, &teachers)));
        }
    }
    for (place, (name, groups)) in scenes.iter().enumerate() {
        let others: Vec<&Group> = scenes
            .iter()
            .enumerate()
            .filter(|(other, _)| *other != place)
            .flat_map(|(_, (_, groups))| groups)
            .collect();
        let own: Vec<&Group> = groups.iter().collect();
        rows.extend(Level::ALL.map(|level| row(name, level, &own, &others)));
    }
    Ok(Coverage { samples: args.samples, profile_frames: args.profile_frames, rows })
}

fn synthetic(args: &Args, effort: Effort, bars: &Bars, interrupt: &Interrupt) -> Result<Vec<Group>> {
    let bar = bars.bar("synthetic", args.fields.into());
    let one = |number: u32| -> Result<Group> {
        if interrupt.is_set() {
            return Err(Interrupted.into());
        }
        let family = Family::ALL[number as usize % Family::ALL.len()];
        let case = fields::shot(family, number.into()).judge(effort, number.into())?;
        bar.inc(1);
        // Families alternate, so both halves have equally many of each.
        let calibrates = (number as usize / Family::ALL.len()).is_multiple_of(2);
        Ok(Group { calibrates, family: family.title().to_owned(), cases: vec![case] })
    };
    let pool = forelight_terminal::local::thread_pool(args.machine.threads)?;
    let groups = pool.install(|| (0..args.fields).into_par_iter().map(one).collect());
    bar.finish_and_clear();
    groups
}

fn of_scene(
    args: &Args,
    local: &Local,
    name: &str,
    effort: Effort,
    bars: &Bars,
    interrupt: &Interrupt,
) -> Result<Vec<Group>> {
    let mut groups = Vec::with_capacity(scenes::QUALITIES.len());
    for quality in scenes::QUALITIES {
        let known = scenes::shot(local, quality, args.width, args.views, bars, interrupt)?;
        let judge = |seed: u32| known.judge(effort, seed.into());
        let cases =
            local.pool.install(|| (0..args.seeds).into_par_iter().map(judge).collect::<Result<_>>())?;
        groups.push(Group { calibrates: false, family: format!("{name}, {}", quality.title), cases });
    }
    Ok(groups)
}

#[cfg(test)]
mod tests {
    use super::rows::Row;
    use super::*;
    use forelight_terminal::options::parsed;

    #[test]
    fn calibrated_quantiles_of_shots_that_calibrated_none_hold_what_they_promise() {
        let args: Args = parsed(["coverage", "--fields", "400", "--json"]);
        let report = measure(&args, &Bars::new(true), &Interrupt::default()).unwrap();
        let all: Vec<&Row> = report.rows.iter().filter(|row| row.shots == "synthetic: all").collect();
        assert_eq!(all.len(), 4);
        for row in all {
            // Pixels are calibrated by the profile of their own frame.
            let of_pixels = row.level == Level::Pixel;
            let teachers = if of_pixels { 0 } else { 200 };
            assert_eq!((row.cases, row.independent, row.calibrated_on), (200, 200, teachers));
            for nominal in [0.8, 0.95] {
                let point = row.point(nominal).unwrap();
                let share = point.calibrated.unwrap_or(point.formulas).share;
                // Four standard errors, for 200 shots that calibrate and 200 that are judged.
                let noise = 4.0 * (2.0 * nominal * (1.0 - nominal) / 200.0f64).sqrt();
                assert!((share - nominal).abs() < noise, "{:?} P{nominal}: {share}", row.level);
            }
        }
        let plot = plot::svg(&report).unwrap();
        roxmltree::Document::parse(&plot).unwrap();
        assert!(!plot.contains("NaN") && !report::of(&report).for_terminal().contains("NaN"));
    }

    #[test]
    fn a_scene_is_calibrated_on_the_others_and_without_others_on_none() {
        let folder = tempfile::tempdir().unwrap();
        let scene = r#"{"version":1,"name":"block","geometry":["t.obj"],
            "lights":[{"type":"point","position":[2,5,3],"intensity":[40,40,40]}],
            "camera":{"origin":[0,3,6],"target":[0,0,0],"up":[0,1,0],"fov_deg":50,"fov_axis":"x","width":16,"height":9}}"#;
        let mesh = "o floor\nv -9 0 -9\nv 9 0 -9\nv 9 0 9\nv -9 0 9\nf 1 4 3 2\n\
                    o block\nv -1 0 0\nv 1 0 0\nv 1 2 0\nv -1 2 0\nf 5 6 7 8\n";
        std::fs::write(folder.path().join("scene.json"), scene).unwrap();
        std::fs::write(folder.path().join("t.obj"), mesh).unwrap();
        let bundle = folder.path().display().to_string();
        let measured = |bundles: &[&str]| {
            let fixed = [
                "coverage",
                "--fields",
                "0",
                "--width",
                "12",
                "--samples",
                "12",
                "--seeds",
                "7",
                "--preview",
                "cpu",
            ];
            let args: Args = parsed(fixed.iter().chain(bundles));
            measure(&args, &Bars::new(true), &Interrupt::default()).unwrap().rows
        };
        let alone = measured(&[&bundle]);
        assert_eq!((alone.len(), alone[3].calibrated_on, alone[3].cases), (4, 0, 21));
        assert!(alone[3].point(0.8).unwrap().calibrated.is_none());
        let two = measured(&[&bundle, &bundle]);
        assert_eq!((two.len(), two[3].calibrated_on), (8, 21));
        assert!(two[3].point(0.8).unwrap().calibrated.is_some());
    }
}

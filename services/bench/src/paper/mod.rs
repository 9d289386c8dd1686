//! `forelight bench paper`: the paper's experiment with seven strategies of the paper and two of ours.

mod chart;
mod experiment;
mod figures;
mod foreign;
mod level;
mod noise;
mod picture;
mod predicted;
mod printed;
mod report;
mod study;
mod trial;

use crate::conventions::{PAPER_SIZE, slug};
use crate::report::Report;
use anyhow::{Context, Result};
use experiment::{Asked, forecasts, study};
use figures::File;
use foreign::Measurement;
use forelight_terminal::atomic_file::write_bytes;
use forelight_terminal::failure::BadInput;
use forelight_terminal::foreign::Foreign;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::local::{Local, thread_pool};
use forelight_terminal::options::MachineOptions;
use forelight_terminal::output::{self, Bars};
use level::Task;
use std::path::{Path, PathBuf};
use study::Study;

/// Repeat the paper's experiment: nine ways to forecast a frame, at four ambient levels, with many seeds
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight bench paper kitchen/ corridor/
  forelight bench paper kitchen/ --size 128 --seeds 100 --out kitchen-report/
  forelight bench paper kitchen/ --out report/ --json > paper.json
  forelight bench paper --renderer radiance kitchen.rif --frame 1 --gather-rays 48 --costs costs/

The frame is rendered once at each level, with one camera ray per pixel. Every strategy forecasts it from \
the costs of its pixels, once with each seed. The folder gets report.md, with tables like 1 to 5 of the \
paper and further ones, the pictures of its figures 1 to 9, and the error against the number of profiled \
pixels as SVG.")]
pub struct Args {
    /// Scene bundles: folders or zip files. With --renderer radiance, .rif files or octrees
    #[arg(required = true, value_name = "BUNDLE")]
    bundles: Vec<PathBuf>,
    /// Frame number
    #[arg(long, value_name = "N", default_value_t = 0)]
    frame: u32,
    /// Width and height of the image in pixels
    #[arg(long, value_name = "PIXELS", default_value_t = PAPER_SIZE, value_parser = clap::value_parser!(u32).range(1..=4096))]
    size: u32,
    /// Pixels to profile, 1 to a million
    #[arg(long, value_name = "PIXELS", default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    samples: u32,
    /// Forecasts by each strategy at each level
    #[arg(long, value_name = "COUNT", default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    seeds: u32,
    /// Renders at each level; the median CPU time of each pixel counts
    #[arg(long, value_name = "TIMES", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=99))]
    repeats: u32,
    /// Rays of a gather, with a cache and without one: 48, 192, 432, 768, ...
    #[arg(long, value_name = "RAYS", default_value_t = 192, value_parser = clap::value_parser!(u32).range(48..=65_536))]
    gather_rays: u32,
    /// Renderer to repeat the experiment with: our own, or radiance, the paper's, whose tables have the
    /// paper's errors beside ours. All pixels are measured once
    #[arg(long, value_name = "NAME", value_parser = ["own", "radiance"], default_value = "own")]
    renderer: String,
    /// Keep the costs of all pixels in this folder, and use those that were kept before. Needs --renderer
    /// radiance
    #[arg(long, value_name = "DIR")]
    costs: Option<PathBuf>,
    /// Folder for the report
    #[arg(long, value_name = "DIR", default_value = "report")]
    out: PathBuf,
    /// Print the measurements as JSON to standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    machine: MachineOptions,
}

pub fn run(args: &Args, interrupt: &Interrupt) -> Result<Report> {
    let bars = Bars::new(args.json);
    let mut studies = Vec::with_capacity(args.bundles.len());
    let mut files = Vec::new();
    let is_own = args.renderer == "own";
    if is_own && args.costs.is_some() {
        return Err(BadInput::new("--costs: needs --renderer radiance").into());
    }
    for (place, bundle) in args.bundles.iter().enumerate() {
        if !is_own {
            let study = other(args, (place, bundle), &mut files, &bars, interrupt);
            studies.push(study.with_context(|| format!("scene {}", bundle.display()))?);
            continue;
        }
        let local = Local::open(bundle, &args.machine, &bars)?;
        let folder = slug(place, &local.shot.info().summary.name);
        let study = study(task(args, &local), &folder, &mut files, &bars, interrupt);
        studies.push((folder, study.with_context(|| format!("bundle {}", bundle.display()))?));
    }
    // Write nothing before all is measured.
    files.push(File { path: "report.md".into(), contents: report::markdown(&studies).into_bytes() });
    for File { path, contents } in &files {
        write_bytes(&args.out.join(path), contents)?;
    }
    let studies: Vec<Study> = studies.into_iter().map(|(_, study)| study).collect();
    let report = report::summary(&studies).printed(args.json, &studies)?;
    if !args.json {
        output::line(format!("\nWrote the report to {}.", args.out.join("report.md").display()))?;
    }
    Ok(report)
}

/// The experiment with another renderer. Returns the folder of its pictures, too.
fn other(
    args: &Args,
    (place, scene): (usize, &Path),
    files: &mut Vec<File>,
    bars: &Bars,
    interrupt: &Interrupt,
) -> Result<(String, Study)> {
    let foreign = Foreign::open(scene, &args.machine, bars, interrupt)?;
    let &Args { frame, size, samples, seeds, gather_rays, .. } = args;
    let (name, _) = foreign.scene(scene)?;
    let folder = slug(place, &name);
    let known = args.costs.as_ref().map(|costs| costs.join(format!("{name}.json")));
    let measurement = Measurement { foreign: &foreign, frame, size, gather_rays, known };
    let measured = measurement.measure(bars, interrupt)?;
    let renderer = Some(foreign.renderer.id().to_string());
    let pool = &thread_pool(args.machine.threads)?;
    let asked = Asked { name, renderer, frame, size, gather_rays, samples, seeds, pool };
    let study = forecasts(asked, measured, &folder, files, bars, interrupt)?;
    Ok((folder, study))
}

fn task<'a>(args: &Args, local: &'a Local) -> Task<'a> {
    let &Args { frame, size, samples, seeds, repeats, gather_rays, .. } = args;
    Task { local, frame, size, gather_rays, samples, seeds, repeats }
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_terminal::options::parsed;

    /// Runs the experiment on a floor with a block, lit or dark. Returns the report and the measurements.
    fn experiment(lamp: &str, flags: &[&str]) -> (tempfile::TempDir, Vec<(String, Study)>) {
        let folder = tempfile::tempdir().unwrap();
        let scene = format!(
            r#"{{"version":1,"name":"a|block","geometry":["t.obj"],"lights":[{lamp}],
            "camera":{{"origin":[0,3,6],"target":[0,0,0],"up":[0,1,0],"fov_deg":50,"fov_axis":"x","width":4,"height":4}}}}"#
        );
        std::fs::write(folder.path().join("scene.json"), scene).unwrap();
        let mesh = "o floor\nv -9 0 -9\nv 9 0 -9\nv 9 0 9\nv -9 0 9\nf 1 4 3 2\n\
                    o block\nv -1 0 0\nv 1 0 0\nv 1 2 0\nv -1 2 0\nf 5 6 7 8\n";
        std::fs::write(folder.path().join("t.obj"), mesh).unwrap();
        let (bundle, out) = (folder.path().display().to_string(), folder.path().join("report"));
        let out = out.display().to_string();
        let fixed = ["paper", &bundle, "--out", &out, "--json", "--preview", "cpu", "--gather-rays", "48"];
        let args: Args = parsed(fixed.iter().chain(flags));
        let bars = Bars::new(true);
        let local = Local::open(folder.path(), &args.machine, &bars).unwrap();
        let mut files = Vec::new();
        let study = study(task(&args, &local), "1-t", &mut files, &bars, &Interrupt::default()).unwrap();
        let studies = vec![("1-t".to_owned(), study)];
        run(&args, &Interrupt::default()).unwrap();
        (folder, studies)
    }

    const LAMP: &str = r#"{"type":"point","position":[2,5,3],"intensity":[40,40,40]}"#;

    #[test]
    fn the_experiment_writes_a_whole_report_and_every_number_of_it_is_one() {
        for (lamp, flags) in [
            (LAMP, ["--size", "24", "--samples", "40", "--seeds", "3"]),
            ("", ["--size", "1", "--samples", "1000", "--seeds", "1"]),
        ] {
            let (folder, studies) = experiment(lamp, &flags);
            let out = folder.path().join("report");
            let report = std::fs::read_to_string(out.join("report.md")).unwrap();
            for word in ["NaN", "inf ", "inf%"] {
                assert!(!report.contains(word), "{report}");
            }
            let pictures: Vec<&str> = report
                .match_indices("](")
                .map(|(at, _)| {
                    let rest = &report[at + 2..];
                    &rest[..rest.find(')').unwrap()]
                })
                .collect();
            assert!(pictures.len() > 60);
            for picture in pictures {
                assert!(out.join(picture).is_file(), "{picture}");
            }
            let text = serde_json::to_string(&studies).unwrap();
            assert!(!text.contains("null,\"work\"") && !text.contains("NaN"), "{text}");
            assert_eq!(studies[0].1.levels.len(), 4);
        }
    }

    #[test]
    fn as_many_samples_as_pixels_leave_no_error_but_that_of_the_records() {
        let (_folder, studies) = experiment(LAMP, &["--size", "12", "--samples", "144", "--seeds", "2"]);
        for level in &studies[0].1.levels {
            assert!(level.actual.work > 0.0);
            for outcome in level.outcomes.iter().filter(|_| !level.level.is_cached()) {
                let error = outcome.error.work;
                assert!(error.largest < 1e-12, "{:?} {:?}: {error:?}", level.level, outcome.strategy);
            }
            assert_eq!(level.records.is_empty(), !level.level.is_cached());
        }
    }
}

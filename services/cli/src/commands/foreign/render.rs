//! `forelight render shot.blend`: frames by another renderer, with their true cost.

use crate::commands::numbered::numbered;
use anyhow::{Context, Result};
use forelight_protocol::FrameSet;
use forelight_renderer::door::{Cost, FixedCosts, Rendered, RendererId, Run, Settings};
use forelight_renderer_own::png;
use forelight_terminal::atomic_file::{self, write_bytes, write_with};
use forelight_terminal::failure::BadInput;
use forelight_terminal::foreign::{Foreign, OwnSetting};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::json_file;
use forelight_terminal::options::{MachineOptions, QualityOptions};
use forelight_terminal::output::{self, Bars};
use forelight_terminal::quantities::seconds;
use indicatif::ProgressBar;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Most frames that one command renders.
const MOST_FRAMES: u64 = 100_000;

/// What is asked for.
pub struct Asked<'a> {
    pub scene: &'a Path,
    /// `None`: the first frame of the shot.
    pub frame: Option<i32>,
    /// Frames to render instead of `frame`. Names of files hold # for the frame's number.
    pub frames: Option<&'a FrameSet>,
    pub out: Option<&'a Path>,
    pub stats: Option<&'a Path>,
    pub quality: &'a QualityOptions,
    pub own: &'a [OwnSetting],
    pub machine: &'a MachineOptions,
    pub json: bool,
}

#[derive(Serialize)]
struct Stats<'a> {
    renderer: &'a RendererId,
    frame: i32,
    settings: &'a Settings,
    cpu_seconds: f64,
    wall_seconds: f64,
    peak_rss_bytes: u64,
    /// CPU time before and after the samples, nanoseconds.
    fixed_nanos: &'a FixedCosts,
}

fn is_same_kind(one: &Path, other: &Path) -> bool {
    one.extension().zip(other.extension()).is_some_and(|(one, other)| one.eq_ignore_ascii_case(other))
}

/// Renders the frame or frames, and writes their images and costs.
pub fn render(asked: &Asked<'_>, interrupt: &Interrupt) -> Result<()> {
    let paths_of = |frame: i32| -> Result<[Option<PathBuf>; 2]> {
        let of = |flag: &str, path: Option<&Path>| match (path, asked.frames) {
            (Some(path), Some(_)) => numbered(flag, path, frame.into()).map(Some),
            (path, _) => Ok(path.map(Path::to_owned)),
        };
        Ok([of("--out", asked.out)?, of("--stats", asked.stats)?])
    };
    let bars = Bars::new(asked.json);
    let foreign = Foreign::open(asked.scene, asked.machine, &bars, interrupt)?;
    let settings = foreign.settings(asked.quality, asked.own)?;
    check_name(asked.out, &foreign.shot.image_extensions(&settings))?;
    let frames: Vec<i32> = match asked.frames {
        Some(frames) if frames.count() > MOST_FRAMES || i32::try_from(frames.last()).is_err() => {
            let reason = format!("--frames {frames}: at most {MOST_FRAMES} frames, up to {}", i32::MAX);
            return Err(BadInput::new(reason).into());
        }
        Some(frames) => frames.iter().map(u32::cast_signed).collect(),
        None => vec![asked.frame.unwrap_or(foreign.description().frames.first)],
    };
    let files = frames.iter().map(|frame| paths_of(*frame)).collect::<Result<Vec<_>>>()?;
    atomic_file::check(files.iter().flatten().map(Option::as_deref))?;
    let all = (frames.len() > 1).then(|| bars.bar("frames", frames.len() as u64));
    for (frame, [out, stats]) in frames.into_iter().zip(files) {
        let bar = bars.bar("rendering", 1000);
        let progress = |share: f64| bar.set_position((share * 1000.0) as u64);
        let run = Run { progress: &progress, ..foreign.run(interrupt) };
        let rendered = foreign.shot.render(frame, &settings, &[], &run);
        bar.finish_and_clear();
        let rendered = rendered?;
        if let Some(out) = &out {
            write_image(out, &rendered)?;
        }
        let Cost { cpu_nanos, wall_nanos, peak_memory_bytes, .. } = rendered.cost;
        let cost = Stats {
            renderer: foreign.renderer.id(),
            frame,
            settings: &settings,
            cpu_seconds: cpu_nanos as f64 * 1e-9,
            wall_seconds: wall_nanos as f64 * 1e-9,
            peak_rss_bytes: peak_memory_bytes,
            fixed_nanos: &rendered.fixed,
        };
        json_file::write(stats.as_deref(), &cost)?;
        report(&cost, asked)?;
        all.iter().for_each(|bar| bar.inc(1));
    }
    all.iter().for_each(ProgressBar::finish_and_clear);
    Ok(())
}

fn write_image(out: &Path, Rendered { files, picture, .. }: &Rendered) -> Result<()> {
    let same_kind = files.iter().find(|file| is_same_kind(file, out));
    match (same_kind.or(files.first()), picture) {
        (_, Some(picture)) if same_kind.is_none() => write_bytes(out, &png(picture)?),
        (Some(image), _) => {
            write_with(out, |to| std::fs::copy(image, to).map(drop).context("cannot copy the image"))
        }
        (None, _) => Ok(()),
    }
}

fn report(cost: &Stats<'_>, asked: &Asked<'_>) -> Result<()> {
    match (asked.json, asked.frames) {
        (true, Some(_)) => return output::json_line(cost),
        (true, None) => return output::json(cost),
        _ => {}
    }
    let fixed: u64 = cost.fixed_nanos.values().sum();
    output::line(format!(
        "frame {} by {}: {} of CPU time, {} of it before and after the samples",
        cost.frame,
        cost.renderer,
        seconds(cost.cpu_seconds),
        seconds(fixed as f64 * 1e-9),
    ))
}

/// Refuses a name that ends like no image of the renderer.
fn check_name(out: Option<&Path>, extensions: &[String]) -> Result<()> {
    let Some(out) = out else { return Ok(()) };
    let fits = |known: &String| out.extension().is_some_and(|end| end.eq_ignore_ascii_case(known.as_str()));
    if extensions.iter().any(fits) {
        return Ok(());
    }
    let known: Vec<String> = extensions.iter().map(|known| format!(".{known}")).collect();
    let known = known.join(" or ");
    let reason = format!("--out {}: the renderer writes {known} files", out.display());
    Err(BadInput::new(reason).hint(format!("name a file that ends in {known}")).into())
}

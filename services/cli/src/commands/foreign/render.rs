//! `forelight render shot.blend`: one frame by another renderer, with its true cost.

use anyhow::{Context, Result};
use forelight_renderer::door::{Cost, FixedCosts, Rendered, RendererId, Run, Settings};
use forelight_renderer_own::png;
use forelight_terminal::atomic_file::{self, write_bytes, write_with};
use forelight_terminal::failure::BadInput;
use forelight_terminal::foreign::{Foreign, OwnSetting};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::options::{MachineOptions, QualityOptions};
use forelight_terminal::output::{self, Bars};
use forelight_terminal::quantities::seconds;
use serde::Serialize;
use std::path::Path;

/// What is asked for.
pub struct Asked<'a> {
    pub scene: &'a Path,
    /// `None`: the first frame of the shot.
    pub frame: Option<i32>,
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
    /// CPU time that does not depend on the samples, nanoseconds.
    fixed_nanos: &'a FixedCosts,
}

fn is_same_kind(one: &Path, other: &Path) -> bool {
    one.extension().zip(other.extension()).is_some_and(|(one, other)| one.eq_ignore_ascii_case(other))
}

/// Renders the frame, and writes its image and cost.
pub fn render(asked: &Asked<'_>, interrupt: &Interrupt) -> Result<()> {
    atomic_file::check([asked.out, asked.stats])?;
    let bars = Bars::new(asked.json);
    let foreign = Foreign::open(asked.scene, asked.machine, &bars, interrupt)?;
    let settings = foreign.settings(asked.quality, asked.own)?;
    check_name(asked.out, &foreign.shot.image_extensions(&settings))?;
    let frame = asked.frame.unwrap_or(foreign.description().frames.first);
    let bar = bars.bar("rendering", 1000);
    let progress = |share: f64| bar.set_position((share * 1000.0) as u64);
    let run = Run { progress: &progress, ..foreign.run(interrupt) };
    let rendered = foreign.shot.render(frame, &settings, &[], &run);
    bar.finish_and_clear();
    let Rendered { files, picture, cost, fixed, .. } = rendered?;
    if let Some(out) = asked.out {
        let same_kind = files.iter().find(|file| is_same_kind(file, out));
        match (same_kind.or(files.first()), picture) {
            (_, Some(picture)) if same_kind.is_none() => write_bytes(out, &png(&picture)?)?,
            (Some(image), _) => {
                write_with(out, |to| std::fs::copy(image, to).map(drop).context("cannot copy the image"))?
            }
            (None, _) => {}
        }
    }
    let Cost { cpu_nanos, wall_nanos, peak_memory_bytes, .. } = cost;
    let stats = Stats {
        renderer: foreign.renderer.id(),
        frame,
        settings: &settings,
        cpu_seconds: cpu_nanos as f64 * 1e-9,
        wall_seconds: wall_nanos as f64 * 1e-9,
        peak_rss_bytes: peak_memory_bytes,
        fixed_nanos: &fixed,
    };
    if let Some(path) = asked.stats {
        write_bytes(path, (output::pretty(&stats)? + "\n").as_bytes())?;
    }
    if asked.json {
        return output::json(&stats);
    }
    let fixed: u64 = fixed.values().sum();
    output::line(format!(
        "frame {frame} by {}: {} of CPU time, {} of it before and after the samples",
        stats.renderer,
        seconds(stats.cpu_seconds),
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

//! Renders every frame in full, and can keep the costs.

use anyhow::Result;
use forelight_protocol::{RenderSettings, RenderStats};
use forelight_renderer_own::render_ready;
use forelight_terminal::failure::Interrupted;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::json_file;
use forelight_terminal::local::Local;
use forelight_terminal::output::Bars;
use std::path::{Path, PathBuf};

/// Costs of these frames. Costs found in the folder `kept` are reused, others are rendered and stored there.
/// File names depend on everything that affects the image.
pub fn of_frames(
    local: &Local,
    frames: &[u32],
    settings: &RenderSettings,
    kept: Option<&Path>,
    bars: &Bars,
    interrupt: &Interrupt,
) -> Result<Vec<RenderStats>> {
    let bar = bars.bar("rendering", frames.len() as u64);
    let mut all = Vec::with_capacity(frames.len());
    for &frame in frames {
        all.push(local.pool.install(|| of_frame(local, frame, settings, kept, interrupt))?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(all)
}

fn of_frame(
    local: &Local,
    frame: u32,
    settings: &RenderSettings,
    kept: Option<&Path>,
    interrupt: &Interrupt,
) -> Result<RenderStats> {
    let ready = local.shot.frame(frame, settings)?;
    let path = kept.map(|folder| -> PathBuf {
        // The fingerprint covers the tracer's version. This program defines the rest of a frame's cost.
        let image: String = ready.profile(&[]).fingerprint.iter().map(|byte| format!("{byte:02x}")).collect();
        folder.join(format!("{image}-{}.json", env!("CARGO_PKG_VERSION")))
    });
    if let Some(path) = path.as_deref().filter(|path| path.exists()) {
        return json_file::read(path);
    }
    let rendered =
        render_ready(&ready, settings, None, &|_| (), &|_| (), interrupt.flag())?.ok_or(Interrupted)?;
    if let Some(path) = path {
        json_file::write(Some(&path), &rendered.stats)?;
    }
    Ok(rendered.stats)
}

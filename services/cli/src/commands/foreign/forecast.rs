//! `forelight forecast shot.blend`: the quote of a shot that another renderer renders.

use crate::commands::explain::{self, Explained, Unit};
use anyhow::{Context, Result};
use forelight_pictures::png;
use forelight_protocol::words::counted;
use forelight_protocol::{ForecastDoc, FrameSet, PreviewBackend, Quantiles};
use forelight_renderer::door::{Common, RendererId, Settings};
use forelight_renderer::{QuotingStep, ShotQuote, Wanted, locates_costs, quote_shot};
use forelight_terminal::atomic_file::{self, write_bytes};
use forelight_terminal::cost_picture::{Paint, Scale, map};
use forelight_terminal::failure::BadInput;
use forelight_terminal::foreign::{Foreign, OwnSetting};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::options::{MachineOptions, QualityOptions};
use forelight_terminal::output::{self, Bars};
use forelight_terminal::quantities::seconds;
use forelight_terminal::table::{Align, Table};
use std::path::Path;

/// What is asked for.
pub struct Asked<'a> {
    pub scene: &'a Path,
    pub frames: Option<&'a FrameSet>,
    pub measured_frames: Option<u32>,
    /// Pixels to profile in each of them, if the renderer measures single pixels.
    pub samples: u32,
    /// Seed of their choice.
    pub seed: u64,
    pub quality: &'a QualityOptions,
    pub own: &'a [OwnSetting],
    pub machine: &'a MachineOptions,
    /// Whether the reasons are wanted too.
    pub explain: bool,
    /// Where to write the forecast cost of each pixel.
    pub cost_map: Option<&'a Path>,
    pub json: bool,
}

/// Makes and prints the quote.
pub fn forecast(asked: &Asked<'_>, interrupt: &Interrupt) -> Result<()> {
    let bars = Bars::new(asked.json);
    let foreign = Foreign::open(asked.scene, asked.machine, &bars, interrupt)?;
    let settings = foreign.settings(asked.quality, asked.own)?;
    if let Some(path) = asked.cost_map {
        check_cost_map(&foreign, &settings)?;
        atomic_file::check([Some(path)])?;
    }
    let frames = foreign.frames(asked.frames)?;
    let (name, digest) = foreign.scene(asked.scene)?;
    let frames_at_most = asked.measured_frames.map(|count| count as usize);
    let wanted = Wanted { frames: frames_at_most, samples: asked.samples, seed: asked.seed };
    let bar = bars.bar("previewing", 1000);
    let observe = |step: QuotingStep| match step {
        QuotingStep::Previewing(share) => bar.set_position((share * 1000.0) as u64),
        QuotingStep::Measuring { frame, done, all } => {
            bar.set_message(format!("measuring frame {frame}"));
            bar.set_position((done * 1000 / all.max(1)) as u64);
        }
    };
    let shot = (foreign.renderer.id(), &*foreign.shot);
    let run = foreign.run(interrupt);
    let quote = quote_shot(shot, (&name, digest), &frames, &settings, wanted, &observe, &run);
    bar.finish_and_clear();
    let quote = quote?;
    let explained = asked.explain.then(|| quote.explain(&settings)).transpose()?;
    let explained = explained.as_ref();
    if asked.json {
        output::json(&Explained { quote: &quote.document, explanation: explained })?;
    } else {
        let why = explained.map_or_else(String::new, |found| explain::text(found, Unit::CpuMicros));
        output::print(&(text(&quote, foreign.renderer.id(), &settings) + &why))?;
    }
    asked.cost_map.map_or(Ok(()), |path| write_cost_map(path, &quote, &settings, &bars))
}

/// The quote as a table, and what was measured for it.
fn text(quote: &ShotQuote, renderer: &RendererId, settings: &Settings) -> String {
    let ShotQuote { document, measured, profiled, preview, .. } = quote;
    let samples =
        measured.first().map_or(0, |frame| frame.result.shares.iter().map(|share| share.count).sum());
    let pixels = profiled.first().map(|profile| profile.result.samples.len());
    let mut measured = measured_text(document.profiled.frames.len(), samples, pixels);
    if preview.backend != PreviewBackend::Renderer {
        measured.push_str("; previewed all frames from their triangles");
    }
    report(document, renderer, settings, &measured)
}

/// Checks that the quote will know where in the image the time goes.
fn check_cost_map(foreign: &Foreign, settings: &Settings) -> Result<()> {
    if locates_costs(&*foreign.shot, settings) {
        return Ok(());
    }
    let renderer = foreign.renderer.id();
    let reason = format!("--cost-map: {renderer} does not say where in the image the time of this shot goes");
    let hint = match renderer.name.as_str() {
        "cycles" => "Blender 5.0 and later say it of 2 samples or more, with --set adaptive_sampling=false",
        _ => "leave out --cost-map",
    };
    Err(BadInput::new(reason).hint(hint).into())
}

/// Writes the forecast cost of each pixel of the first measured frame as a picture.
fn write_cost_map(path: &Path, quote: &ShotQuote, settings: &Settings, bars: &Bars) -> Result<()> {
    let (frame, costs) =
        quote.pixel_costs(settings)?.context("the renderer did not say where the time goes")?;
    let scale = Scale::of(&costs);
    let [least, most] = [scale.lowest, scale.highest].map(|nanos| nanos * 1e-6);
    bars.note(format!(
        "cost map of frame {frame}: cyan is {least:.3} ms of CPU time per pixel, red is {most:.3} ms"
    ));
    write_bytes(path, &png(&map(settings.common.width, &costs, scale, Paint::Colour))?)
}

/// What was measured: samples of frames, or pixels.
fn measured_text(frames: usize, samples: u32, pixels: Option<usize>) -> String {
    let frames = counted(frames, "frame");
    match (pixels, samples) {
        (Some(pixels), _) => format!("profiled {} of {frames}", counted(pixels, "pixel")),
        (None, 0) => format!("measured parts of {frames}"),
        (None, _) => format!("measured {} of {frames}", counted(samples, "sample")),
    }
}

fn report(quote: &ForecastDoc, renderer: &RendererId, settings: &Settings, measured: &str) -> String {
    let mut table = Table::new(&[
        ("frame", Align::Right),
        ("CPU time P50", Align::Right),
        ("P80", Align::Right),
        ("P95", Align::Right),
        ("", Align::Left),
    ]);
    let row = |name: String, cpu: &Quantiles, remark: &str| {
        let cells = [cpu.p50, cpu.p80, cpu.p95].map(seconds);
        [name].into_iter().chain(cells).chain([remark.to_owned()]).collect::<Vec<_>>()
    };
    for frame in &quote.frames {
        let remark = if quote.profiled.frames.contains(&frame.frame) { "measured" } else { "" };
        table.row(row(frame.frame.to_string(), &frame.cpu_seconds, remark));
    }
    table.footer();
    table.row(row("all".to_owned(), &quote.total.cpu_seconds, ""));
    let Common { width, height, samples: all, .. } = settings.common;
    format!(
        "{}\n{renderer}, {width} × {height}, {} per pixel; {measured}.\n\
         The quote took {} of CPU time, {:.1} % of the forecast. Its quantiles are not calibrated on past jobs.\n",
        table.render(),
        counted(all, "sample"),
        seconds(quote.spent.cpu_seconds),
        quote.spent.fraction_of_forecast * 100.0,
    )
}

//! `forelight forecast shot.blend`: the quote of a shot that another renderer renders.

use super::{Foreign, OwnSetting, refuse_quality};
use anyhow::Result;
use forelight_forecast::Quantity;
use forelight_protocol::FrameSet;
use forelight_renderer::door::{Renderer, RendererId, Settings};
use forelight_renderer::{QuotingStep, ShotQuote, quote_shot};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::options::{MachineOptions, QualityOptions};
use forelight_terminal::output::{self, Bars};
use forelight_terminal::quantities::{percent, seconds};
use forelight_terminal::table::{Align, Table};
use serde::Serialize;
use std::path::Path;

/// Frames that are measured where nothing else is asked for.
const MEASURED_FRAMES: usize = 5;

/// What is asked for.
pub struct Asked<'a> {
    pub scene: &'a Path,
    pub frames: Option<&'a FrameSet>,
    pub measured_frames: Option<u32>,
    pub quality: &'a QualityOptions,
    pub own: &'a [OwnSetting],
    pub machine: &'a MachineOptions,
    pub json: bool,
}

/// Makes and prints the quote.
pub fn forecast(asked: &Asked<'_>, interrupt: &Interrupt) -> Result<()> {
    refuse_quality(asked.quality)?;
    let bars = Bars::new(asked.json);
    let foreign = Foreign::open(asked.scene, asked.machine, &bars, interrupt)?;
    let settings = foreign.settings(asked.quality, asked.own)?;
    let frames = foreign.frames(asked.frames)?;
    let most = asked.measured_frames.map_or(MEASURED_FRAMES, |count| count as usize);
    let bar = bars.bar("previewing", 1000);
    let observe = |step: QuotingStep| match step {
        QuotingStep::Previewing(share) => bar.set_position((share * 1000.0) as u64),
        QuotingStep::Measuring { frame, done, all } => {
            bar.set_message(format!("measuring frame {frame}"));
            bar.set_position((done * 1000 / all.max(1)) as u64);
        }
    };
    let quote = quote_shot(&*foreign.shot, &frames, &settings, most, &observe, &foreign.run(interrupt));
    bar.finish_and_clear();
    let quote = quote?;
    let document = document(foreign.cycles.id(), &settings, &quote);
    if asked.json { output::json(&document) } else { output::print(&report(&document)) }
}

#[derive(Serialize)]
struct Document<'a> {
    renderer: &'a RendererId,
    settings: &'a Settings,
    frames: Vec<Frame>,
    total: Total,
    profiled: Profiled,
    spent: Spent,
    calibrated: bool,
}

#[derive(Serialize)]
struct Frame {
    frame: i64,
    cpu_seconds: Seconds,
    measured: bool,
}

#[derive(Serialize)]
struct Total {
    cpu_seconds: Seconds,
}

#[derive(Serialize)]
struct Profiled {
    frames: Vec<i32>,
    /// Samples per pixel that were measured, the same in every frame.
    samples: u32,
}

#[derive(Serialize)]
struct Spent {
    cpu_seconds: f64,
    fraction_of_forecast: f64,
}

#[derive(Serialize)]
struct Seconds {
    mean: f64,
    p50: f64,
    p80: f64,
    p95: f64,
}

impl Seconds {
    fn of(nanos: &Quantity) -> Self {
        let &Quantity { mean, p50, p80, p95, .. } = nanos;
        Self { mean: mean * 1e-9, p50: p50 * 1e-9, p80: p80 * 1e-9, p95: p95 * 1e-9 }
    }
}

fn document<'a>(renderer: &'a RendererId, settings: &'a Settings, quote: &ShotQuote) -> Document<'a> {
    let forecast = &quote.forecast;
    let spent = quote.spent.cpu_nanos as f64 * 1e-9;
    let total = Seconds::of(&forecast.total);
    let samples = quote.measured.first().map_or(0, |frame| frame.costs.iter().map(|cost| cost.samples).sum());
    Document {
        renderer,
        settings,
        frames: forecast
            .frames
            .iter()
            .map(|frame| Frame {
                frame: frame.number,
                cpu_seconds: Seconds::of(&frame.cpu_nanos),
                measured: frame.measured,
            })
            .collect(),
        profiled: Profiled { frames: quote.measured.iter().map(|frame| frame.frame).collect(), samples },
        spent: Spent {
            cpu_seconds: spent,
            fraction_of_forecast: if total.mean > 0.0 { spent / total.mean } else { 0.0 },
        },
        total: Total { cpu_seconds: total },
        calibrated: forecast.calibrated,
    }
}

fn report(document: &Document<'_>) -> String {
    let mut table = Table::new(&[
        ("frame", Align::Right),
        ("CPU time P50", Align::Right),
        ("P80", Align::Right),
        ("P95", Align::Right),
        ("", Align::Left),
    ]);
    let row = |name: String, cpu: &Seconds, remark: &str| {
        let cells = [cpu.p50, cpu.p80, cpu.p95].map(seconds);
        [name].into_iter().chain(cells).chain([remark.to_owned()]).collect::<Vec<_>>()
    };
    for frame in &document.frames {
        let remark = if frame.measured { "measured" } else { "" };
        table.row(row(frame.frame.to_string(), &frame.cpu_seconds, remark));
    }
    table.footer();
    table.row(row("all".to_owned(), &document.total.cpu_seconds, ""));
    let Document { renderer, settings, spent, profiled, .. } = document;
    let common = &settings.common;
    let calibrated = if document.calibrated { "calibrated" } else { "not calibrated" };
    format!(
        "{}\n{renderer}, {} × {}, {} samples per pixel; measured {} samples of {} frames\n\
         the quote cost {} of CPU time, {} of the forecast; quantiles are {calibrated}\n",
        table.render(),
        common.width,
        common.height,
        common.samples,
        profiled.samples,
        profiled.frames.len(),
        seconds(spent.cpu_seconds),
        percent(spent.fraction_of_forecast),
    )
}

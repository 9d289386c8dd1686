//! Scenes of other renderers, on this machine: `.blend` files, rendered by Blender Cycles.

mod forecast;
mod render;

pub use forecast::{Asked as AskedForecast, forecast};
pub use render::{Asked as AskedRender, render};

use anyhow::{Context, Result};
use clap::builder::TypedValueParser;
use forelight_protocol::FrameSet;
use forelight_renderer::door::{Common, Description, Limits, Renderer, Run, Settings, Shot};
use forelight_renderer_blender::Cycles;
use forelight_terminal::failure::BadInput;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::options::{MachineOptions, QualityOptions};
use forelight_terminal::output::Bars;
use serde_json::{Map, Value};
use std::path::Path;

/// A setting of the renderer: its name, and its value as JSON or as plain text.
#[derive(Clone, Debug, PartialEq)]
pub struct OwnSetting(String, Value);

/// Reads `NAME=VALUE`.
pub fn own_setting() -> impl TypedValueParser<Value = OwnSetting> {
    clap::builder::StringValueParser::new().try_map(|text| {
        let (name, value) = text.split_once('=').ok_or("write NAME=VALUE, such as denoise=false")?;
        let value = serde_json::from_str(value).unwrap_or_else(|_| Value::String(value.to_owned()));
        Ok::<_, &str>(OwnSetting(name.to_owned(), value))
    })
}

/// Whether another renderer opens this scene.
pub fn is_foreign(scene: &Path) -> bool {
    scene.extension().is_some_and(|end| end.eq_ignore_ascii_case("blend"))
}

/// Refuses flags that only our own renderer understands.
pub fn refuse(flags: &[(&str, bool)]) -> Result<()> {
    match flags.iter().find(|(_, is_given)| *is_given) {
        None => Ok(()),
        Some((flag, _)) => {
            let reason = format!("{flag}: only forelight's own renderer can do this");
            Err(BadInput::new(reason).hint("leave it out for a .blend file").into())
        }
    }
}

/// Refuses `--set` for our own renderer.
pub fn refuse_own_settings(own: &[OwnSetting]) -> Result<()> {
    match own {
        [] => Ok(()),
        _ => Err(BadInput::new("--set: only .blend files have such settings").into()),
    }
}

/// Refuses settings of light transport that only our own renderer understands.
pub fn refuse_quality(quality: &QualityOptions) -> Result<()> {
    refuse(&[
        ("--integrator", quality.integrator.is_some()),
        ("--ambient-bounces", quality.ambient_bounces.is_some()),
        ("--ambient-divisions", quality.ambient_divisions.is_some()),
        ("--max-depth", quality.max_depth.is_some()),
        ("--cache", quality.cache.is_some()),
        ("--cache-accuracy", quality.cache_accuracy.is_some()),
        ("--cache-rays", quality.cache_rays.is_some()),
        ("--materials", quality.materials.is_some()),
    ])
}

/// An open scene of another renderer.
pub struct Foreign {
    cycles: Cycles,
    shot: Box<dyn Shot>,
    scratch: tempfile::TempDir,
    limits: Limits,
}

impl Foreign {
    /// Finds the renderer and opens the scene.
    pub fn open(scene: &Path, machine: &MachineOptions, bars: &Bars, interrupt: &Interrupt) -> Result<Self> {
        if !scene.is_file() {
            return Err(BadInput::new(format!("{}: this file does not exist", scene.display())).into());
        }
        let cycles = Cycles::find()?;
        let scratch = tempfile::tempdir().context("cannot make a temporary folder")?;
        let threads = machine.threads.map_or_else(threads, u32::from);
        let limits = Limits { threads, ..Limits::default() };
        let spinner = bars.spinner(format!("loading {} with {}", scene.display(), cycles.id()));
        let shot = cycles.open(scene, &outside(scratch.path(), limits, interrupt));
        spinner.finish_and_clear();
        let shot = shot?;
        shot.description().notes.iter().for_each(|note| bars.note(note));
        Ok(Self { cycles, shot, scratch, limits })
    }

    /// A question to the renderer, without progress.
    fn run<'a>(&'a self, interrupt: &'a Interrupt) -> Run<'a> {
        outside(self.scratch.path(), self.limits, interrupt)
    }

    /// What is in the scene.
    pub fn description(&self) -> &Description {
        self.shot.description()
    }

    /// The file's settings, changed by the flags.
    pub fn settings(&self, quality: &QualityOptions, own: &[OwnSetting]) -> Result<Settings> {
        let file = &self.description().settings;
        let Common { width, height, samples, seed } = file.common;
        let size = |asked: Option<u32>, other: Option<u32>, own: u32, others: u32| match (asked, other) {
            (Some(asked), _) => asked,
            (None, Some(other)) => {
                (f64::from(own) * f64::from(other) / f64::from(others.max(1))).round().max(1.0) as u32
            }
            (None, None) => own,
        };
        let seed = match quality.seed {
            None => seed,
            Some(asked) => u32::try_from(asked)
                .map_err(|_| BadInput::new(format!("--seed {asked}: at most {}", u32::MAX)))?,
        };
        let common = Common {
            width: size(quality.width, quality.height, width, height),
            height: size(quality.height, quality.width, height, width),
            samples: quality.spp.unwrap_or(samples),
            seed,
        };
        let by: Map<String, Value> =
            own.iter().map(|OwnSetting(name, value)| (name.clone(), value.clone())).collect();
        let settings = Settings { common, ..file.clone() }.with_own(&by);
        settings.check(&self.cycles.settings_schema()).map_err(|wrong| BadInput::new(wrong.to_string()))?;
        Ok(settings)
    }

    /// The frames that were asked for, or all of the shot's.
    pub fn frames(&self, asked: Option<&FrameSet>) -> Result<Vec<i32>> {
        let all = self.description().frames;
        let Some(asked) = asked else { return Ok(all.numbers().collect()) };
        let number = |frame: u32| {
            i32::try_from(frame).map_err(|_| BadInput::new(format!("--frames: {frame} is too large")))
        };
        Ok(asked.iter().map(number).collect::<Result<_, _>>()?)
    }
}

fn outside<'a>(scratch: &'a Path, limits: Limits, interrupt: &'a Interrupt) -> Run<'a> {
    Run {
        cancelled: interrupt.flag(),
        progress: &|_| {},
        log: &|line| tracing::debug!("{line}"),
        scratch,
        limits,
    }
}

fn threads() -> u32 {
    std::thread::available_parallelism().map_or(1, |count| u32::try_from(count.get()).unwrap_or(1))
}

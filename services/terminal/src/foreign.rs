//! Scenes of other renderers on this machine: `.blend` files, rendered by Blender Cycles, `.rif` files and
//! octrees, rendered by Radiance, and scenes of programs that a `.command.toml` file describes.

use crate::failure::BadInput;
use crate::interrupt::Interrupt;
use crate::local::{cores, preview_choice, settings_request};
use crate::options::{MachineOptions, PreviewBackend, QualityOptions};
use crate::output::Bars;
use anyhow::{Context, Result};
use clap::builder::TypedValueParser;
use forelight_kept::TemporaryFolder;
use forelight_preview::SharedPreviewer;
use forelight_protocol::{FrameSet, RenderSettingsRequest, SceneDigest, ShotSettings};
use forelight_renderer::door::{Description, Limits, Renderer, RendererError, Run, Settings, Shot};
use forelight_renderer::{scene_digest, scene_name};
use forelight_renderer_blender::Cycles;
use forelight_renderer_command::{EXTENSION, open_command};
use forelight_renderer_radiance::Radiance;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Renderers on this machine besides our own.
pub struct Installed {
    /// Those that were found.
    pub renderers: Vec<Box<dyn Renderer>>,
    /// Why others were not found.
    pub missing: Vec<RendererError>,
}

/// Looks for the renderers of this machine, and takes those that command files describe. That starts each of
/// them, to ask for its version. They draw previews with this previewer.
///
/// # Errors
/// If something in a command file is wrong, or its program is missing.
pub fn installed(commands: &[PathBuf], previewer: Arc<SharedPreviewer>) -> Result<Installed> {
    let mut found = Installed { renderers: Vec::new(), missing: Vec::new() };
    match Cycles::find(previewer) {
        Ok(cycles) => found.renderers.push(Box::new(cycles)),
        Err(reason) => found.missing.push(reason),
    }
    match Radiance::find() {
        Ok(radiance) => found.renderers.push(Box::new(radiance)),
        Err(reason) => found.missing.push(reason),
    }
    for path in commands {
        let command = open_command(path).map_err(|error| BadInput::new(error.to_string()))?;
        if found.renderers.iter().any(|other| other.id().name == command.id().name) {
            let reason =
                format!("{}: there is another renderer called {}", path.display(), command.id().name);
            return Err(BadInput::new(reason).into());
        }
        found.renderers.push(Box::new(command));
    }
    Ok(found)
}

/// The renderer that opens this scene.
fn renderer_of(scene: &Path, preview: PreviewBackend) -> Result<Box<dyn Renderer>> {
    if is_command_file(scene) {
        let command = open_command(scene).map_err(|error| BadInput::new(error.to_string()))?;
        return Ok(Box::new(command));
    }
    if is_radiance(scene) {
        return Ok(Box::new(Radiance::find()?));
    }
    Ok(Box::new(Cycles::find(Arc::new(SharedPreviewer::new(preview_choice(preview))))?))
}

/// Whether the file describes a renderer that can only be started, and its scene.
fn is_command_file(scene: &Path) -> bool {
    scene.file_name().is_some_and(|name| name.to_string_lossy().ends_with(EXTENSION))
}

/// A setting of the renderer: its name, and its value as JSON or as plain text.
#[derive(Clone, Debug, PartialEq)]
pub struct OwnSetting(String, Value);

impl OwnSetting {
    /// Its name.
    pub fn name(&self) -> &str {
        &self.0
    }
}

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
    is_blend(scene) || is_radiance(scene) || is_command_file(scene)
}

/// Whether the scene is one of Radiance: a file of `rad`, or an octree.
pub fn is_radiance(scene: &Path) -> bool {
    scene.extension().is_some_and(|end| ["rif", "oct"].iter().any(|known| end.eq_ignore_ascii_case(known)))
}

/// Whether the scene is a Blender file.
pub fn is_blend(scene: &Path) -> bool {
    scene.extension().is_some_and(|end| end.eq_ignore_ascii_case("blend"))
}

/// Refuses flags that only our own renderer understands.
pub fn refuse(flags: &[(&str, bool)]) -> Result<()> {
    let hint = "leave it out for the scene of another renderer";
    refuse_because(flags, "only forelight's own renderer can do this", hint)
}

/// Refuses the first of these flags that is given, with the reason and what to do.
pub fn refuse_because(flags: &[(&str, bool)], reason: &str, hint: &'static str) -> Result<()> {
    match flags.iter().find(|(_, is_given)| *is_given) {
        None => Ok(()),
        Some((flag, _)) => Err(BadInput::new(format!("{flag}: {reason}")).hint(hint).into()),
    }
}

/// Refuses `--set` for our own renderer.
pub fn refuse_own_settings(own: &[OwnSetting]) -> Result<()> {
    match own {
        [] => Ok(()),
        _ => Err(BadInput::new("--set: only scenes of other renderers have such settings").into()),
    }
}

/// An open scene of another renderer.
pub struct Foreign {
    /// The renderer.
    pub renderer: Box<dyn Renderer>,
    /// The scene.
    pub shot: Box<dyn Shot>,
    scratch: TemporaryFolder,
    limits: Limits,
}

impl Foreign {
    /// Finds the renderer and opens the scene.
    pub fn open(scene: &Path, machine: &MachineOptions, bars: &Bars, interrupt: &Interrupt) -> Result<Self> {
        if !scene.is_file() {
            return Err(BadInput::new(format!("{}: this file does not exist", scene.display())).into());
        }
        let renderer = renderer_of(scene, machine.preview)?;
        let scratch = TemporaryFolder::new().context("cannot make a temporary folder")?;
        let threads = machine.threads.map_or_else(cores, u32::from);
        let limits = Limits { threads, ..Limits::default() };
        let spinner = bars.spinner(format!("loading {} with {}", scene.display(), renderer.id()));
        let shot = renderer.open(scene, &outside(scratch.path(), limits, interrupt));
        spinner.finish_and_clear();
        let shot = shot?;
        shot.description().notes.iter().for_each(|note| bars.note(note));
        Ok(Self { renderer, shot, scratch, limits })
    }

    /// A question to the renderer, without progress.
    pub fn run<'a>(&'a self, interrupt: &'a Interrupt) -> Run<'a> {
        outside(self.scratch.path(), self.limits, interrupt)
    }

    /// What is in the scene.
    pub fn description(&self) -> &Description {
        self.shot.description()
    }

    /// The file's settings, changed by the flags.
    pub fn settings(&self, quality: &QualityOptions, own: &[OwnSetting]) -> Result<Settings> {
        let job = as_shot(&shot_request(quality, own)?)?;
        let settings = self.description().settings.changed_by(&job);
        settings.check(&self.renderer.settings_schema()).map_err(|wrong| {
            BadInput::new(wrong.to_string()).hint("`forelight renderers` lists the settings")
        })?;
        Ok(settings)
    }

    /// The frames that were asked for, or all of the shot's.
    pub fn frames(&self, asked: Option<&FrameSet>) -> Result<Vec<u32>> {
        if let Some(asked) = asked {
            return Ok(asked.iter().collect());
        }
        let number = |frame: i32| {
            u32::try_from(frame).map_err(|_| {
                BadInput::new(format!("the shot has frame {frame}; frames below 0 cannot be rendered"))
                    .hint("name the frames with --frames")
            })
        };
        Ok(self.description().frames.numbers().map(number).collect::<Result<_, _>>()?)
    }

    /// Name and hash of the scene.
    pub fn scene(&self, path: &Path) -> Result<(String, SceneDigest)> {
        Ok((scene_name(path), scene_digest(path)?))
    }
}

/// The flags as a request for another renderer. Refuses those that only our own renderer understands.
pub fn shot_request(quality: &QualityOptions, own: &[OwnSetting]) -> Result<RenderSettingsRequest> {
    let own = own.iter().map(|OwnSetting(name, value)| (name.clone(), value.clone())).collect();
    // The service does not know the shape of the scene's image, so a width alone is sent alone.
    let QualityOptions { width, height, .. } = *quality;
    let request = RenderSettingsRequest { width, height, own, ..settings_request(quality, (1, 1)) };
    as_shot(&request)?;
    Ok(request)
}

fn as_shot(request: &RenderSettingsRequest) -> Result<ShotSettings> {
    request.of_shot().map_err(|wrong| {
        BadInput::new(format!("--{}: {}", wrong.name.replace('_', "-"), wrong.reason)).into()
    })
}

fn outside<'a>(scratch: &'a Path, limits: Limits, interrupt: &'a Interrupt) -> Run<'a> {
    Run { log: &|line| tracing::debug!("{line}"), ..Run::silent(interrupt.flag(), scratch, limits) }
}

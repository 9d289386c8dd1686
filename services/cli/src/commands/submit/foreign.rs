//! Jobs of other renderers. The service does not open their scenes, so the renderer on this machine is asked, if
//! there is one: for the frames of the shot, for missing files, and for a copy that holds all files.

use super::upload::upload;
use super::{Args, on_shared_storage, upload_key};
use crate::commands::blocking;
use anyhow::{Context, Result};
use forelight_client::Client;
use forelight_kept::{LARGEST, TemporaryFolder, named};
use forelight_protocol::{FrameSet, JobRequest, RendererRequest};
use forelight_renderer::door::RendererError;
use forelight_renderer::{scene_digest, scene_name};
use forelight_terminal::failure::BadInput;
use forelight_terminal::foreign::{Foreign, OwnSetting, is_blend, is_radiance, refuse, shot_request};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::local::kept_scenes;
use forelight_terminal::options::{Keep, MachineOptions, QualityOptions};
use forelight_terminal::output::Bars;
use forelight_terminal::quantities::bytes;
use std::path::{Path, PathBuf};
use uuid::Uuid;

/// Name of a copy that holds all files.
const PACKED: &str = "packed.blend";

/// The request for a job of another renderer. Uploads the scene, unless it stays on shared storage.
pub(super) async fn request(
    args: &Args,
    scene: &Path,
    client: &Client,
    (key, bars, interrupt): (Uuid, &Bars, &Interrupt),
) -> Result<JobRequest> {
    refuse(&[("--cache-error", args.cache_error.is_given())])?;
    let settings = shot_request(&args.quality, &args.own)?;
    check(args, scene)?;
    let mut found = Found { frames: args.frames.clone(), packed: None };
    if (is_blend(scene) && !args.shared) || args.frames.is_none() {
        let question = Question {
            scene: scene.to_owned(),
            frames: args.frames.clone(),
            quality: args.quality.clone(),
            own: args.own.clone(),
            pack: !args.shared,
        };
        let (bars, interrupt) = (bars.clone(), interrupt.clone());
        found = blocking(move || question.ask(&bars, &interrupt)).await?;
    }
    let Some(frames) = found.frames else {
        let reason =
            "--frames: only its renderer knows the frames of this scene, and it is not on this machine";
        return Err(BadInput::new(reason).hint("give them, such as --frames 1-250").into());
    };
    let known = if is_radiance(scene) { "radiance" } else { "cycles" };
    let renderer = args.renderer.clone().unwrap_or(RendererRequest { name: known.to_owned(), version: None });
    let reference = if args.shared {
        on_shared_storage(scene)?
    } else {
        let packed = found.packed.as_ref().map(|folder| folder.path().join(PACKED));
        upload(packed.as_deref().unwrap_or(scene), client, upload_key(key), bars).await?.0
    };
    let request = super::request(args, reference, scene_name(scene), frames, settings)?;
    Ok(JobRequest { renderer: Some(renderer), ..request })
}

/// Refuses scenes that workers could not open.
fn check(args: &Args, scene: &Path) -> Result<(), BadInput> {
    if is_radiance(scene) && !args.shared {
        let reason = format!("{}: a scene of Radiance needs --shared", scene.display());
        let hint = "it has several files, which stay on storage that all workers share";
        return Err(BadInput::new(reason).hint(hint));
    }
    let stays = args.shared && (args.renderer.is_some() || is_radiance(scene));
    if !is_blend(scene) && !stays {
        let reason = format!("{}: this scene needs --shared and --renderer", scene.display());
        let hint = "--shared leaves it on storage that all workers share; --renderer names the renderer, which a \
                    worker's --command file describes";
        return Err(BadInput::new(reason).hint(hint));
    }
    Ok(())
}

/// What the renderer on this machine is asked.
struct Question {
    scene: PathBuf,
    frames: Option<FrameSet>,
    quality: QualityOptions,
    own: Vec<OwnSetting>,
    /// Whether a copy is wanted that holds all files.
    pack: bool,
}

/// What it answered.
struct Found {
    /// Frames of the job, if they are known.
    frames: Option<FrameSet>,
    /// The folder of the copy, if the scene refers to files outside. Nobody else can read it.
    packed: Option<TemporaryFolder>,
}

impl Question {
    fn ask(self, bars: &Bars, interrupt: &Interrupt) -> Result<Found> {
        if !is_blend(&self.scene) && !is_radiance(&self.scene) {
            return Ok(Found { frames: self.frames, packed: None });
        }
        let machine = MachineOptions::default();
        let foreign = match Foreign::open(&self.scene, &machine, bars, interrupt) {
            Err(error) if matches!(error.downcast_ref(), Some(RendererError::NotInstalled { .. })) => {
                if self.pack {
                    bars.note(
                        "Blender is not on this machine: files that the scene refers to are not uploaded",
                    );
                }
                return Ok(Found { frames: self.frames, packed: None });
            }
            opened => opened?,
        };
        let numbers = foreign.frames(self.frames.as_ref())?;
        let packed = if self.pack { self.packed(&foreign, bars, interrupt)? } else { None };
        Ok(Found { frames: FrameSet::from_frames(numbers), packed })
    }

    /// A copy of the scene that holds all files, if it refers to any. Blender does not write the same bytes
    /// twice, so the copy is kept: the farm has it already when the same scene is submitted again.
    fn packed(
        &self,
        foreign: &Foreign,
        bars: &Bars,
        interrupt: &Interrupt,
    ) -> Result<Option<TemporaryFolder>> {
        let kept = kept_scenes(Keep::On).zip(self.name(foreign)?);
        let beside = TemporaryFolder::new().context("cannot make a temporary folder")?;
        let copy = beside.path().join(PACKED);
        if let Some(content) = kept.as_ref().and_then(|(folder, name)| folder.read(name)) {
            std::fs::write(&copy, content).with_context(|| format!("cannot write {}", copy.display()))?;
            return Ok(Some(beside));
        }
        let settings = foreign.settings(&self.quality, &self.own)?;
        let spinner = bars.spinner(format!("packing {}", self.scene.display()));
        let is_packed = foreign.shot.pack(&settings, &copy, &foreign.run(interrupt));
        spinner.finish_and_clear();
        if !is_packed? {
            return Ok(None);
        }
        let unreadable = || format!("cannot read {}", copy.display());
        let size = std::fs::metadata(&copy).with_context(unreadable)?.len();
        bars.note(format!("packed all files into a copy of {}", bytes(size)));
        if let Some((folder, name)) = kept.filter(|_| size <= LARGEST) {
            folder.write(&name, &[&std::fs::read(&copy).with_context(unreadable)?]);
        }
        Ok(Some(beside))
    }

    /// Name of the copy, by all that is in it. `None` where a path is a pattern of several files.
    fn name(&self, foreign: &Foreign) -> Result<Option<blake3::Hash>> {
        let mut hasher = named("packed scene");
        hasher.update(foreign.renderer.id().to_string().as_bytes());
        hasher.update(&scene_digest(&self.scene)?.0);
        for asset in foreign.description().outside() {
            let Ok(digest) = scene_digest(Path::new(&asset.path)) else { return Ok(None) };
            hasher.update(asset.path.as_bytes()).update(&[0]).update(&digest.0);
        }
        Ok(Some(hasher.finalize()))
    }
}

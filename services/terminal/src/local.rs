//! Work on this machine: an open bundle, complete settings, and a thread pool.

use crate::failure::BadInput;
use crate::options::{Keep, MachineOptions, PreviewBackend, QualityOptions};
use crate::output::Bars;
use anyhow::{Context, Result};
use etcetera::BaseStrategy as _;
use forelight_kept::Folder;
use forelight_preview::Choice;
use forelight_protocol::{FrameSet, RenderSettings, RenderSettingsRequest};
use forelight_renderer_own::{OwnRenderer, OwnShot};
use std::path::Path;

/// An open bundle with its thread pool.
pub struct Local {
    /// The bundle.
    pub shot: OwnShot,
    /// Threads that trace light.
    pub pool: rayon::ThreadPool,
}

impl Local {
    /// Opens a bundle.
    pub fn open(bundle: &Path, machine: &MachineOptions, bars: &Bars) -> Result<Self> {
        if !bundle.exists() {
            let missing = format!("bundle {}: this file or folder does not exist", bundle.display());
            return Err(BadInput::new(missing).into());
        }
        let pool = thread_pool(machine.threads)?;
        let mut ambient = OwnRenderer::new(preview_choice(machine.preview));
        if let Some(folder) = kept_scenes(machine.keep) {
            ambient = ambient.keeping(folder);
        }
        let spinner = bars.spinner(format!("loading {}", bundle.display()));
        let shot = pool.install(|| ambient.open(bundle));
        spinner.finish_and_clear();
        Ok(Self { shot: shot.with_context(|| format!("bundle {}", bundle.display()))?, pool })
    }

    /// The settings. Missing ones come from the bundle's camera.
    pub fn settings(&self, quality: &QualityOptions) -> Result<RenderSettings> {
        quality.check()?;
        let scene = &self.shot.info().summary;
        let settings =
            settings_request(quality, (scene.width, scene.height)).complete((scene.width, scene.height));
        settings.check().map_err(|wrong| {
            BadInput::new(format!("--{}: {}", wrong.name.replace('_', "-"), wrong.reason))
        })?;
        Ok(settings)
    }

    /// The frames, checked against the shot. `None` is all frames.
    pub fn frames(&self, wanted: Option<&FrameSet>) -> Result<Vec<u32>> {
        match wanted {
            None => Ok((0..self.shot.info().summary.frames).collect()),
            Some(wanted) => {
                self.check_frame("--frames", wanted.last())?;
                Ok(wanted.iter().collect())
            }
        }
    }

    /// The frame in the middle of these, checked against the shot. `None` is all frames.
    pub fn middle_frame(&self, wanted: Option<&FrameSet>) -> Result<u32, BadInput> {
        match wanted {
            None => Ok(self.shot.info().summary.frames / 2),
            Some(wanted) => self.check_frame("--frames", wanted.last()).map(|()| wanted.middle()),
        }
    }

    /// Checks that the shot has a frame. An error names the flag.
    pub fn check_frame(&self, flag: &str, frame: u32) -> Result<(), BadInput> {
        let last = self.shot.info().summary.frames.saturating_sub(1);
        if frame <= last {
            return Ok(());
        }
        let reason = format!("{flag}: frame {frame} is outside the shot, which has frames 0 to {last}");
        Err(BadInput::new(reason))
    }
}

/// Number of cores of this machine.
pub fn cores() -> u32 {
    std::thread::available_parallelism().map_or(1, |cores| u32::try_from(cores.get()).unwrap_or(1))
}

/// The thread pool that traces light.
pub fn thread_pool(threads: Option<u16>) -> Result<rayon::ThreadPool> {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads.map_or(0, usize::from))
        .thread_name(|index| format!("trace-{index}"))
        .build()
        .context("cannot start threads")
}

/// The folder of kept scenes in the user's cache folder. `None` if there can be none.
pub fn kept_scenes(keep: Keep) -> Option<Folder> {
    let user = etcetera::choose_base_strategy().ok().filter(|_| keep == Keep::On)?;
    let folder = user.cache_dir().join("forelight/scenes");
    let made = Folder::new(&folder);
    made.inspect_err(|error| tracing::debug!(path = %folder.display(), %error, "scenes cannot be kept")).ok()
}

/// The choice of the previewer for the flag.
pub fn preview_choice(backend: PreviewBackend) -> Choice {
    match backend {
        PreviewBackend::Auto => Choice::Auto,
        PreviewBackend::Gpu => Choice::Gpu,
        PreviewBackend::Cpu => Choice::Cpu,
    }
}

/// The flags as a request. If only one side of the image is set, the other keeps the camera's aspect ratio.
pub fn settings_request(quality: &QualityOptions, camera: (u32, u32)) -> RenderSettingsRequest {
    let (width, height) = match (quality.width, quality.height) {
        (Some(width), None) => (Some(width), Some(scaled(width, camera.1, camera.0))),
        (None, Some(height)) => (Some(scaled(height, camera.0, camera.1)), Some(height)),
        both => both,
    };
    RenderSettingsRequest {
        width,
        height,
        spp: quality.spp,
        integrator: quality.integrator,
        ambient_bounces: quality.ambient_bounces,
        ambient_divisions: quality.ambient_divisions,
        max_depth: quality.max_depth,
        cache: quality.cache,
        cache_accuracy: quality.cache_accuracy,
        cache_rays: quality.cache_rays,
        materials: quality.materials,
        seed: quality.seed,
        ..RenderSettingsRequest::default()
    }
}

/// `side` · `other` / `own`, rounded, at least 1.
fn scaled(side: u32, other: u32, own: u32) -> u32 {
    let own = u64::from(own.max(1));
    let scaled = (u64::from(side) * u64::from(other) + own / 2) / own;
    u32::try_from(scaled).unwrap_or(u32::MAX).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_side_of_the_image_brings_the_other_in_the_cameras_shape() {
        let mut quality = QualityOptions {
            width: Some(640),
            height: None,
            spp: None,
            integrator: None,
            ambient_bounces: None,
            ambient_divisions: None,
            max_depth: None,
            cache: None,
            cache_accuracy: None,
            cache_rays: None,
            materials: None,
            seed: None,
        };
        let size = |quality: &QualityOptions| {
            let settings = settings_request(quality, (1280, 720)).complete((1280, 720));
            (settings.width, settings.height)
        };
        assert_eq!(size(&quality), (640, 360));
        quality.height = Some(100);
        assert_eq!(size(&quality), (640, 100));
        quality.width = None;
        assert_eq!(size(&quality), (178, 100));
        quality.height = None;
        assert_eq!(size(&quality), (1280, 720));
    }
}

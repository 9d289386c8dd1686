//! Finds Open Image Denoise, and runs it.

use crate::pfm;
use forelight_kept::TemporaryFolder;
use forelight_renderer::door::{Limits, RendererError, Run};
use forelight_renderer::process::{Program, Sandbox, Usage, ask, run};
use std::fs;
use std::io::{Error, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// Variable with the path of the program.
const VARIABLE: &str = "FORELIGHT_OIDN";

/// The program of Open Image Denoise that reads and writes files.
const PROGRAM: &str = "oidnDenoise";

/// Name in messages and in images.
const NAME: &str = "Open Image Denoise";

/// Open Image Denoise on this machine.
#[derive(Debug, Clone)]
pub struct Denoiser {
    program: PathBuf,
}

/// A noisy image, and what its pixels show: row-major, from the top.
#[derive(Debug, Clone, Copy)]
pub struct Layers<'a> {
    /// Width and height, pixels.
    pub size: (u32, u32),
    /// Linear radiance.
    pub color: &'a [[f32; 3]],
    /// Colour of surfaces, 0 to 1.
    pub albedo: &'a [[f32; 3]],
    /// Mean unit normals.
    pub normal: &'a [[f32; 3]],
}

/// A denoised image.
#[derive(Debug, Clone)]
pub struct Denoised {
    /// The denoiser and its version.
    pub by: String,
    /// Linear radiance.
    pub color: Vec<[f32; 3]>,
    /// What the program used.
    pub usage: Usage,
}

/// What was learnt by removing the noise of a small image.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Trial {
    /// The denoiser and its version.
    pub by: String,
    /// CPU time that it takes for a pixel, nanoseconds: of the same order for images of all sizes. One of 4
    /// million pixels took a tenth less.
    pub nanos_per_pixel: u64,
}

/// Width and height of the image of a [`Trial`], and the time that it may take.
const SIDE: u32 = 256;
const PATIENCE: Duration = Duration::from_secs(120);

impl Denoiser {
    /// The program that `FORELIGHT_OIDN` names, or `oidnDenoise` in `PATH`.
    ///
    /// # Errors
    /// If there is none, or it is older than version 2.
    pub fn find() -> Result<Self, RendererError> {
        Self::at(std::env::var_os(VARIABLE).map_or_else(|| PROGRAM.into(), PathBuf::from))
    }

    /// The program at `program`, or of this name in `PATH`.
    ///
    /// # Errors
    /// As [`find`](Self::find).
    pub fn at(program: impl Into<PathBuf>) -> Result<Self, RendererError> {
        let program = program.into();
        let not_usable = |reason: String| RendererError::NotInstalled { renderer: NAME.to_owned(), reason };
        let mut has_processor = false;
        // Versions before 2 do not know this option.
        let question = |folder: &Path| program_at(&program, folder).arg("--list_devices");
        ask(question, &[], &mut |line| has_processor |= line.text.contains("Type: CPU")).map_err(|error| {
            not_usable(format!(
                "{error}; install version 2 or later from www.openimagedenoise.org, or name its {PROGRAM} in {VARIABLE}"
            ))
        })?;
        if !has_processor {
            let reason = format!(
                "{} names no processor that it can use: is it {PROGRAM} 2 or later?",
                program.display()
            );
            return Err(not_usable(reason));
        }
        Ok(Self { program })
    }

    /// Tries it out on a small image, in the sandbox if there is one.
    ///
    /// # Errors
    /// As [`denoise`](Self::denoise), and if it takes longer than two minutes.
    pub fn try_out(&self, sandbox: Option<&Sandbox>) -> Result<Trial, RendererError> {
        let place = sandbox.map_or_else(std::env::temp_dir, |sandbox| sandbox.folder().to_owned());
        let folder = TemporaryFolder::new_in(&place).map_err(RendererError::io(place))?;
        let cancelled = AtomicBool::new(false);
        let limits = Limits { threads: 1, time: Some(PATIENCE), ..Limits::default() };
        let to_run = Run { sandbox, ..Run::silent(&cancelled, folder.path(), limits) };
        let grey = vec![[0.5; 3]; (SIDE * SIDE) as usize];
        let layers = Layers { size: (SIDE, SIDE), color: &grey, albedo: &grey, normal: &grey };
        let Denoised { by, usage, .. } = self.denoise(&layers, &to_run)?;
        Ok(Trial { by, nanos_per_pixel: usage.cpu_nanos / u64::from(SIDE * SIDE) })
    }

    /// Removes the noise of an image, on the processor: so the result does not depend on a GPU.
    ///
    /// # Errors
    /// If files cannot be written or read, or the program fails, is stopped or exceeds a limit.
    pub fn denoise(&self, layers: &Layers<'_>, to_run: &Run<'_>) -> Result<Denoised, RendererError> {
        let file = |name: &str| to_run.scratch.join(name);
        let mut program = program_at(&self.program, to_run.scratch).args(["-d", "cpu"]);
        for (option, name, pixels) in [
            ("--hdr", "color.pfm", layers.color),
            ("--alb", "albedo.pfm", layers.albedo),
            ("--nrm", "normal.pfm", layers.normal),
        ] {
            fs::write(file(name), pfm::write(layers.size, pixels)).map_err(RendererError::io(file(name)))?;
            program = program.arg(option).arg(file(name));
        }
        let out = file("denoised.pfm");
        let threads = to_run.limits.threads.max(1).to_string();
        let program = program.arg("-o").arg(&out).args(["--threads", &threads]);
        let mut version = None;
        let finished = run(&program, &[], to_run, &mut |line| {
            version = version.take().or_else(|| version_in(&line.text))
        })?;
        let color = fs::read(&out).and_then(|bytes| pfm::read(&bytes, layers.size));
        let color = color.map_err(RendererError::io(&out))?;
        if !color.iter().flatten().all(|value| value.is_finite()) {
            let reason = Error::new(ErrorKind::InvalidData, "its values are not finite");
            return Err(RendererError::io(&out)(reason));
        }
        let by = version.map_or_else(|| NAME.to_owned(), |version| format!("{NAME} {version}"));
        Ok(Denoised { by, color, usage: finished.usage })
    }
}

/// Libraries of programs that are installed by hand are often found by a variable.
fn program_at(path: &Path, folder: &Path) -> Program {
    Program::new(path, folder).pass_on("LD_LIBRARY_PATH")
}

/// The version in a line such as `device=CPU, version=2.5.1, msec=5.8`.
fn version_in(line: &str) -> Option<String> {
    let (_, after) = line.split_once("version=")?;
    let version: String = after.chars().take_while(|c| c.is_ascii_digit() || *c == '.').take(20).collect();
    (!version.is_empty()).then_some(version)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_version_is_found_in_what_the_program_says() {
        assert_eq!(version_in("  device=CPU, version=2.5.1, msec=5.8").as_deref(), Some("2.5.1"));
        assert_eq!(version_in("Resolution: 320x180"), None);
        assert_eq!(version_in("version="), None);
    }

    #[test]
    fn a_machine_without_the_program_is_told_what_to_install() {
        let error = Denoiser::at("/nowhere/oidnDenoise").unwrap_err().to_string();
        assert!(error.contains(NAME) && error.contains("www.openimagedenoise.org"), "{error}");
    }
}

//! Finds ffmpeg, and encodes pictures with it.

use forelight_protocol::{FrameRate, VIDEO_BYTES};
use forelight_renderer::door::{RendererError, Run};
use forelight_renderer::picture_name;
use forelight_renderer::process::{Program, Usage, ask, run};
use parking_lot::Mutex;
use std::path::{Path, PathBuf};

/// Variable with the path of ffmpeg.
const VARIABLE: &str = "FORELIGHT_FFMPEG";

/// The encoder of H.264 that ffmpeg must have.
const CODEC: &str = "libx264";

/// Constant rate factor of the encoder: 18 can hardly be told from the pictures
/// (<https://trac.ffmpeg.org/wiki/Encode/H.264>).
const QUALITY: &str = "18";

/// Speed of the encoder. Of 48 noisy frames of 1920 × 1080, one core encoded 1.9 in a second as `medium` and
/// 5.6 as `veryfast`, and the file was no larger.
const SPEED: &str = "veryfast";

/// Largest rate of a video in bits per second. Noise of renders hardly compresses, and players read no
/// faster.
const MOST_BITS: f64 = 60e6;

/// Share of the largest size of a video that its rate may fill. The rest is for the container.
const FILLED: f64 = 0.9;

/// Lines of ffmpeg in the message of an error.
const LAST_LINES: usize = 6;

/// Name of the video in its folder.
const VIDEO: &str = "video.mp4";

/// ffmpeg on this machine.
#[derive(Debug, Clone)]
pub struct Encoder {
    program: PathBuf,
    version: String,
}

/// An encoded video.
#[derive(Debug, Clone)]
pub struct Encoded {
    /// The file, in the run's folder.
    pub path: PathBuf,
    /// What ffmpeg used.
    pub usage: Usage,
}

impl Encoder {
    /// The ffmpeg that `FORELIGHT_FFMPEG` names, or that is found in `PATH`.
    ///
    /// # Errors
    /// If there is none, or it cannot encode H.264.
    pub fn find() -> Result<Self, RendererError> {
        Self::at(std::env::var_os(VARIABLE).map_or_else(|| "ffmpeg".into(), PathBuf::from))
    }

    /// The ffmpeg at `program`, or of this name in `PATH`.
    ///
    /// # Errors
    /// As [`find`](Self::find).
    pub fn at(program: impl Into<PathBuf>) -> Result<Self, RendererError> {
        let program = program.into();
        let mut version = None;
        said_by(&program, "-version", &mut |line| {
            version = version.take().or_else(|| version_in(line));
        })?;
        let version = version.ok_or_else(|| {
            not_usable(format!("{} does not say its version: set {VARIABLE}", program.display()))
        })?;
        let mut has_codec = false;
        said_by(&program, "-encoders", &mut |line| {
            has_codec |= line.split_whitespace().nth(1) == Some(CODEC);
        })?;
        if !has_codec {
            return Err(not_usable(format!("{} has no {CODEC}: install one that has", program.display())));
        }
        Ok(Self { program, version })
    }

    /// Its version, as it states it: at most 50 characters.
    pub fn version(&self) -> &str {
        &self.version
    }

    /// Encodes `count` pictures of a folder, named as [`picture_name`] says, all of one size. Odd
    /// sizes get a black row or column more, because H.264 stores colours of two by two pixels.
    ///
    /// # Errors
    /// If a picture is missing or cannot be read, or ffmpeg fails, is stopped or exceeds a limit.
    pub fn encode(
        &self,
        (pictures, count): (&Path, usize),
        rate: FrameRate,
        to_run: &Run<'_>,
    ) -> Result<Encoded, RendererError> {
        if let Some(missing) =
            (0..count).map(|place| pictures.join(picture_name(place))).find(|path| !path.is_file())
        {
            return Err(RendererError::MissingFile(missing.display().to_string()));
        }
        let path = to_run.scratch.join(VIDEO);
        let bits = most_bits(count, rate);
        let program = Program::new(&self.program, to_run.scratch)
            .args(["-hide_banner", "-nostdin", "-loglevel", "warning", "-nostats", "-progress", "pipe:1"])
            .args(["-xerror", "-f", "image2", "-framerate", &exact(rate), "-start_number", "0", "-i"])
            .arg(pictures.join("%06d.png"))
            .args(["-frames:v", &count.to_string()])
            .args([
                "-vf",
                "pad=ceil(iw/2)*2:ceil(ih/2)*2,scale=out_color_matrix=bt709:out_range=tv:\
                 flags=bicubic+accurate_rnd+bitexact,format=yuv420p",
            ])
            .args(["-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "iec61966-2-1"])
            .args(["-c:v", CODEC, "-preset", SPEED, "-crf", QUALITY, "-threads", "1"])
            .args(["-x264-params", "cpu-independent=1"])
            .args(["-maxrate", &bits.to_string(), "-bufsize", &(2 * bits).to_string()])
            .args(["-map_metadata", "-1", "-fflags", "+bitexact", "-flags:v", "+bitexact"])
            .args(["-movflags", "+faststart", "-y"])
            .arg(&path);
        // Its figures are progress, not log.
        let said = Mutex::new(Vec::new());
        let log = |line: &str| {
            if figure(line).is_none() {
                (to_run.log)(line);
                said.lock().push(line.to_owned());
            }
        };
        let quiet = Run { log: &log, ..*to_run };
        let finished = run(&program, &[], &quiet, &mut |line| {
            if let Some(("frame", done)) = figure(&line.text)
                && let Ok(done) = done.parse::<f64>()
            {
                (to_run.progress)(done / count as f64);
            }
        });
        let finished = finished.map_err(|error| match error {
            RendererError::Ended { program, ending, .. } => {
                let last_lines = said.into_inner().into_iter().rev().take(LAST_LINES).rev().collect();
                RendererError::Ended { program, ending, last_lines }
            }
            error => error,
        })?;
        Ok(Encoded { path, usage: finished.usage })
    }
}

/// The rate as ffmpeg reads it. The rates of television are fractions, which their usual three digits stand
/// for.
fn exact(rate: FrameRate) -> String {
    match rate.thousandths() {
        23_976 => "24000/1001".to_owned(),
        29_970 => "30000/1001".to_owned(),
        59_940 => "60000/1001".to_owned(),
        119_880 => "120000/1001".to_owned(),
        thousandths => format!("{thousandths}/1000"),
    }
}

/// Largest rate of so many frames in bits per second, by which their video is not too large.
fn most_bits(count: usize, rate: FrameRate) -> u64 {
    let seconds = count as f64 / f64::from(rate);
    MOST_BITS.min(FILLED * 8.0 * VIDEO_BYTES as f64 / seconds) as u64
}

/// Name and value of a figure in the output of `-progress`.
fn figure(line: &str) -> Option<(&str, &str)> {
    let (name, value) = line.split_once('=')?;
    let is_name = !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    is_name.then_some((name, value.trim()))
}

fn version_in(line: &str) -> Option<String> {
    let version = line.strip_prefix("ffmpeg version ")?.split_whitespace().next()?;
    Some(version.chars().take(50).collect())
}

fn said_by(program: &Path, option: &str, on_line: &mut dyn FnMut(&str)) -> Result<(), RendererError> {
    let question = |folder: &Path| Program::new(program, folder).args(["-hide_banner", option]);
    match ask(question, &[], &mut |line| on_line(&line.text)) {
        Ok(_) => Ok(()),
        Err(error) => Err(not_usable(format!("{error}; install ffmpeg, or name it in {VARIABLE}"))),
    }
}

fn not_usable(reason: String) -> RendererError {
    RendererError::NotInstalled { renderer: "ffmpeg".to_owned(), reason }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_told_from_messages() {
        assert_eq!(figure("frame=12"), Some(("frame", "12")));
        assert_eq!(figure("bitrate=N/A"), Some(("bitrate", "N/A")));
        assert_eq!(figure("[image2 @ 0x55] size = 7"), None);
        assert_eq!(figure("no figure"), None);
    }

    #[test]
    fn versions_are_the_word_after_the_name() {
        let line = "ffmpeg version 5.1.9-0+deb12u1 Copyright (c) 2000-2026 the FFmpeg developers";
        assert_eq!(version_in(line).as_deref(), Some("5.1.9-0+deb12u1"));
        assert_eq!(version_in("built with gcc 12"), None);
    }

    #[test]
    fn long_videos_have_fewer_bits_each_second() {
        let film = FrameRate::FILM;
        assert_eq!(most_bits(240, film), 60_000_000);
        let of_longest = most_bits(20_000, film);
        assert!((9_000_000..10_000_000).contains(&of_longest), "{of_longest}");
        let buffer = 2 * of_longest;
        assert!((of_longest as f64 * 20_000.0 / 24.0 + buffer as f64) / 8.0 < VIDEO_BYTES as f64);
    }

    #[test]
    fn rates_of_television_are_fractions() {
        for (rate, exactly) in [("24", "24000/1000"), ("23.976", "24000/1001"), ("12.5", "12500/1000")] {
            assert_eq!(exact(rate.parse().unwrap()), exactly);
        }
    }
}

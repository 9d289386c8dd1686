//! Flags that several commands share.

use crate::failure::BadInput;
use crate::quantities;
use clap::{Args, ValueEnum};
use forelight_protocol::{CacheMode, Integrator, MaterialMode};

/// Image size and quality of light transport.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Image and quality")]
pub struct QualityOptions {
    /// Image width in pixels [default: the camera's, or what keeps its aspect ratio with --height]
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..=65_536))]
    pub width: Option<u32>,
    /// Image height in pixels [default: the camera's, or what keeps its aspect ratio with --width]
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..=65_536))]
    pub height: Option<u32>,
    /// Camera samples per pixel, 1 to 65536 [default: 16; with another renderer, the scene's]
    #[arg(long, value_name = "SAMPLES")]
    pub spp: Option<u32>,
    /// Method of light transport [default: ambient]
    #[arg(long, value_name = "NAME")]
    pub integrator: Option<Integrator>,
    /// Diffuse bounces of indirect light, 0 to 8. 0 is direct light only. With the path integrator: how often a path
    /// may split after its first time [default: 2]
    #[arg(long, value_name = "BOUNCES")]
    pub ambient_bounces: Option<u32>,
    /// Rays of one indirect gather, without a cache, 1 to 65536 [default: 16]
    #[arg(long, value_name = "RAYS")]
    pub ambient_divisions: Option<u32>,
    /// Longest chain of mirror and glass hits, 1 to 64 [default: 12]
    #[arg(long, value_name = "HITS")]
    pub max_depth: Option<u32>,
    /// Irradiance cache: gather indirect light at a few places, and interpolate between them [default: off]
    #[arg(long, value_name = "MODE")]
    pub cache: Option<CacheMode>,
    /// Error of the irradiance cache, 0.01 to 1 in steps of 0.001. A record is valid up to this share of the
    /// mean distance to its surroundings. Above 0.3 the closest records also lie farther apart [default: 0.2]
    #[arg(long, value_name = "ERROR", value_parser = accuracy)]
    pub cache_accuracy: Option<u32>,
    /// Rays of each record of the cache, at least 48, and about a quarter of them for each further bounce.
    /// Rounded to the nearest of 48, 192, 432, 768, 1200, ... [default: 768]
    #[arg(long, value_name = "RAYS")]
    pub cache_rays: Option<u32>,
    /// The scene's materials, or every surface as Lambert with its base colour [default: full]
    #[arg(long, value_name = "KIND")]
    pub materials: Option<MaterialMode>,
    /// Seed of all random numbers. The same seed gives the same bits [default: 0; with another
    /// renderer, the scene's]
    #[arg(long, value_name = "NUMBER")]
    pub seed: Option<u64>,
}

impl QualityOptions {
    /// Checks that options of a cache come with a cache.
    pub fn check(&self) -> Result<(), BadInput> {
        let of_cache = [("cache-accuracy", self.cache_accuracy), ("cache-rays", self.cache_rays)];
        match of_cache.into_iter().find(|(_, value)| value.is_some()) {
            Some((name, _)) if self.cache.is_none() => {
                Err(BadInput::new(format!("--{name}: there is no irradiance cache")).hint("add --cache on"))
            }
            _ => Ok(()),
        }
    }

    /// The same options with an irradiance cache.
    ///
    /// # Errors
    /// If they exclude one.
    pub fn cached(&self) -> Result<Self, BadInput> {
        if self.cache == Some(CacheMode::Off) {
            return Err(BadInput::new("--cache off: this command needs an irradiance cache"));
        }
        if self.integrator == Some(Integrator::Path) {
            return Err(BadInput::new("--integrator path: it does not use an irradiance cache"));
        }
        Ok(Self { cache: Some(CacheMode::On), ..self.clone() })
    }
}

/// Resources of this machine.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "This machine")]
pub struct MachineOptions {
    /// Threads that trace light [default: one per core]
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Device that renders ID previews
    #[arg(long, value_name = "WHO", default_value = "auto")]
    pub preview: PreviewBackend,
    /// Whether to keep loaded scenes and acceleration structures in the user's cache folder, so that later
    /// commands start sooner. Results are the same
    #[arg(long, value_name = "MODE", default_value = "on")]
    pub keep: Keep,
}

impl Default for MachineOptions {
    /// As without flags.
    fn default() -> Self {
        Self { threads: None, preview: PreviewBackend::Auto, keep: Keep::On }
    }
}

/// Whether loaded scenes are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Keep {
    /// Keep large scenes, up to 4 GiB together.
    On,
    /// Keep nothing, and use nothing that was kept.
    Off,
}

/// The device that renders ID previews.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PreviewBackend {
    /// The GPU if there is one, otherwise the CPU.
    Auto,
    /// The GPU, or an error.
    Gpu,
    /// The CPU.
    Cpu,
}

/// Parses a duration flag.
pub fn duration(text: &str) -> Result<std::time::Duration, String> {
    quantities::parse_duration(text)?.try_into().map_err(|_| "the duration is too long".to_string())
}

/// A number above 0.
pub fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("expected a number above 0".into()),
    }
}

/// Parses the accuracy of a cache, in thousandths.
fn accuracy(text: &str) -> Result<u32, String> {
    let value: f64 = text.parse().map_err(|_| "expected a number such as 0.2".to_string())?;
    let thousandths = (value * 1000.0).round();
    match value {
        0.01..=1.0 if (value * 1000.0 - thousandths).abs() < 1e-6 => Ok(thousandths as u32),
        0.01..=1.0 => Err("must be a multiple of 0.001".into()),
        _ => Err("must be from 0.01 to 1".into()),
    }
}

/// The arguments of a command from its flags, for tests.
pub fn parsed<A: clap::Args>(words: impl IntoIterator<Item = impl Into<std::ffi::OsString> + Clone>) -> A {
    #[derive(clap::Parser)]
    struct Command<A: clap::Args> {
        #[command(flatten)]
        args: A,
    }
    <Command<A> as clap::Parser>::parse_from(words).args
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_said_of_a_cache_needs_one_and_what_needs_one_has_it() {
        let quality = |words: &str| parsed::<QualityOptions>(format!("q {words}").split_whitespace());
        for (words, flag) in
            [("--cache-rays 192", "--cache-rays"), ("--cache-accuracy 0.3", "--cache-accuracy")]
        {
            assert!(quality(words).check().unwrap_err().to_string().contains(flag), "{words}");
            let cached = quality(words).cached().unwrap();
            assert!(cached.check().is_ok() && cached.cache == Some(CacheMode::On), "{words}");
        }
        for words in ["", "--cache on --cache-rays 192", "--cache off --cache-rays 192"] {
            assert!(quality(words).check().is_ok(), "{words}");
        }
        for (words, flag) in [("--cache off", "--cache off"), ("--integrator path", "--integrator path")] {
            assert!(quality(words).cached().unwrap_err().to_string().contains(flag), "{words}");
        }
    }
}

//! Flags that several commands share.

use crate::failure::BadInput;
use crate::quantities;
use clap::{Args, ValueEnum};
use forelight_protocol::{CacheMode, Integrator, MaterialMode};

/// Image size and quality of light transport.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Image and quality")]
pub struct QualityOptions {
    /// Image width in pixels [default: the camera's, or what keeps its shape to --height]
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..=65_536))]
    pub width: Option<u32>,
    /// Image height in pixels [default: the camera's, or what keeps its shape to --width]
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..=65_536))]
    pub height: Option<u32>,
    /// Camera samples per pixel
    #[arg(long, value_name = "SAMPLES")]
    pub spp: Option<u32>,
    /// How light is simulated [default: ambient]
    #[arg(long, value_name = "NAME")]
    pub integrator: Option<Integrator>,
    /// Diffuse bounces of indirect light, 0 to 8; 0 is direct light only. With a cache at most 2. With the path integrator, how often
    /// a path may be spread after the first time
    #[arg(long, value_name = "BOUNCES")]
    pub ambient_bounces: Option<u32>,
    /// Rays of one indirect gather, without a cache [default: 16]
    #[arg(long, value_name = "RAYS")]
    pub ambient_divisions: Option<u32>,
    /// Longest chain of mirror and glass hits, 1 to 64
    #[arg(long, value_name = "HITS")]
    pub max_depth: Option<u32>,
    /// Irradiance cache: gather indirect light at few places, and interpolate between them [default: off]
    #[arg(long, value_name = "MODE")]
    pub cache: Option<CacheMode>,
    /// Error that the cache may make, 0.01 to 1 in steps of 0.001: a gathered place serves up to this share of the mean distance to its
    /// surroundings; beyond 0.3 the closest places also lie farther apart [default: 0.2]
    #[arg(long, value_name = "ERROR", value_parser = accuracy)]
    pub cache_accuracy: Option<u32>,
    /// Rays gathered at a place of the cache, about a quarter of them for each further bounce, at least 48; the nearest of 48, 192, 432, 768, 1200, ... is
    /// taken [default: 768]
    #[arg(long, value_name = "RAYS")]
    pub cache_rays: Option<u32>,
    /// Materials as they are, or every surface as Lambert of its base colour
    #[arg(long, value_name = "KIND")]
    pub materials: Option<MaterialMode>,
    /// Seed of all random numbers: the same seed gives the same bits
    #[arg(long, value_name = "NUMBER")]
    pub seed: Option<u64>,
}

impl QualityOptions {
    /// Whether what is said of a cache is said of one.
    pub fn check(&self) -> Result<(), BadInput> {
        let of_cache = [("cache-accuracy", self.cache_accuracy), ("cache-rays", self.cache_rays)];
        match of_cache.into_iter().find(|(_, value)| value.is_some()) {
            Some((name, _)) if self.cache.is_none() => {
                Err(BadInput::new(format!("--{name}: there is no irradiance cache")).hint("add --cache on"))
            }
            _ => Ok(()),
        }
    }

    /// The same with an irradiance cache, whether or not that was said.
    pub fn cached(&self) -> Result<Self, BadInput> {
        if self.cache == Some(CacheMode::Off) {
            return Err(BadInput::new("--cache off: here an irradiance cache is used"));
        }
        if self.integrator == Some(Integrator::Path) {
            return Err(BadInput::new("--integrator path: it has no use for an irradiance cache"));
        }
        Ok(Self { cache: Some(CacheMode::On), ..self.clone() })
    }
}

/// How this machine does the work.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "This machine")]
pub struct MachineOptions {
    /// Threads that trace light [default: one per core]
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Who makes the ID preview
    #[arg(long, value_name = "WHO", default_value = "auto")]
    pub preview: PreviewBackend,
}

/// Who makes ID previews.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PreviewBackend {
    /// The GPU where there is one, otherwise the CPU.
    Auto,
    /// The GPU, or an error.
    Gpu,
    /// The CPU.
    Cpu,
}

/// A duration flag as the standard library's type.
pub fn duration(text: &str) -> Result<std::time::Duration, String> {
    quantities::parse_duration(text)?.try_into().map_err(|_| "the duration is too long".to_string())
}

/// A number above 0.
pub fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("a number above 0 is wanted".into()),
    }
}

/// The accuracy of a cache in thousandths, as the wire has it.
fn accuracy(text: &str) -> Result<u32, String> {
    let value: f64 = text.parse().map_err(|_| "expected a number such as 0.2".to_string())?;
    let thousandths = (value * 1000.0).round();
    match value {
        0.01..=1.0 if (value * 1000.0 - thousandths).abs() < 1e-6 => Ok(thousandths as u32),
        0.01..=1.0 => Err("is in steps of 0.001".into()),
        _ => Err("must lie in 0.01 to 1".into()),
    }
}

/// The arguments of a command as its flags make them: what its tests run it with.
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

//! Parses settings of a render from a line of flags, and lists the default ladder.

use clap::Parser;
use forelight_protocol::{CacheMode, Integrator, RenderSettings};
use forelight_terminal::failure::BadInput;
use forelight_terminal::local::settings_request;
use forelight_terminal::options::QualityOptions;
use forelight_terminal::options::positive;
use forelight_tracer::Settings;
use std::fmt;
use std::str::FromStr;

#[derive(Debug, Clone, Parser)]
#[command(no_binary_name = true, disable_help_flag = true)]
struct Flags {
    #[command(flatten)]
    quality: QualityOptions,
    #[arg(long, conflicts_with = "spp", value_parser = positive)]
    error: Option<f64>,
    #[arg(long, conflicts_with = "error")]
    denoise: bool,
}

/// One rung: its flags and their settings.
#[derive(Debug, Clone)]
pub struct Quality {
    text: String,
    options: QualityOptions,
    /// Noise to allot camera samples for, in percent of the image's mean.
    error: Option<f64>,
    denoise: bool,
}

impl FromStr for Quality {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let words: Vec<&str> = text.split_whitespace().collect();
        let flags = Flags::try_parse_from(&words).map_err(|error| {
            let lines = error.to_string();
            let first = lines.lines().next().unwrap_or_default();
            format!("`{text}`: {}", first.trim_start_matches("error: "))
        })?;
        if flags.quality.width.is_some() || flags.quality.height.is_some() {
            return Err(format!("`{text}`: all images have the same size; use --size"));
        }
        Ok(Self { text: words.join(" "), options: flags.quality, error: flags.error, denoise: flags.denoise })
    }
}

impl fmt::Display for Quality {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl Quality {
    /// True if indirect light is interpolated.
    pub fn is_cached(&self) -> bool {
        self.options.cache == Some(CacheMode::On)
    }

    /// True if it has this many camera samples and gathers or interpolates indirect light. Two such rungs
    /// differ only in the indirect light.
    pub fn samples_like(&self, spp: u32) -> bool {
        self.error.is_none()
            && !self.denoise
            && self.options.spp == Some(spp)
            && self.options.integrator != Some(Integrator::Path)
    }

    /// Noise to allot camera samples for, as a share of the image's mean. `None` for the same number in all
    /// pixels.
    pub fn error(&self) -> Option<f64> {
        self.error.map(|percent| percent / 100.0)
    }

    /// True if the noise of the image is removed.
    pub fn is_denoised(&self) -> bool {
        self.denoise
    }

    /// Settings with gathers of `rays` rays at the same camera samples.
    pub fn gathered(spp: u32, rays: u32) -> Result<Self, String> {
        format!("--spp {spp} --ambient-divisions {rays}").parse()
    }

    pub fn settings(&self, base: &RenderSettings) -> Result<Settings, BadInput> {
        Ok(Settings::from(&self.asked(base)?))
    }

    /// The full settings. Flags that are missing are as in `base`.
    pub fn asked(&self, base: &RenderSettings) -> Result<RenderSettings, BadInput> {
        let size = (base.width, base.height);
        self.options.check()?;
        let mut settings = settings_request(&self.options, size).complete(size);
        if self.options.ambient_bounces.is_none() {
            settings.ambient_bounces = base.ambient_bounces;
        }
        if self.options.materials.is_none() {
            settings.materials = base.materials;
        }
        if self.options.seed.is_none() {
            settings.seed = base.seed;
        }
        settings.check().map_err(|wrong| BadInput::new(format!("`{self}`: {wrong}")))?;
        Ok(settings)
    }
}

/// The default rungs from quick to good, without a cache and with one.
pub fn ladder() -> Vec<Quality> {
    let gathered = [(1, 4), (1, 16), (4, 4), (4, 16), (4, 64), (4, 256), (16, 4), (16, 16)];
    let cached = [
        (1, "0.4", 192),
        (1, "0.3", 192),
        (4, "0.4", 192),
        (4, "0.4", 768),
        (4, "0.3", 768),
        (4, "0.2", 768),
        (4, "0.1", 1728),
        (16, "0.3", 768),
        (16, "0.2", 768),
        (64, "0.2", 768),
        (64, "0.1", 1728),
    ];
    let gathered =
        gathered.iter().map(|(spp, divisions)| format!("--spp {spp} --ambient-divisions {divisions}"));
    let cached = cached.iter().map(|(spp, accuracy, rays)| {
        format!("--spp {spp} --cache on --cache-accuracy {accuracy} --cache-rays {rays}")
    });
    let allotted = [
        ("8", "0.6", 48),
        ("8", "0.3", 192),
        ("4", "0.6", 48),
        ("4", "0.3", 192),
        ("2", "0.2", 768),
        ("1", "0.2", 768),
    ];
    let allotted = allotted.iter().map(|(error, accuracy, rays)| {
        format!("--error {error} --cache on --cache-accuracy {accuracy} --cache-rays {rays}")
    });
    // The lines are constant, and a test parses them all.
    gathered.chain(cached).chain(allotted).filter_map(|line| line.parse().ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_protocol::{MaterialMode, RenderSettingsRequest};

    fn base() -> RenderSettings {
        let size = (64, 64);
        let base = RenderSettingsRequest::default().complete(size);
        RenderSettings { ambient_bounces: 1, materials: MaterialMode::Lambert, seed: 9, ..base }
    }

    #[test]
    fn a_rung_is_flags_and_size_bounces_materials_and_seed_are_those_of_all() {
        let rung: Quality = "--spp  3 --cache on --cache-accuracy 0.15".parse().unwrap();
        let settings = rung.settings(&base()).unwrap();
        assert_eq!((settings.width, settings.spp, settings.seed), (64, 3, 9));
        assert_eq!((settings.ambient_bounces, settings.materials), (1, MaterialMode::Lambert));
        assert_eq!(settings.cache.unwrap().accuracy, 150);
        assert_eq!(rung.to_string(), "--spp 3 --cache on --cache-accuracy 0.15");
        let other: Quality = "--ambient-bounces 2 --seed 1".parse().unwrap();
        let settings = other.settings(&base()).unwrap();
        assert_eq!((settings.ambient_bounces, settings.seed), (2, 1));
    }

    #[test]
    fn only_what_sees_the_same_direct_light_is_compared() {
        let like = |text: &str| text.parse::<Quality>().unwrap().samples_like(4);
        assert!(like("--spp 4 --cache on") && like("--spp 4 --ambient-divisions 9"));
        assert!(
            !like("--error 2 --cache on")
                && !like("--spp 4 --denoise")
                && !like("--spp 5")
                && !like("--spp 4 --integrator path")
                && !like("--cache on")
        );
    }

    #[test]
    fn a_wrong_flag_or_value_is_named() {
        let unknown = "--sp 3".parse::<Quality>().unwrap_err();
        assert!(unknown.starts_with("`--sp 3`: ") && unknown.contains("--sp"), "{unknown}");
        assert!("--width 3".parse::<Quality>().unwrap_err().contains("--size"));
        let wild: Quality = "--spp 0".parse().unwrap();
        let message = wild.settings(&base()).unwrap_err().to_string();
        assert!(message.contains("`--spp 0`") && message.contains("spp"), "{message}");
    }

    #[test]
    fn every_rung_of_the_default_ladder_is_valid_and_there_are_both_kinds() {
        let rungs = ladder();
        assert_eq!(rungs.len(), 25);
        assert!(rungs.iter().all(|rung| rung.settings(&base()).is_ok()));
        assert_eq!(rungs.iter().filter(|rung| rung.is_cached()).count(), 17);
    }
}

//! The origin of a file: the frame and the settings that it was made for. Errors list which settings differ.

use crate::Settings;
use crate::fingerprint::tracer_version;
use blake3::Hasher;
use bytemuck::{Pod, Zeroable};
use forelight_protocol::{Integrator, MaterialMode};
use forelight_scene::Frame;

/// Settings that only affect the view. The records of an irradiance cache do not depend on them.
const VIEW: [&str; 4] = ["width", "height", "spp", "ambient_divisions"];

/// Settings that affect the light, except the seed.
const LIGHT: [&str; 7] =
    ["integrator", "ambient_bounces", "max_depth", "materials", "cache", "cache_accuracy", "cache_rays"];

/// The frame and settings that a profile or cache was made for. For error messages only; fingerprints decide.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Pod, Zeroable)]
pub struct Origin {
    /// Hash of geometry, textures, materials and lights.
    content: [u8; 32],
    seed: u64,
    version: u32,
    frame: u32,
    view: [u32; VIEW.len()],
    light: [u32; LIGHT.len()],
    zero: u32,
}

impl Origin {
    /// Size in a file, in bytes. Numbers are little-endian.
    pub(crate) const BYTES: usize = size_of::<Self>();

    /// The origin for a frame. `content` is the frame's [`crate::fingerprint::of_content`].
    pub(crate) fn of(content: &Hasher, frame: &Frame, settings: &Settings) -> Self {
        let cache = settings.cache.unwrap_or_default();
        let integrator = match settings.integrator {
            Integrator::Ambient => 0,
            Integrator::Path => 1,
        };
        let materials = match settings.materials {
            MaterialMode::Full => 0,
            MaterialMode::Lambert => 1,
        };
        let Settings { ambient_bounces, max_depth, .. } = *settings;
        let cached = u32::from(settings.cache.is_some());
        Self {
            content: *content.finalize().as_bytes(),
            seed: settings.seed,
            version: tracer_version(),
            frame: frame.number,
            view: [settings.width, settings.height, settings.spp, settings.ambient_divisions],
            light: [integrator, ambient_bounces, max_depth, materials, cached, cache.accuracy, cache.rays],
            zero: 0,
        }
    }

    /// Number of the frame.
    pub fn frame(&self) -> u32 {
        self.frame
    }

    /// The differences between this origin and an image that the file does not fit, in words.
    pub fn unlike_image(&self, image: &Self) -> String {
        let mut words = self.other_frame(image, true);
        words.extend(self.view.iter().zip(image.view).zip(VIEW).filter_map(difference));
        words.extend(self.other_light(image));
        joined_or(words, "different camera, or different sample counts by pixel")
    }

    /// The differences between this origin and a frame in which its cache records are not valid, in words.
    pub(crate) fn unlike_light(&self, frame: &Self) -> String {
        let mut words = self.other_frame(frame, false);
        words.extend(self.other_light(frame));
        joined_or(words, "different lights reach the visible surfaces")
    }

    fn other_frame(&self, other: &Self, always: bool) -> Vec<String> {
        if self.version != other.version {
            return vec![format!("version {} of the tracer, not {}", self.version, other.version)];
        }
        let same = self.content == other.content;
        match self.frame == other.frame {
            false if always || !same => vec![format!("frame {}, not {}", self.frame, other.frame)],
            true if !same => vec!["different scene".to_owned()],
            _ => Vec::new(),
        }
    }

    fn other_light(&self, other: &Self) -> Vec<String> {
        let settings = self.light.iter().zip(other.light).zip(LIGHT).filter_map(difference);
        let seed = || format!("seed {}, not {}", self.seed, other.seed);
        settings.chain((self.seed != other.seed).then(seed)).collect()
    }
}

fn difference(((own, other), name): ((&u32, u32), &str)) -> Option<String> {
    (*own != other).then(|| format!("{name} {}, not {}", shown(name, *own), shown(name, other)))
}

/// A setting's value, as the user enters it.
fn shown(name: &str, value: u32) -> String {
    let of = |words: [&str; 2]| {
        words.get(value as usize).map_or_else(|| value.to_string(), |word| (*word).to_owned())
    };
    match name {
        "integrator" => of(["ambient", "path"]),
        "materials" => of(["full", "lambert"]),
        "cache" => of(["off", "on"]),
        "cache_accuracy" => (f64::from(value) / 1000.0).to_string(),
        _ => value.to_string(),
    }
}

fn joined_or(words: Vec<String>, unknown: &str) -> String {
    if words.is_empty() { unknown.to_owned() } else { words.join("; ") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_another_is_named_and_what_makes_no_difference_is_not() {
        let own = Origin {
            version: 3,
            frame: 7,
            view: [64, 36, 4, 32],
            light: [0, 1, 12, 0, 1, 200, 768],
            ..Origin::default()
        };
        let of = |change: &dyn Fn(&mut Origin)| {
            let mut other = own;
            change(&mut other);
            (own.unlike_image(&other), own.unlike_light(&other))
        };
        let (image, light) = of(&|other| (other.view[2], other.light[5], other.seed) = (16, 350, 9));
        assert_eq!(image, "spp 4, not 16; cache_accuracy 0.2, not 0.35; seed 0, not 9");
        assert_eq!(light, "cache_accuracy 0.2, not 0.35; seed 0, not 9");
        let (image, light) = of(&|other| (other.frame, other.light[0]) = (8, 1));
        assert_eq!(
            (&*image, &*light),
            ("frame 7, not 8; integrator ambient, not path", "integrator ambient, not path")
        );
        // If something moves, another frame has another content.
        let (_, light) = of(&|other| (other.frame, other.content) = (8, [1; 32]));
        assert_eq!(light, "frame 7, not 8");
        let (image, light) = of(&|other| other.content = [1; 32]);
        assert_eq!((&*image, &*light), ("different scene", "different scene"));
        // After a version difference, nothing else is reported.
        let (image, _) = of(&|other| (other.version, other.content) = (4, [1; 32]));
        assert_eq!(image, "version 3 of the tracer, not 4");
        let (image, light) = of(&|_| ());
        assert!(image.contains("camera") && light.contains("lights"), "{image} {light}");
        // Values outside the known words can only come from a damaged file.
        assert_eq!(shown("integrator", 9), "9");
    }
}

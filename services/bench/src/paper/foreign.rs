//! The experiment with another renderer that measures single pixels: every pixel of the frame is measured
//! once at every ambient level.

use super::level::{Level, Seen, Truth, cold};
use anyhow::{Context, Result};
use forelight_forecast::{Cost, Stratum};
use forelight_renderer::door::{PixelCost, Run, Settings, Shown};
use forelight_terminal::atomic_file::write_bytes;
use forelight_terminal::failure::{BadInput, Interrupted};
use forelight_terminal::foreign::Foreign;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::output::Bars;
use glam::Vec3;
use image::RgbImage;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Pixels that are measured between two reports of progress.
const AT_A_TIME: usize = 1024;

/// Expected cost of a pixel of the background, relative to others.
const BACKGROUND_COST: f64 = 0.1;

/// Accuracy of the levels with a cache.
const CACHE_ACCURACY: f64 = 0.2;

/// What to measure.
pub struct Measurement<'a> {
    pub foreign: &'a Foreign,
    pub frame: u32,
    pub size: u32,
    pub gather_rays: u32,
    /// File of costs that were measured before, which is used or made.
    pub known: Option<PathBuf>,
}

/// CPU time of a pixel in nanoseconds, and its rays by kind.
type KeptCost = (u64, [u64; 7]);

/// Costs of all pixels at all levels, as they are kept.
#[derive(Serialize, Deserialize)]
struct Kept {
    /// What was measured: another scene, version or quality is measured again.
    of: Value,
    /// Number of what each pixel shows, and those that it numbers.
    ids: Vec<u32>,
    strata: Vec<(u32, u32)>,
    levels: Vec<(Level, Vec<KeptCost>)>,
}

/// Settings of Radiance at a level. Gathers have the same number of rays with and without a cache.
fn own(level: Level, gather_rays: u32) -> Map<String, Value> {
    let accuracy = if level.is_cached() { CACHE_ACCURACY } else { 0.0 };
    let settings = json!({
        "ambient_bounces": level.bounces(),
        "ambient_accuracy": accuracy,
        "ambient_divisions": gather_rays,
        "ambient_super_samples": 0,
    });
    settings.as_object().cloned().unwrap_or_default()
}

impl Measurement<'_> {
    /// Preview and costs of the frame.
    pub fn measure(&self, bars: &Bars, interrupt: &Interrupt) -> Result<(Seen, Vec<Truth>)> {
        let id = self.foreign.renderer.id();
        if id.name != "radiance" {
            let reason = format!("--renderer: {id} does not measure single pixels at the paper's levels");
            return Err(BadInput::new(reason).into());
        }
        let settings = |level| {
            let mut settings = self.foreign.description().settings.clone();
            (settings.common.width, settings.common.height) = (self.size, self.size);
            settings.common.samples = 1;
            settings.with_own(&own(level, self.gather_rays))
        };
        let of = json!({"renderer": id, "frame": self.frame, "settings": Level::ALL.map(settings)});
        let kept = match self.known.as_deref().and_then(|path| read(path, &of)) {
            Some(kept) => kept,
            None => {
                let kept = self.measure_all(of, &settings, bars, interrupt)?;
                if let Some(path) = &self.known {
                    write_bytes(path, &serde_json::to_vec(&kept)?)?;
                }
                kept
            }
        };
        let stratum =
            |&(object, material): &(u32, u32)| Stratum { object, material, prior_cost: 1.0, apart: false };
        let strata = kept.strata.iter().map(stratum).chain([Stratum::background(BACKGROUND_COST)]);
        let seen = Seen {
            strata: strata.collect(),
            positions: vec![Vec3::ZERO; kept.ids.len()],
            picture: picture(&kept, self.size),
            ids: kept.ids,
        };
        let mut truths: Vec<Truth> = Vec::new();
        for (level, costs) in kept.levels {
            let truth = truth(level, &costs, &truths, &seen.picture);
            truths.push(truth);
        }
        Ok((seen, truths))
    }

    fn measure_all(
        &self,
        of: Value,
        settings: &dyn Fn(Level) -> Settings,
        bars: &Bars,
        interrupt: &Interrupt,
    ) -> Result<Kept> {
        let number = i32::try_from(self.frame).context("the frame's number is too large")?;
        let pixels: Vec<u32> = (0..self.size * self.size).collect();
        let bar = bars.bar("measuring", (pixels.len() * Level::ALL.len()) as u64);
        let mut kept = Kept { of, ids: Vec::new(), strata: Vec::new(), levels: Vec::new() };
        for level in Level::ALL {
            let settings = settings(level);
            let run: Run<'_> = self.foreign.run(interrupt);
            let mut profiler = self.foreign.shot.profile_pixels(number, &settings, &run)?;
            if kept.ids.is_empty() {
                (kept.ids, kept.strata) = strata(profiler.shown());
            }
            let mut costs = Vec::with_capacity(pixels.len());
            for pixels in pixels.chunks(AT_A_TIME) {
                if interrupt.is_set() {
                    return Err(Interrupted.into());
                }
                let measured = profiler.measure(pixels)?;
                costs.extend(measured.iter().map(|&PixelCost { cpu_nanos, rays }| (cpu_nanos, rays)));
                bar.inc(pixels.len() as u64);
            }
            if let Some(artefact) = profiler.finish()?.artefact {
                std::fs::remove_file(artefact.path).context("cannot remove a temporary file")?;
            }
            kept.levels.push((level, costs));
        }
        bar.finish_and_clear();
        Ok(kept)
    }
}

/// Costs that were measured of this, if there are any.
fn read(path: &Path, of: &Value) -> Option<Kept> {
    let kept: Kept = serde_json::from_slice(&std::fs::read(path).ok()?).ok()?;
    (kept.of == *of).then_some(kept)
}

/// Number of what each pixel shows, and object and material by that number. The background comes after the
/// last.
fn strata(shown: &[Shown]) -> (Vec<u32>, Vec<(u32, u32)>) {
    let key = |shown: &Shown| shown.object.zip(shown.material);
    let numbers: BTreeMap<(u32, u32), u32> = shown.iter().filter_map(key).map(|key| (key, 0)).collect();
    let numbers: BTreeMap<(u32, u32), u32> = numbers.into_keys().zip(0..).collect();
    let background = u32::try_from(numbers.len()).unwrap_or(u32::MAX);
    let number = |shown: &Shown| key(shown).and_then(|key| numbers.get(&key).copied()).unwrap_or(background);
    (shown.iter().map(number).collect(), numbers.into_keys().collect())
}

fn picture(kept: &Kept, size: u32) -> RgbImage {
    RgbImage::from_fn(size, size, |x, y| {
        let id = kept.ids.get((y * size + x) as usize).copied().unwrap_or(u32::MAX);
        let shown = kept.strata.get(id as usize);
        image::Rgb(shown.map_or([0; 3], |&(object, material)| forelight_pictures::id_color(object, material)))
    })
}

/// Costs of a level. Work is CPU time in microseconds, as in the quotes of renderers that count no work.
fn truth(level: Level, costs: &[KeptCost], before: &[Truth], picture: &RgbImage) -> Truth {
    let cost = |&(cpu_nanos, rays): &KeptCost| Cost { work: cpu_nanos / 1000, cpu_nanos, rays };
    let pixels: Vec<Cost> = costs.iter().map(cost).collect();
    Truth {
        level,
        cold: cold(level, before, 0, &[]).unwrap_or_else(|| pixels.clone()),
        pixels,
        plan: Cost::default(),
        fill: Cost::default(),
        records: Vec::new(),
        seen_records: Vec::new(),
        record_prior_cost: 1.0,
        sampled_records: BTreeMap::new(),
        picture: picture.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_are_numbered_by_what_they_show_and_the_background_comes_last() {
        let shown = |object, material| Shown { object, material };
        let (table, wall) = (shown(Some(7), Some(1)), shown(Some(3), Some(9)));
        let (ids, strata) = strata(&[table, shown(None, None), wall, table]);
        assert_eq!(ids, [1, 2, 0, 1]);
        assert_eq!(strata, [(3, 9), (7, 1)]);
    }

    #[test]
    fn only_costs_of_the_same_thing_are_used_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("costs.json");
        let of = json!({"frame": 1});
        let levels = vec![(Level::NoAmbient, vec![(1500, [1, 2, 0, 0, 0, 0, 0])])];
        let kept = Kept { of: of.clone(), ids: vec![0], strata: vec![(3, 9)], levels };
        write_bytes(&path, &serde_json::to_vec(&kept).unwrap()).unwrap();
        let found = read(&path, &of).unwrap();
        assert_eq!(found.levels, kept.levels);
        assert!(read(&path, &json!({"frame": 2})).is_none());
        assert!(read(&folder.path().join("none"), &of).is_none());
    }

    #[test]
    fn levels_with_a_cache_differ_in_the_accuracy() {
        assert_eq!(own(Level::OneBounce, 48)["ambient_accuracy"], 0.0);
        assert_eq!(own(Level::TwoBouncesCached, 48)["ambient_bounces"], 2);
        assert_eq!(own(Level::OneBounceCached, 48)["ambient_accuracy"], CACHE_ACCURACY);
    }
}

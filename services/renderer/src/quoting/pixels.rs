//! Profiles of single pixels, for renderers that can measure them.

use super::coverage::{grids, ratio};
use super::neighbours::{WARMING_SHARE, free_neighbours, middle_mean, proportional_sites, sites};
use super::previews::{BACKGROUND_COST, name_of, own_number};
use crate::door::{
    Artefact, Capability, PixelCost, PixelProfiler, ProfiledPixels, RendererError, RendererId, Run, Settings,
    Shot, Shown,
};
use crate::files::artifact_name;
use forelight_forecast::{Cost, ForecastError, Observation, Pick, Strategy, Stratum};
use forelight_protocol::{FixedCosts, ProfileArtifacts, ProfileResult, ProfileSample, Spent};
use forelight_quote::stratum_key;
use image::RgbImage;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;

/// A profiled frame.
#[derive(Debug, Clone, PartialEq)]
pub struct PixelProfile {
    /// Its costs. Work is CPU time in microseconds.
    pub result: ProfileResult,
    /// The finished pixels, as `result` names them.
    pub artefact: Artefact,
    /// CPU time of the finished pixels, nanoseconds.
    pub taken_over_nanos: u64,
    /// Object and material of each pixel as a colour, if the renderer made such a picture.
    pub ids: Option<RgbImage>,
    /// What each pixel shows.
    pub(super) strata: Strata,
}

/// Which pixels of a frame are profiled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PixelChoice {
    /// Number of pixels.
    pub samples: u32,
    /// Seed of the choice.
    pub seed: u64,
    /// How they are chosen.
    pub strategy: Strategy,
}

/// Profiles pixels of one frame. Those of the second phase go where the first found cost and variation.
///
/// # Errors
/// If the renderer cannot measure single pixels, fails, or the run is stopped.
pub fn profile_pixels(
    renderer: &RendererId,
    shot: &dyn Shot,
    frame: u32,
    settings: &Settings,
    choice: PixelChoice,
    run: &Run<'_>,
) -> Result<PixelProfile, RendererError> {
    let number = own_number(frame)?;
    let mut profiler = shot.profile_pixels(number, settings, run)?;
    let strata = Strata::of(profiler.shown());
    let (pixels, costs) = if shot.capabilities(settings).contains(&Capability::ShareCache) {
        cover(&mut *profiler, settings, choice.samples, run)?
    } else {
        choose(&mut *profiler, &strata, (settings, frame), choice, run)?
    };
    let ProfiledPixels { cost, fixed, artefact, finished_nanos, ids } = profiler.finish()?;
    let artefact = artefact
        .ok_or_else(|| RendererError::Answer("the renderer kept none of the profiled pixels".to_owned()))?;
    let bytes = fs::read(&artefact.path).map_err(RendererError::io(&artefact.path))?;
    let (shown, samples) = strata.samples(&pixels, &costs);
    let result = ProfileResult {
        frame,
        strata: shown.into_iter().map(|shown| wire_stratum(shot, shown)).collect(),
        samples,
        uncovered: None,
        shared_samples: Vec::new(),
        cache_samples: Vec::new(),
        shared_cache_samples: Vec::new(),
        noise: Vec::new(),
        samples_for_error: None,
        effects: Vec::new(),
        left_out: Vec::new(),
        renderer: Some(renderer.to_string()),
        work_by_class: None,
        fixed: FixedCosts { build: Spent::uncounted(fixed.values().sum()), ..FixedCosts::default() },
        file_bytes: None,
        once: None,
        ladders: None,
        spent: Spent::uncounted(cost.cpu_nanos),
        artifacts: ProfileArtifacts { profile: artifact_name(&bytes), preview_png: None },
    };
    Ok(PixelProfile { result, artefact, taken_over_nanos: finished_nanos, ids, strata })
}

/// Measures pixels by strata, in two phases. Returns pixels and their costs.
fn choose(
    profiler: &mut dyn PixelProfiler,
    strata: &Strata,
    (settings, frame): (&Settings, u32),
    choice: PixelChoice,
    run: &Run<'_>,
) -> Result<(Vec<u32>, Vec<PixelCost>), RendererError> {
    let PixelChoice { samples, seed, strategy } = choice;
    let refused = |error: ForecastError| RendererError::Failed(error.to_string());
    let width = settings.common.width;
    let design = strategy
        .design(&strata.known, &strata.of_pixels, width, samples, seed, i64::from(frame))
        .map_err(refused)?;
    let first = design.first_phase();
    let mut costs = observe(profiler, &first)?;
    (run.progress)(0.5);
    let observations: Vec<Observation> = first.iter().zip(&costs).map(observation).collect();
    let second = design.second_phase(&observations).map_err(refused)?;
    costs.extend(observe(profiler, &second)?);
    let picks: Vec<Pick> = first.into_iter().chain(second).collect();
    measure_neighbours(profiler, settings, (&picks, design.counts()), &mut costs)?;
    Ok((picks.iter().map(|pick| pick.pixel).collect(), costs))
}

/// Measures pixels from a coarse grid to finer ones. Returns pixels, and the costs that they stand for.
fn cover(
    profiler: &mut dyn PixelProfiler,
    settings: &Settings,
    samples: u32,
    run: &Run<'_>,
) -> Result<(Vec<u32>, Vec<PixelCost>), RendererError> {
    let grids = grids(settings, samples);
    let mut measured = Vec::with_capacity(grids.len());
    for (done, pixels) in grids.iter().enumerate() {
        (run.progress)(done as f64 / grids.len() as f64);
        measured.push(profiler.measure(pixels)?);
    }
    let ratio = ratio(&measured, settings.pixels());
    let costs = measured.iter().flatten().map(|cost| ratio.of(cost)).collect();
    Ok((grids.concat(), costs))
}

fn observe(profiler: &mut dyn PixelProfiler, picks: &[Pick]) -> Result<Vec<PixelCost>, RendererError> {
    if picks.is_empty() {
        return Ok(Vec::new());
    }
    let pixels: Vec<u32> = picks.iter().map(|pick| pick.pixel).collect();
    let costs = profiler.measure(&pixels)?;
    if costs.len() != pixels.len() {
        let reason = format!("costs of {} pixels; {} were asked for", costs.len(), pixels.len());
        return Err(RendererError::Answer(reason));
    }
    Ok(costs)
}

/// Measures blocks of neighbours of some picks, and brings the CPU times of all picks to those of a render.
/// Each block's time per ray is compared with that of the pick amid it. Blocks are drawn in proportion to the
/// time that their pick represents, so the mean of these ratios is that of all pixels. `counts` are the
/// frame's pixels by the picks' strata.
fn measure_neighbours(
    profiler: &mut dyn PixelProfiler,
    settings: &Settings,
    (picks, counts): (&[Pick], &[u32]),
    costs: &mut [PixelCost],
) -> Result<(), RendererError> {
    let rays = |cost: &PixelCost| cost.rays.iter().sum::<u64>() as f64;
    let mut in_stratum = vec![0u32; counts.len()];
    picks.iter().for_each(|pick| in_stratum[pick.stratum as usize] += 1);
    let represented = |(pick, cost): (&Pick, &PixelCost)| {
        let stratum = pick.stratum as usize;
        // Times per ray need rays.
        let known = if rays(cost) > 0.0 { cost.cpu_nanos as f64 } else { 0.0 };
        known * f64::from(counts[stratum]) / f64::from(in_stratum[stratum].max(1))
    };
    let times: Vec<f64> = picks.iter().zip(&*costs).map(represented).collect();
    let mut taken: BTreeSet<u32> = picks.iter().map(|pick| pick.pixel).collect();
    let chosen = proportional_sites(&times, sites(picks.len()));
    let mut runs = Vec::with_capacity(chosen.len());
    for &site in &chosen {
        let run = free_neighbours(picks[site].pixel, settings.common.width, settings.common.height, &taken);
        taken.extend(&run);
        let warming = (run.len() as f64 * WARMING_SHARE).round() as usize;
        runs.push((run, warming));
    }
    let blocks = profiler.measure_runs(&runs)?;
    let ratio = |(&site, block): (&usize, &PixelCost)| {
        let (pick, found) = (rays(&costs[site]), rays(block));
        let scattered = costs[site].cpu_nanos as f64 / pick;
        (found > 0.0).then(|| block.cpu_nanos as f64 / found / scattered)
    };
    let ratio = middle_mean(chosen.iter().zip(&blocks).filter_map(ratio).collect());
    // There may be no blocks.
    if ratio.is_finite() && ratio > 0.0 {
        for cost in costs {
            cost.cpu_nanos = (cost.cpu_nanos as f64 * ratio).round() as u64;
        }
    }
    Ok(())
}

fn observation((pick, cost): (&Pick, &PixelCost)) -> Observation {
    let work = Spent::uncounted(cost.cpu_nanos).work;
    Observation { stratum: pick.stratum, cost: Cost { work, cpu_nanos: cost.cpu_nanos, rays: cost.rays } }
}

/// Strata of a frame, in the order of their numbers.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Strata {
    /// What each shows, without the background.
    shown: Vec<Shown>,
    /// As the forecast has them, the background last.
    known: Vec<Stratum>,
    /// Stratum of each pixel.
    of_pixels: Vec<u32>,
}

impl Strata {
    fn of(pixels: &[Shown]) -> Self {
        let key = |shown: &Shown| stratum_key(shown.object, shown.material);
        let by_key: BTreeMap<(u32, u32), Shown> =
            pixels.iter().filter_map(|shown| Some((key(shown)?, *shown))).collect();
        let places: BTreeMap<(u32, u32), u32> = by_key.keys().copied().zip(0..).collect();
        let background = u32::try_from(by_key.len()).unwrap_or(u32::MAX);
        let place =
            |shown: &Shown| key(shown).and_then(|key| places.get(&key).copied()).unwrap_or(background);
        let stratum =
            |&(object, material): &(u32, u32)| Stratum { object, material, prior_cost: 1.0, apart: false };
        let known = by_key.keys().map(stratum).chain([Stratum::background(BACKGROUND_COST)]).collect();
        Self { of_pixels: pixels.iter().map(place).collect(), shown: by_key.into_values().collect(), known }
    }

    /// What the pixels show, each once, and the pixels with the index of that. The background comes after the
    /// last.
    fn samples(&self, pixels: &[u32], costs: &[PixelCost]) -> (Vec<Shown>, Vec<ProfileSample>) {
        let of = |&pixel: &u32| self.of_pixels[pixel as usize] as usize;
        let seen: BTreeSet<usize> = pixels.iter().map(of).filter(|&at| at < self.shown.len()).collect();
        let seen: Vec<usize> = seen.into_iter().collect();
        let sample = |(pixel, cost): (&u32, &PixelCost)| ProfileSample {
            pixel: *pixel,
            stratum: u32::try_from(seen.binary_search(&of(pixel)).unwrap_or(seen.len())).unwrap_or(u32::MAX),
            work: Spent::uncounted(cost.cpu_nanos).work,
            extra_work: 0,
            work_by_ray: [0; 7],
            cpu_nanos: cost.cpu_nanos,
            rays: cost.rays,
        };
        let samples = pixels.iter().zip(costs).map(sample).collect();
        (seen.iter().map(|&at| self.shown[at]).collect(), samples)
    }

    /// Numbers of object and material of each pixel. `None`: the background.
    pub(super) fn shown(&self) -> impl Iterator<Item = Option<(u32, u32)>> {
        let known = &self.known[..self.shown.len()];
        self.of_pixels.iter().map(|&at| known.get(at as usize).map(|shown| (shown.object, shown.material)))
    }
}

fn wire_stratum(shot: &dyn Shot, shown: Shown) -> forelight_protocol::Stratum {
    let (object, material) = stratum_key(shown.object, shown.material).unwrap_or((0, 0));
    forelight_protocol::Stratum { name: name_of(shot, shown), object, material, prior_cost: 1.0 }
}

//! Makes the caches of a bundle, and compares them to light gathered at every point.

use super::Args;
use crate::images::Quality;
use anyhow::{Context, Result};
use forelight_preview::Choice;
use forelight_protocol::{CacheMode, RenderSettings, RenderSettingsRequest};
use forelight_renderer_own::{Blocks, ChosenCache, OwnRenderer, OwnShot, choose_cache};
use forelight_terminal::failure::{BadInput, Interrupted};
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::output::Bars;
use forelight_terminal::watching::AccuracyWatcher;
use serde::Serialize;
use std::path::Path;

/// Seed of the reference. Its noise must be independent of the caches'.
const REFERENCE_SEED: u64 = 0x5eed;

/// Seed of the camera samples of all images. So they differ in their light alone.
const CAMERA_SEED: u64 = 0;

/// Distance of the pixels whose differences are correlated.
const APART: u32 = 8;

/// The caches of a bundle.
#[derive(Debug, Serialize)]
pub struct Measured {
    pub bundle: String,
    pub rungs: Vec<Rung>,
}

/// Caches with the same settings, or for the same error. Errors are shares of the image's mean.
#[derive(Debug, Serialize)]
pub struct Rung {
    pub flags: String,
    /// Records of all levels, mean over the seeds.
    pub records: f64,
    /// Work of plan and fill, mean over the seeds.
    pub work: f64,
    /// Work of choosing the settings, as a share of that.
    pub choosing: Option<f64>,
    /// Forecast of the error, if the settings were chosen for one.
    pub forecast: Option<f64>,
    pub error: f64,
    /// Of the seeds.
    pub lowest: f64,
    pub highest: f64,
    /// Part of the error that differs from seed to seed.
    pub random: f64,
    /// Part of the error that is the same for all seeds.
    pub constant: f64,
    /// Correlation of the differences of pixels that are 8 pixels apart.
    pub structure: f64,
}

/// What is asked of a cache: settings, or an error.
enum Asked {
    Settings(RenderSettings),
    Error(f64),
}

pub fn bundle(
    args: &Args,
    bundle: &Path,
    rungs: &[Quality],
    bars: &Bars,
    interrupt: &Interrupt,
) -> Result<Measured> {
    let named = || format!("bundle {}", bundle.display());
    let shot = OwnRenderer::new(Choice::Cpu).open(bundle).with_context(named)?;
    let base = base(args);
    shot.frame(args.frame, &base).with_context(named)?;
    let of_rung =
        |rung: &Quality| of_rung(rung, &base).map(|asked| (rung.to_string(), Asked::Settings(asked)));
    let mut asked = rungs.iter().map(of_rung).collect::<Result<Vec<_>, BadInput>>()?;
    asked.extend(
        args.error.iter().map(|error| (format!("--cache-error {error}"), Asked::Error(error / 100.0))),
    );
    let name = shot.info().summary.name.clone();
    let bench = Bench { bundle, bars, args, shot: &shot, interrupt };
    let bar = bars.bar(&name, asked.len() as u64 * args.seeds + 1);
    bar.set_message(format!("{name}: reference"));
    let gathered =
        RenderSettings { ambient_divisions: args.reference_rays, seed: REFERENCE_SEED, ..base.clone() };
    let reference = bench.image(&gathered)?.blocks;
    bar.inc(1);
    let mut rungs = Vec::new();
    for (flags, asked) in asked {
        bar.set_message(format!("{name}: {flags}"));
        let mut all = Vec::new();
        for seed in 1..=args.seeds {
            all.extend(bench.cached(&asked, RenderSettings { seed, ..base.clone() })?);
            bar.inc(1);
        }
        match all.len() as u64 == args.seeds {
            true => rungs.push(summary(flags, &all, &reference)),
            false => bars.note(format!("{name}: {flags}: no cache is so accurate")),
        }
    }
    bar.finish_and_clear();
    Ok(Measured { bundle: name, rungs })
}

/// The settings of a rung. They may differ from `base` in the cache alone.
fn of_rung(rung: &Quality, base: &RenderSettings) -> Result<RenderSettings, BadInput> {
    let asked = rung.asked(base)?;
    if asked.cache == CacheMode::Off {
        return Err(
            BadInput::new(format!("--rung `{rung}`: there is no irradiance cache")).hint("add --cache on")
        );
    }
    let RenderSettings { spp, cache, cache_accuracy, cache_rays, .. } = asked;
    let cached = RenderSettings { cache, cache_accuracy, cache_rays, ..base.clone() };
    if rung.error().is_some() || rung.is_denoised() || asked != (RenderSettings { spp, ..cached.clone() }) {
        let reason = format!("--rung `{rung}`: only the settings of the cache may differ");
        return Err(BadInput::new(reason).hint("use --cache-accuracy and --cache-rays"));
    }
    Ok(cached)
}

fn base(args: &Args) -> RenderSettings {
    RenderSettings {
        ambient_bounces: args.ambient_bounces,
        materials: args.materials,
        spp: args.spp,
        ..RenderSettingsRequest::default().complete((args.size, args.height.unwrap_or(args.size)))
    }
}

struct Bench<'a> {
    bundle: &'a Path,
    bars: &'a Bars,
    args: &'a Args,
    shot: &'a OwnShot,
    interrupt: &'a Interrupt,
}

/// An image, and the cache behind it.
struct Made {
    blocks: Blocks,
    records: f64,
    work: f64,
    chosen: Option<ChosenCache>,
}

impl Bench<'_> {
    /// `None` if no cache is so accurate.
    fn cached(&self, asked: &Asked, base: RenderSettings) -> Result<Option<Made>> {
        match asked {
            Asked::Settings(asked) => {
                self.image(&RenderSettings { seed: base.seed, ..asked.clone() }).map(Some)
            }
            Asked::Error(error) => {
                let watcher = AccuracyWatcher::new(self.bars, "choosing the cache", self.interrupt);
                let chosen = choose_cache(self.shot, self.args.frame, &base, *error, &watcher);
                let chosen = watcher.done(chosen, self.bundle)?;
                if chosen.error > *error {
                    return Ok(None);
                }
                let made = self.image(&chosen.settings(&base))?;
                Ok(Some(Made { chosen: Some(chosen), ..made }))
            }
        }
    }

    fn image(&self, settings: &RenderSettings) -> Result<Made> {
        let ready = self.shot.frame(self.args.frame, settings)?;
        let cancel = self.interrupt.flag();
        ready.fill(&|_| (), cancel);
        let (blocks, _) = ready.blocks(CAMERA_SEED, cancel).ok_or(Interrupted)?;
        let records = ready.cache_records().iter().map(|&count| f64::from(count)).sum();
        Ok(Made { blocks, records, work: ready.spent_on_cache().work as f64, chosen: None })
    }
}

fn summary(flags: String, all: &[Made], reference: &Blocks) -> Rung {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
    let of = |value: &dyn Fn(&Made) -> f64| mean(&all.iter().map(value).collect::<Vec<f64>>());
    let scale = 1.0 / (reference.mean() * reference.mean()).max(f64::MIN_POSITIVE);
    let root = |square: f64| (square * scale).max(0.0).sqrt();
    let differences: Vec<Blocks> = all.iter().map(|made| made.blocks.minus(reference)).collect();
    let squares: Vec<f64> = differences.iter().map(Blocks::mean_square).collect();
    let apart: Vec<f64> = differences.iter().map(|one| one.mean_product_apart(APART)).collect();
    let pairs = differences.iter().enumerate();
    let pairs = pairs.flat_map(|(i, one)| differences[i + 1..].iter().map(|other| one.mean_product(other)));
    let common = mean(&pairs.collect::<Vec<f64>>());
    let square = mean(&squares);
    let work = of(&|made| made.work);
    let chosen: Option<Vec<ChosenCache>> = all.iter().map(|made| made.chosen).collect();
    let of_chosen = |value: &dyn Fn(&ChosenCache) -> f64| {
        chosen.as_ref().map(|all| mean(&all.iter().map(value).collect::<Vec<f64>>()))
    };
    Rung {
        flags,
        records: of(&|made| made.records),
        work,
        choosing: of_chosen(&|chosen| chosen.spent.work as f64 / work.max(1.0)),
        forecast: of_chosen(&|chosen| chosen.error),
        error: root(square),
        lowest: squares.iter().map(|&square| root(square)).fold(f64::INFINITY, f64::min),
        highest: squares.iter().map(|&square| root(square)).fold(0.0, f64::max),
        random: root(square - common),
        constant: root(common),
        structure: if square > 0.0 { mean(&apart) / square } else { 0.0 },
    }
}

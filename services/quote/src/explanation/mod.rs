//! Explains a quote: its work by part, by object and by ray, and the settings that would halve it.
//!
//! It uses the profile of the quote. Nothing more is traced.
//!
//! | file | subject |
//! | --- | --- |
//! | `amounts` | the numbers to explain, from an estimate |
//! | `halving` | settings that halve the work |
//! | `other` | quotes of other renderers |
//! | `words` | the sentences |

mod amounts;
mod halving;
mod other;
mod words;

pub use self::other::explain_sampled;

use forelight_protocol::{
    CacheMode, Explanation, FixedCosts, Integrator, ObjectShare, PartShare, RayShare, Rays, RenderSettings,
};

use self::amounts::{Amounts, ShownWork, extra_work, work_by_ray};
use self::halving::{Samples, Work};
use crate::error::QuoteError;
use crate::measured::Measured;

/// Smallest share of the pixels' work that is listed.
const LEAST_SHARE: f64 = 0.01;

/// Index of ambient rays in [`Rays::NAMES`]. The work of the irradiance cache counts as theirs.
const AMBIENT: usize = 5;

impl Measured<'_> {
    /// Explains the work of all frames, or of one. The work of a shared irradiance cache is not included: the
    /// quote lists it separately.
    ///
    /// # Errors
    /// Those of [`Measured::estimate`], and if there is no such frame.
    pub fn explain(&self, settings: &RenderSettings, frame: Option<u32>) -> Result<Explanation, QuoteError> {
        Ok(explain(self.amounts(frame)?, settings))
    }
}

fn explain(amounts: Amounts, settings: &RenderSettings) -> Explanation {
    let by_ray = work_by_ray(&amounts.pixels);
    let samples = Samples {
        work: amounts.pixel_work(),
        extra: extra_work(&amounts.pixels),
        now: settings.spp.max(1),
        uncovered: amounts.uncovered,
    };
    let (parts, planning) = parts(&amounts);
    // With a cache, only records gather. The path integrator never gathers.
    let gathers = settings.cache == CacheMode::Off && settings.integrator == Integrator::Ambient;
    let ambient = by_ray.filter(|_| gathers).map_or(0.0, |by_ray| by_ray[AMBIENT]);
    let of_cache = amounts.records_work.iter().sum::<f64>() + planning;
    let more = samples.with(samples.now.saturating_add(1)) - samples.work;
    let work = Work { whole: amounts.work, samples, ambient, levels: amounts.records_work.clone() };
    let mut halving = work.halving(settings);
    halving.retain(|way| amounts.by_samples || way.setting != "spp");
    let mut explanation = Explanation {
        words: Vec::new(),
        frame: amounts.frame,
        work: amounts.work,
        parts,
        objects: objects(&amounts),
        rays: rays(&amounts, by_ray, of_cache),
        camera_sample: if amounts.by_samples { amounts.share(more).max(0.0) } else { 0.0 },
        halving,
    };
    explanation.words = words::sentences(&explanation, settings, amounts.shares_cache);
    explanation
}

/// Kinds of work, largest first, and the work of planning the irradiance cache.
fn parts(amounts: &Amounts) -> (Vec<PartShare>, f64) {
    let part = |name: &str, work: f64| PartShare { part: name.into(), work, share: amounts.share(work) };
    let pixels = amounts.pixel_work();
    let records: f64 = amounts.records_work.iter().sum();
    let rest = (amounts.work - pixels - records).max(0.0);
    let mut parts = vec![part("pixels", pixels), part("filling the irradiance cache", records)];
    let FixedCosts { load, build, plan, .. } = amounts.fixed.unwrap_or_default();
    let own = [("setting up", load), ("building the tree", build), ("planning the irradiance cache", plan)];
    let own = own.into_iter().map(|(name, spent)| (name, spent.work as f64));
    let others = amounts.fixed_parts.iter().map(|(name, work)| (name.as_str(), *work));
    let setting_up: Vec<(&str, f64)> = own.chain(others).collect();
    let all = setting_up.iter().map(|(_, work)| work).sum::<f64>();
    let mut planning = 0.0;
    if all > 0.0 {
        planning = rest * (plan.work as f64 / all);
        parts.extend(setting_up.into_iter().map(|(name, work)| part(name, rest * (work / all))));
    } else {
        parts.push(part("setting up", rest));
    }
    parts.retain(|part| part.work > 0.0);
    parts.sort_by(|a, b| b.work.total_cmp(&a.work));
    (parts, planning)
}

/// Work of the pixels by object, largest first. Empty if the strategy does not tell objects apart.
fn objects(amounts: &Amounts) -> Vec<ObjectShare> {
    if !amounts.told_apart {
        return Vec::new();
    }
    let pixel_work = amounts.pixel_work();
    let pixel_count = amounts.pixels.iter().map(|shown| shown.pixels).sum::<u64>().max(1) as f64;
    let object = |&ShownWork { ref shows, pixels, samples, work, .. }: &ShownWork| ObjectShare {
        shows: shows.clone(),
        pixels,
        share_of_pixels: pixels as f64 / pixel_count,
        work,
        share: amounts.share(work),
        times_mean_pixel: work / pixels.max(1) as f64 / (pixel_work / pixel_count),
        samples,
        share_per_sample: (samples > 0).then(|| amounts.share(work) / samples as f64),
    };
    let listed = |shown: &&ShownWork| shown.work >= LEAST_SHARE * pixel_work && shown.work > 0.0;
    let mut objects: Vec<ObjectShare> = amounts.pixels.iter().filter(listed).map(object).collect();
    objects.sort_by(|a, b| b.work.total_cmp(&a.work));
    objects
}

/// Rays by category, most work first. `of_cache` is the work of planning and filling the irradiance cache. It
/// counts as work of ambient rays.
fn rays(amounts: &Amounts, by_ray: Option<[f64; 7]>, of_cache: f64) -> Vec<RayShare> {
    let all_rays: f64 = amounts.rays.iter().sum();
    let ray_share = |(kind, (name, rays)): (usize, (&&str, f64))| {
        let cache = if kind == AMBIENT { of_cache } else { 0.0 };
        let work = by_ray.map(|by_ray| by_ray[kind] + cache);
        RayShare {
            category: (*name).to_owned(),
            rays,
            share: if all_rays > 0.0 { rays / all_rays } else { 0.0 },
            work,
            share_of_work: work.map(|work| amounts.share(work)),
        }
    };
    let all = Rays::NAMES.iter().zip(amounts.rays).enumerate().map(ray_share);
    // Reading an existing cache needs no ray.
    let mut rays: Vec<RayShare> = all.filter(|ray| ray.rays > 0.0 || ray.work > Some(0.0)).collect();
    let cost = |ray: &RayShare| ray.work.unwrap_or(ray.rays);
    rays.sort_by(|a, b| cost(b).total_cmp(&cost(a)));
    rays
}

#[cfg(test)]
mod tests {
    use super::amounts::ProfiledWork;
    use super::*;
    use forelight_protocol::{RenderSettingsRequest, Spent};

    #[test]
    fn the_work_of_rays_is_that_of_pixels_as_profiled_and_all_of_the_cache() {
        let shown = |pixels, samples, work, by_ray| {
            let profiled = ProfiledWork { by_ray, ..ProfiledWork::default() };
            ShownWork { shows: None, pixels, samples, work, profiled }
        };
        let spent = |work| Spent { work, cpu_nanos: 0 };
        let amounts = |by_ray: [f64; 7]| Amounts {
            frame: None,
            work: 200.0,
            // The second entry was not profiled and is divided like all profiled pixels.
            pixels: vec![shown(10, 2, 80.0, by_ray), shown(5, 0, 40.0, [0.0; 7])],
            told_apart: true,
            by_samples: true,
            records_work: vec![50.0],
            fixed: Some(FixedCosts {
                plan: spent(6),
                load: spent(2),
                build: spent(2),
                ..FixedCosts::default()
            }),
            fixed_parts: Vec::new(),
            shares_cache: false,
            rays: [15.0, 20.0, 0.0, 0.0, 0.0, 30.0, 0.0],
            uncovered: None,
        };
        let settings = RenderSettingsRequest::default().complete((10, 10));
        let explained = explain(amounts([1.0, 2.0, 0.0, 0.0, 0.0, 1.0, 0.0]), &settings);
        let told = |explained: &Explanation| -> Vec<(String, Option<f64>)> {
            explained.rays.iter().map(|ray| (ray.category.clone(), ray.share_of_work)).collect()
        };
        let expected = [("ambient", 0.49), ("shadow", 0.3), ("primary", 0.15)];
        assert_eq!(told(&explained), expected.map(|(name, share)| (name.to_owned(), Some(share))));
        let by_ray = "49.0 % of the work is for ambient rays, 30.0 %";
        assert!(explained.words.iter().any(|line| line.starts_with(by_ray)), "{:?}", explained.words);
        let unknown = explain(amounts([0.0; 7]), &settings);
        let expected = ["ambient", "shadow", "primary"].map(|name| (name.to_owned(), None));
        assert_eq!(told(&unknown), expected);
        let by_count = "46.2 % of the rays are ambient";
        assert!(unknown.words.iter().any(|line| line.starts_with(by_count)), "{:?}", unknown.words);
    }
}

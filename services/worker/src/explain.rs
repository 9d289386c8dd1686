//! Why frames are dear: a quote taken apart.

use crate::quote::Quote;
use crate::renderer::StratumInfo;
use forelight_protocol::{Explanation, Halving, ObjectShare, PartShare, RayShare, Rays, RenderSettings};

/// Objects with less than this share of the pixels' work are not listed.
const LEAST_SHARE: f64 = 0.01;

impl Quote {
    /// What the quote's work goes into. `strata` are the shot's. Objects are told apart only if the pixels were chosen by them.
    pub fn explained(&self, strata: &[StratumInfo], settings: &RenderSettings) -> Explanation {
        let background = strata.len();
        let whole = self.forecast.total.work.mean;
        // Sums over the frames: pixels, or records, and their work.
        let by_stratum = self.forecast.frames.first().map_or(0, |frame| frame.strata.len());
        let mut counts = vec![0u64; by_stratum];
        let mut work = vec![0.0; by_stratum];
        for (index, seen) in self.forecast.frames.iter().flat_map(|frame| frame.strata.iter().enumerate()) {
            counts[index] += u64::from(seen.pixels);
            work[index] += f64::from(seen.pixels) * seen.mean.work;
        }
        let records = self.document.total.cache_records.len().min(by_stratum);
        let (pixels, gathered) = work.split_at(by_stratum - records);
        let pixel_count = counts[..pixels.len()].iter().sum::<u64>().max(1) as f64;
        let (pixel_work, gathered_work) = (pixels.iter().sum::<f64>(), gathered.iter().sum::<f64>());
        let share = |part: f64| if whole > 0.0 { part / whole } else { 0.0 };
        let part = |name: &str, work: f64| PartShare { part: name.into(), work, share: share(work) };
        let mut parts = vec![
            part("pixels", pixel_work),
            part("filling the irradiance cache", gathered_work),
            part("setting up, and planning the cache", (whole - pixel_work - gathered_work).max(0.0)),
        ];
        parts.retain(|part| part.work > 0.0);
        parts.sort_by(|a, b| b.work.total_cmp(&a.work));
        let mut objects: Vec<ObjectShare> = Vec::new();
        if pixels.len() == background + 1 {
            let shown = (0..pixels.len()).filter(|&h| work[h] >= LEAST_SHARE * pixel_work && work[h] > 0.0);
            objects.extend(shown.map(|h| ObjectShare {
                shows: strata.get(h).map(|stratum| stratum.name.clone()),
                pixels: counts[h],
                share_of_pixels: counts[h] as f64 / pixel_count,
                work: work[h],
                share: share(work[h]),
                times_mean_pixel: work[h] / counts[h].max(1) as f64 / (pixel_work / pixel_count),
            }));
            objects.sort_by(|a, b| b.work.total_cmp(&a.work));
        }
        let all_rays: f64 = self.forecast.total.rays.iter().map(|rays| rays.mean).sum();
        let named = Rays::NAMES.iter().zip(&self.forecast.total.rays).filter(|(_, rays)| rays.mean > 0.0);
        let mut rays: Vec<RayShare> = named
            .map(|(name, rays)| RayShare {
                category: (*name).to_owned(),
                rays: rays.mean,
                share: rays.mean / all_rays,
            })
            .collect();
        rays.sort_by(|a, b| b.rays.total_cmp(&a.rays));
        Explanation {
            work: whole,
            parts,
            objects,
            rays,
            halving: halving(whole, pixel_work, gathered_work, settings),
        }
    }
}

/// The pixels' part goes with the camera samples, and with the number of pixels; filling a cache with the rays of a record. What is left is
/// taken to stay.
fn halving(whole: f64, pixels: f64, gathered: f64, settings: &RenderSettings) -> Vec<Halving> {
    // The share of a part that may be kept.
    let kept = |part: f64| if part > 0.0 { (1.0 - 0.5 * whole / part).max(0.0) } else { 0.0 };
    let way = |setting: &str, from: u32, to: f64| {
        (to >= 1.0).then(|| Halving { setting: setting.into(), from: f64::from(from), to: to.floor() })
    };
    let ways = [
        way("spp", settings.spp, f64::from(settings.spp) * kept(pixels)),
        way("width", settings.width, f64::from(settings.width) * kept(pixels).sqrt()),
        way("cache-rays", settings.cache_rays, f64::from(settings.cache_rays) * kept(gathered)),
    ];
    ways.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_protocol::RenderSettingsRequest;

    #[test]
    fn what_is_named_really_halves_the_whole() {
        let settings = RenderSettingsRequest { spp: Some(64), ..Default::default() }.complete((1000, 500));
        let (whole, pixels) = (100.0, 80.0);
        for way in halving(whole, pixels, 10.0, &settings) {
            let share = if way.setting == "spp" { way.to / way.from } else { (way.to / way.from).powi(2) };
            let after = whole - pixels + pixels * share;
            assert!(after <= 50.0 && after > 48.0, "{way:?}: {after}");
        }
        let cached = halving(100.0, 10.0, 80.0, &settings);
        assert_eq!(cached.len(), 1);
        assert!(cached[0].setting == "cache-rays" && 20.0 + 80.0 * cached[0].to / cached[0].from <= 50.0);
        assert!(halving(100.0, 40.0, 40.0, &settings).is_empty(), "no single part is more than half");
        assert!(halving(0.0, 0.0, 0.0, &settings).is_empty());
    }
}

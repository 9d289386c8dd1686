//! Finds the settings that would halve the work of a quote.

use forelight_protocol::{Halving, RenderSettings, UncoveredGathers};

/// Work of the pixels as a function of the camera samples.
#[derive(Clone, Copy, Debug)]
pub(super) struct Samples {
    pub work: f64,
    /// Work that does not grow with the samples.
    pub extra: f64,
    pub now: u32,
    pub uncovered: Option<UncoveredGathers>,
}

impl Samples {
    /// Work at this number of samples per pixel.
    pub fn with(&self, samples: u32) -> f64 {
        let growth = self.uncovered.map_or(1.0, |gathers| gathers.growth(self.now, samples));
        (self.work - self.extra) * (f64::from(samples) / f64::from(self.now)) + self.extra * growth
    }
}

pub(super) struct Work {
    pub whole: f64,
    pub samples: Samples,
    /// Work of the pixels that grows with the rays of a gather.
    pub ambient: f64,
    pub levels: Vec<f64>,
}

/// Largest share that counts as half. The margin is worth less than one camera sample.
const HALF: f64 = 0.505;

/// The records grow with the pixels to this power. Measured on the scenes in this repository: a quarter of
/// the pixels leaves 38 to 40 % of the records.
const RECORDS_BY_PIXELS: f64 = 0.65;

/// Rays of a record, relative to the level before.
const RAYS_BY_LEVEL: f64 = 0.25;

impl Work {
    /// The settings that halve the work, each by itself.
    ///
    /// The model: work of the pixels is proportional to the pixels and, except for gathers at uncovered
    /// points, to the camera samples. Its ambient part is proportional to the rays of a gather. The work of
    /// filling a cache is proportional to the records and their rays. All other work is constant.
    pub fn halving(&self, settings: &RenderSettings) -> Vec<Halving> {
        if self.whole <= 0.0 {
            return Vec::new();
        }
        let way = |setting: &str, from: u32, to: Option<f64>| {
            to.map(|to| Halving { setting: setting.into(), from: f64::from(from), to })
        };
        // Largest value below the present one that leaves at most half.
        let most_at = |from: u32, left: &dyn Fn(u32) -> f64| {
            (1..from).rev().find(|&to| left(to) <= HALF * self.whole).map(f64::from)
        };
        let most =
            |from: u32, left: &dyn Fn(f64) -> f64| most_at(from, &|to| left(f64::from(to) / f64::from(from)));
        let records: f64 = self.levels.iter().sum();
        let of_samples = |samples: u32| self.whole - self.samples.work + self.samples.with(samples);
        let of_pixels = |share: f64| self.whole - self.samples.work * (1.0 - share);
        let of_ambient = |share: f64| self.whole - self.ambient * (1.0 - share);
        let of_width = |share: f64| {
            let (pixels, records_left) = (share * share, (share * share).powf(RECORDS_BY_PIXELS));
            of_pixels(pixels) - records * (1.0 - records_left)
        };
        let now = f64::from(settings.cache_rays);
        let of_rays = |rays: f64| {
            let gathered = self.levels.iter().zip(0..).map(|(work, level)| {
                let part = RAYS_BY_LEVEL.powi(level);
                work * (1.0 - rays_used(rays * part) / rays_used(now * part))
            });
            self.whole - gathered.sum::<f64>()
        };
        let sides = (1..=(now / 48.0).sqrt().ceil() as u32).rev();
        let fewer = sides.map(|side| 48.0 * f64::from(side * side)).filter(|&rays| rays < now);
        let ways = [
            way("spp", settings.spp, most_at(settings.spp, &of_samples)),
            way("width", settings.width, most(settings.width, &of_width)),
            way(
                "ambient-divisions",
                settings.ambient_divisions,
                most(settings.ambient_divisions, &of_ambient),
            ),
            way(
                "cache-rays",
                settings.cache_rays,
                fewer.into_iter().find(|&rays| of_rays(rays) <= HALF * self.whole),
            ),
        ];
        ways.into_iter().flatten().collect()
    }
}

/// Rays that a record uses when `asked` are asked for: 48 times a square, and at least 48.
fn rays_used(asked: f64) -> f64 {
    let side = (asked / 48.0).sqrt().round().max(1.0);
    48.0 * side * side
}

#[cfg(test)]
mod tests {
    use super::super::amounts::{ProfiledWork, ShownWork, extra_work};
    use super::*;
    use forelight_protocol::RenderSettingsRequest;

    #[test]
    fn what_is_named_really_halves_the_whole() {
        let request = RenderSettingsRequest { spp: Some(64), ambient_bounces: Some(1), ..Default::default() };
        let settings = request.complete((1000, 500));
        let (whole, pixels) = (100.0, 80.0);
        let ways =
            |whole, pixels, ambient, levels: &[f64], settings: &RenderSettings| -> Vec<(String, f64)> {
                let samples = Samples { work: pixels, extra: 0.0, now: settings.spp, uncovered: None };
                let parts = Work { whole, samples, ambient, levels: levels.to_vec() };
                parts.halving(settings).into_iter().map(|way| (way.setting, way.to)).collect()
            };
        let told = |ways: &[(&str, f64)]| -> Vec<(String, f64)> {
            ways.iter().map(|(setting, to)| ((*setting).to_owned(), *to)).collect()
        };
        // 20 + 80 × 24 / 64 = 50; 20 + 80 × 0.617² = 50.5; 40 + 60 × 5 / 32 = 49.4.
        let plain = ways(whole, pixels, 60.0, &[], &settings);
        assert_eq!(plain, told(&[("spp", 24.0), ("width", 617.0), ("ambient-divisions", 2.0)]));
        // 296 of 768 rays are allowed. The next lower number in use is 192.
        let cached = ways(100.0, 10.0, 0.0, &[80.0], &settings);
        assert_eq!(cached, told(&[("width", 557.0), ("cache-rays", 192.0)]));
        // The second bounce gathers with a quarter: 48 of 192, which is the minimum.
        assert_eq!(ways(100.0, 10.0, 0.0, &[40.0, 40.0], &settings)[1], ("cache-rays".to_owned(), 192.0));
        let few = RenderSettings { cache_rays: 192, ..settings.clone() };
        assert_eq!(
            ways(100.0, 10.0, 0.0, &[40.0, 40.0], &few).len(),
            1,
            "the second bounce keeps its least rays"
        );
        assert_eq!(ways(100.0, 10.0, 0.0, &[80.0], &few)[1], ("cache-rays".to_owned(), 48.0));
        assert_eq!(ways(100.0, 40.0, 0.0, &[], &settings), told(&[]), "no single part is more than half");
        assert_eq!(ways(0.0, 0.0, 0.0, &[], &settings), told(&[]));
        // Two samples of four leave slightly more than half, within the margin.
        let four = RenderSettings { spp: 4, ..settings };
        assert_eq!(ways(100.0, 99.2, 0.0, &[], &four)[0], ("spp".to_owned(), 2.0));
    }

    #[test]
    fn gathers_that_the_first_samples_of_a_pixel_have_are_in_no_further_one() {
        // Gather rays: 24 in the first sample, then 12, 8, 6, 4, and 4 in all others. The surplus over 4: 20,
        // 28, 32, 34, 34.
        let uncovered = Some(UncoveredGathers { first: 24, least: 4 });
        let samples = |now| Samples { work: 80.0, extra: 40.0, now, uncovered };
        assert!((samples(1).with(2) - (80.0 + 56.0)).abs() < 1e-9);
        assert!((samples(8).with(9) - 85.0).abs() < 1e-9, "one more is an eighth of what is in proportion");
        let profiled = |work, extra| ProfiledWork { work, extra, ..ProfiledWork::default() };
        let shown = |work, profiled| ShownWork { shows: None, pixels: 1, samples: 1, work, profiled };
        // The last entry has the proportions of the other two together.
        let pixels = [
            shown(10.0, profiled(4.0, 2.0)),
            shown(30.0, profiled(6.0, 0.0)),
            shown(20.0, ProfiledWork::default()),
        ];
        assert!((extra_work(&pixels) - (5.0 + 4.0)).abs() < 1e-9);
        assert_eq!(extra_work(&pixels[2..]), 0.0);
    }
}

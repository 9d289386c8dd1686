//! Why frames are dear.

use crate::{CacheMode, FixedCosts, Integrator, Rays, RenderSettings, StratumName, UncoveredGathers};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Objects with less than this share of the pixels' work are not listed.
const LEAST_SHARE: f64 = 0.01;

/// Index of ambient rays, for which the irradiance cache is.
const AMBIENT: usize = 5;

/// So many objects, and categories of rays, are named in words.
const NAMED: usize = 3;

/// What a quote's work goes into, and what would halve it. Work is that of all frames, or of one, as the quote expects it.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Explanation {
    /// The same in words, a sentence each, the most important first.
    pub words: Vec<String>,
    /// The frame that it is about; absent if it is about all of them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<u32>,
    /// The whole, without the making of an irradiance cache that frames share.
    pub work: f64,
    /// Kinds of work, the dearest first.
    pub parts: Vec<PartShare>,
    /// The pixels' part by what they show, the dearest first; those of little work are not listed.
    pub objects: Vec<ObjectShare>,
    /// Rays by what sends them out, those that the most work is for first.
    pub rays: Vec<RayShare>,
    /// Share of the whole that one camera sample more of every pixel costs.
    pub camera_sample: f64,
    /// Ways to halve the whole; none where what no pixel can help is more than half of it.
    pub halving: Vec<Halving>,
}

/// A kind of work.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct PartShare {
    /// What it is.
    pub part: String,
    /// Its work.
    pub work: f64,
    /// Its share of the whole, 0 to 1.
    pub share: f64,
}

/// Pixels that show one material of one object.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct ObjectShare {
    /// What they show; absent of the background.
    pub shows: Option<StratumName>,
    /// How many they are, in all frames.
    pub pixels: u64,
    /// Share of all pixels, 0 to 1.
    pub share_of_pixels: f64,
    /// Their work.
    pub work: f64,
    /// Its share of the whole, 0 to 1.
    pub share: f64,
    /// Work of one of them over that of the mean pixel.
    pub times_mean_pixel: f64,
    /// How many of them were profiled: what all this rests on.
    pub samples: u64,
    /// Share of the whole that each of the profiled ones stands for, 0 to 1; absent if none was, so that others like them had to speak for them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub share_per_sample: Option<f64>,
}

/// Rays of one category.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct RayShare {
    /// Its name.
    pub category: String,
    /// How many are expected.
    pub rays: f64,
    /// Share of all rays, 0 to 1.
    pub share: f64,
    /// Work that they bring about, as in [`crate::RenderStats::work_by_ray`]; absent if profiles do not say.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub work: Option<f64>,
    /// Share of the whole work, 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub share_of_work: Option<f64>,
}

/// A setting that would halve the whole.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
pub struct Halving {
    /// Name of the setting. With the width the height changes in proportion.
    pub setting: String,
    /// Its value now.
    pub from: f64,
    /// The value that would do.
    pub to: f64,
}

/// Pixels that are alike, and what a quote expects of them, in all that is explained.
#[derive(Clone, PartialEq, Debug)]
pub struct ShownWork {
    /// What they show; none of the background.
    pub shows: Option<StratumName>,
    /// How many they are.
    pub pixels: u64,
    /// How many of them were profiled.
    pub samples: u64,
    /// Their work.
    pub work: f64,
    /// What those that were profiled took.
    pub profiled: ProfiledWork,
}

/// What profiled pixels took, in parts: their proportions are what counts.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct ProfiledWork {
    /// By the ray that brought it about, in the order of [`Rays::NAMES`].
    by_ray: [f64; 7],
    /// All of it, and the part that is not in proportion to the camera samples, see [`UncoveredGathers`].
    work: f64,
    extra: f64,
}

impl ProfiledWork {
    /// Notes what a pixel took by the ray that brought it about.
    pub fn note_rays(&mut self, work_by_ray: &[u64; 7]) {
        self.by_ray.iter_mut().zip(work_by_ray).for_each(|(sum, &work)| *sum += work as f64);
    }

    /// Notes what a pixel took, and what of it is not in proportion to the camera samples.
    pub fn note_extra(&mut self, work: u64, extra: u64) {
        self.work += work as f64;
        self.extra += extra as f64;
    }

    fn plus(self, other: Self) -> Self {
        let mut by_ray = self.by_ray;
        by_ray.iter_mut().zip(other.by_ray).for_each(|(sum, work)| *sum += work);
        Self { by_ray, work: self.work + other.work, extra: self.extra + other.extra }
    }
}

/// What is to be explained.
#[derive(Clone, PartialEq, Debug)]
pub struct Amounts {
    /// The frame; none for all of them.
    pub frame: Option<u32>,
    /// Work of everything.
    pub work: f64,
    /// Pixels, in parts that are told apart: each of them in one.
    pub pixels: Vec<ShownWork>,
    /// Whether these parts are what the pixels show. A quote by a strategy that knows no objects has none to name.
    pub told_apart: bool,
    /// Work of filling the irradiance cache, by level, that of the camera's hits first; none without one.
    pub records_work: Vec<f64>,
    /// What a frame costs whatever its pixels show; without it that is one part.
    pub fixed: Option<FixedCosts>,
    /// Whether frames share an irradiance cache, whose making is in none of this.
    pub shares_cache: bool,
    /// Rays by category, in the order of [`Rays::NAMES`].
    pub rays: [f64; 7],
    /// Gathers at points that no record covers, if there is a cache.
    pub uncovered: Option<UncoveredGathers>,
}

impl Explanation {
    /// What the work of a quote at these settings goes into.
    pub fn new(amounts: Amounts, settings: &RenderSettings) -> Self {
        let Amounts {
            frame,
            work: whole,
            pixels,
            told_apart,
            records_work: levels,
            fixed,
            shares_cache,
            rays,
            uncovered,
        } = amounts;
        let pixel_work: f64 = pixels.iter().map(|shown| shown.work).sum();
        let records_work: f64 = levels.iter().sum();
        let pixel_count = pixels.iter().map(|shown| shown.pixels).sum::<u64>().max(1) as f64;
        let share = |part: f64| if whole > 0.0 { part / whole } else { 0.0 };
        let part = |name: &str, work: f64| PartShare { part: name.into(), work, share: share(work) };
        let mut parts = vec![part("pixels", pixel_work), part("filling the irradiance cache", records_work)];
        let by_ray = work_by_ray(&pixels);
        let samples =
            Samples { work: pixel_work, extra: extra_work(&pixels), now: settings.spp.max(1), uncovered };
        let rest = (whole - pixel_work - records_work).max(0.0);
        let FixedCosts { load, build, plan, .. } = fixed.unwrap_or_default();
        let setting_up =
            [("setting up", load), ("building the tree", build), ("planning the irradiance cache", plan)];
        let mut planning = 0.0;
        match setting_up.map(|(_, spent)| spent.work as f64).iter().sum::<f64>() {
            all if all > 0.0 => {
                planning = rest * (plan.work as f64 / all);
                parts.extend(setting_up.map(|(name, spent)| part(name, rest * (spent.work as f64 / all))))
            }
            _ => parts.push(part("setting up", rest)),
        }
        parts.retain(|part| part.work > 0.0);
        parts.sort_by(|a, b| b.work.total_cmp(&a.work));
        let mut objects: Vec<ObjectShare> = Vec::new();
        if told_apart {
            let shown = pixels.into_iter().filter(|h| h.work >= LEAST_SHARE * pixel_work && h.work > 0.0);
            objects.extend(shown.map(|ShownWork { shows, pixels, samples, work, .. }| ObjectShare {
                shows,
                pixels,
                share_of_pixels: pixels as f64 / pixel_count,
                work,
                share: share(work),
                times_mean_pixel: work / pixels.max(1) as f64 / (pixel_work / pixel_count),
                samples,
                share_per_sample: (samples > 0).then(|| share(work) / samples as f64),
            }));
            objects.sort_by(|a, b| b.work.total_cmp(&a.work));
        }
        // With a cache it is the records that gather, and paths gather nothing.
        let gathers = settings.cache == CacheMode::Off && settings.integrator == Integrator::Ambient;
        let ambient = by_ray.filter(|_| gathers).map_or(0.0, |by_ray| by_ray[AMBIENT]);
        let all_rays: f64 = rays.iter().sum();
        let ray_share = |(kind, (name, rays)): (usize, (&&str, f64))| {
            let cache = if kind == AMBIENT { records_work + planning } else { 0.0 };
            let work = by_ray.map(|by_ray| by_ray[kind] + cache);
            RayShare {
                category: (*name).to_owned(),
                rays,
                share: if all_rays > 0.0 { rays / all_rays } else { 0.0 },
                work,
                share_of_work: work.map(share),
            }
        };
        let all = Rays::NAMES.iter().zip(rays).enumerate().map(ray_share);
        // A cache that is there already is read without a ray.
        let mut rays: Vec<RayShare> = all.filter(|ray| ray.rays > 0.0 || ray.work > Some(0.0)).collect();
        let dear = |ray: &RayShare| ray.work.unwrap_or(ray.rays);
        rays.sort_by(|a, b| dear(b).total_cmp(&dear(a)));
        let mut explanation = Self {
            words: Vec::new(),
            frame,
            work: whole,
            parts,
            objects,
            rays,
            camera_sample: share(samples.with(samples.now.saturating_add(1)) - pixel_work).max(0.0),
            halving: Dear { whole, samples, ambient, levels }.halving(settings),
        };
        explanation.words = explanation.in_words(settings, shares_cache);
        explanation
    }

    /// The sentences.
    fn in_words(&self, settings: &RenderSettings, shares_cache: bool) -> Vec<String> {
        let mut words = Vec::new();
        let percent = |share: f64| format!("{:.1} %", 100.0 * share);
        if let Some(PartShare { part, share, .. }) = self.parts.first() {
            words.push(format!("{} of the work is {part}", percent(*share)));
        }
        for object in self.objects.iter().take(NAMED) {
            let ObjectShare { share, share_of_pixels, times_mean_pixel, samples, .. } = object;
            let name = object.name();
            let told = match samples {
                0 => "none was profiled: it is told from others of its material".to_owned(),
                1 => "told from one profiled pixel".to_owned(),
                samples => format!("told from {samples} profiled pixels"),
            };
            words.push(format!(
                "{name}: {} of the work, {} of the pixels; one of its pixels costs {times_mean_pixel:.2} times the mean ({told})",
                percent(*share),
                percent(*share_of_pixels),
            ));
        }
        let known = self.rays.iter().all(|ray| ray.share_of_work.is_some());
        let by_ray = self.rays.iter().take(NAMED).map(|ray| match ray.share_of_work {
            Some(share) => format!("{} for {} rays", percent(share), ray.category),
            None => format!("{} {}", percent(ray.share), ray.category),
        });
        if !self.rays.is_empty() {
            let of = if known { "of the work is" } else { "of the rays are" };
            words.push(format!("{of} {}", by_ray.collect::<Vec<_>>().join(", ")));
        }
        if self.camera_sample > 0.0 {
            words.push(format!(
                "one camera sample more per pixel costs {} of the whole",
                percent(self.camera_sample)
            ));
        }
        let way = |way: &Halving| match way.setting.as_str() {
            "spp" => {
                let samples = if way.to == 1.0 { "sample" } else { "samples" };
                format!("{} camera {samples} per pixel in place of {}", way.to, way.from)
            }
            "width" => {
                let RenderSettings { width, height, .. } = settings;
                let lower = (f64::from(*height) * way.to / way.from).floor().max(1.0);
                format!("--width {} --height {lower} in place of {width} x {height}", way.to)
            }
            setting => format!("--{setting} {} in place of {}", way.to, way.from),
        };
        if shares_cache {
            words.push("making the irradiance cache that the frames share is not in this: it is a line of its own in the quote".to_owned());
        }
        words.push(match &self.halving[..] {
            [] => "half of it: fewer camera samples, pixels or rays of a gather do that only together"
                .to_owned(),
            ways => format!("half of it: {}", ways.iter().map(way).collect::<Vec<_>>().join("; or ")),
        });
        words
    }
}

impl ObjectShare {
    /// What people call it.
    pub fn name(&self) -> String {
        self.shows
            .as_ref()
            .map_or("the background".into(), |name| format!("{}, {}", name.object, name.material))
    }
}

/// The pixels' work by the ray that brings it about: in the proportions of those that were profiled of what a pixel shows, or of all of them. `None`
/// if that is of none known.
fn work_by_ray(pixels: &[ShownWork]) -> Option<[f64; 7]> {
    let sum = |of: &ProfiledWork| of.by_ray.iter().sum::<f64>();
    let all = all_profiled(pixels);
    let mut work = [0.0; 7];
    for shown in pixels {
        let known = if sum(&shown.profiled) > 0.0 { &shown.profiled } else { &all };
        let sum = sum(known);
        if sum > 0.0 {
            work.iter_mut().zip(known.by_ray).for_each(|(work, of_ray)| *work += shown.work * (of_ray / sum));
        }
    }
    (sum(&all) > 0.0).then_some(work)
}

/// What of the pixels' work is not in proportion to the camera samples, by the same proportions.
fn extra_work(pixels: &[ShownWork]) -> f64 {
    let all = all_profiled(pixels);
    let of = |shown: &ShownWork| {
        let known = if shown.profiled.work > 0.0 { &shown.profiled } else { &all };
        if known.work > 0.0 { shown.work * (known.extra / known.work) } else { 0.0 }
    };
    pixels.iter().map(of).sum()
}

fn all_profiled(pixels: &[ShownWork]) -> ProfiledWork {
    pixels.iter().map(|shown| shown.profiled).fold(ProfiledWork::default(), ProfiledWork::plus)
}

/// What the pixels take with other camera samples.
#[derive(Clone, Copy, Debug)]
struct Samples {
    /// With those that there are now.
    work: f64,
    /// The part of it that is not in proportion to them.
    extra: f64,
    now: u32,
    uncovered: Option<UncoveredGathers>,
}

impl Samples {
    /// Work with so many.
    fn with(&self, samples: u32) -> f64 {
        let growth = self.uncovered.map_or(1.0, |gathers| gathers.growth(self.now, samples));
        (self.work - self.extra) * (f64::from(samples) / f64::from(self.now)) + self.extra * growth
    }
}

/// What of the work a setting would change.
struct Dear {
    whole: f64,
    /// The pixels.
    samples: Samples,
    /// The part of the pixels that goes with the rays of a gather.
    ambient: f64,
    /// Filling an irradiance cache, by level.
    levels: Vec<f64>,
}

/// What leaves at most this part of the whole halves it: one sample more or less is not worth more.
const HALF: f64 = 0.505;

/// The records of a cache fall with the number of pixels to this power: of a quarter of the pixels 38 to 40 % are left on the test scenes.
const RECORDS_BY_PIXELS: f64 = 0.65;

/// Records of each further level gather this part of the rays of the one before.
const RAYS_BY_LEVEL: f64 = 0.25;

impl Dear {
    /// The pixels' part goes with the camera samples, but for gathers at points that no record covers, and with the number of pixels, its ambient part with the rays of a gather; filling a cache
    /// with the rays of a record, and with the number of records. What is left is taken to stay.
    fn halving(&self, settings: &RenderSettings) -> Vec<Halving> {
        if self.whole <= 0.0 {
            return Vec::new();
        }
        let way = |setting: &str, from: u32, to: Option<f64>| {
            to.map(|to| Halving { setting: setting.into(), from: f64::from(from), to })
        };
        // The largest number below the one that there is now, at which a part shrinks enough.
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

/// The rays that a record is gathered with of which this many are asked for: 48 times a square, and at least 48.
fn rays_used(asked: f64) -> f64 {
    let side = (asked / 48.0).sqrt().round().max(1.0);
    48.0 * side * side
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::RenderSettingsRequest;

    #[test]
    fn what_is_named_really_halves_the_whole() {
        let request = RenderSettingsRequest { spp: Some(64), ambient_bounces: Some(1), ..Default::default() };
        let settings = request.complete((1000, 500));
        let (whole, pixels) = (100.0, 80.0);
        let ways =
            |whole, pixels, ambient, levels: &[f64], settings: &RenderSettings| -> Vec<(String, f64)> {
                let samples = Samples { work: pixels, extra: 0.0, now: settings.spp, uncovered: None };
                let dear = Dear { whole, samples, ambient, levels: levels.to_vec() };
                dear.halving(settings).into_iter().map(|way| (way.setting, way.to)).collect()
            };
        let told = |ways: &[(&str, f64)]| -> Vec<(String, f64)> {
            ways.iter().map(|(setting, to)| ((*setting).to_owned(), *to)).collect()
        };
        // 20 + 80 x 24 / 64 = 50; 20 + 80 x 0.617^2 = 50.5; 40 + 60 x 5 / 32 = 49.4.
        let plain = ways(whole, pixels, 60.0, &[], &settings);
        assert_eq!(plain, told(&[("spp", 24.0), ("width", 617.0), ("ambient-divisions", 2.0)]));
        // Of 768 rays 296 are allowed; the next fewer that are ever used are 192.
        let cached = ways(100.0, 10.0, 0.0, &[80.0], &settings);
        assert_eq!(cached, told(&[("width", 557.0), ("cache-rays", 192.0)]));
        // The second bounce gathers with a quarter: 48 of 192, and not less.
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
        // Two samples of four leave a little more than half, and are half all the same.
        let four = RenderSettings { spp: 4, ..settings };
        assert_eq!(ways(100.0, 99.2, 0.0, &[], &four)[0], ("spp".to_owned(), 2.0));
    }

    #[test]
    fn the_work_of_rays_is_that_of_pixels_as_profiled_and_all_of_the_cache() {
        let shown = |pixels, samples, work, by_ray| {
            let profiled = ProfiledWork { by_ray, ..ProfiledWork::default() };
            ShownWork { shows: None, pixels, samples, work, profiled }
        };
        let spent = |work| crate::Spent { work, cpu_nanos: 0 };
        let amounts = |by_ray: [f64; 7]| Amounts {
            frame: None,
            work: 200.0,
            // The second was not profiled: it is like all that were.
            pixels: vec![shown(10, 2, 80.0, by_ray), shown(5, 0, 40.0, [0.0; 7])],
            told_apart: true,
            records_work: vec![50.0],
            fixed: Some(FixedCosts {
                plan: spent(6),
                load: spent(2),
                build: spent(2),
                ..FixedCosts::default()
            }),
            shares_cache: false,
            rays: [15.0, 20.0, 0.0, 0.0, 0.0, 30.0, 0.0],
            uncovered: None,
        };
        let settings = RenderSettingsRequest::default().complete((10, 10));
        let explained = Explanation::new(amounts([1.0, 2.0, 0.0, 0.0, 0.0, 1.0, 0.0]), &settings);
        let told = |explained: &Explanation| -> Vec<(String, Option<f64>)> {
            explained.rays.iter().map(|ray| (ray.category.clone(), ray.share_of_work)).collect()
        };
        let expected = [("ambient", 0.49), ("shadow", 0.3), ("primary", 0.15)];
        assert_eq!(told(&explained), expected.map(|(name, share)| (name.to_owned(), Some(share))));
        assert!(
            explained
                .words
                .iter()
                .any(|line| line.starts_with("of the work is 49.0 % for ambient rays, 30.0 %"))
        );
        let unknown = Explanation::new(amounts([0.0; 7]), &settings);
        let expected = ["ambient", "shadow", "primary"].map(|name| (name.to_owned(), None));
        assert_eq!(told(&unknown), expected);
        assert!(unknown.words.iter().any(|line| line.starts_with("of the rays are 46.2 % ambient")));
    }

    #[test]
    fn gathers_that_the_first_samples_of_a_pixel_have_are_in_no_further_one() {
        // 24 rays in the first sample, 12 in the second, 8, 6, 4, and 4 in all others: 20, 28, 32, 34, 34 above those.
        let uncovered = Some(UncoveredGathers { first: 24, least: 4 });
        let samples = |now| Samples { work: 80.0, extra: 40.0, now, uncovered };
        assert!((samples(1).with(2) - (80.0 + 56.0)).abs() < 1e-9);
        assert!((samples(8).with(9) - 85.0).abs() < 1e-9, "one more is an eighth of what is in proportion");
        let profiled = |work, extra| {
            let mut profiled = ProfiledWork::default();
            profiled.note_extra(work, extra);
            profiled
        };
        let shown = |work, profiled| ShownWork { shows: None, pixels: 1, samples: 1, work, profiled };
        // The last is like both others together.
        let pixels =
            [shown(10.0, profiled(4, 2)), shown(30.0, profiled(6, 0)), shown(20.0, ProfiledWork::default())];
        assert!((extra_work(&pixels) - (5.0 + 4.0)).abs() < 1e-9);
        assert_eq!(extra_work(&pixels[2..]), 0.0);
    }
}

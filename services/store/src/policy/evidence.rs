//! What a result may say: CPU time that its leases leave room for, work that a machine does in that time, and
//! files that are what they are named.
//!
//! The bounds are wide. An honest result never meets them; a forged one is told why it is refused. What is
//! within them is believed.

use forelight_protocol::{
    ArtifactHash, FinishedPart, FinishedPixels, FixedCosts, ProcessCosts, ProfileResult, RenderArtifacts,
    RenderStats, Spent, TaskResult, TaskSpec,
};
use imagesize::ImageType;

/// Clocks of two machines and two kinds of time differ by at most this factor.
const CLOCKS: f64 = 1.25;

/// CPU time of each core that may be counted outside of the lease, in nanoseconds: a second.
const SLACK_NANOS: f64 = 1e9;

/// Work that the reference core does in a CPU second.
const REFERENCE_RATE: f64 = 1e9;

/// A frame does at most this many times the work that the speed of its node predicts.
const ABOVE_SPEED: f64 = 20.0;

/// No core does more work than this in a CPU second: a hundred times the reference core.
const FASTEST_RATE: f64 = 1e11;

/// What a process pays once for a shot may have been paid before the lease: at most a day of each core.
const ONCE_NANOS: f64 = 86_400e9;

/// Why a result is not possible.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Objection {
    /// JSON pointer to the field.
    pub pointer: String,
    /// The reason.
    pub reason: String,
}

/// What the attempts at a task could do.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) struct Means {
    /// Time of all attempts, each times the cores of its node, in microseconds.
    pub core_micros: i64,
    /// Cores of the node.
    pub cores: u32,
    /// CPU time that the task may have taken over from its profile, in nanoseconds.
    pub taken_over_nanos: u64,
    /// Speed of a core of the node for the job, relative to the reference core.
    pub speed: f64,
}

impl Means {
    /// The most CPU time, in nanoseconds.
    fn cpu_nanos(&self) -> f64 {
        let own = self.core_micros.max(0) as f64 * 1e3;
        CLOCKS * own + SLACK_NANOS * f64::from(self.cores) + self.taken_over_nanos as f64
    }

    /// The most work in so much CPU time.
    fn work(&self, cpu_nanos: f64) -> f64 {
        let rate = (ABOVE_SPEED * self.speed.max(1.0) * REFERENCE_RATE).min(FASTEST_RATE);
        (cpu_nanos + SLACK_NANOS) * 1e-9 * rate
    }
}

/// A cost that a result claims.
struct Claim {
    pointer: String,
    cpu_nanos: f64,
    work: f64,
    /// Whether it may have been paid before the lease.
    once: bool,
}

/// Checks the costs of a result. `None` if all are possible.
pub(crate) fn objection(result: &TaskResult, means: &Means) -> Option<Objection> {
    first_impossible(claims(result), means)
}

/// Checks the cost of the finished pixels of a running frame.
pub(crate) fn pixels_objection(pixels: &FinishedPixels, means: &Means) -> Option<Objection> {
    let claim = sum("/pixels".to_owned(), std::iter::once((pixels.cpu_nanos, pixels.work)));
    first_impossible(vec![claim], means)
}

fn first_impossible(claims: Vec<Claim>, means: &Means) -> Option<Objection> {
    claims.into_iter().find_map(|claim| {
        let before = if claim.once { ONCE_NANOS * f64::from(means.cores) } else { 0.0 };
        let most = means.cpu_nanos() + before;
        if claim.cpu_nanos > most {
            let reason = format!(
                "{:.3} CPU seconds in a lease that leaves room for {:.3} on {} cores",
                claim.cpu_nanos * 1e-9,
                most * 1e-9,
                means.cores
            );
            return Some(Objection { pointer: claim.pointer, reason });
        }
        let most = means.work(claim.cpu_nanos);
        (claim.work > most).then(|| Objection {
            reason: format!(
                "{:.3e} units of work in {:.3} CPU seconds; a core of this node does at most {most:.3e}",
                claim.work,
                claim.cpu_nanos * 1e-9
            ),
            pointer: claim.pointer,
        })
    })
}

fn claims(result: &TaskResult) -> Vec<Claim> {
    match result {
        TaskResult::Preview(result) => vec![spent("/result/preview/spent", result.spent)],
        TaskResult::Profile(result) => profile(result),
        TaskResult::Measured(result) => {
            const AT: &str = "/result/measured";
            // Those of amount 0 are the fixed costs, which are in all others.
            let parts = result.costs.iter().filter(|cost| cost.amount > 0).map(|cost| cost.cpu_nanos);
            let shares = result.shares.iter().map(|share| share.cpu_nanos);
            let strata = result.strata.iter().map(|stratum| stratum.nanos);
            let fixed = result.fixed.iter().map(|part| part.cpu_nanos);
            vec![
                spent(&format!("{AT}/spent"), result.spent),
                sum(format!("{AT}/costs"), parts.map(|nanos| (nanos, 0))),
                sum(format!("{AT}/fixed"), fixed.map(|nanos| (nanos, 0))),
                sum(format!("{AT}/shares"), shares.map(|nanos| (nanos, 0))),
                sum(format!("{AT}/strata"), strata.map(|nanos| (nanos, 0))),
            ]
        }
        TaskResult::CachePlan(result) => vec![spent("/result/cache_plan/spent", result.spent)],
        TaskResult::CacheFill(result) => vec![spent("/result/cache_fill/spent", result.spent)],
        TaskResult::CacheMerge(result) => vec![spent("/result/cache_merge/spent", result.spent)],
        TaskResult::Divide(result) => vec![spent("/result/divide/spent", result.spent)],
        TaskResult::RenderPart(result) => {
            let mut claims = vec![paid_once("/result/render_part/spent".to_owned(), result.spent)];
            if let FinishedPart::Pixels(pixels) = &result.finished {
                claims.push(spent("/result/render_part/finished/pixels/cost", pixels.cost));
            }
            claims
        }
        TaskResult::Render(result) => render(&result.stats),
        TaskResult::Video(result) => vec![spent("/result/video/spent", result.spent)],
    }
}

fn profile(result: &ProfileResult) -> Vec<Claim> {
    const AT: &str = "/result/profile";
    // What denoising will cost is a forecast for the whole image: nobody has spent it.
    let FixedCosts { load, build, plan, write, denoise: _, plan_rays: _ } = result.fixed;
    let samples = result.samples.iter().map(|sample| (sample.cpu_nanos, sample.work));
    let shared = result.shared_samples.iter().map(|sample| (sample.cpu_nanos, sample.work));
    let records = result.cache_samples.iter().chain(&result.shared_cache_samples);
    let records = records.map(|sample| (sample.cpu_nanos, sample.work));
    let mut claims = vec![
        spent(&format!("{AT}/spent"), result.spent),
        sum(format!("{AT}/samples"), samples),
        sum(format!("{AT}/shared_samples"), shared),
        sum(format!("{AT}/cache_samples"), records),
        spent(&format!("{AT}/fixed/plan"), plan),
        spent(&format!("{AT}/fixed/write"), write),
    ];
    // A scene that stays open was loaded for an earlier task.
    let opened = [("load", load), ("build", build)];
    claims.extend(opened.map(|(name, cost)| paid_once(format!("{AT}/fixed/{name}"), cost)));
    claims.extend(once(AT, result.once));
    claims
}

fn render(stats: &RenderStats) -> Vec<Claim> {
    const AT: &str = "/result/render/stats";
    let claim = |name: &str, work: u64| Claim {
        pointer: format!("{AT}/{name}"),
        cpu_nanos: stats.cpu_seconds * 1e9,
        work: work as f64,
        once: false,
    };
    let all = [claim("cpu_seconds", 0), claim("work", stats.work)];
    all.into_iter().chain(once(AT, stats.once)).collect()
}

fn once(at: &str, costs: Option<ProcessCosts>) -> Vec<Claim> {
    let ProcessCosts { load, build } = costs.unwrap_or_default();
    [("load", load), ("build", build)].map(|(name, cost)| paid_once(format!("{at}/once/{name}"), cost)).into()
}

fn paid_once(pointer: String, cost: Spent) -> Claim {
    Claim { once: true, ..spent(&pointer, cost) }
}

fn spent(pointer: &str, cost: Spent) -> Claim {
    sum(pointer.to_owned(), std::iter::once((cost.cpu_nanos, cost.work)))
}

fn sum(pointer: String, costs: impl Iterator<Item = (u64, u64)>) -> Claim {
    let (cpu_nanos, work) =
        costs.fold((0.0, 0.0), |(cpu, all), (nanos, work)| (cpu + nanos as f64, all + work as f64));
    Claim { pointer, cpu_nanos, work, once: false }
}

/// What an artefact of a result must be.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Kind {
    Png,
    OpenExr,
    /// An image in any format that is known: of a renderer that chooses it.
    Image,
    Mp4,
}

/// An artefact of a result that must be an image or a video.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct ExpectedFile {
    pub pointer: String,
    pub hash: ArtifactHash,
    pub kind: Kind,
    /// Width and height in pixels, where the task says so.
    pub size: Option<(u32, u32)>,
}

/// The images and videos among the artefacts of a result.
pub(crate) fn expected_files(spec: &TaskSpec, result: &TaskResult) -> Vec<ExpectedFile> {
    let png = |pointer: String, hash| ExpectedFile { pointer, hash, kind: Kind::Png, size: None };
    match (spec, result) {
        (_, TaskResult::Preview(result)) => {
            let images = result.frames.iter().enumerate().filter_map(|(i, frame)| {
                Some(png(format!("/result/preview/frames/{i}/preview_png"), frame.preview_png?))
            });
            images.collect()
        }
        (_, TaskResult::Profile(result)) => {
            let image = result.artifacts.preview_png;
            image
                .map(|hash| png("/result/profile/artifacts/preview_png".to_owned(), hash))
                .into_iter()
                .collect()
        }
        (_, TaskResult::Measured(result)) => {
            let image = result.preview_png.map(|hash| png("/result/measured/preview_png".to_owned(), hash));
            image.into_iter().collect()
        }
        (TaskSpec::Render(spec), TaskResult::Render(result)) => {
            let RenderArtifacts { image_exr, image_png, cost_map_png, preview_png } = result.artifacts;
            let at = |name: &str| format!("/result/render/artifacts/{name}");
            let size = spec.settings.size();
            let kind = if spec.renderer.is_some() { Kind::Image } else { Kind::OpenExr };
            let image = ExpectedFile { pointer: at("image_exr"), hash: image_exr, kind, size };
            let of_size = |name, hash| ExpectedFile { size, ..png(at(name), hash) };
            let whole = [image, of_size("image_png", image_png), of_size("cost_map_png", cost_map_png)];
            whole.into_iter().chain(preview_png.map(|hash| png(at("preview_png"), hash))).collect()
        }
        (_, TaskResult::Video(result)) => {
            let pointer = "/result/video/file/hash".to_owned();
            vec![ExpectedFile { pointer, hash: result.file.hash, kind: Kind::Mp4, size: None }]
        }
        _ => Vec::new(),
    }
}

impl ExpectedFile {
    /// Holds the first bytes of the file against what it must be.
    pub(crate) fn objection(&self, head: &[u8]) -> Option<Objection> {
        let objection = |reason| Some(Objection { pointer: self.pointer.clone(), reason });
        let name = match self.kind {
            Kind::Png => "a PNG image",
            Kind::OpenExr => "an OpenEXR image",
            Kind::Image => "an image",
            Kind::Mp4 => "a video",
        };
        let found = imagesize::image_type(head).ok();
        let fits = match self.kind {
            Kind::Png => found == Some(ImageType::Png),
            Kind::OpenExr => found == Some(ImageType::Exr),
            Kind::Image => found.is_some(),
            // ISO/IEC 14496-12: the first box says what the file is.
            Kind::Mp4 => head.get(4..8) == Some(b"ftyp"),
        };
        if !fits {
            return objection(format!("artefact {} is not {name}", self.hash));
        }
        // The pixels of another renderer may be a part of the image.
        if (self.kind, found) == (Kind::Image, Some(ImageType::Exr)) {
            return None;
        }
        let (Some((width, height)), Ok(found)) = (self.size, imagesize::blob_size(head)) else { return None };
        if (found.width, found.height) == (width as usize, height as usize) {
            return None;
        }
        objection(format!(
            "the image has {} × {} pixels; the task asks for {width} × {height}",
            found.width, found.height
        ))
    }
}

#[cfg(test)]
mod tests {
    use forelight_protocol::{
        ByClass, FrameRate, JobId, MeasuredFrame, Rays, RendererId, SampleCost, Varied, VideoFile,
        VideoResult, VideoSpec,
    };

    use super::*;

    /// An hour on two cores of a node of speed 1.
    const HOUR: Means = Means { core_micros: 7_200_000_000, cores: 2, taken_over_nanos: 0, speed: 1.0 };

    fn rendered(cpu_seconds: f64, work: u64) -> TaskResult {
        let stats = RenderStats {
            frame: 0,
            width: 8,
            height: 8,
            spp: 1,
            allotted: None,
            denoised: None,
            effects: Vec::new(),
            left_out: Vec::new(),
            rays: Rays::default(),
            cache_records: Vec::new(),
            cache: None,
            cache_choice: None,
            work,
            work_by_class: None::<ByClass>,
            work_by_ray: None,
            cpu_seconds,
            once: None,
            wall_seconds: 1.0,
            peak_rss_bytes: 0,
            reused_pixels: 0,
            reused_rays: 0,
            reused_work: 0,
            reused_cpu_seconds: 0.0,
        };
        let hash = ArtifactHash([0; 32]);
        let artifacts =
            RenderArtifacts { image_exr: hash, image_png: hash, cost_map_png: hash, preview_png: None };
        TaskResult::Render(forelight_protocol::RenderResult { stats, artifacts })
    }

    fn pointer(result: &TaskResult, means: &Means) -> Option<String> {
        objection(result, means).map(|objection| objection.pointer)
    }

    #[test]
    fn cpu_time_is_at_most_that_of_all_cores_and_what_was_taken_over() {
        assert_eq!(pointer(&rendered(7200.0, 0), &HOUR), None);
        assert_eq!(pointer(&rendered(1.3 * 7200.0, 0), &HOUR).unwrap(), "/result/render/stats/cpu_seconds");
        let taken_over = Means { taken_over_nanos: 3_600_000_000_000, ..HOUR };
        assert_eq!(pointer(&rendered(1.3 * 7200.0, 0), &taken_over), None);
        assert!(objection(&rendered(1e12, 0), &HOUR).unwrap().reason.contains("2 cores"));
    }

    /// A frame of Cycles with these measured costs: amounts and nanoseconds.
    fn measured(costs: &[(u32, u64)]) -> TaskResult {
        TaskResult::Measured(MeasuredFrame {
            frame: 0,
            renderer: RendererId { name: "cycles".into(), version: "5.0.1".into() },
            varied: Varied::Samples,
            whole: 64,
            costs: costs.iter().map(|&(amount, cpu_nanos)| SampleCost { amount, cpu_nanos }).collect(),
            fixed: Vec::new(),
            strata: Vec::new(),
            shares: Vec::new(),
            preview_png: Some(ArtifactHash([7; 32])),
            spent: Spent::default(),
            peak_memory_bytes: 0,
        })
    }

    #[test]
    fn fixed_costs_of_a_measured_frame_count_once() {
        // 50 minutes to prepare the scene, and 20 for a sample, on one core.
        const MINUTE: u64 = 60_000_000_000;
        let means = Means { core_micros: 4_200_000_000, cores: 1, ..HOUR };
        assert_eq!(pointer(&measured(&[(1, 70 * MINUTE), (0, 50 * MINUTE)]), &means), None);
        let twice = measured(&[(1, 70 * MINUTE), (1, 70 * MINUTE)]);
        assert_eq!(pointer(&twice, &means).unwrap(), "/result/measured/costs");
    }

    #[test]
    fn the_preview_of_a_measured_frame_is_a_png() {
        let spec =
            VideoSpec { job_id: JobId::new(), frames_per_second: FrameRate::FILM, pictures: Vec::new() };
        let found = expected_files(&TaskSpec::Video(spec), &measured(&[]));
        let [picture] = &found[..] else { panic!("{found:?}") };
        assert_eq!((picture.pointer.as_str(), picture.kind), ("/result/measured/preview_png", Kind::Png));
    }

    #[test]
    fn work_is_at_most_what_the_node_does_in_the_claimed_time_and_any_core_can() {
        assert_eq!(pointer(&rendered(100.0, 100_000_000_000), &HOUR), None);
        assert_eq!(pointer(&rendered(100.0, 1 << 62), &HOUR).unwrap(), "/result/render/stats/work");
        // A node that says it is a thousand times as fast as any other is not believed.
        let boasting = Means { speed: 1000.0, ..HOUR };
        assert_eq!(pointer(&rendered(100.0, 1 << 62), &boasting).unwrap(), "/result/render/stats/work");
        assert_eq!(pointer(&rendered(100.0, 5_000_000_000_000), &boasting), None);
    }

    #[test]
    fn a_file_is_the_image_that_it_is_named_and_has_the_size_that_was_asked_for() {
        let image = |kind, size| ExpectedFile {
            pointer: "/image".to_owned(),
            hash: ArtifactHash([7; 32]),
            kind,
            size,
        };
        let png = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\0\x08\0\0\0\x04\x08\x02\0\0\0";
        let html = b"<!DOCTYPE html><html><body>an image</body></html>";
        for kind in [Kind::Png, Kind::OpenExr, Kind::Image] {
            assert!(image(kind, None).objection(html).is_some(), "{kind:?}");
            assert!(image(kind, None).objection(b"").is_some(), "{kind:?}");
        }
        assert_eq!(image(Kind::Png, Some((8, 4))).objection(png), None);
        assert_eq!(image(Kind::Image, Some((8, 4))).objection(png), None);
        assert!(image(Kind::OpenExr, Some((8, 4))).objection(png).is_some());
        let wrong = image(Kind::Png, Some((80, 4))).objection(png).unwrap();
        assert!(wrong.reason.contains("8 × 4") && wrong.reason.contains("80 × 4"), "{}", wrong.reason);
    }

    #[test]
    fn a_video_begins_like_one() {
        let hash = ArtifactHash([7; 32]);
        let file = VideoFile { hash, bytes: 100, frames: 1 };
        let result = TaskResult::Video(VideoResult { file, spent: Spent::default(), peak_memory_bytes: 0 });
        let frames_per_second = FrameRate::FILM;
        let spec = VideoSpec { job_id: JobId::new(), frames_per_second, pictures: vec![hash] };
        let [video] = &expected_files(&TaskSpec::Video(spec), &result)[..] else { panic!("one file") };
        assert_eq!(video.objection(b"\0\0\0\x20ftypisom"), None);
        for other in [&b"\x89PNG\r\n\x1a\n"[..], b"ftyp", b""] {
            let objection = video.objection(other).unwrap();
            assert!(objection.reason.contains("is not a video"), "{objection:?}");
        }
    }
}

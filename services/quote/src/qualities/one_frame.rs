//! Applies ladders that were profiled in one frame to all frames of a job.
//!
//! The settings asked for are priced twice: for the job by all of its profiles, and for the frame as a rung.
//! The frame's ratio of another rung to that one is applied to the job (ratio estimator: Cochran, *Sampling
//! Techniques*, 3rd edition 1977, section 6.2). The node's speed cancels, and so do most differences between
//! this frame and others.
//!
//! The three uncertainties count as independent: relative distances of quantiles from their medians add as
//! squares. The two of the frame share pixels, so the true error of their ratio is smaller. No interval
//! covers how ratios differ between frames. The settings asked for use the job's profiles.

use forelight_protocol::{AccuracyDoc, AccuracyRung, ImageError, LadderKind, Quantiles, RenderSettings};

/// Least amount (operations, seconds or shares) for a ratio.
const LEAST: f64 = 1e-12;

/// Largest distance of a quantile from its median, in medians.
const WIDEST: f64 = 1e12;

/// Ladders of a frame, and the job's cost at the settings asked for.
pub(super) struct OneFrame<'a> {
    ladders: &'a AccuracyDoc,
    asked: &'a AccuracyRung,
    job: Job,
}

pub(super) struct Job {
    pub work: Quantiles,
    pub cpu_seconds: Quantiles,
    /// `None` if its profiles do not know it.
    pub error: Option<ImageError>,
}

impl<'a> OneFrame<'a> {
    /// `None` if the ladders have no cost for the settings asked for, or one that is too small.
    pub fn new(ladders: &'a AccuracyDoc, job: Job) -> Option<Self> {
        let asked = ladders.rungs.iter().find(|rung| rung.settings == ladders.settings)?;
        let prices = [asked.work.mean, asked.work.p50, asked.cpu_seconds.mean, asked.cpu_seconds.p50];
        prices.iter().all(|&price| price >= LEAST).then_some(Self { ladders, asked, job })
    }

    pub fn rungs(&self, kind: LadderKind) -> impl Iterator<Item = AccuracyRung> {
        self.of(kind).map(|rung| {
            let asked_for = self.is_asked_for(rung);
            let price = |of: fn(&AccuracyRung) -> &Quantiles, job: Quantiles| {
                if asked_for { job } else { ratio(of(rung), of(self.asked), &job) }
            };
            AccuracyRung {
                asked_for,
                work: price(|rung| &rung.work, self.job.work),
                cpu_seconds: price(|rung| &rung.cpu_seconds, self.job.cpu_seconds),
                error: self.error(rung),
                worth_taking: false,
                next: None,
                measured: None,
                ..rung.clone()
            }
        })
    }

    pub fn rung(&self, kind: LadderKind, settings: &RenderSettings) -> Option<AccuracyRung> {
        self.rungs(kind).find(|rung| rung.settings == *settings)
    }

    /// Error of a rung. Pixels of another resolution have the error of those asked for.
    pub fn error_like(&self, kind: LadderKind, settings: &RenderSettings) -> Option<ImageError> {
        let own = || self.of(kind).find(|rung| rung.settings == *settings);
        self.error(if kind == LadderKind::Resolution { self.asked } else { own()? })
    }

    fn of(&self, kind: LadderKind) -> impl Iterator<Item = &AccuracyRung> {
        self.ladders.rungs.iter().filter(move |rung| rung.ladder == kind)
    }

    fn is_asked_for(&self, rung: &AccuracyRung) -> bool {
        rung.settings == self.ladders.settings
    }

    /// Error of a rung for the job, or for the frame if the job's error is unknown.
    fn error(&self, rung: &AccuracyRung) -> Option<ImageError> {
        let own = rung.error?;
        match (self.asked.error, self.job.error) {
            (_, Some(job)) if self.is_asked_for(rung) => Some(job),
            (Some(asked), Some(job)) if [asked.p50, own.p50, job.p50].iter().all(|&error| error >= LEAST) => {
                let p50 = job.p50 * (own.p50 / asked.p50);
                let at = |quantile: fn(&ImageError) -> f64, side: f64| {
                    let relative = [own, asked, job].map(|error| quantile(&error) / error.p50);
                    (p50 * (1.0 + side * spread(relative))).max(0.0)
                };
                Some(ImageError {
                    p05: at(|error| error.p05, -1.0),
                    p50,
                    p80: at(|error| error.p80, 1.0),
                    p95: at(|error| error.p95, 1.0),
                })
            }
            _ => Some(own),
        }
    }
}

/// `job` times the ratio of `rung` to `asked`.
fn ratio(rung: &Quantiles, asked: &Quantiles, job: &Quantiles) -> Quantiles {
    let p50 = job.p50 * (rung.p50 / asked.p50);
    let at = |quantile: fn(&Quantiles) -> f64| {
        let relative = |of: &Quantiles| if of.p50 > 0.0 { quantile(of) / of.p50 } else { 1.0 };
        p50 * (1.0 + spread([rung, asked, job].map(relative)))
    };
    Quantiles {
        mean: job.mean * (rung.mean / asked.mean),
        p50,
        p80: at(|price| price.p80),
        p95: at(|price| price.p95),
    }
}

/// Joint distance of quantiles, relative to their medians. Always finite.
fn spread(relative: [f64; 3]) -> f64 {
    let squares = relative.map(|relative| (relative - 1.0).powi(2));
    squares.iter().sum::<f64>().sqrt().min(WIDEST)
}

#[cfg(test)]
mod tests {
    use super::super::ladder::{ladder, without_ladders};
    use super::*;
    use forelight_protocol::RenderSettingsRequest;

    fn quantiles(mean: f64, p50: f64, p80: f64, p95: f64) -> Quantiles {
        Quantiles { mean, p50, p80, p95 }
    }

    #[test]
    fn ratios_are_brought_over_and_uncertainties_add_up_as_squares() {
        // 0.1, 0.2 and 0.2 of the medians, then twice that.
        let (asked, rung) = (quantiles(11.0, 10.0, 11.0, 12.0), quantiles(33.0, 20.0, 24.0, 28.0));
        let found = ratio(&rung, &asked, &quantiles(110.0, 100.0, 120.0, 140.0));
        assert!((found.mean - 330.0).abs() < 1e-9 && (found.p50 - 200.0).abs() < 1e-9, "{found:?}");
        assert!((found.p80 - 260.0).abs() < 1e-9 && (found.p95 - 320.0).abs() < 1e-9, "{found:?}");
        let certain = quantiles(5.0, 5.0, 5.0, 5.0);
        assert_eq!(ratio(&certain, &certain, &certain), certain);
        let wild = ratio(&quantiles(1e30, 1e-300, 1e30, 1e30), &quantiles(1e-12, 1e-12, 0.0, 0.0), &certain);
        assert!(
            [wild.mean, wild.p50, wild.p80, wild.p95].iter().all(|number| number.is_finite()),
            "{wild:?}"
        );
    }

    #[test]
    fn what_was_asked_for_is_what_the_job_says_and_nothing_wider() {
        let settings =
            RenderSettingsRequest { spp: Some(4), ..RenderSettingsRequest::default() }.complete((8, 8));
        let error = |p50| ImageError { p05: 0.8 * p50, p50, p80: 1.1 * p50, p95: 1.3 * p50 };
        let price = quantiles(11.0, 10.0, 12.0, 14.0);
        let mut document = without_ladders(0, &settings, "");
        document.rungs = ladder(LadderKind::Divisions, &settings)
            .unwrap()
            .into_iter()
            .map(|settings| AccuracyRung {
                ladder: LadderKind::Divisions,
                asked_for: false,
                settings,
                work: price,
                cpu_seconds: price,
                error: Some(error(0.1)),
                denoised_error: Some(error(0.04)),
                worth_taking: false,
                next: None,
                measured: None,
            })
            .collect();
        let job = quantiles(90.0, 80.0, 100.0, 120.0);
        let frame = |error| OneFrame::new(&document, Job { work: job, cpu_seconds: job, error }).unwrap();
        let known = frame(Some(error(0.2)));
        let (asked, others): (Vec<_>, Vec<_>) =
            known.rungs(LadderKind::Divisions).partition(|rung| rung.asked_for);
        assert_eq!(asked.len(), 1);
        assert_eq!((asked[0].work, asked[0].cpu_seconds, asked[0].error), (job, job, Some(error(0.2))));
        // What a denoiser leaves is measured in the frame alone, and does not follow from the noise.
        assert_eq!(asked[0].denoised_error, Some(error(0.04)));
        for rung in others {
            let found = rung.error.unwrap();
            assert!(rung.work.p50 == job.p50 && rung.work.p95 > job.p95, "{:?}", rung.work);
            assert!(
                found.p50 == 0.2 && found.p05 < error(0.2).p05 && found.p95 > error(0.2).p95,
                "{found:?}"
            );
        }
        // Other resolutions have the error of the settings asked for, not of their first rung.
        let larger = RenderSettings { width: 16, ..settings.clone() };
        assert_eq!(known.error_like(LadderKind::Resolution, &larger), Some(error(0.2)));
        assert_eq!(frame(None).error_like(LadderKind::Resolution, &larger), Some(error(0.1)));
        assert_eq!(known.error_like(LadderKind::Path, &settings), None);
    }
}

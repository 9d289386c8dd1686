//! What the ladders of one frame say of all frames of its job.
//!
//! The settings that were asked for are priced twice: for the job, by all its profiles, and for the frame, as a rung. What another rung of the
//! frame takes, and errs, beside that is brought to the job as a ratio (ratio estimator: Cochran, *Sampling Techniques*, 3rd edition
//! 1977, section 6.2): the speed of the node that measured it falls out, and so does most of what sets the frame apart from the others.
//! The two are taken as independent: relative distances of quantiles from their medians add up as squares. They rest in part on the same pixels,
//! so that intervals are rather too wide.

use forelight_protocol::{AccuracyDoc, AccuracyRung, ImageError, LadderKind, MissingLadder, Quantiles};

/// What is held against others is at least this: operations, seconds or shares.
const LEAST: f64 = 1e-12;

/// No quantile lies so many medians from its median.
const WIDEST: f64 = 1e12;

/// The ladders of a frame, beside what is known of the job as it was asked for.
pub(super) struct OneFrame<'a> {
    ladders: &'a AccuracyDoc,
    asked: &'a AccuracyRung,
    job: Job,
}

/// A job as it was asked for.
pub(super) struct Job {
    pub work: Quantiles,
    pub cpu_seconds: Quantiles,
    /// Unknown where its profiles cannot tell.
    pub error: Option<ImageError>,
}

impl<'a> OneFrame<'a> {
    /// Nothing if the ladders do not price what was asked for, or next to nothing: there is nothing to hold the others against.
    pub fn new(ladders: &'a AccuracyDoc, job: Job) -> Option<Self> {
        let asked = ladders.rungs.iter().find(|rung| rung.settings == ladders.settings)?;
        let prices = [asked.work.mean, asked.work.p50, asked.cpu_seconds.mean, asked.cpu_seconds.p50];
        prices.iter().all(|&price| price >= LEAST).then_some(Self { ladders, asked, job })
    }

    /// The rungs of a ladder, for all frames.
    pub fn rungs(&self, kind: LadderKind) -> impl Iterator<Item = AccuracyRung> {
        self.of(kind).map(|rung| AccuracyRung {
            asked_for: rung.settings == self.ladders.settings,
            work: ratio(&rung.work, &self.asked.work, &self.job.work),
            cpu_seconds: ratio(&rung.cpu_seconds, &self.asked.cpu_seconds, &self.job.cpu_seconds),
            error: self.error(rung),
            worth_taking: false,
            next: None,
            measured: None,
            ..rung.clone()
        })
    }

    /// The error of a rung with so many camera samples.
    pub fn error_with(&self, kind: LadderKind, spp: u32) -> Option<ImageError> {
        self.error(self.of(kind).find(|rung| rung.settings.spp == spp)?)
    }

    /// What is missing of a ladder.
    pub fn missing(&self, kind: LadderKind) -> impl Iterator<Item = MissingLadder> {
        self.ladders.missing.iter().filter(move |missing| missing.ladder == kind).cloned()
    }

    fn of(&self, kind: LadderKind) -> impl Iterator<Item = &AccuracyRung> {
        self.ladders.rungs.iter().filter(move |rung| rung.ladder == kind)
    }

    /// Of the frame itself, where the error of the job is not known as it was asked for.
    fn error(&self, rung: &AccuracyRung) -> Option<ImageError> {
        let own = rung.error?;
        match (self.asked.error, self.job.error) {
            (Some(asked), Some(job)) if [asked.p50, own.p50, job.p50].iter().all(|&error| error >= LEAST) => {
                let p50 = job.p50 * (own.p50 / asked.p50);
                let at = |quantile: fn(&ImageError) -> f64, side: f64| {
                    let spread = spread([quantile(&own) / own.p50, quantile(&job) / job.p50]);
                    (p50 * (1.0 + side * spread)).max(0.0)
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

/// So many times `job` as `rung` is `asked`.
fn ratio(rung: &Quantiles, asked: &Quantiles, job: &Quantiles) -> Quantiles {
    let p50 = job.p50 * (rung.p50 / asked.p50);
    let at = |quantile: fn(&Quantiles) -> f64| {
        let relative = |of: &Quantiles| if of.p50 > 0.0 { quantile(of) / of.p50 } else { 1.0 };
        p50 * (1.0 + spread([relative(rung), relative(job)]))
    };
    Quantiles {
        mean: job.mean * (rung.mean / asked.mean),
        p50,
        p80: at(|price| price.p80),
        p95: at(|price| price.p95),
    }
}

/// How far quantiles, over their medians, lie from these together; a number whatever they are.
fn spread(relative: [f64; 2]) -> f64 {
    let squares = relative.map(|relative| (relative - 1.0).powi(2));
    squares.iter().sum::<f64>().sqrt().min(WIDEST)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ratios_are_brought_over_and_uncertainties_add_up_as_squares() {
        let quantiles = |mean, p50, p80, p95| Quantiles { mean, p50, p80, p95 };
        let (asked, rung) = (quantiles(11.0, 10.0, 12.0, 14.0), quantiles(33.0, 20.0, 26.0, 32.0));
        let found = ratio(&rung, &asked, &quantiles(110.0, 100.0, 140.0, 180.0));
        assert!((found.mean - 330.0).abs() < 1e-9 && (found.p50 - 200.0).abs() < 1e-9, "{found:?}");
        // 0.3 and 0.4, 0.6 and 0.8.
        assert!((found.p80 - 300.0).abs() < 1e-9 && (found.p95 - 400.0).abs() < 1e-9, "{found:?}");
        let certain = quantiles(5.0, 5.0, 5.0, 5.0);
        assert_eq!(ratio(&certain, &certain, &certain), certain);
        let wild = ratio(&quantiles(1e30, 1e-300, 1e30, 1e30), &quantiles(1e-12, 1e-12, 0.0, 0.0), &certain);
        assert!(
            [wild.mean, wild.p50, wild.p80, wild.p95].iter().all(|number| number.is_finite()),
            "{wild:?}"
        );
    }
}

//! Other qualities of a job, each planned around the bookings.

use forelight_planner as planner;
use forelight_planner::Booking;
use forelight_protocol::{
    AccuracyRung, CacheMode, JobVerdict, Money, PlanChange, PlanEffect, QualityOffer, RenderSettings,
    Timestamp, Verdict,
};

use super::AdvanceError;
use super::effects::priced;
use super::farm::Farm;
use super::quantities::{times, total};
use super::risks::{Risk, risk};
use super::settle::end;

pub(crate) struct Offered {
    pub offer: QualityOffer,
    words: String,
}

impl Offered {
    /// The quality as a way out of a verdict, whose cost includes what the job has `spent`.
    pub fn way_out(&self, verdict: &JobVerdict, spent: i64) -> Option<PlanEffect> {
        let cost = verdict.cost.unwrap_or_default().micro_units().saturating_sub(spent);
        (verdict.verdict != Verdict::OnTime).then(|| self.way(cost)).flatten()
    }

    /// The quality as a change of a job with this cost. `None` if it does not fit or changes nothing.
    pub fn way(&self, cost: i64) -> Option<PlanEffect> {
        (!self.offer.asked_for && self.offer.fits).then(|| self.effect(cost))
    }

    /// The quality as a change of a job with this cost.
    pub fn effect(&self, cost: i64) -> PlanEffect {
        let QualityOffer { settings, finish, cost: less, fits, .. } = &self.offer;
        let added = less.micro_units().saturating_sub(cost);
        PlanEffect {
            change: PlanChange::Quality {
                spp: settings.spp,
                width: settings.width,
                height: settings.height,
                settings: Some(Box::new(settings.clone())),
            },
            words: format!("{}: {}", self.words, priced(added)),
            added_cost: Money(added),
            finish: *finish,
            in_time: *fits,
            moved: Vec::new(),
        }
    }
}

/// Other qualities of the job around the bookings: smallest error first, then those of unknown error, dearer
/// first. Finished frames stay. Each quality is planned when the iterator reaches it.
pub(crate) fn qualities<'a>(
    farm: &'a Farm,
    job: usize,
    standing: &'a [Booking],
    rungs: &'a [AccuracyRung],
) -> impl Iterator<Item = Result<Offered, AdvanceError>> + 'a {
    let own = rungs.iter().find(|rung| rung.asked_for).filter(|rung| rung.cpu_seconds.p50 > 0.0);
    let mut best_first: Vec<&AccuracyRung> = Vec::new();
    for rung in rungs.iter().filter(|_| own.is_some()) {
        // A quality on several ladders is offered once.
        if best_first.iter().all(|other| other.settings != rung.settings) {
            best_first.push(rung);
        }
    }
    best_first.sort_by(|a, b| {
        let error = |rung: &AccuracyRung| rung.delivered_error().map_or(f64::INFINITY, |error| error.p50);
        let pixels = b.settings.pixels().cmp(&a.settings.pixels());
        pixels.then(error(a).total_cmp(&error(b))).then(b.cpu_seconds.p50.total_cmp(&a.cpu_seconds.p50))
    });
    let around = farm.around(job, standing);
    let offered = best_first.into_iter().zip(own.into_iter().cycle());
    offered.map(move |(rung, own)| offer(farm, job, &around, own, rung))
}

fn offer(
    farm: &Farm,
    job: usize,
    around: &planner::Input,
    own: &AccuracyRung,
    rung: &AccuracyRung,
) -> Result<Offered, AdvanceError> {
    let asked = &farm.jobs[job];
    let mut input = around.clone();
    if let Some(at) = input.jobs.first_mut() {
        at_quality(at, own, rung, asked.factor);
    }
    let plan = planner::plan(&input)?;
    let finish = end(farm, &plan, job);
    let Risk { probability, .. } = risk(farm, &input, &plan, job)?;
    let within = plan.job(job as u64).is_some_and(|entry| entry.within_budget != Some(false));
    let mut words = in_words(&rung.settings, &own.settings);
    let error = rung.delivered_error();
    if let Some((error, before)) = error.zip(own.delivered_error()) {
        words += &format!(" (an error of {:.1} % instead of {:.1} %)", error.p50 * 100.0, before.p50 * 100.0);
    }
    Ok(Offered {
        offer: QualityOffer {
            settings: rung.settings.clone(),
            asked_for: rung.asked_for,
            error,
            finish: finish.map(Timestamp::from_micros),
            probability,
            cost: Money(plan.cost),
            fits: asked.is_kept(finish) && within,
        },
        words,
    })
}

fn in_words(other: &RenderSettings, own: &RenderSettings) -> String {
    let cached = |settings: &RenderSettings| settings.cache == CacheMode::On;
    let accuracy = |settings: &RenderSettings| f64::from(settings.cache_accuracy) / 1000.0;
    let mut words = Vec::new();
    if other.integrator != own.integrator {
        words.push(format!(
            "the integrator {} instead of {}",
            other.integrator.name(),
            own.integrator.name()
        ));
    }
    if cached(other) && !cached(own) {
        words.push(format!("an irradiance cache of accuracy {}", accuracy(other)));
    } else if cached(own) && !cached(other) {
        words.push("no irradiance cache".to_owned());
    } else if cached(own) && accuracy(other) != accuracy(own) {
        words.push(format!("a cache of accuracy {} instead of {}", accuracy(other), accuracy(own)));
    }
    if other.ambient_divisions != own.ambient_divisions {
        words.push(format!("{} rays a gather instead of {}", other.ambient_divisions, own.ambient_divisions));
    }
    let pixels = |settings: &RenderSettings| (settings.width, settings.height);
    if pixels(other) != pixels(own) {
        let ((width, height), (own_width, own_height)) = (pixels(other), pixels(own));
        words.push(format!("{width} × {height} pixels instead of {own_width} × {own_height}"));
    }
    if other.spp != own.spp || words.is_empty() {
        let samples = if other.spp == 1 { "sample" } else { "samples" };
        words.push(format!("{} {samples} a pixel instead of {}", other.spp, own.spp));
    }
    words.join(", ")
}

fn at_quality(job: &mut planner::Job, own: &AccuracyRung, rung: &AccuracyRung, factor: f64) {
    let by = rung.cpu_seconds.p50 / own.cpu_seconds.p50;
    let scaled = |work: u64| ((work as f64 * by).round() as u64).max(1);
    for frame in &mut job.frames {
        frame.work = scaled(frame.work);
        frame.work_p80 = scaled(frame.work_p80);
    }
    job.total = total(&times(&rung.cpu_seconds, factor));
    if rung.settings.cache == CacheMode::Off {
        // It neither pays nor waits for a shared cache.
        job.shared_cache = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_protocol::{LadderKind, Quantiles, RenderSettingsRequest};

    #[test]
    fn a_job_whose_frames_share_a_cache_does_without_it_at_qualities_that_have_none() {
        let rung = |cache, seconds| AccuracyRung {
            ladder: LadderKind::Ambient,
            settings: RenderSettingsRequest { cache: Some(cache), ..RenderSettingsRequest::default() }
                .complete((8, 8)),
            asked_for: cache == CacheMode::On,
            work: Quantiles::known(1.0),
            cpu_seconds: Quantiles::known(seconds),
            error: None,
            denoised_error: None,
            worth_taking: false,
            next: None,
            measured: None,
        };
        let job = planner::Job {
            frames: vec![planner::Frame { work: 100, work_p80: 120, ..planner::Frame::default() }],
            shared_cache: Some(planner::SharedCache::default()),
            ..planner::Job::default()
        };
        let own = rung(CacheMode::On, 2.0);
        let at = |rung: &AccuracyRung| {
            let mut job = job.clone();
            at_quality(&mut job, &own, rung, 1.0);
            job
        };
        let (coarser, without) = (at(&rung(CacheMode::On, 1.0)), at(&rung(CacheMode::Off, 6.0)));
        assert_eq!((coarser.frames[0].work, coarser.frames[0].work_p80), (50, 60));
        assert_eq!((without.frames[0].work, without.frames[0].work_p80), (300, 360));
        assert!(coarser.shared_cache.is_some() && without.shared_cache.is_none());
    }
}

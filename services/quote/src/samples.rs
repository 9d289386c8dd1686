//! Scales the cost of profiled pixels to other numbers of camera samples.

use forelight_forecast::Cost;

use crate::measured::MeasuredProfile;

/// The profiles as if traced with `spp` camera samples. A pixel costs in proportion to its samples, except
/// for gathers at uncovered points. Records and fixed costs stay the same.
pub fn with_samples(profiles: &[MeasuredProfile], spp: u32) -> Vec<MeasuredProfile> {
    profiles.iter().map(|profile| scaled(profile, f64::from(spp))).collect()
}

/// One of them. The mean number of samples need not be whole.
pub(crate) fn scaled(profile: &MeasuredProfile, samples: f64) -> MeasuredProfile {
    let mut profile = profile.clone();
    let had = profile.spp.max(1);
    let factor = samples / f64::from(had);
    let spp = (samples.round() as u32).max(1);
    let growth = profile.result.uncovered.map_or(1.0, |gathers| gathers.growth(had, spp));
    let scale = |work: &mut u64, extra: &mut u64, cpu_nanos: &mut u64, rays: &mut [u64; 7]| {
        let had = Cost { work: *work, cpu_nanos: *cpu_nanos, rays: *rays };
        let cost = had.with_samples(factor, *extra, growth);
        (*work, *cpu_nanos, *rays) = (cost.work, cost.cpu_nanos, cost.rays);
        *extra = (*extra as f64 * growth).round() as u64;
    };
    for sample in &mut profile.result.samples {
        scale(&mut sample.work, &mut sample.extra_work, &mut sample.cpu_nanos, &mut sample.rays);
    }
    for sample in &mut profile.result.shared_samples {
        scale(&mut sample.work, &mut sample.extra_work, &mut sample.cpu_nanos, &mut sample.rays);
    }
    profile.spp = spp;
    profile
}

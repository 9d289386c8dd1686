//! Why a job, or a frame of it, is dear: its quote taken apart. It is worked out from the kept profile when it is asked for; nothing
//! is traced for it.

use forelight_forecast::StratumSum;
use forelight_protocol::{Amounts, Explanation, PreviewResult, ProfiledWork, RenderSettings, ShownWork};
use forelight_store::MeasuredProfile;

use super::estimate::{Estimated, estimated, fixed_costs};
use super::job_profile::JobProfile;
use super::sharing::SharedWay;
use super::{AdvanceError, compute};

/// Of a job with these settings, or of one of its frames. What an irradiance cache takes that its frames share is no frame's, and a line of its own in
/// the quote.
pub(crate) async fn explanation(
    settings: RenderSettings,
    measured: JobProfile,
    frame: Option<u32>,
) -> Result<Explanation, AdvanceError> {
    compute(move || {
        explained(&settings, &measured.preview, &measured.profiles, measured.way().as_ref(), frame)
    })
    .await
}

pub(super) fn explained(
    settings: &RenderSettings,
    preview: &PreviewResult,
    profiles: &[MeasuredProfile],
    shared: Option<&SharedWay<'_>>,
    frame: Option<u32>,
) -> Result<Explanation, AdvanceError> {
    let Estimated { shot, populations } = estimated(preview, profiles, shared)?;
    let (total, sums) = match frame {
        None => (&shot.total, StratumSum::over(shot.frames.iter().map(|frame| &frame.strata[..]))),
        Some(number) => {
            let one = shot.frames.iter().find(|frame| frame.number == i64::from(number));
            let one = one.ok_or_else(|| AdvanceError::Hopeless(format!("the job has no frame {number}")))?;
            (&one.total, StratumSum::over(std::iter::once(&one.strata[..])))
        }
    };
    // Objects first, then the background, then the records.
    let (pixels, records) = sums.split_at((populations.background + 1).min(sums.len()));
    let shown = |(place, sum): (usize, &StratumSum)| ShownWork {
        shows: populations.names.get(place).cloned(),
        pixels: sum.pixels,
        samples: sum.samples,
        work: sum.work,
        profiled: ProfiledWork::default(),
    };
    let mut pixels: Vec<ShownWork> = pixels.iter().enumerate().map(shown).collect();
    for MeasuredProfile { result, .. } in profiles {
        for (place, sample) in result.samples.iter().enumerate() {
            if let Some(shown) = pixels.get_mut(populations.shown_by(sample, result)) {
                shown.profiled.note_rays(&sample.work_by_ray);
                match result.shared_samples.get(place).filter(|_| shared.is_some()) {
                    Some(sample) => shown.profiled.note_extra(sample.work, sample.extra_work),
                    None => shown.profiled.note_extra(sample.work, sample.extra_work),
                }
            }
        }
    }
    let amounts = Amounts {
        frame,
        work: total.work.mean,
        pixels,
        told_apart: true,
        records_work: records.iter().map(|sum| sum.work).collect(),
        fixed: fixed_costs(profiles, shared, frame),
        shares_cache: shared.is_some(),
        rays: total.rays.map(|rays| rays.mean),
        uncovered: profiles.iter().find_map(|profile| profile.result.uncovered),
    };
    Ok(Explanation::new(amounts, settings))
}

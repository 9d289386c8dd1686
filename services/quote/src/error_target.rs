//! The quote of a job whose images are rendered until their error is small enough.
//!
//! The profile of each frame says how many camera samples reach the error ([`SamplesForError`]), and what a
//! pixel costs. So a frame that is noisier than others costs more, and frames between them are estimated as
//! always. Two things are uncertain: what a pixel costs, and how noisy the image is. They count as
//! independent, so relative distances of quantiles from their medians add as squares. The noise of all frames
//! counts as fully dependent: if one is noisier than its profile says, so are the others.

use forelight_forecast::Corrections;
use forelight_protocol::{PreviewResult, Quantiles, SamplesForError};

use crate::error::QuoteError;
use crate::job_forecast::Quote;
use crate::measured::{Measured, MeasuredProfile};
use crate::samples::scaled;

/// The quote. Each profile must say what the error takes.
///
/// # Errors
/// If one does not. Also those of [`Measured::quote`].
pub fn quote_for_error(
    preview: &PreviewResult,
    profiles: &[MeasuredProfile],
    corrections: Option<&Corrections>,
) -> Result<Quote, QuoteError> {
    let with = |samples: fn(&SamplesForError) -> f64| {
        Measured::new(preview, &with_samples_at(profiles, samples)?).quote(corrections)
    };
    let mut quote = with(|needed| needed.p50)?;
    let (p80, p95) = (with(|needed| needed.p80)?, with(|needed| needed.p95)?);
    for (own, (p80, p95)) in quote.frames.iter_mut().zip(p80.frames.iter().zip(&p95.frames)) {
        widen(&mut own.work, p80.work, p95.work);
        widen(&mut own.cpu_seconds, p80.cpu_seconds, p95.cpu_seconds);
    }
    let (own, p80, p95) = (&mut quote.job.total, p80.job.total, p95.job.total);
    widen(&mut own.work, p80.work, p95.work);
    widen(&mut own.cpu_seconds, p80.cpu_seconds, p95.cpu_seconds);
    let needed = profiles.iter().filter_map(|profile| profile.result.samples_for_error);
    let mean = needed.map(|needed| needed.p50).sum::<f64>() / profiles.len().max(1) as f64;
    quote.job.chosen_spp = Some((mean.round() as u32).max(1));
    Ok(quote)
}

/// The profiles as if traced with the samples that the job's error probably takes, each with its own number.
///
/// # Errors
/// If a profile does not say how many.
pub fn with_samples_for_error(profiles: &[MeasuredProfile]) -> Result<Vec<MeasuredProfile>, QuoteError> {
    with_samples_at(profiles, |needed| needed.p50)
}

fn with_samples_at(
    profiles: &[MeasuredProfile],
    samples: fn(&SamplesForError) -> f64,
) -> Result<Vec<MeasuredProfile>, QuoteError> {
    let of = |profile: &MeasuredProfile| {
        let needed = profile.result.samples_for_error;
        let needed = needed.ok_or(QuoteError::NoSamplesForError(profile.result.frame))?;
        Ok(scaled(profile, samples(&needed)))
    };
    profiles.iter().map(of).collect()
}

/// Widens quantiles by those of the samples: the costs with the samples of the 80 % and 95 % quantiles.
fn widen(own: &mut Quantiles, p80: Quantiles, p95: Quantiles) {
    let wide = |quantile: f64, of_samples: f64| {
        own.p50 + (quantile - own.p50).hypot((of_samples - own.p50).max(0.0))
    };
    (own.p80, own.p95) = (wide(own.p80, p80.p50), wide(own.p95, p95.p50));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn independent_uncertainties_add_as_squares() {
        let mut own = Quantiles { mean: 10.0, p50: 10.0, p80: 13.0, p95: 15.0 };
        widen(&mut own, Quantiles::known(14.0), Quantiles::known(22.0));
        assert_eq!((own.mean, own.p50, own.p80, own.p95), (10.0, 10.0, 15.0, 23.0));
        widen(&mut own, Quantiles::known(9.0), Quantiles::known(9.0));
        assert_eq!((own.p80, own.p95), (15.0, 23.0), "fewer samples do not narrow anything");
    }
}

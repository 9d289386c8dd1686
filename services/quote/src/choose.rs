//! Chooses the frames to profile.

use forelight_forecast::{FIRST_FRAMES, Strategy, choose_frames, choose_more_frames};
use forelight_protocol::PreviewResult;

use crate::error::QuoteError;
use crate::estimate::Estimate;
use crate::measured::Measured;
use crate::populations::Populations;

/// The first frames to profile, ascending. At most `most`, or the usual number of them.
///
/// # Errors
/// If the preview has no frames or contradicts itself.
pub fn frames_to_profile(
    preview: &PreviewResult,
    strategy: Strategy,
    most: Option<usize>,
) -> Result<Vec<u32>, QuoteError> {
    let records: Vec<&[u32]> = preview.frames.iter().map(|frame| &frame.cache_records[..]).collect();
    let populations = Populations::new(preview, [], strategy, &records);
    let most = most.unwrap_or(FIRST_FRAMES).max(1);
    let chosen = choose_frames(&populations.strata, &populations.frames, most).map_err(QuoteError::Choice)?;
    if chosen.is_empty() {
        return Err(QuoteError::NothingChosen);
    }
    Ok(chosen.into_iter().map(|index| preview.frames[index].frame).collect())
}

impl Measured<'_> {
    /// More frames to profile, ascending. Empty if the forecast is certain enough, or if more profiles would
    /// cost too much relative to the shot ([`choose_more_frames`]).
    pub fn more_to_profile(&self) -> Result<Vec<u32>, QuoteError> {
        let Estimate { shot, populations, .. } = self.estimate()?;
        let work = self.profiles.iter().map(|profile| profile.result.work_on_pixels());
        let spent = work.fold(0, u64::saturating_add);
        let more = choose_more_frames(&populations.strata, &populations.frames, &shot, spent)
            .map_err(QuoteError::Choice)?;
        Ok(more.into_iter().map(|index| self.preview.frames[index].frame).collect())
    }
}

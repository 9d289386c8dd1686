//! What a task is given: settings, irradiance caches and finished pixels.

use crate::error::RenderError;
use crate::frame::OwnFrame;
use bytes::Bytes;
use forelight_protocol::{ArtifactHash, JobSettings, LogLevel, RenderSettings, Spent};
use forelight_renderer::{Assignment, Control, ExecuteError};
use forelight_tracer::{Cache, CacheError, Passes, Profile};

/// The settings of a task as our own renderer has them.
pub(crate) fn own(settings: &JobSettings) -> Result<&RenderSettings, ExecuteError> {
    let foreign = || ExecuteError::Permanent("the task is for another renderer".to_owned());
    settings.own().ok_or_else(foreign)
}

/// What a task of a divided frame starts with.
pub(crate) struct Start {
    /// The frame's profile, if it is of use.
    pub profile: Option<Profile>,
    /// What earlier tasks have spent on the irradiance cache.
    pub on_cache: Spent,
}

/// Gives a divided frame the irradiance caches that its task names, and reads its profile. A cache in the
/// profile is used if the frame has none of its own yet, as in a render in one piece.
pub(crate) fn start(
    ready: &OwnFrame<'_>,
    (shared, own): (Option<ArtifactHash>, Option<ArtifactHash>),
    assignment: &Assignment,
    control: &Control,
) -> Result<Start, ExecuteError> {
    let mut on_cache = caches(ready, (shared, own), false, assignment, control)?;
    let profile = assignment.profile.as_ref();
    let profile = profile.and_then(|bytes| usable("the frame's profile", bytes, ready, control));
    if let (Some(profile), None) = (&profile, own) {
        on_cache = ready.take_profiled_cache(profile)?;
    }
    Ok(Start { profile, on_cache })
}

/// Gives a frame the irradiance caches that its task names: its own, which holds what is valid of the shared one, or the
/// shared one alone. With `alone`, the frame makes its own if another version of the renderer made the shared
/// one. Returns what earlier tasks have spent on the frame's own.
pub(crate) fn caches(
    ready: &OwnFrame<'_>,
    (shared, own): (Option<ArtifactHash>, Option<ArtifactHash>),
    alone: bool,
    assignment: &Assignment,
    control: &Control,
) -> Result<Spent, ExecuteError> {
    let named = usize::from(shared.is_some()) + usize::from(own.is_some());
    let [.., last] = assignment.caches.as_slice() else { return expect(named, 0).map(|()| Spent::default()) };
    expect(named, assignment.caches.len())?;
    if own.is_some() {
        let taken = Cache::from_bytes(last).map_err(RenderError::from);
        return taken.and_then(|cache| ready.take_own_cache(cache)).map_err(of_given_cache);
    }
    share(ready, last, alone, control).map(|()| Spent::default())
}

pub(crate) fn expect(named: usize, given: usize) -> Result<(), ExecuteError> {
    if named == given {
        return Ok(());
    }
    Err(ExecuteError::Transient(format!("{given} irradiance caches where {named} were expected")))
}

fn share(ready: &OwnFrame<'_>, cache: &Bytes, alone: bool, control: &Control) -> Result<(), ExecuteError> {
    let shared = Cache::from_bytes(cache).map_err(RenderError::from).and_then(|cache| ready.share(cache));
    let (level, text) = match shared {
        Ok(shared) => {
            let (kept, dropped) = (shared.kept.iter().sum::<u64>(), shared.dropped.iter().sum::<u64>());
            let text = format!(
                "{kept} records of the shared irradiance cache are valid in this frame, {dropped} are not"
            );
            (LogLevel::Info, text)
        }
        Err(RenderError::Cache(error @ (CacheError::Foreign | CacheError::OtherScene(_)))) if alone => {
            let text =
                format!("the frame builds its own irradiance cache; the shared one cannot be used: {error}");
            (LogLevel::Warn, text)
        }
        Err(error) => return Err(of_given_cache(error)),
    };
    control.log(level, text);
    Ok(())
}

/// A checkpoint or profile, if it fits this frame. It may come from another version of the renderer.
pub(crate) fn usable(what: &str, bytes: &Bytes, ready: &OwnFrame<'_>, control: &Control) -> Option<Profile> {
    let found = Profile::from_bytes(bytes).map_err(RenderError::from);
    match found.and_then(|found| ready.check(&found).map(|()| found)) {
        Ok(found) => Some(found),
        Err(why) => {
            control.log(LogLevel::Warn, format!("{what} cannot be used: {why}"));
            None
        }
    }
}

/// Takes over the pixels of the last pass over this frame. They may come from another version of the
/// renderer.
pub(crate) fn take_over(
    passes: &mut Passes,
    ready: &OwnFrame<'_>,
    assignment: &Assignment,
    control: &Control,
) -> Result<(), ExecuteError> {
    let read = |bytes: &Bytes| {
        if control.is_cancelled() {
            return Err(ExecuteError::Cancelled);
        }
        let unusable =
            |error| ExecuteError::Transient(format!("pixels of the last pass cannot be used: {error}"));
        ready.unfinished(bytes).map_err(unusable)
    };
    passes.take_over(assignment.parts.iter().map(read), None)
}

/// The one irradiance cache that a task is given.
pub(crate) fn only_cache(assignment: &Assignment) -> Result<Cache, ExecuteError> {
    expect(1, assignment.caches.len())?;
    Cache::from_bytes(&assignment.caches[0]).map_err(unusable)
}

/// The error of a task whose irradiance cache cannot be used.
pub(crate) fn of_given_cache(error: RenderError) -> ExecuteError {
    match error {
        RenderError::Cache(error) => unusable(error),
        other => other.into(),
    }
}

/// A damaged file is damaged for all workers. One of another renderer version may suit another worker.
pub(crate) fn unusable(error: CacheError) -> ExecuteError {
    let text = format!("the irradiance cache cannot be used: {error}");
    match error {
        CacheError::Length { .. } | CacheError::Damaged(_) => ExecuteError::Permanent(text),
        CacheError::Foreign | CacheError::OtherScene(_) | CacheError::OtherPlan => {
            ExecuteError::Transient(text)
        }
    }
}

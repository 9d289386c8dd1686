//! What is finished of a frame, set aside now and then: should this worker be lost, the next one goes on from there.

use crate::agent::execute::Control;
use bytes::Bytes;
use forelight_protocol::CHECKPOINT_BYTES;
use forelight_tracer::{Pixel, Profile};
use parking_lot::Mutex;
use std::time::{Duration, Instant};

/// The pixels of a frame as they are finished, with those that were taken over.
pub(crate) struct Checkpoints<'a> {
    control: &'a Control,
    interval: Duration,
    state: Mutex<State>,
}

struct State {
    /// What a checkpoint holds; `None` if the frame is too large for one, or has an irradiance cache, whose pixels are worth little.
    profile: Option<Profile>,
    last: Instant,
}

impl<'a> Checkpoints<'a> {
    /// Begins with what is taken over (an empty profile, if nothing is) of an image of so many pixels, if it can have checkpoints.
    pub fn new(control: &'a Control, start: Option<Profile>, pixels: u64) -> Self {
        let bytes = Profile::bytes_of(pixels);
        let profile = start.filter(|_| bytes <= CHECKPOINT_BYTES as u64);
        let state = Mutex::new(State { profile, last: Instant::now() });
        Self { control, interval: control.checkpoint_interval(), state }
    }

    /// These pixels are finished. If the last checkpoint is old enough, there is a new one.
    pub fn finished(&self, pixels: &[(u32, Pixel)]) {
        let mut state = self.state.lock();
        let due = state.last.elapsed() >= self.interval;
        let Some(profile) = &mut state.profile else { return };
        profile.pixels.extend_from_slice(pixels);
        if due {
            let bytes = Bytes::from(profile.to_bytes());
            state.last = Instant::now();
            drop(state);
            self.control.offer_checkpoint(bytes);
        }
    }
}

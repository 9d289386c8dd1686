//! Checkpoints: finished tiles of a frame, kept so that another worker can continue if this one is lost.

use bytes::Bytes;
use forelight_protocol::CHECKPOINT_BYTES;
use forelight_renderer::Control;
use forelight_tracer::{Pixel, Profile};
use parking_lot::Mutex;
use std::time::{Duration, Instant};

/// Collects finished pixels of a frame, including those taken over.
pub(crate) struct Checkpoints<'a> {
    control: &'a Control,
    interval: Duration,
    state: Mutex<State>,
}

struct State {
    /// `None` if the frame is too large, or has an irradiance cache, without which pixels are worth little.
    profile: Option<Profile>,
    last: Instant,
}

impl<'a> Checkpoints<'a> {
    /// Begins with the profile that is taken over, or an empty one. `pixels` is the size of the image.
    pub fn new(control: &'a Control, start: Option<Profile>, pixels: u64) -> Self {
        let bytes = Profile::bytes_of(pixels);
        let profile = start.filter(|_| bytes <= CHECKPOINT_BYTES as u64);
        let state = Mutex::new(State { profile, last: Instant::now() });
        Self { control, interval: control.checkpoint_interval(), state }
    }

    /// Adds finished pixels. Offers a new checkpoint if the last one is old enough.
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

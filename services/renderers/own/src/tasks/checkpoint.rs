//! Checkpoints: pixels of a frame that are done, kept so that another worker can continue if this one is
//! lost.

use bytes::Bytes;
use forelight_protocol::CHECKPOINT_BYTES;
use forelight_renderer::Control;
use forelight_tracer::{Pixel, Profile, Unfinished};
use parking_lot::Mutex;
use std::time::{Duration, Instant};

/// A file that pixels are added to.
pub(crate) trait PixelFile {
    fn to_bytes(&self) -> Vec<u8>;
}

impl PixelFile for Profile {
    fn to_bytes(&self) -> Vec<u8> {
        Profile::to_bytes(self)
    }
}

impl PixelFile for Unfinished {
    fn to_bytes(&self) -> Vec<u8> {
        Unfinished::to_bytes(self)
    }
}

/// Collects pixels that are done, including those taken over.
pub(crate) struct Checkpoints<'a, F> {
    control: &'a Control,
    interval: Duration,
    state: Mutex<State<F>>,
}

struct State<F> {
    /// `None` if it would be too large, or if the frame has an irradiance cache of its own, without which
    /// pixels are worth little.
    file: Option<F>,
    last: Instant,
}

impl<'a, F: PixelFile> Checkpoints<'a, F> {
    /// Begins with the pixels that are taken over. `bytes` is the size of the whole file.
    pub fn new(control: &'a Control, start: Option<F>, bytes: u64) -> Self {
        let file = start.filter(|_| bytes <= CHECKPOINT_BYTES as u64);
        let state = Mutex::new(State { file, last: Instant::now() });
        Self { control, interval: control.checkpoint_interval(), state }
    }

    /// Adds pixels. Offers a new checkpoint if the last one is old enough.
    pub fn add(&self, add: impl FnOnce(&mut F)) {
        let mut state = self.state.lock();
        let due = state.last.elapsed() >= self.interval;
        let Some(file) = &mut state.file else { return };
        add(file);
        if due {
            let bytes = Bytes::from(file.to_bytes());
            state.last = Instant::now();
            drop(state);
            // The size of unfinished pixels is not known before.
            if bytes.len() <= CHECKPOINT_BYTES {
                self.control.offer_checkpoint(bytes);
            }
        }
    }
}

impl Checkpoints<'_, Profile> {
    /// Adds finished pixels.
    pub fn finished(&self, pixels: &[(u32, Pixel)]) {
        self.add(|file| file.pixels.extend_from_slice(pixels));
    }
}

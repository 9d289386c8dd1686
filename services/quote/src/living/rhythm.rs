//! Decides when a new estimate is due.
//!
//! An estimate reads all frames of a job, so its cost grows with their number. It is made
//!
//! * with each of the first [`FIRST`] frames;
//! * then with every 256th part of the job ([`PARTS`]), but not twice within [`BETWEEN_FRAMES`];
//! * with the last frame.
//!
//! So a job of n frames reads at most about 270 n rows for its estimates. Finished pixels, and frames left
//! out by these rules, also call for an estimate, [`BETWEEN_PIXELS`] after the last.

use forelight_protocol::Timestamp;

/// Each of this many first frames gets an estimate.
const FIRST: u32 = 16;

/// Number of parts of a job. After the first frames, each part gets an estimate.
const PARTS: u32 = 256;

/// Least time between two estimates, except the first and the last: a second, in microseconds.
const BETWEEN_FRAMES: i64 = 1_000_000;

/// Time between estimates for finished pixels, or for fewer frames than a part: ten seconds, in microseconds.
pub const BETWEEN_PIXELS: i64 = 10_000_000;

/// Why an estimate may be due.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Occasion {
    /// The job was booked.
    Booked,
    /// A frame finished.
    Frame,
    /// The job was cancelled or failed.
    Ended,
    /// Pixels of a frame finished, or finished frames wait for an estimate.
    Meanwhile,
    /// A frame takes longer than forecast.
    Overdue,
}

/// The previous estimate.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Last {
    /// Its time.
    pub at: Timestamp,
    /// Frames finished then.
    pub frames_done: u32,
    /// Frames finished since, without the present one.
    pub frames_since: u32,
    /// Frames of the job.
    pub frames_total: u32,
}

/// True if a new estimate is due on this occasion.
pub fn is_due(last: &Last, occasion: Occasion, now: Timestamp) -> bool {
    let age = now.micros_since(last.at);
    match occasion {
        Occasion::Booked | Occasion::Ended | Occasion::Overdue => true,
        Occasion::Frame => {
            let since = last.frames_since + 1;
            let done = last.frames_done + since;
            let is_part = since >= (last.frames_total / PARTS).max(1) && age >= BETWEEN_FRAMES;
            done <= FIRST || done >= last.frames_total || is_part
        }
        Occasion::Meanwhile => age >= BETWEEN_PIXELS,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn due(frames: (u32, u32, u32), occasion: Occasion, age: i64) -> bool {
        let (frames_done, frames_since, frames_total) = frames;
        let at = Timestamp::from_micros(0);
        is_due(&Last { at, frames_done, frames_since, frames_total }, occasion, at.plus_micros(age))
    }

    #[test]
    fn the_first_frames_and_the_last_are_estimated_at_once_and_others_part_by_part() {
        assert!(due((15, 0, 5000), Occasion::Frame, 0));
        assert!(!due((16, 0, 5000), Occasion::Frame, BETWEEN_FRAMES));
        assert!(!due((16, 17, 5000), Occasion::Frame, BETWEEN_FRAMES));
        assert!(due((16, 18, 5000), Occasion::Frame, BETWEEN_FRAMES), "5000 / 256 frames");
        assert!(!due((16, 18, 5000), Occasion::Frame, BETWEEN_FRAMES - 1));
        assert!(due((4000, 999, 5000), Occasion::Frame, 0));
    }

    #[test]
    fn pixels_wait_and_bookings_and_ends_do_not() {
        assert!(!due((3, 0, 9), Occasion::Meanwhile, BETWEEN_PIXELS - 1));
        assert!(due((3, 0, 9), Occasion::Meanwhile, BETWEEN_PIXELS));
        assert!(due((3, 0, 9), Occasion::Booked, 0) && due((3, 0, 9), Occasion::Ended, 0));
    }
}

//! Whether there is room for what the farm writes.
//!
//! A disk that is full to the last byte takes no renewal and no result, so that work under way is lost and done again for nothing. New
//! tasks stop before that, and whoever asks for a job is told why it does not go on.

use forelight_protocol::{JobState, ProblemKind, WaitKind, Waits};

use crate::error::{ApiError, ApiResult};
use crate::state::App;

/// Bytes as people read them.
fn mebibytes(bytes: u64) -> String {
    format!("{} MiB", bytes >> 20)
}

impl App {
    /// Refuses what needs room, if there is too little for another task to begin.
    pub fn check_disk_space(&self) -> ApiResult<()> {
        let (room, least) = (self.store.free_disk_space()?, self.limits.least_disk_space);
        if room >= least {
            return Ok(());
        }
        let [room, least] = [room, least].map(mebibytes);
        let lack = format!("{room} of room are left where the farm's data are, at least {least} are needed");
        Err(ApiError::new(ProblemKind::StorageFull, lack))
    }

    /// Has jobs say that they wait for room, if they do: it comes before every other reason, of which the plan knows.
    pub fn tell_disk_full<'a>(&self, jobs: impl IntoIterator<Item = (JobState, &'a mut Option<Waits>)>) {
        let least = self.limits.least_disk_space;
        // Where that cannot be known the log says so, see [`Self::log_disk_space`].
        if self.store.free_disk_space().is_ok_and(|room| room < least) {
            let least = mebibytes(least);
            let because =
                format!("waits because less than {least} of room are left where the farm's data are");
            let lack = Waits { kind: WaitKind::Room, because, until: None, behind: Vec::new(), share: None };
            let unfinished = jobs.into_iter().filter(|(state, _)| !state.is_final());
            unfinished.for_each(|(_, waits)| *waits = Some(lack.clone()));
        }
    }

    /// Says in the log when room begins to lack, and when there is some again: twice the least, so that it is not said all the time. Whether
    /// it lacks now.
    pub fn log_disk_space(&self, lacked: bool) -> bool {
        let least = self.limits.least_disk_space;
        match self.store.free_disk_space() {
            Ok(room) if room < least && !lacked => {
                let [room, least] = [room, least].map(mebibytes);
                tracing::error!(
                    room,
                    least,
                    "no task is handed out for want of room where the farm's data are"
                );
                true
            }
            Ok(room) if room >= least.saturating_mul(2) && lacked => {
                tracing::info!(room = mebibytes(room), "there is room again; tasks are handed out");
                false
            }
            Ok(_) => lacked,
            Err(error) => {
                tracing::warn!(%error, "how much room there is cannot be known");
                lacked
            }
        }
    }
}

//! Free disk space for the farm's data. A full disk can store no result, so new tasks stop before that, and
//! jobs say why.

use forelight_protocol::{JobState, ProblemKind, WaitKind, Waits};

use crate::error::{ApiError, ApiResult};
use crate::state::App;

fn mebibytes(bytes: u64) -> String {
    format!("{} MiB", bytes >> 20)
}

impl App {
    /// Refuses a request that writes if there is too little space for another task.
    pub fn check_disk_space(&self) -> ApiResult<()> {
        let (room, least) = (self.store.free_disk_space()?, self.limits.least_disk_space);
        if room >= least {
            return Ok(());
        }
        let [room, least] = [room, least].map(mebibytes);
        let lack = format!("the data folder has {room} of free disk space; it needs at least {least}");
        Err(ApiError::new(ProblemKind::StorageFull, lack))
    }

    /// Makes jobs say that they wait for disk space. This comes before every reason that the plan knows.
    pub fn tell_disk_full<'a>(&self, jobs: impl IntoIterator<Item = (JobState, &'a mut Option<Waits>)>) {
        let least = self.limits.least_disk_space;
        if self.store.free_disk_space().is_ok_and(|room| room < least) {
            let least = mebibytes(least);
            let because = format!("waits because the data folder has less than {least} of free disk space");
            let lack = Waits { kind: WaitKind::Room, because, until: None, behind: Vec::new(), share: None };
            let unfinished = jobs.into_iter().filter(|(state, _)| !state.is_final());
            unfinished.for_each(|(_, waits)| *waits = Some(lack.clone()));
        }
    }

    /// Logs when space runs short, and when twice the minimum is free again. Returns whether it is short now.
    pub fn log_disk_space(&self, lacked: bool) -> bool {
        let least = self.limits.least_disk_space;
        match self.store.free_disk_space() {
            Ok(room) if room < least && !lacked => {
                let [room, least] = [room, least].map(mebibytes);
                tracing::error!(room, least, "the data folder is short of disk space; no task is handed out");
                true
            }
            Ok(room) if room >= least.saturating_mul(2) && lacked => {
                tracing::info!(
                    room = mebibytes(room),
                    "the data folder has enough disk space again; tasks are handed out"
                );
                false
            }
            Ok(_) => lacked,
            Err(error) => {
                tracing::warn!(%error, "the free disk space of the data folder could not be read");
                lacked
            }
        }
    }
}

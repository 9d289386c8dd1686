//! Whether there is room for what the farm writes.
//!
//! A disk that is full to the last byte takes no renewal and no result, so that work under way is lost and done again for nothing. New
//! tasks stop before that, and whoever asks for a job is told why it does not go on.

use forelight_protocol::{JobState, ProblemKind, WaitKind, Waits};
use forelight_store::StoreError;

use crate::error::{ApiError, ApiResult};
use crate::state::App;

impl App {
    /// What there is to say if there is too little room for another task to begin.
    fn lack_of_room(&self) -> Result<Option<String>, StoreError> {
        let (room, least) = (self.store.room()?, self.limits.least_room);
        Ok((room < least).then(|| {
            format!(
                "{} MiB of room are left where the farm's data are, at least {} MiB are needed",
                room >> 20,
                least >> 20
            )
        }))
    }

    /// Says in the log when room begins to lack and when there is some again; whether it lacks now.
    pub fn log_room(&self, lacked: bool) -> bool {
        let lack = match self.lack_of_room() {
            Ok(lack) => lack,
            Err(error) => {
                tracing::warn!(%error, "how much room there is cannot be known");
                return lacked;
            }
        };
        match &lack {
            Some(lack) if !lacked => tracing::error!("{lack}; no task is handed out until there are"),
            None if lacked => tracing::info!("there is room again; tasks are handed out"),
            _ => {}
        }
        lack.is_some()
    }

    /// Refuses what needs room, if there is too little.
    pub fn check_room(&self) -> ApiResult<()> {
        match self.lack_of_room()? {
            Some(lack) => Err(ApiError::new(ProblemKind::StorageFull, lack)),
            None => Ok(()),
        }
    }

    /// Has jobs say that they wait for room, if they do: it comes before every other reason, of which the plan knows.
    pub fn tell_lack_of_room<'a>(
        &self,
        jobs: impl IntoIterator<Item = (JobState, &'a mut Option<Waits>)>,
    ) -> ApiResult<()> {
        let Some(lack) = self.lack_of_room()? else { return Ok(()) };
        for (_, waits) in jobs.into_iter().filter(|(state, _)| !state.is_final()) {
            let because = format!("waits because {lack}");
            *waits =
                Some(Waits { kind: WaitKind::Room, because, until: None, behind: Vec::new(), share: None });
        }
        Ok(())
    }
}

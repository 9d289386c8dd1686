//! The inputs of a task, on this machine.

use std::path::PathBuf;
use std::sync::Arc;

use forelight_client::ClientError;
use forelight_kept::TemporaryFolder;
use forelight_protocol::{BundleSource, CACHE_BYTES, Lease, LogLevel, TaskSpec};
use forelight_renderer::{Assignment, Control, ExecuteError};

use super::{AFTER_REFUSAL, Agent};
use crate::errors::{describe, is_gone};
use crate::pictures;

impl Agent {
    /// Prepares the inputs of a task.
    pub(super) async fn prepare(&self, lease: &Lease, control: &Control) -> Result<Assignment, ExecuteError> {
        let failed = |error: ClientError| {
            let message = describe(&error);
            if is_gone(&error) { ExecuteError::Input(message) } else { ExecuteError::Transient(message) }
        };
        let pictures =
            match lease.spec.pictures() {
                [] => None,
                _ => Some(Arc::new(self.bundles.folder_for_pictures().map_err(|error| {
                    ExecuteError::Transient(format!("no folder for the pictures: {error}"))
                })?)),
            };
        let fetched = loop {
            match self.fetch(lease, pictures.as_deref(), control).await {
                Ok(fetched) => break fetched,
                // A short outage of the service or its artefact store is not the task's fault.
                Err(error) if error.is_passing() => {
                    tracing::warn!(task = %lease.task_id, %error, "task inputs not available yet; retrying");
                    tokio::time::sleep(AFTER_REFUSAL).await;
                }
                Err(error) => return Err(failed(error)),
            }
        };
        if lease.spec.bundle().is_some() && !tokio::fs::try_exists(&fetched.bundle).await.unwrap_or(true) {
            let message = format!("bundle {} is gone", fetched.bundle.display());
            // A fetched one made room on a full disk, and can be fetched again.
            let is_fetched = matches!(lease.spec.bundle(), Some(BundleSource::Artifact(_)));
            return Err(if is_fetched {
                ExecuteError::Transient(message)
            } else {
                ExecuteError::Input(message)
            });
        }
        let what = if pictures.is_some() { "pictures" } else { "bundle" };
        control.log(LogLevel::Info, format!("{what} fetched"));
        let checkpoint = match &lease.spec {
            // Only an earlier attempt can have left a checkpoint. It is optional.
            TaskSpec::Render(_) | TaskSpec::RenderPart(_) if lease.fence > 1 => {
                self.client.checkpoint(lease.lease_id).await.unwrap_or_default()
            }
            _ => None,
        };
        let (limits, threads) = (lease.limits.and(self.limits), self.registration.cores);
        Ok(Assignment { pictures, checkpoint, limits, threads, ..fetched })
    }

    /// Fetches the bundle, and the files that a task takes over. Its pictures go to their folder; those that
    /// are there already stay.
    async fn fetch(
        &self,
        lease: &Lease,
        folder: Option<&TemporaryFolder>,
        control: &Control,
    ) -> Result<Assignment, ClientError> {
        let bundle = match lease.spec.bundle() {
            Some(source) => self.bundles.locate(&self.client, source).await?,
            None => PathBuf::new(),
        };
        if let Some(folder) = folder {
            pictures::fetch(&self.client, lease.spec.pictures(), folder.path(), control).await?;
        }
        let shares = match &lease.spec {
            TaskSpec::Render(spec) => &spec.shares[..],
            _ => &[],
        };
        let mut fetched = Assignment::new(lease.spec.clone(), bundle);
        if let Some(hash) = lease.spec.profile() {
            match self.client.artifact(hash, CACHE_BYTES).await {
                Ok(profile) => fetched.profile = Some(profile),
                // A profile only saves time: without it, its pixels are traced again.
                Err(error) if is_gone(&error) => {
                    let text = format!("the frame is rendered without its profile: {}", describe(&error));
                    control.log(LogLevel::Warn, text);
                }
                Err(error) => return Err(error),
            }
        }
        if let Some(hash) = lease.spec.samples() {
            fetched.samples = Some(self.client.artifact(hash, CACHE_BYTES).await?);
        }
        for &hash in lease.spec.parts() {
            fetched.parts.push(self.client.artifact(hash, CACHE_BYTES).await?);
        }
        for hash in lease.spec.caches() {
            fetched.caches.push(self.client.artifact(hash, CACHE_BYTES).await?);
        }
        for share in shares {
            fetched.shares.push(self.client.artifact(share.hash, CACHE_BYTES).await?);
        }
        Ok(fetched)
    }
}

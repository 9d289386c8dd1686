//! The end of a task: its result, an error, or giving the lease back.

use crate::agent::{Agent, Errand};
use crate::errors::{describe, is_lost};
use forelight_client::{Backoff, Client, ClientError};
use forelight_protocol::{
    FailureKind, Lease, LogLevel, LogLine, ProblemKind, RenewRequest, ResultRequest, TaskError,
    without_secrets,
};
use forelight_renderer::{Control, ExecuteError, Outcome};
use std::time::Duration;

impl Agent {
    /// Uploads the artefacts and reports the end of the task. Retries until the service answers.
    pub(super) async fn report(
        &self,
        lease: &Lease,
        done: Result<Outcome, ExecuteError>,
        control: &Control,
    ) -> Errand {
        let client = self.client.with_backoff(Backoff::FOREVER);
        let failed = |message, kind| TaskError { message, kind, ..TaskError::default() };
        let ended = match done {
            Ok(outcome) => match self.deliver(&client, lease, outcome, control).await {
                Ok(()) => return Errand::Ended,
                Err(error) if is_lost(&error) => Err(error),
                // The service has ended the lease, and the task is done elsewhere.
                Err(error) if error.is(ProblemKind::ImplausibleResult) => Err(error),
                // Only another attempt can help. Report it rather than let the lease expire.
                Err(error) => {
                    let message = format!("the result was refused: {}", describe(&error));
                    tracing::error!(task = %lease.task_id, %message);
                    self.report_error(&client, lease, failed(message, FailureKind::Unknown), control).await
                }
            },
            Err(ExecuteError::Cancelled) => return Errand::Dropped,
            Err(ExecuteError::Permanent(message)) => {
                let error = TaskError { permanent: true, ..failed(message, FailureKind::Task) };
                self.report_error(&client, lease, error, control).await
            }
            Err(ExecuteError::Input(message)) => {
                self.report_error(&client, lease, failed(message, FailureKind::Input), control).await
            }
            Err(ExecuteError::Transient(message)) => {
                self.report_error(&client, lease, failed(message, FailureKind::Unknown), control).await
            }
            Err(ExecuteError::Limit(limit, message)) => {
                let error = TaskError { limit: Some(limit), ..failed(message, FailureKind::Task) };
                self.report_error(&client, lease, error, control).await
            }
        };
        match ended {
            Ok(()) => return Errand::Ended,
            Err(error) if is_lost(&error) => {
                tracing::info!(task = %lease.task_id, "the lease was lost; the result is dropped");
            }
            Err(error) => tracing::error!(task = %lease.task_id, %error, "task outcome not accepted"),
        }
        Errand::Dropped
    }

    async fn deliver(
        &self,
        client: &Client,
        lease: &Lease,
        outcome: Outcome,
        control: &Control,
    ) -> Result<(), ClientError> {
        self.send_log(client, lease, control, |unsent| unsent.len() == Control::LINES_AT_ONCE).await?;
        let result = ResultRequest {
            fence: lease.fence,
            result: Some(outcome.result),
            error: None,
            log: control.unsent(),
        };
        for last_attempt in [false, true] {
            for artifact in &outcome.artifacts {
                client.store(artifact.clone()).await?;
            }
            match client.report(lease.lease_id, &result).await {
                Ok(answer) => {
                    tracing::info!(task = %lease.task_id, duplicate = answer.duplicate, "committed");
                    return Ok(());
                }
                // The service lost an artefact between upload and result: upload again.
                Err(error) if error.is(ProblemKind::MissingArtifact) && !last_attempt => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    async fn report_error(
        &self,
        client: &Client,
        lease: &Lease,
        error: TaskError,
        control: &Control,
    ) -> Result<(), ClientError> {
        let TaskError { message, permanent, .. } = &error;
        tracing::warn!(task = %lease.task_id, message, permanent, "the task failed");
        control.log(LogLevel::Error, message.clone());
        let error = TaskError { message: one_line(message), ..error.clone() };
        // The lines that lead to the error belong to it, however many there are.
        let is_before = |unsent: &[LogLine]| unsent.last().is_some_and(|line| line.level != LogLevel::Error);
        self.send_log(client, lease, control, is_before).await?;
        let log = control.unsent();
        let end = ResultRequest { fence: lease.fence, result: None, error: Some(error), log };
        client.report(lease.lease_id, &end).await.map(drop)
    }

    /// Sends lines of the task's log by renewals, while `is_more` says of the next ones that others follow.
    async fn send_log(
        &self,
        client: &Client,
        lease: &Lease,
        control: &Control,
        is_more: impl Fn(&[LogLine]) -> bool,
    ) -> Result<(), ClientError> {
        loop {
            let log = control.unsent();
            if !is_more(&log) {
                return Ok(());
            }
            let renewal = RenewRequest {
                fence: lease.fence,
                progress: control.progress(),
                log,
                ..RenewRequest::default()
            };
            client.renew(lease.lease_id, &renewal, Duration::from_secs(30)).await?;
            control.sent(&renewal.log);
        }
    }

    /// Gives the lease back. If the service does not answer soon, the lease expires by itself.
    pub(super) async fn give_back(&self, lease: &Lease) {
        let hurried = self.client.with_backoff(Backoff { attempts: Some(2), ..Backoff::PATIENT });
        let release = hurried.release(lease.lease_id, lease.fence);
        match tokio::time::timeout(Duration::from_secs(3), release).await {
            Ok(Ok(())) => tracing::info!(task = %lease.task_id, "gave the lease back"),
            Ok(Err(error)) => tracing::info!(task = %lease.task_id, %error, "lease not given back"),
            Err(_) => tracing::info!(task = %lease.task_id, "lease not given back in time"),
        }
    }
}

/// The protocol accepts one line of 1 to 2000 characters.
fn one_line(message: &str) -> String {
    let line = without_secrets(&message.split_whitespace().collect::<Vec<_>>().join(" "));
    let line: String = line.chars().take(2000).collect();
    if line.is_empty() { "the task failed without a message".into() } else { line }
}

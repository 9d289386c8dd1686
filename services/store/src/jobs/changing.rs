//! Accepting quotes, and changing jobs: deadline, budget, confidence, priority, and whether they are paused.

use forelight_protocol::{
    AuditAction, Event, EventKind, FramePart, Job, JobChange, JobId, JobNews, JobState, Money, Timestamp,
};

use crate::audit::{Deed, note};
use crate::columns::{Id, Time};
use crate::database::{Store, Write};
use crate::error::{Result, StoreError};
use crate::events::{append, event};
use crate::jobs::{read, row};
use crate::plans::{book_tasks, replans};
use crate::policy::rebooking::NewBooking;
use crate::writing::run;

impl Store {
    /// Accepts the quote of a job on hold, under these terms. It is booked after that. Repeating this without
    /// a change does nothing. A [`StoreError::Conflict`] if the job has no complete quote, or was not on
    /// hold.
    pub async fn accept_job(&self, job: JobId, change: &JobChange, now: Timestamp) -> Result<Job> {
        let mut write = self.write().await?;
        let current = read(write.connection().await?, job).await?;
        match current.state {
            JobState::Quoted if current.hold => {}
            JobState::Previewing | JobState::Profiling if current.hold => {
                return Err(StoreError::Conflict(format!(
                    "the job is {}: its quote is not complete yet",
                    current.state
                )));
            }
            JobState::Failed | JobState::Cancelled => {
                return Err(StoreError::Conflict(format!("the job is {}; submit it again", current.state)));
            }
            _ if *change == JobChange::default() => return Ok(current),
            state => {
                return Err(StoreError::Conflict(format!(
                    "the job is {state} and waits for nobody; change its terms with PATCH"
                )));
            }
        }
        run!(write, "UPDATE jobs SET hold = 0 WHERE id = ?", job.0);
        set_terms(&mut write, job, change).await?;
        tell_terms(&mut write, job, "its quote was accepted", now).await?;
        let deed = Deed::new(AuditAction::JobAccepted, job).of_project(&current.project);
        note(&mut write, deed, Some(change), now);
        let accepted = read(write.connection().await?, job).await?;
        self.commit(write).await?;
        Ok(accepted)
    }

    /// Changes a job, and calls for a new plan. A [`StoreError::Conflict`] if the job is over.
    pub async fn change_job(&self, job: JobId, change: &JobChange, now: Timestamp) -> Result<Job> {
        let mut write = self.write().await?;
        let current = read(write.connection().await?, job).await?;
        if current.state.is_final() {
            let reason = format!("the job is {} and cannot be changed", current.state);
            return Err(StoreError::Conflict(reason));
        }
        let changed = JobChange {
            deadline: change.deadline.filter(|it| *it != current.deadline),
            budget: change.budget.filter(|it| *it != current.budget),
            confidence: change.confidence.filter(|it| *it != current.confidence),
            priority: change.priority.filter(|it| *it != current.priority),
            paused: change.paused.filter(|it| *it != current.paused),
        };
        if changed == JobChange::default() {
            return Ok(current);
        }
        set_terms(&mut write, job, &changed).await?;
        if let Some(priority) = changed.priority.filter(|_| current.state.is_booked()) {
            let_ahead(&mut write, job, priority).await?;
        }
        rebook_rates(&mut write, job).await?;
        let what = in_words(&changed);
        replans::want(&mut write, &format!("job {}: {what}", current.name)).await?;
        tell_terms(&mut write, job, &what, now).await?;
        let deed = Deed::new(AuditAction::JobChanged, job).of_project(&current.project);
        note(&mut write, deed, Some(change), now);
        let changed = read(write.connection().await?, job).await?;
        self.commit(write).await?;
        Ok(changed)
    }

    /// A job, and the version of its terms, see [`crate::FarmJob::terms`].
    pub async fn job_with_terms(&self, job: JobId) -> Result<(Job, i64)> {
        let mut transaction = self.read().await?;
        let terms = row(&mut transaction, job).await?.terms;
        Ok((read(&mut transaction, job).await?, terms))
    }
}

async fn set_terms(write: &mut Write, job: JobId, change: &JobChange) -> Result<()> {
    run!(
        write,
        "UPDATE jobs SET deadline_at = CASE WHEN ?1 THEN ?2 ELSE deadline_at END, \
         budget = CASE WHEN ?3 THEN ?4 ELSE budget END, confidence = coalesce(?5, confidence), \
         priority = coalesce(?6, priority), paused = coalesce(?7, paused), terms = terms + 1 WHERE id = ?8",
        change.deadline.is_some(),
        change.deadline.flatten().map(Timestamp::micros),
        change.budget.is_some(),
        change.budget.flatten().map(Money::micro_units),
        change.confidence.map(|confidence| confidence.name()),
        change.priority,
        change.paused,
        job.0
    );
    if change.paused.is_some() {
        run!(
            write,
            "UPDATE tasks SET held = EXISTS (SELECT 1 FROM held_jobs h WHERE h.job_id = tasks.job_id) WHERE job_id = ? \
             AND (held = 1 OR state IN ('waiting', 'ready', 'leased'))",
            job.0
        );
        write.made_work = true;
    }
    // Claims look for tasks by deadline and priority of their jobs.
    run!(
        write,
        "UPDATE tasks SET due_at = (SELECT coalesce(deadline_at, 9223372036854775807) FROM jobs WHERE id = ?1), \
         priority = (SELECT priority FROM jobs WHERE id = ?1) WHERE job_id = ?1 AND state IN ('waiting', 'ready', 'leased')",
        job.0
    );
    Ok(())
}

/// Has jobs without a deadline placed anew that wait behind this one, if their priority is higher than its new one.
async fn let_ahead(write: &mut Write, job: JobId, priority: i32) -> Result<()> {
    run!(
        write,
        "UPDATE jobs SET terms = terms + 1 WHERE state IN ('booked', 'rendering') AND deadline_at IS NULL \
         AND priority > ? AND EXISTS (SELECT 1 FROM json_each(outlook, '$.waits.behind') WHERE value = ?)",
        priority,
        job.to_string()
    );
    Ok(())
}

/// Writes to the waiting frames what plans pay for them, which depends on whether the job has a deadline or a
/// budget. They stay where they are booked until the new plan.
async fn rebook_rates(write: &mut Write, job: JobId) -> Result<()> {
    let rows = sqlx::query!(
        r#"SELECT t.frame AS "frame!: u32", t.booked_part AS "part!: u32", f.parts AS "parts!: u32",
                  t.booked_node AS "node!: Id", t.booked_at AS "start!: Time"
           FROM tasks t JOIN frames f ON f.job_id = t.job_id AND f.frame = t.frame
           WHERE t.job_id = ? AND t.booked_part IS NOT NULL AND t.state IN ('waiting', 'ready')
           AND t.booked_node IS NOT NULL"#,
        job.0
    )
    .fetch_all(write.connection().await?)
    .await?;
    let booked = rows.into_iter().map(|row| {
        let start = Timestamp::from(row.start);
        let frame = FramePart { frame: row.frame, part: row.part, parts: row.parts };
        (frame, Some(NewBooking { frame, node: row.node.into(), start, end: start }))
    });
    book_tasks(write, job, booked.collect()).await
}

/// Writes the event that a job has new terms.
async fn tell_terms(write: &mut Write, job: JobId, what: &str, now: Timestamp) -> Result<()> {
    let news = JobNews::of_terms(&read(write.connection().await?, job).await?);
    let changed = Event { job_id: Some(job), job: Some(news.into()), ..event(EventKind::JobChanged, now) };
    append(write, Event { message: Some(what.to_owned()), ..changed });
    Ok(())
}

pub(crate) fn tell(write: &mut Write, job: JobId, what: &str, now: Timestamp) {
    let changed = Event { job_id: Some(job), ..event(EventKind::JobChanged, now) };
    append(write, Event { message: Some(what.to_owned()), ..changed });
}

fn in_words(change: &JobChange) -> String {
    let mut words = Vec::new();
    match change.deadline {
        Some(Some(deadline)) => words.push(format!("a new deadline, {deadline}")),
        Some(None) => words.push("no deadline any more".to_owned()),
        None => {}
    }
    match change.budget {
        Some(Some(budget)) => words.push(format!("a new budget, {budget}")),
        Some(None) => words.push("no budget any more".to_owned()),
        None => {}
    }
    if let Some(confidence) = change.confidence {
        words.push(format!("a new confidence, {}", confidence.name()));
    }
    if let Some(priority) = change.priority {
        words.push(format!("a new priority, {priority}"));
    }
    if let Some(paused) = change.paused {
        words.push(if paused { "paused" } else { "resumed" }.to_owned());
    }
    words.join(" and ")
}

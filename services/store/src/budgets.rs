//! Budgets, the ledger that they are compared with, and forecasts of nights.
//!
//! Triggers write a ledger row for each lease (`migrations/0003_budgets.sql`), so payments are known however
//! a lease ends. A budget that is used up holds its project's tasks back, as a pause holds those of a job: they stay
//! `ready`, and `held` keeps them from being handed out.
//!
//! An action stays in force until its period ends or the budget is set again. Otherwise, stopping the running
//! tasks would release the money committed to them, and so start them again.

pub(crate) mod ledger;
pub(crate) mod nights;
pub(crate) mod past;

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};

use forelight_protocol::{
    AuditAction, Budget, BudgetAction, BudgetPeriod, BudgetRequest, Event, EventKind, LeaseId, Money,
    Timestamp,
};
use sqlx::SqliteConnection;

use crate::audit::{Deed, note, note_only};
use crate::budgets::ledger::{committed, spent_by_project};
use crate::columns::{Json, corrupt};
use crate::database::{Store, Write};
use crate::error::{Result, StoreError};
use crate::events::{append, event};
use crate::leases;
use crate::plans::replans;
use crate::policy::budgets as policy;
use crate::projects;
use crate::writing::run;

struct Kept {
    request: BudgetRequest,
    action: Option<BudgetAction>,
    period_at: Option<Timestamp>,
    updated_at: Timestamp,
}

impl Store {
    /// Sets a budget, whose time zone must be known. It replaces one of the same project and period and ends
    /// its action.
    pub async fn set_budget(&self, request: &BudgetRequest, now: Timestamp) -> Result<Budget> {
        let mut write = self.write().await?;
        projects::make(&mut write, &request.project, now).await?;
        run!(
            write,
            "INSERT INTO budgets (project, period, amount, zone, thresholds, updated_at) \
             VALUES (?, ?, ?, ?, ?, ?) ON CONFLICT (project, period) DO UPDATE \
             SET amount = excluded.amount, zone = excluded.zone, thresholds = excluded.thresholds, \
             updated_at = excluded.updated_at, action = NULL, period_at = NULL",
            request.project,
            request.period.name(),
            request.amount.0,
            request.zone,
            Json(&request.thresholds),
            now.micros()
        );
        let deed = Deed::new(AuditAction::BudgetSet, &request.project).of_project(&request.project);
        note(&mut write, deed, Some(request), now);
        replans::want(&mut write, &format!("the budget of project {} is set", request.project)).await?;
        enforce(&mut write, now).await?;
        let found = budgets(write.connection().await?, now)
            .await?
            .into_iter()
            .find(|budget| budget.project == request.project && budget.period == request.period);
        let budget = found.ok_or(StoreError::NotFound("budget"))?;
        self.commit(write).await?;
        Ok(budget)
    }

    /// Removes a project's budget. What it held goes on, unless another budget of the project holds it.
    pub async fn remove_budget(&self, project: &str, period: BudgetPeriod, now: Timestamp) -> Result<()> {
        let mut write = self.write().await?;
        let removed =
            run!(write, "DELETE FROM budgets WHERE project = ? AND period = ?", project, period.name());
        if removed == 0 {
            return Err(StoreError::NotFound("budget"));
        }
        note_only(&mut write, Deed::new(AuditAction::BudgetRemoved, project).of_project(project), now);
        let of_budget = Event { project: Some(project.to_owned()), ..event(EventKind::Budget, now) };
        let message = format!("{project}: the budget {} is removed", policy::per(period));
        append(&mut write, Event { message: Some(message), ..of_budget });
        replans::want(&mut write, &format!("a budget of project {project} is removed")).await?;
        enforce(&mut write, now).await?;
        self.commit(write).await
    }

    /// All budgets with their current spending, by project and period.
    pub async fn budgets(&self, now: Timestamp) -> Result<Vec<Budget>> {
        budgets(&mut *self.read().await?, now).await
    }

    /// Puts actions into force that spending calls for, and ends those of past periods. Writes only if
    /// something changes. Returns how many budgets changed.
    pub async fn enforce_budgets(&self, now: Timestamp) -> Result<u32> {
        // Most farms have no budget, and usually nothing changes: reading needs no write lock.
        let mut transaction = self.read().await?;
        let due = due(&mut transaction, now).await?;
        drop(transaction);
        if due.is_empty() {
            return Ok(0);
        }
        let mut write = self.write().await?;
        let changed = enforce(&mut write, now).await?;
        self.commit(write).await?;
        Ok(changed)
    }
}

async fn kept(connection: &mut SqliteConnection) -> Result<Vec<Kept>> {
    let rows = sqlx::query!("SELECT * FROM budgets ORDER BY project, period").fetch_all(connection).await?;
    Ok(rows
        .into_iter()
        .map(|row| Kept {
            request: BudgetRequest {
                project: row.project,
                period: row.period.0,
                amount: Money(row.amount),
                zone: row.zone,
                thresholds: row.thresholds.0,
            },
            action: row.action.map(|it| it.0),
            period_at: row.period_at.map(Into::into),
            updated_at: row.updated_at.into(),
        })
        .collect())
}

pub(crate) async fn budgets(connection: &mut SqliteConnection, now: Timestamp) -> Result<Vec<Budget>> {
    let kept = kept(connection).await?;
    as_they_stand(connection, kept, now).await
}

/// Budgets in the same order, with what is spent.
async fn as_they_stand(
    connection: &mut SqliteConnection,
    kept: Vec<Kept>,
    now: Timestamp,
) -> Result<Vec<Budget>> {
    let mut budgets = Vec::with_capacity(kept.len());
    // Budgets of many projects begin at few instants.
    let mut since: BTreeMap<Timestamp, BTreeMap<String, Money>> = BTreeMap::new();
    for Kept { request, action, period_at, updated_at } in kept {
        let BudgetRequest { project, period, amount, zone, thresholds } = request;
        let (from, until) =
            period.bounds(&zone, now).ok_or_else(|| corrupt("zone", format!("{zone} is not a time zone")))?;
        let spent = match since.entry(from) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(unknown) => unknown.insert(spent_by_project(connection, from, now).await?),
        };
        let spent = spent.get(&project).copied().unwrap_or_default();
        let committed = committed(connection, &project, now).await?;
        let action = action.filter(|_| period_at == Some(from));
        budgets.push(Budget {
            project,
            period,
            amount,
            zone,
            thresholds,
            from,
            until,
            spent,
            committed,
            action,
            updated_at,
        });
    }
    Ok(budgets)
}

/// The budgets whose row has to change, with the action that comes into force.
async fn due(
    connection: &mut SqliteConnection,
    now: Timestamp,
) -> Result<Vec<(Budget, Option<BudgetAction>)>> {
    let kept = kept(connection).await?;
    let written: Vec<_> = kept.iter().map(|kept| (kept.action, kept.period_at)).collect();
    let budgets = as_they_stand(connection, kept, now).await?;
    let due = budgets.into_iter().zip(written).filter_map(|(budget, written)| {
        let action = policy::action(&budget);
        policy::is_news(&budget, action, written).then_some((budget, action))
    });
    Ok(due.collect())
}

async fn enforce(write: &mut Write, now: Timestamp) -> Result<u32> {
    let due = due(write.connection().await?, now).await?;
    for (budget, action) in &due {
        run!(
            write,
            "UPDATE budgets SET action = ?, period_at = ? WHERE project = ? AND period = ?",
            action.map(BudgetAction::name),
            action.map(|_| budget.from.micros()),
            budget.project,
            budget.period.name()
        );
        let message = policy::message(budget, *action);
        let of_budget = Event { project: Some(budget.project.clone()), ..event(EventKind::Budget, now) };
        append(write, Event { message: Some(message), ..of_budget });
    }
    // A budget that was just set again has no action, but may have had one.
    let kept = kept(write.connection().await?).await?;
    let in_force = policy::strongest(kept.into_iter().map(|kept| (kept.request.project, kept.action)));
    let held = sqlx::query_scalar!(
        "SELECT DISTINCT j.project FROM tasks t JOIN jobs j ON j.id = t.job_id WHERE t.held = 1 AND j.paused = 0"
    )
    .fetch_all(write.connection().await?)
    .await?;
    let held: BTreeSet<String> = held.into_iter().collect();
    // Their budgets were removed.
    for project in held.iter().filter(|project| !in_force.contains_key(*project)) {
        let_go(write, project).await?;
        write.made_work = true;
    }
    for (project, action) in in_force {
        match action {
            Some(BudgetAction::Drain | BudgetAction::Stop) => {
                hold(write, &project).await?;
                if action == Some(BudgetAction::Stop) {
                    stop(write, &project, now).await?;
                }
            }
            _ if held.contains(&project) => {
                let_go(write, &project).await?;
                write.made_work = true;
            }
            _ => {}
        }
    }
    Ok(u32::try_from(due.len()).unwrap_or(u32::MAX))
}

/// Keeps a project's tasks from being handed out.
async fn hold(write: &mut Write, project: &str) -> Result<()> {
    let held = run!(
        write,
        "UPDATE tasks SET held = 1 WHERE held = 0 AND state IN ('waiting', 'ready', 'leased') \
         AND job_id IN (SELECT id FROM jobs WHERE project = ?)",
        project
    );
    if held > 0 {
        replans::want(write, &format!("the budget of project {project} holds its tasks")).await?;
    }
    Ok(())
}

/// Lets a project's tasks be handed out again, except those of paused jobs. Tasks that ended meanwhile are released
/// too.
async fn let_go(write: &mut Write, project: &str) -> Result<()> {
    run!(
        write,
        "UPDATE tasks SET held = 0 WHERE held = 1 AND job_id IN (SELECT id FROM jobs WHERE project = ? AND paused = 0)",
        project
    );
    replans::want(write, &format!("the budget of project {project} holds its tasks no more")).await?;
    Ok(())
}

/// Takes back a project's running tasks. The next renewal brings the order to stop; the tasks are ready but
/// held.
async fn stop(write: &mut Write, project: &str, now: Timestamp) -> Result<()> {
    let running = sqlx::query_scalar!(
        "SELECT l.id FROM leases l JOIN tasks t ON t.id = l.task_id JOIN jobs j ON j.id = t.job_id \
         WHERE l.state = 'active' AND j.project = ? ORDER BY l.id",
        project
    )
    .fetch_all(write.connection().await?)
    .await?;
    leases::take_back(write, running.into_iter().map(LeaseId::from), now).await
}

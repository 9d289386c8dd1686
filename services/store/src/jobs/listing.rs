//! Lists of jobs: filtered, searched and sorted.

use forelight_protocol::{Job, JobId, JobState, Timestamp};
use serde::{Deserialize, Serialize};
use sqlx::SqliteConnection;

use crate::columns::Json;
use crate::database::Store;
use crate::error::Result;
use crate::jobs::read_all;

/// Which jobs to list.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct JobFilter {
    /// Only jobs that are not over.
    pub open: bool,
    /// Only jobs in this state.
    pub state: Option<JobState>,
    /// Only jobs of this project.
    pub project: Option<String>,
    /// Only jobs of one of these projects.
    pub projects: Option<Vec<String>>,
    /// Only jobs with exactly this name.
    pub name: Option<String>,
    /// Only jobs with this text in the names of job or project, whatever its case in ASCII.
    pub search: Option<String>,
}

/// The order of a list of jobs.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum JobOrder {
    /// Newest first.
    #[default]
    Newest,
    /// Those at risk first, then by deadline.
    Risk,
    /// By deadline; jobs without one last.
    Deadline,
    /// By name.
    Name,
    /// By the cost of their bookings, dearest first; jobs without any last.
    Cost,
}

/// A job's place in an order. Numbers that the order does not use are 0.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct JobPlace {
    /// 0 at risk, 1 not; or the cost.
    pub first: i64,
    /// The deadline.
    pub due: i64,
    /// The name.
    pub name: String,
    /// The id, which decides between equals.
    pub id: JobId,
}

impl JobOrder {
    /// The place of a job.
    pub fn place(self, job: &Job) -> JobPlace {
        let due = job.deadline.map_or(i64::MAX, Timestamp::micros);
        let none = JobPlace { first: 0, due: 0, name: String::new(), id: job.id };
        match self {
            JobOrder::Newest => none,
            JobOrder::Risk => JobPlace { first: i64::from(!is_at_risk(job)), due, ..none },
            JobOrder::Deadline => JobPlace { due, ..none },
            JobOrder::Name => JobPlace { name: job.name.clone(), ..none },
            JobOrder::Cost => {
                let cost = job.verdict.as_ref().and_then(|verdict| verdict.cost);
                JobPlace { first: cost.map_or(-1, |cost| cost.micro_units()), ..none }
            }
        }
    }
}

/// As the column `at_risk` says, see `0020_farm_size.sql`.
fn is_at_risk(job: &Job) -> bool {
    let misses = job.promise.as_ref().is_some_and(|promise| !promise.kept);
    let said = job.verdict.as_ref().map(|verdict| verdict.verdict);
    misses || said.is_some_and(|verdict| verdict != forelight_protocol::Verdict::OnTime)
}

/// Ids of a page of jobs: `?1` to `?4` are the filter, `?5` to `?8` the place after which it begins, `?9` is
/// the number of rows, `?10` the projects that the caller sees. Only ids are sorted: the rows of jobs are
/// long.
macro_rules! ids {
    (($connection:expr, $filter:expr, $after:expr, $limit:expr), $from:literal, $order:literal) => {
        sqlx::query_scalar!(
            "SELECT id FROM jobs " + $from
                + " AND (?1 IS NULL OR state = ?1) AND (?2 IS NULL OR project = ?2) AND (?3 IS NULL OR name = ?3) \
                   AND (?4 IS NULL OR instr(lower(name), ?4) > 0 OR instr(lower(project), ?4) > 0) \
                   AND (?10 IS NULL OR project IN (SELECT value FROM json_each(?10))) "
                + $order,
            $filter.state.map(JobState::name),
            $filter.project,
            $filter.name,
            $filter.search.as_ref().map(|text| text.to_ascii_lowercase()),
            $after.first,
            $after.due,
            $after.name,
            $after.id.0,
            $limit,
            $filter.projects.as_ref().map(Json)
        )
        .fetch_all(&mut *$connection)
        .await?
    };
}

/// The same in each order. SQLite would look for the newest ones by the primary key alone.
macro_rules! ids_in_order {
    ($asked:tt, $order:expr, $from:literal) => {
        ids_in_order!($asked, $order, $from, newest: $from)
    };
    ($asked:tt, $order:expr, $from:literal, newest: $newest:literal) => {
        match $order {
            JobOrder::Newest => ids!($asked, $newest, "AND id < ?8 ORDER BY id DESC LIMIT ?9"),
            JobOrder::Risk => ids!(
                $asked,
                $from,
                "AND (1 - at_risk, due_at, id) > (?5, ?6, ?8) ORDER BY at_risk DESC, due_at, id LIMIT ?9"
            ),
            JobOrder::Deadline => {
                ids!($asked, $from, "AND (due_at, id) > (?6, ?8) ORDER BY due_at, id LIMIT ?9")
            }
            JobOrder::Name => ids!($asked, $from, "AND (name, id) > (?7, ?8) ORDER BY name, id LIMIT ?9"),
            JobOrder::Cost => {
                ids!($asked, $from, "AND (by_cost, id) > (-?5, ?8) ORDER BY by_cost, id LIMIT ?9")
            }
        }
    };
}

impl Store {
    /// The jobs after `after` that match, in this order, at most `limit`.
    pub async fn jobs(
        &self,
        filter: &JobFilter,
        (order, after): (JobOrder, Option<&JobPlace>),
        limit: u32,
    ) -> Result<Vec<Job>> {
        let mut transaction = self.read().await?;
        let ids = ids(&mut transaction, filter, (order, after), limit).await?;
        read_all(&mut transaction, &ids).await
    }
}

/// The ids of such a page.
pub(crate) async fn ids(
    connection: &mut SqliteConnection,
    filter: &JobFilter,
    (order, after): (JobOrder, Option<&JobPlace>),
    limit: u32,
) -> Result<Vec<JobId>> {
    let first = match order {
        JobOrder::Newest => JobPlace { first: 0, due: 0, name: String::new(), id: JobId(uuid::Uuid::max()) },
        JobOrder::Cost => {
            JobPlace { first: i64::MAX, due: 0, name: String::new(), id: JobId(uuid::Uuid::nil()) }
        }
        _ => JobPlace { first: i64::MIN, due: i64::MIN, name: String::new(), id: JobId(uuid::Uuid::nil()) },
    };
    let after = after.unwrap_or(&first);
    let ids = if filter.open {
        ids_in_order!(
            (connection, filter, after, limit),
            order,
            "INDEXED BY jobs_open WHERE stage IN ('previewing', 'profiling', 'booked', 'rendering')"
        )
    } else {
        ids_in_order!(
            (connection, filter, after, limit),
            order,
            "WHERE 1",
            newest: "INDEXED BY jobs_newest WHERE 1"
        )
    };
    Ok(ids.into_iter().map(JobId::from).collect())
}

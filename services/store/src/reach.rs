//! Which projects a caller reaches, and with which role in each.
//!
//! The rule: whoever reaches some projects only, sees and changes what belongs to them, and is told of other
//! projects as of things that do not exist.

use std::collections::{BTreeMap, BTreeSet};

use forelight_protocol::{ArtifactHash, BundleId, JobId, Role, TaskId};

use crate::columns::Json;
use crate::database::Store;
use crate::error::{Result, StoreError};
use crate::tokens::Principal;

/// In place of a project's name: the role holds in all that have no role of their own.
pub const ALL_PROJECTS: &str = "*";

impl Principal {
    /// The role in this project, if the caller reaches it.
    fn role_in(&self, project: &str) -> Option<Role> {
        match &self.projects {
            None => Some(self.role),
            Some(projects) => projects.get(project).or_else(|| projects.get(ALL_PROJECTS)).copied(),
        }
    }

    /// Whether the caller sees what belongs to any project.
    pub fn reaches_all(&self) -> bool {
        self.projects.as_ref().is_none_or(|projects| projects.contains_key(ALL_PROJECTS))
    }

    /// Whether the caller sees what belongs to this project.
    pub fn sees(&self, project: &str) -> bool {
        self.role_in(project).is_some()
    }

    /// Whether the caller may submit jobs to this project, and change and cancel them.
    pub fn may_change(&self, project: &str) -> bool {
        matches!(self.role_in(project), Some(Role::Submitter | Role::Operator))
    }

    /// The names of the projects, if the caller reaches some only.
    pub fn project_names(&self) -> Option<Vec<String>> {
        let projects = self.projects.as_ref().filter(|_| !self.reaches_all());
        projects.map(|projects| projects.keys().cloned().collect())
    }
}

/// The highest of these roles: what a token allows somewhere.
pub(crate) fn highest(projects: &BTreeMap<String, Role>) -> Role {
    let may_submit = projects.values().any(|role| *role == Role::Submitter);
    if may_submit { Role::Submitter } else { Role::Viewer }
}

impl Store {
    /// The project of a job.
    pub async fn project_of_job(&self, job: JobId) -> Result<String> {
        let project = sqlx::query_scalar!("SELECT project FROM jobs WHERE id = ?", job.0);
        project.fetch_optional(self.readers()).await?.ok_or(StoreError::NotFound("job"))
    }

    /// The project of a task's job.
    pub async fn project_of_task(&self, task: TaskId) -> Result<String> {
        let project = sqlx::query_scalar!(
            "SELECT j.project FROM tasks t JOIN jobs j ON j.id = t.job_id WHERE t.id = ?",
            task.0
        );
        project.fetch_optional(self.readers()).await?.ok_or(StoreError::NotFound("task"))
    }

    /// Whether a caller sees this bundle: he uploaded it, or a job of his projects uses it.
    pub async fn sees_bundle(&self, caller: &Principal, bundle: BundleId) -> Result<bool> {
        let Some(projects) = caller.project_names() else { return Ok(true) };
        Ok(sqlx::query_scalar!(
            r#"SELECT EXISTS (SELECT 1 FROM bundles WHERE id = ?1 AND uploaded_by = ?2)
               OR EXISTS (SELECT 1 FROM jobs WHERE bundle_id = ?1
                          AND project IN (SELECT value FROM json_each(?3))) AS "sees!: bool""#,
            bundle.0,
            caller.name,
            Json(&projects)
        )
        .fetch_one(self.readers())
        .await?)
    }

    /// Whether a caller sees this artefact: it is part of a result or a frame of a job of his projects, or of
    /// a bundle that he sees.
    pub async fn sees_artifact(&self, caller: &Principal, hash: ArtifactHash) -> Result<bool> {
        let Some(projects) = caller.project_names() else { return Ok(true) };
        Ok(sqlx::query_scalar!(
            r#"SELECT EXISTS (SELECT 1 FROM result_artifacts a JOIN tasks t ON t.id = a.task_id
                              JOIN jobs j ON j.id = t.job_id WHERE a.hash = ?1
                              AND j.project IN (SELECT value FROM json_each(?3)))
               OR EXISTS (SELECT 1 FROM bundles b WHERE b.hash = ?1 AND (b.uploaded_by = ?2
                          OR EXISTS (SELECT 1 FROM jobs j WHERE j.bundle_id = b.id
                                     AND j.project IN (SELECT value FROM json_each(?3))))) AS "sees!: bool""#,
            &hash.0[..],
            caller.name,
            Json(&projects)
        )
        .fetch_one(self.readers())
        .await?)
    }

    /// Those of these jobs that a caller sees.
    pub async fn seen_jobs(
        &self,
        caller: &Principal,
        jobs: impl IntoIterator<Item = JobId>,
    ) -> Result<BTreeSet<JobId>> {
        let mut seen = BTreeSet::new();
        let mut asked: Vec<JobId> = jobs.into_iter().collect();
        asked.sort_unstable();
        asked.dedup();
        for job in asked {
            match self.project_of_job(job).await {
                Ok(project) if caller.sees(&project) => {
                    seen.insert(job);
                }
                Ok(_) | Err(StoreError::NotFound(_)) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(seen)
    }
}

//! What is deleted with time, and what stays.

use forelight_protocol::{
    AuditAction, Money, ProjectRequest, Pruned, PrunedKind, RetentionKind, RetentionRule,
};

use super::*;
use crate::{AuditFilter, StoreError};

const DAY: i64 = 86_400;

/// A job of one frame that was done at the 100th second.
async fn done_job(farm: &Farm) -> JobId {
    let node = farm.node("n").await.id;
    let job = farm.booked_job(request("1"), node, at(10)).await;
    let lease = farm.claim(node, at(20)).await.expect("a frame");
    farm.commit(&lease, at(100)).await;
    assert!(farm.store.job(job).await.unwrap().state.is_final());
    job
}

async fn set(farm: &Farm, kind: RetentionKind, project: Option<&str>, days: Option<u32>) {
    let rule = RetentionRule { project: project.map(str::to_owned), kind, days };
    farm.store.set_retention(&rule, at(0)).await.unwrap();
}

fn number(pruned: &forelight_protocol::Pruned, kind: RetentionKind) -> u64 {
    pruned.items.iter().find(|item| item.kind == kind).unwrap().number
}

/// Number of rows of all tables that have a column `job_id` or belong to a job.
async fn rows_of(farm: &Farm, job: JobId) -> Vec<(String, i64)> {
    let tables: Vec<String> = sqlx::query_scalar(
        "SELECT m.name FROM sqlite_master m JOIN pragma_table_info(m.name) c \
         WHERE m.type = 'table' AND c.name = 'job_id' ORDER BY 1",
    )
    .fetch_all(farm.store.readers())
    .await
    .unwrap();
    let mut rows = Vec::new();
    for table in tables {
        let count = sqlx::AssertSqlSafe(format!("SELECT count(*) FROM {table} WHERE job_id = ?"));
        let number: i64 =
            sqlx::query_scalar(count).bind(job.0).fetch_one(farm.store.readers()).await.unwrap();
        rows.push((table, number));
    }
    rows
}

#[tokio::test]
async fn a_deleted_job_leaves_no_row_but_what_it_cost() {
    let farm = Farm::new().await;
    let job = done_job(&farm).await;
    let (from, now) = (at(-DAY), at(200));
    let budget = |amount| forelight_protocol::BudgetRequest {
        project: "default".to_owned(),
        period: forelight_protocol::BudgetPeriod::Total,
        amount: Money(amount),
        zone: "UTC".to_owned(),
        thresholds: Vec::new(),
    };
    let project = farm.store.job(job).await.unwrap().project;
    let request = forelight_protocol::BudgetRequest { project: project.clone(), ..budget(1_000_000_000) };
    let before = farm.store.set_budget(&request, now).await.unwrap().spent;
    let lines = farm.store.ledger(from, now).await.unwrap();
    assert!(before > Money(0) && lines.iter().all(|line| line.of.is_some()));
    assert!(rows_of(&farm, job).await.iter().any(|(_, number)| *number > 0));

    farm.store.delete_job(job, now).await.unwrap();

    let left: Vec<_> = rows_of(&farm, job).await.into_iter().filter(|(_, number)| *number > 0).collect();
    assert_eq!(left, []);
    assert!(matches!(farm.store.job(job).await, Err(StoreError::NotFound("job"))));
    assert_eq!(farm.store.budgets(now).await.unwrap()[0].spent, before);
    let lines = farm.store.ledger(from, now).await.unwrap();
    let cost: i64 = lines.iter().map(|line| line.cost_within(from, now).0).sum();
    assert_eq!((cost, lines.iter().all(|line| line.of.is_none())), (before.0, true));
    let used = farm.store.projects(now).await.unwrap().into_iter().find(|used| used.name == project).unwrap();
    assert_eq!(used.used.iter().map(|(_, micros)| micros).sum::<i64>(), 80 * SECOND);
    // Everything still fits together.
    let farm = farm.restarted().await;
    assert_eq!(farm.store.budgets(now).await.unwrap()[0].spent, before);
}

#[tokio::test]
async fn an_open_job_is_not_deleted() {
    let farm = Farm::new().await;
    let job = farm.job("1").await.id;
    assert!(matches!(farm.store.delete_job(job, at(1)).await, Err(StoreError::Conflict(_))));
    let later = at(4000 * DAY);
    let pruned = farm.store.prune(false, later).await.unwrap();
    let of_jobs = |kind| !matches!(kind, RetentionKind::Events | RetentionKind::Audit);
    assert!(pruned.items.iter().filter(|item| of_jobs(item.kind)).all(|item| item.number == 0));
    assert!(farm.store.job(job).await.is_ok());
}

#[tokio::test]
async fn each_kind_goes_after_its_days_and_files_a_day_after_the_last_that_refers_to_them() {
    let farm = Farm::new().await;
    let job = done_job(&farm).await;
    let (image, profile) = (farm.artifact("an image").await, farm.artifact("a profile").await);
    let holds = async |hash| farm.store.artifacts().size(hash).await.is_ok();

    // After eight days, profiles are past their time: first a mark, a day later the file.
    let dry = farm.store.prune(true, at(8 * DAY)).await.unwrap();
    assert_eq!(number(&dry, RetentionKind::Profiles), 1);
    assert_eq!(number(&farm.store.prune(false, at(8 * DAY)).await.unwrap(), RetentionKind::Profiles), 1);
    assert!(holds(profile).await);
    let pruned = farm.store.prune(false, at(9 * DAY + 1)).await.unwrap();
    assert_eq!((number(&pruned, RetentionKind::Profiles), pruned.deleted.number), (0, 1));
    assert!(!holds(profile).await && holds(image).await);
    let retried = farm.store.retry_frames(job, &"1".parse().unwrap(), at(9 * DAY)).await;
    assert!(matches!(retried, Err(StoreError::Conflict(reason)) if reason.contains("profiles")));

    farm.store.prune(false, at(91 * DAY)).await.unwrap();
    farm.store.prune(false, at(93 * DAY)).await.unwrap();
    assert!(!holds(image).await);
    assert_eq!(farm.store.frame(job, 1).await.unwrap().artifacts.image_png, None);
    assert!(farm.store.job(job).await.is_ok());

    let pruned = farm.store.prune(false, at(366 * DAY)).await.unwrap();
    assert_eq!(number(&pruned, RetentionKind::Jobs), 1);
    assert!(matches!(farm.store.job(job).await, Err(StoreError::NotFound("job"))));
    assert_eq!(farm.store.retention().await.unwrap().last, Some(pruned));
}

#[tokio::test]
async fn a_project_keeps_its_images_longer_than_the_farm() {
    let farm = Farm::new().await;
    let job = done_job(&farm).await;
    let project = farm.store.job(job).await.unwrap().project;
    set(&farm, RetentionKind::Images, None, Some(1)).await;
    set(&farm, RetentionKind::Images, Some(&project), None).await;
    assert_eq!(number(&farm.store.prune(false, at(50 * DAY)).await.unwrap(), RetentionKind::Images), 0);
    set(&farm, RetentionKind::Images, Some(&project), Some(3)).await;
    assert_eq!(number(&farm.store.prune(false, at(50 * DAY)).await.unwrap(), RetentionKind::Images), 1);
}

#[tokio::test]
async fn bytes_that_a_worker_is_about_to_name_stay() {
    let farm = Farm::new().await;
    let hash = farm.artifact("fresh").await;
    farm.store.prune(false, at(0)).await.unwrap();
    // It is uploaded again, or asked for, a day later: the day begins anew.
    farm.artifact("fresh").await;
    farm.store.prune(false, at(2 * DAY)).await.unwrap();
    farm.store.artifacts().announce(hash).await.unwrap();
    let pruned = farm.store.prune(false, at(4 * DAY)).await.unwrap();
    assert_eq!((pruned.deleted.number, pruned.waiting.number), (0, 1));
    assert_eq!(farm.store.prune(false, at(6 * DAY)).await.unwrap().deleted.number, 1);
    assert!(matches!(farm.store.artifacts().announce(hash).await, Err(StoreError::NotFound(_))));
    // The same bytes may come again.
    farm.artifact("fresh").await;
    assert_eq!(farm.store.artifacts().size(hash).await.unwrap(), 5);
}

#[tokio::test]
async fn a_file_without_a_row_is_deleted_once_it_is_old() {
    let farm = Farm::new().await;
    let hash = farm.artifact("kept").await;
    let name = ArtifactHash([7; 32]).to_string();
    let folder = farm.folder.path().join("artifacts/blake3").join(&name[..2]);
    std::fs::create_dir_all(&folder).unwrap();
    let stray = folder.join(&name);
    std::fs::write(&stray, "left by a crash").unwrap();
    // Files have the time of this machine.
    let written = std::fs::metadata(&stray).unwrap().modified().unwrap();
    let written = written.duration_since(std::time::UNIX_EPOCH).unwrap().as_micros() as i64;
    let after = |days: i64| Timestamp::from_micros(written + days * DAY * SECOND);
    farm.store.prune(false, after(0)).await.unwrap();
    assert!(stray.exists());
    farm.store.prune(false, after(2)).await.unwrap();
    assert!(!stray.exists());
    let _ = hash;
}

#[tokio::test]
async fn old_plans_go_and_the_newest_and_those_of_jobs_stay() {
    let farm = Farm::new().await;
    let node = farm.node("n").await.id;
    let jobs = [request("1"), request("2")];
    let mut kept = Vec::new();
    for (request, i) in jobs.into_iter().zip(0i64..) {
        kept.push(farm.booked_job(request, node, at(10 + 100 * i)).await);
    }
    let plan = async |job| farm.store.job(job).await.unwrap().plan_id.unwrap();
    let (first, second) = (plan(kept[0]).await, plan(kept[1]).await);
    farm.store.prune(false, at(20 * DAY)).await.unwrap();
    assert!(farm.store.plan(first).await.is_ok() && farm.store.plan(second).await.is_ok());
    farm.store.cancel_job(kept[0], at(20 * DAY)).await.unwrap();
    farm.store.delete_job(kept[0], at(20 * DAY)).await.unwrap();
    let pruned = farm.store.prune(false, at(40 * DAY)).await.unwrap();
    assert_eq!(number(&pruned, RetentionKind::Plans), 1);
    assert!(matches!(farm.store.plan(first).await, Err(StoreError::NotFound(_))));
    assert_eq!(farm.store.plan(second).await.unwrap().parent_id, None);
    assert!(pruned.items.contains(&PrunedKind { kind: RetentionKind::Scenes, number: 0, bytes: 0 }));
}

#[tokio::test]
async fn old_entries_of_the_audit_go_and_an_entry_says_so() {
    let farm = Farm::new().await;
    farm.store.set_share(&ProjectRequest { project: "film".to_owned(), share: 2 }, at(0)).await.unwrap();
    farm.store
        .set_share(&ProjectRequest { project: "film".to_owned(), share: 3 }, at(20 * DAY))
        .await
        .unwrap();
    let rule = RetentionRule { project: None, kind: RetentionKind::Audit, days: Some(10) };
    farm.store.set_retention(&rule, at(20 * DAY)).await.unwrap();
    let number =
        |pruned: Pruned| pruned.items.iter().find(|item| item.kind == RetentionKind::Audit).unwrap().number;
    assert_eq!(number(farm.store.prune(true, at(25 * DAY)).await.unwrap()), 1);
    assert_eq!(number(farm.store.prune(false, at(25 * DAY)).await.unwrap()), 1);
    let entries = farm.store.audit(&AuditFilter::default(), None, 10).await.unwrap();
    let actions: Vec<AuditAction> = entries.iter().map(|entry| entry.action).collect();
    assert_eq!(actions, [AuditAction::AuditPruned, AuditAction::RetentionSet, AuditAction::ProjectSet]);
    assert_eq!(entries[0].detail.as_ref().unwrap()["entries"], 1);
    // A round without anything to delete says nothing.
    farm.store.prune(false, at(26 * DAY)).await.unwrap();
    assert_eq!(farm.store.audit(&AuditFilter::default(), None, 10).await.unwrap().len(), 3);
}

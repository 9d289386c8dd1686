//! Tasks that fail, and nodes that are at fault.

use forelight_protocol::{
    EventKind, JobState, LogLevel, LogLine, NodeChange, NodeState, TaskError, TaskId, TaskLimit,
};

use super::*;
use crate::policy::faults::FAULTS;
use crate::policy::retries::MAX_FAILURES;

fn error(message: &str) -> TaskError {
    TaskError { message: message.to_owned(), ..TaskError::default() }
}

impl Farm {
    async fn fail(&self, lease: &Lease, error: &TaskError, now: Timestamp) -> JobState {
        self.store.fail_task(lease.lease_id, lease.fence, error, now).await.unwrap().1
    }
}

#[tokio::test]
async fn a_task_that_failed_waits_and_then_goes_to_another_node_first() {
    let farm = Farm::new().await;
    let (a, b) = (farm.node("a").await, farm.node("b").await);
    farm.job("0").await;
    let lease = farm.claim(a.id, at(0)).await.unwrap();
    assert_eq!(farm.fail(&lease, &error("disk full"), at(0)).await, JobState::Previewing);
    assert_eq!(farm.claim(b.id, at(0)).await, None, "at once");
    let due = farm.store.next_retry(at(0)).await.unwrap().unwrap();
    assert!((at(0)..=at(1)).contains(&due), "{due}");
    assert!(!farm.store.may_have_work(b.id, None, at(0)).await.unwrap());
    assert!(farm.store.may_have_work(b.id, None, at(1)).await.unwrap());
    assert_eq!(farm.claim(a.id, at(2)).await, None, "on the node that it failed on");
    assert_eq!(farm.store.next_retry(at(2)).await.unwrap(), Some(due.plus_micros(10 * SECOND)));
    let retried = farm.claim(b.id, at(2)).await.unwrap();
    assert_eq!((retried.task_id, retried.fence), (lease.task_id, 2));
    farm.store.release(retried.lease_id, retried.fence, at(3)).await.unwrap();
    // Where there is no other, the same node has to do.
    assert_eq!(farm.claim(a.id, at(12)).await.unwrap().task_id, lease.task_id);
    assert_eq!(farm.store.next_retry(at(12)).await.unwrap(), None);
}

#[tokio::test]
async fn a_task_that_is_asked_for_by_its_id_waits_after_a_failure_and_is_refused_while_a_budget_holds_it() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.job("0").await;
    let lease = farm.claim(node.id, at(0)).await.unwrap();
    farm.fail(&lease, &error("disk full"), at(0)).await;
    let by_id = async |seconds| farm.store.claim_task(node.id, lease.task_id, TTL, None, at(seconds)).await;
    assert!(by_id(0).await.unwrap().is_none(), "at once");
    let mut write = farm.store.write().await.unwrap();
    sqlx::query("UPDATE tasks SET held = 1").execute(write.connection().await.unwrap()).await.unwrap();
    farm.store.commit(write).await.unwrap();
    let refused = by_id(2).await;
    assert!(
        matches!(&refused, Err(crate::StoreError::Conflict(why)) if why.contains("budget")),
        "{refused:?}"
    );
    let mut write = farm.store.write().await.unwrap();
    sqlx::query("UPDATE tasks SET held = 0").execute(write.connection().await.unwrap()).await.unwrap();
    farm.store.commit(write).await.unwrap();
    // A process that was started for the task may work on the node where it failed.
    assert!(by_id(2).await.unwrap().is_some());
}

#[tokio::test]
async fn the_third_node_that_a_task_fails_on_fails_the_job_and_the_same_report_counts_once() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.booked_job(request("0-1"), node.id, at(0)).await;
    let other = farm.claim(node.id, at(1)).await.unwrap();
    let mut task = None;
    for (attempt, name) in (1..).zip(["a", "b", "c"]) {
        let node = farm.node(name).await;
        let lease = farm.claim(node.id, at(5 * attempt)).await.unwrap();
        assert_eq!(lease.spec.frame(), Some(1));
        task = Some(lease.task_id);
        let message = error(&format!("out of memory, {attempt}"));
        let state = farm.fail(&lease, &message, at(5 * attempt)).await;
        assert_eq!(state == JobState::Failed, attempt == 3, "{attempt}");
        let again = farm.store.fail_task(lease.lease_id, lease.fence, &message, at(1)).await.unwrap();
        assert!(again.0, "the same report again counts once");
    }
    let failed = farm.store.job(job).await.unwrap();
    let said = format!(
        "render of frame 1: out of memory, 3 (it failed on a, b, c; the log of task {} says more)",
        task.unwrap()
    );
    assert_eq!(failed.error, Some(said));
    let order = farm.store.renew(other.lease_id, &renewal(other.fence, 0.1), TTL, at(16)).await;
    assert_eq!(order.unwrap().order, forelight_protocol::LeaseOrder::Stop);
    // It was the task's fault: no node is set aside.
    assert_eq!(farm.store.node(node.id).await.unwrap().set_aside, None);
}

#[tokio::test]
async fn on_a_farm_of_one_node_the_sixth_failure_is_the_last() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.job("0").await;
    for attempt in 1..=i64::from(MAX_FAILURES) {
        let lease = farm.claim(node.id, at(100 * attempt)).await.unwrap();
        let state = farm.fail(&lease, &error("no luck"), at(100 * attempt)).await;
        assert_eq!(state == JobState::Failed, attempt == i64::from(MAX_FAILURES));
    }
}

#[tokio::test]
async fn a_node_whose_failures_no_other_shares_is_set_aside_with_the_reason_until_it_is_brought_back() {
    let farm = Farm::new().await;
    let (bad, good) = (farm.node("bad").await, farm.node("good").await);
    for round in 0..FAULTS {
        assert_eq!(farm.store.node(bad.id).await.unwrap().set_aside, None, "after {round} failures");
        farm.job("0").await;
        let lease = farm.claim(bad.id, at(20 * round)).await.unwrap();
        farm.fail(&lease, &error("no GPU"), at(20 * round)).await;
        assert_eq!(farm.store.node(bad.id).await.unwrap().set_aside, None, "others may fail as well");
        let lease = farm.claim(good.id, at(20 * round + 2)).await.unwrap();
        farm.commit(&lease, at(20 * round + 3)).await;
    }
    let node = farm.store.node(bad.id).await.unwrap();
    let reason = node.set_aside.clone().unwrap();
    assert_eq!(node.state, NodeState::SetAside);
    assert!(reason.contains("3 tasks") && reason.contains("no other node shared"), "{reason}");
    farm.job("0").await;
    assert_eq!(farm.claim(bad.id, at(100)).await, None);
    // The others' work goes on, and registering again does not help.
    let lease = farm.claim(good.id, at(100)).await.unwrap();
    farm.commit(&lease, at(101)).await;
    assert!(farm.node("bad").await.set_aside.is_some());
    assert_eq!(farm.events(EventKind::NodeSetAside).await.len(), 1);
    let back = NodeChange { set_aside: Some(false), ..NodeChange::default() };
    let node = farm.store.change_node(bad.id, &back, at(102)).await.unwrap();
    assert_eq!((node.set_aside, node.state), (None, NodeState::Idle));
    // What was is forgiven: one more failure does not set it aside again.
    farm.job("0").await;
    let lease = farm.claim(bad.id, at(200)).await.unwrap();
    farm.fail(&lease, &error("no GPU"), at(200)).await;
    let lease = farm.claim(good.id, at(202)).await.unwrap();
    farm.commit(&lease, at(203)).await;
    assert_eq!(farm.store.node(bad.id).await.unwrap().set_aside, None);
}

#[tokio::test]
async fn a_node_whose_workers_crash_on_what_others_do_is_set_aside_and_one_that_falls_silent_is_not() {
    let farm = Farm::new().await;
    let good = farm.node("good").await;
    let (crashing, silent) =
        (farm.new_worker("crashing", at(0)).await, farm.new_worker("silent", at(0)).await);
    for round in 1..=FAULTS {
        assert_eq!(farm.store.node(crashing.id).await.unwrap().set_aside, None, "round {round}");
        for (node, crashes) in [(&crashing, true), (&silent, false)] {
            let start = at(1000 * round + 500 * i64::from(crashes));
            let (soon, later) = (start.plus_micros(SECOND), start.plus_micros(60 * SECOND));
            farm.node("good").await;
            farm.job("0").await;
            farm.claim(node.id, start).await.unwrap();
            if crashes {
                farm.new_worker(&node.name, soon).await;
            }
            let lease = farm.claim(good.id, later).await.unwrap();
            farm.commit(&lease, later).await;
        }
    }
    let reason = farm.store.node(crashing.id).await.unwrap().set_aside.unwrap();
    assert!(reason.contains("3 tasks") && reason.contains("no other node shared"), "{reason}");
    assert_eq!(
        farm.store.node(silent.id).await.unwrap().set_aside,
        None,
        "machines are switched off at night"
    );
}

#[tokio::test]
async fn what_others_share_or_the_job_set_itself_is_not_held_against_a_node() {
    let farm = Farm::new().await;
    let (node, other) = (farm.node("a").await, farm.node("b").await);
    let limited = TaskError { limit: Some(TaskLimit::Memory), ..error("beyond its limit") };
    for round in 0..8 {
        farm.job("0").await;
        let lease = farm.claim(node.id, at(20 * round)).await.unwrap();
        farm.fail(&lease, &limited, at(20 * round)).await;
        let lease = farm.claim(other.id, at(20 * round + 2)).await.unwrap();
        farm.commit(&lease, at(20 * round + 3)).await;
    }
    for round in 10..14 {
        let permanent = TaskError { permanent: true, ..error("scene.json: line 3: no mesh") };
        let job = farm.job("0").await;
        for (node, failed) in [(node.id, JobState::Previewing), (other.id, JobState::Failed)] {
            let now = at(20 * round + i64::from(failed == JobState::Failed) * 2);
            let lease = farm.claim(node, now).await.unwrap();
            assert_eq!(farm.fail(&lease, &permanent, now).await, failed, "a second node agrees");
        }
        let failed = farm.store.job(job.id).await.unwrap().error.unwrap();
        assert_eq!(failed, "preview: scene.json: line 3: no mesh");
    }
    for node in [node.id, other.id] {
        assert_eq!(farm.store.node(node).await.unwrap().set_aside, None);
    }
}

#[tokio::test]
async fn the_word_permanent_of_one_node_fails_no_job_while_another_could_try() {
    let farm = Farm::new().await;
    let (liar, honest) = (farm.node("liar").await, farm.node("honest").await);
    let kind = forelight_protocol::FailureKind::Task;
    let permanent = TaskError { permanent: true, kind, ..error("this scene is hopeless") };
    for round in 0..4 {
        let job = farm.booked_job(request("0"), honest.id, at(0)).await;
        let start = 1000 * (round + 1);
        touch(&farm.store, honest.id, at(start)).await;
        let Some(lease) = farm.claim(liar.id, at(start)).await else {
            // It was at fault for three tasks, and is set aside.
            assert_eq!(round, FAULTS);
            break;
        };
        for again in 0..7 {
            // While the other is busy, the same node fails again and again.
            let now = at(start + 100 * again);
            touch(&farm.store, honest.id, now).await;
            let lease = if again == 0 { lease.clone() } else { farm.claim(liar.id, now).await.unwrap() };
            assert_ne!(farm.fail(&lease, &permanent, now).await, JobState::Failed);
        }
        let lease = farm.claim(honest.id, at(start + 700)).await.unwrap();
        farm.commit(&lease, at(start + 701)).await;
        assert_eq!(farm.store.job(job).await.unwrap().state, JobState::Done);
    }
    assert!(farm.store.node(liar.id).await.unwrap().set_aside.is_some());
    assert_eq!(farm.store.node(honest.id).await.unwrap().set_aside, None);
}

#[tokio::test]
async fn where_there_is_no_other_node_a_permanent_error_is_believed_at_the_third_time_without_delay() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.job("0").await;
    let permanent = TaskError { permanent: true, ..error("no such mesh") };
    for (attempt, second) in [(1, 0), (2, 2), (3, 5)] {
        let lease = farm.claim(node.id, at(second)).await.unwrap();
        let state = farm.fail(&lease, &permanent, at(second)).await;
        assert_eq!(state == JobState::Failed, attempt == 3, "{attempt}");
    }
}

#[tokio::test]
async fn input_that_is_gone_fails_the_job_with_its_path_and_counts_against_no_node() {
    let farm = Farm::new().await;
    let (node, other) = (farm.node("a").await, farm.node("b").await);
    for round in 0..4 {
        let job = farm.job("0").await;
        let lease = farm.claim(node.id, at(round)).await.unwrap();
        // The worker has no idea why it failed. The bundle, /scenes/a, does not exist.
        let seen = farm.store.after_a_look(lease.lease_id, error("it crashed"), at(1)).await.unwrap();
        assert_eq!(farm.fail(&lease, &seen, at(round)).await, JobState::Failed);
        let said = farm.store.job(job.id).await.unwrap().error.unwrap();
        assert!(said.contains("its input is gone: bundle /scenes/a"), "{said}");
    }
    for node in [node.id, other.id] {
        assert_eq!(farm.store.node(node).await.unwrap().set_aside, None);
    }
}

#[tokio::test]
async fn the_log_of_a_task_is_kept_by_attempt_each_line_once_and_without_secrets() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.job("0").await;
    let line =
        |number, text: &str| LogLine { number, at: at(7), level: LogLevel::Warn, text: text.to_owned() };
    let lease = farm.claim(node.id, at(0)).await.unwrap();
    let secret = format!("forelight_{}", "ab".repeat(32));
    let first = RenewRequest { log: vec![line(0, "begun"), line(1, &secret)], ..renewal(1, 0.1) };
    for _ in 0..2 {
        farm.store.renew(lease.lease_id, &first, TTL, at(1)).await.unwrap();
    }
    // Beyond the bound nothing is kept, nor of a lease that is not the worker's.
    farm.store.keep_log(lease.lease_id, 1, &[line(2, "odd"), line(400, "too much")]).await.unwrap();
    farm.store.keep_log(lease.lease_id, 9, &[line(3, "a stranger")]).await.unwrap();
    farm.fail(&lease, &error("no"), at(2)).await;
    let again = farm.claim(node.id, at(50)).await.unwrap();
    farm.store.keep_log(again.lease_id, 2, &[line(0, "begun again")]).await.unwrap();
    let log = farm.store.task_log(lease.task_id).await.unwrap();
    let lines: Vec<_> =
        log.lines.iter().map(|line| (line.attempt, line.number, line.text.as_str())).collect();
    assert_eq!(lines, [(1, 0, "begun"), (1, 1, "forelight_…"), (1, 2, "odd"), (2, 0, "begun again")]);
    assert!(matches!(farm.store.task_log(TaskId::new()).await, Err(crate::StoreError::NotFound("task"))));
    farm.store.prune(false, at(40 * 24 * 3600)).await.unwrap();
    assert!(farm.store.task_log(lease.task_id).await.unwrap().lines.is_empty(), "kept for ever");
}

#[tokio::test]
async fn a_limit_of_the_job_reaches_every_one_of_its_tasks() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let limits = forelight_protocol::TaskLimits { memory_bytes: Some(1 << 30), wall_ms: Some(5000) };
    let job = farm.booked_job(JobRequest { limits, ..request("0") }, node.id, at(0)).await;
    assert_eq!(farm.claim(node.id, at(1)).await.unwrap().limits, limits);
    assert_eq!(farm.store.job(job).await.unwrap().limits, limits);
}

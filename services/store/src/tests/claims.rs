//! Who gets which task.

use std::collections::BTreeSet;

use forelight_protocol::{JobState, Money, NodeChange, TaskId, TaskKind};

use super::*;
use crate::{IdempotencyKey, StoreError};

#[tokio::test]
async fn a_new_job_offers_its_preview_and_nothing_else() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.job("0-9").await;
    let lease = farm.claim(node.id, at(0)).await.unwrap();
    assert_eq!((lease.job_id, lease.spec.kind(), lease.fence), (job.id, TaskKind::Preview, 1));
    assert_eq!(lease.expires_at, at(30));
    assert_eq!(farm.claim(node.id, at(0)).await, None);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn claimers_at_the_same_time_never_get_the_same_task() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    for _ in 0..40 {
        farm.job("0").await;
    }
    let mut claimers = tokio::task::JoinSet::new();
    for _ in 0..16 {
        let store = farm.store.clone();
        let node = node.id;
        claimers.spawn(async move {
            let mut mine = Vec::new();
            while let Some(lease) = store.claim(node, TTL, None, at(0)).await.unwrap() {
                mine.push(fresh(lease).task_id);
            }
            mine
        });
    }
    let all: Vec<_> = claimers.join_all().await.into_iter().flatten().collect();
    let distinct: BTreeSet<_> = all.iter().copied().collect();
    assert_eq!((all.len(), distinct.len()), (40, 40));
}

#[tokio::test]
async fn while_nothing_new_is_handed_out_claims_have_their_earlier_answers_and_nodes_are_heard_of() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.job("0").await;
    let key = |key: &str| IdempotencyKey { principal: [1; 32], key: key.to_owned(), request_hash: [1; 32] };
    let lease = fresh(farm.store.claim(node.id, TTL, Some(&key("before")), at(0)).await.unwrap().unwrap());
    farm.job("0").await;
    let nothing_new = async |name: &str, task: Option<TaskId>| {
        farm.store.claim_nothing_new(node.id, task, Some(&key(name)), at(20)).await
    };
    assert!(matches!(nothing_new("before", None).await, Ok(Some(Answered::Repeated(_)))));
    assert!(matches!(nothing_new("after", None).await, Ok(None)));
    assert_eq!(farm.store.node(node.id).await.unwrap().last_seen_at, at(20));
    farm.commit(&lease, at(21)).await;
    assert!(matches!(nothing_new("one", Some(lease.task_id)).await, Err(StoreError::Conflict(_))));
    assert!(farm.claim(node.id, at(22)).await.is_some(), "there was a task all the while");
}

#[tokio::test]
async fn the_database_itself_refuses_a_second_active_lease_on_a_task() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.job("0").await;
    let lease = farm.claim(node.id, at(0)).await.unwrap();
    let mut write = farm.store.write().await.unwrap();
    let error = sqlx::query(
        "INSERT INTO leases (id, task_id, node_id, fence, node_speed, state, granted_at, expires_at) \
         VALUES (?, ?, ?, 99, 1.0, 'active', 0, 0)",
    )
    .bind(forelight_protocol::LeaseId::new().0)
    .bind(lease.task_id.0)
    .bind(node.id.0)
    .execute(write.connection().await.unwrap())
    .await
    .unwrap_err();
    assert!(error.to_string().contains("UNIQUE"), "{error}");
}

#[tokio::test]
async fn own_bookings_come_first_by_planned_start_and_idle_nodes_help_out_with_the_rest() {
    let farm = Farm::new().await;
    let (a, b) = (farm.node("a").await, farm.node("b").await);
    let late = farm.booked_job(request("0-1"), a.id, at(500)).await;
    let early = farm.booked_job(request("0-1"), a.id, at(100)).await;
    let first = farm.claim(a.id, at(1)).await.unwrap();
    assert_eq!((first.job_id, first.spec.frame()), (early, Some(0)));
    // Nothing is booked on b: it takes what is due first, then what was submitted first.
    let helped = farm.claim(b.id, at(1)).await.unwrap();
    assert_eq!((helped.job_id, helped.spec.frame()), (late, Some(0)));
    let second = farm.claim(a.id, at(1)).await.unwrap();
    assert_eq!((second.job_id, second.spec.frame()), (early, Some(1)));
}

#[tokio::test]
async fn unbooked_work_goes_by_deadline_then_priority_then_frame() {
    let farm = Farm::new().await;
    let (a, b) = (farm.node("a").await, farm.node("b").await);
    let whenever = farm.booked_job(request("0"), a.id, at(100)).await;
    let urgent =
        farm.booked_job(JobRequest { deadline: Some(at(900)), ..request("0-1") }, a.id, at(300)).await;
    let favoured = farm
        .booked_job(JobRequest { deadline: Some(at(900)), priority: 5, ..request("7") }, a.id, at(400))
        .await;
    let mut order = Vec::new();
    while let Some(lease) = farm.claim(b.id, at(1)).await {
        order.push((lease.job_id, lease.spec.frame().unwrap()));
    }
    assert_eq!(order, [(favoured, 7), (urgent, 0), (urgent, 1), (whenever, 0)]);
}

#[tokio::test]
async fn quotes_come_before_renders() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.booked_job(request("0"), node.id, at(0)).await;
    let second = farm.job("0").await;
    let lease = farm.claim(node.id, at(1)).await.unwrap();
    assert_eq!((lease.job_id, lease.spec.kind()), (second.id, TaskKind::Preview));
}

#[tokio::test]
async fn a_draining_node_gets_nothing_until_it_is_undrained() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.job("0").await;
    let drain = |drain| NodeChange { drain: Some(drain), ..NodeChange::default() };
    farm.store.change_node(node.id, &drain(true), at(0)).await.unwrap();
    assert_eq!(farm.claim(node.id, at(0)).await, None);
    farm.store.change_node(node.id, &drain(false), at(0)).await.unwrap();
    assert!(farm.claim(node.id, at(0)).await.is_some());
}

#[tokio::test]
async fn a_speed_and_a_price_set_by_hand_outlive_registrations_until_they_are_given_up() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let numbers = |node: &Node| (node.speed, node.speed_set, node.price_per_hour.0, node.price_set);
    assert_eq!(numbers(&node), (2.0, false, 1_000_000, false));
    let change = NodeChange { speed: Some(Some(3.0)), ..NodeChange::default() };
    farm.store.change_node(node.id, &change, at(0)).await.unwrap();
    let change = NodeChange { price_per_hour: Some(Some(Money(7))), ..NodeChange::default() };
    farm.store.change_node(node.id, &change, at(0)).await.unwrap();
    // It starts again, and measures itself anew.
    let registration =
        NodeRegistration { speed: 1.5, price_per_hour: Money(9), cores: 4, ..registration("a") };
    let again = fresh(farm.store.register_node(&registration, None, at(1)).await.unwrap());
    assert_eq!((again.id, numbers(&again), again.cores), (node.id, (3.0, true, 7, true), 4));
    // What was set counts, and not only on paper.
    farm.job("0").await;
    let lease = farm.claim(node.id, at(1)).await.unwrap();
    let mut read = farm.store.read().await.unwrap();
    let speed = crate::leases::read(&mut read, lease.lease_id).await.unwrap().node_speed;
    drop(read);
    assert_eq!(speed, 3.0);
    let change = NodeChange { speed: Some(None), ..NodeChange::default() };
    let given_up = farm.store.change_node(node.id, &change, at(2)).await.unwrap();
    assert_eq!(numbers(&given_up), (1.5, false, 7, true));
}

#[tokio::test]
async fn the_first_claimed_frame_makes_the_job_rendering_and_the_last_committed_one_done() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.booked_job(request("3-4"), node.id, at(0)).await;
    assert_eq!(farm.store.job(job).await.unwrap().state, JobState::Booked);
    let first = farm.claim(node.id, at(1)).await.unwrap();
    assert_eq!(farm.store.job(job).await.unwrap().state, JobState::Rendering);
    assert_eq!(farm.commit(&first, at(2)).await.job_state, JobState::Rendering);
    let second = farm.claim(node.id, at(3)).await.unwrap();
    assert_eq!(farm.commit(&second, at(4)).await.job_state, JobState::Done);
    let done = farm.store.job(job).await.unwrap();
    assert_eq!((done.frames_done, done.progress, done.finished_at), (2, 1.0, Some(at(4))));
}

#[tokio::test]
async fn a_render_is_given_its_own_frames_profile_and_no_other() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.booked_job(request("3-4"), node.id, at(0)).await;
    let profile = farm.artifact("a profile").await;
    for expected in [Some(profile), None] {
        let lease = farm.claim(node.id, at(1)).await.unwrap();
        let TaskSpec::Render(spec) = &lease.spec else { panic!("{:?}", lease.spec) };
        assert_eq!(spec.profile, expected, "frame {}", spec.frame);
    }
}

/// What SQLite does for a query, step by step.
pub(super) async fn steps_of(farm: &Farm, query: &str) -> Vec<String> {
    let plan: Vec<(i64, i64, i64, String)> =
        sqlx::query_as(sqlx::AssertSqlSafe(format!("EXPLAIN QUERY PLAN {query}")))
            .fetch_all(farm.store.readers())
            .await
            .unwrap();
    plan.into_iter().map(|step| step.3).collect()
}

#[tokio::test]
async fn a_claim_finds_its_task_by_index_alone_however_many_there_are() {
    let farm = Farm::new().await;
    for (query, looks) in [(crate::claims::NEXT, 3), (crate::claims::asking::NEXT_BOOKED, 1)] {
        let steps = steps_of(&farm, query).await;
        // The other steps look at a task's failures, by index too, if it has any.
        let by_index = steps.iter().filter(|step| step.contains("USING INDEX tasks_ready")).count();
        assert_eq!(by_index, looks, "{query}: {steps:?}");
        let slow = |step: &String| step.starts_with("SCAN f") || step.contains("TEMP B-TREE");
        assert!(!steps.iter().any(slow), "{query}: {steps:?}");
    }
}

#[tokio::test]
async fn frames_find_their_tasks_one_by_one_however_many_the_job_has() {
    let farm = Farm::new().await;
    let statements = super::statements::checked();
    let by = |index: &'static str| statements.iter().filter(move |statement| statement.contains(index));
    let (of_frames, of_bookings) = (by("INDEXED BY tasks_of_frames"), by("INDEXED BY tasks_of_bookings"));
    assert_eq!((of_frames.clone().count(), of_bookings.clone().count()), (7, 4));
    for query in of_frames.chain(of_bookings) {
        let steps = steps_of(&farm, query).await;
        let task = steps.iter().find(|step| step.starts_with("SEARCH t "));
        assert!(task.is_some_and(|step| step.contains("(job_id=? AND frame=?")), "{query}: {steps:?}");
        // A list that a statement was given is read once, from its beginning to its end.
        let mut scans = steps.iter().enumerate().filter(|(_, step)| step.starts_with("SCAN"));
        let is_read_once = |place: usize| place == 0 || steps[place - 1].starts_with("LIST SUBQUERY");
        let is_list = |(place, step): (usize, &String)| step.contains("VIRTUAL TABLE") && is_read_once(place);
        assert!(scans.all(is_list), "{query}: {steps:?}");
    }
}

#[tokio::test]
async fn a_task_that_is_asked_for_by_its_id_is_handed_to_whoever_asks_one_at_a_time_and_refused_once_it_is_over()
 {
    let farm = Farm::new().await;
    let (first, second) = (farm.node("a").await, farm.node("b").await);
    farm.job("0-9").await;
    let wanted = farm.job("0").await;
    let offered = farm.claim(first.id, at(0)).await.unwrap();
    let task = farm.claim(first.id, at(0)).await.unwrap();
    farm.store.release(task.lease_id, task.fence, at(0)).await.unwrap();
    assert_eq!((offered.job_id == wanted.id, task.job_id), (false, wanted.id));
    // A process that is started on a node may work there.
    let drain = NodeChange { drain: Some(true), ..NodeChange::default() };
    farm.store.change_node(second.id, &drain, at(0)).await.unwrap();
    let by_id = async |node, seconds| farm.store.claim_task(node, task.task_id, TTL, None, at(seconds)).await;
    let lease = fresh(by_id(second.id, 1).await.unwrap().unwrap());
    assert_eq!((lease.task_id, lease.fence), (task.task_id, task.fence + 1));
    // Another one waits while that one lives, and takes over when it has died.
    assert!(by_id(first.id, 2).await.unwrap().is_none());
    let taken_over = fresh(by_id(first.id, 31).await.unwrap().unwrap());
    assert_eq!(taken_over.fence, lease.fence + 1);
    let late = farm.result_for(&lease).await;
    let late = farm.store.commit_result(lease.lease_id, lease.fence, &late, at(32)).await;
    assert!(matches!(late, Err(crate::StoreError::LeaseLost)), "{late:?}");
    farm.commit(&taken_over, at(33)).await;
    assert!(matches!(by_id(second.id, 34).await, Err(crate::StoreError::Conflict(_))));
    let unknown = farm.store.claim_task(first.id, forelight_protocol::TaskId::new(), TTL, None, at(0)).await;
    assert!(matches!(unknown, Err(crate::StoreError::NotFound("task"))));
}

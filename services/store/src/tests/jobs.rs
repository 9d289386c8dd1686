//! Submitting, listing, idempotency.

use forelight_protocol::{EventKind, JobState};

use super::*;
use crate::{IdempotencyKey, JobFilter, JobOrder, JobPlace, StoreError};

fn key(name: &str, request: u8) -> IdempotencyKey {
    IdempotencyKey { principal: [1; 32], key: name.to_owned(), request_hash: [request; 32] }
}

fn newest(after: Option<&JobPlace>) -> (JobOrder, Option<&JobPlace>) {
    (JobOrder::Newest, after)
}

#[tokio::test]
async fn a_repeated_request_gets_the_first_answer_even_after_a_restart() {
    let farm = Farm::new().await;
    let new = new_job(request("0-3"));
    let job = fresh(farm.store.create_job(&new, Some(&key("k", 1)), at(0)).await.unwrap());
    let farm = farm.restarted().await;
    let repeated = farm.store.create_job(&new, Some(&key("k", 1)), at(60)).await.unwrap();
    let Answered::Repeated(answer) = repeated else { panic!("a second job was made") };
    assert_eq!(answer.status, 201);
    assert_eq!(serde_json::from_str::<Job>(&answer.body).unwrap(), job);
    assert_eq!(farm.store.jobs(&JobFilter::default(), newest(None), 10).await.unwrap().len(), 1);
}

#[tokio::test]
async fn a_key_stands_for_one_request_of_one_client_for_a_day() {
    let farm = Farm::new().await;
    let new = new_job(request("0"));
    fresh(farm.store.create_job(&new, Some(&key("k", 1)), at(0)).await.unwrap());
    let reused = farm.store.create_job(&new, Some(&key("k", 2)), at(1)).await;
    assert!(matches!(reused, Err(StoreError::KeyReused)), "{reused:?}");
    let stranger = IdempotencyKey { principal: [2; 32], ..key("k", 2) };
    fresh(farm.store.create_job(&new, Some(&stranger), at(1)).await.unwrap());
    farm.store.sweep(at(86_401)).await.unwrap();
    fresh(farm.store.create_job(&new, Some(&key("k", 2)), at(86_402)).await.unwrap());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_request_sent_many_times_at_once_makes_one_job() {
    let farm = Farm::new().await;
    let mut senders = tokio::task::JoinSet::new();
    for _ in 0..12 {
        let store = farm.store.clone();
        senders.spawn(async move {
            store.create_job(&new_job(request("0")), Some(&key("k", 1)), at(0)).await.unwrap()
        });
    }
    let fresh =
        senders.join_all().await.iter().filter(|answered| matches!(answered, Answered::Fresh(_))).count();
    assert_eq!(fresh, 1);
    assert_eq!(farm.store.jobs(&JobFilter::default(), newest(None), 20).await.unwrap().len(), 1);
}

#[tokio::test]
async fn pages_of_jobs_are_newest_first_and_meet_without_gap_or_overlap() {
    let farm = Farm::new().await;
    let mut submitted = Vec::new();
    for i in 0..7 {
        let project = if i % 2 == 0 { "even" } else { "odd" };
        submitted.push(farm.submit(JobRequest { project: project.to_owned(), ..request("0") }).await.id);
    }
    submitted.reverse();
    let (mut paged, mut before) = (Vec::new(), None);
    loop {
        let page = farm.store.jobs(&JobFilter::default(), newest(before.as_ref()), 3).await.unwrap();
        let Some(last) = page.last() else { break };
        before = Some(JobOrder::Newest.place(last));
        paged.extend(page.iter().map(|job| job.id));
    }
    assert_eq!(paged, submitted);
    let filter = JobFilter {
        project: Some("odd".to_owned()),
        state: Some(JobState::Previewing),
        ..JobFilter::default()
    };
    assert_eq!(farm.store.jobs(&filter, newest(None), 10).await.unwrap().len(), 3);
}

#[tokio::test]
async fn events_of_a_job_come_in_order_and_from_any_place() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.booked_job(request("0"), node.id, at(0)).await;
    farm.job("0").await;
    let all = farm.store.events_after(Some(job), 0, 100).await.unwrap();
    let kinds: Vec<_> = all.iter().map(|event| event.kind).collect();
    use EventKind::*;
    assert_eq!(
        kinds,
        [
            JobCreated,
            TaskLeased,
            TaskDone,
            JobState,
            TaskLeased,
            TaskDone,
            ForecastReady,
            PlanStored,
            JobState
        ]
    );
    assert!(all.windows(2).all(|pair| pair[0].id < pair[1].id));
    assert_eq!(farm.store.events_after(Some(job), all[3].id, 2).await.unwrap(), all[4..6]);
}

#[tokio::test]
async fn starting_to_profile_twice_makes_each_task_once() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.job("0-9").await;
    let preview = farm.claim(node.id, at(0)).await.unwrap();
    farm.commit(&preview, at(0)).await;
    for _ in 0..2 {
        farm.store.start_profiling(job.id, &[0, 9], false, at(0)).await.unwrap();
    }
    assert_eq!(farm.store.profile_results(job.id).await.unwrap(), None);
    for _ in 0..2 {
        let lease = farm.claim(node.id, at(0)).await.unwrap();
        farm.commit(&lease, at(0)).await;
    }
    assert_eq!(farm.claim(node.id, at(0)).await, None);
    let profiles = farm.store.profile_results(job.id).await.unwrap().unwrap();
    assert_eq!(
        profiles.iter().map(|profile| (profile.result.frame, profile.node_speed)).collect::<Vec<_>>(),
        [(0, 2.0), (9, 2.0)]
    );
    // The quote of a job does not wait for a node that measured for it and is no more.
    farm.store.remove_node(node.id, false, at(1)).await.unwrap();
    assert_eq!(farm.store.profile_results(job.id).await.unwrap(), Some(profiles));
}

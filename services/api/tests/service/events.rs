//! Server-sent events.

use crate::support::events::Events;
use crate::support::{Answer, Farm, Http, PATIENCE};
use forelight_protocol::{EventKind, JobState};
use reqwest::{Method, StatusCode};

async fn open(http: &Http, path: &str, last: Option<i64>) -> Events {
    Events::open(http, path, last).await.expect("events to come")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_can_be_followed_from_its_beginning_to_its_end_and_then_there_is_nothing_more() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0-1").await;
    let path = format!("/v1/jobs/{}/events", job.id);
    let stream = open(&farm.viewer, &path, None).await;
    let (events, done) = tokio::join!(stream.rest(PATIENCE), farm.work_off(&node, &job));
    assert_eq!(done.state, JobState::Done);
    let states: Vec<_> = events
        .iter()
        .filter(|event| event.kind == EventKind::JobState)
        .map(|event| event.job_state.unwrap())
        .collect();
    assert_eq!(states, [JobState::Profiling, JobState::Booked, JobState::Rendering, JobState::Done]);
    assert_eq!(events[0].kind, EventKind::JobCreated);
    assert!(events.iter().all(|event| event.job_id == Some(job.id)));
    let last = events.last().unwrap().id;
    assert!(Events::open(&farm.viewer, &path, Some(last)).await.is_none());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_resumes_after_the_last_event_seen_even_after_a_restart() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0-1").await;
    farm.until_booked(&node, &job).await;
    let path = format!("/v1/jobs/{}/events", job.id);
    let all = open(&farm.viewer, &path, None).await.take(6, PATIENCE).await;
    let farm = farm.killed_and_restarted().await;
    let mut resumed = open(&farm.viewer, &path, Some(all[2].id)).await;
    assert_eq!(resumed.take(3, PATIENCE).await, all[3..6]);
    let mut by_query = open(&farm.viewer, &format!("{path}?last_event_id={}", all[3].id), None).await;
    assert_eq!(by_query.take(2, PATIENCE).await, all[4..6]);
    let bad =
        farm.viewer.request(Method::GET, &path).header("Last-Event-ID", "yesterday").send().await.unwrap();
    bad.problem(forelight_protocol::ProblemKind::Malformed).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_ends_with_its_job_even_if_a_worker_speaks_up_afterwards() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0-1").await;
    farm.until_booked(&node, &job).await;
    let lease = farm.next_task(&node).await;
    let path = format!("/v1/jobs/{}", job.id);
    let cancelled = farm.submitter.post(&format!("{path}/cancel"), &()).await;
    assert_eq!(cancelled.status(), StatusCode::OK);
    let late = farm.made_up_result(&lease).await;
    farm.report(&lease, late).await.problem(forelight_protocol::ProblemKind::LeaseLost).await;
    // From the beginning, and with all but the last event seen.
    let events = open(&farm.viewer, &format!("{path}/events"), None).await.rest(PATIENCE).await;
    let [.., end, last] = &events[..] else { panic!("{events:?}") };
    assert_eq!((end.job_state, last.kind), (Some(JobState::Cancelled), EventKind::LeaseLost));
    let rest = open(&farm.viewer, &format!("{path}/events?last_event_id={}", end.id), None).await;
    assert_eq!(rest.rest(PATIENCE).await, events[events.len() - 1..]);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_farms_stream_begins_now_and_brings_what_happens() {
    let farm = Farm::new().await;
    farm.submit("0").await;
    let mut stream = open(&farm.viewer, "/v1/events", None).await;
    let job = farm.submit("0").await;
    let events = stream.take(1, PATIENCE).await;
    assert_eq!((events[0].kind, events[0].job_id), (EventKind::JobCreated, Some(job.id)));
}

#[tokio::test(flavor = "multi_thread")]
async fn who_has_seen_events_that_a_restored_farm_never_had_is_told_what_is_new() {
    let farm = Farm::new().await;
    farm.submit("0").await;
    let mut streams = [
        open(&farm.viewer, "/v1/events", Some(1_000_000_000)).await,
        open(&farm.viewer, "/v1/events?last_event_id=1000000000", None).await,
    ];
    let job = farm.submit("0").await;
    for stream in &mut streams {
        assert_eq!(stream.take(1, PATIENCE).await[0].job_id, Some(job.id));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn streams_that_begin_anywhere_and_are_told_together_miss_nothing_and_see_nothing_twice() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let first = farm.submit("0").await;
    farm.until_booked(&node, &first).await;
    let job = farm.submit("0-1").await;
    let path = format!("/v1/jobs/{}/events", job.id);
    // Some begin before the service has read any event for a stream, some at events that were long ago.
    let now = open(&farm.viewer, "/v1/events?last_event_id=0", None).await.take(1, PATIENCE).await[0].id;
    let mut of_farm = Vec::new();
    for after in [now, now + 1, now, now + 3] {
        of_farm.push((after, open(&farm.viewer, "/v1/events", Some(after)).await));
    }
    let of_job = [open(&farm.viewer, &path, None).await, open(&farm.viewer, &path, None).await];
    farm.work_off(&node, &job).await;
    let late = open(&farm.viewer, &path, Some(now)).await.rest(PATIENCE).await;
    for stream in of_job {
        assert_eq!(stream.rest(PATIENCE).await, late);
    }
    let last = late.last().unwrap().id;
    for (after, stream) in &mut of_farm {
        let mut ids = Vec::new();
        while ids.last().is_none_or(|id| *id < last) {
            ids.push(stream.take(1, PATIENCE).await[0].id);
        }
        assert_eq!(ids, (*after + 1..=last).collect::<Vec<_>>());
    }
}

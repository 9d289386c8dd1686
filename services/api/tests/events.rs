//! Server-sent events.

mod support;

use forelight_protocol::{Event, EventKind, JobState};
use reqwest::{Method, StatusCode};
use support::{Answer, Farm};

/// Reads whole events until there are `count`, or until the stream ends.
async fn read(response: &mut reqwest::Response, count: usize) -> Vec<Event> {
    let mut text = String::new();
    let mut events = Vec::new();
    while events.len() < count {
        let Some(chunk) = response.chunk().await.unwrap() else { break };
        text.push_str(std::str::from_utf8(&chunk).unwrap());
        while let Some(end) = text.find("\n\n") {
            let block: String = text.drain(..end + 2).collect();
            let field = |name: &str| block.lines().find_map(|line| line.strip_prefix(name)).map(str::trim);
            let Some(data) = field("data:") else { continue };
            let event: Event = serde_json::from_str(data).unwrap();
            assert_eq!(field("id:"), Some(event.id.to_string().as_str()));
            assert_eq!(field("event:"), Some(event.kind.name()));
            events.push(event);
        }
    }
    events
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_can_be_followed_from_its_beginning_to_its_end_and_then_there_is_nothing_more() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0-1").await;
    let path = format!("/v1/jobs/{}/events", job.id);
    let mut stream = farm.viewer.get(&path).await;
    assert_eq!(stream.headers()["content-type"], "text/event-stream");
    let (events, done) = tokio::join!(read(&mut stream, usize::MAX), farm.work_off(&node, &job));
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
    let over = farm.viewer.request(Method::GET, &path).header("Last-Event-ID", last).send().await.unwrap();
    assert_eq!(over.status(), StatusCode::NO_CONTENT);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_resumes_after_the_last_event_seen_even_after_a_restart() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.submit("0-1").await;
    farm.until_booked(&node, &job).await;
    let path = format!("/v1/jobs/{}/events", job.id);
    let all = read(&mut farm.viewer.get(&path).await, 6).await;
    let farm = farm.killed_and_restarted().await;
    let mut resumed =
        farm.viewer.request(Method::GET, &path).header("Last-Event-ID", all[2].id).send().await.unwrap();
    assert_eq!(read(&mut resumed, 3).await, all[3..6]);
    let mut by_query = farm.viewer.get(&format!("{path}?last_event_id={}", all[3].id)).await;
    assert_eq!(read(&mut by_query, 2).await, all[4..6]);
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
    // From its beginning, and by a client that saw all but the last event.
    let events = read(&mut farm.viewer.get(&format!("{path}/events")).await, usize::MAX).await;
    let [.., end, last] = &events[..] else { panic!("{events:?}") };
    assert_eq!((end.job_state, last.kind), (Some(JobState::Cancelled), EventKind::LeaseLost));
    let mut rest = farm.viewer.get(&format!("{path}/events?last_event_id={}", end.id)).await;
    assert_eq!(read(&mut rest, usize::MAX).await, events[events.len() - 1..]);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_farms_stream_begins_now_and_brings_what_happens() {
    let farm = Farm::new().await;
    farm.submit("0").await;
    let mut stream = farm.viewer.get("/v1/events").await;
    let job = farm.submit("0").await;
    let events = read(&mut stream, 1).await;
    assert_eq!((events[0].kind, events[0].job_id), (EventKind::JobCreated, Some(job.id)));
}

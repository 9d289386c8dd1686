//! A job stays with one version of our own renderer.

use forelight_protocol::{NodeChange, NodeRegistration, RendererId, TaskKind};

use super::*;
use crate::nodes::LOST;

impl Farm {
    /// A node with this version of our renderer, or the same after an upgrade.
    async fn node_with(&self, name: &str, tracer: u32, now: Timestamp) -> NodeId {
        let capabilities =
            Capabilities { renderers: vec![RendererId::own(tracer)], ..Capabilities::default() };
        let registration = NodeRegistration { capabilities, ..registration(name) };
        fresh(self.store.register_node(&registration, None, now).await.unwrap()).id
    }

    async fn version(&self, job: JobId) -> Option<(String, bool)> {
        let by = self.store.job(job).await.unwrap().rendered_by?;
        Some((by.version, by.mixed.is_some()))
    }
}

#[tokio::test]
async fn frames_stay_with_the_version_that_profiled_them_while_such_a_node_is_left() {
    let farm = Farm::new().await;
    let (old, upgraded) = (farm.node_with("a", 13, at(0)).await, farm.node_with("b", 13, at(0)).await);
    let job = farm.booked_job(request("0-3"), old, at(0)).await;
    assert_eq!(farm.version(job).await, Some(("tracer-13".to_owned(), false)));
    assert_eq!(farm.node_with("b", 14, at(10)).await, upgraded);
    farm.store.sweep(at(10)).await.unwrap();
    assert_eq!(farm.claim(upgraded, at(11)).await, None, "its frames would differ");
    assert_eq!(farm.version(job).await, Some(("tracer-13".to_owned(), false)));
    let lease = farm.claim(old, at(11)).await.unwrap();
    assert_eq!(lease.job_id, job);
    farm.commit(&lease, at(12)).await;

    // A new job is for the version of both, or the newest: a node with the other may still end its old ones.
    farm.node_with("c", 14, at(12)).await;
    let newer = farm.submit(request("0")).await.id;
    let preview = farm.claim(old, at(12)).await.unwrap();
    assert_eq!(preview.job_id, newer, "any version may preview");
    farm.commit(&preview, at(13)).await;
    assert_eq!(farm.version(newer).await, Some(("tracer-14".to_owned(), false)));
}

#[tokio::test]
async fn a_job_whose_version_no_node_has_any_more_goes_on_with_another_and_says_so() {
    let farm = Farm::new().await;
    let node = farm.node_with("a", 13, at(0)).await;
    let job = farm.booked_job(request("0-3"), node, at(0)).await;
    let fresh_one = farm.submit(request("0")).await.id;
    let lease = farm.claim(node, at(1)).await.unwrap();
    farm.commit(&lease, at(1)).await;
    assert_eq!(farm.node_with("a", 14, at(2)).await, node);
    farm.store.sweep(at(2)).await.unwrap();
    let by = farm.store.job(job).await.unwrap().rendered_by.unwrap();
    let mixed = by.mixed.unwrap();
    assert_eq!(by.version, "tracer-14");
    assert!(mixed.contains("no node has forelight tracer-13 any more"), "{mixed}");
    let told: Vec<_> = farm.events(EventKind::JobChanged).await;
    assert!(told.iter().any(|event| event.job_id == Some(job) && event.message.as_ref() == Some(&mixed)));
    assert_eq!(
        farm.version(fresh_one).await,
        Some(("tracer-14".to_owned(), false)),
        "nothing of it was done"
    );
    let mut frames = 0;
    while let Some(lease) = farm.claim(node, at(3)).await {
        frames += usize::from(lease.job_id == job);
        farm.commit(&lease, at(3)).await;
    }
    assert_eq!(frames, 4);
    assert_eq!(farm.store.job(job).await.unwrap().state, forelight_protocol::JobState::Done);
}

#[tokio::test]
async fn a_divided_frame_comes_from_one_version() {
    let farm = Farm::new().await;
    let node = farm.node_with("a", 13, at(0)).await;
    let job = farm.divided_job(request("0"), node, 3).await;
    let part = |part| (TaskKind::RenderPart, Some(part));
    assert_eq!(farm.done(node, 2).await, [(TaskKind::Divide, None), part(0)]);
    let held = farm.claim(node, at(20)).await.unwrap();
    farm.node_with("a", 14, at(21)).await;
    farm.store.sweep(at(21)).await.unwrap();
    assert_eq!(farm.version(job).await, Some(("tracer-14".to_owned(), true)));
    let result = farm.result_for(&held).await;
    let late = farm.store.commit_result(held.lease_id, held.fence, &result, at(22)).await;
    assert!(matches!(late, Err(StoreError::LeaseLost)), "{late:?}");
    assert_eq!(farm.done(node, 9).await, [part(0), part(1), part(2), (TaskKind::Render, None)]);
    assert_eq!(farm.store.job(job).await.unwrap().state, forelight_protocol::JobState::Done);
}

#[tokio::test]
async fn a_frame_in_passes_comes_from_one_version() {
    // Whatever of the first passes is done, all begin again.
    for done in 1..=5 {
        let farm = Farm::new().await;
        let node = farm.node_with("a", 13, at(0)).await;
        let job = farm.job_in_passes("0", node, 2).await;
        for step in 1..=done {
            match step {
                1 => drop(farm.divide(node, [100, 200], "one sample").await),
                4 => drop(farm.divide(node, [100, 200], "more samples").await),
                _ => drop(farm.part_of_pass(node, ["", "", "a", "b", "", "c"][step], 20).await),
            }
        }
        farm.node_with("a", 14, at(21)).await;
        farm.store.sweep(at(21)).await.unwrap();
        assert_eq!(farm.version(job).await.map(|(version, _)| version), Some("tracer-14".to_owned()));
        let part = |part| (TaskKind::RenderPart, Some(part));
        let all =
            [(TaskKind::Divide, None), part(0), part(1), (TaskKind::Divide, None), (TaskKind::Render, None)];
        let found = farm.done(node, 9).await;
        // Of the first division alone, nothing is of the other version.
        assert_eq!(found, all[usize::from(done == 1)..], "after {done} tasks");
        assert_eq!(farm.store.job(job).await.unwrap().state, forelight_protocol::JobState::Done);
    }
}

#[tokio::test]
async fn a_version_is_given_up_when_its_last_node_is_drained_or_lost_and_not_when_it_is_paused() {
    let lost = at(10).plus_micros(LOST + 1);
    let drain = NodeChange { drain: Some(true), ..NodeChange::default() };
    let pause = NodeChange { pause: Some(true), ..NodeChange::default() };
    for (change, now, is_given_up) in
        [(Some(drain), at(10), true), (Some(pause), at(10), false), (None, at(10), false), (None, lost, true)]
    {
        let farm = Farm::new().await;
        let old = farm.node_with("a", 13, at(0)).await;
        let job = farm.booked_job(request("0-1"), old, at(0)).await;
        let new = farm.node_with("b", 14, at(10)).await;
        if let Some(change) = &change {
            farm.store.change_node(old, change, at(10)).await.unwrap();
        }
        touch(&farm.store, new, now).await;
        farm.store.sweep(now).await.unwrap();
        let version = if is_given_up { "tracer-14" } else { "tracer-13" };
        assert_eq!(farm.version(job).await.unwrap().0, version, "{change:?}");
        // Without any node that could do it, the job keeps its version and waits.
        let later = now.plus_micros(LOST * 3);
        farm.store.sweep(later).await.unwrap();
        assert_eq!(farm.version(job).await.unwrap().0, version);
    }
}

#[tokio::test]
async fn a_process_for_one_task_does_it_with_the_version_that_its_node_has_and_the_job_says_so() {
    let farm = Farm::new().await;
    let (old, new) = (farm.node_with("a", 13, at(0)).await, farm.node_with("b", 14, at(0)).await);
    // As many cores of both, so the newest.
    farm.node_with("c", 13, at(0)).await;
    let job = farm.booked_job(request("0-3"), old, at(0)).await;
    assert_eq!(farm.version(job).await, Some(("tracer-13".to_owned(), false)));
    let task = farm.claim(old, at(1)).await.unwrap().task_id;
    farm.store
        .change_node(old, &NodeChange { cancel_task: Some(true), ..NodeChange::default() }, at(1))
        .await
        .unwrap();
    assert!(farm.store.claim_task(new, task, TTL, None, at(2)).await.unwrap().is_some());
    assert_eq!(farm.version(job).await, Some(("tracer-14".to_owned(), true)));
}

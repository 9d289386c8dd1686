//! Quotes that no node works on.

use forelight_protocol::{NodeChange, NodeTerms, TimeSpan, WaitKind};

use super::*;

async fn waits(farm: &Farm, job: JobId, now: Timestamp) -> Option<(WaitKind, String, Option<Timestamp>)> {
    let waits = farm.store.unattended(TTL, now).await.unwrap().waits(job);
    let shown = farm.dashboard(now).await.jobs[0].waits.clone();
    assert_eq!(shown, waits);
    waits.map(|waits| (waits.kind, waits.because, waits.until))
}

#[tokio::test]
async fn a_quote_without_nodes_that_take_tasks_says_so_until_one_does() {
    let farm = Farm::new().await;
    let job = farm.submit(request("0")).await.id;
    let nobody = "waits because no worker has registered; `forelight worker` starts one";
    assert_eq!(waits(&farm, job, at(0)).await, Some((WaitKind::Node, nobody.to_owned(), None)));

    let (a, b) = (farm.node("a").await, farm.node("b").await);
    assert_eq!(waits(&farm, job, at(0)).await, None);
    let drain = NodeChange { drain: Some(true), ..NodeChange::default() };
    farm.store.change_node(a.id, &drain, at(0)).await.unwrap();
    assert_eq!(waits(&farm, job, at(0)).await, None);
    let silent = "waits because no node takes tasks: 1 drained, 1 silent";
    assert_eq!(waits(&farm, job, at(1000)).await, Some((WaitKind::Node, silent.to_owned(), None)));

    // It is at work until its lease runs out.
    let lease = farm.claim(b.id, at(1001)).await.unwrap();
    farm.store.change_node(b.id, &drain, at(1001)).await.unwrap();
    assert_eq!(waits(&farm, job, at(1001)).await, None);
    farm.commit(&lease, at(1002)).await;
    let drained = "waits because no node takes tasks: 2 drained";
    assert_eq!(waits(&farm, job, at(1002)).await, Some((WaitKind::Node, drained.to_owned(), None)));
}

#[tokio::test]
async fn a_quote_waits_for_the_first_node_that_wakes() {
    let farm = Farm::new().await;
    let job = farm.submit(request("0")).await.id;
    for (name, wakes) in [("a", 500), ("b", 300)] {
        let node = farm.node(name).await;
        let terms = NodeTerms {
            maintenance: vec![TimeSpan { start: at(0), end: Some(at(wakes)) }],
            ..NodeTerms::default()
        };
        let change = NodeChange { terms: Some(terms), ..NodeChange::default() };
        farm.store.change_node(node.id, &change, at(0)).await.unwrap();
    }
    let asleep = "waits because no node takes tasks: 2 asleep".to_owned();
    assert_eq!(waits(&farm, job, at(100)).await, Some((WaitKind::Calendar, asleep, Some(at(300)))));
    assert_eq!(waits(&farm, job, at(301)).await, None);
}

#[tokio::test]
async fn a_quote_of_a_project_whose_budget_is_used_up_waits_for_the_budget() {
    let farm = Farm::new().await;
    farm.node("a").await;
    let job = farm.submit(request("0")).await.id;
    assert_eq!(waits(&farm, job, at(0)).await, None);
    let mut write = farm.store.write().await.unwrap();
    sqlx::query("UPDATE tasks SET held = 1").execute(write.connection().await.unwrap()).await.unwrap();
    farm.store.commit(write).await.unwrap();
    let project = farm.store.job(job).await.unwrap().project;
    let because = format!("waits because the budget of project {project} is used up");
    assert_eq!(waits(&farm, job, at(0)).await, Some((WaitKind::Budget, because, None)));
}

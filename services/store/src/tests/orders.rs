//! What an operator orders, and how it is obeyed; clocks that are set.

use forelight_protocol::{FrameState, LeaseOrder, NodeChange, NodeState};

use super::*;

fn change(change: impl FnOnce(&mut NodeChange)) -> NodeChange {
    let mut changed = NodeChange::default();
    change(&mut changed);
    changed
}

#[tokio::test]
async fn a_paused_node_keeps_its_task_and_goes_on_with_it() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.booked_job(request("0-1"), node.id, at(0)).await;
    let lease = farm.claim(node.id, at(1)).await.unwrap();
    let state = async || farm.store.node(node.id).await.unwrap().state;
    assert_eq!(state().await, NodeState::Working);
    farm.store.change_node(node.id, &change(|c| c.pause = Some(true)), at(2)).await.unwrap();
    assert_eq!(state().await, NodeState::Pausing);
    let renew = async |paused, now| {
        let renewal = RenewRequest { paused, ..renewal(lease.fence, 0.2) };
        farm.store.renew(lease.lease_id, &renewal, TTL, now).await.unwrap().order
    };
    assert_eq!(renew(false, at(3)).await, LeaseOrder::Pause);
    assert_eq!(renew(true, at(4)).await, LeaseOrder::Pause);
    assert_eq!(state().await, NodeState::Paused);
    assert_eq!(farm.claim(node.id, at(5)).await, None, "it stands still");
    farm.store.change_node(node.id, &change(|c| c.pause = Some(false)), at(6)).await.unwrap();
    assert_eq!(renew(true, at(7)).await, LeaseOrder::Continue);
    assert_eq!(renew(false, at(8)).await, LeaseOrder::Continue);
    assert_eq!(state().await, NodeState::Working);
    assert!(!farm.commit(&lease, at(9)).await.duplicate);
}

#[tokio::test]
async fn a_draining_node_hears_of_it_finishes_and_is_drained() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.booked_job(request("0-1"), node.id, at(0)).await;
    let lease = farm.claim(node.id, at(1)).await.unwrap();
    let drained = farm.store.change_node(node.id, &change(|c| c.drain = Some(true)), at(2)).await.unwrap();
    assert_eq!(drained.state, NodeState::Draining);
    let heard = farm.store.renew(lease.lease_id, &renewal(lease.fence, 0.5), TTL, at(3)).await.unwrap();
    assert_eq!((heard.order, heard.drain), (LeaseOrder::Continue, true));
    farm.commit(&lease, at(4)).await;
    assert_eq!(farm.store.node(node.id).await.unwrap().state, NodeState::Drained);
}

#[tokio::test]
async fn a_task_that_is_taken_away_goes_to_another_node_and_its_worker_is_told_to_stop() {
    let farm = Farm::new().await;
    let (a, b) = (farm.node("a").await, farm.node("b").await);
    let job = farm.booked_job(request("0"), a.id, at(0)).await;
    let lease = farm.claim(a.id, at(1)).await.unwrap();
    let result = farm.result_for(&lease).await;
    let order = change(|c| (c.drain, c.cancel_task) = (Some(true), Some(true)));
    assert_eq!(farm.store.change_node(a.id, &order, at(2)).await.unwrap().state, NodeState::Drained);
    assert_eq!(farm.store.frame(job, 0).await.unwrap().state, FrameState::Ready);
    let taken = farm.claim(b.id, at(3)).await.unwrap();
    let told = farm.store.renew(lease.lease_id, &renewal(lease.fence, 0.5), TTL, at(4)).await.unwrap();
    assert_eq!((taken.task_id, told.order), (lease.task_id, LeaseOrder::Stop));
    let late = farm.store.commit_result(lease.lease_id, lease.fence, &result, at(5)).await;
    assert!(matches!(late, Err(crate::StoreError::LeaseLost)), "{late:?}");
    assert!(!farm.commit(&taken, at(6)).await.duplicate);
}

#[tokio::test]
async fn a_clock_that_is_set_ends_no_lease_early_and_holds_none_for_ever() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.booked_job(request("0-1"), node.id, at(0)).await;
    farm.claim(node.id, at(10)).await.unwrap();
    // An hour ahead, ten seconds into the lease; then two hours back.
    let begun = async || farm.store.ledger(at(-9000), at(9000)).await.unwrap().last().unwrap().from;
    assert_eq!(begun().await, at(10));
    farm.store.clock_was_set(3600 * SECOND).await.unwrap();
    assert_eq!(begun().await, at(3610), "an hour that was set is paid by nobody");
    assert_eq!(farm.store.sweep(at(3639)).await.unwrap().expired, 0);
    farm.store.clock_was_set(-7200 * SECOND).await.unwrap();
    assert_eq!(farm.store.sweep(at(-3561)).await.unwrap().expired, 0);
    assert!(farm.store.node(node.id).await.unwrap().last_seen_at <= at(-3560));
    assert_eq!(farm.store.sweep(at(-3560)).await.unwrap().expired, 1);
    // Set back while the service was down: one term from the start, and no more.
    farm.claim(node.id, at(10)).await.unwrap();
    assert_eq!(farm.store.extend_leases_after_start(TTL, at(-9000)).await.unwrap(), 1);
    assert_eq!(farm.store.sweep(at(-8971)).await.unwrap().expired, 0);
    assert_eq!(farm.store.sweep(at(-8970)).await.unwrap().expired, 1);
}

#[tokio::test]
async fn what_was_spent_never_falls_when_the_clock_goes_back() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.booked_job(request("0-2"), node.id, at(0)).await;
    let spent = async |now: i64| farm.store.spent_on(job, at(now)).await.unwrap().0;
    let tonight = async |now: i64| {
        let dashboard = farm.dashboard(at(now)).await;
        dashboard.spending.iter().map(|project| project.tonight.0).sum::<i64>()
    };
    let done = farm.claim(node.id, at(10)).await.unwrap();
    farm.commit(&done, at(3610)).await;
    farm.claim(node.id, at(3610)).await.unwrap();
    let (before, before_tonight) = (spent(3620).await, tonight(3620).await);
    assert!(before > 0 && before_tonight > 0);
    // While the service runs, half of the finished task and all of the other lie ahead then.
    farm.store.clock_was_set(-1800 * SECOND).await.unwrap();
    assert_eq!((spent(1820).await, tonight(1820).await), (before, before_tonight));
    // While it does not run.
    farm.store.extend_leases_after_start(TTL, at(-7200)).await.unwrap();
    assert!(spent(-7200).await >= before);
}

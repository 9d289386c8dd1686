//! Tasks that hang, results that are not possible, and jobs that are taken out of the track record.

use forelight_protocol::{FinishedPixels, LeaseOrder};

use super::*;
use crate::policy::faults::STALLED;
use crate::{StoreError, project};

impl Farm {
    /// Renews a lease without progress and sweeps, every five seconds.
    async fn hang(&self, lease: &Lease, from: i64, until: i64) {
        for second in (from..=until).step_by(5) {
            self.store.renew(lease.lease_id, &renewal(lease.fence, 0.0), TTL, at(second)).await.unwrap();
            self.store.sweep(at(second)).await.unwrap();
        }
    }

    async fn is_set_aside(&self, node: NodeId) -> bool {
        self.store.node(node).await.unwrap().set_aside.is_some()
    }

    async fn finish_of(&self, job: JobId, now: Timestamp) -> Option<i64> {
        let projection = project(&self.store.open_bookings().await.unwrap(), &[], now);
        Some(projection.finish_of(job)?.micros_since(at(0)) / SECOND)
    }
}

#[tokio::test]
async fn a_task_that_hangs_is_late_then_run_again_beside_the_first_and_the_first_result_counts() {
    let farm = Farm::new().await;
    let (idle, good) = (farm.node("idle").await, farm.node("good").await);
    let job = farm.booked_job(request("0"), idle.id, at(0)).await;
    let first = farm.claim(idle.id, at(0)).await.unwrap();
    farm.hang(&first, 5, 60).await;
    assert_eq!(farm.events(EventKind::TaskLate).await.len(), 1);
    assert_eq!(farm.claim(good.id, at(60)).await, None, "the first may still be at it");
    farm.hang(&first, 65, 65).await;
    let said = farm.events(EventKind::TaskStalled).await;
    assert!(said.len() == 1 && said[0].node_id == Some(idle.id), "{said:?}");
    assert_eq!(farm.claim(idle.id, at(66)).await, None, "not on the same node");
    let second = farm.claim(good.id, at(66)).await.unwrap();
    assert_eq!((second.task_id, second.fence), (first.task_id, 2));
    assert_eq!(farm.claim(farm.node("third").await.id, at(66)).await, None, "two are enough");
    // Both have a lease of their own.
    farm.hang(&first, 70, 70).await;
    farm.commit(&second, at(72)).await;
    assert_eq!(farm.store.job(job).await.unwrap().state, forelight_protocol::JobState::Done);
    let order = farm.store.renew(first.lease_id, &renewal(first.fence, 0.9), TTL, at(73)).await.unwrap();
    assert_eq!(order.order, LeaseOrder::Stop);
    let result = farm.result_for(&first).await;
    let late = farm.store.commit_result(first.lease_id, first.fence, &result, at(74)).await;
    assert!(matches!(late, Err(StoreError::LeaseLost)), "{late:?}");
    // Both are paid for.
    let paid = farm.store.ledger(at(0), at(100)).await.unwrap();
    let of = |node: NodeId, from: i64| {
        paid.iter()
            .find(|line| line.of.is_some_and(|(_, of)| of == node) && line.from == at(from))
            .unwrap()
            .until
    };
    assert_eq!((of(idle.id, 0), of(good.id, 66)), (Some(at(72)), Some(at(72))));
    assert!(!farm.is_set_aside(idle.id).await, "once may happen");
}

#[tokio::test]
async fn a_node_that_hangs_again_is_set_aside_and_the_one_that_helped_is_not() {
    let farm = Farm::new().await;
    let (idle, good) = (farm.node("idle").await, farm.node("good").await);
    for round in 0..STALLED {
        assert!(!farm.is_set_aside(idle.id).await, "after {round}");
        let start = 200 * round;
        farm.booked_job(request("0"), idle.id, at(start)).await;
        let first = farm.claim(idle.id, at(start)).await.unwrap();
        farm.hang(&first, start + 5, start + 65).await;
        let second = farm.claim(good.id, at(start + 66)).await.unwrap();
        farm.commit(&second, at(start + 70)).await;
    }
    assert!(farm.is_set_aside(idle.id).await);
    assert!(!farm.is_set_aside(good.id).await);
}

#[tokio::test]
async fn if_the_second_attempt_ends_without_a_result_the_first_goes_on() {
    let farm = Farm::new().await;
    let (slow, other) = (farm.node("slow").await, farm.node("other").await);
    let job = farm.booked_job(request("0"), slow.id, at(0)).await;
    let first = farm.claim(slow.id, at(0)).await.unwrap();
    farm.hang(&first, 5, 65).await;
    let second = farm.claim(other.id, at(66)).await.unwrap();
    farm.store.release(second.lease_id, second.fence, at(67)).await.unwrap();
    let holder = farm.store.open_bookings().await.unwrap()[0].holder.unwrap();
    assert_eq!((holder.node_id, holder.started), (slow.id, at(0)));
    farm.commit(&first, at(70)).await;
    assert_eq!(farm.store.job(job).await.unwrap().state, forelight_protocol::JobState::Done);
    assert!(!farm.is_set_aside(slow.id).await);
}

#[tokio::test]
async fn the_expected_end_of_a_task_that_hangs_stands_where_it_is_run_again_and_does_not_slide() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.booked_job(request("0"), node.id, at(0)).await;
    let lease = farm.claim(node.id, at(0)).await.unwrap();
    let mut ends = Vec::new();
    for second in 1..60 {
        ends.push(farm.finish_of(job, at(second)).await.unwrap());
    }
    ends.dedup();
    // The booked ten seconds, its 99 % quantile, and ten seconds after it was run again at 60.
    assert_eq!((ends.first(), ends.last()), (Some(&10), Some(&70)), "{ends:?}");
    assert!(ends.len() <= 3, "{ends:?}");
    let late = farm.store.renew(lease.lease_id, &renewal(lease.fence, 0.5), TTL, at(59)).await;
    late.unwrap();
    assert_eq!(farm.finish_of(job, at(60)).await, Some(64), "half of it is left");
}

#[tokio::test]
async fn progress_keeps_a_task_from_stalling_and_the_farms_limit_ends_it_all_the_same() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.booked_job(request("0"), node.id, at(0)).await;
    let lease = farm.claim(node.id, at(0)).await.unwrap();
    for second in (10..=900).step_by(10) {
        let step = renewal(lease.fence, second as f64 / 10_000.0);
        farm.store.renew(lease.lease_id, &step, TTL, at(second)).await.unwrap();
        farm.store.sweep(at(second)).await.unwrap();
    }
    assert!(farm.events(EventKind::TaskStalled).await.is_empty());
    farm.store.sweep(at(901)).await.unwrap();
    let said = farm.events(EventKind::TaskFailed).await;
    assert!(said.len() == 1 && said[0].message.as_ref().unwrap().contains("many times as long"), "{said:?}");
    let again = farm.store.renew(lease.lease_id, &renewal(lease.fence, 0.99), TTL, at(902)).await;
    assert!(matches!(again, Err(StoreError::LeaseLost)), "{again:?}");
}

#[tokio::test]
async fn a_pause_that_was_ordered_does_not_count_and_one_that_was_not_does() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.booked_job(request("0"), node.id, at(0)).await;
    let lease = farm.claim(node.id, at(0)).await.unwrap();
    let pause = |pause| forelight_protocol::NodeChange { pause: Some(pause), ..Default::default() };
    farm.store.change_node(node.id, &pause(true), at(1)).await.unwrap();
    let stands = RenewRequest { paused: true, ..renewal(lease.fence, 0.0) };
    for second in (10..2000).step_by(10) {
        farm.store.renew(lease.lease_id, &stands, TTL, at(second)).await.unwrap();
        farm.store.sweep(at(second)).await.unwrap();
    }
    farm.store.change_node(node.id, &pause(false), at(2000)).await.unwrap();
    assert!(farm.events(EventKind::TaskLate).await.is_empty());
    for second in (2000..2100).step_by(10) {
        farm.store.renew(lease.lease_id, &stands, TTL, at(second)).await.unwrap();
        farm.store.sweep(at(second)).await.unwrap();
    }
    // A node that says that it is paused, without an order, is shown as such; its time runs.
    farm.store.renew(lease.lease_id, &renewal(lease.fence, 0.0), TTL, at(2100)).await.unwrap();
    farm.store.sweep(at(2100)).await.unwrap();
    assert_eq!(farm.events(EventKind::TaskStalled).await.len(), 1);
}

/// The lease's result, changed.
pub(super) async fn forged(farm: &Farm, lease: &Lease, change: impl FnOnce(&mut RenderResult)) -> TaskResult {
    let TaskResult::Render(mut result) = farm.result_for(lease).await else { panic!() };
    let (exr, png) = (farm.stored(&exr(8, 8)).await, farm.stored(&png(8, 8)).await);
    result.artifacts =
        RenderArtifacts { image_exr: exr, image_png: png, cost_map_png: png, preview_png: None };
    change(&mut result);
    TaskResult::Render(result)
}

impl Farm {
    pub(super) async fn stored(&self, content: &[u8]) -> ArtifactHash {
        let hash = ArtifactHash(*blake3::hash(content).as_bytes());
        let content = bytes::Bytes::copy_from_slice(content);
        let content = futures::stream::iter([Ok(content)]);
        self.store.artifacts().put(hash, content, 1000, at(0)).await.unwrap();
        hash
    }
}

/// The begin of a PNG file.
fn png(width: u32, height: u32) -> Vec<u8> {
    let mut file = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR".to_vec();
    file.extend(width.to_be_bytes().into_iter().chain(height.to_be_bytes()));
    file.extend(b"\x08\x02\0\0\0");
    file
}

/// The begin of an OpenEXR file.
fn exr(width: i32, height: i32) -> Vec<u8> {
    let mut file = b"\x76\x2f\x31\x01\x02\0\0\0dataWindow\0box2i\0\x10\0\0\0".to_vec();
    [0, 0, width - 1, height - 1].iter().for_each(|edge| file.extend(edge.to_le_bytes()));
    file.push(0);
    file
}

#[tokio::test]
async fn a_forged_result_is_refused_held_against_its_node_and_the_task_is_done_elsewhere() {
    let farm = Farm::new().await;
    let (liar, honest) = (farm.node("liar").await, farm.node("honest").await);
    let html = farm.stored(b"<!DOCTYPE html><html>a picture</html>").await;
    let small = farm.stored(&png(4, 4)).await;
    type Forge = Box<dyn Fn(&mut RenderResult)>;
    let forgeries: [(&str, Forge); 5] = [
        ("/result/render/stats/cpu_seconds", Box::new(|result| result.stats.cpu_seconds = 1e12)),
        ("/result/render/stats/work", Box::new(|result| result.stats.work = (1 << 63) - 1)),
        ("/result/render/artifacts/image_png", Box::new(move |result| result.artifacts.image_png = html)),
        ("/result/render/artifacts/image_exr", Box::new(move |result| result.artifacts.image_exr = html)),
        (
            "/result/render/artifacts/cost_map_png",
            Box::new(move |result| result.artifacts.cost_map_png = small),
        ),
    ];
    for ((place, forge), round) in forgeries.iter().zip(0i64..) {
        let start = 100 * round;
        let job = farm.booked_job(request("0"), liar.id, at(start)).await;
        let lease = farm.claim(liar.id, at(start)).await.unwrap();
        farm.store.put_checkpoint(lease.lease_id, lease.fence, "tiles".into()).await.unwrap();
        let result = forged(&farm, &lease, |result| forge(result)).await;
        let refused = farm.store.check_evidence(lease.lease_id, lease.fence, &result, at(start + 5)).await;
        assert!(
            matches!(&refused, Err(StoreError::Implausible { pointer, .. }) if pointer == place),
            "{refused:?}"
        );
        let late = farm.store.commit_result(lease.lease_id, lease.fence, &result, at(start + 6)).await;
        assert!(matches!(late, Err(StoreError::LeaseLost)), "{late:?}");
        let said = farm.events(EventKind::ResultRefused).await;
        assert_eq!((said.len() as i64, said.last().unwrap().node_id), (round + 1, Some(liar.id)));
        let lease = farm.claim(honest.id, at(start + 10)).await.unwrap();
        let tiles = farm.store.checkpoint(lease.lease_id).await;
        assert!(matches!(tiles, Err(StoreError::NotFound(_))), "pixels of a refused result came back");
        let result = forged(&farm, &lease, |_| {}).await;
        farm.store.check_evidence(lease.lease_id, lease.fence, &result, at(start + 15)).await.unwrap();
        farm.store.commit_result(lease.lease_id, lease.fence, &result, at(start + 15)).await.unwrap();
        assert_eq!(farm.store.job(job).await.unwrap().state, forelight_protocol::JobState::Done);
        if round == 2 {
            assert!(farm.is_set_aside(liar.id).await);
            let back = forelight_protocol::NodeChange { set_aside: Some(false), ..Default::default() };
            farm.store.change_node(liar.id, &back, at(start + 20)).await.unwrap();
        }
    }
    assert!(!farm.is_set_aside(honest.id).await);
    assert_eq!(farm.store.track_record(None, 10, None).await.unwrap().frames, 5);
}

#[tokio::test]
async fn what_a_frame_takes_over_and_the_time_before_a_restart_are_not_held_against_it() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.booked_job(request("0"), node.id, at(0)).await;
    let lease = farm.claim(node.id, at(0)).await.unwrap();
    // A checkpoint of the first attempt goes on with the second.
    farm.store.renew(lease.lease_id, &renewal(lease.fence, 0.5), TTL, at(25)).await.unwrap();
    farm.store.sweep(at(60)).await.unwrap();
    let again = farm.claim(node.id, at(60)).await.unwrap();
    let result = forged(&farm, &again, |result| result.stats.cpu_seconds = 50.0).await;
    farm.store.check_evidence(again.lease_id, again.fence, &result, at(62)).await.unwrap();
    // Nobody knows how long the service was down.
    farm.store.extend_leases_after_start(TTL, at(62)).await.unwrap();
    let result = forged(&farm, &again, |result| result.stats.cpu_seconds = 5000.0).await;
    farm.store.check_evidence(again.lease_id, again.fence, &result, at(62)).await.unwrap();
}

#[tokio::test]
async fn finished_pixels_that_are_not_possible_are_refused_and_those_of_the_profile_are_possible() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.booked_job(request("0"), node.id, at(0)).await;
    let lease = farm.claim(node.id, at(0)).await.unwrap();
    let said = async |cpu_seconds: u64, work| {
        let pixels = FinishedPixels { done: 32, all: 64, work, cpu_nanos: cpu_seconds * 1_000_000_000 };
        farm.store.check_pixels(lease.lease_id, &pixels, at(4)).await
    };
    // Four seconds, a quarter more, and one; and half of the P95 of 5 s, at speed 2.
    said(8, 1000).await.unwrap();
    for (cpu_seconds, work) in [(9, 1000), (1 << 33, 1000), (4, 1 << 60)] {
        let refused = said(cpu_seconds, work).await;
        assert!(matches!(&refused, Err(StoreError::Implausible { pointer, .. }) if pointer == "/pixels"));
    }
}

#[tokio::test]
async fn the_clock_may_be_set_while_a_task_runs() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.booked_job(request("0"), node.id, at(0)).await;
    let lease = farm.claim(node.id, at(0)).await.unwrap();
    // An hour back after ten seconds. Ten CPU seconds are possible, and the task is on time.
    farm.store.clock_was_set(-3600 * SECOND).await.unwrap();
    let result = forged(&farm, &lease, |result| result.stats.cpu_seconds = 10.0).await;
    farm.store.check_evidence(lease.lease_id, lease.fence, &result, at(10 - 3600)).await.unwrap();
    farm.store.clock_was_set(7200 * SECOND).await.unwrap();
    farm.store.sweep(at(11 + 3600)).await.unwrap();
    assert!(farm.events(EventKind::TaskStalled).await.is_empty());
}

#[tokio::test]
async fn a_job_that_an_operator_leaves_out_is_in_no_number_of_the_record_until_it_is_put_back() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.booked_job(request("0-1"), node.id, at(0)).await;
    for second in [1, 2] {
        let lease = farm.claim(node.id, at(second)).await.unwrap();
        farm.commit(&lease, at(second)).await;
    }
    let record = async || farm.store.track_record(None, 10, None).await.unwrap();
    assert_eq!(record().await.frames, 2);
    farm.store.leave_out(job, "the node lied", at(5)).await.unwrap();
    let without = record().await;
    assert_eq!((without.frames, without.items.len(), without.kinds.len()), (0, 0, 0));
    assert_eq!(without.left_out[0].reason, "the node lied");
    assert!(farm.store.finished_jobs(10, None).await.unwrap().is_empty());
    farm.store.leave_out(job, "the node lied about its times", at(6)).await.unwrap();
    assert_eq!(record().await.left_out[0].reason, "the node lied about its times");
    farm.store.put_back(job, at(7)).await.unwrap();
    farm.store.put_back(job, at(8)).await.unwrap();
    let with = record().await;
    assert_eq!((with.frames, with.left_out.len()), (2, 0));
    assert_eq!(farm.events(EventKind::JobChanged).await.len(), 3);
    let unknown = farm.store.leave_out(JobId::new(), "no such job", at(9)).await;
    assert!(matches!(unknown, Err(StoreError::NotFound("job"))), "{unknown:?}");
}

//! Plans, bookings, projections.

use super::*;
use forelight_protocol::SharedCacheBooking;

use crate::{Holder, OpenBooking, OpenCachePart, Projected, StoreError, TaskAttempt, project};
use forelight_protocol::{Booking, BookingId, JobState, PlanId};

#[tokio::test]
async fn a_plan_names_its_parent_and_never_changes() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    farm.booked_job(request("0-1"), node.id, at(10)).await;
    let first = farm.store.newest_plan().await.unwrap().unwrap();
    farm.booked_job(request("5"), node.id, at(100)).await;
    let second = farm.store.newest_plan().await.unwrap().unwrap();
    assert_eq!(farm.store.plan(first).await.unwrap().parent_id, None);
    let plan = farm.store.plan(second).await.unwrap();
    assert_eq!((plan.parent_id, plan.bookings.len(), plan.bookings[0].start), (Some(first), 1, at(100)));
    for statement in [
        "UPDATE plans SET reason = reason",
        "DELETE FROM bookings",
        "UPDATE bookings SET frame = 7",
        "DELETE FROM plans",
    ] {
        let mut write = farm.store.write().await.unwrap();
        let error = sqlx::query(sqlx::AssertSqlSafe(statement))
            .execute(write.connection().await.unwrap())
            .await
            .unwrap_err();
        assert!(error.to_string().contains("never changes"), "{statement}: {error}");
    }
}

#[tokio::test]
async fn a_plan_made_on_old_bookings_is_refused_and_nothing_of_it_is_kept() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let slow = farm.job("0").await;
    let preview = farm.claim(node.id, at(0)).await.unwrap();
    farm.commit(&preview, at(0)).await;
    farm.store.start_profiling(slow.id, &[], false, at(0)).await.unwrap();
    let stale_plan = farm.plan_for(&slow, node.id, at(0)).await;
    farm.booked_job(request("0"), node.id, at(0)).await;
    let frames = frame_forecasts(&slow);
    let refused = farm.store.book(slow.id, &job_forecast(), &frames, None, &stale_plan, at(1)).await;
    assert!(matches!(refused, Err(StoreError::Conflict(_))), "{refused:?}");
    assert_eq!(farm.store.job(slow.id).await.unwrap().state, JobState::Profiling);
    assert_eq!(farm.store.forecast(slow.id).await.unwrap(), None);
    let plan = farm.plan_for(&slow, node.id, at(50)).await;
    farm.store.book(slow.id, &job_forecast(), &frames, None, &plan, at(1)).await.unwrap();
    let again = farm.store.book(slow.id, &job_forecast(), &frames, None, &plan, at(1)).await;
    assert!(matches!(again, Err(StoreError::Conflict(_))), "booked twice: {again:?}");
}

#[tokio::test]
async fn a_cancelled_job_is_not_booked() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.job("0").await;
    let plan = farm.plan_for(&job, node.id, at(0)).await;
    farm.store.cancel_job(job.id, at(0)).await.unwrap();
    let refused = farm.store.book(job.id, &job_forecast(), &frame_forecasts(&job), None, &plan, at(1)).await;
    assert!(matches!(refused, Err(StoreError::Conflict(_))), "{refused:?}");
    assert_eq!(farm.store.newest_plan().await.unwrap(), None);
}

#[tokio::test]
async fn open_bookings_are_those_of_frames_not_yet_rendered() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.booked_job(request("0-2"), node.id, at(10)).await;
    let first = farm.claim(node.id, at(10)).await.unwrap();
    // It keeps its node for its two CPU seconds and no longer.
    farm.commit(&first, at(12)).await;
    let second = farm.claim(node.id, at(21)).await.unwrap();
    farm.store.renew(second.lease_id, &renewal(second.fence, 0.25), TTL, at(22)).await.unwrap();
    let open = farm.store.open_bookings().await.unwrap();
    // 5 CPU seconds in 19 of 20 cases, at speed 2.
    let attempt = TaskAttempt { since: at(21), progress: 0.25, sign: at(22), p95: Some(2_500_000) };
    let holder = Holder { node_id: node.id, started: at(21), attempt, slowness: 1.0 };
    let seen: Vec<_> = open.iter().map(|open| (open.booking.frame, open.holder)).collect();
    assert_eq!(seen, [(1, Some(holder)), (2, None)]);
    let page = farm
        .store
        .open_bookings_page((None, None), Some((open[0].booking.start, open[0].booking.id)), 10)
        .await
        .unwrap();
    assert_eq!(page, [open[1].booking.clone()]);
    farm.store.cancel_job(job, at(30)).await.unwrap();
    assert!(farm.store.open_bookings().await.unwrap().is_empty());
}

#[tokio::test]
async fn a_job_that_is_done_or_failed_leaves_no_booking_open_and_those_of_others_stay() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let done = farm.booked_job(request("0-2"), node.id, at(10)).await;
    let failing = farm.booked_job(request("0-2"), node.id, at(100)).await;
    let waiting = farm.booked_job(request("0-2"), node.id, at(200)).await;
    let open = async || {
        let open = farm.store.open_bookings().await.unwrap();
        open.iter().map(|open| (open.booking.job_id, open.booking.frame)).collect::<Vec<_>>()
    };
    assert_eq!(open().await.len(), 9);
    for second in 0..3 {
        let lease = farm.claim(node.id, at(10 + second)).await.unwrap();
        assert_eq!(lease.job_id, done);
        farm.commit(&lease, at(11 + second)).await;
    }
    assert_eq!(farm.store.job(done).await.unwrap().state, JobState::Done);
    // One of its frames is being rendered when it fails.
    let lease = farm.claim(node.id, at(100)).await.unwrap();
    assert_eq!(lease.job_id, failing);
    farm.store.fail_job(failing, "the verifier refused the plan", at(101)).await.unwrap();
    assert_eq!(open().await, [(waiting, 0), (waiting, 1), (waiting, 2)]);
    assert_eq!(farm.store.open_bookings_page((None, None), None, 10).await.unwrap().len(), 3);
    // What was booked is still told beside each frame.
    for job in [done, failing] {
        let rows = farm.store.frames(job, None, 10).await.unwrap();
        assert!(rows.len() == 3 && rows.iter().all(|row| row.booked.is_some()), "{rows:?}");
    }
}

fn booking(frame: u32, node: u8, start: i64, end: i64) -> Booking {
    Booking {
        id: BookingId(uuid::Uuid::from_u128(u128::from(frame))),
        plan_id: PlanId(uuid::Uuid::nil()),
        job_id: JobId(uuid::Uuid::nil()),
        frame,
        part: 0,
        parts: 1,
        node_id: NodeId(uuid::Uuid::from_u128(u128::from(node))),
        start: at(start),
        end: at(end),
    }
}

fn spans(projected: &[Projected]) -> Vec<(u32, i64, i64)> {
    let seconds = |time: Timestamp| time.micros_since(at(0)) / SECOND;
    projected.iter().map(|frame| (frame.booking.frame, seconds(frame.start), seconds(frame.end))).collect()
}

#[test]
fn late_bookings_are_pushed_back_one_behind_the_other_and_punctual_ones_stay() {
    let open: Vec<_> =
        [booking(0, 1, 0, 10), booking(1, 1, 10, 20), booking(2, 1, 100, 110), booking(3, 2, 0, 5)]
            .map(|booking| OpenBooking { booking, holder: None, held: false })
            .into();
    assert_eq!(
        spans(&project(&open, &[], at(15)).frames),
        [(0, 15, 25), (3, 15, 20), (1, 25, 35), (2, 100, 110)]
    );
}

#[test]
fn a_frame_under_way_takes_its_holder_not_its_booked_node_and_always_ends_after_now() {
    let holder = |node: u128, started, progress| {
        let attempt = TaskAttempt { since: at(started), progress, sign: at(50), p95: Some(120 * SECOND) };
        let node_id = NodeId(uuid::Uuid::from_u128(node));
        Some(Holder { node_id, started: at(started), attempt, slowness: 1.0 })
    };
    let open = [
        OpenBooking { booking: booking(0, 1, 0, 100), holder: holder(2, 0, 0.5), held: false },
        OpenBooking { booking: booking(1, 2, 0, 10), holder: None, held: false },
        OpenBooking { booking: booking(2, 1, 0, 10), holder: None, held: false },
        OpenBooking { booking: booking(3, 3, 0, 10), holder: holder(3, 0, 1.0), held: false },
        OpenBooking { booking: booking(4, 4, 30, 40), holder: holder(4, 45, 0.0), held: false },
    ];
    let projected = project(&open, &[], at(50));
    // Frame 3 waits for its delivery, and frame 4 has said nothing since it began.
    assert_eq!(spans(&projected.frames), [(0, 0, 100), (3, 0, 60), (4, 45, 60), (2, 50, 60), (1, 100, 110)]);
    assert_eq!(projected.finish_of(JobId(uuid::Uuid::nil())), Some(at(110)));
}

#[test]
fn frames_wait_for_the_parts_of_their_cache_wherever_these_are() {
    let node = |node: u128| NodeId(uuid::Uuid::from_u128(node));
    let part = |part, number: u128, start, end| SharedCacheBooking {
        job_id: JobId(uuid::Uuid::nil()),
        part,
        node_id: node(number),
        start: at(start),
        end: at(end),
    };
    let open = [booking(0, 1, 20, 30), booking(1, 2, 20, 25)].map(|booking| OpenBooking {
        booking,
        holder: None,
        held: false,
    });
    // Node 3 is half through the second half of its part. The part on node 2 is done with one of two rounds.
    let attempt = TaskAttempt { since: at(10), progress: 0.75, sign: at(20), p95: None };
    let held = Holder { node_id: node(3), started: at(10), attempt, slowness: 1.0 };
    let parts = [
        OpenCachePart { booking: part(0, 3, 0, 40), done: 0.5, holder: Some(held), held: false },
        OpenCachePart { booking: part(1, 2, 0, 20), done: 0.5, holder: None, held: false },
    ];
    let projection = project(&open, &parts, at(20));
    let found: Vec<_> = projection
        .cache_parts
        .iter()
        .map(|part| {
            (
                part.booking.part,
                part.start.micros_since(at(0)) / SECOND,
                part.end.micros_since(at(0)) / SECOND,
            )
        })
        .collect();
    assert_eq!(found, [(0, 10, 30), (1, 20, 30)]);
    assert_eq!(spans(&projection.frames), [(0, 30, 40), (1, 30, 35)]);
    assert_eq!(projection.cache_full_at(JobId(uuid::Uuid::nil())), Some(at(30)));
    // With nothing left but a part, the job ends no sooner than that.
    let rest = project(&[], &parts[..1], at(20));
    assert_eq!(rest.finish_of(JobId(uuid::Uuid::nil())), Some(at(30)));
}

#[tokio::test]
async fn what_calls_for_a_plan_is_remembered_until_a_plan_knows_it() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let seen = farm.store.wanted_plan().await.unwrap();
    assert!(seen.due && seen.causes == ["node a joined"], "{seen:?}");
    // A worker that starts again is the same node: no news.
    farm.node("a").await;
    assert_eq!(farm.store.wanted_plan().await.unwrap(), seen);
    let farm = farm.restarted().await;
    assert_eq!(farm.store.wanted_plan().await.unwrap(), seen);
    // Something happens while a plan is made of what was seen before: it stays due.
    let drain = forelight_protocol::NodeChange { drain: Some(true), ..Default::default() };
    farm.store.change_node(node.id, &drain, at(1)).await.unwrap();
    farm.store.plan_still_good(&seen).await.unwrap();
    let rest = farm.store.wanted_plan().await.unwrap();
    assert!(rest.due && rest.causes == ["node a is drained"], "{rest:?}");
    farm.store.plan_still_good(&rest).await.unwrap();
    let nothing = farm.store.wanted_plan().await.unwrap();
    assert!(!nothing.due && nothing.causes.is_empty(), "{nothing:?}");
    // A burst is one plan.
    for second in 0..50 {
        farm.store.want_plan(&format!("cause {second}")).await.unwrap();
    }
    let burst = farm.store.wanted_plan().await.unwrap();
    assert!(burst.due && burst.causes.len() == 21 && burst.causes[20] == "and more", "{burst:?}");
}

impl Farm {
    /// A plan that books frames of a job anew, of which the first one has begun.
    async fn plan_after_events(&self, job: JobId, bookings: Vec<NewBooking>, factor: f64) -> NewPlan {
        let begun = BTreeSet::from([0.into()]);
        NewPlan {
            parent: self.store.newest_plan().await.unwrap(),
            reason: PlanReason::Events,
            wanted: self.store.wanted_plan().await.unwrap(),
            jobs: vec![NewJobPlan { verdict: verdict(job), bookings, begun, factor, terms: 0 }],
            outlooks: Vec::new(),
            finish: None,
            shared_cache: None,
        }
    }
}

#[tokio::test]
async fn a_frame_that_comes_back_while_a_plan_is_made_has_its_place_still() {
    let farm = Farm::new().await;
    let node = farm.node("a").await;
    let job = farm.booked_job(request("0-1"), node.id, at(10)).await;
    let lease = farm.claim(node.id, at(10)).await.unwrap();
    let stays = NewBooking { frame: 1.into(), node: node.id, start: at(50), end: at(60) };
    let plan = farm.plan_after_events(job, vec![stays], 1.0).await;
    farm.store.release(lease.lease_id, lease.fence, at(11)).await.unwrap();
    farm.store.replan(&plan, at(12)).await.unwrap();
    let open = farm.store.open_bookings().await.unwrap();
    let booked: Vec<_> = open.iter().map(|open| (open.booking.frame, open.booking.start)).collect();
    assert_eq!(booked, [(0, at(10)), (1, at(50))]);
    let place: (Option<uuid::Uuid>, Option<i64>) = sqlx::query_as(
        "SELECT booked_node, booked_at FROM tasks WHERE job_id = ? AND kind = 'render' AND frame = 0",
    )
    .bind(job.0)
    .fetch_one(farm.store.readers())
    .await
    .unwrap();
    assert_eq!(place, (Some(node.id.0), Some(at(10).micros())));
}

#[tokio::test]
async fn a_new_plan_books_what_waits_anew_and_leaves_what_is_done_as_it_was() {
    let farm = Farm::new().await;
    let (a, b) = (farm.node("a").await, farm.node("b").await);
    let job = farm.booked_job(request("0-2"), a.id, at(10)).await;
    let first = farm.store.newest_plan().await.unwrap();
    let lease = farm.claim(a.id, at(10)).await.unwrap();
    farm.commit(&lease, at(20)).await;
    let said = farm.store.job(job).await.unwrap();
    let move_to_b = |frame: u32| NewBooking { frame: frame.into(), node: b.id, start: at(50), end: at(60) };
    let plan = farm.plan_after_events(job, vec![move_to_b(0), move_to_b(1)], 1.5).await;
    let second = farm.store.replan(&plan, at(21)).await.unwrap();
    let kept = farm.store.plan(second).await.unwrap();
    let booked: Vec<_> = kept.bookings.iter().map(|booking| (booking.frame, booking.node_id)).collect();
    // Frame 0 is done, frame 1 moves, frame 2 has no booking any more.
    assert_eq!(booked, [(0, a.id), (1, b.id)]);
    assert_eq!((kept.parent_id, kept.reason), (first, PlanReason::Events));
    let (before, verdicts) = farm.store.booked_before(second).await.unwrap();
    assert_eq!((before.len(), verdicts.len()), (3, 1));
    assert_eq!(farm.store.booked_before(first.unwrap()).await.unwrap(), (Vec::new(), Vec::new()));
    let job_now = farm.store.job(job).await.unwrap();
    assert_eq!((job_now.plan_id, said.plan_id), (Some(second), first));
    // Two plans that were made of the same state: the second is refused.
    assert!(matches!(farm.store.replan(&plan, at(22)).await, Err(StoreError::Conflict(_))));
    let next = farm.claim(b.id, at(23)).await.unwrap();
    assert_eq!(next.spec.frame(), Some(1), "what is booked on the node comes first");
}

#[tokio::test]
async fn a_removed_node_keeps_its_name_for_old_plans_and_its_last_task_is_stopped() {
    let farm = Farm::new().await;
    let node = farm.node("a").await.id;
    let closed = forelight_protocol::TimeSpan { start: at(500), end: None };
    let terms = forelight_protocol::NodeTerms { maintenance: vec![closed], ..Default::default() };
    let change = forelight_protocol::NodeChange { terms: Some(terms), ..Default::default() };
    farm.store.change_node(node, &change, at(0)).await.unwrap();
    farm.booked_job(request("0-2"), node, at(10)).await;
    let lease = farm.claim(node, at(10)).await.unwrap();
    farm.store.remove_node(node, true, at(11)).await.unwrap();
    assert!(matches!(farm.store.node(node).await, Err(StoreError::NotFound("node"))));
    assert_eq!(farm.store.node_name(node).await.unwrap(), "a");
    let told = farm.store.renew(lease.lease_id, &renewal(lease.fence, 0.5), TTL, at(12)).await;
    assert!(!matches!(told, Err(StoreError::NotFound(_))), "{told:?}");
}

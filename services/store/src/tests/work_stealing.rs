//! Which booked frames idle nodes take from other nodes.

use forelight_protocol::{ByClass, Money, NodeCalibration, NodeChange, Promise, TaskError};

use super::*;
use crate::JobOutlook;

/// Units of the currency for an hour.
fn priced(name: &str, hour: i64) -> NodeRegistration {
    NodeRegistration { price_per_hour: Money(hour * 1_000_000), ..registration(name) }
}

fn bounded(frames: &str) -> JobRequest {
    JobRequest { deadline: Some(at(100_000)), ..request(frames) }
}

impl Farm {
    async fn register(&self, registration: &NodeRegistration) -> Node {
        fresh(self.store.register_node(registration, None, at(0)).await.unwrap())
    }

    /// The frames that a node gets at an instant, one after the other.
    async fn frames_for(&self, node: &Node, now: Timestamp) -> Vec<(JobId, u32)> {
        let mut frames = Vec::new();
        while let Some(lease) = self.claim(node.id, now).await {
            frames.push((lease.job_id, lease.spec.frame().unwrap()));
        }
        frames
    }

    async fn idle_reason(&self, node: &Node) -> Option<String> {
        self.store.node(node.id).await.unwrap().idle_reason
    }

    /// Records, without a new plan, whether a job's deadline is kept.
    async fn promise(&self, job: JobId, kept: bool) {
        let promise = Promise { kept, probability: 0.5, finish: None, since: at(0), rescue: None };
        let outlook = JobOutlook { promise: Some(promise), ..JobOutlook::default() };
        let said = NewPlan {
            parent: self.store.newest_plan().await.unwrap(),
            reason: PlanReason::Events,
            wanted: self.store.wanted_plan().await.unwrap(),
            jobs: Vec::new(),
            outlooks: vec![(job, outlook)],
            finish: None,
            shared_cache: None,
        };
        self.store.keep_outlooks(&said, at(1)).await.unwrap();
    }
}

#[tokio::test]
async fn an_idle_node_that_is_dearer_leaves_a_frame_to_the_node_where_it_is_booked_and_says_why() {
    let farm = Farm::new().await;
    let cheap = farm.register(&priced("cheap", 1)).await;
    let dear = farm.register(&priced("dear", 4)).await;
    farm.booked_job(bounded("0-1"), cheap.id, at(100)).await;
    assert_eq!(farm.claim(dear.id, at(1)).await, None);
    assert!(!farm.store.may_have_work(dear.id, None, at(1)).await.unwrap(), "nobody has to wake it");
    assert!(farm.store.may_have_work(cheap.id, None, at(1)).await.unwrap());
    // Speed 2 for 1 and for 4 units an hour.
    let reason =
        "cheaper to wait for cheap: an hour of a core of speed 1 of job a job costs 0.50 there and 2.00 here";
    assert_eq!(farm.idle_reason(&dear).await.as_deref(), Some(reason));
    assert_eq!(farm.frames_for(&cheap, at(1)).await.len(), 2);
    // With nothing left to pass over there is no reason.
    assert_eq!(farm.claim(dear.id, at(1)).await, None);
    assert_eq!(farm.idle_reason(&dear).await, None);
}

#[tokio::test]
async fn a_frame_that_failed_where_it_is_cheap_is_for_a_dearer_node_too() {
    let farm = Farm::new().await;
    let cheap = farm.register(&priced("cheap", 1)).await;
    let dear = farm.register(&priced("dear", 4)).await;
    farm.booked_job(bounded("0-1"), cheap.id, at(100)).await;
    let lease = farm.claim(cheap.id, at(1)).await.unwrap();
    let error = TaskError { message: "out of memory".to_owned(), ..TaskError::default() };
    farm.store.fail_task(lease.lease_id, lease.fence, &error, at(2)).await.unwrap();
    assert_eq!(farm.claim(dear.id, at(2)).await, None, "at once");
    assert_eq!(farm.claim(dear.id, at(3)).await.map(|again| again.task_id), Some(lease.task_id));
    assert_eq!(
        farm.claim(dear.id, at(3)).await,
        None,
        "the other one is booked for less, and has not failed"
    );
}

#[tokio::test]
async fn an_idle_node_that_is_no_dearer_for_the_work_helps_and_takes_what_is_booked_dearest_first() {
    let farm = Farm::new().await;
    let (one, three) = (farm.register(&priced("one", 1)).await, farm.register(&priced("three", 3)).await);
    let job = farm.submit(bounded("0-3")).await;
    let preview = farm.claim(one.id, at(0)).await.unwrap();
    farm.commit(&preview, at(0)).await;
    farm.store.start_profiling(job.id, &[0], false, at(0)).await.unwrap();
    let profile = farm.claim(one.id, at(0)).await.unwrap();
    farm.commit(&profile, at(0)).await;
    let mut plan = farm.plan_for(&job, one.id, at(100)).await;
    plan.jobs[0].bookings[2].node = three.id;
    plan.jobs[0].bookings[3].node = three.id;
    farm.store.book(job.id, &job_forecast(), &frame_forecasts(&job), None, &plan, at(0)).await.unwrap();
    // Two units an hour for twice the cores, at a measured speed that is a little lower: as expensive as
    // `one`, within the error of measurement.
    let same = NodeRegistration { speed: 1.9, cores: 2, ..priced("same", 2) };
    let same = farm.register(&same).await;
    let first = farm.claim(same.id, at(1)).await.unwrap();
    let second = farm.claim(same.id, at(1)).await.unwrap();
    assert_eq!([first.spec.frame(), second.spec.frame()], [Some(2), Some(3)]);
    let third = farm.claim(same.id, at(1)).await.unwrap();
    assert_eq!(third.spec.frame(), Some(0));
    let two = farm.register(&priced("two", 2)).await;
    assert_eq!(farm.claim(two.id, at(1)).await, None, "the last one is booked for less");
}

#[tokio::test]
async fn what_a_node_costs_is_what_it_costs_for_the_jobs_class_of_work() {
    let farm = Farm::new().await;
    let booked = farm.register(&priced("booked", 1)).await;
    // 2 units an hour: more expensive by its speed, but ten times as fast at traversal.
    let picos_per_work = ByClass { traversal: 100, ..ByClass::from_array([1000; ByClass::CLASSES]) };
    let calibration = NodeCalibration { picos_per_work, kernels: Vec::new() };
    let capabilities = Capabilities { calibration: Some(calibration), ..Capabilities::default() };
    let swift = NodeRegistration { speed: 1.0, capabilities, ..priced("swift", 2) };
    let swift = farm.register(&swift).await;
    for (work, takes) in [
        (ByClass { shading: 100, ..ByClass::default() }, false),
        (ByClass { traversal: 100, ..ByClass::default() }, true),
    ] {
        let forecast = JobForecast { work_by_class: Some(work), ..job_forecast() };
        let job = farm.quoted_job(bounded("0"), booked.id, at(100), &forecast, None).await;
        assert_eq!(farm.frames_for(&swift, at(1)).await, if takes { vec![(job, 0)] } else { Vec::new() });
        farm.store.cancel_job(job, at(2)).await.unwrap();
    }
}

#[tokio::test]
async fn a_frame_that_another_node_took_is_expected_when_that_one_is_done_with_it() {
    let farm = Farm::new().await;
    let booked = farm.register(&priced("booked", 1)).await;
    let memory_picos = ByClass { memory: 4000, ..ByClass::from_array([1000; ByClass::CLASSES]) };
    let calibration = NodeCalibration { picos_per_work: memory_picos, kernels: Vec::new() };
    let capabilities = Capabilities { calibration: Some(calibration), ..Capabilities::default() };
    let slow = farm.register(&NodeRegistration { capabilities, ..priced("slow", 1) }).await;
    let work = ByClass { memory: 100, ..ByClass::default() };
    let forecast = JobForecast { work_by_class: Some(work), ..job_forecast() };
    let job = farm.quoted_job(request("0"), booked.id, at(0), &forecast, None).await;
    assert_eq!(farm.frames_for(&slow, at(0)).await, [(job, 0)]);
    let open = farm.store.open_bookings().await.unwrap();
    let times_as_long = booked.speed_for(Some(&work)) / slow.speed_for(Some(&work));
    assert!(times_as_long > 2.0, "{times_as_long}");
    assert!((open[0].holder.unwrap().slowness - times_as_long).abs() < 1e-9, "{open:?}");
    // It was booked for ten seconds.
    let expected = (10.0 * times_as_long) as i64;
    let projected = crate::project(&open, &[], at(1));
    assert_eq!(projected.finish_of(job).map(|end| end.micros_since(at(0)) / 1_000_000), Some(expected));
}

#[tokio::test]
async fn a_budget_alone_binds_idle_nodes_too_and_a_job_with_neither_is_for_everybody() {
    let farm = Farm::new().await;
    let cheap = farm.register(&priced("cheap", 1)).await;
    let dear = farm.register(&priced("dear", 4)).await;
    let budget = JobRequest { budget: Some(Money(5_000_000)), ..request("0-1") };
    farm.booked_job(budget, cheap.id, at(100)).await;
    farm.booked_job(bounded("0-1"), cheap.id, at(200)).await;
    let free = farm.booked_job(request("0-1"), cheap.id, at(300)).await;
    assert_eq!(
        farm.frames_for(&dear, at(1)).await,
        [(free, 0), (free, 1)],
        "what is due before is passed over"
    );
}

#[tokio::test]
async fn a_frame_that_should_have_begun_a_minute_ago_is_for_whoever_is_idle() {
    let farm = Farm::new().await;
    let cheap = farm.register(&priced("cheap", 1)).await;
    let dear = farm.register(&priced("dear", 4)).await;
    let job = farm.booked_job(bounded("0-2"), cheap.id, at(100)).await;
    touch(&farm.store, cheap.id, at(150)).await;
    assert_eq!(farm.claim(dear.id, at(159)).await, None);
    assert_eq!(farm.frames_for(&dear, at(160)).await, [(job, 0)], "the next is booked ten seconds later");
    assert_eq!(farm.frames_for(&dear, at(170)).await, [(job, 1)]);
}

#[tokio::test]
async fn a_frame_that_lost_its_worker_is_for_whoever_is_idle_before_the_same_node_gets_it_again() {
    let farm = Farm::new().await;
    let cheap = farm.new_worker("cheap", at(0)).await;
    let dear = farm.register(&priced("dear", 4)).await;
    // It began ahead of the plan.
    let job = farm.booked_job(bounded("0"), cheap.id, at(1000)).await;
    farm.claim(cheap.id, at(1)).await.unwrap();
    assert_eq!(farm.claim(dear.id, at(2)).await, None);
    farm.new_worker("cheap", at(3)).await;
    assert_eq!(farm.claim(cheap.id, at(4)).await, None);
    assert_eq!(farm.frames_for(&dear, at(5)).await, [(job, 0)]);
}

#[tokio::test]
async fn what_is_booked_on_a_node_that_is_lost_or_gets_no_tasks_is_for_whoever_is_idle() {
    for drained in [false, true] {
        let farm = Farm::new().await;
        let cheap = farm.register(&priced("cheap", 1)).await;
        let dear = farm.register(&priced("dear", 4)).await;
        let job = farm.booked_job(bounded("0"), cheap.id, at(1000)).await;
        assert_eq!(farm.claim(dear.id, at(300)).await, None);
        if drained {
            let drain = NodeChange { drain: Some(true), ..NodeChange::default() };
            farm.store.change_node(cheap.id, &drain, at(300)).await.unwrap();
            assert_eq!(farm.frames_for(&dear, at(300)).await, [(job, 0)]);
        } else {
            // Nobody could be heard of while the service was down.
            farm.store.extend_leases_after_start(TTL, at(200)).await.unwrap();
            assert_eq!(farm.claim(dear.id, at(499)).await, None);
            assert_eq!(farm.frames_for(&dear, at(501)).await, [(job, 0)]);
        }
    }
}

#[tokio::test]
async fn a_job_whose_deadline_the_plan_does_not_keep_is_for_everybody() {
    let farm = Farm::new().await;
    let cheap = farm.register(&priced("cheap", 1)).await;
    let dear = farm.register(&priced("dear", 4)).await;
    let job = farm.booked_job(bounded("0-2"), cheap.id, at(1000)).await;
    let mut taken = Vec::new();
    for kept in [true, false] {
        farm.promise(job, kept).await;
        taken.push(farm.frames_for(&dear, at(1)).await.len());
    }
    assert_eq!(taken, [0, 3]);
}

#[tokio::test]
async fn what_is_found_out_too_late_about_a_job_that_is_over_changes_nothing() {
    let farm = Farm::new().await;
    let node = farm.register(&priced("a", 1)).await;
    let job = farm.booked_job(bounded("0"), node.id, at(1000)).await;
    farm.promise(job, true).await;
    let cancelled = farm.store.cancel_job(job, at(2)).await.unwrap();
    let events = farm.store.last_event_id().await.unwrap();
    farm.promise(job, false).await;
    assert_eq!(farm.store.job(job).await.unwrap(), cancelled);
    assert_eq!(farm.store.last_event_id().await.unwrap(), events);
}

#[tokio::test]
async fn looking_at_a_bounded_job_is_a_few_steps_into_indexes_however_many_frames_it_has() {
    let farm = Farm::new().await;
    for query in [crate::claims::work_stealing::NEXT_OF_JOB, crate::claims::work_stealing::NEXT_NO_DEARER] {
        let steps = super::claims::steps_of(&farm, query).await;
        // The claiming node's few renderers are a list in its row.
        let slow = |step: &String| {
            step.starts_with("SCAN") && !step.starts_with("SCAN json_each") || step.contains("TEMP B-TREE")
        };
        assert!(!steps.iter().any(slow), "{query}: {steps:?}");
        for step in steps.iter().filter(|step| step.starts_with("SEARCH tasks USING INDEX tasks_ready")) {
            assert!(step.contains("job_id=?"), "{step}");
        }
    }
    // The dearest booking is found by the rate, the most overdue by its start.
    let steps = super::claims::steps_of(&farm, crate::claims::work_stealing::NEXT_NO_DEARER).await;
    for bound in
        ["tasks_ready_rates (job_id=? AND booked_rate>?)", "tasks_ready_starts (job_id=? AND booked_at<?)"]
    {
        assert!(steps.iter().any(|step| step.contains(bound)), "{bound}: {steps:?}");
    }
}

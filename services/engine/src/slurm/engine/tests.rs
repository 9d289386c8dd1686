//! Tests of the loop against a fake cluster.

use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::sync::Arc;

use forelight_protocol::{
    BundleSource, EventKind, Job, JobChange, JobId, JobRequest, JobState, Money, NodeChange, NodeId,
    NodeRegistration, RenewRequest, SceneDigest, SceneSummary, TaskId,
};
use forelight_store::{Answered, NewJob};

use super::*;
use crate::slurm::answer::Ending;

/// State and behaviour of the fake cluster.
#[derive(Default)]
struct Fake {
    jobs: Vec<SlurmJob>,
    /// Arguments of all calls, in order, with the program first.
    said: Vec<Vec<String>>,
    away: bool,
    /// The next submission succeeds, but its answer is lost.
    lose_answer: bool,
    refuse: Option<String>,
}

#[derive(Clone, Default)]
struct FakeCluster(Arc<Mutex<Fake>>);

impl FakeCluster {
    fn with<T>(&self, change: impl FnOnce(&mut Fake) -> T) -> T {
        change(&mut self.0.lock())
    }

    /// Sets Slurm's state of all elements.
    fn all(&self, state: &str) {
        self.with(|fake| fake.jobs.iter_mut().for_each(|job| job.state = state.to_owned()));
    }

    fn said(&self, program: &str) -> Vec<Vec<String>> {
        self.with(|fake| fake.said.iter().filter(|words| words[0] == program).cloned().collect())
    }

    fn answer<T>(
        &self,
        program: &str,
        arguments: Vec<String>,
        value: impl FnOnce(&mut Fake) -> T,
    ) -> Result<T, ClusterError> {
        self.with(|fake| {
            if fake.away {
                return Err(ClusterError::Away("Unable to contact slurm controller".to_owned()));
            }
            fake.said.push(std::iter::once(program.to_owned()).chain(arguments).collect());
            Ok(value(fake))
        })
    }
}

impl Cluster for FakeCluster {
    async fn jobs(&self) -> Result<Vec<SlurmJob>, ClusterError> {
        self.answer("squeue", Vec::new(), |fake| fake.jobs.clone())
    }

    async fn nodes(&self, _: Option<&str>) -> Result<Vec<SlurmNode>, ClusterError> {
        let node = |name: &str, up| SlurmNode { name: name.to_owned(), cpus: 4, up };
        self.answer("sinfo", Vec::new(), |_| vec![node("n1", true), node("n2", true), node("n3", false)])
    }

    async fn submit(&self, arguments: Vec<String>, script: String) -> Result<u32, ClusterError> {
        if let Some(reason) = self.with(|fake| fake.refuse.clone()) {
            return Err(ClusterError::Refused { program: "sbatch", reason });
        }
        let value = |name: &str| {
            let found = arguments.iter().find_map(|word| word.strip_prefix(name));
            found.map(str::to_owned).unwrap_or_default()
        };
        let (comment, last) = (value("--comment="), value("--array=0-").parse::<u32>().unwrap());
        assert!(script.contains("--task \"$1\""));
        let number = self.answer("sbatch", arguments.clone(), |fake| {
            let number = 100 + fake.jobs.len() as u32;
            fake.jobs.push(SlurmJob {
                array: number,
                elements: vec![0..=last],
                state: "PENDING".to_owned(),
                reason: "Resources".to_owned(),
                ending: Ending::default(),
                comment,
            });
            number
        })?;
        if self.with(|fake| std::mem::take(&mut fake.lose_answer)) {
            return Err(ClusterError::Away("Socket timed out on send/recv operation".to_owned()));
        }
        Ok(number)
    }

    async fn cancel(&self, arguments: Vec<String>) -> Result<(), ClusterError> {
        self.answer("scancel", arguments, |_| ())
    }

    async fn control(&self, arguments: Vec<String>) -> Result<(), ClusterError> {
        self.answer("scontrol", arguments, |_| ())
    }
}

/// A farm with a real store and a fake Slurm.
struct Farm {
    folder: tempfile::TempDir,
    store: Store,
    slurm: FakeCluster,
    engine: Engine<FakeCluster>,
}

fn at(seconds: i64) -> Timestamp {
    Timestamp::from_micros(1_800_000_000_000_000 + seconds * 1_000_000)
}

fn engine(store: &Store, slurm: &FakeCluster) -> Engine<FakeCluster> {
    let submitting = Submitting {
        partition: None,
        account: None,
        program: "/opt/forelight".into(),
        server: "http://farm:7878".to_owned(),
        token_file: "/srv/token".into(),
        bundles: None,
        preview: "auto",
        price_per_hour: Money(0),
        worker_options: Vec::new(),
        logs: "/srv/logs".into(),
    };
    let options = Options { submitting, quote_minutes: 60, reserve_for: None, poll: Duration::from_secs(5) };
    Engine::new(store.clone(), slurm.clone(), options)
}

impl Farm {
    async fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).await.unwrap();
        let slurm = FakeCluster::default();
        let engine = engine(&store, &slurm);
        Self { folder, store, slurm, engine }
    }

    /// Restarts the service. Slurm keeps its jobs.
    async fn restarted(self) -> Self {
        let Self { folder, store, slurm, engine: old } = self;
        drop(old);
        store.close().await;
        drop(store);
        let store = Store::open(folder.path()).await.unwrap();
        let engine = engine(&store, &slurm);
        Self { folder, store, slurm, engine }
    }

    /// A job whose preview task is ready.
    async fn job(&self) -> Job {
        let request: JobRequest = serde_json::from_value(
            serde_json::json!({"name": "a", "bundle": {"path": "/scenes/a"}, "frames": "0-3"}),
        )
        .unwrap();
        let scene = SceneSummary {
            name: "a".to_owned(),
            digest: SceneDigest([0; 32]),
            frames: 4,
            width: 8,
            height: 8,
            objects: 1,
            materials: 1,
            triangles: 1,
            frames_per_second: None,
        };
        let settings = request.settings.complete((8, 8));
        let source = BundleSource::Path("/scenes/a".to_owned());
        let new = NewJob { request, scene, source, settings: settings.into() };
        match self.store.create_job(&new, None, at(0)).await.unwrap() {
            Answered::Fresh(job) => job,
            Answered::Repeated(_) => panic!("nobody has asked before"),
        }
    }

    async fn round(&mut self, seconds: i64) {
        let outcome = self.engine.round(at(seconds)).await;
        self.engine.tell(outcome, at(seconds)).await;
    }

    async fn told(&self, kind: EventKind) -> Vec<String> {
        let events = self.store.events_after(None, 0, 1000).await.unwrap();
        events.into_iter().filter(|event| event.kind == kind).filter_map(|event| event.message).collect()
    }

    async fn only_task(&self) -> TaskId {
        let arrays = self.store.open_slurm_arrays().await.unwrap();
        assert!(arrays.len() == 1 && arrays[0].elements.len() == 1, "{arrays:?}");
        arrays[0].elements[0].task
    }

    async fn node(&self, name: &str) -> NodeId {
        let registration = NodeRegistration {
            name: name.to_owned(),
            speed: 1.5,
            price_per_hour: Money(0),
            cores: 4,
            capabilities: Default::default(),
            schedule: None,
            worker: None,
        };
        match self.store.register_node(&registration, None, at(0)).await.unwrap() {
            Answered::Fresh(node) => node.id,
            Answered::Repeated(_) => panic!("nobody has asked before"),
        }
    }

    async fn lease(&self, task: TaskId, node: NodeId, seconds: i64) -> bool {
        let ttl = Duration::from_secs(30);
        self.store.claim_task(node, task, ttl, None, at(seconds)).await.unwrap().is_some()
    }

    async fn state(&self, job: JobId) -> (JobState, Option<String>) {
        let job = self.store.job(job).await.unwrap();
        (job.state, job.error)
    }
}

#[tokio::test]
async fn a_task_is_submitted_once_however_often_slurm_is_looked_at_and_whoever_is_restarted() {
    let mut farm = Farm::new().await;
    farm.job().await;
    farm.round(0).await;
    farm.round(5).await;
    let mut farm = farm.restarted().await;
    farm.round(10).await;
    assert_eq!(farm.slurm.said("sbatch").len(), 1);
    assert_eq!(farm.told(EventKind::TaskSubmitted).await, ["Slurm job 100_0"]);
    let seen: BTreeMap<String, u32> =
        farm.store.nodes(None, 10).await.unwrap().into_iter().map(|node| (node.name, node.cores)).collect();
    assert_eq!(seen, BTreeMap::from([("n1".to_owned(), 4), ("n2".to_owned(), 4)]));
}

#[tokio::test]
async fn nodes_that_get_no_tasks_here_get_none_from_slurm() {
    for order in [
        NodeChange { drain: Some(true), ..NodeChange::default() },
        NodeChange { pause: Some(true), ..NodeChange::default() },
        NodeChange { set_aside: Some(true), ..NodeChange::default() },
    ] {
        let mut farm = Farm::new().await;
        farm.round(0).await;
        let nodes = farm.store.nodes(None, 10).await.unwrap();
        let n2 = nodes.iter().find(|node| node.name == "n2").unwrap();
        farm.store.change_node(n2.id, &order, at(1)).await.unwrap();
        farm.job().await;
        farm.round(2).await;
        let words = farm.slurm.said("sbatch").concat();
        assert!(words.contains(&"--exclude=n2".to_owned()), "{order:?}: {words:?}");
    }
}

#[tokio::test]
async fn an_array_whose_answer_was_lost_is_found_again_by_its_comment_and_not_submitted_twice() {
    let mut farm = Farm::new().await;
    farm.job().await;
    farm.slurm.with(|fake| fake.lose_answer = true);
    farm.round(0).await;
    // The service dies before it can record anything.
    let mut farm = farm.restarted().await;
    farm.round(5).await;
    farm.round(500).await;
    assert_eq!(farm.slurm.said("sbatch").len(), 1);
    let arrays = farm.store.open_slurm_arrays().await.unwrap();
    assert_eq!(arrays[0].slurm_id, Some(100));
}

#[tokio::test]
async fn an_array_that_never_reached_slurm_is_submitted_again_but_not_before_that_is_sure() {
    let mut farm = Farm::new().await;
    farm.job().await;
    farm.slurm.with(|fake| fake.lose_answer = true);
    farm.round(0).await;
    farm.slurm.with(|fake| fake.jobs.clear());
    farm.round(59).await;
    assert_eq!(farm.slurm.said("sbatch").len(), 1);
    farm.round(60).await;
    assert_eq!(farm.slurm.said("sbatch").len(), 2);
}

#[tokio::test]
async fn a_controller_that_is_away_costs_nothing_but_time_and_is_told_of_once() {
    let mut farm = Farm::new().await;
    let job = farm.job().await;
    farm.slurm.with(|fake| fake.away = true);
    for seconds in 0..20 {
        farm.round(seconds * 100).await;
    }
    assert_eq!(farm.state(job.id).await.0, JobState::Previewing);
    farm.slurm.with(|fake| fake.away = false);
    farm.round(2000).await;
    assert_eq!(farm.slurm.said("sbatch").len(), 1);
    let told = farm.told(EventKind::EngineState).await;
    assert_eq!(told.len(), 2, "{told:?}");
    assert!(told[0].contains("does not answer") && told[1].contains("answers again"), "{told:?}");
}

#[tokio::test]
async fn what_slurm_refuses_is_told_with_its_words_and_tried_again_later() {
    let mut farm = Farm::new().await;
    farm.job().await;
    farm.slurm.with(|fake| fake.refuse = Some("invalid partition specified: x".to_owned()));
    farm.round(0).await;
    farm.round(5).await;
    farm.slurm.with(|fake| fake.refuse = None);
    farm.round(29).await;
    assert_eq!(farm.slurm.said("sbatch").len(), 0);
    farm.round(30).await;
    assert_eq!(farm.slurm.said("sbatch").len(), 1);
    let told = farm.told(EventKind::EngineState).await;
    assert_eq!(told.len(), 2, "{told:?}");
    assert!(told[0].contains("invalid partition specified: x"), "{told:?}");
}

#[tokio::test]
async fn elements_of_a_paused_job_leave_slurm_without_a_loss_and_come_back_when_it_is_resumed() {
    let mut farm = Farm::new().await;
    let job = farm.job().await;
    for round in 0..8 {
        let start = 1000 * round;
        farm.round(start).await;
        assert_eq!(farm.slurm.said("sbatch").len() as i64, round + 1);
        let set = async |farm: &Farm, paused, seconds| {
            let change = JobChange { paused: Some(paused), ..JobChange::default() };
            farm.store.change_job(job.id, &change, at(start + seconds)).await.unwrap();
        };
        set(&farm, true, 1).await;
        farm.round(start + 2).await;
        assert_eq!(farm.slurm.said("scancel").len() as i64, round + 1);
        farm.slurm.all("CANCELLED");
        farm.round(start + 3).await;
        assert!(farm.store.open_slurm_arrays().await.unwrap().is_empty());
        assert_eq!(farm.slurm.said("sbatch").len() as i64, round + 1, "it is paused");
        set(&farm, false, 4).await;
    }
    assert_eq!(farm.state(job.id).await, (JobState::Previewing, None));
    assert_eq!(farm.told(EventKind::SubmissionLost).await, Vec::<String>::new());
}

#[tokio::test]
async fn an_element_that_somebody_cancels_is_handed_out_again_until_it_was_lost_six_times() {
    let mut farm = Farm::new().await;
    let job = farm.job().await;
    for round in 0..6 {
        farm.round(round * 1000).await;
        farm.slurm.all("CANCELLED");
        farm.round(round * 1000 + 1).await;
    }
    assert_eq!(farm.slurm.said("sbatch").len(), 6);
    farm.round(10_000).await;
    let (state, error) = farm.state(job.id).await;
    assert_eq!(state, JobState::Failed);
    let error = error.unwrap();
    assert!(
        error.starts_with("preview: Slurm ended its process 6 times, the last one with CANCELLED"),
        "{error}"
    );
    assert_eq!(farm.told(EventKind::SubmissionLost).await.len(), 6);
    farm.round(20_000).await;
    assert_eq!(farm.slurm.said("sbatch").len(), 6);
}

#[tokio::test]
async fn what_slurm_starts_twice_waits_while_the_first_lives_and_nothing_is_submitted_beside_them() {
    let mut farm = Farm::new().await;
    farm.job().await;
    farm.round(0).await;
    let task = farm.only_task().await;
    let (first, second) = (farm.node("n1").await, farm.node("n2").await);
    assert!(farm.lease(task, first, 10).await);
    // The first node is lost. Slurm requeues its job and starts it elsewhere.
    for state in ["PENDING", "RUNNING"] {
        farm.slurm.all(state);
        farm.round(20).await;
        assert!(!farm.lease(task, second, 25).await);
    }
    // Slurm reports a node failure while the first process still works.
    farm.slurm.all("NODE_FAIL");
    farm.round(30).await;
    assert_eq!(farm.slurm.said("sbatch").len(), 1);
    // Its lease expires. Only then is the task submitted again.
    farm.store.sweep(at(41)).await.unwrap();
    farm.round(42).await;
    farm.round(60).await;
    assert_eq!(farm.slurm.said("sbatch").len(), 2);
}

#[tokio::test]
async fn a_job_that_is_cancelled_here_is_cancelled_there_whether_it_waits_or_runs() {
    let mut farm = Farm::new().await;
    let job = farm.job().await;
    farm.round(0).await;
    farm.slurm.all("RUNNING");
    farm.store.cancel_job(job.id, at(5)).await.unwrap();
    farm.round(6).await;
    assert_eq!(farm.slurm.said("scancel"), [["scancel", "--quiet", "100_0"]]);
    farm.slurm.all("CANCELLED");
    farm.round(10).await;
    assert!(farm.store.open_slurm_arrays().await.unwrap().is_empty());
    assert!(farm.told(EventKind::SubmissionLost).await.is_empty());
}

#[tokio::test]
async fn another_jobs_number_is_not_taken_for_ours_after_the_controller_lost_its_state() {
    let mut farm = Farm::new().await;
    farm.job().await;
    farm.round(0).await;
    // Another user's running job now has our number.
    farm.slurm.with(|fake| fake.jobs[0].comment = "a simulation".to_owned());
    farm.slurm.all("RUNNING");
    farm.round(5).await;
    farm.round(30).await;
    assert_eq!(farm.slurm.said("sbatch").len(), 2);
    assert!(farm.slurm.said("scancel").is_empty());
}

#[tokio::test]
async fn what_waits_for_a_reason_that_will_not_pass_by_itself_is_told_once() {
    let mut farm = Farm::new().await;
    farm.job().await;
    farm.round(0).await;
    farm.slurm.with(|fake| fake.jobs[0].reason = "PartitionTimeLimit".to_owned());
    farm.round(5).await;
    farm.round(10).await;
    assert_eq!(farm.told(EventKind::EngineState).await, ["Slurm keeps job 100 waiting: PartitionTimeLimit"]);
}

#[tokio::test]
async fn a_task_that_makes_no_progress_is_submitted_again_for_another_node_beside_the_first() {
    let mut farm = Farm::new().await;
    farm.job().await;
    farm.round(0).await;
    let task = farm.only_task().await;
    let [hangs, helps] = [farm.node("n1").await, farm.node("n2").await];
    let ttl = Duration::from_secs(30);
    let claimed = farm.store.claim_task(hangs, task, ttl, None, at(10)).await.unwrap();
    let Some(Answered::Fresh(lease)) = claimed else { panic!("the task is ready") };
    farm.slurm.all("RUNNING");
    // It renews its lease, and does nothing for twenty minutes.
    for step in 1..=64 {
        let now = at(10 + 20 * step);
        let renewal = RenewRequest { fence: lease.fence, ..RenewRequest::default() };
        farm.store.renew(lease.lease_id, &renewal, ttl, now).await.unwrap();
        farm.store.sweep(now).await.unwrap();
        farm.round(10 + 20 * step).await;
    }
    let submitted = farm.slurm.said("sbatch");
    assert_eq!(submitted.len(), 2, "once for each attempt: {submitted:?}");
    assert!(submitted[1].iter().any(|word| word == "--exclude=n1"), "{:?}", submitted[1]);
    assert!(!farm.lease(task, hangs, 1300).await, "it has the task already");
    assert!(farm.lease(task, helps, 1300).await);
    farm.round(1310).await;
    assert_eq!(farm.slurm.said("sbatch").len(), 2);
}

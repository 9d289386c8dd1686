//! A farm on which one node in four lies at random: it hangs, forges results, calls errors permanent, and
//! says that files are gone.

use std::collections::{BTreeMap, BTreeSet};

use forelight_protocol::{FailureKind, JobState, NodeId, TaskError};
use forelight_random::Random;

use super::trust::forged;
use super::*;
use crate::StoreError;
use crate::policy::faults::FAULTS;

const NODES: usize = 12;
const LIARS: usize = NODES / 4;
const FRAMES: u32 = 200;

/// How long an honest frame takes, in seconds. Its P95 is 2.5 s.
const FRAME: i64 = 6;

/// What a node does with its lease.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Conduct {
    Honest,
    Hangs,
    Forges(u32),
    Fails { permanent: bool, kind: FailureKind },
}

struct Busy {
    lease: Lease,
    since: i64,
    conduct: Conduct,
}

fn conduct(random: &mut Random) -> Conduct {
    match random.below(10) {
        0 => Conduct::Hangs,
        1 => Conduct::Forges(random.below(3) as u32),
        2 => Conduct::Fails { permanent: true, kind: FailureKind::Task },
        3 => Conduct::Fails { permanent: false, kind: FailureKind::Input },
        4 => Conduct::Fails { permanent: false, kind: FailureKind::Unknown },
        _ => Conduct::Honest,
    }
}

impl Farm {
    /// Does what the node does with its lease at this second. Returns whether it has none after that.
    async fn act(&self, busy: &Busy, second: i64) -> bool {
        let Busy { lease, since, conduct } = busy;
        let (id, fence, now) = (lease.lease_id, lease.fence, at(second));
        let is_lost = |error: &StoreError| matches!(error, StoreError::LeaseLost);
        match conduct {
            Conduct::Hangs => match self.store.renew(id, &renewal(fence, 0.0), TTL, now).await {
                Ok(renewed) => renewed.order == forelight_protocol::LeaseOrder::Stop,
                Err(error) => {
                    assert!(is_lost(&error), "{error}");
                    true
                }
            },
            _ if second < since + FRAME => false,
            Conduct::Honest => {
                let result = forged(self, lease, |_| {}).await;
                self.store.check_evidence(id, fence, &result, now).await.unwrap();
                let committed = self.store.commit_result(id, fence, &result, now).await;
                assert!(committed.as_ref().err().is_none_or(is_lost), "{committed:?}");
                true
            }
            Conduct::Forges(what) => {
                let html = self.stored(b"<html>").await;
                let result = forged(self, lease, |result| match what {
                    0 => result.stats.cpu_seconds = 1e9,
                    1 => result.stats.work = u64::MAX / 4,
                    _ => result.artifacts.image_exr = html,
                })
                .await;
                let refused = self.store.check_evidence(id, fence, &result, now).await;
                assert!(matches!(refused, Err(StoreError::Implausible { .. })), "{refused:?}");
                true
            }
            &Conduct::Fails { permanent, kind } => {
                let message = "this can not be done".to_owned();
                let error = TaskError { message, permanent, kind, limit: None };
                // The service has every file.
                let error = crate::policy::faults::after_a_look(error, None);
                self.store.fail_task(id, fence, &error, now).await.unwrap();
                true
            }
        }
    }
}

/// Runs a farm until its job is over, and returns what was set aside.
async fn run(seed: u64) -> (Farm, JobId, BTreeSet<NodeId>, Vec<NodeId>, BTreeMap<NodeId, BTreeSet<u32>>) {
    let farm = Farm::new().await;
    let mut random = Random::new(seed);
    let mut nodes = Vec::new();
    for number in 0..NODES {
        nodes.push(farm.node(&format!("n{number:02}")).await.id);
    }
    let job = farm.booked_job(request(&format!("0-{}", FRAMES - 1)), nodes[NODES - 1], at(0)).await;
    let mut busy: BTreeMap<NodeId, Busy> = BTreeMap::new();
    let mut lied: BTreeMap<NodeId, BTreeSet<u32>> = BTreeMap::new();
    for second in 0.. {
        assert!(second < 3600, "the job does not end: {:?}", farm.store.job(job).await.unwrap());
        if farm.store.job(job).await.unwrap().state.is_final() {
            break;
        }
        for (place, &node) in nodes.iter().enumerate() {
            if let Some(holds) = busy.get(&node)
                && farm.act(holds, second).await
            {
                busy.remove(&node);
            }
            if busy.contains_key(&node) {
                continue;
            }
            if let Some(lease) = farm.claim(node, at(second)).await {
                let is_liar = place < LIARS;
                let conduct = if is_liar { conduct(&mut random) } else { Conduct::Honest };
                if conduct != Conduct::Honest {
                    lied.entry(node).or_default().insert(lease.spec.frame().unwrap());
                }
                busy.insert(node, Busy { lease, since: second, conduct });
            }
        }
        farm.store.sweep(at(second)).await.unwrap();
    }
    let mut aside = BTreeSet::new();
    for &node in &nodes {
        if farm.store.node(node).await.unwrap().set_aside.is_some() {
            aside.insert(node);
        }
    }
    (farm, job, aside, nodes, lied)
}

#[tokio::test]
async fn with_one_node_in_four_lying_at_random_every_frame_is_there_once_and_right_and_no_innocent_pays() {
    let mut caught = 0;
    for seed in 1..=3 {
        let (farm, job, aside, nodes, lied) = run(seed).await;
        let done = farm.store.job(job).await.unwrap();
        assert_eq!((done.state, done.frames_done), (JobState::Done, FRAMES), "{seed}: {:?}", done.error);
        let rows = farm.store.frames(job, None, 1000).await.unwrap();
        assert_eq!(rows.len(), FRAMES as usize);
        let right = forelight_protocol::RenderStats { frame: 0, ..stats(0) };
        for row in rows {
            let actual = row.actual.unwrap();
            assert_eq!(
                forelight_protocol::RenderStats { frame: 0, ..actual },
                right,
                "{seed}: {}",
                row.frame
            );
        }
        let innocent: Vec<_> = nodes[LIARS..].iter().filter(|node| aside.contains(node)).collect();
        assert!(innocent.is_empty(), "{seed}: {innocent:?}");
        for node in &nodes[..LIARS] {
            let lies = lied.get(node).map_or(0, BTreeSet::len);
            // A lie that nobody but itself put right is not known.
            assert!(lies <= FAULTS as usize + 1 || aside.contains(node), "{seed}: {lies} lies");
        }
        assert_eq!(farm.store.track_record(None, 1, None).await.unwrap().frames, u64::from(FRAMES));
        caught += aside.len();
    }
    assert!(caught >= 5, "{caught} of 9 liars were set aside");
}

//! The fixed cases: what they simulate, and what they must reach.

use super::runner::{Document, Finding, Runner, Simulated};
use super::table::hours;
use anyhow::Result;
use forelight_planner::Confidence;
use forelight_simulator::{Chances, PolicyKind, Report, Scenario, World, stills as draw_stills};

/// Pools to try EDF with, per cent of the nodes. A farm's operator would also search for the best.
const POOLS: [u32; 9] = [100, 60, 40, 30, 25, 22, 20, 18, 16];
/// Required share of saved cost in the month, and of kept promises at each confidence.
const MONTH_SAVES: f64 = 0.15;
const PROMISES: [(Confidence, f64); 2] = [(Confidence::P80, 0.80 - 0.03), (Confidence::P95, 0.95 - 0.02)];

/// For long frames: a frame's own cache relative to the shared one, and the required gain in promises.
const OWN_CACHE: f64 = 0.5;
const SHOTS_MORE: f64 = 0.0;

/// For stills: the most parts of a frame, the least time saved, and the most that this may cost.
const STILL_PARTS: u32 = 512;
const STILLS_SAVE: f64 = 0.90;
const STILLS_COST: f64 = 0.03;

pub(super) fn month(runner: &Runner) -> Result<Document> {
    let world = Scenario::MONTH.world(runner.chances)?;
    let mut runs = vec![(PolicyKind::Planned, 100)];
    runs.extend(POOLS.map(|pool| (PolicyKind::Deadline, pool)));
    runs.extend([PolicyKind::ThreeFrames, PolicyKind::FairShare, PolicyKind::Fifo].map(|kind| (kind, 100)));
    let simulated = runner.world("a month, 1,000 nodes".to_owned(), &world, &runs)?;
    let mut findings = Vec::new();
    let ours = simulated.reports.iter().find(|report| report.policy == PolicyKind::Planned);
    if let Some((ours, rival)) = ours.zip(rival(&simulated.reports)) {
        let saved = 1.0 - ours.cost as f64 / rival.cost.max(1) as f64;
        findings.push(Finding {
            what: format!(
                "saved compared with EDF on the cheapest {} % of the nodes, which has {:.1} % in time (forelight: {:.1} %)",
                rival.pool,
                rival.on_time() * 100.0,
                ours.on_time() * 100.0
            ),
            found: saved,
            wanted: MONTH_SAVES,
            at_most: false,
            reached: saved >= MONTH_SAVES,
        });
    }
    Ok(Document { worlds: vec![simulated], findings })
}

/// The cheapest EDF that is in time as often as forelight. Otherwise the cheapest one that is at most one job
/// in a hundred behind. Otherwise the one that is in time most often.
pub(super) fn rival(reports: &[Report]) -> Option<&Report> {
    let ours = reports.iter().find(|report| report.policy == PolicyKind::Planned)?;
    let all = || reports.iter().filter(|report| report.policy == PolicyKind::Deadline);
    let at_least = |rate: f64| all().filter(|r| r.on_time() >= rate).min_by_key(|report| report.cost);
    at_least(ours.on_time())
        .or_else(|| at_least(ours.on_time() - 0.01))
        .or_else(|| all().max_by(|a, b| a.on_time().total_cmp(&b.on_time())))
}

pub(super) fn promises(runner: &Runner) -> Result<Document> {
    let mut document = Document { worlds: Vec::new(), findings: Vec::new() };
    for (confidence, wanted) in PROMISES {
        let world = Scenario::promises(confidence).world(runner.chances)?;
        let per_cent = confidence.probability() * 100.0;
        let name = format!("promises at {per_cent:.0} %");
        let simulated = runner.world(name, &world, &[(PolicyKind::Planned, 100)])?;
        for report in &simulated.reports {
            document.findings.push(Finding {
                what: format!("of {} promises at {per_cent:.0} % were kept", report.promised),
                found: report.kept(),
                wanted,
                at_most: false,
                reached: report.kept() >= wanted && report.promised >= 1000,
            });
        }
        document.worlds.push(simulated);
    }
    Ok(document)
}

/// The same jobs with frames and caches in one piece, and in parts.
pub(super) fn shots(runner: &Runner) -> Result<Document> {
    let chances = Chances { own_cache: OWN_CACHE, ..runner.chances };
    let whole = Scenario { parts: 1, ..Scenario::SHOTS }.world(chances)?;
    let parts = Scenario::SHOTS.world(chances)?;
    let runs = [PolicyKind::Planned, PolicyKind::Deadline].map(|kind| (kind, 100));
    let whole = runner.world("in one piece".to_owned(), &whole, &runs[..1])?;
    let parts = runner.world("in parts".to_owned(), &parts, &runs)?;
    let promised = |world: &Simulated| world.reports.first().map_or(0, |report| report.promised);
    let more = promised(&parts) as f64 / promised(&whole).max(1) as f64 - 1.0;
    let kept = parts.reports.first().map_or(0.0, Report::kept);
    let findings = vec![
        Finding {
            what: "more jobs are promised with caches in parts".to_owned(),
            found: more,
            wanted: SHOTS_MORE,
            at_most: false,
            reached: more >= SHOTS_MORE,
        },
        Finding {
            what: "of these promises at 80 % were kept".to_owned(),
            found: kept,
            wanted: PROMISES[0].1,
            at_most: false,
            reached: kept >= PROMISES[0].1,
        },
    ];
    Ok(Document { worlds: vec![whole, parts], findings })
}

/// The same stills whole, and in parts.
pub(super) fn stills(runner: &Runner) -> Result<Document> {
    let world = |parts: u32| World::new(draw_stills(parts, runner.chances.seed), runner.chances);
    let runs = [(PolicyKind::Planned, 100)];
    let whole = runner.world("whole frames".to_owned(), &world(1)?, &runs)?;
    let parts = runner.world("frames in parts".to_owned(), &world(STILL_PARTS)?, &runs)?;
    let mut findings = Vec::new();
    if let Some((before, after)) = whole.reports.first().zip(parts.reports.first()) {
        let saved = 1.0 - after.median_hours / before.median_hours.max(f64::MIN_POSITIVE);
        let more = after.cost as f64 / before.cost.max(1) as f64 - 1.0;
        findings = vec![
            Finding {
                what: format!(
                    "of the median time from submit to image is saved: {} instead of {}",
                    hours(after.median_hours),
                    hours(before.median_hours)
                ),
                found: saved,
                wanted: STILLS_SAVE,
                at_most: false,
                reached: saved >= STILLS_SAVE,
            },
            Finding {
                what: "more is paid".to_owned(),
                found: more,
                wanted: STILLS_COST,
                at_most: true,
                reached: more <= STILLS_COST,
            },
        ];
    }
    Ok(Document { worlds: vec![whole, parts], findings })
}

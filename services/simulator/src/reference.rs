//! Reference farms, and the optimum of small ones by exhaustive search. For scenarios, for the planner's
//! tests and for `forelight bench plan`. The planner does not know them.

use std::collections::BTreeMap;
use std::sync::Arc;

use forelight_planner::chance::{between, bits, normal, uniform};
use forelight_planner::{Confidence, Division, Frame, Input, Interval, Job, Node, SharedCache, WorkTotal};

const SECOND: i64 = 1_000_000;
const MINUTE: i64 = 60 * SECOND;
const HOUR: i64 = 60 * MINUTE;
const DAY: i64 = 24 * HOUR;
/// Work of an hour on a node of speed one.
const WORK_OF_AN_HOUR: f64 = 3.6e12;
/// Memory classes of a studio's jobs, in GiB. Each is a class of work, on CPUs first, then on GPUs.
const NEEDS: [u64; 3] = [32, 60, 100];

/// Size of a farm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// Jobs.
    pub jobs: u64,
    /// Frames of all jobs together.
    pub frames: u64,
    /// Nodes.
    pub nodes: u64,
    /// Classes of nodes.
    pub classes: u64,
    /// Days from the first release to the last deadline.
    pub days: u64,
}

impl Default for Size {
    fn default() -> Self {
        Size { jobs: 200, frames: 20_000, nodes: 500, classes: 20, days: 7 }
    }
}

/// A studio's week. Two fifths of the classes are its own farm, three tenths are workstations at night, and
/// three tenths are rented by the hour with a set-up. A fifth has GPUs. A fifth of the jobs have shared
/// caches, one in twenty needs a GPU. The jobs need about a quarter of the farm's time.
pub fn studio(size: Size, seed: u64) -> Input {
    let mut input = Input::default();
    for id in 0..size.nodes {
        input.nodes.push(studio_node(size, seed, id, id % size.classes.max(1)));
    }
    let mut frames_left = size.frames;
    for id in 0..size.jobs {
        let jobs_left = size.jobs - id;
        let mean = frames_left as f64 / jobs_left as f64;
        let drawn = (mean * libm::exp(0.5 * normal(seed, &[10, id]))).round() as u64;
        let frames = if jobs_left == 1 {
            frames_left
        } else {
            drawn.clamp(1, frames_left.max(jobs_left) - jobs_left + 1)
        };
        frames_left = frames_left.saturating_sub(frames);
        input.jobs.push(studio_job(size, seed, id, frames));
    }
    input
}

/// The same week with divided frames. In half of the jobs, frames may have up to 64 parts, and every fiftieth
/// is eight times as long as the others. In one job of twenty, every frame must have four parts. A part costs a
/// minute at speed 1 on top. All jobs need as much work as in [`studio`], up to rounding.
pub fn studio_with_parts(size: Size, seed: u64) -> Input {
    let mut input = studio(size, seed);
    for job in &mut input.jobs {
        job.part_overhead = WORK_OF_AN_HOUR as u64 / 60;
        let (may, must) = (job.id % 2 == 0, job.id % 20 == 1);
        let is_long = |frame: &Frame| may && frame.number % 50 == 7;
        let work = |frame: &Frame| u128::from(frame.work);
        let before: u128 = job.frames.iter().map(work).sum();
        let more: u128 = job.frames.iter().filter(|frame| is_long(frame)).map(work).sum();
        let after = (before + 7 * more).max(1);
        let scaled = |work: u64| u64::try_from(u128::from(work) * before / after).unwrap_or(u64::MAX).max(1);
        for frame in &mut job.frames {
            let times = if is_long(frame) { 8 } else { 1 };
            (frame.work, frame.work_p80) = (scaled(frame.work) * times, scaled(frame.work_p80) * times);
            frame.division = match (may, must) {
                (true, _) => Division::UpTo(64),
                (_, true) => Division::Into(4),
                _ => Division::Whole,
            };
        }
    }
    input
}

/// A shot without a deadline, of this many frames, on nodes that are always open. Frames may have up to 64
/// parts. `longest`: one frame takes this many times as long as it would.
pub fn shot(frames: u64, nodes: u64, longest: u64, seed: u64) -> Input {
    let mut input = studio(Size { jobs: 1, frames, nodes, classes: 20, days: 7 }, seed);
    for node in &mut input.nodes {
        node.calendar = vec![Interval { start: 0, end: None }];
    }
    for job in &mut input.jobs {
        (job.class, job.deadline, job.shared_cache) = (0, None, None);
        job.part_overhead = WORK_OF_AN_HOUR as u64 / 60;
        job.frames.iter_mut().for_each(|frame| frame.division = Division::UpTo(64));
        if let Some(first) = job.frames.first_mut() {
            (first.work, first.work_p80) = (first.work * longest, first.work_p80 * longest);
        }
        let total: u64 = job.frames.iter().map(|frame| frame.work).sum();
        job.total = WorkTotal { p50: total, p80: total + total / 8, p95: total + total / 4 };
    }
    input
}

fn studio_node(size: Size, seed: u64, id: u64, class: u64) -> Node {
    let speed = 0.6 + 2.4 * uniform(seed, &[1, class]);
    let kind = class * 10 / size.classes.max(1);
    let price = speed * (0.9 + 0.4 * uniform(seed, &[2, class]));
    let has_gpu = class % 5 == 3;
    let memory = [32, 64, 128, 256][(bits(seed, &[3, class]) % 4) as usize];
    let speed_for = |on_gpu: bool, need: u64| {
        let factor = if on_gpu { 8e9 } else { 1e9 };
        let can = memory >= need && (has_gpu || !on_gpu);
        (studio_class(on_gpu, need), if can { (speed * factor).round() as u64 } else { 0 })
    };
    let mut node = Node {
        id,
        name: format!("class-{class}-{id}"),
        speed: (speed * 1e9).round() as u64,
        speeds: Arc::new(
            [false, true].into_iter().flat_map(|on_gpu| NEEDS.map(|need| speed_for(on_gpu, need))).collect(),
        ),
        price_per_hour: (price * 4e5).round() as i64,
        calendar: vec![Interval { start: 0, end: None }],
        ..Node::default()
    };
    match kind {
        0..4 => {}
        4..7 => {
            // From 20:00 to 08:00.
            let night = |day: i64| Interval { start: day * DAY - 4 * HOUR, end: Some(day * DAY + 8 * HOUR) };
            node.calendar = (0..=size.days as i64).map(night).collect();
            node.price_per_hour /= 2;
        }
        _ => {
            node.price_per_hour *= 3;
            node.billing_step = HOUR;
            node.setup = 5 * MINUTE;
        }
    }
    node
}

/// The class of work that needs this much memory in GiB.
fn studio_class(on_gpu: bool, need: u64) -> u32 {
    let place = NEEDS.iter().position(|&most| need <= most).unwrap_or(NEEDS.len() - 1);
    (place + if on_gpu { NEEDS.len() } else { 0 }) as u32
}

fn studio_job(size: Size, seed: u64, id: u64, frames: u64) -> Job {
    let on_gpu = bits(seed, &[11, id]).is_multiple_of(20);
    let typical = 2.0 * libm::exp(0.4 * normal(seed, &[12, id])) * WORK_OF_AN_HOUR;
    let frame = |number: u64| {
        let work = (typical * libm::exp(0.3 * normal(seed, &[13, id, number]))).round() as u64;
        Frame { number: number as i64, work, work_p80: work + work / 5, ..Frame::default() }
    };
    let frames: Vec<Frame> = (0..frames).map(frame).collect();
    let total: u64 = frames.iter().map(|frame| frame.work).sum();
    let horizon = size.days as i64 * DAY;
    let release = between(seed, &[14, id], 0, horizon * 5 / 7);
    let room = (DAY * size.days as i64 * 5 / 14).max(DAY);
    let deadline = (release + between(seed, &[15, id], (room / 3).min(16 * HOUR), room))
        .min(horizon)
        .max(release + 16 * HOUR);
    let pick = |n: usize, of: u64| bits(seed, &[16 + n as u64, id]) % of;
    let class = studio_class(on_gpu, [16, 16, 32, 60, 100][pick(2, 5) as usize]);
    Job {
        id,
        name: format!("job-{id}"),
        class,
        release: release / MINUTE * MINUTE,
        deadline: Some(deadline / MINUTE * MINUTE),
        confidence: [Confidence::P50, Confidence::P80, Confidence::P95][pick(0, 3) as usize],
        total: WorkTotal { p50: total, p80: total + total / 8, p95: total + total / 4 },
        shared_cache: (pick(1, 5) == 0).then_some(SharedCache {
            class,
            work: typical as u64 / 2,
            ..SharedCache::default()
        }),
        frames,
        ..Job::default()
    }
}

/// A farm of one to three nodes and up to eight frames with tight deadlines, all in quarters of an hour.
/// `in_steps`: some nodes are billed by the hour, and some need a set-up.
pub fn tiny(seed: u64, in_steps: bool) -> Input {
    let nodes = 1 + bits(seed, &[1]) % 3;
    let jobs = 1 + bits(seed, &[2]) % 3;
    let grid = 15 * MINUTE;
    let node = |id: u64| {
        let draw = |n: u64, low, high| between(seed, &[3, id, n], low, high);
        let first = draw(0, 0, 4);
        let length = draw(1, 4, 26);
        let second = first + length + draw(2, 0, 8);
        let interval =
            |start: i64, length: i64| Interval { start: start * grid, end: Some((start + length) * grid) };
        let steps = in_steps && draw(3, 0, 1) == 1;
        let speed = draw(4, 1, 2) as u64;
        Node {
            id,
            speed,
            // Half of the nodes are too small for work of class 1.
            speeds: Arc::new(BTreeMap::from([(1, if draw(5, 1, 2) == 2 { speed } else { 0 })])),
            price_per_hour: draw(6, 1, 12) * 1_000_000,
            billing_step: if steps { HOUR } else { 0 },
            setup: if steps { draw(7, 0, 1) * grid } else { 0 },
            calendar: vec![interval(first, length), interval(second, draw(8, 2, 20))],
            ..Node::default()
        }
    };
    let mut frames_left = if in_steps { 6 } else { 8 };
    let mut job = |id: u64| {
        let draw = |n: u64, low, high| between(seed, &[4, id, n], low, high);
        let count = draw(0, 1, 4).min(frames_left);
        frames_left -= count;
        // On a node of speed two, half of this is still a multiple of a quarter of an hour.
        let work = |n: u64| 1800 * draw(10 + n, 1, 8) as u64;
        let frames: Vec<Frame> = (0..count as u64)
            .map(|n| Frame { number: n as i64, work: work(n), ..Frame::default() })
            .collect();
        let total = frames.iter().map(|frame| frame.work).sum();
        let release = draw(1, 0, 7);
        Job {
            id,
            release: release * grid,
            deadline: Some((release + draw(2, 4, 46)) * grid),
            confidence: Confidence::P50,
            total: WorkTotal { p50: total, p80: total, p95: total },
            frames,
            class: draw(3, 0, 1) as u32,
            ..Job::default()
        }
    };
    Input {
        nodes: (0..nodes).map(node).collect(),
        jobs: (0..jobs).map(&mut job).collect(),
        ..Input::default()
    }
}

/// The least cost of a plan that keeps all deadlines of a [`tiny`] farm. `None` if there is no such plan.
/// Tries every assignment of frames to nodes, and every order. A frame starts as early as it can or, where
/// nodes are billed in steps, at any later quarter of an hour. All times are quarters, so this is exact.
pub fn cheapest_by_trying_everything(input: &Input) -> Option<i64> {
    let works: Vec<(usize, u64)> = input
        .jobs
        .iter()
        .enumerate()
        .flat_map(|(job, entry)| entry.bought_work().into_iter().map(move |work| (job, work)))
        .collect();
    // For each node, the least cost of every set of frames.
    let tables: Vec<Vec<Option<i64>>> =
        input.nodes.iter().map(|node| Tried::new(input, node, &works).costs).collect();
    let mut best = None;
    let assignments = tables.len().checked_pow(works.len() as u32)?;
    for assignment in 0..assignments {
        let mut sets = vec![0usize; tables.len()];
        let mut rest = assignment;
        for frame in 0..works.len() {
            sets[rest % tables.len()] |= 1 << frame;
            rest /= tables.len();
        }
        let cost = sets.iter().zip(&tables).try_fold(0i64, |sum, (&set, table)| Some(sum + table[set]?));
        if let Some(cost) = cost
            && best.is_none_or(|least| cost < least)
        {
            best = Some(cost);
        }
    }
    best
}

/// Cost of every set of frames on one node, by depth-first search over orders and starts.
struct Tried<'a> {
    input: &'a Input,
    node: &'a Node,
    works: &'a [(usize, u64)],
    /// When the node may be used. Adjacent intervals are merged.
    open: Vec<(i64, i64)>,
    costs: Vec<Option<i64>>,
    /// For set, free instant and start of the open rental, the least cost so far.
    seen: BTreeMap<(usize, i64, i64), i64>,
}

impl<'a> Tried<'a> {
    fn new(input: &'a Input, node: &'a Node, works: &'a [(usize, u64)]) -> Self {
        let mut open: Vec<(i64, i64)> = Vec::new();
        for window in &node.calendar {
            let end = window.end.unwrap_or(i64::MAX);
            match open.last_mut() {
                Some(last) if last.1 == window.start => last.1 = end,
                _ => open.push((window.start, end)),
            }
        }
        let costs = vec![None; 1 << works.len()];
        let mut tried = Tried { input, node, works, open, costs, seen: BTreeMap::new() };
        tried.go(0, i64::MIN, None, 0);
        tried
    }

    /// `open`: start of the rental that pays for the last frame. `closed`: cost of earlier rentals.
    fn go(&mut self, set: usize, free_from: i64, open: Option<i64>, closed: i64) {
        let node = self.node;
        let has_setup = node.setup > 0 || node.setup_cost > 0;
        let cost = closed + open.map_or(0, |start| node.price(free_from - start, has_setup));
        self.costs[set] = Some(self.costs[set].map_or(cost, |least| least.min(cost)));
        let known = self.seen.entry((set, free_from, open.unwrap_or(i64::MIN))).or_insert(i64::MAX);
        if *known <= closed {
            return;
        }
        *known = closed;
        for (frame, &(job, work)) in self.works.iter().enumerate() {
            let job = &self.input.jobs[job];
            let Some(duration) = node.duration(work, job.class) else { continue };
            if set >> frame & 1 == 1 {
                continue;
            }
            for index in 0..self.open.len() {
                let (opens, until) = self.open[index];
                let last = until.min(job.deadline.unwrap_or(i64::MAX)) - duration;
                let first = job.release.max(free_from).max(opens);
                let mut start = first;
                while start <= last {
                    let next = set | 1 << frame;
                    // A new rental, if there is time for its set-up.
                    let rented = start - node.setup;
                    if rented >= free_from.max(opens) {
                        self.go(next, start + duration, Some(rented), cost);
                    }
                    // Or the open one, if there is no closed time in between.
                    if let Some(open) = open.filter(|&open| open >= opens) {
                        self.go(next, start + duration, Some(open), closed);
                    }
                    // With exact billing and nothing to share, a later start is never cheaper.
                    if node.billing_step <= 1 && !has_setup {
                        break;
                    }
                    start += 15 * MINUTE;
                }
            }
        }
    }
}

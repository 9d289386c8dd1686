//! Frames in parts: how many, and where.
//!
//! By a deadline, a frame that does not fit whole has the fewest parts that fit, since each part costs
//! something on top. A job that should end early is evened out: the frames that end last are divided, so that
//! it ends as early as a small part of its cost pays for.
//!
//! How many parts of a length fit before an instant follows from the gaps of all nodes. So the number of
//! parts, and the end of a job, are found by bisection, and not by trying one more part at a time.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use crate::admission::Allotted;
use crate::bound::{bound, first_alone};
use crate::model::{Division, Job, Task, price_of};
use crate::places::{Search, find_allotted};
use crate::problem::FrameWork;
use crate::state::{Placed, State};

/// The most numbers of parts tried for one frame, on top of the fewest that fit.
const MOST_NUMBERS: u32 = 6;
/// If the frames that end too late cannot be placed around the others, those that end in the last of this
/// many pieces of a job's length move as well.
const PIECES: i64 = 3;
/// An earlier end may cost a job at most one part in this many more.
const WORTH_OF_TIME: i128 = 33;
/// As far as the money reaches, an earlier end may take one part in this many more work.
const WORK_FOR_TIME: i128 = 16;
/// Dividing a frame may pay if it could save more than one part in this many of its cost.
const WORTH_DIVIDING: i64 = 8;
/// The end of a job is found to one part in this many of its length.
const PRECISION: i64 = 128;

/// Places all parts of a frame by the search's latest end: as many as it must have, or the fewest that fit.
pub(crate) fn place_in_parts(
    state: &mut State,
    job: usize,
    frame: &FrameWork,
    search: &Search,
    mut allotment: Option<&mut [Allotted]>,
) -> bool {
    let work = &state.problem.jobs[job];
    let most = frame.division.most();
    let first = match frame.division {
        Division::Whole => None,
        Division::Into(parts) => Some(parts),
        Division::UpTo(_) => {
            Rooms::new(state, search, work.job.part_work(frame.work, most)).fewest(state, work.job, frame, 2)
        }
    };
    let before = state.placed[job].len();
    let mut next = first.filter(|&parts| parts > 1);
    for _ in 0..MOST_NUMBERS {
        let Some(parts) = next else { return false };
        let of_part = Search { work: work.job.part_work(frame.work, parts), ..*search };
        let is_placed = (0..parts).all(|part| {
            let allotted =
                allotment.as_deref_mut().and_then(|allotment| find_allotted(state, &of_part, allotment));
            let Some((node, fit)) = allotted.or_else(|| state.find(&of_part)) else { return false };
            let task = Task::Part { frame: frame.number, part, parts };
            state.book(job, Placed { node, start: fit.start, end: fit.end, task });
            true
        });
        if is_placed {
            return true;
        }
        // The gaps are long enough together, but the best places left too short ones.
        state.unbook_after(job, before);
        next = Some(parts.saturating_add((parts / 4).max(1))).filter(|&more| more <= most);
    }
    false
}

/// Work of each task of a frame in so many parts. One stands for the whole frame.
fn task_work(job: &Job, frame: &FrameWork, parts: u32) -> u64 {
    if parts == 1 { frame.work } else { job.part_work(frame.work, parts) }
}

/// A gap on a node.
#[derive(Clone, Copy, Debug)]
struct Room {
    class: usize,
    node: usize,
    start: i64,
    end: i64,
}

/// The gaps of all nodes that can do a class of work, between two instants.
struct Rooms {
    class_of_work: u32,
    rooms: Vec<Room>,
}

impl Rooms {
    /// The gaps of a search that hold at least this work.
    fn new(state: &State, search: &Search, least: u64) -> Self {
        let problem = state.problem;
        let mut rooms = Vec::new();
        for &class in search.classes {
            let node = problem.representative(class);
            let Some(least) = node.duration(least, search.class_of_work) else { continue };
            for &node in &problem.classes[class] {
                for (start, end) in state.lanes[node].gaps(search.release, least) {
                    let (start, end) = (start.max(search.release), end.min(search.latest_end));
                    if start >= search.latest_end {
                        break;
                    }
                    if end.saturating_sub(start) >= least {
                        rooms.push(Room { class, node, start, end });
                    }
                }
            }
        }
        Rooms { class_of_work: search.class_of_work, rooms }
    }

    /// Calls `visit` for each gap that holds at least one task of this work, with the task's length and their
    /// number, until that returns false.
    fn visit(&self, state: &State, work: u64, mut visit: impl FnMut(usize, i64, u64) -> bool) {
        let (mut class, mut length) = (usize::MAX, None);
        for (index, room) in self.rooms.iter().enumerate() {
            if room.class != class {
                class = room.class;
                length = state.problem.representative(class).duration(work, self.class_of_work);
            }
            let Some(length) = length else { continue };
            let count = room.end.saturating_sub(room.start) / length;
            if count > 0 && !visit(index, length, count.unsigned_abs()) {
                return;
            }
        }
    }

    /// The fewest parts of a frame that fit, at least so many.
    ///
    /// More parts usually fit where fewer do, so the number is found by doubling and bisection. Where that
    /// misses, the parts fill gaps exactly: as on equal nodes, each of which takes one.
    fn fewest(&self, state: &State, job: &Job, frame: &FrameWork, least: u32) -> Option<u32> {
        let most = frame.division.most();
        let fits = |parts: u32| self.hold(state, task_work(job, frame, parts), parts);
        let (mut short, mut found) = (least.saturating_sub(1), Some(least).filter(|&least| least <= most));
        while let Some(parts) = found.filter(|&parts| !fits(parts)) {
            short = parts;
            let more = parts.saturating_add((parts / 2).max(1)).min(most);
            found = Some(more).filter(|_| parts < most);
        }
        if let Some(enough) = &mut found {
            while *enough - short > 1 {
                let middle = short + (*enough - short) / 2;
                if fits(middle) { *enough = middle } else { short = middle }
            }
        }
        let exact = self.exact_numbers(state, job, frame);
        let better =
            |parts: &u32| *parts >= least && *parts <= most && found.is_none_or(|found| *parts < found);
        exact.into_iter().filter(better).find(|&parts| fits(parts)).or(found)
    }

    /// Numbers of parts, rising, that fill the longest gap of some class of nodes with one or two parts.
    fn exact_numbers(&self, state: &State, job: &Job, frame: &FrameWork) -> Vec<u32> {
        let mut numbers = Vec::new();
        for rooms in self.rooms.chunk_by(|a, b| a.class == b.class) {
            let longest = rooms.iter().map(|room| room.end.saturating_sub(room.start)).max().unwrap_or(0);
            let speed = state.problem.representative(rooms[0].class).speed_of(self.class_of_work);
            for parts in 1..=2 {
                let work = u128::from(longest.unsigned_abs() / parts) * u128::from(speed) / 1_000_000;
                let share = work.saturating_sub(u128::from(job.part_overhead));
                let number = (share > 0).then(|| u128::from(frame.work).div_ceil(share));
                numbers.extend(number.and_then(|number| u32::try_from(number).ok()));
            }
        }
        numbers.sort_unstable();
        numbers.dedup();
        numbers
    }

    /// Whether this many tasks of this work fit into the gaps.
    fn hold(&self, state: &State, work: u64, tasks: u32) -> bool {
        let mut left = u64::from(tasks);
        self.visit(state, work, |_, _, count| {
            left = left.saturating_sub(count);
            left > 0
        });
        left == 0
    }

    /// Places a frame in the cheapest gaps: in the fewest parts that fit, or in a few more where that makes
    /// cheaper nodes usable. Returns whether it fits.
    fn place(
        &mut self,
        state: &mut State,
        job: usize,
        frame: &FrameWork,
        spent: &mut Spent,
        places: &mut Vec<Placed>,
    ) -> bool {
        let problem = state.problem;
        let asked = problem.jobs[job].job;
        let of_task = |parts: u32| task_work(asked, frame, parts);
        let most = frame.division.most();
        let Some(first) = self.fewest(state, asked, frame, 1) else { return false };
        let mut best = (self.cheapest(state, of_task(first), first), first);
        let mut more = first;
        for _ in 0..MOST_NUMBERS {
            more = more.saturating_add((more / 3).max(1));
            if more > most {
                break;
            }
            let offer = self.cheapest(state, of_task(more), more);
            if offer.cost < best.0.cost {
                best = (offer, more);
            }
        }
        let (offer, parts) = best;
        let mut part = 0;
        for Block { room, length, tasks } in offer.blocks {
            let room = &mut self.rooms[room];
            for _ in 0..tasks {
                let (start, end) = (room.start, room.start + length);
                let number = frame.number;
                let task =
                    if parts == 1 { Task::Frame(number) } else { Task::Part { frame: number, part, parts } };
                let placed = Placed { node: room.node, start, end, task };
                places.push(placed);
                state.occupy(&placed);
                room.start = end;
                part += 1;
            }
        }
        spent.money += offer.cost;
        spent.work += i128::from(of_task(parts)) * i128::from(parts);
        true
    }

    /// The cheapest gaps that hold this many tasks of this work. The cost is out of range if they do not fit.
    fn cheapest(&self, state: &State, work: u64, tasks: u32) -> Offer {
        let cost = |room: usize, length: i64, count: u64| {
            let Room { node, start, .. } = self.rooms[room];
            let end = start.saturating_add(length.saturating_mul(count as i64));
            i128::from(state.lanes[node].added_cost(state.problem.nodes[node], start, end))
        };
        let mut all: Vec<(i128, u64, Block, i128)> = Vec::new();
        self.visit(state, work, |room, length, count| {
            let tasks = count.min(u64::from(tasks));
            let cost = cost(room, length, tasks);
            let id = state.problem.nodes[self.rooms[room].node].id;
            // Costs of one task are compared in parts of a micro-unit.
            all.push(((cost << 32) / i128::from(tasks), id, Block { room, length, tasks }, cost));
            true
        });
        all.sort_unstable();
        let mut left = u64::from(tasks);
        let mut offer = Offer { blocks: Vec::new(), cost: 0 };
        for (_, _, block, of_block) in all {
            let tasks = block.tasks.min(left);
            offer.cost += if tasks == block.tasks { of_block } else { cost(block.room, block.length, tasks) };
            offer.blocks.push(Block { tasks, ..block });
            left -= tasks;
            if left == 0 {
                return offer;
            }
        }
        Offer { blocks: Vec::new(), cost: i128::MAX }
    }
}

/// Tasks that follow each other from the start of a gap.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Block {
    /// Index of the gap.
    room: usize,
    length: i64,
    tasks: u64,
}

/// Places of all parts of a frame.
struct Offer {
    blocks: Vec<Block>,
    /// Micro-units.
    cost: i128,
}

/// What a job gives away for an earlier end.
#[derive(Clone, Copy, Debug, Default)]
struct Spent {
    /// Micro-units.
    money: i128,
    work: i128,
}

/// Divides the frames that end last, so that a job that should end early does. Its frames that may be divided
/// move, unless they are kept.
pub(crate) fn even_out(state: &mut State, job: usize) {
    let work = &state.problem.jobs[job];
    let movable = movable(state, job);
    let Some(release) = state.earliest(job, Task::Frame(0)).filter(|_| !movable.is_empty()) else { return };
    let Some(earliest) = bound(state.problem, work).earliest_finish() else { return };
    let stays = |placed: &&Placed| placed.task.frame().is_none_or(|frame| !movable.contains_key(&frame));
    let fixed = state.placed[job].iter().filter(stays).map(|placed| placed.end).max();
    let from = earliest.max(fixed.unwrap_or(i64::MIN));
    let mut limits = limits(state, job).into_iter();
    if let Some((lifted, places)) =
        limits.find_map(|most| end_early(state, job, &movable, (release, from), most))
    {
        state.unbook_all(job, &lifted);
        places.into_iter().for_each(|placed| state.book(job, placed));
    }
}

/// What an earlier end may cost, the preferred limit first.
///
/// A job with no more frames than nodes is measured by the node that would end its longest frame first, if
/// the farm were empty. Where others are on that node, a frame that should end early may be on a dear node
/// as a whole, and in parts on cheaper ones a little later.
fn limits(state: &State, job: usize) -> Vec<Spent> {
    let problem = state.problem;
    let work = &problem.jobs[job];
    let price = |placed: &Placed| {
        i128::from(price_of(problem.nodes[placed.node].price_per_hour, placed.end - placed.start))
    };
    let paid: i128 = state.placed[job].iter().map(price).sum();
    let total = work.total();
    let most = Spent {
        money: paid / WORTH_OF_TIME,
        work: i128::try_from(total).unwrap_or(i128::MAX) / WORK_FOR_TIME,
    };
    let able: usize = work.classes.iter().map(|&class| problem.classes[class].len()).sum();
    let alone = first_alone(problem, work).filter(|_| work.frames.len() <= able).and_then(|node| {
        let time = node.duration(u64::try_from(total).ok()?, work.job.class)?;
        Some(i128::from(price_of(node.price_per_hour, time)))
    });
    let strict = alone.map(|price| price + price / WORTH_OF_TIME - paid).filter(|&money| money < most.money);
    strict.map(|money| Spent { money, ..most }).into_iter().chain([most]).collect()
}

/// For the earliest end that the limit pays for: the places of the frames that end later, and new ones.
/// `None` if it pays for no earlier end.
///
/// For a given end, the frames that end later are lifted. They are placed anew in as few parts as end by
/// then, in the cheapest gaps. The end is found by bisection.
fn end_early(
    state: &mut State,
    job: usize,
    movable: &BTreeMap<i64, Vec<Placed>>,
    (release, from): (i64, i64),
    most: Spent,
) -> Option<(Vec<Placed>, Vec<Placed>)> {
    let (mut low, mut high) = (from, state.finish(job));
    let mut best = None;
    while high.saturating_sub(low) > (high.saturating_sub(release) / PRECISION).max(1) {
        let by = low + (high - low) / 2;
        let lifted = [by, by - (by - release) / PIECES].map(|after| {
            let ends_late = |places: &&Vec<Placed>| places.iter().any(|placed| placed.end > after);
            movable.values().filter(ends_late).flatten().copied().collect::<Vec<Placed>>()
        });
        let tried = if lifted[0].len() == lifted[1].len() { &lifted[..1] } else { &lifted[..] };
        let try_with =
            |lifted: &Vec<Placed>| Some((lifted.clone(), try_by(state, job, lifted, (release, by), most)?));
        match tried.iter().find_map(try_with) {
            Some(found) => {
                best = Some(found);
                high = by;
            }
            None => low = by,
        }
    }
    best
}

/// Divides frames of jobs with a deadline where their parts fit into cheaper gaps in time, the largest
/// possible saving first. Each attempt uses up one of the trials.
pub(crate) fn divide_dear(state: &mut State, trials: &mut usize) {
    let problem = state.problem;
    let mut found: Vec<(Reverse<i64>, usize, i64, Placed)> = Vec::new();
    for (job, work) in problem.jobs.iter().enumerate() {
        let Some(deadline) = work.job.deadline.filter(|&deadline| state.finish(job) <= deadline) else {
            continue;
        };
        for placed in movable(state, job).into_values().filter(|places| places.len() == 1).flatten() {
            let Some(of_frame) = work.work_of(placed.task) else { continue };
            let least = work.classes.iter().filter_map(|&class| {
                let node = problem.representative(class);
                // In two parts, at least.
                let time =
                    node.duration(of_frame.saturating_add(2 * work.job.part_overhead), work.job.class)?;
                Some(price_of(node.price_per_hour, time))
            });
            let node = problem.nodes[placed.node];
            let saved = state.lanes[placed.node].saved_without(node, placed.start, placed.end);
            let gain = saved.saturating_sub(least.min().unwrap_or(i64::MAX));
            if gain > saved / WORTH_DIVIDING {
                found.push((Reverse(gain), job, deadline, placed));
            }
        }
    }
    found.sort_unstable_by_key(|&(gain, job, _, placed)| (gain, job, placed.start, placed.node, placed.task));
    let most = Spent { money: -1, work: i128::MAX };
    for (_, job, deadline, placed) in found.into_iter().take(*trials) {
        *trials -= 1;
        let Some(release) = state.earliest(job, placed.task) else { continue };
        if let Some(places) = try_by(state, job, &[placed], (release, deadline), most) {
            state.unbook(job, placed);
            places.into_iter().for_each(|placed| state.book(job, placed));
        }
    }
}

/// By number: the places of all frames that may move and may be divided.
fn movable(state: &State, job: usize) -> BTreeMap<i64, Vec<Placed>> {
    let work = &state.problem.jobs[job];
    let may_be_divided = |frame: &FrameWork| frame.division.allows(1) && frame.division.most() > 1;
    let mut found: BTreeMap<i64, Vec<Placed>> = BTreeMap::new();
    if !work.frames.iter().any(may_be_divided) {
        return found;
    }
    for &placed in state.placed[job].iter().skip(state.kept[job]) {
        let frame = placed.task.frame().and_then(|number| work.frame(number));
        if let Some(frame) = frame.filter(|frame| may_be_divided(frame)) {
            found.entry(frame.number).or_default().push(placed);
        }
    }
    found
}

/// New places for lifted frames between two instants, at no more than this on top of what they cost. The
/// state stays as it is.
fn try_by(
    state: &mut State,
    job: usize,
    lifted: &[Placed],
    (release, by): (i64, i64),
    most: Spent,
) -> Option<Vec<Placed>> {
    let problem = state.problem;
    let work = &problem.jobs[job];
    let mut spent = Spent::default();
    for placed in lifted {
        let (node, lane) = (problem.nodes[placed.node], &state.lanes[placed.node]);
        spent.money -= i128::from(lane.saved_without(node, placed.start, placed.end));
        spent.work -= work.work_of(placed.task).map_or(0, i128::from);
        state.vacate(placed);
    }
    let mut numbers: Vec<i64> = lifted.iter().filter_map(|placed| placed.task.frame()).collect();
    numbers.sort_unstable();
    numbers.dedup();
    let mut frames: Vec<&FrameWork> = numbers.iter().filter_map(|&number| work.frame(number)).collect();
    frames.sort_unstable_by_key(|frame| (Reverse(frame.work), frame.number));
    let shortest = frames.iter().map(|frame| work.job.longest_part(frame.work, frame.division)).min();
    let search = Search::early(state, job, release, 0);
    let mut rooms = Rooms::new(state, &Search { latest_end: by, ..search }, shortest.unwrap_or(0));
    let mut places = Vec::new();
    let all = frames.iter().all(|frame| {
        rooms.place(state, job, frame, &mut spent, &mut places)
            && spent.money <= most.money
            && spent.work <= most.work
    });
    places.iter().rev().for_each(|placed| state.vacate(placed));
    lifted.iter().for_each(|placed| state.occupy(placed));
    all.then_some(places)
}

//! Searches for the best place of a task, class by class.
//!
//! Nodes of a class differ in their free time alone. So a search asks each class's
//! [`Gaps`](crate::gaps::Gaps) for the first place from a few instants on, and does not look at single nodes.
//! Only where nodes are billed in steps does it also try those that have been paid for time that nobody uses.

use crate::admission::{Admission, Allotted, IN_A_MICRO_UNIT};
use crate::gaps::Gap;
use crate::lane::{Fit, Prefer, Wanted};
use crate::state::State;

/// The most gaps tried for the smallest that holds a task, where time is scarce.
const GAPS_TRIED: usize = 8;
/// The most nodes billed in steps that are tried for time that is already paid for.
const NODES_TRIED: usize = 1;

#[derive(Clone, Copy, Debug)]
pub(crate) struct Search<'s> {
    pub class_of_work: u32,
    pub work: u64,
    pub release: i64,
    pub latest_end: i64,
    /// Classes of nodes to search.
    pub classes: &'s [usize],
    pub prefer: Prefer,
    /// The place must cost less than this.
    pub below: i64,
    /// A node billed in steps to leave out.
    pub except: Option<usize>,
    /// So many per cent of what others would pay for the time are added to the cost.
    pub for_others: i128,
}

impl<'s> Search<'s> {
    /// The earliest end of this much work of a job's frames, whenever that is.
    pub fn early(state: &State<'s, '_>, job: usize, release: i64, work: u64) -> Self {
        let of_job = &state.problem.jobs[job];
        Search {
            class_of_work: of_job.job.class,
            work,
            release,
            latest_end: i64::MAX,
            classes: &of_job.classes,
            prefer: Prefer::Early,
            below: i64::MAX,
            except: None,
            for_others: state.for_others(),
        }
    }
}

/// Rank, node id, node index, and the place on the node.
type Candidate = ((i128, i64, i64), u64, usize, Fit);

/// A search in one class of nodes.
struct InClass<'s, 'p, 'a> {
    state: &'s State<'p, 'a>,
    search: &'s Search<'s>,
    class: usize,
    wanted: Wanted,
    best: &'s mut Option<Candidate>,
}

impl State<'_, '_> {
    /// The best place on these classes of nodes. Ties go to the node with the lowest id.
    ///
    /// A cheap place is one with the least cost, including what others would pay. Ties in scarce time go to
    /// the place that leaves least of its gap (best fit), other ties to the earliest.
    pub fn find(&self, search: &Search) -> Option<(usize, Fit)> {
        let mut classes: Vec<(i64, i64, usize)> = search
            .classes
            .iter()
            .filter_map(|&class| {
                let node = self.problem.representative(class);
                let duration = node.duration(search.work, search.class_of_work)?;
                Some((node.price(duration, false), duration, class))
            })
            .collect();
        classes.sort_unstable();
        let mut best: Option<Candidate> = None;
        for (price, duration, class) in classes {
            let wanted = Wanted { release: search.release, latest_end: search.latest_end, duration };
            let mut in_class = InClass { state: self, search, class, wanted, best: &mut best };
            let is_plain = self.problem.representative(class).is_plainly_billed();
            if !is_plain && search.prefer == Prefer::Cheap {
                in_class.try_overpaid();
            }
            if !is_plain || !in_class.is_hopeless(price) {
                in_class.try_first(is_plain.then_some(price));
            }
        }
        best.map(|(_, _, node, fit)| (node, fit))
    }
}

impl InClass<'_, '_, '_> {
    fn admission(&self) -> &Admission {
        self.state.admission
    }

    fn worth(&self, start: i64, end: i64) -> i128 {
        if self.search.for_others == 0 || self.search.prefer == Prefer::Early {
            return 0;
        }
        self.admission().worth(self.class, start, end).saturating_mul(self.search.for_others) / 100
    }

    /// Whether a place with this cost cannot be the best.
    fn is_hopeless(&self, cost: i64) -> bool {
        let is_more = |rank: i128| i128::from(cost) * IN_A_MICRO_UNIT > rank;
        cost >= self.search.below
            || self.search.prefer == Prefer::Cheap && self.best.is_some_and(|(rank, ..)| is_more(rank.0))
    }

    fn offer(&mut self, index: usize, fit: Fit) {
        let id = self.state.problem.nodes[index].id;
        let rank = fit.rank(self.search.prefer);
        if fit.added_cost < self.search.below
            && self.best.is_none_or(|(least, of, ..)| (rank, id) < (least, of))
        {
            *self.best = Some((rank, id, index, fit));
        }
    }

    /// Tries nodes billed in steps on which time is paid for that nobody uses.
    fn try_overpaid(&mut self) {
        let state = self.state;
        let overpaid = state.pools[self.class].overpaid();
        for index in overpaid.filter(|&index| self.search.except != Some(index)).take(NODES_TRIED) {
            let (node, lane) = (state.problem.nodes[index], &state.lanes[index]);
            let least = lane.least_added_cost(node, self.wanted.duration);
            if self.is_hopeless(least) {
                break;
            }
            if let Some(fit) = lane.cheapest(node, &self.wanted, |start, end| self.worth(start, end)) {
                self.offer(index, fit);
            }
        }
    }

    /// Tries the first places from the release on, and from each later instant at which time is worth less.
    fn try_first(&mut self, price: Option<i64>) {
        let state = self.state;
        let Wanted { release, latest_end, duration } = self.wanted;
        let mut from = release;
        while let Some((gap, start)) = state.pools[self.class].gaps().first(from, duration) {
            let end = start.saturating_add(duration);
            if end > latest_end || gap.end < end {
                break;
            }
            if self.search.prefer == Prefer::Early
                && self.best.is_some_and(|(rank, ..)| i128::from(end) > rank.0)
            {
                break;
            }
            let is_scarce =
                self.search.prefer == Prefer::Cheap && self.admission().is_scarce(self.class, start);
            let worth = self.worth(start, end);
            self.offer_gap(&gap, start, price, worth);
            if is_scarce && price.is_some() {
                self.try_smaller(&gap, from, price);
            }
            let later = self.admission().cheaper_from(self.class, if is_scarce { start } else { end - 1 });
            match later.filter(|&later| worth > 0 && later > from) {
                Some(later) => from = later,
                None => break,
            }
        }
    }

    /// Tries the next gaps for one of which less would be left.
    fn try_smaller(&mut self, first: &Gap, from: i64, price: Option<i64>) {
        let state = self.state;
        let Wanted { latest_end, duration, .. } = self.wanted;
        let mut after = if first.start < from { (from, 0) } else { (first.start, first.node + 1) };
        for _ in 0..GAPS_TRIED {
            let Some(gap) = state.pools[self.class].gaps().next(after, duration) else { return };
            let is_scarce = self.admission().is_scarce(self.class, gap.start);
            if gap.start.saturating_add(duration) > latest_end || !is_scarce {
                return;
            }
            self.offer_gap(&gap, gap.start, price, self.worth(gap.start, gap.start.saturating_add(duration)));
            after = (gap.start, gap.node + 1);
        }
    }

    /// Offers a place in a gap. Without a price, its cost follows from the node's rentals.
    fn offer_gap(&mut self, gap: &Gap, start: i64, price: Option<i64>, worth: i128) {
        let end = start.saturating_add(self.wanted.duration);
        let (node, lane) = (self.state.problem.nodes[gap.node], &self.state.lanes[gap.node]);
        if price.is_none() && self.is_hopeless(lane.least_added_cost(node, self.wanted.duration)) {
            return;
        }
        let is_scarce = self.search.prefer == Prefer::Cheap && self.admission().is_scarce(self.class, start);
        let fit = Fit {
            start,
            end,
            added_cost: price.unwrap_or_else(|| lane.added_cost(node, start, end)),
            // Time that is not scarce counts as a perfect fit.
            left: if is_scarce { gap.end.saturating_sub(end) } else { 0 },
            worth,
        };
        self.offer(gap.node, fit);
    }
}

/// The best place within a job's allotment, which it uses up. At least half of the frame must lie in the
/// slot.
pub(crate) fn find_allotted(
    state: &State,
    search: &Search,
    allotment: &mut [Allotted],
) -> Option<(usize, Fit)> {
    let mut best: Option<(usize, usize, Fit)> = None;
    for (index, piece) in allotment.iter().enumerate().filter(|(_, piece)| piece.left > 0) {
        let node = state.problem.representative(piece.class);
        let half = node.duration(search.work, search.class_of_work)? / 2;
        let within = Search {
            classes: &[piece.class],
            release: search.release.max(piece.start.saturating_sub(half)),
            latest_end: search.latest_end.min(piece.end.saturating_add(half)),
            for_others: search.for_others.min(100),
            ..*search
        };
        if let Some((node, fit)) = state.find(&within)
            && best.is_none_or(|(_, _, least)| fit.rank(search.prefer) < least.rank(search.prefer))
        {
            best = Some((index, node, fit));
        }
    }
    let (index, node, fit) = best?;
    allotment[index].left = allotment[index].left.saturating_sub(fit.end - fit.start);
    Some((node, fit))
}

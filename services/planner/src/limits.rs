//! How much of each limit is held when.

use std::collections::BTreeMap;

use crate::model::{Input, LimitUse};

/// The use of all limits over time.
#[derive(Clone, Debug, Default)]
pub(crate) struct Ledger {
    limits: BTreeMap<u64, Account>,
}

#[derive(Clone, Debug, Default)]
struct Account {
    count: u64,
    /// Units held from this instant to the next one.
    held: BTreeMap<i64, u64>,
}

impl Ledger {
    /// What fixed bookings hold.
    pub fn new(input: &Input) -> Self {
        let account = |count| Account { count, held: BTreeMap::new() };
        let mut ledger =
            Ledger { limits: input.limits.iter().map(|limit| (limit.id, account(limit.count))).collect() };
        for fixed in &input.fixed {
            ledger.hold(&fixed.uses, fixed.start, fixed.end);
        }
        ledger
    }

    /// Holds these units from `start` to just before `end`.
    pub fn hold(&mut self, uses: &[LimitUse], start: i64, end: i64) {
        self.change(uses, start, end, |held, count| held.saturating_add(count));
    }

    /// Gives back what was held.
    pub fn release(&mut self, uses: &[LimitUse], start: i64, end: i64) {
        self.change(uses, start, end, |held, count| held.saturating_sub(count));
    }

    fn change(&mut self, uses: &[LimitUse], start: i64, end: i64, new: impl Fn(u64, u64) -> u64) {
        if start >= end {
            return;
        }
        for one in uses {
            let Some(account) = self.limits.get_mut(&one.limit) else { continue };
            for edge in [start, end] {
                let before = account.held.range(..=edge).next_back().map_or(0, |(_, &held)| held);
                account.held.entry(edge).or_insert(before);
            }
            account.held.range_mut(start..end).for_each(|(_, held)| *held = new(*held, one.count));
        }
    }

    /// Whether these units are free from `start` to just before `end`. If not, a later start before which it
    /// certainly does not work: none if there will never be enough.
    pub fn is_free(&self, uses: &[LimitUse], start: i64, end: i64) -> Result<(), Option<i64>> {
        let mut later = start;
        for one in uses {
            let Some(account) = self.limits.get(&one.limit) else { return Err(None) };
            let Some(room) = account.count.checked_sub(one.count) else { return Err(None) };
            let first = account.held.range(..=start).next_back().map_or(start, |(&at, _)| at);
            // The last instant of this stretch at which too much is held; from the next change on it may work.
            let blocked = account.held.range(first..end).rev().find(|(_, held)| **held > room);
            if let Some((&at, _)) = blocked {
                let next = account.held.range(at..).find(|(_, held)| **held <= room).map(|(&at, _)| at);
                later = later.max(next.ok_or(None)?);
            }
        }
        if later > start { Err(Some(later)) } else { Ok(()) }
    }

    /// Whether the units are held by others at this instant.
    pub fn is_short_at(&self, limit: u64, count: u64, instant: i64) -> bool {
        self.limits.get(&limit).is_some_and(|account| {
            let held = account.held.range(..=instant).next_back().map_or(0, |(_, &held)| held);
            held.saturating_add(count) > account.count
        })
    }
}

#[cfg(test)]
mod tests {
    use super::Ledger;
    use crate::model::{Input, Limit, LimitUse};

    #[test]
    fn units_are_free_again_the_instant_they_are_given_back() {
        let input =
            Input { limits: vec![Limit { id: 1, name: String::new(), count: 2 }], ..Input::default() };
        let mut ledger = Ledger::new(&input);
        let one = [LimitUse { limit: 1, count: 1 }];
        let two = [LimitUse { limit: 1, count: 2 }];
        ledger.hold(&one, 10, 20);
        ledger.hold(&one, 15, 30);
        assert_eq!(ledger.is_free(&one, 0, 15), Ok(()));
        assert_eq!(ledger.is_free(&one, 0, 16), Err(Some(20)));
        assert_eq!(ledger.is_free(&one, 20, 40), Ok(()));
        assert_eq!(ledger.is_free(&two, 5, 11), Err(Some(30)));
        assert_eq!(ledger.is_free(&two, 0, 10), Ok(()));
        assert_eq!(ledger.is_free(&[LimitUse { limit: 1, count: 3 }], 0, 1), Err(None));
        assert!(
            ledger.is_short_at(1, 2, 10) && !ledger.is_short_at(1, 1, 10) && ledger.is_short_at(1, 1, 19)
        );
        ledger.release(&one, 15, 30);
        assert_eq!(ledger.is_free(&one, 0, 40), Ok(()));
    }
}

//! Who gets a connection when there are too many.
//!
//! Everybody may connect, so what a connection costs must not be what others lack. Each connection has a
//! *standing*: a stranger's has shown no valid token yet, a worker's has shown one of a worker. When all seats
//! are taken, the quiet connection gives way that has the lowest standing and was quiet for longest. One that a
//! request runs on is not quiet. If none is quiet, the oldest request of a stranger is ended, once it has run for
//! [`PATIENCE`]: strangers' requests are short, unless they are there to hold a seat. Known callers' requests, and
//! workers, never give way to others. So whoever comes next, such as a health check, is let in, and nobody is kept
//! out by connections or requests that were begun to be held.
//!
//! Strangers of one address have a quarter of the seats. A proxy or a rack behind one address is not held to
//! that, because its connections show tokens.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::net::IpAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use forelight_protocol::Role;
use parking_lot::Mutex;
use tokio_util::sync::CancellationToken;

/// How long a stranger's request may run while others want its seat.
const PATIENCE: Duration = Duration::from_secs(5);

/// What a connection has shown of its caller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Standing {
    /// Nothing yet.
    Stranger,
    /// The token or session of a person.
    Known,
    /// The token of a worker.
    Worker,
}

impl From<Role> for Standing {
    fn from(role: Role) -> Self {
        if role == Role::Worker { Standing::Worker } else { Standing::Known }
    }
}

/// The open connections of a service.
pub(crate) struct Admission {
    /// Connections at the same time.
    most: usize,
    /// Of these, strangers of one address.
    most_of_one: usize,
    /// How long a stranger's request runs before it may be ended.
    patience: Duration,
    seats: Mutex<Seats>,
}

#[derive(Default)]
struct Seats {
    taken: HashMap<u64, Seat>,
    /// Connections that may give way, the first of them first.
    yielding: BTreeSet<Place>,
    /// How many strangers each address has, and which of them may give way.
    strangers: BTreeMap<IpAddr, (usize, BTreeSet<Place>)>,
    /// Counts changes, to order connections by how long they were quiet.
    turn: u64,
}

/// Which connections go first; since when it was quiet, or busy; and number of a connection.
type Place = (Yields, u64, u64);

/// Which connections give way first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Yields {
    QuietStranger,
    QuietPerson,
    BusyStranger,
}

struct Seat {
    peer: IpAddr,
    standing: Standing,
    requests: u32,
    since: u64,
    /// The same by the clock.
    since_time: Instant,
    gives_way: CancellationToken,
}

impl Seat {
    /// `None` if it does not give way.
    fn place(&self, number: u64) -> Option<Place> {
        let yields = match (self.standing, self.requests) {
            (Standing::Stranger, 0) => Yields::QuietStranger,
            (Standing::Known, 0) => Yields::QuietPerson,
            (Standing::Stranger, _) => Yields::BusyStranger,
            (Standing::Known | Standing::Worker, _) => return None,
        };
        Some((yields, self.since, number))
    }
}

impl Seats {
    /// Changes a seat, and puts it where it then belongs.
    fn change(&mut self, number: u64, change: impl FnOnce(&mut Seat)) {
        self.turn += 1;
        let turn = self.turn;
        let Some(mut seat) = self.leave(number) else { return };
        let was_quiet = seat.requests == 0;
        change(&mut seat);
        if was_quiet != (seat.requests == 0) {
            (seat.since, seat.since_time) = (turn, Instant::now());
        }
        self.sit(number, seat);
    }

    fn sit(&mut self, number: u64, seat: Seat) {
        let place = seat.place(number);
        self.yielding.extend(place);
        if seat.standing == Standing::Stranger {
            let (count, yielding) = self.strangers.entry(seat.peer).or_default();
            *count += 1;
            yielding.extend(place);
        }
        self.taken.insert(number, seat);
    }

    fn leave(&mut self, number: u64) -> Option<Seat> {
        let seat = self.taken.remove(&number)?;
        let place = seat.place(number);
        if let Some(place) = &place {
            self.yielding.remove(place);
        }
        if seat.standing == Standing::Stranger
            && let Some((count, yielding)) = self.strangers.get_mut(&seat.peer)
        {
            *count -= 1;
            if let Some(place) = &place {
                yielding.remove(place);
            }
            if *count == 0 {
                self.strangers.remove(&seat.peer);
            }
        }
        Some(seat)
    }

    /// Ends the first of these connections, unless it is busy and not for long enough. Whether there was one.
    fn end(&mut self, first: Option<Place>, patience: Duration) -> bool {
        let may_end = |&(yields, _, number): &Place| {
            let seat = self.taken.get(&number);
            yields < Yields::BusyStranger || seat.is_some_and(|seat| seat.since_time.elapsed() >= patience)
        };
        let ended = first.filter(may_end).and_then(|(.., number)| self.leave(number));
        ended.inspect(|seat| seat.gives_way.cancel()).is_some()
    }
}

impl Admission {
    pub fn new(most: usize) -> Arc<Self> {
        Self::with_patience(most, PATIENCE)
    }

    fn with_patience(most: usize, patience: Duration) -> Arc<Self> {
        let most = most.max(4);
        Arc::new(Self { most, most_of_one: most / 4, patience, seats: Mutex::default() })
    }

    /// A seat for a new connection. `None` if all others are known callers' at work, strangers' that began just now, or
    /// those of workers.
    pub fn admit(self: &Arc<Self>, peer: IpAddr) -> Option<Guest> {
        let mut seats = self.seats.lock();
        if let Some((count, yielding)) = seats.strangers.get(&peer)
            && *count >= self.most_of_one
        {
            let first = yielding.first().copied();
            if !seats.end(first, self.patience) {
                return None;
            }
        }
        if seats.taken.len() >= self.most {
            let first = seats.yielding.first().copied();
            if !seats.end(first, self.patience) {
                return None;
            }
        }
        seats.turn += 1;
        let number = seats.turn;
        let gives_way = CancellationToken::new();
        let seat = Seat {
            peer,
            standing: Standing::Stranger,
            requests: 0,
            since: number,
            since_time: Instant::now(),
            gives_way: gives_way.clone(),
        };
        seats.sit(number, seat);
        Some(Guest { admission: self.clone(), number, gives_way })
    }

    /// Ends one connection, for the system has no file left for another. Whether there was one.
    pub fn make_room(&self) -> bool {
        let mut seats = self.seats.lock();
        let first = seats.yielding.first().copied();
        seats.end(first, self.patience)
    }
}

/// A connection's seat. Dropping it frees the seat.
pub(crate) struct Guest {
    admission: Arc<Admission>,
    number: u64,
    /// Cancelled when the connection has to give way.
    pub gives_way: CancellationToken,
}

impl Drop for Guest {
    fn drop(&mut self) {
        self.admission.seats.lock().leave(self.number);
    }
}

impl Guest {
    /// A request on this connection. While it runs, the connection gives way only if it is a stranger's and no
    /// other is quiet.
    pub fn request(&self) -> RequestSeat {
        self.admission.seats.lock().change(self.number, |seat| seat.requests += 1);
        RequestSeat { admission: self.admission.clone(), number: self.number }
    }
}

/// The request that holds a seat, until its answer was sent or given up.
pub(crate) struct RequestSeat {
    admission: Arc<Admission>,
    number: u64,
}

impl RequestSeat {
    /// The request has shown whose it is. A connection keeps the highest standing.
    pub fn show(&self, standing: Standing) {
        let mut seats = self.admission.seats.lock();
        if seats.taken.get(&self.number).is_some_and(|seat| seat.standing < standing) {
            seats.change(self.number, |seat| seat.standing = standing);
        }
    }
}

impl Drop for RequestSeat {
    fn drop(&mut self) {
        self.admission.seats.lock().change(self.number, |seat| seat.requests -= 1);
    }
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;

    use super::*;

    fn address(number: u8) -> IpAddr {
        Ipv4Addr::new(10, 0, 0, number).into()
    }

    fn gone(guest: &Guest) -> bool {
        guest.gives_way.is_cancelled()
    }

    #[test]
    fn the_longest_quiet_stranger_gives_way_and_a_seat_is_free_again_afterwards() {
        let admission = Admission::new(4);
        let guests: Vec<Guest> = (0..4).map(|n| admission.admit(address(n)).unwrap()).collect();
        // The first has had a request since, so the second was quiet for longest.
        drop(guests[0].request());
        let fifth = admission.admit(address(9)).unwrap();
        assert_eq!(guests.iter().map(gone).collect::<Vec<_>>(), [false, true, false, false]);
        drop(guests);
        let others: Vec<Guest> = (20..23).map(|n| admission.admit(address(n)).unwrap()).collect();
        assert!(!gone(&fifth) && !others.iter().any(gone));
    }

    #[test]
    fn who_has_shown_a_token_stays_before_strangers_and_workers_and_known_requests_never_give_way() {
        let admission = Admission::with_patience(4, Duration::ZERO);
        let [known, worker, busy, stranger] = [1, 2, 3, 4].map(|n| admission.admit(address(n)).unwrap());
        known.request().show(Standing::from(Role::Viewer));
        worker.request().show(Standing::from(Role::Worker));
        // What was shown once is not forgotten.
        worker.request().show(Standing::Known);
        let request = busy.request();
        let next = admission.admit(address(5)).unwrap();
        assert!(gone(&stranger) && !gone(&known));
        let running = next.request();
        let after = admission.admit(address(6)).unwrap();
        assert!(gone(&known) && !gone(&worker) && !gone(&busy));
        let last = after.request();
        // Only requests are left, and a worker. The oldest of a stranger ends.
        let late = admission.admit(address(7)).unwrap();
        assert!(gone(&busy) && !gone(&next) && !gone(&after));
        let held = late.request();
        [&running, &last, &held].iter().for_each(|request| request.show(Standing::Known));
        assert!(admission.admit(address(8)).is_none(), "all others work, or are workers");
        assert!(!admission.make_room());
        drop((request, running, last));
        assert!(admission.make_room() && gone(&next));
        assert!(admission.admit(address(8)).is_some() && !gone(&worker));
    }

    #[test]
    fn strangers_of_one_address_give_way_to_each_other_and_to_nobody_elses_harm() {
        let admission = Admission::with_patience(16, Duration::ZERO);
        let other = admission.admit(address(1)).unwrap();
        let own: Vec<Guest> = (0..6).map(|_| admission.admit(address(2)).unwrap()).collect();
        assert_eq!(own.iter().map(gone).collect::<Vec<_>>(), [true, true, false, false, false, false]);
        assert!(!gone(&other));
        let requests: Vec<RequestSeat> = own[2..].iter().map(Guest::request).collect();
        // Its share is at work: one of its own requests ends, and no other's connection.
        let next = admission.admit(address(2)).unwrap();
        assert!(gone(&own[2]) && !gone(&own[3]) && !gone(&other));
        // A proxy's connections show tokens and no longer count.
        requests.iter().for_each(|request| request.show(Standing::Known));
        let more: Vec<Guest> = (0..3).map(|_| admission.admit(address(2)).unwrap()).collect();
        assert!(!gone(&next) && !more.iter().any(gone));
    }

    #[test]
    fn a_strangers_request_is_not_ended_before_it_could_show_whose_it_is() {
        let admission = Admission::new(4);
        let guests: Vec<Guest> = (0..4).map(|n| admission.admit(address(n)).unwrap()).collect();
        let requests: Vec<RequestSeat> = guests.iter().map(Guest::request).collect();
        assert!(admission.admit(address(9)).is_none() && !guests.iter().any(gone));
        drop(requests);
        assert!(admission.admit(address(9)).is_some());
    }
}

//! The handshakes under way: a stranger can take part of the places, never all of the gateway's time.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::net::IpAddr;
use std::rc::Rc;

/// Places of the smallest team.
const PLACES: usize = 64;

/// Further places for each robot: over a link that is cut in one direction its attempts follow each other faster than they end.
const PLACES_OF_ROBOT: usize = 8;

/// The places for handshakes.
#[derive(Debug)]
pub(super) struct Handshakes {
    places: usize,
    under_way: RefCell<BTreeMap<IpAddr, usize>>,
    /// Addresses from which robots have joined.
    known: RefCell<BTreeSet<IpAddr>>,
}

/// A handshake that is under way, until this is dropped.
#[derive(Debug)]
pub(super) struct OpenHandshake {
    handshakes: Rc<Handshakes>,
    address: IpAddr,
}

impl Handshakes {
    /// Those of a gateway for so many robots.
    pub(super) fn of_team(robots: usize) -> Rc<Self> {
        let places = PLACES + PLACES_OF_ROBOT * robots;
        Rc::new(Self { places, under_way: RefCell::default(), known: RefCell::default() })
    }

    /// The number that are under way.
    pub(super) fn count(&self) -> usize {
        self.under_way.borrow().values().sum()
    }

    /// A robot has joined from this address: strangers do not keep it out. There are no more such addresses than places.
    pub(super) fn know(&self, address: IpAddr) {
        let mut known = self.known.borrow_mut();
        if known.len() < self.places {
            known.insert(address);
        }
    }

    /// Begins a handshake with this address; `None` if half of the places are taken by this address, or all of them. Known
    /// addresses have as many places again.
    pub(super) fn begin(self: &Rc<Self>, address: IpAddr) -> Option<OpenHandshake> {
        let places = if self.known.borrow().contains(&address) { 2 * self.places } else { self.places };
        let is_full = self.count() >= places;
        let mut under_way = self.under_way.borrow_mut();
        let with_address = under_way.get(&address).copied().unwrap_or(0);
        if is_full || with_address >= self.places / 2 {
            return None;
        }
        under_way.insert(address, with_address + 1);
        Some(OpenHandshake { handshakes: Rc::clone(self), address })
    }
}

impl Drop for OpenHandshake {
    fn drop(&mut self) {
        let mut under_way = self.handshakes.under_way.borrow_mut();
        if let Some(count) = under_way.get_mut(&self.address) {
            *count -= 1;
            if *count == 0 {
                under_way.remove(&self.address);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;

    use super::*;

    #[test]
    fn a_strangers_address_takes_half_of_the_places_and_strangers_together_all() {
        let handshakes = Handshakes::of_team(2);
        let address = |last: u8| IpAddr::V4(Ipv4Addr::new(10, 0, 0, last));
        let begin_all = |last| std::iter::from_fn(|| handshakes.begin(address(last))).collect::<Vec<_>>();
        let first = begin_all(1);
        assert_eq!((first.len(), handshakes.count()), (40, 40));
        let second = begin_all(2);
        assert_eq!((second.len(), handshakes.count()), (40, 80));
        assert!(handshakes.begin(address(3)).is_none());
        // A robot that comes back is not kept out.
        handshakes.know(address(4));
        let known = begin_all(4);
        assert_eq!((known.len(), handshakes.count()), (40, 120));
        drop(known);
        // A place is free again once its handshake has ended.
        drop(first);
        assert_eq!((handshakes.count(), begin_all(3).len()), (40, 40));
        drop(second);
        assert!(handshakes.count() == 0 && handshakes.under_way.borrow().is_empty());
    }
}

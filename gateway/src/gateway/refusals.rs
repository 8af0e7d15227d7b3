//! Refused peers and frames: counted by cause, and reported in one line each time a cause or a peer is new.

use std::collections::{BTreeMap, HashMap};
use std::fmt::Arguments;
use std::net::IpAddr;
use std::time::{Duration, Instant};

/// A peer that is refused for the same cause again is reported again after this time.
const REPORT: Duration = Duration::from_secs(10);

/// Peers and causes that are remembered: strangers cost no more memory.
const REPORTED_MAX: usize = 256;

/// Refusals since the gateway started.
#[derive(Debug, Default)]
pub(super) struct Refusals {
    counts: BTreeMap<&'static str, u64>,
    reported: HashMap<(IpAddr, &'static str), Instant>,
}

impl Refusals {
    /// Counts a refusal by the name of its cause, and reports it if it is new.
    pub(super) fn add(&mut self, peer: IpAddr, cause: &'static str, what: Arguments<'_>) {
        *self.counts.entry(cause).or_default() += 1;
        let now = Instant::now();
        let is_recent = |at: &Instant| now - *at < REPORT;
        if self.reported.get(&(peer, cause)).is_some_and(is_recent) {
            return;
        }
        if self.reported.len() >= REPORTED_MAX {
            self.reported.retain(|_, at| is_recent(at));
        }
        if self.reported.len() < REPORTED_MAX {
            self.reported.insert((peer, cause), now);
            log::warn!("{peer} {what}");
        }
    }

    /// The counts by the name of the cause.
    pub(super) fn counts(&self) -> &BTreeMap<&'static str, u64> {
        &self.counts
    }
}

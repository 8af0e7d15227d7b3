//! The network between a robot's host and the run's host: it may lose, delay and double packets, and can be cut.

use std::collections::{BinaryHeap, HashMap};
use std::fs::File;
use std::io;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::thread::{LinkNameSpaceType, move_into_link_name_space};
use serde::Serialize;

use super::network;

/// Longest packet: more than any Ethernet carries.
const PACKET_LEN_MAX: usize = 2_048;

/// Longest sleep of a link: bounds how late it notices that it is to end.
const LONGEST_SLEEP: Duration = Duration::from_millis(20);

/// A robot's process that has sent nothing for this time has ended.
const FORGOTTEN: Duration = Duration::from_secs(120);

/// The conditions of all links, each way.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Conditions {
    /// Part of the packets that are lost.
    pub loss: f64,
    /// Packets that are lost one after the other.
    pub burst: u32,
    /// Part of the packets that come twice.
    pub duplicates: f64,
    /// Least time for which a packet is on its way, s.
    pub delay_s: f64,
    /// Time on top of it, up to this, uniformly distributed, s: packets overtake each other.
    pub jitter_s: f64,
    /// Interval at which the links are cut, s, if they are: one after the other.
    pub cut_every_s: Option<f64>,
    /// Duration of such a cut, s.
    pub cut_for_s: f64,
}

impl std::fmt::Display for Conditions {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { loss, burst, duplicates, delay_s, jitter_s, cut_every_s, cut_for_s } = self;
        let (delay_ms, jitter_ms) = (1e3 * delay_s, 1e3 * jitter_s);
        write!(f, "{} % lost", 100.0 * loss)?;
        if *burst > 1 {
            write!(f, " in bursts of {burst}")?;
        }
        write!(f, ", {} % doubled, {delay_ms} to {} ms late", 100.0 * duplicates, delay_ms + jitter_ms)?;
        match cut_every_s {
            Some(cut_every_s) => write!(f, ", cut for {cut_for_s} s in every {cut_every_s}"),
            None => Ok(()),
        }
    }
}

impl Conditions {
    /// Of a link that does nothing to packets.
    #[cfg(test)]
    pub const GOOD: Self =
        Self { loss: 0.0, burst: 1, duplicates: 0.0, delay_s: 0.0, jitter_s: 0.0, cut_every_s: None, cut_for_s: 0.0 };

    /// True while the link of a host is cut that is cut at intervals, this time after its beginning, s. The first cut of host 1
    /// ends with the interval, and those of the others follow.
    fn cuts(&self, host: usize, elapsed_s: f64) -> bool {
        self.cut_every_s.is_some_and(|every_s| {
            let since_first_s = elapsed_s - every_s - (host as f64 - 2.0) * self.cut_for_s;
            since_first_s >= 0.0 && since_first_s.rem_euclid(every_s) < self.cut_for_s
        })
    }
}

/// Which packets a link lets through.
#[derive(Debug, Default)]
struct State {
    cut_up: AtomicBool,
    cut_down: AtomicBool,
    ended: AtomicBool,
}

/// The link of a robot's host: robots connect to its address instead of the gateway's.
#[derive(Debug)]
pub struct Link {
    address: SocketAddr,
    state: Arc<State>,
    thread: Option<JoinHandle<()>>,
}

impl Link {
    /// A link from a host to the gateway.
    ///
    /// # Errors
    /// If its socket cannot be opened between the hosts.
    pub fn new(host: usize, port: u16, gateway: SocketAddr, conditions: Conditions, seed: u64) -> io::Result<Self> {
        let state = Arc::new(State::default());
        let its = Arc::clone(&state);
        let (sender, opened) = std::sync::mpsc::channel();
        let thread = std::thread::Builder::new().name(format!("link-{host}")).spawn(move || {
            let front = open(port);
            let failed = front.as_ref().err().map(|error| io::Error::new(error.kind(), error.to_string()));
            let _ = sender.send(failed);
            if let Ok(front) = front {
                let random = ChaCha8Rng::seed_from_u64(seed.wrapping_add(host as u64));
                Relay {
                    front,
                    gateway,
                    host,
                    began: Instant::now(),
                    conditions,
                    random,
                    backs: HashMap::new(),
                    later: BinaryHeap::new(),
                    lose: [0; 2],
                }
                .pass(&its);
            }
        })?;
        match opened.recv() {
            Ok(None) => Ok(Self { address: (network::next_hop(host), port).into(), state, thread: Some(thread) }),
            Ok(Some(error)) => Err(error),
            Err(_) => Err(io::ErrorKind::BrokenPipe.into()),
        }
    }

    /// The address that robots connect to.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Cuts packets to the gateway, from it, both, or none.
    pub fn cut(&self, up: bool, down: bool) {
        self.state.cut_up.store(up, Ordering::Relaxed);
        self.state.cut_down.store(down, Ordering::Relaxed);
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.state.ended.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// Moves this thread to the middle of the network, and opens a socket there. It belongs to no host's address, so that it
/// outlives the host.
fn open(port: u16) -> io::Result<UdpSocket> {
    let middle = File::open(network::middle_file())?;
    move_into_link_name_space(middle.as_fd(), Some(LinkNameSpaceType::Network))?;
    let front = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, port))?;
    front.set_nonblocking(true)?;
    Ok(front)
}

/// A packet on its way: the earliest first.
struct Later {
    at: Instant,
    robot: SocketAddr,
    is_up: bool,
    bytes: Vec<u8>,
}

impl Ord for Later {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        other.at.cmp(&self.at)
    }
}

impl PartialOrd for Later {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Later {
    fn eq(&self, other: &Self) -> bool {
        self.at == other.at
    }
}

impl Eq for Later {}

struct Relay {
    front: UdpSocket,
    gateway: SocketAddr,
    conditions: Conditions,
    host: usize,
    began: Instant,
    random: ChaCha8Rng,
    /// A socket for each robot's process, so that the gateway sees them apart, and when the process last sent something.
    backs: HashMap<SocketAddr, (UdpSocket, Instant)>,
    later: BinaryHeap<Later>,
    /// Packets of a burst that are still to be lost, up and down.
    lose: [u32; 2],
}

impl Relay {
    fn pass(&mut self, state: &State) {
        while !state.ended.load(Ordering::Relaxed) {
            self.wait();
            let mut bytes = [0; PACKET_LEN_MAX];
            let mut come = Vec::new();
            while let Ok((len, robot)) = self.front.recv_from(&mut bytes) {
                come.push((robot, true, bytes[..len].to_vec()));
            }
            for (robot, (back, _)) in &self.backs {
                while let Ok(len) = back.recv(&mut bytes) {
                    come.push((*robot, false, bytes[..len].to_vec()));
                }
            }
            let is_cut = self.conditions.cuts(self.host, self.began.elapsed().as_secs_f64());
            for (robot, is_up, bytes) in come {
                let cut = if is_up { &state.cut_up } else { &state.cut_down };
                if !is_cut && !cut.load(Ordering::Relaxed) && !self.loses(is_up) {
                    let copies = 1 + usize::from(self.random.random_bool(self.conditions.duplicates));
                    for _ in 0..copies {
                        let at = self.arrival();
                        self.later.push(Later { at, robot, is_up, bytes: bytes.clone() });
                    }
                }
            }
            while self.later.peek().is_some_and(|first| first.at <= Instant::now()) {
                self.deliver();
            }
        }
    }

    /// Sleeps until a packet comes or is due.
    fn wait(&self) {
        let due = self
            .later
            .peek()
            .map_or(LONGEST_SLEEP, |first| first.at.saturating_duration_since(Instant::now()).min(LONGEST_SLEEP));
        let timeout = Timespec { tv_sec: 0, tv_nsec: due.subsec_nanos().into() };
        let sockets = std::iter::once(&self.front).chain(self.backs.values().map(|(back, _)| back));
        let mut sockets: Vec<PollFd<'_>> = sockets.map(|socket| PollFd::new(socket, PollFlags::IN)).collect();
        let _ = poll(&mut sockets, Some(&timeout));
    }

    fn loses(&mut self, is_up: bool) -> bool {
        let Conditions { loss, burst, .. } = self.conditions;
        let left = &mut self.lose[usize::from(is_up)];
        if *left > 0 {
            *left -= 1;
            return true;
        }
        // So that bursts and the packets between them have this part in the mean.
        let starts = loss / (loss + f64::from(burst) * (1.0 - loss));
        let is_lost = self.random.random_bool(starts);
        if is_lost {
            *left = burst - 1;
        }
        is_lost
    }

    fn arrival(&mut self) -> Instant {
        let Conditions { delay_s, jitter_s, .. } = self.conditions;
        let on_its_way_s = delay_s + jitter_s * self.random.random_range(0.0..1.0);
        Instant::now() + Duration::from_secs_f64(on_its_way_s)
    }

    /// Delivers the first packet. One that cannot be sent is lost, as in a network.
    fn deliver(&mut self) {
        let Some(Later { robot, is_up, bytes, .. }) = self.later.pop() else { return };
        if !is_up {
            let _ = self.front.send_to(&bytes, robot);
            return;
        }
        let now = Instant::now();
        if !self.backs.contains_key(&robot)
            && let Ok(back) = self.back()
        {
            self.backs.retain(|_, (_, heard)| now.duration_since(*heard) < FORGOTTEN);
            self.backs.insert(robot, (back, now));
        }
        if let Some((back, heard)) = self.backs.get_mut(&robot) {
            *heard = now;
            let _ = back.send(&bytes);
        }
    }

    fn back(&self) -> io::Result<UdpSocket> {
        let back = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
        back.connect(self.gateway)?;
        back.set_nonblocking(true)?;
        Ok(back)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_are_cut_at_intervals_one_after_the_other() {
        let never = Conditions { cut_for_s: 2.0, ..Conditions::GOOD };
        let cut_at = |conditions: &Conditions, host| -> Vec<u32> {
            (0..22).filter(|s| conditions.cuts(host, f64::from(*s) + 0.5)).collect()
        };
        let at_intervals = Conditions { cut_every_s: Some(10.0), ..never };
        assert_eq!(cut_at(&never, 1), [0; 0]);
        assert_eq!(cut_at(&at_intervals, 1), [8, 9, 18, 19]);
        assert_eq!(cut_at(&at_intervals, 2), [10, 11, 20, 21]);
        let overlapping = Conditions { cut_every_s: Some(10.0), cut_for_s: 9.0, ..never };
        assert_eq!(cut_at(&overlapping, 2), [10, 11, 12, 13, 14, 15, 16, 17, 18, 20, 21]);
    }
}

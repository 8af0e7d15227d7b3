//! Wake-ups: a word of shared memory for each wait group, on which its processes wait in the kernel (futex).
//!
//! Compared with an iceoryx2 event, which is a datagram to every listener, a signal here wakes all robots with one
//! system call, costs none if nobody sleeps, and needs no socket. Nothing can be left locked: a
//! killed process leaves at most a count too high, which costs a system call.

use std::cell::Cell;
use std::rc::Rc;
use std::sync::atomic::Ordering::{AcqRel, Acquire, Relaxed, SeqCst};
use std::time::Duration;

use iceoryx2::prelude::ZeroCopySend;
use iceoryx2_bb_concurrency::atomic::{AtomicU32, AtomicU64};
use rangehound_shared::protocol::wake::{Answers, EVENTS, Event, Events, Notification, WaitGroup, When};
use rustix::thread::futex;
use rustix::time::Timespec;

use crate::block::{Block, BlockError};
use crate::system::clock::monotonic_ns;

/// Name of the block with the wait groups.
const NAME: &str = "wait_groups";

/// One wait group's words, on their own cache line, so that signals to one group do not disturb another.
#[derive(Debug, Default, ZeroCopySend)]
#[repr(C)]
#[repr(align(64))]
struct Words {
    /// Counts signals; the word that the kernel compares.
    signals: AtomicU32,
    /// Upper bound on the processes asleep.
    asleep: AtomicU32,
    /// Count of each event.
    events: [AtomicU32; EVENTS],
    /// Answers that a tick waits for.
    expected: AtomicU32,
    /// [`Answers`] to the newest tick.
    answers: AtomicU64,
}

const _: () = assert!(size_of::<Words>() == 64 && align_of::<Words>() == 64 && size_of::<SharedWaitGroups>() == 3 * 64);

/// How long a process spins for an event, if other cores may be about to send it: a few times the cost of sleeping and
/// being woken from another core, because the rest of the team has to be woken too.
const POLL_NS: u64 = 200_000;

/// A process that yields for longer than this, and [`TURN_NS`] for each robot, has not yielded to its team alone: another
/// program uses this processor. The kernel then gives the processor back at once only to a process that it wakes from sleep.
const LONG_TURN_NS: u64 = 1_000_000;

/// A robot's share of a tick if all share one processor, whose caches hold no robot's data, and all are woken from sleep.
const TURN_NS: u64 = 25_000;

/// After a long turn, waits until the next spin.
const WAITS_AFTER_LONG_TURN: u32 = 250;

/// The words of a run.
#[derive(Debug, Default, ZeroCopySend)]
#[repr(C)]
#[type_name("rangehound.WaitGroups.v2")]
struct SharedWaitGroups {
    sim: Words,
    fusion: Words,
    robots: Words,
}

/// One process's view of the run's wait groups.
#[derive(Debug, Clone)]
pub(crate) struct WaitGroups(Rc<Block<SharedWaitGroups>>);

/// Creates the wait groups of the run with this shared-memory prefix. Call before any process can join it.
///
/// # Errors
/// [`BlockError`] if the system refuses.
pub(crate) fn create(prefix: &str) -> Result<(), BlockError> {
    Block::create(prefix, NAME, SharedWaitGroups::default)
}

impl WaitGroups {
    pub(crate) fn open(prefix: &str) -> Result<Self, BlockError> {
        Block::open(prefix, NAME).map(|block| Self(Rc::new(block)))
    }

    fn words(&self, group: WaitGroup) -> &Words {
        let groups: &SharedWaitGroups = &self.0;
        match group {
            WaitGroup::Sim => &groups.sim,
            WaitGroup::Fusion => &groups.fusion,
            WaitGroup::Robots => &groups.robots,
        }
    }
}

/// How long a process spins before it sleeps.
#[derive(Debug, Clone, Copy)]
enum Spin {
    /// For this time, ns.
    Time(u64),
    /// On one core, where no other process runs meanwhile: for this number of turns of the others.
    Turns(u32),
}

impl Spin {
    fn on_one_core(group: WaitGroup) -> Self {
        Self::Turns(match group {
            // The answers of a tick come with the second turn of each robot: to check after the first one costs the
            // robots, which wait for their headings, a turn.
            WaitGroup::Sim => 0,
            WaitGroup::Fusion => 1,
            // Fusion's turn may come only after each robot has had another one.
            WaitGroup::Robots => 2,
        })
    }
}

/// The place where a process waits for events.
#[derive(Debug)]
pub struct Waiter {
    wait_groups: WaitGroups,
    group: WaitGroup,
    spin: Spin,
    /// A longer turn of the others is not the team's own.
    long_turn_ns: u64,
    /// Waits left without a spin.
    asleep_at_once: Cell<u32>,
    /// Each event's count at the last check.
    heard: Cell<[u32; EVENTS]>,
}

impl Waiter {
    pub(crate) fn new(wait_groups: WaitGroups, group: WaitGroup, robots: usize) -> Self {
        let has_cores = rustix::thread::sched_getaffinity(None).is_ok_and(|cores| cores.count() > 1);
        Self {
            wait_groups,
            group,
            spin: if has_cores { Spin::Time(POLL_NS) } else { Spin::on_one_core(group) },
            long_turn_ns: LONG_TURN_NS + TURN_NS * robots as u64,
            asleep_at_once: Cell::default(),
            heard: Cell::default(),
        }
    }

    /// Spins for an event that may be about to come, and then sleeps: see [`Self::watch`], [`Self::sleep`].
    pub fn wait(&self, at_most: Duration) -> Events {
        let events = self.watch();
        if events.is_empty() { self.sleep(at_most) } else { events }
    }

    /// Spins for an event, yielding to other processes: if the event is about to come, this costs less than
    /// sleeping and being woken.
    #[must_use]
    pub fn watch(&self) -> Events {
        if matches!(self.spin, Spin::Turns(0)) {
            return Events::default();
        }
        if let Some(fewer) = self.asleep_at_once.get().checked_sub(1) {
            self.asleep_at_once.set(fewer);
            return Events::default();
        }
        let words = self.wait_groups.words(self.group);
        let mut now_ns = monotonic_ns();
        let (began_ns, mut turns) = (now_ns, 0);
        loop {
            rustix::thread::sched_yield();
            turns += 1;
            let events = self.events(words);
            let since_ns = std::mem::replace(&mut now_ns, monotonic_ns());
            if now_ns - since_ns > self.long_turn_ns {
                self.asleep_at_once.set(WAITS_AFTER_LONG_TURN);
                return events;
            }
            let is_over = match self.spin {
                Spin::Time(spin_ns) => now_ns - began_ns >= spin_ns,
                Spin::Turns(most) => turns >= most,
            };
            if !events.is_empty() || is_over {
                return events;
            }
        }
    }

    /// Sleeps until an event, a time-out or a signal. Does not sleep if an event came since the
    /// last call. May return without an event, if it saw an event's signal before that had finished.
    pub fn sleep(&self, at_most: Duration) -> Events {
        let words = self.wait_groups.words(self.group);
        let signals = words.signals.load(SeqCst);
        let events = self.events(words);
        if !events.is_empty() || at_most.is_zero() {
            return events;
        }
        words.asleep.fetch_add(1, SeqCst);
        let timeout = Timespec { tv_sec: at_most.as_secs().cast_signed(), tv_nsec: at_most.subsec_nanos().into() };
        // Sleep may end for any reason, a recent signal included: the caller checks everything.
        let _ = futex::wait(&words.signals, futex::Flags::empty(), signals, Some(&timeout));
        words.asleep.fetch_sub(1, SeqCst);
        self.events(words)
    }

    fn events(&self, words: &Words) -> Events {
        let heard = self.heard.get();
        let now = std::array::from_fn(|event| words.events[event].load(Acquire));
        self.heard.set(now);
        Events::new(std::array::from_fn(|event| now[event] != heard[event]))
    }

    /// Sets the number of answers that this wait group waits for: see [`Notifier::signal_if_last`].
    pub fn expect(&self, answers: usize) {
        self.wait_groups.words(self.group).expected.store(answers as u32, Relaxed);
    }
}

/// Wakes a wait group.
#[derive(Debug)]
pub struct Notifier {
    wait_groups: WaitGroups,
    group: WaitGroup,
}

impl Notifier {
    pub(crate) fn new(wait_groups: WaitGroups, group: WaitGroup) -> Self {
        Self { wait_groups, group }
    }

    /// Carries out a wake-up that a role asks for.
    pub fn notify(&self, notification: &Notification) {
        match notification.when {
            When::Always => self.signal(notification.event),
            When::LastAnswer { tick, or_first } => self.signal_if_last(notification.event, tick, or_first),
        }
    }

    /// Sends an event to the wait group.
    pub fn signal(&self, event: Event) {
        let words = self.wait_groups.words(self.group);
        words.events[event as usize].fetch_add(1, AcqRel);
        words.signals.fetch_add(1, SeqCst);
        if words.asleep.load(SeqCst) > 0 {
            // No error needs an action: a process that was not woken checks by itself after its time-out.
            let _ = futex::wake(&words.signals, futex::Flags::empty(), i32::MAX as u32);
        }
    }

    /// Counts an answer to a tick, and wakes the wait group if it is the last expected one; with `or_first` also
    /// if it is the first.
    ///
    /// A count that a kill left too low costs a wait until the next repeat, which signals without
    /// counting; a count that a restarted robot made too high costs a wake-up.
    pub fn signal_if_last(&self, event: Event, tick: u64, or_first: bool) {
        let words = self.wait_groups.words(self.group);
        let counted = |answers: u64| Answers::from_bits(answers).with(tick).map(Answers::to_bits);
        let before = words.answers.fetch_update(AcqRel, Relaxed, counted).ok();
        let answers = before.and_then(|before| Answers::from_bits(before).with(tick));
        // The tick is over: nobody waits for its answers.
        if answers.is_none_or(|answers| answers.wakes(words.expected.load(Relaxed).into(), or_first)) {
            self.signal(event);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rendezvous::create_for_test as run;

    /// Far longer than any wait takes here.
    const LIMIT: Duration = Duration::from_secs(60);

    /// Ping-pong at full speed, so that signals come at every moment of falling asleep.
    #[test]
    fn every_notification_is_received() {
        let run = run("wait-groups-heard");
        let rounds = 50_000;
        let play = |prefix: &str, mine: WaitGroup, other: WaitGroup, begins: bool| {
            let wait_groups = WaitGroups::open(prefix).unwrap();
            let (waiter, notifier) = (Waiter::new(wait_groups.clone(), mine, 1), Notifier::new(wait_groups, other));
            if begins {
                notifier.signal(Event::Range);
            }
            for round in 0..rounds {
                let began = std::time::Instant::now();
                // It may return without an event, if it saw the last signal before that had finished.
                while !waiter.sleep(LIMIT).has(Event::Range) {
                    assert!(began.elapsed() < LIMIT, "round {round}");
                }
                notifier.signal(Event::Range);
            }
        };
        std::thread::scope(|scope| {
            let prefix = run.shared_memory_prefix();
            scope.spawn(move || play(prefix, WaitGroup::Sim, WaitGroup::Fusion, false));
            scope.spawn(move || play(prefix, WaitGroup::Fusion, WaitGroup::Sim, true));
        });
    }

    #[test]
    fn each_wait_groups_words_have_their_own_cache_line() {
        let run = run("wait-groups-lines");
        let wait_groups = WaitGroups::open(run.shared_memory_prefix()).unwrap();
        for group in [WaitGroup::Sim, WaitGroup::Fusion, WaitGroup::Robots] {
            assert_eq!(std::ptr::from_ref(wait_groups.words(group)).addr() % 64, 0, "{group:?}");
        }
    }

    #[test]
    fn one_signal_wakes_the_whole_wait_group() {
        let run = run("wait-groups-all");
        let prefix = run.shared_memory_prefix();
        std::thread::scope(|scope| {
            let waiters: Vec<_> = (0..5)
                .map(|_| {
                    scope.spawn(|| Waiter::new(WaitGroups::open(prefix).unwrap(), WaitGroup::Robots, 5).sleep(LIMIT))
                })
                .collect();
            let wait_groups = WaitGroups::open(prefix).unwrap();
            while wait_groups.words(WaitGroup::Robots).asleep.load(SeqCst) < 5 {
                std::thread::yield_now();
            }
            Notifier::new(wait_groups, WaitGroup::Robots).signal(Event::Finished);
            for waiter in waiters {
                let events = waiter.join().unwrap();
                assert!(events.has(Event::Finished) && !events.has(Event::Range));
            }
        });
    }

    #[test]
    fn the_last_answer_to_a_tick_signals() {
        let run = run("wait-groups-last");
        let wait_groups = WaitGroups::open(run.shared_memory_prefix()).unwrap();
        let (waiter, notifier) =
            (Waiter::new(wait_groups.clone(), WaitGroup::Fusion, 3), Notifier::new(wait_groups, WaitGroup::Fusion));
        waiter.expect(3);
        let signals = |tick: u64, or_first: bool| {
            notifier.signal_if_last(Event::Range, tick, or_first);
            waiter.sleep(Duration::ZERO).has(Event::Range)
        };
        for tick in [0, 1, 7] {
            assert_eq!([0; 3].map(|_| signals(tick, false)), [false, false, true], "{tick}");
            // A restarted robot answers again.
            assert!(signals(tick, false));
        }
        assert_eq!([0; 3].map(|_| signals(8, true)), [true, false, true]);
        assert!(signals(7, false), "of a tick that is over");
        // One answer fewer is expected.
        waiter.expect(2);
        assert_eq!([0; 2].map(|_| signals(9, false)), [false, true]);
    }
}

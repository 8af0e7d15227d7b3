//! Wake-ups: a word of shared memory for each kind of sleeper, on which the kernel lets it wait (futex).
//!
//! Against an event of iceoryx2's, which is a datagram to every listener, a ring wakes all robots with one
//! system call, costs none where nobody sleeps, and holds no socket. Nothing here can be left locked: a
//! process that is killed leaves at most a count too high, which costs a system call.

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

/// Name of the block that holds them.
const NAME: &str = "wait_groups";

/// One sleeper's words, on a cache line of their own, so that rings for one do not disturb another.
#[derive(Debug, Default, ZeroCopySend)]
#[repr(C)]
#[repr(align(64))]
struct Words {
    /// Counts rings; the word that the kernel compares.
    signals: AtomicU32,
    /// Who may be asleep: at least as many as are.
    asleep: AtomicU32,
    /// Counts each call.
    events: [AtomicU32; EVENTS],
    /// Answers without which a tick does not go on.
    expected: AtomicU32,
    /// [`Answers`] to the newest tick.
    answers: AtomicU64,
}

const _: () = assert!(size_of::<Words>() == 64 && align_of::<Words>() == 64 && size_of::<Board>() == 3 * 64);

/// How long a process looks out for a call, if other cores may be about to make it: some times what falling asleep and
/// being woken from another core take, as the rest of the team has to be woken too.
const WATCH_NS: u64 = 200_000;

/// The team takes no longer for a round of turns, unless it is large and on one processor: who had this one computes
/// something else. From such, only who is woken from sleep gets the processor back at once.
const LONG_TURN_NS: u64 = 1_000_000;

/// After a long turn, waits until the next look-out.
const WAITS_AFTER_LONG_TURN: u32 = 250;

/// The words of a run.
#[derive(Debug, Default, ZeroCopySend)]
#[repr(C)]
#[type_name("rangehound.WaitGroups.v2")]
struct Board {
    sim: Words,
    fusion: Words,
    robots: Words,
}

/// One process's view of the run's wait groups.
#[derive(Debug, Clone)]
pub(crate) struct WaitGroups(Rc<Block<Board>>);

/// Makes the wait groups of a run whose shared memory has this prefix: before anybody can join it.
///
/// # Errors
/// [`BlockError`] if the system refuses.
pub(crate) fn create(prefix: &str) -> Result<(), BlockError> {
    Block::create(prefix, NAME, Board::default)
}

impl WaitGroups {
    pub(crate) fn open(prefix: &str) -> Result<Self, BlockError> {
        Block::open(prefix, NAME).map(|block| Self(Rc::new(block)))
    }

    fn words(&self, group: WaitGroup) -> &Words {
        let board: &Board = &self.0;
        match group {
            WaitGroup::Sim => &board.sim,
            WaitGroup::Fusion => &board.fusion,
            WaitGroup::Robots => &board.robots,
        }
    }
}

/// Where a process sleeps until it is called.
#[derive(Debug)]
pub struct Waiter {
    wait_groups: WaitGroups,
    group: WaitGroup,
    /// How long it looks out: on one core, where nobody runs meanwhile, for one look.
    watch_ns: u64,
    /// Waits for which it does not look out.
    asleep_at_once: Cell<u32>,
    /// Each call's count at the last look.
    heard: Cell<[u32; EVENTS]>,
}

impl Waiter {
    pub(crate) fn new(wait_groups: WaitGroups, group: WaitGroup) -> Self {
        let has_cores = rustix::thread::sched_getaffinity(None).is_ok_and(|cores| cores.count() > 1);
        Self {
            wait_groups,
            group,
            watch_ns: if has_cores { WATCH_NS } else { 0 },
            asleep_at_once: Cell::default(),
            heard: Cell::default(),
        }
    }

    /// Looks out for a call that is about to come, and sleeps if it does not: see [`Self::watch`], [`Self::sleep`].
    pub fn wait(&self, at_most: Duration) -> Events {
        let events = self.watch();
        if events.is_empty() { self.sleep(at_most) } else { events }
    }

    /// Looks out for a call for a moment, and lets others run meanwhile: cheaper for all than to fall asleep and be
    /// woken, if the call is about to come.
    #[must_use]
    pub fn watch(&self) -> Events {
        if let Some(fewer) = self.asleep_at_once.get().checked_sub(1) {
            self.asleep_at_once.set(fewer);
            return Events::default();
        }
        let words = self.wait_groups.words(self.group);
        let mut now_ns = monotonic_ns();
        let until_ns = now_ns + self.watch_ns;
        loop {
            std::thread::yield_now();
            let events = self.events(words);
            let since_ns = std::mem::replace(&mut now_ns, monotonic_ns());
            if now_ns - since_ns > LONG_TURN_NS {
                self.asleep_at_once.set(WAITS_AFTER_LONG_TURN);
            }
            if !events.is_empty() || now_ns >= until_ns {
                return events;
            }
        }
    }

    /// Sleeps until called, until time runs out, or until a signal comes. Does not sleep if called since the
    /// last time. May end without a call, if that of a ring was seen before the ring had ended.
    pub fn sleep(&self, at_most: Duration) -> Events {
        let words = self.wait_groups.words(self.group);
        let signals = words.signals.load(SeqCst);
        let events = self.events(words);
        if !events.is_empty() || at_most.is_zero() {
            return events;
        }
        words.asleep.fetch_add(1, SeqCst);
        let timeout = Timespec { tv_sec: at_most.as_secs().cast_signed(), tv_nsec: at_most.subsec_nanos().into() };
        // Whatever ends it, a ring just before among them: the caller looks at everything.
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

    /// Says how many answers this sleeper waits for: see [`Notifier::signal_if_last`].
    pub fn expect(&self, answers: usize) {
        self.wait_groups.words(self.group).expected.store(answers as u32, Relaxed);
    }
}

/// Wakes a sleeper.
#[derive(Debug)]
pub struct Notifier {
    wait_groups: WaitGroups,
    group: WaitGroup,
}

impl Notifier {
    pub(crate) fn new(wait_groups: WaitGroups, group: WaitGroup) -> Self {
        Self { wait_groups, group }
    }

    /// Wakes as a role asks for it.
    pub fn notify(&self, notification: &Notification) {
        match notification.when {
            When::Always => self.signal(notification.event),
            When::LastAnswer { tick, or_first } => self.signal_if_last(notification.event, tick, or_first),
        }
    }

    /// Events the sleeper.
    pub fn signal(&self, event: Event) {
        let words = self.wait_groups.words(self.group);
        words.events[event as usize].fetch_add(1, AcqRel);
        words.signals.fetch_add(1, SeqCst);
        if words.asleep.load(SeqCst) > 0 {
            // An error is nothing to act on: who was not woken looks by itself before long.
            let _ = futex::wake(&words.signals, futex::Flags::empty(), i32::MAX as u32);
        }
    }

    /// Counts an answer to a tick, and calls the sleeper if it is the last that it waits for; or the first, if
    /// that is asked for.
    ///
    /// A count that a kill has left short costs a wait until the next repeat, which rings without
    /// counting; one that a restarted robot has made too high costs a wake-up.
    pub fn signal_if_last(&self, event: Event, tick: u64, or_first: bool) {
        let words = self.wait_groups.words(self.group);
        let counted = |answers: u64| Answers::from_bits(answers).with(tick).map(Answers::to_bits);
        let before = words.answers.fetch_update(AcqRel, Relaxed, counted).ok();
        let answers = before.and_then(|before| Answers::from_bits(before).with(tick));
        // Of a tick that is over: whoever needs it waits for nothing else.
        if answers.is_none_or(|answers| answers.event(words.expected.load(Relaxed).into(), or_first)) {
            self.signal(event);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rendezvous::found_for_test as run;

    /// Far above what any wait takes here.
    const LIMIT: Duration = Duration::from_secs(60);

    /// To and fro as fast as it goes, so that rings come at every moment of falling asleep.
    #[test]
    fn every_ring_is_heard() {
        let run = run("wait-groups-heard");
        let rounds = 50_000;
        let play = |prefix: &str, mine: WaitGroup, other: WaitGroup, begins: bool| {
            let wait_groups = WaitGroups::open(prefix).unwrap();
            let (waiter, notifier) = (Waiter::new(wait_groups.clone(), mine), Notifier::new(wait_groups, other));
            if begins {
                notifier.signal(Event::Range);
            }
            for round in 0..rounds {
                let began = std::time::Instant::now();
                // It may return without a call, if the last ring was seen before it had ended.
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
    fn each_sleepers_words_have_a_cache_line_of_their_own() {
        let run = run("wait-groups-lines");
        let wait_groups = WaitGroups::open(run.shared_memory_prefix()).unwrap();
        for group in [WaitGroup::Sim, WaitGroup::Fusion, WaitGroup::Robots] {
            assert_eq!(std::ptr::from_ref(wait_groups.words(group)).addr() % 64, 0, "{group:?}");
        }
    }

    #[test]
    fn one_ring_wakes_all_who_sleep_in_one_place() {
        let run = run("wait-groups-all");
        let prefix = run.shared_memory_prefix();
        std::thread::scope(|scope| {
            let sleepers: Vec<_> = (0..5)
                .map(|_| scope.spawn(|| Waiter::new(WaitGroups::open(prefix).unwrap(), WaitGroup::Robots).sleep(LIMIT)))
                .collect();
            let wait_groups = WaitGroups::open(prefix).unwrap();
            while wait_groups.words(WaitGroup::Robots).asleep.load(SeqCst) < 5 {
                std::thread::yield_now();
            }
            Notifier::new(wait_groups, WaitGroup::Robots).signal(Event::Finished);
            for group in sleepers {
                let events = group.join().unwrap();
                assert!(events.has(Event::Finished) && !events.has(Event::Range));
            }
        });
    }

    #[test]
    fn of_the_answers_to_a_tick_the_last_one_rings() {
        let run = run("wait-groups-last");
        let wait_groups = WaitGroups::open(run.shared_memory_prefix()).unwrap();
        let (waiter, notifier) =
            (Waiter::new(wait_groups.clone(), WaitGroup::Fusion), Notifier::new(wait_groups, WaitGroup::Fusion));
        waiter.expect(3);
        let signals = |tick: u64, or_first: bool| {
            notifier.signal_if_last(Event::Range, tick, or_first);
            waiter.sleep(Duration::ZERO).has(Event::Range)
        };
        for tick in [0, 1, 7] {
            assert_eq!([0; 3].map(|_| signals(tick, false)), [false, false, true], "{tick}");
            // A robot that was started again answers again.
            assert!(signals(tick, false));
        }
        assert_eq!([0; 3].map(|_| signals(8, true)), [true, false, true]);
        assert!(signals(7, false), "of a tick that is over");
        // One is not waited for any more.
        waiter.expect(2);
        assert_eq!([0; 2].map(|_| signals(9, false)), [false, true]);
    }
}

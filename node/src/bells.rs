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
use rangehound_shared::protocol::wake::{Answers, CALLS, Call, Calls, Notification, Sleeper, When};
use rustix::thread::futex;
use rustix::time::Timespec;

use crate::block::{Block, BlockError};
use crate::system::clock::monotonic_ns;

/// Name of the block that holds them.
const NAME: &str = "bells";

/// One sleeper's words, on a cache line of their own, so that rings for one do not disturb another.
#[derive(Debug, Default, ZeroCopySend)]
#[repr(C)]
#[repr(align(64))]
struct Words {
    /// Counts rings; the word that the kernel compares.
    rings: AtomicU32,
    /// Who may be asleep: at least as many as are.
    asleep: AtomicU32,
    /// Counts each call.
    calls: [AtomicU32; CALLS],
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
#[type_name("rangehound.Bells.v2")]
struct Board {
    sim: Words,
    fusion: Words,
    robots: Words,
}

/// One process's view of the run's bells.
#[derive(Debug, Clone)]
pub(crate) struct Bells(Rc<Block<Board>>);

/// Makes the bells of a run whose shared memory has this prefix: before anybody can join it.
///
/// # Errors
/// [`BlockError`] if the system refuses.
pub(crate) fn create(prefix: &str) -> Result<(), BlockError> {
    Block::create(prefix, NAME, Board::default)
}

impl Bells {
    pub(crate) fn open(prefix: &str) -> Result<Self, BlockError> {
        Block::open(prefix, NAME).map(|block| Self(Rc::new(block)))
    }

    fn words(&self, sleeper: Sleeper) -> &Words {
        let board: &Board = &self.0;
        match sleeper {
            Sleeper::Sim => &board.sim,
            Sleeper::Fusion => &board.fusion,
            Sleeper::Robots => &board.robots,
        }
    }
}

/// Where a process sleeps until it is called.
#[derive(Debug)]
pub struct Bed {
    bells: Bells,
    sleeper: Sleeper,
    /// How long it looks out: on one core, where nobody runs meanwhile, for one look.
    watch_ns: u64,
    /// Waits for which it does not look out.
    asleep_at_once: Cell<u32>,
    /// Each call's count at the last look.
    heard: Cell<[u32; CALLS]>,
}

impl Bed {
    pub(crate) fn new(bells: Bells, sleeper: Sleeper) -> Self {
        let has_cores = rustix::thread::sched_getaffinity(None).is_ok_and(|cores| cores.count() > 1);
        Self {
            bells,
            sleeper,
            watch_ns: if has_cores { WATCH_NS } else { 0 },
            asleep_at_once: Cell::default(),
            heard: Cell::default(),
        }
    }

    /// Looks out for a call that is about to come, and sleeps if it does not: see [`Self::watch`], [`Self::sleep`].
    pub fn wait(&self, at_most: Duration) -> Calls {
        let calls = self.watch();
        if calls.is_empty() { self.sleep(at_most) } else { calls }
    }

    /// Looks out for a call for a moment, and lets others run meanwhile: cheaper for all than to fall asleep and be
    /// woken, if the call is about to come.
    #[must_use]
    pub fn watch(&self) -> Calls {
        if let Some(fewer) = self.asleep_at_once.get().checked_sub(1) {
            self.asleep_at_once.set(fewer);
            return Calls::default();
        }
        let words = self.bells.words(self.sleeper);
        let mut now_ns = monotonic_ns();
        let until_ns = now_ns + self.watch_ns;
        loop {
            std::thread::yield_now();
            let calls = self.calls(words);
            let since_ns = std::mem::replace(&mut now_ns, monotonic_ns());
            if now_ns - since_ns > LONG_TURN_NS {
                self.asleep_at_once.set(WAITS_AFTER_LONG_TURN);
            }
            if !calls.is_empty() || now_ns >= until_ns {
                return calls;
            }
        }
    }

    /// Sleeps until called, until time runs out, or until a signal comes. Does not sleep if called since the
    /// last time. May end without a call, if that of a ring was seen before the ring had ended.
    pub fn sleep(&self, at_most: Duration) -> Calls {
        let words = self.bells.words(self.sleeper);
        let rings = words.rings.load(SeqCst);
        let calls = self.calls(words);
        if !calls.is_empty() || at_most.is_zero() {
            return calls;
        }
        words.asleep.fetch_add(1, SeqCst);
        let timeout = Timespec { tv_sec: at_most.as_secs().cast_signed(), tv_nsec: at_most.subsec_nanos().into() };
        // Whatever ends it, a ring just before among them: the caller looks at everything.
        let _ = futex::wait(&words.rings, futex::Flags::empty(), rings, Some(&timeout));
        words.asleep.fetch_sub(1, SeqCst);
        self.calls(words)
    }

    fn calls(&self, words: &Words) -> Calls {
        let heard = self.heard.get();
        let now = std::array::from_fn(|call| words.calls[call].load(Acquire));
        self.heard.set(now);
        Calls::new(std::array::from_fn(|call| now[call] != heard[call]))
    }

    /// Says how many answers this sleeper waits for: see [`Bell::ring_if_last`].
    pub fn expect(&self, answers: usize) {
        self.bells.words(self.sleeper).expected.store(answers as u32, Relaxed);
    }
}

/// Wakes a sleeper.
#[derive(Debug)]
pub struct Bell {
    bells: Bells,
    sleeper: Sleeper,
}

impl Bell {
    pub(crate) fn new(bells: Bells, sleeper: Sleeper) -> Self {
        Self { bells, sleeper }
    }

    /// Wakes as a role asks for it.
    pub fn notify(&self, notification: &Notification) {
        match notification.when {
            When::Always => self.ring(notification.call),
            When::LastAnswer { tick, or_first } => self.ring_if_last(notification.call, tick, or_first),
        }
    }

    /// Calls the sleeper.
    pub fn ring(&self, call: Call) {
        let words = self.bells.words(self.sleeper);
        words.calls[call as usize].fetch_add(1, AcqRel);
        words.rings.fetch_add(1, SeqCst);
        if words.asleep.load(SeqCst) > 0 {
            // An error is nothing to act on: who was not woken looks by itself before long.
            let _ = futex::wake(&words.rings, futex::Flags::empty(), i32::MAX as u32);
        }
    }

    /// Counts an answer to a tick, and calls the sleeper if it is the last that it waits for; or the first, if
    /// that is asked for.
    ///
    /// A count that a kill has left short costs a wait until the next repeat, which rings without
    /// counting; one that a restarted robot has made too high costs a wake-up.
    pub fn ring_if_last(&self, call: Call, tick: u64, or_first: bool) {
        let words = self.bells.words(self.sleeper);
        let counted = |answers: u64| Answers::from_bits(answers).with(tick).map(Answers::to_bits);
        let before = words.answers.fetch_update(AcqRel, Relaxed, counted).ok();
        let answers = before.and_then(|before| Answers::from_bits(before).with(tick));
        // Of a tick that is over: whoever needs it waits for nothing else.
        if answers.is_none_or(|answers| answers.call(words.expected.load(Relaxed).into(), or_first)) {
            self.ring(call);
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
        let run = run("bells-heard");
        let rounds = 50_000;
        let play = |prefix: &str, mine: Sleeper, other: Sleeper, begins: bool| {
            let bells = Bells::open(prefix).unwrap();
            let (bed, bell) = (Bed::new(bells.clone(), mine), Bell::new(bells, other));
            if begins {
                bell.ring(Call::Range);
            }
            for round in 0..rounds {
                let began = std::time::Instant::now();
                // It may return without a call, if the last ring was seen before it had ended.
                while !bed.sleep(LIMIT).has(Call::Range) {
                    assert!(began.elapsed() < LIMIT, "round {round}");
                }
                bell.ring(Call::Range);
            }
        };
        std::thread::scope(|scope| {
            let prefix = run.shared_memory_prefix();
            scope.spawn(move || play(prefix, Sleeper::Sim, Sleeper::Fusion, false));
            scope.spawn(move || play(prefix, Sleeper::Fusion, Sleeper::Sim, true));
        });
    }

    #[test]
    fn each_sleepers_words_have_a_cache_line_of_their_own() {
        let run = run("bells-lines");
        let bells = Bells::open(run.shared_memory_prefix()).unwrap();
        for sleeper in [Sleeper::Sim, Sleeper::Fusion, Sleeper::Robots] {
            assert_eq!(std::ptr::from_ref(bells.words(sleeper)).addr() % 64, 0, "{sleeper:?}");
        }
    }

    #[test]
    fn one_ring_wakes_all_who_sleep_in_one_place() {
        let run = run("bells-all");
        let prefix = run.shared_memory_prefix();
        std::thread::scope(|scope| {
            let sleepers: Vec<_> = (0..5)
                .map(|_| scope.spawn(|| Bed::new(Bells::open(prefix).unwrap(), Sleeper::Robots).sleep(LIMIT)))
                .collect();
            let bells = Bells::open(prefix).unwrap();
            while bells.words(Sleeper::Robots).asleep.load(SeqCst) < 5 {
                std::thread::yield_now();
            }
            Bell::new(bells, Sleeper::Robots).ring(Call::Finished);
            for sleeper in sleepers {
                let calls = sleeper.join().unwrap();
                assert!(calls.has(Call::Finished) && !calls.has(Call::Range));
            }
        });
    }

    #[test]
    fn of_the_answers_to_a_tick_the_last_one_rings() {
        let run = run("bells-last");
        let bells = Bells::open(run.shared_memory_prefix()).unwrap();
        let (bed, bell) = (Bed::new(bells.clone(), Sleeper::Fusion), Bell::new(bells, Sleeper::Fusion));
        bed.expect(3);
        let rings = |tick: u64, or_first: bool| {
            bell.ring_if_last(Call::Range, tick, or_first);
            bed.sleep(Duration::ZERO).has(Call::Range)
        };
        for tick in [0, 1, 7] {
            assert_eq!([0; 3].map(|_| rings(tick, false)), [false, false, true], "{tick}");
            // A robot that was started again answers again.
            assert!(rings(tick, false));
        }
        assert_eq!([0; 3].map(|_| rings(8, true)), [true, false, true]);
        assert!(rings(7, false), "of a tick that is over");
        // One is not waited for any more.
        bed.expect(2);
        assert_eq!([0; 2].map(|_| rings(9, false)), [false, true]);
    }
}

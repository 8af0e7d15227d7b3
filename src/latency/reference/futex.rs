//! Fan-in and fan-out over a block of shared memory: the last range wakes the centre, one system call all robots.

use std::sync::atomic::Ordering::{AcqRel, Acquire, Relaxed, Release};

use ::iceoryx2::prelude::{FileName, SemanticString, ZeroCopySend};
use anyhow::anyhow;
use iceoryx2_bb_concurrency::atomic::{AtomicU32, AtomicU64};
use iceoryx2_bb_posix::access_mode::AccessMode;
use iceoryx2_cal::dynamic_storage::posix_shared_memory::{Builder, Configuration, Storage};
use iceoryx2_cal::dynamic_storage::{DynamicStorage, DynamicStorageBuilder};
use iceoryx2_cal::named_concept::{NamedConceptBuilder, NamedConceptConfiguration};
use rangehound_shared::ROBOTS_MAX;
use rangehound_shared::rendezvous::Rendezvous;
use rustix::io::Errno;
use rustix::thread::futex;
use rustix::time::Timespec;

use super::{Command, RANGE_TICK, ROBOT, Range, Vigil, WAIT};

/// What the nodes share.
#[derive(Debug, ZeroCopySend)]
#[repr(C)]
#[type_name("rangehound.FutexReference.v1")]
struct Board {
    /// Ranges of all ticks.
    arrivals: AtomicU64,
    /// Ticks whose ranges are all there: the word that the centre sleeps on.
    full: AtomicU32,
    /// To a cache line's length.
    _padding: [u32; 13],
    /// Ticks that are answered: the word that the robots sleep on.
    round: AtomicU32,
    command: [AtomicU64; size_of::<Command>() / 8],
    ranges: [[AtomicU64; size_of::<Range>() / 8]; ROBOTS_MAX],
}

impl Board {
    fn new() -> Self {
        Self {
            arrivals: AtomicU64::new(0),
            full: AtomicU32::new(0),
            _padding: [0; 13],
            round: AtomicU32::new(0),
            command: std::array::from_fn(|_| AtomicU64::new(0)),
            ranges: std::array::from_fn(|_| std::array::from_fn(|_| AtomicU64::new(0))),
        }
    }
}

fn builder<'a>(prefix: &str) -> anyhow::Result<Builder<'a, Board>> {
    let prefix = FileName::new(prefix.as_bytes()).map_err(|error| refused(&error))?;
    let name = FileName::new(b"latency").map_err(|error| refused(&error))?;
    Ok(Builder::new(&name).config(&Configuration::default().prefix(&prefix)).has_ownership(false))
}

fn refused(reason: &dyn std::fmt::Debug) -> anyhow::Error {
    anyhow!("shared memory of the futex reference: iceoryx2 says {reason:?}")
}

/// Makes the block: before any node opens it. It goes with the run's other shared memory.
pub(super) fn create(run: &Rendezvous) -> anyhow::Result<()> {
    let builder = builder(run.shared_memory_prefix())?.initializer(|board, _| {
        board.write(Board::new());
        true
    });
    builder.create().map(drop).map_err(|error| refused(&error))
}

fn open(run: &Rendezvous) -> anyhow::Result<Storage<Board>> {
    builder(run.shared_memory_prefix())?.open(AccessMode::ReadWrite).map_err(|error| refused(&error))
}

/// Sleeps until the word has this value.
fn wait_for(word: &AtomicU32, value: u32, vigil: &mut Vigil<'_>) -> anyhow::Result<()> {
    let at_most = Timespec { tv_sec: 0, tv_nsec: WAIT.subsec_nanos().into() };
    loop {
        let now = word.load(Acquire);
        if now == value {
            vigil.end();
            return Ok(());
        }
        match futex::wait(word, futex::Flags::empty(), now, Some(&at_most)) {
            Ok(()) | Err(Errno::AGAIN) => {}
            Err(Errno::TIMEDOUT | Errno::INTR) => vigil.keep()?,
            Err(error) => return Err(error.into()),
        }
    }
}

pub(super) struct Centre<'a> {
    board: Storage<Board>,
    ranges: Vec<Range>,
    vigil: Vigil<'a>,
}

impl<'a> Centre<'a> {
    pub(super) fn open(run: &Rendezvous, vigil: Vigil<'a>) -> anyhow::Result<Self> {
        let robots = run.description().scenario.robots.len();
        Ok(Self { board: open(run)?, ranges: vec![Range::default(); robots], vigil })
    }
}

impl super::Centre for Centre<'_> {
    fn collect(&mut self, tick: u64) -> anyhow::Result<()> {
        let board = self.board.get();
        wait_for(&board.full, tick as u32, &mut self.vigil)?;
        for (range, words) in self.ranges.iter_mut().zip(&board.ranges) {
            *range = words.each_ref().map(|word| word.load(Relaxed));
            if range[RANGE_TICK] != tick {
                return Err(anyhow!(
                    "robot {}: expected the range of tick {tick}, got {}",
                    range[ROBOT],
                    range[RANGE_TICK]
                ));
            }
        }
        Ok(())
    }

    fn answer(&mut self, command: &Command) -> anyhow::Result<()> {
        let board = self.board.get();
        for (word, value) in board.command.iter().zip(command) {
            word.store(*value, Relaxed);
        }
        board.round.fetch_add(1, Release);
        futex::wake(&board.round, futex::Flags::empty(), i32::MAX as u32)?;
        Ok(())
    }
}

pub(super) struct Robot<'a> {
    board: Storage<Board>,
    robots: u64,
    vigil: Vigil<'a>,
}

impl<'a> Robot<'a> {
    pub(super) fn open(run: &Rendezvous, vigil: Vigil<'a>) -> anyhow::Result<Self> {
        Ok(Self { board: open(run)?, robots: run.description().scenario.robots.len() as u64, vigil })
    }
}

impl super::Robot for Robot<'_> {
    fn publish(&mut self, range: &Range) -> anyhow::Result<()> {
        let board = self.board.get();
        for (word, value) in board.ranges[range[ROBOT] as usize].iter().zip(range) {
            word.store(*value, Relaxed);
        }
        if (board.arrivals.fetch_add(1, AcqRel) + 1).is_multiple_of(self.robots) {
            board.full.fetch_add(1, Release);
            futex::wake(&board.full, futex::Flags::empty(), 1)?;
        }
        Ok(())
    }

    fn command(&mut self, tick: u64) -> anyhow::Result<Command> {
        let board = self.board.get();
        wait_for(&board.round, tick as u32, &mut self.vigil)?;
        Ok(board.command.each_ref().map(|word| word.load(Relaxed)))
    }
}

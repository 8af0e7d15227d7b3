//! Fan-in and fan-out over a block of shared memory: the last range wakes the centre, one system call wakes all robots.

use std::sync::atomic::Ordering::{AcqRel, Acquire, Relaxed, Release};
use std::time::{Duration, Instant};

use ::iceoryx2::prelude::ZeroCopySend;
use anyhow::{anyhow, bail};
use iceoryx2_bb_concurrency::atomic::{AtomicU32, AtomicU64};
use rangehound_node::block::{Block, BlockError};
use rangehound_node::rendezvous::Rendezvous;
use rangehound_node::system::signal::Termination;
use rangehound_shared::ROBOTS_MAX;
use rustix::io::Errno;
use rustix::thread::futex;

use super::{Command, RANGE_TICK, ROBOT, Range, WAIT};

/// Name of the block that the nodes share.
const NAME: &str = "latency";

/// The shared data of the nodes.
#[derive(Debug, ZeroCopySend)]
#[repr(C)]
#[type_name("rangehound.FutexReference.v1")]
struct Board {
    /// Ranges of all ticks.
    arrivals: AtomicU64,
    /// Ticks whose ranges are complete: the word on which the centre waits.
    full: AtomicU32,
    /// 1 once the exchange is abandoned.
    given_up: AtomicU32,
    /// Padding to a cache line.
    _padding: [u32; 12],
    /// Ticks that are answered: the word on which the robots wait.
    round: AtomicU32,
    command: [AtomicU64; size_of::<Command>() / 8],
    ranges: [[AtomicU64; size_of::<Range>() / 8]; ROBOTS_MAX],
}

impl Board {
    fn new() -> Self {
        Self {
            arrivals: AtomicU64::new(0),
            full: AtomicU32::new(0),
            given_up: AtomicU32::new(0),
            _padding: [0; 12],
            round: AtomicU32::new(0),
            command: std::array::from_fn(|_| AtomicU64::new(0)),
            ranges: std::array::from_fn(|_| std::array::from_fn(|_| AtomicU64::new(0))),
        }
    }
}

fn refused(reason: BlockError) -> anyhow::Error {
    anyhow!("the shared memory of the futex reference {reason}")
}

/// Creates the block, before any node opens it.
pub(super) fn create(run: &Rendezvous) -> anyhow::Result<()> {
    Block::create(run.shared_memory_prefix(), NAME, Board::new).map_err(refused)
}

fn open(run: &Rendezvous) -> anyhow::Result<Block<Board>> {
    Block::open(run.shared_memory_prefix(), NAME).map_err(refused)
}

/// Waits until the word has this value. It has no time-out, because that would cost a timer for each wait: the watch ends
/// the wait instead.
fn wait_for(board: &Board, word: &AtomicU32, value: u32) -> anyhow::Result<()> {
    loop {
        let now = word.load(Acquire);
        if now == value {
            return Ok(());
        }
        if board.given_up.load(Relaxed) != 0 {
            bail!("ended before the last tick: on request, or because the other nodes went silent");
        }
        match futex::wait(word, futex::Flags::empty(), now, None) {
            Ok(()) | Err(Errno::AGAIN | Errno::INTR) => {}
            Err(error) => return Err(error.into()),
        }
    }
}

/// Watches the exchange in the background. Abandons it, for all nodes, when this node is asked to end or no message
/// has come for the time `silence`.
fn watch(board: Block<Board>, termination: &Termination, silence: Duration) -> std::io::Result<()> {
    let termination = termination.clone();
    let watched = std::thread::Builder::new().spawn(move || {
        let board: &Board = &board;
        let (mut heard, mut since) = ((0, 0), Instant::now());
        loop {
            std::thread::sleep(WAIT);
            let now = (board.arrivals.load(Relaxed), board.round.load(Relaxed));
            // Until the first range, all nodes wait for the start.
            if now != heard || now.0 == 0 {
                (heard, since) = (now, Instant::now());
            }
            if termination.requested() || since.elapsed() > silence {
                board.given_up.store(1, Relaxed);
                // Repeated, because a node may have been about to wait.
                for word in [&board.full, &board.round] {
                    let _ = futex::wake(word, futex::Flags::empty(), i32::MAX as u32);
                }
            }
        }
    });
    watched.map(drop)
}

pub(super) struct Centre {
    board: Block<Board>,
    ranges: Vec<Range>,
}

impl Centre {
    pub(super) fn open(run: &Rendezvous, termination: &Termination, silence: Duration) -> anyhow::Result<Self> {
        watch(open(run)?, termination, silence)?;
        let robots = run.description().scenario.robots.len();
        Ok(Self { board: open(run)?, ranges: vec![Range::default(); robots] })
    }
}

impl super::Centre for Centre {
    fn collect(&mut self, tick: u64) -> anyhow::Result<()> {
        let board: &Board = &self.board;
        wait_for(board, &board.full, tick as u32)?;
        for (range, words) in self.ranges.iter_mut().zip(&board.ranges) {
            *range = words.each_ref().map(|word| word.load(Relaxed));
            if range[RANGE_TICK] != tick {
                return Err(anyhow!(
                    "a range of robot {} is not of tick {tick}, but of {}",
                    range[ROBOT],
                    range[RANGE_TICK]
                ));
            }
        }
        Ok(())
    }

    fn answer(&mut self, command: &Command) -> anyhow::Result<()> {
        let board: &Board = &self.board;
        for (word, value) in board.command.iter().zip(command) {
            word.store(*value, Relaxed);
        }
        board.round.fetch_add(1, Release);
        futex::wake(&board.round, futex::Flags::empty(), i32::MAX as u32)?;
        Ok(())
    }
}

pub(super) struct Robot {
    board: Block<Board>,
    robots: u64,
}

impl Robot {
    pub(super) fn open(run: &Rendezvous, termination: &Termination, silence: Duration) -> anyhow::Result<Self> {
        watch(open(run)?, termination, silence)?;
        Ok(Self { board: open(run)?, robots: run.description().scenario.robots.len() as u64 })
    }
}

impl super::Robot for Robot {
    fn publish(&mut self, range: &Range) -> anyhow::Result<()> {
        let board: &Board = &self.board;
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
        let board: &Board = &self.board;
        wait_for(board, &board.round, tick as u32)?;
        Ok(board.command.each_ref().map(|word| word.load(Relaxed)))
    }
}

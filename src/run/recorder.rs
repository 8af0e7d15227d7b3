//! `record`: writes a run into one file during the run, and ends with it.
//!
//! It reads the nodes' logs, some ticks behind them. The run does not notice it. However far it falls behind, it misses no tick
//! and needs no more memory. If it is killed, another one starts from the first tick and loses nothing.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rangehound_node::rendezvous::{Rendezvous, RunDescription};
use rangehound_node::system::signal::Termination;
use rangehound_shared::run_name::RunName;
use rangehound_shared::scenario::Clock;
use rustix::thread::{Timespec, nanosleep};
use serde::Serialize;

use crate::failure::{self, Failure};
use crate::files::layout::RECORDING;
use crate::files::out_folder;
use crate::results::frame::{Frame, Frames, UNSETTLED_TICKS};
use crate::results::made;
use crate::results::ros_bag::folder::BagFolder;
use crate::results::run_mcap::file::{FewerTicks, RunFile, unusable};
use crate::results::run_mcap::write::Written;
use crate::run::folder;
use crate::run::node;
use crate::run::watch::{self, POLL_INTERVAL, Progress};

/// After a request to end, ticks that are in the logs are recorded for this long.
const CATCH_UP: Duration = Duration::from_secs(5);

/// Work that takes longer shows its progress.
const UNEXPLAINED: Duration = Duration::from_secs(1);

/// Megabytes as bytes.
#[must_use]
pub fn bytes(megabytes: u64) -> u64 {
    megabytes.saturating_mul(1_000_000)
}

/// Where a run is recorded.
#[derive(Debug, Clone, Copy)]
pub enum Out<'a> {
    /// In `run.mcap` of the run folder.
    Default,
    /// In another file of the same form.
    File(&'a Path),
    /// In the folder of a ROS 2 bag.
    Bag(&'a Path),
}

/// Records a run that is over, from its folder.
///
/// # Errors
/// [`Failure`].
pub fn record_folder(folder: &Path, out: Out<'_>, bytes_max: u64) -> Result<Recorded, Failure> {
    let termination = Termination::listen()?;
    let description = folder::read_description(folder)?;
    // A living run writes this recording itself.
    let _alone = (!matches!(out, Out::File(_))).then(|| out_folder::lock_finished(folder)).transpose()?;
    record_logs(&description, out, bytes_max, &termination)
}

/// Records a living run; `None` if it was asked to end before it could join.
///
/// # Errors
/// [`Failure`].
pub fn record_run(name: &RunName, out: Out<'_>, bytes_max: u64) -> Result<Option<Recorded>, Failure> {
    let termination = Termination::listen()?;
    let rendezvous = node::observe(c"rh-recorder", name, &termination)?;
    rendezvous.map(|rendezvous| follow(&rendezvous.observe(), out, bytes_max, &termination)).transpose()
}

/// The outcome of a recording; its fields are the keys of `--json`.
#[derive(Debug, Serialize)]
pub struct Recorded {
    /// The file; none if there was nothing to record.
    file: Option<String>,
    scenario: String,
    /// The last recorded tick, and the last tick of the whole run.
    ticks: Option<u64>,
    ticks_of_run: u64,
    /// Earlier ticks that are not in the logs.
    ticks_lost: u64,
    /// True if it ended at its size limit.
    is_full: bool,
}

impl Recorded {
    /// Prints it.
    ///
    /// # Errors
    /// [`Failure`] if it cannot be printed.
    pub fn print(&self, json: bool) -> Result<(), Failure> {
        let Self { file, ticks, ticks_of_run, .. } = self;
        match (json, file, ticks) {
            (true, _, _) => failure::print_json(self),
            (false, Some(file), Some(ticks)) => {
                failure::print(format_args!("recorded: {ticks} of {ticks_of_run} ticks in {file}\n"))
            }
            // A warning has reported this.
            (false, _, _) => Ok(()),
        }
    }
}

/// Records the ticks in the logs of a run.
///
/// # Errors
/// [`Failure`] if there are none, or the file cannot be written.
pub fn record_logs(
    description: &RunDescription,
    out: Out<'_>,
    bytes_max: u64,
    termination: &Termination,
) -> Result<Recorded, Failure> {
    let mut recorder = Recorder::begin(description, out, bytes_max)?;
    recorder.catch_up(termination)?;
    recorder.finish()
}

/// Records a run until its end, or until asked to end.
fn follow(
    rendezvous: &Rendezvous,
    out: Out<'_>,
    bytes_max: u64,
    termination: &Termination,
) -> Result<Recorded, Failure> {
    let description = rendezvous.description().clone();
    let mut recorder = Recorder::begin(&description, out, bytes_max)?;
    // A run in lock step uses all processors, and recording would slow it down: it is recorded after its end.
    let goes_along = description.scenario.clock == Clock::Realtime;
    while !rendezvous.is_finished() && !termination.requested() {
        if goes_along {
            recorder.advance_to_settled()?;
        }
        if recorder.is_full {
            return recorder.finish();
        }
        sleep(POLL_INTERVAL);
    }
    if !watch::wait_for_last_estimate(rendezvous) && !rendezvous.is_finished() {
        recorder.advance_to_settled()?;
        log::warn!("the recording was asked to end before the run: it has no tick from {} on", recorder.next);
    } else {
        recorder.catch_up(termination)?;
    }
    recorder.finish()
}

/// Sleeps until the time is over or a signal comes.
fn sleep(time: Duration) {
    let _ = nanosleep(&Timespec { tv_sec: time.as_secs().cast_signed(), tv_nsec: time.subsec_nanos().into() });
}

/// The file or folder in the making.
enum Growing {
    File(Box<RunFile>),
    Bag(Box<BagFolder>),
}

impl Growing {
    fn write(&mut self, frame: &Frame) -> anyhow::Result<Written> {
        match self {
            Self::File(file) => file.write(frame),
            Self::Bag(bag) => bag.write(frame),
        }
    }

    fn flush_if_due(&mut self) -> anyhow::Result<()> {
        match self {
            Self::File(file) => file.flush_if_due(),
            // Without its metadata a bag is of no use before its end.
            Self::Bag(_) => Ok(()),
        }
    }

    fn finish(self) -> anyhow::Result<()> {
        match self {
            Self::File(file) => file.finish(),
            Self::Bag(bag) => bag.finish(),
        }
    }

    /// Makes a failure that a restart would not repair: the run continues without a recording.
    fn unwritable(&self) -> fn(anyhow::Error) -> Failure {
        match self {
            Self::File(_) => |error| {
                let keeps = "`rangehound replay --repair` keeps what was recorded";
                Failure::input(format!("the recording ends early: {error:#}: {keeps}"))
            },
            Self::Bag(_) => |error| Failure::input(format!("the bag cannot be written: {error:#}")),
        }
    }

    fn discard(self) {
        match self {
            Self::File(file) => file.discard(),
            Self::Bag(bag) => bag.discard(),
        }
    }
}

/// A recording in the making.
struct Recorder<'a> {
    description: &'a RunDescription,
    frames: Option<Frames>,
    file: Growing,
    path: PathBuf,
    bytes_max: u64,
    /// The next tick to record.
    next: u64,
    /// The last recorded tick.
    last: Option<u64>,
    /// The number of ticks that are not in the logs, and the first of them.
    holes: (u64, u64),
    is_full: bool,
}

impl<'a> Recorder<'a> {
    fn begin(description: &'a RunDescription, out: Out<'_>, bytes_max: u64) -> Result<Self, Failure> {
        let (path, is_bag) = match out {
            Out::Default => (description.out_dir.join(RECORDING), false),
            Out::File(path) => (path.to_owned(), false),
            Out::Bag(path) => (path.to_owned(), true),
        };
        if !is_bag && path.is_dir() {
            return Err(Failure::input(format!("{} is a folder (--out): expected the name of a file", path.display())));
        }
        let file = if is_bag {
            Growing::Bag(Box::new(BagFolder::begin(&path, description, bytes_max)?))
        } else {
            Growing::File(Box::new(RunFile::begin(&path, description, bytes_max).map_err(unusable)?))
        };
        Ok(Self {
            description,
            frames: None,
            file,
            path,
            bytes_max,
            next: 0,
            last: None,
            holes: (0, 0),
            is_full: false,
        })
    }

    /// The newest tick that is in the logs, if there are any.
    fn newest(&mut self) -> Result<Option<u64>, Failure> {
        if self.frames.is_none() {
            // A run that has just started has no logs.
            self.frames = Frames::open(self.description).ok();
        }
        Ok(match &self.frames {
            Some(frames) => frames.newest_tick()?,
            None => None,
        })
    }

    /// Records the ticks that are final: no late range changes them any more.
    fn advance_to_settled(&mut self) -> Result<(), Failure> {
        if let Some(settled) = self.newest()?.and_then(|newest| newest.checked_sub(UNSETTLED_TICKS as u64)) {
            while self.next <= settled && !self.is_full {
                self.advance()?;
            }
        }
        let unwritable = self.file.unwritable();
        self.file.flush_if_due().map_err(unwritable)
    }

    /// Records all ticks that are left, after the run.
    fn catch_up(&mut self, termination: &Termination) -> Result<(), Failure> {
        let Some(newest) = self.newest()? else { return Ok(()) };
        let began = Instant::now();
        let mut asked: Option<Instant> = None;
        let mut progress = Progress::new("recording tick", newest);
        while self.next <= newest && !self.is_full {
            self.advance()?;
            if self.next.is_multiple_of(256) {
                if began.elapsed() > UNEXPLAINED {
                    progress.show(self.next, "");
                }
                if termination.requested() && asked.get_or_insert_with(Instant::now).elapsed() > CATCH_UP {
                    log::warn!(
                        "the recording was stopped early: it ends before tick {}: `rangehound record {}` writes a complete one",
                        self.next,
                        made::from_here(&self.description.out_dir).display()
                    );
                    break;
                }
            }
        }
        progress.finish();
        Ok(())
    }

    /// Records the next tick.
    fn advance(&mut self) -> Result<(), Failure> {
        let tick = self.next;
        let Some(frames) = &mut self.frames else { return Ok(()) };
        match frames.at(tick)? {
            Some(frame) => match self.file.write(&frame).map_err(self.file.unwritable())? {
                Written::Taken => self.last = Some(tick),
                Written::Full => {
                    let limit_mb = self.bytes_max / 1_000_000;
                    log::warn!(
                        "{} has reached {limit_mb} MB (--record-limit): nothing is recorded from tick {tick} on",
                        self.path.display()
                    );
                    self.is_full = true;
                    return Ok(());
                }
            },
            None => {
                let (count, first) = self.holes;
                self.holes = (count + 1, if count == 0 { tick } else { first });
            }
        }
        self.next += 1;
        Ok(())
    }

    fn finish(self) -> Result<Recorded, Failure> {
        let Self { description, file, path, last, holes: (lost, first), is_full, .. } = self;
        if lost > 0 {
            log::warn!("{lost} ticks, the first of them {first}, are missing in the logs, and so in the recording");
        }
        if last.is_none() {
            file.discard();
            log::warn!("no recording {}: the run has written no logs", path.display());
        } else {
            let unwritable = file.unwritable();
            file.finish().map_err(|error| match error.downcast::<FewerTicks>() {
                Ok(fewer) => Failure::input(fewer),
                Err(error) => unwritable(error),
            })?;
        }
        Ok(Recorded {
            file: last.map(|_| made::from_here(&path).display().to_string()),
            scenario: description.scenario.name.clone(),
            ticks: last,
            ticks_of_run: description.scenario.ticks,
            ticks_lost: lost,
            is_full,
        })
    }
}

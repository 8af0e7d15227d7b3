//! Follows a run until its end for the page; reads files only.

use std::time::{Duration, Instant};

use rangehound_node::rendezvous::{Rendezvous, Role};
use rangehound_node::system::signal::Termination;
use rangehound_shared::message::Estimate;
use serde_json::Value;

use super::POLL_INTERVAL;
use super::scene::Scene;
use super::server::Server;
use crate::results::frame::{Frame, Frames};
use crate::run::remote::Status;
use crate::run::watch;

/// Interval at which the states of the processes are read, and its increase per robot.
const NODES: Duration = Duration::from_millis(250);
const NODES_PER_ROBOT: Duration = Duration::from_millis(5);

/// Most robots in all ticks of one look together; beyond it, some ticks are left out.
const ROBOTS_PER_LOOK_MAX: u64 = 1_000;

/// The same for the first look, which reads the run so far: some tenths of a second.
const ROBOTS_OF_PAST_MAX: u64 = 200_000;

/// Ticks that are added at once; viewers are answered in between.
const TICKS_AT_ONCE: usize = 256;

/// A run without any process for this long has ended, whatever its state.
const NO_PROCESS_MAX: Duration = Duration::from_secs(3);

/// If Ctrl-C interrupts run and page together, the run reports its end within this time.
const INTERRUPTED: Duration = Duration::from_millis(500);
const INTERRUPTED_POLL: Duration = Duration::from_millis(10);

/// Shows the run until its end; returns the reason of the end.
pub(super) fn follow(run: &Rendezvous, server: &Server, termination: &Termination) -> &'static str {
    let scenario = &run.description().scenario;
    let robots = u32::try_from(scenario.robots.len()).unwrap_or(u32::MAX);
    let nodes_every = NODES + NODES_PER_ROBOT * robots;
    let mut reader = Reader { frames: None, next: None };
    let (mut nodes_at, mut inhabited, mut has_been_inhabited) = (None, Instant::now(), false);
    loop {
        // Checked before reading, so that everything up to the end is read.
        let is_finished = run.is_finished();
        let is_asked = !is_finished && termination.requested();
        let is_over = is_finished || is_asked && ends_soon(run);
        if is_over {
            watch::wait_for_last_estimate(run);
        }
        if is_over || nodes_at.is_none_or(|at: Instant| at.elapsed() >= nodes_every) {
            nodes_at = Some(Instant::now());
            let status = Status::of(run);
            if status.has_processes() {
                (inhabited, has_been_inhabited) = (Instant::now(), true);
            }
            show_nodes(server, &status, is_over);
        }
        reader.look(run, server);
        let has_no_processes = has_been_inhabited && inhabited.elapsed() >= NO_PROCESS_MAX;
        if is_over || has_no_processes {
            reader.finish(server);
        }
        if is_finished {
            return "finished";
        }
        if is_over {
            return "ended early";
        }
        if is_asked {
            return "the page was ended; the run may continue";
        }
        if has_no_processes {
            show_nodes(server, &Status::of(run), true);
            return "ended early: all processes are gone";
        }
        std::thread::sleep(POLL_INTERVAL);
    }
}

/// True if the run ends before its last tick; false if only the page is asked to end.
fn ends_soon(run: &Rendezvous) -> bool {
    let asked = Instant::now();
    loop {
        if run.is_ending() {
            return true;
        }
        // A run started by hand has no supervisor to report it.
        if !run.roster().is_held(Role::Supervisor) || asked.elapsed() >= INTERRUPTED {
            return false;
        }
        std::thread::sleep(INTERRUPTED_POLL);
    }
}

fn show_nodes(server: &Server, status: &Status, is_over: bool) {
    let Ok(mut status) = serde_json::to_value(status) else { return };
    if is_over {
        mark_as_ended(&mut status);
    }
    server.update(|scene| scene.set_nodes(status));
}

/// Shows all nodes as ended: their state is not read again.
fn mark_as_ended(status: &mut Value) {
    for node in status.get_mut("nodes").and_then(Value::as_array_mut).into_iter().flatten() {
        let Some(node) = node.as_object_mut() else { continue };
        node.insert("state".to_owned(), "ended".into());
        for of_process in ["pid", "silent_s", "resident_kb"] {
            node.insert(of_process.to_owned(), Value::Null);
        }
    }
}

/// Reads the frames that are new since the last look.
struct Reader {
    frames: Option<Frames>,
    /// The first tick that was not read; `None` before the first look.
    next: Option<u64>,
}

impl Reader {
    fn look(&mut self, run: &Rendezvous, server: &Server) {
        // The logs exist once the nodes have started.
        if self.frames.is_none() {
            self.frames = Frames::open(run.description()).ok();
        }
        let newest = self.frames.as_ref().and_then(|frames| frames.newest_tick().ok()?);
        let (Some(frames), Some(newest)) = (&mut self.frames, newest) else { return };
        count_anew(frames, server);
        let robots = (run.description().scenario.robots.len() as u64).max(1);
        let is_first = self.next.is_none();
        let most = if is_first { ROBOTS_OF_PAST_MAX / robots } else { (ROBOTS_PER_LOOK_MAX / robots).max(5) };
        let take = |scene: &mut Scene, new: &mut Vec<Frame>| {
            new.drain(..).for_each(|frame| if is_first { scene.recall(frame) } else { scene.add(frame) });
        };
        let (mut new, mut is_new) = (Vec::new(), false);
        for tick in spread(self.next.unwrap_or(0), newest, most) {
            // A tick that cannot be read now is left out, like ticks that were not recorded.
            if let Ok(Some(frame)) = frames.at(tick) {
                new.push(frame);
                is_new = true;
            } else if let Ok(Some(estimate)) = frames.estimate(tick) {
                server.keep(|scene| {
                    take(scene, &mut new);
                    scene.count_ranges(tick, &estimate);
                });
            }
            if new.len() >= TICKS_AT_ONCE {
                server.keep(|scene| take(scene, &mut new));
            }
        }
        self.next = Some(newest + 1);
        let look = |scene: &mut Scene| {
            take(scene, &mut new);
            scene.looked(Instant::now());
        };
        if is_new { server.update(look) } else { server.keep(look) }
    }

    /// Counts fusion's last recorded ticks that the simulator has not recorded.
    fn finish(&mut self, server: &Server) {
        let (Some(frames), Some(next)) = (&mut self.frames, self.next) else { return };
        count_anew(frames, server);
        let newest = frames.newest_estimate().ok().flatten();
        for tick in newest.into_iter().flat_map(|newest| spread(next, newest, ROBOTS_PER_LOOK_MAX)) {
            if let Ok(Some(estimate)) = frames.estimate(tick) {
                server.keep(|scene| scene.count_ranges(tick, &estimate));
            }
        }
    }
}

/// Reads ticks again that may have changed since.
fn count_anew(frames: &mut Frames, server: &Server) {
    let mut unsettled = Vec::new();
    server.keep(|scene| unsettled = scene.unsettled());
    let again: Vec<(u64, Estimate)> =
        unsettled.into_iter().filter_map(|tick| Some((tick, frames.estimate(tick).ok()??))).collect();
    server.keep(|scene| again.iter().for_each(|(tick, estimate)| scene.count_ranges(*tick, estimate)));
}

/// The ticks of a look, at most `most`: evenly spread, and always with the newest.
fn spread(next: u64, newest: u64, most: u64) -> impl Iterator<Item = u64> {
    let count = (newest + 1).saturating_sub(next);
    let taken = count.min(most);
    // Each chosen tick is the last of an equal share.
    (1..=taken).map(move |n| next + (u128::from(count) * u128::from(n) / u128::from(taken)) as u64 - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_ticks_are_looked_at_or_few_evenly_and_the_newest() {
        assert!(spread(5, 9, 10).eq(5..=9));
        assert!(spread(0, 99, 4).eq([24, 49, 74, 99]));
        assert!(spread(10, 10, 4).eq([10]));
        assert_eq!(spread(11, 10, 4).count(), 0);
        assert_eq!(spread(0, u64::MAX - 1, 3).last(), Some(u64::MAX - 1));
    }
}

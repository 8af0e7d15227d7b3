//! Runs the processes of a run, and runs them again if the run's shared memory is removed. Then all of them end, the
//! run is created again under its own id, and they go on from its checkpoints as after `resume`.

use anyhow::anyhow;
use rangehound_node::bus::Bus;
use rangehound_node::rendezvous::{ENDING_NOTE, LIVE_NOTE, Rendezvous, Role};
use rangehound_node::system::signal::Termination;

use super::cleaner::Cleaner;
use super::losses::Losses;
use super::nodes::{Ended, Nodes};
use super::sidecars::Sidecars;
use super::waiting::Waiting;
use super::{Gateway, Supervision};
use crate::failure::Failure;
use crate::results::report::NodeSummary;
use crate::run::node::input_or_running;
use crate::run::watch::Watch;

/// Shared memory that is removed this often in a row, each time before a tick is over, is not made again.
const REMOVALS_MAX: u32 = 5;

/// Runs the nodes until the run ends, and again from its checkpoints whenever its shared memory was removed.
pub(super) fn run_to_the_end(
    rendezvous: Rendezvous,
    supervision: &Supervision,
    gateway: Option<&Gateway>,
    termination: &Termination,
) -> Result<(Vec<NodeSummary>, anyhow::Result<()>), Failure> {
    let mut rendezvous = rendezvous;
    let mut past = Past::default();
    let mut removals_in_a_row = 0;
    let mut removed: Option<String> = None;
    loop {
        let outcome_of_nodes = run_once(&rendezvous, supervision, gateway, termination, &mut past);
        if outcome_of_nodes.is_err() {
            // Nodes that others have started may have joined already.
            let _ = rendezvous.write_note(ENDING_NOTE, "");
        }
        let with_cause = |error: anyhow::Error| match &removed {
            Some(cause) if past.newest_tick.is_none() && !termination.requested() => error.context(cause.clone()),
            _ => error,
        };
        let path = match outcome_of_nodes {
            Ok(Ended::Finished) => return Ok((past.summaries, Ok(()))),
            Ok(Ended::Removed(path)) => path,
            // It was removed before the supervisor could check for it.
            Err(Failure::Running(_)) if rendezvous.is_removed() && !termination.requested() => {
                rendezvous.iceoryx2_config_path()
            }
            Err(Failure::Running(error)) if removed.is_some() => {
                let outcome = Err(with_cause(error));
                return Ok((past.summaries, outcome));
            }
            Err(Failure::Running(error)) if !past.summaries.is_empty() => return Ok((past.summaries, Err(error))),
            Err(failure) => return Err(failure),
        };
        let what = format!("shared memory of run {} was removed from outside ({})", rendezvous.name(), path.display());
        removals_in_a_row = if past.newest_tick.is_some() { 0 } else { removals_in_a_row + 1 };
        if removals_in_a_row >= REMOVALS_MAX {
            return Ok((
                past.summaries,
                Err(anyhow!(
                    "{what} {REMOVALS_MAX} times before a tick ended: find what removes it, then `rangehound resume`"
                )),
            ));
        }
        log::warn!(
            "{what}, as systemd does at a user's last logout with RemoveIPC=yes; the run goes on from its checkpoints"
        );
        let starts = past.starts();
        rendezvous = match rendezvous.recreate(&starts) {
            Ok(again) => again,
            Err(error) => {
                let error = anyhow::Error::new(error).context(format!("{what}, and cannot be made again"));
                return Ok((past.summaries, Err(error)));
            }
        };
        removed = Some(format!("{what}, and it cannot go on from its checkpoints"));
    }
}

/// Starts all processes of the run and supervises them until the run ends, or until its shared memory is removed.
fn run_once(
    rendezvous: &Rendezvous,
    supervision: &Supervision,
    gateway: Option<&Gateway>,
    termination: &Termination,
    past: &mut Past,
) -> Result<Ended, Failure> {
    let description = rendezvous.description();
    let lease = rendezvous.roster().take(Role::Supervisor).map_err(input_or_running)?;
    past.supervisor_starts = lease.incarnation;
    past.newest_tick = None;
    std::thread::scope(|scope| {
        let bus = Bus::connect(rendezvous, "observer")?;
        let mut watch = Watch::new(&bus, description.scenario.ticks)?;
        let cleaner = Cleaner::start(rendezvous, scope);
        let mut nodes = Nodes::start(rendezvous, &lease, (supervision, gateway), cleaner, past.summaries.clone())?;
        let mut sidecars = Sidecars::of(rendezvous, &lease);
        if let Some(limit_mb) = supervision.record_limit_mb {
            sidecars.start("record", vec!["--record-limit".to_owned(), limit_mb.to_string()]);
        }
        if let Some(port) = supervision.live {
            // The page keeps its address.
            if let Some(address) = &past.live_address {
                let _ = rendezvous.write_note(LIVE_NOTE, address);
            }
            let port = port.map(|port| ["--port".to_owned(), port.to_string()]);
            sidecars.start("live", port.into_iter().flatten().collect());
        }
        let mut losses = Losses::new(description);
        let mut waiting = Waiting::new(rendezvous, supervision, gateway);
        let mut has_warned = false;
        let outcome = nodes.supervise(termination, || {
            // A run does not end because its progress cannot be shown.
            if let Err(error) = watch.look()
                && !std::mem::replace(&mut has_warned, true)
            {
                log::warn!("progress cannot be shown: {error}");
            }
            losses.look(watch.newest_ticks());
            waiting.look(watch.newest_ticks());
            sidecars.look();
            if supervision.live.is_some() {
                past.live_address = rendezvous.note(LIVE_NOTE).or_else(|| past.live_address.take());
            }
        });
        past.newest_tick = watch.newest_ticks().fusion;
        if let Ok(Ended::Removed(_)) = outcome {
            watch.finish();
            sidecars.kill();
            nodes.kill()?;
        } else {
            // Without the note, observers would take it for a run whose nodes have died.
            let _ = rendezvous.write_note(ENDING_NOTE, "");
            nodes.end(rendezvous.is_finished());
            watch.finish();
            sidecars.end(termination);
        }
        past.leads = nodes.leads();
        past.summaries = nodes.into_summaries();
        Ok(outcome?)
    })
}

/// State of a run that outlasts the removal of its shared memory.
#[derive(Debug, Default)]
struct Past {
    summaries: Vec<NodeSummary>,
    supervisor_starts: u64,
    /// How often the lead has been taken, also by standbys.
    leads: u64,
    /// Port and token of the live page.
    live_address: Option<String>,
    /// The newest tick that fusion has published since the nodes were started.
    newest_tick: Option<u64>,
}

impl Past {
    /// How often each role has been taken.
    fn starts(&self) -> Vec<(Role, u64)> {
        let of_node = |node: &NodeSummary| Some((node.name.parse::<Role>().ok()?, node.starts));
        let nodes = self.summaries.iter().filter_map(of_node).map(|(role, starts)| match role {
            Role::Fusion => (role, starts.max(self.leads)),
            role => (role, starts),
        });
        nodes.chain([(Role::Supervisor, self.supervisor_starts)]).collect()
    }
}

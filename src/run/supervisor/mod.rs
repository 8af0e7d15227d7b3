//! `run`, `resume` and `track`: starts the nodes of a run, watches them, ends them, and reports.

mod cleaner;
pub(crate) mod deaths;
mod losses;
pub(crate) mod machine;
mod nodes;
mod removal;
pub mod restart;
mod sidecars;
pub(crate) mod silence;

use std::path::Path;

use anyhow::anyhow;
use rangehound_node::rendezvous::Rendezvous;
use rangehound_node::system::signal::Termination;
use rangehound_shared::run_name::RunName;

use crate::failure::Failure;
use crate::files::out_folder::{self, Claim};
use crate::results::made::{self, Keep};
use crate::run::experiment::Experiment;
use crate::run::folder;
use crate::run::in_process;
use crate::run::node::input_or_running;
use crate::run::pin::Pin;
use crate::run::port;
use crate::run::recorder;
use crate::run::watch::Progress;
use removal::go_on_until_the_end;
use restart::Rule;

/// Who is started beside the nodes of a run, and what is done when one of them ends.
#[derive(Debug, Default)]
pub struct Supervision {
    /// Fusion processes that stand by.
    pub standbys: usize,
    /// Who is started again.
    pub rules: Vec<Rule>,
    /// Processors for all.
    pub pin: Pin,
    /// Whether a page shows the run, and at which port, if not at any.
    pub live: Option<Option<u16>>,
    /// How large a recording may become, MB; `None` where there is none.
    pub record_limit_mb: Option<u64>,
}

/// Goes on with a run all of whose processes are gone.
///
/// # Errors
/// [`Failure`].
pub fn resume(folder: &Path, name: Option<&RunName>, supervision: &Supervision, keep: &Keep) -> Result<(), Failure> {
    let description = folder::read_description(folder)?;
    let name = match name {
        Some(name) => name.clone(),
        None => description.scenario.name.parse().map_err(|error| Failure::input(format!("--name: {error}")))?,
    };
    let found = || {
        let rendezvous = Rendezvous::found(&name, description.clone()).map_err(input_or_running)?;
        Ok((rendezvous, folder::look_for_writable(&description)?))
    };
    supervise(supervision, keep, found)
}

/// Runs an experiment with a process for each node.
///
/// # Errors
/// [`Failure`].
pub fn run(mut experiment: Experiment, supervision: &Supervision, keep: &Keep) -> Result<(), Failure> {
    // What has been read is let go of once its copy is written.
    supervise(supervision, keep, move || {
        // Only who has the name may touch the folder.
        let rendezvous = experiment.found()?;
        let folder = folder::prepare_folder(&experiment)?;
        Ok((rendezvous, folder))
    })
}

/// Runs an experiment in this process, and records it if its recording may have any megabytes.
///
/// # Errors
/// [`Failure`].
pub fn run_in_process(experiment: &Experiment, record_limit_mb: Option<u64>, keep: &Keep) -> Result<(), Failure> {
    let description = &experiment.description;
    let _folder = folder::prepare_folder(experiment)?;
    let mut progress = Progress::new("tick", description.scenario.ticks);
    in_process::run(description, |tick| {
        if tick > 0 && tick % 4_096 == 0 {
            progress.show(tick, "in one process");
        }
    })?;
    progress.finish();
    if let Some(limit_mb) = record_limit_mb {
        recorder::record_logs(description, None, recorder::bytes(limit_mb), &Termination::listen()?)?;
    }
    let reported = made::report_and_tables(description, keep, Vec::new());
    out_folder::seal(&description.out_dir);
    reported.map(drop)
}

/// Founds a run in its folder, starts its processes, sees to them until it ends, and reports.
fn supervise(
    supervision: &Supervision,
    keep: &Keep,
    found: impl FnOnce() -> Result<(Rendezvous, Claim), Failure>,
) -> Result<(), Failure> {
    let termination = Termination::listen()?;
    supervision.pin.apply().map_err(Failure::input)?;
    if let Some(Some(port)) = supervision.live {
        port::listen(Some(port))?;
    }
    let (rendezvous, _folder) = found()?;
    let description = &rendezvous.description().clone();
    let (summaries, outcome) = go_on_until_the_end(rendezvous, supervision, &termination)?;
    let reported = made::report_and_tables(description, keep, summaries);
    out_folder::seal(&description.out_dir);
    // Why the run ended early comes first.
    outcome?;
    let ticks = reported?.ticks;
    if ticks < description.scenario.ticks {
        return Err(Failure::Running(anyhow!(
            "the logs end at tick {ticks} of {}: see logs/ in the run folder",
            description.scenario.ticks
        )));
    }
    Ok(())
}

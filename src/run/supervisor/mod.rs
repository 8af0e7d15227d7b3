//! `run`, `resume` and `track`: starts the nodes of a run, watches them, ends them, and reports.

mod cleaner;
mod companions;
mod losses;
mod nodes;
mod removal;
pub mod restart;
pub(crate) mod silence;

use anyhow::anyhow;
use rangehound_node::rendezvous::Rendezvous;
use rangehound_node::signal::Termination;

use crate::cli::{RecordingArgs, ResumeArgs, RunArgs, SupervisionArgs, TrackArgs};
use crate::failure::Failure;
use crate::files::out_folder::{self, Claim};
use crate::results::made::{self, Keep};
use crate::results::report::Truth;
use crate::run::experiment::{Experiment, Naming};
use crate::run::folder;
use crate::run::in_process;
use crate::run::node::{end_with, input_or_running};
use crate::run::port;
use crate::run::recorder;
use crate::run::watch::Progress;
use removal::go_on_until_the_end;

/// `rangehound run`.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &RunArgs) -> Result<(), Failure> {
    end_with(&args.parent)?;
    let experiment = Experiment::from_run(&args.experiment, Naming::Numbered)?;
    let keep = Keep { ranges: args.write_recording, truth: None, json: args.json, strict: args.strict };
    execute(experiment, args.in_process, &args.supervision, &args.recording, &keep)
}

/// `rangehound track`.
///
/// # Errors
/// [`Failure`].
pub fn track(args: &TrackArgs) -> Result<(), Failure> {
    // Before a folder is made for the name.
    let truth = args.truth.as_deref().map(Truth::read).transpose()?;
    let experiment = Experiment::from_track(args)?;
    let keep = Keep { ranges: false, truth, json: args.json, strict: args.input.strict };
    execute(experiment, args.in_process, &args.supervision, &args.recording, &keep)
}

/// `rangehound resume`: goes on with a run all of whose processes are gone.
///
/// # Errors
/// [`Failure`].
pub fn resume(args: &ResumeArgs) -> Result<(), Failure> {
    let description = folder::read_description(&args.folder)?;
    let name = match &args.name {
        Some(name) => name.clone(),
        None => description.scenario.name.parse().map_err(|error| Failure::input(format!("--name: {error}")))?,
    };
    let found = || {
        let rendezvous = Rendezvous::found(&name, description.clone()).map_err(input_or_running)?;
        Ok((rendezvous, folder::look_for_writable(&description)?))
    };
    let keep = Keep { json: args.json, ..Keep::default() };
    supervise(&args.supervision, &args.recording, &keep, found)
}

fn execute(
    mut experiment: Experiment,
    in_process: bool,
    supervision: &SupervisionArgs,
    recording: &RecordingArgs,
    keep: &Keep,
) -> Result<(), Failure> {
    if in_process {
        let description = &experiment.description;
        let _folder = folder::prepare_folder(&experiment)?;
        let mut progress = Progress::new("tick", description.scenario.ticks);
        in_process::run(description, |tick| {
            if tick > 0 && tick % 4_096 == 0 {
                progress.show(tick, "in one process");
            }
        })?;
        progress.finish();
        if !recording.no_record {
            recorder::record_logs(description, None, recording.limit.bytes(), &Termination::listen()?)?;
        }
        let reported = made::report_and_tables(description, keep, Vec::new());
        out_folder::seal(&description.out_dir);
        return reported.map(drop);
    }
    // What has been read is let go of once its copy is written.
    supervise(supervision, recording, keep, move || {
        // Only who has the name may touch the folder.
        let rendezvous = experiment.found()?;
        let folder = folder::prepare_folder(&experiment)?;
        Ok((rendezvous, folder))
    })
}

/// Founds a run in its folder, starts its processes, sees to them until it ends, and reports.
fn supervise(
    supervision: &SupervisionArgs,
    recording: &RecordingArgs,
    keep: &Keep,
    found: impl FnOnce() -> Result<(Rendezvous, Claim), Failure>,
) -> Result<(), Failure> {
    let termination = Termination::listen()?;
    supervision.pin.apply().map_err(Failure::input)?;
    if let Some(Some(port)) = supervision.show.live {
        port::listen(Some(port))?;
    }
    let (rendezvous, _folder) = found()?;
    let description = &rendezvous.description().clone();
    let (summaries, outcome) = go_on_until_the_end(rendezvous, supervision, recording, &termination)?;
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

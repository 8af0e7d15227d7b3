//! `run`, `resume` and `track`: starts the nodes of a run, watches them, ends them, and reports.

mod cleaner;
mod companions;
mod losses;
mod nodes;
pub mod restart;
mod silence;

use std::path::{Path, PathBuf};

use anyhow::anyhow;
use rangehound_shared::bus::Bus;
use rangehound_shared::rendezvous::{Rendezvous, Role};
use rangehound_shared::signal::Termination;

use crate::cli::{RecordingArgs, ResumeArgs, RunArgs, SupervisionArgs, TrackArgs};
use crate::experiment::{Experiment, Naming};
use crate::failure::Failure;
use crate::node::{end_with, input_or_running};
use crate::out_folder::{self, Claim};
use crate::tables::{self, Keep};
use crate::watch::{Progress, Watch};
use crate::{in_process, live, recorder, remote};
use cleaner::Cleaner;
use companions::Companions;
use losses::Losses;
use nodes::Nodes;

/// `rangehound run`.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &RunArgs) -> Result<(), Failure> {
    end_with(&args.parent)?;
    let experiment = Experiment::from_run(&args.experiment, Naming::Numbered)?;
    let keep = Keep { ranges: args.write_recording, truth: None, json: args.json };
    execute(experiment, args.in_process, &args.supervision, &args.recording, &keep, &[])
}

/// `rangehound track`.
///
/// # Errors
/// [`Failure`].
pub fn track(args: &TrackArgs) -> Result<(), Failure> {
    // Before a folder is made for the name.
    let truth = args.truth.as_deref().map(tables::read_truth).transpose()?;
    let experiment = Experiment::from_track(args)?;
    let keep = Keep { ranges: false, truth, json: args.json };
    let inputs: Vec<&Path> = args.truth.iter().map(PathBuf::as_path).collect();
    execute(experiment, args.in_process, &args.supervision, &args.recording, &keep, &inputs)
}

/// `rangehound resume`: goes on with a run all of whose processes are gone.
///
/// # Errors
/// [`Failure`].
pub fn resume(args: &ResumeArgs) -> Result<(), Failure> {
    let description = tables::read_description(&args.folder)?;
    let name = match &args.name {
        Some(name) => name.clone(),
        None => description.scenario.name.parse().map_err(|error| Failure::input(format!("--name: {error}")))?,
    };
    let found = || {
        let rendezvous = Rendezvous::found(&name, description.clone()).map_err(input_or_running)?;
        Ok((rendezvous, tables::look_for_writable(&description)?))
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
    inputs: &[&Path],
) -> Result<(), Failure> {
    if in_process {
        let description = &experiment.description;
        let _folder = tables::prepare_folder(&experiment, inputs)?;
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
        let reported = tables::report_and_tables(description, keep, Vec::new());
        out_folder::seal(&description.out_dir);
        return reported.map(drop);
    }
    supervise(supervision, recording, keep, || {
        // Only who has the name may touch the folder.
        let rendezvous = experiment.found()?;
        let folder = tables::prepare_folder(&experiment, inputs)?;
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
        live::look_for(port)?;
    }
    let (rendezvous, _folder) = found()?;
    let description = &rendezvous.description().clone();
    let hold = rendezvous.roster().take(Role::Supervisor).map_err(input_or_running)?;
    let (summaries, outcome) = std::thread::scope(|scope| {
        let bus = Bus::connect(&rendezvous, "observer")?;
        let mut watch = Watch::new(&bus, description.scenario.ticks)?;
        let mut nodes = Nodes::start(&rendezvous, &hold, supervision, Cleaner::start(&rendezvous, scope))?;
        let mut companions = Companions::of(&rendezvous, &hold);
        if !recording.no_record {
            companions.start("record", vec!["--record-limit".to_owned(), recording.limit.limit_mb.to_string()]);
        }
        if let Some(port) = supervision.show.live {
            let port = port.map(|port| ["--port".to_owned(), port.to_string()]);
            companions.start("live", port.into_iter().flatten().collect());
        }
        let mut losses = Losses::new(description);
        let mut is_blind = false;
        let outcome = nodes.supervise(&termination, || {
            // What cannot be shown is no reason to end the run.
            if let Err(error) = watch.look()
                && !std::mem::replace(&mut is_blind, true)
            {
                log::warn!("progress cannot be shown: {error}");
            }
            losses.look(watch.newest_ticks());
            companions.look();
        });
        // Without the note, whoever looks on takes it for a run whose nodes have died.
        let _ = rendezvous.leave_note(remote::ENDING, "");
        nodes.end(rendezvous.is_finished());
        watch.finish();
        companions.end(&termination);
        Ok::<_, Failure>((nodes.summaries(), outcome))
    })?;
    drop(rendezvous);
    let reported = tables::report_and_tables(description, keep, summaries);
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

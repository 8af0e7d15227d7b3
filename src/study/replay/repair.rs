//! Repairs a file that was cut short or damaged: copies all ticks before the damage to a complete file.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::failure::{self, Failure};
use crate::files::atomic_file::with_ending;
use crate::files::layout::PARTIAL;
use crate::results::run_mcap::file::{RunFile, unusable};
use crate::results::run_mcap::read::{FrameReader, ReadError};
use crate::results::run_mcap::write::Written;
use crate::run::watch::Progress;

/// The outcome of a repair; its fields are the keys of `--json`.
#[derive(Debug, Serialize)]
struct Repaired {
    file: String,
    /// The complete file.
    whole: String,
    /// The first and last tick in it, and the last tick of the run.
    first_tick: u64,
    ticks: u64,
    ticks_of_run: u64,
    /// The error in the file after these ticks; `None` without error.
    reason: Option<String>,
}

/// Reads a file up to the damage, and writes the ticks before it to a complete file.
///
/// # Errors
/// [`Failure`] if no tick can be read, or the new file cannot be written.
pub fn repair(path: &Path, out: Option<&Path>, json: bool) -> Result<(), Failure> {
    let refuse = |error: &ReadError| Failure::input(format!("cannot repair {}: {error}", path.display()));
    let mut reader = super::open(path, "repair")?;
    let out = out.map_or_else(|| complete_name(path), Path::to_owned);
    if out.symlink_metadata().is_ok() {
        return Err(Failure::input(format!(
            "{} exists already: expected a name that is free: choose one with --out",
            out.display()
        )));
    }
    let description = reader.description().map_err(|error| refuse(&error))?.clone();
    // The damaged file may be all that remains of the run: it keeps its name until a file with more ticks exists.
    let in_making = with_ending(&out, &format!(".{}{PARTIAL}", std::process::id()));
    let file = RunFile::begin_as(&in_making, &out, &description, reader.scenario_text(), u64::MAX).map_err(unusable)?;
    let copied = copy(&mut reader, file, description.scenario.ticks);
    if !matches!(copied, Ok((Some(_), _))) {
        let _ = std::fs::remove_file(&in_making);
    }
    let (ticks, why) = copied.map_err(Failure::Running)?;
    let Some((first_tick, ticks)) = ticks else {
        return Err(why.map_or_else(
            || Failure::input(format!("{} has no tick: there is nothing to repair", path.display())),
            |why| refuse(&why),
        ));
    };
    let (file, whole) = (path.display().to_string(), out.display().to_string());
    let ticks_of_run = description.scenario.ticks;
    if json {
        let reason = why.map(|why| why.to_string());
        return failure::print_json(&Repaired { file, whole, first_tick, ticks, ticks_of_run, reason });
    }
    if let Some(why) = why.filter(|why| !matches!(why, ReadError::Cut { .. })) {
        failure::print_stderr(format_args!("{file}: {why}"));
    }
    failure::print(format_args!("repaired: ticks {first_tick} to {ticks} of {ticks_of_run} in {whole}\n"))
}

/// The first and the last readable tick, and why there are no more.
type Copied = (Option<(u64, u64)>, Option<ReadError>);

/// Copies the readable ticks, and finishes the file if there are any.
fn copy(reader: &mut FrameReader<BufReader<File>>, mut file: RunFile, ticks_of_run: u64) -> anyhow::Result<Copied> {
    let mut progress = Progress::new("tick", ticks_of_run);
    let mut ticks: Option<(u64, u64)> = None;
    let why = loop {
        match reader.next_frame() {
            Ok(Some(frame)) => {
                let Written::Taken = file.write(&frame)? else { break None };
                ticks = Some((ticks.map_or(frame.tick, |(first, _)| first), frame.tick));
                if frame.tick > 0 && frame.tick.is_multiple_of(super::SHOW_TICKS) {
                    progress.show(frame.tick, "");
                }
            }
            Ok(None) => break None,
            Err(error) => break Some(error),
        }
    };
    progress.finish();
    if ticks.is_some() {
        file.finish()?;
    }
    Ok((ticks, why))
}

/// The name without `.partial`, or with `.repaired` before its ending.
fn complete_name(path: &Path) -> PathBuf {
    match path.extension() {
        Some(ending) if ending == "partial" => path.with_extension(""),
        _ => path.with_extension("repaired.mcap"),
    }
}

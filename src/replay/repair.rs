//! A whole file of one that was cut short or damaged: all ticks up to there.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use crate::failure::{self, Failure};
use crate::run_mcap::file::{RunFile, unusable};
use crate::run_mcap::read::{FrameReader, ReadError};
use crate::run_mcap::write::Written;
use crate::watch::Progress;

/// Reads a file up to where it is cut or damaged, and writes what there is as a whole file.
///
/// # Errors
/// [`Failure`] if nothing of it can be read, or the new file cannot be written.
pub(super) fn repair(
    path: &Path,
    out: Option<&Path>,
    mut reader: FrameReader<BufReader<File>>,
    refuse: impl Fn(&ReadError) -> Failure,
) -> Result<(), Failure> {
    let out = out.map_or_else(|| whole_name(path), Path::to_owned);
    if out.exists() {
        return Err(Failure::input(format!("{}: expected a name that is free: choose one with --out", out.display())));
    }
    let description = reader.description().map_err(|error| refuse(&error))?.clone();
    let mut file = RunFile::begin_with(&out, &description, reader.scenario_text(), u64::MAX).map_err(unusable)?;
    let mut progress = Progress::new("tick", description.scenario.ticks);
    let mut ticks: Option<(u64, u64)> = None;
    let why = loop {
        match reader.next_frame() {
            Ok(Some(frame)) => {
                let Written::Taken = file.write(&frame).map_err(unusable)? else { break None };
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
    let Some((first, last)) = ticks else {
        file.discard();
        return Err(
            why.map_or_else(|| Failure::input(format!("{}: holds no tick", path.display())), |why| refuse(&why))
        );
    };
    file.finish().map_err(unusable)?;
    if let Some(why) = why.filter(|why| !matches!(why, ReadError::Cut { .. })) {
        failure::tell(format_args!("{}: {why}", path.display()));
    }
    failure::print(format_args!(
        "repaired: ticks {first} to {last} of {} in {}\n",
        description.scenario.ticks,
        out.display()
    ))
}

/// The name without `.partial`, or with `.repaired` before its ending.
fn whole_name(path: &Path) -> PathBuf {
    match path.extension() {
        Some(ending) if ending == "partial" => path.with_extension(""),
        _ => path.with_extension("repaired.mcap"),
    }
}

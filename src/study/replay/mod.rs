//! `replay`: feeds recorded ranges to a fresh fusion centre, and reports whether it computes the same estimates, bit for
//! bit, or how they differ with another planner or filter.

mod differences;
pub mod repair;
mod show;
pub mod steps;

use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use std::time::Instant;

use rangehound_shared::motion::MotionModel;
use rangehound_shared::record::digest::Digest;
use rangehound_shared::scenario::{GRID_INSTEAD, GateKey, PlannerSpec, PlannerTable, Scenario, Source};
use serde::Serialize;

use crate::failure::{self, Failure};
use crate::files::input::COMMAND_LINE;
use crate::results::run_mcap::read::{FrameReader, Missing, ReadError};
use crate::run::watch::Progress;
use crate::terminal::counted;
use differences::{Comparison, Differences};
use steps::{Difference, Fed, StepError, Steps};

/// How often progress is shown.
const SHOW_TICKS: u64 = 4_096;

/// The outcome of a replay; its fields are the keys of `--json`.
#[derive(Debug, Serialize)]
struct Outcome {
    file: String,
    scenario: String,
    robots: usize,
    clock: &'static str,
    seed: u64,
    /// The last replayed tick, and the last tick of the complete run.
    ticks: u64,
    ticks_of_run: u64,
    /// Ticks after the last that the file counts but does not hold.
    ticks_missing: Option<Missing>,
    /// Replayed time of the run, and its wall time, s.
    run_s: f64,
    wall_s: f64,
    ranges_in_time: u64,
    ranges_late: u64,
    /// `bit-identical`, `differs`, or `changed` if settings were changed.
    verdict: &'static str,
    first_difference: Option<Difference>,
    /// After the last tick, as replayed.
    digest: String,
    /// With changed settings only.
    comparison: Option<Comparison>,
}

/// Changes to the settings of the recorded run.
#[derive(Debug, Default)]
pub struct Changes {
    /// Another planner.
    pub planner: Option<String>,
    /// Another gate.
    pub gate: Option<GateKey>,
    /// Whether sensors are distrusted.
    pub distrust: Option<bool>,
    /// Another spectral density of the target's noise, m^2/s^3.
    pub accel_psd: Option<f64>,
}

/// How the replay is shown after the comparison.
#[derive(Debug, Clone, Copy)]
pub struct Show {
    /// The page's port; any free one if not given.
    pub port: Option<u16>,
    /// Speed: seconds of the run per second.
    pub speed: f64,
}

/// The use of a file in its errors, as a verb.
const REPLAY: &str = "replay";

/// The end of errors of a damaged file.
const DAMAGED: &str = "the file is damaged: `rangehound replay --repair` keeps the ticks before the damage";

fn open(path: &Path, verb: &str) -> Result<FrameReader<BufReader<File>>, Failure> {
    let refuse = |error: &dyn std::fmt::Display| Failure::input(format!("cannot {verb} {}: {error}", path.display()));
    let file = File::open(path).map_err(|error| refuse(&format_args!("{error}: expected a run.mcap")))?;
    FrameReader::open(BufReader::new(file)).map_err(|error| refuse(&error))
}

/// `rangehound replay`.
///
/// # Errors
/// [`Failure`]: of the input, if the file cannot be read to its end; of the run, if the replay differs.
pub fn replay(path: &Path, changes: &Changes, show: Option<Show>, json: bool) -> Result<(), Failure> {
    let refuse = |error: &dyn std::fmt::Display| Failure::input(format!("cannot {REPLAY} {}: {error}", path.display()));
    let mut reader = open(path, REPLAY)?;
    let recorded = reader.description().map_err(|error| refuse(&error))?.scenario.clone();
    let replayed = changed(&recorded, changes)?;
    let begin = || Steps::new(&replayed).map_err(Failure::input);
    let is_changed = recorded != replayed;
    let fed = feed(&mut reader, begin()?, &recorded, is_changed).map_err(|error| match error {
        Stopped::Reading(error @ (ReadError::Cut { after: Some(_) } | ReadError::Damaged { after: Some(_), .. })) => {
            refuse(&format!("{error}: `rangehound replay --repair` makes a complete file of the ticks before that"))
        }
        Stopped::Reading(error) => refuse(&error),
        Stopped::Empty => match reader.missing_at_end() {
            Some(missing) => Failure::Running(anyhow::anyhow!(
                "{missing} in {}: the file is damaged: record the run again",
                path.display()
            )),
            None => refuse(&"it has no tick: record the run again"),
        },
        Stopped::Stepping(error @ StepError::InvalidTick { .. }) => refuse(&error),
        // Missing ticks are a difference; divergence after changed settings is a result too.
        Stopped::Stepping(error) => Failure::Running(anyhow::Error::new(error).context(path.display().to_string())),
        Stopped::Comparing(error) => Failure::Running(error),
    })?;
    let Replayed { ticks, run_s, wall_s, fed: Fed { in_time, late }, first_difference, digest, differences } = fed;
    let outcome = Outcome {
        file: path.display().to_string(),
        scenario: recorded.name.clone(),
        robots: recorded.robots.len(),
        clock: recorded.clock.name(),
        seed: recorded.seed,
        ticks,
        ticks_of_run: recorded.ticks,
        ticks_missing: reader.missing_at_end(),
        run_s,
        wall_s,
        ranges_in_time: in_time,
        ranges_late: late,
        verdict: match (is_changed, &first_difference) {
            (true, _) => "changed",
            (false, None) => "bit-identical",
            (false, Some(_)) => "differs",
        },
        first_difference: first_difference.filter(|_| !is_changed),
        digest: digest.to_string(),
        comparison: differences.map(|differences| differences.end(&recorded, &replayed)),
    };
    if json {
        failure::print_json(&outcome)?;
    } else {
        failure::print(&outcome)?;
    }
    if let Some(Show { port, speed }) = show {
        show::show(open(path, REPLAY)?, begin()?, &replayed, port, speed)?;
    }
    match (&outcome.first_difference, outcome.ticks_missing) {
        (Some(difference), _) => Err(Failure::Running(anyhow::anyhow!(
            "the replay of {} differs from the recording from tick {} on: replay it with the build that recorded it",
            path.display(),
            difference.tick
        ))),
        (None, Some(missing)) => {
            let path = path.display();
            Err(Failure::Running(anyhow::anyhow!("{missing} at the end of {path}: {DAMAGED}")))
        }
        (None, None) => Ok(()),
    }
}

/// The scenario with the values of the command line.
fn changed(recorded: &Scenario, changes: &Changes) -> Result<Scenario, Failure> {
    let mut scenario = recorded.clone();
    if let Some(name) = &changes.planner {
        if matches!(recorded.source, Source::Recorded { .. }) {
            return Err(Failure::input(
                "--planner is given for recorded ranges: expected a run whose robots receive headings",
            ));
        }
        let table = PlannerTable { name: Some(name.clone()), ..PlannerTable::default() };
        let spec = PlannerSpec::from_table(&table, COMMAND_LINE)
            .map_err(|error| Failure::input(error.by_flag(&[("planner.name", "--planner")])))?;
        if matches!(spec, PlannerSpec::Grid { .. }) && !recorded.is_range_only() {
            return Err(Failure::input(format!("--planner is \"grid\": expected {GRID_INSTEAD}")));
        }
        // The same planner keeps the settings of its scenario.
        if spec.name() != recorded.planner.name() {
            scenario.planner = spec;
        }
    }
    if let Some(gate) = &changes.gate {
        scenario.gate_sigma = match gate {
            GateKey::Sigma(sigma) => Some(*sigma),
            GateKey::Word(_) => None,
        };
        scenario.distrust = scenario.gate_sigma.is_some();
    }
    scenario.distrust = changes.distrust.unwrap_or(scenario.distrust);
    if let Some(psd) = changes.accel_psd {
        let MotionModel::IntegratorChain { noise_psd, .. } = &mut scenario.filter_motion else {
            return Err(Failure::input(
                "--accel-psd is given for a target model of matrices: expected a model with a spectral density",
            ));
        };
        *noise_psd = psd;
    }
    Ok(scenario)
}

/// Why a replay stopped before the end.
enum Stopped {
    Empty,
    Reading(ReadError),
    Stepping(StepError),
    Comparing(anyhow::Error),
}

/// The state of a replay.
struct Replayed {
    ticks: u64,
    run_s: f64,
    wall_s: f64,
    fed: Fed,
    first_difference: Option<Difference>,
    digest: Digest,
    differences: Option<Differences>,
}

/// Feeds a complete recording.
fn feed(
    reader: &mut FrameReader<BufReader<File>>,
    mut steps: Steps,
    recorded: &Scenario,
    is_changed: bool,
) -> Result<Replayed, Stopped> {
    let began = Instant::now();
    let mut progress = Progress::new("tick", recorded.ticks);
    let mut differences = is_changed.then(Differences::new).transpose().map_err(Stopped::Comparing)?;
    let (mut ticks, mut first_difference, mut digest) = (0, None, Digest::default());
    let mut times_s: Option<(f64, f64)> = None;
    while let Some(frame) = reader.next_frame().map_err(Stopped::Reading)? {
        let estimate = steps.step(&frame).map_err(Stopped::Stepping)?;
        if let Some(differences) = &mut differences {
            differences.add(&frame, &estimate, steps.commands());
        } else if first_difference.is_none() {
            first_difference = steps::difference(&frame, &estimate, steps.commands());
        }
        ticks = frame.tick;
        let time_s = frame.fusion.time_s;
        times_s = Some((times_s.map_or(time_s, |(first_s, _)| first_s), time_s));
        digest = Digest::from_words(estimate.digest);
        if ticks > 0 && ticks.is_multiple_of(SHOW_TICKS) {
            progress.show(ticks, "");
        }
    }
    progress.finish();
    let (first_s, last_s) = times_s.ok_or(Stopped::Empty)?;
    let (wall_s, fed) = (began.elapsed().as_secs_f64(), steps.fed());
    Ok(Replayed { ticks, run_s: last_s - first_s, wall_s, fed, first_difference, digest, differences })
}

impl std::fmt::Display for Outcome {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { file, scenario, robots, clock, seed, ticks, ticks_of_run, run_s, wall_s, digest, .. } = self;
        writeln!(f, "{file}: {scenario}, {}, {clock}, seed {seed}", counted(robots, "robot"))?;
        let of_run = if ticks < ticks_of_run { format!(" of {ticks_of_run}") } else { String::new() };
        let speed = run_s / wall_s.max(1e-9);
        writeln!(
            f,
            "  replayed         {ticks} ticks{of_run}, {run_s:.1} s, in {wall_s:.2} s ({speed:.0} x real time)"
        )?;
        let (in_time, late) = (self.ranges_in_time, self.ranges_late);
        writeln!(f, "  ranges           {in_time} in time, {late} late")?;
        match (&self.comparison, &self.first_difference) {
            (Some(comparison), _) => write!(f, "{comparison}"),
            (None, None) => {
                writeln!(f, "  estimates        bit-identical: state, covariance, digest and headings")?;
                writeln!(f, "  digest           {digest}")?;
                if ticks < ticks_of_run {
                    writeln!(f, "                   (a run stopped early may report the digest of the next tick)")?;
                }
                Ok(())
            }
            (None, Some(Difference { tick, what, recorded, replayed })) => {
                let apart = replayed - recorded;
                writeln!(f, "  estimates        differ from tick {tick} on: {what}")?;
                writeln!(f, "                   {recorded:e} recorded, {replayed:e} replayed, {apart:.3e} apart")
            }
        }
    }
}

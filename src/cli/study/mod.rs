//! Commands that measure and compare: `plan`, `compare`, `calibrate`, `latency`, `chaos`, `explore`.

mod chaos;
mod compare;
mod latency;

use std::path::PathBuf;

use clap::Args;
use rangehound_shared::scenario::PlannerTable;

use super::values::{PlannerName, number, whole};
use super::{InputArgs, TruthArgs};
use crate::failure::Failure;
use crate::plan;
use crate::study::{calibrate, explore};
pub use chaos::ChaosArgs;
pub use compare::CompareArgs;
pub use latency::LatencyArgs;

/// `plan`.
#[derive(Debug, Default, Args)]
pub struct PlanArgs {
    /// File of problems, one JSON object per line; - or no file for standard input
    pub file: Option<PathBuf>,
    /// Planner for lines that name none [default: certified]
    #[arg(long, value_name = "NAME", value_parser = PlannerName)]
    pub planner: Option<String>,
    /// Most branch-and-bound nodes that the certified planner searches
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub nodes: Option<u64>,
    /// Iterations of the relaxation planners
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub iterations: Option<u64>,
    /// Relaxation factor of the adaptive planner, 0 to 1
    #[arg(long, value_name = "A", value_parser = number, allow_negative_numbers = true)]
    pub alpha: Option<f64>,
    /// Step of the grid planner on the bearing, rad
    #[arg(long, value_name = "RAD", value_parser = number, allow_negative_numbers = true)]
    pub step_rad: Option<f64>,
    /// Steps that the horizon planner looks ahead, 1 to 100
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub steps: Option<u64>,
    /// Number of blocks of steps of the horizon planner; a robot keeps one heading in each block
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub blocks: Option<u64>,
    /// Seed of the random planner; its headings also depend on the line's number
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub seed: Option<u64>,
}

/// `calibrate`.
#[derive(Debug, Args)]
pub struct CalibrateArgs {
    /// The recording to read
    #[command(flatten)]
    pub input: InputArgs,
    /// The true track
    #[command(flatten)]
    pub truth: TruthArgs,
    /// Folder for calibration.toml and residuals.svg [default: runs/calibrate]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the result as one line of JSON
    #[arg(long)]
    pub json: bool,
}

/// `explore`.
#[derive(Debug, Args)]
pub struct ExploreArgs {
    /// The first seed
    #[arg(long, value_name = "FIRST", value_parser = whole, allow_negative_numbers = true, default_value_t = 1)]
    pub seed: u64,
    /// Number of seeds, one after the other
    #[arg(long, value_name = "COUNT", value_parser = whole, allow_negative_numbers = true, default_value_t = 20_000)]
    pub seeds: u64,
    /// Print what each node did
    #[arg(long, alias = "story")]
    pub trace: bool,
}

impl PlanArgs {
    /// Plans the lines.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        let table = PlannerTable {
            name: self.planner.clone(),
            nodes: self.nodes,
            iterations: self.iterations,
            alpha: self.alpha,
            step_rad: self.step_rad,
            steps: self.steps,
            blocks: self.blocks,
            ..PlannerTable::default()
        };
        let flags = [
            ("planner.name", "--planner"),
            ("planner.nodes", "--nodes"),
            ("planner.iterations", "--iterations"),
            ("planner.alpha", "--alpha"),
            ("planner.step_rad", "--step-rad"),
            ("planner.steps", "--steps"),
            ("planner.blocks", "--blocks"),
        ];
        plan::plan(table, &flags, self.seed, self.file.as_deref())
    }
}

impl CalibrateArgs {
    /// Estimates the sensors' errors.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        let truth = self.truth.read(&self.input)?;
        calibrate::calibrate(
            &self.input.table()?,
            &self.input.flags(),
            truth.as_ref(),
            self.truth.truth.as_deref(),
            self.out.as_deref(),
            self.json,
        )
    }
}

impl ExploreArgs {
    /// Explores the seeds.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        explore::explore(self.seed, self.seeds, self.trace)
    }
}

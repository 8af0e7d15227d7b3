//! `chaos`: its flags, checked.

use clap::Args;
use rangehound_shared::scenario::{Clock, Source, TimeoutKey};

use crate::cli::ExperimentArgs;
use crate::cli::values::{KINDS, VICTIMS, number, standbys, whole, within};
use crate::failure::Failure;
use crate::run::experiment::{Experiment, Naming, Reserved, free_name};
use crate::study::chaos;
use crate::study::chaos::enough_ticks;
use crate::study::chaos::faults::{Asked, Kind, STOP_MIN_S, Victim};

/// `chaos`.
#[derive(Debug, Args)]
pub struct ChaosArgs {
    /// The experiment; in lock step, the default here, with no time-out
    #[command(flatten)]
    pub experiment: ExperimentArgs,
    /// Number of faults; if a run ends before that, the next run starts with the next seed
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true, default_value_t = 50)]
    pub faults: u64,
    /// Kinds of faults, separated by commas
    #[arg(long, value_name = "KINDS", value_parser = KINDS, value_delimiter = ',', default_value = "all")]
    pub kinds: Vec<Option<Kind>>,
    /// Kinds of nodes that faults hit, separated by commas: sim, fusion (the one that leads), robot, standby
    #[arg(long, value_name = "ROLES", value_parser = VICTIMS, value_delimiter = ',', default_value = "sim,fusion,robot")]
    pub roles: Vec<Victim>,
    /// Standby fusion processes in each run
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = standbys)]
    pub standby: usize,
    /// Longest time for which a node is suspended, s
    #[arg(long, value_name = "SECONDS", value_parser = number, allow_negative_numbers = true, default_value_t = 0.5)]
    pub longest_stop: f64,
    /// Mean number of faults per second; the times between them are exponentially distributed
    #[arg(long, value_name = "PER_S", value_parser = number, allow_negative_numbers = true, default_value_t = 10.0)]
    pub rate: f64,
    /// Seed of the faults
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true, default_value_t = 1)]
    pub chaos_seed: u64,
    /// Print the outcome as one line of JSON, with the keys of chaos.json
    #[arg(long)]
    pub json: bool,
}

impl ChaosArgs {
    /// Injects the faults.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        let asked = self.asked()?;
        let (experiment, _reserved) = self.experiment(&asked)?;
        chaos::chaos(&experiment, &asked, self.json)
    }

    /// The parameters of the campaign.
    fn asked(&self) -> Result<Asked, Failure> {
        if self.faults == 0 {
            return Err(Failure::input("--faults is 0: expected at least 1"));
        }
        if self.standby == 0 && self.roles.contains(&Victim::Standby) {
            return Err(Failure::input("--roles has standby, but --standby is 0: expected --standby 1 or more"));
        }
        Ok(Asked {
            faults: self.faults,
            kinds: self.kinds.iter().copied().collect(),
            victims: self.roles.clone(),
            standbys: self.standby,
            longest_stop_s: within("--longest-stop", STOP_MIN_S..=60.0, "0.01 to 60 s", self.longest_stop)?,
            rate_per_s: within("--rate", 0.01..=1_000.0, "0.01 to 1000 a second", self.rate)?,
            seed: self.chaos_seed,
        })
    }

    /// The run to inject faults into. In lock step it waits for every node, so its digest must not change.
    fn experiment(&self, asked: &Asked) -> Result<(Experiment, Option<Reserved>), Failure> {
        let given = &self.experiment;
        let clock = given.clock.unwrap_or(Clock::Lockstep);
        let forever = TimeoutKey::Word("forever".to_owned());
        if given.timeout.as_ref().is_some_and(|timeout| *timeout != forever) {
            return Err(Failure::input(
                "--timeout is finite: expected forever, because a run that goes on without a node has another digest",
            ));
        }
        let (name, reserved) = match &given.name {
            Some(name) => (name.clone(), None),
            None => free_name("chaos", given.out.is_some())?,
        };
        let wanted = |ticks| ExperimentArgs {
            scenario: given.scenario.clone(),
            robots: given.robots,
            ticks,
            seed: given.seed,
            clock: Some(clock),
            planner: given.planner.clone(),
            stand_off: given.stand_off,
            timeout: Some(forever.clone()),
            name: Some(name.clone()),
            out: given.out.clone(),
        };
        let experiment = wanted(given.ticks).experiment(Naming::Exact)?;
        let scenario = &experiment.description.scenario;
        let experiment = match (given.ticks, &scenario.source) {
            (None, Source::Simulated { .. }) => {
                wanted(Some(enough_ticks(scenario, asked))).experiment(Naming::Exact)?
            }
            _ => experiment,
        };
        Ok((experiment, reserved))
    }
}

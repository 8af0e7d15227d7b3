//! Commands that run one node: `sim`, `fusion`, `robot`.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use clap::Args;
use rangehound_node::rendezvous::{Rendezvous, Role, RunDescription};
use rangehound_shared::run_name::RunName;
use rangehound_shared::scenario::{Scenario, Source, defaults};

use super::ExperimentArgs;
use super::values::{REFERENCES, whole};
use crate::failure::{self, Failure};
use crate::files::input;
use crate::files::layout::SCENARIO;
use crate::files::out_folder::Claim;
use crate::run::experiment::{Experiment, Naming};
use crate::run::folder;
use crate::run::gateway;
use crate::run::node::{self, input_or_running};
use crate::study::latency::reference::{Reference, latency_node};

/// `sim`.
#[derive(Debug, Args)]
pub struct SimArgs {
    /// The experiment, if this process starts the run
    #[command(flatten)]
    pub experiment: ExperimentArgs,
    /// The process to end with
    #[command(flatten)]
    pub parent: ParentArgs,
}

/// `fusion`.
#[derive(Debug, Args)]
pub struct FusionArgs {
    /// The run
    #[command(flatten)]
    pub node: NodeArgs,
    /// Stand by: follow the run, and take over when the fusion process that leads dies or hangs
    #[arg(long)]
    pub standby: bool,
}

/// `robot`.
#[derive(Debug, Args)]
pub struct RobotArgs {
    /// Number of the robot in the team, from 0
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub id: u64,
    /// Name of the run to join; waits until the run exists [default: paper; with --connect the run of the gateway]
    #[arg(long)]
    pub name: Option<RunName>,
    /// The process to end with
    #[command(flatten)]
    pub parent: ParentArgs,
    /// Take part in a run on another host, through its gateway at this address
    #[arg(long, value_name = "HOST:PORT")]
    pub connect: Option<String>,
    /// With --connect: folder with the keys of this host, from `rangehound keys`
    #[arg(long, value_name = "DIR", requires = "connect")]
    pub keys: Option<PathBuf>,
    /// With --connect: allow the run's host to end this process, by `rangehound kill`, `rangehound restart` or the live page
    #[arg(long, requires = "connect")]
    pub allow_remote_control: bool,
}

/// `latency-node`.
#[derive(Debug, Args)]
pub struct LatencyNodeArgs {
    /// The transport
    #[arg(long, value_parser = REFERENCES)]
    pub reference: Reference,
    /// fusion (the centre) or robot-N
    #[arg(long)]
    pub role: Role,
    /// The run
    #[command(flatten)]
    pub node: NodeArgs,
}

/// The flags that nodes and observers share.
#[derive(Debug, Args)]
pub struct NodeArgs {
    /// Name of the run to join; waits until the run exists
    #[arg(long, default_value = defaults::NAME)]
    pub name: RunName,
    /// The process to end with
    #[command(flatten)]
    pub parent: ParentArgs,
}

/// Set by `run` for the nodes that it starts, and by `latency` for what it measures.
#[derive(Debug, Default, Args)]
pub struct ParentArgs {
    /// End when this process ends
    #[arg(long, value_name = "PID", hide = true)]
    pub end_with: Option<u32>,
}

impl SimArgs {
    /// Joins the run that a supervisor has created, or creates one.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        let joined = self.parent.end_with.and(self.experiment.name.as_ref());
        // Before signals are handled: a signal then ends a wait for a pipe's writer at once.
        let experiment = if joined.is_none() { Some(self.experiment.experiment(Naming::Exact)?) } else { None };
        let termination = node::prepare(Role::Sim, self.parent.end_with)?;
        let (rendezvous, _folder) = match (joined, experiment) {
            (Some(name), _) => (node::join(name, &termination)?, None),
            (None, Some(experiment)) => create(&self.experiment, &experiment)?,
            (None, None) => return Err(Failure::input("--name is missing: expected the name of a run")),
        };
        node::sim(&rendezvous, &termination)
    }
}

impl FusionArgs {
    /// Runs it.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        node::fusion(&self.node.name, self.standby, self.node.parent.end_with)
    }
}

impl RobotArgs {
    /// Runs it.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        let Some(connect) = &self.connect else {
            let name = self.name.clone().map_or_else(|| defaults::NAME.parse().map_err(Failure::input), Ok)?;
            return node::robot(&name, usize::try_from(self.id)?, self.parent.end_with);
        };
        let mut args: Vec<OsString> =
            vec!["robot".into(), "--id".into(), self.id.to_string().into(), "--connect".into(), connect.into()];
        if let Some(keys) = &self.keys {
            args.extend(["--keys".into(), keys.into()]);
        }
        if let Some(name) = &self.name {
            args.extend(["--name".into(), name.to_string().into()]);
        }
        args.extend(self.allow_remote_control.then(|| "--allow-remote-control".into()));
        gateway::hand_over(args)
    }
}

impl LatencyNodeArgs {
    /// Runs it.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        let robot = match self.role {
            Role::Fusion => None,
            Role::Robot(id) => Some(id),
            role => return Err(Failure::input(format!("--role is {role}: expected fusion or robot-N"))),
        };
        latency_node(self.reference, robot, &self.node.name, self.node.parent.end_with)
    }
}

/// Creates the run of a simulator that was started by hand, or joins it again after a kill. Also returns the claim on the
/// run folder.
fn create(args: &ExperimentArgs, experiment: &Experiment) -> Result<(Rendezvous, Option<Claim>), Failure> {
    if let Some(living) = Rendezvous::join_if_alive(&experiment.name).map_err(input_or_running)? {
        refuse_other_experiment(args, experiment, living.description())?;
        failure::print_stderr(format!(
            "sim: run {} is already running; taking the simulator's place in it",
            experiment.name
        ));
        // If the run has a supervisor, that holds the claim.
        let folder = folder::look_for_writable(living.description()).ok();
        return Ok((living, folder));
    }
    let name = &experiment.name;
    // Only the process that has the run's name may change the folder, and nodes write to it as soon as they have joined.
    let created = Rendezvous::create_closed(name, experiment.description_for_nodes()).map_err(input_or_running)?;
    let folder = folder::prepare_folder(experiment)?;
    let rendezvous = created.open().map_err(input_or_running)?;
    let robots = rendezvous.description().scenario.robots.len();
    failure::print_stderr(format!(
        "sim: started run {name}; join it from other terminals with\n  rangehound fusion --name {name}\n  \
         rangehound robot --id 0 --name {name}   (to --id {})\n  rangehound watch --name {name}",
        robots - 1
    ));
    Ok((rendezvous, Some(folder)))
}

/// Refuses flags that describe another experiment than the living run's: they would have no effect.
fn refuse_other_experiment(args: &ExperimentArgs, asked: &Experiment, living: &RunDescription) -> Result<(), Failure> {
    let name = &asked.name;
    let refuse = |flag: &str, is: &dyn std::fmt::Display| {
        Failure::input(format!(
            "{flag} differs from run {name}, which is already running with {is}: leave it out to take the simulator's place, \
             or choose another --name"
        ))
    };
    let real = |folder: &Path| folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    if args.out.is_some() && real(&asked.description.out_dir) != real(&living.out_dir) {
        return Err(refuse("--out", &format_args!("its folder in {}", living.out_dir.display())));
    }
    let other = &"another scenario";
    // The run's copy of a recording has fewer details on how the original was read.
    let same_recording = |given: &Source| matches!((given, &living.scenario.source), (Source::Recorded(a), Source::Recorded(b)) if a.digest == b.digest);
    let scenario = |given: &Scenario| {
        let source = if same_recording(&given.source) { &living.scenario.source } else { &given.source };
        Scenario { name: String::new(), source: source.clone(), ..given.clone() }
    };
    if let Some(file) = &args.scenario {
        let is_same = scenario(&asked.description.scenario) == scenario(&living.scenario);
        return if is_same { Ok(()) } else { Err(refuse(&file.display().to_string(), other)) };
    }
    let own_file = living.out_dir.join(SCENARIO);
    for (flag, alone) in one_by_one(args) {
        // The run's own scenario, overridden by this one flag.
        let with_flag = input::scenario_file(&own_file).and_then(|mut file| {
            alone.override_with(&mut file)?;
            input::scenario(&file, &own_file.display().to_string(), &living.out_dir).map_err(Failure::input)
        });
        if with_flag.is_ok_and(|with_flag| scenario(&with_flag) == scenario(&living.scenario)) {
            continue;
        }
        return Err(match flag {
            "--seed" => refuse(flag, &format_args!("seed {}", living.scenario.seed)),
            "--ticks" => refuse(flag, &format_args!("{} ticks", living.scenario.ticks)),
            "--robots" => refuse(flag, &format_args!("{} robots", living.scenario.robots.len())),
            flag => refuse(flag, other),
        });
    }
    Ok(())
}

/// The flags that change the experiment, each without the others.
fn one_by_one(args: &ExperimentArgs) -> Vec<(&'static str, ExperimentArgs)> {
    let none = ExperimentArgs::default;
    let ExperimentArgs { robots, ticks, seed, clock, planner, stand_off, timeout, .. } = args;
    let each = [
        ("--robots", robots.is_some(), ExperimentArgs { robots: *robots, ..none() }),
        ("--ticks", ticks.is_some(), ExperimentArgs { ticks: *ticks, ..none() }),
        ("--seed", seed.is_some(), ExperimentArgs { seed: *seed, ..none() }),
        ("--clock", clock.is_some(), ExperimentArgs { clock: *clock, ..none() }),
        ("--planner", planner.is_some(), ExperimentArgs { planner: planner.clone(), ..none() }),
        ("--stand-off", stand_off.is_some(), ExperimentArgs { stand_off: *stand_off, ..none() }),
        ("--timeout", timeout.is_some(), ExperimentArgs { timeout: timeout.clone(), ..none() }),
    ];
    each.into_iter().filter(|(_, is_given, _)| *is_given).map(|(flag, _, alone)| (flag, alone)).collect()
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;
    use crate::cli::Cli;

    #[test]
    fn nodes_can_be_started_as_a_supervisor_starts_them() {
        let name: RunName = "demo".parse().unwrap();
        for role in [Role::Sim, Role::Fusion, Role::Standby(1), Role::Robot(255)] {
            let args = node::command_line(role, &name);
            Cli::try_parse_from(std::iter::once("rangehound".to_owned()).chain(args)).unwrap();
        }
    }
}

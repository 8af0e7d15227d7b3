//! `chaos`: its flags, checked.

use clap::Args;
use rangehound_shared::scenario::{Clock, Source, TimeoutKey};

use crate::cli::ExperimentArgs;
use crate::cli::values::{KINDS, VICTIMS, number, standbys, whole, within};
use crate::failure::Failure;
use crate::run::experiment::{Experiment, Naming, Reserved, free_name};
use crate::study::chaos;
use crate::study::chaos::enough_ticks;
use crate::study::chaos::faults::{Asked, Kind, OnHosts, STOP_MIN_S, Victim};
use crate::study::hosts::HOSTS_MAX;
use crate::study::hosts::link::Conditions;

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
    /// Kinds of nodes that faults hit, separated by commas: sim, fusion (the one that leads), robot, standby, gateway [default:
    /// sim,fusion,robot, and gateway if there are several hosts]
    #[arg(long, value_name = "ROLES", value_parser = VICTIMS, value_delimiter = ',')]
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
    /// Several hosts
    #[command(flatten)]
    pub hosts: OnHostsArgs,
    /// Print the outcome as one line of JSON, with the keys of chaos.json
    #[arg(long)]
    pub json: bool,
}

/// A team on several hosts.
#[derive(Debug, Args)]
pub struct OnHostsArgs {
    /// Number of hosts: network namespaces of this machine, which need root. The run's host is one of them; the robots are
    /// spread over all
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub hosts: Option<u64>,
    /// Longest time for which a host is cut off or down, s
    #[arg(long, value_name = "SECONDS", requires = "hosts", value_parser = number, allow_negative_numbers = true, default_value_t = 2.0)]
    pub longest_cut: f64,
    /// Fraction of the packets that are lost each way, 0 to 1
    #[arg(long, value_name = "PART", requires = "hosts", value_parser = number, allow_negative_numbers = true, default_value_t = 0.0)]
    pub loss: f64,
    /// Number of packets lost in a row at each loss
    #[arg(long, value_name = "N", requires = "hosts", value_parser = whole, allow_negative_numbers = true, default_value_t = 1)]
    pub burst: u64,
    /// Fraction of the packets that come twice, 0 to 1
    #[arg(long, value_name = "PART", requires = "hosts", value_parser = number, allow_negative_numbers = true, default_value_t = 0.0)]
    pub duplicates: f64,
    /// Time that a packet needs each way, ms
    #[arg(long, value_name = "MS", requires = "hosts", value_parser = number, allow_negative_numbers = true, default_value_t = 0.0)]
    pub delay: f64,
    /// Largest random delay of a packet in addition to --delay, ms; packets may overtake each other
    #[arg(long, value_name = "MS", requires = "hosts", value_parser = number, allow_negative_numbers = true, default_value_t = 0.0)]
    pub jitter: f64,
    /// Cut the links one after the other, each at this interval, s
    #[arg(long, value_name = "SECONDS", requires = "hosts", value_parser = number, allow_negative_numbers = true)]
    pub cut_every: Option<f64>,
    /// Duration of these cuts, s
    #[arg(long, value_name = "SECONDS", requires = "cut_every", value_parser = number, allow_negative_numbers = true, default_value_t = 2.0)]
    pub cut_for: f64,
}

impl OnHostsArgs {
    /// The hosts, if there are several, for this many robots.
    fn checked(&self, robots: usize) -> Result<Option<OnHosts>, Failure> {
        let Some(hosts) = self.hosts else { return Ok(None) };
        let most = robots.min(HOSTS_MAX) as u64;
        if robots < 2 {
            return Err(Failure::input("--hosts is given for one robot: expected two robots or more"));
        }
        let hosts = within("--hosts", 2..=most, &format!("2 to {most}, with a robot on each"), hosts)?;
        let part = |flag, part| within(flag, 0.0..=0.9, "0 to 0.9", part);
        let time_s = |flag, ms| Ok::<f64, Failure>(within(flag, 0.0..=1_000.0, "0 to 1000 ms", ms)? / 1e3);
        let cut_every_s =
            self.cut_every.map(|every_s| within("--cut-every", 0.1..=3_600.0, "0.1 to 3600 s", every_s)).transpose()?;
        let shorter_s = 0.9 * cut_every_s.unwrap_or(f64::INFINITY);
        Ok(Some(OnHosts {
            count: hosts as usize,
            longest_cut_s: within("--longest-cut", STOP_MIN_S..=600.0, "0.01 to 600 s", self.longest_cut)?,
            conditions: Conditions {
                loss: part("--loss", self.loss)?,
                burst: within("--burst", 1..=1_000, "1 to 1000", self.burst)? as u32,
                duplicates: part("--duplicates", self.duplicates)?,
                delay_s: time_s("--delay", self.delay)?,
                jitter_s: time_s("--jitter", self.jitter)?,
                cut_every_s,
                cut_for_s: within("--cut-for", 0.0..=shorter_s, "0 to 0.9 times --cut-every", self.cut_for)?,
            },
        }))
    }
}

impl ChaosArgs {
    /// Injects the faults.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        let mut asked = self.asked()?;
        let (experiment, _reserved) = self.experiment(&asked)?;
        asked.hosts = self.hosts.checked(experiment.description.scenario.robots.len())?;
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
        let mut victims = self.roles.clone();
        if victims.is_empty() {
            victims = vec![Victim::Sim, Victim::Fusion, Victim::Robot];
            victims.extend(self.hosts.hosts.map(|_| Victim::Gateway));
        }
        let of_hosts = self.kinds.iter().flatten().any(|kind| kind.is_of_hosts()) || victims.contains(&Victim::Gateway);
        if of_hosts && self.hosts.hosts.is_none() {
            return Err(Failure::input("--kinds or --roles has faults between hosts: expected --hosts 2 or more"));
        }
        Ok(Asked {
            faults: self.faults,
            kinds: self.kinds.iter().copied().collect(),
            victims,
            standbys: self.standby,
            longest_stop_s: within("--longest-stop", STOP_MIN_S..=60.0, "0.01 to 60 s", self.longest_stop)?,
            rate_per_s: within("--rate", 0.01..=1_000.0, "0.01 to 1000 a second", self.rate)?,
            seed: self.chaos_seed,
            hosts: None,
        })
    }

    /// The run to inject faults into. In lock step it waits for every node, so its digest must not change.
    fn experiment(&self, asked: &Asked) -> Result<(Experiment, Option<Reserved>), Failure> {
        let given = &self.experiment;
        let clock = given.clock.unwrap_or(Clock::Lockstep);
        let forever = TimeoutKey::Word("forever".to_owned());
        if given.timeout.as_ref().is_some_and(|timeout| *timeout != forever) {
            return Err(Failure::input(
                "--timeout is given in seconds: expected forever, because `chaos` waits for every node that it has hit",
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

//! `rangehound explore`: whole teams in one process on simulated time, with faults drawn from a seed and checks at
//! every step.
//!
//! | module | what |
//! |---|---|
//! | `plan`, `faults`, `links` | what happens to a team, from a seed |
//! | `cluster` | the team: events in the order of simulated time |
//! | `roles` | the roles' machines, driven in it |
//! | `process` | processes that are started, stopped and killed between two actions |
//! | `network`, `disk`, `lead` | messages that get lost, half-written checkpoints, the lock of the lead |
//! | `supervisor` | the supervisor's machine, driven in it |
//! | `gateway` | the gateway of robots on other hosts, and who has joined it |
//! | `reboot` | the run's host is lost, and the run resumed |
//! | `checker` | the invariants |
//! | `trace` | what happened, as a table |

mod checker;
mod cluster;
mod disk;
mod faults;
mod gateway;
mod lead;
mod links;
mod message;
mod network;
mod node;
mod plan;
mod process;
mod reboot;
mod roles;
mod supervisor;
mod trace;

use std::collections::HashMap;
use std::fmt::Write as _;
use std::rc::Rc;
use std::time::Instant;

use rangehound_shared::scenario::{Clock, Scenario, ScenarioFile};

use crate::failure::{self, Failure};
use crate::run::in_process;
use crate::run::watch::Progress;
use crate::terminal::counted;
use cluster::{Cluster, Counts, Outcome, Violation};
use links::Links;
use plan::{Equipment, LocalClock, Network, Plan};
use trace::table;

/// Largest number of ticks of an exploration.
const TICKS_MAX: u64 = 16;

/// Seeds between two updates of the shown progress.
const SHOW: u64 = 64;

/// `rangehound explore`: explores `seeds` seeds from `first` on, and prints what each node did if `prints_trace`.
///
/// # Errors
/// [`Failure`]; also if a seed breaks a promise.
pub fn explore(first: u64, seeds: u64, prints_trace: bool) -> Result<(), Failure> {
    let mut stage = Stage::default();
    let mut total = Total { began: Instant::now(), first, seeds: 0, counts: Counts::default() };
    let mut progress = Progress::new("seed", seeds);
    for index in 0..seeds {
        let plan = Plan::new(first.wrapping_add(index));
        let Outcome { violation, counts, trace } = stage.explore(&plan, prints_trace)?;
        total.add(&counts);
        if let Some(violation) = violation {
            progress.finish();
            let failure = stage.report_violation(&plan, &violation)?;
            failure::print(total.summary("1 violation"))?;
            return Err(failure);
        }
        if prints_trace {
            failure::print(table(&plan, &trace))?;
        }
        if index % SHOW == 0 || index + 1 == seeds {
            progress.show(index + 1, "");
        }
    }
    progress.finish();
    failure::print(total.summary("0 violations"))
}

/// Counts over all seeds.
struct Total {
    began: Instant,
    first: u64,
    seeds: u64,
    counts: Counts,
}

impl Total {
    fn add(&mut self, counts: &Counts) {
        self.seeds += 1;
        self.counts.node_ticks += counts.node_ticks;
        self.counts.faults += counts.faults;
        self.counts.successions += counts.successions;
    }

    fn summary(&self, violations: &str) -> String {
        let Self { began, first, seeds, counts: Counts { node_ticks, faults, successions } } = self;
        let per_second = *node_ticks as f64 / began.elapsed().as_secs_f64();
        format!(
            "explored {} from {first}: {node_ticks} node-ticks ({per_second:.0} a second), {}, {}, {violations}\n",
            counted(seeds, "seed"),
            counted(faults, "fault"),
            counted(successions, "succession"),
        )
    }
}

/// Size and equipment of a team.
type Team = (usize, Equipment);

/// The robots of a scenario file.
fn robots_of((robots, equipment): Team) -> String {
    if equipment == Equipment::Ranges {
        return format!("[robots]\ncount = {robots}\n");
    }
    let tables = "[sensor.radio]\nrange_std_m = 1.0\nrange_bias_std_m = 0.2\n\
                  [sensor.camera]\nbearing_std_rad = 0.05\nmax_range_m = 60.0\n\
                  [sensor.both]\nrange_std_m = 0.5\nrange_std_per_m = 0.02\nbearing_std_rad = 0.1\n\
                  [localiser.gps]\nstd_m = 0.5\ncorrelation_s = 5.0\nheading_std_rad = 0.02\n\
                  [localiser.odometry]\ndrift_m = 0.1\n";
    let equipped = ["radio", "both", "camera"].into_iter().zip(["gps", "odometry", "gps"]).cycle();
    let robot = |(sensor, localiser)| format!("[[robot]]\nsensor = \"{sensor}\"\nlocaliser = \"{localiser}\"\n");
    tables.to_owned() + &equipped.take(robots).map(robot).collect::<String>()
}

/// Scenarios and undisturbed runs, each made once.
#[derive(Default)]
struct Stage {
    scenarios: HashMap<(Team, bool, bool), Scenario>,
    undisturbed: HashMap<Team, Rc<Vec<[u64; 2]>>>,
}

impl Stage {
    fn explore(&mut self, plan: &Plan, keeps_trace: bool) -> Result<Outcome, Failure> {
        let is_realtime = plan.clock == Clock::Realtime;
        let team = (plan.robots, plan.equipment);
        let scenario = self.scenario(team, is_realtime, plan.is_endless)?;
        let scenario = Scenario { ticks: plan.ticks, ..scenario };
        let undisturbed = self.undisturbed(team)?;
        Ok(Cluster::new(plan, &scenario, undisturbed, keeps_trace).explore())
    }

    fn scenario(&mut self, team: Team, is_realtime: bool, is_endless: bool) -> Result<Scenario, Failure> {
        let key = (team, is_realtime, is_endless);
        if let Some(scenario) = self.scenarios.get(&key) {
            return Ok(scenario.clone());
        }
        let clock = if is_realtime { "realtime" } else { "lockstep" };
        let timeout = if is_endless { "\"forever\"" } else { "2.0" };
        let text = format!(
            "ticks = {TICKS_MAX}\nclock = \"{clock}\"\ntimeout_s = {timeout}\n\
             [planner]\nname = \"greedy\"\n{}",
            robots_of(team)
        );
        let file = ScenarioFile::parse(&text, "explore").map_err(Failure::input)?;
        let scenario = Scenario::from_file(&file, "explore").map_err(Failure::input)?;
        self.scenarios.insert(key, scenario.clone());
        Ok(scenario)
    }

    /// Digests by tick of a run without faults.
    fn undisturbed(&mut self, team: Team) -> Result<Rc<Vec<[u64; 2]>>, Failure> {
        if let Some(digests) = self.undisturbed.get(&team) {
            return Ok(Rc::clone(digests));
        }
        let scenario = self.scenario(team, false, true)?;
        let mut run = in_process::Team::new(&scenario).map_err(anyhow::Error::from)?;
        let mut digests = Vec::new();
        for _ in 0..=TICKS_MAX {
            run.tick().map_err(anyhow::Error::from)?;
            digests.push(run.centre().estimate().digest);
            run.advance();
        }
        let digests = Rc::new(digests);
        self.undisturbed.insert(team, Rc::clone(&digests));
        Ok(digests)
    }

    /// Reports a broken promise, with the fewest faults that break one.
    fn report_violation(&mut self, plan: &Plan, violation: &Violation) -> Result<Failure, Failure> {
        let fewest = self.shrink(plan)?;
        let Outcome { violation: shrunk, trace, .. } = self.explore(&fewest, true)?;
        let shrunk = shrunk.as_ref().unwrap_or(violation);
        failure::print(table(&fewest, &trace))?;
        let faults = fewest.faults.iter().fold(String::new(), |mut text, fault| {
            let _ = writeln!(text, "  {fault:?}");
            text
        });
        let Plan { seed, clock, robots, standbys, ticks, network, links, .. } = &fewest;
        let links = links.as_ref().map(|links| format!("{links:?}\n")).unwrap_or_default();
        failure::print(format!(
            "seed {seed}: {}, {}, {ticks} ticks, {clock:?}, {network:?}\n{links}{faults}\
             repeat it: rangehound explore --seed {seed} --seeds 1\n",
            counted(robots, "robot"),
            counted(standbys, "standby"),
        ))?;
        let at_ms = shrunk.at_ns as f64 / 1e6;
        Ok(Failure::Running(anyhow::anyhow!(
            "{} breaks a promise at {at_ms:.3} ms of seed {seed}: {}",
            shrunk.node.map_or_else(|| "run".to_owned(), |node| fewest.name_of(node)),
            shrunk.what
        )))
    }

    /// The plan reduced to the fewest faults and disturbances that still break a promise.
    fn shrink(&mut self, plan: &Plan) -> Result<Plan, Failure> {
        let mut fewest = plan.clone();
        loop {
            let network = fewest.network;
            let calmer = [
                Network { loss: 0.0, ..network },
                Network { duplicates: 0.0, ..network },
                Network { slow: 0.0, ..network },
                Network { garbled: 0.0, ..network },
                Network { wakes_on_arrival: true, ..network },
            ];
            let fewer = (0..fewest.faults.len()).map(|index| {
                let mut fewer = fewest.clone();
                fewer.faults.remove(index);
                fewer
            });
            let right_clocks = Plan { clocks: vec![LocalClock::default(); fewest.clocks.len()], ..fewest.clone() };
            let calmer = calmer.into_iter().map(|network| Plan { network, ..fewest.clone() });
            let links = fewest.links.as_ref().map(Links::calmer).unwrap_or_default();
            let links = [None].into_iter().chain(links.into_iter().map(Some));
            let links = links.map(|links| Plan { links, ..fewest.clone() });
            let candidates: Vec<Plan> =
                links.chain(fewer).chain(calmer).chain([right_clocks]).filter(|plan| *plan != fewest).collect();
            let mut smaller = None;
            for candidate in candidates {
                if self.explore(&candidate, false)?.violation.is_some() {
                    smaller = Some(candidate);
                    break;
                }
            }
            match smaller {
                Some(smaller) => fewest = smaller,
                None => return Ok(fewest),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outcome(seed: u64) -> Outcome {
        Stage::default().explore(&Plan::new(seed), true).unwrap()
    }

    #[test]
    fn a_seed_gives_the_same_trace_each_time() {
        for seed in 0..20 {
            let (first, second) = (outcome(seed), outcome(seed));
            assert_eq!(first.violation, second.violation);
            assert_eq!(first.trace, second.trace, "seed {seed}");
            assert!(!first.trace.is_empty());
        }
    }

    #[test]
    fn no_seed_breaks_a_promise() {
        let mut stage = Stage::default();
        let (mut total, mut with_links) = (Counts::default(), 0);
        for seed in 0..2_000 {
            let plan = Plan::new(seed);
            with_links += u32::from(plan.links.is_some());
            let Outcome { violation, counts, .. } = stage.explore(&plan, false).unwrap();
            assert_eq!(violation, None, "seed {seed}");
            total.faults += counts.faults;
            total.successions += counts.successions;
        }
        // Without faults the test would show nothing.
        assert!(total.faults > 2_000 && total.successions > 200 && with_links > 400, "{total:?}, {with_links}");
    }
}

//! The time from a range to its heading, divided into hops.
//!
//! The messages carry the time stamps, all of the clock of the run's host: robots send theirs in `drive`, fusion sends its own in
//! `estimate`. The gateway translates the stamps of a robot on another host: it puts half of the time beyond its host on each way,
//! and tells which parts of it were its own and the robot's. For each robot and tick the hops add up to its end-to-end latency, to
//! the nanosecond.

use rangehound_shared::message::Stages;
use rangehound_shared::record::RobotRecord;
use serde::{Deserialize, Serialize};

use crate::statistics::{Percentiles, Samples};

/// Number of hops from range to heading.
const COUNT: usize = 10;

/// The last of them, between hosts.
const BETWEEN_HOSTS: usize = 3;

/// Full names of the hops, in order.
const NAMES: [&str; COUNT] = [
    "wait for the team",
    "fusion awake",
    "filter",
    "planner",
    "checkpoint",
    "publish",
    "robot awake",
    "gateway",
    "network",
    "robot's host",
];

/// Durations of the hops of many robots and ticks.
#[derive(Debug)]
pub struct Hops([Samples; COUNT]);

/// Percentiles of each hop, us. The medians of the hops do not add up to the median of the total.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct HopSummary {
    /// From a robot's range, as it reaches fusion's host, to the last robot's range.
    pub wait_for_team: Percentiles,
    /// From the last range until fusion has received it.
    pub fusion_awake: Percentiles,
    /// Prediction and update.
    pub filter: Percentiles,
    /// Selection of the headings.
    pub planner: Percentiles,
    /// Writing the checkpoint.
    pub checkpoint: Percentiles,
    /// Sending the headings.
    pub publish: Percentiles,
    /// From sending until the robot, or its gateway, has received its heading.
    pub robot_awake: Percentiles,
    /// From the arrival of the heading in the gateway until it was sent to the robot; 0 on one host.
    #[serde(default)]
    pub gateway: Percentiles,
    /// Between the hosts of robot and gateway, both ways; 0 on one host.
    #[serde(default)]
    pub network: Percentiles,
    /// On the robot's host, until the range was sent and since the frame with the heading; 0 on one host.
    #[serde(default)]
    pub robot_host: Percentiles,
}

impl HopSummary {
    /// The hops in order.
    #[must_use]
    pub fn in_order(&self) -> [Percentiles; COUNT] {
        [
            self.wait_for_team,
            self.fusion_awake,
            self.filter,
            self.planner,
            self.checkpoint,
            self.publish,
            self.robot_awake,
            self.gateway,
            self.network,
            self.robot_host,
        ]
    }

    /// The hops with their full names, in order; without those between hosts if the whole team is on one.
    #[must_use]
    pub fn named(&self) -> Vec<(&'static str, Percentiles)> {
        let mut named: Vec<_> = NAMES.into_iter().zip(self.in_order()).collect();
        named.truncate(if self.network.p99 > 0.0 { COUNT } else { COUNT - BETWEEN_HOSTS });
        named
    }

    /// A summary of hops in order.
    #[must_use]
    pub fn from_order(hops: [Percentiles; COUNT]) -> Self {
        let [
            wait_for_team,
            fusion_awake,
            filter,
            planner,
            checkpoint,
            publish,
            robot_awake,
            gateway,
            network,
            robot_host,
        ] = hops;
        Self {
            wait_for_team,
            fusion_awake,
            filter,
            planner,
            checkpoint,
            publish,
            robot_awake,
            gateway,
            network,
            robot_host,
        }
    }
}

impl Hops {
    /// An empty collection.
    ///
    /// # Errors
    /// If a histogram cannot be made.
    pub fn new() -> anyhow::Result<Self> {
        let none = Samples::new()?;
        Ok(Self(std::array::from_fn(|_| none.clone())))
    }

    /// Adds the hops of one robot in one tick, if all of its stamps are known.
    pub fn add(&mut self, stages: &Stages, robot: &RobotRecord) {
        let Some(durations_ns) = durations_ns(stages, robot) else { return };
        // A robot on the run's host has no hops between hosts.
        let hops = if robot.network_ns > 0 { COUNT } else { COUNT - BETWEEN_HOSTS };
        for (samples, duration_ns) in self.0.iter_mut().zip(durations_ns).take(hops) {
            samples.add(duration_ns);
        }
    }

    /// Percentiles of the added hops.
    #[must_use]
    pub fn summary(&self) -> HopSummary {
        HopSummary::from_order(self.0.each_ref().map(Samples::percentiles))
    }
}

/// Duration of each hop; `None` if a stamp is missing or older than its predecessor, as after a restart.
fn durations_ns(stages: &Stages, robot: &RobotRecord) -> Option<[u64; COUNT]> {
    let Stages { last_range_ns, began_ns, filtered_ns, planned_ns, saved_ns, sent_ns } = *stages;
    let (there_ns, back_ns) = (robot.network_ns / 2, robot.network_ns.div_ceil(2));
    let (first_ns, held_ns) =
        (robot.range_sent_ns?.checked_add(there_ns)?, robot.heading_held_ns?.checked_sub(back_ns)?);
    let stamps = [first_ns, last_range_ns, began_ns, filtered_ns, planned_ns, saved_ns, sent_ns, held_ns];
    let mut durations_ns = [0; COUNT];
    for (duration_ns, pair) in durations_ns.iter_mut().zip(stamps.windows(2)) {
        *duration_ns = pair[1].checked_sub(pair[0])?;
    }
    let RobotRecord { network_ns, robot_host_ns, gateway_ns, .. } = *robot;
    let link_ns = network_ns.checked_sub(robot_host_ns)?.checked_sub(gateway_ns)?;
    durations_ns[COUNT - BETWEEN_HOSTS..].copy_from_slice(&[gateway_ns, link_ns, robot_host_ns]);
    Some(durations_ns)
}

#[cfg(test)]
mod tests {
    use super::*;

    const STAGES: Stages = Stages {
        last_range_ns: 1_010,
        began_ns: 1_030,
        filtered_ns: 1_060,
        planned_ns: 1_100,
        saved_ns: 1_150,
        sent_ns: 1_210,
    };

    #[test]
    fn hops_add_up_to_the_end_to_end_latency() {
        let robot = RobotRecord { range_sent_ns: Some(1_000), heading_held_ns: Some(1_280), ..RobotRecord::default() };
        let durations_ns = durations_ns(&STAGES, &robot).unwrap();
        assert_eq!(durations_ns, [10, 20, 30, 40, 50, 60, 70, 0, 0, 0]);
        assert_eq!(Some(durations_ns.iter().sum()), robot.latency_ns());
        // The same robot on another host.
        let robot = RobotRecord { range_sent_ns: Some(700), heading_held_ns: Some(1_581), network_ns: 601, ..robot };
        let robot = RobotRecord { robot_host_ns: 100, gateway_ns: 20, ..robot };
        let durations_ns = super::durations_ns(&STAGES, &robot).unwrap();
        assert_eq!(durations_ns, [10, 20, 30, 40, 50, 60, 70, 20, 481, 100]);
        assert_eq!(Some(durations_ns.iter().sum()), robot.latency_ns());
    }

    #[test]
    fn robots_of_the_runs_host_do_not_count_in_the_hops_between_hosts() {
        let here = RobotRecord { range_sent_ns: Some(1_000), heading_held_ns: Some(1_280), ..RobotRecord::default() };
        let there = RobotRecord { range_sent_ns: Some(700), heading_held_ns: Some(1_581), network_ns: 601, ..here };
        let mut hops = Hops::new().unwrap();
        [here, here, there].iter().for_each(|robot| hops.add(&STAGES, robot));
        let HopSummary { network, .. } = hops.summary();
        assert!(network.p50 > 0.59, "{network:?}");
    }

    #[test]
    fn hops_with_stamps_missing_or_out_of_order_are_left_out() {
        let whole = RobotRecord { range_sent_ns: Some(1_000), heading_held_ns: Some(1_280), ..RobotRecord::default() };
        let mut hops = Hops::new().unwrap();
        hops.add(&STAGES, &RobotRecord { heading_held_ns: None, ..whole });
        hops.add(&STAGES, &RobotRecord { range_sent_ns: Some(1_020), ..whole });
        hops.add(&Stages { saved_ns: 0, ..STAGES }, &whole);
        assert_eq!(hops.summary(), HopSummary::default());
        hops.add(&STAGES, &whole);
        assert_eq!(
            hops.summary().named().iter().map(|(_, hop)| hop.p50).collect::<Vec<_>>(),
            [0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.07]
        );
    }
}

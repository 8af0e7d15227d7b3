//! The diagnostics of the estimate for ROS. The bag writes them, and the node of the Python package publishes them.

use rangehound_shared::record::{FusionDecision, FusionRecord};

use crate::results::report::position_covariance;

/// A status, as in `diagnostic_msgs/DiagnosticStatus`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Status {
    /// Its subject.
    pub name: &'static str,
    /// 0: well; 1: warning.
    pub level: u8,
    /// The state in words.
    pub message: &'static str,
    /// Keys and values.
    pub values: Vec<(&'static str, String)>,
}

/// The facts of a tick.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TickDiagnostics {
    /// The tick.
    pub tick: u64,
    /// The run's last tick.
    pub ticks: u64,
    /// Measurements fused.
    pub fused: u64,
    /// Number of robots without a message when the tick was estimated.
    pub missing: u64,
    /// The robots whose message of this tick did not come in time.
    pub silent: Vec<usize>,
    /// Robots of which a measurement was not fused because its sensor is distrusted.
    pub distrusted: Vec<usize>,
    /// When the last measurement was sent, and when the headings were, monotonic ns; 0 if that was not taken.
    pub sent_ns: [u64; 2],
    /// Trace of the covariance of the position.
    pub trace_m2: f64,
}

impl TickDiagnostics {
    /// Those of a recorded tick of a run that has so many.
    #[must_use]
    pub fn of(tick: u64, ticks: u64, record: &FusionRecord) -> Self {
        let robots = || record.exchanges.iter().enumerate();
        let is_silent = |heard: Option<u64>| heard.is_none_or(|taken_at| taken_at > tick);
        let silent = robots().filter(|(_, exchange)| is_silent(exchange.heard.map(|heard| heard.taken_at)));
        let distrusted = robots().filter(|(_, exchange)| {
            let judged = exchange.heard.map_or([None; 2], |heard| heard.judged);
            judged.iter().flatten().any(|judged| judged.used == FusionDecision::Distrusted)
        });
        let estimate = &record.estimate;
        Self {
            tick,
            ticks,
            fused: estimate.fused,
            missing: estimate.missing,
            silent: silent.map(|(id, _)| id).collect(),
            distrusted: distrusted.map(|(id, _)| id).collect(),
            sent_ns: [estimate.stages.last_range_ns, estimate.stages.sent_ns],
            trace_m2: position_covariance(estimate).trace(),
        }
    }

    /// The status, with the measurements that were rejected since the last one.
    #[must_use]
    pub fn status(&self, rejected: u64) -> Status {
        let is_well = rejected == 0 && self.distrusted.is_empty() && self.missing == 0;
        let mut values = vec![
            ("tick", self.tick.to_string()),
            ("ticks", self.ticks.to_string()),
            ("fused", self.fused.to_string()),
            ("missing", self.missing.to_string()),
            ("silent robots", listed(&self.silent)),
            ("rejected since the last status", rejected.to_string()),
            ("distrusted robots", listed(&self.distrusted)),
        ];
        let [last_range_ns, sent_ns] = self.sent_ns;
        if (1..=sent_ns).contains(&last_range_ns) {
            values.push(("range to heading, us", format!("{:.1}", (sent_ns - last_range_ns) as f64 * 1e-3)));
        }
        values.push(("position trace, m^2", format!("{}", (self.trace_m2 * 1e6).round() / 1e6)));
        Status {
            name: "rangehound: estimate",
            level: u8::from(!is_well),
            message: if is_well {
                "all fused at this tick"
            } else {
                "measurements are missing or rejected, or robots are distrusted"
            },
            values,
        }
    }
}

fn listed(robots: &[usize]) -> String {
    let ids: Vec<String> = robots.iter().map(usize::to_string).collect();
    if ids.is_empty() { "none".to_owned() } else { ids.join(" ") }
}

#[cfg(test)]
mod tests {
    use rangehound_shared::message::{Estimate, Stages};
    use rangehound_shared::record::{Exchange, GateResult, Heard};

    use super::*;

    fn record(missing: u64, stages: Stages, heard: &[Option<(u64, FusionDecision)>]) -> FusionRecord {
        let mut estimate = Estimate { state_dim: 2, fused: 1, missing, stages, ..Estimate::default() };
        estimate.covariance[..4].copy_from_slice(&[0.5, 0.1, 0.1, 0.25]);
        let judged = |used| [None, Some(GateResult { used, normalised_square: None })];
        let heard = heard
            .iter()
            .map(|heard| heard.map(|(taken_at, used)| Heard { taken_at, judged: judged(used), ..Heard::default() }));
        let exchanges = heard.map(|heard| Exchange { heard, ..Exchange::default() }).collect();
        FusionRecord { time_s: 0.7, estimate, exchanges }
    }

    #[test]
    fn silent_and_distrusted_robots_are_named() {
        let stages = Stages { last_range_ns: 1_000, sent_ns: 13_340, ..Stages::default() };
        let heard = [
            Some((7, FusionDecision::Fused)),
            None,
            Some((7, FusionDecision::Distrusted)),
            Some((9, FusionDecision::Fused)),
        ];
        let status = TickDiagnostics::of(7, 600, &record(2, stages, &heard)).status(3);
        assert_eq!(
            (status.level, status.message),
            (1, "measurements are missing or rejected, or robots are distrusted")
        );
        let expected = [
            ("tick", "7"),
            ("ticks", "600"),
            ("fused", "1"),
            ("missing", "2"),
            ("silent robots", "1 3"),
            ("rejected since the last status", "3"),
            ("distrusted robots", "2"),
            ("range to heading, us", "12.3"),
            ("position trace, m^2", "0.75"),
        ];
        assert_eq!(status.values, expected.map(|(key, value)| (key, value.to_owned())));
    }

    #[test]
    fn a_tick_whose_measurements_are_all_fused_is_well_and_a_time_that_was_not_taken_is_left_out() {
        let status =
            TickDiagnostics::of(7, 600, &record(0, Stages::default(), &[Some((7, FusionDecision::Fused))])).status(0);
        assert_eq!((status.level, status.message), (0, "all fused at this tick"));
        assert!(!status.values.iter().any(|(key, _)| *key == "range to heading, us"), "{status:?}");
        assert!(status.values.contains(&("silent robots", "none".to_owned())));
    }
}

//! Differences between a run as recorded and the same ranges with another planner or filter.

use std::f64::consts::PI;

use nalgebra::Vector2;
use rangehound_shared::message::{Command, Estimate};
use rangehound_shared::motion::MotionModel;
use rangehound_shared::scenario::Scenario;
use serde::Serialize;

use crate::results::frame::Frame;
use crate::results::report::{Accumulator, Background};
use crate::statistics::Mean;

/// Most characters of a setting: a space must remain between the columns.
const SETTING_LEN_MAX: usize = 11;

/// Sums up both sides tick by tick.
pub(super) struct Differences {
    sides: [Side; 2],
    headings_apart: Apart,
    positions_apart: Apart,
}

struct Side {
    totals: Accumulator,
    objective: Mean,
    bound: Mean,
}

/// Mean and maximum of a distance.
#[derive(Debug, Clone, Copy, Default)]
struct Apart {
    mean: Mean,
    max: f64,
}

impl Apart {
    fn add(&mut self, apart: f64) {
        self.mean.add(apart);
        self.max = self.max.max(apart);
    }
}

/// Both sides' figures.
#[derive(Debug, Serialize)]
pub(super) struct Comparison {
    /// The recorded run.
    pub(super) recorded: Figures,
    /// The replayed run.
    pub(super) replayed: Figures,
    /// Mean difference of the headings over robots and ticks, rad.
    pub(super) heading_apart_mean_rad: Option<f64>,
    /// Maximum of it.
    pub(super) heading_apart_max_rad: f64,
    /// Mean distance of the estimated positions over the ticks, m.
    pub(super) position_apart_mean_m: Option<f64>,
    /// Maximum of it.
    pub(super) position_apart_max_m: f64,
    /// Unit of the spectral densities.
    #[serde(skip)]
    psd_unit: &'static str,
}

/// One side's figures, as the report has them.
#[derive(Debug, Serialize)]
pub(super) struct Figures {
    pub(super) planner: String,
    pub(super) gate_sigma: Option<f64>,
    pub(super) distrust: bool,
    /// As in the scenario; `None` if the model is given by matrices.
    pub(super) noise_psd: Option<f64>,
    pub(super) position_rmse_m: Option<f64>,
    pub(super) anees: Option<f64>,
    pub(super) nis_mean: Option<f64>,
    pub(super) nis_all_mean: Option<f64>,
    pub(super) gate_widened: u64,
    pub(super) position_trace_final_m2: f64,
    pub(super) position_trace_median_m2: f64,
    pub(super) fused: u64,
    pub(super) rejected: u64,
    pub(super) objective_mean: Option<f64>,
    /// `None` if the planner proves no bound.
    pub(super) lower_bound_mean: Option<f64>,
}

impl Differences {
    pub(super) fn new() -> anyhow::Result<Self> {
        let side =
            || anyhow::Ok(Side { totals: Accumulator::new()?, objective: Mean::default(), bound: Mean::default() });
        Ok(Self { sides: [side()?, side()?], headings_apart: Apart::default(), positions_apart: Apart::default() })
    }

    /// Adds a tick.
    pub(super) fn add(&mut self, frame: &Frame, replayed: &Estimate, commands: &[Command]) {
        let truth_m = frame.world.truth.first_chunk().map(|[x_m, y_m]| Vector2::new(*x_m, *y_m));
        let recorded = &frame.fusion.estimate;
        for (side, estimate) in self.sides.iter_mut().zip([recorded, replayed]) {
            side.totals.add_estimate(frame.tick, estimate, truth_m);
            // A planner without an objective reports none.
            if estimate.objective > 0.0 {
                side.objective.add(estimate.objective);
            }
            // Not every planner proves a bound.
            if estimate.objective > 0.0 && estimate.lower_bound.is_finite() {
                side.bound.add(estimate.lower_bound);
            }
        }
        let [x_m, y_m] = [0, 1].map(|axis| recorded.state[axis] - replayed.state[axis]);
        self.positions_apart.add(x_m.hypot(y_m));
        for (exchange, command) in frame.fusion.exchanges.iter().zip(commands) {
            // A robot that stands still has no heading.
            if exchange.command.speed_mps > 0.0 && command.speed_mps > 0.0 {
                let apart_rad = (exchange.command.heading_rad - command.heading_rad).rem_euclid(2.0 * PI);
                self.headings_apart.add(apart_rad.min(2.0 * PI - apart_rad));
            }
        }
    }

    pub(super) fn end(self, recorded: &Scenario, replayed: &Scenario) -> Comparison {
        let [was, would_be] = self.sides;
        Comparison {
            recorded: was.figures(recorded),
            replayed: would_be.figures(replayed),
            heading_apart_mean_rad: self.headings_apart.mean.value(),
            heading_apart_max_rad: self.headings_apart.max,
            position_apart_mean_m: self.positions_apart.mean.value(),
            position_apart_max_m: self.positions_apart.max,
            psd_unit: match recorded.filter_motion {
                MotionModel::IntegratorChain { order: 1, .. } => "m^2/s",
                MotionModel::IntegratorChain { order: 3, .. } => "m^2/s^5",
                MotionModel::IntegratorChain { .. } | MotionModel::Custom { .. } => "m^2/s^3",
            },
        }
    }
}

impl Side {
    fn figures(self, scenario: &Scenario) -> Figures {
        let (objective_mean, lower_bound_mean) = (self.objective.value(), self.bound.value());
        let report = self.totals.report(scenario, Background::default(), Vec::new());
        Figures {
            planner: report.planner,
            gate_sigma: scenario.gate_sigma,
            distrust: scenario.distrust,
            noise_psd: match scenario.filter_motion {
                MotionModel::IntegratorChain { noise_psd, .. } => Some(noise_psd),
                MotionModel::Custom { .. } => None,
            },
            position_rmse_m: report.position_rmse_m,
            anees: report.anees,
            nis_mean: report.nis_mean,
            nis_all_mean: report.nis_all_mean,
            gate_widened: report.gate_widened,
            position_trace_final_m2: report.position_trace_m2.r#final,
            position_trace_median_m2: report.position_trace_m2.median,
            fused: report.ranges.fused,
            rejected: report.ranges.rejected,
            objective_mean,
            lower_bound_mean,
        }
    }
}

impl std::fmt::Display for Comparison {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (was, would_be) = (&self.recorded, &self.replayed);
        let number = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.4}"));
        let noise = format!("noise psd, {}", self.psd_unit);
        let rows = [
            // The settings that may have changed come first.
            ("planner", was.planner.clone(), would_be.planner.clone()),
            ("gate, sigma", setting(was.gate_sigma), setting(would_be.gate_sigma)),
            ("distrust", on_or_off(was.distrust), on_or_off(would_be.distrust)),
            (&noise, setting(was.noise_psd), setting(would_be.noise_psd)),
            ("position error, m RMS", number(was.position_rmse_m), number(would_be.position_rmse_m)),
            ("ANEES", number(was.anees), number(would_be.anees)),
            ("NIS", number(was.nis_mean), number(would_be.nis_mean)),
            ("NIS, all ranges", number(was.nis_all_mean), number(would_be.nis_all_mean)),
            (
                "trace at the end, m^2",
                number(Some(was.position_trace_final_m2)),
                number(Some(would_be.position_trace_final_m2)),
            ),
            (
                "trace, median, m^2",
                number(Some(was.position_trace_median_m2)),
                number(Some(would_be.position_trace_median_m2)),
            ),
            ("ranges fused", was.fused.to_string(), would_be.fused.to_string()),
            ("ranges rejected", was.rejected.to_string(), would_be.rejected.to_string()),
            ("objective, mean, 1/m^2", number(was.objective_mean), number(would_be.objective_mean)),
            ("its bound, mean, 1/m^2", number(was.lower_bound_mean), number(would_be.lower_bound_mean)),
        ];
        writeln!(f, "  {:<24}{:>12}{:>12}", "", "recorded", "replayed")?;
        for (what, recorded, replayed) in rows {
            writeln!(f, "  {what:<24}{recorded:>12}{replayed:>12}")?;
        }
        if let Some(mean_rad) = self.heading_apart_mean_rad {
            writeln!(
                f,
                "  headings apart          {mean_rad:.3} rad in the mean, {:.3} max",
                self.heading_apart_max_rad
            )?;
        }
        if let Some(mean_m) = self.position_apart_mean_m {
            writeln!(f, "  estimates apart         {mean_m:.3} m in the mean, {:.3} max", self.position_apart_max_m)?;
        }
        Ok(())
    }
}

fn on_or_off(switch: bool) -> String {
    if switch { "on" } else { "off" }.to_owned()
}

/// A number in its shortest form that fits.
fn setting(value: Option<f64>) -> String {
    let Some(value) = value else { return "-".to_owned() };
    let text = value.to_string();
    if text.len() <= SETTING_LEN_MAX { text } else { format!("{value:.3e}") }
}

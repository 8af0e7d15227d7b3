//! One line in, one line out: a problem and its answer, without I/O.

use std::fmt::Display;
use std::ops::RangeInclusive;
use std::time::Instant;

use nalgebra::Matrix2;
use rangehound_fusion::planner::{
    self, Certificate, Plan, Planner, Predicted, Situation, TeamMember, hull_certificate,
};
use rangehound_fusion::vector::Vector;
use rangehound_shared::ROBOTS_MAX;
use rangehound_shared::message::Command;
use rangehound_shared::motion::matrix::Matrix;
use rangehound_shared::scenario::{
    Clearance, Criterion, GRID_INSTEAD, PlannerSpec, PlannerTable, RangeNoise, ScenarioError, SensorSpec, bounds,
};
use serde::{Serialize, Serializer};

use super::schema::{Number, Object, Pair, ProblemLine, RobotLine};
use crate::failure::one_short_line;
use crate::files::input::COMMAND_LINE;

/// Answers lines. It keeps planners and memory between lines, but no answer depends on earlier lines.
#[derive(Debug)]
pub struct LineSolver {
    table: PlannerTable,
    seed: u64,
    kept: Vec<Kept>,
    situation: Situation,
    plan: Plan,
}

/// A planner and the team size that it was made for.
#[derive(Debug)]
struct Kept {
    spec: PlannerSpec,
    robots: usize,
    planner: Box<dyn Planner>,
}

/// The solution of a problem.
#[derive(Debug, Clone, Copy)]
pub struct Solved<'a> {
    /// The planner's name.
    pub planner: &'static str,
    /// Its plan.
    pub plan: &'a Plan,
    /// How good other plans can be at best: proven by the planner, or by the hulls.
    pub certificate: Certificate,
    /// Time of the planning alone, us.
    pub plan_us: f64,
}

/// The answer to a problem.
#[derive(Debug, Serialize)]
struct Answer<'a> {
    planner: &'static str,
    headings_rad: EachOf<'a>,
    speeds_mps: EachOf<'a>,
    objective: f64,
    lower_bound: f64,
    certified: bool,
    position_trace_m2: f64,
    lower_bound_trace_m2: f64,
    plan_us: f64,
}

/// One number of each command, as a list.
#[derive(Debug)]
struct EachOf<'a>(&'a [Command], fn(&Command) -> f64);

impl Serialize for EachOf<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.0.iter().map(self.1))
    }
}

impl LineSolver {
    /// Uses the planner of this table for lines that name none. Keys of a line override the table's.
    ///
    /// # Errors
    /// [`ScenarioError`] if the table is invalid.
    pub fn new(table: PlannerTable, seed: u64) -> Result<Self, ScenarioError> {
        PlannerSpec::from_table(&table, COMMAND_LINE)?;
        let (situation, plan) = Default::default();
        Ok(Self { table, seed, kept: Vec::new(), situation, plan })
    }

    /// Appends the answer to this line, which is also one line. If the line is invalid, the answer has the reason, which is
    /// also returned.
    ///
    /// Except for `plan_us`, the answer is a function of the arguments: the random planner uses the line's number as the
    /// tick.
    pub fn answer(&mut self, number: u64, line: &[u8], answer: &mut Vec<u8>) -> Option<String> {
        let problem = self.try_answer(number, line, answer).err().map(|problem| one_short_line(&problem))?;
        refuse(number, &problem, answer);
        Some(problem)
    }

    fn try_answer(&mut self, number: u64, line: &[u8], answer: &mut Vec<u8>) -> Result<(), String> {
        let Solved { planner, plan, certificate, plan_us } = self.solve(number, &ProblemLine::parse(line)?)?;
        let answered = Answer {
            planner,
            headings_rad: EachOf(&plan.commands, |command| command.heading_rad),
            speeds_mps: EachOf(&plan.commands, |command| command.speed_mps),
            objective: plan.predicted.objective,
            lower_bound: certificate.lower_bound,
            certified: certificate.is_optimal,
            position_trace_m2: plan.predicted.position_trace_m2,
            lower_bound_trace_m2: certificate.least_trace_m2,
            plan_us,
        };
        write_line(&answered, answer);
        Ok(())
    }

    /// Checks a problem and solves it. Except for `plan_us`, the solution is a function of the arguments.
    ///
    /// # Errors
    /// One line that says which value is wrong and what was expected.
    pub fn solve(&mut self, number: u64, raw: &ProblemLine) -> Result<Solved<'_>, String> {
        let spec = self.check(raw)?;
        let Self { kept, situation, plan, .. } = self;
        let kept = kept_planner(kept, spec, situation.team.len(), self.seed)?;
        let began = Instant::now();
        kept.planner.plan(number, situation, plan);
        let plan_us = began.elapsed().as_nanos() as f64 / 1e3;

        let Predicted { objective, position_trace_m2, .. } = plan.predicted;
        // Planners that prove no bound get this one.
        let certificate = plan.certificate.unwrap_or_else(|| hull_certificate(situation, plan));
        let Certificate { lower_bound, least_trace_m2, .. } = certificate;
        let commanded = plan.commands.iter().flat_map(|command| [command.heading_rad, command.speed_mps]);
        if !commanded.chain([objective, lower_bound, position_trace_m2, least_trace_m2]).all(f64::is_finite) {
            return Err("the answer is not finite: expected numbers whose products are finite".to_owned());
        }
        Ok(Solved { planner: spec.name(), plan, certificate, plan_us })
    }

    /// Checks every value, and stores them in `self.situation`.
    fn check(&mut self, raw: &ProblemLine) -> Result<PlannerSpec, String> {
        let covariance_m2 = covariance("prior_position_covariance", raw.prior_position_covariance, bounds::VARIANCE)?;
        self.situation.belief.set_position(place("target", raw.target)?, &covariance_m2);
        self.situation.step_s = number("time_step_s", raw.time_step_s, bounds::DT_S)?;
        let robots = raw.robots.as_deref().ok_or_else(|| expected("robots", "a list of robots", "missing"))?;
        self.situation.team.clear();
        for (i, Object(robot)) in robots.iter().enumerate() {
            self.situation.team.push(member(robot).map_err(|problem| format!("robots[{i}].{problem}"))?);
        }
        let mut table = self.table.clone();
        if let Some(name) = &raw.planner {
            table.name = Some(name.clone());
        }
        // Without the key there is no stand-off, unlike in a scenario.
        table.stand_off_m = Some(raw.stand_off_m.map_or(0.0, |Number(value)| value));
        table.stand_off_sigma = raw.stand_off_sigma.map(|Number(value)| value);
        table.separation_m = raw.separation_m.map(|Number(value)| value);
        let spec = PlannerSpec::from_table(&table, "").map_err(of_line)?;
        let clearance = Clearance::from_table(&table, "").map_err(of_line)?;
        if clearance.separation_m > 0.0 && robots.len() > ROBOTS_MAX {
            let none = format!("0 in a team of more than {ROBOTS_MAX} robots");
            return Err(expected(
                "separation_m",
                none,
                format!("{} for {} robots", clearance.separation_m, robots.len()),
            ));
        }
        self.situation.clearance = clearance;
        self.situation.criterion = match &raw.criterion {
            Some(name) => criterion(name)?,
            None => Criterion::default(),
        };
        if matches!(spec, PlannerSpec::Grid { .. }) && !self.situation.is_range_only() {
            // A line that names none has the flag's.
            let key = if raw.planner.is_some() { "planner" } else { "--planner" };
            return Err(expected(key, GRID_INSTEAD, "grid"));
        }
        Ok(spec)
    }
}

/// Appends the answer to an invalid line.
pub fn refuse(line: u64, error: &str, answer: &mut Vec<u8>) {
    #[derive(Serialize)]
    struct Refusal<'a> {
        line: u64,
        error: &'a str,
    }
    write_line(&Refusal { line, error }, answer);
}

fn write_line(value: &impl Serialize, answer: &mut Vec<u8>) {
    // Structs of numbers and texts always have a JSON form, and writing to a vector cannot fail.
    let _ = serde_json::to_writer(&mut *answer, value);
    answer.push(b'\n');
}

/// The planner of an earlier line if it serves this team, else a new one in its place.
fn kept_planner(kept: &mut Vec<Kept>, spec: PlannerSpec, robots: usize, seed: u64) -> Result<&mut Kept, String> {
    let at = kept.iter().position(|known| known.spec == spec).unwrap_or(kept.len());
    if kept.get(at).is_none_or(|known| known.robots != robots) {
        let planner = planner::for_team(spec, robots, seed).map_err(|error| error.to_string())?;
        let fresh = Kept { spec, robots, planner };
        match kept.get_mut(at) {
            Some(known) => *known = fresh,
            None => kept.push(fresh),
        }
    }
    Ok(&mut kept[at])
}

/// A covariance whose variances are within bounds; it may be singular if they may be zero.
fn covariance(
    key: &str,
    rows: Option<Pair<Pair<Number>>>,
    variances: RangeInclusive<f64>,
) -> Result<Matrix2<f64>, String> {
    let Some(Pair([Pair([Number(xx), Number(xy)]), Pair([Number(yx), Number(yy)])])) = rows else {
        return Err(expected(key, "two rows of two numbers", "missing"));
    };
    for variance in [xx, yy] {
        number(key, Some(Number(variance)), variances.clone())?;
    }
    for entry in [xy, yx] {
        number(key, Some(Number(entry)), bounds::MATRIX_ENTRY)?;
    }
    // The least eigenvalue of a singular matrix is zero up to rounding.
    let least = if *variances.start() == 0.0 { -1e-12 } else { bounds::RELATIVE_EIGENVALUE_MIN };
    let minimum = Matrix::from_rows(&[vec![xx, xy], vec![yx, yy]]).and_then(|matrix| matrix.relative_min_eigenvalue());
    match minimum {
        Some(minimum) if minimum > least => {}
        Some(_) => return Err(expected(key, "a positive definite matrix", "indefinite or singular")),
        None => return Err(expected(key, "a symmetric matrix", "asymmetric")),
    }
    let across = 0.5 * (xy + yx);
    Ok(Matrix2::new(xx, across, across, yy))
}

fn member(robot: &RobotLine) -> Result<TeamMember, String> {
    let position_m = place("position", robot.position)?;
    let max_speed_mps = number("max_speed", robot.max_speed, bounds::SPEED_MPS)?;
    let optional = |key, value: Option<Number>, bounds, absent| match value {
        Some(value) => number(key, Some(value), bounds),
        None => Ok(absent),
    };
    let bearing_std_rad = match robot.bearing_std_rad {
        Some(value) => Some(number("bearing_std_rad", Some(value), bounds::BEARING_STD_RAD)?),
        None => None,
    };
    // A robot with bearings need not measure ranges.
    let std_m = match robot.range_std {
        None if bearing_std_rad.is_some() => None,
        value => Some(number("range_std", value, bounds::STD_M)?),
    };
    let std_per_m = optional("range_std_per_m", robot.range_std_per_m, bounds::STD_PER_M, 0.0)?;
    if std_m.is_none() && robot.range_std_per_m.is_some() {
        return Err(expected("range_std_per_m", "range_std with it", std_per_m));
    }
    let position_covariance_m2 = match robot.position_covariance {
        Some(rows) => {
            let variances = 0.0..=*bounds::VARIANCE.end();
            covariance("position_covariance", Some(rows), variances)?
        }
        None => Matrix2::zeros(),
    };
    Ok(TeamMember {
        position_m,
        position_covariance_m2,
        heading_std_rad: optional("heading_std_rad", robot.heading_std_rad, bounds::HEADING_STD_RAD, 0.0)?,
        max_speed_mps,
        sensor: SensorSpec {
            range: std_m.map(|std_m| RangeNoise { std_m, std_per_m }),
            bearing_std_rad,
            max_range_m: maybe("max_range_m", robot.max_range_m, bounds::MAX_RANGE_M)?,
            field_of_view_rad: maybe("field_of_view_rad", robot.field_of_view_rad, bounds::FIELD_OF_VIEW_RAD)?,
        },
        is_fused: true,
    })
}

/// A value that need not be given.
fn maybe(key: &str, value: Option<Number>, bounds: RangeInclusive<f64>) -> Result<Option<f64>, String> {
    value.map(|value| number(key, Some(value), bounds)).transpose()
}

fn criterion(name: &str) -> Result<Criterion, String> {
    let names = Criterion::ALL.map(Criterion::name).join(", ");
    let found = Criterion::ALL.into_iter().find(|criterion| criterion.name() == name);
    found.ok_or_else(|| expected("criterion", format!("one of {names}"), format!("{name:?}")))
}

fn place(key: &str, pair: Option<Pair<Number>>) -> Result<Vector, String> {
    let Pair([x, y]) = pair.ok_or_else(|| expected(key, "a list of two numbers", "missing"))?;
    Ok(Vector::new(number(key, Some(x), bounds::COORDINATE)?, number(key, Some(y), bounds::COORDINATE)?))
}

fn number(key: &str, value: Option<Number>, bounds: RangeInclusive<f64>) -> Result<f64, String> {
    let what = || format!("a number from {} to {}", bounds.start(), bounds.end());
    match value {
        Some(Number(value)) if bounds.contains(&value) => Ok(value),
        Some(Number(value)) => Err(expected(key, what(), value)),
        None => Err(expected(key, what(), "missing")),
    }
}

fn expected(key: &str, expected: impl Display, got: impl Display) -> String {
    format!("{key} is {got}: expected {expected}")
}

/// An error of the scenario's checks, in the keys of a line.
fn of_line(error: ScenarioError) -> String {
    match error {
        ScenarioError::WrongValue { key, expected: what, got, .. } => {
            let key = if key == "planner.name" { "planner" } else { key.trim_start_matches("planner.") };
            expected(key, what, got)
        }
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests;

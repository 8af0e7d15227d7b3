//! The team: identical robots, or one by one.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use super::Checker;
use super::values::quoted;
use crate::ROBOTS_MAX;
use crate::scenario::bounds::{
    BEARING_STD_RAD, CORRELATION_S, FIELD_OF_VIEW_RAD, HEADING_STD_RAD, MAX_RANGE_M, NUISANCE_STD_M, SPEED_MPS, STD_M,
    STD_PER_M,
};
use crate::scenario::{
    Calibration, EXACT, LocaliserTable, NuisanceSpec, OWN, PoseCorrelation, RangeNoise, RobotSpec, RobotTable,
    RobotsTable, ScenarioError, ScenarioFile, SensorSpec, SensorTable, defaults,
};

/// Sensors and localisers that robots can have, by name.
struct Equipment<'a> {
    sensors: &'a BTreeMap<String, SensorTable>,
    localisers: &'a BTreeMap<String, LocaliserTable>,
}

/// A robot's choice of them; `table` is its own in errors.
struct Choice<'a> {
    table: &'a str,
    range_std_m: Option<f64>,
    sensor: Option<&'a str>,
    localiser: Option<&'a str>,
}

impl Checker<'_> {
    pub(super) fn team(&self, raw: &ScenarioFile) -> Result<Vec<RobotSpec>, ScenarioError> {
        let (no_sensors, no_localisers) = (BTreeMap::new(), BTreeMap::new());
        let equipment = Equipment {
            sensors: raw.sensor.as_ref().unwrap_or(&no_sensors),
            localisers: raw.localiser.as_ref().unwrap_or(&no_localisers),
        };
        // Tables that no robot names are checked too.
        for (name, table) in equipment.sensors {
            self.unreserved("sensor", name, &[OWN])?;
            self.sensor(name, table)?;
        }
        for (name, table) in equipment.localisers {
            self.unreserved("localiser", name, &[OWN, EXACT])?;
            self.localiser(name, table)?;
        }
        match (&raw.robots, &raw.robot) {
            (Some(_), Some(_)) => Err(self.refuse(
                "robots",
                "either [robots] with a count or a [[robot]] for each",
                "given together with [[robot]]",
            )),
            (alike, None) => self.alike_team(&alike.clone().unwrap_or_default(), &equipment),
            (None, Some(tables)) => self.mixed_team(tables, &equipment),
        }
    }

    /// Refuses a name that has another meaning in `compare`.
    fn unreserved(&self, table: &str, name: &str, reserved: &[&str]) -> Result<(), ScenarioError> {
        if reserved.contains(&name) {
            let expected = "another name, because `compare` uses this one";
            return Err(self.refuse(&format!("[{table}.{name}]"), expected, "given"));
        }
        Ok(())
    }

    fn alike_team(&self, table: &RobotsTable, equipment: &Equipment<'_>) -> Result<Vec<RobotSpec>, ScenarioError> {
        let count = self.whole("robots.count", table.count, defaults::ROBOTS, 1..=ROBOTS_MAX as u64)?;
        let centre_m = self.point("robots.start_m", table.start_m)?;
        let radius_m = self.number("robots.ring_radius_m", table.ring_radius_m, 0.0, 0.0..=1e6)?;
        let speed_mps = self.number("robots.speed_mps", table.speed_mps, defaults::SPEED_MPS, SPEED_MPS)?;
        let choice = Choice {
            table: "robots",
            range_std_m: table.range_std_m,
            sensor: table.sensor.as_deref(),
            localiser: table.localiser.as_deref(),
        };
        let (sensor, nuisances) = self.equip(&choice, equipment)?;
        Ok((0..count)
            .map(|id| {
                let (sin, cos) = (TAU * id as f64 / count as f64).sin_cos();
                RobotSpec {
                    label: id.to_string(),
                    start_m: [centre_m[0] + radius_m * cos, centre_m[1] + radius_m * sin],
                    speed_mps,
                    sensor,
                    reported: sensor,
                    calibration: Calibration::default(),
                    nuisances,
                }
            })
            .collect())
    }

    fn mixed_team(&self, tables: &[RobotTable], equipment: &Equipment<'_>) -> Result<Vec<RobotSpec>, ScenarioError> {
        let count = tables.len();
        if !(1..=ROBOTS_MAX).contains(&count) {
            return Err(self.refuse("robot", format!("1 to {ROBOTS_MAX} robots"), format!("a list of {count}")));
        }
        let mut robots: Vec<Option<RobotSpec>> = vec![None; count];
        for (index, table) in tables.iter().enumerate() {
            let key = |name: &str| format!("robot[{index}].{name}");
            let id = table.id.unwrap_or(index as u64);
            let Some(slot) = usize::try_from(id).ok().and_then(|id| robots.get_mut(id)) else {
                return Err(self.refuse(&key("id"), format!("an id from 0 to {}", count - 1), id));
            };
            if slot.is_some() {
                return Err(self.refuse(&key("id"), "each id once", format!("{id} for the second time")));
            }
            let choice = Choice {
                table: &format!("robot[{index}]"),
                range_std_m: table.range_std_m,
                sensor: table.sensor.as_deref(),
                localiser: table.localiser.as_deref(),
            };
            let (sensor, nuisances) = self.equip(&choice, equipment)?;
            *slot = Some(RobotSpec {
                label: id.to_string(),
                start_m: self.point(&key("start_m"), table.start_m)?,
                speed_mps: self.number(&key("speed_mps"), table.speed_mps, defaults::SPEED_MPS, SPEED_MPS)?,
                sensor,
                reported: sensor,
                calibration: Calibration::default(),
                nuisances,
            });
        }
        Ok(robots.into_iter().flatten().collect())
    }

    /// The sensor and the nuisances of a robot.
    fn equip(
        &self,
        choice: &Choice<'_>,
        equipment: &Equipment<'_>,
    ) -> Result<(SensorSpec, NuisanceSpec), ScenarioError> {
        let key = |name: &str| format!("{}.{name}", choice.table);
        let (sensor, bias) = match choice.sensor {
            None => {
                let std_m = self.number(&key("range_std_m"), choice.range_std_m, defaults::RANGE_STD_M, STD_M)?;
                (SensorSpec::range(std_m), NuisanceSpec::default())
            }
            Some(name) => {
                if let Some(std_m) = choice.range_std_m {
                    let expected = format!("the noise in [sensor.{name}]");
                    return Err(self.refuse(&key("range_std_m"), expected, std_m));
                }
                self.sensor(name, self.named(&key("sensor"), "sensor", name, equipment.sensors)?)?
            }
        };
        let pose = match choice.localiser {
            None => NuisanceSpec::default(),
            Some(name) => {
                self.localiser(name, self.named(&key("localiser"), "localiser", name, equipment.localisers)?)?
            }
        };
        let NuisanceSpec { bias_std_m, bias_correlation_s, .. } = bias;
        Ok((sensor, NuisanceSpec { bias_std_m, bias_correlation_s, ..pose }))
    }

    /// The table of this name.
    fn named<'t, T>(
        &self,
        key: &str,
        what: &str,
        name: &str,
        tables: &'t BTreeMap<String, T>,
    ) -> Result<&'t T, ScenarioError> {
        tables.get(name).ok_or_else(|| {
            let known: Vec<String> = tables.keys().map(|name| quoted(name)).collect();
            let expected = match known.is_empty() {
                true => format!("the name of a table [{what}.NAME], of which there are none"),
                false => format!("the name of a table [{what}.NAME], one of {}", known.join(", ")),
            };
            self.refuse(key, expected, quoted(name))
        })
    }

    /// The measurements of a `[sensor.NAME]`, and the nuisances of its ranges.
    fn sensor(&self, name: &str, table: &SensorTable) -> Result<(SensorSpec, NuisanceSpec), ScenarioError> {
        let key = |key: &str| format!("sensor.{name}.{key}");
        let std_per_m = self.number(&key("range_std_per_m"), table.range_std_per_m, 0.0, STD_PER_M)?;
        let bias_std_m = self.number(&key("range_bias_std_m"), table.range_bias_std_m, 0.0, NUISANCE_STD_M)?;
        let bias_correlation_s = match table.range_bias_correlation_s {
            None => None,
            time_s => Some(self.number(&key("range_bias_correlation_s"), time_s, 0.0, CORRELATION_S)?),
        };
        let range = match table.range_std_m {
            None => None,
            std_m => Some(RangeNoise { std_m: self.number(&key("range_std_m"), std_m, 0.0, STD_M)?, std_per_m }),
        };
        for (of_range, given) in [
            ("range_std_per_m", table.range_std_per_m.is_some()),
            ("range_bias_std_m", table.range_bias_std_m.is_some()),
            ("range_bias_correlation_s", table.range_bias_correlation_s.is_some()),
        ] {
            if given && range.is_none() {
                return Err(self.refuse(&key(of_range), "both of them, or neither", "given without range_std_m"));
            }
        }
        let bearing_std_rad = match table.bearing_std_rad {
            None => None,
            std_rad => Some(self.number(&key("bearing_std_rad"), std_rad, 0.0, BEARING_STD_RAD)?),
        };
        if range.is_none() && bearing_std_rad.is_none() {
            let expected = "range_std_m, bearing_std_rad or both";
            return Err(self.refuse(&format!("sensor.{name}"), expected, "a sensor without either"));
        }
        let max_range_m = match table.max_range_m {
            None => None,
            limit_m => Some(self.number(&key("max_range_m"), limit_m, 0.0, MAX_RANGE_M)?),
        };
        let field_of_view_rad = match table.field_of_view_rad {
            None => None,
            angle_rad => Some(self.number(&key("field_of_view_rad"), angle_rad, TAU, FIELD_OF_VIEW_RAD)?),
        };
        let sensor = SensorSpec { range, bearing_std_rad, max_range_m, field_of_view_rad };
        Ok((sensor, NuisanceSpec { bias_std_m, bias_correlation_s, ..NuisanceSpec::default() }))
    }

    /// The nuisances of a pose from a `[localiser.NAME]`.
    fn localiser(&self, name: &str, table: &LocaliserTable) -> Result<NuisanceSpec, ScenarioError> {
        self.pose_nuisances(|key| format!("localiser.{name}.{key}"), table)
    }

    /// The nuisances of a pose. `key` names a key of the table in errors.
    pub(super) fn pose_nuisances(
        &self,
        key: impl Fn(&str) -> String,
        table: &LocaliserTable,
    ) -> Result<NuisanceSpec, ScenarioError> {
        let pose_std_m = self.number(&key("std_m"), table.std_m, 0.0, NUISANCE_STD_M)?;
        let pose_drift_m = self.number(&key("drift_m"), table.drift_m, 0.0, NUISANCE_STD_M)?;
        let correlation = match (table.drift_m, table.correlation_s) {
            (Some(_), Some(_)) => {
                return Err(self.refuse(&key("correlation_s"), "only one of them", "given together with drift_m"));
            }
            (Some(_), None) => PoseCorrelation::Drift,
            (None, Some(_)) => {
                PoseCorrelation::Time(self.number(&key("correlation_s"), table.correlation_s, 0.0, CORRELATION_S)?)
            }
            (None, None) => PoseCorrelation::White,
        };
        let heading_std_rad = self.number(&key("heading_std_rad"), table.heading_std_rad, 0.0, HEADING_STD_RAD)?;
        Ok(NuisanceSpec { pose_std_m, pose_drift_m, heading_std_rad, correlation, ..NuisanceSpec::default() })
    }
}

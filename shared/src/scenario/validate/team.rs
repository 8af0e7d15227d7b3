//! The team: identical robots, or one by one.

use super::Checker;
use crate::ROBOTS_MAX;
use crate::scenario::bounds::{SPEED_MPS, STD_M};
use crate::scenario::{Calibration, RobotSpec, RobotTable, RobotsTable, ScenarioError, defaults};

impl Checker<'_> {
    pub(super) fn team(
        &self,
        alike: Option<&RobotsTable>,
        each: Option<&[RobotTable]>,
    ) -> Result<Vec<RobotSpec>, ScenarioError> {
        match (alike, each) {
            (Some(_), Some(_)) => Err(self.refuse(
                "robots",
                "either [robots] with a count or a [[robot]] for each",
                "given beside [[robot]]",
            )),
            (alike, None) => self.alike_team(&alike.cloned().unwrap_or_default()),
            (None, Some(tables)) => self.mixed_team(tables),
        }
    }

    pub(super) fn alike_team(&self, table: &RobotsTable) -> Result<Vec<RobotSpec>, ScenarioError> {
        let count = self.whole("robots.count", table.count, defaults::ROBOTS, 1..=ROBOTS_MAX as u64)?;
        let centre_m = self.point("robots.start_m", table.start_m)?;
        let radius_m = self.number("robots.ring_radius_m", table.ring_radius_m, 0.0, 0.0..=1e6)?;
        let speed_mps = self.number("robots.speed_mps", table.speed_mps, defaults::SPEED_MPS, SPEED_MPS)?;
        let range_std_m = self.number("robots.range_std_m", table.range_std_m, defaults::RANGE_STD_M, STD_M)?;
        Ok((0..count)
            .map(|id| {
                let (sin, cos) = (std::f64::consts::TAU * id as f64 / count as f64).sin_cos();
                RobotSpec {
                    label: id.to_string(),
                    start_m: [centre_m[0] + radius_m * cos, centre_m[1] + radius_m * sin],
                    speed_mps,
                    range_std_m,
                    reported_std_m: range_std_m,
                    calibration: Calibration::default(),
                }
            })
            .collect())
    }

    pub(super) fn mixed_team(&self, tables: &[RobotTable]) -> Result<Vec<RobotSpec>, ScenarioError> {
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
            let range_std_m = self.number(&key("range_std_m"), table.range_std_m, defaults::RANGE_STD_M, STD_M)?;
            *slot = Some(RobotSpec {
                label: id.to_string(),
                start_m: self.point(&key("start_m"), table.start_m)?,
                speed_mps: self.number(&key("speed_mps"), table.speed_mps, defaults::SPEED_MPS, SPEED_MPS)?,
                range_std_m,
                reported_std_m: range_std_m,
                calibration: Calibration::default(),
            });
        }
        Ok(robots.into_iter().flatten().collect())
    }
}

//! Single values: numbers within their bounds, points, states, matrices.

use std::fmt::Display;
use std::ops::RangeInclusive;

use super::Checker;
use crate::motion::matrix::Matrix;
use crate::scenario::bounds::{COORDINATE, MATRIX_ENTRY, STATE};
use crate::scenario::{ScenarioError, defaults};

impl Checker<'_> {
    pub(super) fn point(&self, key: &str, value: Option<[f64; 2]>) -> Result<[f64; 2], ScenarioError> {
        let point = value.unwrap_or(defaults::ROBOT_START_M);
        for coordinate in point {
            self.number(key, Some(coordinate), coordinate, COORDINATE)?;
        }
        Ok(point)
    }

    pub(super) fn state(&self, key: &str, state: &[f64], n: usize) -> Result<Vec<f64>, ScenarioError> {
        if state.len() != n {
            return Err(self.refuse(key, list_of(n, "number"), format!("a list of {}", state.len())));
        }
        for value in state {
            self.number(key, Some(*value), *value, STATE)?;
        }
        Ok(state.to_vec())
    }

    pub(super) fn matrix(&self, key: &str, rows: Option<&[Vec<f64>]>) -> Result<Matrix, ScenarioError> {
        let Some(rows) = rows else {
            return Err(self.refuse(key, "a matrix as a list of rows", "missing"));
        };
        for value in rows.iter().flatten() {
            self.number(key, Some(*value), *value, MATRIX_ENTRY)?;
        }
        Matrix::from_rows(rows).ok_or_else(|| self.refuse(key, "a matrix with rows of one length", "not a matrix"))
    }

    pub(super) fn number(
        &self,
        key: &str,
        value: Option<f64>,
        default: f64,
        bounds: RangeInclusive<f64>,
    ) -> Result<f64, ScenarioError> {
        let value = value.unwrap_or(default);
        if bounds.contains(&value) {
            Ok(value)
        } else {
            let expected = format!("a number from {} to {}", bounds.start(), bounds.end());
            Err(self.refuse(key, expected, value))
        }
    }

    pub(super) fn whole(
        &self,
        key: &str,
        value: Option<u64>,
        default: u64,
        bounds: RangeInclusive<u64>,
    ) -> Result<u64, ScenarioError> {
        let value = value.unwrap_or(default);
        if bounds.contains(&value) {
            Ok(value)
        } else {
            let expected = format!("a whole number from {} to {}", bounds.start(), bounds.end());
            Err(self.refuse(key, expected, value))
        }
    }

    pub(super) fn refuse(&self, key: &str, expected: impl Display, got: impl Display) -> ScenarioError {
        ScenarioError::WrongValue {
            file: self.file.to_owned(),
            key: key.to_owned(),
            expected: expected.to_string(),
            got: got.to_string(),
        }
    }
}

pub(super) fn quoted(text: &str) -> String {
    format!("{text:?}")
}

/// The description of a list with an item for each state.
pub(super) fn list_of(n: usize, what: &str) -> String {
    format!("a list of {n}, one {what} for each state of the model")
}

//! When the target was found, and how well it was tracked from then on.

use super::FoundSummary;
use super::verdict::VAGUE_SHARE;
use crate::statistics::Mean;

/// The ticks at which the position was better known than at any tick before, each with the errors until then.
#[derive(Debug, Default)]
pub(super) struct Search {
    steps: Vec<Step>,
}

#[derive(Debug)]
struct Step {
    tick: u64,
    trace_m2: f64,
    squared_error_before_m2: Mean,
}

impl Search {
    /// Adds the trace of a tick's position covariance, with the squared errors of all ticks before.
    pub(super) fn add(&mut self, tick: u64, trace_m2: f64, squared_error_before_m2: Mean) {
        if self.steps.last().is_none_or(|last| trace_m2 < last.trace_m2) {
            self.steps.push(Step { tick, trace_m2, squared_error_before_m2 });
        }
    }

    /// The tick at which the search ended; `None` if there was none, or if it did not end. `distance_m` is a typical distance of
    /// the target, and `squared_error_m2` has the errors of all ticks.
    pub(super) fn end(&self, distance_m: f64, squared_error_m2: Mean) -> Option<FoundSummary> {
        let is_small = |step: &&Step| step.trace_m2.sqrt() <= VAGUE_SHARE * distance_m;
        let first = self.steps.first()?;
        let step = self.steps.iter().find(is_small).filter(|step| step.tick > first.tick)?;
        let squared_error_m2 = squared_error_m2.without(step.squared_error_before_m2);
        Some(FoundSummary { tick: step.tick, position_rmse_m: squared_error_m2.value().map(f64::sqrt) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Traces and errors tick by tick, from tick 1 on; the typical distance is 10 m.
    fn found(ticks: &[(f64, Option<f64>)]) -> Option<FoundSummary> {
        let (mut search, mut squared_error_m2) = (Search::default(), Mean::default());
        for (tick, (trace_m2, error_m)) in (1..).zip(ticks) {
            search.add(tick, *trace_m2, squared_error_m2);
            if let Some(error_m) = error_m {
                squared_error_m2.add(error_m * error_m);
            }
        }
        search.end(10.0, squared_error_m2)
    }

    #[test]
    fn errors_count_from_the_first_tick_at_which_the_position_is_known() {
        let ticks = [(40.0, Some(7.0)), (50.0, Some(9.0)), (8.0, Some(3.0)), (20.0, Some(5.0)), (0.1, Some(1.0))];
        let rmse_m = (35.0_f64 / 3.0).sqrt();
        assert_eq!(found(&ticks), Some(FoundSummary { tick: 3, position_rmse_m: Some(rmse_m) }));
    }

    #[test]
    fn without_a_truth_only_the_tick_is_known() {
        assert_eq!(found(&[(40.0, None), (8.0, None)]), Some(FoundSummary { tick: 2, position_rmse_m: None }));
    }

    #[test]
    fn a_target_that_is_known_at_once_or_never_was_not_searched_for_and_found() {
        assert_eq!(found(&[(8.0, Some(1.0)), (0.1, Some(1.0))]), None);
        assert_eq!(found(&[(40.0, Some(1.0)), (30.0, Some(1.0))]), None);
        assert_eq!(found(&[]), None);
    }
}

//! Uniformly random headings: the baseline of the comparison.

use std::f64::consts::{PI, TAU};

use rangehound_shared::draws::{Draws, Stream};

use super::{Problem, Solution, Solver};

/// Each heading uniform on the circle, a function of (seed, tick, place in the team).
#[derive(Debug, Clone)]
pub struct Random {
    draws: Draws,
    /// Reused memory.
    drawn: Vec<f64>,
}

impl Random {
    /// Random headings under this seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self { draws: Draws::new(seed, Stream::RandomPlanner), drawn: Vec::new() }
    }
}

impl Solver for Random {
    fn name(&self) -> &'static str {
        "random"
    }

    fn solve(&mut self, tick: u64, problem: &Problem, solution: &mut Solution) {
        self.drawn.resize(problem.len(), 0.0);
        self.draws.uniform(tick, &mut self.drawn);
        solution.directions.clear();
        solution.commands.clear();
        for (i, drawn) in self.drawn.iter().enumerate() {
            let (direction, command) = problem.after_heading(i, drawn * TAU - PI);
            solution.directions.push(direction);
            solution.commands.push(command);
        }
        solution.value(problem);
    }
}

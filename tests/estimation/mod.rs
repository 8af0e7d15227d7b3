//! The accuracy of teams in this process: against the paper, against references, with faulty sensors.

mod comparison;
mod distrust;
mod golden;
mod paper;

//! The trace of an exploration: a table of what happened, by node.

use std::fmt::Write as _;

use super::plan::Plan;

/// A line of the trace.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct TraceLine {
    /// When, ns since the start.
    pub(super) at_ns: u64,
    /// The node that it is about, if any.
    pub(super) node: Option<usize>,
    /// The node's action, or the event that it met.
    pub(super) what: String,
}

/// The trace as a table: a line for each event, with a column for its node.
pub(super) fn table(plan: &Plan, trace: &[TraceLine]) -> String {
    let name_of = |node: Option<usize>| node.map_or_else(|| "run".to_owned(), |node| plan.name_of(node));
    let width = (0..=plan.nodes()).map(|node| plan.name_of(node).len()).max().unwrap_or(0);
    trace.iter().fold(String::new(), |mut text, TraceLine { at_ns, node, what }| {
        let _ = writeln!(text, "{:>12.3} ms  {:width$}  {what}", *at_ns as f64 / 1e6, name_of(*node));
        text
    })
}

//! What happened, as a table of events by node.

use std::fmt::Write as _;

use super::plan::Plan;

/// A line of a story.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct StoryLine {
    /// When, ns since the start.
    pub(super) at_ns: u64,
    /// The node, if it is one's.
    pub(super) node: Option<usize>,
    /// What it did, or what was done to it.
    pub(super) what: String,
}

/// The story as a table: a line for each event, a column for its node.
pub(super) fn table(plan: &Plan, story: &[StoryLine]) -> String {
    let name_of = |node: Option<usize>| node.map_or_else(|| "run".to_owned(), |node| plan.name_of(node));
    let width = (0..plan.nodes()).map(|node| plan.name_of(node).len()).max().unwrap_or(0);
    story.iter().fold(String::new(), |mut text, StoryLine { at_ns, node, what }| {
        let _ = writeln!(text, "{:>12.3} ms  {:width$}  {what}", *at_ns as f64 / 1e6, name_of(*node));
        text
    })
}

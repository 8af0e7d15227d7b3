//! Who takes the lead when.

use crate::study::explore::lead::Lead;
use crate::study::explore::process::Node;

/// A standby has a lead that is free after this time at the latest: at once, or at its next look, ns.
const INHERITS_NS: u64 = 60_000_000;

/// What a standby needs before it knows whom to wait for: some looks, ns.
const SETTLED_NS: u64 = 150_000_000;

/// A leader that hangs is deposed after this time: ten looks of 50 ms, and some that count for its last sign, ns.
const DEPOSES_NS: u64 = 700_000_000;

/// One that has taken part for this long has given signs of it, ns.
const SIGNS_NS: u64 = 400_000_000;

/// A standby looks, having stood by undisturbed for so long: it leaves the lead neither free nor with one that hangs.
pub(in crate::study::explore) fn waits(
    lead: &Lead,
    nodes: &[Node],
    stood_by_ns: u64,
    now_ns: u64,
) -> Result<(), String> {
    let free_ns = lead.free_since_ns.map_or(0, |since_ns| now_ns - since_ns);
    if free_ns > INHERITS_NS && stood_by_ns > free_ns + SETTLED_NS {
        return Err("it does not take a lead that is free".to_owned());
    }
    let hung_ns = lead.holder.map_or(0, |node| nodes[node].stopped_for_ns(now_ns));
    if hung_ns > DEPOSES_NS && stood_by_ns > hung_ns {
        return Err("it does not depose a leader that hangs".to_owned());
    }
    Ok(())
}

/// A standby deposes who leads: not one that runs.
pub(in crate::study::explore) fn deposes(nodes: &[Node], holder: Option<usize>, now_ns: u64) -> Result<(), String> {
    if holder.is_some_and(|node| nodes[node].well_for_ns(now_ns) > SIGNS_NS) {
        return Err("it deposed a leader that sends heartbeats".to_owned());
    }
    Ok(())
}

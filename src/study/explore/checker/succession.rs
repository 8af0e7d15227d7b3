//! When a standby takes the lead.

use crate::study::explore::lead::Lead;
use crate::study::explore::node::Node;

/// A standby must take a free lead within this time: at once, or at its next look, ns.
const SUCCEEDS_NS: u64 = 60_000_000;

/// Time that a standby needs until it waits for the right lock: some looks, ns.
const SETTLED_NS: u64 = 150_000_000;

/// A hung leader must be deposed within this time: ten looks of 50 ms, and some for its last heartbeat, ns.
const DEPOSES_NS: u64 = 700_000_000;

/// A process that has taken part for this long has sent heartbeats, ns.
const HEARTBEATS_NS: u64 = 400_000_000;

/// A standby looks, after it has stood by undisturbed for `stood_by_ns`: it must not leave the lead free or with a hung
/// leader.
pub(in crate::study::explore) fn waits(
    lead: &Lead,
    nodes: &[Node],
    stood_by_ns: u64,
    now_ns: u64,
) -> Result<(), String> {
    let free_ns = lead.free_since_ns.map_or(0, |since_ns| now_ns - since_ns);
    if free_ns > SUCCEEDS_NS && stood_by_ns > free_ns + SETTLED_NS {
        return Err("it does not take a lead that is free".to_owned());
    }
    let hung_ns = lead.holder.map_or(0, |node| nodes[node].stopped_for_ns(now_ns));
    if hung_ns > DEPOSES_NS && stood_by_ns > hung_ns {
        return Err("it does not depose a leader that hangs".to_owned());
    }
    Ok(())
}

/// A standby deposes the leader: it must not depose a running one.
pub(in crate::study::explore) fn deposes(nodes: &[Node], holder: Option<usize>, now_ns: u64) -> Result<(), String> {
    if holder.is_some_and(|node| nodes[node].well_for_ns(now_ns) > HEARTBEATS_NS) {
        return Err("it deposed a leader that sends heartbeats".to_owned());
    }
    Ok(())
}

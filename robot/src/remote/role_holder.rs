//! How long a link may be silent, and which process has the role of a robot on another host.

/// Least silence after which a link counts as lost, ns: some intervals of the frames that keep it alive.
const SILENT_NS: u64 = 500_000_000;

/// Round trips of silence after which it does: opening it again takes two, and the first frame of a robot that joins comes after one.
const SILENT_ROUND_TRIPS: u64 = 3;

/// Silence after which a robot is gone, ns: its role is free for any process.
const GONE_NS: u64 = 3_000_000_000;

/// Silence after which a link with this round trip counts as lost, ns: its robot opens it again, and another process may take the
/// robot's role.
#[must_use]
pub fn silence_max_ns(round_trip_ns: u64) -> u64 {
    round_trip_ns.saturating_mul(SILENT_ROUND_TRIPS).clamp(SILENT_NS, GONE_NS)
}

/// The process that has a robot's role, as the gateway knows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RoleHolder {
    process: u64,
    heard_ns: u64,
}

/// The answer to a process that asks for a role.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Claim {
    /// It has the role, and has opened another link.
    ComesBack,
    /// Another process has the role, and is heard.
    Refused,
    /// It takes the role from one that is silent.
    Succeeds,
}

impl RoleHolder {
    /// A process that takes the role; `process` is a number that no other has.
    #[must_use]
    pub fn new(process: u64, now_ns: u64) -> Self {
        Self { process, heard_ns: now_ns }
    }

    /// Decides on a process that asks for the role; `round_trip_ns` is of the link of the one that has it.
    pub fn claim(&mut self, process: u64, round_trip_ns: u64, now_ns: u64) -> Claim {
        if process == self.process {
            self.hear(now_ns);
            Claim::ComesBack
        } else if self.is_heard(round_trip_ns, now_ns) {
            Claim::Refused
        } else {
            Claim::Succeeds
        }
    }

    /// A frame of it came.
    pub fn hear(&mut self, now_ns: u64) {
        self.heard_ns = now_ns;
    }

    /// Time since its last frame, ns.
    #[must_use]
    pub fn silence_ns(&self, now_ns: u64) -> u64 {
        now_ns.saturating_sub(self.heard_ns)
    }

    /// True while no other process may take its role.
    #[must_use]
    pub fn is_heard(&self, round_trip_ns: u64, now_ns: u64) -> bool {
        self.silence_ns(now_ns) < silence_max_ns(round_trip_ns)
    }

    /// True once its role is free.
    #[must_use]
    pub fn is_gone(&self, now_ns: u64) -> bool {
        self.silence_ns(now_ns) > GONE_NS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NEAR_NS: u64 = 1_000_000;

    #[test]
    fn a_role_is_claimed_only_from_a_silent_process() {
        let mut holder = RoleHolder::new(7, 1_000);
        assert_eq!(holder.claim(8, NEAR_NS, 1_000 + SILENT_NS - 1), Claim::Refused);
        assert_eq!(holder.claim(8, NEAR_NS, 1_000 + SILENT_NS), Claim::Succeeds);
        assert_eq!(holder.claim(7, NEAR_NS, 1_000 + SILENT_NS), Claim::ComesBack);
        assert_eq!(holder.claim(8, NEAR_NS, 1_000 + SILENT_NS), Claim::Refused, "it was heard again");
        assert!(!holder.is_gone(1_000 + SILENT_NS + GONE_NS) && holder.is_gone(1_001 + SILENT_NS + GONE_NS));
        holder.hear(u64::MAX);
        assert_eq!(holder.silence_ns(0), 0, "a clock that jumps back");
    }

    /// Its first frame comes a round trip after it has joined.
    #[test]
    fn over_a_slow_link_a_process_that_has_just_joined_keeps_its_role() {
        let round_trip_ns = 600_000_000;
        let mut holder = RoleHolder::new(7, 0);
        assert_eq!(holder.claim(8, round_trip_ns, 2 * round_trip_ns), Claim::Refused);
        assert_eq!(holder.claim(8, round_trip_ns, 3 * round_trip_ns), Claim::Succeeds);
        assert_eq!([0, 150_000_000, u64::MAX].map(silence_max_ns), [SILENT_NS, SILENT_NS, GONE_NS]);
    }
}

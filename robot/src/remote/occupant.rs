//! Which process has the role of a robot on another host.

/// Silence after which another process may take a robot's role, ns: some intervals of the frames that keep a link alive.
const CLAIM_NS: u64 = 500_000_000;

/// Silence after which a robot is gone, ns: its role is free for any process.
const GONE_NS: u64 = 3_000_000_000;

/// The process that has a robot's role, as the gateway knows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Occupant {
    process: u64,
    heard_ns: u64,
}

/// What becomes of a process that asks for a role.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Claim {
    /// It has the role, and has opened another link.
    ComesBack,
    /// Another process has the role, and is heard.
    Refused,
    /// It takes the role from one that is silent.
    Succeeds,
}

impl Occupant {
    /// A process that takes the role; `process` is a number that no other has.
    #[must_use]
    pub fn new(process: u64, now_ns: u64) -> Self {
        Self { process, heard_ns: now_ns }
    }

    /// Decides on a process that asks for the role.
    pub fn claim(&mut self, process: u64, now_ns: u64) -> Claim {
        if process == self.process {
            self.hear(now_ns);
            Claim::ComesBack
        } else if self.is_heard(now_ns) {
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
    pub fn is_heard(&self, now_ns: u64) -> bool {
        self.silence_ns(now_ns) < CLAIM_NS
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

    #[test]
    fn a_role_is_claimed_only_from_a_silent_process() {
        let mut occupant = Occupant::new(7, 1_000);
        assert_eq!(occupant.claim(8, 1_000 + CLAIM_NS - 1), Claim::Refused);
        assert_eq!(occupant.claim(8, 1_000 + CLAIM_NS), Claim::Succeeds);
        assert_eq!(occupant.claim(7, 1_000 + CLAIM_NS), Claim::ComesBack);
        assert_eq!(occupant.claim(8, 1_000 + CLAIM_NS), Claim::Refused, "it was heard again");
        assert!(!occupant.is_gone(1_000 + CLAIM_NS + GONE_NS) && occupant.is_gone(1_001 + CLAIM_NS + GONE_NS));
        occupant.hear(u64::MAX);
        assert_eq!(occupant.silence_ns(0), 0, "a clock that jumps back");
    }
}

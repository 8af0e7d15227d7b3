//! The rules of succession in a role, pure. [`Roster`](super::Roster) applies them with files and locks; `rangehound explore`
//! with simulated ones.

/// The state of a role: how often it was taken, and its holder's last heartbeat, if any. `S` is a
/// heartbeat's stamp, compared only for equality.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Tenure<S> {
    /// How often it was taken: the current or last holder's incarnation.
    pub starts: u64,
    /// The last heartbeat.
    pub heartbeat: Option<S>,
}

impl<S: PartialEq> Tenure<S> {
    /// The next holder's incarnation: greater than all before, because it is the fencing token.
    #[must_use]
    pub fn next_incarnation(&self) -> u64 {
        self.starts + 1
    }

    /// True if a process that saw this heartbeat last may depose the holder: the holder has sent no other since, and nobody else
    /// has taken the role.
    #[must_use]
    pub fn is_silent_since(&self, heartbeat: &S) -> bool {
        self.heartbeat.as_ref() == Some(heartbeat)
    }
}

/// True if the leader of this incarnation must use a new checkpoint file. A predecessor may have been deposed and may wake up
/// later, even if its deposer ended before it had a new file.
#[must_use]
pub fn needs_own_checkpoint(incarnation: u64) -> bool {
    incarnation > 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_holder_without_a_newer_heartbeat_is_deposed() {
        let tenure = Tenure { starts: 3, heartbeat: Some(7) };
        assert!(tenure.is_silent_since(&7) && !tenure.is_silent_since(&6));
        assert!(!Tenure { starts: 0, heartbeat: None }.is_silent_since(&7));
        assert_eq!(tenure.next_incarnation(), 4);
        // Also a leader that took a free role: the first one's deposer may have ended before it moved the file.
        assert!(!needs_own_checkpoint(1) && needs_own_checkpoint(2) && needs_own_checkpoint(3));
    }
}

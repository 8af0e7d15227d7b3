//! Who follows whom in a role: the rules, pure. [`Roster`](super::Roster) keeps them with files and locks; `rangehound explore`
//! with simulated ones.

/// What is known of a role: how often it was taken, and its holder's last heartbeat, if it ever had one. `S` is such a
/// sign, of which only whether it changes means anything.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Tenure<S> {
    /// How often it was taken: the holder's incarnation, or the last one's.
    pub starts: u64,
    /// The last heartbeat.
    pub heartbeat: Option<S>,
}

impl<S: PartialEq> Tenure<S> {
    /// The incarnation of whoever takes it next: greater than all before, as it is the fencing token.
    #[must_use]
    pub fn next_incarnation(&self) -> u64 {
        self.starts + 1
    }

    /// True if the holder may be deposed by one who saw it give this sign last: it has given no other since, and nobody else
    /// has taken the role.
    #[must_use]
    pub fn is_silent_since(&self, heartbeat: &S) -> bool {
        self.heartbeat.as_ref() == Some(heartbeat)
    }
}

/// True if who leads in this incarnation goes on in a checkpoint file of its own. One before it may have been deposed and wake up
/// yet, also where whoever deposed it has ended before it had a file of its own.
#[must_use]
pub fn needs_own_checkpoint(incarnation: u64) -> bool {
    incarnation > 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_who_has_given_no_sign_since_is_deposed() {
        let tenure = Tenure { starts: 3, heartbeat: Some(7) };
        assert!(tenure.is_silent_since(&7) && !tenure.is_silent_since(&6));
        assert!(!Tenure { starts: 0, heartbeat: None }.is_silent_since(&7));
        assert_eq!(tenure.next_incarnation(), 4);
        // Also one that takes it from nobody: whoever deposed the first one may have ended before it had moved the file.
        assert!(!needs_own_checkpoint(1) && needs_own_checkpoint(2) && needs_own_checkpoint(3));
    }
}

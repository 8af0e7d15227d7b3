//! The action of a robot that joins again.

/// An incarnation of a run: a run that is resumed has another one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RunIncarnation {
    /// Id of the run.
    pub run_id: u64,
    /// Its incarnation.
    pub life: u64,
}

/// The action of a robot that has joined.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rejoin {
    /// It goes on where it was.
    Continue,
    /// It starts anew with the equipment that it has: simulator and fusion have lower incarnations than those that it knew.
    Restart,
    /// It starts in a run that it does not know.
    Start,
}

impl RunIncarnation {
    /// The action of a robot that joins this incarnation of a run after that one, if any.
    #[must_use]
    pub fn after(self, before: Option<Self>) -> Rejoin {
        match before {
            Some(Self { run_id, life }) if run_id == self.run_id => {
                if life == self.life {
                    Rejoin::Continue
                } else {
                    Rejoin::Restart
                }
            }
            _ => Rejoin::Start,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_same_life_of_the_same_run_goes_on() {
        let [known, resumed, other] = [(1, 5), (1, 6), (2, 5)].map(|(run_id, life)| RunIncarnation { run_id, life });
        assert_eq!(known.after(Some(known)), Rejoin::Continue);
        assert_eq!(resumed.after(Some(known)), Rejoin::Restart);
        assert_eq!([other.after(Some(known)), known.after(None)], [Rejoin::Start; 2]);
    }
}

//! The action of a robot that joins again.

/// One life of a run: a run that is resumed has another one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RunLife {
    /// Id of the run.
    pub run_id: u64,
    /// Its life.
    pub life: u64,
}

/// The action of a robot that has joined.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rejoin {
    /// It goes on where it was.
    GoesOn,
    /// It starts anew with the equipment that it has: simulator and fusion have lower incarnations than those that it knew.
    StartsAnew,
    /// It starts in a run that it does not know.
    Starts,
}

impl RunLife {
    /// The action of a robot that joins this life of a run after that one, if any.
    #[must_use]
    pub fn after(self, before: Option<Self>) -> Rejoin {
        match before {
            Some(Self { run_id, life }) if run_id == self.run_id => {
                if life == self.life {
                    Rejoin::GoesOn
                } else {
                    Rejoin::StartsAnew
                }
            }
            _ => Rejoin::Starts,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_same_life_of_the_same_run_goes_on() {
        let [known, resumed, other] = [(1, 5), (1, 6), (2, 5)].map(|(run_id, life)| RunLife { run_id, life });
        assert_eq!(known.after(Some(known)), Rejoin::GoesOn);
        assert_eq!(resumed.after(Some(known)), Rejoin::StartsAnew);
        assert_eq!([other.after(Some(known)), known.after(None)], [Rejoin::Starts; 2]);
    }
}

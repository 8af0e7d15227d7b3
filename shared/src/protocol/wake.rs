//! Who can be woken, and why: what roles ask for, without the means.

/// Who can be woken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WaitGroup {
    /// The simulator.
    Sim,
    /// The fusion centre.
    Fusion,
    /// All robots.
    Robots,
}

/// Why somebody is woken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Event {
    /// There is something on the topic `world`.
    World,
    /// On `range`.
    Range,
    /// On `heading`.
    Heading,
    /// On `drive`.
    Drive,
    /// A node has just started and needs the present tick.
    Hello,
    /// The run has ended.
    Finished,
}

/// How many kinds of calls there are.
pub const EVENTS: usize = 6;

/// What a wait returned: the calls that came, none if time ran out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Events([bool; EVENTS]);

impl Events {
    /// The calls that came, in the order of [`Event`].
    #[must_use]
    pub fn new(came: [bool; EVENTS]) -> Self {
        Self(came)
    }

    /// True if this call was among them.
    #[must_use]
    pub fn has(self, event: Event) -> bool {
        self.0[event as usize]
    }

    /// True if nobody called: what there is to see has been seen, unless a call was lost in a kill.
    #[must_use]
    pub fn is_empty(self) -> bool {
        self == Self::default()
    }
}

/// A wake-up that a role asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Notification {
    /// Who is woken.
    pub to: WaitGroup,
    /// Why.
    pub event: Event,
    /// On what condition.
    pub when: When,
}

/// On what condition somebody is woken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum When {
    /// On none.
    Always,
    /// If this is the last answer to a tick that they wait for; or the first, if that is asked for.
    LastAnswer {
        /// The tick that is answered.
        tick: u64,
        /// The first wakes too.
        or_first: bool,
    },
}

impl Notification {
    /// A wake-up on no condition.
    #[must_use]
    pub fn always(to: WaitGroup, event: Event) -> Self {
        Self { to, event, when: When::Always }
    }

    /// A wake-up by the last answer to a tick.
    #[must_use]
    pub fn by_last_answer(to: WaitGroup, event: Event, tick: u64, or_first: bool) -> Self {
        Self { to, event, when: When::LastAnswer { tick, or_first } }
    }
}

/// Bits of an answers' word that count.
const COUNT_BITS: u32 = 16;

/// The answers to the newest tick that a sleeper was sent, in one word, so that processes count them without a lock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Answers(u64);

impl Answers {
    /// The answers in a word, as [`Self::to_bits`] gave it.
    #[must_use]
    pub fn from_bits(bits: u64) -> Self {
        Self(bits)
    }

    /// Their word: the tick's number, from 1, above; their count in the lowest bits.
    #[must_use]
    pub fn to_bits(self) -> u64 {
        self.0
    }

    /// With an answer to a tick; `None` if that tick is over, since another is answered.
    #[must_use]
    pub fn with(self, tick: u64) -> Option<Self> {
        let number = tick + 1;
        match self.0 >> COUNT_BITS {
            newest if newest < number => Some(Self(number << COUNT_BITS | 1)),
            newest if newest == number => Some(Self(self.0 + 1)),
            _ => None,
        }
    }

    /// True if the last of these calls a sleeper that waits for so many: it is the last, or the first if that is asked for. One too
    /// many calls again: a robot that was started again has answered twice.
    #[must_use]
    pub fn event(self, expected: u64, or_first: bool) -> bool {
        let count = self.0 & ((1 << COUNT_BITS) - 1);
        count >= expected || or_first && count == 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_answer_to_the_newest_tick_calls() {
        let mut answers = Answers::default();
        let mut event = |tick, expected, or_first| match answers.with(tick) {
            Some(counted) => {
                answers = Answers::from_bits(counted.to_bits());
                Some(counted.event(expected, or_first))
            }
            None => None,
        };
        for tick in [0, 1, 7] {
            assert_eq!([0; 3].map(|_| event(tick, 3, false)), [Some(false), Some(false), Some(true)], "{tick}");
            assert_eq!(event(tick, 3, false), Some(true), "of one that was started again");
        }
        assert_eq!([0; 3].map(|_| event(8, 3, true)), [Some(true), Some(false), Some(true)]);
        assert_eq!(event(7, 3, false), None, "of a tick that is over");
    }
}

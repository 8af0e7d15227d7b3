//! Wait groups and events: the wake-ups that roles ask for, without their implementation.

/// A group of processes that can be woken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WaitGroup {
    /// The simulator.
    Sim,
    /// The fusion centre.
    Fusion,
    /// All robots.
    Robots,
}

/// The reason for a wake-up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Event {
    /// A message on the topic `world`.
    World,
    /// A message on `range`.
    Range,
    /// A message on `heading`.
    Heading,
    /// A message on `drive`.
    Drive,
    /// A node has just started and needs the current tick.
    Hello,
    /// The run has ended.
    Finished,
}

/// Number of kinds of events.
pub const EVENTS: usize = 6;

/// The result of a wait: the events that came, none after a time-out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Events([bool; EVENTS]);

impl Events {
    /// The events that came, in the order of [`Event`].
    #[must_use]
    pub fn new(came: [bool; EVENTS]) -> Self {
        Self(came)
    }

    /// True if this event came.
    #[must_use]
    pub fn has(self, event: Event) -> bool {
        self.0[event as usize]
    }

    /// True if no event came: then all messages have been seen, unless a kill lost an event.
    #[must_use]
    pub fn is_empty(self) -> bool {
        self == Self::default()
    }
}

/// A wake-up that a role asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Notification {
    /// The group to wake.
    pub to: WaitGroup,
    /// The reason.
    pub event: Event,
    /// The condition.
    pub when: When,
}

/// The condition of a wake-up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum When {
    /// Always.
    Always,
    /// If this is the last expected answer to a tick; or the first, if that is asked for.
    LastAnswer {
        /// The answered tick.
        tick: u64,
        /// The first answer wakes too.
        or_first: bool,
    },
}

impl Notification {
    /// An unconditional wake-up.
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

/// Bits of an answer word that hold the count.
const COUNT_BITS: u32 = 16;

/// The answers to the newest tick in a wait group, in one word, so that processes count them without a lock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Answers(u64);

impl Answers {
    /// The answers from the word of [`Self::to_bits`].
    #[must_use]
    pub fn from_bits(bits: u64) -> Self {
        Self(bits)
    }

    /// The word: the tick's number, from 1, in the upper bits; the count in the lowest bits.
    #[must_use]
    pub fn to_bits(self) -> u64 {
        self.0
    }

    /// Adds an answer to a tick; `None` if that tick is over, because a newer one is being answered.
    #[must_use]
    pub fn with(self, tick: u64) -> Option<Self> {
        let number = tick + 1;
        match self.0 >> COUNT_BITS {
            newest if newest < number => Some(Self(number << COUNT_BITS | 1)),
            newest if newest == number => Some(Self(self.0 + 1)),
            _ => None,
        }
    }

    /// True if the last of these answers wakes a wait group that expects this many: it is the last, or the first if that is asked for.
    /// Extra answers wake again: a restarted robot may answer twice.
    #[must_use]
    pub fn wakes(self, expected: u64, or_first: bool) -> bool {
        let count = self.0 & ((1 << COUNT_BITS) - 1);
        count >= expected || or_first && count == 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_answer_to_the_newest_tick_signals() {
        let mut answers = Answers::default();
        let mut wakes = |tick, expected, or_first| match answers.with(tick) {
            Some(counted) => {
                answers = Answers::from_bits(counted.to_bits());
                Some(counted.wakes(expected, or_first))
            }
            None => None,
        };
        for tick in [0, 1, 7] {
            assert_eq!([0; 3].map(|_| wakes(tick, 3, false)), [Some(false), Some(false), Some(true)], "{tick}");
            assert_eq!(wakes(tick, 3, false), Some(true), "of one that was started again");
        }
        assert_eq!([0; 3].map(|_| wakes(8, 3, true)), [Some(true), Some(false), Some(true)]);
        assert_eq!(wakes(7, 3, false), None, "of a tick that is over");
    }
}

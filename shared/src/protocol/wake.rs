//! Who can be woken, and why: what roles ask for, without the means.

/// Who can be woken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sleeper {
    /// The simulator.
    Sim,
    /// The fusion centre.
    Fusion,
    /// All robots.
    Robots,
}

/// Why somebody is woken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Call {
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
pub const CALLS: usize = 6;

/// What a wait returned: the calls that came, none if time ran out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Calls([bool; CALLS]);

impl Calls {
    /// The calls that came, in the order of [`Call`].
    #[must_use]
    pub fn new(came: [bool; CALLS]) -> Self {
        Self(came)
    }

    /// True if this call was among them.
    #[must_use]
    pub fn has(self, call: Call) -> bool {
        self.0[call as usize]
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
    pub to: Sleeper,
    /// Why.
    pub call: Call,
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
    pub fn always(to: Sleeper, call: Call) -> Self {
        Self { to, call, when: When::Always }
    }

    /// A wake-up by the last answer to a tick.
    #[must_use]
    pub fn by_last_answer(to: Sleeper, call: Call, tick: u64, or_first: bool) -> Self {
        Self { to, call, when: When::LastAnswer { tick, or_first } }
    }
}

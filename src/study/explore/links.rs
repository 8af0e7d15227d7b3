//! Robots on other hosts and the links to them, drawn from a seed.

use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

/// Time from one host to the other without any disturbance, ns.
pub(super) const LINK_NS: u64 = 50_000;

/// Longest jitter, ns.
const JITTER_MAX_NS: u64 = 50_000_000;

/// Time from the loss of a gateway until the robots have joined the next one: their silence, and some attempts, ns.
const REJOINS_NS: u64 = 1_000_000_000;

/// Robots on other hosts, their links and their gateway.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Links {
    /// Bit i: robot i is on another host.
    pub(super) robots: u64,
    /// The quality of the links until a time.
    pub(super) quality: Quality,
    /// Cuts.
    pub(super) cuts: Vec<Cut>,
    /// Kills of the gateway, in order of time.
    pub(super) kills: Vec<GatewayKill>,
    /// Times for which the gateway is stopped, unless the supervisor replaces it before; in order.
    pub(super) stops: Vec<GatewayStop>,
    /// Reboots of the run's host.
    pub(super) reboots: Vec<Reboot>,
}

/// The quality of a link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Quality {
    /// Share of frames that are lost.
    pub(super) loss: f64,
    /// Share that arrive twice.
    pub(super) duplicates: f64,
    /// Longest additional delay of a frame, ns: a frame with less overtakes others.
    pub(super) jitter_ns: u64,
    /// Time after which the link is good, ns.
    pub(super) until_ns: u64,
}

/// A way of a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Way {
    /// From the gateway to a robot.
    Down,
    /// From a robot to the gateway.
    Up,
}

/// No frame passes, and no robot joins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cut {
    /// When, ns.
    pub(super) at_ns: u64,
    /// Duration, ns.
    pub(super) for_ns: u64,
    /// Bit i: the link to robot i is cut.
    pub(super) robots: u64,
    /// The only way that is cut; both if none is named.
    pub(super) only: Option<Way>,
}

/// The gateway is killed, and another one started.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct GatewayKill {
    /// When, ns.
    pub(super) at_ns: u64,
    /// Number of actions before that.
    pub(super) after_actions: u32,
    /// Time that the next one takes to start, ns.
    pub(super) up_ns: u64,
}

/// The gateway is stopped, and continued later.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct GatewayStop {
    /// When, ns.
    pub(super) at_ns: u64,
    /// Duration, ns.
    pub(super) for_ns: u64,
}

/// The run's host loses all its processes, and the run is resumed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reboot {
    /// When, ns.
    pub(super) at_ns: u64,
    /// Time until the processes are started again, ns.
    pub(super) for_ns: u64,
}

impl Quality {
    /// True if each frame arrives once, without a delay.
    pub(super) fn is_good(&self) -> bool {
        self.until_ns == 0 || self.loss == 0.0 && self.duplicates == 0.0 && self.jitter_ns == 0
    }

    /// When the last frame that it disturbed has arrived, ns.
    fn bad_until_ns(&self) -> u64 {
        if self.is_good() { 0 } else { self.until_ns + self.jitter_ns }
    }
}

impl Links {
    /// The links of a team: mostly none. `span_ns` is about how long the run takes.
    pub(super) fn draw(random: &mut ChaCha8Rng, robots: usize, span_ns: u64) -> Option<Self> {
        if !random.random_bool(0.3) {
            return None;
        }
        let all = (1_u64 << robots) - 1;
        let some = random.random_range(1..=all);
        let remote = if random.random_bool(0.5) { all } else { some };
        let is_bad = random.random_bool(0.7);
        let jitter_ns = [0, JITTER_MAX_NS / 25, JITTER_MAX_NS][random.random_range(0..3)];
        let jitter_ns = if jitter_ns == 0 { 0 } else { random.random_range(0..jitter_ns) };
        // Each tick crosses the link four times.
        let span_ns = span_ns + 40 * jitter_ns;
        let quality = Quality {
            loss: if random.random_bool(0.7) { random.random_range(0.0..0.3) } else { 0.0 },
            duplicates: if random.random_bool(0.7) { random.random_range(0.0..0.3) } else { 0.0 },
            jitter_ns,
            until_ns: if is_bad { random.random_range(span_ns / 4..span_ns) } else { 0 },
        };
        let cuts = random.random_range(0..=4_usize).saturating_sub(1);
        let cuts = (0..cuts).map(|_| Cut::draw(random, all, span_ns)).collect();
        let kills = random.random_range(0..=4_usize).saturating_sub(2);
        let mut kills: Vec<_> = (0..kills).map(|_| GatewayKill::draw(random, span_ns)).collect();
        kills.sort_by_key(|kill| kill.at_ns);
        let stops = random.random_range(0..=4_usize).saturating_sub(2);
        let mut stops: Vec<_> = (0..stops).map(|_| GatewayStop::draw(random, span_ns)).collect();
        stops.sort_by_key(|stop| stop.at_ns);
        let reboots = random.random_range(0..=4_usize).saturating_sub(2);
        let reboots = (0..reboots).map(|_| Reboot::draw(random, span_ns)).collect();
        Some(Self { robots: remote, quality, cuts, kills, stops, reboots })
    }

    /// True if this robot is on another host.
    pub(super) fn has(&self, robot: usize) -> bool {
        self.robots >> robot & 1 == 1
    }

    /// True if this way to a robot is cut at a time after the start.
    pub(super) fn is_cut(&self, robot: usize, way: Way, at_ns: u64) -> bool {
        self.cuts.iter().any(|cut| {
            (cut.at_ns..cut.at_ns + cut.for_ns).contains(&at_ns)
                && cut.robots >> robot & 1 == 1
                && cut.only.is_none_or(|only| only == way)
        })
    }

    /// Until when the link to a robot was disturbed last, ns; a time to come if it still is.
    pub(super) fn bad_until_ns(&self, robot: usize, at_ns: u64) -> u64 {
        let has_begun = |cut: &&Cut| cut.at_ns <= at_ns && cut.robots >> robot & 1 == 1;
        let cuts_ns = self.cuts.iter().filter(has_begun).map(|cut| cut.at_ns + cut.for_ns);
        let stops_ns = self.stops.iter().filter(|stop| stop.at_ns <= at_ns).map(|stop| stop.at_ns + stop.for_ns);
        let reboots_ns = self.reboots.iter().filter(|reboot| reboot.at_ns <= at_ns).map(Reboot::ends_ns);
        cuts_ns.chain(stops_ns).chain(reboots_ns).max().unwrap_or(0).max(self.quality.bad_until_ns())
    }

    /// Time at which the last disturbance is over, ns.
    pub(super) fn calm_from_ns(&self) -> u64 {
        let cuts_ns = self.cuts.iter().map(|cut| cut.at_ns + cut.for_ns);
        let kills_ns = self.kills.iter().map(|kill| kill.at_ns + kill.up_ns + REJOINS_NS);
        let stops_ns = self.stops.iter().map(|stop| stop.at_ns + stop.for_ns + REJOINS_NS);
        let reboots_ns = self.reboots.iter().map(|reboot| reboot.ends_ns() + REJOINS_NS);
        let ends_ns = cuts_ns.chain(kills_ns).chain(stops_ns).chain(reboots_ns);
        ends_ns.max().unwrap_or(0).max(self.quality.bad_until_ns())
    }

    /// True if nothing disturbs them.
    pub(super) fn is_undisturbed(&self) -> bool {
        let has_faults = !self.kills.is_empty() || !self.stops.is_empty() || !self.reboots.is_empty();
        self.quality.is_good() && self.cuts.is_empty() && !has_faults
    }

    /// The same with one disturbance less, or with fewer robots behind the gateway.
    pub(super) fn calmer(&self) -> Vec<Self> {
        let quality = |quality: Quality| Self { quality, ..self.clone() };
        let mut calmer = vec![
            Self { cuts: Vec::new(), ..self.clone() },
            Self { kills: Vec::new(), ..self.clone() },
            Self { stops: Vec::new(), ..self.clone() },
            Self { reboots: Vec::new(), ..self.clone() },
            quality(Quality { loss: 0.0, ..self.quality }),
            quality(Quality { duplicates: 0.0, ..self.quality }),
            quality(Quality { jitter_ns: 0, ..self.quality }),
            quality(Quality { until_ns: 0, ..self.quality }),
        ];
        calmer.extend((0..self.cuts.len()).map(|index| {
            let mut fewer = self.clone();
            fewer.cuts.remove(index);
            fewer
        }));
        calmer.extend((0..self.kills.len()).map(|index| {
            let mut fewer = self.clone();
            fewer.kills.remove(index);
            fewer
        }));
        let remote = (0..u64::BITS).map(|robot| self.robots & !(1 << robot)).filter(|robots| *robots != 0);
        calmer.extend(remote.map(|robots| Self { robots, ..self.clone() }));
        calmer
    }
}

impl Cut {
    fn draw(random: &mut ChaCha8Rng, all: u64, span_ns: u64) -> Self {
        let (short_ns, long_ns) =
            (random.random_range(100_000_000..600_000_000), random.random_range(600_000_000..3_000_000_000));
        Self {
            at_ns: random.random_range(0..span_ns),
            for_ns: if random.random_bool(0.6) { short_ns } else { long_ns },
            robots: if random.random_bool(0.5) { all } else { random.random_range(1..=all) },
            only: [None, None, Some(Way::Down), Some(Way::Up)][random.random_range(0..4)],
        }
    }
}

impl GatewayStop {
    fn draw(random: &mut ChaCha8Rng, span_ns: u64) -> Self {
        Self { at_ns: random.random_range(0..span_ns), for_ns: random.random_range(10_000_000..4_000_000_000) }
    }
}

impl Reboot {
    fn draw(random: &mut ChaCha8Rng, span_ns: u64) -> Self {
        Self { at_ns: random.random_range(0..span_ns), for_ns: random.random_range(10_000_000..1_000_000_000) }
    }

    fn ends_ns(&self) -> u64 {
        self.at_ns + self.for_ns
    }
}

impl GatewayKill {
    fn draw(random: &mut ChaCha8Rng, span_ns: u64) -> Self {
        Self {
            at_ns: random.random_range(0..span_ns),
            after_actions: random.random_range(0..12),
            up_ns: random.random_range(10_000_000..500_000_000),
        }
    }
}

//! When ticks begin and end, and which robots they wait for.

use rangehound_shared::scenario::{Clock, Scenario, Timeout};

/// Difference of a node's clock within a time-out, ns.
const CLOCK_NS: u64 = 15_000_000;

/// Part of a real-time tick after which fusion goes on without the ranges that are missing.
const RANGE_DEADLINE: f64 = 0.5;

/// Ticks after which a node is synchronised with the ticks.
const SETTLED_TICKS: u64 = 5;

/// How late fusion may notice that a deadline has passed on its own clock, ns.
const LATE_NS: u64 = 1_000_000;

/// When ticks began and ended.
#[derive(Debug)]
pub(in crate::study::explore) struct Timing {
    is_realtime: bool,
    dt_ns: u64,
    /// How long lock step waits for a robot, ns; `None` if for ever.
    timeout_ns: Option<u64>,
    /// When each tick was published first.
    worlds_ns: Vec<u64>,
    /// The newest tick of the present simulator.
    sim_tick: Option<SimTick>,
    /// When a fusion last asked for the present tick.
    pub(in crate::study::explore) hello_ns: u64,
    /// The last tick at which no robot was missing.
    last_full: Option<u64>,
}

/// When a simulator published a tick first.
#[derive(Debug, Clone, Copy)]
struct SimTick {
    tick: u64,
    at_ns: u64,
    /// The time for which it had run, without its stops.
    ran_ns: u64,
    /// The same, including the part of each stop that it cannot notice.
    counted_ns: u64,
}

/// Which robots are missing at a tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::study::explore) enum Missing {
    /// None.
    Nobody,
    /// Only robots that were missing before.
    AsBefore,
    /// A robot that was not missing before.
    Another,
}

/// How fusion closed a tick.
#[derive(Debug, Clone, Copy)]
pub(in crate::study::explore) struct Closing {
    pub(in crate::study::explore) tick: u64,
    /// The missing robots.
    pub(in crate::study::explore) missing: Missing,
    /// A later tick had begun, or the run had ended.
    pub(in crate::study::explore) is_cut: bool,
    /// When it ended, ns.
    pub(in crate::study::explore) at_ns: u64,
    /// When its first range arrived, read or not, ns.
    pub(in crate::study::explore) arrived_ns: Option<u64>,
    /// Time since its first range, if no process was stopped since, ns.
    pub(in crate::study::explore) held_ns: Option<u64>,
    /// The same, without the time for which fusion was stopped.
    pub(in crate::study::explore) ran_ns: Option<u64>,
    /// Time for which simulator and fusion have taken part undisturbed, ns.
    pub(in crate::study::explore) well_for_ns: u64,
    /// How far clocks may have diverged, ns.
    pub(in crate::study::explore) late_ns: u64,
    /// Longest delay of a message, ns. Fusion knows the start of a tick only by the arrival of its messages.
    pub(in crate::study::explore) slowest_ns: u64,
}

impl Timing {
    pub(in crate::study::explore) fn new(scenario: &Scenario) -> Self {
        Self {
            is_realtime: scenario.clock == Clock::Realtime,
            dt_ns: (scenario.dt_s * 1e9) as u64,
            timeout_ns: match scenario.timeout {
                Timeout::After(timeout) => Some(timeout.as_nanos() as u64),
                Timeout::Forever => None,
            },
            worlds_ns: Vec::new(),
            sim_tick: None,
            hello_ns: 0,
            last_full: None,
        }
    }

    /// A new simulator process starts.
    pub(in crate::study::explore) fn sim_starts(&mut self) {
        self.sim_tick = None;
    }

    /// The simulator publishes a tick, after it has run for `ran_ns` without its stops, or `counted_ns` with the parts
    /// of stops that it cannot notice. In real time a tick must be neither late nor in a burst.
    pub(in crate::study::explore) fn world(
        &mut self,
        tick: u64,
        now_ns: u64,
        [ran_ns, counted_ns]: [u64; 2],
        late_ns: u64,
    ) -> Result<(), String> {
        let index = tick as usize;
        let before = self.sim_tick;
        if before.is_none_or(|before| before.tick != tick) {
            self.sim_tick = Some(SimTick { tick, at_ns: now_ns, ran_ns, counted_ns });
        }
        if index < self.worlds_ns.len() {
            return Ok(());
        }
        if index > self.worlds_ns.len() {
            return Err(format!("sim passed over a tick before {tick}"));
        }
        self.worlds_ns.push(now_ns);
        if !self.is_realtime {
            return Ok(());
        }
        if tick >= 3 && now_ns + late_ns < self.worlds_ns[index - 2] + self.dt_ns {
            return Err(format!("two ticks took less than one time step, before tick {tick}"));
        }
        // Unless it was stopped since.
        let took_ns = before.map(|before| (now_ns - before.at_ns, ran_ns - before.ran_ns));
        if tick >= 2 && took_ns.is_some_and(|(took_ns, ran_ns)| took_ns == ran_ns && took_ns > self.dt_ns + late_ns) {
            return Err(format!("tick {tick} came late"));
        }
        Ok(())
    }

    /// The simulator goes on without a robot, after it has run for `counted_ns`, including the parts of stops that it
    /// cannot notice.
    pub(in crate::study::explore) fn leaves_out(&self, tick: u64, counted_ns: u64) -> Result<(), String> {
        let waited_ns = self.sim_tick.map_or(0, |began| counted_ns - began.counted_ns);
        let is_over = self.timeout_ns.is_some_and(|timeout_ns| waited_ns + CLOCK_NS >= timeout_ns);
        if tick == 0 || self.is_realtime || !is_over {
            return Err(format!("a robot was left out at tick {tick} before its time"));
        }
        Ok(())
    }

    /// Fusion has closed a tick: it must be neither early nor late.
    pub(in crate::study::explore) fn closes(&mut self, closing: &Closing) -> Result<(), String> {
        let Closing { tick, missing, is_cut, at_ns, arrived_ns, held_ns, ran_ns, well_for_ns, late_ns, slowest_ns } =
            *closing;
        // If a predecessor closed the tick, the time is unknown.
        let Some(world_ns) = self.worlds_ns.get(tick as usize).copied().filter(|_| at_ns > 0) else { return Ok(()) };
        let has_newly_missing = missing == Missing::Another;
        if has_newly_missing && tick == 0 {
            return Err("tick 0 did not wait for the whole team".to_owned());
        }
        if !self.is_realtime {
            let is_over = self
                .timeout_ns
                .is_some_and(|timeout_ns| ran_ns.is_none_or(|ran_ns| ran_ns + CLOCK_NS + late_ns >= timeout_ns));
            return if has_newly_missing && !is_over && !is_cut {
                Err(format!("tick {tick} did not wait for a robot"))
            } else {
                Ok(())
            };
        }
        if tick == 0 {
            return Ok(());
        }
        let deadline_ns = world_ns + (RANGE_DEADLINE * self.dt_ns as f64) as u64;
        if has_newly_missing && !is_cut && at_ns + late_ns < deadline_ns {
            return Err(format!("tick {tick} did not wait for a robot until its deadline"));
        }
        let before_is_full = self.last_full.is_some_and(|full| full + 1 == tick);
        if missing == Missing::Nobody {
            self.last_full = Some(tick);
        }
        // Without an earlier report, a tick may be taken to begin up to one step after its first range.
        let longest_ns = ((1.0 + RANGE_DEADLINE) * self.dt_ns as f64) as u64 + LATE_NS;
        if held_ns.is_some_and(|held_ns| held_ns > longest_ns) {
            return Err(format!("tick {tick} was held beyond its deadline"));
        }
        // A fusion that asks for a tick makes it begin again.
        let is_settled = well_for_ns > SETTLED_TICKS * self.dt_ns
            && before_is_full
            && self.hello_ns < self.worlds_ns[tick as usize - 1];
        let is_late = arrived_ns.is_some_and(|arrived_ns| at_ns > deadline_ns.max(arrived_ns) + late_ns + slowest_ns);
        if tick >= 2 && is_settled && is_late {
            return Err(format!("tick {tick} was held beyond its deadline, though all knew when it began"));
        }
        Ok(())
    }
}

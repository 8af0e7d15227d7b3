//! The values of flags.

use std::ffi::OsStr;
use std::fmt::Display;
use std::ops::RangeInclusive;

use clap::Arg;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::error::ErrorKind;
use rangehound_fusion::standby::STANDBYS_MAX;
use rangehound_shared::recording::SensorName;
use rangehound_shared::scenario::{Clock, GateKey, PLANNERS, TimeoutKey};

use crate::failure::Failure;
use crate::study::chaos::faults::{Kind, Victim};
use crate::study::latency::reference::Reference;

/// The method of each planner, in the order of [`PLANNERS`].
const PLANNERS_DO: [&str; PLANNERS.len()] = [
    "Global optimum of each step, with a certificate that proves it",
    "The paper's adaptive relaxation",
    "The standard relaxation that the paper compares with",
    "Exhaustive search on a grid of bearings, for up to 4 robots",
    "Each robot chooses for itself, as if the others stood still",
    "Each robot drives straight to the predicted target",
    "Random headings",
    "Headings that are best over several steps",
];

/// The start of the next tick.
pub(super) const CLOCKS: OneOf<Clock> = OneOf(
    &[
        ("realtime", Clock::Realtime, "A tick starts every dt seconds of wall time, even if messages are missing"),
        ("lockstep", Clock::Lockstep, "A tick starts as soon as all robots have answered the previous one"),
    ],
    &[],
);

/// Kinds of faults; `None` stands for all of them.
pub(super) const KINDS: OneOf<Option<Kind>> = OneOf(
    &[
        ("kill", Some(Kind::Kill), "One node is killed"),
        ("stop", Some(Kind::Stop), "One node is suspended, from 10 ms up to the longest stop, and then continued"),
        (
            "crash-loop",
            Some(Kind::CrashLoop),
            "One node is killed, and each successor as soon as it starts, 3 to 5 times in all",
        ),
        ("several", Some(Kind::Several), "Two or more nodes are killed at once"),
        (
            "total-outage",
            Some(Kind::TotalOutage),
            "All processes and the supervisor are killed at once; then the run is resumed",
        ),
        ("cut", Some(Kind::Cut), "With --hosts: a host is cut off the network, up to the longest cut"),
        ("one-way", Some(Kind::OneWay), "With --hosts: the same, but only packets from the host or to it are lost"),
        (
            "reboot",
            Some(Kind::Reboot),
            "With --hosts: a host loses its robots and its network, and gets them back after a while",
        ),
        ("all", None, "All of these; total-outage only if --roles has sim, fusion and robot"),
    ],
    &[("storm", "crash-loop"), ("blackout", "total-outage")],
);

/// The kinds of nodes that faults hit.
pub(super) const VICTIMS: OneOf<Victim> = OneOf(
    &[
        ("sim", Victim::Sim, "The simulator"),
        ("fusion", Victim::Fusion, "The fusion process that leads"),
        ("robot", Victim::Robot, "Any robot"),
        ("standby", Victim::Standby, "Any fusion process that stands by"),
        ("gateway", Victim::Gateway, "The gateway to robots on other hosts"),
    ],
    &[],
);

/// The transport of a reference.
pub(super) const REFERENCES: OneOf<Reference> = OneOf(
    &[
        ("iceoryx2", Reference::Iceoryx2, "Publish-subscribe and events of iceoryx2"),
        ("futex", Reference::Futex, "Futexes in shared memory: the least that a wake-up can cost"),
    ],
    &[],
);

/// A planner's name. The shell completes the known names; the scenario's checks refuse others.
#[derive(Debug, Clone, Copy)]
pub(super) struct PlannerName;

impl TypedValueParser for PlannerName {
    type Value = String;

    fn parse_ref(&self, command: &clap::Command, _: Option<&Arg>, value: &OsStr) -> Result<String, clap::Error> {
        let refused = || clap::Error::new(ErrorKind::InvalidUtf8).with_cmd(command);
        value.to_str().map(|name| name.trim().to_owned()).ok_or_else(refused)
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        let planners = PLANNERS.into_iter().zip(PLANNERS_DO);
        Some(Box::new(planners.map(|(name, does)| PossibleValue::new(name).help(does))))
    }
}

/// A flag with a fixed set of values: each with its meaning and its text in `--help`; then aliases of former names.
#[derive(Debug, Clone, Copy)]
pub(super) struct OneOf<T: 'static>(
    &'static [(&'static str, T, &'static str)],
    &'static [(&'static str, &'static str)],
);

impl<T: Copy + Send + Sync + 'static> OneOf<T> {
    fn values(&self) -> impl Iterator<Item = PossibleValue> + '_ {
        let aliases = |name| self.1.iter().filter(move |(_, of)| *of == name).map(|(alias, _)| *alias);
        self.0.iter().map(move |(name, _, does)| PossibleValue::new(*name).help(*does).aliases(aliases(*name)))
    }
}

impl<T: Copy + Send + Sync + 'static> TypedValueParser for OneOf<T> {
    type Value = T;

    fn parse_ref(&self, command: &clap::Command, arg: Option<&Arg>, value: &OsStr) -> Result<T, clap::Error> {
        let names = PossibleValuesParser::new(self.values());
        // A value that is not UTF-8 matches no name.
        let name = names.parse_ref(command, arg, OsStr::new(value.to_string_lossy().as_ref()))?;
        let name = self.1.iter().find(|(alias, _)| *alias == name).map_or(name.as_str(), |(_, of)| *of);
        let found = self.0.iter().find(|(known, ..)| *known == name);
        found.map(|(_, value, _)| *value).ok_or_else(|| clap::Error::new(ErrorKind::InvalidValue).with_cmd(command))
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(self.values()))
    }
}

/// A value for all sensors, or for one: `0.1` or `105=0.1`.
#[derive(Debug, Clone, PartialEq)]
pub struct PerSensor {
    /// The sensor, if not all.
    pub sensor: Option<SensorName>,
    /// The value.
    pub value: f64,
}

impl std::str::FromStr for PerSensor {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || "expected a number or SENSOR=NUMBER".to_owned();
        let (sensor, value) = match text.rsplit_once('=') {
            Some((sensor, value)) => (Some(sensor.parse().map_err(|_| expected())?), value),
            None => (None, text),
        };
        Ok(Self { sensor, value: value.parse().map_err(|_| expected())? })
    }
}

/// A flag's value, if it is in these bounds.
pub(super) fn within<T: PartialOrd + Display>(
    flag: &str,
    bounds: RangeInclusive<T>,
    expected: &str,
    value: T,
) -> Result<T, Failure> {
    if bounds.contains(&value) {
        Ok(value)
    } else {
        Err(Failure::input(format!("{flag} is {value}: expected {expected}")))
    }
}

pub(super) fn whole(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_| "expected a whole number from 0".to_owned())
}

pub(super) fn port(text: &str) -> Result<u16, String> {
    text.parse().map_err(|_| "expected a port from 1 to 65535, or 0 for any that is free".to_owned())
}

pub(super) fn standbys(text: &str) -> Result<usize, String> {
    let expected = || format!("expected a whole number from 0 to {STANDBYS_MAX}");
    text.parse().ok().filter(|count| *count <= STANDBYS_MAX).ok_or_else(expected)
}

pub(super) fn number(text: &str) -> Result<f64, String> {
    text.parse().map_err(|_| "expected a number".to_owned())
}

pub(super) fn place(text: &str) -> Result<[f64; 2], String> {
    let coordinates = text.split_once(',').and_then(|(x, y)| Some([x.trim().parse().ok()?, y.trim().parse().ok()?]));
    coordinates.ok_or_else(|| "expected two numbers X,Y".to_owned())
}

pub(super) fn gate(text: &str) -> Result<GateKey, String> {
    text.parse()
}

pub(super) fn megabytes(text: &str) -> Result<u64, String> {
    text.parse().ok().filter(|megabytes| *megabytes > 0).ok_or_else(|| "expected a whole number from 1".to_owned())
}

pub(super) fn speed(text: &str) -> Result<f64, String> {
    let speed = text.parse().ok().filter(|speed| (1e-3..=1e6).contains(speed));
    speed.ok_or_else(|| "expected a number from 0.001 to 1e6".to_owned())
}

pub(super) fn timeout(text: &str) -> Result<TimeoutKey, String> {
    Ok(match text.parse() {
        Ok(seconds) => TimeoutKey::Seconds(seconds),
        Err(_) => TimeoutKey::Word(text.to_owned()),
    })
}

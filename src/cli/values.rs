//! Values as they are written behind flags.

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

/// What each planner does, in the order of [`PLANNERS`].
const PLANNERS_DO: [&str; PLANNERS.len()] = [
    "The global optimum of each step, with a proof",
    "The paper's adaptive relaxation",
    "Standard relaxation",
    "Exhaustive search, for up to 4 robots",
    "Each robot by itself",
    "Straight to the predicted target",
    "Random headings",
];

/// What starts the next tick.
pub(super) const CLOCKS: OneOf<Clock> = OneOf(&[
    ("realtime", Clock::Realtime, "Every dt of wall time, whatever is missing"),
    ("lockstep", Clock::Lockstep, "As soon as all have answered"),
]);

/// Kinds of faults; of all, none is named.
pub(super) const KINDS: OneOf<Option<Kind>> = OneOf(&[
    ("kill", Some(Kind::Kill), "One node is killed"),
    ("stop", Some(Kind::Stop), "One node is stopped for 10 ms up to the longest stop"),
    ("storm", Some(Kind::Storm), "One node is killed, and its successors as soon as they have its role, 3 to 5 times"),
    ("several", Some(Kind::Several), "Two or more nodes are killed at once"),
    (
        "blackout",
        Some(Kind::Blackout),
        "Everything is killed at once, whatever the roles, and the supervisor too; then the run is resumed",
    ),
    ("all", None, "All of these; without blackout if not sim, fusion and robot are to be hurt"),
]);

/// Who is hurt.
pub(super) const VICTIMS: OneOf<Victim> = OneOf(&[
    ("sim", Victim::Sim, "The simulator"),
    ("fusion", Victim::Fusion, "The fusion centre"),
    ("robot", Victim::Robot, "Any robot"),
    ("standby", Victim::Standby, "Any fusion that stands by"),
]);

/// How nodes of a reference talk.
pub(super) const REFERENCES: OneOf<Reference> = OneOf(&[
    (
        "iceoryx2",
        Reference::Iceoryx2,
        "Publish-subscribe and events of iceoryx2, as a program would use it that has nothing else to do",
    ),
    (
        "futex",
        Reference::Futex,
        "Words of shared memory on which the kernel lets processes wait: the least that a wake-up takes",
    ),
]);

/// Completes the names of planners, but takes any: who plans says what is wrong with it.
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

/// One of these words: its meaning, and its text in `--help`.
#[derive(Debug, Clone, Copy)]
pub(super) struct OneOf<T: 'static>(&'static [(&'static str, T, &'static str)]);

impl<T: Copy + Send + Sync + 'static> TypedValueParser for OneOf<T> {
    type Value = T;

    fn parse_ref(&self, command: &clap::Command, arg: Option<&Arg>, value: &OsStr) -> Result<T, clap::Error> {
        let words = PossibleValuesParser::new(self.0.iter().map(|(word, ..)| *word));
        // What is not UTF-8 is none of them.
        let word = words.parse_ref(command, arg, OsStr::new(value.to_string_lossy().as_ref()))?;
        let found = self.0.iter().find(|(known, ..)| *known == word);
        found.map(|(_, value, _)| *value).ok_or_else(|| clap::Error::new(ErrorKind::InvalidValue).with_cmd(command))
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(self.0.iter().map(|(word, _, does)| PossibleValue::new(word).help(does))))
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
        Err(Failure::input(format!("{flag}: expected {expected}, got {value}")))
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

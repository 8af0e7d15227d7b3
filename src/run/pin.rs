//! The processors of a command and of all processes that it starts.

use std::str::FromStr;

use anyhow::anyhow;
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};

/// Which processors to run on.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum Pin {
    /// All processors that the system allows.
    #[default]
    None,
    /// One processor for all processes: latency then excludes wake-ups across processors.
    OneCore,
    /// These.
    Cpus(Vec<usize>),
}

impl Pin {
    /// Pins this thread, and with it whatever it starts from now on.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn apply(&self) -> anyhow::Result<()> {
        let mut set = CpuSet::new();
        match self {
            Self::None => return Ok(()),
            Self::OneCore => {
                let allowed = sched_getaffinity(None)?;
                // The last one: the first usually handles interrupts.
                let last = (0..CpuSet::MAX_CPU).rev().find(|cpu| allowed.is_set(*cpu));
                set.set(last.unwrap_or(0));
            }
            Self::Cpus(cpus) => cpus.iter().for_each(|cpu| set.set(*cpu)),
        }
        sched_setaffinity(None, &set).map_err(|error| {
            anyhow!("cannot run on the processors of --pin {self}: {error}: expected processors that exist")
        })
    }
}

impl FromStr for Pin {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let cpu = |word: &str| word.trim().parse().ok().filter(|cpu| *cpu < CpuSet::MAX_CPU);
        match text {
            "none" => Ok(Self::None),
            "one-core" => Ok(Self::OneCore),
            list => list
                .split(',')
                .map(cpu)
                .collect::<Option<_>>()
                .map(Self::Cpus)
                .ok_or_else(|| "expected none, one-core, or processors by number, separated by commas".to_owned()),
        }
    }
}

impl std::fmt::Display for Pin {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::None => f.write_str("none"),
            Self::OneCore => f.write_str("one-core"),
            Self::Cpus(cpus) => f.write_str(&cpus.iter().map(ToString::to_string).collect::<Vec<_>>().join(",")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pins_are_read_as_they_are_shown() {
        for (text, pin) in [("none", Pin::None), ("one-core", Pin::OneCore), ("0,3", Pin::Cpus(vec![0, 3]))] {
            assert_eq!(text.parse(), Ok(pin.clone()));
            assert_eq!(pin.to_string(), text);
        }
        for nonsense in ["", "two", "0,", "-1", "1000000"] {
            assert!(nonsense.parse::<Pin>().is_err(), "{nonsense}");
        }
    }
}

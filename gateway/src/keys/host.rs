//! A host: its name, and for whom it may speak.

use std::fmt::{Display, Formatter};
use std::str::FromStr;

use rangehound_shared::robot_set::RobotSet;

use super::files::AUTHORITY_FOLDER;
use super::{GATEWAY_NAME, robot_name};

/// Longest name, bytes: what a label of a host name may have.
const NAME_BYTES_MAX: usize = 63;

/// A host's name, which is also the name of its folder: 1 to 63 of `a-z`, `A-Z`, `0-9`, `-`, `_`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HostName(String);

impl HostName {
    /// The name.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for HostName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let allowed = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if text == AUTHORITY_FOLDER {
            return Err(format!("expected another name: {AUTHORITY_FOLDER} is the folder of the authority"));
        }
        if (1..=NAME_BYTES_MAX).contains(&text.len()) && text.chars().all(allowed) {
            Ok(Self(text.to_owned()))
        } else {
            Err(format!("expected a name of 1 to {NAME_BYTES_MAX} letters, digits, '-' or '_'"))
        }
    }
}

/// A robots' host as the command line gives it: `alice=0,1` or `bob=2-5,7`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RobotHost {
    /// Its name.
    pub name: HostName,
    /// The robots that it may speak for: at least one.
    pub robots: RobotSet,
}

impl FromStr for RobotHost {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, robots) = text.split_once('=').ok_or("expected NAME=ROBOTS, such as alice=0,1 or bob=2-5")?;
        Ok(Self { name: name.parse()?, robots: robots.parse()? })
    }
}

/// The permissions of a host.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HostRole {
    /// Be a gateway.
    Gateway,
    /// Speak for these robots.
    Robots(RobotSet),
}

impl Display for HostRole {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Gateway => f.write_str("gateway"),
            Self::Robots(robots) => {
                f.write_str(if robots.len() == 1 { "robot " } else { "robots " })?;
                for (index, (first, last)) in runs(*robots).into_iter().enumerate() {
                    let comma = if index > 0 { "," } else { "" };
                    if first == last { write!(f, "{comma}{first}") } else { write!(f, "{comma}{first}-{last}") }?;
                }
                Ok(())
            }
        }
    }
}

/// First and last of each unbroken row of robots.
fn runs(robots: RobotSet) -> Vec<(usize, usize)> {
    let mut runs: Vec<(usize, usize)> = Vec::new();
    for robot in robots.iter() {
        match runs.last_mut() {
            Some((_, last)) if *last + 1 == robot => *last = robot,
            _ => runs.push((robot, robot)),
        }
    }
    runs
}

/// A host that gets keys.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Host {
    /// Its name.
    pub name: HostName,
    /// Its permissions.
    pub role: HostRole,
}

impl Host {
    /// The names in its certificate.
    pub(super) fn certified_names(&self) -> Vec<String> {
        match self.role {
            HostRole::Gateway => vec![GATEWAY_NAME.to_owned()],
            HostRole::Robots(robots) => robots.iter().map(robot_name).collect(),
        }
    }
}

impl From<RobotHost> for Host {
    fn from(host: RobotHost) -> Self {
        Self { name: host.name, role: HostRole::Robots(host.robots) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shown(text: &str) -> Result<String, String> {
        text.parse::<RobotHost>().map(|host| Host::from(host).role.to_string())
    }

    #[test]
    fn robots_are_numbers_and_ranges() {
        let good = [
            ("alice=0,1", "robots 0-1"),
            ("bob=2-5", "robots 2-5"),
            ("b-_=7", "robot 7"),
            ("x=9,2-4,1023,3", "robots 2-4,9,1023"),
            ("x=5-5", "robot 5"),
        ];
        for (text, expected) in good {
            assert_eq!(shown(text).as_deref(), Ok(expected), "{text}");
        }
        let bad = [
            "x",
            "x=",
            "=1",
            "x=1,",
            "x=a",
            "x=-1",
            "x=1-",
            "x=5-2",
            "x=1024",
            "x=0-1024",
            "x=1-2-3",
            "x=0-999999999999",
            "../x=1",
            "x.y=1",
            "ü=1",
            "authority=1",
            "x=1=2",
            "x= 1",
            "x=99999999999999999999999",
        ];
        for text in bad {
            let refusal = shown(text).expect_err(text);
            assert!(refusal.contains("expected") && !refusal.contains('\n'), "{text}: {refusal}");
        }
        assert!("n".repeat(63).parse::<HostName>().is_ok() && "n".repeat(64).parse::<HostName>().is_err());
    }
}

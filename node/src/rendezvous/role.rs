//! Roles in a run.

use serde::{Deserialize, Serialize};

/// A role in a run; at most one live process holds it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Role {
    /// Advances the world and keeps the clock.
    Sim,
    /// Estimates the target and plans the headings.
    Fusion,
    /// Ready to take over as fusion; numbered from 1.
    Standby(usize),
    /// One robot, by id.
    Robot(usize),
    /// Speaks for the robots on other hosts.
    Gateway,
    /// Starts, restarts and ends the nodes.
    Supervisor,
}

impl Role {
    /// The robot's id, if the role is a robot.
    #[must_use]
    pub fn robot(self) -> Option<usize> {
        if let Self::Robot(id) = self { Some(id) } else { None }
    }

    /// Names this process after the role, so that `ps` and `top` tell the nodes apart.
    pub fn name_process(self) {
        // The kernel keeps 15 bytes; "rh-robot-1023" fits. A failure is harmless.
        if let Ok(title) = std::ffi::CString::new(format!("rh-{self}")) {
            let _ = rustix::thread::set_name(&title);
        }
    }
}

impl std::fmt::Display for Role {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Sim => f.write_str("sim"),
            Self::Fusion => f.write_str("fusion"),
            Self::Standby(number) => write!(f, "standby-{number}"),
            Self::Robot(id) => write!(f, "robot-{id}"),
            Self::Gateway => f.write_str("gateway"),
            Self::Supervisor => f.write_str("run"),
        }
    }
}

impl std::str::FromStr for Role {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || format!("unknown role {text:?}: expected sim, fusion, gateway, standby-N or robot-N");
        match text.split_once('-') {
            None if text == "sim" => Ok(Self::Sim),
            None if text == "fusion" => Ok(Self::Fusion),
            None if text == "gateway" => Ok(Self::Gateway),
            Some(("standby", number)) => number.parse().map(Self::Standby).map_err(|_| expected()),
            Some(("robot", id)) => id.parse().map(Self::Robot).map_err(|_| expected()),
            _ => Err(expected()),
        }
    }
}

//! The nodes of a run that others start on this host.

use std::collections::BTreeSet;
use std::str::FromStr;

use rangehound_node::rendezvous::Role;
use rangehound_shared::robot_set::RobotSet;
use serde::{Deserialize, Serialize};

/// The nodes whose processes others start on this host.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct External {
    /// The robots.
    pub robots: BTreeSet<usize>,
    /// True if fusion is one of them.
    pub fusion: bool,
}

impl External {
    /// True if others start the process of this role.
    #[must_use]
    pub fn has(&self, role: Role) -> bool {
        match role {
            Role::Fusion => self.fusion,
            Role::Robot(id) => self.robots.contains(&id),
            _ => false,
        }
    }
}

impl FromStr for External {
    type Err = String;

    /// Reads robots and `fusion`, as in `0,2-5,fusion`.
    fn from_str(text: &str) -> Result<Self, String> {
        let (fusion, robots): (Vec<&str>, Vec<&str>) = text.split(',').partition(|part| *part == "fusion");
        let robots = match robots.is_empty() {
            true => RobotSet::default(),
            false => robots.join(",").parse().map_err(|error| format!("{error}, or fusion"))?,
        };
        Ok(Self { robots: robots.iter().collect(), fusion: !fusion.is_empty() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn robots_and_fusion_are_named_in_one_list() {
        let external: External = "0,fusion,2-3".parse().unwrap();
        assert!(external.has(Role::Fusion) && external.has(Role::Robot(3)));
        assert!(!external.has(Role::Robot(1)) && !external.has(Role::Sim));
        assert!("fusion".parse::<External>().unwrap().robots.is_empty());
        assert!("0".parse::<External>().is_ok_and(|external| !external.fusion));
        for text in ["", "sim", "0,,fusion", "fusion-2"] {
            assert!(text.parse::<External>().unwrap_err().ends_with(", or fusion"), "{text}");
        }
    }
}

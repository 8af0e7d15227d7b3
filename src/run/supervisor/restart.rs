//! Which nodes are started again after they ended.

use rangehound_node::rendezvous::Role;

/// When a node that ended is started again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Policy {
    /// However it ended.
    #[default]
    Always,
    /// If it was killed or failed.
    OnFailure,
    /// Not at all.
    Never,
}

/// A policy for one kind of node, or for all: `never`, `robot=on-failure`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rule {
    kind: Option<Kind>,
    policy: Policy,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Sim,
    Fusion,
    Robot,
}

impl std::str::FromStr for Rule {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = "expected always, on-failure or never, or one of these for sim=, fusion= or robot=";
        let (kind, policy) = match text.split_once('=') {
            None => (None, text),
            Some(("sim", policy)) => (Some(Kind::Sim), policy),
            Some(("fusion", policy)) => (Some(Kind::Fusion), policy),
            Some(("robot", policy)) => (Some(Kind::Robot), policy),
            Some(_) => return Err(expected.to_owned()),
        };
        let policy = match policy {
            "always" => Policy::Always,
            "on-failure" => Policy::OnFailure,
            "never" => Policy::Never,
            _ => return Err(expected.to_owned()),
        };
        Ok(Self { kind, policy })
    }
}

/// The policies of a run: later rules win.
#[derive(Debug, Clone, Default)]
pub struct Policies(Vec<Rule>);

impl Policies {
    /// The policies that these rules make.
    #[must_use]
    pub fn new(rules: &[Rule]) -> Self {
        Self(rules.to_vec())
    }

    /// The policy for a node of this role. A gateway is always started again: the robots on other hosts need it, and it has no
    /// state that could be wrong.
    #[must_use]
    pub fn of(&self, role: Role) -> Policy {
        let kind = match role {
            Role::Sim => Kind::Sim,
            Role::Fusion | Role::Standby(_) => Kind::Fusion,
            Role::Robot(_) => Kind::Robot,
            Role::Gateway | Role::Supervisor => return Policy::Always,
        };
        let rule = self.0.iter().rev().find(|rule| rule.kind.is_none_or(|of| of == kind));
        rule.map_or(Policy::default(), |rule| rule.policy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn later_rules_win_and_invalid_ones_are_refused() {
        let rules: Vec<Rule> = ["on-failure", "robot=never"].iter().map(|text| text.parse().unwrap()).collect();
        let policies = Policies::new(&rules);
        assert_eq!(policies.of(Role::Robot(3)), Policy::Never);
        assert_eq!(policies.of(Role::Fusion), Policy::OnFailure);
        assert_eq!(policies.of(Role::Gateway), Policy::Always);
        assert_eq!(Policies::default().of(Role::Sim), Policy::Always);
        for text in ["", "sometimes", "robot=", "wheel=never"] {
            assert!(text.parse::<Rule>().unwrap_err().starts_with("expected always"), "{text}");
        }
    }
}

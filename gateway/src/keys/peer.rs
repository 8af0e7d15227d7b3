//! The host at the other end of a connection.

use rangehound_shared::robot_set::RobotSet;
use rustls::pki_types::CertificateDer;
use x509_parser::extensions::GeneralName;

use super::{GATEWAY_NAME, KeysError, robot_of_name};

/// The contents of a host's certificate. The handshake has verified the certificate.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Peer {
    /// The host's name.
    pub host: String,
    robots: RobotSet,
    is_gateway: bool,
}

impl Peer {
    /// The peer with this chain of certificates, its own first.
    ///
    /// # Errors
    /// [`KeysError::Peer`] if its certificate cannot be read, or has no name.
    pub fn of(chain: &[CertificateDer<'_>]) -> Result<Self, KeysError> {
        let own = chain.first().ok_or(KeysError::Peer("there is none"))?;
        let (_, certificate) =
            x509_parser::parse_x509_certificate(own).map_err(|_| KeysError::Peer("it is not in X.509 format"))?;
        let host = certificate.subject().iter_common_name().next().and_then(|name| name.as_str().ok());
        let mut peer = Self {
            host: host.ok_or(KeysError::Peer("it names no host"))?.to_owned(),
            robots: RobotSet::default(),
            is_gateway: false,
        };
        let names = certificate.subject_alternative_name().map_err(|_| KeysError::Peer("its names cannot be read"))?;
        for name in names.iter().flat_map(|names| &names.value.general_names) {
            if let GeneralName::DNSName(name) = name {
                peer.is_gateway |= *name == GATEWAY_NAME;
                if let Some(robot) = robot_of_name(name) {
                    peer.robots.set(robot, true);
                }
            }
        }
        Ok(peer)
    }

    /// True if it may speak for the robot.
    #[must_use]
    pub fn may_be(&self, robot: usize) -> bool {
        self.robots.contains(robot)
    }

    /// All robots that it may speak for.
    #[must_use]
    pub fn robots(&self) -> RobotSet {
        self.robots
    }

    /// True if it may be a gateway.
    #[must_use]
    pub fn is_gateway(&self) -> bool {
        self.is_gateway
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::keys::robot_name;

    #[test]
    fn a_robot_has_one_name() {
        for robot in [0, 7, 1023, usize::MAX] {
            assert_eq!(robot_of_name(&robot_name(robot)), Some(robot));
        }
        for name in
            ["robot-.rangehound", "robot-+1.rangehound", "robot-01.rangehound", "robot-1.rangehound.", "robot-1", "*"]
        {
            assert_eq!(robot_of_name(name), None, "{name}");
        }
    }

    #[test]
    fn bytes_that_are_no_certificate_are_refused() {
        for chain in [vec![], vec![vec![]], vec![vec![0x30, 0x82, 0xff, 0xff]], vec![vec![0xff; 4_096]]] {
            let chain: Vec<_> = chain.into_iter().map(CertificateDer::from).collect();
            assert!(matches!(Peer::of(&chain), Err(KeysError::Peer(_))), "{chain:?}");
        }
    }
}

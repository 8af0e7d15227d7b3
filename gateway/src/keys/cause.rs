//! Why a gateway and a robot's host do not come together.

use quinn::ConnectionError;
use rustls::AlertDescription;

/// QUIC's codes of TLS alerts: the alert is the last byte (RFC 9001, section 4.8).
const TLS_ALERTS: std::ops::Range<u64> = 0x100..0x200;

/// Why a peer was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum RefusalCause {
    /// It has no certificate.
    NoCertificate,
    /// Its certificate is of another authority.
    UnknownAuthority,
    /// Its certificate has expired, or is not valid yet: TLS has one alert for both.
    Expired,
    /// Its certificate does not name the robot that it speaks for.
    WrongRobot,
    /// Its certificate is bad in another way.
    BadCertificate,
    /// Its certificate is not a gateway's.
    NotGateway,
    /// It has another version of the protocol.
    Version,
    /// It wants another run.
    Run,
    /// The robot's role is taken.
    RoleTaken,
    /// The run has no such robot.
    NoSuchRobot,
    /// Too many handshakes are under way, in all or with its address.
    Flood,
    /// Any other cause.
    Other,
}

impl RefusalCause {
    /// All causes.
    pub const ALL: [Self; 12] = [
        Self::NoCertificate,
        Self::UnknownAuthority,
        Self::Expired,
        Self::WrongRobot,
        Self::BadCertificate,
        Self::NotGateway,
        Self::Version,
        Self::Run,
        Self::RoleTaken,
        Self::NoSuchRobot,
        Self::Flood,
        Self::Other,
    ];

    /// The cause in a few words.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::NoCertificate => "no certificate",
            Self::UnknownAuthority => "certificate of another authority",
            Self::Expired => "certificate expired or not valid yet",
            Self::WrongRobot => "certificate of another robot",
            Self::BadCertificate => "bad certificate",
            Self::NotGateway => "certificate is not a gateway's",
            Self::Version => "another version",
            Self::Run => "another run",
            Self::RoleTaken => "role taken",
            Self::NoSuchRobot => "no such robot",
            Self::Flood => "too many handshakes",
            Self::Other => "other",
        }
    }

    /// The cause of a handshake that failed, at the end that refused and at the one that was refused. `None` if the
    /// connection ended for another reason, such as silence.
    ///
    /// A robot's host learns only after its own handshake that the gateway has refused it, when it uses the connection.
    #[must_use]
    pub fn of_connection_error(error: &ConnectionError) -> Option<Self> {
        let code = match error {
            ConnectionError::VersionMismatch => return Some(Self::Version),
            ConnectionError::TransportError(refused_here) => u64::from(refused_here.code),
            ConnectionError::ConnectionClosed(refused_there) => u64::from(refused_there.error_code),
            _ => return None,
        };
        let alert = u8::try_from(code & 0xff).ok().filter(|_| TLS_ALERTS.contains(&code))?;
        Some(Self::of_alert(AlertDescription::from(alert)))
    }

    fn of_alert(alert: AlertDescription) -> Self {
        match alert {
            AlertDescription::CertificateRequired => Self::NoCertificate,
            AlertDescription::UnknownCA => Self::UnknownAuthority,
            AlertDescription::CertificateExpired => Self::Expired,
            // The answer of `GatewayOnly`, and of nothing else.
            AlertDescription::AccessDenied => Self::NotGateway,
            AlertDescription::BadCertificate
            | AlertDescription::UnsupportedCertificate
            | AlertDescription::CertificateRevoked
            | AlertDescription::CertificateUnknown
            | AlertDescription::DecryptError => Self::BadCertificate,
            // Not of this program, or of a version that joins in another way. The number of the protocol is compared later, in the
            // request to join, so that both ends can name both versions.
            AlertDescription::NoApplicationProtocol | AlertDescription::ProtocolVersion => Self::Version,
            _ => Self::Other,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    #[test]
    fn each_cause_has_a_name_of_its_own_and_only_tls_alerts_have_one() {
        let names: HashSet<_> = RefusalCause::ALL.into_iter().map(RefusalCause::name).collect();
        assert_eq!(names.len(), RefusalCause::ALL.len());
        let none = [ConnectionError::TimedOut, ConnectionError::Reset, ConnectionError::LocallyClosed];
        for error in none {
            assert_eq!(RefusalCause::of_connection_error(&error), None, "{error}");
        }
    }
}

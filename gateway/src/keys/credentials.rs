//! A host's keys, and the TLS configurations made of them.

use std::path::Path;
use std::sync::Arc;

use rcgen::{CertificateParams, KeyPair};
use rustls::client::{Resumption, WebPkiServerVerifier};
use rustls::crypto::{CryptoProvider, ring};
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::server::{NoServerSessionStorage, WebPkiClientVerifier};
use rustls::sign::{CertifiedKey, SingleCertAndKey};
use rustls::version::TLS13;
use rustls::{ClientConfig, Error, InconsistentKeys, RootCertStore, ServerConfig};

use super::files::{AUTHORITY_CERTIFICATE, HOST_CERTIFICATE, HOST_KEY, read};
use super::verifier::{AnyCertificate, GatewayOnly};
use super::{GATEWAY_NAME, KeysError, Peer};

/// How hosts join, which both ends must name in the handshake. It stays when the protocol's number changes: see [`crate::link::Request`].
pub const ALPN: &[u8] = b"rangehound/1";

/// A host's certificate and key, and the authority that it trusts.
#[derive(Debug, Clone)]
pub struct Credentials {
    own: CertifiedKey,
    authority: Arc<RootCertStore>,
    own_peer: Peer,
}

impl Credentials {
    /// The credentials in a host's folder.
    ///
    /// # Errors
    /// [`KeysError`] if a file is missing or not what its name says.
    pub fn load(dir: &Path) -> Result<Self, KeysError> {
        let bad = |file: &str, expected: &'static str, reason: String| KeysError::File {
            path: dir.join(file),
            expected,
            reason,
        };
        let not_certificate = |file, reason| bad(file, "a certificate", reason);
        let certificates = |file| -> Result<Vec<CertificateDer<'static>>, KeysError> {
            let text = read(&dir.join(file))?;
            let found: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(text.as_bytes()).collect();
            match found {
                Ok(found) if found.is_empty() => Err(not_certificate(file, "there is none".to_owned())),
                found => found.map_err(|error| not_certificate(file, error.to_string())),
            }
        };
        let mut authority = RootCertStore::empty();
        for certificate in certificates(AUTHORITY_CERTIFICATE)? {
            authority.add(certificate).map_err(|error| not_certificate(AUTHORITY_CERTIFICATE, error.to_string()))?;
        }
        let chain = certificates(HOST_CERTIFICATE)?;
        let own_peer = Peer::of(&chain).map_err(|error| match error {
            KeysError::Peer(reason) => not_certificate(HOST_CERTIFICATE, reason.to_owned()),
            error => error,
        })?;
        let key = PrivateKeyDer::from_pem_slice(read(&dir.join(HOST_KEY))?.as_bytes())
            .map_err(|error| bad(HOST_KEY, "a private key", error.to_string()))?;
        let own = CertifiedKey::from_der(chain, key, &provider()).map_err(|error| match error {
            Error::InconsistentKeys(InconsistentKeys::KeyMismatch) => KeysError::NotAPair(dir.to_owned()),
            error => bad(HOST_KEY, "a private key", error.to_string()),
        })?;
        Ok(Self { own, authority: Arc::new(authority), own_peer })
    }

    /// The contents of the host's own certificate, which its peers will read.
    #[must_use]
    pub fn own(&self) -> &Peer {
        &self.own_peer
    }

    #[cfg(test)]
    pub(super) fn with_authority_of(mut self, other: &Self) -> Self {
        self.authority = other.authority.clone();
        self
    }

    /// A gateway's configuration: it demands a certificate of the same authority.
    ///
    /// # Errors
    /// [`KeysError::Tls`].
    pub fn server_config(&self) -> Result<ServerConfig, KeysError> {
        let verifier = WebPkiClientVerifier::builder_with_provider(self.authority.clone(), provider())
            .build()
            .map_err(|error| Error::General(error.to_string()))?;
        let config = ServerConfig::builder_with_provider(provider())
            .with_protocol_versions(&[&TLS13])?
            .with_client_cert_verifier(verifier)
            .with_cert_resolver(Arc::new(SingleCertAndKey::from(self.own.clone())));
        Ok(as_gateway(config))
    }

    /// A robot's host's configuration: it trusts only gateways of the same authority. The name to verify is
    /// [`GATEWAY_NAME`].
    ///
    /// # Errors
    /// [`KeysError::Tls`].
    pub fn client_config(&self) -> Result<ClientConfig, KeysError> {
        let verifier = WebPkiServerVerifier::builder_with_provider(self.authority.clone(), provider())
            .build()
            .map_err(|error| Error::General(error.to_string()))?;
        let config = ClientConfig::builder_with_provider(provider())
            .with_protocol_versions(&[&TLS13])?
            .dangerous()
            .with_custom_certificate_verifier(Arc::new(GatewayOnly(verifier)))
            .with_client_cert_resolver(Arc::new(SingleCertAndKey::from(self.own.clone())));
        Ok(as_robot_host(config))
    }

    /// A gateway's configuration without keys: it accepts anyone. Only for loopback addresses, on a machine whose users
    /// are all trusted. Its certificate lasts as long as the configuration.
    ///
    /// # Errors
    /// [`KeysError::Make`], [`KeysError::Tls`].
    pub fn for_loopback_server() -> Result<ServerConfig, KeysError> {
        let key = KeyPair::generate_for(&rcgen::PKCS_ECDSA_P256_SHA256)?;
        let certificate = CertificateParams::new([GATEWAY_NAME.to_owned()])?.self_signed(&key)?;
        let config = ServerConfig::builder_with_provider(provider())
            .with_protocol_versions(&[&TLS13])?
            .with_no_client_auth()
            .with_single_cert(vec![certificate.der().clone()], key.into())?;
        Ok(as_gateway(config))
    }

    /// A robot's host's configuration without keys: it trusts whatever answers. Only for loopback addresses, on a machine
    /// whose users are all trusted.
    ///
    /// # Errors
    /// [`KeysError::Tls`].
    pub fn for_loopback_client() -> Result<ClientConfig, KeysError> {
        let config = ClientConfig::builder_with_provider(provider())
            .with_protocol_versions(&[&TLS13])?
            .dangerous()
            .with_custom_certificate_verifier(Arc::new(AnyCertificate(provider())))
            .with_no_client_auth();
        Ok(as_robot_host(config))
    }
}

/// Given everywhere: the process's default may be another, or none.
pub(super) fn provider() -> Arc<CryptoProvider> {
    Arc::new(ring::default_provider())
}

/// No early data, which can be replayed, and no resumption, which would skip the verification of the certificate.
fn as_gateway(mut config: ServerConfig) -> ServerConfig {
    config.alpn_protocols = vec![ALPN.to_vec()];
    config.max_early_data_size = 0;
    config.session_storage = Arc::new(NoServerSessionStorage {});
    config.send_tls13_tickets = 0;
    config
}

/// As [`as_gateway`], for the other end.
pub(super) fn as_robot_host(mut config: ClientConfig) -> ClientConfig {
    config.alpn_protocols = vec![ALPN.to_vec()];
    config.enable_early_data = false;
    config.resumption = Resumption::disabled();
    config
}

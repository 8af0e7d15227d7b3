//! The authority, and the certificates that it signs.

use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use rcgen::{
    BasicConstraints, CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose, PublicKeyData,
};
use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject;
use time::OffsetDateTime;

use super::files::{AUTHORITY_CERTIFICATE, AUTHORITY_KEY, HOST_CERTIFICATE, HOST_KEY, NewFile, make_folder, read};
use super::{Host, HostRole, KeysError};

const DAY: Duration = Duration::from_secs(86_400);

/// 9999-12-31 23:59:59, which RFC 5280 gives to certificates without an end: the hosts' certificates have one.
const WITHOUT_END_UNIX_S: i64 = 253_402_300_799;

/// When a certificate is valid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Validity {
    /// The first moment.
    pub from: SystemTime,
    /// The last moment.
    pub until: SystemTime,
}

impl Validity {
    /// From one day ago, because clocks of hosts differ, until so many days from now.
    ///
    /// # Errors
    /// [`KeysError::Time`] if the days do not fit a calendar.
    pub fn of_days(days: u32) -> Result<Self, KeysError> {
        let now = SystemTime::now();
        let from = now.checked_sub(DAY).filter(|from| *from >= UNIX_EPOCH).unwrap_or(UNIX_EPOCH);
        Ok(Self { from, until: now.checked_add(DAY * days).ok_or(KeysError::Time)? })
    }
}

/// The moment in whole seconds, as certificates have it.
fn moment(time: SystemTime) -> Result<OffsetDateTime, KeysError> {
    let since_1970 = time.duration_since(UNIX_EPOCH).map_err(|_| KeysError::Time)?;
    let seconds = i64::try_from(since_1970.as_secs()).map_err(|_| KeysError::Time)?;
    OffsetDateTime::from_unix_timestamp(seconds).map_err(|_| KeysError::Time)
}

/// An authority: whoever has its key decides which hosts take part.
#[derive(Debug)]
pub struct Authority {
    certificate_pem: String,
    issuer: Issuer<'static, KeyPair>,
}

impl Authority {
    /// A new authority with a key of its own.
    ///
    /// # Errors
    /// [`KeysError::Make`].
    pub fn new() -> Result<Self, KeysError> {
        let key = KeyPair::generate_for(&rcgen::PKCS_ECDSA_P256_SHA256)?;
        let mut params = CertificateParams::default();
        // A name of its own: certificates of another authority are then known as such, not as forged.
        let digits: String = params.key_identifier(&key).iter().take(6).map(|byte| format!("{byte:02x}")).collect();
        params.distinguished_name = named(&format!("rangehound authority {digits}"));
        params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
        params.not_before = OffsetDateTime::UNIX_EPOCH;
        params.not_after = OffsetDateTime::from_unix_timestamp(WITHOUT_END_UNIX_S).map_err(|_| KeysError::Time)?;
        let certificate_pem = params.self_signed(&key)?.pem();
        Ok(Self { certificate_pem, issuer: Issuer::new(params, key) })
    }

    /// The authority of a folder.
    ///
    /// # Errors
    /// [`KeysError`] if a file is missing or not what its name says.
    pub fn load(folder: &Path) -> Result<Self, KeysError> {
        let (certificate_path, key_path) = (folder.join(AUTHORITY_CERTIFICATE), folder.join(AUTHORITY_KEY));
        let certificate_pem = read(&certificate_path)?;
        let not_certificate =
            |reason: String| KeysError::File { path: certificate_path.clone(), expected: "a certificate", reason };
        let der = CertificateDer::from_pem_slice(certificate_pem.as_bytes())
            .map_err(|error| not_certificate(error.to_string()))?;
        let key = KeyPair::from_pem(&read(&key_path)?).map_err(|error| KeysError::File {
            path: key_path,
            expected: "a private key",
            reason: error.to_string(),
        })?;
        let (_, parsed) =
            x509_parser::parse_x509_certificate(&der).map_err(|error| not_certificate(error.to_string()))?;
        if parsed.public_key().raw != key.subject_public_key_info() {
            return Err(KeysError::NotAPair(folder.to_owned()));
        }
        let issuer = Issuer::from_ca_cert_der(&der, key).map_err(|error| not_certificate(error.to_string()))?;
        Ok(Self { certificate_pem, issuer })
    }

    /// Writes certificate and key into a new folder.
    ///
    /// # Errors
    /// [`KeysError::Exists`], [`KeysError::Write`].
    pub fn save(&self, folder: &Path) -> Result<(), KeysError> {
        let key = self.issuer.key().serialize_pem();
        make_folder(
            folder,
            &[
                NewFile { name: AUTHORITY_CERTIFICATE, text: &self.certificate_pem, is_secret: false },
                NewFile { name: AUTHORITY_KEY, text: &key, is_secret: true },
            ],
        )
    }

    /// Signs a certificate with a new key.
    pub(super) fn sign(&self, params: &CertificateParams) -> Result<HostKeys, KeysError> {
        let key = KeyPair::generate_for(&rcgen::PKCS_ECDSA_P256_SHA256)?;
        Ok(HostKeys {
            authority_pem: self.certificate_pem.clone(),
            certificate_pem: params.signed_by(&key, &self.issuer)?.pem(),
            key,
        })
    }
}

/// A host's certificate and key, and its authority's certificate.
#[derive(Debug)]
pub struct HostKeys {
    authority_pem: String,
    certificate_pem: String,
    key: KeyPair,
}

impl HostKeys {
    /// Writes them into a new folder.
    ///
    /// # Errors
    /// [`KeysError::Exists`], [`KeysError::Write`].
    pub fn save(&self, folder: &Path) -> Result<(), KeysError> {
        let key = self.key.serialize_pem();
        make_folder(
            folder,
            &[
                NewFile { name: AUTHORITY_CERTIFICATE, text: &self.authority_pem, is_secret: false },
                NewFile { name: HOST_CERTIFICATE, text: &self.certificate_pem, is_secret: false },
                NewFile { name: HOST_KEY, text: &key, is_secret: true },
            ],
        )
    }
}

/// Makes a key for the host, and a certificate that says what the host may do.
///
/// # Errors
/// [`KeysError::Make`], [`KeysError::Time`].
pub fn make(authority: &Authority, host: &Host, validity: Validity) -> Result<HostKeys, KeysError> {
    authority.sign(&params(host, validity)?)
}

pub(super) fn params(host: &Host, validity: Validity) -> Result<CertificateParams, KeysError> {
    let mut params = CertificateParams::new(host.certified_names())?;
    params.distinguished_name = named(host.name.as_str());
    params.is_ca = IsCa::ExplicitNoCa;
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    params.extended_key_usages = vec![match host.role {
        HostRole::Gateway => ExtendedKeyUsagePurpose::ServerAuth,
        HostRole::Robots(_) => ExtendedKeyUsagePurpose::ClientAuth,
    }];
    params.use_authority_key_identifier_extension = true;
    (params.not_before, params.not_after) = (moment(validity.from)?, moment(validity.until)?);
    Ok(params)
}

fn named(common_name: &str) -> DistinguishedName {
    let mut name = DistinguishedName::new();
    name.push(DnType::CommonName, common_name);
    name
}

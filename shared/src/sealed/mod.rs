//! Complete states in files, such as checkpoints: bincode under a magic number, the build's version and a checksum.

pub mod slots;

use serde::Serialize;
use serde::de::DeserializeOwned;
use xxhash_rust::xxh3::Xxh3;

use crate::protocol::{OtherBuild, PROGRAM, PROTOCOL};

/// First bytes of every sealed file.
pub const MAGIC: [u8; 8] = *b"rhsealed";

/// Bytes for the program's version, padded with zeros.
pub const PROGRAM_LEN: usize = 16;

const CHECKSUM_LEN: usize = 8;

/// Magic, protocol, program, checksum over all: the same in all versions, so that each can name any other.
const HEADER_LEN: usize = 8 + 4 + PROGRAM_LEN + CHECKSUM_LEN;

/// Longest sealed file.
pub const FILE_LEN_MAX: usize = HEADER_LEN + VALUE_LEN_MAX;

/// Most bytes of a sealed value: bounds the memory that a damaged length can make the reader allocate.
const VALUE_LEN_MAX: usize = 1 << 24;

/// Why a value cannot be sealed, or a sealed value cannot be opened.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum SealError {
    /// Too short or without the magic number.
    #[error("not a rangehound file")]
    Foreign,
    /// From a build with another protocol.
    #[error("written by {0}")]
    OtherBuild(OtherBuild),
    /// The checksum does not match.
    #[error("damaged: its checksum does not match")]
    Damaged,
    /// Undamaged, but not a value of the expected kind.
    #[error("has other contents than expected")]
    Malformed,
    /// The value is larger than readers accept.
    #[error("a value of {0} bytes, expected at most {VALUE_LEN_MAX}")]
    TooLarge(usize),
    /// The value cannot be encoded.
    #[error("cannot be encoded: {0}")]
    Unencodable(String),
}

fn config() -> impl bincode::config::Config {
    bincode::config::standard().with_limit::<VALUE_LEN_MAX>()
}

/// The sealed bytes of a value.
///
/// # Errors
/// [`SealError::Unencodable`], [`SealError::TooLarge`].
pub fn seal(value: &impl Serialize) -> Result<Vec<u8>, SealError> {
    let mut bytes = Vec::new();
    seal_into(value, &mut bytes)?;
    Ok(bytes)
}

/// Appends [`seal`] to a buffer, which grows only if it must.
///
/// # Errors
/// [`SealError::Unencodable`], [`SealError::TooLarge`].
pub fn seal_into(value: &impl Serialize, bytes: &mut Vec<u8>) -> Result<(), SealError> {
    let start = bytes.len();
    bytes.extend(MAGIC);
    bytes.extend(PROTOCOL.to_le_bytes());
    bytes.extend(PROGRAM.bytes().chain(std::iter::repeat(0)).take(PROGRAM_LEN));
    bytes.extend([0; CHECKSUM_LEN]);
    let body = bytes.len();
    encode_into(value, bytes)?;
    let checksum = checksum(&bytes[start..body - CHECKSUM_LEN], &bytes[body..]);
    bytes[body - CHECKSUM_LEN..body].copy_from_slice(&checksum.to_le_bytes());
    Ok(())
}

/// The checksum over everything except itself.
fn checksum(head: &[u8], body: &[u8]) -> u64 {
    let mut hash = Xxh3::new();
    hash.update(head);
    hash.update(body);
    hash.digest()
}

/// Appends a value's bytes without magic, version and checksum: a part of what will be
/// sealed.
///
/// # Errors
/// [`SealError::Unencodable`], [`SealError::TooLarge`].
pub fn encode_into(value: &impl Serialize, bytes: &mut Vec<u8>) -> Result<(), SealError> {
    let start = bytes.len();
    bincode::serde::encode_into_std_write(value, bytes, config())
        .map_err(|error| SealError::Unencodable(error.to_string()))?;
    // Only decoders check the limit of the configuration.
    match bytes.len() - start {
        len if len > VALUE_LEN_MAX => Err(SealError::TooLarge(len)),
        _ => Ok(()),
    }
}

/// Decodes a value that [`encode_into`] wrote.
///
/// # Errors
/// [`SealError::Malformed`] if the bytes are not such a value.
pub fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, SealError> {
    match bincode::serde::decode_from_slice(bytes, config()) {
        Ok((value, used)) if used == bytes.len() => Ok(value),
        _ => Err(SealError::Malformed),
    }
}

/// Opens a sealed value.
///
/// # Errors
/// [`SealError`], for bytes that [`seal`] of this version did not write for such a value.
pub fn open<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, SealError> {
    let rest = bytes.strip_prefix(&MAGIC).ok_or(SealError::Foreign)?;
    let (protocol, rest) = rest.split_first_chunk::<4>().ok_or(SealError::Foreign)?;
    let (program, rest) = rest.split_first_chunk::<PROGRAM_LEN>().ok_or(SealError::Foreign)?;
    let protocol = u32::from_le_bytes(*protocol);
    if protocol != PROTOCOL {
        let known = program.iter().take_while(|byte| byte.is_ascii_graphic()).map(|byte| char::from(*byte));
        return Err(SealError::OtherBuild(OtherBuild { program: known.collect(), protocol }));
    }
    let (sum, body) = rest.split_first_chunk::<CHECKSUM_LEN>().ok_or(SealError::Foreign)?;
    if u64::from_le_bytes(*sum) != checksum(&bytes[..HEADER_LEN - CHECKSUM_LEN], body) {
        return Err(SealError::Damaged);
    }
    decode(body)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_sealed_value_opens(value: (u64, Vec<f32>, String)) {
            prop_assert_eq!(open(&seal(&value).unwrap()), Ok(value));
        }

        #[test]
        fn one_flipped_bit_is_refused(value: (u64, String), position: prop::sample::Index, bit in 0..8_u8) {
            let mut bytes = seal(&value).unwrap();
            let index = position.index(bytes.len());
            bytes[index] ^= 1_u8 << bit;
            prop_assert!(open::<(u64, String)>(&bytes).is_err());
        }

        #[test]
        fn no_bytes_make_it_panic(bytes: Vec<u8>) {
            prop_assert!(open::<(u64, Vec<String>)>(&bytes).is_err());
        }
    }

    #[test]
    fn a_file_of_another_build_is_refused_by_both_versions() {
        let mut bytes = seal(&7_u64).unwrap();
        bytes[8..12].copy_from_slice(&(PROTOCOL + 1).to_le_bytes());
        bytes[12..28].copy_from_slice(b"12.3.4-beta.5\0\0\0");
        let error = open::<u64>(&bytes).unwrap_err().to_string();
        let this = format!("this is {PROGRAM} (protocol {PROTOCOL})");
        assert_eq!(error, format!("written by rangehound 12.3.4-beta.5 (protocol {}); {this}", PROTOCOL + 1));
    }

    #[test]
    fn an_unsealable_value_is_reported_with_its_cause() {
        let large = vec![0_u8; VALUE_LEN_MAX];
        assert!(matches!(seal(&large), Err(SealError::TooLarge(len)) if len > VALUE_LEN_MAX));
        struct Broken;
        impl Serialize for Broken {
            fn serialize<S: serde::Serializer>(&self, _: S) -> Result<S::Ok, S::Error> {
                Err(serde::ser::Error::custom("has no end"))
            }
        }
        let error = seal(&Broken).unwrap_err();
        assert!(matches!(&error, SealError::Unencodable(cause) if cause.contains("has no end")), "{error}");
    }

    #[test]
    fn a_cut_file_is_refused_at_every_length() {
        let bytes = seal(&(1_u64, "text".to_owned())).unwrap();
        for len in 0..bytes.len() {
            assert!(open::<(u64, String)>(&bytes[..len]).is_err());
        }
    }
}

//! The description of a run: the creator writes it, all other nodes read it.

use std::path::PathBuf;

use rangehound_shared::protocol::{self, OtherBuild, PROTOCOL};
use rangehound_shared::scenario::Scenario;
use rangehound_shared::sealed::{self, SealError};
use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::xxh3_64;

/// The data that every node of a run needs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunDescription {
    /// Distinguishes this run from all others, also from those of the same name.
    pub run_id: u64,
    /// The experiment.
    pub scenario: Scenario,
    /// The run folder, absolute: logs and report.
    pub out_dir: PathBuf,
}

impl RunDescription {
    /// A new run of this scenario.
    #[must_use]
    pub fn new(scenario: Scenario, out_dir: PathBuf) -> Self {
        let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
        let mut unique = [0; 20];
        unique[..16].copy_from_slice(&now.as_nanos().to_le_bytes());
        unique[16..].copy_from_slice(&std::process::id().to_le_bytes());
        Self { run_id: xxh3_64(&unique), scenario, out_dir }
    }

    /// The description as one line of JSON, with the build that wrote it and a checksum.
    ///
    /// # Errors
    /// [`SealError`], also for NaN and infinity, which JSON does not have.
    pub fn seal(&self) -> Result<String, SealError> {
        let text = self.written_by(protocol::PROGRAM)?;
        let read =
            serde_json::from_str::<Document>(&text).map_err(|error| SealError::Unencodable(error.to_string()))?;
        match text.len() {
            _ if read.description != *self => {
                Err(SealError::Unencodable("it has a NaN or an infinite number".to_owned()))
            }
            len if len > sealed::FILE_LEN_MAX => Err(SealError::TooLarge(len)),
            _ => Ok(text),
        }
    }

    /// Reads a description that [`Self::seal`] wrote.
    ///
    /// # Errors
    /// [`SealError`] if the text was not sealed by a build of this protocol.
    pub fn open(bytes: &[u8]) -> Result<Self, SealError> {
        if bytes.starts_with(&sealed::MAGIC) {
            // Protocols up to 4 used the format of checkpoints.
            return Err(sealed::open::<()>(bytes).err().unwrap_or(SealError::Malformed));
        }
        let build: OtherBuild = serde_json::from_slice(bytes).map_err(|_| match bytes.starts_with(HEAD) {
            true => SealError::Damaged,
            false => SealError::Foreign,
        })?;
        if build.protocol != PROTOCOL {
            let program = build.program.chars().filter(char::is_ascii_graphic).take(sealed::PROGRAM_LEN).collect();
            return Err(SealError::OtherBuild(OtherBuild { program, ..build }));
        }
        let Document { program, description } = serde_json::from_slice(bytes).map_err(|_| SealError::Malformed)?;
        if description.written_by(&program)?.as_bytes() != bytes {
            return Err(SealError::Damaged);
        }
        if description.scenario.is_complete() { Ok(description) } else { Err(SealError::Malformed) }
    }

    fn written_by(&self, program: &str) -> Result<String, SealError> {
        let unencodable = |error: serde_json::Error| SealError::Unencodable(error.to_string());
        let description = serde_json::to_string(self).map_err(unencodable)?;
        let checksum = xxh3_64(format!("{program} {PROTOCOL} {description}").as_bytes());
        Ok(format!(
            "{{\"program\":{program:?},\"protocol\":{PROTOCOL},\"checksum\":\"{checksum:016x}\",\"description\":{description}}}\n"
        ))
    }
}

/// Start of the text, in every version.
const HEAD: &[u8] = b"{\"program\":";

/// The fields of the text; the checksum is [`RunDescription::written_by`]'s.
#[derive(Deserialize)]
struct Document {
    program: String,
    description: RunDescription,
}

#[cfg(test)]
mod tests {
    use rangehound_shared::scenario::ScenarioFile;

    use super::*;

    fn described() -> RunDescription {
        let scenario = Scenario::from_file(&ScenarioFile::default(), "test").unwrap();
        RunDescription::new(scenario, PathBuf::from("/nowhere"))
    }

    #[test]
    fn a_description_is_read_to_the_last_bit_and_numbers_that_json_lacks_are_refused() {
        let mut one = described();
        (one.scenario.dt_s, one.scenario.gate_sigma) = (0.1 + 0.2, Some(f64::MIN_POSITIVE / 3.0));
        let read = RunDescription::open(one.seal().unwrap().as_bytes()).unwrap();
        assert_eq!(read, one);
        assert_eq!(read.scenario.dt_s.to_bits(), (0.1_f64 + 0.2).to_bits());
        // As an optional number, both would be read as absent.
        for none in [f64::NAN, f64::INFINITY] {
            one.scenario.gate_sigma = Some(none);
            assert!(matches!(one.seal(), Err(SealError::Unencodable(_))));
        }
    }

    #[test]
    fn only_a_sealed_description_opens() {
        let text = described().seal().unwrap();
        let open = |text: &str| RunDescription::open(text.as_bytes()).unwrap_err();
        for len in 8..text.len() - 1 {
            assert!(matches!(open(&text[..len]), SealError::Damaged | SealError::Foreign), "{len}");
        }
        assert_eq!(open(&text.replace("\"dt_s\":", "\"dt_s\": ")), SealError::Damaged);
        assert_eq!(open(&text.replace("\"seed\":", "\"seed\":1")), SealError::Damaged);
        assert_eq!(open("{}"), SealError::Foreign);
        assert_eq!(open("rhsealed"), SealError::Foreign);
        let other = text.replace(&format!("\"protocol\":{PROTOCOL}"), "\"protocol\":99");
        assert!(matches!(open(&other), SealError::OtherBuild(OtherBuild { protocol: 99, .. })));
    }
}

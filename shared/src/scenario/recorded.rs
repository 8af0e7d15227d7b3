//! A recording as the source of a run's ranges: the user's options, and the link from a run to the data read.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::{RecordingTable, ScenarioError};
use crate::radio::{Format, UnknownFormat, UnknownUnit};
use crate::recording::{ColumnMap, ColumnMapError, PortLog, ReadOptions, ReadSummary, Recording, RecordingDigest};

/// The run folder's copy of the recording.
pub const COPY: &str = "recording.csv";

/// Recorded ranges as the source of a run. The user's file is read once, when the scenario is made. The nodes read the
/// copy in the run folder, and only if it has not changed since.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RecordedRanges {
    /// The identity of the data read.
    pub digest: RecordingDigest,
    /// The reader's findings besides the ranges.
    pub summary: ReadSummary,
    /// True if a sensor's height in the recording is not 0.
    pub has_heights: bool,
    /// Height of the target in the recording's frame, m; `None` if ranges count as level.
    pub target_height_m: Option<f64>,
    /// Time of its first instant, s.
    pub start_s: f64,
    /// The recording, in the process that read it.
    #[serde(skip)]
    pub(crate) read: AlreadyRead,
}

/// A cached recording. It is not part of a scenario's contents.
#[derive(Clone, Default)]
pub(crate) struct AlreadyRead(Option<Arc<Recording>>);

impl std::fmt::Debug for AlreadyRead {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("AlreadyRead")
    }
}

impl PartialEq for AlreadyRead {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl RecordedRanges {
    pub(super) fn new(recording: Recording, summary: ReadSummary, target_height_m: Option<f64>) -> Self {
        let heights = (0..recording.len()).filter_map(|index| recording.instant(index));
        let has_heights = recording.has_heights()
            && heights.flat_map(|(_, readings)| readings).any(|reading| reading.height_m.is_some_and(|z_m| z_m != 0.0));
        let digest = recording.digest();
        let start_s = recording.instant(0).map_or(0.0, |(time_s, _)| time_s);
        Self { digest, summary, has_heights, target_height_m, start_s, read: AlreadyRead(Some(Arc::new(recording))) }
    }

    /// The recording, if this process has read it and not released it.
    #[must_use]
    pub fn already_read(&self) -> Option<Arc<Recording>> {
        self.read.0.clone()
    }

    /// Releases the recording.
    pub fn forget(&mut self) {
        self.read.0 = None;
    }
}

impl RecordingTable {
    /// The options for reading the recording, without its anchors, which are in another file. `file` names the scenario in errors.
    ///
    /// # Errors
    /// [`ScenarioError`] for the first fault.
    pub fn read_options(&self, file: &str) -> Result<ReadOptions, ScenarioError> {
        let refuse = |key: &str, expected: String, got: String| ScenarioError::WrongValue {
            file: file.to_owned(),
            key: format!("recording.{key}"),
            expected,
            got,
        };
        // These errors begin with the word.
        let expected = |error: &dyn std::error::Error| error.to_string().trim_start_matches("expected ").to_owned();
        let columns = match &self.columns {
            None => ColumnMap::default(),
            Some(text) => text
                .parse()
                .map_err(|error: ColumnMapError| refuse("columns", error.expected, format!("{:?}", error.got)))?,
        };
        let format: Option<Format> = match &self.format {
            None => None,
            Some(text) => Some(
                text.parse().map_err(|error: UnknownFormat| refuse("format", expected(&error), format!("{text:?}")))?,
            ),
        };
        let stamp_unit = match &self.stamp_unit {
            None => None,
            Some(text) => Some(
                text.parse()
                    .map_err(|error: UnknownUnit| refuse("stamp_unit", expected(&error), format!("{text:?}")))?,
            ),
        };
        let of_port = [("rate_hz", self.rate_hz.is_some()), ("stamp_unit", stamp_unit.is_some())];
        if let (None, Some((key, _))) = (format, of_port.iter().find(|(_, present)| *present)) {
            return Err(refuse(
                key,
                "recording.format (--format) too, because only logs of a radio's port need it".to_owned(),
                "given".to_owned(),
            ));
        }
        if let Some(rate_hz) = self.rate_hz.filter(|rate_hz| !(1e-3..=1e5).contains(rate_hz)) {
            return Err(refuse("rate_hz", "a number from 0.001 to 100000".to_owned(), rate_hz.to_string()));
        }
        Ok(ReadOptions {
            strict: self.strict.unwrap_or(false),
            columns,
            anchors: None,
            target: self.target.clone(),
            port: format.map(|format| PortLog { format, rate_hz: self.rate_hz, stamp_unit }),
        })
    }

    /// Path of the recording; `-` is standard input.
    #[must_use]
    pub fn ranges_path(&self, folder: &Path) -> Option<PathBuf> {
        let ranges = self.ranges.as_deref()?;
        Some(if ranges == "-" { PathBuf::from(ranges) } else { folder.join(ranges) })
    }

    /// Path of the anchors file, if any.
    #[must_use]
    pub fn anchors_path(&self, folder: &Path) -> Option<PathBuf> {
        self.anchors.as_ref().map(|anchors| folder.join(anchors))
    }

    /// Files that are read besides the scenario itself.
    pub fn inputs(&self, folder: &Path) -> impl Iterator<Item = PathBuf> {
        let ranges = self.ranges_path(folder).filter(|path| path != Path::new("-"));
        let definitions = self.msg.iter().flatten().filter_map(|given| Some(folder.join(given.split_once('=')?.1)));
        ranges.into_iter().chain(self.anchors_path(folder)).chain(definitions.collect::<Vec<_>>())
    }

    /// The table for the run folder's copy of the recording, without the options for the original's form.
    #[must_use]
    pub fn of_copy(self) -> Self {
        Self {
            ranges: Some(COPY.to_owned()),
            columns: None,
            anchors: None,
            target: None,
            topic: None,
            position: None,
            msg: None,
            format: None,
            rate_hz: None,
            stamp_unit: None,
            strict: None,
            ..self
        }
    }
}

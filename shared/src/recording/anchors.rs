//! Where sensors stand, from a file of its own.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};

use super::columns::ColumnMap;
use super::{RecordingError, SensorName};

/// The anchors of a site: `sensor_id,x_m,y_m[,z_m]`, in any of the forms that a recording may have.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Anchors {
    file: PathBuf,
    by_name: BTreeMap<SensorName, Anchor>,
}

/// Where one anchor stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Anchor {
    /// Its place, m.
    pub position_m: [f64; 2],
    /// Its height, m; `None` where the file has none.
    pub height_m: Option<f64>,
}

impl Anchors {
    /// Reads an anchors file. Of the columns told, it takes `x`, `y` and `z`, and `sensor` if it has that one.
    ///
    /// # Errors
    /// [`RecordingError`] for the first thing that is wrong.
    pub fn read(path: &Path, columns: &ColumnMap) -> Result<Self, RecordingError> {
        let file = std::fs::File::open(path)
            .map_err(|error| RecordingError::Unreadable { file: path.to_owned(), reason: error.to_string() })?;
        Self::parse(file, path, columns)
    }

    /// Parses an anchors file from a reader; `path` names it in errors.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn parse(_input: impl Read, path: &Path, _columns: &ColumnMap) -> Result<Self, RecordingError> {
        Err(RecordingError::Unreadable { file: path.to_owned(), reason: "anchors files come later".to_owned() })
    }

    /// The anchors by name.
    pub fn iter(&self) -> impl Iterator<Item = (&SensorName, &Anchor)> {
        self.by_name.iter()
    }

    /// The file that they were read from.
    #[must_use]
    pub fn file(&self) -> &Path {
        &self.file
    }
}

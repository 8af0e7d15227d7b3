//! Files of keys: secrets that only their owner reads, and folders that are complete or do not exist.

use std::fs::{DirBuilder, File, OpenOptions};
use std::io::{ErrorKind, Read, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::Path;

use super::KeysError;

/// The authority's folder, beside those of the hosts.
pub(super) const AUTHORITY_FOLDER: &str = "authority";
/// The authority's certificate, in its own folder and in each host's.
pub(crate) const AUTHORITY_CERTIFICATE: &str = "authority.pem";
/// The authority's key.
pub(super) const AUTHORITY_KEY: &str = "authority.key";
/// A host's certificate.
pub(crate) const HOST_CERTIFICATE: &str = "host.pem";
/// A host's key.
pub(crate) const HOST_KEY: &str = "host.key";

const FOLDER_MODE: u32 = 0o700;
const SECRET_MODE: u32 = 0o600;
const CERTIFICATE_MODE: u32 = 0o644;

/// Most bytes that are read of a file: a certificate with all robots takes 40 kB.
const READ_BYTES_MAX: u64 = 1 << 18;

/// A file to be written.
pub(super) struct NewFile<'a> {
    pub(super) name: &'static str,
    pub(super) text: &'a str,
    pub(super) is_secret: bool,
}

/// Makes a folder that others cannot enter, and those above it, unless it exists.
pub(super) fn make_parents(folder: &Path) -> Result<(), KeysError> {
    let made = DirBuilder::new().recursive(true).mode(FOLDER_MODE).create(folder);
    made.map_err(|source| KeysError::Write { path: folder.to_owned(), source })
}

/// Makes a folder with these files.
///
/// # Errors
/// [`KeysError::Exists`] if there is something of this name; otherwise, if a file cannot be written, the folder is
/// removed again.
pub(super) fn make_folder(folder: &Path, files: &[NewFile]) -> Result<(), KeysError> {
    DirBuilder::new().mode(FOLDER_MODE).create(folder).map_err(|source| match source.kind() {
        ErrorKind::AlreadyExists => KeysError::Exists(folder.to_owned()),
        _ => KeysError::Write { path: folder.to_owned(), source },
    })?;
    let written = files.iter().try_for_each(|file| write_new(&folder.join(file.name), file));
    if written.is_err() {
        // The first error is the one that the user needs.
        let _ = std::fs::remove_dir_all(folder);
    }
    written
}

fn write_new(path: &Path, file: &NewFile) -> Result<(), KeysError> {
    let mode = if file.is_secret { SECRET_MODE } else { CERTIFICATE_MODE };
    let write = || {
        let mut opened = OpenOptions::new().write(true).create_new(true).mode(mode).open(path)?;
        opened.write_all(file.text.as_bytes())?;
        opened.sync_all()
    };
    write().map_err(|source| KeysError::Write { path: path.to_owned(), source })
}

/// The text of a file of a folder.
pub(super) fn read(path: &Path) -> Result<String, KeysError> {
    let read = || {
        let mut text = String::new();
        File::open(path)?.take(READ_BYTES_MAX).read_to_string(&mut text)?;
        Ok(text)
    };
    read().map_err(|source| KeysError::Read { path: path.to_owned(), source })
}

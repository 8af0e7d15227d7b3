//! Reads files of other programs within a memory limit.

use std::fs::File;
use std::io::{Error, ErrorKind, Read, Result};
use std::path::Path;

/// The bytes of a file of at most `len_max` bytes.
///
/// # Errors
/// If the file cannot be read or is longer, as an endless device is.
pub fn read(path: &Path, len_max: usize) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    File::open(path)?.take(len_max as u64 + 1).read_to_end(&mut bytes)?;
    if bytes.len() > len_max { Err(too_long("file", len_max)) } else { Ok(bytes) }
}

fn too_long(what: &str, len_max: usize) -> Error {
    Error::new(ErrorKind::InvalidData, format!("a {what} of more than {len_max} bytes"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_endless_file_is_refused() {
        assert!(read(Path::new("/dev/zero"), 1_000).is_err());
    }

    #[test]
    fn a_file_of_maximum_length_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(&path, [7; 10]).unwrap();
        assert_eq!(read(&path, 10).unwrap(), [7; 10]);
        assert!(read(&path, 9).is_err());
    }
}

//! Reading what others wrote without taking more memory than what is expected there can need.

use std::fs::File;
use std::io::{Error, ErrorKind, Read, Result};
use std::path::Path;

/// The bytes of a file of at most `len_max` bytes.
///
/// # Errors
/// If it cannot be read or is longer, as a device without end is.
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
    fn what_has_no_end_is_refused() {
        assert!(read(Path::new("/dev/zero"), 1_000).is_err());
    }

    #[test]
    fn what_is_as_long_as_it_may_be_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(&path, [7; 10]).unwrap();
        assert_eq!(read(&path, 10).unwrap(), [7; 10]);
        assert!(read(&path, 9).is_err());
    }
}

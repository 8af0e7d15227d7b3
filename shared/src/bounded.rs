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

/// A reader that gives at most so many bytes until its ration is renewed: for parsers that keep a whole
/// row in memory, however long it is.
#[derive(Debug)]
pub struct Rationed<R> {
    inner: R,
    ration: usize,
    left: usize,
}

impl<R> Rationed<R> {
    /// Rations a reader.
    pub fn new(inner: R, ration: usize) -> Self {
        Self { inner, ration, left: ration }
    }

    /// What has been read so far is done with.
    pub fn renew(&mut self) {
        self.left = self.ration;
    }
}

impl<R: Read> Read for Rationed<R> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
        if self.left == 0 {
            return Err(too_long("row", self.ration));
        }
        let room = buffer.len().min(self.left);
        let count = self.inner.read(&mut buffer[..room])?;
        self.left -= count;
        Ok(count)
    }
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
        assert!(std::io::copy(&mut Rationed::new(std::io::repeat(0), 1_000), &mut std::io::sink()).is_err());
    }

    #[test]
    fn what_is_as_long_as_it_may_be_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(&path, [7; 10]).unwrap();
        assert_eq!(read(&path, 10).unwrap(), [7; 10]);
        assert!(read(&path, 9).is_err());
        let mut rationed = Rationed::new(&[7; 10][..], 5);
        let mut buffer = [0; 5];
        for _ in 0..2 {
            rationed.read_exact(&mut buffer).unwrap();
            rationed.renew();
        }
        assert_eq!(rationed.read(&mut buffer).unwrap(), 0);
    }
}

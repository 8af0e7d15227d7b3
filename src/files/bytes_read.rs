//! How much of an input has been read, for a caller that shows it meanwhile.

use std::io::Read;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// The bytes of an input: those that have been read, and all, as far as that is known. Clones share them.
#[derive(Debug, Clone, Default)]
pub struct BytesRead(Arc<[AtomicU64; 2]>);

impl BytesRead {
    /// Bytes read, and all; 0 of what is not known, as of a pipe.
    #[must_use]
    pub fn get(&self) -> [u64; 2] {
        self.0.each_ref().map(|bytes| bytes.load(Ordering::Relaxed))
    }

    /// Adds bytes that will be read.
    pub fn expect(&self, bytes: u64) {
        let [_, all] = &*self.0;
        all.fetch_add(bytes, Ordering::Relaxed);
    }

    /// Adds bytes that have been read.
    pub fn add(&self, bytes: u64) {
        let [done, _] = &*self.0;
        done.fetch_add(bytes, Ordering::Relaxed);
    }

    /// The reader with its bytes counted.
    pub fn count<R: Read>(&self, reader: R) -> Counted<R> {
        Counted { reader, bytes: self.clone() }
    }
}

/// A reader whose bytes are counted.
#[derive(Debug)]
pub struct Counted<R> {
    reader: R,
    bytes: BytesRead,
}

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let read = self.reader.read(buffer)?;
        self.bytes.add(read as u64);
        Ok(read)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bytes_of_several_inputs_add_up() {
        let bytes = BytesRead::default();
        for input in [&b"abc"[..], &b"defgh"[..]] {
            bytes.expect(input.len() as u64);
            let mut text = String::new();
            bytes.count(input).read_to_string(&mut text).unwrap();
            assert_eq!(text.as_bytes(), input);
        }
        assert_eq!(bytes.clone().get(), [8, 8]);
    }
}

//! Why keys cannot be made or used.

use std::path::PathBuf;

/// Why keys cannot be made or used.
#[derive(Debug, thiserror::Error)]
pub enum KeysError {
    /// The folder of a host or of the authority would be replaced.
    #[error("{} exists: choose another name, or remove the folder to make new keys", .0.display())]
    Exists(PathBuf),
    /// Two hosts of one command would share a folder.
    #[error("two hosts are named {0}: expected one name for each host, with all of its robots")]
    Twice(String),
    /// A file cannot be read.
    #[error("cannot read {}: {source}: expected a folder of keys from `rangehound keys`", .path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A file or folder cannot be written.
    #[error("cannot write {}: {source}: choose a folder that can be written (--out)", .path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A file does not hold what its name says.
    #[error("cannot use {}: {reason}: expected {expected} as `keys` writes it", .path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The expected contents.
        expected: &'static str,
        /// The problem.
        reason: String,
    },
    /// Certificate and key of a folder are not a pair.
    #[error("cannot use {}: certificate and key are not of one pair: restore both, or make new keys", .0.display())]
    NotAPair(PathBuf),
    /// The times of a certificate cannot be written.
    #[error("cannot make certificates for this time: expected the years 1970 to 9999; check the clock")]
    Time,
    /// A key or certificate cannot be made.
    #[error("cannot make keys: {0}")]
    Make(#[from] rcgen::Error),
    /// TLS cannot be set up with these keys.
    #[error("cannot set up encryption: {0}")]
    Tls(#[from] rustls::Error),
    /// The peer's certificate cannot be understood.
    #[error("cannot use the peer's certificate: {0}")]
    Peer(&'static str),
    /// Standard output cannot be written.
    #[error("the keys are made, but standard output cannot be written: {0}")]
    Print(std::io::Error),
}

//! Files that are there as a whole or not at all: nobody reads half of one, and a full disk leaves none without its content.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// How the names of files end that are not finished.
pub const PARTIAL: &str = ".partial";

/// The path of a file beside this one, whose name has more at its end.
#[must_use]
pub fn with_ending(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(ending);
    name.into()
}

/// A file in the making, beside its place. It gets its name when it is finished; otherwise it is taken away.
#[derive(Debug)]
pub struct WholeFile {
    out: BufWriter<File>,
    path: PathBuf,
    partial: PathBuf,
}

/// Writes a whole file.
///
/// # Errors
/// With its name, if the system refuses.
pub fn write(path: &Path, content: impl AsRef<[u8]>) -> anyhow::Result<()> {
    let mut file = WholeFile::create(path)?;
    file.write_all(content.as_ref())?;
    file.finish()
}

impl WholeFile {
    /// Begins a file.
    ///
    /// # Errors
    /// With its name, if the system refuses.
    pub fn create(path: &Path) -> anyhow::Result<Self> {
        // Another process may be writing the same, as `watch` does beside a run's supervisor: whoever is last has the name.
        let partial = with_ending(path, &format!(".{}{PARTIAL}", std::process::id()));
        let file = File::create(&partial).map_err(|error| named(path, &error))?;
        Ok(Self { out: BufWriter::new(file), path: path.to_owned(), partial })
    }

    /// Gives it its name.
    ///
    /// # Errors
    /// With its name, if the system refuses.
    pub fn finish(mut self) -> anyhow::Result<()> {
        self.flush()?;
        std::fs::rename(&self.partial, &self.path).map_err(|error| named(&self.path, &error))?;
        Ok(())
    }
}

impl Write for WholeFile {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.out.write(bytes).map_err(|error| named(&self.path, &error))
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.out.flush().map_err(|error| named(&self.path, &error))
    }
}

impl Drop for WholeFile {
    fn drop(&mut self) {
        // Not there any more if it was finished.
        let _ = std::fs::remove_file(&self.partial);
    }
}

fn named(path: &Path, error: &std::io::Error) -> std::io::Error {
    std::io::Error::new(error.kind(), format!("{}: {error}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_finished_leaves_what_was_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        let names = || std::fs::read_dir(folder.path()).unwrap().count();
        write(&path, "first").unwrap();
        let mut second = WholeFile::create(&path).unwrap();
        second.write_all(b"second").unwrap();
        drop(second);
        assert_eq!((std::fs::read_to_string(&path).unwrap(), names()), ("first".to_owned(), 1));
        write(&path, "third").unwrap();
        assert_eq!((std::fs::read_to_string(&path).unwrap(), names()), ("third".to_owned(), 1));
        let error = write(&path.join("below"), "").unwrap_err().to_string();
        assert!(error.contains("file/below: "), "{error}");
    }
}

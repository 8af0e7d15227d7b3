//! Atomic files: complete or absent. No reader sees half a file, and a full disk leaves no empty file.
//!
//! They replace only files that rangehound has written, see [`crate::files::out_folder`].

use std::fs::File;
use std::io::{BufWriter, ErrorKind, Seek, SeekFrom, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use rustix::fs::{CWD, RenameFlags, renameat_with};
use rustix::io::Errno;

use crate::files::layout::PARTIAL;
use crate::files::out_folder;

/// A path in the same folder with a suffix appended to the file name.
#[must_use]
pub fn with_ending(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(ending);
    name.into()
}

/// An unfinished file under a temporary name. It gets its final name when it is finished; otherwise it is removed.
#[derive(Debug)]
pub struct AtomicFile {
    out: BufWriter<File>,
    path: PathBuf,
    partial: PathBuf,
}

/// Writes a complete file.
///
/// # Errors
/// With its name, if the system refuses.
pub fn write(path: &Path, content: impl AsRef<[u8]>) -> anyhow::Result<()> {
    write_with_mode(path, content, MODE)
}

/// Writes a complete file that only its owner can read.
///
/// # Errors
/// As [`write()`].
pub fn write_for_owner(path: &Path, content: impl AsRef<[u8]>) -> anyhow::Result<()> {
    write_with_mode(path, content, 0o600)
}

fn write_with_mode(path: &Path, content: impl AsRef<[u8]>, mode: u32) -> anyhow::Result<()> {
    let mut file = AtomicFile::create_with_mode(path, mode)?;
    file.write_all(content.as_ref())?;
    file.finish()
}

/// Gives a finished file its name. It replaces only what rangehound has written.
///
/// # Errors
/// If the system refuses, or another file has that name.
pub fn give_name(file: &File, partial: &Path, path: &Path) -> std::io::Result<()> {
    out_folder::note_finished(path, file)?;
    // In a claimed folder no other process can interfere between this check and the rename.
    if out_folder::is_ours(path) {
        return std::fs::rename(partial, path);
    }
    rename_to_free(partial, path)
}

/// Gives a file a name that no other file has.
///
/// # Errors
/// If the system refuses, or something has that name.
pub fn rename_to_free(partial: &Path, path: &Path) -> std::io::Result<()> {
    match renameat_with(CWD, partial, CWD, path, RenameFlags::NOREPLACE) {
        Err(Errno::EXIST) => Err(std::io::Error::new(
            ErrorKind::AlreadyExists,
            "the file that has this name is not as rangehound wrote it, so it is kept: move it away",
        )),
        // The file system does not support such a rename.
        Err(Errno::INVAL | Errno::NOSYS) if path.symlink_metadata().is_err() => std::fs::rename(partial, path),
        renamed => Ok(renamed?),
    }
}

/// Permissions of a new file, before the user's mask.
const MODE: u32 = 0o666;

impl AtomicFile {
    /// Begins a file.
    ///
    /// # Errors
    /// With its name, if the system refuses.
    pub fn create(path: &Path) -> anyhow::Result<Self> {
        Self::create_with_mode(path, MODE)
    }

    fn create_with_mode(path: &Path, mode: u32) -> anyhow::Result<Self> {
        // Another process may write the same file, as `watch` does beside a run's supervisor: the last one to finish wins.
        let partial = with_ending(path, &format!(".{}{PARTIAL}", std::process::id()));
        let file = File::options().write(true).create_new(true).mode(mode).open(&partial);
        let file = file.map_err(|error| named(path, &error))?;
        let made = Self { out: BufWriter::new(file), path: path.to_owned(), partial };
        out_folder::note_growing(&made.partial).map_err(|error| named(path, &error))?;
        Ok(made)
    }

    /// Gives the file its final name.
    ///
    /// # Errors
    /// With its name, if the system refuses.
    pub fn finish(mut self) -> anyhow::Result<()> {
        self.flush()?;
        give_name(self.out.get_ref(), &self.partial, &self.path).map_err(|error| named(&self.path, &error))?;
        Ok(())
    }
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.out.write(bytes).map_err(|error| named(&self.path, &error))
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.out.flush().map_err(|error| named(&self.path, &error))
    }
}

impl Seek for AtomicFile {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.out.seek(to).map_err(|error| named(&self.path, &error))
    }
}

impl Drop for AtomicFile {
    fn drop(&mut self) {
        // After `finish` this file no longer exists.
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
    fn an_unfinished_file_leaves_the_existing_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        let names = || std::fs::read_dir(folder.path()).unwrap().count() - 1;
        let _claim = out_folder::claim(folder.path(), crate::files::layout::Kind::Run, &[]).unwrap();
        write(&path, "first").unwrap();
        let mut second = AtomicFile::create(&path).unwrap();
        second.write_all(b"second").unwrap();
        drop(second);
        assert_eq!((std::fs::read_to_string(&path).unwrap(), names()), ("first".to_owned(), 1));
        write(&path, "third").unwrap();
        assert_eq!((std::fs::read_to_string(&path).unwrap(), names()), ("third".to_owned(), 1));
        std::fs::write(&path, "somebody's").unwrap();
        assert!(write(&path, "fourth").unwrap_err().to_string().contains("it is kept"));
        assert_eq!((std::fs::read_to_string(&path).unwrap(), names()), ("somebody's".to_owned(), 1));
        let error = write(&path.join("below"), "").unwrap_err().to_string();
        assert!(error.contains("file/below: "), "{error}");
    }
}

//! The mark of an output folder: what it is, and which files in it rangehound has made.
//!
//! A line is added before a file gets its name, so that a kill at any moment leaves no result that is not listed.

use std::ffi::OsStr;
use std::fs::{File, Metadata};
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

use rangehound_node::system::bounded;

use super::LOGS;

/// File name of the mark.
pub const MARK: &str = ".rangehound";

/// First line of every mark.
const TITLE: &str = "rangehound output folder, version 1";

const EXPLANATION: &str = "# Rangehound replaces only the files listed here, and only while they are as it wrote them.";

/// Longest mark that is read, bytes: a line is some 80 long.
const LEN_MAX: usize = 16 << 20;

/// A file as it was when it was added to the list.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Entry {
    name: String,
    inode: u64,
    /// 0 if the file system does not record it.
    born_ns: u128,
    /// Length and time of change; `None` while the file grows.
    finished: Option<(u64, i128)>,
}

impl Entry {
    fn of(name: &str, file: &Metadata, is_finished: bool) -> Self {
        let born = file.created().ok().and_then(|born| born.duration_since(UNIX_EPOCH).ok());
        let changed_ns = i128::from(file.mtime()) * 1_000_000_000 + i128::from(file.mtime_nsec());
        Self {
            name: name.to_owned(),
            inode: file.ino(),
            born_ns: born.map_or(0, |born| born.as_nanos()),
            finished: is_finished.then_some((file.len(), changed_ns)),
        }
    }

    fn parse(line: &str) -> Option<Self> {
        let mut words = line.strip_prefix("file ")?.splitn(5, ' ');
        let (inode, born_ns) = (words.next()?.parse().ok()?, words.next()?.parse().ok()?);
        let (len, changed_ns, name) = (words.next()?, words.next()?, words.next()?.to_owned());
        let finished = match (len, changed_ns) {
            ("-", "-") => None,
            (len, changed_ns) => Some((len.parse().ok()?, changed_ns.parse().ok()?)),
        };
        Some(Self { name, inode, born_ns, finished })
    }

    fn line(&self) -> String {
        let Self { name, inode, born_ns, finished } = self;
        let finished = finished.map_or("- -".to_owned(), |(len, changed_ns)| format!("{len} {changed_ns}"));
        format!("file {inode} {born_ns} {finished} {name}\n")
    }

    fn is_of(&self, other: &Self) -> bool {
        (&self.name, self.inode, self.born_ns) == (&other.name, other.inode, other.born_ns)
    }
}

/// True if the folder is rangehound's.
pub(super) fn is_marked(folder: &Path) -> bool {
    read(&folder.join(MARK)).is_some()
}

/// The lines of a mark; `None` if this version has written none.
fn read(mark: &Path) -> Option<Vec<String>> {
    if !mark.symlink_metadata().ok()?.is_file() {
        return None;
    }
    let text = String::from_utf8(bounded::read(mark, LEN_MAX).ok()?).ok()?;
    let mut lines = text.lines().map(str::to_owned);
    (lines.next()? == TITLE).then(|| lines.collect())
}

fn entries(lines: &[String]) -> Vec<Entry> {
    lines.iter().filter_map(|line| Entry::parse(line)).collect()
}

/// Marks a folder, and removes files from the list that no longer exist.
pub(super) fn mark(folder: &Path, kind: &str) -> io::Result<()> {
    let path = folder.join(MARK);
    let lines = read(&path).unwrap_or_default();
    let kind = format!("kind {kind}");
    let mut text = format!("{TITLE}\n{EXPLANATION}\n{kind}\n");
    for other in lines.iter().filter(|line| line.starts_with("kind ") && **line != kind) {
        text += &format!("{other}\n");
    }
    for entry in entries(&lines) {
        let there = folder.join(&entry.name).symlink_metadata();
        if there.is_ok_and(|file| Entry::of(&entry.name, &file, false).is_of(&entry)) {
            text += &entry.line();
        }
    }
    let partial = folder.join(format!("{MARK}.{}.partial", std::process::id()));
    let write = || {
        let mut file = File::create_new(&partial)?;
        file.write_all(text.as_bytes())?;
        std::fs::rename(&partial, &path)
    };
    write().inspect_err(|error| {
        if error.kind() != io::ErrorKind::AlreadyExists {
            let _ = std::fs::remove_file(&partial);
        }
    })
}

/// The mark that lists this file, and its name there; `None` in a folder that is not rangehound's.
fn listed_in(path: &Path) -> Option<(PathBuf, String)> {
    let (folder, name) = (path.parent()?, path.file_name()?.to_str()?);
    let mark = folder.join(MARK);
    if mark.symlink_metadata().is_ok() {
        return Some((mark, name.to_owned()));
    }
    let mark = folder.parent()?.join(MARK);
    let is_log = folder.file_name() == Some(OsStr::new(LOGS)) && mark.symlink_metadata().is_ok();
    is_log.then(|| (mark, format!("{LOGS}/{name}")))
}

/// True if rangehound made this file here, and it has not changed since.
#[must_use]
pub fn is_ours(path: &Path) -> bool {
    let Some((mark, name)) = listed_in(path) else { return false };
    let (Some(lines), Ok(file)) = (read(&mark), path.symlink_metadata()) else { return false };
    let now = Entry::of(&name, &file, true);
    let noted = entries(&lines).into_iter().rfind(|entry| entry.is_of(&now));
    file.is_file() && noted.is_some_and(|noted| noted.finished.is_none() || noted.finished == now.finished)
}

/// Adds a file that will grow to the list of its output folder. Does nothing in other folders.
///
/// # Errors
/// The system's.
pub fn note_growing(path: &Path) -> io::Result<()> {
    let Some((mark, name)) = listed_in(path) else { return Ok(()) };
    add(&mark, &Entry::of(&name, &path.symlink_metadata()?, false))
}

/// Adds a finished file to the list of its output folder, before it gets the name at `path`.
///
/// # Errors
/// The system's.
pub fn note_finished(path: &Path, file: &File) -> io::Result<()> {
    let Some((mark, name)) = listed_in(path) else { return Ok(()) };
    add(&mark, &Entry::of(&name, &file.metadata()?, true))
}

/// Adds the present state of all growing files to the list.
pub(super) fn seal(folder: &Path) -> io::Result<()> {
    let mark = folder.join(MARK);
    let entries = entries(&read(&mark).unwrap_or_default());
    for (index, entry) in entries.iter().enumerate() {
        let is_last = !entries[index + 1..].iter().any(|later| later.is_of(entry));
        let Ok(file) = folder.join(&entry.name).symlink_metadata() else { continue };
        let now = Entry::of(&entry.name, &file, true);
        if is_last && entry.finished.is_none() && now.is_of(entry) {
            add(&mark, &now)?;
        }
    }
    Ok(())
}

/// Adds a line in one write, so that lines of several processes do not mix.
fn add(mark: &Path, entry: &Entry) -> io::Result<()> {
    File::options().append(true).open(mark)?.write_all(entry.line().as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_reads_back() {
        for finished in [None, Some((5, -7))] {
            let entry = Entry { name: "logs/a b.log".to_owned(), inode: 3, born_ns: 4, finished };
            assert_eq!(Entry::parse(entry.line().trim_end()), Some(entry));
        }
        assert_eq!(Entry::parse("file 1 x - - name"), None);
    }

    #[test]
    fn a_file_is_ours_until_somebody_changes_or_replaces_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        std::fs::write(&path, "a").unwrap();
        assert!(!is_ours(&path));
        mark(folder.path(), "run").unwrap();
        assert!(!is_ours(&path));
        note_growing(&path).unwrap();
        std::fs::write(&path, "more").unwrap();
        assert!(is_ours(&path));
        seal(folder.path()).unwrap();
        assert!(is_ours(&path));
        mark(folder.path(), "run").unwrap();
        assert!(is_ours(&path));
        std::fs::write(&path, "somebody's").unwrap();
        assert!(!is_ours(&path));
        std::fs::rename(&path, folder.path().join("other")).unwrap();
        std::os::unix::fs::symlink("other", &path).unwrap();
        assert!(!is_ours(&path));
    }
}

//! Output folders: the folders that results may go to, and the files in them that may be replaced.
//!
//! A folder that rangehound writes results to has a mark in it, the file `.rangehound`. It lists each file that rangehound
//! has made there, by inode, time of birth, and, once it is finished, length and time of change. Only a file that is still
//! the one in the list is replaced or removed. A folder that is neither new nor empty nor marked is refused.

mod ledger;

use std::fs::{File, TryLockError};
use std::io;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use rangehound_node::checkpoint::Checkpoint;
use rangehound_node::logs;
use rangehound_node::rendezvous::Role;
use rangehound_shared::scenario::COPY;
use rustix::fs::OFlags;

use crate::failure::Failure;
use crate::files::layout::{DESCRIPTION, Kind, LOGS, RECORDING, SCENARIO};
pub use ledger::{MARK, is_ours, note_finished, note_growing};

/// Numbered names have smaller numbers.
pub const NUMBERS_END: u32 = 10_000;

/// Why a folder cannot be used.
#[derive(Debug)]
pub enum Refusal {
    /// Another process writes to it, or it holds files that rangehound has not made: another folder may work.
    Taken(String),
    /// It cannot be written, or an input lies in it.
    Unusable(String),
}

impl std::fmt::Display for Refusal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (Self::Taken(problem) | Self::Unusable(problem)) = self;
        f.write_str(problem)
    }
}

impl From<Refusal> for Failure {
    fn from(refusal: Refusal) -> Self {
        Self::input(refusal)
    }
}

/// An output folder; while this exists, no other process writes results to it.
#[derive(Debug)]
pub struct Claim {
    path: PathBuf,
    kind: Kind,
    _lock: File,
}

/// Claims a folder for results of a kind: makes it, or checks that rangehound made all files that would be replaced.
/// Changes only its mark. `inputs` are the files that are read meanwhile: none of them may be in the folder.
///
/// # Errors
/// [`Refusal`].
pub fn claim(folder: &Path, kind: Kind, inputs: &[&Path]) -> Result<Claim, Refusal> {
    refuse_inputs(folder, kind, inputs)?;
    std::fs::create_dir_all(folder).map_err(|error| not_writable(folder, &error))?;
    let lock = lock(folder)?;
    let claim = Claim { path: folder.to_owned(), kind, _lock: lock };
    let is_marked = ledger::is_marked(folder);
    if !is_marked && entries(folder).next().is_some() {
        return Err(Refusal::Taken(format!(
            "{} (--out) has files that rangehound did not make (no {MARK}): expected a new or empty folder, or one that \
             rangehound made: choose another, or move them away",
            folder.display()
        )));
    }
    claim.refuse_strangers()?;
    ledger::mark(folder, kind.name()).map_err(|error| not_writable(folder, &error))?;
    Ok(claim)
}

/// Claims the folder that the user chose, or else the default one, numbered if that is taken.
///
/// # Errors
/// [`Failure::Input`] if no folder can be claimed.
pub fn claim_or_number(chosen: Option<&Path>, default: &str, kind: Kind, inputs: &[&Path]) -> Result<Claim, Failure> {
    if let Some(chosen) = chosen {
        return Ok(claim(chosen, kind, inputs)?);
    }
    let numbered = (2..NUMBERS_END).map(|number| format!("{default}-{number}"));
    for folder in std::iter::once(default.to_owned()).chain(numbered) {
        match claim(Path::new(&folder), kind, inputs) {
            Err(Refusal::Taken(_)) => {}
            claimed => return Ok(claimed?),
        }
    }
    Err(Failure::input(format!("all numbered folders from {default} on are taken: choose a folder with --out")))
}

/// Claims the folder of a run that is resumed.
///
/// # Errors
/// [`Refusal`], also if a file would be replaced that rangehound did not make.
pub fn claim_again(folder: &Path) -> Result<Claim, Refusal> {
    let claim = Claim { path: folder.to_owned(), kind: Kind::Run, _lock: lock(folder)? };
    if !ledger::is_marked(folder) {
        return Err(Refusal::Taken(format!(
            "{} (--out) has no {MARK}: expected a folder that rangehound made: start a new run in another folder",
            folder.display()
        )));
    }
    // The run's id in these files tells whether they belong to this run.
    let goes_on = |name: &str| name.ends_with(".ticks") || name.ends_with(".checkpoint");
    let kept = [DESCRIPTION, SCENARIO, COPY];
    for name in entries(folder).filter(|name| kind_of_result(name)) {
        if !goes_on(&name) && !kept.contains(&name.as_str()) && !name.starts_with(RECORDING) {
            claim.refuse_stranger(&folder.join(&name))?;
        }
    }
    for name in [logs::ESTIMATES, logs::WORLDS] {
        let _ = note_growing(&folder.join(name));
    }
    for name in entries(&folder.join(LOGS)) {
        let path = folder.join(LOGS).join(name);
        if is_ours(&path) {
            let _ = note_growing(&path);
        }
    }
    Ok(claim)
}

fn kind_of_result(name: &str) -> bool {
    Kind::Run.writes(name)
}

/// Adds the present state of a folder's growing files to its list: later changes are not rangehound's.
pub fn seal(folder: &Path) {
    if let Err(error) = ledger::seal(folder) {
        log::warn!(
            "cannot update {}: {error}; later runs may refuse to replace its files",
            folder.join(MARK).display()
        );
    }
}

/// Removes the files that rangehound made in a folder, and the folder if it is empty then. A folder without a mark is
/// not changed.
pub fn remove(folder: &Path) {
    if !ledger::is_marked(folder) {
        return;
    }
    for (below, name) in [folder.join(LOGS), folder.to_owned()]
        .iter()
        .flat_map(|below| entries(below).map(move |name| (below, name)).collect::<Vec<_>>())
    {
        let path = below.join(&name);
        if name != MARK && is_ours(&path) {
            let _ = std::fs::remove_file(path);
        }
    }
    // Fails, as it should, if the folder is not empty.
    let _ = std::fs::remove_dir(folder.join(LOGS));
    if entries(folder).all(|name| name == MARK) {
        let _ = std::fs::remove_file(folder.join(MARK));
        let _ = std::fs::remove_dir(folder);
    }
}

/// Opens a file of an output folder for appending, and adds it to the list if it is new.
///
/// # Errors
/// The system's.
pub fn append(path: &Path) -> io::Result<File> {
    let flags = OFlags::NOFOLLOW.bits().cast_signed();
    match File::options().append(true).create_new(true).open(path) {
        Ok(file) => {
            note_growing(path)?;
            Ok(file)
        }
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
            File::options().append(true).custom_flags(flags).open(path)
        }
        Err(error) => Err(error),
    }
}

impl Claim {
    /// The folder.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Removes earlier results of this kind, all of which rangehound has made.
    ///
    /// # Errors
    /// [`Refusal`] if a file was added meanwhile that rangehound did not make, or the system refuses.
    pub fn clear(&self) -> Result<(), Refusal> {
        for path in self.results() {
            self.refuse_stranger(&path)?;
            std::fs::remove_file(&path).map_err(|error| not_writable(&path, &error))?;
        }
        if self.kind == Kind::Run {
            let logs = self.path.join(LOGS);
            std::fs::create_dir_all(&logs).map_err(|error| not_writable(&logs, &error))?;
        }
        Ok(())
    }

    /// Makes the empty log in which a node will record its ticks.
    ///
    /// # Errors
    /// [`Refusal`] if the system refuses.
    pub fn make_growing(&self, name: &str) -> Result<(), Refusal> {
        let path = self.path.join(name);
        append(&path).map(drop).map_err(|error| not_writable(&path, &error))
    }

    /// All files of the folder that have names of results of this kind.
    fn results(&self) -> Vec<PathBuf> {
        let results = entries(&self.path).filter(|name| self.kind.writes(name)).map(|name| self.path.join(name));
        let logs = self.path.join(LOGS);
        // A file that is not in the list belongs to the user. It is in the way only if it has a node's name.
        let is_log = |path: &PathBuf| {
            let node = path.file_stem().and_then(|stem| stem.to_str()).map(str::parse::<Role>);
            is_ours(path) || path.extension().is_some_and(|ending| ending == "log") && matches!(node, Some(Ok(_)))
        };
        let has_logs = self.kind == Kind::Run && logs.symlink_metadata().is_ok_and(|logs| logs.is_dir());
        let logs: Vec<String> = if has_logs { entries(&logs).collect() } else { Vec::new() };
        let logs = logs.into_iter().map(|name| self.path.join(LOGS).join(name)).filter(is_log);
        results.chain(logs).collect()
    }

    fn refuse_strangers(&self) -> Result<(), Refusal> {
        for path in self.results() {
            self.refuse_stranger(&path)?;
        }
        let logs = self.path.join(LOGS);
        match logs.symlink_metadata() {
            Ok(metadata) if self.kind == Kind::Run && !metadata.is_dir() => Err(stranger(&logs)),
            _ => Ok(()),
        }
    }

    fn refuse_stranger(&self, path: &Path) -> Result<(), Refusal> {
        let is_checkpoint = path.extension().is_some_and(|ending| ending == "checkpoint");
        if is_ours(path) || is_checkpoint && Checkpoint::is_one(path) { Ok(()) } else { Err(stranger(path)) }
    }
}

fn stranger(path: &Path) -> Refusal {
    Refusal::Taken(format!(
        "{} (--out) is not as rangehound wrote it, and would be replaced: choose another folder, or move it away",
        path.display()
    ))
}

/// Refuses an input that is in the folder, under any name.
fn refuse_inputs(folder: &Path, kind: Kind, inputs: &[&Path]) -> Result<(), Refusal> {
    let Ok(real_folder) = folder.canonicalize() else { return Ok(()) };
    let identity = |file: &std::fs::Metadata| (file.dev(), file.ino());
    let below = |folder: PathBuf| entries(&folder).map(move |name| folder.join(name)).collect::<Vec<_>>();
    let is_result = |path: &PathBuf| path.file_name().is_some_and(|name| kind.writes(&name.to_string_lossy()));
    let results = || below(folder.to_owned()).into_iter().filter(is_result).chain(below(folder.join(LOGS)));
    for input in inputs {
        let Ok(metadata) = std::fs::metadata(input) else { continue };
        let is_in = input.canonicalize().is_ok_and(|input| input.starts_with(&real_folder));
        let is_one =
            |path: PathBuf| std::fs::metadata(path).is_ok_and(|result| identity(&result) == identity(&metadata));
        if is_in || metadata.is_file() && results().any(is_one) {
            return Err(Refusal::Unusable(format!(
                "{} is read, and lies where results would go, in {} (--out): choose another folder",
                input.display(),
                folder.display()
            )));
        }
    }
    Ok(())
}

/// Locks a folder while the file is open: two processes that write to one folder would destroy each other's results.
fn lock(folder: &Path) -> Result<File, Refusal> {
    let file = File::open(folder).map_err(|error| not_writable(folder, &error))?;
    match file.try_lock() {
        Err(TryLockError::WouldBlock) => {
            let folder = folder.display();
            Err(Refusal::Taken(format!("a run is using {folder} (--out): choose another folder, or stop that run")))
        }
        // Runs also work on a file system without locks.
        Ok(()) | Err(TryLockError::Error(_)) => Ok(file),
    }
}

/// Locks the folder of a run that is over while it is recorded.
///
/// # Errors
/// [`Failure::Input`] if a living run uses it.
pub fn lock_finished(folder: &Path) -> Result<File, Failure> {
    lock(folder).map_err(|refusal| match refusal {
        Refusal::Taken(_) => Failure::input(format!(
            "the run in {} is not over: expected a finished run: record it by its --name, or wait for its end",
            folder.display()
        )),
        unusable => unusable.into(),
    })
}

fn not_writable(path: &Path, error: &io::Error) -> Refusal {
    // For these the system only says that something exists already.
    let is_link = path.symlink_metadata().is_ok_and(|file| file.is_symlink());
    let (cause, advice) = match path.metadata() {
        Ok(file) if error.kind() == io::ErrorKind::AlreadyExists && !file.is_dir() => {
            ("it is not a folder".to_owned(), ": choose another name")
        }
        Err(_) if is_link => ("it is a link to nothing".to_owned(), ": choose another name, or remove it"),
        _ => (error.to_string(), ""),
    };
    let path = path.display();
    Refusal::Unusable(format!("cannot write to {path} (--out): {cause}: expected a folder that can be written{advice}"))
}

/// Names of the files in a folder.
fn entries(folder: &Path) -> impl Iterator<Item = String> + use<> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.map(|entry| entry.file_name().to_string_lossy().into_owned())
}

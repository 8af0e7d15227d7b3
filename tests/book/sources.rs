//! The contents of the project: its files and folders, and the names of its tests.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::page::root;

/// Folders without files of the project.
const FOREIGN: [&str; 4] = [".git", "target", "runs", "corpus"];

pub(super) struct Sources {
    /// Files and folders, relative to the project's folder.
    paths: Vec<PathBuf>,
    /// The file and the name of each test.
    tests: BTreeSet<(PathBuf, String)>,
    /// Every identifier of the Rust sources.
    words: BTreeSet<String>,
}

impl Sources {
    pub(super) fn read() -> Self {
        let mut paths = Vec::new();
        collect(Path::new(""), &mut paths);
        let (mut tests, mut words) = (BTreeSet::new(), BTreeSet::new());
        for path in paths.iter().filter(|path| path.extension().is_some_and(|extension| extension == "rs")) {
            let source = std::fs::read_to_string(root().join(path)).unwrap();
            tests.extend(tests_of(&source).map(|name| (path.clone(), name.to_owned())));
            words.extend(words_of(&source).map(str::to_owned));
        }
        Self { paths, tests, words }
    }

    /// True for a path from the project's folder, and for the end of one: `certified/`, `frame.rs`.
    pub(super) fn has(&self, path: &str) -> bool {
        root().join(path).exists() || self.paths.iter().any(|known| known.ends_with(path))
    }

    /// True for the name of a file or folder directly in the project's folder.
    pub(super) fn has_at_its_root(&self, name: &str) -> bool {
        self.paths.iter().any(|path| path == Path::new(name))
    }

    /// True if each part of a Rust name, such as `Centre::update`, occurs in the sources.
    pub(super) fn has_words(&self, name: &str) -> bool {
        words_of(name).all(|word| self.words.contains(word))
    }

    pub(super) fn has_test(&self, name: &str) -> bool {
        self.tests.iter().any(|(_, test)| test == name)
    }

    /// True if a folder has a test with this in its name, or in that of its modules.
    pub(super) fn has_test_like(&self, folder: &Path, filter: &str) -> bool {
        let mut tests = self.tests.iter().filter(|(path, _)| path.starts_with(folder));
        tests.any(|(path, name)| name.contains(filter) || path.to_string_lossy().contains(filter))
    }
}

fn collect(folder: &Path, paths: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(root().join(folder)).unwrap().map(Result::unwrap) {
        let name = entry.file_name();
        if FOREIGN.iter().any(|foreign| name == *foreign) {
            continue;
        }
        let path = folder.join(name);
        if entry.file_type().unwrap().is_dir() {
            collect(&path, paths);
        }
        paths.push(path);
    }
}

/// Names of the functions that are marked as tests.
fn tests_of(source: &str) -> impl Iterator<Item = &str> {
    source.split("#[test]").skip(1).filter_map(|rest| {
        let name = rest.split_once("fn ")?.1;
        words_of(name).next()
    })
}

fn words_of(text: &str) -> impl Iterator<Item = &str> {
    text.split(|c: char| !c.is_alphanumeric() && c != '_').filter(|word| !word.is_empty())
}

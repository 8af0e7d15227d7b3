//! A page's parts: blocks of commands, links, headings, names in backticks.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// A mark is on the line before its block.
const MARK: (&str, &str) = ("<!-- ", " -->");

const FENCE: &str = "```";

/// The project's folder.
pub(super) fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// A page of the project.
pub(super) struct Page {
    /// Path relative to the project's folder.
    pub(super) path: PathBuf,
    pub(super) text: String,
}

/// The text between two fences.
pub(super) struct Block {
    pub(super) line: usize,
    pub(super) language: String,
    pub(super) text: String,
    /// Without one it is run as it stands.
    pub(super) mark: Option<Mark>,
}

/// How a block is run that needs more than the program.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Mark {
    /// `run with`: what the tests here provide.
    With(String),
    /// `run by`: the file of the tests that run it.
    By(String),
    /// `not run`: why not.
    Not(String),
    /// None of these.
    Unknown(String),
}

impl Mark {
    fn of(line: &str) -> Option<Self> {
        let text = line.strip_prefix(MARK.0)?.strip_suffix(MARK.1)?;
        let (kind, what) = text.split_once(": ").unwrap_or((text, ""));
        let kind = match kind {
            "run with" => Self::With,
            "run by" => Self::By,
            "not run" => Self::Not,
            _ => return Some(Self::Unknown(text.to_owned())),
        };
        Some(kind(what.to_owned()))
    }
}

impl Page {
    fn read(path: PathBuf) -> Self {
        let text = std::fs::read_to_string(root().join(&path)).unwrap();
        Self { path, text }
    }

    /// A page by its path.
    pub(super) fn of(path: &str) -> Self {
        Self::read(path.into())
    }

    /// The pages of the book.
    pub(super) fn of_book() -> Vec<Self> {
        let mut paths: Vec<PathBuf> = std::fs::read_dir(root().join("docs"))
            .unwrap()
            .map(|entry| Path::new("docs").join(entry.unwrap().file_name()))
            .filter(|path| path.extension().is_some_and(|extension| extension == "md"))
            .collect();
        paths.sort();
        paths.into_iter().map(Self::read).collect()
    }

    /// A position on this page, for an error message.
    pub(super) fn at(&self, line: usize) -> String {
        format!("{}:{line}", self.path.display())
    }

    /// Blocks of commands: of the shell, or of Python.
    pub(super) fn commands(&self) -> impl Iterator<Item = Block> {
        self.blocks().into_iter().filter(|block| ["sh", "python"].contains(&block.language.as_str()))
    }

    pub(super) fn blocks(&self) -> Vec<Block> {
        let mut blocks = Vec::new();
        let mut before = "";
        let mut lines = self.text.lines().zip(1..);
        while let Some((line, number)) = lines.next() {
            if let Some(language) = line.strip_prefix(FENCE) {
                let inside = lines.by_ref().map(|(line, _)| line).take_while(|line| *line != FENCE);
                let text = inside.map(|line| format!("{line}\n")).collect();
                blocks.push(Block { line: number, language: language.to_owned(), text, mark: Mark::of(before) });
            }
            before = line;
        }
        blocks
    }

    /// The lines outside blocks, with their numbers.
    pub(super) fn prose(&self) -> Vec<(usize, &str)> {
        let mut inside = false;
        let outside = |line: &str| {
            let fence = line.starts_with(FENCE);
            inside ^= fence;
            !inside && !fence
        };
        let numbered = self.text.lines().scan(outside, |outside, line| Some((outside(line), line)));
        (1..).zip(numbered).filter_map(|(number, (outside, line))| outside.then_some((number, line))).collect()
    }

    /// Texts in backticks, with their line numbers.
    pub(super) fn names(&self) -> Vec<(usize, &str)> {
        self.prose().into_iter().flat_map(|(number, line)| names(line).map(move |name| (number, name))).collect()
    }

    /// Targets of links and pictures, with their line numbers.
    pub(super) fn links<'a>(&'a self) -> Vec<(usize, &'a str)> {
        let of_line = |(number, line): (usize, &'a str)| {
            line.split("](").skip(1).filter_map(move |rest| Some((number, rest.split_once(')')?.0)))
        };
        self.prose().into_iter().flat_map(of_line).collect()
    }

    /// Headings without their marks, in order, with their depth.
    pub(super) fn headings(&self) -> Vec<(usize, &str)> {
        let prose = self.prose().into_iter();
        prose
            .filter_map(|(_, line)| Some((line.find(' ')?, line.strip_prefix('#')?.trim_start_matches('#').trim())))
            .collect()
    }

    /// Anchors of the headings.
    pub(super) fn anchors(&self) -> BTreeSet<String> {
        self.headings().into_iter().map(|(_, heading)| anchor(heading)).collect()
    }

    /// The lines of a section, without its heading.
    pub(super) fn section(&self, heading: &str) -> Vec<(usize, &str)> {
        let heading = format!("## {heading}");
        let prose = self.prose().into_iter().skip_while(|(_, line)| *line != heading).skip(1);
        prose.take_while(|(_, line)| !line.starts_with("## ")).collect()
    }
}

/// Texts in backticks in a line.
pub(super) fn names(line: &str) -> impl Iterator<Item = &str> {
    line.split('`').skip(1).step_by(2)
}

/// A heading's anchor, as GitHub makes it.
fn anchor(heading: &str) -> String {
    let kept = heading.chars().filter(|c| c.is_alphanumeric() || [' ', '-', '_'].contains(c));
    kept.flat_map(char::to_lowercase).map(|c| if c == ' ' { '-' } else { c }).collect()
}

//! Commands for the shell: `completions`, `names`, `man`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

/// `completions`.
#[derive(Debug, Args)]
pub struct CompletionsArgs {
    /// The shell
    pub shell: clap_complete::Shell,
}

/// `names`.
#[derive(Debug, Args)]
pub struct NamesArgs {
    /// The kind of names
    pub of: NamesOf,
}

/// Kinds of names that change over time.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum NamesOf {
    /// Running runs
    Runs,
    /// Nodes of the running runs
    Nodes,
}

/// `man`.
#[derive(Debug, Args)]
pub struct ManArgs {
    /// Folder for the pages of all commands [default: print the main page, to a pipe or file]
    #[arg(value_name = "DIR")]
    pub folder: Option<PathBuf>,
}

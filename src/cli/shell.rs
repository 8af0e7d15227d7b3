//! What a shell asks for: `completions`, `man`.

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
    /// Of what
    pub of: NamesOf,
}

/// What has names that only the moment knows.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum NamesOf {
    /// Runs that go on
    Runs,
    /// Nodes of any of them
    Nodes,
}

/// `man`.
#[derive(Debug, Args)]
pub struct ManArgs {
    /// Folder for the pages of all commands [default: that of rangehound, to a pipe or file]
    #[arg(value_name = "DIR")]
    pub folder: Option<PathBuf>,
}

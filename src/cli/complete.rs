//! Completions and manual pages, made from the definition of the command line.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{IsTerminal, Write};
use std::path::Path;

use clap::Command;
use clap_complete::Shell;
use clap_mangen::Man;
use clap_mangen::roff::{Roff, roman};
use rangehound_node::rendezvous::{Rendezvous, Role, living_runs};
use rangehound_node::system::bounded;

use crate::cli::{self, CompletionsArgs, ManArgs, NamesArgs, NamesOf};
use crate::failure::{self, Failure};
use crate::files::atomic_file::{rename_to_free, with_ending};
use crate::files::layout::PARTIAL;
use crate::run::watch;

/// Longest manual page that is read.
const PAGE_LEN_MAX: usize = 1 << 20;

/// Printed on a terminal, where the source of a page is unreadable.
const HOW_TO_READ: &str = "\
rangehound man | man -l -                      reads the manual page
rangehound man ~/.local/share/man/man1         writes those of all commands; then:
man rangehound-run                             reads one of them
";

/// `rangehound completions`.
///
/// # Errors
/// [`Failure`].
pub fn completions(args: &CompletionsArgs) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut visible(&cli::command()), "rangehound", &mut script);
    failure::print(with_names(args.shell, String::from_utf8(script)?))
}

/// A completion script that also asks the program for the names of runs and nodes.
fn with_names(shell: Shell, script: String) -> String {
    match shell {
        Shell::Bash => script + include_str!("complete/names.bash"),
        Shell::Fish => script + include_str!("complete/names.fish"),
        Shell::Zsh => script
            .replace(":NAME:_default", ":NAME:_rangehound_runs")
            .replace("robot-N:_default", "robot-N:_rangehound_nodes")
            .replacen("_rangehound() {", concat!(include_str!("complete/names.zsh"), "_rangehound() {"), 1),
        _ => script,
    }
}

/// `rangehound names`: the names for these scripts, one per line.
///
/// # Errors
/// [`Failure`].
pub fn names(args: &NamesArgs) -> Result<(), Failure> {
    let names: BTreeSet<String> = match args.of {
        NamesOf::Runs => living_runs().iter().map(ToString::to_string).collect(),
        NamesOf::Nodes => {
            // A run of another version is left out; the others are listed.
            let runs = living_runs().into_iter().filter_map(|name| Rendezvous::join_if_alive(&name).ok().flatten());
            let roles = |run: Rendezvous| {
                let gateway = Some(Role::Gateway).filter(|role| run.roster().starts(*role) > 0);
                watch::roles(run.description().scenario.robots.len()).chain(gateway)
            };
            runs.flat_map(roles).map(|role| role.to_string()).collect()
        }
    };
    failure::print(names.into_iter().map(|name| name + "\n").collect::<String>())
}

/// `rangehound man`.
///
/// # Errors
/// [`Failure`].
pub fn man(args: &ManArgs) -> Result<(), Failure> {
    // `help` needs no page of its own.
    let mut command = cli::command().disable_help_subcommand(true);
    command.build();
    let Some(folder) = &args.folder else {
        if std::io::stdout().is_terminal() {
            return failure::print(HOW_TO_READ);
        }
        return failure::print(String::from_utf8(page(&command)?)?);
    };
    std::fs::create_dir_all(folder).map_err(|error| not_writable(folder, &error))?;
    let of_each = command.get_subcommands().filter(|subcommand| !subcommand.is_hide_set());
    let of_each = of_each.chain([&command]).map(|command| {
        let file = folder.join(Man::new(command.clone()).get_filename());
        Ok::<_, Failure>((file, page(command)?))
    });
    let pages = of_each.collect::<Result<Vec<_>, _>>()?;
    if let Some((file, _)) = pages.iter().find(|(file, _)| file.symlink_metadata().is_ok() && !is_page(file)) {
        return Err(Failure::input(format!(
            "{} is in the way (DIR), and rangehound did not make it: choose another folder, or move it away",
            file.display()
        )));
    }
    for (file, page) in pages {
        write_page(&file, &page).map_err(|error| not_writable(&file, &error))?;
    }
    failure::print(format!("manual pages in {}\n", folder.display()))
}

/// True if the file is a manual page that any version of this program made.
fn is_page(file: &Path) -> bool {
    let is_file = file.symlink_metadata().is_ok_and(|file| file.is_file());
    let text = if is_file { bounded::read(file, PAGE_LEN_MAX).unwrap_or_default() } else { Vec::new() };
    let text = String::from_utf8_lossy(&text);
    let title = text.lines().take(8).find(|line| line.starts_with(".TH "));
    title.is_some_and(|title| title.starts_with(".TH rangehound") && title.contains("rangehound "))
}

/// Writes a page under a temporary name and renames it: a file that is replaced keeps its content under its other names.
fn write_page(file: &Path, page: &[u8]) -> std::io::Result<()> {
    let partial = with_ending(file, &format!(".{}{PARTIAL}", std::process::id()));
    let mut out = File::create_new(&partial)?;
    let named = out
        .write_all(page)
        .and_then(|()| if is_page(file) { std::fs::rename(&partial, file) } else { rename_to_free(&partial, file) });
    named.inspect_err(|_| drop(std::fs::remove_file(&partial)))
}

fn not_writable(path: &Path, error: &std::io::Error) -> Failure {
    Failure::input(format!("cannot write {} (DIR): {error}: expected a folder that can be written", path.display()))
}

/// The manual page of a command.
fn page(command: &Command) -> std::io::Result<Vec<u8>> {
    let man = Man::new(command.clone()).source(concat!("rangehound ", env!("CARGO_PKG_VERSION"))).manual("rangehound");
    let mut page = Vec::new();
    man.render_title(&mut page)?;
    man.render_name_section(&mut page)?;
    man.render_synopsis_section(&mut page)?;
    man.render_description_section(&mut page)?;
    man.render_options_section(&mut page)?;
    if command.has_subcommands() {
        man.render_subcommands_section(&mut page)?;
    }
    if let Some(examples) = command.get_after_help() {
        let mut roff = Roff::default();
        // Lines unfilled and not indented: they are already as wide as a terminal.
        roff.control("SH", ["EXAMPLES"]).control("in", ["0"]).control("nf", []);
        for line in examples.to_string().lines() {
            roff.text([roman(line)]);
        }
        roff.control("fi", []).to_writer(&mut page)?;
    }
    Ok(page)
}

/// A command without its hidden parts, which completions would show.
fn visible(command: &Command) -> Command {
    let args = command.get_arguments().filter(|arg| !arg.is_hide_set()).cloned();
    let subcommands = command.get_subcommands().filter(|subcommand| !subcommand.is_hide_set()).map(visible);
    let mut visible = Command::new(command.get_name().to_owned()).args(args).subcommands(subcommands);
    if let Some(about) = command.get_about() {
        visible = visible.about(about.clone());
    }
    match command.get_version() {
        Some(version) => visible.version(version.to_owned()),
        None => visible,
    }
}

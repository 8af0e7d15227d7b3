//! What a shell wants to know of the tool: completions and manual pages, made of what the command line is read with.

use clap::Command;
use clap_mangen::Man;
use clap_mangen::roff::{Roff, roman};

use crate::cli::{self, CompletionsArgs, ManArgs};
use crate::failure::{self, Failure};
use crate::tables;

/// `rangehound completions`.
///
/// # Errors
/// [`Failure`].
pub fn completions(args: &CompletionsArgs) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut visible(&cli::command()), "rangehound", &mut script);
    failure::print(String::from_utf8(script)?)
}

/// `rangehound man`.
///
/// # Errors
/// [`Failure`].
pub fn man(args: &ManArgs) -> Result<(), Failure> {
    // A page of its own for `help` would say nothing.
    let mut command = cli::command().disable_help_subcommand(true);
    command.build();
    let Some(folder) = &args.folder else {
        return failure::print(String::from_utf8(page(&command)?)?);
    };
    tables::make_folder(folder)?;
    let of_each = command.get_subcommands().filter(|subcommand| !subcommand.is_hide_set());
    for command in of_each.chain([&command]) {
        let file = folder.join(Man::new(command.clone()).get_filename());
        std::fs::write(&file, page(command)?).map_err(|error| tables::not_writable(&file, &error))?;
    }
    failure::print(format!("manual pages in {}\n", folder.display()))
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
        // Line by line as it is, and from the margin, as it is as wide as a terminal.
        roff.control("SH", ["EXAMPLES"]).control("in", ["0"]).control("nf", []);
        for line in examples.to_string().lines() {
            roff.text([roman(line)]);
        }
        roff.control("fi", []).to_writer(&mut page)?;
    }
    Ok(page)
}

/// A command without what is hidden in it, which completions would tell.
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

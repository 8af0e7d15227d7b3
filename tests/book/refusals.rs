//! Commands are read without being run: what the program or Cargo would refuse is a fault of the page.

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

use clap::error::ErrorKind;
use rangehound::cli;

use super::commands::example;
use super::page::{Mark, root};
use super::sources::Sources;
use super::{assert_none, pages, provided};

/// The reasons for which a page may say that no test runs its commands.
const REASONS: [&str; 4] = [
    "needs a browser",
    "needs another machine, and a browser there",
    "takes minutes or hours",
    "takes minutes to build",
];

/// The members whose tests `cargo test --release` runs, and so this one with them.
const TESTED: [&str; 5] = ["shared", "sim", "robot", "fusion", "node"];

/// The commands of the Python package.
const PYTHON_COMMANDS: [&str; 6] = [
    "python/rangehound/foxglove.py",
    "python/rangehound/mavlink/__main__.py",
    "python/rangehound/rerun.py",
    "python/rangehound/ros2/observer.py",
    "python/rangehound/ros2/robot.py",
    "python/rangehound/ros2/session.py",
];

/// Each mark says what is so: the tests here provide what it names, or other tests read the page, or there is a good reason.
#[test]
fn each_block_is_run_or_has_a_reason() {
    let mut faults = Vec::new();
    let mut marks = BTreeSet::new();
    for page in pages() {
        for block in page.commands() {
            let Some(mark) = block.mark else { continue };
            let is_known = match &mark {
                Mark::With(what) => {
                    provided::PROVIDED.iter().any(|(known, _)| known == what) || what == super::recordings::WHAT
                }
                // These files run every block with their mark, and fail if a page has more: see `blocks` there.
                Mark::By(file) => std::fs::read_to_string(root().join(file))
                    .is_ok_and(|text| text.contains(&format!("\"{}\"", page.path.display()))),
                Mark::Not(reason) => REASONS.contains(&reason.as_str()),
                Mark::Unknown(_) => false,
            };
            if !is_known {
                faults.push(format!("{}: nobody takes care of {mark:?}", page.at(block.line)));
            }
            marks.insert(mark);
        }
    }
    let provided = provided::PROVIDED.iter().map(|(what, _)| Mark::With((*what).to_owned()));
    let unused: Vec<Mark> = provided
        .chain(REASONS.map(|reason| Mark::Not(reason.to_owned())))
        .filter(|mark| !marks.contains(mark))
        .collect();
    faults.extend(unused.iter().map(|mark| format!("no block has the mark {mark:?}")));
    assert_none(faults);
}

#[test]
fn no_command_is_refused() {
    let sources = Sources::read();
    let mut faults = Vec::new();
    for page in pages() {
        for block in page.commands() {
            let refused = commands(&block.text).filter_map(|words| refusal(&sources, &words));
            faults.extend(refused.map(|refusal| format!("{}: {refusal}", page.at(block.line))));
        }
    }
    assert_none(faults);
}

/// Why a command of the project is refused, if it is.
fn refusal(sources: &Sources, words: &[String]) -> Option<String> {
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    match words[..] {
        ["rangehound", ref args @ ..] => refusal_by_program(args),
        ["cargo", "run", ref args @ ..] => {
            let (of_cargo, args) = args.split_at(args.iter().position(|arg| *arg == "--").unwrap_or(args.len()));
            let args = args.get(1..).unwrap_or_default();
            match after(of_cargo, "--example") {
                None => refusal_by_program(args),
                Some(name) => refusal_by_example(name, args),
            }
        }
        ["cargo", "test", ref args @ ..] => refusal_by_tests(sources, args),
        ["cargo", "bench", ref args @ ..] => {
            let bench = after(args, "--bench").map(|name| format!("bench/benches/{name}.rs"));
            missing(&bench.unwrap_or_else(|| "bench/benches".to_owned()))
        }
        ["cargo", "fuzz", "run", ref args @ ..] => {
            let target = args.iter().find(|arg| **arg != "-s" && **arg != "none")?;
            missing(&format!("fuzz/fuzz_targets/{target}.rs"))
        }
        ["cargo", "fuzz", "list"] => missing("fuzz/Cargo.toml"),
        ["cargo", "build", ref args @ ..] => {
            let member = after(args, "-p")?.strip_prefix("rangehound-")?;
            let manifest = format!("{member}/Cargo.toml");
            let text = std::fs::read_to_string(root().join(&manifest)).unwrap_or_default();
            let has = |feature: &str| text.contains(&format!("\n{feature} = [\"dep:"));
            match after(args, "--features") {
                Some(feature) if !has(feature) => Some(format!("no feature {feature} in {manifest}")),
                _ => missing(&manifest),
            }
        }
        ["cargo", ..] => Some(format!("unknown command of Cargo: {}", words.join(" "))),
        ["python3", script] => missing(script),
        [".ci/run"] => missing(".ci/run"),
        _ => None,
    }
}

fn after<'a>(words: &[&'a str], flag: &str) -> Option<&'a str> {
    words.iter().skip_while(|word| **word != flag).nth(1).copied()
}

fn missing(path: &str) -> Option<String> {
    (!root().join(path).exists()).then(|| format!("no such file: {path}"))
}

/// Tests that a page names are among those that run now.
fn refusal_by_tests(sources: &Sources, args: &[&str]) -> Option<String> {
    let member = after(args, "-p").map(|member| member.strip_prefix("rangehound-").unwrap_or(member));
    if member.is_some_and(|member| !TESTED.contains(&member)) {
        return Some(format!("`cargo test --release` does not run the tests of {member:?}"));
    }
    let folder = Path::new(member.unwrap_or(""));
    let of_cargo: Vec<&str> = args.iter().take_while(|arg| **arg != "--").copied().collect();
    let mut rest = of_cargo.iter().skip_while(|arg| arg.starts_with("--release"));
    let mut filter = None;
    while let Some(word) = rest.next() {
        match *word {
            "-p" | "--test" => _ = rest.next(),
            word if !word.starts_with('-') => filter = Some(word),
            _ => {}
        }
    }
    let filter = filter?;
    (!sources.has_test_like(folder, filter)).then(|| format!("no test is named like {filter}"))
}
fn refusal_by_program(args: &[&str]) -> Option<String> {
    let refusal = cli::command().try_get_matches_from([&["rangehound"], args].concat()).err()?;
    let is_answer = matches!(refusal.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion);
    (!is_answer).then(|| format!("rangehound {}: {refusal}", args.join(" ")))
}

/// An example that is built beside this binary is run with `--help` after the other flags, which it parses first.
fn refusal_by_example(name: &str, args: &[&str]) -> Option<String> {
    let exists =
        ["fusion", "node", "shared"].iter().any(|member| root().join(format!("{member}/examples/{name}.rs")).exists());
    if !exists {
        return Some(format!("no such example: {name}"));
    }
    if args.is_empty() {
        return None;
    }
    let answer = Command::new(example(name)).args(args).arg("--help").output().unwrap();
    (!answer.status.success()).then(|| format!("{name}: {}", String::from_utf8_lossy(&answer.stderr)))
}

/// The commands of a script as words. Quotes, comments, separators of commands and lines that go on are understood.
fn commands(script: &str) -> impl Iterator<Item = Vec<String>> {
    let mut commands = vec![Vec::new()];
    let mut word = String::new();
    let mut quote = None;
    let script = script.replace("\\\n", " ");
    for line in script.lines() {
        let mut comment = false;
        for c in line.chars().chain(['\n']) {
            let between = c.is_whitespace() || [';', '|', '&'].contains(&c);
            match quote {
                Some(open) if c == open => quote = None,
                Some(_) => word.push(c),
                None if comment => {}
                None if c == '\'' || c == '"' => quote = Some(c),
                None if c == '#' && word.is_empty() => comment = true,
                None if !between => word.push(c),
                None => {
                    if let Some(command) = commands.last_mut().filter(|_| !word.is_empty()) {
                        command.push(std::mem::take(&mut word));
                    }
                    if c != ' ' {
                        commands.push(Vec::new());
                    }
                }
            }
            if c == '\n' && comment {
                commands.push(Vec::new());
            }
        }
    }
    // Redirections belong to the shell.
    commands.into_iter().filter(|command| !command.is_empty()).map(|command| {
        let is_argument = |word: &String| !word.starts_with(['<', '>']);
        command.into_iter().take_while(is_argument).collect()
    })
}

/// A flag must belong to the program, the driver or a command of the Python package.
#[test]
fn flags_that_are_named_exist() {
    let text = |path: &str| std::fs::read_to_string(root().join(path)).unwrap();
    let driver = text("node/examples/serial_range.rs");
    let scripts = PYTHON_COMMANDS.into_iter().map(text).collect::<String>();
    let command = cli::command();
    let of_command = |command: &clap::Command, flag: &str| {
        flag == "help" || command.get_arguments().any(|argument| argument.get_long() == Some(flag))
    };
    let of_any = |flag: &str| {
        command.get_subcommands().any(|command| of_command(command, flag))
            || driver.contains(&format!("    {}: ", flag.replace('-', "_")))
            || scripts.contains(&format!("\"--{flag}\""))
    };
    let mut faults = Vec::new();
    for page in pages() {
        for (line, name) in page.names() {
            let words: Vec<&str> = name.split_whitespace().skip_while(|word| *word == "rangehound").collect();
            let named = words.first().and_then(|first| command.find_subcommand(first));
            if named.is_none() && !name.starts_with("--") {
                continue;
            }
            let flags = words.iter().filter_map(|word| word.strip_prefix("--")?.split(['=', '[']).next());
            let unknown =
                flags.filter(|flag| named.map_or_else(|| !of_any(flag), |command| !of_command(command, flag)));
            faults.extend(unknown.map(|flag| format!("{}: no such flag: --{flag}: {name}", page.at(line))));
        }
    }
    assert_none(faults);
}

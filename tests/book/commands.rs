//! The commands of each page, run in order by a shell. Each page has its own folder with the project's examples, and
//! its own `/dev/shm`, so that the names of its runs are unique.

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

use clap::error::ErrorKind;
use rangehound::cli;

use super::page::{Block, Page, root};
use super::{assert_none, pages};
use crate::support::{Outcome, PROGRAM, Run, skipped};

/// The reason of a block with one command, which the test ends with this signal after some time.
const ENDS_WITH_CTRL_C: &str = "ends only with Ctrl-C";

/// The reason of a block that reads such a file; the test makes one.
const NEEDS_A_CUT_FILE: &str = "needs a file that a kill has cut short";

/// The reason of blocks that call Cargo. Those that only run examples are run with the examples beside the program.
const BUILDS: &str = "builds the program";

/// The reasons that a page may give for a command that the test cannot run as it stands.
const REASONS: [&str; 12] = [
    BUILDS,
    ENDS_WITH_CTRL_C,
    "needs a browser",
    NEEDS_A_CUT_FILE,
    "needs a ROS bag",
    "needs a serial port",
    "needs another machine",
    "needs root",
    "needs packages of Python",
    "needs rangehound-gateway",
    "needs a viewer",
    "needs recordings of real robots",
];

/// The commands of the Python package.
const PYTHON_COMMANDS: [&str; 6] = [
    "python/rangehound/foxglove.py",
    "python/rangehound/mavlink/__main__.py",
    "python/rangehound/rerun.py",
    "python/rangehound/ros2/observer.py",
    "python/rangehound/ros2/robot.py",
    "python/rangehound/ros2/session.py",
];

/// Programs that the pages use and that some machines lack.
const OTHERS: [&str; 2] = ["jq", "python3"];

/// The program's folder, the page's own shared memory, and background jobs, whose failures count too.
const BEFORE: &str = r#"set -euo pipefail
mount -t tmpfs none /dev/shm
mkdir temporary
export TMPDIR=$PWD/temporary
pids=()
started() { pids+=("$1"); }
cargo() {
    local example
    while [ $# -gt 0 ] && [ "$1" != -- ]; do [ "$1" != --example ] || example=$2; shift; done
    "$PROGRAMS/examples/$example" "${@:2}"
}
wait() { local each=("${pids[@]}") pid; pids=(); for pid in "${each[@]}"; do builtin wait "$pid"; done; }
"#;

const AFTER: &str = r#"wait
echo "== the end" >&2
left=$(ls -A /dev/shm temporary/)
[ "$left" = "$(printf '/dev/shm:\n\ntemporary/:')" ] || { echo "left behind: $left" >&2; exit 1; }
"#;

#[test]
fn the_commands_of_the_book_do_what_it_says() {
    let faults = std::thread::scope(|scope| {
        let typed: Vec<_> = pages().into_iter().map(|page| scope.spawn(move || fault(&page))).collect();
        typed.into_iter().filter_map(|page| page.join().unwrap()).collect()
    });
    assert_none(faults);
}

/// The failure of a page's commands, if any.
fn fault(page: &Page) -> Option<String> {
    let mut script = String::new();
    for block in page.commands() {
        let Some(typed) = typed(&block) else { continue };
        let place = page.at(block.line);
        if lacks_a_program(&block) {
            skipped(&place, "a program that it uses is not installed");
        } else {
            script += &format!("echo '== {place}' >&2\n{typed}");
        }
    }
    if script.is_empty() {
        return None;
    }
    let folder = Run::new();
    for name in ["scenarios", "tools"] {
        std::os::unix::fs::symlink(root().join(name), folder.path(name)).unwrap();
    }
    let programs = Path::new(PROGRAM).parent().unwrap().display();
    folder.write("typed.sh", format!("PROGRAMS='{programs}'\nexport PATH=$PROGRAMS:$PATH\n{BEFORE}{script}{AFTER}"));
    // All processes that the commands start end with the namespace.
    let mut args = vec!["--mount", "--pid", "--fork", "--kill-child", "--mount-proc"];
    if !rustix::process::getuid().is_root() {
        args.push("--map-root-user");
    }
    args.extend(["bash", "typed.sh"]);
    let outcome = folder.start_program(Path::new("unshare"), &args).finish();
    let Outcome { code, stdout, stderr } = outcome;
    (code != Some(0)).then(|| format!("{}: exit code {code:?}\n{stdout}\n{stderr}", page.path.display()))
}

/// True if the block uses a program that this machine lacks.
fn lacks_a_program(block: &Block) -> bool {
    let used = |program: &&str| block.text.contains(*program) || block.language == "python" && *program == "python3";
    OTHERS
        .iter()
        .filter(|program| used(program))
        .any(|program| Command::new(program).arg("--version").output().is_err())
}

/// The block as the shell gets it, if it can be run: background jobs are recorded, Python blocks go to Python.
fn typed(block: &Block) -> Option<String> {
    let Block { text, language, not_run, .. } = block;
    match not_run.as_deref() {
        None if language == "python" => Some(format!("python3 - <<'PYTHON'\n{text}PYTHON\n")),
        None => Some(text.replace(" &\n", " & started $!\n").replace(" & ", " & started $!; ")),
        Some(ENDS_WITH_CTRL_C) => Some(format!("timeout --preserve-status --signal=INT 2 {text}")),
        Some(NEEDS_A_CUT_FILE) => Some(format!("{CUT}{text}")),
        Some(BUILDS) => runs_examples_only(text).then(|| text.clone()),
        Some(_) => None,
    }
}

/// Leaves of the page's recording what a kill does.
const CUT: &str = r"head -c 400000 runs/recorded/run.mcap > runs/recorded/run.mcap.partial
rm runs/recorded/run.mcap
";

/// True if all that Cargo is called for are examples that need nothing but the program.
fn runs_examples_only(script: &str) -> bool {
    let this = std::env::current_exe().unwrap();
    let examples = this.ancestors().nth(2).unwrap().join("examples");
    commands(script).filter(|words| words[0] == "cargo").all(|words| {
        let example = words.iter().skip_while(|word| *word != "--example").nth(1);
        example.is_some_and(|name| examples.join(name).exists() && !script.contains("mkfifo"))
    })
}

#[test]
fn skipped_commands_have_a_reason_and_parse() {
    let mut faults = Vec::new();
    let mut reasons = BTreeSet::new();
    for page in pages() {
        for block in page.commands() {
            let Some(reason) = &block.not_run else { continue };
            if !REASONS.contains(&reason.as_str()) {
                faults.push(format!("{}: not one of the reasons: {reason}", page.at(block.line)));
            }
            reasons.insert(reason.clone());
            let refused = commands(&block.text).filter_map(|words| refusal(&words));
            faults.extend(refused.map(|refusal| format!("{}: {refusal}", page.at(block.line))));
        }
    }
    let unused = REASONS.into_iter().filter(|reason| !reasons.contains(*reason));
    faults.extend(unused.map(|reason| format!("no block has the reason: {reason}")));
    assert_none(faults);
}

/// Why the project's program refuses a command, if it does.
fn refusal(words: &[String]) -> Option<String> {
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    match words[..] {
        ["rangehound", ref args @ ..] => refusal_by_program(args),
        ["cargo", "run", ref args @ ..] => {
            let (of_cargo, args) = args.split_at(args.iter().position(|arg| *arg == "--").unwrap_or(args.len()));
            let args = args.get(1..).unwrap_or_default();
            match of_cargo.iter().position(|arg| *arg == "--example") {
                None => refusal_by_program(args),
                Some(place) => refusal_by_example(of_cargo[place + 1], args),
            }
        }
        _ => None,
    }
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
    let this = std::env::current_exe().unwrap();
    let example = this.ancestors().nth(2).unwrap().join("examples").join(name);
    if args.is_empty() || !example.exists() {
        return None;
    }
    let answer = Command::new(example).args(args).arg("--help").output().unwrap();
    (!answer.status.success()).then(|| format!("{name}: {}", String::from_utf8_lossy(&answer.stderr)))
}

/// The commands of a script as words. Quotes, comments and separators of commands are understood.
fn commands(script: &str) -> impl Iterator<Item = Vec<String>> {
    let mut commands = vec![Vec::new()];
    let mut word = String::new();
    let mut quote = None;
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

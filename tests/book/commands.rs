//! The commands of each page, run in order by a shell. Each page has its own folder with the project's examples, and
//! its own `/dev/shm`, so that the names of its runs are unique.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use super::page::{Block, Mark, Page, root};
use super::provided::{PROVIDED, Provided};
use super::{assert_none, pages};
use crate::support::{Outcome, PROGRAM, Run, skipped};

/// Far above the time of any page: all run at once.
const LIMIT: Duration = Duration::from_secs(400);

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
    local command=$1 example=
    while [ $# -gt 0 ] && [ "$1" != -- ]; do [ "$1" != --example ] || example=$2; shift; done
    case $command in
    run)
        if [ -n "$example" ]; then
            "$PROGRAMS/examples/$example" "${@:2}"
        else
            # The experiment in real time: what follows need not wait for it.
            rangehound "${@:2}" & started $!
        fi ;;
    # This is one of them.
    test) ;;
    *) echo "cargo $command: mark the block" >&2; return 1 ;;
    esac
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
    let folder = Run::new();
    let (mut script, mut checks) = (String::new(), Vec::new());
    for block in page.commands() {
        let place = page.at(block.line);
        let is_run_here = matches!(block.mark, None | Some(Mark::With(_)));
        if is_run_here && lacks_a_program(&block) {
            skipped(&place, "a program that it uses is not installed");
            continue;
        }
        let provided = match &block.mark {
            None => Provided { script: block.text.clone(), check: Box::new(|_| {}) },
            Some(Mark::With(what)) => match PROVIDED.iter().find(|(known, _)| known == what) {
                Some((_, provide)) => provide(page, &block, &folder),
                None => continue,
            },
            Some(_) => continue,
        };
        script += &format!("echo '== {place}' >&2\n{}", typed(&block, &provided.script));
        checks.push(provided.check);
    }
    if script.is_empty() {
        return None;
    }
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
    let began = Instant::now();
    let outcome = folder.start_program(Path::new("unshare"), &args).finish_within(LIMIT);
    println!("{}: {:.0} s", page.path.display(), began.elapsed().as_secs_f64());
    let Outcome { code, stdout, stderr } = outcome;
    if code != Some(0) {
        return Some(format!("{}: exit code {code:?}\n{stdout}\n{stderr}", page.path.display()));
    }
    checks.into_iter().for_each(|check| check(&folder));
    None
}

/// True if the block uses a program that this machine lacks.
fn lacks_a_program(block: &Block) -> bool {
    let used = |program: &&str| block.text.contains(*program) || block.language == "python" && *program == "python3";
    OTHERS
        .iter()
        .filter(|program| used(program))
        .any(|program| Command::new(program).arg("--version").output().is_err())
}

/// The block as the shell gets it: background jobs are recorded, Python blocks go to Python.
fn typed(block: &Block, script: &str) -> String {
    if block.language == "python" {
        return format!("python3 - <<'PYTHON'\n{script}PYTHON\n");
    }
    script.replace(" &\n", " & started $!\n").replace(" & ", " & started $!; ")
}

/// An example of a member, which is built with the tests.
pub(super) fn example(name: &str) -> PathBuf {
    let this = std::env::current_exe().unwrap();
    let example = this.ancestors().nth(2).unwrap().join("examples").join(name);
    assert!(example.exists(), "`cargo test --release` builds {}", example.display());
    example
}

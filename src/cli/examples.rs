//! What `--help` and the manual add to each command: examples, in lines of 80 columns.

use clap::Command;

/// Below the list of commands.
pub(super) const ALL: &str = "Examples:
  rangehound                            the paper's experiment, in real time
  rangehound run --clock lockstep --robots 10
                                        ten robots, as fast as the processes can
  rangehound scenario > mine.toml       a scenario file to start from
  rangehound run mine.toml              and a run of it
  rangehound track ranges.csv --range-std 0.12
                                        recorded ranges, the same processes
  rangehound compare --robots 5         all planners on the same 1000 targets
  rangehound kill robot-1               what happens if a robot dies?
  rangehound status --watch             see who is there, from another terminal

Each command has its own --help, with examples; `rangehound man` is the manual.
Output is coloured on a terminal that can, unless NO_COLOR is set.

Exit codes: 0 done, 1 failed while running or ended by Ctrl-C, 2 bad usage or
bad input.";

/// Below each command's flags.
const EACH: [(&str, &str); 23] = [
    ("run", RUN),
    ("sim", SIM),
    ("fusion", FUSION),
    ("robot", ROBOT),
    ("watch", WATCH),
    ("plan", PLAN),
    ("record", RECORD),
    ("replay", REPLAY),
    ("live", LIVE),
    ("resume", RESUME),
    ("status", STATUS),
    ("kill", KILL),
    ("restart", RESTART),
    ("stop", STOP),
    ("chaos", CHAOS),
    ("explore", EXPLORE),
    ("latency", LATENCY),
    ("scenario", SCENARIO),
    ("track", TRACK),
    ("compare", COMPARE),
    ("calibrate", CALIBRATE),
    ("completions", COMPLETIONS),
    ("man", MAN),
];

/// Adds to each command its examples.
pub(super) fn add(command: Command) -> Command {
    let with = |command: Command, (name, text): (&'static str, &'static str)| {
        command.mut_subcommand(name, |subcommand| subcommand.after_help(text))
    };
    EACH.into_iter().fold(command, with)
}

const RUN: &str = "What no flag says is the scenario file's to say; what that does not say has a
default. `rangehound scenario` prints a file with every key explained.

Examples:
  rangehound run                                 the paper's experiment
  rangehound run mine.toml --seed 7              a scenario of your own
  rangehound run --clock lockstep --ticks 5000   as fast as the processes can
  rangehound run --robots 10 --pin one-core      all processes on one processor
  rangehound run --in-process --json | jq .position_rmse_m";

const SIM: &str = "Examples, each in a terminal of its own, in any order:
  rangehound sim scenarios/paper.toml --name demo
  rangehound fusion --name demo
  rangehound robot --id 0 --name demo            and --id 1, --id 2
  rangehound watch --name demo";

const FUSION: &str = "Examples:
  rangehound fusion --name demo
  rangehound fusion --name demo --standby        takes over when that one dies";

const ROBOT: &str = "Example:
  rangehound robot --id 2 --name demo            the third robot of run demo";

const WATCH: &str = "Examples:
  rangehound watch --name demo
  rangehound watch --name demo --json > demo.json";

const RECORD: &str = "Examples:
  rangehound record --name demo                  a run started by hand
  rangehound record runs/paper                   one that is over

Foxglove, Rerun and any reader of MCAP files open what it writes.";

const REPLAY: &str = "Examples:
  rangehound replay runs/paper/run.mcap          the same estimates, to the bit?
  rangehound replay runs/paper/run.mcap --planner greedy
  rangehound replay runs/paper/run.mcap --gate 3
  rangehound replay runs/paper/run.mcap --live --speed 5
  rangehound replay run.mcap.partial --repair    what a kill has left

It ends with 1 if an estimate differs that should not.";

const LIVE: &str = "Example:
  rangehound live --name demo                    prints the address of its page

Only who knows the token in the address may look or act, from this machine.";

const PLAN: &str = "A line holds the predicted position covariance (m^2), the predicted target (m),
the time that robots move before they measure, and the team, all in one line:

  {\"prior_position_covariance\":[[4,0.5],[0.5,2]],\"target\":[0,0],
   \"time_step_s\":0.1,\"robots\":[
   {\"position\":[20,0],\"max_speed\":10,\"range_std\":1},
   {\"position\":[0,15],\"max_speed\":10,\"range_std\":1}]}

It may add stand_off_m, stand_off_sigma, separation_m (clearances, 0 if absent)
and planner (a name). Its answer is one line, in the same order:

  {\"planner\":..,\"headings_rad\":[..],\"speeds_mps\":[..],\"objective\":..,
   \"lower_bound\":..,\"certified\":..,\"position_trace_m2\":..,\"plan_us\":..}

objective is |S|, no headings reach less than lower_bound; certified: none are
better but for rounding. A line that makes no sense is answered by
{\"line\":N,\"error\":\"..\"}, told on standard error too, and the next one is read;
the exit code is then 2. Lines count from 1, blank ones are skipped. Answers
come at once when no more input is there.

Examples:
  rangehound plan problems.jsonl > answers.jsonl
  rangehound plan --planner adaptive < problems.jsonl";

const RESUME: &str = "Example, after a kill of everything:
  rangehound resume runs/demo --name demo";

const STATUS: &str = "A node is running, stopped (by a signal), hung (no heartbeat for a second)
or gone. Who is not running comes first; more than 16 robots in one state share
a line, unless --all. --json always has all. A run is finishing while it ends
and its recording is written.

Examples:
  rangehound status
  rangehound status --watch                      again every second
  rangehound status --json | jq '.nodes[] | select(.state != \"running\")'";

const KILL: &str = "Examples:
  rangehound kill robot-1
  rangehound kill fusion --name demo";

const RESTART: &str = "Example:
  rangehound restart robot-1                     its successor is a new process";

const STOP: &str = "Example:
  rangehound stop --name demo                    its report is still written";

const CHAOS: &str = "It starts runs of its own, one after the other, until all faults are in. A
broken promise is exit code 1, and is named.

Examples:
  rangehound chaos --faults 200
  rangehound chaos --kinds kill,stop --roles sim,fusion --rate 2
  rangehound chaos --clock realtime --faults 50 --chaos-seed 7
  rangehound chaos --standby 1 --roles fusion,standby --kinds kill";

const EXPLORE: &str = "Simulator, fusion, standbys and robots run in this one process on simulated
time, with faults, a network and clocks that are drawn from the seed. A broken
promise is exit code 1; it is shown with the fewest faults that break it.

Examples:
  rangehound explore --seed 1 --seeds 20000
  rangehound explore --seed 7 --seeds 1 --story    what each node did, by time";

const LATENCY: &str = "It runs the whole system (simulator, fusion with filter, planner and
checkpoints, robots) and, in turns, the bare exchange of the same messages over
raw iceoryx2 and over futexes, on this machine, now; a ratio below 1 means that
the system was faster than that reference.

Examples:
  rangehound latency --robots 10 --pin one-core  software alone, one processor
  rangehound latency --robots 10 --rate 100      in real time, mostly asleep";

const SCENARIO: &str = "Example:
  rangehound scenario > mine.toml
  rangehound run mine.toml";

const TRACK: &str = "Examples:
  rangehound track ranges.csv --range-std 0.12
  rangehound track ranges.csv --range-bias 0.18 --range-bias 105=0.15
  rangehound track ranges.csv --truth truth.csv --json | jq .position_rmse_m";

const COMPARE: &str = "Examples:
  rangehound compare                             six planners, 1000 runs of each
  rangehound compare --planners certified,grid --runs 50
  rangehound compare mine.toml --robots 5 --stand-off 0";

const CALIBRATE: &str = "Without --truth the ranges must tell by themselves: three sensors or more that
are not on one line, and a target that moves. What they cannot tell is named and
not used; if that is everything, no file is written and the exit code is 1.

Examples:
  rangehound calibrate ranges.csv
  rangehound track ranges.csv --calibration runs/calibrate/calibration.toml
  rangehound calibrate ranges.csv --truth truth.csv --out truth-calibration";

const COMPLETIONS: &str = "Examples, for bash, zsh and fish:
  source <(rangehound completions bash)          in ~/.bashrc
  rangehound completions zsh > ~/.zfunc/_rangehound
                                                 with ~/.zfunc in fpath
  rangehound completions fish > ~/.config/fish/completions/rangehound.fish";

const MAN: &str = "Examples:
  rangehound man | man -l -
  rangehound man ~/.local/share/man/man1         then: man rangehound-run";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terminal::WIDTH;

    /// Longer ones would be broken anywhere.
    #[test]
    fn lines_fit_as_they_are_written() {
        for text in EACH.iter().map(|(_, text)| text).chain([&ALL]) {
            for line in text.lines() {
                assert!(line.len() <= WIDTH, "{line}");
            }
        }
    }
}

//! The examples that `--help` and the manual add to each command, in lines of at most 80 columns.

use clap::Command;

/// Below the list of commands.
pub(super) const ALL: &str = "Examples:
  rangehound                            the paper's experiment, in real time
  rangehound run --clock lockstep --robots 10
                                        ten robots, as fast as the processes can
  rangehound scenario > mine.toml       a scenario file to start from
  rangehound run mine.toml              and a run of it
  rangehound track ranges.csv --range-std 0.12
                                        track a target from recorded ranges
  rangehound compare --robots 5         six planners on the same 1000 targets
  rangehound kill robot-1               kill a robot of a run, as a crash would
  rangehound status --watch             show its processes, in another terminal

Each command has its own --help with examples. `rangehound man` prints the
manual. Output has colours on a terminal, unless NO_COLOR is set.

Exit codes: 0 done, 1 failed while running or ended by Ctrl-C, 2 bad usage or
bad input.";

/// Below each command's flags.
const EACH: [(&str, &str); 25] = [
    ("run", RUN),
    ("sim", SIM),
    ("fusion", FUSION),
    ("robot", ROBOT),
    ("gateway", GATEWAY),
    ("keys", KEYS),
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

/// Adds its examples to each command.
pub(super) fn add(command: Command) -> Command {
    let with = |command: Command, (name, text): (&'static str, &'static str)| {
        command.mut_subcommand(name, |subcommand| subcommand.after_help(text))
    };
    EACH.into_iter().fold(command, with)
}

const RUN: &str = "Flags override the scenario file; keys that the file does not have get defaults.
`rangehound scenario` prints a file that explains every key.

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
  rangehound fusion --name demo --standby        takes over if the first dies";

const ROBOT: &str = "Examples:
  rangehound robot --id 2 --name demo            the third robot of run demo
  rangehound robot --id 2 --connect station:7400 --keys keys
                                        the same from another host";

const GATEWAY: &str = "Example:
  rangehound gateway --name demo --listen 192.168.1.10:7400 --keys keys/station
                                        robots on other hosts join the run demo
`rangehound run --listen` starts a gateway with the run.";

const KEYS: &str = "Examples:
  rangehound keys --gateway station --host alice=0,1 --host bob=2-5
                                        keys for the run's host and two others
  rangehound keys --host carol=6        and for one more host, later
Copy the folder of each host to it; the folder keys/authority stays here.";

const WATCH: &str = "Examples:
  rangehound watch --name demo
  rangehound watch --name demo --json > demo.json";

const RECORD: &str = "Examples:
  rangehound record --name demo                  a run started by hand
  rangehound record runs/paper                   a run that is over
  rangehound record runs/paper --ros2 paper-bag  as a ROS 2 bag

Foxglove, Rerun and other readers of MCAP files open the recording.";

const REPLAY: &str = "Examples:
  rangehound replay runs/paper/run.mcap          the same estimates, to the bit?
  rangehound replay runs/paper/run.mcap --planner greedy
  rangehound replay runs/paper/run.mcap --gate 3
  rangehound replay runs/paper/run.mcap --live --speed 5
  rangehound replay run.mcap.partial --repair    a file that was cut short

Without changed settings the estimates must be bit-identical: if one differs,
the exit code is 1.";

const LIVE: &str = "Example:
  rangehound live --name demo                    prints the address of its page

The page works on this machine only, and only with the token in its address.";

const PLAN: &str = "Each input line is one problem: the covariance of the predicted position (m^2),
the predicted position of the target (m), the time that robots move before they
measure (s), and the team. Written in one line:

  {\"prior_position_covariance\":[[4,0.5],[0.5,2]],\"target\":[0,0],
   \"time_step_s\":0.1,\"robots\":[
   {\"position\":[20,0],\"max_speed\":10,\"range_std\":1},
   {\"position\":[0,15],\"max_speed\":10,\"range_std\":1}]}

Optional keys: stand_off_m, stand_off_sigma and separation_m (clearances, 0 if
absent), planner (a name), criterion (trace, eigenvalue or determinant).
Optional keys of a robot: bearing_std_rad (beside range_std or instead of it),
range_std_per_m, max_range_m, field_of_view_rad, position_covariance (m^2) and
heading_std_rad. The answers are lines in the same order:

  {\"planner\":..,\"headings_rad\":[..],\"speeds_mps\":[..],\"objective\":..,
   \"lower_bound\":..,\"certified\":..,\"position_trace_m2\":..,
   \"lower_bound_trace_m2\":..,\"plan_us\":..}

objective is |S|, or the criterion's value if a robot measures more than ranges
of constant noise. No headings reach less than lower_bound. certified means
that no headings are better, up to rounding. The answer to an invalid line is
{\"line\":N,\"error\":\"..\"}. The error is also printed to standard error, the next
lines are still answered, and the exit code is 2. Lines count from 1; blank
lines are skipped. The program answers before it waits for more input.

Examples:
  rangehound plan problems.jsonl > answers.jsonl
  rangehound plan --planner adaptive < problems.jsonl";

const RESUME: &str = "Example, after all processes of the run were killed:
  rangehound resume runs/demo --name demo";

const STATUS: &str = "A node is running, stopped (by a signal), hung (no heartbeat for a second),
gone, or elsewhere (in another PID namespace). Nodes that do not run come first.
More than 16 robots in the same state share a line; --all and --json list each.
A run is finishing while its nodes end and its recording is written.

Examples:
  rangehound status
  rangehound status --watch                      again every second
  rangehound status --json | jq '.nodes[] | select(.state != \"running\")'";

const KILL: &str = "Examples:
  rangehound kill robot-1
  rangehound kill fusion --name demo";

const RESTART: &str = "Example:
  rangehound restart robot-1                     a new process takes its place";

const STOP: &str = "Example:
  rangehound stop --name demo                    its report is still written";

const CHAOS: &str = "It starts runs of its own, one after the other, until all faults are injected.
If a run breaks a promise, it names the promise and exits with 1.

Examples:
  rangehound chaos --faults 200
  rangehound chaos --kinds kill,stop --roles sim,fusion --rate 2
  rangehound chaos --clock realtime --faults 50 --chaos-seed 7
  rangehound chaos --standby 1 --roles fusion,standby --kinds kill
  rangehound chaos --hosts 3 --loss 0.05   several hosts; needs root";

const EXPLORE: &str = "A whole team (simulator, fusion, standbys, robots) runs in this process on
simulated time. Its faults, network delays and clocks are drawn from the seed:
nodes are stopped, killed between two actions with a checkpoint half written,
fail by themselves or start late, the supervisor is stopped, starts are refused,
the team is cut in two, and messages are lost, delayed, doubled, reordered or
garbled. If the team breaks a promise, the smallest set of faults that breaks it
is printed, and the exit code is 1.

Examples:
  rangehound explore --seed 1 --seeds 20000
  rangehound explore --seed 39 --seeds 1 --trace   prints what each node did";

const LATENCY: &str = "It measures the whole system (simulator, fusion with filter, planner and
checkpoints, robots) and two references that only exchange messages, over
iceoryx2 and over futexes. They take turns on this machine. A ratio below 1
means that the system was faster than the reference.

Examples:
  rangehound latency --robots 10 --pin one-core  all processes on one processor
  rangehound latency --robots 10 --rate 100      in real time, at 100 Hz
  rangehound latency --hosts 2 --rate 100        on several hosts; needs root";

const SCENARIO: &str = "Example:
  rangehound scenario > mine.toml
  rangehound run mine.toml";

const TRACK: &str = "Examples:
  rangehound track ranges.csv --range-std 0.12
  rangehound track bag --topic /uwb/range --anchors anchors.csv
                                                 a ROS 2 bag
  rangehound track ranges.csv --range-bias 0.18 --range-bias 105=0.15
  rangehound track ranges.csv --truth truth.csv --json | jq .position_rmse_m";

const COMPARE: &str = "Examples:
  rangehound compare                             six planners, 1000 runs of each
  rangehound compare --planners certified,grid --runs 50
  rangehound compare mine.toml --robots 5 --stand-off 0";

const CALIBRATE: &str = "Without --truth it needs three or more sensors that are not on one line, and a
moving target. Values that the ranges do not determine are named and left out.
If none is determined, no file is written and the exit code is 1.

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

    /// clap would break longer lines at any place.
    #[test]
    fn lines_fit_as_they_are_written() {
        for text in EACH.iter().map(|(_, text)| text).chain([&ALL]) {
            for line in text.lines() {
                assert!(line.len() <= WIDTH, "{line}");
            }
        }
    }
}

//! Missing resources of the system: one clear line, nothing left behind, and the tracking goes on if possible.

use std::ffi::OsStr;
use std::io::Write;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{PermissionsExt, chown};
use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use rustix::process::Signal;

use crate::support::{Outcome, Run, signal, skipped};

const ENDLESS: &str = "run --clock lockstep --ticks 100000000 --timeout forever";

/// Refused with this exit code, and one complaint with all of these names.
#[track_caller]
fn assert_refused(outcome: &Outcome, code: i32, names: &[&str]) {
    assert_eq!(outcome.code, Some(code), "{outcome:#?}");
    let complaints = outcome.complaints();
    assert!(complaints.len() == 1 && names.iter().all(|name| complaints[0].contains(name)), "{outcome:#?}");
    assert!(!outcome.stderr.contains("panicked"), "{outcome:#?}");
}

#[track_caller]
fn assert_nothing_made(run: &Run) {
    assert!(!run.path("out").exists() && !run.shared_folder().exists());
}

/// True if this user may mount; otherwise reports that the test is skipped.
fn may_mount() -> bool {
    let probe = Command::new("unshare").args(["-m", "mount", "-t", "tmpfs", "none", "/mnt"]).output();
    let may = probe.is_ok_and(|output| output.status.success());
    if !may {
        skipped("what needs mounts of its own", "this user may not mount");
    }
    may
}

/// A script with these mounts in its own mount namespace.
fn mounted(mounts: &str) -> String {
    format!("exec unshare -m sh -c '{mounts} && exec \"$@\"' sh \"$@\"")
}

/// The same; afterwards the output of `list` goes to standard error, each line after `listed: `.
fn mounted_and_listed(mounts: &str, list: &str) -> String {
    let listed = format!("code=$?; ({list}) 2>&1 | sed \"s/^/listed: /\" >&2; exit $code");
    format!("exec unshare -m sh -c '{mounts} && \"$@\"; {listed}' sh \"$@\"")
}

#[test]
fn too_few_open_files_are_reported_before_anything_is_made() {
    for (files, robots) in [(32, 3), (64, 3), (300, 128)] {
        let run = Run::new();
        let outcome = run.command_by(&format!("ulimit -n {files} && exec \"$@\""), &format!("run --robots {robots}"));
        let limit = format!("the limit is {files}");
        assert_refused(&outcome.finish(), 2, &["open files", &limit, "ulimit -n"]);
        assert_nothing_made(&run);
    }
}

#[test]
fn a_low_limit_of_open_files_that_may_be_raised_is_raised() {
    let run = Run::new();
    let words = "run --clock lockstep --robots 16 --ticks 5";
    run.command_by("ulimit -S -n 64 && exec \"$@\"", words).finish().succeeded();
    assert_eq!(run.report()["ranges"]["fused"], 16 * 5);
    run.assert_nothing_left();
}

#[test]
fn a_folder_that_cannot_be_made_is_refused_before_anything_is_made() {
    for words in ["run", "run --in-process", "sim", "track r.csv", "chaos"] {
        let run = Run::new();
        run.write("r.csv", "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m\n0,1,0,0,5\n0,2,9,0,5\n");
        let mut args: Vec<&str> = words.split_whitespace().collect();
        args.extend(["--name", &run.name, "--out", "r.csv/out"]);
        assert_refused(&run.start(&args).finish(), 2, &["--out", "r.csv/out"]);
        assert!(!run.shared_folder().exists());
    }
}

#[test]
fn full_standard_output_is_reported() {
    let run = Run::new();
    for words in ["scenario", "--help", "--version"] {
        assert_refused(&run.start_by("exec \"$@\" > /dev/full", &[words]).finish(), 1, &["standard output"]);
    }
    let outcome = run.command_by("exec \"$@\" > /dev/full", "run --in-process --clock lockstep --ticks 5").finish();
    assert_refused(&outcome, 1, &["standard output"]);
    assert_eq!(run.report()["ticks"], 5);
    let silent = run.start_by("exec \"$@\" 2> /dev/full", &["run", "--robots", "0"]).finish();
    assert_eq!(silent.code, Some(2));
}

#[test]
fn with_a_full_disk_the_tracking_goes_on_and_the_user_is_warned() {
    if !may_mount() {
        return;
    }
    let run = Run::new();
    std::fs::create_dir(run.path("out")).unwrap();
    let script = mounted_and_listed("mount -t tmpfs -o size=400k none out", "find out -maxdepth 1 -size 0");
    let words = "run --clock lockstep --ticks 300000 --timeout forever";
    let outcome = run.command_by(&script, words).finish();
    assert_refused(&outcome, 1, &["out", "No space left on device"]);
    // A file without space is not created, instead of left empty.
    assert!(!outcome.stderr.contains("listed: "), "{outcome:#?}");
    for file in ["estimate.ticks", "world.ticks"] {
        let is_reported =
            outcome.stderr.lines().any(|line| line.contains(file) && line.contains("the run continues, but"));
        assert!(is_reported, "{file}: {outcome:#?}");
    }
    // It wrote the report of the ticks it had, and no node was started again: all went on to the end.
    assert!(outcome.stdout.contains("digest") && !outcome.stdout.contains("starts,"), "{outcome:#?}");
    run.assert_nothing_left();
}

#[test]
fn a_repair_without_disk_space_keeps_the_damaged_file() {
    if !may_mount() {
        return;
    }
    let run = Run::new();
    run.lockstep("--record --in-process --ticks 2000").finish().succeeded();
    let complete = std::fs::read(run.path("out/run.mcap")).unwrap();
    run.write("cut", &complete[..complete.len() * 3 / 4]);
    std::fs::create_dir(run.path("full")).unwrap();
    let kb = complete.len() / 1_024;
    // Room for the cut file and a part of the repaired one; then no room.
    for (room, code) in [(kb, 1), (kb * 3 / 4 + 8, 2)] {
        let mount = format!("mount -t tmpfs -o size={room}k none full && cp cut full/run.mcap.partial");
        let fill = if code == 2 { " && cat /dev/zero > full/filler 2>/dev/null; true" } else { "" };
        let script = mounted_and_listed(&format!("{mount}{fill}"), "cd full && ls run* && cmp run.mcap.partial ../cut");
        let outcome = run.start_by(&script, &["replay", "full/run.mcap.partial", "--repair"]).finish();
        assert_refused(&outcome, code, &["full/run.mcap", "No space left on device"]);
        let listed: Vec<&str> = outcome.stderr.lines().filter(|line| line.starts_with("listed: ")).collect();
        assert_eq!(listed, ["listed: run.mcap.partial"], "{outcome:#?}");
    }
}

#[test]
fn a_disk_that_is_full_from_the_start_is_refused() {
    if !may_mount() {
        return;
    }
    let run = Run::new();
    std::fs::create_dir(run.path("out")).unwrap();
    let outcome = run.command_by(&mounted("mount -t tmpfs -o size=4k none out"), "run").finish();
    assert_refused(&outcome, 2, &["--out", "No space left on device"]);
    assert!(!run.shared_folder().exists());
}

#[test]
fn without_its_folder_a_run_goes_on_until_it_would_need_it() {
    let run = Run::new();
    let supervisor = run.command(ENDLESS);
    run.wait_for_ticks(100);
    std::fs::remove_dir_all(run.path("out")).unwrap();
    for file in ["estimate.ticks", "world.ticks", "sim.checkpoint", "fusion.checkpoint"] {
        run.wait_until(&format!("the loss of {file} is reported"), || {
            supervisor.stderr().lines().any(|line| line.contains(file) && line.contains("the run continues, but"))
        });
    }
    signal(run.pid_of("robot-1", 1), Signal::KILL);
    run.pid_of("robot-1", 2);
    // A new fusion would not know the ticks so far: it must not start from the prior.
    signal(run.pid_of("fusion", 1), Signal::KILL);
    let outcome = supervisor.finish();
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    let [of_fusion, of_supervisor] = outcome.complaints()[..] else { panic!("{outcome:#?}") };
    assert!(of_fusion.contains("fusion of run") && of_fusion.contains("saved no state"), "{outcome:#?}");
    assert!(of_supervisor.contains("fusion exited with code 2"), "{outcome:#?}");
    run.assert_nothing_left();
}

#[test]
fn shared_memory_that_is_too_small_or_missing_is_reported() {
    if !may_mount() {
        return;
    }
    let run = Run::new();
    for (mounts, words, names) in [
        ("mount -t tmpfs -o size=200k none /dev/shm", "run", ["/dev/shm", "kB free"]),
        ("mount -t tmpfs -o size=4m none /dev/shm", "run --robots 128", ["/dev/shm", "128 robots"]),
        ("mount -t tmpfs -o nr_inodes=20 none /dev/shm", "run", ["/dev/shm", "files free"]),
        ("mount -t tmpfs none /dev", "run", ["/dev/shm", "No such file"]),
    ] {
        let outcome = run.command_by(&mounted(mounts), words).finish();
        assert_refused(&outcome, 2, &names);
        assert!(!run.path("out").exists());
    }
    let outcome = run.start_by(&mounted("mount -t tmpfs none /dev"), &["fusion", "--name", &run.name]).finish();
    assert_refused(&outcome, 2, &["/dev/shm", "No such file"]);
}

#[test]
fn shared_memory_that_fills_up_ends_a_run_that_must_start_a_node_with_the_cause() {
    if !may_mount() {
        return;
    }
    let run = Run::new();
    // Files of the namespace are visible from outside through /proc.
    let supervisor = run.command_by(&mounted("mount -t tmpfs -o size=2m none /dev/shm"), ENDLESS);
    run.wait_for_ticks(100);
    let shared_memory = format!("/proc/{}/root/dev/shm", supervisor.pid().as_raw_pid());
    let mut fill = std::fs::File::create(Path::new(&shared_memory).join("fill")).unwrap();
    assert!(fill.write_all(&vec![1; 4 << 20]).is_err(), "it was to be filled");
    let role = Path::new(&shared_memory).join(run.shared_folder().file_name().unwrap()).join("robot-1.role");
    let text = std::fs::read_to_string(role).unwrap();
    let pid = text.trim().split_once(' ').unwrap().1.parse().unwrap();
    signal(rustix::process::Pid::from_raw(pid).unwrap(), Signal::KILL);
    // Cleanup after the dead node would free memory, so another thread keeps filling it.
    let is_over = AtomicBool::new(false);
    let outcome = std::thread::scope(|scope| {
        scope.spawn(|| {
            // With a limit, in case the other thread fails.
            let began = Instant::now();
            while !is_over.load(Ordering::Relaxed) && began.elapsed() < Duration::from_secs(150) {
                while fill.write(&[1; 1 << 12]).is_ok_and(|written| written > 0) {}
                std::thread::yield_now();
            }
        });
        let outcome = supervisor.finish();
        is_over.store(true, Ordering::Relaxed);
        outcome
    });
    assert_refused(&outcome, 1, &["/dev/shm"]);
}

/// A user without other processes.
const NOBODY: u32 = 61_234;

/// A run whose folder belongs to [`NOBODY`]; `None` if this process may not change its user.
fn run_of_nobody() -> Option<Run> {
    if !rustix::process::getuid().is_root() {
        println!("skipped: only root may become another user");
        return None;
    }
    let run = Run::new();
    let folder = run.path("");
    std::fs::set_permissions(&folder, std::fs::Permissions::from_mode(0o777)).unwrap();
    chown(&folder, Some(NOBODY), Some(NOBODY)).unwrap();
    Some(run)
}

fn as_nobody(limit: &str) -> String {
    format!("exec setpriv --reuid {NOBODY} --regid {NOBODY} --clear-groups prlimit {limit} -- \"$@\"")
}

#[test]
fn a_limit_of_processes_is_reported_by_name_and_number() {
    let Some(run) = run_of_nobody() else { return };
    let refused = run.command_by(&as_nobody("--nproc=4"), "run").finish();
    assert_refused(&refused, 1, &["cannot start", "may have 4 processes", "ulimit -u"]);
    assert!(!Path::new("/dev/shm").join(format!("rh-{NOBODY}-{}", run.name)).exists());
    let refused = run.command_by(&as_nobody("--nproc=1"), "run --live").finish();
    assert_refused(&refused, 1, &["cannot start", "may have 1 processes", "ulimit -u"]);
}

#[test]
fn a_path_that_is_not_utf_8_is_refused_by_name_before_anything_is_made() {
    let run = Run::new();
    let strange = run.path("").join(OsStr::from_bytes(b"a\xff"));
    std::fs::create_dir(&strange).unwrap();
    run.write("r.csv", "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m\n0,1,0,0,5\n0,2,9,0,5\n");
    std::fs::copy(run.path("r.csv"), strange.join("r.csv")).unwrap();
    std::fs::write(strange.join("replay.toml"), "[recording]\nranges = \"r.csv\"\n").unwrap();
    let here = "exec \"$@\" --name ";
    for (script, words) in [
        ("--out \"$(printf 'a\\377/out')\"", "run"),
        ("--out \"$(printf 'a\\377')\"", "run --in-process"),
        ("--out \"$(printf 'a\\377')\"", "sim"),
        ("--out \"$(printf 'a\\377')\"", "track r.csv"),
        ("--out \"$(printf 'a\\377')\"", "chaos --faults 1"),
        ("--out \"$(printf 'a\\377')\"", "latency --ticks 100"),
        ("--out out \"$(printf 'a\\377/r.csv')\"", "track"),
        ("\"$(printf 'a\\377')\"", "resume"),
    ] {
        let args: Vec<&str> = words.split(' ').collect();
        let outcome = run.start_by(&format!("{here}{} {script}", run.name), &args).finish();
        // A folder without a run is refused for that reason.
        let names: &[&str] = if words == "resume" { &["a"] } else { &["UTF-8", "a\\xFF"] };
        assert_refused(&outcome, 2, names);
        assert_nothing_made(&run);
        assert_eq!(std::fs::read_dir(&strange).unwrap().count(), 2, "{words}");
    }
    // The working folder.
    let in_it = format!("cd \"$(printf 'a\\377')\" && exec \"$@\" --name {}", run.name);
    for words in ["run", "sim", "track r.csv"] {
        let args: Vec<&str> = words.split(' ').collect();
        assert_refused(&run.start_by(&in_it, &args).finish(), 2, &["UTF-8", "a\\xFF"]);
        assert_nothing_made(&run);
    }
}

#[test]
fn files_in_place_of_the_shared_folder_are_reported_or_repaired() {
    let run = Run::new();
    let shared = run.shared_folder();
    std::fs::write(&shared, "mine").unwrap();
    let refused = run.command("run --ticks 5").finish();
    assert_refused(&refused, 2, &[shared.to_str().unwrap(), "is not a folder"]);
    assert_eq!(std::fs::read(&shared).unwrap(), b"mine");
    std::fs::remove_file(&shared).unwrap();

    // A link to a folder of the user; its files are not leftovers of a run.
    std::fs::create_dir(run.path("mine")).unwrap();
    run.write("mine/thesis.txt", "mine");
    std::os::unix::fs::symlink(run.path("mine"), &shared).unwrap();
    let refused = run.command("run --ticks 5").finish();
    assert_refused(&refused, 2, &[shared.to_str().unwrap(), "is not a folder"]);
    assert_eq!(std::fs::read(run.path("mine/thesis.txt")).unwrap(), b"mine");
    std::fs::remove_file(&shared).unwrap();

    // A folder without permissions, or with too many.
    for mode in [0o000, 0o777] {
        std::fs::create_dir(&shared).unwrap();
        std::fs::set_permissions(&shared, std::fs::Permissions::from_mode(mode)).unwrap();
        run.lockstep("--ticks 5").finish().succeeded();
        run.assert_nothing_left();
    }
}

#[test]
fn shared_memory_that_is_removed_and_cannot_be_made_again_ends_the_run_with_the_cause() {
    if !may_mount() {
        return;
    }
    let run = Run::new();
    let supervisor = run.command_by(&mounted("mount -t tmpfs -o size=1m none /dev/shm"), ENDLESS);
    run.wait_for_ticks(100);
    let shared_memory = Path::new("/proc").join(supervisor.pid().as_raw_pid().to_string()).join("root/dev/shm");
    assert!(std::fs::write(shared_memory.join("fill"), vec![1; 4 << 20]).is_err(), "it was to be filled");
    std::fs::remove_dir_all(shared_memory.join(run.shared_folder().file_name().unwrap())).unwrap();
    let outcome = supervisor.finish();
    assert_refused(&outcome, 1, &["was removed from outside", "cannot be made again", "/dev/shm", "kB free"]);
    assert!(outcome.stdout.contains("digest"), "it reported what it had: {outcome:#?}");
}

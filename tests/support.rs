//! Runs of the real program: a name and a folder for each, and a limit on every wait.
//!
//! Tests run side by side, beside other users of `/dev/shm`. They observe and end only the processes and files
//! of one run, identified by its name.

use std::cell::Cell;
use std::fs::File;
use std::io::Write;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use rangehound_node::logs;
use rangehound_node::rendezvous::RunDescription;
use rangehound_shared::record::WorldRecord;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use tempfile::TempDir;

/// Far above the time of any step: only a missing event reaches it.
const LIMIT: Duration = Duration::from_secs(120);

/// Most time for the processes of a failed test to end in order.
const GRACE: Duration = Duration::from_secs(10);

/// The program under test.
pub(crate) const PROGRAM: &str = env!("CARGO_BIN_EXE_rangehound");

const POLL: Duration = Duration::from_millis(1);

/// Reports that a test was skipped, and why. `println!` would not do: the harness hides it if the test passes.
pub(crate) fn skipped(what: &str, why: &str) {
    let _ = writeln!(std::io::stderr(), "NOT TESTED: {what}: {why}");
}

/// Runs a command that must be refused in one line, with no file created.
#[track_caller]
pub(crate) fn assert_refused_at_once(words: &str, expected: &str) {
    let run = Run::new();
    let refused = run.command(words).finish();
    assert_eq!(refused.code, Some(2), "{refused:#?}");
    let [complaint] = refused.complaints()[..] else { panic!("{refused:#?}") };
    assert!(complaint.contains(expected), "{complaint}");
    assert!(!run.path("out").exists());
}

/// One run: a unique name, and a working folder of the program. The run folder
/// is `out` in it.
pub(crate) struct Run {
    pub(crate) name: String,
    folder: TempDir,
    started: Cell<usize>,
}

impl Run {
    pub(crate) fn new() -> Self {
        static COUNT: AtomicUsize = AtomicUsize::new(0);
        let name = format!("t{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
        Self { name, folder: TempDir::new().unwrap(), started: Cell::new(0) }
    }

    /// A path in the working folder.
    pub(crate) fn path(&self, file: &str) -> PathBuf {
        self.folder.path().join(file)
    }

    pub(crate) fn write(&self, file: &str, text: impl AsRef<[u8]>) {
        std::fs::write(self.path(file), text).unwrap();
    }

    /// A file of the run folder.
    pub(crate) fn read(&self, file: &str) -> String {
        let path = self.path("out").join(file);
        std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
    }

    /// Starts the program. Its output goes to files: a full pipe would stop it.
    pub(crate) fn start(&self, args: &[&str]) -> Process {
        self.start_by("exec \"$@\"", args)
    }

    /// Starts the program from a shell script, which it replaces: `$@` is the program with its arguments.
    pub(crate) fn start_by(&self, script: &str, args: &[&str]) -> Process {
        self.start_program_by(script, Path::new(PROGRAM), args)
    }

    /// Starts another program.
    pub(crate) fn start_program(&self, program: &Path, args: &[&str]) -> Process {
        self.start_program_by("exec \"$@\"", program, args)
    }

    fn start_program_by(&self, script: &str, program: &Path, args: &[&str]) -> Process {
        let number = self.started.replace(self.started.get() + 1);
        let [stdout, stderr] = ["stdout", "stderr"].map(|stream| self.path(&format!(".{number}.{stream}")));
        let child = Command::new("sh")
            .args(["-c", script, "sh"])
            .arg(program)
            .args(args)
            .current_dir(self.folder.path())
            .env_remove("RUST_LOG")
            .env_remove("NO_COLOR")
            .env_remove("CLICOLOR_FORCE")
            .stdin(Stdio::null())
            .stdout(File::create(&stdout).unwrap())
            .stderr(File::create(&stderr).unwrap())
            .spawn()
            .unwrap();
        Process { child, args: args.join(" "), stdout, stderr, shared: self.shared_folder() }
    }

    /// Starts a command, split at spaces, with this run's name and folder.
    pub(crate) fn command(&self, words: &str) -> Process {
        self.start(&self.args_of(words))
    }

    /// A command's words with this run's name and folder. It does not record unless requested: most tests need no recording.
    fn args_of<'a>(&'a self, words: &'a str) -> Vec<&'a str> {
        let mut args: Vec<&str> = words.split_whitespace().collect();
        if matches!(args.first(), Some(&("run" | "track"))) && !args.contains(&"--record") {
            args.push("--no-record");
        }
        args.extend(["--name", &self.name, "--out", "out"]);
        args
    }

    /// Starts a command of this run from a shell script, as [`Self::start_by`] does.
    pub(crate) fn command_by(&self, script: &str, words: &str) -> Process {
        self.start_by(script, &self.args_of(words))
    }

    /// Starts `run` in lock step.
    pub(crate) fn lockstep(&self, words: &str) -> Process {
        self.command(&format!("run --clock lockstep {words}"))
    }

    /// Starts a node that joins this run.
    pub(crate) fn node(&self, words: &str) -> Process {
        let mut args: Vec<&str> = words.split_whitespace().collect();
        args.extend(["--name", &self.name]);
        self.start(&args)
    }

    /// The run's shared folder.
    pub(crate) fn shared_folder(&self) -> PathBuf {
        Path::new("/dev/shm").join(format!("rh-{}-{}", rustix::process::getuid().as_raw(), self.name))
    }

    pub(crate) fn report(&self) -> Value {
        serde_json::from_str(&self.read("report.json")).unwrap()
    }

    pub(crate) fn digest(&self) -> String {
        self.report()["digest"].as_str().unwrap().to_owned()
    }

    /// Waits until a condition is true; on time-out fails with all output.
    pub(crate) fn wait_until(&self, what: &str, mut so: impl FnMut() -> bool) {
        let began = Instant::now();
        while !so() {
            assert!(began.elapsed() < LIMIT, "waited {LIMIT:?} in vain until {what}\n{}", self.all_output());
            std::thread::sleep(POLL);
        }
    }

    /// The output of the programs and their nodes.
    fn all_output(&self) -> String {
        [self.folder.path().to_owned(), self.path("out/logs")]
            .iter()
            .flat_map(|folder| std::fs::read_dir(folder).into_iter().flatten().flatten())
            .filter(|entry| entry.file_name().to_string_lossy().ends_with(['r', 'g']))
            .filter_map(|entry| Some(format!("{:?}: {}", entry.file_name(), read_if_file(&entry.path())?)))
            .collect()
    }

    /// The process in a role, once the role has been started this many times and the latest process lives.
    pub(crate) fn pid_of(&self, role: &str, starts: u64) -> Pid {
        let file = self.shared_folder().join(format!("{role}.role"));
        let mut found = None;
        self.wait_until(&format!("{role} has been started {starts} times"), || {
            let text = std::fs::read_to_string(&file).unwrap_or_default();
            found = text.trim().split_once(' ').and_then(|(count, pid)| {
                let pid = Pid::from_raw(pid.parse().ok()?)?;
                // The file is rewritten in pieces: the process itself confirms the pid.
                (count.parse() == Ok(starts) && is_alive(pid) && comm(pid) == format!("rh-{role}")).then_some(pid)
            });
            found.is_some()
        });
        found.unwrap()
    }

    /// True while a process holds this role.
    pub(crate) fn is_held(&self, role: &str) -> bool {
        // Without try-lock: a node that tries to take the role at that moment would find it held, and a standby would take the next number.
        let role = std::fs::metadata(self.shared_folder().join(format!("{role}.role")));
        let locks = std::fs::read_to_string("/proc/locks").unwrap();
        role.is_ok_and(|role| {
            locks.lines().any(|lock| lock.contains(" WRITE ") && lock.contains(&format!(":{} ", role.ino())))
        })
    }

    /// Number of starts of a role.
    pub(crate) fn starts(&self, role: &str) -> u64 {
        let text = std::fs::read_to_string(self.shared_folder().join(format!("{role}.role"))).unwrap_or_default();
        text.split(' ').next().and_then(|starts| starts.parse().ok()).unwrap_or(0)
    }

    /// The newest tick that the simulator has logged.
    pub(crate) fn last_world(&self) -> Option<(u64, WorldRecord)> {
        let description = RunDescription::open(&std::fs::read(self.path("out/run.sealed")).ok()?).ok()?;
        let mut log = logs::read_worlds(&description).ok()?;
        let tick = log.newest_tick().ok()??;
        Some((tick, log.at(tick).ok()??.clone()))
    }

    /// Ticks that the simulator has logged.
    pub(crate) fn ticks_done(&self) -> u64 {
        self.last_world().map_or(0, |(tick, _)| tick + 1)
    }

    pub(crate) fn wait_for_ticks(&self, ticks: u64) {
        self.wait_until(&format!("{ticks} ticks are done"), || self.ticks_done() >= ticks);
    }

    /// Prefix of the run's shared memory, once it has been created.
    pub(crate) fn shared_memory_prefix(&self) -> String {
        let config = self.shared_folder().join("iceoryx2.toml");
        self.wait_until("the run is created", || config.exists());
        let config = std::fs::read_to_string(config).unwrap();
        config.lines().find_map(|line| line.strip_prefix("prefix = ")).unwrap().trim_matches('"').to_owned()
    }

    /// Checks that the run has left no file in `/dev/shm`.
    pub(crate) fn assert_nothing_left(&self) {
        // Repeated: any creator looks into the folders of others, to remove those of dead processes.
        self.wait_until("the run's folder is gone", || !self.shared_folder().exists());
        let names = |prefix: &str| -> Vec<String> {
            let entries = std::fs::read_dir("/dev/shm").unwrap().flatten();
            let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
            names.filter(|name| name.starts_with(prefix)).collect()
        };
        let left = names("rh");
        // The prefix of shared memory follows from the name alone, and a creator records it.
        let creator = self.node("sim --ticks 1 --out of-creator");
        let prefix = self.shared_memory_prefix();
        let left: Vec<&String> = left.iter().filter(|name| name.starts_with(&prefix)).collect();
        assert!(left.is_empty(), "{left:?}");
        creator.signal(Signal::TERM);
        creator.finish().succeeded();
        self.wait_until("the folder is gone again", || !self.shared_folder().exists());
        assert_eq!(names(&prefix), [""; 0]);
    }
}

/// The digest of a scenario composed in one process: every undisturbed run must have it.
pub(crate) fn digest_in_process(words: &str) -> String {
    let run = Run::new();
    run.lockstep(&format!("--in-process {words}")).finish().succeeded();
    run.digest()
}

/// A program that a test started and that does not outlive the test.
pub(crate) struct Process {
    child: Child,
    args: String,
    stdout: PathBuf,
    stderr: PathBuf,
    shared: PathBuf,
}

/// The end of a program.
#[derive(Debug)]
pub(crate) struct Outcome {
    /// `None` after a signal.
    pub(crate) code: Option<i32>,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

impl Process {
    pub(crate) fn pid(&self) -> Pid {
        Pid::from_child(&self.child)
    }

    pub(crate) fn signal(&self, signal: Signal) {
        kill_process(self.pid(), signal).unwrap();
    }

    pub(crate) fn stdout(&self) -> String {
        read_if_file(&self.stdout).unwrap_or_default()
    }

    pub(crate) fn stderr(&self) -> String {
        read_if_file(&self.stderr).unwrap_or_default()
    }

    /// True once the process is a member of its run: it holds the members' file.
    pub(crate) fn has_joined(&self) -> bool {
        let members = self.shared.join("members");
        let open = std::fs::read_dir(format!("/proc/{}/fd", self.child.id())).into_iter().flatten().flatten();
        open.filter_map(|entry| std::fs::read_link(entry.path()).ok()).any(|file| file == members)
    }

    /// Waits for the end.
    pub(crate) fn finish(self) -> Outcome {
        self.finish_within(LIMIT)
    }

    /// The same for what takes many steps.
    pub(crate) fn finish_within(mut self, limit: Duration) -> Outcome {
        let began = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                break status;
            }
            assert!(began.elapsed() < limit, "{} has not ended in {limit:?}\n{}", self.args, self.stderr());
            std::thread::sleep(POLL);
        };
        Outcome { code: status.code(), stdout: self.stdout(), stderr: self.stderr() }
    }
}

impl Drop for Process {
    /// Ends the processes of a failed test, in order if possible, so that they end their nodes and remove the run's
    /// shared memory.
    fn drop(&mut self) {
        if !matches!(self.child.try_wait(), Ok(None)) {
            return;
        }
        let roles = std::fs::read_dir(&self.shared).into_iter().flatten().flatten();
        let nodes = roles.filter_map(|entry| read_if_file(&entry.path())?.trim().split_once(' ')?.1.parse().ok());
        for pid in nodes.filter_map(Pid::from_raw).filter(|pid| comm(*pid).starts_with("rh-")) {
            let _ = kill_process(pid, Signal::CONT);
        }
        for signal in [Signal::CONT, Signal::TERM] {
            let _ = kill_process(self.pid(), signal);
        }
        let began = Instant::now();
        while matches!(self.child.try_wait(), Ok(None)) && began.elapsed() < GRACE {
            std::thread::sleep(POLL);
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Outcome {
    /// Returns itself if the program succeeded.
    #[track_caller]
    pub(crate) fn succeeded(self) -> Self {
        assert_eq!(self.code, Some(0), "{self:#?}");
        self
    }

    /// The error messages of the tool itself: progress and warnings begin differently.
    pub(crate) fn complaints(&self) -> Vec<&str> {
        self.stderr.lines().filter(|line| line.starts_with("rangehound: ")).collect()
    }
}

pub(crate) fn signal(pid: Pid, signal: Signal) {
    kill_process(pid, signal).unwrap();
}

/// The name of a process.
pub(crate) fn comm(pid: Pid) -> String {
    let text = std::fs::read_to_string(format!("/proc/{}/comm", pid.as_raw_pid())).unwrap_or_default();
    text.trim_end().to_owned()
}

/// False once a process has ended, even if its parent has not waited for it.
pub(crate) fn is_alive(pid: Pid) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{}/stat", pid.as_raw_pid())).unwrap_or_default();
    stat.rsplit_once(") ").is_some_and(|(_, rest)| !rest.starts_with(['Z', 'X']))
}

fn read_if_file(path: &Path) -> Option<String> {
    path.is_file().then(|| String::from_utf8_lossy(&std::fs::read(path).unwrap_or_default()).into_owned())
}

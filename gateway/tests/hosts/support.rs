//! A run with its programs, and a bad link between robots and gateway. Each run has its own name and folder, each wait a limit.

use std::collections::{BinaryHeap, HashMap};
use std::fs::File;
use std::net::{SocketAddr, UdpSocket};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rangehound_node::logs;
use rangehound_node::rendezvous::RunDescription;
use rangehound_node::tick_log::{TickLogError, TickLogReader};
use rangehound_shared::record::{FusionRecord, Record, WorldRecord};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use tempfile::TempDir;

/// Far above the time of any step: only a missing event reaches it.
pub(crate) const LIMIT: Duration = Duration::from_secs(180);

const GATEWAY: &str = env!("CARGO_BIN_EXE_rangehound-gateway");

/// The program `rangehound`, which is built before: it lies beside the gateway's.
fn program() -> PathBuf {
    let program = PathBuf::from(GATEWAY).with_file_name("rangehound");
    assert!(program.is_file(), "{} is missing: build it first, in the same profile", program.display());
    program
}

/// Opens a log of a run.
type Read<R> = fn(&RunDescription) -> Result<TickLogReader<R>, TickLogError>;

/// A run's name and folder, and the processes that were started for it.
pub(crate) struct Run {
    pub(crate) name: String,
    folder: TempDir,
    started: AtomicUsize,
}

impl Run {
    pub(crate) fn new() -> Self {
        static COUNT: AtomicUsize = AtomicUsize::new(0);
        let name = format!("h{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
        Self { name, folder: TempDir::new().unwrap(), started: AtomicUsize::new(0) }
    }

    /// The same with a scenario in real time, `slow.toml`, whose ticks last so long.
    pub(crate) fn with_ticks_of(dt_s: f64) -> Self {
        let run = Self::new();
        std::fs::write(run.path("slow.toml"), format!("clock = \"realtime\"\ndt_s = {dt_s:?}\n")).unwrap();
        run
    }

    pub(crate) fn path(&self, file: &str) -> PathBuf {
        self.folder.path().join(file)
    }

    /// Starts a command of `rangehound`, split at spaces.
    pub(crate) fn start(&self, words: &str) -> Process {
        self.start_by("exec \"$@\"", words)
    }

    /// The same from a shell script: `$@` is the program with its arguments.
    pub(crate) fn start_by(&self, script: &str, words: &str) -> Process {
        let number = self.started.fetch_add(1, Ordering::Relaxed);
        let [stdout, stderr] = ["stdout", "stderr"].map(|stream| self.path(&format!(".{number}.{stream}")));
        let child = Command::new("sh")
            .args(["-c", script, "sh"])
            .arg(program())
            .args(words.split_whitespace())
            .current_dir(self.folder.path())
            .env_remove("RUST_LOG")
            .stdin(Stdio::null())
            .stdout(File::create(&stdout).unwrap())
            .stderr(File::create(&stderr).unwrap())
            .spawn()
            .unwrap();
        Process { child: Some(child), words: words.to_owned(), stdout, stderr }
    }

    /// Runs a command of `rangehound` to its end; returns its exit code and its messages.
    pub(crate) fn finish(&self, words: &str) -> (Option<i32>, String) {
        self.start(words).finish()
    }

    /// The same for one that must succeed.
    #[track_caller]
    pub(crate) fn finish_ok(&self, words: &str) {
        self.start(words).succeeds();
    }

    /// Starts a run with a gateway, at a port that is free. Returns the gateway's address too.
    pub(crate) fn run(&self, words: &str) -> (Process, SocketAddr) {
        let run = self.start(&format!("run --no-record --name {} --out out --listen 127.0.0.1:0 {words}", self.name));
        let address = self.listens(&run);
        (run, address)
    }

    /// The address at which the gateway listens that this process is or has started.
    pub(crate) fn listens(&self, process: &Process) -> SocketAddr {
        self.wait_for("the gateway listens", || {
            let text = process.stderr();
            let listens = text.lines().find_map(|line| line.split_once("listens on "))?.1.to_owned();
            listens.trim().parse().ok()
        })
    }

    pub(crate) fn robot(&self, id: usize, address: SocketAddr) -> Process {
        self.start(&format!("robot --id {id} --connect {address}"))
    }

    /// Waits until something is there.
    #[track_caller]
    pub(crate) fn wait_for<T>(&self, what: &str, look: impl Fn() -> Option<T>) -> T {
        let began = Instant::now();
        loop {
            if let Some(found) = look() {
                return found;
            }
            assert!(began.elapsed() < LIMIT, "{}: {what} does not come", self.name);
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    pub(crate) fn report(&self) -> Value {
        let text = std::fs::read_to_string(self.path("out/report.json")).unwrap();
        serde_json::from_str(&text).unwrap()
    }

    /// The simulator's record of each tick.
    pub(crate) fn worlds(&self) -> Vec<(u64, WorldRecord)> {
        self.records(logs::read_worlds)
    }

    /// Fusion's record of each tick.
    pub(crate) fn estimates(&self) -> Vec<(u64, FusionRecord)> {
        self.records(logs::read_estimates)
    }

    fn records<R: Record + Clone>(&self, read: Read<R>) -> Vec<(u64, R)> {
        let mut description = RunDescription::open(&std::fs::read(self.path("out/run.sealed")).unwrap()).unwrap();
        description.out_dir = self.path("out");
        let mut log = read(&description).unwrap();
        std::iter::from_fn(|| log.next().map(|record| record.map(|(tick, record)| (tick, record.clone())).unwrap()))
            .collect()
    }

    pub(crate) fn digest(&self) -> String {
        self.report()["digest"].as_str().unwrap().to_owned()
    }

    /// The digest of the same run in one process.
    pub(crate) fn digest_in_process(words: &str) -> String {
        let oracle = Self::new();
        let (code, text) = oracle.finish(&format!("run --in-process --no-record --out out {words}"));
        assert_eq!(code, Some(0), "{text}");
        oracle.digest()
    }

    /// The state of the run, as `status --json` tells.
    pub(crate) fn status(&self) -> Option<Value> {
        let output = Command::new(program()).args(["status", "--json", "--name", &self.name]).output().unwrap();
        serde_json::from_slice(&output.stdout).ok()
    }

    /// The gateway's refusals, by cause, from the note that `status` reads too: without a process, so that it costs no time.
    pub(crate) fn refusals(&self) -> Value {
        let note = std::fs::read(self.shared_folder().join("gateway")).unwrap_or_default();
        serde_json::from_slice(&note).map(|note: Value| note["refusals"].clone()).unwrap_or_default()
    }

    /// How often it has refused something for this cause.
    pub(crate) fn refused(&self, cause: &str) -> u64 {
        self.refusals()[cause].as_u64().unwrap_or(0)
    }

    pub(crate) fn tick(&self) -> u64 {
        self.status().and_then(|status| status["tick"].as_u64()).unwrap_or(0)
    }

    #[track_caller]
    pub(crate) fn wait_until_tick(&self, tick: u64) {
        self.wait_for("the tick", || (self.tick() >= tick).then_some(()));
    }

    /// The process in a role of this run, as the kernel knows it.
    pub(crate) fn pid_of(&self, role: &str) -> Option<Pid> {
        let status = self.status()?;
        let node = status["nodes"].as_array()?.iter().find(|node| node["name"] == role)?;
        Pid::from_raw(i32::try_from(node["pid"].as_i64()?).ok()?)
    }

    /// The gateway's process.
    pub(crate) fn gateway(&self) -> Option<Pid> {
        self.pid_of("gateway")
    }

    /// Robots that have joined through the gateway.
    pub(crate) fn links(&self) -> usize {
        let status = self.status();
        status.and_then(|status| Some(status["gateway"]["robots"].as_array()?.len())).unwrap_or(0)
    }

    pub(crate) fn shared_folder(&self) -> PathBuf {
        PathBuf::from("/dev/shm").join(format!("rh-{}-{}", rustix::process::getuid().as_raw(), self.name))
    }

    #[track_caller]
    pub(crate) fn assert_nothing_left(&self) {
        self.wait_for("the end of the shared memory", || (!self.shared_folder().exists()).then_some(()));
    }
}

/// Memory of a process that is in use, kB, if it lives.
pub(crate) fn resident_kb(pid: Pid) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{}/status", pid.as_raw_pid())).ok()?;
    let resident = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    resident.trim().strip_suffix(" kB")?.parse().ok()
}

/// A process of a test, which ends with it.
pub(crate) struct Process {
    child: Option<Child>,
    words: String,
    stdout: PathBuf,
    stderr: PathBuf,
}

impl Process {
    pub(crate) fn stderr(&self) -> String {
        std::fs::read_to_string(&self.stderr).unwrap_or_default()
    }

    pub(crate) fn stdout(&self) -> String {
        std::fs::read_to_string(&self.stdout).unwrap_or_default()
    }

    pub(crate) fn pid(&self) -> Pid {
        Pid::from_child(self.child.as_ref().unwrap())
    }

    pub(crate) fn signal(&self, signal: Signal) {
        let _ = kill_process(self.pid(), signal);
    }

    pub(crate) fn is_running(&mut self) -> bool {
        self.child.as_mut().is_some_and(|child| matches!(child.try_wait(), Ok(None)))
    }

    /// Waits for its end; returns its exit code and its messages.
    #[track_caller]
    pub(crate) fn finish(mut self) -> (Option<i32>, String) {
        let began = Instant::now();
        while self.is_running() {
            assert!(began.elapsed() < LIMIT, "{} does not end: {}", self.words, self.stderr());
            std::thread::sleep(Duration::from_millis(2));
        }
        let status = self.child.take().and_then(|mut child| child.wait().ok());
        (status.and_then(|status| status.code()), self.stderr())
    }

    #[track_caller]
    pub(crate) fn succeeds(self) {
        let words = self.words.clone();
        let (code, text) = self.finish();
        assert_eq!(code, Some(0), "{words}: {text}");
    }

    /// Ends in order. A robot whose link is lost when its run ends would wait for the next one.
    #[track_caller]
    pub(crate) fn ends(self) {
        self.signal(Signal::TERM);
        self.succeeds();
    }

    pub(crate) fn kill(mut self) {
        self.signal(Signal::KILL);
        let _ = self.child.take().map(|mut child| child.wait());
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if self.child.is_none() {
            return;
        }
        // In order first: a supervisor ends its nodes.
        self.signal(Signal::TERM);
        let began = Instant::now();
        while self.is_running() && began.elapsed() < Duration::from_secs(10) {
            std::thread::sleep(Duration::from_millis(5));
        }
        self.signal(Signal::KILL);
        let _ = self.child.take().map(|mut child| child.wait());
    }
}

/// The faults of a link.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Faults {
    pub(crate) loss: f64,
    pub(crate) duplicates: f64,
    pub(crate) delay: Duration,
    pub(crate) jitter: Duration,
    /// Part of the packets beside which an old one comes again.
    pub(crate) replayed: f64,
    /// Part of the packets beside which a damaged copy comes: cut short, or with another byte.
    pub(crate) damaged: f64,
}

/// A link between robots and a gateway on loopback: robots connect to its address.
pub(crate) struct Link {
    pub(crate) address: SocketAddr,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

struct Shared {
    faults: Mutex<Faults>,
    cut_up: AtomicBool,
    cut_down: AtomicBool,
    ended: AtomicBool,
    replayed: AtomicUsize,
    damaged: AtomicUsize,
}

/// A packet that arrives later: the earliest first.
struct Later {
    at: Instant,
    to: SocketAddr,
    is_up: bool,
    bytes: Vec<u8>,
}

impl Ord for Later {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        other.at.cmp(&self.at)
    }
}

impl PartialOrd for Later {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Later {
    fn eq(&self, other: &Self) -> bool {
        self.at == other.at
    }
}

impl Eq for Later {}

impl Link {
    pub(crate) fn new(gateway: SocketAddr, seed: u64, faults: Faults) -> Self {
        let front = UdpSocket::bind("127.0.0.1:0").unwrap();
        let address = front.local_addr().unwrap();
        let shared = Arc::new(Shared {
            faults: Mutex::new(faults),
            cut_up: AtomicBool::new(false),
            cut_down: AtomicBool::new(false),
            ended: AtomicBool::new(false),
            replayed: AtomicUsize::new(0),
            damaged: AtomicUsize::new(0),
        });
        let its = Arc::clone(&shared);
        let thread = std::thread::spawn(move || pass(&front, gateway, seed, &its));
        Self { address, shared, thread: Some(thread) }
    }

    /// Packets that came again, and damaged ones.
    pub(crate) fn hostile(&self) -> [usize; 2] {
        [&self.shared.replayed, &self.shared.damaged].map(|count| count.load(Ordering::Relaxed))
    }

    /// Cuts packets to the gateway, from it, or both.
    pub(crate) fn cut(&self, up: bool, down: bool) {
        self.shared.cut_up.store(up, Ordering::Relaxed);
        self.shared.cut_down.store(down, Ordering::Relaxed);
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.shared.ended.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

fn pass(front: &UdpSocket, gateway: SocketAddr, seed: u64, shared: &Shared) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    // One socket for each robot, so that the gateway sees them apart.
    let mut backs: HashMap<SocketAddr, UdpSocket> = HashMap::new();
    let mut later: BinaryHeap<Later> = BinaryHeap::new();
    let mut past: Vec<(SocketAddr, bool, Vec<u8>)> = Vec::new();
    let mut bytes = [0; 2_048];
    front.set_nonblocking(true).unwrap();
    while !shared.ended.load(Ordering::Relaxed) {
        // Not a time-out of the socket: the kernel rounds those up to milliseconds.
        std::thread::sleep(Duration::from_micros(100));
        let mut come: Vec<(SocketAddr, bool, usize, [u8; 2_048])> = Vec::new();
        while let Ok((len, from)) = front.recv_from(&mut bytes) {
            backs.entry(from).or_insert_with(|| {
                let back = UdpSocket::bind("127.0.0.1:0").unwrap();
                back.connect(gateway).unwrap();
                back.set_nonblocking(true).unwrap();
                back
            });
            come.push((from, true, len, bytes));
        }
        for (robot, back) in &backs {
            while let Ok(len) = back.recv(&mut bytes) {
                come.push((*robot, false, len, bytes));
            }
        }
        let faults = *shared.faults.lock().unwrap();
        for (robot, is_up, len, bytes) in come {
            let cut = if is_up { &shared.cut_up } else { &shared.cut_down };
            if cut.load(Ordering::Relaxed) || random.random_bool(faults.loss) {
                continue;
            }
            for _ in 0..if random.random_bool(faults.duplicates) { 2 } else { 1 } {
                let at = Instant::now() + faults.delay + faults.jitter.mul_f64(random.random_range(0.0..1.0));
                later.push(Later { at, to: robot, is_up, bytes: bytes[..len].to_vec() });
            }
            if random.random_bool(faults.damaged) {
                let mut bytes = bytes[..len].to_vec();
                let at = random.random_range(0..len);
                if random.random_bool(0.5) {
                    bytes.truncate(at);
                } else {
                    bytes[at] ^= random.random_range(1..=255);
                }
                later.push(Later { at: Instant::now(), to: robot, is_up, bytes });
                shared.damaged.fetch_add(1, Ordering::Relaxed);
            }
            if faults.replayed > 0.0 {
                past.push((robot, is_up, bytes[..len].to_vec()));
                if random.random_bool(faults.replayed) {
                    let (to, is_up, bytes) = past[random.random_range(0..past.len())].clone();
                    later.push(Later { at: Instant::now(), to, is_up, bytes });
                    shared.replayed.fetch_add(1, Ordering::Relaxed);
                }
            }
        }
        while later.peek().is_some_and(|first| first.at <= Instant::now()) {
            let Some(Later { to, is_up, bytes, .. }) = later.pop() else { break };
            let _ = match (is_up, backs.get(&to)) {
                (true, Some(back)) => back.send(&bytes),
                _ => front.send_to(&bytes, to),
            };
        }
    }
}

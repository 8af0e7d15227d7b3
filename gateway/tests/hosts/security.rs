//! Hosts that may take part, and strangers, who can do nothing.

use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime};

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rangehound_gateway::keys::{Authority, GATEWAY_NAME, Host, HostRole, RobotHost, Validity, make};
use rangehound_gateway::link;

use crate::peer::{self, Peer};
use crate::support::{Faults, LIMIT, Link, Process, Run, resident_kb};

/// A run with keys of two authorities.
pub(crate) fn with_keys() -> Run {
    let run = Run::new();
    let (code, text) = run.finish("keys --out keys --gateway station --host alice=0,1 --host bob=2");
    assert_eq!(code, Some(0), "{text}");
    let (code, text) = run.finish("keys --out other --gateway station --host alice=0-5");
    assert_eq!(code, Some(0), "{text}");
    run
}

#[test]
fn an_address_that_others_can_reach_demands_keys() {
    let run = Run::new();
    let (code, text) = run.finish("run --listen 0.0.0.0:0 --out out");
    assert!(code == Some(2) && text.lines().count() == 1 && text.contains("--keys is missing"), "{text}");
    let (code, text) = run.finish("run --in-process --listen 127.0.0.1:0 --out out");
    assert!(code == Some(2) && text.lines().count() == 1 && text.contains("--listen"), "{text}");
    let (code, text) = run.finish("robot --id 0 --connect 192.0.2.1:7447");
    assert!(code == Some(2) && text.lines().count() == 1 && text.contains("--keys is missing"), "{text}");
    let (code, text) = run.finish("robot --id 0 --connect 127.0.0.1");
    assert!(code == Some(2) && text.lines().count() == 1 && text.contains("expected HOST:PORT"), "{text}");
    let (code, text) = run.finish("run --listen 127.0.0.1:0 --keys nowhere --out out");
    assert!(code == Some(2) && text.lines().count() == 1 && text.contains("nowhere"), "{text}");
    assert!(!run.path("out").exists());
    let run = with_keys();
    let (code, text) = run.finish("run --listen 127.0.0.1:0 --keys keys/alice --out out");
    assert!(code == Some(2) && text.lines().count() == 1 && text.contains("a host of robots"), "{text}");
}

/// Each is refused with one line at both ends, and the run goes on.
#[test]
fn wrong_foreign_and_missing_certificates_are_refused_at_both_ends() {
    let run = with_keys();
    let words = "--clock lockstep --timeout forever --ticks 200 --robots 3 --keys keys/station";
    let (supervisor, gateway) = run.run(words);
    let connect = |id: usize, keys: &str| run.finish(&format!("robot --id {id} --connect {gateway} {keys}"));
    for (id, keys, robot_says, gateway_says) in [
        (
            2,
            "--keys keys/alice",
            "the certificate of alice does not name robot-",
            "the certificate of alice does not name robot-",
        ),
        (0, "--keys other/alice", "another authority", "another authority"),
        (0, "", "no certificate", "no certificate"),
        (9, "--keys keys/alice", "(--id) is not in this run", "(--id) is not in this run"),
        (0, "--keys keys/alice --name another", "this is the gateway of run", "this is the gateway of run"),
    ] {
        let (code, text) = connect(id, keys);
        assert_eq!(code, Some(2), "{keys}: {text}");
        // On a busy machine an attempt may end before its refusal.
        let complaints: Vec<&str> = text.lines().filter(|line| !line.contains("no answer")).collect();
        assert!(complaints.len() == 1 && complaints[0].contains(robot_says), "{keys}: {text}");
        run.wait_for("the gateway's line", || supervisor.stderr().contains(gateway_says).then_some(()));
    }
    let robots = [(0, "alice"), (1, "alice"), (2, "bob")]
        .map(|(id, host)| run.start(&format!("robot --id {id} --connect {gateway} --keys keys/{host}")));
    supervisor.succeeds();
    for robot in robots {
        robot.succeeds();
    }
    run.assert_nothing_left();
}

/// Between the hosts somebody sends old packets again, and damaged copies, both ways.
#[test]
fn replayed_and_damaged_packets_change_nothing() {
    let run = Run::new();
    let words = "--clock lockstep --timeout forever --ticks 600 --robots 3 --seed 3";
    let (supervisor, gateway) = run.run(words);
    let link = Link::new(gateway, 7, Faults { replayed: 0.5, damaged: 0.5, ..Faults::default() });
    let robots = [0, 1, 2].map(|id| run.robot(id, link.address));
    supervisor.succeeds();
    robots.into_iter().for_each(Process::succeeds);
    assert!(link.hostile().iter().all(|count| *count >= 1_000), "{:?}", link.hostile());
    assert_eq!(run.digest(), Run::digest_in_process(words));
    run.assert_nothing_left();
}

/// Packets of a stranger, 1 000 and more of each kind, cost the run nothing and the gateway no memory.
#[test]
fn a_strangers_packets_change_nothing() {
    let run = Run::new();
    let words = "--clock lockstep --timeout forever --ticks 600 --robots 2 --seed 3";
    let (supervisor, gateway) = run.run(words);
    // The run waits for the other robot.
    let first = run.robot(0, gateway);
    run.wait_for("the link", || (run.links() == 1).then_some(()));
    let mut stranger = Stranger::new(gateway);
    let pid = run.wait_for("the gateway", || run.gateway());
    let sizes_kb = [1_000, 10_000, 10_000].map(|each| {
        stranger.send(each);
        resident_kb(pid).unwrap()
    });
    println!("resident {sizes_kb:?} kB");
    assert!(sizes_kb[2] <= sizes_kb[1] + GROWTH_KB_MAX, "{sizes_kb:?}");
    // The run goes on while more of them come.
    let is_over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while !is_over.load(Ordering::Relaxed) {
                stranger.send(20);
            }
        });
        let second = run.robot(1, gateway);
        let (code, text) = supervisor.finish();
        is_over.store(true, Ordering::Relaxed);
        assert_eq!(code, Some(0), "{text}");
        [first, second].into_iter().for_each(Process::succeeds);
    });
    assert_eq!(run.digest(), Run::digest_in_process(words));
    run.assert_nothing_left();
}

/// Growth of the gateway's memory that does not come from packets, kB: the allocator's.
const GROWTH_KB_MAX: u64 = 512;

/// It sends packets to a gateway, and has no link to it.
struct Stranger {
    gateway: SocketAddr,
    socket: UdpSocket,
    random: ChaCha8Rng,
    /// The first packet of a handshake.
    first: Vec<u8>,
}

impl Stranger {
    fn new(gateway: SocketAddr) -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        // It has seen this packet on its way to somebody else.
        let listens = UdpSocket::bind("127.0.0.1:0").unwrap();
        listens.set_read_timeout(Some(LIMIT)).unwrap();
        let mut first = vec![0; 2_048];
        let len = link::runtime().unwrap().block_on(async {
            let robot = quinn::Endpoint::client("127.0.0.1:0".parse().unwrap()).unwrap();
            let address = listens.local_addr().unwrap();
            let connecting = robot.connect_with(peer::without_keys(), address, GATEWAY_NAME).unwrap();
            let sent = tokio::time::timeout(Duration::from_millis(200), connecting).await;
            assert!(sent.is_err(), "nobody answers");
            listens.recv(&mut first).unwrap()
        });
        first.truncate(len);
        Self { gateway, socket, random: ChaCha8Rng::seed_from_u64(1), first }
    }

    /// Sends so many packets of each kind.
    fn send(&mut self, each: usize) {
        for number in 0..each {
            let len = self.random.random_range(1..1_400);
            let noise = self.noise(len);
            // Like the first packet of a connection.
            let mut like_first = self.noise(1_200);
            like_first[..5].copy_from_slice(&self.first[..5]);
            let cut = self.first[..self.random.random_range(0..self.first.len())].to_vec();
            let mut other_version = self.first.clone();
            other_version[1..5].copy_from_slice(&0x1a2a_3a4a_u32.to_be_bytes());
            let oversized = self.noise(if number % 10 == 0 { 60_000 } else { 1_473 });
            for packet in [noise, like_first, cut, other_version, oversized, self.first.clone()] {
                let _ = self.socket.send_to(&packet, self.gateway);
            }
            // Not faster than the gateway reads.
            if number % 10 == 0 {
                std::thread::sleep(Duration::from_millis(1));
            }
        }
    }

    fn noise(&mut self, len: usize) -> Vec<u8> {
        (0..len).map(|_| self.random.random()).collect()
    }
}

/// Strangers with many addresses, without certificates and with foreign ones, begin more handshakes than there are places. A robot
/// from a known address gets in, and the run goes on.
#[test]
fn a_flood_of_handshakes_costs_the_run_nothing() {
    let words = "--clock lockstep --timeout forever --ticks 3000 --robots 3 --seed 3";
    let hosts = [(0, "alice"), (1, "alice"), (2, "bob")];
    let mut latencies = Vec::new();
    for is_flooded in [false, true] {
        let run = with_keys();
        let (mut supervisor, gateway) = run.run(&format!("{words} --keys keys/station"));
        let start = |(id, host)| run.start(&format!("robot --id {id} --connect {gateway} --keys keys/{host}"));
        let mut robots: Vec<Process> = hosts[..2].iter().map(|robot| start(*robot)).collect();
        run.wait_for("the links", || (run.links() == 2).then_some(()));
        let flood = is_flooded.then(|| Flood::start(&run, gateway, 2..34));
        if is_flooded {
            // More than there are places: from now on the gateway has as many as it ever has.
            let counts =
                [("certificate of another authority", 250), ("no certificate", 250), ("too many handshakes", 1_000)];
            for (cause, count) in counts {
                run.wait_for(cause, || (run.refused(cause) >= count).then_some(()));
            }
        }
        let pid = run.wait_for("the gateway", || run.gateway());
        let before_kb = resident_kb(pid).unwrap();
        robots.push(start(hosts[2]));
        let mut later = (before_kb, run.refusals());
        while supervisor.is_running() {
            if let Some(later_kb) = resident_kb(pid) {
                later = (later_kb, run.refusals());
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        println!("flood: {is_flooded}, resident {before_kb} kB, later {} kB, refused {}", later.0, later.1);
        assert!(later.0 <= before_kb + FLOOD_GROWTH_KB_MAX, "{later:?}");
        supervisor.succeeds();
        drop(flood);
        robots.into_iter().for_each(Process::succeeds);
        let report = run.report();
        assert_eq!(report["ranges"]["published"], report["ranges"]["fused"]);
        assert_eq!(run.digest(), Run::digest_in_process(words));
        latencies.push(report["latency_us"].clone());
        run.assert_nothing_left();
    }
    println!("from range to heading, us: alone {}, under the flood {}", latencies[0], latencies[1]);
}

/// Growth of the gateway's memory while handshakes come and go, kB.
const FLOOD_GROWTH_KB_MAX: u64 = 4_096;

/// Strangers that are refused, some times as many as there are places; four times as many come after them.
const FIRST_STRANGERS: u64 = 1_000;

/// Growth of the gateway's memory from then on, kB: two for each stranger. A handshake under way takes about 50.
const STRANGERS_GROWTH_KB_MAX: u64 = 8 * FIRST_STRANGERS;

/// The memory that handshakes of strangers cost is bounded.
#[test]
fn handshakes_of_strangers_cost_no_memory() {
    let run = with_keys();
    // So few robots that all places are soon taken.
    let (supervisor, gateway) = run.run("--clock lockstep --timeout forever --robots 16 --keys keys/station");
    let pid = run.wait_for("the gateway", || run.gateway());
    let flood = Flood::start(&run, gateway, 2..34);
    let refused = || run.refused("certificate of another authority") + run.refused("no certificate");
    let sizes_kb = [FIRST_STRANGERS, 5 * FIRST_STRANGERS].map(|count| {
        run.wait_for("the refusals", || (refused() >= count).then_some(()));
        resident_kb(pid).unwrap()
    });
    println!("resident {sizes_kb:?} kB, refused {}", run.refusals());
    assert!(sizes_kb[1] <= sizes_kb[0] + STRANGERS_GROWTH_KB_MAX, "{sizes_kb:?}");
    drop(flood);
    run.finish_ok(&format!("stop --name {}", run.name));
    drop(supervisor);
    run.assert_nothing_left();
}

/// A stranger with one address begins more handshakes than there are places. Robots that were never here, from another address, get
/// in: half of the places are not for it.
#[test]
fn a_flood_from_one_address_keeps_no_new_robot_out() {
    let run = with_keys();
    let words = "--clock lockstep --timeout forever --ticks 200 --robots 3 --seed 3";
    let (supervisor, gateway) = run.run(&format!("{words} --keys keys/station"));
    let flood = Flood::start(&run, gateway, std::iter::repeat_n(2, 32));
    run.wait_for("the flood", || (run.refused("too many handshakes") >= 1_000).then_some(()));
    let robots = [(0, "alice"), (1, "alice"), (2, "bob")]
        .map(|(id, host)| run.start(&format!("robot --id {id} --connect {gateway} --keys keys/{host}")));
    supervisor.succeeds();
    drop(flood);
    robots.into_iter().for_each(Process::succeeds);
    assert_eq!(run.digest(), Run::digest_in_process(words));
    run.assert_nothing_left();
}

/// Handshakes of strangers, until it is dropped.
struct Flood {
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Flood {
    /// From addresses that end with these bytes.
    fn start(run: &Run, gateway: SocketAddr, lasts: impl Iterator<Item = u8> + Send + 'static) -> Self {
        let is_over = Arc::new(AtomicBool::new(false));
        let is_over_there = Arc::clone(&is_over);
        let configs = [peer::with_keys(&mixed_keys(run)), peer::without_keys()];
        let flood = async move {
            for (number, last) in lasts.enumerate() {
                let from = Ipv4Addr::new(127, 0, 0, last);
                let endpoint = quinn::Endpoint::client((from, 0).into()).unwrap();
                for _ in 0..4 {
                    let (endpoint, config) = (endpoint.clone(), configs[number % 2].clone());
                    tokio::task::spawn_local(async move {
                        loop {
                            let connecting = endpoint.connect_with(config.clone(), gateway, GATEWAY_NAME).unwrap();
                            let admitted = async { connecting.await?.accept_bi().await.map(drop) };
                            let limited = tokio::time::timeout(Duration::from_millis(500), admitted).await;
                            assert!(!matches!(limited, Ok(Ok(()))), "a stranger is admitted");
                        }
                    });
                }
            }
            while !is_over_there.load(Ordering::Relaxed) {
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
        };
        let thread = std::thread::spawn(|| link::runtime().unwrap().block_on(flood));
        Self { is_over, thread: Some(thread) }
    }
}

impl Drop for Flood {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// How often each wrong certificate is tried.
const ATTEMPTS: u64 = 100;

/// A folder with a certificate of another authority, whose host trusts the run's gateway.
fn mixed_keys(run: &Run) -> PathBuf {
    let folder = run.path("mixed");
    std::fs::create_dir_all(&folder).unwrap();
    for (from, file) in [("keys", "authority.pem"), ("other", "host.pem"), ("other", "host.key")] {
        std::fs::copy(run.path(&format!("{from}/alice/{file}")), folder.join(file)).unwrap();
    }
    folder
}

/// Makes keys of the run's authority that were valid until yesterday.
fn make_expired(run: &Run, host: Host, folder: &str) {
    let (now, day) = (SystemTime::now(), Duration::from_secs(86_400));
    let authority = Authority::load(&run.path("keys/authority")).unwrap();
    let validity = Validity { from: now - 2 * day, until: now - day };
    make(&authority, &host, validity).unwrap().save(&run.path(folder)).unwrap();
}

fn alice() -> Host {
    "alice=0,1".parse::<RobotHost>().unwrap().into()
}

fn station() -> Host {
    Host { name: "station".parse().unwrap(), role: HostRole::Gateway }
}

/// Of 100 attempts with each wrong certificate none is accepted: at the gateway's end those of robots' hosts, at the robots' end
/// those of gateways. Each robot says why in one line, and the gateway says it in one line and counts it.
#[test]
fn of_a_hundred_attempts_with_each_wrong_certificate_none_is_accepted() {
    let run = with_keys();
    mixed_keys(&run);
    make_expired(&run, alice(), "expired-alice");
    make_expired(&run, station(), "expired-station");
    let (foreign, expired) = ("certificate of another authority", "certificate expired or not valid yet");
    // The keys of gateway and robot, the robot, the name of the cause, and the line.
    let at_the_gateway = [
        ("keys/station", "mixed", 0, foreign, foreign),
        ("keys/station", "", 0, "no certificate", "no certificate"),
        ("keys/station", "expired-alice", 0, expired, expired),
        ("keys/station", "keys/alice", 2, "certificate of another robot", "certificate of alice does not name robot-"),
        ("keys/station", "keys/station", 0, "bad certificate", "bad certificate"),
    ];
    let at_the_robot = [
        ("other/station", "keys/alice", 0, foreign, foreign),
        // Without keys it has a certificate that it made itself.
        ("", "keys/alice", 0, foreign, foreign),
        ("expired-station", "keys/alice", 0, expired, expired),
    ];
    let option = |keys: &str| match keys {
        "" => String::new(),
        keys => format!("--keys {}", run.path(keys).display()),
    };
    let mut gateways: Vec<(&str, Process, SocketAddr, Run)> = Vec::new();
    for (gateway_keys, robot_keys, id, cause, line) in at_the_gateway.into_iter().chain(at_the_robot) {
        if gateways.last().is_none_or(|(keys, ..)| *keys != gateway_keys) {
            // So many robots have places for more handshakes than come in a second.
            let of_gateway = Run::new();
            let words = format!("--clock lockstep --timeout forever --robots 64 {}", option(gateway_keys));
            let (supervisor, address) = of_gateway.run(&words);
            gateways.push((gateway_keys, supervisor, address, of_gateway));
        }
        let (_, supervisor, gateway, of_gateway) = gateways.last().unwrap();
        let before = of_gateway.refused(cause);
        let began = Instant::now();
        let mut unanswered = 0;
        for _ in 0..ATTEMPTS {
            let (code, text) = run.finish(&format!("robot --id {id} --connect {gateway} {}", option(robot_keys)));
            let (no_answer, complaints): (Vec<_>, Vec<_>) = text.lines().partition(|line| line.contains("no answer"));
            assert!(code == Some(2) && complaints.len() == 1 && complaints[0].contains(line), "{robot_keys}: {text}");
            // On a busy machine an attempt may end before its refusal.
            unanswered += no_answer.len() as u64;
        }
        let count = of_gateway
            .wait_for("the count", || Some(of_gateway.refused(cause) - before).filter(|count| *count >= ATTEMPTS));
        assert!(count <= ATTEMPTS + unanswered, "{robot_keys}: {count}");
        let lines = supervisor.stderr().lines().filter(|text| text.contains(line)).count() as u64;
        // A line is written again after ten seconds.
        assert!((1..=1 + began.elapsed().as_secs() / 10).contains(&lines), "{}", supervisor.stderr());
        assert_eq!((of_gateway.links(), of_gateway.tick()), (0, 0));
    }
    for (_, supervisor, _, of_gateway) in gateways {
        of_gateway.finish_ok(&format!("stop --name {}", of_gateway.name));
        drop(supervisor);
        of_gateway.assert_nothing_left();
    }
}

/// The keys of a host are replaced while its processes run: they read them again. Keys that cannot be read are not used.
#[test]
fn renewed_keys_are_read_again_by_gateway_and_robot() {
    let run = with_keys();
    let words = "--clock lockstep --timeout forever --ticks 1000000 --robots 1";
    let (supervisor, gateway) = run.run(&format!("{words} --keys keys/station"));
    let link = Link::new(gateway, 3, Faults::default());
    let mut robot = run.start(&format!("robot --id 0 --connect {} --keys keys/alice", link.address));
    run.wait_until_tick(20);
    let open_link_again = || {
        link.cut(true, true);
        std::thread::sleep(Duration::from_millis(800));
        link.cut(false, false);
    };
    let goes_on = || {
        let tick = run.tick();
        run.wait_until_tick(tick + 20);
    };
    let renew = |host: Host, path: &str| {
        let authority = Authority::load(&run.path("keys/authority")).unwrap();
        std::fs::remove_dir_all(run.path(path)).unwrap();
        make(&authority, &host, Validity::of_days(1).unwrap()).unwrap().save(&run.path(path)).unwrap();
    };
    for (host, path) in [(alice(), "keys/alice"), (station(), "keys/station")] {
        // Its certificate expires. The link that is open stays.
        std::fs::remove_dir_all(run.path(path)).unwrap();
        make_expired(&run, host.clone(), path);
        goes_on();
        let refusals = || robot.stderr().matches("certificate expired").count();
        let before = refusals();
        open_link_again();
        run.wait_for("the refusal", || (refusals() > before).then_some(()));
        assert!(robot.is_running());
        renew(host.clone(), path);
        goes_on();
        // Files that cannot be read are not used, and each end reports it once.
        std::fs::write(run.path(path).join("host.pem"), "no certificate").unwrap();
        open_link_again();
        goes_on();
        renew(host, path);
    }
    for text in [robot.stderr(), supervisor.stderr()] {
        let bad: Vec<&str> = text.lines().filter(|line| line.contains("the old keys stay in use")).collect();
        assert!(!bad.is_empty() && bad.iter().any(|line| line.contains("host.pem")), "{text}");
    }
    run.finish_ok(&format!("stop --name {}", run.name));
    drop(supervisor);
    robot.succeeds();
    run.assert_nothing_left();
}

/// Its link is cut during the handshake: nobody has refused it.
#[test]
fn a_peer_that_goes_away_is_no_refusal() {
    let run = Run::new();
    let (supervisor, gateway) = run.run("--clock lockstep --timeout forever --robots 1");
    let link = Link::new(gateway, 3, Faults::default());
    link.cut(false, true);
    let robot = run.robot(0, link.address);
    run.wait_for("its message", || robot.stderr().contains("no answer").then_some(()));
    robot.kill();
    // The gateway gives up a handshake after three seconds, and writes its note each half second.
    std::thread::sleep(Duration::from_millis(4_000));
    let refusals = run.wait_for("the note", || Some(run.status()?["gateway"]["refusals"].as_object()?.len()));
    assert_eq!(refusals, 0, "{:?}", run.status());
    run.finish_ok(&format!("stop --name {}", run.name));
    drop(supervisor);
}

/// The places of handshakes count for a while after a stranger has gone, because they have cost as much.
#[test]
fn strangers_that_go_away_at_once_run_out_of_places() {
    let run = Run::new();
    let (supervisor, gateway) = run.run("--clock lockstep --timeout forever --robots 1");
    let strangers = async {
        while run.refused("too many handshakes") == 0 {
            let connecting = Peer::connect(gateway, Ipv4Addr::LOCALHOST.into(), peer::without_keys());
            // It closes its connection; without a place there is no answer.
            let _ = tokio::time::timeout(Duration::from_millis(200), connecting).await;
        }
    };
    let limited = async { tokio::time::timeout(LIMIT, strangers).await };
    link::runtime().unwrap().block_on(limited).expect("the places run out");
    run.finish_ok(&format!("stop --name {}", run.name));
    drop(supervisor);
}

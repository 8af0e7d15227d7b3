//! Peers that have a certificate, or that are at least admitted, and misbehave: what they send is refused, counted by cause, and
//! costs no memory.

use std::fs::File;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::time::{Duration, Instant};

use quinn::ConnectionError;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rangehound_gateway::link::{self, Answer, Notice, Request};
use rangehound_node::bus::{Bus, Subscriber};
use rangehound_node::rendezvous::{Rendezvous, RunDescription};
use rangehound_robot::remote::wire::{
    Downlink, Driven, FRAME_LEN_MAX, FRAME_VERSION, MEASUREMENTS_MAX, Measured, Uplink,
};
use rangehound_shared::measurement::{Measurement, Pose};
use rangehound_shared::message::{Drive, Range};
use rangehound_shared::protocol::PROTOCOL;
use tokio::task::JoinSet;

use crate::peer::{self, Peer, request};
use crate::security::with_keys;
use crate::support::{LIMIT, Process, Run, resident_kb};

const LOCALHOST: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);

/// Hostile frames of each kind, at least.
const EACH: u64 = 1_000;

/// Frames of each kind before and after which the gateway's memory is compared: more than enough for it to reach its final size.
const MANY: u64 = 10_000;

/// Growth of the gateway's memory that is not one by frame, kB: the allocator's.
const GROWTH_KB_MAX: u64 = 512;

/// Runs a test's peers in this thread, with a limit.
fn block_on<T>(test: impl Future<Output = T>) -> T {
    let limited = async { tokio::time::timeout(LIMIT, test).await.unwrap() };
    link::runtime().unwrap().block_on(limited)
}

/// A frame that is good, but of a tick that has not come: fusion refuses its range.
fn of_the_future(run_id: u64) -> Uplink {
    let (tick, valid_at_s) = (50, 5.0);
    let measurement = Measurement::new(Pose::at([1.0, 2.0]), Some((5.0, 1.0)));
    Uplink { run_id, echo: None, measured: vec![Measured { tick, valid_at_s, measurement }], driven: None }
}

/// A kind of hostile frames: its name, the cause for which the gateway counts it, and how one is made.
type Kind = (&'static str, &'static str, Box<dyn Fn(&mut ChaCha8Rng) -> Vec<u8>>);

fn kinds(run_id: u64, frame_len_max: usize) -> Vec<Kind> {
    let good = of_the_future(run_id);
    let bytes = good.to_bytes();
    let noise = |random: &mut ChaCha8Rng, len: usize| (0..len).map(|_| random.random()).collect::<Vec<u8>>();
    let (cut, longer) = (bytes.clone(), bytes.clone());
    let frame = |change: &dyn Fn(&mut Uplink)| {
        let mut frame = good.clone();
        change(&mut frame);
        let bytes = frame.to_bytes();
        assert!(!bytes.is_empty() && bytes.len() <= FRAME_LEN_MAX);
        move |_: &mut ChaCha8Rng| bytes.clone()
    };
    let driven = Driven { tick: u64::MAX, ..Driven::default() };
    vec![
        (
            "random",
            "damaged frame",
            Box::new(move |random| {
                let len = random.random_range(0..FRAME_LEN_MAX);
                [&[FRAME_VERSION][..], &noise(random, len)].concat()
            }),
        ),
        ("cut", "damaged frame", Box::new(move |random| cut[..random.random_range(0..cut.len())].to_vec())),
        ("longer", "damaged frame", Box::new(move |random| [&longer[..], &noise(random, 8)].concat())),
        (
            "other version",
            "frame of another version",
            Box::new(move |random| {
                let version = FRAME_VERSION.wrapping_add(random.random_range(1..=u8::MAX));
                let len = random.random_range(0..8);
                [&[version][..], &bytes[1..], &noise(random, len)].concat()
            }),
        ),
        ("other run", "frame of another run", Box::new(frame(&|frame| frame.run_id ^= 1))),
        (
            "oversized",
            "frame too long",
            Box::new(move |random| {
                let len = random.random_range(FRAME_LEN_MAX + 1..=frame_len_max);
                noise(random, len)
            }),
        ),
        (
            "too many measurements",
            "frame with too many measurements",
            Box::new(frame(&|frame| frame.measured = vec![frame.measured[0]; MEASUREMENTS_MAX + 1])),
        ),
        (
            "measured after the end",
            "frame of a tick after the last one",
            Box::new(frame(&|frame| frame.measured[0].tick = 101)),
        ),
        (
            "driven after the end",
            "frame of a tick after the last one",
            Box::new(frame(&|frame| frame.driven = Some(driven))),
        ),
    ]
}

/// A robot with a good certificate sends 1 000 and more frames of each bad kind, and one good frame again and again.
#[test]
fn hostile_frames_of_a_certified_robot_are_refused_by_cause_and_cost_no_memory() {
    let run = with_keys();
    let words = "--clock lockstep --timeout forever --ticks 100 --robots 3 --seed 3";
    let (supervisor, gateway) = run.run(&format!("{words} --keys keys/station"));
    let pid = run.wait_for("the gateway", || run.gateway());
    let observer = Observer::of(&run);
    block_on(async {
        let mut robot = Hostile::join(gateway, peer::with_keys(&run.path("keys/alice"))).await;
        let began = Instant::now();
        let kinds = kinds(robot.run_id, robot.peer.connection.max_datagram_size().unwrap());
        let mut random = ChaCha8Rng::seed_from_u64(1);
        // The first good frame counts, and none of its repeats.
        let good = of_the_future(robot.run_id).to_bytes();
        while observer.published() == [0, 0] {
            robot.send_all(1, || good.clone()).await;
        }
        let mut sizes_kb = Vec::new();
        for at_least in [EACH, MANY, MANY] {
            let links_before = robot.links;
            for (_, cause, make) in &kinds {
                let goal = run.refused(cause) + at_least;
                while run.refused(cause) < goal {
                    robot.send_all(500, || make(&mut random)).await;
                }
            }
            robot.send_all(at_least, || good.clone()).await;
            // Frames are read in the order in which they were sent.
            let before = run.refused("damaged frame");
            while run.refused("damaged frame") == before {
                robot.send_all(1, Vec::new).await;
            }
            let [ranges, drives] = observer.published();
            // Of a new link one good frame counts.
            assert!(ranges <= robot.links - links_before && drives == 0, "{ranges} {drives}");
            sizes_kb.push(resident_kb(pid).unwrap());
        }
        println!("{:?}, resident {sizes_kb:?} kB", run.refusals());
        assert!(sizes_kb[2] <= sizes_kb[1] + GROWTH_KB_MAX, "{sizes_kb:?}");
        let lines = supervisor.stderr();
        let of_frames: Vec<&str> = lines.lines().filter(|line| line.contains("invalid frame for robot-1")).collect();
        assert!(
            of_frames.iter().all(|line| line.starts_with("rangehound: 127.0.0.1 sends an invalid frame")),
            "{lines}"
        );
        // One line for each cause, again after ten seconds.
        let of_version = of_frames.iter().filter(|line| line.contains("a frame of another version (protocol "));
        assert!((1..=1 + began.elapsed().as_secs() / 10).contains(&(of_version.count() as u64)), "{lines}");
        link::write(&mut robot.peer.send, &Notice::Leaving).await.unwrap();
        robot.peer.connection.closed().await;
    });
    drop(observer);
    // Whatever it sent, the run is that of the honest robots.
    let robots = [(0, "alice"), (1, "alice"), (2, "bob")]
        .map(|(id, host)| run.start(&format!("robot --id {id} --connect {gateway} --keys keys/{host}")));
    supervisor.succeeds();
    robots.into_iter().for_each(Process::succeeds);
    let report = run.report();
    assert_eq!(report["ranges"]["published"], report["ranges"]["fused"]);
    assert_eq!(run.digest(), Run::digest_in_process(words));
    run.assert_nothing_left();
}

/// Robot 1, which has joined and sends what it likes.
struct Hostile {
    gateway: SocketAddr,
    config: quinn::ClientConfig,
    request: Request,
    run_id: u64,
    peer: Peer,
    links: usize,
}

impl Hostile {
    async fn join(gateway: SocketAddr, config: quinn::ClientConfig) -> Self {
        let request = request(1);
        let (peer, run_id) = Self::open(gateway, &config, &request).await.unwrap();
        Self { gateway, config, request, run_id, peer, links: 1 }
    }

    /// An open link, and the run's id.
    async fn open(gateway: SocketAddr, config: &quinn::ClientConfig, request: &Request) -> Option<(Peer, u64)> {
        let mut peer = Peer::connect(gateway, LOCALHOST, config.clone()).await.ok()?;
        let Ok(Answer::Welcome { description, .. }) = peer.ask(request).await else { return None };
        Some((peer, RunDescription::open(description.as_bytes()).unwrap().run_id))
    }

    /// On a busy machine its link may be lost: then it opens another one.
    async fn send(&mut self, bytes: Vec<u8>) {
        while self.peer.connection.send_datagram_wait(bytes.clone().into()).await.is_err() {
            if let Some((peer, _)) = Self::open(self.gateway, &self.config, &self.request).await {
                self.peer = peer;
                self.links += 1;
            }
        }
    }

    /// Sends so many frames, not faster than the gateway reads. Bad ones alone do not keep a link.
    async fn send_all(&mut self, count: u64, mut make: impl FnMut() -> Vec<u8>) {
        let alive = Uplink { measured: Vec::new(), ..of_the_future(self.run_id) }.to_bytes();
        for number in 0..count {
            self.send(make()).await;
            if number % 40 == 0 {
                self.send(alive.clone()).await;
                tokio::time::sleep(Duration::from_millis(2)).await;
            }
        }
    }
}

/// The samples of robot 1 that the gateway publishes, as every process of the run's host can see it.
struct Observer {
    ranges: Subscriber<Range>,
    drives: Subscriber<Drive>,
    _bus: Bus,
    _rendezvous: Rendezvous,
}

impl Observer {
    fn of(run: &Run) -> Self {
        let rendezvous = Rendezvous::join_if_alive(&run.name.parse().unwrap()).unwrap().unwrap().observe();
        let bus = Bus::connect(&rendezvous, "observer").unwrap();
        Self {
            ranges: bus.subscriber().unwrap(),
            drives: bus.subscriber().unwrap(),
            _bus: bus,
            _rendezvous: rendezvous,
        }
    }

    /// Ranges and drives since the last call.
    fn published(&self) -> [usize; 2] {
        let mut counts = [0, 0];
        self.ranges.drain(|_, ranges| counts[0] += ranges.iter().filter(|range| range.robot == 1).count()).unwrap();
        self.drives.drain(|_, drives| counts[1] += drives.iter().filter(|drive| drive.robot == 1).count()).unwrap();
        counts
    }
}

/// Growth of the gateway's memory over 5 000 requests, kB: the number of handshakes under way changes.
const REQUESTS_GROWTH_KB_MAX: u64 = 2_048;

/// Requests that are open at the same time.
const AT_ONCE: usize = 20;

/// Sends these bytes as a request to join. Returns the reason why it is refused; `None` if time ran out on a busy machine.
async fn read_refusal(gateway: SocketAddr, config: quinn::ClientConfig, bytes: Vec<u8>) -> Option<String> {
    let mut peer = Peer::connect(gateway, LOCALHOST, config).await.unwrap();
    // The gateway may refuse it before all is sent.
    let _ = peer.send.write_all(&bytes).await;
    let _ = peer.send.finish();
    let answer = link::read::<Answer>(&mut peer.receive, None).await;
    match (answer, peer.connection.closed().await) {
        (Ok(Answer::Refused { text, .. }), _) => Some(text),
        (Err(_), ConnectionError::ApplicationClosed(closed)) if closed.error_code == link::REFUSED => {
            Some(String::from_utf8(closed.reason.to_vec()).unwrap())
        }
        (Err(_), ConnectionError::ApplicationClosed(_)) => None,
        (Err(_), ConnectionError::Reset | ConnectionError::TimedOut | ConnectionError::ConnectionClosed(_)) => None,
        other => panic!("not refused: {other:?}"),
    }
}

/// Requests to join, 1 000 of each kind and each over a link of its own, are refused by cause. Both ends know why.
#[test]
fn hostile_requests_are_refused_by_cause_and_cost_no_memory() {
    let run = with_keys();
    // So many robots have places for more handshakes than come in a second.
    let (supervisor, gateway) = run.run("--clock lockstep --timeout forever --robots 64 --keys keys/station");
    let pid = run.wait_for("the gateway", || run.gateway());
    let config = peer::with_keys(&run.path("keys/alice"));
    let good = serde_json::to_vec(&request(0)).unwrap();
    let framed = |text: &[u8]| [&u32::try_from(text.len()).unwrap().to_le_bytes()[..], text].concat();
    let changed = |change: &dyn Fn(&mut Request)| {
        let mut request = request(0);
        change(&mut request);
        framed(&serde_json::to_vec(&request).unwrap())
    };
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut noise = |len: usize| (0..len).map(|_| random.random()).collect::<Vec<u8>>();
    let versions = format!("(protocol {}), the run's host has", PROTOCOL + 1);
    // The bytes sent, the cause that is counted, and a part of the reason that the robot reads.
    let kinds: [(Vec<u8>, &str, &str); 5] = [
        (framed(&noise(200)), "other", "not a message of rangehound"),
        (framed(&good)[..good.len() / 2].to_vec(), "other", "a message that is cut"),
        (changed(&|request| request.protocol += 1), "another version", &versions),
        (changed(&|request| request.run = Some("another".to_owned())), "another run", "this is the gateway of run"),
        ([&u32::MAX.to_le_bytes()[..], &noise(8_000)].concat(), "other", "at most 4096 are allowed"),
    ];
    let mut sizes_kb = Vec::new();
    // The second time all of them find the memory that they need.
    for (bytes, cause, reason) in kinds.iter().chain(&kinds) {
        let before = run.refused(cause);
        block_on(async {
            let mut asking = JoinSet::new();
            let mut refused_count = 0;
            while refused_count < EACH {
                while asking.len() < AT_ONCE {
                    asking.spawn_local(read_refusal(gateway, config.clone(), bytes.clone()));
                }
                if let Some(text) = asking.join_next().await.unwrap().unwrap() {
                    assert!(text.contains(reason), "{cause}: {text}");
                    refused_count += 1;
                }
            }
        });
        run.wait_for("the count", || (run.refused(cause) >= before + EACH).then_some(()));
        sizes_kb.push(resident_kb(pid).unwrap());
    }
    println!("{}, resident {sizes_kb:?} kB", run.refusals());
    assert!(sizes_kb[9] <= sizes_kb[4] + REQUESTS_GROWTH_KB_MAX, "{sizes_kb:?}");
    assert_eq!((run.links(), run.tick()), (0, 0));
    run.finish_ok(&format!("stop --name {}", run.name));
    drop(supervisor);
    run.assert_nothing_left();
}

/// Each notice of a robot is read, not only the first.
#[test]
fn a_robot_that_has_sent_another_notice_before_leaves_in_order() {
    let run = Run::new();
    let (supervisor, gateway) = run.run("--clock lockstep --timeout forever --robots 1");
    block_on(async {
        let mut peer = Peer::connect(gateway, LOCALHOST, peer::without_keys()).await.unwrap();
        assert!(matches!(peer.ask(&request(0)).await, Ok(Answer::Welcome { .. })));
        for notice in [Notice::End, Notice::Kill, Notice::Leaving] {
            link::write(&mut peer.send, &notice).await.unwrap();
        }
        peer.connection.closed().await;
    });
    let gone = run.wait_for("its end", || {
        supervisor.stderr().lines().find(|line| line.contains("robot-0 of 127.0.0.1")).map(str::to_owned)
    });
    assert!(gone.ends_with("has left"), "{gone}");
    run.finish_ok(&format!("stop --name {}", run.name));
    drop(supervisor);
    run.assert_nothing_left();
}

/// A process that is suspended holds the membership lock: a robot that asks for a free role waits for it, and no other robot does.
#[test]
fn a_robot_that_asks_for_a_role_delays_no_other() {
    let run = Run::new();
    let (supervisor, gateway) = run.run("--clock lockstep --timeout forever --ticks 100 --robots 2");
    let lock = block_on(async {
        let mut first = Peer::connect(gateway, LOCALHOST, peer::without_keys()).await.unwrap();
        let Ok(Answer::Welcome { description, .. }) = first.ask(&request(0)).await else { panic!("not welcome") };
        let run_id = RunDescription::open(description.as_bytes()).unwrap().run_id;
        let alive = Uplink { measured: Vec::new(), ..of_the_future(run_id) }.to_bytes();
        // It answers each frame of the gateway, as a robot does.
        let exchange = async || {
            let frame = first.connection.read_datagram().await.unwrap();
            assert!(Downlink::from_bytes(&frame, run_id).is_ok());
            first.connection.send_datagram(alive.clone().into()).unwrap();
        };
        exchange().await;
        // Commands that look at the run would wait for the lock from now on.
        let lock = File::open(run.shared_folder().join("membership.lock")).unwrap();
        lock.lock().unwrap();
        let mut second = Peer::connect(gateway, LOCALHOST, peer::without_keys()).await.unwrap();
        link::write(&mut second.send, &request(1)).await.unwrap();
        let has_asked = tokio::time::sleep(Duration::from_millis(500));
        tokio::pin!(has_asked);
        loop {
            tokio::select! {
                () = exchange() => {}
                () = &mut has_asked => break,
            }
        }
        for _ in 0..10 {
            exchange().await;
        }
        let answer = link::read::<Answer>(&mut second.receive, None);
        let answer = tokio::time::timeout(Duration::from_millis(1), answer).await;
        assert!(!matches!(answer, Ok(Ok(_))), "it is answered before the others have their frames: {answer:?}");
        lock
    });
    drop(lock);
    // Both roles can be had again.
    let robots = [0, 1].map(|id| run.robot(id, gateway));
    supervisor.succeeds();
    robots.into_iter().for_each(Process::succeeds);
    run.assert_nothing_left();
}

//! The link of a robot to its gateway: opened until it succeeds, watched, and opened again.

use std::net::SocketAddr;
use std::path::Path;
use std::time::Duration;

use quinn::{ClientConfig, Connection, ConnectionError, Endpoint, RecvStream, SendStream, VarInt};
use rangehound_node::rendezvous::RunDescription;
use rangehound_node::system::clock::monotonic_ns;
use rangehound_shared::protocol::{PROGRAM, PROTOCOL};
use tokio::task::{JoinHandle, JoinSet};
use tokio::time::{Instant, timeout};

use super::{RobotError, Target};
use crate::keys::{Credentials, GATEWAY_NAME, RefusalCause, Reloaded};
use crate::link::{self, Answer, Notice, Request};

/// Time for one attempt to connect and to join. A handshake that takes longer goes on beside those of the next attempts: over a
/// slow link it needs the time, and after a cut a new one is there sooner.
const ATTEMPT_MAX: Duration = Duration::from_millis(800);

/// Round trips for which a robot that has connected waits for the answer, at least.
const JOIN_ROUND_TRIPS: u32 = 3;

/// Time between two attempts.
const RETRY_DELAY: Duration = Duration::from_millis(100);

/// Time until the next attempt of a robot that does not fit the run.
const MISFIT_RETRY_DELAY: Duration = Duration::from_secs(1);

/// Time in which a robot that leaves must reach the gateway.
const CLOSING_MAX: Duration = Duration::from_millis(500);

/// An event at the link.
pub(super) enum LinkEvent {
    /// The robot has joined.
    Joined(Box<Session>),
    /// The gateway refused it.
    Refused(Refusal),
    /// No gateway answered.
    Unreachable(String),
    /// A frame came.
    Frame(Vec<u8>),
    /// The gateway says that the run is over, or that this process is to end.
    Noticed(Notice),
    /// The gateway answers that the run in which this robot took part is over. The connection is closed, and its last packet may
    /// not be sent yet.
    Finished(Endpoint),
    /// The connection has ended.
    Ended,
    /// Time is up.
    Nothing,
}

/// Why a gateway does not take a robot.
#[derive(Debug)]
pub struct Refusal {
    /// The reason.
    pub text: String,
    /// True if it may take it later.
    pub may_change: bool,
}

/// Makes the configuration of a robot's host of a folder of keys.
type ConfigOf = fn(Option<&Path>) -> Result<ClientConfig, RobotError>;

/// Handshakes that have begun, each with a socket of its own. QUIC ends those that nobody answers.
type Handshakes = JoinSet<(Endpoint, Result<Connection, ConnectionError>)>;

/// Opens links.
pub(super) struct Connector {
    target: Target,
    config: Reloaded<ClientConfig, ConfigOf>,
    robot: usize,
    process: u64,
    attempt: Option<JoinHandle<(LinkEvent, Handshakes)>>,
    /// Those of earlier attempts.
    handshakes: Handshakes,
    reported: Option<String>,
    /// The id of the last run that it has joined.
    took_part_in: Option<u64>,
}

/// An open link of a robot that has joined.
pub(super) struct Session {
    endpoint: Endpoint,
    connection: Connection,
    send: SendStream,
    notice: JoinHandle<Option<Notice>>,
    /// The notice was taken: the task must not be asked again.
    is_noticed: bool,
    /// When it joined, ns.
    pub(super) joined_ns: u64,
    /// The run.
    pub(super) description: RunDescription,
    /// Its life: a resumed run has another one.
    pub(super) life: u64,
    /// How often the lead had been taken.
    pub(super) fusion_incarnation: u64,
}

impl Connector {
    pub(super) fn new(target: Target, robot: usize) -> Result<Self, RobotError> {
        let config = Reloaded::new(target.keys.clone(), config_of as ConfigOf)?;
        let process = rand::random();
        let handshakes = Handshakes::new();
        Ok(Self { target, config, robot, process, attempt: None, handshakes, reported: None, took_part_in: None })
    }

    pub(super) fn is_idle(&self) -> bool {
        self.attempt.is_none()
    }

    /// Begins to open a link.
    pub(super) fn open(&mut self) {
        let request = Request {
            protocol: PROTOCOL,
            program: PROGRAM.to_owned(),
            robot: self.robot,
            process: self.process,
            run: self.target.run.clone(),
            allows_control: self.target.allows_control,
            took_part_in: self.took_part_in,
        };
        let (target, config) = (self.target.clone(), self.config.present().clone());
        let mut handshakes = std::mem::take(&mut self.handshakes);
        self.attempt = Some(tokio::task::spawn_local(async move {
            // The system has a limit of its own for names: a slow server of names must not keep the robot out.
            let happened = match resolve(&target).await {
                Ok(address) => open(&target, address, config, &request, &mut handshakes).await,
                Err(reason) => LinkEvent::Unreachable(reason),
            };
            if !matches!(happened, LinkEvent::Joined(_)) {
                tokio::time::sleep(RETRY_DELAY).await;
            }
            (happened, handshakes)
        }));
    }

    /// The end of an attempt, or nothing after this time.
    pub(super) async fn next(&mut self, wait: Duration) -> LinkEvent {
        if self.is_idle() {
            self.open();
        }
        let Some(attempt) = &mut self.attempt else { return LinkEvent::Nothing };
        match timeout(wait, attempt).await {
            Err(_) => LinkEvent::Nothing,
            Ok(ended) => {
                self.attempt = None;
                match ended {
                    Ok((happened, handshakes)) => {
                        self.handshakes = handshakes;
                        happened
                    }
                    Err(error) => LinkEvent::Unreachable(error.to_string()),
                }
            }
        }
    }

    /// Lets the attempt that has just succeeded count as refused. The next one follows some time later.
    pub(super) fn refuse(&mut self, refusal: Refusal) {
        self.attempt = Some(tokio::task::spawn_local(async move {
            tokio::time::sleep(MISFIT_RETRY_DELAY).await;
            (LinkEvent::Refused(refusal), Handshakes::new())
        }));
    }

    /// Reports that the robot takes part. A link that is opened again is worth a line only if there was one about its end.
    pub(super) fn report_joined(&mut self, run_id: u64) {
        let is_first = self.took_part_in.replace(run_id).is_none();
        if self.reported.take().is_some() || is_first {
            log::info!("robot-{} has joined the run through {}", self.robot, self.target.gateway);
        }
    }

    /// Reports why the robot has no link, once for each reason.
    pub(super) fn report(&mut self, reason: &str) {
        if self.reported.as_deref() != Some(reason) {
            log::warn!("no link to the gateway at {}: {reason}; trying again", self.target.gateway);
            self.reported = Some(reason.to_owned());
        }
    }
}

fn config_of(keys: Option<&Path>) -> Result<ClientConfig, RobotError> {
    let tls = match keys {
        Some(folder) => Credentials::load(folder)?.client_config()?,
        None => Credentials::for_loopback_client()?,
    };
    link::client(tls).map_err(|error| RobotError::Cryptography(error.to_string()))
}

/// The gateway's address, or why there is none.
async fn resolve(target: &Target) -> Result<SocketAddr, String> {
    let mut found = tokio::net::lookup_host(&target.gateway).await.map_err(|error| error.to_string())?;
    found.next().ok_or_else(|| "it has no address".to_owned())
}

/// Connects and joins: begins a handshake, and goes on with the first one that succeeds.
async fn open(
    target: &Target,
    address: SocketAddr,
    config: ClientConfig,
    request: &Request,
    handshakes: &mut Handshakes,
) -> LinkEvent {
    if target.keys.is_none() && !address.ip().is_loopback() {
        let text = format!("{address} is another host: --keys is missing (`rangehound keys` makes them)");
        return LinkEvent::Refused(Refusal { text, may_change: false });
    }
    let ends = Instant::now() + ATTEMPT_MAX;
    if let Err(reason) = begin(address, config, handshakes) {
        return LinkEvent::Unreachable(reason);
    }
    let no_answer = || LinkEvent::Unreachable("no answer".to_owned());
    let (endpoint, connection) = match tokio::time::timeout_at(ends, first(handshakes)).await {
        Ok((endpoint, Ok(connection))) => (endpoint, connection),
        Ok((_, Err(error))) => return refused_or_unreachable(&error),
        Err(_) => return no_answer(),
    };
    *handshakes = Handshakes::new();
    let ends = ends.max(Instant::now() + JOIN_ROUND_TRIPS * connection.rtt());
    let joined = async {
        match join(endpoint, &connection, request).await {
            Some(happened) => happened,
            // In TLS 1.3 the gateway checks the robot's certificate after the robot has connected.
            None => refused_or_unreachable(&connection.closed().await),
        }
    };
    tokio::time::timeout_at(ends, joined).await.unwrap_or_else(|_| no_answer())
}

/// Begins a handshake, from a socket of its own: the host may have got other addresses since the last one.
fn begin(address: SocketAddr, config: ClientConfig, handshakes: &mut Handshakes) -> Result<(), String> {
    let endpoint = Endpoint::client(link::any_address_for(address)).map_err(|error| error.to_string())?;
    let connecting = endpoint.connect_with(config, address, GATEWAY_NAME).map_err(|error| error.to_string())?;
    handshakes.spawn_local(async move { (endpoint, connecting.await) });
    Ok(())
}

/// The first handshake that ends. That nobody answered an earlier one is no news.
async fn first(handshakes: &mut Handshakes) -> (Endpoint, Result<Connection, ConnectionError>) {
    while let Some(ended) = handshakes.join_next().await {
        match ended {
            Ok((_, Err(ConnectionError::TimedOut))) | Err(_) => {}
            Ok(ended) => return ended,
        }
    }
    std::future::pending().await
}

fn refused_or_unreachable(error: &ConnectionError) -> LinkEvent {
    match (RefusalCause::of_connection_error(error), error) {
        (Some(cause), _) => LinkEvent::Refused(Refusal { text: cause.name().to_owned(), may_change: false }),
        (None, ConnectionError::ApplicationClosed(closed)) if closed.error_code == link::REFUSED => {
            let text = String::from_utf8_lossy(&closed.reason).into_owned();
            LinkEvent::Refused(Refusal { text, may_change: true })
        }
        (None, error) => LinkEvent::Unreachable(error.to_string()),
    }
}

/// Asks for the role. `None` if the connection has ended.
async fn join(endpoint: Endpoint, connection: &Connection, request: &Request) -> Option<LinkEvent> {
    let (mut send, mut receive) = connection.open_bi().await.ok()?;
    link::write(&mut send, request).await.ok()?;
    let answer = match link::read::<Answer>(&mut receive, None).await {
        Ok(answer) => answer,
        Err(link::JoinError::Ended | link::JoinError::Cut) => return None,
        Err(error) => return Some(LinkEvent::Refused(Refusal { text: error.to_string(), may_change: false })),
    };
    match answer {
        Answer::Refused { text, may_change } => {
            connection.close(link::LEFT, b"refused");
            Some(LinkEvent::Refused(Refusal { text, may_change }))
        }
        Answer::Finished => {
            connection.close(link::LEFT, b"the run is over");
            Some(LinkEvent::Finished(endpoint))
        }
        Answer::Welcome { description, life, fusion_incarnation } => {
            let description = match RunDescription::open(description.as_bytes()) {
                Ok(description) => description,
                Err(error) => {
                    return Some(LinkEvent::Refused(Refusal { text: error.to_string(), may_change: false }));
                }
            };
            let notice = tokio::task::spawn_local(notice_of(receive));
            let connection = connection.clone();
            let joined_ns = monotonic_ns();
            Some(LinkEvent::Joined(Box::new(Session {
                endpoint,
                connection,
                send,
                notice,
                is_noticed: false,
                joined_ns,
                description,
                life,
                fusion_incarnation,
            })))
        }
    }
}

/// Sends the last packets of connections that are closed.
pub(super) async fn flush(endpoint: &Endpoint) {
    let _ = timeout(CLOSING_MAX, endpoint.wait_idle()).await;
}

async fn notice_of(mut receive: RecvStream) -> Option<Notice> {
    link::read(&mut receive, Some(link::REQUEST_LEN_MAX)).await.ok()
}

impl Session {
    /// The next event, or none after this time.
    pub(super) async fn next(&mut self, wait: Duration) -> LinkEvent {
        let Self { connection, notice, is_noticed, .. } = self;
        let received = tokio::select! {
            frame = connection.read_datagram() => match frame {
                Ok(bytes) => return LinkEvent::Frame(bytes.into()),
                Err(_) if *is_noticed => None,
                // A notice may have come with the end.
                Err(_) => timeout(CLOSING_MAX, notice).await.ok(),
            },
            ended = &mut *notice, if !*is_noticed => Some(ended),
            () = tokio::time::sleep(wait) => return LinkEvent::Nothing,
        };
        *is_noticed = true;
        match received {
            Some(Ok(Some(notice))) => LinkEvent::Noticed(notice),
            _ => LinkEvent::Ended,
        }
    }

    /// The round trip of the link, ns.
    pub(super) fn round_trip_ns(&self) -> u64 {
        link::round_trip_ns(&self.connection)
    }

    /// Sends a frame. A datagram that cannot be sent counts as lost.
    pub(super) fn send(&self, frame: Vec<u8>) {
        let _ = self.connection.send_datagram(frame.into());
    }

    pub(super) fn close(&self, code: VarInt, reason: &str) {
        self.notice.abort();
        self.connection.close(code, reason.as_bytes());
    }

    /// Sends its last message, and waits for some time until the gateway has it.
    pub(super) async fn send_last(&mut self, notice: Notice) {
        let sending = async {
            if link::write(&mut self.send, &notice).await.is_ok() {
                let _ = self.send.finish();
                let _ = self.send.stopped().await;
            }
        };
        let _ = timeout(CLOSING_MAX, sending).await;
    }

    /// Leaves in order: the gateway frees the role.
    pub(super) async fn leave(mut self) {
        self.notice.abort();
        self.send_last(Notice::Leaving).await;
        self.connection.close(link::LEFT, b"the robot has left");
        flush(&self.endpoint).await;
    }
}

//! The gateway's process: it takes the roles of the robots that connect to it, and relays their messages.
//!
//! It has no state that could be lost: a gateway that is started again learns everything from the robots and the bus.

mod acceptor;
mod handshakes;
mod refusals;
mod remote_robots;

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::net::{SocketAddr, UdpSocket};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use rangehound_node::bus::{self, BusError, Event, Events, IDLE, WaitGroup};
use rangehound_node::rendezvous::{Rendezvous, RendezvousError, Role, RoleLease};
use rangehound_node::system::clock::{monotonic_ns, until};
use rangehound_node::system::signal::Termination;
use tokio::sync::mpsc::{self, Receiver, Sender};
use tokio::sync::watch;

use crate::keys::{Credentials, KeysError, Reloaded};
use crate::link::{self, Answer};
use acceptor::{Acceptor, Applicant};
use handshakes::Handshakes;
use refusals::Refusals;
use remote_robots::RemoteRobots;

/// Inputs that wait for the gateway. Whoever has a further one waits in turn.
const INPUTS_MAX: usize = 256;

/// Longest sleep.
const LONGEST_SLEEP: Duration = Duration::from_millis(50);

/// Longest time for which the end of the run is announced to the robots: one whose link is lost needs it to connect again.
const INFORMING_MAX: Duration = Duration::from_secs(5);

/// Longest time for which the packets that close the connections are sent.
const CLOSING_MAX: Duration = Duration::from_secs(2);

/// Why a gateway ended early.
#[derive(Debug, thiserror::Error)]
pub enum GatewayError {
    /// It cannot take part in the run.
    #[error(transparent)]
    Rendezvous(#[from] RendezvousError),
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// Its keys cannot be used.
    #[error(transparent)]
    Keys(#[from] KeysError),
    /// Without keys it must not be reached from other hosts.
    #[error("--listen {0} can be reached from other hosts: --keys is missing (`rangehound keys` makes them)")]
    Open(SocketAddr),
    /// The gateway's host is named as a robot's.
    #[error("--keys has the keys of {0}, a host of robots: expected those of a gateway (`rangehound keys --gateway`)")]
    NotGateway(String),
    /// The system does not give it the address.
    #[error("cannot listen on {address} (--listen): {source}: expected an address of this host and a free port")]
    Address {
        /// The address.
        address: SocketAddr,
        /// The reason.
        source: std::io::Error,
    },
    /// The cryptography does not fit.
    #[error("{0}")]
    Cryptography(String),
    /// Its socket or its view of the bus has failed.
    #[error("the gateway receives nothing any more: its socket or the run's shared memory has failed: start it again")]
    Deaf,
    /// The system.
    #[error("{0}")]
    System(#[from] std::io::Error),
}

/// Something that happened.
#[derive(Debug)]
enum Input {
    /// On the bus of the run.
    Bus(Events),
    /// A robot wants to join.
    Applicant(Box<Applicant>),
    /// The role of a robot that wants to join, or why it cannot have it.
    Lease(Box<Applicant>, Result<RoleLease, RendezvousError>),
    /// A frame of a robot.
    Frame { robot: usize, connection: usize, bytes: Vec<u8> },
    /// A robot leaves in order.
    Leaving { robot: usize, connection: usize },
    /// A robot knows that the run is over.
    Informed { robot: usize },
    /// A robot has confirmed an order, or not in time.
    Ordered { robot: usize, has_arrived: bool },
}

/// Runs the gateway of a run until the run ends or until asked to end. `listening` is called with its address.
///
/// # Errors
/// [`GatewayError`].
pub fn run(
    rendezvous: &Rendezvous,
    address: SocketAddr,
    keys: Option<&PathBuf>,
    termination: &Termination,
    listening: impl FnOnce(SocketAddr),
) -> Result<(), GatewayError> {
    // Two gateways would each take the roles that the other one lacks.
    let lease = rendezvous.roster().take(Role::Gateway)?;
    let mut config = Reloaded::new(keys.cloned(), move |keys| config_of(keys, address))?;
    let socket = bind(address)?;
    let runtime = link::runtime()?;
    let is_over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let (sender, mut inputs) = mpsc::channel(INPUTS_MAX);
        let bus_sender = sender.clone();
        let bus = scope.spawn(|| wait_on_bus(rendezvous, bus_sender, &is_over));
        let ended = runtime.block_on(async {
            let runtime = Arc::new(quinn::TokioRuntime);
            let first_config = quinn::ServerConfig::clone(config.present());
            let endpoint = quinn::Endpoint::new(quinn::EndpointConfig::default(), Some(first_config), socket, runtime)?;
            listening(endpoint.local_addr()?);
            let refusals = Rc::new(RefCell::new(Refusals::default()));
            let mut remote_robots = RemoteRobots::new(rendezvous, sender.clone(), Rc::clone(&refusals))?;
            let (finished, when_finished) = watch::channel(false);
            let handshakes = Handshakes::of_team(rendezvous.description().scenario.robots.len());
            let acceptor = Acceptor { sender, handshakes, refusals, demands_keys: keys.is_some() };
            let config = move || Arc::clone(config.present());
            let acceptor = tokio::task::spawn_local(acceptor.answer(endpoint.clone(), config, when_finished));
            // Without them it would hold its role and serve no robot: the supervisor starts it again.
            let is_deaf = || acceptor.is_finished() || bus.is_finished();
            let served = serve(&mut remote_robots, &mut inputs, (rendezvous, &lease), (termination, is_deaf)).await;
            let robots = remote_robots.robots();
            // The roles are free before the robots know that the gateway ends.
            drop(remote_robots);
            // A run that was stopped is over for the robots too; one that lost its gateway is not.
            if rendezvous.is_finished() || rendezvous.is_ending() {
                let _ = finished.send(true);
                let informing = inform(robots, &mut inputs, rendezvous.description().run_id, &lease);
                let _ = tokio::time::timeout(INFORMING_MAX, informing).await;
            }
            endpoint.close(link::LEFT, b"the gateway has ended");
            let _ = tokio::time::timeout(CLOSING_MAX, endpoint.wait_idle()).await;
            served
        });
        is_over.store(true, Ordering::Relaxed);
        ended
    })
}

/// Checks that a gateway could listen here with these keys, and returns the address with its port.
///
/// # Errors
/// [`GatewayError`].
pub fn check(address: SocketAddr, keys: Option<&PathBuf>) -> Result<SocketAddr, GatewayError> {
    config_of(keys.map(PathBuf::as_path), address)?;
    Ok(bind(address)?.local_addr()?)
}

fn config_of(keys: Option<&Path>, address: SocketAddr) -> Result<Arc<quinn::ServerConfig>, GatewayError> {
    let tls = match keys {
        Some(folder) => {
            let credentials = Credentials::load(folder)?;
            if !credentials.own().is_gateway() {
                return Err(GatewayError::NotGateway(credentials.own().host.clone()));
            }
            credentials.server_config()?
        }
        None if address.ip().is_loopback() => Credentials::for_loopback_server()?,
        None => return Err(GatewayError::Open(address)),
    };
    let config = link::server(tls).map_err(|error| GatewayError::Cryptography(error.to_string()))?;
    Ok(Arc::new(config))
}

fn bind(address: SocketAddr) -> Result<UdpSocket, GatewayError> {
    UdpSocket::bind(address).map_err(|source| GatewayError::Address { address, source })
}

/// Waits for events of the bus in a thread of its own, because a futex cannot be waited for together with a socket.
fn wait_on_bus(rendezvous: &Rendezvous, sender: Sender<Input>, is_over: &AtomicBool) {
    let waiter = match bus::waiter(rendezvous, WaitGroup::Robots) {
        Ok(waiter) => waiter,
        Err(error) => return log::error!("{error}"),
    };
    while !is_over.load(Ordering::Relaxed) {
        let events = waiter.sleep(IDLE);
        // An error means that the gateway ends.
        if sender.blocking_send(Input::Bus(events)).is_err() {
            return;
        }
    }
}

async fn serve(
    remote_robots: &mut RemoteRobots<'_>,
    inputs: &mut Receiver<Input>,
    (rendezvous, lease): (&Rendezvous, &RoleLease),
    (termination, is_deaf): (&Termination, impl Fn() -> bool),
) -> Result<(), GatewayError> {
    let mut may_have_ended = true;
    while !(termination.requested() || may_have_ended && rendezvous.is_finished()) {
        let now_ns = monotonic_ns();
        lease.renew(now_ns);
        rendezvous.look_for_removal(now_ns)?;
        let wait = until(remote_robots.wakes_at_ns()).min(LONGEST_SLEEP);
        let mut next = tokio::time::timeout(wait, inputs.recv()).await.ok().flatten();
        may_have_ended = false;
        while let Some(input) = next {
            // To look each time costs more than to relay a frame.
            may_have_ended |= matches!(input, Input::Bus(events) if events.has(Event::Finished) || events.is_empty());
            remote_robots.on_input(input)?;
            next = inputs.try_recv().ok();
        }
        remote_robots.publish_drives()?;
        remote_robots.send_frames();
        remote_robots.look(monotonic_ns());
        if is_deaf() {
            return Err(GatewayError::Deaf);
        }
    }
    Ok(())
}

/// Waits until these robots know that the run is over. A robot whose link is lost just then connects again, and hears it.
async fn inform(mut robots: BTreeSet<usize>, inputs: &mut Receiver<Input>, run_id: u64, lease: &RoleLease) {
    while !robots.is_empty() {
        lease.renew(monotonic_ns());
        match tokio::time::timeout(LONGEST_SLEEP, inputs.recv()).await {
            Ok(Some(Input::Applicant(applicant))) => {
                let answer = if applicant.request.took_part_in == Some(run_id) {
                    Answer::Finished
                } else {
                    Answer::Refused { text: "the run is over".to_owned(), may_change: true }
                };
                let _ = applicant.answer.send(answer);
            }
            Ok(Some(Input::Informed { robot } | Input::Leaving { robot, .. })) => {
                robots.remove(&robot);
            }
            Ok(Some(_)) | Err(_) => {}
            Ok(None) => return,
        }
    }
}

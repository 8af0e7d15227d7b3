//! Connections: the handshake, the request to join, and the frames of a robot that has joined.

use std::cell::RefCell;
use std::net::IpAddr;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

use quinn::{Connection, ConnectionError, Endpoint, Incoming, RecvStream, SendStream, ServerConfig};
use rustls::pki_types::CertificateDer;
use serde::Serialize;
use tokio::sync::mpsc::{self, Receiver, Sender};
use tokio::sync::{oneshot, watch};

use super::Input;
use super::handshakes::Handshakes;
use super::refusals::Refusals;
use crate::keys::{Peer, RefusalCause};
use crate::link::{self, Answer, JoinError, Notice, Request};

/// Time for a handshake and a request to join.
const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(3);

/// Longest time for which a peer may confirm its last message.
const CONFIRMATION_MAX: Duration = Duration::from_secs(1);

/// Time for which the handshake of a peer that is refused or goes away still counts as under way: it has cost a signature.
const PLACE_KEPT: Duration = Duration::from_secs(1);

/// Handshakes under way from which on each peer must first prove its address: it costs a round trip, and a stranger with a
/// false address gets no further.
const HANDSHAKES_TRUSTED: usize = 16;

/// A peer that asks for a role. The answer is for its stream, and so are notices after that.
#[derive(Debug)]
pub(super) struct Applicant {
    pub(super) request: Request,
    pub(super) peer: Option<Peer>,
    pub(super) connection: Connection,
    pub(super) answer: oneshot::Sender<Answer>,
    pub(super) notices: Sender<Notice>,
}

/// Accepts connections of peers.
pub(super) struct Acceptor {
    pub(super) sender: Sender<Input>,
    pub(super) handshakes: Rc<Handshakes>,
    pub(super) refusals: Rc<RefCell<Refusals>>,
    /// Each peer must have a certificate.
    pub(super) demands_keys: bool,
}

impl Acceptor {
    /// Answers all connections, until the endpoint is closed. `config` is asked for each handshake. `finished` becomes true when
    /// the run is over.
    pub(super) async fn answer(
        self,
        endpoint: Endpoint,
        mut config: impl FnMut() -> Arc<ServerConfig>,
        finished: watch::Receiver<bool>,
    ) {
        let acceptor = Rc::new(self);
        while let Some(incoming) = endpoint.accept().await {
            let count = acceptor.handshakes.count();
            if count >= HANDSHAKES_TRUSTED && !incoming.remote_address_validated() && incoming.may_retry() {
                let _ = incoming.retry();
                continue;
            }
            let address = incoming.remote_address().ip();
            let Some(under_way) = acceptor.handshakes.begin(address) else {
                // The peer sends its first packet again.
                incoming.ignore();
                acceptor.refuse(address, RefusalCause::Flood, RefusalCause::Flood.name());
                continue;
            };
            let (acceptor, config, finished) = (Rc::clone(&acceptor), config(), finished.clone());
            tokio::task::spawn_local(async move {
                match tokio::time::timeout(HANDSHAKE_TIMEOUT, acceptor.join(incoming, config)).await {
                    Ok(Ok(remote)) => {
                        drop(under_way);
                        acceptor.handshakes.know(address);
                        remote.attend(&acceptor.sender, finished).await;
                    }
                    Ok(Err(NotJoined::Refused(cause, text))) => {
                        acceptor.refuse(address, cause, &text);
                        tokio::time::sleep(PLACE_KEPT).await;
                    }
                    Ok(Err(NotJoined::Gone)) => tokio::time::sleep(PLACE_KEPT).await,
                    Ok(Err(NotJoined::Answered)) | Err(_) => {}
                }
            });
        }
    }

    fn refuse(&self, address: IpAddr, cause: RefusalCause, text: &str) {
        self.refusals.borrow_mut().add(address, cause.name(), format_args!("is refused: {text}"));
    }

    /// The handshake and the request.
    async fn join(&self, incoming: Incoming, config: Arc<ServerConfig>) -> Result<RemoteRobot, NotJoined> {
        let failed = |error: ConnectionError| match RefusalCause::of_connection_error(&error) {
            Some(RefusalCause::Other) => NotJoined::Refused(RefusalCause::Other, error.to_string()),
            Some(cause) => NotJoined::Refused(cause, cause.name().to_owned()),
            None => NotJoined::Gone,
        };
        let connection = incoming.accept_with(config).map_err(failed)?.await.map_err(failed)?;
        let peer = peer_of(&connection);
        if self.demands_keys && peer.is_none() {
            let cause = RefusalCause::BadCertificate;
            connection.close(link::REFUSED, cause.name().as_bytes());
            return Err(NotJoined::Refused(cause, cause.name().to_owned()));
        }
        let (mut send, mut receive) = connection.accept_bi().await.map_err(failed)?;
        let request: Request =
            link::read(&mut receive, Some(link::REQUEST_LEN_MAX)).await.map_err(|error: JoinError| {
                connection.close(link::REFUSED, error.to_string().as_bytes());
                match error {
                    JoinError::Ended => NotJoined::Gone,
                    error => NotJoined::Refused(RefusalCause::Other, error.to_string()),
                }
            })?;
        let robot = request.robot;
        let (answer, answered) = oneshot::channel();
        let (noticing, notices) = mpsc::channel(1);
        let applicant = Applicant { request, peer, connection: connection.clone(), answer, notices: noticing };
        // An error means that the gateway ends.
        self.sender.send(Input::Applicant(Box::new(applicant))).await.map_err(|_| NotJoined::Gone)?;
        let answer = answered.await.map_err(|_| NotJoined::Gone)?;
        match answer {
            Answer::Welcome { .. } => {
                link::write(&mut send, &answer).await.map_err(|_| NotJoined::Gone)?;
                Ok(RemoteRobot { robot, connection, receive, send, notices })
            }
            Answer::Refused { ref text, .. } => {
                send_last(&connection, &mut send, &answer).await;
                connection.close(link::REFUSED, text.as_bytes());
                Err(NotJoined::Answered)
            }
            Answer::Finished => {
                if send_last(&connection, &mut send, &answer).await {
                    let _ = self.sender.send(Input::Informed { robot }).await;
                }
                Err(NotJoined::Answered)
            }
        }
    }
}

/// Sends the last message to a peer. True if the peer has it in time, or has left in order.
async fn send_last(connection: &Connection, send: &mut SendStream, message: &impl Serialize) -> bool {
    let sending =
        async { link::write(send, message).await.is_ok() && send.finish().is_ok() && send.stopped().await.is_ok() };
    let has_it = tokio::time::timeout(CONFIRMATION_MAX, sending).await.unwrap_or(false);
    let closed = connection.close_reason();
    has_it || matches!(closed, Some(ConnectionError::ApplicationClosed(closed)) if closed.error_code == link::LEFT)
}

/// Why a peer has not joined.
enum NotJoined {
    /// It was refused before it asked for a role.
    Refused(RefusalCause, String),
    /// It asked for a role, and was answered why it does not get it.
    Answered,
    /// It went away, or its link was cut: nobody refused it.
    Gone,
}

/// A robot that has joined.
struct RemoteRobot {
    robot: usize,
    connection: Connection,
    receive: RecvStream,
    send: SendStream,
    notices: Receiver<Notice>,
}

/// The host that the peer's certificate names.
fn peer_of(connection: &Connection) -> Option<Peer> {
    let identity = connection.peer_identity()?.downcast::<Vec<CertificateDer<'static>>>().ok()?;
    Peer::of(&identity).ok()
}

impl RemoteRobot {
    /// Passes on the frames and the last message of the robot, and notifies it when the run is over or its process is to end. An order
    /// that it does not confirm in time must not reach it later: its link is closed.
    async fn attend(self, sender: &Sender<Input>, mut finished: watch::Receiver<bool>) {
        let Self { robot, connection, mut receive, mut send, mut notices } = self;
        let id = connection.stable_id();
        let frames = async {
            while let Ok(bytes) = connection.read_datagram().await {
                // While the queue is full, frames wait at their connection, where the newest displace the oldest.
                let frame = Input::Frame { robot, connection: id, bytes: bytes.into() };
                if sender.send(frame).await.is_err() {
                    return;
                }
            }
        };
        let (heard_sender, mut heard) = mpsc::channel(1);
        // Apart from the rest: a read that is given up loses what it has read.
        let listen = async {
            while let Ok(notice) = link::read::<Notice>(&mut receive, Some(link::REQUEST_LEN_MAX)).await {
                let _ = heard_sender.send(notice).await;
            }
            std::future::pending::<()>().await;
        };
        let talk = async {
            loop {
                let notice = tokio::select! {
                    Some(notice) = heard.recv() => Some(notice),
                    Some(order) = notices.recv() => {
                        let sent = link::write(&mut send, &order).await.is_ok();
                        let confirmed = tokio::time::timeout(CONFIRMATION_MAX, confirmation(&mut heard, order)).await;
                        let notice = confirmed.ok().flatten().filter(|_| sent);
                        let _ = sender.send(Input::Ordered { robot, has_arrived: notice.is_some() }).await;
                        if notice.is_none() {
                            connection.close(link::SILENT, b"an order was not confirmed");
                        }
                        notice
                    }
                    Ok(_) = finished.wait_for(|finished| *finished) => {
                        if send_last(&connection, &mut send, &Notice::Finished).await {
                            let _ = sender.send(Input::Informed { robot }).await;
                        }
                        return;
                    }
                };
                if notice == Some(Notice::Leaving) {
                    let _ = sender.send(Input::Leaving { robot, connection: id }).await;
                }
            }
        };
        // A robot that leaves ends the frames, too: its messages count first.
        tokio::select! {
            biased;
            () = talk => {}
            () = listen => {}
            () = frames => {}
        }
    }
}

/// A robot confirms an order by the same notice, or by leaving.
async fn confirmation(heard: &mut Receiver<Notice>, order: Notice) -> Option<Notice> {
    while let Some(notice) = heard.recv().await {
        if notice == order || notice == Notice::Leaving {
            return Some(notice);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use std::net::{Ipv4Addr, SocketAddr};

    use super::*;
    use crate::keys::{Credentials, GATEWAY_NAME};

    const FRAMES: u32 = 1_000;

    /// The gateway is busy while frames come: the newest one is read, and old ones are lost.
    #[test]
    fn the_newest_frame_wins_a_full_queue() {
        let watched = async {
            let test = the_newest_frame_of_a_busy_gateway();
            tokio::time::timeout(Duration::from_secs(60), test).await.expect("all frames arrive")
        };
        let read = link::runtime().unwrap().block_on(watched);
        assert!(read.is_sorted() && read.last() == Some(&(FRAMES - 1)), "{read:?}");
        assert!(read.len() < FRAMES as usize / 2, "{} are kept", read.len());
    }

    /// The numbers of the frames that a gateway reads which was busy while they came.
    async fn the_newest_frame_of_a_busy_gateway() -> Vec<u32> {
        let loopback = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
        let server = link::server(Credentials::for_loopback_server().unwrap()).unwrap();
        let gateway = Endpoint::server(server, loopback).unwrap();
        let client = link::client(Credentials::for_loopback_client().unwrap()).unwrap();
        let host = Endpoint::client(loopback).unwrap();
        let connecting = host.connect_with(client, gateway.local_addr().unwrap(), GATEWAY_NAME).unwrap();
        let accepted = async { gateway.accept().await.unwrap().await.unwrap() };
        let (robot, connection) = tokio::join!(async { connecting.await.unwrap() }, accepted);
        let (mut stream, _) = robot.open_bi().await.unwrap();
        link::write(&mut stream, &Notice::End).await.unwrap();
        let (send, receive) = connection.accept_bi().await.unwrap();

        let (sender, mut inputs) = mpsc::channel(1);
        let (_orders, notices) = mpsc::channel(1);
        let (_finish, finished) = watch::channel(false);
        let remote = RemoteRobot { robot: 0, connection: connection.clone(), receive, send, notices };
        let attended = tokio::task::spawn_local(async move { remote.attend(&sender, finished).await });
        for number in 0..FRAMES {
            robot.send_datagram_wait(number.to_le_bytes().to_vec().into()).await.unwrap();
            while connection.stats().frame_rx.datagram <= u64::from(number) {
                tokio::time::sleep(Duration::from_micros(100)).await;
            }
        }
        let mut read = Vec::new();
        while read.last() != Some(&(FRAMES - 1)) {
            let next = tokio::time::timeout(Duration::from_secs(1), inputs.recv()).await;
            let Ok(Some(Input::Frame { bytes, .. })) = next else { break };
            read.push(u32::from_le_bytes(bytes.try_into().unwrap()));
        }
        attended.abort();
        read
    }
}

//! Connections: the handshake, the request to join, and the frames of a robot that has joined.

use std::net::SocketAddr;
use std::rc::Rc;
use std::time::Duration;

use quinn::{Connection, Endpoint, Incoming, RecvStream, SendStream};
use rustls::pki_types::CertificateDer;
use tokio::sync::mpsc::{self, Receiver, Sender};
use tokio::sync::{oneshot, watch};

use super::Input;
use super::handshakes::Handshakes;
use crate::keys::{Peer, RefusalCause};
use crate::link::{self, Answer, JoinError, Notice, Request};

/// Time for a handshake and a request to join.
const PATIENCE: Duration = Duration::from_secs(3);

/// Time for which a refused peer may read why.
const FAREWELL: Duration = Duration::from_secs(1);

/// Time for which the handshake of a refused peer still counts as under way: it has cost a signature.
const REST: Duration = Duration::from_secs(1);

/// Handshakes under way from which on each peer must first prove its address: it costs a round trip, and a stranger with a
/// false address gets no further.
const HANDSHAKES_TRUSTED: usize = 16;

/// A peer that wants to join, or was refused before it could say so.
#[derive(Debug)]
pub(super) enum Applicant {
    /// It asks for a role. The answer is for its stream, and so are notices after that.
    Asks {
        request: Request,
        peer: Option<Peer>,
        connection: Connection,
        answer: oneshot::Sender<Answer>,
        notices: Sender<Notice>,
    },
    /// It was refused.
    Refused { address: SocketAddr, cause: RefusalCause, text: String },
}

/// Answers all connections, until the gateway ends. `finished` becomes true when the run is over.
pub(super) async fn answer(
    endpoint: Endpoint,
    sender: Sender<Input>,
    (handshakes, has_keys): (Rc<Handshakes>, bool),
    finished: watch::Receiver<bool>,
) {
    loop {
        let mut is_finished = finished.clone();
        let incoming = tokio::select! {
            incoming = endpoint.accept() => incoming,
            _ = is_finished.wait_for(|finished| *finished) => None,
        };
        let Some(incoming) = incoming else { return };
        if handshakes.count() >= HANDSHAKES_TRUSTED && !incoming.remote_address_validated() && incoming.may_retry() {
            let _ = incoming.retry();
            continue;
        }
        let Some(under_way) = handshakes.begin(incoming.remote_address().ip()) else {
            // The peer sends its first packet again.
            incoming.ignore();
            continue;
        };
        let (sender, finished) = (sender.clone(), finished.clone());
        tokio::task::spawn_local(async move {
            let address = incoming.remote_address();
            let joined = tokio::time::timeout(PATIENCE, join(incoming, &sender, has_keys)).await;
            match joined {
                Ok(Ok(guest)) => {
                    drop(under_way);
                    attend(guest, &sender, finished).await;
                }
                Ok(Err(NotJoined::Refused(cause, text))) => {
                    let refused = Applicant::Refused { address, cause, text };
                    let _ = sender.send(Input::Applicant(Box::new(refused))).await;
                    tokio::time::sleep(REST).await;
                }
                Ok(Err(NotJoined::Told | NotJoined::Gone)) | Err(_) => {}
            }
        });
    }
}

/// Why a peer has not joined.
enum NotJoined {
    /// It was refused before it asked for a role.
    Refused(RefusalCause, String),
    /// It asked for a role, and has been told why it does not get it.
    Told,
    /// It went away, or its link was cut: nobody refused it.
    Gone,
}

/// A robot that has joined.
struct Guest {
    robot: usize,
    connection: Connection,
    receive: RecvStream,
    send: SendStream,
    notices: Receiver<Notice>,
}

/// The handshake and the request.
async fn join(incoming: Incoming, sender: &Sender<Input>, has_keys: bool) -> Result<Guest, NotJoined> {
    let failed = |error: quinn::ConnectionError| match RefusalCause::of_connection_error(&error) {
        Some(RefusalCause::Other) => NotJoined::Refused(RefusalCause::Other, error.to_string()),
        Some(cause) => NotJoined::Refused(cause, cause.name().to_owned()),
        None => NotJoined::Gone,
    };
    let connection = incoming.accept().map_err(failed)?.await.map_err(failed)?;
    let peer = peer_of(&connection);
    if has_keys && peer.is_none() {
        connection.close(link::REFUSED, RefusalCause::BadCertificate.name().as_bytes());
        return Err(NotJoined::Refused(RefusalCause::BadCertificate, RefusalCause::BadCertificate.name().to_owned()));
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
    let asks = Applicant::Asks { request, peer, connection: connection.clone(), answer, notices: noticing };
    // An error means that the gateway ends.
    sender.send(Input::Applicant(Box::new(asks))).await.map_err(|_| NotJoined::Gone)?;
    let answer = answered.await.map_err(|_| NotJoined::Gone)?;
    let sent = link::write(&mut send, &answer).await;
    if let Answer::Refused { text, .. } = answer {
        let _ = send.finish();
        let _ = tokio::time::timeout(FAREWELL, send.stopped()).await;
        connection.close(link::REFUSED, text.as_bytes());
        return Err(NotJoined::Told);
    }
    sent.map_err(|_| NotJoined::Gone)?;
    Ok(Guest { robot, connection, receive, send, notices })
}

/// The host that the peer's certificate names.
fn peer_of(connection: &Connection) -> Option<Peer> {
    let identity = connection.peer_identity()?.downcast::<Vec<CertificateDer<'static>>>().ok()?;
    Peer::of(&identity).ok()
}

/// Passes on the frames and the farewell of a robot, and tells it when the run is over or its process is to end. An order
/// that it does not confirm in time must not reach it later: its link is closed.
async fn attend(guest: Guest, sender: &Sender<Input>, mut finished: watch::Receiver<bool>) {
    let Guest { robot, connection, mut receive, mut send, mut notices } = guest;
    let id = connection.stable_id();
    let frames = async {
        while let Ok(bytes) = connection.read_datagram().await {
            // A full queue drops the frame: the robot sends it again.
            let _ = sender.try_send(Input::Frame { robot, connection: id, bytes: bytes.into() });
        }
    };
    let words = async {
        let mut said = std::pin::pin!(link::read::<Notice>(&mut receive, Some(link::REQUEST_LEN_MAX)));
        let said = tokio::select! {
            said = &mut said => said.ok(),
            Some(order) = notices.recv() => {
                let sent = link::write(&mut send, &order).await.is_ok();
                let answer = tokio::time::timeout(FAREWELL, said).await.ok().and_then(Result::ok).filter(|_| sent);
                let _ = sender.send(Input::Ordered { robot, has_arrived: answer.is_some() }).await;
                if answer.is_none() {
                    connection.close(link::SILENT, b"an order was not confirmed");
                }
                answer
            }
            Ok(_) = finished.wait_for(|finished| *finished) => {
                if link::write(&mut send, &Notice::Finished).await.is_ok() {
                    let _ = send.finish();
                    let _ = tokio::time::timeout(FAREWELL, send.stopped()).await;
                }
                return;
            }
        };
        if said == Some(Notice::Leaving) {
            let _ = sender.send(Input::Leaving { robot, connection: id }).await;
        }
        std::future::pending::<()>().await;
    };
    tokio::select! {
        () = words => {}
        () = frames => {}
    }
}

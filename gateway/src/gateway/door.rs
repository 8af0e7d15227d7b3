//! Connections: the handshake, the request to join, and the frames of a robot that has joined.

use std::net::SocketAddr;
use std::rc::Rc;
use std::time::Duration;

use quinn::{Connection, Endpoint, Incoming, RecvStream, SendStream};
use rustls::pki_types::CertificateDer;
use tokio::sync::mpsc::{self, Receiver, Sender};
use tokio::sync::{oneshot, watch};

use super::Input;
use crate::keys::{Peer, RefusalCause};
use crate::link::{self, Answer, JoinError, Notice, Request};

/// Time for a handshake and a request to join.
const PATIENCE: Duration = Duration::from_secs(3);

/// Time for which a refused peer may read why.
const FAREWELL: Duration = Duration::from_secs(1);

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
pub(super) async fn answer(endpoint: Endpoint, sender: Sender<Input>, has_keys: bool, finished: watch::Receiver<bool>) {
    let under_way = Rc::new(());
    loop {
        let mut is_finished = finished.clone();
        let incoming = tokio::select! {
            incoming = endpoint.accept() => incoming,
            _ = is_finished.wait_for(|finished| *finished) => None,
        };
        let Some(incoming) = incoming else { return };
        let handshakes = Rc::strong_count(&under_way) - 1;
        if handshakes >= HANDSHAKES_TRUSTED && !incoming.remote_address_validated() && incoming.may_retry() {
            let _ = incoming.retry();
            continue;
        }
        let (sender, guard, finished) = (sender.clone(), Rc::clone(&under_way), finished.clone());
        tokio::task::spawn_local(async move {
            let address = incoming.remote_address();
            let joined = tokio::time::timeout(PATIENCE, join(incoming, &sender, has_keys)).await;
            drop(guard);
            match joined {
                Ok(Ok(Some(guest))) => attend(guest, &sender, finished).await,
                Ok(Ok(None)) => {}
                Ok(Err((cause, text))) => refuse(&sender, address, cause, text).await,
                Err(_) => refuse(&sender, address, RefusalCause::Other, "no request to join".to_owned()).await,
            }
        });
    }
}

async fn refuse(sender: &Sender<Input>, address: SocketAddr, cause: RefusalCause, text: String) {
    let refused = Applicant::Refused { address, cause, text };
    let _ = sender.send(Input::Applicant(Box::new(refused))).await;
}

/// A robot that has joined.
struct Guest {
    robot: usize,
    connection: Connection,
    receive: RecvStream,
    send: SendStream,
    notices: Receiver<Notice>,
}

/// The handshake and the request. `None` if the robot was refused and has been told why.
async fn join(
    incoming: Incoming,
    sender: &Sender<Input>,
    has_keys: bool,
) -> Result<Option<Guest>, (RefusalCause, String)> {
    let failed = |error: quinn::ConnectionError| {
        let cause = RefusalCause::of_connection_error(&error).unwrap_or(RefusalCause::Other);
        (cause, if cause == RefusalCause::Other { error.to_string() } else { cause.name().to_owned() })
    };
    let connection = incoming.accept().map_err(failed)?.await.map_err(failed)?;
    let peer = peer_of(&connection);
    if has_keys && peer.is_none() {
        connection.close(link::REFUSED, RefusalCause::BadCertificate.name().as_bytes());
        return Err((RefusalCause::BadCertificate, RefusalCause::BadCertificate.name().to_owned()));
    }
    let (mut send, mut receive) = connection.accept_bi().await.map_err(failed)?;
    let request: Request =
        link::read(&mut receive, Some(link::REQUEST_LEN_MAX)).await.map_err(|error: JoinError| {
            connection.close(link::REFUSED, error.to_string().as_bytes());
            (RefusalCause::Other, error.to_string())
        })?;
    let robot = request.robot;
    let (answer, answered) = oneshot::channel();
    let (noticing, notices) = mpsc::channel(1);
    let asks = Applicant::Asks { request, peer, connection: connection.clone(), answer, notices: noticing };
    let ended = || (RefusalCause::Other, "the gateway ends".to_owned());
    sender.send(Input::Applicant(Box::new(asks))).await.map_err(|_| ended())?;
    let answer = answered.await.map_err(|_| ended())?;
    let sent = link::write(&mut send, &answer).await;
    if let Answer::Refused { text, .. } = answer {
        let _ = send.finish();
        let _ = tokio::time::timeout(FAREWELL, send.stopped()).await;
        connection.close(link::REFUSED, text.as_bytes());
        return Ok(None);
    }
    sent.map_err(|error| (RefusalCause::Other, error.to_string()))?;
    Ok(Some(Guest { robot, connection, receive, send, notices }))
}

/// The host that the peer's certificate names.
fn peer_of(connection: &Connection) -> Option<Peer> {
    let identity = connection.peer_identity()?.downcast::<Vec<CertificateDer<'static>>>().ok()?;
    Peer::of(&identity).ok()
}

/// Passes on the frames and the farewell of a robot, and tells it when the run is over or its process is to end.
async fn attend(guest: Guest, sender: &Sender<Input>, mut finished: watch::Receiver<bool>) {
    let Guest { robot, connection, mut receive, mut send, mut notices } = guest;
    let id = connection.stable_id();
    let leaving = async {
        if link::read::<Notice>(&mut receive, Some(link::REQUEST_LEN_MAX)).await.is_ok() {
            let _ = sender.send(Input::Leaving { robot, connection: id }).await;
        }
        std::future::pending::<()>().await;
    };
    let frames = async {
        while let Ok(bytes) = connection.read_datagram().await {
            // A full queue drops the frame: the robot sends it again.
            let _ = sender.try_send(Input::Frame { robot, connection: id, bytes: bytes.into() });
        }
    };
    let notice = async {
        tokio::select! {
            Some(notice) = notices.recv() => notice,
            Ok(_) = finished.wait_for(|finished| *finished) => Notice::Finished,
            else => std::future::pending().await,
        }
    };
    tokio::select! {
        () = leaving => {}
        () = frames => {}
        notice = notice => {
            if link::write(&mut send, &notice).await.is_ok() {
                let _ = send.finish();
                let _ = tokio::time::timeout(FAREWELL, send.stopped()).await;
            }
        }
    }
}

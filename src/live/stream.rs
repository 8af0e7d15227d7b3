//! A viewer's stream of events: always the newest, whatever it has missed.
//!
//! What a viewer is sent is made when it has taken what came before. So one that reads slowly sees fewer pictures, and
//! one that does not read at all costs two of them in memory until its time is up.

use std::pin::Pin;
use std::sync::atomic::Ordering;
use std::sync::{Arc, OnceLock};
use std::task::{Context, Poll};
use std::time::Duration;

use hyper::Response;
use hyper::body::{Body as HttpBody, Bytes, Frame, SizeHint};
use hyper::header::{self, HeaderValue};
use tokio::sync::{mpsc, watch};
use tokio::time::Instant;

use super::scene::Seen;
use super::shared::Shared;

/// Viewers at once.
const STREAMS_MAX: usize = 16;

/// A viewer that takes nothing for this long is let go.
const STALLED: Duration = Duration::from_secs(30);

/// Without news something is sent all the same: a viewer that is gone is noticed.
const QUIET: Duration = Duration::from_secs(5);

/// An answer's contents.
#[derive(Debug)]
pub(super) enum Body {
    /// All at once.
    Whole(Option<Bytes>),
    /// As it comes, until its end.
    Events(mpsc::Receiver<Bytes>),
}

impl HttpBody for Body {
    type Data = Bytes;
    type Error = std::convert::Infallible;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Self::Error>>> {
        match &mut *self {
            Self::Whole(bytes) => Poll::Ready(bytes.take().map(|bytes| Ok(Frame::data(bytes)))),
            Self::Events(events) => events.poll_recv(context).map(|event| event.map(|bytes| Ok(Frame::data(bytes)))),
        }
    }

    fn is_end_stream(&self) -> bool {
        matches!(self, Self::Whole(None))
    }

    fn size_hint(&self) -> SizeHint {
        match self {
            Self::Whole(bytes) => SizeHint::with_exact(bytes.as_ref().map_or(0, |bytes| bytes.len() as u64)),
            Self::Events(_) => SizeHint::default(),
        }
    }
}

/// One of the viewers that there may be, for as long as it is one.
pub(super) struct Place(Arc<Shared>);

impl Place {
    /// `None` if there are as many as there may be.
    fn take(shared: &Arc<Shared>) -> Option<Self> {
        let place = |taken: usize| (taken < STREAMS_MAX).then_some(taken + 1);
        shared.streams.fetch_update(Ordering::Relaxed, Ordering::Relaxed, place).ok()?;
        Some(Self(Arc::clone(shared)))
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.0.streams.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Until when a connection may last; streams put it off.
pub(super) struct Life {
    end: watch::Sender<Instant>,
    /// Given back when the connection has ended, with all that was to be sent.
    place: OnceLock<Place>,
}

impl Life {
    pub(super) fn new(time: Duration) -> Self {
        Self { end: watch::Sender::new(Instant::now() + time), place: OnceLock::new() }
    }

    pub(super) fn lasts(&self, time: Duration) {
        self.end.send_replace(Instant::now() + time);
    }

    pub(super) fn keep(&self, place: Place) {
        // There is one request, so there is one place.
        let _ = self.place.set(place);
    }

    pub(super) async fn is_over(&self) {
        loop {
            let end = *self.end.borrow();
            if end <= Instant::now() {
                return;
            }
            tokio::time::sleep_until(end).await;
        }
    }
}

/// Opens a stream; `None` if there are too many viewers.
pub(super) fn open(shared: &Arc<Shared>, life: &Arc<Life>) -> Option<Response<Body>> {
    let place = Place::take(shared)?;
    let (send, events) = mpsc::channel(1);
    life.keep(place);
    tokio::spawn(feed(Arc::clone(shared), Arc::clone(life), send));
    let mut response = Response::new(Body::Events(events));
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static("text/event-stream"));
    Some(response)
}

/// Sends what is new whenever the viewer has room for it; ends with the viewer, or with the run.
async fn feed(shared: Arc<Shared>, life: Arc<Life>, send: mpsc::Sender<Bytes>) {
    let mut changes = shared.changes.clone();
    let mut seen = Seen::default();
    changes.mark_changed();
    loop {
        // Room first, then the news: what waits is never old. The connection's end makes this one fail.
        let Ok(room) = send.reserve().await else { return };
        life.lasts(STALLED);
        let is_quiet = tokio::select! {
            change = changes.changed() => match change {
                Ok(()) => false,
                // The server is about to end.
                Err(_) => return,
            },
            () = tokio::time::sleep(QUIET) => true,
            () = send.closed() => return,
        };
        let (events, is_last) =
            if is_quiet { (": still here\n\n".to_owned(), false) } else { shared.scene().news(&mut seen) };
        room.send(Bytes::from(events));
        if is_last {
            return;
        }
        tokio::time::sleep(shared.pace).await;
    }
}

//! A viewer's stream of events: always the newest state, even after missed events.
//!
//! An event is made when the viewer has received the one before. A slow viewer sees fewer pictures. A viewer that does not
//! read costs the memory of two pictures until its time-out.

use std::convert::Infallible;
use std::sync::atomic::Ordering;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use axum::Extension;
use axum::body::Body;
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use futures_util::stream::unfold;
use tokio::sync::watch;
use tokio::time::{Instant, sleep_until, timeout};

use super::guard::ViewPermission;
use super::shared::Shared;
use crate::live::scene::Seen;

/// Viewers at once.
const STREAMS_MAX: usize = 16;

/// A viewer that receives nothing for this long is disconnected.
const STALLED: Duration = Duration::from_secs(30);

/// Interval of keep-alive events: they detect a viewer that is gone.
const QUIET: Duration = Duration::from_secs(5);

/// A viewer's slot, freed when dropped.
pub(super) struct Place(Arc<Shared>);

impl Place {
    /// `None` if all slots are in use.
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

/// Deadline of a connection; streams extend it.
pub(super) struct Life {
    end: watch::Sender<Instant>,
    /// Freed when the connection has ended.
    place: OnceLock<Place>,
}

impl Life {
    pub(super) fn new(time: Duration) -> Self {
        Self { end: watch::Sender::new(Instant::now() + time), place: OnceLock::new() }
    }

    pub(super) fn lasts(&self, time: Duration) {
        self.end.send_replace(Instant::now() + time);
    }

    pub(super) async fn is_over(&self) {
        loop {
            let end = *self.end.borrow();
            if end <= Instant::now() {
                return;
            }
            sleep_until(end).await;
        }
    }
}

/// Opens a stream, unless there are too many viewers.
pub(super) async fn open(ViewPermission(shared): ViewPermission, Extension(life): Extension<Arc<Life>>) -> Response {
    let Some(place) = Place::take(&shared) else {
        return (StatusCode::SERVICE_UNAVAILABLE, "Too many viewers: close another page of this run.").into_response();
    };
    // Each connection has one request, so its slot is free.
    let _ = life.place.set(place);
    let mut changes = shared.changes.clone();
    changes.mark_changed();
    let viewer = Viewer { shared, life, changes, seen: Seen::default(), due: Instant::now() };
    let events = unfold(Some(viewer), |viewer| async move { viewer?.next().await });
    ([(CONTENT_TYPE, "text/event-stream")], Body::from_stream(events)).into_response()
}

/// A viewer and its state.
struct Viewer {
    shared: Arc<Shared>,
    life: Arc<Life>,
    changes: watch::Receiver<u64>,
    seen: Seen,
    /// The earliest time of the next event.
    due: Instant,
}

impl Viewer {
    /// The next event, and the viewer if more events follow. It is made when there is room to send it, so that it is never
    /// old. `None` if the server ends.
    async fn next(mut self) -> Option<(Result<String, Infallible>, Option<Self>)> {
        self.life.lasts(STALLED);
        sleep_until(self.due).await;
        let (events, is_last) = match timeout(QUIET, self.changes.changed()).await {
            Ok(Ok(())) => self.shared.scene().news(&mut self.seen),
            Ok(Err(_)) => return None,
            Err(_) => (": still here\n\n".to_owned(), false),
        };
        self.due = Instant::now() + self.shared.pace;
        Some((Ok(events), (!is_last).then_some(self)))
    }
}

//! The server of the page: one thread, a bounded number of connections, one request each.

mod assets;
mod guard;
mod routes;
mod shared;
mod stream;
mod token;

use std::net::TcpListener;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use rangehound_node::rendezvous::Rendezvous;
use tokio::sync::{Semaphore, oneshot, watch};

use self::shared::Shared;
use self::stream::Life;
pub(super) use self::token::Token;
use super::scene::Scene;

/// Connections at once: a browser opens six, and one for each page's stream.
const CONNECTIONS_MAX: usize = 64;

/// Time-out of a request and its answer.
const REQUEST: Duration = Duration::from_secs(10);

/// Longest head of a request, bytes.
const HEAD_MAX: usize = 16 << 10;

/// Time for viewers to receive the end of a run.
const CLOSING_MAX: Duration = Duration::from_secs(2);

/// The page of one run while it is served.
pub(super) struct Server {
    shared: Arc<Shared>,
    change: watch::Sender<u64>,
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Starts to serve a scene.
    pub(super) fn start(
        listener: TcpListener,
        token: Token,
        pace: Duration,
        scene: Scene,
        run: Option<Arc<Rendezvous>>,
    ) -> std::io::Result<Self> {
        let port = listener.local_addr()?.port();
        listener.set_nonblocking(true)?;
        let (change, changes) = watch::channel(0);
        let (end, ended) = oneshot::channel();
        let streams = AtomicUsize::new(0);
        let shared = Arc::new(Shared { scene: Mutex::new(scene), changes, token, port, pace, run, streams });
        let runtime = tokio::runtime::Builder::new_current_thread().enable_io().enable_time().build()?;
        let served = Arc::clone(&shared);
        let thread = std::thread::Builder::new().name("server".to_owned()).spawn(move || {
            runtime.block_on(async {
                tokio::select! {
                    () = accept(listener, routes::router(&served)) => {}
                    _ = ended => {}
                }
            });
        })?;
        Ok(Self { shared, change, end: Some(end), thread: Some(thread) })
    }

    /// The address for a browser.
    pub(super) fn address(&self) -> String {
        let Shared { token, port, .. } = &*self.shared;
        format!("http://127.0.0.1:{port}/?token={token}")
    }

    pub(super) fn viewers(&self) -> usize {
        self.shared.streams.load(Ordering::Relaxed)
    }

    /// Changes the scene, and shows it.
    pub(super) fn update(&self, change: impl FnOnce(&mut Scene)) {
        change(&mut self.shared.scene());
        self.change.send_modify(|count| *count += 1);
    }

    /// Changes the scene without a new picture.
    pub(super) fn keep(&self, change: impl FnOnce(&mut Scene)) {
        change(&mut self.shared.scene());
    }

    /// Reports the end to all viewers, and gives them time to receive it.
    pub(super) fn end(&self, reason: &str) {
        self.update(|scene| scene.end(reason));
        let began = Instant::now();
        while self.viewers() > 0 && began.elapsed() < CLOSING_MAX {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        drop(self.end.take());
        if let Some(thread) = self.thread.take() {
            // A panic of that thread has already been reported.
            let _ = thread.join();
        }
    }
}

async fn accept(listener: TcpListener, router: Router) {
    let Ok(listener) = tokio::net::TcpListener::from_std(listener) else { return };
    let places = Arc::new(Semaphore::new(CONNECTIONS_MAX));
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            // Out of file descriptors: wait until other connections end.
            tokio::time::sleep(Duration::from_millis(50)).await;
            continue;
        };
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else {
            // This must not block: text beyond the socket's empty buffer is dropped.
            let _ =
                stream.try_write(b"HTTP/1.1 503 Service Unavailable\r\nContent-Length: 0\r\nConnection: close\r\n\r\n");
            continue;
        };
        let router = router.clone();
        tokio::spawn(async move {
            serve(stream, router).await;
            drop(place);
        });
    }
}

/// Answers one request. The connection ends after its time-out, or when the viewer of its stream reads no more. Uses hyper
/// directly, because `axum::serve` limits neither the length of a request's head nor its time.
async fn serve(stream: tokio::net::TcpStream, router: Router) {
    // Sends each picture at once, without waiting for the acknowledgement of the previous one.
    let _ = stream.set_nodelay(true);
    let life = Arc::new(Life::new(REQUEST));
    let service = TowerToHyperService::new(router.layer(Extension(Arc::clone(&life))));
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(REQUEST)
        .max_buf_size(HEAD_MAX)
        .keep_alive(false)
        .serve_connection(TokioIo::new(stream), service);
    tokio::select! {
        // Errors of a connection concern only its client.
        _ = connection => {}
        () = life.is_over() => {}
    }
}

//! `rangehound live`: a page that shows a living run, with buttons to kill its processes.
//!
//! It does not load the control loop: the page is a separate process of the lowest priority that reads the nodes' logs.
//! No node in the loop sends messages or notifications to it.
//!
//! | module | what |
//! |---|---|
//! | `follow` | follows a run until its end |
//! | `scene`, `history`, `latency` | the displayed data, bounded |
//! | `act` | what the buttons do |
//! | `server` | the HTTP server; `guard`: access control; `page/`: the page itself |

mod act;
mod follow;
mod history;
mod latency;
mod scene;
mod server;

use std::io::IsTerminal;
use std::net::TcpListener;
use std::sync::Arc;
use std::time::{Duration, Instant};

use rangehound_node::rendezvous::{LIVE_NOTE, Rendezvous};
use rangehound_node::system::signal::Termination;
use rangehound_shared::run_name::RunName;
use rangehound_shared::scenario::Scenario;
use serde_json::json;

use crate::failure::{Failure, print_json, print_stderr};
use crate::results::frame::Frame;
use crate::run::node::observe;
use crate::run::port::listen;
use scene::Scene;
use server::{Server, Token};

/// Interval at which the page reads the run, and the shortest interval between two pictures.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Increase of the interval between pictures per robot, because each makes pictures larger.
const POLL_INTERVAL_PER_ROBOT: Duration = Duration::from_millis(1);

/// `rangehound live`.
///
/// # Errors
/// [`Failure`].
pub fn live(name: &RunName, port: Option<u16>, json: bool) -> Result<(), Failure> {
    let termination = Termination::listen()?;
    let Some(run) = observe(c"rh-live", name, &termination)? else { return Ok(()) };
    let run = Arc::new(run);
    let scenario = &run.description().scenario;
    let (listener, token) = address_of_before(&run, port).map_or_else(|| new_address(port), Ok)?;
    let note = format!("{} {token}", listener.local_addr()?.port());
    let scene = Scene::new(&run.name().to_string(), "run", scenario);
    let server = Server::start(listener, token, pace(scenario), scene, Some(Arc::clone(&run)))?;
    // Without this note, a page that is started again after a kill has another address.
    let _ = run.write_note(LIVE_NOTE, &note);
    if json {
        print_json(&json!({ "name": run.name().to_string(), "address": server.address() }))?;
    } else {
        announce("live", &server);
    }
    let reason = follow::follow(&run, &server, &termination);
    server.end(reason);
    Ok(())
}

/// Shows other frames, such as those of a recording, on the same page without processes. Waits for a viewer before the
/// first frame; the iterator sets the pace.
///
/// # Errors
/// [`Failure`] if the port is taken or a frame cannot be read.
pub fn serve_frames(
    name: &str,
    scenario: &Scenario,
    port: Option<u16>,
    frames: impl IntoIterator<Item = anyhow::Result<Frame>>,
    termination: &Termination,
) -> Result<(), Failure> {
    let (listener, token) = new_address(port)?;
    let scene = Scene::new(name, "recording", scenario);
    let server = Server::start(listener, token, pace(scenario), scene, None)?;
    announce("replay", &server);
    feed(&server, frames, termination)
}

/// Waits for a viewer, and shows all frames.
fn feed(
    server: &Server,
    frames: impl IntoIterator<Item = anyhow::Result<Frame>>,
    termination: &Termination,
) -> Result<(), Failure> {
    while server.viewers() == 0 && !termination.requested() {
        std::thread::sleep(POLL_INTERVAL);
    }
    let mut looked = None;
    for frame in frames {
        if termination.requested() {
            break;
        }
        let frame = frame?;
        let is_look = looked.is_none_or(|at: Instant| at.elapsed() >= POLL_INTERVAL);
        if is_look {
            looked = Some(Instant::now());
        }
        server.update(|scene| {
            scene.add(frame);
            if is_look {
                scene.looked(Instant::now());
            }
        });
    }
    server.keep(|scene| scene.looked(Instant::now()));
    server.end(if termination.requested() { "The replay was ended." } else { "The recording has ended." });
    Ok(())
}

/// A free port and a new token.
fn new_address(port: Option<u16>) -> Result<(TcpListener, Token), Failure> {
    Ok((listen(port)?, Token::new()?))
}

/// The address of this run's page before it was killed, if it is free.
fn address_of_before(run: &Rendezvous, port: Option<u16>) -> Option<(TcpListener, Token)> {
    let note = run.note(LIVE_NOTE)?;
    let (before, token) = note.split_once(' ')?;
    let before = before.parse().ok().filter(|before| port.is_none_or(|port| port == *before || port == 0))?;
    Some((listen(Some(before)).ok()?, Token::from_text(token)?))
}

fn pace(scenario: &Scenario) -> Duration {
    POLL_INTERVAL + POLL_INTERVAL_PER_ROBOT * scenario.robots.len().try_into().unwrap_or(u32::MAX)
}

/// Prints the address on one line, which scripts can read too.
fn announce(what: &str, server: &Server) {
    // Overwrites the progress bar of the parent process, if there is one, which is redrawn.
    let over = if std::io::stderr().is_terminal() { "\r\x1b[2K" } else { "" };
    print_stderr(format_args!("{over}{what}: {}", server.address()));
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::net::TcpStream;

    use rangehound_shared::scenario::ScenarioFile;

    use super::*;
    use crate::live::scene::frame_for_test;

    #[test]
    fn frames_from_elsewhere_are_shown_to_their_end_and_have_no_processes() {
        let scenario = Scenario::from_file(&ScenarioFile::default(), "test").unwrap();
        let (listener, token) = new_address(None).unwrap();
        let (port, token_text) = (listener.local_addr().unwrap().port(), token.to_string());
        let scene = Scene::new("tape", "recording", &scenario);
        let server = Server::start(listener, token, Duration::from_millis(1), scene, None).unwrap();
        let ask = move |request: &str| {
            let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
            stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
            write!(stream, "{request} HTTP/1.1\r\nHost: localhost:{port}\r\n").unwrap();
            write!(stream, "X-Rangehound-Token: {token_text}\r\n\r\n").unwrap();
            let mut answer = String::new();
            stream.read_to_string(&mut answer).unwrap();
            answer
        };
        assert!(ask("POST /act/kill/sim").starts_with("HTTP/1.1 409"));
        let address = server.address();
        let token = address.rsplit_once('=').unwrap().1.to_owned();
        let viewer = std::thread::spawn(move || ask(&format!("GET /stream?token={token}")));
        let frames = (0..=300).map(|tick| Ok(frame_for_test(tick, &scenario)));
        feed(&server, frames, &Termination::listen().unwrap()).unwrap();
        let seen = viewer.join().unwrap();
        assert!(
            seen.contains("\"what\":\"recording\"") && seen.contains("event: picture\ndata: {\"tick\":300,"),
            "{seen}"
        );
        assert!(seen.contains("event: ended\ndata: \"The recording has ended.\"") && !seen.contains("event: nodes"));
    }
}

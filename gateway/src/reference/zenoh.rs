//! Over zenoh, as a team would use it for ticks: its datagrams of QUIC with the keys of the hosts, and express publishers of the
//! highest priority for data that drop what they cannot send.

use std::time::Duration;

use zenoh::handlers::FifoChannelHandler;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::Sample;
use zenoh::{Config, Session, Wait};

use super::{Down, Exchange, ReferenceError, Up, failed};
use crate::keys::{AUTHORITY_CERTIFICATE, HOST_CERTIFICATE, HOST_KEY};

fn up_key(robot: &str) -> String {
    format!("up/{robot}")
}

fn down_key(robot: usize) -> String {
    format!("down/{robot}")
}

/// Opens a session; a robot's is open once it has reached the centre.
fn open(exchange: &Exchange<'_>, end: &str) -> Result<Session, ReferenceError> {
    // Paths as JSON.
    let [authority, certificate, key] = [AUTHORITY_CERTIFICATE, HOST_CERTIFICATE, HOST_KEY]
        .map(|file| serde_json::Value::from(exchange.keys.join(file).display().to_string()).to_string());
    let settings = [
        ("mode", "\"peer\""),
        ("scouting/multicast/enabled", "false"),
        ("scouting/gossip/enabled", "false"),
        ("timestamping/enabled", "false"),
        ("listen/endpoints", "[]"),
        ("connect/exit_on_failure", "true"),
        ("connect/timeout_ms", "10000"),
        ("connect/retry", "{\"period_init_ms\": 50, \"period_max_ms\": 500, \"period_increase_factor\": 2}"),
        (&format!("{end}/endpoints"), &format!("[\"quic/{}?rel=0\"]", exchange.address)),
        ("transport/link/tls/enable_mtls", "true"),
        ("transport/link/tls/root_ca_certificate", &authority),
        (&format!("transport/link/tls/{end}_certificate"), &certificate),
        (&format!("transport/link/tls/{end}_private_key"), &key),
        // The certificates name no addresses.
        ("transport/link/tls/verify_name_on_connect", "false"),
    ];
    let mut config = Config::default();
    for (name, value) in settings {
        config.insert_json5(name, value).map_err(|error| failed(format!("zenoh's {name}: {error}")))?;
    }
    zenoh::open(config).wait().map_err(failed)
}

fn publisher(session: &Session, key: String) -> Result<Publisher<'static>, ReferenceError> {
    let publisher = session.declare_publisher(key).express(true).priority(Priority::RealTime);
    publisher.congestion_control(CongestionControl::Drop).wait().map_err(failed)
}

type Frames = Subscriber<FifoChannelHandler<Sample>>;

fn subscriber(session: &Session, key: String) -> Result<Frames, ReferenceError> {
    session.declare_subscriber(key).wait().map_err(failed)
}

/// The frame of a sample, if it has its length.
fn frame<const LEN: usize>(sample: &Sample) -> Option<[u8; LEN]> {
    sample.payload().to_bytes().as_ref().try_into().ok()
}

pub(super) struct Centre {
    frames: Frames,
    robots: Vec<Publisher<'static>>,
    /// Ends with this value.
    _session: Session,
}

impl Centre {
    pub(super) fn open(exchange: &Exchange<'_>, robots: usize) -> Result<Self, ReferenceError> {
        let session = open(exchange, "listen")?;
        let frames = subscriber(&session, up_key("*"))?;
        let robots = (0..robots).map(|robot| publisher(&session, down_key(robot))).collect::<Result<_, _>>()?;
        Ok(Self { frames, robots, _session: session })
    }
}

impl super::Centre for Centre {
    fn receive(&mut self) -> Result<Up, ReferenceError> {
        loop {
            if let Some(frame) = frame(&self.frames.recv().map_err(failed)?) {
                return Ok(frame);
            }
        }
    }

    fn answer(&mut self, robot: usize, frame: &Down) -> Result<(), ReferenceError> {
        self.robots.get(robot).map_or(Ok(()), |robot| robot.put(frame).wait().map_err(failed))
    }
}

pub(super) struct Robot {
    publisher: Publisher<'static>,
    frames: Frames,
    /// Ends with this value.
    _session: Session,
}

impl Robot {
    pub(super) fn open(exchange: &Exchange<'_>, robot: usize) -> Result<Self, ReferenceError> {
        let session = open(exchange, "connect")?;
        let frames = subscriber(&session, down_key(robot))?;
        Ok(Self { publisher: publisher(&session, up_key(&robot.to_string()))?, frames, _session: session })
    }
}

impl super::Robot for Robot {
    fn send(&mut self, frame: &Up) -> Result<(), ReferenceError> {
        self.publisher.put(frame).wait().map_err(failed)
    }

    fn receive(&mut self, wait: Duration) -> Result<Option<Down>, ReferenceError> {
        let sample = self.frames.recv_timeout(wait).map_err(failed)?;
        Ok(sample.as_ref().and_then(frame))
    }
}

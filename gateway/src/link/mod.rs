//! QUIC between a robot's host and the gateway: ticks are datagrams, joining and leaving a stream.

mod stream;
mod window;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use quinn::crypto::rustls::{NoInitialCipherSuite, QuicClientConfig, QuicServerConfig};
use quinn::{ClientConfig, Connection, ServerConfig, TransportConfig, VarInt};
use tokio::runtime::{LocalOptions, LocalRuntime};

pub(crate) use stream::REQUEST_LEN_MAX;
pub use stream::{Answer, JoinError, Notice, Request, read, write};
pub use window::FixedWindow;

/// Silence after which QUIC gives a connection up, also one that is not open yet. Both ends notice a cut earlier, by the frames.
const IDLE: Duration = Duration::from_secs(5);

/// The round trip that the first packets of a connection assume: a lost one is sent again after three of them.
const FIRST_ROUND_TRIP: Duration = Duration::from_millis(30);

/// Bytes of datagrams that wait to be sent: a few frames. If there are more, the oldest are dropped, because only the
/// newest tick matters.
const SEND_BUFFER: usize = 4 << 10;

/// Bytes of datagrams that wait to be read. If there are more, the oldest are dropped.
const RECEIVE_BUFFER: usize = 16 << 10;

/// Connections that wait for the gateway to look at them. Any more are refused.
const WAITING_MAX: usize = 64;

/// Close codes of this program.
pub const LEFT: VarInt = VarInt::from_u32(1);
/// The peer was refused; the reason is the text.
pub const REFUSED: VarInt = VarInt::from_u32(2);
/// The link was silent for too long.
pub const SILENT: VarInt = VarInt::from_u32(3);
/// Another connection of the same robot replaces this one.
pub const REPLACED: VarInt = VarInt::from_u32(4);

fn transport() -> TransportConfig {
    let mut transport = TransportConfig::default();
    transport
        .max_idle_timeout(IDLE.try_into().ok())
        .initial_rtt(FIRST_ROUND_TRIP)
        .max_concurrent_bidi_streams(VarInt::from_u32(1))
        .max_concurrent_uni_streams(VarInt::from_u32(0))
        .datagram_send_buffer_size(SEND_BUFFER)
        .datagram_receive_buffer_size(Some(RECEIVE_BUFFER))
        // Frames fit in the smallest datagram.
        .mtu_discovery_config(None)
        .congestion_controller_factory(Arc::new(FixedWindow));
    transport
}

/// The gateway's side of QUIC.
///
/// # Errors
/// If the cipher suites do not fit QUIC.
pub fn server(tls: rustls::ServerConfig) -> Result<ServerConfig, NoInitialCipherSuite> {
    let mut config = ServerConfig::with_crypto(Arc::new(QuicServerConfig::try_from(tls)?));
    config.transport_config(Arc::new(transport())).max_incoming(WAITING_MAX).migration(false);
    Ok(config)
}

/// The robot's side of QUIC.
///
/// # Errors
/// If the cipher suites do not fit QUIC.
pub fn client(tls: rustls::ClientConfig) -> Result<ClientConfig, NoInitialCipherSuite> {
    let mut config = ClientConfig::new(Arc::new(QuicClientConfig::try_from(tls)?));
    config.transport_config(Arc::new(transport()));
    Ok(config)
}

/// The runtime of one end: all of it in one thread.
///
/// # Errors
/// If the system refuses what it needs.
pub fn runtime() -> std::io::Result<LocalRuntime> {
    tokio::runtime::Builder::new_current_thread().enable_all().build_local(LocalOptions::default())
}

/// The smoothed round trip of a connection as QUIC measures it, from the handshake on, ns.
#[must_use]
pub fn round_trip_ns(connection: &Connection) -> u64 {
    u64::try_from(connection.rtt().as_nanos()).unwrap_or(u64::MAX)
}

/// The address of a local socket that reaches this one.
#[must_use]
pub fn any_address_for(peer: SocketAddr) -> SocketAddr {
    let any: std::net::IpAddr =
        if peer.is_ipv4() { std::net::Ipv4Addr::UNSPECIFIED.into() } else { std::net::Ipv6Addr::UNSPECIFIED.into() };
    (any, 0).into()
}

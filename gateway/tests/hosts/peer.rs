//! A peer of a gateway that does what no robot does: over a real link, with the certificates of its choice.

use std::net::{IpAddr, SocketAddr};
use std::path::Path;
use std::sync::Arc;

use quinn::{Connection, ConnectionError, Endpoint, RecvStream, SendStream, TransportConfig};
use rangehound_gateway::keys::{Credentials, GATEWAY_NAME};
use rangehound_gateway::link::{self, Answer, FixedWindow, JoinError, Request};
use rangehound_shared::protocol::{PROGRAM, PROTOCOL};

/// Longer datagrams than a robot sends.
const MTU: u16 = 1_400;

/// The QUIC of a peer with the keys of this folder.
pub(crate) fn with_keys(folder: &Path) -> quinn::ClientConfig {
    config(Credentials::load(folder).unwrap().client_config().unwrap())
}

/// The same without any.
pub(crate) fn without_keys() -> quinn::ClientConfig {
    config(Credentials::for_loopback_client().unwrap())
}

fn config(tls: rustls::ClientConfig) -> quinn::ClientConfig {
    let mut transport = TransportConfig::default();
    transport.initial_mtu(MTU).mtu_discovery_config(None).congestion_controller_factory(Arc::new(FixedWindow));
    let mut config = link::client(tls).unwrap();
    config.transport_config(Arc::new(transport));
    config
}

/// The request of a robot.
pub(crate) fn request(robot: usize) -> Request {
    Request {
        protocol: PROTOCOL,
        program: PROGRAM.to_owned(),
        robot,
        process: rand::random(),
        run: None,
        allows_control: false,
        took_part_in: None,
    }
}

/// A connection that is open, and its stream for joining.
pub(crate) struct Peer {
    pub(crate) connection: Connection,
    pub(crate) send: SendStream,
    pub(crate) receive: RecvStream,
    /// Ends with it.
    _endpoint: Endpoint,
}

impl Peer {
    /// Connects from this address of the machine.
    pub(crate) async fn connect(
        gateway: SocketAddr,
        from: IpAddr,
        config: quinn::ClientConfig,
    ) -> Result<Self, ConnectionError> {
        let endpoint = Endpoint::client((from, 0).into()).unwrap();
        let connection = endpoint.connect_with(config, gateway, GATEWAY_NAME).unwrap().await?;
        let (send, receive) = connection.open_bi().await?;
        Ok(Self { connection, send, receive, _endpoint: endpoint })
    }

    /// Asks for a role.
    pub(crate) async fn ask(&mut self, request: &Request) -> Result<Answer, JoinError> {
        link::write(&mut self.send, request).await?;
        link::read(&mut self.receive, None).await
    }
}

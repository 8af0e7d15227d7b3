//! Ports of this machine that no other machine reaches.

use std::net::{Ipv4Addr, SocketAddr, TcpListener};

use crate::failure::Failure;

/// A socket at a port; any free one if none is given.
///
/// # Errors
/// [`Failure::Input`] if another process has the port.
pub fn listen(port: Option<u16>) -> Result<TcpListener, Failure> {
    TcpListener::bind(SocketAddr::from((Ipv4Addr::LOCALHOST, port.unwrap_or(0)))).map_err(|error| match port {
        Some(port) => {
            Failure::input(format!("cannot use port {port}: {error}: expected one that is free on 127.0.0.1"))
        }
        None => Failure::from(error),
    })
}

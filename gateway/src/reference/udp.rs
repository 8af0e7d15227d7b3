//! Over UDP.

use std::io::ErrorKind;
use std::net::{SocketAddr, UdpSocket};
use std::time::Duration;

use super::{DOWN_LEN, Down, Exchange, ReferenceError, UP_LEN, Up, word};
use crate::link;

pub(super) struct Centre {
    socket: UdpSocket,
    robots: Vec<Option<SocketAddr>>,
}

impl Centre {
    pub(super) fn open(exchange: &Exchange<'_>, robots: usize) -> Result<Self, ReferenceError> {
        Ok(Self { socket: UdpSocket::bind(exchange.address)?, robots: vec![None; robots] })
    }
}

impl super::Centre for Centre {
    fn receive(&mut self) -> Result<Up, ReferenceError> {
        loop {
            let mut frame = [0; UP_LEN];
            let (len, address) = self.socket.recv_from(&mut frame)?;
            if let Some(known) = self.robots.get_mut(word(&frame, 0) as usize).filter(|_| len == UP_LEN) {
                *known = Some(address);
                return Ok(frame);
            }
        }
    }

    fn answer(&mut self, robot: usize, frame: &Down) -> Result<(), ReferenceError> {
        if let Some(Some(address)) = self.robots.get(robot) {
            self.socket.send_to(frame, address)?;
        }
        Ok(())
    }
}

pub(super) struct Robot {
    socket: UdpSocket,
}

impl Robot {
    pub(super) fn open(exchange: &Exchange<'_>) -> Result<Self, ReferenceError> {
        let socket = UdpSocket::bind(link::any_address_for(exchange.address))?;
        socket.connect(exchange.address)?;
        Ok(Self { socket })
    }
}

impl super::Robot for Robot {
    fn send(&mut self, frame: &Up) -> Result<(), ReferenceError> {
        Ok(self.socket.send(frame).map(drop)?)
    }

    fn receive(&mut self, wait: Duration) -> Result<Option<Down>, ReferenceError> {
        self.socket.set_read_timeout(Some(wait))?;
        let mut frame = [0; DOWN_LEN];
        match self.socket.recv(&mut frame) {
            Ok(len) => Ok((len == DOWN_LEN).then_some(frame)),
            Err(error)
                if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted) =>
            {
                Ok(None)
            }
            Err(error) => Err(error.into()),
        }
    }
}

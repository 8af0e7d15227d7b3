//! Over datagrams of QUIC, as the links use it.

use std::collections::BTreeMap;
use std::time::Duration;

use quinn::{Connection, Endpoint};
use tokio::runtime::LocalRuntime;
use tokio::sync::mpsc::{self, Receiver, Sender};

use super::{DOWN_LEN, Down, Exchange, ReferenceError, UP_LEN, Up, failed, word};
use crate::keys::{Credentials, GATEWAY_NAME};
use crate::link;

/// Frames that wait for the centre.
const FRAMES_MAX: usize = 4_096;

pub(super) struct Centre {
    runtime: LocalRuntime,
    frames: Receiver<(Connection, Up)>,
    robots: BTreeMap<usize, Connection>,
}

impl Centre {
    pub(super) fn open(exchange: &Exchange<'_>) -> Result<Self, ReferenceError> {
        let runtime = link::runtime()?;
        let config = link::server(Credentials::load(exchange.keys)?.server_config()?).map_err(failed)?;
        let endpoint = {
            let _inside = runtime.enter();
            Endpoint::server(config, exchange.address)?
        };
        let (sender, frames) = mpsc::channel(FRAMES_MAX);
        runtime.spawn_local(accept(endpoint, sender));
        Ok(Self { runtime, frames, robots: BTreeMap::new() })
    }
}

async fn accept(endpoint: Endpoint, sender: Sender<(Connection, Up)>) {
    while let Some(incoming) = endpoint.accept().await {
        let sender = sender.clone();
        tokio::task::spawn_local(async move {
            let Ok(connection) = incoming.await else { return };
            while let Ok(bytes) = connection.read_datagram().await {
                if let Ok(frame) = Up::try_from(&*bytes) {
                    let _ = sender.try_send((connection.clone(), frame));
                }
            }
        });
    }
}

impl super::Centre for Centre {
    fn receive(&mut self) -> Result<Up, ReferenceError> {
        let Self { runtime, frames, robots } = self;
        let next = runtime.block_on(frames.recv());
        let (connection, frame) = next.ok_or_else(|| failed("the endpoint has ended"))?;
        robots.insert(word(&frame, 0) as usize, connection);
        Ok(frame)
    }

    fn answer(&mut self, robot: usize, frame: &Down) -> Result<(), ReferenceError> {
        if let Some(connection) = self.robots.get(&robot) {
            let _ = connection.send_datagram(frame.to_vec().into());
        }
        Ok(())
    }
}

pub(super) struct Robot {
    runtime: LocalRuntime,
    connection: Connection,
}

impl Robot {
    pub(super) fn open(exchange: &Exchange<'_>) -> Result<Self, ReferenceError> {
        let runtime = link::runtime()?;
        let config = link::client(Credentials::load(exchange.keys)?.client_config()?).map_err(failed)?;
        let address = exchange.address;
        let connection = runtime.block_on(async {
            let endpoint = Endpoint::client(link::any_address_for(address))?;
            endpoint.connect_with(config, address, GATEWAY_NAME).map_err(failed)?.await.map_err(failed)
        })?;
        Ok(Self { runtime, connection })
    }
}

impl super::Robot for Robot {
    fn send(&mut self, frame: &Up) -> Result<(), ReferenceError> {
        // It is sent at the next wait.
        self.connection.send_datagram(frame.to_vec().into()).map_err(failed)
    }

    fn receive(&mut self, wait: Duration) -> Result<Option<Down>, ReferenceError> {
        let next = async { tokio::time::timeout(wait, self.connection.read_datagram()).await };
        match self.runtime.block_on(next) {
            Err(_) => Ok(None),
            Ok(bytes) => {
                let bytes = bytes.map_err(failed)?;
                Ok(<[u8; DOWN_LEN]>::try_from(&*bytes).ok())
            }
        }
    }
}

const _: () = assert!(UP_LEN > 16 && DOWN_LEN >= 16, "the words of a frame fit in");

//! Robots on other hosts.
//!
//! The gateway runs on the run's host and takes the roles of the robots that connect to it; a robot's host needs no shared
//! memory. Messages between hosts are QUIC datagrams, which may be lost: see `docs/machines.md`.

pub mod keys;

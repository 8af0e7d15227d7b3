//! Robots on other hosts.
//!
//! The gateway ([`gateway`]) runs on the run's host and takes the roles of the robots that connect to it. A robot on another host
//! ([`robot`]) needs no shared memory. Between them are QUIC datagrams ([`link`]), which may be lost; what they carry is in
//! `rangehound_robot::remote`. The hosts prove who they are with [`keys`]. [`mod@reference`] measures the bare transport.

pub mod gateway;
pub mod keys;
pub mod link;
pub mod reference;
pub mod robot;

//! Whole runs with robots on other hosts: the real programs, with a link between them that loses, delays, doubles and cuts.
//!
//! | module | what |
//! |---|---|
//! | `support` | a run with its programs, and the bad link |
//! | `lockstep` | no fault changes a bit |
//! | `realtime` | headings stay fresh, robots stop by themselves |
//! | `security` | who is refused, and how both ends show it |
//! | `hostile` | peers that are admitted and misbehave |
//! | `peer` | such a peer |
//! | `clocks` | hosts with clocks of their own: time namespaces |
//! | `control` | robots that tools of the run's host may end |
//! | `own_robot` | robots with equipment of their own, and what it is asked for |
//! | `book` | the commands of README and docs that need this program |
//! | `namespaces` | `chaos` and `latency` over hosts with networks of their own |

#![allow(clippy::unwrap_used, reason = "a test that cannot go on should panic")]

mod book;
mod clocks;
mod control;
mod hostile;
mod lockstep;
mod namespaces;
mod own_robot;
mod peer;
mod realtime;
mod security;
mod support;

//! The messages between nodes.

use std::rc::Rc;

use rangehound_robot::remote::wire::{Downlink, Uplink};
use rangehound_shared::message::{Command, Drive, Header, Range, WorldEntry};

/// More ticks than any run has.
const NO_TICK: u64 = 1_000;

/// The id of a robot that no team has.
const NO_ROBOT: u64 = 200;

/// A message from one node to another.
#[derive(Debug, Clone)]
pub(super) enum Message {
    World(Header, Rc<[WorldEntry]>),
    Range(Header, Range),
    Heading(Header, Rc<[Command]>),
    Drive(u64, Drive),
    /// From the gateway to a robot that has joined over this link.
    Downlink {
        connection: u64,
        frame: Box<Downlink>,
    },
    /// From such a robot.
    Uplink {
        robot: usize,
        connection: u64,
        frame: Box<Uplink>,
    },
}

impl Message {
    /// True for a frame between two hosts.
    pub(super) fn is_frame(&self) -> bool {
        matches!(self, Self::Downlink { .. } | Self::Uplink { .. })
    }

    /// An invalid copy, of some kind: its receiver must act as if it had not arrived.
    pub(super) fn garbled(self, kind: u32) -> Self {
        match self {
            Self::World(header, entries) => {
                let mut entries = entries.to_vec();
                match kind {
                    0 => return Self::World(Header { tick: header.tick + NO_TICK, ..header }, entries.into()),
                    1 => entries.iter_mut().for_each(|entry| entry.pose.x_m = f64::NAN),
                    2 => entries.iter_mut().for_each(|entry| entry.origin = u64::MAX),
                    _ => entries.clear(),
                }
                Self::World(header, entries.into())
            }
            Self::Range(header, mut range) => {
                match kind {
                    0 => return Self::Range(Header { tick: header.tick + NO_TICK, ..header }, range),
                    1 => range.robot = NO_ROBOT,
                    2 => range.measurement.range_m = f64::NAN,
                    3 => range.measurement.pose.x_m += 1e6,
                    _ => range.measurement.range_m += 5.0,
                }
                Self::Range(header, range)
            }
            Self::Heading(header, commands) => {
                let one = Command { heading_rad: 1.0, speed_mps: 1.0 };
                Self::Heading(header, commands.iter().map(|_| one).chain([one]).collect())
            }
            Self::Drive(tick, drive) => Self::Drive(tick, Drive { robot: NO_ROBOT, ..drive }),
            // A link authenticates its frames: a garbled one is a lost one.
            frame @ (Self::Downlink { .. } | Self::Uplink { .. }) => frame,
        }
    }
}

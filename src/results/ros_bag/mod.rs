//! A run as a ROS 2 bag: a folder with an MCAP file and `metadata.yaml`; `docs/recording.md` lists its topics.
//!
//! | module | what |
//! |---|---|
//! | [`planar`] | from a run's data to numbers for ROS: poses, velocities, twists, stamps |
//! | [`markers`] | the markers of a tick for RViz |
//! | [`diagnostics`] | the diagnostics of a tick for ROS |
//! | [`messages`] | from that to the bytes of messages |
//! | [`write`](mod@write) | frames into an MCAP file |
//! | [`folder`] | the folder, and its `metadata.yaml` |

pub mod diagnostics;
pub mod folder;
pub mod markers;
pub mod messages;
pub mod planar;
pub mod write;

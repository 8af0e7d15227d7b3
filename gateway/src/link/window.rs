//! No congestion control: a robot sends some frames a tick, and a lost one must not delay the next.

use std::any::Any;
use std::sync::Arc;
use std::time::Instant;

use quinn::congestion::{Controller, ControllerFactory};
use quinn_proto::RttEstimator;

/// Bytes under way at the same time: far more than the frames of a round trip.
const WINDOW: u64 = 64 << 10;

/// A window that never changes. The frames are bounded by the ticks, and their repeats become rarer by themselves.
#[derive(Debug, Clone, Copy)]
pub struct FixedWindow;

impl ControllerFactory for FixedWindow {
    fn build(self: Arc<Self>, _now: Instant, _mtu: u16) -> Box<dyn Controller> {
        Box::new(*self)
    }
}

impl Controller for FixedWindow {
    fn on_ack(&mut self, _now: Instant, _sent: Instant, _bytes: u64, _is_app_limited: bool, _rtt: &RttEstimator) {}

    fn on_congestion_event(&mut self, _now: Instant, _sent: Instant, _is_persistent: bool, _lost_bytes: u64) {}

    fn on_mtu_update(&mut self, _mtu: u16) {}

    fn window(&self) -> u64 {
        WINDOW
    }

    fn clone_box(&self) -> Box<dyn Controller> {
        Box::new(*self)
    }

    fn initial_window(&self) -> u64 {
        WINDOW
    }

    fn into_any(self: Box<Self>) -> Box<dyn Any> {
        self
    }
}

//! The team's environment, pure: no I/O, no clock.

use rangehound_shared::measurement::Pose;
use rangehound_shared::message::{Drive, WorldEntry};
use rangehound_shared::sealed::SealError;

/// Largest accepted coordinate in a saved state, m: beyond it distances would not be finite.
const PLACE_MAX: f64 = 1e150;

/// True if a world can continue with these numbers.
pub(crate) fn are_valid(numbers: impl IntoIterator<Item = f64>) -> bool {
    numbers.into_iter().all(|number| number.abs() <= PLACE_MAX)
}

/// The present tick and the way to the next.
pub trait World: std::fmt::Debug + Send {
    /// Time of the present tick, s.
    fn time_s(&self) -> f64;

    /// The pose from each robot's localiser, and the measurements that its sensor can make.
    fn entries(&self) -> &[WorldEntry];

    /// Each robot's true pose; in a recording, the pose that its localiser reported.
    fn poses(&self) -> &[Pose];

    /// The target's true state; empty if unknown.
    fn truth(&self) -> &[f64];

    /// Advances to the next tick. `drives` has an entry for each robot; a robot without a drive stands still.
    fn advance(&mut self, drives: &[Option<Drive>]);

    /// Appends the state from which [`Self::restore`] continues bit for bit.
    ///
    /// # Errors
    /// If it cannot be encoded.
    fn save(&self, bytes: &mut Vec<u8>) -> Result<(), SealError>;

    /// Continues from the saved state of a world of the same scenario.
    ///
    /// # Errors
    /// If the bytes are not a valid state of this world.
    fn restore(&mut self, bytes: &[u8]) -> Result<(), SealError>;
}

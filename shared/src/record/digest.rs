//! The rolling digest: one number for all estimates of a run.

use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::xxh3_128;

use crate::STATE_DIM_MAX;

/// Bytes of the longest record: previous digest, tick, state, covariance.
const RECORD_LEN: usize = 16 + 8 + 8 * (STATE_DIM_MAX + STATE_DIM_MAX * STATE_DIM_MAX);

/// A hash chain over (tick, state, covariance), bit for bit, in tick order.
///
/// `d_k = xxh3_128(d_{k-1} | k | x_k | P_k)`, little-endian, `d_{-1} = 0`. Two runs with equal digests
/// have bit-identical estimates (up to accidental hash collisions, which are negligible).
/// The chain's only state is its value, so it is part of a checkpoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Digest(u128);

impl Digest {
    /// Appends the estimate of one tick. Elements of `state` and `covariance` (row-major or column-major, as it
    /// is symmetric) beyond the largest state dimension are ignored; passing them is a caller's error.
    pub fn append(&mut self, tick: u64, state: &[f64], covariance: &[f64]) {
        let mut record = [0_u8; RECORD_LEN];
        record[..16].copy_from_slice(&self.0.to_le_bytes());
        record[16..24].copy_from_slice(&tick.to_le_bytes());
        let mut end = 24;
        for (slot, value) in record[24..].as_chunks_mut::<8>().0.iter_mut().zip(state.iter().chain(covariance)) {
            *slot = value.to_le_bytes();
            end += 8;
        }
        self.0 = xxh3_128(&record[..end]);
    }

    /// The value as a number, to send it in a message.
    #[must_use]
    pub fn to_bits(self) -> u128 {
        self.0
    }

    /// The digest in the words of a message, the lower word first.
    #[must_use]
    pub fn from_words([low, high]: [u64; 2]) -> Self {
        Self(u128::from(high) << 64 | u128::from(low))
    }
}

impl std::fmt::Display for Digest {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:032x}", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_changed_bit_anywhere_changes_the_digest() {
        let digest_of = |tick, state: &[f64], covariance: &[f64]| {
            let mut digest = Digest::default();
            digest.append(tick, state, covariance);
            digest
        };
        let reference = digest_of(3, &[1.0, 2.0], &[1.0, 0.0, 0.0, 1.0]);
        assert_eq!(reference, digest_of(3, &[1.0, 2.0], &[1.0, 0.0, 0.0, 1.0]));
        assert_ne!(reference, digest_of(4, &[1.0, 2.0], &[1.0, 0.0, 0.0, 1.0]));
        assert_ne!(reference, digest_of(3, &[1.0_f64.next_up(), 2.0], &[1.0, 0.0, 0.0, 1.0]));
        assert_ne!(reference, digest_of(3, &[1.0, 2.0], &[1.0, -0.0, 0.0, 1.0]));
    }

    #[test]
    fn the_chain_depends_on_the_order() {
        let (mut a, mut b) = (Digest::default(), Digest::default());
        a.append(1, &[1.0], &[1.0]);
        a.append(2, &[2.0], &[1.0]);
        b.append(2, &[2.0], &[1.0]);
        b.append(1, &[1.0], &[1.0]);
        assert_ne!(a, b);
    }
}

//! A set of robots, by id, without a heap.

use serde::{Deserialize, Serialize};

use std::str::FromStr;

use crate::ROBOTS_MAX;

/// Words of a [`RobotSet`].
pub const WORDS: usize = ROBOTS_MAX / u64::BITS as usize;

/// A set of robots' ids, 0 to [`ROBOTS_MAX`] - 1; others are never in it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct RobotSet([u64; WORDS]);

impl RobotSet {
    /// The set from the words of [`Self::to_bits`].
    #[must_use]
    pub fn from_bits(words: [u64; WORDS]) -> Self {
        Self(words)
    }

    /// Its words: bit `i % 64` of word `i / 64` is robot `i`.
    #[must_use]
    pub fn to_bits(self) -> [u64; WORDS] {
        self.0
    }

    /// Adds or removes a robot.
    pub fn set(&mut self, id: usize, is_in: bool) {
        if let Some(word) = self.0.get_mut(id / 64) {
            let bit = 1 << (id % 64);
            *word = if is_in { *word | bit } else { *word & !bit };
        }
    }

    /// True if the set contains the robot.
    #[must_use]
    pub fn contains(&self, id: usize) -> bool {
        self.0.get(id / 64).is_some_and(|word| word >> (id % 64) & 1 == 1)
    }

    /// Number of robots in the set.
    #[must_use]
    pub fn len(&self) -> usize {
        self.0.iter().map(|word| word.count_ones() as usize).sum()
    }

    /// True if the set is empty.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// The robots' ids, ascending.
    pub fn iter(self) -> impl Iterator<Item = usize> {
        // Only words with a robot cost anything: most sets are empty, at every tick.
        self.0.into_iter().enumerate().flat_map(|(index, word)| {
            let after = |rest: &u64| Some(rest & (rest - 1)).filter(|rest| *rest != 0);
            let rests = std::iter::successors(Some(word).filter(|word| *word != 0), after);
            rests.map(move |rest| 64 * index + rest.trailing_zeros() as usize)
        })
    }
}

impl FromStr for RobotSet {
    type Err = String;

    /// Reads numbers and ranges, as in `0,1` or `2-5,7`.
    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || format!("expected robots from 0 to {}, such as 0,1 or 2-5", ROBOTS_MAX - 1);
        let robot = |text: &str| text.parse().ok().filter(|robot| *robot < ROBOTS_MAX).ok_or_else(expected);
        let mut robots = Self::default();
        for part in text.split(',') {
            let (first, last) = part.split_once('-').unwrap_or((part, part));
            let (first, last) = (robot(first)?, robot(last)?);
            if first > last {
                return Err(format!("the range {part} is empty: {}", expected()));
            }
            (first..=last).for_each(|robot| robots.set(robot, true));
        }
        Ok(robots)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_is_in_the_set_until_it_is_removed() {
        let mut set = RobotSet::default();
        for id in [0, 63, 64, 1023, 1024, usize::MAX] {
            set.set(id, true);
        }
        assert!(set.iter().eq([0, 63, 64, 1023]) && set.len() == 4 && !set.contains(1024));
        assert_eq!(RobotSet::from_bits(set.to_bits()), set);
        set.set(63, false);
        assert!(set.iter().eq([0, 64, 1023]) && !set.is_empty());
        let all = RobotSet::from_bits([u64::MAX; WORDS]);
        assert!(all.iter().eq(0..ROBOTS_MAX) && RobotSet::default().iter().next().is_none());
    }
}

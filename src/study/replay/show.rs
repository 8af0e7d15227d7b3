//! `replay --live`: shows a replay on the live page, at any speed.

use std::fs::File;
use std::io::BufReader;
use std::time::{Duration, Instant};

use rangehound_node::system::signal::Termination;
use rangehound_shared::scenario::Scenario;

use super::steps::Steps;
use crate::failure::Failure;
use crate::live;
use crate::results::frame::Frame;
use crate::results::run_mcap::read::FrameReader;

/// Longest sleep: bounds how late a request to end is noticed.
const LONGEST_SLEEP: Duration = Duration::from_millis(50);

/// Shows a recording from its beginning, with the estimates and headings of the replay in place of its own.
///
/// # Errors
/// [`Failure`] if the port is taken or a frame cannot be read.
pub(super) fn show(
    reader: FrameReader<BufReader<File>>,
    steps: Steps,
    scenario: &Scenario,
    port: Option<u16>,
    speed: f64,
) -> Result<(), Failure> {
    let termination = Termination::listen()?;
    let frames = Frames { reader, steps, speed, began: None, termination: &termination };
    live::serve_frames(&scenario.name, scenario, port, frames, &termination)
}

/// Replayed frames, each when it is due.
struct Frames<'a> {
    reader: FrameReader<BufReader<File>>,
    steps: Steps,
    /// Speed: seconds of the run per second.
    speed: f64,
    /// When the first frame was shown, and its time, s.
    began: Option<(Instant, f64)>,
    termination: &'a Termination,
}

impl Iterator for Frames<'_> {
    type Item = anyhow::Result<Frame>;

    fn next(&mut self) -> Option<Self::Item> {
        let frame = self.replayed().transpose()?;
        if let Ok(frame) = &frame {
            self.wait_for(frame.fusion.time_s);
        }
        Some(frame)
    }
}

impl Frames<'_> {
    fn replayed(&mut self) -> anyhow::Result<Option<Frame>> {
        let Some(mut frame) = self.reader.next_frame()? else { return Ok(None) };
        let estimate = self.steps.step(&frame)?;
        frame.fusion.estimate = estimate;
        for (exchange, command) in frame.fusion.exchanges.iter_mut().zip(self.steps.commands()) {
            exchange.command = *command;
        }
        Ok(Some(frame))
    }

    fn wait_for(&mut self, time_s: f64) {
        let (began, first_s) = *self.began.get_or_insert((Instant::now(), time_s));
        let due = Duration::try_from_secs_f64((time_s - first_s) / self.speed).unwrap_or(Duration::MAX);
        while let left = due.saturating_sub(began.elapsed())
            && !left.is_zero()
            && !self.termination.requested()
        {
            std::thread::sleep(left.min(LONGEST_SLEEP));
        }
    }
}

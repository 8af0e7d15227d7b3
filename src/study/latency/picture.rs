//! The picture of a measurement: the percentile curves of all, and the hops of the system.

use std::path::Path;

use plotters::prelude::*;

use super::outcome::{Contender, Each, Outcome};
use crate::draw::chart::{self, Area, COLOURS, Drawn, KeyEntry};
use crate::files::layout::LATENCY_PICTURE;
use crate::results::percentiles::{self, Point};

const SIZE: (u32, u32) = (1_800, 1_300);

/// Height of the bars beneath the curves.
const BARS: u32 = 300;

/// Draws the picture into a folder.
///
/// # Errors
/// If it cannot be written.
pub(super) fn draw(outcome: &Outcome, folder: &Path) -> anyhow::Result<()> {
    chart::draw_to_file(&folder.join(LATENCY_PICTURE), SIZE, |area| draw_on(outcome, area))
}

fn colours() -> Each<RGBColor> {
    Each { system: COLOURS[6], iceoryx2: COLOURS[0], futex: COLOURS[2] }
}

fn draw_on(outcome: &Outcome, area: &Area<'_>) -> Drawn {
    let colours = colours();
    let name = |contender| format!("{contender}: median {:.1} µs", outcome.latency_us.get(contender).p50);
    let entry = |contender| (name(contender), colours.get(contender).stroke_width(6));
    let key: [KeyEntry; 3] = Contender::ALL.map(entry);
    let below = chart::draw_key(area, &key)?;
    let height = below.dim_in_pixel().1;
    let (upper, lower) = below.split_vertically(height.saturating_sub(BARS));
    let curves: [(&[Point], RGBColor); 3] =
        Contender::ALL.map(|contender| (outcome.percentiles.get(contender).as_slice(), *colours.get(contender)));
    let samples = Contender::ALL.map(|contender| outcome.latency_us.get(contender).count).into_iter().max();
    percentiles::draw_curves(&upper, &curves, samples.unwrap_or(0))?;
    let label = "hops of the system, µs: median, and pale up to 99 %";
    percentiles::draw_hops(&lower, &outcome.hops_us, colours.system, label)
}

//! The picture of a measurement: the percentile curves of all, and the hops of the system.

use std::path::Path;

use plotters::prelude::*;

use super::outcome::{Contender, Outcome};
use super::reference::Reference;
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

fn colour(contender: Contender) -> RGBColor {
    COLOURS[match contender {
        Contender::System => 6,
        Contender::Local => 4,
        Contender::Reference(Reference::Iceoryx2 | Reference::Quic) => 0,
        Contender::Reference(Reference::Futex | Reference::Udp) => 2,
        Contender::Reference(Reference::Zenoh) => 1,
    }]
}

fn draw_on(outcome: &Outcome, area: &Area<'_>) -> Drawn {
    let latency_us = || outcome.latency_us.iter();
    let name = |contender, p50| format!("{contender}: median {p50:.1} µs");
    let entry = |contender, p50| (name(contender, p50), colour(contender).stroke_width(6));
    let key: Vec<KeyEntry> = latency_us().map(|(contender, latency_us)| entry(contender, latency_us.p50)).collect();
    let below = chart::draw_key(area, &key)?;
    let height = below.dim_in_pixel().1;
    let (upper, lower) = below.split_vertically(height.saturating_sub(BARS));
    let curves = outcome.percentiles.iter().map(|(contender, points)| (points.as_slice(), colour(contender)));
    let curves: Vec<(&[Point], RGBColor)> = curves.collect();
    let samples = latency_us().map(|(_, latency_us)| latency_us.count).max();
    percentiles::draw_curves(&upper, &curves, samples.unwrap_or(0))?;
    let label = "hops of the system, µs: median (dark) and 99th percentile (pale)";
    percentiles::draw_hops(&lower, &outcome.hops_us, colour(Contender::System), label)
}

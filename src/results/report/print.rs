//! The report as it is printed.

use rangehound_shared::scenario::{name_of, printable};

use super::{
    BearingSummary, Distrust, HeadingSummary, LatencySummary, NodeSummary, RangeSummary, RefusalSummary, Report,
    SensorSummary, TraceSummary, of_bearings,
};
use crate::terminal::{DOUBTFUL, TITLE, counted, field, field_in};

/// Share of a sensor's ranges or bearings that were not fused, above which the sensor is printed.
const DOUBTFUL_SHARE: f64 = 0.1;

/// In place of the clock's name: no clock paces such a run.
pub(crate) const IN_ONE_PROCESS: &str = "in one process";

/// Most intervals of distrust that are printed; the file has all.
const DISTRUST_LINES_MAX: usize = 5;

impl std::fmt::Display for Report {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { ranges, headings, latency_us, .. } = self;
        let Self { scenario, robots, planner, seed, .. } = self;
        writeln!(f, "{TITLE}{scenario}{TITLE:#}: {}, {planner} planner, seed {seed}", counted(robots, "robot"))?;
        let Self { clock, ticks, wall_s, ticks_per_s, .. } = self;
        let clock = if self.in_one_process { IN_ONE_PROCESS } else { clock };
        let ticks = counted(ticks, "tick");
        writeln!(f, "{}", field(clock, format_args!("{ticks} in {wall_s:.2} s ({ticks_per_s:.0} ticks/s)")))?;
        if let Some(rmse_m) = self.position_rmse_m {
            let since_found = self.found.and_then(|found| Some((found.tick, found.position_rmse_m?)));
            let since_found =
                since_found.map(|(tick, m)| format!(", {m:.3} since the target was found at tick {tick}"));
            let error = format!("{rmse_m:.3} m RMS{}", since_found.unwrap_or_default());
            writeln!(f, "{}", field("position error", error))?;
        }
        let ratio = |value: Option<f64>| value.map_or("unknown".to_owned(), |value| format!("{value:.2}"));
        // Also of all ranges, if some were not fused.
        let all = if self.ranges.rejected > 0 {
            format!(" ({} with the rejected)", ratio(self.nis_all_mean))
        } else {
            String::new()
        };
        let consistency = format!("ANEES {}, NIS {}{all}; 1 is ideal", ratio(self.anees), ratio(self.nis_mean));
        writeln!(f, "{}", field("consistency", consistency))?;
        let TraceSummary { r#final: end, median } = self.position_trace_m2;
        writeln!(f, "{}", field("position trace", format_args!("{end:.3} m^2 at the end, {median:.3} median")))?;
        writeln!(f, "{}\n{}", field(self.measured(), ranges), field("headings", headings))?;
        self.fmt_doubtful_messages(f)?;
        self.fmt_doubtful_sensors(f)?;
        if latency_us.count > 0 {
            let LatencySummary { p50, p90, p99, p99_9, max, .. } = latency_us;
            let waits = format!("{p50:.0} us p50, {p90:.0} p90, {p99:.0} p99, {p99_9:.0} p99.9, {max:.0} max");
            writeln!(f, "{}", field("range to heading", waits))?;
            let hops = self.hops_us.named();
            let hops: Vec<String> = hops.iter().map(|(name, hop)| format!("{name} {:.1}", hop.p50)).collect();
            writeln!(f, "{}", field("hops, us p50", hops.join(", ")))?;
        }
        for node in self.nodes.iter().filter(|node| node.starts != 1 || node.kills + node.exits > 0) {
            let NodeSummary { starts, kills, exits, hangs, .. } = node;
            let hung = if *hangs > 0 { format!(", hung {}", counted(hangs, "time")) } else { String::new() };
            let [starts, kills, exits] =
                [(starts, "start"), (kills, "kill"), (exits, "early exit")].map(|(count, what)| counted(count, what));
            let history = format!("{starts}, {kills}, {exits}{hung}");
            writeln!(f, "{}", field_in(DOUBTFUL, &node.title(), history))?;
        }
        writeln!(f, "{}", field("digest", &self.digest))?;
        write!(f, "{}", self.verdict)
    }
}

impl std::fmt::Display for RangeSummary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { published, fused, rejected, late, missing, .. } = self;
        write!(f, "{published} published: {fused} fused, {rejected} rejected, {late} late, {missing} missing")
    }
}

impl std::fmt::Display for HeadingSummary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { fresh, late, none, refused } = self;
        write!(f, "{fresh} fresh, {late} late, {none} none, {refused} refused")
    }
}

/// Most sensors that are printed; the file has all.
const SENSOR_LINES_MAX: usize = 5;

impl Report {
    /// The sensors that lost many of their ranges or bearings, if any, and whether the gate was widened.
    fn fmt_doubtful_sensors(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let share = |count: u64, of: u64| count as f64 / of as f64;
        let mut doubtful: Vec<(f64, String)> = Vec::new();
        for SensorSummary { name, ranges, rejected, distrusted, bearings, .. } in &self.sensors {
            let of_bearings = bearings
                .as_ref()
                .map(|of: &BearingSummary| (of.bearings, "bearings", of.bearings_rejected, of.bearings_distrusted));
            for (all, kind, rejected, distrusted) in
                std::iter::once((*ranges, "ranges", *rejected, *distrusted)).chain(of_bearings)
            {
                let lost = share(rejected + distrusted, all);
                if lost > DOUBTFUL_SHARE {
                    let [rejected, distrusted] = [rejected, distrusted].map(|count| 100.0 * share(count, all));
                    let text = format!("{rejected:.0} % of {all} {kind} rejected, {distrusted:.0} % distrusted");
                    doubtful.push((lost, format!("{}: {text}", printable(name))));
                }
            }
        }
        doubtful.sort_by(|(a, _), (b, _)| b.total_cmp(a));
        for (_, text) in doubtful.into_iter().take(SENSOR_LINES_MAX) {
            writeln!(f, "{}", field_in(DOUBTFUL, "sensor", text))?;
        }
        if self.gate_widened > 0 {
            let times = format!("at {}: most sensors failed the gate together", counted(self.gate_widened, "tick"));
            writeln!(f, "{}", field_in(DOUBTFUL, "noise raised", times))?;
        }
        Ok(())
    }

    /// Refused messages and distrusted robots, if any.
    fn fmt_doubtful_messages(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { refused, distrusted, .. } = self;
        if *refused != RefusalSummary::default() {
            let RefusalSummary { impostor, out_of_range, malformed, future, contradiction, jump } = refused;
            let causes = format!(
                "{impostor} impostor, {out_of_range} out of range, {malformed} malformed, {future} future, \
                 {contradiction} contradiction, {jump} jump"
            );
            writeln!(f, "{}", field_in(DOUBTFUL, "refused", causes))?;
        }
        for Distrust { robot, sensor, kind, from_tick, to_tick } in distrusted.iter().take(DISTRUST_LINES_MAX) {
            let until = to_tick.map_or("the end".to_owned(), |tick| format!("tick {tick}"));
            let time = format!(
                "{}{} from tick {from_tick} to {until}",
                name_of(*robot, self.recording.as_ref().map(|_| sensor.as_str())),
                of_bearings(kind)
            );
            writeln!(f, "{}", field_in(DOUBTFUL, "distrusted", time))?;
        }
        if let Some(more) = distrusted.len().checked_sub(DISTRUST_LINES_MAX).filter(|more| *more > 0) {
            writeln!(f, "{}", field_in(DOUBTFUL, "distrusted", counted(more, "more time")))?;
        }
        Ok(())
    }
}

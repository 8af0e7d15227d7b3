//! The report as it is printed.

use super::{Distrust, NodeSummary, RefusalSummary, Report};
use crate::hops;

/// Times of distrust that are told one by one in print; the file has all.
const DISTRUST_LINES_MAX: usize = 5;

impl std::fmt::Display for Report {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { ranges, headings, refused, distrusted, latency_us, .. } = self;
        writeln!(f, "{}: {} robots, {} planner, seed {}", self.scenario, self.robots, self.planner, self.seed)?;
        writeln!(
            f,
            "  {:<16} {} ticks in {:.2} s ({:.0} ticks/s)",
            self.clock, self.ticks, self.wall_s, self.ticks_per_s
        )?;
        if let Some(rmse_m) = self.position_rmse_m {
            writeln!(f, "  position error   {rmse_m:.3} m RMS")?;
        }
        let ratio = |value: Option<f64>| value.map_or("unknown".to_owned(), |value| format!("{value:.2}"));
        writeln!(f, "  consistency      ANEES {}, NIS {}; 1 is ideal", ratio(self.anees), ratio(self.nis_mean))?;
        writeln!(
            f,
            "  position trace   {:.3} m^2 at the end, {:.3} median",
            self.position_trace_m2.r#final, self.position_trace_m2.median
        )?;
        writeln!(
            f,
            "  ranges           {} published: {} fused, {} rejected, {} late, {} missing",
            ranges.published, ranges.fused, ranges.rejected, ranges.late, ranges.missing
        )?;
        writeln!(
            f,
            "  headings         {} fresh, {} late, {} none, {} refused",
            headings.fresh, headings.late, headings.none, headings.refused
        )?;
        if *refused != RefusalSummary::default() {
            let RefusalSummary { impostor, out_of_range, malformed, future, contradiction, jump } = refused;
            writeln!(
                f,
                "  refused          {impostor} impostor, {out_of_range} out of range, {malformed} malformed, \
                 {future} future, {contradiction} contradiction, {jump} jump"
            )?;
        }
        for Distrust { robot, from_tick, to_tick } in distrusted.iter().take(DISTRUST_LINES_MAX) {
            let until = to_tick.map_or("the end".to_owned(), |tick| format!("tick {tick}"));
            writeln!(f, "  distrusted       robot {robot} from tick {from_tick} to {until}")?;
        }
        if let Some(more) = distrusted.len().checked_sub(DISTRUST_LINES_MAX).filter(|more| *more > 0) {
            writeln!(f, "  distrusted       {more} times more")?;
        }
        if latency_us.count > 0 {
            writeln!(
                f,
                "  range to heading {:.0} us p50, {:.0} p90, {:.0} p99, {:.0} p99.9, {:.0} max",
                latency_us.p50, latency_us.p90, latency_us.p99, latency_us.p99_9, latency_us.max
            )?;
            let hops = hops::NAMES.iter().zip(self.hops_us.in_order());
            let hops: Vec<String> = hops.map(|(name, hop)| format!("{name} {:.1}", hop.p50)).collect();
            writeln!(f, "  hops, us p50     {}", hops.join(", "))?;
        }
        for node in self.nodes.iter().filter(|node| node.starts != 1 || node.kills + node.exits > 0) {
            let NodeSummary { name, starts, kills, exits, hangs, .. } = node;
            let hung = if *hangs > 0 { format!(", hung {hangs} times") } else { String::new() };
            writeln!(f, "  {name:<16} {starts} starts, {kills} kills, {exits} early exits{hung}")?;
        }
        write!(f, "  digest           {}", self.digest)
    }
}

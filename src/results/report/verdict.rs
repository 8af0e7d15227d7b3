//! Whether a run's result is credible: a pure function from figures to a verdict with its reasons.

use serde::Serialize;

use super::consistency::ConsistencySummary;
use super::measured;
use crate::statistics::Interval;
use crate::terminal::{BAD, DOUBTFUL, GOOD, prose_in};

/// Share of a sensor's ranges that are not fused, above which the sensor counts as faulty.
const FAULTY_SHARE: f64 = 0.5;

/// Fewest ranges by which a sensor is judged.
const JUDGED_RANGES_MIN: u64 = 8;

/// Share of the ranges of sensors without fault that a valid filter may reject.
const REJECTED_SHARE_MAX: f64 = 0.2;

/// Standard deviation of the position over a typical range, above which the target is not located.
pub(super) const VAGUE_SHARE: f64 = 0.3;

/// Share of the ticks with widened noise, above which the model is wrong.
const WIDENED_SHARE_MAX: f64 = 0.2;

/// Share of the run that a true track must cover; below it a note is added.
const TRUTH_SHARE_MIN: f64 = 0.5;

/// Most digits after the point of a figure that is near the limits of its band.
const DIGITS_MAX: usize = 6;

/// Most reasons in a verdict.
const REASONS_MAX: usize = 2;

/// The evidence about a run's result.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Evidence {
    /// Each sensor's ranges.
    pub sensors: Vec<SensorEvidence>,
    /// NIS of the fused ranges.
    pub nis: Option<ConsistencySummary>,
    /// NIS of all ranges of sensors that are not faulty.
    pub nis_all: Option<ConsistencySummary>,
    /// The same with each range's contribution limited, so that a few rejected outliers do not dominate it.
    pub nis_capped: Option<ConsistencySummary>,
    /// Normalised position error squared; `None` without truth.
    pub anees: Option<ConsistencySummary>,
    /// The true track that the user gave; `None` without one.
    pub truth: Option<TruthEvidence>,
    /// Median standard deviation of the position (square root of the trace) in the second half of the run, m.
    pub position_std_m: f64,
    /// Median of all ranges, and of the distances of bearings without a range, m.
    pub median_distance_m: f64,
    /// Share of the ticks at which the noise was widened, as most ranges failed the gate together.
    pub raised_noise_share: f64,
    /// Standard deviation that is assumed of a range, m: the median of the sensors'; `None` if none measures ranges.
    pub range_std_m: Option<f64>,
    /// The same of a bearing, rad.
    pub bearing_std_rad: Option<f64>,
    /// Facts about a recording; `None` for a simulated run.
    pub recording: Option<RecordingEvidence>,
}

/// The outcome of a sensor's ranges.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct SensorEvidence {
    /// The sensor's display name.
    pub name: String,
    /// Ranges that fusion has.
    pub ranges: u64,
    /// Ranges that it fused.
    pub fused: u64,
}

/// A true track beside the run.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TruthEvidence {
    /// Share of the ticks at which it gives a position.
    pub covered_share: f64,
    /// First and last time of the track, s.
    pub span_s: [f64; 2],
    /// First and last time of the run, s.
    pub run_span_s: [f64; 2],
}

/// Facts about a recording.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RecordingEvidence {
    /// Doubts of the reader about the file's meaning, for example its units.
    pub doubts: Vec<String>,
    /// True if the sensors have heights, and the target has none: ranges are taken as level.
    pub has_unused_heights: bool,
}

/// Whether a result is credible.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Verdict {
    /// True if no evidence contradicts it.
    pub valid: bool,
    /// The same, for programs that read the key's earlier name.
    sound: bool,
    /// The evidence, in one line.
    pub summary: String,
    /// Likely reasons if the result is invalid: one or two.
    pub reasons: Vec<String>,
    /// Further remarks.
    pub notes: Vec<String>,
}

impl Evidence {
    fn has_bearings(&self) -> bool {
        self.bearing_std_rad.is_some()
    }

    fn measured(&self) -> &'static str {
        measured(self.has_bearings())
    }

    /// The assumed standard deviations, with their units.
    fn assumed_noise(&self) -> String {
        let [range, bearing] = [(self.range_std_m, "m"), (self.bearing_std_rad, "rad")]
            .map(|(std, unit)| std.map(|std| format!("{std} {unit}")));
        range.into_iter().chain(bearing).collect::<Vec<String>>().join(" and ")
    }

    /// The flags that assume this many times as much.
    fn flags_of_noise(&self, factor: f64) -> String {
        let range = self.range_std_m.map(|std_m| format!("--range-std {:.2}", std_m * factor));
        let bearing = self.bearing_std_rad.map(|std_rad| format!("--bearing-std {:.4}", std_rad * factor));
        range.into_iter().chain(bearing).collect::<Vec<String>>().join(" ")
    }
}

impl SensorEvidence {
    fn rejected_share(&self) -> f64 {
        1.0 - self.fused as f64 / self.ranges.max(1) as f64
    }

    /// True if most of its ranges were not fused.
    #[must_use]
    pub fn is_faulty(&self) -> bool {
        self.ranges >= JUDGED_RANGES_MIN && self.rejected_share() > FAULTY_SHARE
    }
}

impl Verdict {
    /// Judges the evidence.
    #[must_use]
    pub fn of(evidence: &Evidence) -> Self {
        let symptoms = Symptoms::of(evidence);
        let mut reasons = symptoms.reasons(evidence);
        reasons.truncate(REASONS_MAX);
        let valid = !symptoms.any();
        Self { valid, sound: valid, summary: summary(evidence, &symptoms), reasons, notes: notes(evidence, valid) }
    }
}

/// Evidence against a result.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Symptoms {
    nothing_fused: bool,
    rejects_most: bool,
    rejects_many: bool,
    misfits: bool,
    errs: bool,
    is_vague: bool,
    is_doubtful: bool,
    misses_truth: bool,
}

impl Symptoms {
    fn of(evidence: &Evidence) -> Self {
        let Evidence { sensors, .. } = evidence;
        let [ranges, fused] = [|s: &SensorEvidence| s.ranges, |s: &SensorEvidence| s.fused]
            .map(|count| sensors.iter().map(count).sum::<u64>());
        let heard = sensors.iter().filter(|sensor| sensor.ranges > 0).count();
        let faulty = sensors.iter().filter(|sensor| sensor.is_faulty()).count();
        let (others, others_fused) = sensors
            .iter()
            .filter(|sensor| !sensor.is_faulty())
            .fold((0, 0), |(ranges, fused), sensor| (ranges + sensor.ranges, fused + sensor.fused));
        let others_share = 1.0 - others_fused as f64 / others.max(1) as f64;
        let rejects_most = ranges > 0 && 2 * faulty >= heard.max(1) && faulty > 0;
        let is_overconfident =
            |summary: &Option<ConsistencySummary>| summary.as_ref().is_some_and(ConsistencySummary::is_overconfident);
        Self {
            nothing_fused: fused == 0,
            rejects_most,
            rejects_many: !rejects_most && others_share > REJECTED_SHARE_MAX
                || evidence.raised_noise_share > WIDENED_SHARE_MAX,
            misfits: is_overconfident(&evidence.nis_capped) || is_overconfident(&evidence.nis),
            errs: is_overconfident(&evidence.anees),
            is_vague: fused > 0 && evidence.position_std_m > VAGUE_SHARE * evidence.median_distance_m,
            is_doubtful: evidence.recording.as_ref().is_some_and(|recording| !recording.doubts.is_empty()),
            misses_truth: evidence.truth.is_some_and(|truth| truth.covered_share == 0.0),
        }
    }

    fn any(self) -> bool {
        self != Self::default()
    }

    /// True if the ranges contradict each other or the model.
    fn contradicts(self) -> bool {
        self.nothing_fused || self.rejects_most || self.rejects_many || self.misfits || self.errs
    }

    /// The likely reasons, the likeliest first.
    fn reasons(self, evidence: &Evidence) -> Vec<String> {
        let recording = evidence.recording.iter();
        let mut reasons: Vec<String> = recording.clone().flat_map(|recording| recording.doubts.clone()).collect();
        if self.contradicts() && recording.clone().any(|recording| recording.has_unused_heights) {
            reasons.push(
                "the sensors have heights, and the target may have another: the ranges are then slant, too long for \
                 the plane; give --target-height M"
                    .to_owned(),
            );
        }
        if let Some(truth) = evidence.truth.filter(|_| self.misses_truth) {
            let ([from_s, to_s], [first_s, last_s]) = (truth.span_s, truth.run_span_s);
            reasons.push(format!(
                "the true track ({from_s:.1} to {to_s:.1} s) does not overlap the run ({first_s:.1} to {last_s:.1} s), so \
                 no error is known: if the two files have different clocks, shift the stamps of one"
            ));
        }
        if self.contradicts() && reasons.is_empty() {
            reasons.push(self.reason_of_misfit(evidence));
        }
        if self.is_vague && reasons.len() < REASONS_MAX {
            reasons.push(self.reason_of_vagueness(evidence));
        }
        reasons
    }

    fn reason_of_misfit(self, evidence: &Evidence) -> String {
        let measured = evidence.measured();
        let heard = evidence.sensors.iter().filter(|sensor| sensor.ranges > 0).count();
        if self.nothing_fused && evidence.sensors.iter().all(|sensor| sensor.ranges == 0) {
            let one = measured.trim_end_matches('s');
            return format!("no {one} was received: see logs/ in the run folder");
        }
        let is_recorded = evidence.recording.is_some();
        if !is_recorded && self.errs && !self.misfits {
            return format!(
                "the error is larger than the filter believes although the {measured} fit: robots came as close to the \
                 target as its position is uncertain; keep a distance with --stand-off"
            );
        }
        if !is_recorded {
            return format!(
                "the {measured} do not fit the scenario's model: noise, prior or target model differ from the truth"
            );
        }
        let faulty = evidence.sensors.iter().find(|sensor| sensor.is_faulty());
        if let Some(SensorEvidence { name, ranges, fused }) = faulty.filter(|_| !self.rejects_most) {
            return format!(
                "sensor {name} contradicts the others: {fused} of its {ranges} {measured} were fused; correct its place \
                 or bias, or leave it out"
            );
        }
        let misfit = evidence.nis_capped.or(evidence.nis).filter(|_| self.misfits).map(|nis| nis.mean.sqrt());
        match misfit {
            _ if self.errs && heard <= 2 => self.reason_of_vagueness(evidence),
            Some(misfit) => {
                let (assumed, flags) = (evidence.assumed_noise(), evidence.flags_of_noise(misfit));
                format!(
                    "the {measured} are off by {misfit:.1} times what the assumed {assumed} allows: a bias, sensors in the wrong \
                     place, or more noise (try {flags}){}",
                    if evidence.has_bearings() { "" } else { "; `rangehound calibrate` shows which" }
                )
            }
            None if evidence.has_bearings() => {
                "the measurements contradict each other or the truth: a bias, a wrong unit, sensors in the wrong place or with \
                 a wrong heading, or two targets"
                    .to_owned()
            }
            None if self.errs => "the error is larger than the filter believes although the ranges fit: a bias that is \
                                  common to the sensors, or wrong sensor positions; `rangehound calibrate` looks for a bias"
                .to_owned(),
            None => "the ranges contradict each other: a bias, a wrong unit, sensors in the wrong place, or two targets; \
                     `rangehound calibrate` looks for a bias"
                .to_owned(),
        }
    }

    fn reason_of_vagueness(self, evidence: &Evidence) -> String {
        let heard = evidence.sensors.iter().filter(|sensor| sensor.ranges > 0).count();
        let std_m = evidence.position_std_m;
        if evidence.has_bearings() {
            return format!(
                "the position is known to {std_m:.1} m only: the bearings hardly cross, too few measurements were received, or \
                 the target's noise is set far too high"
            );
        }
        match heard {
            0..=2 => format!(
                "{heard} sensor{} cannot distinguish the target from its mirror image: the position is known to {std_m:.1} m only; \
                 add a sensor, or give --start",
                if heard == 1 { "" } else { "s" }
            ),
            _ => format!(
                "the position is known to {std_m:.1} m only: the sensors lie on a line, too few ranges were received, or the \
                 target's noise (--accel-psd) is set far too high"
            ),
        }
    }
}

fn summary(evidence: &Evidence, symptoms: &Symptoms) -> String {
    let [ranges, fused] = [|s: &SensorEvidence| s.ranges, |s: &SensorEvidence| s.fused]
        .map(|count| evidence.sensors.iter().map(count).sum::<u64>());
    let measured = evidence.measured();
    let mut parts = vec![format!("{fused} of {ranges} {measured} fused")];
    let misfits = |nis: Option<ConsistencySummary>| nis.is_some_and(|nis| nis.is_overconfident());
    // The one that decides.
    let nis = if misfits(evidence.nis) && !misfits(evidence.nis_capped) {
        (format!("NIS of the fused {measured}"), evidence.nis)
    } else {
        ("NIS with outliers capped".to_owned(), evidence.nis_capped)
    };
    for (name, figure) in [nis, ("ANEES".to_owned(), evidence.anees)] {
        parts.extend(figure.map(|figure| format!("{name} {}", with_band(&figure))));
    }
    if !symptoms.nothing_fused {
        parts.push(format!("position known to {:.2} m", evidence.position_std_m));
    }
    parts.join(", ")
}

/// A figure and its place in its band, with as many digits as tell value and limits apart.
fn with_band(figure: &ConsistencySummary) -> String {
    let ConsistencySummary { mean, band_95: Interval { low, high }, .. } = *figure;
    let place = match mean {
        _ if mean > high => "above",
        _ if mean < low => "below",
        _ => "in",
    };
    let printed = |digits| [mean, low, high].map(|value| format!("{value:.digits$}"));
    let tells_apart = |[mean, low, high]: &[String; 3]| mean != low && mean != high && low != high;
    let [mean, low, high] = (2..=DIGITS_MAX).map(printed).find(tells_apart).unwrap_or_else(|| printed(2));
    format!("{mean} ({place} its band {low} to {high})")
}

fn notes(evidence: &Evidence, valid: bool) -> Vec<String> {
    let mut notes = Vec::new();
    let measured = evidence.measured();
    let faulty: Vec<&SensorEvidence> = evidence.sensors.iter().filter(|sensor| sensor.is_faulty()).collect();
    if valid && let [only] = faulty[..] {
        let share = 100.0 * only.rejected_share();
        notes.push(format!("sensor {} was left out: {share:.0} % of its {measured} did not fit the others", only.name));
    } else if valid && !faulty.is_empty() {
        let names: Vec<&str> = faulty.iter().map(|sensor| sensor.name.as_str()).collect();
        let names = names.join(", ");
        notes.push(format!("sensors {names} were left out: most of their {measured} did not fit the others"));
    }
    if let Some(nis) = evidence.nis_all.filter(|nis| nis.mean < 0.5 && nis.mean < nis.band_95.low) {
        let (assumed, flags) = (evidence.assumed_noise(), evidence.flags_of_noise(nis.mean.sqrt()));
        notes.push(format!(
            "the filter is cautious: the {measured} are better than the assumed {assumed} ({flags} fits)"
        ));
    }
    if let Some(truth) =
        evidence.truth.filter(|truth| (f64::MIN_POSITIVE..TRUTH_SHARE_MIN).contains(&truth.covered_share))
    {
        let share = 100.0 * truth.covered_share;
        notes.push(format!("the error covers {share:.0} % of the ticks: the true track has no others"));
    }
    notes
}

impl std::fmt::Display for Verdict {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { valid, sound: _, summary, reasons, notes } = self;
        let (style, word) = if *valid { (GOOD, "valid") } else { (BAD, "not valid") };
        write!(f, "{}", prose_in(style, "verdict", format_args!("{word}: {summary}")))?;
        for reason in reasons {
            write!(f, "\n{}", prose_in(BAD, "likely reason", reason))?;
        }
        for note in notes {
            write!(f, "\n{}", prose_in(DOUBTFUL, "note", note))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn figure(mean: f64) -> Option<ConsistencySummary> {
        let band_95 = Interval { low: 0.8, high: 1.2 };
        Some(ConsistencySummary { mean, band_95, independent_samples: 100.0 })
    }

    fn sensor(name: &str, ranges: u64, fused: u64) -> SensorEvidence {
        SensorEvidence { name: name.to_owned(), ranges, fused }
    }

    /// A valid recording of three sensors in a hall.
    fn good() -> Evidence {
        Evidence {
            sensors: ["A", "B", "C"].map(|name| sensor(name, 100, 99)).into(),
            nis: figure(1.0),
            nis_all: figure(1.1),
            nis_capped: figure(1.1),
            anees: figure(0.9),
            truth: Some(TruthEvidence { covered_share: 1.0, span_s: [0.0, 10.0], run_span_s: [0.0, 10.0] }),
            position_std_m: 0.1,
            median_distance_m: 5.0,
            raised_noise_share: 0.0,
            range_std_m: Some(0.1),
            bearing_std_rad: None,
            recording: Some(RecordingEvidence::default()),
        }
    }

    /// The reasons of an invalid result.
    fn reasons(evidence: &Evidence) -> String {
        let verdict = Verdict::of(evidence);
        assert!(!verdict.valid && (1..=REASONS_MAX).contains(&verdict.reasons.len()), "{verdict:?}");
        verdict.reasons.join("; ")
    }

    #[test]
    fn a_good_result_is_valid() {
        let verdict = Verdict::of(&good());
        assert!(verdict.valid && verdict.reasons.is_empty() && verdict.notes.is_empty(), "{verdict:?}");
        assert!(verdict.summary.contains("297 of 300 ranges fused"), "{verdict:?}");
    }

    #[test]
    fn one_faulty_sensor_is_named_and_does_not_make_the_rest_invalid() {
        let mut evidence = good();
        evidence.sensors[1] = sensor("2938", 100, 20);
        let verdict = Verdict::of(&evidence);
        assert!(verdict.valid && verdict.notes[0].contains("sensor 2938 was left out: 80 %"), "{verdict:?}");
        let dragged = Evidence { nis_capped: figure(4.0), ..evidence.clone() };
        assert!(reasons(&dragged).contains("sensor 2938 contradicts the others: 20 of its 100"));
        // With two of three faulty sensors, the faulty ones cannot be identified.
        evidence.sensors[0] = sensor("A", 100, 30);
        assert!(reasons(&evidence).contains("rangehound calibrate"));
    }

    #[test]
    fn doubts_of_the_reader_come_first() {
        let doubts =
            vec!["the ranges are in millimetres".to_owned(), "the stamps too".to_owned(), "and more".to_owned()];
        let recording = Some(RecordingEvidence { doubts, ..RecordingEvidence::default() });
        assert_eq!(reasons(&Evidence { recording, ..good() }), "the ranges are in millimetres; the stamps too");
    }

    #[test]
    fn a_true_track_on_another_clock_is_reported() {
        let truth = TruthEvidence { covered_share: 0.0, span_s: [1.7e9, 1.7e9 + 9.0], run_span_s: [0.1, 10.0] };
        let evidence = Evidence { truth: Some(truth), anees: None, ..good() };
        assert!(reasons(&evidence).contains("does not overlap"));
        let truth = TruthEvidence { covered_share: 0.2, ..truth };
        assert!(Verdict::of(&Evidence { truth: Some(truth), ..good() }).notes[0].contains("20 % of the ticks"));
    }

    #[test]
    fn misfits_have_reasons_that_match_their_pattern() {
        let misfit = Evidence { nis_all: figure(90.0), nis_capped: figure(9.0), ..good() };
        assert!(reasons(&misfit).contains("--range-std 0.30"));
        let heights = || RecordingEvidence { has_unused_heights: true, ..RecordingEvidence::default() };
        assert!(reasons(&Evidence { recording: Some(heights()), ..misfit.clone() }).contains("--target-height"));
        assert!(Verdict::of(&Evidence { recording: Some(heights()), ..good() }).valid);
        assert!(reasons(&Evidence { anees: figure(30.0), ..good() }).contains("common to the sensors"));
        assert!(reasons(&Evidence { anees: figure(30.0), recording: None, ..good() }).contains("--stand-off"));
        let rejected = ["A", "B", "C"].map(|name| sensor(name, 100, 60));
        assert!(reasons(&Evidence { sensors: rejected.into(), nis: figure(0.9), ..good() }).contains("calibrate"));
        assert!(reasons(&Evidence { raised_noise_share: 0.3, ..good() }).contains("calibrate"));
    }

    #[test]
    fn bearings_have_words_and_flags_of_their_own() {
        let cameras = Evidence { range_std_m: None, bearing_std_rad: Some(0.02), ..good() };
        assert!(Verdict::of(&cameras).summary.contains("297 of 300 measurements fused, NIS with outliers capped"));
        let misfit = Evidence { nis_all: figure(90.0), nis_capped: figure(9.0), ..cameras.clone() };
        assert!(
            reasons(&misfit).contains("3.0 times what the assumed 0.02 rad allows")
                && reasons(&misfit).contains("(try --bearing-std 0.0600)")
        );
        let both = Evidence { range_std_m: Some(0.1), ..misfit };
        assert!(reasons(&both).contains("(try --range-std 0.30 --bearing-std 0.0600)"));
        assert!(reasons(&Evidence { position_std_m: 6.0, ..cameras }).contains("bearings hardly cross"));
    }

    #[test]
    fn the_summary_has_the_nis_that_decides() {
        let summary =
            |nis, nis_capped| Verdict::of(&Evidence { nis, nis_all: figure(90.0), nis_capped, ..good() }).summary;
        let capped = summary(figure(1.0), figure(3.0));
        assert!(
            capped.contains("fused, NIS with outliers capped 3.00 (above its band 0.80 to 1.20), ANEES"),
            "{capped}"
        );
        let fused = summary(figure(2.5), figure(1.0));
        assert!(fused.contains("fused, NIS of the fused ranges 2.50 (above its band 0.80 to 1.20), ANEES"), "{fused}");
    }

    #[test]
    fn a_figure_and_its_limits_are_printed_with_as_many_digits_as_tell_them_apart() {
        let with_band = |mean, low, high| {
            super::with_band(&ConsistencySummary { mean, band_95: Interval { low, high }, independent_samples: 1.0 })
        };
        assert_eq!(with_band(1.0, 0.8, 1.25), "1.00 (in its band 0.80 to 1.25)");
        assert_eq!(with_band(0.969, 0.971, 1.03), "0.969 (below its band 0.971 to 1.030)");
        assert_eq!(with_band(1.0, 1.0, 1.0), "1.00 (in its band 1.00 to 1.00)");
    }

    #[test]
    fn a_few_outliers_do_not_rule_the_verdict() {
        assert!(Verdict::of(&Evidence { nis_all: figure(20.0), nis_capped: figure(1.5), ..good() }).valid);
    }

    #[test]
    fn an_ambiguous_position_is_reported() {
        let two = vec![sensor("A", 100, 100), sensor("B", 100, 100)];
        assert!(reasons(&Evidence { sensors: two, position_std_m: 6.0, ..good() }).contains("mirror image"));
        assert!(reasons(&Evidence { position_std_m: 6.0, ..good() }).contains("on a line"));
        let silent = vec![sensor("A", 0, 0)];
        assert!(
            reasons(&Evidence { sensors: silent, nis: None, nis_capped: None, anees: None, ..good() })
                .contains("logs/")
        );
    }

    #[test]
    fn a_cautious_filter_is_valid_and_noted() {
        let verdict = Verdict::of(&Evidence { nis_all: figure(0.09), ..good() });
        assert!(verdict.valid && verdict.notes[0].contains("--range-std 0.03"), "{verdict:?}");
    }
}

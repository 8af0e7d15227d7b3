//! `report.html`: the page of a finished run.

use rustix::process::Signal;

use crate::support::{Run, signal};

const LIMIT_BYTES: usize = 1_000_000;

/// The headings of a page, in order, after a check that it is complete and needs no other file.
fn headings(page: &str) -> Vec<&str> {
    assert!(page.starts_with("<!DOCTYPE html>") && page.trim_end().ends_with("</html>"), "{page}");
    assert!(page.len() < LIMIT_BYTES, "{} bytes", page.len());
    let foreign = page.replace("http://www.w3.org/2000/svg", "");
    for reference in ["http", "<link", "<script", "src=", "url(", "@import", "NaN", "inf,"] {
        assert!(!foreign.contains(reference), "{reference}");
    }
    for tag in ["figure", "section", "main", "dl", "svg"] {
        let count = |start: &str| page.matches(&format!("{start}{tag}")).count();
        assert_eq!(count("<"), count("</"), "{tag}");
    }
    assert_eq!(page.matches("<svg").count(), page.matches("<figure>").count());
    page.split("<h2>").skip(1).filter_map(|rest| rest.split_once("</h2>")).map(|(heading, _)| heading).collect()
}

#[test]
fn a_run_with_a_killed_node_has_all_pictures_and_shows_the_fault() {
    let run = Run::new();
    let supervisor = run.lockstep("--ticks 5000 --timeout forever");
    run.wait_for_ticks(300);
    signal(run.pid_of("robot-1", 1), Signal::KILL);
    run.pid_of("robot-1", 2);
    supervisor.finish().succeeded();
    let page = run.read("report.html");
    let expected = ["Paths", "Position error", "Trace", "NIS", "Latency", "Hops", "Faults"];
    assert_eq!(headings(&page), expected);
    assert_eq!(page.matches("<svg").count(), expected.len());
    for expected in [
        "<td>robot-1 killed</td>",
        "<td>robot-1 started</td>",
        "range to heading, p99",
        "<dt>ranges</dt>",
        &run.digest(),
    ] {
        assert!(page.contains(expected), "{expected}\n{page}");
    }
    assert!(page.find("robot-1 killed") < page.find("robot-1 started"));
    assert!(!page.contains("<td>robot-0"), "{page}");
    let headings =
        page.split_once("<dt>headings</dt><dd>").and_then(|(_, rest)| rest.split_once(" refused")).unwrap().0;
    assert!(["fresh, ", "late, ", "none, "].iter().all(|what| headings.contains(what)), "{headings}");
    assert!(page.contains("The half axes of the last ellipse are ") && page.contains("from range to heading, µs"));
    run.assert_nothing_left();
}

#[test]
fn unknown_facts_have_no_section() {
    let run = Run::new();
    run.lockstep("--in-process --ticks 3000 --robots 100 --write-recording").finish().succeeded();
    let page = run.read("report.html");
    assert_eq!(headings(&page), ["Paths", "Position error", "Trace", "NIS", "Faults"]);
    assert!(page.contains("No node ended before the run did") && page.matches("<svg").count() == 4);
    // Its planner proves no bound for the trace.
    assert!(!page.contains("proven lower bound"), "{page}");
    let proven = Run::new();
    proven.lockstep("--in-process --ticks 100 --planner certified").finish().succeeded();
    assert!(proven.read("report.html").contains("proven lower bound"));
    let tracked = Run::new();
    tracked.write("ranges.csv", run.read("ranges.csv"));
    tracked.command("track ranges.csv --range-std 1.0 --accel-psd 10 --in-process").finish().succeeded();
    assert_eq!(headings(&tracked.read("report.html")), ["Paths", "Trace", "NIS", "Faults"]);
}

#[test]
fn the_page_of_a_recording_has_nothing_on_headings_that_no_sensor_follows() {
    let run = Run::new();
    run.write("ranges.csv", include_str!("../../scenarios/recording/ranges.csv"));
    run.command("track ranges.csv --range-std 0.15 --accel-psd 0.05").finish().succeeded();
    let page = run.read("report.html");
    assert_eq!(headings(&page), ["Paths", "Trace", "NIS", "Faults"]);
    assert!(!page.contains("<dt>headings</dt>") && !page.contains("range to heading"), "{page}");
    // Programs find the figures all the same.
    assert!(run.report()["latency_us"]["count"].as_u64() > Some(0));
    run.assert_nothing_left();
}

//! The flags for recordings of real robots, on recordings that are not part of the project.

use serde_json::Value;

use super::page::{Mark, Page, root};
use crate::support::Run;

/// The mark of the block.
pub(super) const WHAT: &str = "recordings of real robots";

/// The files that the block names, and the recordings of the table: with cameras, with odometry, indoors.
const RECORDINGS: [(&str, &str); 3] =
    [("camera.csv", "mrclam7_t1_bearing"), ("odometry.csv", "tiers_a_bcd_dead"), ("indoor.csv", "labyrinth")];

/// Each command gives the figures of its row in the table below the block.
#[test]
#[ignore = "needs recordings that are not part of the project, in ../shared/data; .ci/run runs it where they are"]
fn the_flags_for_recordings_of_real_robots_give_the_figures_of_the_book() {
    let page = Page::of("docs/uncertain.md");
    let block = page.commands().find(|block| block.mark == Some(Mark::With(WHAT.to_owned()))).unwrap();
    let table = page.prose().into_iter().skip_while(|(line, _)| *line < block.line).map(|(_, line)| line);
    let rows: Vec<&str> =
        table.skip_while(|line| !line.starts_with('|')).skip(2).take_while(|line| line.starts_with('|')).collect();
    // `0.098 / 0.94 and 0.100 / 0.88`: position error and ANEES of one command or two.
    let figures: Vec<Vec<f64>> = rows
        .iter()
        .flat_map(|row| row.trim_end_matches(" |").rsplit_once("| ").unwrap().1.split(" and "))
        .map(|pair| pair.split(" / ").map(|figure| figure.parse().unwrap()).collect())
        .collect();
    let commands: Vec<&str> = block.text.lines().filter(|line| !line.starts_with('#')).collect();
    assert_eq!((commands.len(), figures.len()), (4, 4), "{commands:?} {rows:?}");

    let data = root().join("../shared/data");
    for (command, figures) in commands.into_iter().zip(figures) {
        let (file, recording) = RECORDINGS.into_iter().find(|(file, _)| command.contains(file)).unwrap();
        let run = Run::new();
        for (name, source) in [(file, "ranges.csv"), ("truth.csv", "truth.csv")] {
            std::os::unix::fs::symlink(data.join(recording).join(source), run.path(name)).unwrap();
        }
        let words: Vec<&str> = command.split_whitespace().skip(1).chain(["--name", &run.name, "--json"]).collect();
        let outcome = run.start(&words).finish().succeeded();
        let report: Value = serde_json::from_str(&outcome.stdout).unwrap();
        let found = &report["found"]["position_rmse_m"];
        let rmse_m = found.as_f64().or(report["position_rmse_m"].as_f64()).unwrap();
        let measured = [rmse_m, report["anees"].as_f64().unwrap()];
        println!("{recording}: {measured:?}, in the book {figures:?}");
        let is_equal = |(measured, figure): (&f64, &f64)| (measured / figure - 1.0).abs() < 0.02;
        assert!(figures.len() == 2 && measured.iter().zip(&figures).all(is_equal), "{command}: {measured:?}");
    }
}

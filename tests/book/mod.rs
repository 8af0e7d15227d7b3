//! README, ARCHITECTURE.md and the book in `docs/`: their commands work, and their links and names exist.

mod commands;
mod page;
mod provided;
mod radio;
mod recordings;
mod refusals;
mod sources;

use std::collections::BTreeSet;
use std::path::Path;

use page::{Block, Page, names, root};
use rangehound_shared::scenario::{
    LocaliserTable, RecordedSensorTable, RecordingTable, RobotTable, RobotsTable, SensorTable,
};
use serde_json::Value;
use sources::Sources;

use crate::support::Run;

/// Languages of blocks that are not run; [`commands`] tests the others.
const SHOWN: [&str; 2] = ["text", "toml"];

/// Limits of length, so that README and ARCHITECTURE.md stay short.
const LINES_MAX: [(&str, usize); 2] = [("README.md", 150), ("ARCHITECTURE.md", 120)];

fn assert_none(faults: Vec<String>) {
    assert!(faults.is_empty(), "{} faults:\n{}", faults.len(), faults.join("\n"));
}

/// Every page that names present files and functions.
fn pages() -> Vec<Page> {
    let mut pages = Page::of_book();
    pages.extend(["README.md", "ARCHITECTURE.md"].map(Page::of));
    pages
}

#[test]
fn links_and_names_lead_somewhere() {
    let sources = Sources::read();
    let mut faults = Vec::new();
    for page in pages().into_iter().chain([Page::of("CHANGELOG.md")]) {
        for (line, link) in page.links() {
            if !leads_somewhere(&page, link) {
                faults.push(format!("{}: no such page, or no such heading: {link}", page.at(line)));
            }
        }
    }
    for page in pages() {
        for (line, name) in page.names() {
            if is_path(&sources, name) && !sources.has(name) {
                faults.push(format!("{}: no such file: {name}", page.at(line)));
            }
            if is_of_rust(name) && !sources.has_words(name) {
                faults.push(format!("{}: not in the sources: {name}", page.at(line)));
            }
        }
    }
    assert_none(faults);
}

fn leads_somewhere(page: &Page, link: &str) -> bool {
    if link.starts_with("https://") {
        return true;
    }
    let (path, anchor) = link.split_once('#').map_or((link, None), |(path, anchor)| (path, Some(anchor)));
    let path = if path.is_empty() { page.path.clone() } else { page.path.parent().unwrap().join(path) };
    let path = root().join(path);
    let found = path.exists() && path.canonicalize().unwrap().starts_with(root().canonicalize().unwrap());
    found && anchor.is_none_or(|anchor| Page::of(path.to_str().unwrap()).anchors().contains(anchor))
}

/// Whether a name in backticks is one of the project's files or folders.
fn is_path(sources: &Sources, name: &str) -> bool {
    let is_source = Path::new(name).extension().is_some_and(|extension| extension == "rs" || extension == "py");
    let is_folder = name.ends_with('/') && !name.starts_with('/') && !name.contains("NAME");
    let first = name.split_once('/').map(|(first, _)| first);
    !name.contains(' ') && (is_source || is_folder || first.is_some_and(|first| sources.has_at_its_root(first)))
}

/// Whether a name in backticks is that of a type or function: `Plan`, `Centre::update`.
fn is_of_rust(name: &str) -> bool {
    let is_type = name.starts_with(|c: char| c.is_ascii_uppercase())
        && name.chars().nth(1).is_some_and(|c| c.is_ascii_lowercase());
    name.chars().all(|c| c.is_alphanumeric() || c == ':' || c == '_') && (is_type || name.contains("::"))
}

#[test]
fn each_invariant_names_the_test_that_holds_it() {
    let sources = Sources::read();
    let page = Page::of("ARCHITECTURE.md");
    let mut faults = Vec::new();
    for (line, bullet) in page.section("Invariants").into_iter().filter(|(_, line)| line.starts_with("- ")) {
        let tests: Vec<&str> = bullet.split_once("Test: ").into_iter().flat_map(|(_, tests)| names(tests)).collect();
        if tests.is_empty() && !bullet.contains("lints check it") {
            faults.push(format!("{}: no test: {bullet}", page.at(line)));
        }
        let unknown = tests.iter().filter(|test| !sources.has_test(test));
        faults.extend(unknown.map(|test| format!("{}: no such test: {test}", page.at(line))));
    }
    assert_none(faults);
}

#[test]
fn each_change_names_its_test() {
    let sources = Sources::read();
    let page = Page::of("docs/extend.md");
    let rows =
        page.prose().into_iter().filter_map(|(line, row)| Some((line, row.strip_suffix(" |")?.rsplit_once("| ")?.1)));
    let tests = rows.flat_map(|(line, cell)| names(cell).map(move |name| (line, name)));
    let unknown = tests.filter(|(_, name)| !sources.has_test(name) && !sources.has(name));
    assert_none(unknown.map(|(line, name)| format!("{}: no such test: {name}", page.at(line))).collect());
}

#[test]
fn every_key_of_the_report_is_explained() {
    let run = Run::new();
    run.command("run --in-process --ticks 5").finish().succeeded();
    let mut keys = BTreeSet::new();
    collect_keys(&run.report(), &mut keys);
    let pages = ["docs/report.md", "docs/outliers.md"].map(Page::of);
    let explained: BTreeSet<&str> = pages.iter().flat_map(|page| page.names()).map(|(_, name)| name).collect();
    let faults = keys.iter().filter(|key| !explained.contains(key.as_str()));
    assert_none(faults.map(|key| format!("docs/report.md: not explained: {key}")).collect());
}

fn collect_keys(value: &Value, keys: &mut BTreeSet<String>) {
    match value {
        Value::Object(entries) => {
            for (key, value) in entries {
                keys.insert(key.clone());
                collect_keys(value, keys);
            }
        }
        Value::Array(values) => values.iter().for_each(|value| collect_keys(value, keys)),
        _ => {}
    }
}

/// Each key of the tables that describe robots, sensors and recordings is in backticks on the page for scenarios.
#[test]
fn every_key_of_robots_sensors_and_recordings_is_explained() {
    let tables = [
        serde_json::to_value(RobotsTable::default()),
        serde_json::to_value(RobotTable::default()),
        serde_json::to_value(SensorTable::default()),
        serde_json::to_value(LocaliserTable::default()),
        serde_json::to_value(RecordingTable::default()),
        serde_json::to_value(RecordedSensorTable::new("A".parse().unwrap())),
    ];
    let mut keys = BTreeSet::new();
    tables.into_iter().for_each(|table| collect_keys(&table.unwrap(), &mut keys));
    assert!(keys.contains("bearing_std_rad") && keys.contains("pose_drift_m"), "{keys:?}");
    let page = Page::of("docs/scenarios.md");
    let explained: BTreeSet<&str> = page.names().into_iter().map(|(_, name)| name).collect();
    let faults = keys.iter().filter(|key| !explained.contains(key.as_str()));
    assert_none(faults.map(|key| format!("docs/scenarios.md: not explained: {key}")).collect());
}

/// A line below the title that is no prose: it is empty, or the mark of a block.
fn is_title_or_mark(line: &str) -> bool {
    line.is_empty() || line.starts_with("# ") || line.starts_with("<!-- ")
}

#[test]
fn each_page_starts_with_a_command_and_ends_with_its_limits() {
    let mut faults = Vec::new();
    for page in Page::of_book() {
        let path = page.path.display();
        let first_words =
            page.prose().into_iter().find(|(_, line)| !is_title_or_mark(line)).map_or(0, |(line, _)| line);
        if page.commands().next().is_none_or(|block| block.line > first_words) {
            faults.push(format!("{path}: prose or a section before the first command"));
        }
        if page.headings().last().is_none_or(|(_, heading)| *heading != "Limits") {
            faults.push(format!("{path}: the last section is not Limits"));
        }
    }
    for page in pages() {
        let commands: BTreeSet<usize> = page.commands().map(|block| block.line).collect();
        let is_known = |block: &Block| commands.contains(&block.line) || SHOWN.contains(&block.language.as_str());
        let unknown = page.blocks().into_iter().filter(|block| !is_known(block));
        faults
            .extend(unknown.map(|block| format!("{}: neither run nor shown: {}", page.at(block.line), block.language)));
    }
    let contents = Page::of("docs/README.md");
    let listed: BTreeSet<&Path> = contents.links().into_iter().map(|(_, link)| Path::new(link)).collect();
    let pages = Page::of_book().into_iter().filter(|page| page.path != contents.path);
    let unlisted = pages.filter(|page| !listed.contains(Path::new(page.path.file_name().unwrap())));
    faults.extend(unlisted.map(|page| format!("docs/README.md: not listed: {}", page.path.display())));
    for (path, lines_max) in LINES_MAX {
        let lines = Page::of(path).text.lines().count();
        if lines > lines_max {
            faults.push(format!("{path}: {lines} lines, at most {lines_max}"));
        }
    }
    assert_none(faults);
}

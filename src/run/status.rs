//! `status`: the present state of a run as a table. Nodes in trouble come first; many robots in the same state share a line.

use std::fmt::Write as _;
use std::time::{Duration, Instant};

use anstyle::Style;
use rangehound_node::gateway_note::GatewayNote;
use rangehound_node::rendezvous::Rendezvous;
use rangehound_node::system::signal::Termination;
use rangehound_shared::run_name::RunName;
use rangehound_shared::scenario::printable;

use crate::failure::{self, Failure};
use crate::run::node::input_or_running;
use crate::run::remote::{ELSEWHERE, NodeStatus, Status, not_running, run_named};
use crate::terminal::{self, BAD, DOUBTFUL, GOOD, TITLE, field, wrapped};

/// All states, the worst first.
const STATES: [(&str, Style); 5] =
    [("gone", BAD), ("hung", DOUBTFUL), ("stopped", DOUBTFUL), (ELSEWHERE, DOUBTFUL), ("running", GOOD)];

/// More robots in one state than this share a line.
const ROBOTS_MAX: usize = 16;

/// Characters of a sensor's name in the table.
const SENSOR_CHARS_MAX: usize = 16;

/// A robot on another host that is silent for longer has no working link, ms.
const SILENT_MS: u64 = 500;

/// Interval at which `--watch` shows the state.
const REFRESH_INTERVAL: Duration = Duration::from_secs(1);

/// Time between two checks for Ctrl-C.
const POLL: Duration = Duration::from_millis(50);

/// `rangehound status`, once or every second, with a line for each robot or one for many in the same state.
///
/// # Errors
/// [`Failure`].
pub fn status(name: Option<&RunName>, shows_all: bool, again: bool, json: bool) -> Result<(), Failure> {
    let name = run_named(name)?;
    let termination = Termination::listen()?;
    let in_place = again && !json && terminal::draws_on_stdout();
    let mut is_first = true;
    // It joins only briefly, because a run does not end while it has members.
    while let Some(run) = Rendezvous::join_if_alive(&name).map_err(input_or_running)? {
        let status = Status::of(&run);
        drop(run);
        let text = if json { serde_json::to_string(&status)? } else { status.text(shows_all) };
        if in_place {
            terminal::clear_screen()?;
        } else if !is_first && !json {
            failure::print("\n")?;
        }
        let is_read = failure::print_if_read(text + "\n")?;
        if !again || !is_read {
            return Ok(());
        }
        is_first = false;
        let began = Instant::now();
        while began.elapsed() < REFRESH_INTERVAL && !termination.requested() {
            std::thread::sleep(POLL);
        }
        if termination.requested() {
            return Ok(());
        }
    }
    match (is_first, json) {
        (true, _) => Err(not_running(&name)),
        (false, true) => Ok(()),
        (false, false) => failure::print(format!("run {name} has ended\n")),
    }
}

/// A line or two of the table.
enum Row<'a> {
    Node(&'a NodeStatus),
    /// Robots in the same state.
    Robots(Vec<&'a NodeStatus>),
}

impl Status {
    /// The table; `all`: with a line for each robot.
    pub(crate) fn text(&self, all: bool) -> String {
        let Self { name, scenario, tick, ticks, out_dir, leader, leads, standbys, .. } = self;
        let mut out = format!("{TITLE}run {name}{TITLE:#}: {scenario}, tick {tick} of {ticks}\n");
        let what = match leader {
            _ if self.is_finishing() => field("finishing", "nodes are ending, recording and report are being written"),
            Some(pid) => {
                field("fusion", format!("process {pid} leads (leader {leads} of this run); {standbys} on standby"))
            }
            None if self.nodes.iter().any(|node| node.name == "fusion" && node.state == ELSEWHERE) => field(
                "fusion",
                format!("a process in another PID namespace leads (leader {leads} of this run); {standbys} on standby"),
            ),
            None => field("fusion", format!("{BAD}nobody leads{BAD:#}; {standbys} on standby")),
        };
        let sensor = if self.nodes.iter().any(|node| node.sensor.is_some()) { "sensor" } else { "" };
        let heads = ["node", "state", "pid", "starts", "silent", "memory", sensor].map(str::to_owned);
        let _ = writeln!(out, "{what}\n{}", field("run folder", out_dir));
        let _ = write!(out, "\n{}", line(TITLE, &heads));
        let rows = self.rows(all);
        for (style, row) in &rows {
            let _ = write!(out, "\n{}", line(*style, &row.cells()));
            // A line of robots that run needs no names: it has all that are not named elsewhere.
            if let Row::Robots(robots) = row
                && robots.iter().any(|robot| robot.state != "running")
            {
                let names = names_of_robots(robots.iter().filter_map(|robot| robot.robot()));
                let _ = write!(out, "\n{:<13}{}", "", wrapped(&names, 13));
            }
        }
        if rows.iter().any(|(_, row)| matches!(row, Row::Robots(_))) {
            out.push_str("\n\nOne line for several robots: longest silence, total memory. --all shows each.");
        }
        if rows.iter().any(|(_, row)| row.cells()[1] == ELSEWHERE) {
            out.push_str("\n\nelsewhere: in another PID namespace (container); run this command there.");
        }
        if let Some(gateway) = &self.gateway {
            out.push_str(&links(gateway));
        }
        out
    }

    fn is_finishing(&self) -> bool {
        self.phase == "finishing"
    }

    /// The rows, nodes in trouble first. Of a run that is over, nodes that are gone are left out, as all nodes end.
    fn rows(&self, all: bool) -> Vec<(Style, Row<'_>)> {
        let mut rows = Vec::new();
        for (state, style) in STATES.into_iter().filter(|(state, _)| !self.is_finishing() || *state != "gone") {
            let in_state = || self.nodes.iter().filter(move |node| node.state == state);
            let robots: Vec<&NodeStatus> = in_state().filter(|node| node.robot().is_some()).collect();
            let is_folded = !all && robots.len() > ROBOTS_MAX;
            let mut robots = Some(robots).filter(|_| is_folded);
            for node in in_state().filter(|node| !node.is_of_no_run()) {
                if !is_folded || node.robot().is_none() {
                    rows.push((style, Row::Node(node)));
                } else if let Some(robots) = robots.take() {
                    rows.push((style, Row::Robots(robots)));
                }
            }
        }
        rows
    }
}

impl NodeStatus {
    fn robot(&self) -> Option<usize> {
        self.name.strip_prefix("robot-")?.parse().ok()
    }

    /// True for the supervisor's entry if the run was started by hand, and so has none.
    fn is_of_no_run(&self) -> bool {
        self.name == "run" && self.starts == 0
    }
}

impl Row<'_> {
    fn cells(&self) -> [String; 7] {
        let or_none = |text: Option<String>| text.unwrap_or_else(|| "-".to_owned());
        let (name, pid, nodes) = match self {
            Self::Node(node) => (node.name.clone(), node.pid.map(|pid| pid.to_string()), std::slice::from_ref(node)),
            Self::Robots(robots) => (format!("{} robots", robots.len()), None, robots.as_slice()),
        };
        let state = nodes.first().map_or("", |node| node.state).to_owned();
        let starts = || nodes.iter().map(|node| node.starts);
        let starts = match (starts().min().unwrap_or(0), starts().max().unwrap_or(0)) {
            (least, most) if least == most => most.to_string(),
            (least, most) => format!("{least}-{most}"),
        };
        let silent_s = nodes.iter().filter_map(|node| node.silent_s).reduce(f64::max);
        let silent = silent_s.map(|silent_s| format!("{silent_s:.2} s"));
        let resident_kb = nodes.iter().filter_map(|node| node.resident_kb).reduce(|a, b| a + b);
        let memory = resident_kb.map(|kb| format!("{:.1} MB", kb as f64 / 1_024.0));
        let sensor = match self {
            Self::Node(node) => node.sensor.as_deref().map(shown_sensor),
            Self::Robots(_) => None,
        };
        [name, state, or_none(pid), starts, or_none(silent), or_none(memory), sensor.unwrap_or_default()]
    }
}

/// The links to robots on other hosts, and who was refused.
fn links(gateway: &GatewayNote) -> String {
    let heads = ["robot", "host", "address", "rtt", "lost", "resent", "silent"].map(str::to_owned);
    let mut out = format!("\n\n{TITLE}{}{TITLE:#}", link(&heads));
    for remote in &gateway.robots {
        let trip = remote.round_trip_us.map_or("-".to_owned(), |us| format!("{:.1} ms", us as f64 / 1_000.0));
        let percent = |part: f64| format!("{:.0} %", 100.0 * part);
        let silent = format!("{:.2} s", remote.silent_ms as f64 / 1_000.0);
        let (lost, repeated) = (percent(remote.lost), percent(remote.repeated));
        let (name, host) = (format!("robot-{}", remote.robot), shown_sensor(&remote.host));
        let style = if remote.silent_ms > SILENT_MS { DOUBTFUL } else { GOOD };
        let cells = [name, host, remote.address.clone(), trip, lost, repeated, silent];
        let _ = write!(out, "\n{style}{}{style:#}", link(&cells));
    }
    if !gateway.refusals.is_empty() {
        let refusals: Vec<String> = gateway.refusals.iter().map(|(cause, count)| format!("{cause} {count}")).collect();
        let _ = write!(out, "\n{}", field("refused", refusals.join(", ")));
    }
    out
}

/// A line of the links' table.
fn link([robot, host, address, trip, lost, repeated, silent]: &[String; 7]) -> String {
    format!("{robot:<10} {host:<16} {address:<21} {trip:>8} {lost:>5} {repeated:>6} {silent:>8}").trim_end().to_owned()
}

/// A row of the table, with the style of its state; or the heads.
fn line(style: Style, [name, state, pid, starts, silent, memory, sensor]: &[String; 7]) -> String {
    let sensor = if sensor.is_empty() { String::new() } else { format!("  {sensor}") };
    format!("{name:<12} {style}{state:<9}{style:#} {pid:>8} {starts:>7} {silent:>10} {memory:>10}{sensor}")
}

/// A sensor's name, shortened to the column's width; `--json` has it complete.
fn shown_sensor(name: &str) -> String {
    let name = printable(name);
    if name.chars().count() <= SENSOR_CHARS_MAX {
        return name;
    }
    name.chars().take(SENSOR_CHARS_MAX - 3).chain("...".chars()).collect()
}

/// Robots by ascending ids, with ranges of successive ones: `robot-7`, `robots 0 and 1`, `robots 0 to 4, 7`.
pub(crate) fn names_of_robots(ids: impl Iterator<Item = usize>) -> String {
    let mut runs: Vec<(usize, usize)> = Vec::new();
    for id in ids {
        match runs.last_mut() {
            Some((_, last)) if *last + 1 == id => *last = id,
            _ => runs.push((id, id)),
        }
    }
    let names = runs.iter().map(|(first, last)| match last - first {
        0 => first.to_string(),
        _ => format!("{first} to {last}"),
    });
    match runs[..] {
        [(first, last)] if first == last => format!("robot-{first}"),
        [(first, last)] if first + 1 == last => format!("robots {first} and {last}"),
        _ => format!("robots {}", names.collect::<Vec<_>>().join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use rangehound_node::gateway_note::RemoteRobotNote;

    use super::*;
    use crate::terminal::WIDTH;

    fn node(name: &str, state: &'static str) -> NodeStatus {
        let pid = (state != "gone").then_some(1_234_567);
        let (silent_s, resident_kb) = (pid.map(|_| 0.05), pid.map(|_| 20_480));
        NodeStatus { name: name.to_owned(), sensor: None, state, pid, starts: 1, silent_s, resident_kb }
    }

    fn status(robots: usize, state_of: impl Fn(usize) -> &'static str) -> Status {
        let mut nodes = vec![node("sim", "running"), node("fusion", "running")];
        nodes.extend((0..robots).map(|id| node(&format!("robot-{id}"), state_of(id))));
        nodes.push(node("run", "running"));
        Status {
            name: "a-name-of-24-letters-xxx".to_owned(),
            scenario: "a-scenario-of-24-letters".to_owned(),
            phase: "running",
            tick: 1_000_000,
            ticks: 1_000_000,
            out_dir: "runs/x".to_owned(),
            leader: Some(1_234_567),
            leads: 1_000,
            standbys: 2,
            nodes,
            gateway: None,
        }
    }

    #[test]
    fn links_to_other_hosts_and_refusals_are_shown() {
        let remote = |robot, silent_ms| RemoteRobotNote {
            robot,
            host: "a-host-with-a-long-name".to_owned(),
            address: "192.168.100.200:65535".to_owned(),
            round_trip_us: (robot == 0).then_some(1_260),
            lost: 0.126,
            repeated: 0.03,
            silent_ms,
            allows_control: false,
        };
        let mut status = status(2, |_| "running");
        let refusals = [("no certificate".to_owned(), 3)].into();
        status.gateway = Some(GatewayNote { pid: 1, robots: vec![remote(0, 20), remote(255, 123_456)], refusals });
        let text = text(&status, true);
        assert!(text.contains("1.3 ms  13 %    3 %   0.02 s") && text.contains("no certificate 3"), "{text}");
    }

    fn text(status: &Status, all: bool) -> String {
        let text = anstream::adapter::strip_str(&status.text(all)).to_string();
        assert!(text.lines().all(|line| line.len() <= WIDTH && line == line.trim_end()), "{text}");
        text
    }

    fn nodes_shown(text: &str) -> Vec<&str> {
        let table = text.lines().skip_while(|line| !line.starts_with("node ")).skip(1);
        table.take_while(|line| !line.is_empty()).map(|line| line[..12].trim_end()).collect()
    }

    #[test]
    fn nodes_in_trouble_come_first() {
        let states = ["running", "stopped", "gone", "hung"];
        let text = text(&status(4, |id| states[id]), false);
        assert_eq!(nodes_shown(&text), ["robot-2", "robot-3", "robot-1", "sim", "fusion", "robot-0", "run"]);
    }

    #[test]
    fn many_running_robots_share_a_line_and_the_others_do_not() {
        let status = status(128, |id| if id == 77 { "hung" } else { "running" });
        let folded = text(&status, false);
        assert_eq!(nodes_shown(&folded), ["robot-77", "sim", "fusion", "127 robots", "run"]);
        assert!(folded.contains("2540.0 MB") && folded.contains("--all"), "{folded}");
        let all = text(&status, true);
        assert_eq!(nodes_shown(&all).len(), 131);
        assert!(!all.contains("--all"), "{all}");
    }

    #[test]
    fn successive_robots_share_a_range() {
        let names = |ids: &[usize]| names_of_robots(ids.iter().copied());
        assert_eq!([&[7][..], &[0, 1], &[0, 2]].map(names), ["robot-7", "robots 0 and 1", "robots 0, 2"]);
        assert_eq!(names(&[0, 1, 2, 3, 4, 7]), "robots 0 to 4, 7");
    }

    #[test]
    fn many_robots_that_are_gone_are_listed_by_id() {
        let text = text(&status(256, |id| if id % 3 == 0 { "running" } else { "gone" }), false);
        assert!(text.contains("171 robots") || text.contains("170 robots"), "{text}");
        assert!(text.contains("robots 1 to 2, 4 to 5,") && text.contains("253 to 254"), "{text}");
    }

    #[test]
    fn a_finished_run_shows_only_living_nodes() {
        let mut over = status(3, |_| "gone");
        over.phase = "finishing";
        let text = text(&over, true);
        assert_eq!(nodes_shown(&text), ["sim", "fusion", "run"]);
        assert!(text.contains("  finishing ") && !text.contains("leads"), "{text}");
    }

    #[test]
    fn a_robots_row_shows_its_sensors_name() {
        let mut status = status(3, |_| "running");
        for (node, name) in status.nodes[2..].iter_mut().zip(["2938", "\u{202e}a\u{1b}[31m", &"n".repeat(64)]) {
            node.sensor = Some(name.to_owned());
        }
        let text = text(&status, false);
        let rows: Vec<&str> = text.lines().filter(|line| line.starts_with("robot-")).collect();
        assert!(rows[0].ends_with(" MB  2938") && rows[1].ends_with("  \\u{202e}a\\u{1..."), "{text}");
        assert!(rows[2].ends_with("  nnnnnnnnnnnnn..."), "{text}");
        assert!(serde_json::to_string(&status).unwrap().contains(r#""sensor":"2938""#));
    }

    #[test]
    fn a_run_started_by_hand_lacks_no_supervisor() {
        let mut by_hand = status(1, |_| "running");
        by_hand.nodes.pop();
        by_hand.nodes.push(NodeStatus { starts: 0, ..node("run", "gone") });
        assert_eq!(nodes_shown(&text(&by_hand, false)), ["sim", "fusion", "robot-0"]);
    }
}

//! Robots on other hosts that tools of the run's host may end, where their host allows that.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;

use rustix::process::{Signal, kill_process};

use crate::support::{Faults, LIMIT, Link, Process, Run};

/// Starts a robot again whenever it ends, as a service manager does, until there is a file `over`.
const SERVICE: &str = "while [ ! -e over ]; do timeout 150 \"$@\"; done";

fn starts(run: &Run, robot: usize) -> Option<u64> {
    run.status()?["nodes"].as_array()?.iter().find(|node| node["name"] == format!("robot-{robot}"))?["starts"].as_u64()
}

#[test]
fn only_robots_whose_host_allows_it_are_ended_from_the_runs_host() {
    let words = "--clock lockstep --timeout forever --robots 2 --ticks 100000 --seed 5";
    let run = Run::new();
    let (supervisor, gateway) = run.run(words);
    let link = Link::new(gateway, 7, Faults::default());
    let obeys = run.start_by(SERVICE, &format!("robot --id 0 --connect {} --allow-remote-control", link.address));
    let mut refuses = run.robot(1, gateway);
    run.wait_until_tick(50);
    run.wait_for("the links", || (run.status()?["gateway"]["robots"].as_array()?.len() == 2).then_some(()));
    let name = &run.name;

    // Never the gateway, which holds its role.
    let holder = run.gateway();
    let (code, text) = run.finish(&format!("kill robot-1 --name {name}"));
    assert!(code == Some(2) && text.contains("--allow-remote-control"), "{code:?}: {text}");
    assert!(refuses.is_running() && run.gateway() == holder);
    let (code, text) = run.finish(&format!("gateway --name {name} --listen 127.0.0.1:0"));
    assert!(
        code == Some(2) && text.contains("gateway of run") && text.contains("is already running"),
        "{code:?}: {text}"
    );

    run.finish_ok(&format!("kill robot-0 --name {name}"));
    run.wait_for("its successor", || (starts(&run, 0) >= Some(2)).then_some(()));
    assert!(obeys.stderr().contains("killed from the run's host"), "{}", obeys.stderr());

    let wait_for_its_link = || {
        run.wait_for("its link", || {
            let status = run.status()?;
            let robots = status["gateway"]["robots"].as_array()?;
            robots.iter().any(|joined| joined["robot"] == 0 && joined["allows_control"] == true).then_some(())
        });
    };
    wait_for_its_link();
    let before = starts(&run, 0);
    run.finish_ok(&format!("restart robot-0 --name {name}"));
    assert!(starts(&run, 0) > before);
    assert!(obeys.stderr().contains("asked to end from the run's host"), "{}", obeys.stderr());

    // An order over a link that is cut does not arrive, and not later either.
    wait_for_its_link();
    let starts_before = starts(&run, 0);
    link.cut(true, true);
    let (code, text) = run.finish(&format!("kill robot-0 --name {name}"));
    assert!(code == Some(1) && text.contains("did not reach robot-0"), "{code:?}: {text}");
    link.cut(false, false);
    let tick = run.tick();
    run.wait_until_tick(tick + 50);
    let kills = obeys.stderr().matches("killed from the run's host").count();
    assert_eq!((kills, starts(&run, 0)), (1, starts_before), "{}", obeys.stderr());

    // The gateway is a node of the run: it can be ended, and is started again.
    for command in ["kill", "restart"] {
        let before = run.gateway();
        if let Some(pid) = before.filter(|_| command == "restart") {
            // A stopped node can be restarted too.
            let _ = kill_process(pid, Signal::STOP);
        }
        run.finish_ok(&format!("{command} gateway --name {name}"));
        run.wait_for("its successor", || run.gateway().filter(|pid| Some(*pid) != before));
    }

    // The team goes on with it.
    let tick = run.tick();
    run.wait_until_tick(tick + 50);
    std::fs::write(run.path("over"), "").unwrap();
    run.finish_ok(&format!("stop --name {name}"));
    drop(supervisor);
    // It receives the notice that the run was stopped.
    refuses.succeeds();
    run.assert_nothing_left();
}

/// The live page's address and token.
struct Page {
    port: u16,
    token: String,
}

impl Page {
    fn of(run: &Run, live: &Process) -> Self {
        run.wait_for("the page's address", || {
            let text = live.stderr();
            let line = text.lines().find_map(|line| line.strip_prefix("live: http://127.0.0.1:"))?;
            let (port, token) = line.split_once("/?token=")?;
            Some(Self { port: port.parse().ok()?, token: token.to_owned() }).filter(|_| text.ends_with('\n'))
        })
    }

    /// Presses a button. Returns the answer's status and text.
    fn act(&self, action: &str, node: &str) -> (u16, String) {
        let Self { port, token } = self;
        let mut stream = TcpStream::connect(("127.0.0.1", *port)).unwrap();
        stream.set_read_timeout(Some(LIMIT)).unwrap();
        let request = format!(
            "POST /act/{action}/{node} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nX-Rangehound-Token: {token}\r\n\
             Content-Length: 0\r\nConnection: close\r\n\r\n"
        );
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        let (head, text) = answer.split_once("\r\n\r\n").unwrap();
        (head.split(' ').nth(1).unwrap().parse().unwrap(), text.to_owned())
    }
}

/// The buttons act on a robot of another host as the commands do. The run was started by hand: only the robot's own host starts
/// it again.
#[test]
fn the_buttons_of_the_live_page_act_on_robots_whose_host_allows_it() {
    let run = Run::new();
    let scenario = "clock = \"lockstep\"\ntimeout_s = \"forever\"\nticks = 1000000\n[robots]\ncount = 2\n";
    std::fs::write(run.path("team.toml"), scenario).unwrap();
    let start = |words: &str| run.start(&format!("{words} --name {}", run.name));
    let nodes = ["sim team.toml", "fusion", "gateway --listen 127.0.0.1:0"].map(start);
    let gateway = run.listens(&nodes[2]);
    let obeys = run.start_by(SERVICE, &format!("robot --id 0 --connect {gateway} --allow-remote-control"));
    let mut refuses = run.robot(1, gateway);
    let is_linked = |robot: usize| {
        run.wait_for("its link", || {
            let status = run.status()?;
            let robots = status["gateway"]["robots"].as_array()?;
            robots.iter().any(|joined| joined["robot"] == robot).then_some(())
        });
    };
    [0, 1].into_iter().for_each(is_linked);
    let live = start("live");
    let page = Page::of(&run, &live);
    for (action, node, expected) in [
        ("kill", "robot-1", "--allow-remote-control"),
        ("restart", "robot-1", "--allow-remote-control"),
        ("stop", "robot-1", "--allow-remote-control"),
        ("stop", "robot-0", "nothing can be stopped or continued there"),
        ("continue", "robot-0", "nothing can be stopped or continued there"),
        ("restart", "sim", "was started by hand"),
    ] {
        // On a busy machine the link may just be lost.
        run.wait_for(expected, || {
            let (status, text) = page.act(action, node);
            (status == 400 && text.contains(expected)).then_some(())
        });
    }
    for (action, message) in [("kill", "killed from the run's host"), ("restart", "asked to end from the run's host")] {
        is_linked(0);
        let before = starts(&run, 0);
        run.wait_for(action, || {
            let (status, text) = page.act(action, "robot-0");
            (status == 200 && text.contains("on the host 127.0.0.1")).then_some(())
        });
        run.wait_for("its successor", || (starts(&run, 0) > before).then_some(()));
        assert!(obeys.stderr().contains(message), "{}", obeys.stderr());
    }
    assert!(refuses.is_running());
    std::fs::write(run.path("over"), "").unwrap();
    run.finish_ok(&format!("stop --name {}", run.name));
    // It waits for the next run.
    refuses.ends();
    run.assert_nothing_left();
}

//! Robots on other hosts that tools of the run's host may end, where their host allows that.

use crate::support::{Faults, Link, Run};

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
    run.wait_for("the links", || (run.status()?["gateway"]["guests"].as_array()?.len() == 2).then_some(()));
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
            let guests = status["gateway"]["guests"].as_array()?;
            guests.iter().any(|guest| guest["robot"] == 0 && guest["allows_control"] == true).then_some(())
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
        run.finish_ok(&format!("{command} gateway --name {name}"));
        run.wait_for("its successor", || run.gateway().filter(|pid| Some(*pid) != before));
    }

    // The team goes on with it.
    let tick = run.tick();
    run.wait_until_tick(tick + 50);
    std::fs::write(run.path("over"), "").unwrap();
    run.finish_ok(&format!("stop --name {name}"));
    drop(supervisor);
    // It is told that the run was stopped.
    refuses.succeeds();
    run.assert_nothing_left();
}

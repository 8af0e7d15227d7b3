//! The live page: access, buttons, robustness against crowds and garbage; and in a real browser.

mod browser;
mod http;

use std::io::Write;
use std::time::Instant;

use rustix::process::{Pid, Signal};
use serde_json::Value;

use crate::support::{Process, Run, comm, digest_in_process, signal, skipped};
use browser::Browser;
use http::{Answer, Events, Page};

/// Largest size of the complete page.
const PAGE_BYTES_MAX: usize = 300_000;

/// A run without end, and its page.
fn endless(run: &Run) -> (Process, Page) {
    let supervisor = run.command("run --live --clock realtime --ticks 100000");
    let page = Page::of(run, &supervisor);
    (supervisor, page)
}

/// Ends a run in order.
fn end(run: &Run, supervisor: Process) {
    supervisor.signal(Signal::TERM);
    assert_eq!(supervisor.finish().code, Some(1));
    run.assert_nothing_left();
}

/// The kernel's letter for the state of a process.
fn state(pid: Pid) -> char {
    let stat = std::fs::read_to_string(format!("/proc/{}/stat", pid.as_raw_pid())).unwrap_or_default();
    stat.rsplit_once(") ").and_then(|(_, rest)| rest.chars().next()).unwrap_or('X')
}

/// The process that serves the page.
fn server_of(supervisor: &Process) -> Option<Pid> {
    let parent = supervisor.pid().as_raw_pid().to_string();
    let processes = std::fs::read_dir("/proc").unwrap().flatten();
    let mut pids = processes.filter_map(|entry| Pid::from_raw(entry.file_name().to_str()?.parse().ok()?));
    pids.find(|pid| {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", pid.as_raw_pid())).unwrap_or_default();
        let is_child = stat.rsplit_once(") ").is_some_and(|(_, rest)| rest.split(' ').nth(1) == Some(&*parent));
        is_child && comm(*pid) == "rh-live"
    })
}

#[test]
fn only_requests_with_the_token_and_origin_of_the_page_are_accepted() {
    let run = Run::new();
    let (supervisor, page) = endless(&run);
    let Page { port, token, .. } = &page;
    let host = format!("Host: 127.0.0.1:{port}");
    let wrong = "0".repeat(32);
    let act = "/act/kill/robot-1";
    let cases = [
        (200, "GET", format!("/?token={token}"), vec![host.clone()]),
        (200, "GET", format!("/?token={token}"), vec![format!("Host: localhost:{port}")]),
        (200, "GET", format!("/?token={token}"), vec![host.clone(), format!("Origin: http://127.0.0.1:{port}")]),
        (200, "GET", format!("/{token}/live.js"), vec![host.clone()]),
        (404, "GET", format!("/{token}/other.js"), vec![host.clone()]),
        (403, "GET", "/".to_owned(), vec![host.clone()]),
        (403, "GET", format!("/?token={wrong}"), vec![host.clone()]),
        (403, "GET", format!("/?token={}", &token[1..]), vec![host.clone()]),
        (403, "GET", "/stream".to_owned(), vec![host.clone()]),
        (403, "GET", format!("/stream?token={wrong}"), vec![host.clone()]),
        (403, "GET", format!("/{wrong}/live.js"), vec![host.clone()]),
        (403, "GET", "/etc/passwd".to_owned(), vec![host.clone()]),
        (403, "GET", format!("/?token={token}"), vec![]),
        (403, "GET", format!("/?token={token}"), vec!["Host: evil.example".to_owned()]),
        (403, "GET", format!("/?token={token}"), vec![format!("Host: evil.example:{port}")]),
        (403, "GET", format!("/?token={token}"), vec![host.clone(), "Origin: http://evil.example".to_owned()]),
        (403, "GET", format!("/stream?token={token}"), vec![host.clone(), "Origin: null".to_owned()]),
        (403, "POST", act.to_owned(), vec![host.clone()]),
        // Requests that a form of another page could send.
        (403, "POST", format!("{act}?token={token}"), vec![host.clone()]),
        (403, "POST", act.to_owned(), vec![host.clone(), format!("X-Rangehound-Token: {wrong}")]),
        (
            403,
            "POST",
            act.to_owned(),
            vec![host.clone(), format!("X-Rangehound-Token: {token}"), "Origin: http://evil.example".to_owned()],
        ),
        (403, "GET", act.to_owned(), vec![host.clone(), format!("X-Rangehound-Token: {token}")]),
        (405, "PUT", act.to_owned(), vec![host.clone(), format!("X-Rangehound-Token: {token}")]),
    ];
    // Through a tunnel with another local port: refused, with advice.
    let other = [format!("Host: localhost:{}", if *port == 9_000 { 9_001 } else { 9_000 })];
    let answer = page.ask("GET", &format!("/?token={token}"), &other);
    assert_eq!(answer.status, 403, "{answer:?}");
    assert!(answer.body.contains(&format!("ssh -L {port}:127.0.0.1:{port}")), "{answer:?}");
    assert!(answer.body.contains("--live=PORT") && answer.body.trim_end().lines().count() == 1, "{answer:?}");
    for (status, method, path, headers) in cases {
        let answer = page.ask(method, &path, &headers);
        assert_eq!(answer.status, status, "{method} {path} {headers:?}: {answer:?}");
        for header in
            ["cache-control: no-store", "referrer-policy: no-referrer", "content-security-policy: default-src 'none'"]
        {
            assert!(answer.head.to_ascii_lowercase().contains(header), "{header}: {}", answer.head);
        }
        assert!(status == 200 || !answer.body.contains(token.as_str()), "{answer:?}");
    }
    // No node was killed.
    assert_eq!(run.starts("robot-1"), 1);
    end(&run, supervisor);
}

#[test]
fn the_page_is_small_and_needs_nothing_from_elsewhere() {
    let run = Run::new();
    let (supervisor, page) = endless(&run);
    let html = page.get("/?token=").body;
    let mut bytes = html.len();
    let mut files: Vec<String> =
        html.split('"').filter_map(|part| part.strip_prefix(&format!("/{}/", page.token))).map(str::to_owned).collect();
    let mut texts = vec![html];
    let mut at = 0;
    while let Some(file) = files.get(at).cloned() {
        let Answer { status, body, .. } = page.ask("GET", &format!("/{}/{file}", page.token), &[page.host()]);
        assert_eq!(status, 200, "{file}");
        bytes += body.len();
        let imported = body.split("from \"./").skip(1).filter_map(|rest| rest.split_once('"')).map(|(name, _)| name);
        let new: Vec<String> =
            imported.filter(|name| !files.iter().any(|file| file == name)).map(str::to_owned).collect();
        files.extend(new);
        texts.push(body);
        at += 1;
    }
    assert!(files.len() >= 6, "{files:?}");
    assert!(bytes < PAGE_BYTES_MAX, "{bytes} bytes");
    eprintln!("the live page has {bytes} bytes in {} files", files.len() + 1);
    for text in texts {
        for reference in ["http:", "https:", "//cdn", "@import", "url("] {
            assert!(!text.contains(reference), "{reference}\n{text}");
        }
    }
    end(&run, supervisor);
}

#[test]
fn buttons_kill_stop_continue_and_restart() {
    let run = Run::new();
    let (supervisor, page) = endless(&run);
    let mut events = Events::open(&page);
    let first = run.pid_of("robot-1", 1);
    assert_eq!(page.act("kill", "robot-1").status, 200);
    let second = run.pid_of("robot-1", 2);
    assert_ne!(first, second);
    // The page is notified.
    events.until("nodes", |nodes| {
        let node = |name: &str| nodes["nodes"].as_array().unwrap().iter().find(|node| node["name"] == name).cloned();
        node("robot-1").is_some_and(|node| node["pid"] == second.as_raw_pid() && node["starts"] == 2)
    });

    let robot = run.pid_of("robot-0", 1);
    assert_eq!(page.act("stop", "robot-0").status, 200);
    run.wait_until("robot-0 is stopped", || state(robot) == 'T');
    assert_eq!(page.act("continue", "robot-0").status, 200);
    run.wait_until("robot-0 goes on", || matches!(state(robot), 'S' | 'R'));
    // A stopped node can be restarted too.
    assert_eq!(page.act("stop", "robot-0").status, 200);
    assert_eq!(page.act("restart", "robot-0").status, 200);
    run.pid_of("robot-0", 2);

    for (status, action, node) in [
        (400, "kill", "robot-3"),
        (400, "kill", "robot--1"),
        (400, "kill", "run"),
        (400, "kill", ""),
        (400, "kill", "%2e%2e"),
        (400, "kill", "robot-99999999999999999999"),
        (400, "explode", "robot-1"),
        (409, "kill", "standby-1"),
        (409, "kill", "standby-18446744073709551615"),
    ] {
        let answer = page.act(action, node);
        assert_eq!(answer.status, status, "{action} {node}: {answer:?}");
        assert!(answer.body.lines().count() == 1, "{answer:?}");
    }
    end(&run, supervisor);
}

#[test]
fn a_viewer_sees_the_run_to_its_last_tick_and_its_end() {
    let run = Run::new();
    let words = "--ticks 20000 --timeout forever --robots 5";
    let supervisor = run.lockstep(&format!("{words} --live"));
    let page = Page::of(&run, &supervisor);
    let (mut ticks, mut points): (Vec<u64>, Vec<Value>) = (Vec::new(), Vec::new());
    let (mut abouts, mut ended) = (0, None);
    let mut events = Events::open(&page);
    while let Some((name, data)) = events.next() {
        match name.as_str() {
            "about" => {
                abouts += 1;
                assert_eq!(data["robots"], 5);
                assert_eq!(data["ticks"], 20_000);
            }
            "picture" => {
                ticks.push(data["tick"].as_u64().unwrap());
                assert_eq!(data["robots"].as_array().unwrap().len(), 5);
                points.truncate(data["history"]["from"].as_u64().unwrap() as usize);
                points.extend(data["history"]["points"].as_array().unwrap().iter().cloned());
                assert!(points.len() < 600);
            }
            "ended" => ended = Some(data),
            _ => {}
        }
    }
    assert!(abouts == 1 && ticks.is_sorted() && ticks.last() == Some(&20_000), "{ticks:?}");
    assert_eq!(ended, Some(Value::from("finished")));
    assert_eq!(points.last().unwrap()[0], 20_000);
    supervisor.finish().succeeded();
    // Observers do not change a bit of any estimate.
    assert_eq!(run.digest(), digest_in_process(words));
    run.assert_nothing_left();
}

#[test]
fn a_recording_is_shown_again_as_it_was_or_would_have_been() {
    let run = Run::new();
    run.command("run --in-process --ticks 60 --record").finish().succeeded();
    for (words, planner) in [("--speed 40", "bit-identical"), ("--speed 1e6 --planner random", "random")] {
        let args = format!("replay out/run.mcap --live {words}");
        let replay = run.start(&args.split_whitespace().collect::<Vec<_>>());
        let page = Page::of(&run, &replay);
        let (mut last, mut ended) = (Value::Null, None);
        let mut events = Events::open(&page);
        while let Some((name, data)) = events.next() {
            match name.as_str() {
                "picture" => last = data,
                "ended" => ended = Some(data),
                _ => {}
            }
        }
        assert_eq!((&last["tick"], last["robots"].as_array().unwrap().len()), (&Value::from(60), 3));
        assert_eq!(ended, Some(Value::from("The recording has ended.")));
        let output = replay.finish().succeeded();
        assert!(output.stdout.contains(planner), "{output:?}");
    }
    for (words, expected) in [("--speed 2", "--live"), ("--live --speed 0", "--speed")] {
        let args = format!("replay out/run.mcap {words}");
        let refused = run.start(&args.split_whitespace().collect::<Vec<_>>()).finish();
        assert!(refused.code == Some(2) && refused.complaints()[..].len() == 1, "{refused:?}");
        assert!(refused.stderr.contains(expected), "{refused:?}");
    }
}

#[test]
fn crowds_garbage_and_viewers_that_do_not_read_do_no_harm() {
    let run = Run::new();
    let (supervisor, page) = endless(&run);
    // They open all available streams, and read none.
    let stuck: Vec<_> = (0..20)
        .map(|_| {
            let mut viewer = page.connect();
            let request = format!("GET /stream?token={} HTTP/1.1\r\n{}\r\n\r\n", page.token, page.host());
            viewer.write_all(request.as_bytes()).unwrap();
            viewer
        })
        .collect();
    run.wait_until("no further viewer is let in", || page.get("/stream?token=").status == 503);
    for garbage in [
        &b"\0\0\0\0"[..],
        b"GET / HTTP/1.1\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
        b"GET / HTTP/9.9\r\n\r\n",
        b"POST /act/kill/sim HTTP/1.1\r\nContent-Length: 99999999999999999999\r\n\r\n",
        &[b'A'; 100_000],
    ] {
        let mut connection = page.connect();
        // The server may close the connection in the middle.
        let _ = connection.write_all(garbage);
    }
    let long = page.ask("GET", "/", &[page.host(), format!("X-Long: {}", "x".repeat(40_000))]);
    assert!(matches!(long.status, 0 | 431), "{long:?}");
    // More clients than allowed: the others are refused, and afterwards the page works as before.
    let crowd: Vec<_> = (0..200).map(|_| page.try_connect()).collect();
    drop(crowd);
    drop(stuck);
    // Closed connections are noticed one by one.
    run.wait_until("a viewer sees a picture again", || {
        let mut events = Events::open(&page);
        std::iter::from_fn(|| events.next()).any(|(name, _)| name == "picture")
    });
    let server = server_of(&supervisor).unwrap();
    let status = std::fs::read_to_string(format!("/proc/{}/status", server.as_raw_pid())).unwrap();
    let resident_kb =
        status.lines().find_map(|line| line.strip_prefix("VmRSS:")?.trim().split(' ').next()?.parse().ok());
    assert!(resident_kb.is_some_and(|kb: u64| kb < 100_000), "{status}");
    end(&run, supervisor);
}

#[test]
fn a_killed_page_returns_at_its_address_with_its_history() {
    let run = Run::new();
    let (supervisor, page) = endless(&run);
    run.wait_for_ticks(25);
    let first = server_of(&supervisor).unwrap();
    signal(first, Signal::KILL);
    run.wait_until("the page is there again", || {
        page.try_connect().is_some()
            && server_of(&supervisor).is_some_and(|server| server != first)
            && page.get("/?token=").status == 200
    });
    // Counts, curves and trails include the time before the kill.
    Events::open(&page).until("picture", |picture| {
        let ticks = picture["counts"]["ticks"].as_u64().unwrap();
        let points = picture["history"]["points"].as_array().unwrap();
        ticks >= 20 && points.len() >= 20 && points[0][0] == 1
    });
    Events::open(&page).until("trails", |trails| trails.as_array().unwrap().len() >= 20);
    end(&run, supervisor);
}

#[test]
fn a_run_by_hand_has_a_page_but_no_restarts() {
    let run = Run::new();
    let live = run.node("live");
    let sim = run.command("sim --clock realtime --ticks 100000 --robots 1");
    let page = Page::of(&run, &live);
    let nodes = [run.node("fusion"), run.node("robot --id 0")];
    let mut events = Events::open(&page);
    events.until("picture", |picture| picture["tick"].as_u64() > Some(3));
    let answer = page.act("restart", "fusion");
    assert!(answer.status == 400 && answer.body.contains("by hand"), "{answer:?}");
    let taken = run.node(&format!("live --port {}", page.port)).finish();
    let [complaint] = taken.complaints()[..] else { panic!("{taken:#?}") };
    assert!(taken.code == Some(2) && complaint.contains("expected one that is free"), "{taken:#?}");
    let other = run.node("live --json");
    run.wait_until("another page is announced", || other.stdout().ends_with('\n'));
    let output: Value = serde_json::from_str(&other.stdout()).unwrap();
    assert_eq!(output["name"], run.name.as_str());
    assert!(output["address"].as_str().unwrap().starts_with("http://127.0.0.1:"), "{output}");
    other.signal(Signal::TERM);
    other.finish().succeeded();
    // When the last node has ended, the page ends too.
    for node in nodes.iter().chain([&sim]) {
        node.signal(Signal::KILL);
    }
    nodes.into_iter().chain([sim]).for_each(|node| drop(node.finish()));
    while events.next().is_some_and(|(name, _)| name != "ended") {}
    live.finish().succeeded();
    run.wait_until("the run's folder is gone", || !run.shared_folder().exists());
}

#[test]
fn a_file_that_cannot_be_shown_is_refused_in_one_line() {
    for (words, expected) in [
        ("run --live=x", "--live"),
        ("run --live=65536", "--live"),
        ("run --in-process --live", "--live"),
        ("run --live --live", "--live"),
    ] {
        crate::support::assert_refused_at_once(words, expected);
    }
    let run = Run::new();
    let refused = run.node("live --port -1").finish();
    assert!(refused.code == Some(2) && refused.stderr.lines().count() == 1, "{refused:?}");
}

#[test]
fn in_a_real_browser_the_canvas_moves_and_a_kill_button_kills() {
    let Some(mut browser) = Browser::start() else {
        skipped("the live page in a browser", "no chromium, chromium-browser, google-chrome or $RANGEHOUND_BROWSER");
        return;
    };
    let run = Run::new();
    let began = Instant::now();
    let (supervisor, page) = endless(&run);
    browser.visit(&page.url);
    browser.wait_for("Number(document.documentElement.dataset.pictures) >= 1");
    eprintln!("first picture {} ms after the start of the run", began.elapsed().as_millis());
    browser.wait_for("Number(document.documentElement.dataset.pictures) >= 3");
    assert_eq!(browser.evaluate("location.pathname + location.search"), "/");

    let pixels = "document.getElementById('field').toDataURL()";
    let before = browser.evaluate(pixels);
    assert!(before.as_str().unwrap().len() > 2_000, "{before}");
    run.wait_until("the canvas has changed", || browser.evaluate(pixels) != before);

    let first = run.pid_of("robot-1", 1);
    browser.evaluate("document.querySelector('tr[data-node=robot-1] button.kill').click()");
    let second = run.pid_of("robot-1", 2);
    assert_ne!(first, second);
    let row = "document.querySelector('tr[data-node=robot-1]').textContent";
    browser.wait_for(&format!("{row}.includes('{}') && {row}.includes('running')", second.as_raw_pid()));

    // By keyboard.
    let stopped = run.pid_of("robot-2", 1);
    browser.evaluate("document.querySelector('tr[data-node=robot-2] button.stop').focus()");
    browser.press_enter();
    run.wait_until("robot-2 is stopped", || state(stopped) == 'T');
    browser.wait_for("document.querySelector('tr[data-node=robot-2] .state').textContent == 'stopped'");
    browser.wait_for("document.activeElement.dataset.action == 'continue'");
    browser.press_enter();
    run.wait_until("robot-2 goes on", || state(stopped) != 'T');

    for (width_px, height_px) in [(375, 800), (800, 800), (1024, 800), (1150, 800), (1200, 800), (1280, 800)] {
        browser.resize(width_px, height_px);
        browser.wait_for(&format!("innerWidth == {width_px}"));
        let width = browser.evaluate("document.documentElement.scrollWidth");
        assert!(width.as_u64() <= Some(width_px), "{width} px wide at {width_px}");
        // After a kill there are two pids in a row; the longer button acts like `continue`.
        let overflow = "(() => {
            document.querySelector('tr[data-node=robot-1] button.stop').textContent = 'continue';
            const panel = document.getElementById('processes').getBoundingClientRect().right;
            const ends = [...document.querySelectorAll('td button')].map((button) => button.getBoundingClientRect().right);
            return Math.max(...ends) - panel;
        })()";
        let over_px = browser.evaluate(overflow);
        assert!(over_px.as_f64() < Some(0.0), "buttons end {over_px} px beyond their panel at {width_px}");
        let unnamed = "[...document.querySelectorAll('button:not([hidden]), canvas')]\
                       .filter((element) => !element.ariaLabel && !element.textContent.trim()).length";
        assert_eq!(browser.evaluate(unnamed), 0);
    }
    assert_eq!(browser.complaints(), [""; 0]);

    // Reloaded without a token in its address, the page still works.
    browser.reload();
    browser.wait_for("Number(document.documentElement.dataset.pictures) >= 2");
    end(&run, supervisor);
    browser.wait_for("document.getElementById('connection').dataset.state == 'ended'");
    assert_eq!(browser.evaluate("document.getElementById('connection').textContent"), "ended early");
    let states =
        "[...new Set([...document.querySelectorAll('tbody .state')].map((state) => state.textContent))].join()";
    assert_eq!(browser.evaluate(states), "ended");
    assert_eq!(browser.evaluate("document.querySelectorAll('td button:not([hidden])').length"), 0);
    assert_ne!(browser.evaluate("document.querySelector('#figures dd').textContent"), "");
    browser.close();
}

//! A real browser without a window, controlled by the DevTools protocol over two pipes.

use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tempfile::TempDir;

const BROWSERS: [&str; 3] = ["chromium", "chromium-browser", "google-chrome"];

/// Far above the time of any step.
const LIMIT: Duration = Duration::from_secs(60);

const POLL: Duration = Duration::from_millis(20);

pub(super) struct Browser {
    child: Child,
    commands: File,
    answers: Receiver<Value>,
    session: Option<String>,
    sent: u64,
    complaints: Vec<String>,
    // Removed when the browser has ended.
    _profile: TempDir,
}

impl Browser {
    /// `None` if this machine has no browser.
    pub(super) fn start() -> Option<Self> {
        let program = find()?;
        let profile = TempDir::new().unwrap();
        let [to, from] = ["to", "from"].map(|name| profile.path().join(name));
        assert!(Command::new("mkfifo").args([&to, &from]).status().unwrap().success());
        // The protocol uses descriptors 3 and 4.
        let child = Command::new("sh")
            .args(["-c", "exec \"$0\" \"$@\" 3<\"$TO\" 4>\"$FROM\""])
            .arg(&program)
            .args(["--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run"])
            .args(["--remote-debugging-pipe", "about:blank"])
            .arg(format!("--user-data-dir={}", profile.path().join("profile").display()))
            .env("TO", &to)
            .env("FROM", &from)
            .env("HOME", profile.path())
            .env("TMPDIR", profile.path())
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        // In the order in which the shell opens them: each end waits for the other.
        let commands = File::options().write(true).open(&to).unwrap();
        let input = BufReader::new(File::open(&from).unwrap());
        let (send, answers) = mpsc::channel();
        std::thread::spawn(move || {
            for message in input.split(0).map_while(Result::ok) {
                if send.send(serde_json::from_slice(&message).unwrap_or(Value::Null)).is_err() {
                    return;
                }
            }
        });
        let mut browser =
            Self { child, commands, answers, session: None, sent: 0, complaints: Vec::new(), _profile: profile };
        let target = browser.call("Target.createTarget", json!({"url": "about:blank"}))["targetId"].clone();
        let attached = browser.call("Target.attachToTarget", json!({"targetId": target, "flatten": true}));
        browser.session = Some(attached["sessionId"].as_str().unwrap().to_owned());
        for domain in ["Runtime.enable", "Log.enable", "Page.enable"] {
            browser.call(domain, json!({}));
        }
        Some(browser)
    }

    /// Sends a command and waits for its result.
    #[track_caller]
    fn call(&mut self, method: &str, params: Value) -> Value {
        self.sent += 1;
        let id = self.sent;
        let mut message = json!({"id": id, "method": method, "params": params});
        if let Some(session) = &self.session {
            message["sessionId"] = json!(session);
        }
        self.commands.write_all(format!("{message}\0").as_bytes()).unwrap();
        let began = Instant::now();
        loop {
            match self.answers.recv_timeout(LIMIT.saturating_sub(began.elapsed())) {
                Ok(answer) if answer["id"] == id => {
                    assert!(answer["error"].is_null(), "{method}: {answer}");
                    return answer["result"].clone();
                }
                Ok(event) => self.listen(&event),
                Err(RecvTimeoutError::Timeout) => panic!("no answer to {method} in {LIMIT:?}"),
                Err(RecvTimeoutError::Disconnected) => panic!("the browser has ended before it answered {method}"),
            }
        }
    }

    /// Collects the errors of the page's console.
    fn listen(&mut self, event: &Value) {
        let params = &event["params"];
        let is_complaint = match event["method"].as_str() {
            Some("Runtime.exceptionThrown") => true,
            Some("Runtime.consoleAPICalled") => params["type"] == "error" || params["type"] == "warning",
            Some("Log.entryAdded") => params["entry"]["level"] == "error",
            _ => false,
        };
        if is_complaint {
            self.complaints.push(params.to_string());
        }
    }

    pub(super) fn visit(&mut self, url: &str) {
        self.call("Page.navigate", json!({"url": url}));
    }

    pub(super) fn reload(&mut self) {
        // Ensures that the next awaited condition is not yet true.
        self.evaluate("document.documentElement.dataset.pictures = 0");
        self.call("Page.reload", json!({}));
    }

    pub(super) fn resize(&mut self, width_px: u64, height_px: u64) {
        let size = json!({"width": width_px, "height": height_px, "deviceScaleFactor": 1, "mobile": width_px < 500});
        self.call("Emulation.setDeviceMetricsOverride", size);
    }

    pub(super) fn press_enter(&mut self) {
        for kind in ["keyDown", "keyUp"] {
            let key = json!({"type": kind, "key": "Enter", "code": "Enter", "text": "\r", "windowsVirtualKeyCode": 13});
            self.call("Input.dispatchKeyEvent", key);
        }
    }

    /// The value of an expression on the page.
    #[track_caller]
    pub(super) fn evaluate(&mut self, expression: &str) -> Value {
        let params = json!({"expression": expression, "returnByValue": true, "userGesture": true});
        let answer = self.call("Runtime.evaluate", params);
        assert!(answer["exceptionDetails"].is_null(), "{expression}: {answer}");
        answer["result"]["value"].clone()
    }

    /// Waits until an expression is true on the page, even across a reload.
    #[track_caller]
    pub(super) fn wait_for(&mut self, expression: &str) {
        let began = Instant::now();
        // While a page loads, its elements may be missing.
        let so = format!("(() => {{ try {{ return Boolean({expression}) }} catch {{ return false }} }})()");
        while self.evaluate(&so) != true {
            if began.elapsed() >= LIMIT {
                let body = self.evaluate("document.body.innerText");
                panic!("waited {LIMIT:?} in vain for {expression} on\n{body}\n{:?}", self.complaints);
            }
            std::thread::sleep(POLL);
        }
    }

    pub(super) fn complaints(&self) -> &[String] {
        &self.complaints
    }

    /// Ends the browser in order; drop does the rest.
    pub(super) fn close(mut self) {
        self.session = None;
        self.call("Browser.close", json!({}));
        let began = Instant::now();
        while matches!(self.child.try_wait(), Ok(None)) && began.elapsed() < LIMIT {
            std::thread::sleep(POLL);
        }
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The browser that the user names, or the first usual one.
fn find() -> Option<PathBuf> {
    if let Some(named) = std::env::var_os("RANGEHOUND_BROWSER") {
        return Some(named.into());
    }
    let folders: Vec<PathBuf> = std::env::split_paths(&std::env::var_os("PATH")?).collect();
    let mut programs = BROWSERS.iter().flat_map(|name| folders.iter().map(move |folder| folder.join(name)));
    programs.find(|program| program.is_file())
}

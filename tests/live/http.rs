//! A minimal HTTP client of the live page.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use serde_json::Value;

use crate::support::{Process, Run};

/// Far above the time of any step.
const LIMIT: Duration = Duration::from_secs(60);

/// Address of a page.
pub(super) struct Page {
    pub(super) url: String,
    pub(super) port: u16,
    pub(super) token: String,
}

/// The answer; status 0 without answer.
#[derive(Debug)]
pub(super) struct Answer {
    pub(super) status: u16,
    pub(super) head: String,
    pub(super) body: String,
}

impl Page {
    /// The page that a process has announced.
    pub(super) fn of(run: &Run, process: &Process) -> Self {
        let mut url = None;
        run.wait_until("the page's address is printed", || {
            let stderr = process.stderr();
            let found =
                |line: &str| ["live: ", "replay: "].iter().find_map(|what| line.strip_prefix(what)).map(str::to_owned);
            url = stderr.lines().find_map(found);
            url.is_some() && stderr.ends_with('\n')
        });
        let url = url.unwrap();
        let (port, token) = url.strip_prefix("http://127.0.0.1:").unwrap().split_once("/?token=").unwrap();
        Self { port: port.parse().unwrap(), token: token.to_owned(), url: url.clone() }
    }

    pub(super) fn host(&self) -> String {
        format!("Host: 127.0.0.1:{}", self.port)
    }

    pub(super) fn try_connect(&self) -> Option<TcpStream> {
        let stream = TcpStream::connect(("127.0.0.1", self.port)).ok()?;
        stream.set_read_timeout(Some(LIMIT)).unwrap();
        stream.set_write_timeout(Some(LIMIT)).unwrap();
        Some(stream)
    }

    pub(super) fn connect(&self) -> TcpStream {
        self.try_connect().unwrap()
    }

    /// Sends a request with the token at the end of the path.
    pub(super) fn get(&self, path: &str) -> Answer {
        self.ask("GET", &format!("{path}{}", self.token), &[self.host()])
    }

    /// Performs the action of a button.
    pub(super) fn act(&self, action: &str, node: &str) -> Answer {
        let token = format!("X-Rangehound-Token: {}", self.token);
        self.ask("POST", &format!("/act/{action}/{node}"), &[self.host(), token, "Content-Length: 0".to_owned()])
    }

    pub(super) fn ask(&self, method: &str, path: &str, headers: &[String]) -> Answer {
        let mut request = format!("{method} {path} HTTP/1.1\r\n");
        headers.iter().for_each(|header| request.extend([header, "\r\n"]));
        request.push_str("\r\n");
        let mut bytes = Vec::new();
        if let Some(mut stream) = self.try_connect() {
            // The server may close the connection before all is sent.
            let _ = stream.write_all(request.as_bytes());
            // An accepted stream has no end: its start is sufficient.
            let mut beginning = [0; "HTTP/1.1 200".len()];
            if stream.read_exact(&mut beginning).is_ok() {
                bytes.extend(beginning);
                if !(path.starts_with("/stream") && beginning.ends_with(b"200")) {
                    let _ = stream.read_to_end(&mut bytes);
                }
            }
        }
        let text = String::from_utf8_lossy(&bytes).into_owned();
        let (head, body) = text.split_once("\r\n\r\n").unwrap_or((&text, ""));
        let status = head.split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or(0);
        Answer { status, head: head.to_owned(), body: body.to_owned() }
    }
}

/// A viewer's stream.
pub(super) struct Events(BufReader<TcpStream>);

impl Events {
    pub(super) fn open(page: &Page) -> Self {
        let mut stream = page.connect();
        let request = format!("GET /stream?token={} HTTP/1.1\r\n{}\r\n\r\n", page.token, page.host());
        stream.write_all(request.as_bytes()).unwrap();
        Self(BufReader::new(stream))
    }

    /// The next event with its data; `None` at the end.
    pub(super) fn next(&mut self) -> Option<(String, Value)> {
        let mut name = String::new();
        loop {
            let mut line = String::new();
            // Chunk lengths between the events are skipped.
            if self.0.read_line(&mut line).ok()? == 0 {
                return None;
            }
            if let Some(found) = line.strip_prefix("event: ") {
                name = found.trim_end().to_owned();
            } else if let Some(data) = line.strip_prefix("data: ") {
                return Some((name, serde_json::from_str(data).unwrap()));
            }
        }
    }

    /// Reads until an event of this name meets the condition.
    #[track_caller]
    pub(super) fn until(&mut self, name: &str, mut so: impl FnMut(&Value) -> bool) {
        let mut last = Value::Null;
        while let Some((found, data)) = self.next() {
            if found == name && so(&data) {
                return;
            }
            last = data;
        }
        panic!("the stream has ended without the {name} that was waited for; the last event was {last}");
    }
}

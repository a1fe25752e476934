//! The built `firn` as a process.

use std::{
    io::{BufRead, BufReader, Read},
    path::Path,
    process::{Child, ChildStderr, Command, ExitStatus, Output, Stdio},
    time::{Duration, Instant},
};

use reqwest::Method;
use serde_json::Value;

use super::answer::Call;

/// How long the machine may take for anything before a test gives up.
const PATIENCE: Duration = Duration::from_secs(60);

fn firn() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_firn"));
    // no setting of the developer's shell may reach the tests
    command.env_clear();
    command
}

/// Runs a command of `firn` to its end.
pub fn run(arguments: &[&str]) -> Output {
    firn().args(arguments).stdin(Stdio::null()).output().expect("the binary runs")
}

/// Runs a command of `firn` on a data folder, to its end.
pub fn run_on(data_dir: &Path, arguments: &[&str]) -> Output {
    let data_dir = data_dir.to_str().expect("a folder in UTF-8");
    run(&[arguments, &["--data-dir", data_dir]].concat())
}

/// A serving process; killed when it goes out of scope.
pub struct Serving {
    child: Child,
    address: String,
    client: reqwest::Client,
}

impl Serving {
    /// Starts `firn serve` on a free port and waits until it listens.
    pub fn start(data_dir: &Path, arguments: &[&str]) -> Self {
        let mut child = firn()
            .args(["serve", "--listen", "127.0.0.1:0", "--data-dir"])
            .arg(data_dir)
            .args(arguments)
            .stderr(Stdio::piped())
            .spawn()
            .expect("the binary starts");
        let address = listening(child.stderr.take().expect("its log"));
        let client = reqwest::Client::builder().no_proxy().build().expect("a client");
        Self { child, address, client }
    }

    /// Where it listens.
    pub fn address(&self) -> &str {
        &self.address
    }

    pub fn call(&self, method: Method, path: &str) -> Call {
        Call(self.client.request(method, format!("http://{}{path}", self.address)))
    }

    pub async fn read(&self, path: &str) -> Value {
        self.call(Method::GET, path).await.json(200)
    }

    /// Ends the process without a word, as a power cut would.
    pub fn kill(&mut self) {
        self.child.kill().expect("it can be killed");
        self.child.wait().expect("it ends");
    }

    /// Asks the process to end.
    pub fn terminate(&self) {
        let done = Command::new("kill").args(["-TERM", &self.child.id().to_string()]).status();
        assert!(done.expect("kill runs").success());
    }

    /// Waits for the end of the process.
    pub fn ended(&mut self) -> ExitStatus {
        let since = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().expect("its state") {
                return status;
            }
            assert!(since.elapsed() < PATIENCE, "the process does not end");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Serving {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Reads the log up to the address, and goes on reading so that the process is never held up by a full pipe.
fn listening(log: ChildStderr) -> String {
    let mut log = BufReader::new(log);
    let mut seen = String::new();
    loop {
        let begin = seen.len();
        let read = log.read_line(&mut seen).expect("a log in UTF-8");
        assert!(read > 0, "the server ended before it listened:\n{seen}");
        if let Some((_, rest)) = seen[begin..].split_once("listens on http://") {
            let end = rest.find(|c: char| !c.is_ascii_digit() && c != '.' && c != ':').unwrap_or(rest.len());
            let address = rest[..end].to_owned();
            assert!(!seen.contains('\u{1b}'), "colours in a log that is no terminal: {seen:?}");
            std::thread::spawn(move || log.read_to_end(&mut Vec::new()));
            return address;
        }
    }
}

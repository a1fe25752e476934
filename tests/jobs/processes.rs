//! A NATS server and `firn worker` as processes.

use std::{
    io::{BufRead, BufReader},
    net::{Ipv4Addr, TcpListener, TcpStream},
    process::{Child, Command, Stdio},
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use tempfile::TempDir;

use crate::support::app::data_dir;

/// How long the machine may take for anything before a test gives up.
pub const PATIENCE: Duration = Duration::from_secs(90);

/// A NATS server with JetStream on a free loopback port; killed when it goes out of scope.
pub struct NatsServer {
    child: Child,
    port: u16,
    store: TempDir,
}

impl NatsServer {
    /// Starts one; none, with a message, where the machine has no `nats-server`.
    pub fn start() -> Option<Self> {
        let port = free_port();
        let store = data_dir();
        match spawn_nats(port, &store) {
            Ok(child) => {
                let server = Self { child, port, store };
                server.wait_until_it_answers();
                Some(server)
            }
            Err(error) => {
                println!("skipped: nats-server does not run here: {error}");
                None
            }
        }
    }

    pub fn url(&self) -> String {
        format!("nats://127.0.0.1:{}", self.port)
    }

    /// Ends it without a word and starts it again, without what it had on disk where `wipe`.
    pub fn kill_and_restart(&mut self, wipe: bool) {
        self.child.kill().expect("it can be killed");
        self.child.wait().expect("it ends");
        if wipe {
            self.store = data_dir();
        }
        self.child = spawn_nats(self.port, &self.store).expect("it starts again");
        self.wait_until_it_answers();
    }

    fn wait_until_it_answers(&self) {
        let since = Instant::now();
        while TcpStream::connect((Ipv4Addr::LOCALHOST, self.port)).is_err() {
            assert!(since.elapsed() < PATIENCE, "the NATS server does not listen");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for NatsServer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn free_port() -> u16 {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a free port");
    listener.local_addr().expect("its number").port()
}

fn spawn_nats(port: u16, store: &TempDir) -> std::io::Result<Child> {
    let debian = "/usr/sbin/nats-server";
    let program = std::env::var("FIRN_NATS_SERVER")
        .unwrap_or_else(|_| if std::path::Path::new(debian).exists() { debian.into() } else { "nats-server".into() });
    Command::new(program)
        .args(["-js", "-a", "127.0.0.1", "-p", &port.to_string(), "-sd"])
        .arg(store.path())
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
}

/// A `firn worker` process; killed when it goes out of scope.
pub struct WorkerProcess {
    child: Child,
    log: Arc<Mutex<String>>,
}

impl WorkerProcess {
    /// Starts one.
    pub fn start(url: &str, name: &str, slots: usize) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_firn"))
            .env_clear()
            .args(["worker", "--engine", url, "--name", name])
            .args(["--job-slots", &slots.to_string(), "--compute-threads", "1"])
            .stdin(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the binary starts");
        let log = Arc::new(Mutex::new(String::new()));
        let (lines, seen) = (BufReader::new(child.stderr.take().expect("its log")).lines(), Arc::clone(&log));
        std::thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                let mut seen = seen.lock().unwrap();
                seen.push_str(&line);
                seen.push('\n');
            }
        });
        Self { child, log }
    }

    /// What it has logged so far.
    pub fn log(&self) -> String {
        self.log.lock().unwrap().clone()
    }

    /// Sends a signal by its name, such as `STOP`.
    pub fn signal(&self, name: &str) {
        let done = Command::new("kill").args([&format!("-{name}"), &self.child.id().to_string()]).status();
        assert!(done.expect("kill runs").success());
    }

    /// Ends it without a word.
    pub fn kill(&mut self) {
        self.child.kill().expect("it can be killed");
        self.child.wait().expect("it ends");
    }

    /// Waits for the end and gives the exit code.
    pub fn ended(&mut self) -> Option<i32> {
        let since = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().expect("its state") {
                return status.code();
            }
            assert!(since.elapsed() < PATIENCE, "the worker does not end:\n{}", self.log());
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for WorkerProcess {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

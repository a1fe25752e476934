//! The server in this process, on a port that the system chose, with data that go with it.

use std::{
    collections::BTreeMap,
    future::Future,
    net::SocketAddr,
    path::Path,
    sync::{LazyLock, Once},
    time::Duration,
};

use firn::{
    api::AppState,
    config::{Config, Settings},
    server::Server,
};
use reqwest::Method;
use serde_json::{Value, json};
use sqlx::{AssertSqlSafe, Connection, SqliteConnection, sqlite::SqliteConnectOptions};
use tempfile::TempDir;
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
    runtime::Runtime,
    task::JoinHandle,
};
use tokio_util::sync::CancellationToken;

use super::answer::{Answer, Call};

/// The servers outlive the runtime of a single test, since tests share some of them.
static SERVERS: LazyLock<Runtime> = LazyLock::new(|| Runtime::new().expect("a runtime"));

/// Runs `work` where the servers live: a database connection belongs to the runtime that opened it.
pub async fn beside_the_servers<T: Send + 'static>(work: impl Future<Output = T> + Send + 'static) -> T {
    SERVERS.spawn(work).await.expect("no panic beside the servers")
}

/// A running server.
pub struct TestApp {
    pub address: SocketAddr,
    pub state: AppState,
    client: reqwest::Client,
    stop: CancellationToken,
    running: Option<JoinHandle<()>>,
    data: TempDir,
}

/// The settings of a test: everything small, on loopback.
pub fn config(data_dir: &Path) -> Config {
    let settings = Settings { data_dir: Some(data_dir.into()), ..Settings::default() };
    let mut config = settings.over(Settings::default());
    config.listen = "127.0.0.1:0".parse().unwrap();
    config.compute_threads = 2;
    config.shutdown_timeout = Duration::from_secs(10);
    config
}

/// A folder for the data of one server, below the build's own temporary folder.
pub fn data_dir() -> TempDir {
    static SWEPT: Once = Once::new();
    SWEPT.call_once(sweep);
    TempDir::new_in(env!("CARGO_TARGET_TMPDIR")).expect("a folder")
}

/// Removes what the servers of earlier runs left: one that all tests share is never dropped.
fn sweep() {
    const AN_HOUR: Duration = Duration::from_secs(3600);
    let old = |entry: &std::fs::DirEntry| {
        let changed = entry.metadata().and_then(|about| about.modified());
        changed.is_ok_and(|at| at.elapsed().is_ok_and(|age| age > AN_HOUR))
    };
    for entry in std::fs::read_dir(env!("CARGO_TARGET_TMPDIR")).into_iter().flatten().flatten() {
        if entry.file_name().to_string_lossy().starts_with(".tmp") && old(&entry) {
            // another test process may be faster
            let _ = std::fs::remove_dir_all(entry.path());
        }
    }
}

impl TestApp {
    /// A server with the settings of a test.
    pub async fn start() -> Self {
        Self::with(|_| ()).await
    }

    /// The same with settings changed.
    pub async fn with(change: impl FnOnce(&mut Config)) -> Self {
        Self::on(data_dir(), change).await
    }

    /// The same on data that are there.
    pub async fn on(data: TempDir, change: impl FnOnce(&mut Config)) -> Self {
        let mut config = config(data.path());
        change(&mut config);
        let server = beside_the_servers(Server::bind(config)).await.expect("the server starts");
        Self::run(server, data)
    }

    fn run(server: Server, data: TempDir) -> Self {
        let port = server.address().expect("an address").port();
        let state = server.state().clone();
        let stop = CancellationToken::new();
        let token = stop.clone();
        let running = SERVERS.spawn(async move { server.run(token).await.expect("a clean end") });
        Self {
            address: SocketAddr::from(([127, 0, 0, 1], port)),
            state,
            client: reqwest::Client::builder().no_proxy().build().expect("a client"),
            stop,
            running: Some(running),
            data,
        }
    }

    /// Any request.
    pub fn call(&self, method: Method, path: &str) -> Call {
        Call(self.client.request(method, format!("http://{}{path}", self.address)))
    }

    pub fn get(&self, path: &str) -> Call {
        self.call(Method::GET, path)
    }

    pub fn put(&self, path: &str, body: &Value) -> Call {
        self.call(Method::PUT, path).json(body)
    }

    pub fn post(&self, path: &str) -> Call {
        self.call(Method::POST, path)
    }

    pub fn delete(&self, path: &str) -> Call {
        self.call(Method::DELETE, path)
    }

    /// The JSON of a path that answers 200.
    pub async fn read(&self, path: &str) -> Value {
        self.get(path).await.json(200)
    }

    /// Makes a station that reports whatever appears, in UTC.
    pub async fn station(&self, id: &str) -> &Self {
        self.put(&format!("/v1/stations/{id}"), &json!({"name": id, "timezone": "UTC"})).await.json(201);
        self
    }

    /// Sends rows of our own CSV in.
    pub async fn import_csv(&self, station: &str, csv: &str) -> Answer {
        self.post(&format!("/v1/stations/{station}/observations")).body("text/csv", csv.to_owned()).await
    }

    /// What the server says to these bytes, for what no client library would send.
    pub async fn raw(&self, request: &str) -> String {
        let stream = self.begin(request).await;
        finish(stream, "").await
    }

    /// A connection on which these bytes have been sent and more may follow.
    pub async fn begin(&self, request: &str) -> TcpStream {
        let mut stream = TcpStream::connect(self.address).await.expect("a connection");
        stream.write_all(request.as_bytes()).await.expect("the request goes out");
        stream
    }

    /// The rows of every table: what a refused call must not change.
    pub async fn rows(&self) -> BTreeMap<String, i64> {
        let path = self.data.path().join("firn.db");
        let options = SqliteConnectOptions::new().filename(path).read_only(true);
        let mut db = SqliteConnection::connect_with(&options).await.expect("the database opens");
        let tables: Vec<String> =
            sqlx::query_scalar("SELECT name FROM sqlite_schema WHERE type = 'table' AND name NOT LIKE 'sqlite_%'")
                .fetch_all(&mut db)
                .await
                .expect("the tables");
        let mut rows = BTreeMap::new();
        for table in tables {
            let count = sqlx::query_scalar(AssertSqlSafe(format!("SELECT count(*) FROM \"{table}\"")));
            rows.insert(table, count.fetch_one(&mut db).await.expect("a count"));
        }
        db.close().await.expect("the database closes");
        rows
    }

    /// Where the data are.
    /// How many outputs and columns of data sets lie beside the database.
    pub fn stored(&self) -> usize {
        stored(self.data_dir())
    }

    pub fn data_dir(&self) -> &Path {
        self.data.path()
    }

    /// Begins a graceful end, as a signal does.
    pub fn begin_to_stop(&self) {
        self.stop.cancel();
    }

    /// Waits for the end.
    pub async fn stopped(&mut self) {
        self.running.take().expect("it runs").await.expect("no panic in the server");
    }
}

/// Sends the rest of a request, and reads until the server closes the connection.
pub async fn finish(mut stream: TcpStream, rest: &str) -> String {
    stream.write_all(rest.as_bytes()).await.expect("the rest goes out");
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).await.expect("an answer");
    String::from_utf8_lossy(&answer).into_owned()
}

impl Drop for TestApp {
    fn drop(&mut self) {
        self.stop.cancel();
    }
}

/// How many outputs and columns of data sets lie in a data directory: each is called by its digest.
pub fn stored(data_dir: &Path) -> usize {
    let files = std::fs::read_dir(data_dir.join("artifacts")).into_iter().flatten();
    files.filter(|file| file.as_ref().unwrap().file_name().len() == 64).count()
}

//! A server of its own for each test, on a port that the system chooses.

use std::{net::SocketAddr, path::Path};

use firn::{config::Settings, demo, server::Server};
use tokio_util::sync::CancellationToken;

/// A running server; it ends with the test.
pub struct Service {
    /// Where it listens.
    pub address: SocketAddr,
    stop: CancellationToken,
    _data: tempfile::TempDir,
}

impl Service {
    /// A server on a loopback address, with the synthetic station or with nothing.
    pub async fn start(with_demo: bool) -> Self {
        let data = tempfile::tempdir().unwrap();
        Self::serve(data, "127.0.0.1:0", with_demo).await
    }

    /// A server on `listen` with the data in `data`.
    pub async fn serve(data: tempfile::TempDir, listen: &str, with_demo: bool) -> Self {
        let server = Server::bind(settings(data.path(), listen).over(Settings::default())).await.unwrap();
        let address = SocketAddr::from(([127, 0, 0, 1], server.address().unwrap().port()));
        if with_demo {
            demo::start(server.state(), address).await.unwrap();
        }
        let stop = CancellationToken::new();
        tokio::spawn(server.run(stop.clone()));
        Self { address, stop, _data: data }
    }

    /// The whole address of `path`.
    pub fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.address)
    }

    /// Reads a JSON document; `None` where it is refused.
    pub async fn json(&self, path: &str) -> Option<serde_json::Value> {
        let response = reqwest::get(self.url(path)).await.unwrap();
        if response.status().is_success() { Some(response.json().await.unwrap()) } else { None }
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        self.stop.cancel();
    }
}

fn settings(data: &Path, listen: &str) -> Settings {
    Settings { listen: Some(listen.parse().unwrap()), data_dir: Some(data.to_owned()), ..Settings::default() }
}

//! One server with trained models for all tests that only look at them: training takes seconds.

use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tokio::sync::OnceCell;

use super::{TestApp, app::beside_the_servers, data};

/// How long a training of a few winters may take on a busy machine.
const PATIENCE: Duration = Duration::from_secs(120);

/// A server with a synthetic station `synthetic` and its first model.
pub struct Trained {
    pub app: TestApp,
    /// The finished job of the first model.
    pub job: Value,
    /// Its results.
    pub results: Value,
}

static TRAINED: OnceCell<Trained> = OnceCell::const_new();

/// The server with the trained model; trains it for the first that asks.
pub async fn trained() -> &'static Trained {
    TRAINED
        .get_or_init(|| async {
            let app = TestApp::start().await;
            let store = app.state.store.clone();
            beside_the_servers(data::synthetic(store, "synthetic", data::winters(7, 4))).await;
            let job = train(&app, &json!({"station": "synthetic", "label": "observed", "lead": 0})).await;
            let results = app.read(&format!("/v1/jobs/{}/results", id(&job))).await;
            Trained { app, job, results }
        })
        .await
}

impl Trained {
    pub fn model_id(&self) -> &str {
        self.results["model_id"].as_str().expect("a model id")
    }
}

/// The id of a status document.
pub fn id(job: &Value) -> &str {
    job["jobID"].as_str().expect("a job id")
}

/// Asks for a training and gives its status document as it was accepted.
pub async fn submit(app: &TestApp, inputs: &Value) -> Value {
    app.post("/v1/processes/train-model/execution").json(&json!({"inputs": inputs})).await.json(201)
}

/// Trains and waits for the end, which must be a good one.
pub async fn train(app: &TestApp, inputs: &Value) -> Value {
    let job = submit(app, inputs).await;
    let ended = until(app, id(&job), |job| !matches!(job["status"].as_str(), Some("accepted" | "running"))).await;
    assert_eq!(ended["status"], "successful", "{ended}");
    ended
}

/// Polls a job until it is as wanted.
pub async fn until(app: &TestApp, id: &str, wanted: impl Fn(&Value) -> bool) -> Value {
    let since = Instant::now();
    loop {
        let job = app.read(&format!("/v1/jobs/{id}")).await;
        if wanted(&job) {
            return job;
        }
        assert!(since.elapsed() < PATIENCE, "waited too long for {job}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

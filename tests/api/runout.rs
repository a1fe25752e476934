//! An engineer simulates a run-out, looks at its numbers and frames, and is told what cannot be simulated.

use std::time::{Duration, Instant};

use firn::science::runout::frames;
use jiff::Timestamp;
use reqwest::Method;
use serde_json::{Value, json};

use crate::support::{
    self, TestApp,
    app::data_dir,
    binary::Serving,
    trained::{id, until},
};

const EXECUTION: &str = "/v1/processes/runout/execution";

fn plug() -> Value {
    json!({"scenario": "warm-plug", "mesh_m": 0.1, "end_time_s": 2.0, "seed": 7})
}

async fn simulated(app: &TestApp, inputs: &Value) -> String {
    let job = app.post(EXECUTION).json(&json!({"inputs": inputs})).await.json(201);
    let ended = until(app, id(&job), |job| job["status"] == "successful" || job["status"] == "failed").await;
    assert_eq!(ended["status"], "successful", "{ended}");
    id(&job).to_owned()
}

#[tokio::test]
async fn a_run_gives_its_numbers_series_and_frames() {
    let app = TestApp::start().await;
    let job = simulated(&app, &plug()).await;
    let results = app.read(&format!("/v1/jobs/{job}/results")).await;
    let summary = &results["summary"];
    // a slab of 2 m x 12 m, four particles in a cell of 0.01 m2
    assert_eq!(summary["particles"], 24 * 400);
    assert_eq!(summary["ending"], "end_time");
    for number in ["v_max", "front_m", "v_max_scaled", "com_v_max", "com_end_m", "particle_v_max", "energy_closure"] {
        assert!(summary[number].is_f64(), "{number}: {summary}");
    }
    assert!(summary["particle_steps_per_s"].as_f64().unwrap() > 0.0);
    assert_eq!(results["provenance"]["seed"], 7);
    assert_eq!(results["inputs"]["snow"], Value::Null, "a typical flow has its own snow");
    let series = app.get(&format!("/v1/jobs/{job}/results/series")).await.json(200);
    assert_eq!(series["time_s"].as_array().unwrap().len(), 49);
    // on the slope the slab gains g (sin - mu cos) a second, once its own waves have settled
    let speed = |frame: usize| {
        series["com_vx_m_s"][frame].as_f64().unwrap().hypot(series["com_vz_m_s"][frame].as_f64().unwrap())
    };
    let (sine, cosine) = 40_f64.to_radians().sin_cos();
    let gain = speed(48) - speed(24);
    assert!((gain / (9.81 * (sine - 0.5 * cosine)) - 1.0).abs() < 2e-3, "{gain}");

    let list = app.read(&format!("/v1/jobs/{job}/frames")).await;
    let frames = list["frames"].as_array().unwrap();
    assert_eq!(frames.len(), 49);
    assert_eq!(frames[24]["time_s"], 1.0);
    let href = frames[48]["href"].as_str().unwrap();
    let frame = app.read(href).await;
    assert_eq!(frame["x_m"].as_array().unwrap().len(), 24 * 400);
    assert_eq!(frame["class"][0], "whole");
    let packed = app.get(href).header("accept", "application/octet-stream").await;
    assert_eq!((packed.status, packed.header("content-type")), (200, "application/octet-stream"));
    assert_eq!(serde_json::to_value(frames::decode(&packed.body).unwrap()).unwrap(), frame);
    app.get(&format!("/v1/jobs/{job}/frames/49")).await.problem("unknown-output");
    app.get(href).header("accept", "image/png").await.problem("not-acceptable");
}

#[tokio::test]
async fn what_cannot_be_simulated_is_refused_before_there_is_a_job() {
    let app = TestApp::start().await;
    let snow = json!({"M": 1.0, "beta": 0.0, "xi": 1.0, "p0_kpa": 3.0});
    let with = |change: Value| {
        let mut inputs = json!({"scenario": "group-2", "snow": snow.clone()});
        for (name, value) in change.as_object().unwrap() {
            inputs[name] = value.clone();
        }
        inputs
    };
    let profile = |release: Value| {
        let terrain = json!({"profile": [[-60.0, 45.0], [0.0, 0.0], [200.0, 0.0]]});
        json!({"terrain": terrain, "release": release, "snow": snow.clone()})
    };
    let cases = [
        (with(json!({"snow": {"M": 0, "beta": 0, "xi": 1, "p0_kpa": 3}})), "/inputs/snow/M", "above 0"),
        (with(json!({"snow": {"M": 1, "beta": -1, "xi": 1, "p0_kpa": 3}})), "/inputs/snow/beta", "0"),
        (
            with(json!({"snow": {"M": 1, "beta": 0, "xi": 1, "p0_kpa": 3, "poisson_ratio": 0.5}})),
            "/inputs/snow/poisson_ratio",
            "0.5",
        ),
        (with(json!({"time_step_s": 0.01})), "/inputs/time_step_s", "at most"),
        (with(json!({"mesh_m": 0.001})), "/inputs/mesh_m", "particles"),
        (with(json!({"precision": "f16"})), "/inputs/precision", "f32"),
        (with(json!({"unheard": 1})), "/inputs/unheard", ""),
        (json!({"snow": snow}), "/inputs/scenario", "terrain"),
        (profile(json!({"x_m": 500.0, "length_m": 12.0, "thickness_m": 2.0})), "/inputs/release", ""),
        (json!({"scenario": "group-2"}), "/inputs/snow", ""),
    ];
    for (inputs, pointer, accepted) in cases {
        let answer = app.post(EXECUTION).json(&json!({"inputs": inputs})).await;
        let problem = answer.problem("invalid-inputs");
        assert_eq!(problem["errors"][0]["pointer"], pointer, "{problem}");
        assert!(problem["errors"][0]["detail"].as_str().unwrap().contains(accepted), "{problem}");
    }
    assert_eq!(app.rows().await["job"], 0);
}

#[tokio::test]
async fn frames_are_there_after_the_run_and_only_of_a_run() {
    let app = TestApp::start().await;
    let inputs = json!({"scenario": "group-5", "snow": {"M": 0.5, "beta": 0, "xi": 1, "p0_kpa": 3}});
    let accepted = app.post(EXECUTION).json(&json!({"inputs": inputs})).await.json(201);
    let job = id(&accepted);
    app.get(&format!("/v1/jobs/{job}/frames")).await.problem("result-not-ready");
    assert_eq!(app.delete(&format!("/v1/jobs/{job}")).await.json(200)["status"], "dismissed");
    let echo = app.post("/v1/processes/echo/execution").json(&json!({"inputs": {"message": "a"}})).await.json(201);
    until(&app, id(&echo), |job| job["status"] == "successful").await;
    app.get(&format!("/v1/jobs/{}/frames", id(&echo))).await.problem("unknown-output");
}

#[tokio::test]
async fn scenarios_are_those_of_the_published_table() {
    let app = TestApp::start().await;
    let scenarios = app.read("/v1/scenarios").await;
    let of = |name: &str| {
        scenarios["scenarios"].as_array().unwrap().iter().find(|scenario| scenario["id"] == name).unwrap().clone()
    };
    // Li et al. (2020), Table 1: H0
    for (name, height) in
        [("group-1", 37.1), ("group-2", 52.8), ("group-3", 73.5), ("group-4", 132.0), ("group-5", 211.2)]
    {
        assert!((of(name)["drop_height_m"].as_f64().unwrap() - height).abs() < 0.05, "{name}");
        assert_eq!(of(name)["snow"], Value::Null);
    }
    assert_eq!(of("cold-dense")["snow"]["p0_kpa"], 3.0);
}

#[tokio::test]
async fn a_dismissed_run_frees_its_slot_within_a_second() {
    let app = TestApp::with(|config| (config.job_slots, config.compute_threads) = (1, 1)).await;
    // 614,400 particles: few steps a second
    let inputs = json!({"scenario": "group-5", "snow": {"M": 0.5, "beta": 0, "xi": 1, "p0_kpa": 3}});
    let run = app.post(EXECUTION).json(&json!({"inputs": inputs})).await.json(201);
    until(&app, id(&run), |job| job["rate"].as_f64() > Some(0.0)).await;
    let next = app.post("/v1/processes/echo/execution").json(&json!({"inputs": {"message": "a"}})).await.json(201);
    let dismissed = app.delete(&format!("/v1/jobs/{}", id(&run))).await.json(200);
    let next = until(&app, id(&next), |job| job["status"] == "successful").await;
    let at = |time: &Value| time.as_str().unwrap().parse::<Timestamp>().unwrap();
    let waited = at(&next["started"]).duration_since(at(&dismissed["finished"]));
    assert!(waited.as_millis() <= 1000, "the slot was freed after {waited}");
}

#[tokio::test]
async fn a_mesh_that_the_server_has_no_memory_for_is_refused_with_the_setting() {
    let app = TestApp::with(|config| config.runout_memory_bytes = 1 << 20).await;
    let inputs = json!({"scenario": "cold-dense", "mesh_m": 0.1});
    let problem = app.post(EXECUTION).json(&json!({"inputs": inputs})).await.problem("invalid-inputs");
    let detail = problem["errors"][0]["detail"].as_str().unwrap();
    assert_eq!(problem["errors"][0]["pointer"], "/inputs/mesh_m");
    assert!(detail.contains("9600 particles") && detail.contains("1048576 bytes"), "{detail}");
    assert!(detail.contains("runout_memory_mib"), "{detail}");
}

/// The film is longer than one piece: what a server stored before it was stopped and what the next one computed make one, with
/// the bits of a film that was never interrupted.
#[tokio::test]
async fn the_film_of_a_run_goes_on_over_a_restart() {
    const ONE_SLOT: [&str; 4] = ["--job-slots", "1", "--compute-threads", "1"];
    let data = data_dir();
    let inputs = json!({"inputs": {"scenario": "cold-dense", "mesh_m": 0.1, "end_time_s": 6.5}});
    let submit = async |server: &Serving| {
        let call = server.call(Method::POST, EXECUTION).json(&inputs).header("cache-control", "no-cache");
        call.await.json(201)["jobID"].as_str().unwrap().to_owned()
    };
    let until = async |server: &Serving, job: &str, wanted: &dyn Fn(&Value) -> bool| loop {
        let record = server.read(&format!("/v1/jobs/{job}")).await;
        assert_ne!(record["status"], "failed", "{record}");
        if wanted(&record) {
            break;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    };
    let mut server = Serving::start(data.path(), &ONE_SLOT);
    let interrupted = submit(&server).await;
    until(&server, &interrupted, &|job| job["progress"].as_u64() >= Some(60)).await;
    server.terminate();
    assert_eq!(server.ended().code(), Some(0));
    let server = Serving::start(data.path(), &ONE_SLOT);
    let whole = submit(&server).await;
    let mut films = Vec::new();
    for (job, attempts) in [(&interrupted, 2), (&whole, 1)] {
        until(&server, job, &|job| job["status"] == "successful").await;
        assert_eq!(server.read(&format!("/v1/jobs/{job}")).await["attempt"], attempts);
        let results = server.read(&format!("/v1/jobs/{job}/results")).await;
        let list = server.read(&format!("/v1/jobs/{job}/frames")).await;
        assert_eq!(list["frames"].as_array().unwrap().len(), 24 * 6 + 13);
        // 250 KB for 38,400 particles
        let largest = list["frames"].as_array().unwrap().iter().map(|frame| frame["bytes"].as_u64()).max().flatten();
        assert!(largest.unwrap() < 250_000 / 4, "{largest:?}");
        let last = server.read(&format!("/v1/jobs/{job}/frames/156")).await;
        assert_eq!(last["x_m"].as_array().unwrap().len(), 9600);
        films.push(
            [&results["frames"]["sha256"], &results["series"]["sha256"], &results["frames"]["length"]]
                .map(Value::clone),
        );
    }
    assert_eq!(films[0], films[1]);
    // the film is put together and its pieces are gone: series, profiles and film, of both jobs the same
    assert!(films[0][2].as_u64() > Some(2 << 20), "{}: it is one piece", films[0][2]);
    let since = Instant::now();
    while support::app::stored(data.path()) > 3 {
        assert!(since.elapsed() < Duration::from_secs(60), "pieces are left");
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}

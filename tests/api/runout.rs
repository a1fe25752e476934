//! An engineer simulates a run-out, looks at its numbers and frames, and is told what cannot be simulated.

use firn::science::runout::frames;
use serde_json::{Value, json};

use crate::support::{
    TestApp,
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

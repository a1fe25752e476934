//! What can be executed, and what is refused before there is a job.

use firn::science::forecast::day::{Activity, DayRecord};
use insta::assert_json_snapshot;
use serde_json::{Value, json};

use crate::support::{Answer, TestApp, data};

const EXECUTION: &str = "/v1/processes/train-model/execution";

async fn execute(app: &TestApp, inputs: Value) -> Answer {
    app.post(EXECUTION).json(&json!({"inputs": inputs})).await
}

/// A server with a station of two winters, one of four quiet winters and one without a day.
async fn too_little() -> TestApp {
    let app = TestApp::start().await;
    app.station("short").await.station("quiet").await.station("empty").await;
    app.import_csv("short", &data::csv(&data::winters(7, 2))).await.json(200);
    let quiet: Vec<DayRecord> =
        data::winters(7, 4).into_iter().map(|day| DayRecord { activity: Activity::None, ..day }).collect();
    app.import_csv("quiet", &data::csv(&quiet)).await.json(200);
    app
}

#[tokio::test]
async fn a_client_of_the_standard_finds_its_way() {
    let app = TestApp::start().await;
    let landing = app.read("/v1").await;
    for rel in [
        "service-desc",
        "http://www.opengis.net/def/rel/ogc/1.0/conformance",
        "http://www.opengis.net/def/rel/ogc/1.0/processes",
        "http://www.opengis.net/def/rel/ogc/1.0/job-list",
    ] {
        let link = landing["links"].as_array().unwrap().iter().find(|link| link["rel"] == rel);
        let href = link.unwrap_or_else(|| panic!("{rel}"))["href"].as_str().unwrap().to_owned();
        assert_eq!(app.get(&href).await.status, 200, "{href}");
    }
    let classes = app.read("/v1/conformance").await;
    assert!(
        classes["conformsTo"].as_array().unwrap().iter().any(|class| class.as_str().unwrap().ends_with("conf/core"))
    );
    let list = app.read("/v1/processes").await;
    assert_eq!(list["processes"].as_array().unwrap().len(), 10);
    assert_json_snapshot!(list["processes"][1], {".version" => "[version]"}, @r#"
    {
      "id": "train-model",
      "title": "Train an avalanche-day forecasting model",
      "description": "Trains a support vector machine on the observations of a station, or of all stations of a region, evaluates it beside climatology, persistence, nearest neighbours and logistic regression with every season left out once, and puts it into the registry of models. The first model of a station or region and lead becomes its active one.",
      "version": "[version]",
      "jobControlOptions": [
        "async-execute",
        "dismiss"
      ],
      "outputTransmission": [
        "value",
        "reference"
      ],
      "links": [
        {
          "href": "/v1/processes/train-model",
          "rel": "self",
          "type": "application/json",
          "title": "the process description"
        },
        {
          "href": "/v1/processes/train-model/execution",
          "rel": "http://www.opengis.net/def/rel/ogc/1.0/execute",
          "type": "application/json",
          "title": "execute it"
        }
      ]
    }
    "#);
}

#[tokio::test]
async fn the_published_schema_is_the_one_that_checks() {
    let app = TestApp::start().await;
    let process = app.read("/v1/processes/train-model").await;
    let inputs = process["inputs"].as_object().unwrap();
    let example = process["example"]["inputs"].as_object().unwrap();
    assert!(example.keys().all(|name| inputs.contains_key(name)), "{example:?}");
    for (name, input) in inputs {
        assert_eq!(input["minOccurs"], u8::from(["label", "lead"].contains(&name.as_str())), "{name}");
        let validator = jsonschema::validator_for(&input["schema"]).expect("a schema that compiles");
        if let Some(value) = example.get(name) {
            assert!(validator.is_valid(value), "{name}: the example is not what the schema accepts");
        }
        // whatever the schema refuses is refused, with a pointer to it
        for wrong in [json!("\u{0}"), json!(-1), json!([]), json!({})] {
            if validator.is_valid(&wrong) {
                continue;
            }
            let mut body = process["example"].clone();
            body["inputs"][name] = wrong.clone();
            let pointers = app.post(EXECUTION).json(&body).await.pointers("invalid-inputs");
            assert_eq!(pointers, [format!("/inputs/{name}")], "{wrong}");
        }
    }
}

#[tokio::test]
async fn inputs_at_fault_are_pointed_at() {
    let app = too_little().await;
    let good = json!({"station": "short", "label": "observed", "lead": 0});
    let with = |name: &str, value: Value| {
        let mut inputs = good.clone();
        inputs[name] = value;
        inputs
    };
    let cases = [
        (with("label", json!("seen")), "/inputs/label"),
        (with("lead", json!(2)), "/inputs/lead"),
        (with("lead", json!("0")), "/inputs/lead"),
        (with("feature_set", json!("all")), "/inputs/feature_set"),
        (with("kernel", json!("cubic")), "/inputs/kernel"),
        (with("from", json!("2012-02-30")), "/inputs/from"),
        (with("to", json!(2012)), "/inputs/to"),
        (with("seed", json!(-1)), "/inputs/seed"),
        (with("seed", json!(9_007_199_254_740_992_u64)), "/inputs/seed"),
        (with("cost_loss_ratio", json!(1)), "/inputs/cost_loss_ratio"),
        (with("station", json!("a b")), "/inputs/station"),
        (with("station", json!("absent")), "/inputs/station"),
        (with("label_", json!("observed")), "/inputs/label_"),
    ];
    for (inputs, pointer) in cases {
        assert_eq!(execute(&app, inputs.clone()).await.pointers("invalid-inputs"), [pointer], "{inputs}");
    }
    let all = execute(&app, json!({"label": "seen", "seed": "x"})).await;
    let mut pointers = all.pointers("invalid-inputs");
    pointers.sort();
    assert_eq!(pointers, ["/inputs/label", "/inputs/lead", "/inputs/seed", "/inputs/station"]);
    let backwards = with("from", json!("2013-01-01"));
    let mut backwards = backwards.clone();
    backwards["to"] = json!("2012-01-01");
    assert_eq!(execute(&app, backwards).await.pointers("invalid-inputs"), ["/inputs/to"]);
    assert_eq!(app.read("/v1/jobs").await["jobs"], json!([]), "no job was made");
}

#[tokio::test]
async fn a_window_that_cannot_train_is_refused_before_there_is_a_job() {
    let app = too_little().await;
    let train = |station: &str| execute(&app, json!({"station": station, "label": "observed", "lead": 0}));
    let short = train("short").await;
    assert_json_snapshot!(short.problem("training-window"), {".traceId" => "[id]"}, @r#"
    {
      "type": "/problems/training-window",
      "title": "The training window cannot train a model",
      "status": 422,
      "detail": "/inputs/from: 2 season(s) with a scorable day: at least 3 are needed (a day is scorable where its avalanche activity is known and the base day and the two days before it are recorded)",
      "code": "training-window",
      "errors": [
        {
          "pointer": "/inputs/from",
          "detail": "2 season(s) with a scorable day: at least 3 are needed (a day is scorable where its avalanche activity is known and the base day and the two days before it are recorded)",
          "code": "training_window"
        }
      ],
      "traceId": "[id]"
    }
    "#);
    let quiet = train("quiet").await;
    assert_eq!(quiet.pointers("training-window"), ["/inputs/label"]);
    assert!(quiet.problem("training-window")["detail"].as_str().unwrap().contains("avalanche days in 0 season(s)"));
    train("empty").await.problem("training-window");
    // three winters would do, but the window names two of them
    app.import_csv("empty", &data::csv(&data::winters(7, 3))).await.json(200);
    let narrow = json!({"station": "empty", "label": "observed", "lead": 0, "from": "2012-07-01", "to": "2014-06-30"});
    execute(&app, narrow).await.problem("training-window");
    assert_eq!(app.read("/v1/jobs").await["jobs"], json!([]), "no job was made");
    assert_eq!(app.rows().await["job"], 0);
}

#[tokio::test]
async fn a_process_that_is_not_there_is_refused_in_the_words_of_the_standard() {
    let app = TestApp::start().await;
    let problem = app.get("/v1/processes/nothing").await.problem("no-such-process");
    assert_json_snapshot!(problem, {".traceId" => "[id]"}, @r#"
    {
      "type": "http://www.opengis.net/def/exceptions/ogcapi-processes-1/1.0/no-such-process",
      "title": "No such process",
      "status": 404,
      "detail": "there is no process nothing; there are: echo, train-model, select-features, evaluate-transfer, retrain-model, runout, emission-analysis, emission-comparison, emission-location, emission-synthetic",
      "code": "no-such-process",
      "traceId": "[id]"
    }
    "#);
    app.post("/v1/processes/nothing/execution").json(&json!({"inputs": {}})).await.problem("no-such-process");
}

#[tokio::test]
async fn a_body_that_is_no_execute_request_is_refused() {
    let app = TestApp::start().await;
    app.post(EXECUTION).body("text/plain", "{}").await.problem("unsupported-media-type");
    app.post(EXECUTION).body("application/json", "{").await.problem("invalid-json");
    assert_eq!(app.post(EXECUTION).json(&json!({"input": {}})).await.pointers("invalid-body"), ["/input"]);
    let form = json!({"inputs": {}, "response": "xml"});
    assert_eq!(app.post(EXECUTION).json(&form).await.pointers("invalid-body"), ["/response"]);
    // raw is one output, and of several it must be said which
    let raw = json!({"inputs": {}, "response": "raw"});
    assert_eq!(app.post(EXECUTION).json(&raw).await.pointers("invalid-body"), ["/outputs"]);
    let both = json!({"inputs": {}, "response": "raw", "outputs": {"model_id": {}, "scores": {}}});
    assert_eq!(app.post(EXECUTION).json(&both).await.pointers("invalid-body"), ["/outputs"]);
    let unknown = json!({"inputs": {}, "outputs": {"mode_id": {}}});
    assert_eq!(app.post(EXECUTION).json(&unknown).await.pointers("invalid-body"), ["/outputs/mode_id"]);
    let mode = json!({"inputs": {}, "outputs": {"model_id": {"transmissionMode": "post"}}});
    let refused = app.post(EXECUTION).json(&mode).await;
    assert_eq!(refused.pointers("invalid-body"), ["/outputs/model_id/transmissionMode"]);
    assert_eq!(app.post(EXECUTION).json(&json!({})).await.pointers("invalid-inputs").len(), 3);
}

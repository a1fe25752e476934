//! From days to a model that says how good it is.

use insta::assert_json_snapshot;
use serde_json::{Value, json};

use crate::support::{
    TestApp,
    app::beside_the_servers,
    data,
    trained::{id, train, trained},
};

const MODELS: [&str; 6] = ["svm", "climatology", "persistence", "knn10", "knn30", "logistic"];

fn keys(value: &Value) -> Vec<&str> {
    value.as_object().unwrap_or_else(|| panic!("no object: {value}")).keys().map(String::as_str).collect()
}

#[tokio::test]
async fn the_first_model_of_a_station_becomes_active() {
    let trained = trained().await;
    assert_json_snapshot!(trained.results, {
        ".model_id" => "[id]", ".scores" => "[scores]", ".provenance.input_hash" => "[hash]", ".provenance.version" => "[version]"
    }, @r#"
    {
      "model_id": "[id]",
      "activated": true,
      "synthetic": true,
      "scores": "[scores]",
      "provenance": {
        "version": "[version]",
        "input_hash": "[hash]",
        "seed": 0
      },
      "station": "synthetic"
    }
    "#);
    let active = trained.app.read("/v1/stations/synthetic/active-model?lead=0").await;
    assert_json_snapshot!(active, {
        ".model_id" => "[id]", ".activated" => "[instant]", ".links[].href" => "[path]"
    }, @r#"
    {
      "station": "synthetic",
      "region": null,
      "synthetic": true,
      "lead": 0,
      "model_id": "[id]",
      "activated": "[instant]",
      "activated_by": null,
      "reason": "the first model",
      "links": [
        {
          "href": "[path]",
          "rel": "model",
          "type": "application/json",
          "title": "the model"
        }
      ]
    }
    "#);
    assert_eq!(active["model_id"], trained.results["model_id"]);
    // the other lead has none
    trained.app.get("/v1/stations/synthetic/active-model?lead=1").await.problem("no-active-model");
}

#[tokio::test]
async fn a_model_says_what_it_was_trained_on() {
    let trained = trained().await;
    let model = trained.app.read(&format!("/v1/models/{}", trained.model_id())).await;
    assert_json_snapshot!(model, {
        ".id" => "[id]", ".job" => "[id]", ".created" => "[instant]", ".links[].href" => "[path]", ".scores" => "[scores]",
        ".provenance.input_hash" => "[hash]", ".provenance.version" => "[version]", ".training.c" => "[c]",
        ".training.gamma" => "[gamma]", ".training.cross_validated_auc" => "[auc]", ".training.threshold" => "[threshold]",
        ".training.support_vectors" => "[count]"
    }, @r#"
    {
      "id": "[id]",
      "station": "synthetic",
      "region": null,
      "synthetic": true,
      "lead": 0,
      "job": "[id]",
      "created": "[instant]",
      "training": {
        "stations": [
          "synthetic"
        ],
        "label": "observed",
        "feature_set": "expert",
        "feature_set_version": 1,
        "features": 64,
        "feature_choice": "all",
        "variables": [
          "air_temperature",
          "wind_speed",
          "wind_direction",
          "cloud_cover",
          "new_snow_index",
          "rain_at_900m",
          "snow_drift",
          "foot_penetration",
          "snow_temperature",
          "insolation_index",
          "cumulative_snow_index"
        ],
        "kernel": "gaussian",
        "c": "[c]",
        "gamma": "[gamma]",
        "cross_validated_auc": "[auc]",
        "threshold": "[threshold]",
        "threshold_rule": {
          "kind": "peirce"
        },
        "first": "2011-12-17",
        "last": "2015-04-20",
        "days": 496,
        "events": 79,
        "seasons": [
          2011,
          2012,
          2013,
          2014
        ],
        "base_rate": 0.1592741935483871,
        "support_vectors": "[count]"
      },
      "scores": "[scores]",
      "provenance": {
        "version": "[version]",
        "input_hash": "[hash]",
        "seed": 0
      },
      "links": [
        {
          "href": "[path]",
          "rel": "self",
          "type": "application/json",
          "title": "this document"
        },
        {
          "href": "[path]",
          "rel": "evaluation",
          "type": "application/json",
          "title": "its scores beside those of other models"
        },
        {
          "href": "[path]",
          "rel": "features",
          "type": "application/json",
          "title": "its features"
        },
        {
          "href": "[path]",
          "rel": "transfers",
          "type": "application/json",
          "title": "how it did at other stations"
        }
      ]
    }
    "#);
    assert_eq!(model["job"], trained.job["jobID"]);
    assert_eq!(model["scores"], trained.results["scores"]);
    let features = trained.app.read(&format!("/v1/models/{}/features", trained.model_id())).await;
    let list = features["features"].as_array().unwrap();
    assert_eq!(json!(list.len()), model["training"]["features"]);
    for feature in list {
        assert!(
            ["name", "unit", "formula"].iter().all(|part| feature[part].as_str().is_some_and(|text| !text.is_empty()))
        );
    }
    let listed = trained.app.read("/v1/models?station=synthetic").await;
    assert!(listed["models"].as_array().unwrap().contains(&model));
    assert_eq!(trained.app.read("/v1/models?station=other").await["models"], json!([]));
}

#[tokio::test]
async fn an_evaluation_puts_every_model_beside_the_machine() {
    let trained = trained().await;
    let evaluation = trained.app.read(&format!("/v1/models/{}/evaluation", trained.model_id())).await;
    for part in ["scores", "per_season", "reliability", "forward_chaining", "bootstrap"] {
        assert!(!evaluation[part].is_null(), "{part}");
    }
    let tables =
        [&evaluation["scores"], &evaluation["forward_chaining"]["scores"], &evaluation["per_season"][0]["scores"]];
    for scores in tables {
        assert_eq!(keys(scores), MODELS);
        for model in MODELS {
            assert_eq!(
                keys(&scores[model]),
                [
                    "auc",
                    "brier",
                    "brier_skill",
                    "pod",
                    "far",
                    "pofd",
                    "pss",
                    "hss",
                    "csi",
                    "bias",
                    "expected_cost",
                    "contingency"
                ]
            );
            assert_eq!(keys(&scores[model]["contingency"]), ["a", "b", "c", "d"]);
        }
    }
    check_arithmetic(&evaluation);

    let seasons: Vec<&Value> = evaluation["per_season"].as_array().unwrap().iter().map(|s| &s["season"]).collect();
    assert_eq!(json!(seasons), json!([2011, 2012, 2013, 2014]));
    assert_eq!(evaluation["reliability"].as_array().unwrap().len(), 10);
    // the generator's hazard is known, and the machine must see a good part of it
    assert!(evaluation["scores"]["svm"]["auc"].as_f64().unwrap() > 0.7, "{}", evaluation["scores"]["svm"]);
}

/// Every score of the whole follows from its own table; a season's table is a part of the whole.
fn check_arithmetic(evaluation: &Value) {
    for model in MODELS {
        let scores = &evaluation["scores"][model];
        let [a, b, c, d] = ["a", "b", "c", "d"].map(|cell| scores["contingency"][cell].as_f64().unwrap());
        let close = |name: &str, expected: f64| {
            let found = scores[name].as_f64().unwrap_or_else(|| panic!("{model} {name}: {scores}"));
            assert!((found - expected).abs() < 1e-12, "{model} {name}: {found} for {expected}");
        };
        assert_eq!(a + b + c + d, evaluation["days"].as_f64().unwrap(), "{model}");
        assert_eq!(a + c, evaluation["events"].as_f64().unwrap(), "{model}");
        close("pod", a / (a + c));
        close("far", b / (a + b));
        close("pofd", b / (b + d));
        close("pss", a / (a + c) - b / (b + d));
        close("csi", a / (a + b + c));
        close("bias", (a + b) / (a + c));
        close("hss", 2.0 * (a * d - b * c) / ((a + c) * (c + d) + (a + b) * (b + d)));
        let brier = |of: &str| evaluation["scores"][of]["brier"].as_f64().unwrap();
        close("brier_skill", 1.0 - brier(model) / brier("climatology"));
        let of_seasons = |cell: &str| -> f64 {
            let seasons = evaluation["per_season"].as_array().unwrap().iter();
            seasons.map(|season| season["scores"][model]["contingency"][cell].as_f64().unwrap()).sum()
        };
        assert_eq!(["a", "b", "c", "d"].map(of_seasons), [a, b, c, d], "{model}");
    }
    let bins = evaluation["reliability"].as_array().unwrap().iter();
    assert_eq!(bins.map(|bin| bin["count"].as_u64().unwrap()).sum::<u64>(), evaluation["days"].as_u64().unwrap());
}

#[tokio::test]
async fn what_a_generator_made_says_so_wherever_it_shows() {
    let trained = trained().await;
    let app = &trained.app;
    let model = format!("/v1/models/{}", trained.model_id());
    let day = "/v1/stations/synthetic";
    assert_eq!(trained.results["synthetic"], true);
    for path in [
        day.to_owned(),
        model,
        format!("{day}/observations/2014-01-15"),
        format!("{day}/forecasts/2014-01-15"),
        format!("{day}/forecasts/latest"),
        format!("{day}/forecasts/2014-01-15/similar-days"),
    ] {
        assert_eq!(app.read(&path).await["synthetic"], true, "{path}");
    }
    for (path, list) in [
        ("/v1/stations", "stations"),
        ("/v1/models", "models"),
        ("/v1/stations/synthetic/observations?limit=5", "observations"),
        ("/v1/stations/synthetic/forecasts?from=2014-01-15&to=2014-01-20", "forecasts"),
    ] {
        let document = app.read(path).await;
        let list = document[list].as_array().unwrap();
        assert!(!list.is_empty() && list.iter().all(|entry| entry["synthetic"] == true), "{path}");
    }
    // describing the station anew does not make it a place
    let named = app.put("/v1/stations/synthetic", &json!({"name": "Generated, no real place"})).await.json(200);
    assert_eq!(named["synthetic"], true);
}

/// Trains twice or more on one server, activates in turn: three winters and a linear kernel make it quick.
#[tokio::test]
async fn a_second_model_waits_to_be_activated() {
    let app = TestApp::start().await;
    for station in ["a", "b"] {
        app.station(station).await.import_csv(station, &data::csv(&data::winters(3, 3))).await.json(200);
    }
    let quick = |station: &str, lead: u8, seed: u64| {
        json!({"station": station, "label": "presumed", "lead": lead, "kernel": "linear",
                                                "feature_set": "raw-30", "seed": seed})
    };
    let mut models = Vec::new();
    for inputs in [quick("a", 0, 5), quick("a", 0, 6), quick("a", 1, 5), quick("b", 0, 5)] {
        let job = train(&app, &inputs).await;
        let results = app.read(&format!("/v1/jobs/{}/results", id(&job))).await;
        models.push((results["model_id"].as_str().unwrap().to_owned(), results["activated"].clone()));
    }
    let activated: Vec<&Value> = models.iter().map(|(_, activated)| activated).collect();
    assert_eq!(json!(activated), json!([true, false, true, true]), "the first of each station and lead");
    let path = "/v1/stations/a/active-model";
    let first = app.get(path).await;
    assert_eq!(first.json(200)["model_id"], models[0].0);

    let body = |model: usize| json!({"model_id": models[model].0});
    let switched = app.put(path, &body(1)).header("if-match", first.header("etag")).await;
    assert_eq!(switched.json(200)["model_id"], models[1].0);
    assert_eq!(app.read(path).await, switched.json(200));
    let day = app.read("/v1/stations/a/forecasts/2013-01-15").await;
    assert_eq!(day["model_id"], models[1].0);
    // a roll-back that does not know of the switch is stopped
    app.put(path, &body(0)).header("if-match", first.header("etag")).await.problem("precondition-failed");
    app.put(path, &body(0)).await.json(200);
    let rows = app.rows().await;
    app.put(path, &body(0)).await.json(200);
    assert_eq!(app.rows().await, rows, "the same again is no new activation");

    for (path, model) in
        [(path, 2), (path, 3), ("/v1/stations/a/active-model?lead=1", 0), ("/v1/stations/b/active-model", 0)]
    {
        assert_eq!(app.put(path, &body(model)).await.pointers("model-mismatch"), ["/model_id"], "{path} {model}");
    }
    let asked = |model: usize| app.get(&format!("/v1/stations/a/forecasts/2013-01-15?model_id={}", models[model].0));
    asked(3).await;
    assert_eq!(asked(2).await.pointers("model-mismatch"), ["/model_id"]);
    assert_eq!(asked(1).await.json(200)["model_id"], models[1].0);

    // models are listed newest first, page by page
    let page = app.read("/v1/models?station=a&limit=2").await;
    let ids = |page: &Value| -> Vec<String> {
        page["models"].as_array().unwrap().iter().map(|model| model["id"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(ids(&page), [models[2].0.clone(), models[1].0.clone()]);
    let cursor = page["next"].as_str().unwrap();
    let rest = app.read(&format!("/v1/models?station=a&limit=2&cursor={cursor}")).await;
    assert_eq!((ids(&rest), &rest["next"]), (vec![models[0].0.clone()], &Value::Null));
}

/// Evaluation, results without their id, and forecasts of a training on so many threads.
async fn trained_on(threads: usize) -> (Value, Value, Value, String) {
    let app = TestApp::with(|config| config.compute_threads = threads).await;
    let store = app.state.store.clone();
    beside_the_servers(data::synthetic(store, "synthetic", data::winters(11, 3))).await;
    let job = train(&app, &json!({"station": "synthetic", "label": "observed", "lead": 0, "seed": 42})).await;
    let mut results = app.read(&format!("/v1/jobs/{}/results", id(&job))).await;
    let model = results["model_id"].as_str().unwrap().to_owned();
    results["model_id"] = Value::Null;
    let mut evaluation = app.read(&format!("/v1/models/{model}/evaluation")).await;
    evaluation["model_id"] = Value::Null;
    let mut forecasts = app.read("/v1/stations/synthetic/forecasts?from=2012-12-15&to=2013-04-20").await;
    for forecast in forecasts["forecasts"].as_array_mut().unwrap() {
        forecast["model_id"] = Value::Null;
    }
    let similar = app.get("/v1/stations/synthetic/forecasts/2013-01-15/similar-days?limit=1000").await.text();
    (evaluation, results, forecasts, similar.replace(&model, ""))
}

#[tokio::test]
async fn the_same_days_and_seed_give_the_same_bits_on_any_number_of_threads() {
    let one = trained_on(1).await;
    let two = trained_on(2).await;
    assert!(one.2["forecasts"].as_array().unwrap().len() > 100);
    assert_eq!(one.0.to_string(), two.0.to_string(), "the evaluation");
    assert_eq!(one.1.to_string(), two.1.to_string(), "scores and provenance");
    assert_eq!(one.2.to_string(), two.2.to_string(), "the forecasts");
    assert_eq!(one.3, two.3, "the similar days");
    let again = trained_on(2).await;
    assert_eq!((&again.0, &again.1, &again.2, &again.3), (&two.0, &two.1, &two.2, &two.3));
}

//! Several stations that feed one model.

use insta::assert_json_snapshot;
use serde_json::{Value, json};
use tokio::sync::OnceCell;

use crate::support::{
    TestApp, data,
    trained::{id, train},
};

/// A server with the stations `a`, `b` and `c`, the region `ab`, its model of lead 0, and a model of `b` alone.
struct Regional {
    app: TestApp,
    region_model: String,
    own_model: String,
}

static REGIONAL: OnceCell<Regional> = OnceCell::const_new();

fn quick(place: (&str, &str)) -> Value {
    json!({place.0: place.1, "label": "observed", "lead": 0, "kernel": "linear", "feature_set": "raw-30"})
}

async fn model_of(app: &TestApp, inputs: &Value) -> String {
    let job = train(app, inputs).await;
    let results = app.read(&format!("/v1/jobs/{}/results", id(&job))).await;
    assert_eq!(results["activated"], true, "{results}");
    results["model_id"].as_str().unwrap().to_owned()
}

async fn regional() -> &'static Regional {
    REGIONAL
        .get_or_init(|| async {
            let app = TestApp::start().await;
            for (station, seed) in [("a", 3), ("b", 4), ("c", 5)] {
                app.station(station).await.import_csv(station, &data::csv(&data::winters(seed, 3))).await.json(200);
            }
            let region = json!({"name": "Both", "stations": ["a", "b"], "avalanche_day": {"quiet": "any_station"}});
            app.put("/v1/regions/ab", &region).await.json(201);
            let region_model = model_of(&app, &quick(("region", "ab"))).await;
            let own_model = model_of(&app, &quick(("station", "b"))).await;
            Regional { app, region_model, own_model }
        })
        .await
}

#[tokio::test]
async fn a_region_is_made_and_read_and_listed() {
    let app = TestApp::start().await;
    app.station("a").await.station("b").await;
    let body = json!({"name": "Western Highlands", "stations": ["b", "a"]});
    let made = app.put("/v1/regions/west", &body).await;
    assert_eq!((made.header("location"), made.header("etag")), ("/v1/regions/west", "\"1\""));
    let made = made.json(201);
    assert_json_snapshot!(made, {".created" => "[instant]", ".updated" => "[instant]"}, @r#"
    {
      "id": "west",
      "name": "Western Highlands",
      "stations": [
        "b",
        "a"
      ],
      "avalanche_day": {
        "stations": 1,
        "quiet": "every_station"
      },
      "retrain": null,
      "revision": 1,
      "created": "[instant]",
      "updated": "[instant]",
      "links": [
        {
          "href": "/v1/regions/west",
          "rel": "self",
          "type": "application/json",
          "title": "this document"
        },
        {
          "href": "/v1/regions/west/active-model",
          "rel": "active-model",
          "type": "application/json",
          "title": "the model that forecasts for it"
        },
        {
          "href": "/v1/models?region=west",
          "rel": "models",
          "type": "application/json",
          "title": "its models"
        },
        {
          "href": "/v1/regions/west/proposals",
          "rel": "proposals",
          "type": "application/json",
          "title": "what retrainings propose"
        }
      ]
    }
    "#);
    assert_eq!(app.read("/v1/regions/west").await, made);
    let rows = app.rows().await;
    assert_eq!(app.put("/v1/regions/west", &body).await.json(200), made);
    assert_eq!(app.rows().await, rows, "the same again is no change");

    let changed =
        json!({"name": "West", "stations": ["a", "b"], "avalanche_day": {"stations": 2.0, "quiet": "any_station"}});
    let old = app.put("/v1/regions/west", &changed).header("if-match", "\"7\"").await;
    old.problem("precondition-failed");
    let changed = app.put("/v1/regions/west", &changed).header("if-match", "\"1\"").await.json(200);
    assert_eq!((&changed["revision"], &changed["stations"]), (&json!(2), &json!(["a", "b"])));
    assert_eq!(changed["avalanche_day"], json!({"stations": 2, "quiet": "any_station"}));
    assert_eq!(app.read("/v1/regions/west").await, changed);

    app.put("/v1/regions/east", &json!({"name": "East", "stations": ["a"]})).await.json(201);
    let page = app.read("/v1/regions?limit=1").await;
    assert_eq!((&page["regions"][0]["id"], &page["next"]), (&json!("east"), &json!("east")));
    let last = app.read("/v1/regions?limit=1&cursor=east").await;
    assert_eq!((&last["regions"][0]["id"], &last["next"]), (&json!("west"), &Value::Null));
}

#[tokio::test]
async fn a_region_that_cannot_be_is_refused_with_a_pointer() {
    let app = TestApp::start().await;
    app.station("a").await;
    let refused = async |body: Value| app.put("/v1/regions/r", &body).await.pointers("invalid-body");
    let with = |stations: Value, needed: Value| json!({"name": "R", "stations": stations, "avalanche_day": {"stations": needed}});
    assert_eq!(refused(with(json!(["a", "x", "y"]), json!(1))).await, ["/stations/1", "/stations/2"]);
    assert_eq!(refused(with(json!(["a"]), json!(2))).await, ["/avalanche_day/stations"]);
    assert_eq!(refused(with(json!(["a"]), json!(0))).await, ["/avalanche_day/stations"]);
    assert_eq!(refused(with(json!(["a"]), json!(1.5))).await, ["/avalanche_day/stations"]);
    assert_eq!(refused(with(json!(["a", "a"]), json!(1))).await, ["/stations"]);
    assert_eq!(refused(with(json!([]), json!(1))).await, ["/stations"]);
    let quiet = json!({"name": "R", "stations": ["a"], "avalanche_day": {"quiet": "nobody"}});
    assert_eq!(refused(quiet).await, ["/avalanche_day/quiet"]);
    app.get("/v1/regions/r").await.problem("unknown-region");
}

#[tokio::test]
async fn a_model_of_a_region_says_what_it_was_trained_on() {
    let Regional { app, region_model, .. } = regional().await;
    let model = app.read(&format!("/v1/models/{region_model}")).await;
    assert_eq!((&model["station"], &model["region"]), (&Value::Null, &json!("ab")));
    let training = &model["training"];
    assert_eq!(training["stations"], json!(["a", "b"]));
    assert_eq!(training["region"], json!({"revision": 1, "avalanche_day": {"stations": 1, "quiet": "any_station"}}));
    let (days, rows) = (training["days"].as_u64().unwrap(), training["station_days"].as_u64().unwrap());
    assert!(days < rows && rows <= 2 * days, "{training}");
    let evaluation = app.read(&format!("/v1/models/{region_model}/evaluation")).await;
    assert_eq!(evaluation["days"], days);
    assert_eq!(evaluation["events"], training["events"]);
    let of_region = app.read("/v1/models?region=ab").await;
    assert_eq!(of_region["models"].as_array().unwrap().len(), 1);
    let active = app.read("/v1/regions/ab/active-model").await;
    assert_eq!((&active["region"], &active["model_id"]), (&json!("ab"), &json!(region_model)));

    // more avalanche days than any one station: those of either
    let own = train(app, &quick(("station", "a"))).await;
    let own = app.read(&format!("/v1/jobs/{}/results", id(&own))).await;
    assert_eq!(own["activated"], true);
    let own = app.read(&format!("/v1/models/{}", own["model_id"].as_str().unwrap())).await;
    assert!(training["events"].as_u64() > own["training"]["events"].as_u64(), "{training} {own}");
}

#[tokio::test]
async fn a_region_is_forecast_with_each_of_its_stations() {
    let app = TestApp::start().await;
    for (station, seed) in [("a", 3), ("b", 4), ("d", 6)] {
        app.station(station).await.import_csv(station, &data::csv(&data::winters(seed, 3))).await.json(200);
    }
    app.station("empty").await;
    let region =
        |stations: Value| json!({"name": "R", "stations": stations, "avalanche_day": {"quiet": "any_station"}});
    app.put("/v1/regions/r", &region(json!(["a", "b"]))).await.json(201);
    let region_model = model_of(&app, &quick(("region", "r"))).await;
    let own_model = model_of(&app, &quick(("station", "b"))).await;

    let forecast = app.read("/v1/regions/r/forecasts/2013-02-10").await;
    assert_json_snapshot!(forecast, {
        ".probability" => "[p]", ".threshold" => "[p]", ".model_id" => "[id]", ".provenance" => "[provenance]",
        ".category" => "[category]", ".stations[].regional" => "[regional]", ".stations[].forecast" => "[forecast]",
    }, @r#"
    {
      "region": "r",
      "synthetic": false,
      "date": "2013-02-10",
      "lead": 0,
      "label": "observed",
      "probability": "[p]",
      "category": "[category]",
      "threshold": "[p]",
      "method": "mean of the probabilities that the region's model gives from the observations of each station",
      "stations_used": 2,
      "model_id": "[id]",
      "changed_since_training": false,
      "provenance": "[provenance]",
      "stations": [
        {
          "station": "a",
          "regional": "[regional]",
          "made_by": "region",
          "forecast": "[forecast]"
        },
        {
          "station": "b",
          "regional": "[regional]",
          "made_by": "station",
          "forecast": "[forecast]"
        }
      ]
    }
    "#);
    let parts: Vec<f64> =
        (0..2).map(|i| forecast["stations"][i]["regional"]["probability"].as_f64().unwrap()).collect();
    assert_eq!(forecast["probability"].as_f64().unwrap(), (parts[0] + parts[1]) / 2.0);
    assert_eq!(forecast["model_id"], json!(region_model));
    // a has no model of its own: that of the region speaks, of avalanche days of the region
    let a = app.read("/v1/stations/a/forecasts/2013-02-10").await;
    assert_eq!(forecast["stations"][0]["forecast"], a);
    assert_eq!((&a["region"], &a["model_id"]), (&json!("r"), &json!(region_model)));
    assert_eq!(a["probability"].as_f64(), Some(parts[0]));
    // b has one, and speaks of its own days
    let b = app.read("/v1/stations/b/forecasts/2013-02-10").await;
    assert_eq!(forecast["stations"][1]["forecast"], b);
    assert_eq!((&b["region"], &b["model_id"]), (&Value::Null, &json!(own_model)));
    let asked = app.read(&format!("/v1/stations/b/forecasts/2013-02-10?model_id={region_model}")).await;
    assert_eq!((&asked["region"], asked["probability"].as_f64()), (&json!("r"), Some(parts[1])));
    // a station of another region, or a model of another station, does not fit
    let stranger = app.get(&format!("/v1/stations/d/forecasts/2013-02-10?model_id={region_model}")).await;
    assert_eq!(stranger.pointers("model-mismatch"), ["/model_id"]);
    app.get("/v1/stations/d/forecasts/2013-02-10").await.problem("no-active-model");

    // similar days name the station whose days they were; what the model says of a can be explained as any other
    let similar = app.read("/v1/stations/a/forecasts/2013-02-10/similar-days?limit=1000").await;
    let stations: Vec<&Value> = similar["similar_days"].as_array().unwrap().iter().map(|day| &day["station"]).collect();
    assert!(stations.contains(&&json!("a")) && stations.contains(&&json!("b")), "{stations:?}");
    assert_eq!(similar["similar_days"][0]["station"], "a", "the day itself was in the training");
    app.get("/v1/stations/a/forecasts/2013-02-10/explanation").await.json(200);

    // stations come and go: the model stays, and the answer says that it knew another region
    app.put("/v1/regions/r", &region(json!(["a", "b", "d", "empty"]))).await.json(200);
    let later = app.read("/v1/regions/r/forecasts/2013-02-10").await;
    assert_eq!((&later["changed_since_training"], &later["stations_used"]), (&json!(true), &json!(3)));
    let empty = &later["stations"][3];
    assert_eq!(
        (&empty["regional"], &empty["forecast"], &empty["made_by"]),
        (&Value::Null, &Value::Null, &json!("region"))
    );
    app.get("/v1/regions/r/forecasts/2013-08-10").await.problem("no-observation");
    app.get("/v1/regions/r/forecasts/2013-02-10?lead=1").await.problem("no-active-model");
}

/// The avalanches that a model of a region knows of are the region's: what b saw yesterday is in the forecast of a.
#[tokio::test]
async fn what_a_neighbour_saw_is_in_the_forecast() {
    let app = TestApp::start().await;
    for (station, seed) in [("a", 3), ("b", 4)] {
        app.station(station).await.import_csv(station, &data::csv(&data::winters(seed, 3))).await.json(200);
    }
    let region = json!({"name": "R", "stations": ["a", "b"], "avalanche_day": {"quiet": "any_station"}});
    app.put("/v1/regions/r", &region).await.json(201);
    let inputs = json!({"region": "r", "label": "observed", "lead": 0, "kernel": "linear", "feature_set": "expert"});
    model_of(&app, &inputs).await;
    for station in ["a", "b"] {
        let quiet = json!({"activity": "none"});
        app.put(&format!("/v1/stations/{station}/avalanches/2013-02-09"), &quiet).await;
    }
    let path = "/v1/stations/a/forecasts/2013-02-10";
    let before = app.read(path).await["probability"].as_f64().unwrap();
    app.put("/v1/stations/b/avalanches/2013-02-09", &json!({"activity": "observed", "count": 3})).await.json(200);
    let after = app.read(path).await["probability"].as_f64().unwrap();
    assert_ne!(before, after);
}

#[tokio::test]
async fn a_training_names_a_station_or_a_region() {
    let Regional { app, .. } = regional().await;
    let refused = async |process: &str, inputs: Value| {
        let answer = app.post(&format!("/v1/processes/{process}/execution")).json(&json!({"inputs": inputs})).await;
        answer.pointers("invalid-inputs")
    };
    for process in ["train-model", "select-features"] {
        let task = json!({"label": "observed", "lead": 0});
        assert_eq!(refused(process, task.clone()).await, ["/inputs/station"]);
        let with = |names: Value| {
            let mut task = task.clone();
            task.as_object_mut().unwrap().extend(names.as_object().unwrap().clone());
            task
        };
        assert_eq!(refused(process, with(json!({"station": "a", "region": "ab"}))).await, ["/inputs/region"]);
        assert_eq!(refused(process, with(json!({"region": "absent"}))).await, ["/inputs/region"]);
        assert_eq!(refused(process, with(json!({"region": "a b"}))).await, ["/inputs/region"]);
    }
}

#[tokio::test]
async fn what_was_said_of_a_region_is_judged_by_the_region() {
    let app = TestApp::start().await;
    for (station, seed) in [("a", 3), ("b", 4)] {
        app.station(station).await.import_csv(station, &data::csv(&data::winters(seed, 3))).await.json(200);
    }
    let region = json!({"name": "R", "stations": ["a", "b"], "avalanche_day": {"quiet": "any_station"}});
    app.put("/v1/regions/r", &region).await.json(201);
    model_of(&app, &quick(("region", "r"))).await;
    // a quiet day of a on which b had an avalanche
    let activity = async |station: &str, date: &str| {
        let answer = app.get(&format!("/v1/stations/{station}/avalanches/{date}")).await;
        if answer.status == 200 { answer.json(200)["activity"].as_str().unwrap().to_owned() } else { String::new() }
    };
    let mut chosen = None;
    for day in 1..=28 {
        let date = format!("2013-02-{day:02}");
        if (activity("a", &date).await, activity("b", &date).await) == ("none".to_owned(), "observed".to_owned()) {
            chosen = Some(date);
        }
    }
    let date = chosen.expect("a day on which only b had an avalanche");
    let issued = app.call(reqwest::Method::PUT, &format!("/v1/stations/a/forecasts/{date}")).await.json(201);
    assert_eq!(issued["forecast"]["region"], "r");
    let path = "/v1/stations/a/forecasts/verification?hindcasts=true";
    let own = app.read(path).await;
    assert_eq!((&own["days"], &own["region"]), (&json!(0), &Value::Null), "nothing was said of days of a alone");
    let of_region = app.read(&format!("{path}&region=r")).await;
    assert_eq!((&of_region["days"], &of_region["events"]), (&json!(1), &json!(1)), "{of_region}");
    assert_eq!(of_region["region"], "r");
}

#[tokio::test]
async fn features_are_selected_for_a_region() {
    let Regional { app, own_model, .. } = regional().await;
    let inputs = json!({"region": "ab", "label": "observed", "lead": 0, "feature_set": "raw-30"});
    let job = app.post("/v1/processes/select-features/execution").json(&json!({"inputs": inputs})).await.json(201);
    let ended = crate::support::trained::until(app, id(&job), |job| {
        !matches!(job["status"].as_str(), Some("accepted" | "running"))
    })
    .await;
    assert_eq!(ended["status"], "successful", "{ended}");
    let results = app.read(&format!("/v1/jobs/{}/results", id(&job))).await;
    assert_eq!((&results["region"], results.get("station")), (&json!("ab"), None));
    // another place cannot use it
    let inputs =
        json!({"station": "a", "label": "observed", "lead": 0, "feature_set": "raw-30", "selection": id(&job)});
    let refused = app.post("/v1/processes/train-model/execution").json(&json!({"inputs": inputs})).await;
    assert_eq!(refused.pointers("invalid-inputs"), ["/inputs/selection"]);
    assert!(!own_model.is_empty());
}

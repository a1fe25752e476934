//! Weather forecasts of days to come: kept apart from observations, read only where they are asked for, replaced by what
//! is observed, verified by themselves.

use jiff::civil::Date;
use serde_json::{Value, json};

use crate::support::{TestApp, data, trained::train};

fn storm() -> Value {
    json!({"air_temperature": -2.0, "wind_speed": 20.0, "new_snow_index": 8, "snow_drift": true})
}

/// A server with a station of three winters and a model of lead 0.
async fn service() -> TestApp {
    let app = TestApp::start().await;
    app.station("a").await.import_csv("a", &data::csv(&data::winters(3, 3))).await.json(200);
    let inputs = json!({"station": "a", "label": "observed", "lead": 0, "kernel": "linear", "feature_set": "raw-30"});
    train(&app, &inputs).await;
    app
}

fn today() -> Date {
    firn::clock::today(&jiff::tz::TimeZone::UTC)
}

fn observation(date: impl std::fmt::Display) -> String {
    format!("/v1/stations/a/observations/{date}")
}

fn forecast(date: impl std::fmt::Display, query: &str) -> String {
    format!("/v1/stations/a/forecasts/{date}{query}")
}

#[tokio::test]
async fn weather_of_a_day_to_come_is_a_forecast_until_the_day_is_observed() {
    let app = TestApp::start().await;
    app.station("a").await;
    let (today, tomorrow) = (today(), today().tomorrow().unwrap());
    // what nobody said of the day follows from the clock of the station
    assert_eq!(app.put(&observation(tomorrow), &storm()).await.json(201)["forecast"], true);
    assert_eq!(app.put(&observation(today), &storm()).await.json(201)["forecast"], false);
    let mut observed = storm();
    observed["forecast"] = json!(false);
    let refused = app.put(&observation(tomorrow), &observed).await;
    assert_eq!(refused.pointers("invalid-body"), ["/forecast"]);
    let mut with_avalanches = storm();
    with_avalanches["forecast"] = json!(true);
    with_avalanches["avalanche_activity"] = json!("observed");
    let refused = app.put(&observation(tomorrow), &with_avalanches).await;
    assert_eq!(refused.pointers("invalid-body"), ["/forecast"]);

    // a forecast of a past day is replaced by its observation as a whole, and not the other way round
    let past = "2014-01-10";
    let mut said = storm();
    said["forecast"] = json!(true);
    assert_eq!(app.put(&observation(past), &said).await.json(201)["forecast"], true);
    let csv = app.import_csv("a", &format!("date,air_temperature\n{past},-7\n")).await.json(200);
    assert_eq!(csv["updated"], 1);
    let day = app.read(&observation(past)).await;
    assert_eq!(
        (&day["forecast"], &day["air_temperature"], &day["wind_speed"]),
        (&json!(false), &json!(-7.0), &Value::Null)
    );
    app.put(&observation(past), &said).await.problem("already-observed");
    said["date"] = json!(past);
    let rows = json!([{"date": "2014-01-11", "air_temperature": 1.0}, said]);
    app.post("/v1/stations/a/observations").json(&rows).await.problem("already-observed");
    app.get(&observation("2014-01-11")).await.problem("no-observation");
    // both states are in the history
    let history = app.read(&format!("{}/revisions", observation(past))).await;
    let kinds: Vec<&Value> =
        history["revisions"].as_array().unwrap().iter().map(|one| &one["body"]["forecast"]).collect();
    assert_eq!(kinds, [&json!(true), &json!(false)]);
}

#[tokio::test]
async fn files_bring_forecasts_for_days_to_come_and_take_none_away() {
    let app = TestApp::start().await;
    app.station("a").await;
    let (today, tomorrow) = (today(), today().tomorrow().unwrap());
    let csv = app.import_csv("a", &format!("date,air_temperature\n{today},-3\n{tomorrow},-5\n")).await.json(200);
    assert_eq!(csv["notes"], json!(["1 day(s) are still to come: their weather is kept as a forecast"]));
    assert_eq!(app.read(&observation(tomorrow)).await["forecast"], true);
    let smet = format!(
        "SMET 1.1 ASCII\n[HEADER]\nstation_id = a\nnodata = -999\nfields = timestamp TA\n[DATA]\n{tomorrow}T09:00 269.65\n"
    );
    let read = app.post("/v1/stations/a/observations").body("text/x-smet", smet).await.json(200);
    assert_eq!(read["updated"], 1);
    // what goes out as a file has lost the mark, so it has only what was observed
    for media in ["text/csv", "text/x-smet"] {
        let text = app.get("/v1/stations/a/observations").header("accept", media).await.text();
        assert!(text.contains(&today.to_string()) && !text.contains(&tomorrow.to_string()), "{text}");
    }
    let list = app.read("/v1/stations/a/observations").await;
    let kinds: Vec<&Value> = list["observations"].as_array().unwrap().iter().map(|day| &day["forecast"]).collect();
    assert_eq!(kinds, [&json!(false), &json!(true)]);
}

#[tokio::test]
async fn no_training_reads_a_weather_forecast() {
    let app = service().await;
    let inputs =
        json!({"station": "a", "label": "observed", "lead": 0, "kernel": "linear", "feature_set": "raw-30", "seed": 1});
    let hash = |job: &Value| job["jobID"].as_str().unwrap().to_owned();
    let first = train(&app, &inputs).await;
    let first = app.read(&format!("/v1/jobs/{}/results", hash(&first))).await;
    // forecasts for tomorrow and for a day of a winter that has none
    let mut said = storm();
    said["forecast"] = json!(true);
    app.put(&observation(today().tomorrow().unwrap()), &said).await.json(201);
    app.put(&observation("2013-08-15"), &said).await.json(201);
    let call = app.post("/v1/processes/train-model/execution").header("cache-control", "no-cache");
    let again = call.json(&json!({"inputs": inputs})).await.json(201);
    let again =
        crate::support::trained::until(&app, again["jobID"].as_str().unwrap(), |job| job["status"] == "successful")
            .await;
    let again = app.read(&format!("/v1/jobs/{}/results", hash(&again))).await;
    assert_eq!(first["provenance"]["input_hash"], again["provenance"]["input_hash"]);
    assert_eq!(first["training"], again["training"]);
}

#[tokio::test]
async fn a_forecast_says_that_it_read_a_weather_forecast_and_is_verified_as_such() {
    let app = service().await;
    let (today, tomorrow) = (today(), today().tomorrow().unwrap());
    let with = "?lead=1&weather=forecast";
    app.get(&forecast(tomorrow, with)).await.problem("no-forecast-weather");
    app.put(&observation(tomorrow), &storm()).await.json(201);
    // a nowcast does not read it
    let refused = app.get(&forecast(tomorrow, "")).await.problem("no-observation");
    assert!(refused["detail"].as_str().unwrap().ends_with("lead=1&weather=forecast"), "{refused}");
    assert_eq!(app.get(&forecast(tomorrow, "?weather=forecast")).await.pointers("invalid-parameter"), ["/weather"]);
    let said = app.read(&forecast(tomorrow, with)).await;
    assert_eq!((&said["lead"], &said["base_date"]), (&json!(1), &json!(today.to_string())));
    let mut read: Vec<&str> =
        said["inputs"]["forecast_weather"].as_array().unwrap().iter().map(|name| name.as_str().unwrap()).collect();
    read.sort_unstable();
    assert_eq!(read, ["air_temperature", "new_snow_index", "snow_drift", "wind_speed"]);
    assert_eq!(app.read(&forecast("2013-01-10", "")).await["inputs"]["forecast_weather"], json!([]));
    let why = app.read(&forecast(tomorrow, &format!("/explanation{with}"))).await;
    assert_eq!((&why["lead"], &why["decision_value"]), (&json!(1), &said["decision_value"]));
    let alike = app.read(&forecast(tomorrow, &format!("/similar-days{with}&limit=3"))).await;
    assert_eq!(alike["similar_days"].as_array().unwrap().len(), 3);
    let question =
        json!({"date": tomorrow, "lead": 1, "weather": "forecast", "changes": [{"values": {"air_temperature": 5.0}}]});
    let answer = app.post("/v1/stations/a/forecasts/what-if").json(&question).await.json(200);
    assert_eq!(answer["as_observed"]["probability"], said["probability"]);
    assert_ne!(answer["changed"]["probability"], said["probability"]);

    let wrong = json!({"date": tomorrow, "weather": "forecast"});
    let wrong = app.post("/v1/stations/a/forecasts/what-if").json(&wrong).await;
    assert_eq!(wrong.pointers("invalid-body"), ["/weather"]);

    // issued beside the other one of lead 1, and beside the nowcast of the same day
    let issued = app.put(&forecast(tomorrow, with), &json!({})).await.json(201);
    assert_eq!(
        (&issued["lead"], &issued["weather"], &issued["hindcast"]),
        (&json!(1), &json!("forecast"), &json!(false))
    );
    app.get(&forecast(tomorrow, "/issued?lead=1")).await.problem("not-issued");
    assert_eq!(app.read(&forecast(tomorrow, &format!("/issued{with}"))).await["forecast"], said);

    // on a past day: the weather forecast is issued, then the day is observed and its avalanches become known
    let past = "2013-08-15";
    let mut weather = storm();
    weather["forecast"] = json!(true);
    app.put(&observation(past), &weather).await.json(201);
    app.put(&forecast(past, with), &json!({})).await.json(201);
    let mut observed = storm();
    observed["avalanche_activity"] = json!("observed");
    app.put(&observation(past), &observed).await.json(200);
    let gone = app.get(&forecast(past, with)).await.problem("no-forecast-weather");
    assert!(gone["detail"].as_str().unwrap().contains("ask for lead 0"));
    app.put(&forecast(past, ""), &json!({})).await.json(201);
    let scored = async |query: &str| {
        let found = app.read(&format!("/v1/stations/a/forecasts/verification?hindcasts=true&{query}")).await;
        (found["days"].clone(), found["events"].clone(), found["waiting"].clone(), found["weather"].clone())
    };
    assert_eq!(scored("lead=1&weather=forecast").await, (json!(1), json!(1), json!(1), json!("forecast")));
    assert_eq!(scored("lead=1").await, (json!(0), json!(0), json!(0), json!("observed")));
    assert_eq!(scored("lead=0").await, (json!(1), json!(1), json!(0), json!("observed")));
    let wrong = app.get("/v1/stations/a/forecasts/verification?weather=forecast").await;
    assert_eq!(wrong.pointers("invalid-parameter"), ["/weather"]);
}

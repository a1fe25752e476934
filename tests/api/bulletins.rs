//! Bulletins: issued forecasts in the form that avalanche warning services exchange, held to its public schema.

use insta::assert_json_snapshot;
use jiff::{ToSpan, civil::Date, tz::TimeZone};
use serde_json::{Value, json};

use crate::support::{TestApp, app::beside_the_servers, data, trained::train};

/// What the public schema of CAAML 6.0, profile BulletinEAWS, finds wrong.
fn faults(bulletins: &Value) -> Vec<String> {
    let schema: Value = serde_json::from_str(include_str!("support/caaml_v6_bulletin_eaws.json")).unwrap();
    let validator = jsonschema::options().should_validate_formats(true).build(&schema).unwrap();
    validator.iter_errors(bulletins).map(|error| format!("{}: {error}", error.instance_path())).collect()
}

/// A server with a station of three winters, a model and weather of today.
async fn service() -> TestApp {
    let app = TestApp::with(|config| {
        config.provider.name = "A warning service".to_owned();
        config.provider.website = Some("https://warning.example".to_owned());
    })
    .await;
    let station = json!({"name": "Lochaber", "timezone": "Europe/London", "eaws_region": "GB-SCT-LO"});
    app.put("/v1/stations/a", &station).await.json(201);
    app.import_csv("a", &data::csv(&data::winters(3, 3))).await.json(200);
    let inputs = json!({"station": "a", "label": "observed", "lead": 0, "kernel": "linear", "feature_set": "raw-30"});
    train(&app, &inputs).await;
    let weather = json!({"air_temperature": -2.0, "wind_speed": 20.0, "new_snow_index": 8, "snow_drift": true});
    for date in [today(), today().tomorrow().unwrap()] {
        app.put(&format!("/v1/stations/a/observations/{date}"), &weather).await.json(201);
    }
    app
}

fn today() -> Date {
    firn::clock::today(&TimeZone::get("Europe/London").unwrap())
}

fn of(date: impl std::fmt::Display, query: &str) -> String {
    format!("/v1/stations/a/bulletins/{date}{query}")
}

fn forecast(date: impl std::fmt::Display, what: &str) -> String {
    format!("/v1/stations/a/forecasts/{date}{what}")
}

/// The only bulletin of a collection that the public schema accepts.
async fn only(app: &TestApp, path: &str) -> Value {
    let found = app.read(path).await;
    assert_eq!(faults(&found), Vec::<String>::new());
    let bulletins = found["bulletins"].as_array().unwrap();
    assert_eq!(bulletins.len(), 1, "{found}");
    bulletins[0].clone()
}

#[test]
fn the_schema_refuses_what_is_no_bulletin() {
    let good = json!({"bulletins": [{"source": {"provider": {"name": "x"}}, "dangerRatings": [{"mainValue": "low"}]}]});
    assert_eq!(faults(&good), Vec::<String>::new());
    for (pointer, value) in [
        ("/bulletins/0/dangerRatings/0/mainValue", json!("severe")),
        ("/bulletins/0/source", json!({})),
        ("/bulletins/0/probability", json!(0.4)),
        ("/bulletins/0/publicationTime", json!("yesterday")),
        ("/bulletins/0/regions", json!([{"regionId": "x"}])),
    ] {
        let mut bad = good.clone();
        let (parent, name) = pointer.rsplit_once('/').unwrap();
        bad.pointer_mut(parent).unwrap()[name] = value;
        assert_eq!(faults(&bad).len(), 1, "{pointer}: {:?}", faults(&bad));
    }
}

#[tokio::test]
async fn a_bulletin_has_the_level_of_a_person_and_the_probability_of_the_model() {
    let app = service().await;
    let today = today();
    app.get(&of(today, "")).await.problem("not-issued");
    let issued = app.put(&forecast(today, ""), &json!({})).await.json(201);
    let first = only(&app, &of(today, "")).await;
    assert_json_snapshot!(first, {
        ".bulletinID" => "[id]", ".publicationTime" => "[instant]", ".validTime.startTime" => "[instant]", ".validTime.endTime" => "[instant]",
        ".customData.firn.forecast" => "[as it was answered]", ".customData.firn.similar_days" => "[ten days]",
        ".customData.firn.date" => "[today]", ".customData.firn.issued" => "[instant]",
    }, @r#"
    {
      "bulletinID": "[id]",
      "lang": "en",
      "publicationTime": "[instant]",
      "validTime": {
        "startTime": "[instant]",
        "endTime": "[instant]"
      },
      "source": {
        "provider": {
          "name": "A warning service",
          "website": "https://warning.example"
        }
      },
      "regions": [
        {
          "regionID": "GB-SCT-LO",
          "name": "Lochaber"
        }
      ],
      "dangerRatings": [
        {
          "mainValue": "no_rating",
          "validTimePeriod": "all_day"
        }
      ],
      "customData": {
        "firn": {
          "station": "a",
          "synthetic": false,
          "date": "[today]",
          "lead": 0,
          "weather": "observed",
          "issued": "[instant]",
          "hindcast": false,
          "forecast": "[as it was answered]",
          "similar_days": "[ten days]",
          "called": null,
          "called_probability": null
        }
      }
    }
    "#);
    let ours = &first["customData"]["firn"];
    assert_eq!((&ours["forecast"], &ours["similar_days"]), (&issued["forecast"], &issued["similar_days"]));
    assert!(
        ours["forecast"]["provenance"]["input_hash"].is_string() && ours["forecast"]["provenance"]["seed"].is_number()
    );
    assert_eq!(ours["similar_days"].as_array().unwrap().len(), 10);
    assert_eq!((&first["publicationTime"], &ours["issued"]), (&issued["issued"], &issued["issued"]));
    assert!(first["validTime"]["startTime"].as_str().unwrap().starts_with(&format!("{today}T00:00:00+0")));

    // whoever warns without a level sets none
    app.put(&forecast(today, "/call"), &json!({"warned": true, "probability": 0.9, "note": "between us"}))
        .await
        .json(201);
    let warned = app.get(&of(today, "")).await;
    assert!(!warned.text().contains("between us"), "a note is for the service itself");
    let warned = only(&app, &of(today, "")).await;
    assert_eq!(warned["dangerRatings"], json!([{"mainValue": "no_rating", "validTimePeriod": "all_day"}]));
    assert_eq!(warned["customData"]["firn"]["called_probability"], 0.9);
    let called = app.put(&forecast(today, "/call"), &json!({"warned": true, "danger_level": 3})).await.json(200);
    let rated = only(&app, &of(today, "")).await;
    assert_eq!(rated["dangerRatings"][0]["mainValue"], "considerable");
    assert_eq!(rated["publicationTime"], called["made"]);
    // the level of another lead is another's
    app.put(&forecast(today, "/call?lead=1"), &json!({"warned": true, "danger_level": 5})).await.json(201);
    assert_eq!(only(&app, &of(today, "")).await["dangerRatings"][0]["mainValue"], "considerable");
    app.get(&of(today, "?lead=1")).await.problem("not-issued");
}

#[tokio::test]
async fn a_window_has_one_bulletin_a_day_and_no_hindcasts_unless_asked_for() {
    let app = service().await;
    let (today, tomorrow) = (today(), today().tomorrow().unwrap());
    app.put(&forecast(today, ""), &json!({})).await.json(201);
    app.put(&forecast(tomorrow, "?lead=1&weather=forecast"), &json!({})).await.json(201);
    app.put(&forecast("2013-01-10", ""), &json!({})).await.json(201);
    let list = app.read("/v1/stations/a/bulletins").await;
    assert_eq!(faults(&list), Vec::<String>::new());
    let days: Vec<(&Value, &Value)> = list["bulletins"]
        .as_array()
        .unwrap()
        .iter()
        .map(|bulletin| (&bulletin["customData"]["firn"]["date"], &bulletin["customData"]["firn"]["weather"]))
        .collect();
    assert_eq!(days, [(&json!(today), &json!("observed")), (&json!(tomorrow), &json!("forecast"))]);
    assert_eq!(only(&app, &of(tomorrow, "?weather=forecast")).await["customData"]["firn"]["lead"], 1);
    let past = "/v1/stations/a/bulletins?from=2013-01-01&to=2013-02-01";
    assert_eq!(app.read(past).await["bulletins"], json!([]));
    let hint = app.get(&of("2013-01-10", "")).await.problem("not-issued");
    assert!(hint["detail"].as_str().unwrap().contains("hindcasts=true"));
    assert_eq!(only(&app, &format!("{past}&hindcasts=true")).await["customData"]["firn"]["hindcast"], true);
    assert_eq!(only(&app, &of("2013-01-10", "?hindcasts=true")).await["customData"]["firn"]["date"], "2013-01-10");
    // of a day that was forecast twice the one that was said last
    let weather = json!({"air_temperature": -2.0, "wind_speed": 20.0, "new_snow_index": 8, "forecast": true});
    app.put("/v1/stations/a/observations/2013-07-20", &weather).await.json(201);
    app.put(&forecast("2013-07-20", "?lead=1&weather=forecast"), &json!({})).await.json(201);
    app.put("/v1/stations/a/observations/2013-07-20", &json!({"air_temperature": 1.0})).await.json(200);
    let last = || only(&app, "/v1/stations/a/bulletins/2013-07-20?hindcasts=true");
    assert_eq!(last().await["customData"]["firn"]["lead"], 1);
    app.put(&forecast("2013-07-20", ""), &json!({})).await.json(201);
    assert_eq!(last().await["customData"]["firn"]["lead"], 0);

    app.get("/v1/stations/b/bulletins").await.problem("unknown-station");
    app.get(&of("2013-02-30", "")).await.problem("invalid-parameter");
    let far = today.checked_add(401.days()).unwrap();
    for (query, pointer) in [
        ("from=2013-01-02&to=2013-01-01", "/to"),
        (format!("from={today}&to={far}").as_str(), "/to"),
        ("lead=2", "/lead"),
        ("lead=0&weather=forecast", "/weather"),
        ("weather=fine", "/weather"),
        ("hindcasts=perhaps", "/hindcasts"),
        ("level=3", "/level"),
    ] {
        let answer = app.get(&format!("/v1/stations/a/bulletins?{query}")).await;
        assert_eq!(answer.pointers("invalid-parameter"), [pointer], "{query}");
    }
}

#[tokio::test]
async fn a_bulletin_of_generated_days_says_so() {
    let app = TestApp::start().await;
    beside_the_servers(data::synthetic(app.state.store.clone(), "made", data::winters(3, 3))).await;
    let inputs =
        json!({"station": "made", "label": "observed", "lead": 0, "kernel": "linear", "feature_set": "raw-30"});
    train(&app, &inputs).await;
    app.put("/v1/stations/made/forecasts/2013-01-10", &json!({})).await.json(201);
    let bulletin = only(&app, "/v1/stations/made/bulletins/2013-01-10?hindcasts=true").await;
    assert!(bulletin["highlights"].as_str().unwrap().starts_with("Synthetic data"));
    assert!(bulletin["bulletinID"].as_str().unwrap().starts_with("synthetic-made-2013-01-10"));
    assert_eq!(bulletin["customData"]["firn"]["synthetic"], true);
    assert_eq!(bulletin["source"]["provider"], json!({"name": "firn"}));
    assert_eq!(bulletin["regions"][0]["regionID"], "made");
}

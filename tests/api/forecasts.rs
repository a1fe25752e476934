//! A forecaster asks what tomorrow and today are like.

use insta::assert_json_snapshot;
use serde_json::{Value, json};

use crate::support::{TestApp, trained::trained};

const FORECASTS: &str = "/v1/stations/synthetic/forecasts";

#[tokio::test]
async fn a_forecast_says_what_and_on_what_grounds() {
    let trained = trained().await;
    let forecast = trained.app.read(&format!("{FORECASTS}/2014-01-15?lead=0")).await;
    assert_json_snapshot!(forecast, {
        ".probability" => "[probability]", ".decision_value" => "[value]", ".threshold" => "[threshold]",
        ".category" => "[category]", ".model_id" => "[id]", ".inputs.missing" => "[names]", ".inputs.imputed" => "[names]",
        ".inputs.out_of_range" => "[names]",
        ".provenance.input_hash" => "[hash]", ".provenance.version" => "[version]"
    }, @r#"
    {
      "station": "synthetic",
      "region": null,
      "synthetic": true,
      "date": "2014-01-15",
      "lead": 0,
      "base_date": "2014-01-15",
      "label": "observed",
      "probability": "[probability]",
      "category": "[category]",
      "threshold": "[threshold]",
      "decision_value": "[value]",
      "model_id": "[id]",
      "feature_set": "expert",
      "feature_set_version": 1,
      "inputs": {
        "missing": "[names]",
        "imputed": "[names]",
        "out_of_range": "[names]",
        "forecast_weather": []
      },
      "provenance": {
        "version": "[version]",
        "input_hash": "[hash]",
        "seed": 0
      }
    }
    "#);
    assert_eq!(forecast["model_id"], trained.model_id());
    assert_eq!(forecast["provenance"], trained.results["provenance"]);
    let by_name = trained.app.read(&format!("{FORECASTS}/2014-01-15?model_id={}", trained.model_id())).await;
    assert_eq!(by_name, forecast);
}

#[tokio::test]
async fn a_range_gives_the_forecasts_of_its_days() {
    let trained = trained().await;
    let list = trained.app.read(&format!("{FORECASTS}?from=2014-01-10&to=2014-01-19")).await;
    let list = list["forecasts"].as_array().unwrap();
    assert_eq!(list.len(), 10);
    for forecast in list {
        let date = forecast["date"].as_str().unwrap();
        assert_eq!(&trained.app.read(&format!("{FORECASTS}/{date}")).await, forecast);
        let number = |name: &str| forecast[name].as_f64().unwrap();
        let (probability, threshold) = (number("probability"), number("threshold"));
        assert!((0.0..=1.0).contains(&probability), "{forecast}");
        let category = if probability >= threshold { "avalanche_day" } else { "no_avalanche_day" };
        assert_eq!(forecast["category"], category, "{forecast}");
    }
    // the probability rises with the decision value
    let mut pairs: Vec<(f64, f64)> =
        list.iter().map(|f| (f["decision_value"].as_f64().unwrap(), f["probability"].as_f64().unwrap())).collect();
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    assert!(pairs.is_sorted_by_key(|pair| pair.1), "{pairs:?}");

    // days without an observation are left out, and so is the summer
    let edge = trained.app.read(&format!("{FORECASTS}?from=2014-04-15&to=2014-05-15")).await;
    let dates: Vec<&str> = edge["forecasts"].as_array().unwrap().iter().map(|f| f["date"].as_str().unwrap()).collect();
    assert_eq!((dates.first(), dates.last()), (Some(&"2014-04-15"), Some(&"2014-04-20")));
    // without a range: the season of the newest day
    let season = trained.app.read(FORECASTS).await;
    let season = season["forecasts"].as_array().unwrap();
    assert_eq!((&season[0]["date"], &season[season.len() - 1]["date"]), (&json!("2014-12-15"), &json!("2015-04-20")));
    assert_eq!(trained.app.read(&format!("{FORECASTS}/latest")).await, season[season.len() - 1]);
}

#[tokio::test]
async fn a_range_that_is_too_long_or_backwards_is_refused() {
    let trained = trained().await;
    let list = |query: &str| trained.app.get(&format!("{FORECASTS}?{query}"));
    assert_eq!(list("from=2013-01-01&to=2014-12-31").await.pointers("invalid-parameter"), ["/to"]);
    assert_eq!(list("from=2014-01-02&to=2014-01-01").await.pointers("invalid-parameter"), ["/to"]);
    assert_eq!(list("to=0000-01-01").await.status, 200);
    assert_eq!(list("from=9999-12-31&to=9999-12-31").await.json(200)["forecasts"], json!([]));
}

#[tokio::test]
async fn a_day_that_cannot_be_forecast_is_refused_with_a_hint() {
    let trained = trained().await;
    let problem = trained.app.get(&format!("{FORECASTS}/2014-07-01")).await.problem("no-observation");
    assert_json_snapshot!(problem, {".traceId" => "[id]"}, @r#"
    {
      "type": "/problems/no-observation",
      "title": "There is no observation of that day",
      "status": 404,
      "detail": "synthetic has no observation of 2014-07-01 that the model reads, and a forecast of lead 0 needs one; the nearest day with one is 2014-04-20",
      "code": "no-observation",
      "traceId": "[id]"
    }
    "#);
    trained.app.get(&format!("{FORECASTS}/2014-07-01/similar-days")).await.problem("no-observation");
    for path in ["0000-01-01", "9999-12-31"] {
        trained.app.get(&format!("{FORECASTS}/{path}")).await.problem("no-observation");
    }
    let bad = trained.app.get(&format!("{FORECASTS}/tomorrow")).await;
    assert_eq!(bad.pointers("invalid-parameter"), ["/date"]);
}

#[tokio::test]
async fn a_lead_without_a_model_has_no_forecast() {
    let trained = trained().await;
    let problem = trained.app.get(&format!("{FORECASTS}/2014-01-15?lead=1")).await.problem("no-active-model");
    assert!(problem["detail"].as_str().unwrap().contains("train-model"), "{problem}");
    let other = trained.app.get(&format!("{FORECASTS}/2014-01-15?lead=1&model_id={}", trained.model_id())).await;
    assert_eq!(other.pointers("model-mismatch"), ["/model_id"]);
    let nobody = "00000000-0000-7000-8000-000000000000";
    trained.app.get(&format!("{FORECASTS}/2014-01-15?model_id={nobody}")).await.problem("unknown-model");
    // days that nobody trained on
    let app = TestApp::start().await;
    app.station("a").await;
    app.get("/v1/stations/a/forecasts/latest").await.problem("no-active-model");
}

#[tokio::test]
async fn similar_days_carry_the_decision() {
    let trained = trained().await;
    let path = format!("{FORECASTS}/2014-01-15/similar-days");
    let few = trained.app.read(&format!("{path}?limit=3")).await;
    assert_json_snapshot!(few, {
        ".model_id" => "[id]", ".similar_days[].date" => "[date]", ".similar_days[].label" => "[label]",
        ".similar_days[].kernel" => "[kernel]", ".similar_days[].contribution" => "[contribution]",
        ".similar_days[].avalanches" => "[avalanches]"
    }, @r#"
    {
      "station": "synthetic",
      "synthetic": true,
      "date": "2014-01-15",
      "lead": 0,
      "model_id": "[id]",
      "similar_days": [
        {
          "station": "synthetic",
          "date": "[date]",
          "label": "[label]",
          "kernel": "[kernel]",
          "contribution": "[contribution]",
          "avalanches": "[avalanches]"
        },
        {
          "station": "synthetic",
          "date": "[date]",
          "label": "[label]",
          "kernel": "[kernel]",
          "contribution": "[contribution]",
          "avalanches": "[avalanches]"
        },
        {
          "station": "synthetic",
          "date": "[date]",
          "label": "[label]",
          "kernel": "[kernel]",
          "contribution": "[contribution]",
          "avalanches": "[avalanches]"
        }
      ]
    }
    "#);
    assert_eq!(trained.app.read(&path).await["similar_days"].as_array().unwrap().len(), 10);

    let all = trained.app.read(&format!("{path}?limit=1000")).await;
    let all = all["similar_days"].as_array().unwrap();
    assert_eq!(few["similar_days"].as_array().unwrap()[..], all[..3]);
    let number = |day: &Value, name: &str| day[name].as_f64().unwrap();
    assert!(all.windows(2).all(|pair| number(&pair[0], "kernel") >= number(&pair[1], "kernel")), "most similar first");
    for day in all {
        assert_eq!(number(day, "contribution") > 0.0, day["label"] == true, "an avalanche day speaks for one: {day}");
        assert!((0.0..=1.0).contains(&number(day, "kernel")), "{day}");
        // what the label says is what was recorded of the day
        let date = day["date"].as_str().unwrap();
        let recorded = trained.app.read(&format!("/v1/stations/synthetic/avalanches/{date}")).await;
        assert_eq!(recorded["activity"] == "observed", day["label"] == true, "{date}");
    }
    let model = trained.app.read(&format!("/v1/models/{}", trained.model_id())).await;
    assert_eq!(json!(all.len()), model["training"]["support_vectors"]);
    // a machine's decision value is the sum of what its days say, and a constant that is the same for every day
    let constant = |day: &'static str| async move {
        let days = trained.app.read(&format!("{FORECASTS}/{day}/similar-days?limit=1000")).await;
        let sum: f64 =
            days["similar_days"].as_array().unwrap().iter().map(|d| d["contribution"].as_f64().unwrap()).sum();
        let value = trained.app.read(&format!("{FORECASTS}/{day}")).await["decision_value"].as_f64().unwrap();
        value - sum
    };
    let (one, other) = (constant("2014-01-15").await, constant("2013-02-20").await);
    assert!((one - other).abs() < 1e-9, "{one} {other}");
}

#[tokio::test]
async fn what_the_day_lacks_is_said() {
    let trained = trained().await;
    let app = &trained.app;
    // a day of which little was observed, in a season of its own: other tests look at the same station
    let path = "/v1/stations/synthetic/observations/2010-11-30";
    app.put(path, &json!({"air_temperature": 30, "new_snow_index": 4})).await.json(201);
    let forecast = app.read(&format!("{FORECASTS}/2010-11-30")).await;
    let missing = forecast["inputs"]["missing"].as_array().unwrap();
    assert!(missing.contains(&json!("wind_speed")) && !missing.contains(&json!("air_temperature")), "{missing:?}");
    assert!(!forecast["inputs"]["imputed"].as_array().unwrap().is_empty());
    let beyond = forecast["inputs"]["out_of_range"].as_array().unwrap();
    assert!(beyond.iter().any(|name| name.as_str().unwrap().contains("air_temperature")), "{beyond:?}");
}

//! A physicist sends hits in, looks at them, analyses and compares them, and is told what is wrong with a file.

use std::{fmt::Write as _, io::Write as _};

use firn::science::emission::{
    catalogue::Column,
    synthetic::{SyntheticOptions, synthetic},
};
use serde_json::{Value, json};

use crate::support::{
    Answer, TestApp, app,
    binary::{self, Serving},
    trained::{id, until},
};

const DATASETS: &str = "/v1/datasets";

/// A generated catalogue as CSV with canonical names.
fn csv(options: &SyntheticOptions, seed: u64) -> String {
    let (catalogue, _) = synthetic(options, seed).unwrap();
    let columns: Vec<(Column, &[f64])> = catalogue.columns().collect();
    let mut text = columns.iter().map(|(column, _)| column.name()).collect::<Vec<_>>().join(",") + "\n";
    for row in 0..catalogue.len() {
        let values: Vec<String> = columns.iter().map(|(_, values)| values[row].to_string()).collect();
        writeln!(text, "{}", values.join(",")).unwrap();
    }
    text
}

async fn upload(app: &TestApp, query: &str, body: impl Into<String>) -> Answer {
    app.post(&format!("{DATASETS}?{query}")).body("text/csv", body.into()).await
}

async fn uploaded(app: &TestApp, name: &str, options: &SyntheticOptions, seed: u64) -> Value {
    upload(app, &format!("name={name}&preamp_gain_db=40"), csv(options, seed)).await.json(201)
}

async fn run(app: &TestApp, process: &str, inputs: &Value) -> (String, Value) {
    let job = app.post(&format!("/v1/processes/{process}/execution")).json(&json!({"inputs": inputs})).await.json(201);
    let ended = until(app, id(&job), |job| job["status"] == "successful" || job["status"] == "failed").await;
    assert_eq!(ended["status"], "successful", "{ended}");
    let results = app.read(&format!("/v1/jobs/{}/results", id(&job))).await;
    (id(&job).to_owned(), results)
}

#[tokio::test]
async fn a_file_of_hits_is_taken_in_described_and_given_back() {
    let app = TestApp::start().await;
    let options = SyntheticOptions { events: 500, ..SyntheticOptions::default() };
    let text = csv(&options, 1);
    let answer = upload(&app, "name=crystal&temperature_c=-10", text.clone()).await;
    let dataset = answer.json(201);
    let at = format!("{DATASETS}/{}", dataset["id"].as_str().unwrap());
    assert_eq!(answer.header("location"), at);
    assert_eq!((&dataset["events"], &dataset["amplitude_unit"]), (&json!(500), &json!("V")));
    assert_eq!((&dataset["synthetic"], &dataset["truth"]), (&json!(false), &Value::Null));
    assert_eq!(dataset["metadata"]["temperature_c"], -10.0);
    assert_eq!(dataset["source"]["format"], "csv");
    assert_eq!(dataset["source"]["bytes"], text.len());
    let time = dataset["columns"].as_array().unwrap().iter().find(|column| column["column"] == "time_s").unwrap();
    assert_eq!((&time["unit"], &time["values"], &time["missing"]), (&json!("s"), &json!(500), &json!(0)));
    assert_eq!(app.read(&at).await, dataset);
    assert_eq!(app.read(DATASETS).await["datasets"], json!([dataset]));

    // every hit comes back, page by page, and as the table that was sent
    let mut amplitudes = Vec::new();
    let mut cursor = json!(0);
    while !cursor.is_null() {
        let page = app.read(&format!("{at}/hits?limit=200&cursor={cursor}")).await;
        amplitudes
            .extend(page["columns"]["amplitude_v"].as_array().unwrap().iter().map(|value| value.as_f64().unwrap()));
        cursor = page["next"].clone();
    }
    assert_eq!(amplitudes, synthetic(&options, 1).unwrap().0.amplitudes_v("test").unwrap());
    let table = app.get(&format!("{at}/hits?limit=500")).header("accept", "text/csv").await;
    assert_eq!(table.text(), text);
    let picture = app.get(&format!("{at}/picture")).await;
    assert_eq!((picture.status, picture.header("content-type")), (200, "image/svg+xml"));
    assert!(picture.text().starts_with("<svg ") && picture.text().contains("A₀ (V)"));
    let png = app.get(&format!("{at}/picture")).header("accept", "image/png").await;
    assert!(png.body.starts_with(b"\x89PNG"));
    app.get(&format!("{at}/picture")).header("accept", "image/webp").await.problem("not-acceptable");
}

#[tokio::test]
async fn metadata_can_be_edited_and_a_data_set_removed() {
    let app = TestApp::start().await;
    let dataset = uploaded(&app, "a", &SyntheticOptions { events: 60, ..SyntheticOptions::default() }, 1).await;
    let at = format!("{DATASETS}/{}", dataset["id"].as_str().unwrap());
    let body = json!({"name": "polycrystal", "metadata": {
        "material": "ice", "temperature_c": -10.0, "grain_size_mm": 0.87, "stress_mpa": 0.55, "phase": "loading",
        "longitudinal_speed_m_per_s": 3900.0,
        "sensors": [{"channel": 1, "position_m": [0.0, 0.0, 0.1], "sensitivity_v_per_pa": 0.5}]}});
    let tag = app.get(&at).await.header("etag").to_owned();
    let changed = app.put(&at, &body).header("if-match", &tag).await.json(200);
    assert_eq!((&changed["name"], &changed["revision"]), (&json!("polycrystal"), &json!(2)));
    assert_eq!(changed["metadata"]["sensors"][0]["sensitivity_v_per_pa"], 0.5);
    assert_eq!(changed["columns"], dataset["columns"]);
    app.put(&at, &body).header("if-match", &tag).await.problem("precondition-failed");
    assert_eq!(app.put(&at, &body).await.json(200)["revision"], 2, "the same again changes nothing");
    let wrong = json!({"name": "a", "metadata": {"grain_size_mm": -1.0}});
    assert_eq!(app.put(&at, &wrong).await.pointers("invalid-body"), ["/metadata/grain_size_mm"]);
    let unknown = json!({"name": "a", "metadata": {"grain": 1.0}});
    assert_eq!(app.put(&at, &unknown).await.pointers("invalid-body"), ["/metadata/grain"]);

    assert_eq!(app.stored(), 1);
    app.delete(&at).header("if-match", &tag).await.problem("precondition-failed");
    assert_eq!(app.delete(&at).await.status, 204);
    assert_eq!((app.stored(), app.rows().await["dataset"]), (0, 0));
    app.get(&at).await.problem("unknown-dataset");
    app.get(&format!("{at}/hits")).await.problem("unknown-dataset");
    app.put(&at, &body).await.problem("unknown-dataset");
    app.delete(&at).await.problem("unknown-dataset");
}

#[tokio::test]
async fn two_data_sets_of_the_same_hits_share_their_columns_until_the_last_goes() {
    let app = TestApp::start().await;
    let options = SyntheticOptions { events: 60, ..SyntheticOptions::default() };
    let [a, b] = [uploaded(&app, "a", &options, 1).await, uploaded(&app, "b", &options, 1).await];
    let at = |dataset: &Value| format!("{DATASETS}/{}", dataset["id"].as_str().unwrap());
    assert_eq!(app.delete(&at(&a)).await.status, 204);
    assert_eq!(app.read(&format!("{}/hits", at(&b))).await["total"], 60);
}

#[tokio::test]
async fn what_is_wrong_with_a_file_is_named_and_nothing_is_stored() {
    let app = TestApp::start().await;
    let good = |row: u32| format!("{row},0.1,{row}\n");
    let header = "time_s,amplitude_v,duration_us\n";
    let rows: String = (0..50).map(good).collect();
    let refused = [
        ("name=a", "time,AMP\n0,12\n".to_owned(), "/amplitude_unit", "never guessed"),
        ("name=a&amplitude_unit=v", "time,amplitude_db\n0,12\n".into(), "/amplitude_unit", "mixed units"),
        ("name=a", "amplitude_v,amplitude_db\n1,120\n".into(), "/amplitude_db", "mixed units"),
        ("name=a", format!("{header}{rows}50,-0.1,1\n"), "/amplitude_v", "line 52"),
        ("name=a", format!("{header}{rows}50,0,1\n"), "/amplitude_v", "above 0"),
        ("name=a", format!("{header}{rows}50,NaN,1\n"), "/amplitude_v", "missing"),
        ("name=a", format!("{header}{rows}1,0.1,1\n"), "/time_s", "before the time of the hit above"),
        ("name=a", format!("{header}{rows}51,0.1\n"), "", "2 fields"),
        ("name=a", header.into(), "", "no hits"),
        ("name=a", "1,2,3\n".into(), "", "no line names the columns"),
    ];
    for (query, body, pointer, words) in refused {
        let answer = upload(&app, query, body).await;
        let problem = answer.problem("dataset-refused");
        assert_eq!(problem["errors"][0]["pointer"], pointer, "{problem}");
        assert!(problem["errors"][0]["detail"].as_str().unwrap().contains(words), "{words}: {problem}");
    }
    upload(&app, "name=a", "a\0b").await.problem("malformed-file");
    assert_eq!(upload(&app, "amplitude_unit=v", "AMP\n1\n").await.pointers("invalid-parameter"), ["/name"]);
    let unit = upload(&app, "name=a&amplitude_unit=furlong", "AMP\n1\n").await;
    assert_eq!(unit.pointers("invalid-parameter"), ["/amplitude_unit"]);
    let cold = upload(&app, "name=a&temperature_c=nan", "AMP\n1\n").await;
    assert_eq!(cold.pointers("invalid-parameter"), ["/temperature_c"]);
    app.post("/v1/datasets?name=a").body("application/json", "{}").await.problem("unsupported-media-type");
    assert_eq!(app.rows().await["dataset"], 0);
    assert_eq!(app.stored(), 0);
    assert_eq!(std::fs::read_dir(app.data_dir().join("uploads")).unwrap().count(), 0, "uploads are cleared away");
}

#[tokio::test]
async fn the_one_broken_row_among_half_a_million_is_named() {
    let app = TestApp::start().await;
    let mut text = String::from("time_s,amplitude_v\n");
    for row in 2..600_000 {
        // the header is line 1
        if row == 512_007 {
            text.push_str("broken\n");
        } else {
            writeln!(text, "{row},0.1").unwrap();
        }
    }
    let problem = upload(&app, "name=a", text).await.problem("dataset-refused");
    assert_eq!(problem["errors"].as_array().unwrap().len(), 1);
    assert!(problem["errors"][0]["detail"].as_str().unwrap().starts_with("line 512007: has 1 fields"), "{problem}");
}

#[tokio::test]
async fn a_file_that_is_too_large_or_breaks_off_leaves_nothing() {
    let app = TestApp::with(|config| config.max_dataset_bytes = 1000).await;
    let large = "time_s,amplitude_v\n".to_owned() + &"1,0.1\n".repeat(500);
    let problem = upload(&app, "name=a", large).await.problem("payload-too-large");
    assert!(problem["detail"].as_str().unwrap().contains("max_dataset_mib"), "{problem}");
    let request = "POST /v1/datasets?name=a HTTP/1.1\r\nHost: localhost\r\nContent-Type: text/csv\r\n\
                   Content-Length: 900\r\n\r\ntime_s,amplitude_v\n1,0.1\n";
    drop(app.begin(request).await);
    for _ in 0..200 {
        if std::fs::read_dir(app.data_dir().join("uploads")).is_ok_and(|mut files| files.next().is_none()) {
            break;
        }
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    }
    assert_eq!(std::fs::read_dir(app.data_dir().join("uploads")).unwrap().count(), 0);
    assert_eq!(app.rows().await["dataset"], 0);
}

#[tokio::test]
async fn a_server_that_is_killed_in_an_upload_has_nothing_of_it() {
    let data = app::data_dir();
    let mut server = Serving::start(data.path(), &[]);
    let mut stream = std::net::TcpStream::connect(server.address()).unwrap();
    let rows = "1,0.1\n".repeat(500_000);
    let head = format!(
        "POST /v1/datasets?name=a HTTP/1.1\r\nHost: localhost\r\nContent-Type: text/csv\r\nContent-Length: {}\r\n\r\n",
        2 * rows.len()
    );
    stream.write_all(head.as_bytes()).unwrap();
    stream.write_all(b"time_s,amplitude_v\n").unwrap();
    stream.write_all(rows.as_bytes()).unwrap();
    let uploads = data.path().join("uploads");
    let on_its_way = || {
        std::fs::read_dir(&uploads)
            .is_ok_and(|files| files.flatten().any(|file| file.metadata().is_ok_and(|about| about.len() > 0)))
    };
    for _ in 0..500 {
        if on_its_way() {
            break;
        }
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    }
    assert!(on_its_way(), "half of the file is on the disk");
    server.kill();
    let again = Serving::start(data.path(), &[]);
    assert_eq!(again.read("/v1/datasets").await["datasets"], json!([]));
    assert!(!uploads.exists(), "what was on its way is swept away");
}

#[tokio::test]
async fn the_command_line_gives_what_a_job_gives() {
    let app = TestApp::start().await;
    let options = SyntheticOptions { events: 400, ..SyntheticOptions::default() };
    let analyses =
        json!([{"kind": "amplitude_distribution", "model": "power_law", "replicates": 50}, {"kind": "waiting_times"}]);
    let dataset = uploaded(&app, "a", &options, 3).await;
    let (_, results) =
        run(&app, "emission-analysis", &json!({"dataset": dataset["id"], "analyses": analyses, "seed": 5})).await;

    let folder = app::data_dir();
    let (file, figures) = (folder.path().join("hits.csv"), folder.path().join("figures"));
    std::fs::write(&file, csv(&options, 3)).unwrap();
    let (file, figures) = (file.to_str().unwrap(), figures.to_str().unwrap());
    let arguments = ["analyse", file, "--preamp-gain-db", "40", "--seed", "5", "--figures", figures];
    let wanted: Vec<String> = analyses.as_array().unwrap().iter().map(ToString::to_string).collect();
    let wanted: Vec<&str> = wanted.iter().flat_map(|one| ["--analysis", one.as_str()]).collect();
    let ran = binary::run(&[&arguments[..], &wanted].concat());
    assert!(ran.status.success(), "{ran:?}");
    let printed: Value = serde_json::from_slice(&ran.stdout).unwrap();
    assert_eq!(printed["analyses"], results["analyses"]);
    assert_eq!(printed["figures"], results["figures"]);
    assert_eq!(printed["description"]["columns"], dataset["columns"]);
    for name in ["0-amplitude-density.svg", "0-amplitude-ccdf.svg", "1-waiting-times.svg"] {
        assert!(std::fs::read_to_string(format!("{figures}/{name}")).unwrap().starts_with("<svg "), "{name}");
    }
    // all that the columns allow, and what they do not
    let all = binary::run(&["analyse", file, "--analysis", "duration_scaling"]);
    assert!(all.status.success());
    for (wrong, words) in [
        (vec!["analyse", file, "--analysis", "wavelets"], "phase_comparison"),
        (vec!["analyse", file, "--analysis", "source_model"], "sensitivity_v_per_pa"),
        (vec!["analyse", file, "--amplitude-unit", "mv"], "mixed units"),
        (vec!["analyse", "/nowhere.csv"], "nowhere.csv"),
    ] {
        let refused = binary::run(&wrong);
        assert!(!refused.status.success());
        assert!(String::from_utf8(refused.stderr).unwrap().contains(words), "{wrong:?}");
    }
}

#[tokio::test]
async fn waveforms_become_hits_with_a_sensitivity_scan() {
    let app = TestApp::start().await;
    // bursts of 1 ms of 100 kHz, one every 10 ms, with falling peaks
    let samples: Vec<f64> = (0..400_000)
        .map(|at| {
            let (burst, within) = (at / 10_000, at % 10_000);
            let peak = 2.0 / f64::from(burst + 1);
            if within < 1000 { if within % 10 < 5 { peak } else { -peak } } else { 0.0 }
        })
        .collect();
    let mut file = b"\x93NUMPY\x01\x00".to_vec();
    let mut header = "{'descr': '<f8', 'fortran_order': False, 'shape': (400000,), }".to_owned();
    while !(10 + header.len() + 1).is_multiple_of(64) {
        header.push(' ');
    }
    header.push('\n');
    file.extend(u16::try_from(header.len()).unwrap().to_le_bytes());
    file.extend(header.as_bytes());
    samples.iter().for_each(|sample| file.extend(sample.to_le_bytes()));
    let query =
        "name=waves&amplitude_unit=v&sample_rate_hz=1e6&threshold_v=0.01&hit_definition_s=0.001&hit_lockout_s=0.0005";
    let post = |query: &str| app.post(&format!("{DATASETS}?{query}")).body("application/octet-stream", file.clone());
    let dataset = post(query).await.json(201);
    assert_eq!((&dataset["events"], &dataset["source"]["format"]), (&json!(40), &json!("npy")));
    let waveform = &dataset["waveform"];
    assert_eq!((&waveform["samples"], waveform["sensitivity"].as_array().unwrap().len()), (&json!(400_000), 27));
    let hits = app.read(&format!("{DATASETS}/{}/hits", dataset["id"].as_str().unwrap())).await;
    assert_eq!(hits["columns"]["amplitude_v"][1], 1.0);
    assert_eq!(hits["columns"]["time_s"][39], 0.39);
    let bare = post("name=waves&amplitude_unit=v&sample_rate_hz=1e6&threshold_v=0.01").await;
    assert_eq!(bare.pointers("dataset-refused"), ["/hit_definition_s"]);
}

#[tokio::test]
async fn a_database_that_was_cut_is_refused() {
    let app = TestApp::start().await;
    let mut file = b"SQLite format 3\0".to_vec();
    file.resize(4096, 0);
    file[16..18].copy_from_slice(&4096_u16.to_be_bytes());
    file[28..32].copy_from_slice(&9_u32.to_be_bytes());
    let answer = app.post("/v1/datasets?name=a").body("application/vnd.sqlite3", file).await;
    let problem = answer.problem("malformed-file");
    assert!(problem["detail"].as_str().unwrap().contains("the file was cut"), "{problem}");
    assert_eq!(app.rows().await["dataset"], 0);
}

#[tokio::test]
async fn a_data_set_is_analysed_with_figures() {
    let app = TestApp::start().await;
    let options =
        SyntheticOptions { events: 3000, grain_size_mm: Some(0.87), clip_v: 1e9, ..SyntheticOptions::default() };
    let dataset = uploaded(&app, "polycrystal", &options, 1).await;
    let analyses = json!([
        {"kind": "amplitude_distribution", "model": "auto", "xmin": 0.00317, "replicates": 100},
        {"kind": "duration_scaling"},
        {"kind": "correlation_integral", "radii": 20},
        {"kind": "waiting_times"},
    ]);
    let inputs = json!({"dataset": dataset["id"], "analyses": analyses, "seed": 7, "figures": "both"});
    let (job, results) = run(&app, "emission-analysis", &inputs).await;
    let fit = &results["analyses"][0]["fit"];
    let members: Vec<&str> = fit.as_object().unwrap().keys().map(String::as_str).collect();
    assert_eq!(
        members,
        [
            "model",
            "alpha",
            "alpha_se",
            "ci95",
            "cutoff",
            "xmin",
            "xmax",
            "n_tail",
            "ks_distance",
            "ks_convention",
            "p_value",
            "replicates",
            "loglik",
            "aic",
            "bic"
        ]
    );
    // the generator: tau = 1.35, A_c = 0.1 V
    assert_eq!(fit["model"], "cutoff_power_law");
    let (alpha, se) = (fit["alpha"].as_f64().unwrap(), fit["alpha_se"].as_f64().unwrap());
    assert!((alpha - 1.35).abs() < 3.0 * se, "{fit}");
    assert_eq!(fit["replicates"], 100);
    assert_eq!(results["analyses"][0]["comparison"].as_array().unwrap().len(), 15);
    assert_eq!(results["analyses"][1]["kind"], "duration_scaling");
    assert_eq!(results["dataset"]["sha256"].as_str().unwrap().len(), 64);
    assert_eq!(results["provenance"]["seed"], 7);
    let figures = results["figures"].as_array().unwrap();
    assert_eq!(figures.len(), 6, "{figures:?}");
    for figure in figures {
        for output in figure["outputs"].as_array().unwrap() {
            let name = output.as_str().unwrap();
            let drawn = app.get(&format!("/v1/jobs/{job}/results/{name}")).await;
            assert_eq!(drawn.status, 200, "{name}");
            let (media, begin): (_, &[u8]) =
                if name.ends_with(".svg") { ("image/svg+xml", b"<svg ") } else { ("image/png", b"\x89PNG") };
            assert_eq!(drawn.header("content-type"), media);
            assert!(drawn.body.starts_with(begin), "{name}");
        }
    }
    // the same again is the same job; changed metadata are another input
    let again = app.post("/v1/processes/emission-analysis/execution").json(&json!({"inputs": inputs})).await.json(201);
    assert_eq!((id(&again), &again["reused"]), (job.as_str(), &json!(true)));
    let at = format!("{DATASETS}/{}", dataset["id"].as_str().unwrap());
    app.put(&at, &json!({"name": "polycrystal", "metadata": {"grain_size_mm": 0.87}})).await.json(200);
    let anew = app.post("/v1/processes/emission-analysis/execution").json(&json!({"inputs": inputs})).await.json(201);
    assert_ne!(id(&anew), job);
}

#[tokio::test]
async fn what_cannot_be_analysed_is_refused_before_there_is_a_job() {
    let app = TestApp::start().await;
    let dataset = upload(&app, "name=bare", "amplitude_v\n0.1\n0.2\n0.3\n0.4\n").await.json(201);
    let analysis = |analysis: Value| json!({"dataset": dataset["id"], "analyses": [analysis]});
    let at = "/inputs/analyses/0";
    let nowhere = json!({"dataset": "019326f0-0000-7000-8000-000000000000", "analyses": [{"kind": "waiting_times"}]});
    let cases = [
        (nowhere, "/inputs/dataset".to_owned(), "no data set"),
        (analysis(json!({"kind": "duration_scaling"})), at.to_owned(), "column duration_us is missing"),
        (analysis(json!({"kind": "correlation_integral"})), at.to_owned(), "column x_m is missing"),
        (analysis(json!({"kind": "exponent_map"})), at.to_owned(), "4 event(s), at least 20"),
        (analysis(json!({"kind": "source_model"})), at.to_owned(), "sensitivity_v_per_pa is not known"),
        (analysis(json!({"kind": "amplitude_distribution", "xmin": -1})), format!("{at}/xmin"), "above 0"),
        (
            analysis(json!({"kind": "amplitude_distribution", "xmin": 5})),
            at.to_owned(),
            "from xmin to xmax: 0 event(s)",
        ),
        (analysis(json!({"kind": "amplitude_distribution", "model": "gauss"})), format!("{at}/model"), "lognormal"),
        (analysis(json!({"kind": "wavelets"})), format!("{at}/kind"), "phase_comparison"),
        (json!({"dataset": dataset["id"], "analyses": []}), "/inputs/analyses".into(), ""),
        (json!({"dataset": dataset["id"], "analyses": [{"kind": "activity"}], "seed": -1}), "/inputs/seed".into(), ""),
    ];
    for (inputs, pointer, words) in cases {
        let answer = app.post("/v1/processes/emission-analysis/execution").json(&json!({"inputs": inputs})).await;
        let problem = answer.problem("invalid-inputs");
        assert_eq!(problem["errors"][0]["pointer"], pointer, "{problem}");
        assert!(problem["errors"][0]["detail"].as_str().unwrap().contains(words), "{problem}");
    }
    assert_eq!(app.rows().await["job"], 0);
}

#[tokio::test]
async fn synthetic_polycrystals_are_made_and_compared() {
    let app = TestApp::start().await;
    let mut datasets = Vec::new();
    for (seed, grain) in [0.26, 0.87, 5.02].into_iter().enumerate() {
        let inputs = json!({"name": format!("grain {grain} mm"), "events": 3000, "grain_size_mm": grain, "clip_v": 1e9, "seed": seed});
        let (job, results) = run(&app, "emission-synthetic", &inputs).await;
        let made = app.read(&format!("{DATASETS}/{}", results["dataset_id"].as_str().unwrap())).await;
        assert_eq!((&made["synthetic"], &made["events"], &made["job"]), (&json!(true), &json!(3000), &json!(job)));
        assert_eq!(made["truth"]["tau"], 1.35);
        assert_eq!(made["truth"], results["truth"]);
        assert_eq!(made["metadata"]["grain_size_mm"], grain);
        // the data set outlives its job
        assert_eq!(app.delete(&format!("/v1/jobs/{job}")).await.status, 200);
        let hits = app.read(&format!("{DATASETS}/{}/hits?limit=1", made["id"].as_str().unwrap())).await;
        assert_eq!((&hits["total"], &hits["synthetic"]), (&json!(3000), &json!(true)));
        datasets.push(made["id"].clone());
    }
    let options = json!({"fit": {"xmin": 0.00317, "replicates": 0}});
    let inputs = json!({"datasets": datasets, "options": options});
    let (job, results) = run(&app, "emission-comparison", &inputs).await;
    let found = &results["comparison"];
    let trend = found["trends"].as_array().unwrap().iter().find(|trend| trend["quantity"] == "cutoff_v").unwrap();
    let (slope, se) = (trend["slope"].as_f64().unwrap(), trend["slope_se"].as_f64().unwrap());
    assert!((slope - 1.0).abs() < 3.0 * se, "A_c grows with the grain: {trend}");
    assert!(found["common_exponent_with_cutoff"]["p_value"].as_f64().unwrap() > 0.001, "{found}");
    assert!(found["collapse"]["scatter"].as_f64().unwrap() > 2.0);
    let outputs: Vec<&str> =
        results["figures"].as_array().unwrap().iter().map(|figure| figure["outputs"][0].as_str().unwrap()).collect();
    for name in ["densities.svg", "collapse.svg", "durations.svg", "cutoff-v-against-grain-size-mm.svg"] {
        assert!(outputs.contains(&name), "{outputs:?}");
        assert_eq!(app.get(&format!("/v1/jobs/{job}/results/{name}")).await.status, 200);
    }

    let one = json!({"datasets": [datasets[0]]});
    let refused = app.post("/v1/processes/emission-comparison/execution").json(&json!({"inputs": one})).await;
    assert_eq!(refused.pointers("invalid-inputs"), ["/inputs/datasets"]);
    let bad = json!({"name": "a", "events": 2_000_000, "grain_size_mm": -1.0, "unheard": 1});
    let refused = app.post("/v1/processes/emission-synthetic/execution").json(&json!({"inputs": bad})).await;
    assert_eq!(refused.pointers("invalid-inputs"), ["/inputs/unheard"]);
    let bad = json!({"name": "a", "grain_size_mm": -1.0});
    let refused = app.post("/v1/processes/emission-synthetic/execution").json(&json!({"inputs": bad})).await;
    assert_eq!(refused.pointers("invalid-inputs"), ["/inputs/grain_size_mm"]);
}

/// Quantile 0.95 of chi-square with three degrees of freedom.
const CHI_SQUARE_3: f64 = 7.814_727_903_251_178;

/// Columns of all rows of a data set.
async fn columns(app: &TestApp, dataset: &Value) -> Value {
    let id = dataset.as_str().unwrap();
    app.read(&format!("{DATASETS}/{id}/hits?limit=100000")).await["columns"].clone()
}

/// The quadratic form of a miss in the inverse of the covariance of one row, by Cramer's rule.
fn form(of: impl Fn(&str) -> f64, miss: [f64; 3]) -> f64 {
    let [x, y, z] = ["x_se_m", "y_se_m", "z_se_m"].map(|name| of(name).powi(2));
    let [xy, xz, yz] = ["xy_cov_m2", "xz_cov_m2", "yz_cov_m2"].map(of);
    let determinant = |[[a, b, c], [d, e, f], [g, h, i]]: [[f64; 3]; 3]| {
        a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    };
    let rows = [[x, xy, xz], [xy, y, yz], [xz, yz, z]];
    let whole = determinant(rows);
    let with = |column: usize| {
        let mut changed = rows;
        (0..3).for_each(|row| changed[row][column] = miss[row]);
        determinant(changed)
    };
    (0..3).map(|k| miss[k] * with(k) / whole).sum()
}

#[tokio::test]
async fn hits_of_sensors_become_events_at_their_sources() {
    let app = TestApp::start().await;
    let events = json!({"name": "sources", "events": 1500, "seed": 4});
    let mut hits = events.clone();
    hits["name"] = json!("recorded");
    hits["hits"] = json!({"speed_m_per_s": 3900, "arrival_error_s": 2e-7});
    let (_, sources) = run(&app, "emission-synthetic", &events).await;
    let (_, recorded) = run(&app, "emission-synthetic", &hits).await;
    let parent = recorded["dataset_id"].clone();
    let taken = app.read(&format!("{DATASETS}/{}", parent.as_str().unwrap())).await;
    assert_eq!((&taken["events"], &taken["metadata"]["longitudinal_speed_m_per_s"]), (&json!(12_000), &json!(3900.0)));

    let inputs = json!({"dataset": parent, "name": "located"});
    let (job, results) = run(&app, "emission-location", &inputs).await;
    let summary = &results["summary"];
    assert_eq!((&summary["hits_grouped"], &summary["events"]), (&json!(12_000), &json!(1500)), "{summary}");
    let located = summary["located"].as_u64().unwrap();
    assert!(located >= 1485, "{summary}");
    assert!((summary["arrival_error_s"].as_f64().unwrap() / 2e-7 - 1.0).abs() < 0.05, "{summary}");

    // the data set tells where it comes from, and that nobody measured it
    let made = app.read(&format!("{DATASETS}/{}", results["dataset_id"].as_str().unwrap())).await;
    assert_eq!((&made["name"], &made["events"], &made["job"]), (&json!("located"), &json!(1500), &json!(job)));
    assert_eq!((&made["synthetic"], &made["location"]["parent"]), (&json!(true), &parent));
    assert_eq!((&made["location"]["summary"], &made["truth"]), (summary, &taken["truth"]));

    // every source lies in the ellipsoid that is stated for it 95 times of 100; events are in the order of the sources
    let (truth, found) = (columns(&app, &sources["dataset_id"]).await, columns(&app, &made["id"]).await);
    let mut inside = 0;
    for row in 0..1500 {
        assert_eq!(found["amplitude_v"][row], truth["amplitude_v"][row]);
        let of = |name: &str| found[name][row].as_f64().unwrap_or(f64::NAN);
        let miss = ["x_m", "y_m", "z_m"].map(|name| of(name) - truth[name][row].as_f64().unwrap());
        inside += u64::from(form(of, miss) <= CHI_SQUARE_3);
    }
    // 95 %, give or take 0.56 %
    let share = inside as f64 / located as f64;
    assert!((0.93..=0.97).contains(&share), "{share}");

    // the location error is known now, and sets the smallest radius
    let error = made["metadata"]["location_error_m"].as_f64().unwrap();
    let inputs = json!({"dataset": made["id"], "analyses": [{"kind": "correlation_integral"}], "figures": "none"});
    let (_, results) = run(&app, "emission-analysis", &inputs).await;
    let first = results["analyses"][0]["points"][0]["r_m"].as_f64().unwrap();
    assert!((first / (4.0 * error) - 1.0).abs() < 1e-9, "{first} {error}");
}

#[tokio::test]
async fn what_a_location_lacks_is_named_before_there_is_a_job() {
    let app = TestApp::start().await;
    let refused = |inputs: Value| {
        let app = &app;
        async move { app.post("/v1/processes/emission-location/execution").json(&json!({"inputs": inputs})).await }
    };
    let hits = "time_s,amplitude_v,channel\n0,0.1,1\n0.00001,0.1,2\n";
    let dataset = upload(&app, "name=two", hits).await.json(201)["id"].clone();
    let answer = refused(json!({"dataset": dataset})).await;
    assert_eq!(answer.pointers("invalid-inputs"), ["/inputs/dataset"]);
    assert!(answer.text().contains("wave speed"), "{}", answer.text());
    let answer = refused(json!({"dataset": dataset, "options": {"speed_m_per_s": 3900}})).await;
    assert!(answer.text().contains("the sensors with their positions"), "{}", answer.text());
    for (options, pointer) in [
        (json!({"speed_m_per_s": -1}), "/inputs/options/speed_m_per_s"),
        (json!({"speed_m_per_s": 3900, "dimensions": 4}), "/inputs/options/dimensions"),
        (json!({"velocity": 3900}), "/inputs/options/velocity"),
    ] {
        let answer = refused(json!({"dataset": dataset, "options": options})).await;
        assert_eq!(answer.pointers("invalid-inputs"), [pointer]);
    }
    let table = upload(&app, "name=none", "time_s,amplitude_v\n0,0.1\n").await.json(201)["id"].clone();
    let answer = refused(json!({"dataset": table, "options": {"speed_m_per_s": 3900}})).await;
    assert!(answer.text().contains("column channel is missing"), "{}", answer.text());
}

use serde_json::{Value, json};

use super::*;
use crate::emission::close;
use crate::emission::synthetic::{Clustering, SyntheticOptions, synthetic};
use crate::progress::Unobserved;

fn requests(value: Value) -> Vec<Request> {
    serde_json::from_value(value).unwrap()
}

fn polycrystal() -> Catalogue {
    let clustering = Some(Clustering { branching_ratio: 0.3, c_s: 0.05, p: 1.5 });
    let options = SyntheticOptions {
        events: 3000,
        grain_size_mm: Some(0.87),
        unloading_share: 0.3,
        clustering,
        ..SyntheticOptions::default()
    };
    synthetic(&options, 1).unwrap().0
}

fn all() -> Value {
    let breaks: Vec<Value> = (0..3).map(|k| json!({"number": k, "distance_m": 0.1, "amplitude_db": 99.0})).collect();
    json!([
        {"kind": "amplitude_distribution", "replicates": 20},
        {"kind": "energy_distribution", "model": "power_law", "replicates": 20},
        {"kind": "duration_scaling"},
        {"kind": "correlation_integral"},
        {"kind": "waiting_times"},
        {"kind": "aftershocks"},
        {"kind": "activity"},
        {"kind": "exponent_map", "replicates": 5, "range_points": 6},
        {"kind": "monte_carlo_validation", "replicates": 20},
        {"kind": "source_model", "sensitivity_v_per_pa": 1.0, "distance_m": 0.1, "volume_m3": 1e-4},
        {"kind": "calibration", "breaks": breaks},
        {"kind": "phase_comparison", "fit": {"replicates": 10, "xmin": 0.0032}},
    ])
}

#[test]
fn all_twelve_run_and_give_the_same_bits_at_any_number_of_threads() {
    let (catalogue, requests) = (polycrystal(), requests(all()));
    assert_eq!(requests.len(), 12);
    let run_with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let outcomes = pool.install(|| run(&catalogue, &requests, 7, &Unobserved)).unwrap();
        serde_json::to_string(&outcomes).unwrap()
    };
    let one = run_with(1);
    assert_eq!(one, run_with(2));
    assert_eq!(one, run_with(8));
    let read: Vec<Outcome> = serde_json::from_str(&one).unwrap();
    let kinds: Vec<&str> = requests.iter().map(Request::kind).collect();
    let values: Vec<Value> = serde_json::from_str(&one).unwrap();
    assert_eq!(values.iter().map(|v| v["kind"].as_str().unwrap()).collect::<Vec<_>>(), kinds);
    assert_eq!(serde_json::to_string(&read).unwrap(), one);
}

#[test]
fn a_fit_has_exactly_the_promised_fields_and_finds_the_truth() {
    let options = SyntheticOptions { events: 5000, grain_size_mm: Some(0.87), ..SyntheticOptions::default() };
    let (catalogue, truth) = synthetic(&options, 3).unwrap();
    let requests =
        requests(json!([{"kind": "amplitude_distribution", "model": "auto", "replicates": 50, "xmin": 0.0033}]));
    let outcome = serde_json::to_value(&run(&catalogue, &requests, 1, &Unobserved).unwrap()[0]).unwrap();
    let mut fields: Vec<&String> = outcome["fit"].as_object().unwrap().keys().collect();
    fields.sort();
    assert_eq!(
        fields,
        [
            "aic",
            "alpha",
            "alpha_se",
            "bic",
            "ci95",
            "cutoff",
            "ks_convention",
            "ks_distance",
            "loglik",
            "model",
            "n_tail",
            "p_value",
            "replicates",
            "xmax",
            "xmin"
        ]
    );
    let fit = &outcome["fit"];
    assert_eq!((fit["model"].as_str(), fit["ks_convention"].as_str()), (Some("cutoff_power_law"), Some("csn")));
    close(fit["alpha"].as_f64().unwrap(), truth.tau, 3.0 * fit["alpha_se"].as_f64().unwrap());
    assert!((0.06..0.16).contains(&fit["cutoff"].as_f64().unwrap()));
    assert_eq!(outcome["comparison"].as_array().unwrap().len(), 15);
    assert!(outcome["choice"]["reason"].as_str().unwrap().starts_with("cutoff_power_law has the lowest BIC"));
    // density and curve tell the same story
    let curve = outcome["curve"].as_array().unwrap();
    assert_eq!(curve.len(), 100);
    close(curve[0]["ccdf"].as_f64().unwrap(), fit["n_tail"].as_f64().unwrap() / 5000.0, 1e-9);
}

#[test]
fn whole_decibels_and_exact_volts_give_the_same_exponent() {
    let single = SyntheticOptions { events: 20_000, ..SyntheticOptions::default() };
    let rounded = SyntheticOptions { db_step: Some(1.0), ..single.clone() };
    let alpha = |options: &SyntheticOptions| {
        let request = requests(
            json!([{"kind": "amplitude_distribution", "model": "power_law", "xmin": 0.0034, "replicates": 0}]),
        );
        match run(&synthetic(options, 2).unwrap().0, &request, 1, &Unobserved).unwrap().remove(0) {
            Outcome::AmplitudeDistribution(result) => (result.fit.alpha.unwrap(), result.fit.alpha_se.unwrap()),
            _ => unreachable!(),
        }
    };
    let (exact, bins) = (alpha(&single), alpha(&rounded));
    close(exact.0, 2.0, 3.0 * exact.1);
    close(bins.0, 2.0, 3.0 * bins.1);
    close(exact.0, bins.0, exact.1);
}

#[test]
fn energy_follows_from_amplitude() {
    let (catalogue, _) = synthetic(&SyntheticOptions { events: 5000, ..Default::default() }, 4).unwrap();
    let request = requests(json!([{"kind": "energy_distribution", "model": "power_law", "replicates": 0}]));
    let Outcome::EnergyDistribution(result) = run(&catalogue, &request, 1, &Unobserved).unwrap().remove(0) else {
        panic!()
    };
    let consistency = result.energy_consistency.unwrap();
    close(consistency.energy_exponent, 2.0, 0.01);
    // tau = 2, x = 2: epsilon = 1.5
    close(consistency.predicted, 1.5, 0.05);
    close(consistency.fitted, consistency.predicted, 0.01);
}

#[test]
fn phases_differ_where_the_generator_made_them_differ() {
    let options = SyntheticOptions {
        events: 8000,
        grain_size_mm: Some(0.87),
        unloading_share: 0.5,
        clip_v: 1e9,
        ..SyntheticOptions::default()
    };
    let (catalogue, truth) = synthetic(&options, 5).unwrap();
    let request = requests(json!([{"kind": "phase_comparison", "fit": {"xmin": 0.0032, "replicates": 0}}]));
    let Outcome::PhaseComparison(found) = run(&catalogue, &request, 1, &Unobserved).unwrap().remove(0) else {
        panic!()
    };
    assert_eq!(
        (found.loading.fit.model, found.unloading.fit.model),
        (super::super::tails::Model::CutoffPowerLaw, super::super::tails::Model::PowerLaw)
    );
    let of = |name: &str| found.differences.iter().find(|d| d.quantity == name).unwrap();
    let alpha = of("alpha");
    assert!(
        alpha.ci95[0] <= truth.tau_unloading - truth.tau && truth.tau_unloading - truth.tau <= alpha.ci95[1],
        "{alpha:?}"
    );
    assert!(of("scaled_duration_above_10_mv_us").ci95[0] > 0.0);
    assert!(found.amplitudes.p_value < 0.01);
    assert!(found.common_exponent.unwrap().p_value < 0.01);
}

#[test]
fn what_cannot_run_is_named_before_it_runs() {
    let catalogue = Catalogue::new(
        [(Column::AmplitudeV, (1..=60).map(f64::from).collect())].into_iter().collect(),
        super::super::catalogue::Metadata::default(),
    )
    .unwrap();
    for (request, words) in [
        (json!({"kind": "duration_scaling"}), "analysis 0 (duration_scaling): column duration_us is missing"),
        (json!({"kind": "waiting_times"}), "column time_s is missing"),
        (json!({"kind": "correlation_integral"}), "column x_m is missing"),
        (json!({"kind": "activity"}), "column strain, stress_mpa or time_s is missing"),
        (json!({"kind": "activity", "against": "stress"}), "column stress_mpa is missing"),
        (json!({"kind": "phase_comparison"}), "column phase is missing"),
        (json!({"kind": "energy_distribution"}), "column energy_eu is missing"),
        (json!({"kind": "amplitude_distribution", "xmin": -1.0}), "xmin is -1"),
        (json!({"kind": "amplitude_distribution", "xmin": 2.0, "xmax": 1.0}), "xmax is 1"),
        (json!({"kind": "amplitude_distribution", "model": "power_law", "xmax": 9.0}), "bounded_power_law"),
        (json!({"kind": "amplitude_distribution", "replicates": 1_000_000}), "replicates is 1000000: at most 100000"),
        (json!({"kind": "calibration", "breaks": []}), "calibration: 0 event(s), at least 3"),
    ] {
        let refused = check(&catalogue, &requests(json!([request.clone()]))).unwrap_err().to_string();
        assert!(refused.contains(words), "{refused}");
    }
    let run_one =
        |request: Value| run(&catalogue, &requests(json!([request])), 1, &Unobserved).unwrap_err().to_string();
    assert!(run_one(json!({"kind": "source_model", "distance_m": 1.0})).contains("sensitivity_v_per_pa is not known"));
    assert!(run_one(json!({"kind": "amplitude_distribution", "xmin": 59.0})).contains("at least 3 are needed"));
    for unknown in [
        json!([{"kind": "wavelets"}]),
        json!([{"kind": "activity", "bin": 3}]),
        json!([{"kind": "amplitude_distribution", "model": "x"}]),
    ] {
        assert!(serde_json::from_value::<Vec<Request>>(unknown).is_err());
    }
}

struct Stop;

impl Progress for Stop {
    fn report(&self, fraction: f64, _: &str) {
        assert!((0.0..=1.0).contains(&fraction));
    }

    fn cancelled(&self) -> bool {
        true
    }
}

#[test]
fn a_cancelled_run_says_so() {
    let error = run(&polycrystal(), &requests(json!([{"kind": "amplitude_distribution"}])), 1, &Stop).unwrap_err();
    assert_eq!(error.error, EmissionError::Cancelled);
}

/// Nobody wants the result any more.
struct Dismissed;

impl crate::progress::Progress for Dismissed {
    fn report(&self, _: f64, _: &str) {}

    fn cancelled(&self) -> bool {
        true
    }
}

#[test]
fn durations_waiting_times_and_aftershocks_end_when_they_are_dismissed() {
    use crate::emission::aftershocks::{AftershockOptions, aftershocks};
    use crate::emission::duration::{DurationOptions, duration_scaling};
    use crate::emission::waiting::waiting_times;

    let (catalogue, _) = synthetic(&SyntheticOptions { events: 500, ..Default::default() }, 1).unwrap();
    let amplitudes = catalogue.amplitudes_v("test").unwrap();
    let [times, durations] = [Column::TimeS, Column::DurationUs].map(|column| catalogue.column(column).unwrap());
    let cancelled = Some(EmissionError::Cancelled);
    assert_eq!(
        duration_scaling(&amplitudes, durations, &DurationOptions::default(), 1, &Dismissed).err(),
        cancelled.clone()
    );
    assert_eq!(waiting_times(times, &amplitudes, &[], &Dismissed).err(), cancelled.clone());
    assert_eq!(aftershocks(times, &amplitudes, &AftershockOptions::default(), &Dismissed).err(), cancelled);
}

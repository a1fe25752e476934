use super::*;
use crate::emission::catalogue::{FlagKind, quality};
use crate::emission::close;
use crate::emission::numerics::mean;

#[test]
fn the_same_seed_gives_the_same_bits() {
    let options = SyntheticOptions { events: 500, ..SyntheticOptions::default() };
    assert_eq!(synthetic(&options, 1).unwrap(), synthetic(&options, 1).unwrap());
    assert_ne!(synthetic(&options, 1).unwrap().0, synthetic(&options, 2).unwrap().0);
}

#[test]
fn amplitudes_have_the_exponent_that_is_recorded() {
    for (grain_size_mm, temperature_c) in [(None, -3.0), (None, -20.0), (Some(0.26), -10.0), (Some(5.02), -10.0)] {
        let options =
            SyntheticOptions { events: 20_000, grain_size_mm, temperature_c, clip_v: 1e9, ..Default::default() };
        let (catalogue, truth) = synthetic(&options, 3).unwrap();
        let sample = crate::emission::sample::Sample::exact(catalogue.amplitudes_v("x").unwrap(), "x").unwrap();
        let tail = sample.tail(None, None).unwrap();
        use crate::emission::tails::{Model, fit};
        let model = if grain_size_mm.is_some() { Model::CutoffPowerLaw } else { Model::PowerLaw };
        let fit = fit(&tail, model).unwrap();
        let alpha = fit.parameter("alpha").unwrap();
        close(alpha.value, truth.tau, 3.5 * alpha.se.unwrap());
        if let (Some(cutoff), Some(truth)) = (fit.parameter("cutoff"), truth.cutoff_v) {
            close(cutoff.value, truth, 3.5 * cutoff.se.unwrap());
        }
    }
}

#[test]
fn durations_follow_the_damping_and_the_orderings() {
    let mean_duration = |options: &SyntheticOptions, from: f64, to: f64| {
        let (catalogue, truth) = synthetic(options, 5).unwrap();
        let amplitudes = catalogue.amplitudes_v("x").unwrap();
        let durations = catalogue.column(Column::DurationUs).unwrap();
        let chosen: Vec<f64> =
            amplitudes.iter().zip(durations).filter(|(a, _)| (from..to).contains(*a)).map(|p| *p.1).collect();
        let expected = (0.5 * (from + to) / truth.threshold_v).ln() / truth.damping_per_s * 1e6;
        (mean(&chosen), expected)
    };
    let base = SyntheticOptions { events: 50_000, ..Default::default() };
    let (found, expected) = mean_duration(&base, 0.0198, 0.0202);
    close(found / expected, 1.0, 0.05);
    assert!(mean_duration(&base, 0.05, 0.1).0 > mean_duration(&base, 0.01, 0.02).0);
    let warm = SyntheticOptions { temperature_c: -3.0, ..base.clone() };
    assert!(mean_duration(&warm, 0.01, 0.02).0 < mean_duration(&base, 0.01, 0.02).0);
    let [fine, coarse] = [0.26, 5.02].map(|grain| SyntheticOptions { grain_size_mm: Some(grain), ..base.clone() });
    assert!(mean_duration(&fine, 0.01, 0.02).0 < mean_duration(&coarse, 0.01, 0.02).0);
    let unloading = SyntheticOptions { unloading_share: 1.0, ..base.clone() };
    assert!(mean_duration(&unloading, 0.011, 0.02).0 > 1.4 * mean_duration(&base, 0.011, 0.02).0);
}

#[test]
fn recorder_faults_raise_their_flags() {
    let kinds = |options: &SyntheticOptions| -> Vec<FlagKind> {
        quality(&synthetic(options, 1).unwrap().0).into_iter().map(|flag| flag.kind).collect()
    };
    let base = SyntheticOptions { events: 50_000, ..Default::default() };
    assert_eq!(kinds(&SyntheticOptions { clip_v: 1e9, ..base.clone() }), []);
    assert_eq!(kinds(&SyntheticOptions { clip_v: 1.0, ..base.clone() }), [FlagKind::Saturation]);
    let rounded = SyntheticOptions { db_step: Some(1.0), clip_v: 1e9, ..base };
    assert!(kinds(&rounded).contains(&FlagKind::DecibelResolution));
    let (catalogue, truth) = synthetic(&SyntheticOptions { clip_v: 1.0, ..rounded }, 1).unwrap();
    assert!(truth.clipped > 50);
    let largest = catalogue.column(Column::AmplitudeDb).unwrap().iter().copied().fold(0.0, f64::max);
    assert_eq!(largest, 80.0);
}

#[test]
fn nonsense_is_refused_by_name() {
    let base = SyntheticOptions::default();
    for (options, name) in [
        (SyntheticOptions { events: 0, ..base.clone() }, "events"),
        (SyntheticOptions { dimension: 3.5, ..base.clone() }, "dimension"),
        (SyntheticOptions { temperature_c: f64::NAN, ..base.clone() }, "temperature_c"),
        (SyntheticOptions { db_step: Some(0.0), ..base.clone() }, "db_step"),
        (
            SyntheticOptions {
                clustering: Some(Clustering { branching_ratio: 1.0, c_s: 1.0, p: 1.2 }),
                ..base.clone()
            },
            "branching_ratio",
        ),
    ] {
        assert!(synthetic(&options, 1).unwrap_err().to_string().starts_with(name));
    }
}

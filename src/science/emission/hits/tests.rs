use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::emission::close;
use crate::emission::samples::pareto_sample;
use crate::progress::Unobserved;

const RATE: f64 = 1e6;

fn options(t1_us: f64, t2_us: f64) -> HitOptions {
    HitOptions {
        threshold_v: 0.1,
        hit_definition_s: t1_us * 1e-6,
        hit_lockout_s: t2_us * 1e-6,
        peak_definition_s: None,
    }
}

/// A wave of `length` samples with 0.5 V at the given samples.
fn pulses(length: usize, at: &[usize]) -> Vec<f64> {
    let mut samples = vec![0.0; length];
    at.iter().for_each(|&i| samples[i] = 0.5);
    samples
}

fn of(samples: &[f64], options: &HitOptions) -> Vec<Hit> {
    hits(&Waveform { samples, rate_hz: RATE, start_s: 0.0 }, options).unwrap()
}

#[test]
fn features_of_a_wave_by_hand() {
    // 0.2 V, -0.8 V, 0.4 V, 0.05 V, 0.3 V at 1 MHz, threshold 0.1 V
    let samples = [0.0, 0.2, -0.8, 0.4, 0.05, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0];
    let hit = of(&samples, &options(3.0, 0.0))[0];
    let features = hit.features;
    assert_eq!((hit.first, hit.last, hit.cut), (1, 5, false));
    close(hit.time_s, 1e-6, 1e-18);
    assert_eq!((features.amplitude_v, features.counts), (0.8, 3));
    close(features.duration_us, 4.0, 1e-9);
    close(features.rise_time_us, 1.0, 1e-9);
    // 0.04 + 0.64 + 0.16 + 0.0025 + 0.09 V2, 1e-6 s
    close(features.energy_eu, 0.9325e-6 / 1e-14, 1e-3);
    close(features.average_frequency_khz.unwrap(), 750.0, 1e-9);
    close(features.ra_us_per_v, 1.25, 1e-9);
    // a peak definition time of 0.5 us sees the first sample alone
    let early = HitOptions { peak_definition_s: Some(5e-7), ..options(3.0, 0.0) };
    assert_eq!(of(&samples, &early)[0].features.amplitude_v, 0.2);
}

#[test]
fn hits_merge_if_and_only_if_the_gap_is_at_most_t1() {
    for gap in 1..40 {
        let found = of(&pulses(200, &[20, 20 + gap]), &options(15.0, 0.0)).len();
        assert_eq!(found, if gap <= 15 { 1 } else { 2 }, "{gap}");
    }
}

#[test]
fn echoes_within_t2_are_never_counted() {
    for gap in 16..80 {
        let found = of(&pulses(200, &[20, 20 + gap]), &options(15.0, 30.0));
        assert_eq!(found.len(), if gap <= 45 { 1 } else { 2 }, "{gap}");
        assert_eq!(found[0].last, 20);
    }
}

#[test]
fn a_hit_that_the_waveform_cuts_says_so() {
    assert!(of(&pulses(30, &[20]), &options(15.0, 0.0))[0].cut);
    assert!(!of(&pulses(40, &[20]), &options(15.0, 0.0))[0].cut);
}

/// Damped bursts of 150 kHz with noise of `noise` V; returns the samples, the first sample and the duration of each burst.
fn bursts(amplitudes: &[f64], spacing: usize, noise: f64, seed: u64) -> (Vec<f64>, Vec<(usize, f64)>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut normal = move || {
        let (u, v): (f64, f64) = (rng.random(), rng.random());
        (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    };
    let mut samples: Vec<f64> = (0..spacing * (amplitudes.len() + 1)).map(|_| noise * normal()).collect();
    let (damping, omega) = (20e3, std::f64::consts::TAU * 150e3);
    let mut truth = Vec::new();
    for (k, amplitude) in amplitudes.iter().enumerate() {
        let start = spacing * k + spacing / 2;
        for i in 0..spacing / 2 {
            let t = i as f64 / RATE;
            samples[start + i] += amplitude * (-damping * t).exp() * (omega * t + 1.0).sin();
        }
        truth.push((start, (amplitude / 0.1).ln() / damping));
    }
    (samples, truth)
}

#[test]
fn every_burst_is_recalled_at_20_db() {
    // peaks of 1 V and more in noise of 0.02 V: the threshold of 0.1 V is 5 sigma up, the signal 34 dB; spacing 2 ms > d + T1 + T2
    let amplitudes: Vec<f64> = (0..40).map(|k| 1.0 + f64::from(k % 7)).collect();
    let (samples, truth) = bursts(&amplitudes, 2000, 0.02, 1);
    let found = of(&samples, &options(200.0, 500.0));
    let near = |start: usize| found.iter().filter(|hit| hit.first.abs_diff(start) <= 7).count();
    assert!(truth.iter().all(|&(start, _)| near(start) == 1));
    // of 20 dB: 0.2 V in 0.02 V, 5 sigma noise crossings are 6e-7 a sample
    let (samples, truth) = bursts(&[0.3; 40], 2000, 0.0212, 2);
    let found = of(&samples, &options(200.0, 500.0));
    let near = |start: usize| found.iter().filter(|hit| hit.first.abs_diff(start) <= 14).count();
    assert!(truth.iter().all(|&(start, _)| near(start) == 1), "{found:?}");
}

#[test]
fn durations_are_those_of_the_wave_within_a_sample() {
    let (samples, truth) = bursts(&[1.0, 3.0, 7.0], 2000, 0.0, 1);
    for (hit, (start, _)) in of(&samples, &options(200.0, 500.0)).iter().zip(truth) {
        // the truth of a sampled wave: its first and last sample beyond the threshold, by definition
        let above: Vec<usize> = (start..start + 1000).filter(|&i| samples[i].abs() >= 0.1).collect();
        let duration = (above[above.len() - 1] - above[0]) as f64;
        close(hit.features.duration_us, duration, 1.0);
        // and the envelope's duration within one period of the carrier, 6.7 us
        let envelope = (hit.features.amplitude_v / 0.1).ln() / 20e3 * 1e6;
        close(hit.features.duration_us, envelope, 10.0);
    }
}

#[test]
fn pickers_find_the_onset() {
    let (samples, truth) = bursts(&[2.0], 4000, 0.02, 3);
    let start = truth[0].0;
    let window = &samples[start - 800..start + 60];
    close(picker::aic(window).unwrap() as f64, 800.0, 2.0);
    close(picker::hinkley(window, 10.0).unwrap() as f64, 800.0, 3.0);
    assert_eq!(picker::aic(&[0.0; 100]), None);
    assert_eq!(picker::aic(&[1.0; 4]), None);
    assert_eq!(picker::hinkley(&[0.0; 100], 4.0), None);
    assert_eq!(picker::hinkley(window, 0.0), None);
}

#[test]
fn the_scan_shows_the_exponent_and_how_merging_bends_it() {
    let mut amplitudes = pareto_sample(1500, 2.0, 0.3, 4);
    // any order but the sorted one
    amplitudes.sort_by(|a, b| (a * 1e6).fract().total_cmp(&(b * 1e6).fract()));
    amplitudes.iter_mut().for_each(|a| *a = a.min(100.0));
    let (samples, _) = bursts(&amplitudes, 800, 0.0, 4);
    let waveform = Waveform { samples: &samples, rate_hz: RATE, start_s: 0.0 };
    let scan = SensitivityOptions {
        threshold_v: vec![0.1],
        hit_definition_s: vec![50e-6, 2e-3],
        hit_lockout_s: vec![0.0],
        xmin: Some(0.3),
    };
    let found = sensitivity(&[waveform], &scan, &Unobserved).unwrap();
    assert!((1400..=1500).contains(&found[0].hits), "{found:?}");
    close(found[0].alpha.unwrap(), 2.0, 4.0 * found[0].alpha_se.unwrap());
    // with a T1 longer than the spacing all merge into one
    assert_eq!((found[1].hits, found[1].alpha), (1, None));
    assert!(sensitivity(&[waveform], &SensitivityOptions { threshold_v: vec![], ..scan }, &Unobserved).is_err());
}

#[test]
fn nonsense_is_refused_by_name() {
    let samples = [0.0, f64::NAN];
    let waveform = Waveform { samples: &samples, rate_hz: RATE, start_s: 0.0 };
    assert!(hits(&waveform, &options(10.0, 0.0)).unwrap_err().to_string().starts_with("waveform, row 2: NaN"));
    assert!(hits(&waveform, &options(0.5, 0.0)).unwrap_err().to_string().contains("at least one sample"));
    assert!(hits(&waveform, &options(10.0, -1.0)).unwrap_err().to_string().starts_with("hit_lockout_s is"));
}

proptest! {
    #[test]
    fn hits_never_overlap_and_hold_every_crossing_or_lie_in_a_lockout(
        samples in proptest::collection::vec(-0.3_f64..0.3, 0..300), t1 in 1.0_f64..20.0, t2 in 0.0_f64..20.0
    ) {
        let found = of(&samples, &options(t1, t2));
        for pair in found.windows(2) {
            prop_assert!((pair[1].first - pair[0].last) as f64 > t1.floor() + t2.floor());
        }
        for (i, sample) in samples.iter().enumerate().filter(|(_, x)| x.abs() >= 0.1) {
            let inside = found.iter().any(|hit| (hit.first..=hit.last).contains(&i));
            let locked = found.iter().any(|hit| i > hit.last && (i - hit.last) as f64 <= t1.floor() + t2.floor());
            prop_assert!(inside || locked, "{i} {sample}");
        }
    }
}

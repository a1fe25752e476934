use proptest::prelude::*;

use super::*;
use crate::emission::close;
use crate::emission::samples::{cutoff_sample, pareto_sample, reference_sample};
use crate::emission::tails::{DecibelLevels, Rounding};

/// Customers affected by 211 blackouts of the USA, 1984 to 2002, in thousands (Newman 2005, Contemp. Phys. 46, 323-351).
pub(in crate::emission) const BLACKOUTS: [f64; 211] = [
    1.0, 1.646, 1.8, 2.0, 2.9, 4.15, 5.3, 7.5, 8.0, 9.0, 10.0, 10.0, 10.3, 11.0, 11.529, 12.0, 14.273, 15.0, 15.0,
    17.0, 18.0, 18.0, 18.351, 18.819, 19.0, 20.0, 20.0, 24.0, 24.506, 25.0, 25.0, 25.0, 25.0, 25.0, 25.0, 26.334, 29.0,
    29.0, 29.9, 30.0, 30.001, 30.5, 32.0, 32.0, 33.0, 35.0, 36.073, 37.0, 38.5, 39.5, 40.0, 40.0, 40.0, 40.911, 43.0,
    43.696, 45.0, 46.0, 48.0, 50.0, 50.0, 50.0, 50.0, 50.0, 50.0, 50.0, 50.0, 50.0, 50.462, 51.0, 51.0, 53.0, 55.0,
    55.0, 56.0, 56.0, 58.0, 59.0, 60.0, 60.0, 60.0, 60.0, 60.0, 62.0, 63.5, 65.0, 65.0, 66.005, 70.0, 70.0, 70.0, 70.0,
    71.0, 71.0, 71.0, 74.0, 75.0, 75.0, 80.0, 80.0, 81.0, 82.5, 88.0, 90.0, 91.0, 92.0, 92.0, 94.285, 95.0, 95.63,
    100.0, 100.0, 100.0, 100.0, 106.85, 112.0, 113.2, 114.0, 114.5, 115.0, 120.0, 120.0, 122.0, 124.0, 126.0, 128.0,
    130.0, 130.0, 133.0, 142.0, 145.0, 145.0, 146.0, 147.0, 148.0, 158.0, 160.0, 160.0, 160.0, 163.0, 164.5, 166.0,
    173.0, 173.0, 190.0, 191.0, 200.0, 203.0, 206.0, 207.2, 210.882, 219.0, 230.0, 234.0, 235.0, 238.0, 240.0, 242.91,
    246.0, 246.0, 250.0, 257.718, 258.0, 272.0, 272.0, 284.0, 290.0, 300.0, 300.0, 300.0, 300.0, 312.0, 315.0, 320.831,
    350.0, 350.0, 360.0, 363.476, 375.0, 385.0, 400.0, 400.0, 404.0, 460.0, 464.0, 490.0, 500.0, 500.0, 500.0, 557.354,
    570.0, 598.0, 600.0, 600.0, 650.0, 660.0, 725.0, 870.0, 875.0, 877.0, 899.0, 1140.0, 1300.0, 1500.0, 1500.0,
    1500.0, 1600.0, 1660.0, 2085.0, 2100.0, 7500.0,
];

#[test]
fn the_published_blackouts_come_out() {
    // Clauset, Shalizi & Newman (2009), table 6.1: xmin = 230, alpha = 2.3, n_tail = 59; digits by numpy over all values
    for convention in [KsConvention::Csn, KsConvention::TwoSided] {
        let start = scan(&BLACKOUTS, convention).unwrap();
        assert_eq!((start.xmin, start.n_tail), (230.0, 59));
        close(start.alpha, 2.272637219830288, 1e-12);
        close(start.ks_distance, 0.060673796294438476, 1e-12);
    }
}

#[test]
fn the_reference_sample_agrees_with_numpy() {
    let start = scan(&reference_sample(), KsConvention::Csn).unwrap();
    close(start.xmin, 0.14799203734880637, 1e-12);
    close(start.alpha, 2.6036717731764067, 1e-9);
    close(start.ks_distance, 0.08455962422991914, 1e-9);
    assert_eq!(start.n_tail, 32);
}

/// Every candidate in full.
fn by_brute_force(sorted: &[f64], convention: KsConvention) -> Option<(f64, usize)> {
    let mut best: Option<(f64, usize)> = None;
    for start in 0..sorted.len() {
        let tie = start > 0 && sorted[start] == sorted[start - 1];
        if tie || sorted[start] == sorted[sorted.len() - 1] {
            continue;
        }
        let tail = &sorted[start..];
        let n = tail.len() as f64;
        let b = n / tail.iter().map(|x| (x / tail[0]).ln()).sum::<f64>();
        let deviation = |(j, x): (usize, &f64)| {
            let f = 1.0 - (x / tail[0]).powf(-b);
            let low = (f - j as f64 / n).abs();
            if convention == KsConvention::TwoSided { low.max((f - (j as f64 + 1.0) / n).abs()) } else { low }
        };
        let distance = tail.iter().enumerate().map(deviation).fold(0.0, f64::max);
        if best.is_none_or(|best| distance < best.0) {
            best = Some((distance, start));
        }
    }
    best
}

proptest! {
    #[test]
    fn pruning_changes_nothing(seed in 0_u64..1000, n in 3_usize..400, grain in prop_oneof![Just(0.0), Just(0.05), Just(0.5)]) {
        let mut x = if seed % 2 == 0 { pareto_sample(n, 1.5 + (seed % 7) as f64 / 4.0, 1.0, seed) } else {
            cutoff_sample(n, 1.2, 20.0, 1.0, seed)
        };
        if grain > 0.0 {
            // ties
            for x in &mut x { *x = (*x / grain).round() * grain; }
        }
        for convention in [KsConvention::Csn, KsConvention::TwoSided] {
            match by_brute_force(&x, convention) {
                Some((distance, start)) => {
                    let found = scan(&x, convention).unwrap();
                    prop_assert!((found.ks_distance - distance).abs() < 1e-12, "{} {}", found.ks_distance, distance);
                    // two candidates may be equally near to the last bits
                    let same = found.xmin == x[start];
                    prop_assert!(same || n < 30, "{} {}", found.xmin, x[start]);
                }
                None => prop_assert!(scan(&x, convention).is_err()),
            }
        }
    }
}

#[test]
fn an_early_end_finds_what_the_whole_search_finds() {
    for seed in 0..50 {
        let logs: Vec<f64> = cutoff_sample(300, 1.5, 30.0, 1.0, seed).iter().map(|x| x.ln()).collect();
        let candidates = Candidates::new(&logs, KsConvention::Csn);
        let best = candidates.best().unwrap().distance;
        for likely in [0, 100, 299] {
            assert!(!candidates.any_below(best, likely), "the limit itself is not below");
            assert!(candidates.any_below(best * (1.0 + 1e-9), likely));
        }
    }
}

#[test]
fn a_body_below_the_tail_is_left_out() {
    // a uniform body up to 1 and a Pareto tail
    let mut x: Vec<f64> = (1..=2000).map(|i| f64::from(i) / 2000.0).collect();
    x.extend(pareto_sample(2000, 2.5, 1.0, 3));
    x.sort_by(f64::total_cmp);
    let start = scan(&x, KsConvention::Csn).unwrap();
    assert!((0.85..1.6).contains(&start.xmin), "{start:?}");
    close(start.alpha, 2.5, 0.15);
    let selected = select(&Sample::Exact(x), Model::PowerLaw, None, KsConvention::Csn).unwrap();
    assert!((0.85..1.6).contains(&selected.xmin()), "{}", selected.xmin());
}

#[test]
fn whole_decibels_are_selected_at_an_edge() {
    let db: Vec<f64> = pareto_sample(5000, 2.0, 1.0, 5).iter().map(|x| (40.0 + 20.0 * x.log10()).round()).collect();
    let levels = DecibelLevels::new(&db, 1.0, 1.0, Rounding::Nearest).unwrap();
    let tail = select(&Sample::Rounded(levels), Model::PowerLaw, None, KsConvention::Csn).unwrap();
    let position = 20.0 * tail.xmin().log10();
    close(position - position.floor(), 0.5, 1e-9);
    // the first bin is half empty, so the tail must begin above it
    assert!(position > 40.4, "{position}");
}

#[test]
fn too_little_is_refused() {
    assert!(scan(&[1.0, 2.0], KsConvention::Csn).is_err());
    assert!(scan(&[2.0; 40], KsConvention::Csn).is_err());
    assert!(select(&Sample::Exact(Vec::new()), Model::PowerLaw, None, KsConvention::Csn).is_err());
}

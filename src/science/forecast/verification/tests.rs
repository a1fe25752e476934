use proptest::prelude::*;

use super::bootstrap::{Interval, SeasonDraws, interval, replicate};
use super::brier::decomposition;
use super::reliability::bins;
use super::roc::curve;
use super::*;

/// Twenty scores with ties. The values that tests compare with were computed on them with scikit-learn 1.9.1.
const SCORE: [f64; 20] =
    [0.1, 0.4, 0.35, 0.8, 0.4, 0.4, 0.9, 0.2, 0.2, 0.65, 0.7, 0.4, 0.1, 0.55, 0.8, 0.3, 0.3, 0.05, 0.95, 0.5];
const EVENT: [u8; 20] = [0, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 0, 0, 1, 0, 0, 1, 0, 1, 0];

fn event() -> Vec<bool> {
    EVENT.map(|o| o == 1).to_vec()
}

fn close(value: Option<f64>, expected: f64, tolerance: f64) {
    let value = value.unwrap();
    assert!((value - expected).abs() <= tolerance, "{value} is not {expected}");
}

/// Finley (1884): tornado forecasts for the United States. Scores to three digits as in Wilks (2011, Statistical Methods in the
/// Atmospheric Sciences, 3rd ed., section 8.2.3).
#[test]
fn finleys_tornadoes_score_as_published() {
    let table = Contingency { a: 28, b: 72, c: 23, d: 2680 };
    close(table.pod(), 0.549, 5e-4);
    close(table.far(), 0.720, 5e-4);
    close(table.pofd(), 0.0262, 5e-5);
    close(table.pss(), 0.523, 5e-4);
    close(table.hss(), 0.355, 5e-4);
    close(table.csi(), 0.228, 5e-4);
    close(table.bias(), 1.96, 5e-3);
    // his critics' forecast "never" has no skill, and warning nobody costs the misses
    let never = Contingency { a: 0, b: 0, c: 51, d: 2752 };
    assert_eq!((never.pss(), never.hss()), (Some(0.0), Some(0.0)));
    close(never.expected_cost(0.1), 51.0 / 2803.0, 1e-15);
    close(table.expected_cost(0.1), (0.1 * 100.0 + 23.0) / 2803.0, 1e-15);
}

#[test]
fn counts_go_to_their_cells() {
    let pairs =
        [(true, true), (true, false), (true, false), (false, true), (false, true), (false, true), (false, false)];
    assert_eq!(Contingency::of(pairs), Contingency { a: 1, b: 2, c: 3, d: 1 });
}

#[test]
fn undefined_scores_are_none() {
    let quiet = Contingency { a: 0, b: 0, c: 0, d: 7 };
    assert_eq!(
        [quiet.pod(), quiet.far(), quiet.pss(), quiet.hss(), quiet.csi(), quiet.bias()],
        [None; 6],
        "no event and no forecast"
    );
    assert_eq!(quiet.pofd(), Some(0.0));
    let always = Contingency { a: 3, b: 0, c: 0, d: 0 };
    assert_eq!((always.pod(), always.pofd(), always.pss()), (Some(1.0), None, None));

    let nothing = Scores::of(&[], Some(0.1));
    assert_eq!([nothing.auc, nothing.brier, nothing.brier_skill, nothing.pss, nothing.expected_cost], [None; 5]);
    let certain = [Outcome { probability: 0.2, warned: false, event: false, reference: 0.0 }];
    let certain = Scores::of(&certain, None);
    close(certain.brier, 0.04, 1e-15);
    assert_eq!((certain.auc, certain.brier_skill), (None, None), "one class, and a perfect reference");
}

/// `roc_auc_score(EVENT, SCORE)` and `brier_score_loss(EVENT, SCORE)` of scikit-learn 1.9.1.
#[test]
fn auc_and_brier_are_those_of_scikit_learn() {
    close(auc(&SCORE, &event()), 0.717_171_717_171_717_2, 1e-15);
    close(brier::score(&SCORE, &event()), 0.210_125, 1e-15);
}

#[test]
fn auc_is_the_share_of_pairs_won() {
    // 2 x 2 pairs: 3 > 1, 3 > 2, 2 > 1, and the tie 2 = 2 counts one half
    assert_eq!(auc(&[3.0, 2.0, 2.0, 1.0], &[true, true, false, false]), Some(3.5 / 4.0));
    assert_eq!(auc(&[-0.0, 0.0], &[true, false]), Some(0.5));
    assert_eq!(auc(&[f64::INFINITY, f64::NEG_INFINITY], &[true, false]), Some(1.0));
    assert_eq!(auc(&[0.5, 0.5], &[true, true]), None);
    assert_eq!(auc(&[0.5, f64::NAN], &[true, false]), None);
    assert_eq!(auc(&[0.5], &[true, false]), None);
}

/// The points of `roc_curve(EVENT, SCORE)` of scikit-learn 1.9.1 (11 non-events, 9 events), less those on a straight line.
#[test]
fn the_curve_has_the_corners_of_scikit_learn() {
    let corner = |p: &roc::RocPoint| (p.threshold, (p.pofd * 11.0).round() as u32, (p.pod * 9.0).round() as u32);
    let corners: Vec<_> = curve(&SCORE, &event()).iter().map(corner).collect();
    let expected = [
        (None, 0, 0),
        (Some(0.9), 0, 2),
        (Some(0.8), 1, 3),
        (Some(0.7), 1, 4),
        (Some(0.65), 2, 4),
        (Some(0.55), 2, 5),
        (Some(0.5), 3, 5),
        (Some(0.4), 6, 6),
        (Some(0.35), 6, 7),
        (Some(0.2), 8, 9),
        (Some(0.05), 11, 9),
    ];
    assert_eq!(corners, expected);
    assert!(curve(&[0.1, 0.2], &[false, false]).is_empty());
}

#[test]
fn bins_count_every_day_once() {
    let (probability, event) = ([0.0, 0.1, 0.19, 0.55, 1.0], [false, true, false, true, true]);
    let bins = bins(&probability, &event, 10);
    assert_eq!(bins.iter().map(|b| b.count).collect::<Vec<_>>(), [1, 2, 0, 0, 0, 1, 0, 0, 0, 1]);
    close(bins[1].mean_probability, 0.145, 1e-15);
    assert_eq!(bins[1].observed_frequency, Some(0.5));
    assert_eq!((bins[2].mean_probability, bins[2].observed_frequency), (None, None));
    assert_eq!((bins[9].lower, bins[9].upper), (0.9, 1.0));
}

#[test]
fn thresholds_follow_their_rule() {
    // POD - POFD by cut: 0.8 -> 1/2, 0.6 -> 1/2 - 1/3, 0.5 -> 1 - 1/3 (the best), 0.2 -> 1 - 2/3, 0.1 -> 0
    let (p, o) = ([0.8, 0.6, 0.5, 0.2, 0.1], [true, false, true, false, false]);
    close(ThresholdRule::Peirce.choose(&p, &o), 0.35, 1e-15);
    // of equal skill the cut with fewest warnings
    close(ThresholdRule::Peirce.choose(&[0.9, 0.7, 0.5, 0.3], &[true, false, true, false]), 0.8, 1e-15);
    close(ThresholdRule::Peirce.choose(&[0.3, 0.3], &[true, false]), 0.3, 0.0);
    assert_eq!(ThresholdRule::Peirce.choose(&[0.3, 0.4], &[true, true]), None);
    assert_eq!(ThresholdRule::CostLoss { ratio: 0.25 }.choose(&p, &o), Some(0.25));
}

/// Two seasons of known scores: a replicate is the first, the second, or both.
#[test]
fn replicates_are_whole_seasons() {
    let day = |probability: f64, event| Outcome { probability, warned: probability >= 0.5, event, reference: 0.5 };
    let good = [day(0.9, true), day(0.8, true), day(0.1, false)];
    let bad = [day(0.7, false), day(0.2, true), day(0.6, false)];
    let outcomes = [good, bad].concat();
    let replicates = replicate(&outcomes, &[0, 0, 0, 1, 1, 1], &SeasonDraws::new(2, 200, 5));
    let of = |days: &[Outcome]| Scores::of(days, None);
    let possible = [of(&good), of(&bad), of(&outcomes)];
    let mut seen = [0; 3];
    for i in 0..200 {
        let matches = |s: &Scores| {
            s.auc == replicates.auc[i]
                && s.pss == replicates.pss[i]
                && (s.brier_skill.unwrap() - replicates.brier_skill[i].unwrap()).abs() < 1e-12
        };
        seen[possible.iter().position(matches).unwrap()] += 1;
    }
    // both seasons are drawn in half of the replicates: 100 +- 7
    assert!(seen.iter().all(|&n| n > 25) && (70..=130).contains(&seen[2]), "{seen:?}");
}

/// `numpy.quantile(values, [0.025, 0.975])` with numpy 2.4.6, whose default is type 7.
#[test]
fn intervals_are_quantiles() {
    let mut values: Vec<Option<f64>> = [7.0, 1.0, 3.0, 10.0, 2.0, 8.0, 4.0].map(Some).to_vec();
    values.push(None);
    let Interval { lower, upper } = interval(&values, 0.95).unwrap();
    assert!((lower - 1.15).abs() < 1e-12 && (upper - 9.7).abs() < 1e-12, "{lower} {upper}");
    assert_eq!(interval(&[None], 0.95), None);
    assert_eq!(interval(&[Some(2.0)], 0.95), Some(Interval { lower: 2.0, upper: 2.0 }));
}

/// Probabilities on a coarse grid, so that ties are common.
fn forecasts() -> impl Strategy<Value = (Vec<f64>, Vec<bool>)> {
    prop::collection::vec((0_u32..=20, any::<bool>()), 1..80)
        .prop_map(|days| days.into_iter().map(|(p, o)| (f64::from(p) / 20.0, o)).unzip())
}

proptest! {
    #[test]
    fn auc_asks_for_order_alone((p, o) in forecasts()) {
        let curved: Vec<f64> = p.iter().map(|x| 3.0 * x.powi(3) - 7.0).collect();
        prop_assert_eq!(auc(&curved, &o), auc(&p, &o));
        let negated: Vec<f64> = p.iter().map(|x| -x).collect();
        if let (Some(up), Some(down)) = (auc(&p, &o), auc(&negated, &o)) {
            prop_assert!((up + down - 1.0).abs() < 1e-12);
        }
    }

    /// The definition, pair by pair, and the area below the corners of the curve.
    #[test]
    fn auc_is_the_area_and_the_pairs((p, o) in forecasts()) {
        let Some(area) = auc(&p, &o) else { return Ok(()) };
        let (mut won, mut pairs) = (0.0, 0.0);
        for (&a, _) in p.iter().zip(&o).filter(|&(_, &o)| o) {
            for (&b, _) in p.iter().zip(&o).filter(|&(_, &o)| !o) {
                pairs += 1.0;
                won += if a > b { 1.0 } else if a == b { 0.5 } else { 0.0 };
            }
        }
        prop_assert!((area - won / pairs).abs() < 1e-12);
        let corners = curve(&p, &o);
        let below: f64 = corners.windows(2).map(|w| (w[1].pofd - w[0].pofd) * (w[1].pod + w[0].pod) / 2.0).sum();
        prop_assert!((area - below).abs() < 1e-12);
    }

    #[test]
    fn the_parts_make_the_brier_score((p, o) in forecasts(), count in 1_usize..12) {
        let bins = bins(&p, &o, count);
        prop_assert_eq!(bins.iter().map(|b| b.count).sum::<u64>(), p.len() as u64);
        let parts = decomposition(&p, &o, &bins).unwrap();
        let sum = parts.reliability - parts.resolution + parts.uncertainty + parts.within_variance - parts.within_covariance;
        prop_assert!((sum - brier::score(&p, &o).unwrap()).abs() < 1e-12);
    }

    #[test]
    fn scores_stay_in_range((p, o) in forecasts(), threshold in 0.0..1.0_f64) {
        let outcomes: Vec<Outcome> = p.iter().zip(&o)
            .map(|(&probability, &event)| Outcome { probability, warned: probability >= threshold, event, reference: 0.3 })
            .collect();
        let s = Scores::of(&outcomes, Some(0.2));
        for share in [s.auc, s.brier, s.pod, s.far, s.pofd, s.csi].into_iter().flatten() {
            prop_assert!((0.0..=1.0).contains(&share));
        }
        for skill in [s.pss, s.hss].into_iter().flatten() {
            prop_assert!((-1.0..=1.0).contains(&skill));
        }
        let Contingency { a, b, c, d } = s.contingency;
        prop_assert_eq!((a + b + c + d) as usize, p.len());
    }

    #[test]
    fn a_perfect_forecast_is_perfect(o in prop::collection::vec(any::<bool>(), 2..60)) {
        let outcomes: Vec<Outcome> = o.iter()
            .map(|&event| Outcome { probability: f64::from(u8::from(event)), warned: event, event, reference: 0.4 })
            .collect();
        let s = Scores::of(&outcomes, None);
        prop_assert_eq!((s.brier, s.brier_skill), (Some(0.0), Some(1.0)));
        if o.contains(&true) && o.contains(&false) {
            prop_assert_eq!([s.auc, s.pod, s.pss, s.hss, s.csi, s.bias], [Some(1.0); 6]);
            prop_assert_eq!([s.far, s.pofd], [Some(0.0); 2]);
        }
    }

    /// No other cut of the training probabilities has more Peirce skill.
    #[test]
    fn the_threshold_has_the_largest_skill((p, o) in forecasts()) {
        let Some(chosen) = ThresholdRule::Peirce.choose(&p, &o) else { return Ok(()) };
        let skill = |t: f64| Contingency::of(p.iter().map(|&x| x >= t).zip(o.iter().copied())).pss().unwrap();
        for &other in &p {
            prop_assert!(skill(chosen) >= skill(other) - 1e-12);
        }
    }
}

use super::*;
use crate::emission::close;
use crate::emission::samples::{cutoff_sample, pareto_sample};
use crate::emission::tails::fit;
use crate::emission::xmin::{scan, select, tests::BLACKOUTS};
use crate::progress::Unobserved;

fn of_scan(values: &[f64], replicates: usize, seed: u64) -> f64 {
    let start = scan(values, KsConvention::Csn).unwrap();
    let sample = Sample::Exact(values.to_vec());
    let fitted = fit(&sample.tail(Some(start.xmin), None).unwrap(), Model::PowerLaw).unwrap();
    let convention = KsConvention::Csn;
    let question = Question { sample: &sample, fitted: &fitted, xmin_chosen: true, xmax: None, convention };
    p_value(&question, replicates, seed, &Unobserved).unwrap().p_value
}

#[test]
fn the_published_blackouts_are_not_rejected() {
    // Clauset, Shalizi & Newman (2009), table 6.1: p = 0.62; 2,500 replicates are good to 0.01
    close(of_scan(&BLACKOUTS, 2500, 1), 0.62, 0.04);
}

/// `n` values `x^-alpha` above 1 that join `exp(-alpha (x - 1))` below, as in eq. 3.10 of Clauset et al.
fn with_body(n: usize, alpha: f64, seed: u64) -> Vec<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let body = (alpha.exp() - 1.0) / alpha;
    let share = body / (body + 1.0 / (alpha - 1.0));
    let mut value = || {
        let (which, v): (f64, f64) = (rng.random(), rng.random());
        if which < share {
            -(1.0 - v * (1.0 - (-alpha).exp())).ln() / alpha
        } else {
            (1.0 - v).powf(-1.0 / (alpha - 1.0))
        }
    };
    let mut x: Vec<f64> = (0..n).map(|_| value()).collect();
    x.sort_by(f64::total_cmp);
    x
}

#[test]
fn p_is_spread_evenly_where_the_power_law_is_true_and_small_where_it_is_not() {
    let p: Vec<f64> = (0..60).map(|seed| of_scan(&with_body(500, 2.5, seed), 100, seed)).collect();
    let mean = p.iter().sum::<f64>() / 60.0;
    // the mean of 60 uniform values has the standard error 0.037
    close(mean, 0.5, 0.13);
    let rejected = p.iter().filter(|p| **p < 0.1).count();
    assert!((1..=14).contains(&rejected), "{rejected} of 60 below 0.1");
    // an exponential tail looks like a power law only where few values are left
    let mut exponential: Vec<f64> = (1..=2000).map(|i| 1.0 - (1.0 - (f64::from(i) - 0.5) / 2000.0).ln()).collect();
    exponential.sort_by(f64::total_cmp);
    let sample = Sample::Exact(exponential);
    let fitted = fit(&sample.tail(None, None).unwrap(), Model::PowerLaw).unwrap();
    let convention = KsConvention::Csn;
    let question = Question { sample: &sample, fitted: &fitted, xmin_chosen: false, xmax: None, convention };
    assert!(p_value(&question, 200, 1, &Unobserved).unwrap().p_value < 0.01);
}

#[test]
fn the_true_model_is_kept_and_the_wrong_one_rejected_at_a_given_xmin() {
    let sample = Sample::Exact(cutoff_sample(2000, 1.35, 0.1, 0.003, 9));
    let tail = sample.tail(Some(0.003), None).unwrap();
    let p = |model| {
        let fitted = fit(&tail, model).unwrap();
        let convention = KsConvention::TwoSided;
        let question = Question { sample: &sample, fitted: &fitted, xmin_chosen: false, xmax: None, convention };
        p_value(&question, 200, 3, &Unobserved).unwrap().p_value
    };
    assert!(p(Model::CutoffPowerLaw) > 0.1);
    assert!(p(Model::PowerLaw) < 0.01);
    assert!(p(Model::Exponential) < 0.01);
}

#[test]
fn rounded_data_are_tested_on_rounded_replicates() {
    let p = |seed: u64, xmin_chosen: bool| {
        let db: Vec<f64> = pareto_sample(2000, 2.0, 0.96, seed).iter().map(|x| (20.0 * x.log10()).round()).collect();
        let levels = DecibelLevels::new(&db, 1.0, 1.0, crate::emission::tails::Rounding::Nearest).unwrap();
        let sample = Sample::Rounded(levels);
        let convention = KsConvention::Csn;
        let tail = if xmin_chosen {
            select(&sample, Model::PowerLaw, None, convention).unwrap()
        } else {
            sample.tail(Some(1.1), None).unwrap()
        };
        let fitted = fit(&tail, Model::PowerLaw).unwrap();
        let question = Question { sample: &sample, fitted: &fitted, xmin_chosen, xmax: None, convention };
        p_value(&question, 50, 1, &Unobserved).unwrap().p_value
    };
    // against replicates that were not rounded every p would be 0; the mean of 30 uniform values is 0.5 +- 0.053
    for xmin_chosen in [true, false] {
        let mean = (0..30).map(|seed| p(seed, xmin_chosen)).sum::<f64>() / 30.0;
        close(mean, 0.5, 0.16);
    }
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    let values = with_body(800, 2.0, 5);
    let sample = Sample::Exact(cutoff_sample(400, 1.35, 0.1, 0.003, 2));
    let tail = select(&sample, Model::CutoffPowerLaw, None, KsConvention::Csn).unwrap();
    let fitted = fit(&tail, Model::CutoffPowerLaw).unwrap();
    let convention = KsConvention::Csn;
    let question = Question { sample: &sample, fitted: &fitted, xmin_chosen: true, xmax: None, convention };
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| (of_scan(&values, 100, 7), p_value(&question, 40, 7, &Unobserved).unwrap()))
    };
    let one = run(1);
    assert_eq!(one, run(2));
    assert_eq!(one, run(8));
}

struct Stop;

impl Progress for Stop {
    fn report(&self, _: f64, _: &str) {}

    fn cancelled(&self) -> bool {
        true
    }
}

#[test]
fn it_can_be_cancelled_and_asks_for_replicates() {
    let sample = Sample::Exact(pareto_sample(100, 2.0, 1.0, 1));
    let fitted = fit(&sample.tail(None, None).unwrap(), Model::PowerLaw).unwrap();
    let convention = KsConvention::Csn;
    let question = Question { sample: &sample, fitted: &fitted, xmin_chosen: true, xmax: None, convention };
    assert_eq!(p_value(&question, 100, 1, &Stop), Err(EmissionError::Cancelled));
    assert!(p_value(&question, 0, 1, &Unobserved).unwrap_err().to_string().starts_with("replicates is 0"));
}

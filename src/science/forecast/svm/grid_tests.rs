use std::sync::atomic::{AtomicUsize, Ordering};

use super::*;
use crate::forecast::svm::machine::train;
use crate::forecast::svm::problems::seasons;
use crate::progress::Unobserved;

fn small() -> Grid {
    Grid { c: vec![3.0, 0.1, 30.0], gamma: vec![0.03, 0.3] }
}

fn search(family: KernelFamily, options: &SolverOptions) -> GridResult {
    let (x, labels, fold) = seasons(1, 5, 60);
    grid_search(&x, &labels, &fold, family, &small(), options, &Unobserved).unwrap()
}

/// Share of pairs (event, none) in the right order, from the definition.
fn auc_by_pairs(values: &[f64], events: &[bool]) -> f64 {
    let of = |class: bool| values.iter().zip(events).filter(move |(_, event)| **event == class).map(|(v, _)| *v);
    let (mut right, mut pairs) = (0.0, 0.0);
    for event in of(true) {
        for none in of(false) {
            right += if event > none {
                1.0
            } else if event == none {
                0.5
            } else {
                0.0
            };
            pairs += 1.0;
        }
    }
    right / pairs
}

#[test]
fn every_point_is_what_single_fits_give() {
    let (x, labels, fold) = seasons(1, 5, 60);
    let options = SolverOptions { epsilon: 1e-6, ..SolverOptions::default() };
    for family in [KernelFamily::Gaussian, KernelFamily::Linear] {
        let result = search(family, &options);
        assert_eq!(result.points.len(), if family == KernelFamily::Gaussian { 6 } else { 3 });
        for point in &result.points {
            let kernel = family.with_gamma(point.gamma.unwrap_or(f64::NAN));
            let mut aucs = Vec::new();
            for name in 0..5 {
                let (test, training): (Vec<usize>, Vec<usize>) = (0..300).partition(|&row| fold[row] == name);
                let of = |rows: &[usize]| rows.iter().map(|&row| labels[row]).collect::<Vec<bool>>();
                let cost = Cost::balanced(point.c, &of(&training));
                let machine = train(&x.select_rows(&training), &of(&training), kernel, cost, &options).unwrap();
                let values: Vec<f64> = test.iter().map(|&row| machine.decision_value(x.row(row))).collect();
                aucs.push(auc_by_pairs(&values, &of(&test)));
                if *point == result.best {
                    for (&row, value) in test.iter().zip(values) {
                        assert!((result.decision_values[row] - value).abs() < 1e-3, "row {row}");
                    }
                }
            }
            let mean = aucs.iter().sum::<f64>() / 5.0;
            // one pair in 60 days changes the order at most
            assert!((point.auc - mean).abs() < 5e-4, "{point:?} {mean}");
            assert!(point.auc <= result.best.auc);
        }
    }
}

#[test]
fn ties_go_to_the_smaller_cost_and_gamma() {
    // one feature: at every gamma the decision value orders the days as the feature does
    let x = Matrix::from_rows(8, 1, vec![-2.0, -1.0, 1.0, 2.0, -2.5, -1.5, 1.5, 2.5]).unwrap();
    let labels = [false, false, true, true, false, false, true, true];
    let fold = [0, 0, 0, 0, 1, 1, 1, 1];
    let grid = Grid { c: vec![10.0, 1.0], gamma: vec![0.2, 0.1] };
    let options = SolverOptions::default();
    let result = grid_search(&x, &labels, &fold, KernelFamily::Gaussian, &grid, &options, &Unobserved).unwrap();
    assert_eq!(result.best, GridPoint { c: 1.0, gamma: Some(0.1), auc: 1.0 });
}

#[test]
fn same_bits_at_one_and_two_threads_and_with_little_memory() {
    let with_threads = |threads: usize, options: SolverOptions| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| search(KernelFamily::Gaussian, &options))
    };
    let options = SolverOptions::default();
    let reference = with_threads(1, options);
    assert_eq!(reference, with_threads(2, options));
    // groups of one gamma, then cached rows
    let one = 2 * Gram::bytes(300) + 3 * Gram::bytes(300);
    for memory_limit_bytes in [one, 100_000, 0] {
        assert_eq!(reference, with_threads(2, SolverOptions { memory_limit_bytes, ..options }));
    }
}

#[test]
fn a_fold_with_one_class_is_not_scored_but_predicted() {
    let (x, mut labels, fold) = seasons(2, 4, 40);
    labels[..40].fill(false);
    let grid = Grid { c: vec![1.0], gamma: vec![0.1] };
    let options = SolverOptions::default();
    let result = grid_search(&x, &labels, &fold, KernelFamily::Gaussian, &grid, &options, &Unobserved).unwrap();
    let of_fold = |f: usize| auc_by_pairs(&result.decision_values[40 * f..40 * (f + 1)], &labels[40 * f..40 * (f + 1)]);
    assert!((result.best.auc - (of_fold(1) + of_fold(2) + of_fold(3)) / 3.0).abs() < 1e-12);
    assert!(result.decision_values.iter().all(|v| v.is_finite()));
}

/// Cancels after some reports, and keeps what was reported.
struct Listener {
    reports: Mutex<Vec<f64>>,
    limit: usize,
    seen: AtomicUsize,
}

impl Progress for Listener {
    fn report(&self, fraction: f64, _phase: &str) {
        self.seen.fetch_add(1, Ordering::SeqCst);
        self.reports.lock().unwrap().push(fraction);
    }

    fn cancelled(&self) -> bool {
        self.seen.load(Ordering::SeqCst) >= self.limit
    }
}

#[test]
fn progress_rises_to_one_and_a_cancelled_search_ends() {
    let (x, labels, fold) = seasons(1, 5, 60);
    let run = |limit| {
        let listener = Listener { reports: Mutex::default(), limit, seen: AtomicUsize::new(0) };
        let options = SolverOptions::default();
        let result = grid_search(&x, &labels, &fold, KernelFamily::Gaussian, &small(), &options, &listener);
        (result, listener.reports.into_inner().unwrap())
    };
    let (result, reports) = run(usize::MAX);
    assert!(result.is_ok());
    assert!(reports.windows(2).all(|w| w[0] < w[1]));
    assert_eq!((reports.len(), reports.last()), (30, Some(&1.0)));
    let (result, reports) = run(4);
    assert_eq!(result, Err(GridError::Cancelled));
    assert!(reports.len() < 30);
}

#[test]
fn bad_input_is_a_typed_error() {
    let (x, labels, fold) = seasons(1, 3, 20);
    let grid = small();
    let run = |x: &Matrix, labels: &[bool], fold: &[usize], grid: &Grid, options: &SolverOptions| {
        grid_search(x, labels, fold, KernelFamily::Gaussian, grid, options, &Unobserved).unwrap_err()
    };
    let options = SolverOptions::default();
    assert!(matches!(run(&x, &labels[1..], &fold, &grid, &options), GridError::Input(_)));
    assert!(matches!(run(&x, &labels, &fold[1..], &grid, &options), GridError::Input(_)));
    assert_eq!(run(&x, &labels, &[4; 60], &grid, &options), GridError::TooFewFolds { folds: 1 });
    assert_eq!(run(&x, &labels, &fold, &Grid { c: vec![], ..small() }, &options), GridError::EmptyGrid);
    assert_eq!(run(&x, &labels, &fold, &Grid { gamma: vec![], ..small() }, &options), GridError::EmptyGrid);
    let bad = Grid { c: vec![1.0, -1.0], ..small() };
    assert_eq!(run(&x, &labels, &fold, &bad, &options), GridError::InvalidParameter { parameter: "c", value: -1.0 });
    let bad = Grid { gamma: vec![0.0], ..small() };
    assert_eq!(run(&x, &labels, &fold, &bad, &options), GridError::InvalidParameter { parameter: "gamma", value: 0.0 });
    let first_only: Vec<bool> = (0..60).map(|row| row < 20 && labels[row]).collect();
    assert_eq!(run(&x, &first_only, &fold, &grid, &options), GridError::OneClass { fold: 0 });
    let separate: Vec<bool> = (0..60).map(|row| row < 30).collect();
    let halves: Vec<usize> = (0..60).map(|row| row / 15).collect();
    assert_eq!(run(&x, &separate, &halves, &grid, &options), GridError::NothingToScore);
    // a fit that fails is named: the smallest cost of the first gamma without the first fold
    let few = SolverOptions { max_iterations: 1, ..options };
    let error = run(&x, &labels, &fold, &grid, &few);
    assert!(matches!(error, GridError::Fit { c: 0.1, gamma: Some(0.03), fold: 0, .. }), "{error}");
}

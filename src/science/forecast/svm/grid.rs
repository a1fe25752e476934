//! Cross-validated search over costs and gammas, with folds that the caller chooses (seasons).

use std::collections::BTreeSet;
use std::sync::Mutex;

use multiversion::multiversion;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::columns::Columns;
use super::gram::{Gram, PairTable, Selection};
use super::interior::solve_linear;
use super::kernel::KernelFamily;
use super::lanes;
use super::machine::check_features;
use super::rows::{CachedRows, Rows, WholeRows};
use super::smo::Dual;
use super::solver::{Cost, SolverError, SolverOptions, check_length, check_problem};
use crate::forecast::matrix::Matrix;
use crate::forecast::verification::auc;
use crate::progress::Progress;

/// The candidates: every cost with every gamma.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Grid {
    /// Costs C before class weights, > 0.
    pub c: Vec<f64>,
    /// Inverse squared widths of the Gaussian kernel, > 0; a linear kernel ignores them.
    pub gamma: Vec<f64>,
}

impl Default for Grid {
    fn default() -> Self {
        Self { c: vec![0.1, 0.3, 1.0, 3.0, 10.0, 30.0], gamma: vec![0.001, 0.003, 0.006, 0.01, 0.02, 0.03] }
    }
}

/// A candidate and its score.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GridPoint {
    /// Cost before class weights.
    pub c: f64,
    /// Inverse squared width; `None` for a linear kernel.
    pub gamma: Option<f64>,
    /// Mean over the folds of the area under the ROC curve of the held-out rows; folds with one class are left out.
    pub auc: f64,
}

/// What a search found.
#[derive(Clone, Debug, PartialEq)]
pub struct GridResult {
    /// Every candidate: costs in the order of the grid, within each the gammas in the order of the grid.
    pub points: Vec<GridPoint>,
    /// The highest AUC; among equals the smaller cost, then the smaller gamma.
    pub best: GridPoint,
    /// Decision value of every row at [`Self::best`] from the machine that was fitted without the row's fold.
    pub decision_values: Vec<f64>,
}

/// Why a search gave no result.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum GridError {
    /// No candidate.
    #[error("the grid is empty")]
    EmptyGrid,
    /// A candidate that is not finite and above 0.
    #[error("{parameter} = {value} is not a finite number above 0")]
    InvalidParameter {
        /// `c` or `gamma`.
        parameter: &'static str,
        /// Its value.
        value: f64,
    },
    /// Features, labels, folds or options that no machine can be fitted to.
    #[error(transparent)]
    Input(SolverError),
    /// Fewer than two folds.
    #[error("{folds} fold(s): at least two are needed")]
    TooFewFolds {
        /// Folds there are.
        folds: usize,
    },
    /// Outside of a fold only one class is left.
    #[error("without fold {fold} the labels hold one class only")]
    OneClass {
        /// The fold.
        fold: usize,
    },
    /// No fold holds both classes, so that there is no AUC.
    #[error("no fold holds both classes")]
    NothingToScore,
    /// A fit failed.
    #[error("C = {c}, gamma = {gamma:?}, without fold {fold}: {source}")]
    Fit {
        /// Cost before class weights.
        c: f64,
        /// Inverse squared width; `None` for a linear kernel.
        gamma: Option<f64>,
        /// The fold that was held out.
        fold: usize,
        /// What happened.
        source: SolverError,
    },
    /// The caller no longer wants the result.
    #[error("cancelled")]
    Cancelled,
}

/// Scores every candidate of `grid` on the rows of `x` (samples x features, finite and standardised).
///
/// `fold` names the fold of each row; rows ordered by fold (season) are fastest. For each fold a machine is fitted to all
/// other rows, with class weights balanced on these (see [`Cost::balanced`]), and scored on the fold, as scikit-learn's
/// `GridSearchCV` does. Along the costs each fit starts from the solution before it.
///
/// # Errors
/// [`GridError`]. It is the same whichever thread met it first, except for [`GridError::Cancelled`].
pub fn grid_search(
    x: &Matrix,
    labels: &[bool],
    fold: &[usize],
    family: KernelFamily,
    grid: &Grid,
    options: &SolverOptions,
    progress: &dyn Progress,
) -> Result<GridResult, GridError> {
    let folds = check(x, labels, fold, family, grid, options)?;
    let search =
        Search { x, folds: &folds, family, costs: &grid.c, options, steps: Steps::new(progress, family, grid, &folds) };
    let gammas = candidates(family, grid);
    let scores = search.run(&gammas)?;
    let mut points = Vec::with_capacity(grid.c.len() * gammas.len());
    for (ci, &c) in grid.c.iter().enumerate() {
        for (gi, &gamma) in gammas.iter().enumerate() {
            let auc = mean_auc(labels, &folds, &scores[gi][ci]).ok_or(GridError::NothingToScore)?;
            points.push((GridPoint { c, gamma, auc }, gi, ci));
        }
    }
    let better = |a: &GridPoint, b: &GridPoint| {
        let smaller = |p: &GridPoint| (p.c, p.gamma.unwrap_or(0.0));
        a.auc > b.auc || (a.auc == b.auc && smaller(a) < smaller(b))
    };
    let best = points.iter().copied().reduce(|best, p| if better(&p.0, &best.0) { p } else { best });
    let (best, gi, ci) = best.ok_or(GridError::EmptyGrid)?;
    let mut decision_values = vec![f64::NAN; labels.len()];
    for (part, values) in folds.iter().zip(&scores[gi][ci]) {
        for (&row, &value) in part.held_out.iter().zip(values) {
            decision_values[row] = value;
        }
    }
    Ok(GridResult { points: points.into_iter().map(|(point, _, _)| point).collect(), best, decision_values })
}

/// One split of the rows.
struct Fold {
    name: usize,
    training: Vec<usize>,
    training_labels: Vec<bool>,
    held_out: Vec<usize>,
}

fn check(
    x: &Matrix,
    labels: &[bool],
    fold: &[usize],
    family: KernelFamily,
    grid: &Grid,
    options: &SolverOptions,
) -> Result<Vec<Fold>, GridError> {
    check_length("folds", x.rows(), fold.len()).map_err(GridError::Input)?;
    check_problem(x.rows(), labels, Cost::uniform(1.0), options).map_err(GridError::Input)?;
    check_features(x).map_err(GridError::Input)?;
    let gammas: &[f64] = if family == KernelFamily::Gaussian { &grid.gamma } else { &[1.0] };
    for (parameter, values) in [("c", grid.c.as_slice()), ("gamma", gammas)] {
        if values.is_empty() {
            return Err(GridError::EmptyGrid);
        }
        if let Some(&value) = values.iter().find(|v| !(v.is_finite() && **v > 0.0)) {
            return Err(GridError::InvalidParameter { parameter, value });
        }
    }
    let names: BTreeSet<usize> = fold.iter().copied().collect();
    if names.len() < 2 {
        return Err(GridError::TooFewFolds { folds: names.len() });
    }
    names.into_iter().map(|name| split(labels, fold, name)).collect()
}

fn split(labels: &[bool], fold: &[usize], name: usize) -> Result<Fold, GridError> {
    let (held_out, training): (Vec<usize>, Vec<usize>) = (0..fold.len()).partition(|&row| fold[row] == name);
    let training_labels: Vec<bool> = training.iter().map(|&row| labels[row]).collect();
    if training_labels.iter().all(|&event| event) || !training_labels.iter().any(|&event| event) {
        return Err(GridError::OneClass { fold: name });
    }
    Ok(Fold { name, training, training_labels, held_out })
}

/// The gammas to try; a linear kernel has one candidate without any.
fn candidates(family: KernelFamily, grid: &Grid) -> Vec<Option<f64>> {
    match family {
        KernelFamily::Gaussian => grid.gamma.iter().copied().map(Some).collect(),
        KernelFamily::Linear => vec![None],
    }
}

/// Counts fits and tells the caller.
struct Steps<'a> {
    progress: &'a dyn Progress,
    done: Mutex<usize>,
    total: usize,
}

impl<'a> Steps<'a> {
    fn new(progress: &'a dyn Progress, family: KernelFamily, grid: &Grid, folds: &[Fold]) -> Self {
        Self { progress, done: Mutex::new(0), total: grid.c.len() * candidates(family, grid).len() * folds.len() }
    }

    fn advance(&self) {
        // reported under the lock, so that the fraction never falls
        let mut done = self.done.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        *done += 1;
        self.progress.report(*done as f64 / self.total as f64, "grid search");
    }
}

/// Held-out decision values by cost, fold and row of the fold.
type ByCost = Vec<Vec<Vec<f64>>>;

struct Search<'a> {
    x: &'a Matrix,
    folds: &'a [Fold],
    family: KernelFamily,
    costs: &'a [f64],
    options: &'a SolverOptions,
    steps: Steps<'a>,
}

impl Search<'_> {
    /// Decision values by gamma, cost, fold and row.
    fn run(&self, gammas: &[Option<f64>]) -> Result<Vec<ByCost>, GridError> {
        if self.family == KernelFamily::Linear {
            return Ok(vec![self.run_linear()?]);
        }
        let n = self.x.rows();
        let pairs = 2 * Gram::bytes(n);
        // besides the pairs: a Gram matrix for every gamma of a group, and a sub-matrix for every thread
        let left = self.options.memory_limit_bytes.saturating_sub(pairs);
        let group = (left / Gram::bytes(n).max(1)).saturating_sub(rayon::current_num_threads());
        let mut results = Vec::with_capacity(gammas.len());
        if group == 0 {
            for &gamma in gammas {
                results.extend(self.run_group(&[gamma], None)?);
            }
            return Ok(results);
        }
        let table = PairTable::new(self.x, self.family);
        for gammas in gammas.chunks(group) {
            let grams: Vec<Gram> = gammas.iter().map(|gamma| table.gram(gamma.unwrap_or(1.0))).collect();
            results.extend(self.run_group(gammas, Some(&grams))?);
        }
        Ok(results)
    }

    /// Every fold of every gamma of a group, each a task of its own.
    fn run_group(&self, gammas: &[Option<f64>], grams: Option<&[Gram]>) -> Result<Vec<ByCost>, GridError> {
        let tasks: Vec<(usize, usize)> =
            (0..gammas.len()).flat_map(|g| (0..self.folds.len()).map(move |f| (g, f))).collect();
        let outcomes: Vec<Result<Vec<Vec<f64>>, GridError>> = tasks
            .into_par_iter()
            .map(|(g, f)| {
                let gamma = gammas[g];
                match grams {
                    Some(grams) => self.path_in_memory(&grams[g], gamma, &self.folds[f]),
                    None => self.path_cached(gamma, &self.folds[f]),
                }
            })
            .collect();
        // the first failure in task order, so that the error does not depend on the threads
        let mut by_gamma = vec![vec![Vec::with_capacity(self.folds.len()); self.costs.len()]; gammas.len()];
        for (task, outcome) in outcomes.into_iter().enumerate() {
            for (ci, values) in outcome?.into_iter().enumerate() {
                by_gamma[task / self.folds.len()][ci].push(values);
            }
        }
        Ok(by_gamma)
    }

    /// Every fold and cost of linear machines, each a task of its own: decision values by cost, fold and row.
    fn run_linear(&self) -> Result<ByCost, GridError> {
        let parts: Vec<Columns> =
            self.folds.iter().map(|fold| Columns::of_rows(self.x, fold.training.iter().copied())).collect();
        let tasks: Vec<(usize, usize)> =
            (0..self.costs.len()).flat_map(|c| (0..self.folds.len()).map(move |f| (c, f))).collect();
        let outcomes: Vec<Result<Vec<f64>, GridError>> =
            tasks.into_par_iter().map(|(c, f)| self.linear(self.costs[c], &self.folds[f], &parts[f])).collect();
        let mut by_cost = vec![Vec::with_capacity(self.folds.len()); self.costs.len()];
        for (task, outcome) in outcomes.into_iter().enumerate() {
            by_cost[task / self.folds.len()].push(outcome?);
        }
        Ok(by_cost)
    }

    /// Decision values of the rows of a fold by the linear machine of the others, whose features are `columns`.
    fn linear(&self, c: f64, fold: &Fold, columns: &Columns) -> Result<Vec<f64>, GridError> {
        if self.steps.progress.cancelled() {
            return Err(GridError::Cancelled);
        }
        let mut dual = Dual::new(&fold.training_labels, Cost::balanced(c, &fold.training_labels));
        let stop = || self.steps.progress.cancelled();
        solve_linear(&mut dual, columns, self.options, &stop).map_err(|source| failure(c, None, fold, source))?;
        let normal = columns.combination(&dual.beta()[..fold.training.len()]);
        let rho = dual.rho();
        self.steps.advance();
        let product = |row: usize| self.x.row(row).iter().zip(&normal).fold(0.0, |sum, (x, w)| sum + x * w);
        Ok(fold.held_out.iter().map(|&row| product(row) - rho).collect())
    }

    /// One fold at every cost, on rows selected from a Gram matrix of all rows.
    fn path_in_memory(&self, gram: &Gram, gamma: Option<f64>, fold: &Fold) -> Result<Vec<Vec<f64>>, GridError> {
        if !gram.is_finite() {
            return Err(failure(self.costs[0], gamma, fold, SolverError::NotFinite));
        }
        let selection = Selection::new(&fold.training);
        let machines = self.path(&mut WholeRows::new(&gram.select(&selection)), gamma, fold)?;
        self.held_out_values(fold, &machines, |row, out| selection.gather(gram.padded_row(row), out))
    }

    /// One fold at every cost, on cached rows.
    fn path_cached(&self, gamma: Option<f64>, fold: &Fold) -> Result<Vec<Vec<f64>>, GridError> {
        let kernel = self.family.with_gamma(gamma.unwrap_or(1.0));
        let limit = self.options.memory_limit_bytes / rayon::current_num_threads().max(1);
        let mut rows = CachedRows::new(self.x, &fold.training, kernel, limit);
        let machines = self.path(&mut rows, gamma, fold)?;
        let mut pairs = vec![0.0; rows.columns().stride()];
        self.held_out_values(fold, &machines, |row, out| {
            rows.columns().kernel_row(&kernel, self.x.row(row), &mut pairs, out);
        })
    }

    /// Machines of one fold at every cost, in the order of the grid. They are fitted from the smallest cost upwards.
    fn path(&self, rows: &mut dyn Rows, gamma: Option<f64>, fold: &Fold) -> Result<Vec<Signed>, GridError> {
        let labels = &fold.training_labels;
        let mut order: Vec<usize> = (0..self.costs.len()).collect();
        order.sort_by(|&a, &b| self.costs[a].total_cmp(&self.costs[b]));
        let mut dual: Option<(Dual, f64)> = None;
        let mut machines = vec![Signed::default(); order.len()];
        for ci in order {
            let c = self.costs[ci];
            if self.steps.progress.cancelled() {
                return Err(GridError::Cancelled);
            }
            let cost = Cost::balanced(c, labels);
            let mut next = match dual.take() {
                Some((mut previous, before)) => {
                    previous.scale(cost, c / before);
                    previous
                }
                None => Dual::new(labels, cost),
            };
            let stop = || self.steps.progress.cancelled();
            next.solve(rows, self.options, &stop).map_err(|source| failure(c, gamma, fold, source))?;
            machines[ci] = Signed { beta: next.beta().to_vec(), rho: next.rho() };
            dual = Some((next, c));
            self.steps.advance();
        }
        Ok(machines)
    }

    /// Decision values by machine and held-out row; `fill` writes the kernel values of a row with the training rows.
    fn held_out_values(
        &self,
        fold: &Fold,
        machines: &[Signed],
        mut fill: impl FnMut(usize, &mut [f32]),
    ) -> Result<Vec<Vec<f64>>, GridError> {
        let mut values = vec![Vec::with_capacity(fold.held_out.len()); machines.len()];
        let mut kernel_row = vec![0.0_f32; lanes::padded(fold.training.len())];
        for &row in &fold.held_out {
            if self.steps.progress.cancelled() {
                return Err(GridError::Cancelled);
            }
            fill(row, &mut kernel_row);
            for (values, machine) in values.iter_mut().zip(machines) {
                values.push(dot(&machine.beta, &kernel_row) - machine.rho);
            }
        }
        Ok(values)
    }
}

fn failure(c: f64, gamma: Option<f64>, fold: &Fold, source: SolverError) -> GridError {
    match source {
        SolverError::Cancelled => GridError::Cancelled,
        source => GridError::Fit { c, gamma, fold: fold.name, source },
    }
}

/// A machine over the training rows of a fold: `alpha_i y_i` of each, and the threshold.
#[derive(Clone, Default)]
struct Signed {
    beta: Vec<f64>,
    rho: f64,
}

/// Sum of the products of `alpha_i y_i` and a padded kernel row.
#[multiversion(targets = "simd")]
pub(super) fn dot(beta: &[f64], row: &[f32]) -> f64 {
    lanes::dot(beta, row)
}

/// Mean over the folds with both classes; `None` without any.
fn mean_auc(labels: &[bool], folds: &[Fold], values: &[Vec<f64>]) -> Option<f64> {
    let scored: Vec<f64> = folds
        .iter()
        .zip(values)
        .filter_map(|(fold, values)| {
            let events: Vec<bool> = fold.held_out.iter().map(|&row| labels[row]).collect();
            auc(values, &events)
        })
        .collect();
    (!scored.is_empty()).then(|| scored.iter().sum::<f64>() / scored.len() as f64)
}

#[cfg(test)]
#[path = "grid_tests.rs"]
mod tests;

//! Recursive feature elimination for a Gaussian machine (Guyon, Weston, Barnhill & Vapnik 2002, Mach. Learn. 46, 389-422).
//!
//! At each step a machine is fitted, and the feature whose removal changes the objective least goes:
//! `DJ(f) = 1/2 [beta' K beta - beta' K(-f) beta]`, where `K(-f)_ij = K_ij exp(gamma (x_if - x_jf)^2)` is the kernel without
//! the feature and `beta_i = alpha_i y_i` stays as it is. The sum runs over pairs of support vectors only.
//!
//! What makes it fast changes nothing but rounding: the squared distances lose `(x_if - x_jf)^2` instead of being computed
//! anew, each fit starts from the machine before, and held-out rows are scored by the very machine that ranks the features.

use thiserror::Error;

use super::criterion::Criterion;
use super::downdate::{CrossTable, Triangle};
use super::gram::Gram;
use super::kernel::{Kernel, KernelFamily};
use super::machine::check_features;
use super::rows::WholeRows;
use super::smo::Dual;
use super::solver::{Cost, SolverError, SolverOptions, check_length, check_problem};
use crate::forecast::matrix::Matrix;
use crate::progress::Progress;

/// What is the same at every step of an elimination.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EliminationRecipe {
    /// Cost before class weights, > 0; the classes are balanced (see [`Cost::balanced`]).
    pub c: f64,
    /// Inverse squared width of the kernel, > 0.
    pub gamma: f64,
    /// Features at which to stop, 1 or more.
    pub least: usize,
}

/// The order in which features went, and how the machines along the way do on held-out rows.
#[derive(Clone, Debug, PartialEq)]
pub struct Elimination {
    /// Columns in the order of their removal.
    pub removed: Vec<usize>,
    /// |DJ| of each when it was removed, in the units of the dual objective.
    pub change: Vec<f64>,
    /// Columns that are left, rising.
    pub kept: Vec<usize>,
    /// Decision value of every held-out row: with all columns, then after each removal.
    pub decision_values: Vec<Vec<f64>>,
    /// Iterations of SMO over all fits.
    pub iterations: usize,
}

/// Why features could not be eliminated.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum EliminationError {
    /// Features, labels or options that no machine can be fitted to.
    #[error(transparent)]
    Input(SolverError),
    /// A size to stop at that is 0 or above the number of features.
    #[error("{least} feature(s) cannot be left of {features}: 1 to {features} are accepted")]
    Size {
        /// The size asked for.
        least: usize,
        /// Features there are.
        features: usize,
    },
    /// More rows than the memory limit holds pairs of.
    #[error("{rows} rows: their pairs take {bytes} bytes, more than the limit of {limit}")]
    TooManyRows {
        /// Training rows.
        rows: usize,
        /// Bytes they would take.
        bytes: usize,
        /// [`SolverOptions::memory_limit_bytes`].
        limit: usize,
    },
    /// A fit failed.
    #[error("with {features} features: {source}")]
    Fit {
        /// Features that were left.
        features: usize,
        /// What happened.
        source: SolverError,
    },
    /// The caller no longer wants the result.
    #[error("cancelled")]
    Cancelled,
}

/// Bytes that the elimination takes for so many training and held-out rows.
#[must_use]
pub const fn bytes(training: usize, held_out: usize) -> usize {
    let across = super::lanes::padded(training).saturating_mul(held_out).saturating_mul(size_of::<f64>());
    Triangle::bytes(training).saturating_add(Gram::bytes(training)).saturating_add(across)
}

/// Takes the features of `training` (rows x features, finite and standardised, one label a row) out one after the other
/// until [`EliminationRecipe::least`] are left, and scores the rows of `held_out` (any number, the same features) at every size.
///
/// Among features that change the objective equally little the last column goes. Uses the current rayon pool; the result has
/// the same bits at any number of threads.
///
/// # Errors
/// [`EliminationError`].
pub fn eliminate(
    training: &Matrix,
    labels: &[bool],
    held_out: &Matrix,
    recipe: &EliminationRecipe,
    options: &SolverOptions,
    progress: &dyn Progress,
) -> Result<Elimination, EliminationError> {
    check(training, labels, held_out, recipe, options)?;
    let mut path = Path::new(training, labels, held_out, recipe);
    if !path.table.is_finite() {
        return Err(EliminationError::Input(SolverError::NotFinite));
    }
    let features = training.cols();
    let work = |left: usize| (features * (features + 1) - left * (left + 1)) as f64;
    loop {
        path.fit(options, &|| progress.cancelled())?;
        if path.kept.len() == recipe.least {
            return Ok(path.result);
        }
        path.remove_least();
        let left = path.kept.len();
        progress.report(work(left) / work(recipe.least), &format!("{left} of {features} features"));
    }
}

fn check(
    training: &Matrix,
    labels: &[bool],
    held_out: &Matrix,
    recipe: &EliminationRecipe,
    options: &SolverOptions,
) -> Result<(), EliminationError> {
    let input = EliminationError::Input;
    check_problem(training.rows(), labels, Cost::uniform(recipe.c), options).map_err(input)?;
    if !KernelFamily::Gaussian.with_gamma(recipe.gamma).is_valid() {
        return Err(input(SolverError::InvalidGamma));
    }
    check_features(training).map_err(input)?;
    if held_out.rows() > 0 {
        check_features(held_out).map_err(input)?;
        check_length("columns of the held-out rows", training.cols(), held_out.cols()).map_err(input)?;
    }
    let features = training.cols();
    if !(1..=features).contains(&recipe.least) {
        return Err(EliminationError::Size { least: recipe.least, features });
    }
    let (bytes, limit) = (bytes(training.rows(), held_out.rows()), options.memory_limit_bytes);
    if bytes > limit {
        return Err(EliminationError::TooManyRows { rows: training.rows(), bytes, limit });
    }
    Ok(())
}

/// An elimination on its way.
struct Path<'a> {
    training: &'a Matrix,
    held_out: &'a Matrix,
    gamma: f64,
    criterion: Criterion,
    table: Triangle,
    across: CrossTable,
    gram: Gram,
    dual: Dual,
    /// The column that went last, which the held-out rows still have.
    last: Option<usize>,
    kept: Vec<usize>,
    result: Elimination,
}

impl<'a> Path<'a> {
    fn new(training: &'a Matrix, labels: &[bool], held_out: &'a Matrix, recipe: &EliminationRecipe) -> Self {
        let mut table = Triangle::new(training);
        let mut gram = Gram::empty(Kernel::Gaussian { gamma: recipe.gamma }, training.rows());
        let dual = Dual::new(labels, Cost::balanced(recipe.c, labels));
        // takes nothing out and fills the matrix as every later step does
        table.remove_feature(&vec![0.0; training.rows()], recipe.gamma, dual.beta(), &mut gram);
        Self {
            gram,
            across: CrossTable::new(held_out, training),
            criterion: Criterion::new(training, recipe.gamma),
            dual,
            last: None,
            kept: (0..training.cols()).collect(),
            result: Elimination {
                removed: Vec::new(),
                change: Vec::new(),
                kept: (0..training.cols()).collect(),
                decision_values: Vec::new(),
                iterations: 0,
            },
            gamma: recipe.gamma,
            training,
            held_out,
            table,
        }
    }

    /// Fits the machine of the features that are left, from the one before, and scores the held-out rows.
    fn fit(&mut self, options: &SolverOptions, stop: &dyn Fn() -> bool) -> Result<(), EliminationError> {
        let failed = |source| match source {
            SolverError::Cancelled => EliminationError::Cancelled,
            source => EliminationError::Fit { features: self.kept.len(), source },
        };
        if stop() {
            return Err(EliminationError::Cancelled);
        }
        let mut rows = WholeRows::new(&self.gram);
        self.result.iterations += self.dual.solve_fresh(&mut rows, options, stop).map_err(failed)?.iterations;
        let (beta, rho) = (self.dual.beta(), self.dual.rho());
        let (held_out, training) = match self.last {
            Some(column) => (self.held_out.column(column), self.training.column(column)),
            None => (vec![0.0; self.held_out.rows()], vec![0.0; self.training.rows()]),
        };
        let mut values = self.across.remove_feature(&held_out, &training, self.gamma, beta);
        values.iter_mut().for_each(|value| *value -= rho);
        self.result.decision_values.push(values);
        Ok(())
    }

    /// Takes the feature out that changes the objective least.
    fn remove_least(&mut self) {
        let changes = self.criterion.changes(&self.table, &self.gram, self.dual.beta(), &self.kept);
        let least = (0..changes.len()).fold(0, |least, k| if changes[k] <= changes[least] { k } else { least });
        let column = self.kept.remove(least);
        let values = self.training.column(column);
        let products = self.table.remove_feature(&values, self.gamma, self.dual.beta(), &mut self.gram);
        self.dual.renew(&products);
        self.last = Some(column);
        self.result.removed.push(column);
        self.result.change.push(changes[least]);
        self.result.kept.clone_from(&self.kept);
    }
}

#[cfg(test)]
#[path = "elimination_tests.rs"]
mod tests;

//! A fitted machine: support vectors, coefficients and threshold.

use serde::{Deserialize, Serialize};

use super::columns::Columns;
use super::gram::Gram;
use super::interior::solve_linear;
use super::kernel::Kernel;
use super::rows::{CachedRows, WholeRows};
use super::smo::Dual;
use super::solver::{Cost, Solution, SolverError, SolverOptions, check_length, check_problem, solve_rows};
use crate::forecast::matrix::Matrix;

/// A trained C-SVC.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Machine {
    /// Kernel with its parameter.
    pub kernel: Kernel,
    /// Support vectors: rows of standardised features, in the order of the training rows.
    pub support: Vec<Vec<f64>>,
    /// Training row of each support vector.
    pub support_index: Vec<usize>,
    /// `alpha_i y_i` of each support vector: above 0 for events, below 0 for all others.
    pub coefficient: Vec<f64>,
    /// Threshold of the decision value.
    pub rho: f64,
    /// Dual objective `1/2 a'Qa - sum a` at the solution.
    pub objective: f64,
    /// Iterations of the fit: of SMO, or of the interior point for a linear kernel.
    pub iterations: usize,
    /// m - M at the solution, computed afresh.
    pub kkt_gap: f64,
}

/// Fits a machine to the rows of `x` (samples x features, finite and standardised) with one label a row.
///
/// For a Gaussian kernel the whole Gram matrix is kept up to [`SolverOptions::memory_limit_bytes`]; beyond it the most recently
/// used rows are, as many as fit in. Both give the same bits.
///
/// # Errors
/// [`SolverError`]; [`SolverError::RowOutOfRange`] and [`SolverError::Cancelled`] never.
pub fn train(
    x: &Matrix,
    labels: &[bool],
    kernel: Kernel,
    cost: Cost,
    options: &SolverOptions,
) -> Result<Machine, SolverError> {
    train_unless(x, labels, kernel, cost, options, &|| false)
}

/// [`train`] until `stop` says so, which is asked some times a second.
///
/// # Errors
/// [`SolverError`]; [`SolverError::RowOutOfRange`] never.
pub fn train_unless(
    x: &Matrix,
    labels: &[bool],
    kernel: Kernel,
    cost: Cost,
    options: &SolverOptions,
    stop: &dyn Fn() -> bool,
) -> Result<Machine, SolverError> {
    check_problem(x.rows(), labels, cost, options)?;
    if !kernel.is_valid() {
        return Err(SolverError::InvalidGamma);
    }
    check_features(x)?;
    let solution = if kernel == Kernel::Linear {
        let mut dual = Dual::new(labels, cost);
        let effort = solve_linear(&mut dual, &Columns::of_rows(x, 0..x.rows()), options, stop)?;
        dual.solution(effort)
    } else if Gram::bytes(x.rows()) <= options.memory_limit_bytes {
        let gram = Gram::of_rows(x, kernel);
        if !gram.is_finite() {
            return Err(SolverError::NotFinite);
        }
        solve_rows(&mut WholeRows::new(&gram), labels, cost, options, None, stop)?
    } else {
        let all: Vec<usize> = (0..x.rows()).collect();
        let mut rows = CachedRows::new(x, &all, kernel, options.memory_limit_bytes);
        solve_rows(&mut rows, labels, cost, options, None, stop)?
    };
    Ok(Machine::of_solution(x, labels, kernel, &solution))
}

/// That every feature is a number.
pub(super) fn check_features(x: &Matrix) -> Result<(), SolverError> {
    for row in 0..x.rows() {
        if let Some(column) = x.row(row).iter().position(|v| !v.is_finite()) {
            return Err(SolverError::FeatureNotFinite { row, column });
        }
    }
    check_length("columns of x", x.cols().max(1), x.cols())
}

impl Machine {
    /// The machine of a solution over all rows of `x`, one label a row.
    #[must_use]
    pub fn of_solution(x: &Matrix, labels: &[bool], kernel: Kernel, solution: &Solution) -> Self {
        let alphas = || solution.alpha.iter().zip(labels).enumerate().filter(|(_, (alpha, _))| **alpha > 0.0);
        Self {
            kernel,
            support: alphas().map(|(i, _)| x.row(i).to_vec()).collect(),
            support_index: alphas().map(|(i, _)| i).collect(),
            coefficient: alphas().map(|(_, (&alpha, &event))| if event { alpha } else { -alpha }).collect(),
            rho: solution.rho,
            objective: solution.objective,
            iterations: solution.iterations,
            kkt_gap: solution.kkt_gap,
        }
    }

    /// `f(x) = sum alpha_i y_i k(x_i, x) - rho`, dimensionless, above 0 on the side of events.
    ///
    /// `x` is one row of standardised features; NaN if its length is not that of the support vectors.
    #[must_use]
    pub fn decision_value(&self, x: &[f64]) -> f64 {
        let terms = self.support.iter().zip(&self.coefficient);
        terms.fold(0.0, |sum, (support, coefficient)| sum + coefficient * self.kernel.value(support, x)) - self.rho
    }

    /// `k(x_i, x)` of every support vector, in their order; NaN if the length of `x` is not theirs.
    #[must_use]
    pub fn kernel_values(&self, x: &[f64]) -> Vec<f64> {
        self.support.iter().map(|support| self.kernel.value(support, x)).collect()
    }
}

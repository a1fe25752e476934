//! The C-SVC dual problem: costs, options, errors and the solver on a Gram matrix.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::gram::{Gram, Selection};
use super::rows::{Rows, WholeRows};
use super::smo::Dual;

/// Upper bounds of the dual variables: how much a margin violation costs in each class. Dimensionless, > 0.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cost {
    /// C+, the bound of events.
    pub positive: f64,
    /// C-, the bound of all others.
    pub negative: f64,
}

impl Cost {
    /// The same bound for both classes.
    #[must_use]
    pub const fn uniform(c: f64) -> Self {
        Self { positive: c, negative: c }
    }

    /// `c` weighted by `n / (2 n_class)`, as scikit-learn's `class_weight="balanced"`, so that both classes weigh the same.
    ///
    /// A class without a member gets an infinite bound; [`solve`] refuses such labels as [`SolverError::OneClass`].
    #[must_use]
    pub fn balanced(c: f64, labels: &[bool]) -> Self {
        let total = labels.len() as f64;
        let events = labels.iter().filter(|&&event| event).count() as f64;
        Self { positive: c * (total / (2.0 * events)), negative: c * (total / (2.0 * (total - events))) }
    }
}

/// How accurately and with how much memory a machine is fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolverOptions {
    /// Largest violation m - M of the optimality conditions (Keerthi et al. 2001) that is accepted, in units of the decision
    /// value. 1e-5: at the 1e-3 of LIBSVM decision values can still be off by 1e-2 (see the tests).
    pub epsilon: f64,
    /// Iterations after which a fit is given up.
    pub max_iterations: usize,
    /// Bytes that kernel values may take; beyond it rows are cached instead of kept.
    pub memory_limit_bytes: usize,
}

impl Default for SolverOptions {
    fn default() -> Self {
        Self { epsilon: 1e-5, max_iterations: 10_000_000, memory_limit_bytes: 1 << 30 }
    }
}

/// An optimum of the dual problem.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// Dual variables, one per entry of `rows`, between 0 and the bound of its class.
    pub alpha: Vec<f64>,
    /// Threshold: the decision value is `sum alpha_i y_i k(x_i, x) - rho`.
    pub rho: f64,
    /// `1/2 a'Qa - sum a`, which is minimised (LIBSVM's sign), on the rows in single precision that the solver works with.
    pub objective: f64,
    /// Iterations: of SMO, or of the interior point for a linear machine.
    pub iterations: usize,
    /// m - M, computed afresh at the solution: below [`SolverOptions::epsilon`].
    pub kkt_gap: f64,
}

/// Why a machine could not be fitted.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum SolverError {
    /// Two inputs that belong together differ in length.
    #[error("{what}: {found} entries instead of {expected}")]
    LengthMismatch {
        /// Which input.
        what: &'static str,
        /// Entries it should have.
        expected: usize,
        /// Entries it has.
        found: usize,
    },
    /// An index beyond the Gram matrix.
    #[error("row {row} is outside the {rows} rows of the Gram matrix")]
    RowOutOfRange {
        /// The index.
        row: usize,
        /// Rows there are.
        rows: usize,
    },
    /// Without an event or without a day that is none there is nothing to separate (also without any row).
    #[error("the labels hold one class only")]
    OneClass,
    /// A bound that is not finite and above 0.
    #[error("cost {value} is not a finite number above 0")]
    InvalidCost {
        /// The bound.
        value: f64,
    },
    /// A kernel width that is not finite and above 0.
    #[error("gamma is not a finite number above 0")]
    InvalidGamma,
    /// An option outside its range.
    #[error("epsilon {epsilon} is not a finite number above 0")]
    InvalidEpsilon {
        /// The tolerance.
        epsilon: f64,
    },
    /// A warm start that holds NaN or infinity.
    #[error("the warm start holds a value that is not finite")]
    InvalidWarmStart,
    /// A feature that is NaN or infinite.
    #[error("feature {column} of row {row} is not finite")]
    FeatureNotFinite {
        /// Row of the matrix.
        row: usize,
        /// Column of the matrix.
        column: usize,
    },
    /// A kernel value or a residual that is NaN or infinite: features or costs too large for the arithmetic.
    #[error("a kernel value or residual is not finite")]
    NotFinite,
    /// The limit of [`SolverOptions::max_iterations`].
    #[error("no optimum after {iterations} iterations (m - M = {gap:e})")]
    TooManyIterations {
        /// Iterations made.
        iterations: usize,
        /// m - M reached.
        gap: f64,
    },
    /// The conditions hold on the running residual but not on one computed afresh: `epsilon` is below what the numbers carry.
    #[error("the optimality conditions still fail on a fresh residual (m - M = {gap:e})")]
    NotConverged {
        /// m - M of the last fresh residual.
        gap: f64,
    },
    /// The caller no longer wants the result.
    #[error("cancelled")]
    Cancelled,
}

/// Fits a C-SVC to the rows of `gram` named by `rows`.
///
/// `labels` (event or not) and `warm_start` (dual variables near the solution, any finite numbers: they are made feasible)
/// have one entry per entry of `rows`. The optimum does not depend on the warm start, up to `epsilon`.
///
/// # Errors
/// [`SolverError`]; [`SolverError::Cancelled`] never.
pub fn solve(
    gram: &Gram,
    rows: &[usize],
    labels: &[bool],
    cost: Cost,
    options: &SolverOptions,
    warm_start: Option<&[f64]>,
) -> Result<Solution, SolverError> {
    if let Some(&row) = rows.iter().find(|&&row| row >= gram.rows()) {
        return Err(SolverError::RowOutOfRange { row, rows: gram.rows() });
    }
    if !gram.kernel().is_valid() {
        return Err(SolverError::InvalidGamma);
    }
    if !gram.is_finite() {
        return Err(SolverError::NotFinite);
    }
    check_problem(rows.len(), labels, cost, options)?;
    let is_whole = rows.len() == gram.rows() && rows.iter().enumerate().all(|(position, &row)| position == row);
    if is_whole {
        return solve_rows(&mut WholeRows::new(gram), labels, cost, options, warm_start, &|| false);
    }
    let selected = gram.select(&Selection::new(rows));
    solve_rows(&mut WholeRows::new(&selected), labels, cost, options, warm_start, &|| false)
}

/// [`solve`] on any source of rows, once the inputs are known to be sound.
pub(super) fn solve_rows(
    rows: &mut dyn Rows,
    labels: &[bool],
    cost: Cost,
    options: &SolverOptions,
    warm_start: Option<&[f64]>,
    stop: &dyn Fn() -> bool,
) -> Result<Solution, SolverError> {
    let mut dual = Dual::new(labels, cost);
    if let Some(alpha) = warm_start {
        check_length("warm start", labels.len(), alpha.len())?;
        if !alpha.iter().all(|a| a.is_finite()) {
            return Err(SolverError::InvalidWarmStart);
        }
        dual.start_from(alpha, rows);
    }
    let effort = dual.solve(rows, options, stop)?;
    Ok(dual.solution(effort))
}

/// What a problem must fulfil whatever its rows come from.
pub(super) fn check_problem(
    rows: usize,
    labels: &[bool],
    cost: Cost,
    options: &SolverOptions,
) -> Result<(), SolverError> {
    check_length("labels", rows, labels.len())?;
    if labels.iter().all(|&event| event) || !labels.iter().any(|&event| event) {
        return Err(SolverError::OneClass);
    }
    for value in [cost.positive, cost.negative] {
        if !(value.is_finite() && value > 0.0) {
            return Err(SolverError::InvalidCost { value });
        }
    }
    if !(options.epsilon.is_finite() && options.epsilon > 0.0) {
        return Err(SolverError::InvalidEpsilon { epsilon: options.epsilon });
    }
    Ok(())
}

/// That an input has the length it must have.
pub(super) const fn check_length(what: &'static str, expected: usize, found: usize) -> Result<(), SolverError> {
    if found == expected { Ok(()) } else { Err(SolverError::LengthMismatch { what, expected, found }) }
}

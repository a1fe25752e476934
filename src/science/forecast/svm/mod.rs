//! Exact support vector classification (C-SVC) with class weights, for a Gaussian or a linear kernel.
//!
//! The dual problem, written for signed variables `beta_i = y_i alpha_i` (`y_i` is +1 for an event and -1 otherwise):
//! maximise `sum y_i beta_i - 1/2 beta' K beta` with `sum beta_i = 0`, `0 <= beta_i <= C+` for events and
//! `-C- <= beta_i <= 0` for the others. [`solver`] solves it by sequential minimal optimisation (SMO) with the second-order
//! working set of Fan, Chen & Lin (2005, J. Mach. Learn. Res. 6, 1889-1918), which is what LIBSVM does too; `interior`
//! solves it for a linear kernel, where SMO gets slow.
//!
//! Data flow: rows of standardised features -> [`gram::PairTable`] (once a feature set) -> [`gram::Gram`] (once a gamma) ->
//! [`solver::solve`] (once a cost and fold) -> [`machine::Machine`] -> [`calibration::Platt`]. [`grid`] runs that chain over
//! costs, gammas and folds; [`elimination`] takes one feature after the other out.
//!
//! Every sum runs in an order that depends neither on the number of threads nor on the instruction set, so the same input
//! gives the same bits everywhere.

pub mod attribution;
pub mod calibration;
mod columns;
mod criterion;
mod downdate;
pub mod elimination;
pub mod gram;
pub mod grid;
mod interior;
pub mod kernel;
mod lanes;
pub mod machine;
mod rows;
mod smo;
pub mod solver;

pub use attribution::Attribution;
pub use calibration::{CalibrationError, Platt, fit_platt};
pub use elimination::{Elimination, EliminationError, EliminationRecipe, eliminate};
pub use gram::{Gram, PairTable};
pub use grid::{Grid, GridError, GridPoint, GridResult, grid_search};
pub use kernel::{Kernel, KernelFamily};
pub use machine::{Machine, train, train_unless};
pub use solver::{Cost, Solution, SolverError, SolverOptions, solve};

#[cfg(test)]
mod oracle_tests;
#[cfg(test)]
mod problems;

//! Logistic regression with a ridge penalty.

use nalgebra::{Cholesky, DMatrix, DVector};
use thiserror::Error;

use super::matrix::Matrix;

/// `P(event | x) = 1 / (1 + exp(-(intercept + weights . x)))`.
#[derive(Clone, Debug, PartialEq)]
pub struct Logistic {
    /// Log odds at the centre of the training rows.
    pub intercept: f64,
    /// Change of the log odds by one standard deviation of each feature.
    pub weights: Vec<f64>,
}

/// Why no regression could be fitted.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum LogisticError {
    /// Not one label a row.
    #[error("{labels} labels for {rows} rows")]
    LengthMismatch {
        /// Rows given.
        rows: usize,
        /// Labels given.
        labels: usize,
    },
    /// A penalty that is not finite and above 0.
    #[error("the ridge penalty is {0}: a finite number above 0 is accepted")]
    Penalty(f64),
    /// The intercept of a single class is infinite.
    #[error("the labels hold one class only")]
    OneClass,
    /// Features that are not finite, or so large that the likelihood cannot be maximised.
    #[error("no maximum of the likelihood: are the features standardised?")]
    NotConverged,
}

const MAX_ITERATIONS: usize = 100;
/// Squared Newton decrement (twice the log likelihood still to gain) at which a fit ends, and the share of the likelihood
/// that rounding may hide.
const TOLERANCE: f64 = 1e-12;
/// A step shorter than this is none.
const MIN_STEP: f64 = 1e-10;

impl Logistic {
    /// Probability of the event for one row of standardised features; features beyond the fitted ones are ignored.
    #[must_use]
    pub fn probability(&self, x: &[f64]) -> f64 {
        sigmoid(self.log_odds(x))
    }

    fn log_odds(&self, x: &[f64]) -> f64 {
        self.intercept + self.weights.iter().zip(x).map(|(w, x)| w * x).sum::<f64>()
    }
}

/// Minimises `sum -ln P(label | x) + penalty / 2 |weights|^2` over intercept and weights; the intercept is not penalised.
///
/// `x` is samples x standardised features with one label a row. With `penalty = 1 / C` it is what scikit-learn's
/// `LogisticRegression(C)` minimises. Newton's method (iteratively reweighted least squares) with backtracking; the problem is
/// strictly convex, so `start`, a guess such as the fit to another penalty, changes the work and not the result.
///
/// # Errors
/// [`LogisticError`].
pub fn fit(x: &Matrix, event: &[bool], penalty: f64, start: Option<&Logistic>) -> Result<Logistic, LogisticError> {
    if x.rows() != event.len() {
        return Err(LogisticError::LengthMismatch { rows: x.rows(), labels: event.len() });
    }
    if !(penalty.is_finite() && penalty > 0.0) {
        return Err(LogisticError::Penalty(penalty));
    }
    let events = event.iter().filter(|&&o| o).count() as f64;
    let others = event.len() as f64 - events;
    if events == 0.0 || others == 0.0 {
        return Err(LogisticError::OneClass);
    }
    let problem = Problem { x, event, penalty };
    let base_rate = || Logistic { intercept: (events / others).ln(), weights: vec![0.0; x.cols()] };
    let mut fit = start.filter(|s| s.weights.len() == x.cols()).cloned().unwrap_or_else(base_rate);
    let mut loss = problem.loss(&fit);
    for _ in 0..MAX_ITERATIONS {
        let (gradient, hessian) = problem.slope(&fit);
        let step = Cholesky::new(hessian).ok_or(LogisticError::NotConverged)?.solve(&gradient);
        let decrement = gradient.dot(&step);
        if !decrement.is_finite() {
            return Err(LogisticError::NotConverged);
        }
        if decrement <= TOLERANCE * (1.0 + loss) {
            return Ok(fit.minus(&step, 1.0));
        }
        (fit, loss) = problem.descend(&fit, loss, &step, decrement).ok_or(LogisticError::NotConverged)?;
    }
    Err(LogisticError::NotConverged)
}

impl Logistic {
    /// The coefficients after `length` times a Newton step, whose first entry is that of the intercept.
    fn minus(&self, step: &DVector<f64>, length: f64) -> Self {
        let weights = self.weights.iter().zip(step.iter().skip(1)).map(|(w, s)| w - length * s).collect();
        Self { intercept: self.intercept - length * step[0], weights }
    }
}

struct Problem<'a> {
    x: &'a Matrix,
    event: &'a [bool],
    penalty: f64,
}

impl Problem<'_> {
    fn loss(&self, fit: &Logistic) -> f64 {
        let misfit: f64 = (0..self.x.rows()).map(|i| softplus(self.margin(fit, i))).sum();
        misfit + 0.5 * self.penalty * fit.weights.iter().map(|w| w * w).sum::<f64>()
    }

    /// Log odds against the label of row `i`.
    fn margin(&self, fit: &Logistic, i: usize) -> f64 {
        let z = fit.log_odds(self.x.row(i));
        if self.event[i] { -z } else { z }
    }

    /// Halves the step until the loss falls sufficiently (Armijo); `None` where it never does.
    fn descend(&self, fit: &Logistic, loss: f64, step: &DVector<f64>, decrement: f64) -> Option<(Logistic, f64)> {
        let mut length = 1.0;
        while length >= MIN_STEP {
            let next = fit.minus(step, length);
            let next_loss = self.loss(&next);
            if next_loss <= loss - 1e-4 * length * decrement {
                return Some((next, next_loss));
            }
            length /= 2.0;
        }
        None
    }

    /// Gradient and Hessian of the loss; entry 0 is the intercept.
    fn slope(&self, fit: &Logistic) -> (DVector<f64>, DMatrix<f64>) {
        let n = self.x.cols() + 1;
        let mut gradient = DVector::zeros(n);
        let mut hessian = DMatrix::zeros(n, n);
        // four rows at a time: the Hessian is then read and written a quarter as often
        let mut rows = [const { Vec::new() }; 4];
        let mut weights = [0.0; 4];
        for from in (0..self.x.rows()).step_by(4) {
            for (lane, (row, weight)) in rows.iter_mut().zip(&mut weights).enumerate() {
                row.clear();
                *weight = 0.0;
                let i = from + lane;
                if i >= self.x.rows() {
                    row.resize(n, 0.0);
                    continue;
                }
                row.push(1.0);
                row.extend_from_slice(self.x.row(i));
                let p = fit.probability(self.x.row(i));
                let residual = p - f64::from(u8::from(self.event[i]));
                *weight = p * (1.0 - p);
                gradient.iter_mut().zip(&*row).for_each(|(g, x)| *g += residual * x);
            }
            add_squares(&mut hessian, &rows, weights);
        }
        for j in 1..n {
            gradient[j] += self.penalty * fit.weights[j - 1];
            hessian[(j, j)] += self.penalty;
        }
        // add_squares fills what Cholesky reads: the lower triangle
        (gradient, hessian)
    }
}

/// Adds `sum_k weight_k row_k row_k'` to the lower triangle.
fn add_squares(hessian: &mut DMatrix<f64>, rows: &[Vec<f64>; 4], weights: [f64; 4]) {
    let n = hessian.nrows();
    let [a, b, c, d] = rows;
    for (j, column) in hessian.as_mut_slice().chunks_exact_mut(n).enumerate() {
        let [p, q, r, s] = [weights[0] * a[j], weights[1] * b[j], weights[2] * c[j], weights[3] * d[j]];
        let below = column[j..].iter_mut().zip(&a[j..]).zip(&b[j..]).zip(&c[j..]).zip(&d[j..]);
        for ((((h, a), b), c), d) in below {
            *h += p * a + q * b + r * c + s * d;
        }
    }
}

/// `ln(1 + e^z)` without overflow.
fn softplus(z: f64) -> f64 {
    z.max(0.0) + (-z.abs()).exp().ln_1p()
}

fn sigmoid(z: f64) -> f64 {
    let e = (-z.abs()).exp();
    if z >= 0.0 { 1.0 / (1.0 + e) } else { e / (1.0 + e) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forecast::problems::waves;

    /// `LogisticRegression(C=C, solver="newton-cholesky", tol=1e-12)` of scikit-learn 1.9.1 on [`waves`]: C, intercept, weights.
    const SCIKIT_LEARN: [(f64, f64, [f64; 4]); 3] = [
        (
            1.0,
            -0.775_898_757_123_748_9,
            [2.603_062_843_086_315, -1.407_977_315_752_856_3, -0.535_647_839_342_749_7, -0.067_576_157_055_530_12],
        ),
        (
            0.05,
            -0.425_821_601_058_033_8,
            [0.563_405_042_051_493, -0.254_170_914_232_881_1, -0.095_834_368_975_367_97, -0.037_582_947_364_477_99],
        ),
        (
            20.0,
            -1.855_420_787_805_850_4,
            [5.992_767_624_990_001, -3.892_556_477_264_158_8, -1.572_162_202_266_073_3, 0.072_573_292_239_328_07],
        ),
    ];

    #[test]
    fn coefficients_are_those_of_scikit_learn() {
        let (x, event) = waves();
        let far_start = Logistic { intercept: 5.0, weights: vec![-4.0, 4.0, 4.0, -4.0] };
        for (c, intercept, weights) in SCIKIT_LEARN {
            for start in [None, Some(&far_start)] {
                let fit = fit(&x, &event, 1.0 / c, start).unwrap();
                assert!((fit.intercept - intercept).abs() < 1e-6, "C = {c}: {fit:?}");
                for (ours, theirs) in fit.weights.iter().zip(weights) {
                    assert!((ours - theirs).abs() < 1e-6, "C = {c}: {fit:?}");
                }
            }
        }
    }

    /// Without a ridge separable classes have no finite maximum; with it the gradient vanishes at the fit.
    #[test]
    fn separable_classes_are_fitted() {
        let x = Matrix::from_rows(5, 1, vec![-2.0, -1.0, 0.5, 1.0, 3.0]).unwrap();
        let event = [false, false, true, true, true];
        let fit = fit(&x, &event, 1e-3, None).unwrap();
        let residual = |i: usize| fit.probability(x.row(i)) - f64::from(u8::from(event[i]));
        let slope: f64 = (0..5).map(|i| residual(i) * x.row(i)[0]).sum::<f64>() + 1e-3 * fit.weights[0];
        assert!((0..5).map(residual).sum::<f64>().abs() < 1e-9 && slope.abs() < 1e-9, "{fit:?}");
        assert!(fit.weights[0] > 5.0);
    }

    #[test]
    fn what_cannot_be_fitted_is_an_error() {
        let x = Matrix::from_rows(2, 1, vec![0.0, 1.0]).unwrap();
        assert_eq!(fit(&x, &[true], 1.0, None), Err(LogisticError::LengthMismatch { rows: 2, labels: 1 }));
        assert_eq!(fit(&x, &[true, true], 1.0, None), Err(LogisticError::OneClass));
        assert_eq!(fit(&x, &[true, false], 0.0, None), Err(LogisticError::Penalty(0.0)));
        let broken = Matrix::from_rows(2, 1, vec![f64::NAN, 1.0]).unwrap();
        assert_eq!(fit(&broken, &[true, false], 1.0, None), Err(LogisticError::NotConverged));
    }

    #[test]
    fn without_a_feature_the_base_rate_remains() {
        let fit = fit(&Matrix::filled(4, 0, 0.0), &[true, false, false, false], 1.0, None).unwrap();
        assert!((fit.probability(&[]) - 0.25).abs() < 1e-12);
    }
}

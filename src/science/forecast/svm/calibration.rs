//! Probabilities from decision values: Platt's sigmoid, fitted after Lin, Lin & Weng (2007, Mach. Learn. 68, 267-276).

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The sigmoid `P(event | f) = 1 / (1 + exp(a f + b))`; `a` is below 0 where larger decision values mean more events.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Platt {
    /// Slope, 1 / (unit of decision value).
    pub a: f64,
    /// Offset, dimensionless.
    pub b: f64,
}

/// Why no sigmoid could be fitted.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum CalibrationError {
    /// Not one label a decision value.
    #[error("{labels} labels for {decision_values} decision values")]
    LengthMismatch {
        /// Decision values given.
        decision_values: usize,
        /// Labels given.
        labels: usize,
    },
    /// Without an event or without a day that is none there is nothing to fit (also without any value).
    #[error("the labels hold one class only")]
    OneClass,
    /// A decision value that is NaN or infinite.
    #[error("decision value {index} is not finite")]
    NotFinite {
        /// Position of the value.
        index: usize,
    },
    /// The likelihood could not be brought to its maximum.
    #[error("no maximum of the likelihood (gradient {gradient:e})")]
    NotConverged {
        /// Largest component of the gradient that was left.
        gradient: f64,
    },
}

const MAX_ITERATIONS: usize = 100;
/// Least step of the line search.
const MIN_STEP: f64 = 1e-10;
/// Added to the diagonal of the Hessian, which may be singular (all decision values equal).
const RIDGE: f64 = 1e-12;
/// Largest component of the gradient at the maximum.
const TOLERANCE: f64 = 1e-5;

impl Platt {
    /// The probability of an event at that decision value, in [0, 1]; without overflow for any finite value.
    #[must_use]
    pub fn probability(&self, decision_value: f64) -> f64 {
        let z = self.a * decision_value + self.b;
        if z >= 0.0 {
            let e = (-z).exp();
            e / (1.0 + e)
        } else {
            1.0 / (1.0 + z.exp())
        }
    }
}

/// Fits the sigmoid to decision values that the machine did not train on, one label each.
///
/// Regularised targets (N+ + 1) / (N+ + 2) and 1 / (N- + 2); Newton's method with backtracking (Lin, Lin & Weng 2007).
///
/// # Errors
/// [`CalibrationError`].
pub fn fit_platt(decision: &[f64], labels: &[bool]) -> Result<Platt, CalibrationError> {
    if decision.len() != labels.len() {
        return Err(CalibrationError::LengthMismatch { decision_values: decision.len(), labels: labels.len() });
    }
    if let Some(index) = decision.iter().position(|f| !f.is_finite()) {
        return Err(CalibrationError::NotFinite { index });
    }
    let events = labels.iter().filter(|&&event| event).count() as f64;
    let others = labels.len() as f64 - events;
    if events == 0.0 || others == 0.0 {
        return Err(CalibrationError::OneClass);
    }
    let likelihood = Likelihood { decision, labels, high: (events + 1.0) / (events + 2.0), low: 1.0 / (others + 2.0) };
    maximise(&likelihood, Platt { a: 0.0, b: ((others + 1.0) / (events + 1.0)).ln() })
}

fn maximise(likelihood: &Likelihood<'_>, start: Platt) -> Result<Platt, CalibrationError> {
    let mut platt = start;
    let mut loss = likelihood.loss(platt);
    for _ in 0..MAX_ITERATIONS {
        let slope = likelihood.slope(platt);
        if slope.is_flat() {
            return Ok(platt);
        }
        let determinant = slope.aa * slope.bb - slope.ab * slope.ab;
        let da = -(slope.bb * slope.a - slope.ab * slope.b) / determinant;
        let db = -(slope.aa * slope.b - slope.ab * slope.a) / determinant;
        let descent = slope.a * da + slope.b * db;
        let mut step = 1.0;
        loop {
            let next = Platt { a: platt.a + step * da, b: platt.b + step * db };
            let next_loss = likelihood.loss(next);
            // sufficient decrease (Armijo)
            if next_loss < loss + 1e-4 * step * descent {
                (platt, loss) = (next, next_loss);
                break;
            }
            step /= 2.0;
            if step < MIN_STEP {
                // what is left is rounding: the loss no longer falls along a descent direction
                return slope.accept_if_small(platt);
            }
        }
    }
    likelihood.slope(platt).accept_if_small(platt)
}

/// Negative log likelihood of a sigmoid.
struct Likelihood<'a> {
    decision: &'a [f64],
    labels: &'a [bool],
    high: f64,
    low: f64,
}

/// Gradient and Hessian of the negative log likelihood.
struct Slope {
    a: f64,
    b: f64,
    aa: f64,
    ab: f64,
    bb: f64,
}

impl Slope {
    fn largest(&self) -> f64 {
        self.a.abs().max(self.b.abs())
    }

    fn is_flat(&self) -> bool {
        self.largest() < TOLERANCE
    }

    /// A failed line search is fine where rounding hides the rest of the way: relative to the curvature, not absolutely.
    fn accept_if_small(&self, platt: Platt) -> Result<Platt, CalibrationError> {
        let scale = 1.0 + self.aa.abs().max(self.bb.abs());
        if self.largest() < 1e-3 * scale {
            Ok(platt)
        } else {
            Err(CalibrationError::NotConverged { gradient: self.largest() })
        }
    }
}

impl Likelihood<'_> {
    fn targets(&self) -> impl Iterator<Item = (f64, f64)> {
        self.decision.iter().zip(self.labels).map(|(&f, &event)| (f, if event { self.high } else { self.low }))
    }

    /// `sum -(t ln p + (1 - t) ln(1 - p))`, in the form of Lin, Lin & Weng (2007) that cannot overflow.
    fn loss(&self, platt: Platt) -> f64 {
        self.targets().fold(0.0, |sum, (f, t)| {
            let z = platt.a * f + platt.b;
            sum + if z >= 0.0 { t * z + (-z).exp().ln_1p() } else { (t - 1.0) * z + z.exp().ln_1p() }
        })
    }

    fn slope(&self, platt: Platt) -> Slope {
        let mut slope = Slope { a: 0.0, b: 0.0, aa: RIDGE, ab: 0.0, bb: RIDGE };
        for (f, t) in self.targets() {
            let p = platt.probability(f);
            let (weight, misfit) = (p * (1.0 - p), t - p);
            slope.aa += f * f * weight;
            slope.bb += weight;
            slope.ab += f * weight;
            slope.a += f * misfit;
            slope.b += misfit;
        }
        slope
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forecast::svm::problems::decisions;

    /// The root of the gradient found by SciPy 1.17.1 (`optimize.root` after BFGS on the same likelihood).
    #[test]
    fn agrees_with_scipy() {
        let decision = [-2.0, -1.5, -1.0, -0.25, 0.0, 0.5, 0.75, 1.25, 2.0, 3.0];
        let labels = [false, false, false, true, false, false, true, true, true, true];
        let platt = fit_platt(&decision, &labels).unwrap();
        // the method stops at a gradient of 1e-5
        assert!((platt.a - -0.898_960_375_856).abs() < 1e-5, "{platt:?}");
        assert!((platt.b - 0.222_031_238_834).abs() < 1e-5, "{platt:?}");
    }

    #[test]
    fn agrees_with_libsvm() {
        for seed in 0..200 {
            let (decision, labels) = decisions(seed);
            let signs: Vec<f64> = labels.iter().map(|&event| if event { 1.0 } else { -1.0 }).collect();
            let (a, b) = libsvm_rs::probability::sigmoid_train(&decision, &signs);
            let platt = fit_platt(&decision, &labels).unwrap();
            let theirs = Platt { a, b };
            for &f in &decision {
                let difference = (platt.probability(f) - theirs.probability(f)).abs();
                assert!(difference < 1e-6, "seed {seed}: {platt:?} {theirs:?} at {f}");
            }
        }
    }

    #[test]
    fn probability_never_overflows() {
        let platt = Platt { a: -3.0, b: 0.5 };
        assert_eq!(platt.probability(-1e300), 0.0);
        assert_eq!(platt.probability(1e300), 1.0);
        assert!((platt.probability(0.5) - 1.0 / (1.0 + (-1.0_f64).exp())).abs() < 1e-15);
    }

    #[test]
    fn equal_decision_values_give_the_base_rate() {
        let labels = [true, false, false, false, true, false];
        let platt = fit_platt(&[0.7; 6], &labels).unwrap();
        // mean of the regularised targets: (2 * 3/4 + 4 * 1/6) / 6
        assert!((platt.probability(0.7) - (1.5 + 4.0 / 6.0) / 6.0).abs() < 1e-6);
    }

    #[test]
    fn bad_input_is_an_error() {
        assert_eq!(fit_platt(&[], &[]), Err(CalibrationError::OneClass));
        assert_eq!(fit_platt(&[1.0, 2.0], &[true, true]), Err(CalibrationError::OneClass));
        assert_eq!(fit_platt(&[1.0, f64::NAN], &[true, false]), Err(CalibrationError::NotFinite { index: 1 }));
        assert_eq!(
            fit_platt(&[1.0], &[true, false]),
            Err(CalibrationError::LengthMismatch { decision_values: 1, labels: 2 })
        );
        // squares overflow: refused or fitted, but neither NaN nor a panic
        if let Ok(platt) = fit_platt(&[1e200, -1e200], &[true, false]) {
            assert!(platt.a.is_finite() && platt.b.is_finite());
        }
    }
}

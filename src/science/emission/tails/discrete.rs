//! The power law of whole numbers, such as counts.

use crate::emission::error::EmissionError;
use crate::emission::numerics::root;
use crate::emission::special::hurwitz_zeta;
use crate::emission::tails::Parameter;

/// A fitted discrete power law `P(x) = x^-alpha / zeta(alpha, xmin)`.
#[derive(Clone, Debug, PartialEq)]
pub struct DiscreteFit {
    /// Exponent, with its standard error from the observed information.
    pub alpha: Parameter,
    /// Smallest whole number in the fit.
    pub xmin: u64,
    /// Values in the fit.
    pub n_tail: usize,
    /// Log likelihood.
    pub loglik: f64,
}

/// Largest exponent that is searched.
const LARGEST_ALPHA: f64 = 60.0;

/// Maximum likelihood of the discrete power law on the `values` of at least `xmin` (Clauset, Shalizi & Newman 2009, eqs
/// 3.5 and 3.6): -zeta'(alpha, xmin)/zeta = mean ln x, standard error 1/sqrt(n [zeta''/zeta - (zeta'/zeta)^2]).
///
/// # Errors
/// xmin = 0, fewer than three values, or none above xmin.
pub fn fit(values: &[u64], xmin: u64) -> Result<DiscreteFit, EmissionError> {
    if xmin == 0 {
        return Err(EmissionError::option("xmin", xmin, "a whole number of at least 1"));
    }
    let logs: Vec<f64> = values.iter().filter(|&&x| x >= xmin).map(|&x| (x as f64).ln()).collect();
    if logs.len() < 3 {
        return Err(EmissionError::TooFewEvents { what: "a discrete power law", found: logs.len(), needed: 3 });
    }
    let a = xmin as f64;
    let n = logs.len() as f64;
    let mean = logs.iter().sum::<f64>() / n;
    let score = |alpha: f64| {
        let [zeta, first, _] = hurwitz_zeta(alpha, a);
        -first / zeta - mean
    };
    let alpha = root(score, 1.0 + 1e-6, LARGEST_ALPHA).ok_or(EmissionError::Degenerate { what: "the tail" })?;
    let [zeta, first, second] = hurwitz_zeta(alpha, a);
    let se = 1.0 / (n * (second / zeta - (first / zeta).powi(2))).sqrt();
    Ok(DiscreteFit {
        alpha: Parameter::normal("alpha", alpha, se),
        xmin,
        n_tail: logs.len(),
        loglik: -n * zeta.ln() - alpha * n * mean,
    })
}

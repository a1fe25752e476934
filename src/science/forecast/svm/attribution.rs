//! What each feature adds to a decision value: integrated gradients (Sundararajan, Taly & Yan 2017, ICML, eq. 1), in closed form.
//!
//! Along the straight way from the origin (every standardised feature at its training mean) to the row, the decision value
//! changes by `sum_j x_j integral_0^1 df/dx_j(t x) dt`. Each term is what feature `j` adds, and the terms add up to `f(x) - f(0)`
//! exactly. For a linear kernel a term is `w_j x_j`. For a Gaussian one the integrals are of a Gaussian along a line,
//! `exp(-gamma (a t^2 - 2 b t + d))` with `a = |x|^2`, `b = x . s`, `d = |s|^2`, and have the error function as antiderivative.

use super::kernel::Kernel;
use super::machine::Machine;

/// The decision value of a row, taken apart.
#[derive(Clone, Debug, PartialEq)]
pub struct Attribution {
    /// Decision value at the origin.
    pub base: f64,
    /// What each feature adds to it; with the base they add up to the decision value.
    pub contributions: Vec<f64>,
}

impl Machine {
    /// Takes the decision value of `x`, one row of standardised features, apart. NaN where its length is not that of the
    /// support vectors.
    #[must_use]
    pub fn attribution(&self, x: &[f64]) -> Attribution {
        let origin = vec![0.0; x.len()];
        let mut contributions = vec![0.0; x.len()];
        for (support, coefficient) in self.support.iter().zip(&self.coefficient) {
            if support.len() != x.len() {
                return Attribution { base: f64::NAN, contributions: vec![f64::NAN; x.len()] };
            }
            match self.kernel {
                Kernel::Linear => {
                    for ((sum, x), s) in contributions.iter_mut().zip(x).zip(support) {
                        *sum += coefficient * x * s;
                    }
                }
                Kernel::Gaussian { gamma } => {
                    let (zeroth, first) = moments(gamma, x, support);
                    for ((sum, x), s) in contributions.iter_mut().zip(x).zip(support) {
                        *sum += coefficient * -2.0 * gamma * x * (x * first - s * zeroth);
                    }
                }
            }
        }
        Attribution { base: self.decision_value(&origin), contributions }
    }
}

/// Below this `gamma |x|^2` the antiderivative loses digits, and five nodes are exact to rounding.
const SHORT: f64 = 1e-3;

/// The integrals of `exp(-gamma |t x - s|^2)` and of `t` times that over t from 0 to 1.
fn moments(gamma: f64, x: &[f64], s: &[f64]) -> (f64, f64) {
    let (a, b, d) = x.iter().zip(s).fold((0.0, 0.0, 0.0), |(a, b, d), (x, s)| (a + x * x, b + x * s, d + s * s));
    let value = |t: f64| (-gamma * (a * t * t - 2.0 * b * t + d)).exp();
    if gamma * a < SHORT {
        let (mut zeroth, mut first) = (0.0, 0.0);
        for (t, weight) in GAUSS_LEGENDRE {
            zeroth += weight * value(t);
            first += weight * t * value(t);
        }
        return (zeroth, first);
    }
    let (root, nearest) = ((gamma * a).sqrt(), b / a);
    // the error function between the ends of the way, seen from its point nearest to s
    let between = error_function_between(-root * nearest, root * (1.0 - nearest));
    let least_distance = (d - b * nearest).max(0.0);
    let zeroth = (-gamma * least_distance).exp() * between * std::f64::consts::PI.sqrt() / (2.0 * root);
    let first = (value(0.0) - value(1.0)) / (2.0 * gamma * a) + nearest * zeroth;
    (zeroth, first)
}

/// `erf(to) - erf(from)` without cancellation in the tails.
fn error_function_between(from: f64, to: f64) -> f64 {
    if from > 0.0 {
        libm::erfc(from) - libm::erfc(to)
    } else if to < 0.0 {
        libm::erfc(-to) - libm::erfc(-from)
    } else {
        libm::erf(to) - libm::erf(from)
    }
}

/// Nodes and weights of five-point Gauss-Legendre quadrature on 0 to 1.
const GAUSS_LEGENDRE: [(f64, f64); 5] = [
    (0.046_910_077_030_668, 0.118_463_442_528_094_54),
    (0.230_765_344_947_158_45, 0.239_314_335_249_683_24),
    (0.5, 0.284_444_444_444_444_44),
    (0.769_234_655_052_841_5, 0.239_314_335_249_683_24),
    (0.953_089_922_969_332, 0.118_463_442_528_094_54),
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forecast::svm::problems::problem;
    use crate::forecast::svm::{SolverOptions, train};

    /// Simpson's rule with 20,000 steps on the derivative, which is taken by differences: nothing of the closed form.
    fn by_quadrature(machine: &Machine, x: &[f64], j: usize) -> f64 {
        const STEPS: usize = 20_000;
        let slope = |t: f64| {
            let mut point: Vec<f64> = x.iter().map(|x| t * x).collect();
            let at = point[j];
            point[j] = at + 1e-4;
            let above = machine.decision_value(&point);
            point[j] = at - 1e-4;
            (above - machine.decision_value(&point)) / 2e-4
        };
        let weight = |k: usize| match k {
            0 | STEPS => 1.0,
            k if k % 2 == 1 => 4.0,
            _ => 2.0,
        };
        let sum: f64 = (0..=STEPS).map(|k| weight(k) * slope(k as f64 / STEPS as f64)).sum();
        x[j] * sum / (3.0 * STEPS as f64)
    }

    #[test]
    fn contributions_add_up_to_the_decision_value() {
        for seed in 0..40 {
            let p = problem(seed);
            let machine = train(&p.x, &p.labels, p.kernel, p.cost, &SolverOptions::default()).unwrap();
            let rows = (0..p.x.rows().min(12)).map(|i| p.x.row(i).to_vec());
            // near the origin, and far outside of the training range
            let stretched = [1e-6, 1e-2, 30.0, 1e6].map(|scale| p.x.row(1).iter().map(|x| scale * x).collect());
            for x in rows.chain(stretched).chain([vec![0.0; p.x.cols()]]) {
                let found = machine.attribution(&x);
                let sum = found.base + found.contributions.iter().sum::<f64>();
                // the terms of the decision value, whose rounding the sum has too
                let term = |(s, c): (&Vec<f64>, &f64)| match machine.kernel {
                    Kernel::Linear => c.abs() * s.iter().zip(&x).map(|(s, x)| (s * x).abs()).sum::<f64>(),
                    Kernel::Gaussian { .. } => c.abs(),
                };
                let size: f64 = machine.support.iter().zip(&machine.coefficient).map(term).sum();
                assert!((sum - machine.decision_value(&x)).abs() < 1e-12 * size.max(1.0), "{}: {x:?}", p.name);
            }
        }
    }

    #[test]
    fn contributions_are_those_of_a_quadrature() {
        for seed in [0, 1, 5, 8] {
            let p = problem(seed);
            let machine = train(&p.x, &p.labels, p.kernel, p.cost, &SolverOptions::default()).unwrap();
            let found = machine.attribution(p.x.row(0));
            let size = machine.coefficient.iter().map(|c| c.abs()).fold(1.0, f64::max);
            for j in 0..p.x.cols().min(3) {
                let expected = by_quadrature(&machine, p.x.row(0), j);
                assert!((found.contributions[j] - expected).abs() < 1e-6 * size, "{}: {expected} {found:?}", p.name);
            }
        }
    }

    #[test]
    fn a_row_of_another_length_has_no_contributions() {
        let p = problem(1);
        let machine = train(&p.x, &p.labels, p.kernel, p.cost, &SolverOptions::default()).unwrap();
        assert!(machine.attribution(&[]).base.is_nan());
    }
}

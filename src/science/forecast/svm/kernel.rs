//! The kernels of the machine.

use serde::{Deserialize, Serialize};

use super::lanes;

/// A kernel with its parameter. Features are taken as standardised, so `gamma` is dimensionless.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Kernel {
    /// `k(a, b) = exp(-gamma |a - b|^2)`.
    Gaussian {
        /// Inverse squared width, > 0, in units of 1 / (standardised feature)^2.
        gamma: f64,
    },
    /// `k(a, b) = a . b`.
    Linear,
}

/// A kernel without its parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum KernelFamily {
    /// See [`Kernel::Gaussian`].
    Gaussian,
    /// See [`Kernel::Linear`].
    Linear,
}

impl Kernel {
    /// The kernel of two rows of features; NaN if their lengths differ.
    #[must_use]
    pub fn value(&self, a: &[f64], b: &[f64]) -> f64 {
        if a.len() != b.len() {
            return f64::NAN;
        }
        self.of_pair(self.family().pair(a, b))
    }

    /// The family this kernel belongs to.
    #[must_use]
    pub const fn family(&self) -> KernelFamily {
        match self {
            Self::Gaussian { .. } => KernelFamily::Gaussian,
            Self::Linear => KernelFamily::Linear,
        }
    }

    /// The parameter of a Gaussian kernel, `None` for a linear one.
    #[must_use]
    pub const fn gamma(&self) -> Option<f64> {
        match self {
            Self::Gaussian { gamma } => Some(*gamma),
            Self::Linear => None,
        }
    }

    /// True for a linear kernel and for a Gaussian one whose `gamma` is finite and above 0.
    #[must_use]
    pub const fn is_valid(&self) -> bool {
        match self {
            Self::Gaussian { gamma } => gamma.is_finite() && *gamma > 0.0,
            Self::Linear => true,
        }
    }

    /// The kernel of a squared distance (Gaussian) or of an inner product (linear).
    #[inline(always)]
    pub(super) fn of_pair(&self, pair: f64) -> f64 {
        match self {
            Self::Gaussian { gamma } => lanes::exp_of_negative(-gamma * pair),
            Self::Linear => pair,
        }
    }
}

impl KernelFamily {
    /// The member with that `gamma`, which a linear kernel ignores.
    #[must_use]
    pub const fn with_gamma(self, gamma: f64) -> Kernel {
        match self {
            Self::Gaussian => Kernel::Gaussian { gamma },
            Self::Linear => Kernel::Linear,
        }
    }

    /// What a pair of rows contributes: squared distance (Gaussian) or inner product (linear), summed in feature order.
    fn pair(self, a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).fold(0.0, |sum, (&x, &y)| sum + self.term(x, y))
    }

    /// The part of one feature in [`Self::pair`].
    #[inline(always)]
    pub(super) fn term(self, x: f64, y: f64) -> f64 {
        match self {
            Self::Gaussian => (x - y) * (x - y),
            Self::Linear => x * y,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_follow_the_formulas() {
        let (a, b) = ([1.0, 2.0, -1.0], [0.5, 0.0, 3.0]);
        let squared_distance: f64 = 0.25 + 4.0 + 16.0;
        let gaussian = Kernel::Gaussian { gamma: 0.03 }.value(&a, &b);
        assert!((gaussian - (-0.03 * squared_distance).exp()).abs() < 1e-15);
        assert_eq!(Kernel::Linear.value(&a, &b), 0.5 - 3.0);
        assert_eq!(Kernel::Gaussian { gamma: 0.03 }.value(&a, &a), 1.0);
        assert!(Kernel::Linear.value(&a, &b[..2]).is_nan());
    }
}

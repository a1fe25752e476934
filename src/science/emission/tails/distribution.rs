//! The fitted distributions: density, distribution function, draws.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::tilted::{Sampler, Shape, Table, Tilted};

/// A distribution of `u = ln(x / xmin)` on `0..=upper`.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::emission) struct Distribution {
    pub(super) upper: f64,
    pub(super) form: Form,
}

/// The form of the density of u.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Form {
    /// `exp(-b u)`: power laws, with or without an upper bound.
    Power { b: f64 },
    /// `k beta exp(beta u) exp(-k w)` with `w = exp(beta u) - 1`: exponential (beta = 1) and stretched exponential.
    Stretched { k: f64, beta: f64 },
    /// `exp(-b u - c t(u))`.
    Tilted { tilted: Tilted, log_z: f64 },
}

impl Distribution {
    pub(super) fn power(b: f64, upper: f64) -> Self {
        Self { upper, form: Form::Power { b } }
    }

    pub(super) fn stretched(k: f64, beta: f64, upper: f64) -> Self {
        Self { upper, form: Form::Stretched { k, beta } }
    }

    pub(super) fn tilted(tilted: Tilted) -> Self {
        Self { upper: tilted.upper, form: Form::Tilted { tilted, log_z: tilted.all().log_z } }
    }

    /// The power law with an exponential cut-off, `exp(-b u - c (exp(u) - 1))`, or the pure power law for c = 0.
    pub(in crate::emission) fn cutoff(b: f64, c: f64, upper: f64) -> Self {
        if c == 0.0 { Self::power(b, upper) } else { Self::tilted(Tilted { shape: Shape::Cutoff, b, c, upper }) }
    }

    /// `ln p(u)`.
    pub(in crate::emission) fn log_density(&self, u: f64) -> f64 {
        match &self.form {
            Form::Power { b } => log_exponential_constant(*b, self.upper) - b * u,
            Form::Stretched { k, beta } => {
                let reach = (beta * self.upper).exp_m1();
                log_exponential_constant(*k, reach) + beta.ln() + beta * u - k * (beta * u).exp_m1()
            }
            Form::Tilted { tilted, log_z } => tilted.log_density(u, *log_z),
        }
    }

    /// `ln` of the probability of `u..u + width`.
    pub(in crate::emission) fn log_probability(&self, u: f64, width: f64) -> f64 {
        match &self.form {
            Form::Power { b } => log_exponential_interval(*b, u, u + width, self.upper),
            Form::Stretched { k, beta } => {
                let w = |u: f64| (beta * u).exp_m1();
                log_exponential_interval(*k, w(u), w(u + width), w(self.upper))
            }
            Form::Tilted { tilted, log_z } => tilted.moments(u, u + width).log_z - log_z,
        }
    }

    /// The logarithm of the density at `u`, or of the probability of the bin that begins at `u`.
    pub(in crate::emission) fn log_likelihood(&self, u: f64, width: Option<f64>) -> f64 {
        width.map_or_else(|| self.log_density(u), |width| self.log_probability(u, width))
    }

    /// The distribution function, ready to be asked often.
    pub(in crate::emission) fn cumulative(&self) -> Cumulative {
        match &self.form {
            Form::Power { b } => Cumulative::Exponential { k: *b, beta: 0.0, reach: self.upper },
            Form::Stretched { k, beta } => {
                Cumulative::Exponential { k: *k, beta: *beta, reach: (beta * self.upper).exp_m1() }
            }
            Form::Tilted { tilted, .. } => Cumulative::Tilted(Table::new(tilted)),
        }
    }

    /// Something that draws u.
    pub(in crate::emission) fn sampler(&self) -> Draw {
        match &self.form {
            Form::Power { b } => Draw::Exponential { k: *b, beta: 0.0, reach: self.upper },
            Form::Stretched { k, beta } => {
                Draw::Exponential { k: *k, beta: *beta, reach: (beta * self.upper).exp_m1() }
            }
            Form::Tilted { tilted, .. } => Draw::Tilted(Sampler::new(tilted)),
        }
    }
}

/// `ln(k / (1 - exp(-k reach)))`, for any k.
pub(super) fn log_exponential_constant(k: f64, reach: f64) -> f64 {
    if reach.is_infinite() {
        return k.ln();
    }
    let y = k * reach;
    if y.abs() < 1e-8 { -reach.ln() + y / 2.0 } else { (k / -(-y).exp_m1()).ln() }
}

/// `ln` of the probability of `from..to` of an exponential variable with rate `k`, given that it is below `reach`.
fn log_exponential_interval(k: f64, from: f64, to: f64, reach: f64) -> f64 {
    let to = to.min(reach);
    log_exponential_constant(k, reach) - log_exponential_constant(k, to - from) - k * from
}

/// See [`Distribution::cumulative`].
pub(in crate::emission) enum Cumulative {
    /// Of a truncated exponential variable `u` (beta = 0) or `exp(beta u) - 1`.
    Exponential {
        k: f64,
        beta: f64,
        reach: f64,
    },
    Tilted(Table),
}

impl Cumulative {
    /// Probability of a value up to `u`.
    #[inline]
    pub(in crate::emission) fn at(&self, u: f64) -> f64 {
        match self {
            Self::Exponential { k, beta, reach } => {
                let w = if *beta == 0.0 { u } else { (beta * u).exp_m1() };
                let share = -(-k * w).exp_m1();
                if reach.is_infinite() {
                    share
                } else if (k * reach).abs() < 1e-8 {
                    (w / reach).min(1.0)
                } else {
                    (share / -(-k * reach).exp_m1()).min(1.0)
                }
            }
            Self::Tilted(table) => table.cdf(u),
        }
    }
}

/// See [`Distribution::sampler`].
#[derive(Clone, Debug)]
pub(in crate::emission) enum Draw {
    Exponential { k: f64, beta: f64, reach: f64 },
    Tilted(Sampler),
}

impl Draw {
    /// One value of u.
    pub(in crate::emission) fn draw(&self, rng: &mut ChaCha8Rng) -> f64 {
        match self {
            Self::Exponential { k, beta, reach } => {
                let v: f64 = rng.random();
                let w = if reach.is_infinite() {
                    -(-v).ln_1p() / k
                } else if (k * reach).abs() < 1e-8 {
                    v * reach
                } else {
                    -(v * (-k * reach).exp_m1()).ln_1p() / k
                };
                if *beta == 0.0 { w } else { w.ln_1p() / beta }
            }
            Self::Tilted(sampler) => sampler.draw(rng),
        }
    }
}

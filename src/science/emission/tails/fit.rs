//! Maximum likelihood of each model on a tail.

use super::data::Tail;
use super::distribution::{Distribution, Form, log_exponential_constant};
use super::tilted::{Moments, Shape, Tilted};
use super::{Fitted, Model, Parameter};
use crate::emission::error::EmissionError;
use crate::emission::numerics::{Z95, errors_from_curvature, maximum, root};

/// Fits `model` to `tail`.
///
/// All likelihoods are conditional on xmin <= x <= xmax and, where the tail is rounded, of bins.
///
/// # Errors
/// A power law with an upper bound (that is the bounded power law), or a likelihood without a maximum.
pub fn fit(tail: &Tail, model: Model) -> Result<Fitted, EmissionError> {
    match model {
        Model::PowerLaw if tail.xmax.is_some() => Err(EmissionError::option(
            "model",
            "power_law with xmax",
            "bounded_power_law, or no xmax, as a power law has no upper bound",
        )),
        Model::PowerLaw => power_law(tail, Model::PowerLaw, f64::INFINITY),
        Model::BoundedPowerLaw => bounded_power_law(tail),
        Model::CutoffPowerLaw => tilted(tail, Model::CutoffPowerLaw, Shape::Cutoff),
        Model::Lognormal => tilted(tail, Model::Lognormal, Shape::Lognormal),
        Model::Exponential => exponential(tail),
        Model::StretchedExponential => stretched_exponential(tail),
    }
}

/// Builds the result from what every model knows.
fn fitted(tail: &Tail, model: Model, distribution: Distribution, parameters: Vec<Parameter>) -> Fitted {
    let n = tail.len() as f64;
    let sum: f64 = match tail.width {
        None => {
            // the density of x is that of u divided by x
            let logs = n * tail.mean_u() + n * tail.xmin.ln();
            log_density_sum(tail, &distribution) - logs
        }
        Some(width) => tail.groups().iter().map(|&(u, count)| count * distribution.log_probability(u, width)).sum(),
    };
    Fitted { model, xmin: tail.xmin, xmax: tail.xmax, n_tail: tail.len(), distribution, parameters, loglik: sum }
}

fn log_density_sum(tail: &Tail, distribution: &Distribution) -> f64 {
    let n = tail.len() as f64;
    match &distribution.form {
        Form::Power { b } => n * (log_exponential_constant(*b, distribution.upper) - b * tail.mean_u()),
        _ => tail.u.iter().map(|&u| distribution.log_density(u)).sum(),
    }
}

/// The rate `k` of an exponential variable on `0..=reach` whose mean is `mean`: `1/k - reach / (exp(k reach) - 1) = mean`.
pub(in crate::emission) fn exponential_rate(mean: f64, reach: f64) -> Option<f64> {
    if reach.is_infinite() {
        return (mean > 0.0).then(|| 1.0 / mean);
    }
    let share = mean / reach;
    if !(share > 0.0 && share < 1.0) {
        return None;
    }
    let bound = 2.0 / share.min(1.0 - share) + 10.0;
    Some(root(|y| mean_share(y) - share, -bound, bound)? / reach)
}

/// `1/y - 1/(exp(y) - 1)`.
fn mean_share(y: f64) -> f64 {
    if y.abs() < 1e-3 { 0.5 - y / 12.0 + y * y * y / 720.0 } else { 1.0 / y - 1.0 / y.exp_m1() }
}

/// Variance of an exponential variable with rate `k` on `0..=reach`.
fn exponential_variance(k: f64, reach: f64) -> f64 {
    if reach.is_infinite() {
        return 1.0 / (k * k);
    }
    let y = k * reach;
    if y.abs() < 1e-2 {
        return reach * reach * (1.0 / 12.0 - y * y / 240.0);
    }
    1.0 / (k * k) - (reach / (2.0 * (y / 2.0).sinh())).powi(2)
}

/// Exact data: alpha = 1 + n / sum u, or the bounded likelihood. Bins: the bin number is geometric, truncated at `upper`.
fn power_law(tail: &Tail, model: Model, upper: f64) -> Result<Fitted, EmissionError> {
    let failed = EmissionError::NotConverged { what: model.name() };
    let n = tail.len() as f64;
    let (b, variance) = match tail.width {
        None => {
            let b = exponential_rate(tail.mean_u(), upper).ok_or(failed)?;
            (b, exponential_variance(b, upper))
        }
        Some(width) => {
            let y = geometric_rate(tail.mean_u() / width, upper / width).ok_or(failed)?;
            (y / width, width * width * geometric_variance(y, upper / width))
        }
    };
    let parameters = vec![Parameter::normal("alpha", b + 1.0, 1.0 / (n * variance).sqrt())];
    Ok(fitted(tail, model, Distribution::power(b, upper), parameters))
}

/// The rate `y` of a geometric variable `exp(-y k)`, k = 0, 1, ... bins - 1, whose mean is `mean`.
fn geometric_rate(mean: f64, bins: f64) -> Option<f64> {
    if bins.is_infinite() {
        return (mean > 0.0).then(|| (1.0 / mean).ln_1p());
    }
    let bins = bins.round();
    if !(mean > 0.0 && mean < bins - 1.0) {
        return None;
    }
    let expected = |y: f64| {
        // 1/(e^y - 1) - bins/(e^(bins y) - 1), as a continuous mean and a part without a pole
        (mean_share(bins * y) * bins) - mean_share(y)
    };
    let bound = 2.0 + 2.0 * (bins + 1.0) / mean.min(bins - 1.0 - mean);
    root(|y| expected(y) - mean, -bound, bound)
}

fn geometric_variance(y: f64, bins: f64) -> f64 {
    let single = |y: f64| if y.abs() < 1e-4 { 1.0 / 12.0 } else { 1.0 / (y * y) - (2.0 * (y / 2.0).sinh()).powi(-2) };
    if bins.is_infinite() {
        return (2.0 * (y / 2.0).sinh()).powi(-2);
    }
    exponential_variance(y * 1.0, bins.round()) - single(y)
}

/// The upper bound is xmax where given, else the largest value (which maximises the likelihood).
fn bounded_power_law(tail: &Tail) -> Result<Fitted, EmissionError> {
    let last = tail.u.last().copied().unwrap_or_default() + tail.width.unwrap_or_default();
    let upper = if tail.xmax.is_some() { tail.upper() } else { last };
    let mut fit = power_law(tail, Model::BoundedPowerLaw, upper)?;
    let xmax = tail.xmax.unwrap_or(tail.largest);
    if tail.xmax.is_none() {
        fit.parameters.push(Parameter::bare("xmax", xmax));
    }
    fit.xmax = Some(xmax);
    Ok(fit)
}

/// Exponential: `w = x / xmin - 1` has the rate k = xmin times the rate of x.
fn exponential(tail: &Tail) -> Result<Fitted, EmissionError> {
    let n = tail.len() as f64;
    let reach = tail.upper().exp_m1();
    let failed = EmissionError::NotConverged { what: Model::Exponential.name() };
    let (k, se) = match tail.width {
        None => {
            let k = exponential_rate(tail.u.iter().map(|u| u.exp_m1()).sum::<f64>() / n, reach).ok_or(failed)?;
            (k, 1.0 / (n * exponential_variance(k, reach)).sqrt())
        }
        Some(_) => {
            let k = binned_rate(tail, 1.0);
            // one parameter only: the other is given a curvature of its own
            let curve = |[k, other]: [f64; 2]| binned_loglik(tail, k, 1.0) - 0.5 * (other - 1.0).powi(2);
            (k, errors_from_curvature(curve, [k, 1.0]).ok_or(failed)?[0])
        }
    };
    let parameters = vec![Parameter::normal("rate", k / tail.xmin, se / tail.xmin)];
    Ok(fitted(tail, Model::Exponential, Distribution::stretched(k, 1.0, tail.upper()), parameters))
}

/// `n` times the mean log density of u without its terms in the data's own logarithms, exact or in bins.
fn stretched_loglik(tail: &Tail, k: f64, beta: f64) -> f64 {
    if tail.width.is_some() {
        return binned_loglik(tail, k, beta);
    }
    let n = tail.len() as f64;
    let w = tail.u.iter().map(|u| (beta * u).exp_m1()).sum::<f64>();
    let reach = (beta * tail.upper()).exp_m1();
    n * (log_exponential_constant(k, reach) + beta.ln() + beta * tail.mean_u()) - k * w
}

fn binned_loglik(tail: &Tail, k: f64, beta: f64) -> f64 {
    let distribution = Distribution::stretched(k, beta, tail.upper());
    let width = tail.width.unwrap_or_default();
    tail.groups().iter().map(|&(u, count)| count * distribution.log_probability(u, width)).sum()
}

/// The rate that maximises the likelihood of the bins for a given `beta`.
fn binned_rate(tail: &Tail, beta: f64) -> f64 {
    let half = tail.width.unwrap_or_default() / 2.0;
    let mean = tail.u.iter().map(|u| (beta * (u + half)).exp_m1()).sum::<f64>() / tail.len() as f64;
    let near = -mean.ln();
    maximum(|log_k| binned_loglik(tail, log_k.exp(), beta), near - 3.0, near + 3.0).0.exp()
}

/// Smallest exponent of the stretched exponential: below, it is a power law to all that data could tell.
const SMALLEST_BETA: f64 = 1e-3;

/// Stretched exponential `exp(-(lambda x)^beta)`: for each beta the rate is known, so that beta alone is searched.
fn stretched_exponential(tail: &Tail) -> Result<Fitted, EmissionError> {
    let rate = |beta: f64| {
        if tail.width.is_some() {
            return Some(binned_rate(tail, beta));
        }
        let mean = tail.u.iter().map(|u| (beta * u).exp_m1()).sum::<f64>() / tail.len() as f64;
        exponential_rate(mean, (beta * tail.upper()).exp_m1())
    };
    let profile = |log_beta: f64| {
        let beta = log_beta.exp();
        rate(beta).map_or(f64::NEG_INFINITY, |k| stretched_loglik(tail, k, beta))
    };
    let largest = tail.u.last().copied().unwrap_or(1.0);
    // e^(beta u) stays finite
    let (low, high) = (SMALLEST_BETA.ln(), (20.0_f64.min(600.0 / largest)).ln());
    let (log_beta, best) = maximum(profile, low, high);
    let failed = EmissionError::NotConverged { what: Model::StretchedExponential.name() };
    if !best.is_finite() {
        return Err(failed);
    }
    let beta = log_beta.exp();
    let k = rate(beta).ok_or(failed)?;
    // k = (lambda xmin)^beta
    let lambda = |k: f64, beta: f64| k.powf(1.0 / beta) / tail.xmin;
    let inside = log_beta > low + 1e-3 && log_beta < high - 1e-3;
    let errors = if inside {
        let surface = |[log_k, beta]: [f64; 2]| stretched_loglik(tail, log_k.exp(), beta);
        errors_from_curvature(surface, [k.ln(), beta])
    } else {
        None
    };
    let beta_parameter = match errors {
        Some([_, se]) => Parameter::normal("stretching", beta, se),
        None => Parameter::bare("stretching", beta),
    };
    // at the lower bound of beta it is a power law, whose rate is infinite
    let rate = lambda(k, beta);
    let mut parameters = vec![beta_parameter];
    if rate.is_finite() {
        parameters.push(Parameter::bare("rate", rate));
    }
    let distribution = Distribution::stretched(k, beta, tail.upper());
    Ok(fitted(tail, Model::StretchedExponential, distribution, parameters))
}

/// What the likelihood of a [`Tilted`] family needs of the data.
enum Statistics {
    /// Means of u and t.
    Exact { mean: [f64; 2] },
    /// Lower edge and share of each bin.
    Bins { width: f64, shares: Vec<(f64, f64)> },
}

impl Statistics {
    fn of(tail: &Tail, shape: Shape) -> Self {
        let n = tail.len() as f64;
        match tail.width {
            None => {
                let t = tail.u.iter().map(|&u| shape.statistic(u)).sum::<f64>() / n;
                Self::Exact { mean: [tail.mean_u(), t] }
            }
            Some(width) => {
                Self::Bins { width, shares: tail.groups().into_iter().map(|(u, count)| (u, count / n)).collect() }
            }
        }
    }

    /// Mean log likelihood, its gradient in (b, c) and its negative Hessian.
    fn evaluate(&self, tilted: &Tilted) -> Evaluation {
        let all = tilted.all();
        match self {
            Self::Exact { mean } => Evaluation {
                value: -tilted.b * mean[0] - tilted.c * mean[1] - all.log_z,
                gradient: [all.mean[0] - mean[0], all.mean[1] - mean[1]],
                information: all.covariance,
            },
            Self::Bins { width, shares } => {
                let mut value = -all.log_z;
                let mut gradient = all.mean;
                let mut information = all.covariance;
                for &(u, share) in shares {
                    let Moments { log_z, mean, covariance } = tilted.moments(u, u + width);
                    value += share * log_z;
                    for i in 0..2 {
                        gradient[i] -= share * mean[i];
                    }
                    for i in 0..3 {
                        information[i] -= share * covariance[i];
                    }
                }
                Evaluation { value, gradient, information }
            }
        }
    }
}

struct Evaluation {
    value: f64,
    gradient: [f64; 2],
    /// bb, bc, cc.
    information: [f64; 3],
}

impl Evaluation {
    /// The Newton step; `None` where the surface is not curved downwards.
    fn step(&self) -> Option<[f64; 2]> {
        let [bb, bc, cc] = self.information;
        let [gb, gc] = self.gradient;
        let determinant = bb * cc - bc * bc;
        (bb > 0.0 && determinant > 1e-14 * bb * cc)
            .then(|| [(cc * gb - bc * gc) / determinant, (bb * gc - bc * gb) / determinant])
    }
}

/// The maximum of the likelihood of a two-parameter family.
enum Optimum {
    /// At c = 0: the power law with this fit.
    Boundary(Fitted),
    Inside(Tilted, Evaluation),
}

/// Newton's method in (b, c) with c > 0, or the power law where the likelihood falls from c = 0 on.
fn optimum(tail: &Tail, model: Model, shape: Shape, statistics: &Statistics) -> Result<Optimum, EmissionError> {
    let upper = tail.upper();
    let boundary = power_law(tail, model, upper);
    let b0 = boundary.as_ref().ok().and_then(|fit| match fit.distribution.form {
        Form::Power { b } => Some(b),
        _ => None,
    });
    let largest = tail.u.last().copied().unwrap_or(1.0) + tail.width.unwrap_or_default();
    let scale = 1.0 / shape.statistic(largest);
    // inside by a hair: where the likelihood falls there, it falls from the boundary on (it is concave)
    if let (Some(b), Ok(fit)) = (b0, &boundary) {
        let hair = Tilted { shape, b, c: scale * 1e-6, upper };
        if statistics.evaluate(&hair).gradient[1] <= 0.0 {
            return Ok(Optimum::Boundary(fit.clone()));
        }
    }
    let mut at = Tilted { shape, b: b0.unwrap_or(0.0) * 0.8, c: scale, upper };
    let failed = EmissionError::NotConverged { what: model.name() };
    let mut here = statistics.evaluate(&at);
    for _ in 0..200 {
        let step = here.step().filter(|step| step.iter().all(|s| s.is_finite())).ok_or_else(|| failed.clone())?;
        let gain = here.gradient[0] * step[0] + here.gradient[1] * step[1];
        let next = ascend(&at, &here, step, gain, statistics);
        let done = gain < 1e-17 || next.is_none();
        if let Some(next) = next {
            (at, here) = next;
        }
        if done {
            return Ok(Optimum::Inside(at, here));
        }
        if at.c < scale * 1e-7 {
            return boundary.map(Optimum::Boundary);
        }
    }
    Err(failed)
}

/// A step along `step`, halved until the likelihood rises; `None` where only rounding is left to gain.
fn ascend(
    at: &Tilted,
    here: &Evaluation,
    step: [f64; 2],
    gain: f64,
    statistics: &Statistics,
) -> Option<(Tilted, Evaluation)> {
    let mut length = if at.c + step[1] > 0.1 * at.c { 1.0 } else { 0.9 * at.c / -step[1] };
    while length > 1e-10 {
        let next = Tilted { b: at.b + length * step[0], c: at.c + length * step[1], ..*at };
        let there = statistics.evaluate(&next);
        if there.value >= here.value + 1e-4 * length * gain - 1e-14 {
            return Some((next, there));
        }
        length *= 0.5;
    }
    None
}

fn tilted(tail: &Tail, model: Model, shape: Shape) -> Result<Fitted, EmissionError> {
    let statistics = Statistics::of(tail, shape);
    Ok(match optimum(tail, model, shape, &statistics)? {
        Optimum::Boundary(fit) => on_boundary(fit, shape),
        Optimum::Inside(at, here) => inside(tail, model, &at, &here, &statistics),
    })
}

/// The fitted distribution alone: what [`fit`] finds, without errors and intervals.
pub(in crate::emission) fn distribution(tail: &Tail, model: Model) -> Result<Distribution, EmissionError> {
    let shape = match model {
        Model::CutoffPowerLaw => Shape::Cutoff,
        Model::Lognormal => Shape::Lognormal,
        _ => return fit(tail, model).map(|fit| fit.distribution),
    };
    let statistics = Statistics::of(tail, shape);
    Ok(match optimum(tail, model, shape, &statistics)? {
        Optimum::Boundary(fit) => fit.distribution,
        Optimum::Inside(at, _) => Distribution::tilted(at),
    })
}

/// The pure power law as the limit of a family: a lognormal of infinite width has no alpha of its own.
fn on_boundary(mut fit: Fitted, shape: Shape) -> Fitted {
    if shape == Shape::Lognormal {
        fit.parameters.clear();
    }
    fit
}

fn inside(tail: &Tail, model: Model, at: &Tilted, here: &Evaluation, statistics: &Statistics) -> Fitted {
    let n = tail.len() as f64;
    let [bb, bc, cc] = here.information;
    let determinant = bb * cc - bc * bc;
    let [var_b, cov, var_c] = [cc / determinant / n, -bc / determinant / n, bb / determinant / n];
    let parameters = match at.shape {
        Shape::Cutoff => {
            let cutoff = tail.xmin / at.c;
            let interval = cutoff_interval(tail, at, n * here.value, statistics);
            vec![
                Parameter::normal("alpha", at.b + 1.0, var_b.sqrt()),
                Parameter {
                    name: "cutoff".to_owned(),
                    value: cutoff,
                    se: Some(cutoff * var_c.sqrt() / at.c),
                    lower95: interval.0,
                    upper95: interval.1,
                },
            ]
        }
        Shape::Lognormal => {
            let variance = 0.5 / at.c;
            let (mu, sigma) = (tail.xmin.ln() - at.b * variance, variance.sqrt());
            // mu = ln xmin - b / (2 c), sigma = (2 c)^(-1/2)
            let slope = [-variance, at.b / (2.0 * at.c * at.c)];
            let mu_se =
                (slope[0] * slope[0] * var_b + 2.0 * slope[0] * slope[1] * cov + slope[1] * slope[1] * var_c).sqrt();
            let sigma_se = var_c.sqrt() * sigma / (2.0 * at.c);
            vec![Parameter::normal("log_mean", mu, mu_se), Parameter::normal("log_sd", sigma, sigma_se)]
        }
    };
    fitted(tail, model, Distribution::tilted(*at), parameters)
}

/// Where the profile likelihood of the cut-off has fallen by half the 95 % quantile of chi-square with one degree.
fn cutoff_interval(tail: &Tail, at: &Tilted, best: f64, statistics: &Statistics) -> (Option<f64>, Option<f64>) {
    let n = tail.len() as f64;
    let drop = 0.5 * Z95 * Z95;
    let profile = |log_c: f64| n * best_given_c(statistics, &Tilted { c: log_c.exp(), ..*at }) - best + drop;
    let centre = at.c.ln();
    let side = |direction: f64| {
        let mut reach = 0.1;
        while reach < 12.0 {
            if profile(centre + direction * reach) < 0.0 {
                return root(profile, centre, centre + direction * reach);
            }
            reach *= 2.0;
        }
        None
    };
    (side(1.0).map(|log_c| tail.xmin / log_c.exp()), side(-1.0).map(|log_c| tail.xmin / log_c.exp()))
}

/// Mean log likelihood maximised over b for the c of `start`.
fn best_given_c(statistics: &Statistics, start: &Tilted) -> f64 {
    let mut at = *start;
    let mut here = statistics.evaluate(&at);
    for _ in 0..50 {
        let mut step = here.gradient[0] / here.information[0].abs();
        if (step * here.gradient[0]).abs() < 1e-14 {
            break;
        }
        loop {
            let next = Tilted { b: at.b + step, ..at };
            let there = statistics.evaluate(&next);
            if there.value >= here.value || step.abs() < 1e-12 {
                (at, here) = (next, there);
                break;
            }
            step *= 0.5;
        }
    }
    here.value
}

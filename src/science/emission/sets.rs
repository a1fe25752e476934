//! Several data sets side by side: collapse, one exponent for all, one distribution for all.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::error::EmissionError;
use super::numerics::{log_spaced, maximum};
use super::special::chi_square_survival;
use super::tails::distribution::Distribution;
use super::tails::{Fitted, Model, Tail, fit};

/// The number of events a set and a unit of amplitude, over the number of all of the set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Collapse {
    /// Edges of the bins in equal ratios, V.
    pub edges: Vec<f64>,
    /// n(A)/N of each bin, 1/V, a list a set; missing for an empty bin.
    pub density: Vec<Vec<Option<f64>>>,
    /// Their standard errors from the Poisson numbers of events.
    pub error: Vec<Vec<Option<f64>>>,
    /// Mean over bins of the variance of ln n(A)/N between the sets over that which Poisson numbers have: 1 where the sets collapse.
    pub scatter: Option<f64>,
}

/// Collapses rising samples of one quantity into `bins` common bins from `from` on.
///
/// # Errors
/// Fewer than two sets, a set without events from `from` on, or bins out of range.
pub fn collapse(sets: &[&[f64]], from: f64, bins: usize) -> Result<Collapse, EmissionError> {
    if sets.len() < 2 {
        return Err(EmissionError::TooFewEvents { what: "a comparison of data sets", found: sets.len(), needed: 2 });
    }
    if !(2..=500).contains(&bins) {
        return Err(EmissionError::option("bins", bins, "2 to 500"));
    }
    super::error::positive("from", from)?;
    let high = sets.iter().filter_map(|set| set.last().copied()).fold(0.0, f64::max);
    if high <= from {
        return Err(EmissionError::TooFewEvents { what: "collapse", found: 0, needed: 1 });
    }
    let edges = log_spaced(from, high * (1.0 + 1e-9), bins + 1);
    let mut collapse = Collapse { edges, density: Vec::new(), error: Vec::new(), scatter: None };
    let mut counts = Vec::new();
    for set in sets {
        let total = (set.len() - set.partition_point(|&x| x < from)) as f64;
        let below = |edge: f64| set.partition_point(|&x| x < edge) as f64;
        let n: Vec<f64> = collapse.edges.windows(2).map(|edge| below(edge[1]) - below(edge[0])).collect();
        let widths = collapse.edges.windows(2).map(|edge| edge[1] - edge[0]);
        let scaled = |n: f64, width: f64, count: f64| (count > 0.0).then_some(n / (total * width));
        let density = n.iter().zip(widths.clone()).map(|(&n, width)| scaled(n, width, n)).collect();
        let error = n.iter().zip(widths).map(|(&n, width)| scaled(n.sqrt(), width, n)).collect();
        collapse.density.push(density);
        collapse.error.push(error);
        counts.push(n);
    }
    collapse.scatter = scatter(&collapse.density, &counts);
    Ok(collapse)
}

/// Reduced chi-square of ln density between the sets, over bins in which every set has at least 10 events.
fn scatter(density: &[Vec<Option<f64>>], counts: &[Vec<f64>]) -> Option<f64> {
    let (mut chi_square, mut degrees) = (0.0, 0.0);
    for bin in 0..counts[0].len() {
        if counts.iter().any(|n| n[bin] < 10.0) {
            continue;
        }
        let points: Vec<(f64, f64)> =
            density.iter().zip(counts).filter_map(|(d, n)| d[bin].map(|d| (d.ln(), n[bin]))).collect();
        let weight: f64 = points.iter().map(|p| p.1).sum();
        let mean = points.iter().map(|p| p.0 * p.1).sum::<f64>() / weight;
        chi_square += points.iter().map(|p| p.1 * (p.0 - mean).powi(2)).sum::<f64>();
        degrees += points.len() as f64 - 1.0;
    }
    (degrees > 0.0).then(|| chi_square / degrees)
}

/// Whether several sets share one exponent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct CommonExponent {
    /// Model; the cut-off, if it has one, is free in every set.
    pub model: Model,
    /// The common exponent.
    pub alpha: f64,
    /// Exponent of each set alone.
    pub alphas: Vec<f64>,
    /// Twice the log likelihood that free exponents gain.
    pub likelihood_ratio: f64,
    /// Sets less 1.
    pub degrees: usize,
    /// Probability of such a ratio if the exponent is common, by chi-square; below 0.05 the exponents differ.
    pub p_value: f64,
}

/// Likelihood-ratio test of one exponent in all `tails`, of the power law or the power law with a cut-off.
///
/// # Errors
/// Fewer than two sets, another model, or a set that cannot be fitted.
pub fn common_exponent(tails: &[Tail], model: Model) -> Result<CommonExponent, EmissionError> {
    if tails.len() < 2 {
        return Err(EmissionError::TooFewEvents { what: "a common exponent", found: tails.len(), needed: 2 });
    }
    if !matches!(model, Model::PowerLaw | Model::CutoffPowerLaw) {
        return Err(EmissionError::option("model", model.name(), "power_law or cutoff_power_law"));
    }
    let fits: Vec<Fitted> = tails.par_iter().map(|tail| fit(tail, model)).collect::<Result<_, _>>()?;
    let alphas: Vec<f64> = fits.iter().filter_map(|fit| fit.parameter("alpha")).map(|alpha| alpha.value).collect();
    let free: f64 = tails.iter().zip(&fits).map(|(tail, fit)| loglik(tail, &fit.distribution)).sum();
    let low = alphas.iter().copied().fold(f64::INFINITY, f64::min);
    let high = alphas.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let together = |alpha: f64| tails.iter().map(|tail| best_with(tail, model, alpha)).sum::<f64>();
    let (alpha, common) = if high - low < 1e-9 { (low, free) } else { maximum(together, low, high) };
    let likelihood_ratio = (2.0 * (free - common)).max(0.0);
    let degrees = tails.len() - 1;
    let p_value = chi_square_survival(likelihood_ratio, degrees as f64);
    Ok(CommonExponent { model, alpha, alphas, likelihood_ratio, degrees, p_value })
}

/// Log likelihood of u, of densities or bins.
fn loglik(tail: &Tail, distribution: &Distribution) -> f64 {
    match tail.width {
        None => tail.u.iter().map(|&u| distribution.log_density(u)).sum(),
        Some(width) => tail.groups().iter().map(|&(u, count)| count * distribution.log_probability(u, width)).sum(),
    }
}

/// The largest log likelihood for a given exponent.
fn best_with(tail: &Tail, model: Model, alpha: f64) -> f64 {
    let b = alpha - 1.0;
    let of = |c: f64| loglik(tail, &Distribution::cutoff(b, c, tail.upper()));
    let pure = if b > 0.0 { of(0.0) } else { f64::NEG_INFINITY };
    if model == Model::PowerLaw {
        return pure;
    }
    let exact = tail.width.is_none();
    let n = tail.len() as f64;
    let (mean_u, mean_t) = (tail.mean_u(), tail.u.iter().map(|u| u.exp_m1()).sum::<f64>() / n);
    // for exact values two sums say all
    let fast = |c: f64| n * (Distribution::cutoff(b, c, tail.upper()).log_density(0.0) - b * mean_u - c * mean_t);
    let value = |log_c: f64| if exact { fast(log_c.exp()) } else { of(log_c.exp()) };
    let scale = (tail.largest / tail.xmin).ln();
    maximum(value, -scale - 8.0, 5.0).1.max(pure)
}

/// Whether several samples have one distribution.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct AndersonDarling {
    /// The statistic A2kN of Scholz & Stephens (1987), for ties.
    pub statistic: f64,
    /// The statistic less its mean over its standard deviation.
    pub standardised: f64,
    /// Probability of such a statistic for samples of one distribution, between 0.001 and 0.25 (it is cut off there).
    pub p_value: f64,
}

/// The k-sample Anderson-Darling test (Scholz & Stephens 1987, J. Am. Stat. Assoc. 82, 918-924, eq. 7) of rising samples.
///
/// # Errors
/// Fewer than two samples, an empty one, or values that all agree.
pub fn anderson_darling(samples: &[&[f64]]) -> Result<AndersonDarling, EmissionError> {
    const WHAT: &str = "the k-sample Anderson-Darling test";
    let k = samples.len();
    let smallest = samples.iter().map(|s| s.len()).min().unwrap_or(0);
    if k < 2 || smallest < 2 {
        return Err(EmissionError::TooFewEvents { what: WHAT, found: k.min(smallest), needed: 2 });
    }
    let mut all: Vec<f64> = samples.concat();
    all.sort_unstable_by(f64::total_cmp);
    let n = all.len() as f64;
    let groups: Vec<(f64, f64)> = all.chunk_by(|a, b| a == b).map(|same| (same[0], same.len() as f64)).collect();
    if groups.len() < 2 {
        return Err(EmissionError::Degenerate { what: WHAT });
    }
    let mut statistic = 0.0;
    for sample in samples {
        let size = sample.len() as f64;
        let (mut below_all, mut inner, mut at) = (0.0, 0.0, 0);
        for &(value, ties) in &groups {
            let before = at;
            while at < sample.len() && sample[at] <= value {
                at += 1;
            }
            let own = (at - before) as f64;
            let all_mid = below_all + ties / 2.0;
            let own_mid = before as f64 + own / 2.0;
            inner += ties / n * (n * own_mid - size * all_mid).powi(2) / (all_mid * (n - all_mid) - n * ties / 4.0);
            below_all += ties;
        }
        statistic += inner / size;
    }
    statistic *= (n - 1.0) / n;
    let standardised = (statistic - (k as f64 - 1.0)) / variance(samples, n).sqrt();
    Ok(AndersonDarling { statistic, standardised, p_value: significance(standardised, k as f64 - 1.0) })
}

/// Variance of the statistic, eq. 4 of Scholz & Stephens.
fn variance(samples: &[&[f64]], n: f64) -> f64 {
    let k = samples.len() as f64;
    let inverse: f64 = samples.iter().map(|s| 1.0 / s.len() as f64).sum();
    let whole = n as usize;
    let harmonic: f64 = (1..whole).map(|i| 1.0 / i as f64).sum();
    // g = sum over i < j of 1/((n - i) j), with the inner sum as the tail of the harmonic one
    let (mut g, mut tail) = (0.0, 0.0);
    for i in (1..=whole.saturating_sub(2)).rev() {
        tail += 1.0 / (i as f64 + 1.0);
        g += tail / (n - i as f64);
    }
    let a = (4.0 * g - 6.0) * (k - 1.0) + (10.0 - 6.0 * g) * inverse;
    let b = (2.0 * g - 4.0) * k * k + 8.0 * harmonic * k + (2.0 * g - 14.0 * harmonic - 4.0) * inverse - 8.0 * harmonic
        + 4.0 * g
        - 6.0;
    let c = (6.0 * harmonic + 2.0 * g - 2.0) * k * k
        + (4.0 * harmonic - 4.0 * g + 6.0) * k
        + (2.0 * harmonic - 6.0) * inverse
        + 4.0 * harmonic;
    let d = (2.0 * harmonic + 6.0) * k * k - 4.0 * harmonic * k;
    (a * n.powi(3) + b * n * n + c * n + d) / ((n - 1.0) * (n - 2.0) * (n - 3.0))
}

/// Probability by a parabola in ln p through the critical values of the paper's table 2, within its range.
fn significance(standardised: f64, m: f64) -> f64 {
    const LEVELS: [f64; 7] = [0.25, 0.1, 0.05, 0.025, 0.01, 0.005, 0.001];
    const B: [[f64; 7]; 3] = [
        [0.675, 1.281, 1.645, 1.96, 2.326, 2.573, 3.085],
        [-0.245, 0.25, 0.678, 1.149, 1.822, 2.364, 3.615],
        [-0.105, -0.305, -0.362, -0.391, -0.396, -0.345, -0.154],
    ];
    let critical: Vec<f64> = (0..7).map(|i| B[0][i] + B[1][i] / m.sqrt() + B[2][i] / m).collect();
    if standardised <= critical[0] {
        return LEVELS[0];
    }
    if standardised >= critical[6] {
        return LEVELS[6];
    }
    let design = nalgebra::Matrix3::from_fn(|r, c| critical.iter().map(|x| x.powi((r + c) as i32)).sum::<f64>());
    let right = nalgebra::Vector3::from_fn(|r, _| {
        critical.iter().zip(LEVELS).map(|(x, level)| x.powi(r as i32) * level.ln()).sum::<f64>()
    });
    let solved = design.lu().solve(&right);
    let log_p = solved.map_or(f64::NAN, |c| c[0] + c[1] * standardised + c[2] * standardised * standardised);
    log_p.exp().clamp(LEVELS[6], LEVELS[0])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emission::close;
    use crate::emission::samples::{cutoff_sample, pareto_sample};

    #[test]
    fn anderson_darling_agrees_with_scipy() {
        // SciPy 1.17.1: anderson_ksamp(samples, variant="midrank")
        let a = [38.7, 41.5, 43.8, 44.5, 45.5, 46.0, 47.7, 58.0];
        let b = [35.8, 39.2, 39.3, 39.7, 41.2, 41.4, 41.8, 42.9];
        let c = [34.0, 34.0, 35.0, 39.0, 40.0, 43.0, 43.0, 44.0];
        let test = anderson_darling(&[&a, &b, &c]).unwrap();
        close(test.standardised, 4.095692866164991, 1e-9);
        close(test.p_value, 0.0048554276422650925, 1e-9);
        assert!(anderson_darling(&[&a]).is_err());
        assert!(anderson_darling(&[&[1.0, 1.0], &[1.0, 1.0]]).is_err());
    }

    #[test]
    fn one_exponent_is_kept_and_two_are_told_apart() {
        let tails =
            |sets: &[Vec<f64>]| -> Vec<Tail> { sets.iter().map(|x| Tail::exact(x, 0.003, None).unwrap()).collect() };
        let same: Vec<Vec<f64>> = (0..3).map(|seed| pareto_sample(2000, 2.0, 0.003, seed)).collect();
        let test = common_exponent(&tails(&same), Model::PowerLaw).unwrap();
        assert!(test.p_value > 0.05 && test.degrees == 2, "{test:?}");
        // of power laws the common exponent is known: 1 + sum n / sum u
        let inverse: f64 = test.alphas.iter().map(|alpha| 1.0 / (alpha - 1.0)).sum();
        close(test.alpha, 1.0 + 3.0 / inverse, 1e-6);
        let mut different = same.clone();
        different.push(pareto_sample(2000, 2.3, 0.003, 9));
        assert!(common_exponent(&tails(&different), Model::PowerLaw).unwrap().p_value < 1e-3);
        // polycrystals of three grain sizes: one tau, three cut-offs
        let grains: Vec<Vec<f64>> = [0.03, 0.1, 0.6].iter().map(|&c| cutoff_sample(2000, 1.35, c, 0.003, 7)).collect();
        let test = common_exponent(&tails(&grains), Model::CutoffPowerLaw).unwrap();
        assert!(test.p_value > 0.05, "{test:?}");
        close(test.alpha, 1.35, 0.08);
        assert!(common_exponent(&tails(&grains), Model::Lognormal).is_err());
    }

    #[test]
    fn single_crystals_collapse_and_polycrystals_do_not() {
        let single: Vec<Vec<f64>> = (0..3).map(|k| pareto_sample(3000 + 2000 * k, 2.0, 0.003, k as u64)).collect();
        let of = |sets: &[Vec<f64>]| {
            let slices: Vec<&[f64]> = sets.iter().map(Vec::as_slice).collect();
            collapse(&slices, 0.003, 20).unwrap()
        };
        let found = of(&single);
        close(found.scatter.unwrap(), 1.0, 0.6);
        let total: f64 =
            found.density[0].iter().zip(found.edges.windows(2)).map(|(d, e)| d.unwrap_or(0.0) * (e[1] - e[0])).sum();
        close(total, 1.0, 1e-9);
        let grains: Vec<Vec<f64>> = [0.03, 0.6].iter().map(|&c| cutoff_sample(3000, 1.35, c, 0.003, 7)).collect();
        assert!(of(&grains).scatter.unwrap() > 5.0);
        assert!(collapse(&[&single[0]], 0.003, 20).is_err());
    }
}

//! How an exponent depends on the bounds of the fit, and the b-value family.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::error::EmissionError;
use super::goodness::replicate_tail;
use super::numerics::{Z95, log_spaced, mean};
use super::sample::Sample;
use super::tails::{KsConvention, Model, fit, fit_distribution, ks_distance};
use crate::progress::Progress;

/// A fit to one range.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct MapPoint {
    /// Lower bound.
    pub xmin: f64,
    /// Upper bound, if there is one.
    pub xmax: Option<f64>,
    /// Events in the range.
    pub n_tail: usize,
    /// Exponent.
    pub alpha: f64,
    /// Its standard error.
    pub alpha_se: Option<f64>,
    /// 95 % interval.
    pub ci95: Option<[f64; 2]>,
    /// Bootstrap probability, where it was asked for.
    pub p_value: Option<f64>,
}

/// Fewest events of a range.
const FEWEST: usize = 20;

/// The exponent of `model` (a power law, pure or with a cut-off) as a function of xmin, at `points` lower bounds in equal ratios up
/// to the 20th largest value.
///
/// # Errors
/// A model without an exponent, fewer than two points, or fewer than 20 events.
pub fn exponent_map(sample: &Sample, model: Model, points: usize) -> Result<Vec<MapPoint>, EmissionError> {
    if !matches!(model, Model::PowerLaw | Model::BoundedPowerLaw | Model::CutoffPowerLaw) {
        let accepted = "power_law, bounded_power_law or cutoff_power_law";
        return Err(EmissionError::option("model", model.name(), accepted));
    }
    let (low, high) = range(sample, points, "exponent_map")?;
    let bounds = log_spaced(low, high, points);
    let point = |&xmin: &f64| {
        let tail = sample.tail(Some(xmin), None).ok()?;
        let fitted = fit(&tail, model).ok()?;
        let alpha = fitted.parameter("alpha")?;
        Some(MapPoint {
            xmin: fitted.xmin,
            xmax: fitted.xmax,
            n_tail: fitted.n_tail,
            alpha: alpha.value,
            alpha_se: alpha.se,
            ci95: alpha.lower95.zip(alpha.upper95).map(|(lower, upper)| [lower, upper]),
            p_value: None,
        })
    };
    let mut map: Vec<MapPoint> = bounds.par_iter().filter_map(point).collect();
    map.dedup_by(|a, b| a.xmin == b.xmin);
    Ok(map)
}

/// The smallest and the 20th largest value.
fn range(sample: &Sample, points: usize, what: &'static str) -> Result<(f64, f64), EmissionError> {
    if !(2..=1000).contains(&points) {
        return Err(EmissionError::option("points", points, "2 to 1000"));
    }
    let n = sample.len();
    if n < FEWEST {
        return Err(EmissionError::TooFewEvents { what, found: n, needed: FEWEST });
    }
    let value = |i: usize| match sample {
        Sample::Exact(values) => values[i],
        Sample::Rounded(levels) => levels.lower_edge(levels.levels[i]),
    };
    let (low, high) = (value(0), value(n - FEWEST));
    if high > low { Ok((low, high)) } else { Err(EmissionError::Degenerate { what }) }
}

/// What [`corral_deluca`] finds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct RangeMap {
    /// All ranges that could be fitted.
    pub ranges: Vec<MapPoint>,
    /// The one with the largest xmax/xmin of those that are not rejected (p > 0.1), if there is one.
    pub widest: Option<MapPoint>,
}

/// Fits the bounded power law to all ranges between `points` bounds in equal ratios, with the bootstrap probability of each
/// (Deluca & Corral 2013, Acta Geophys. 61, 1351-1394).
///
/// One random stream a range.
///
/// # Errors
/// As [`exponent_map`], no replicates, or [`EmissionError::Cancelled`].
pub fn corral_deluca(
    sample: &Sample,
    points: usize,
    replicates: usize,
    seed: u64,
    progress: &dyn Progress,
) -> Result<RangeMap, EmissionError> {
    const NOT_REJECTED: f64 = 0.1;
    if replicates == 0 {
        return Err(EmissionError::option("replicates", replicates, "a whole number of at least 1"));
    }
    let (low, _) = range(sample, points.min(200), "range map")?;
    let high = match sample {
        Sample::Exact(values) => values[values.len() - 1],
        Sample::Rounded(levels) => levels.lower_edge(levels.levels[levels.levels.len() - 1] + 1),
    };
    let bounds = log_spaced(low, high, points);
    let pairs: Vec<(usize, usize)> = (0..points).flat_map(|a| (a + 1..points).map(move |b| (a, b))).collect();
    let one = |(stream, &(a, b)): (usize, &(usize, usize))| {
        if progress.cancelled() {
            return Err(EmissionError::Cancelled);
        }
        if stream.is_multiple_of(16) {
            progress.report(stream as f64 / pairs.len() as f64, "range map");
        }
        let Ok(tail) = sample.tail(Some(bounds[a]), Some(bounds[b])) else { return Ok(None) };
        if tail.len() < FEWEST {
            return Ok(None);
        }
        let Ok(fitted) = fit(&tail, Model::BoundedPowerLaw) else { return Ok(None) };
        let convention = KsConvention::TwoSided;
        let limit = fitted.ks_distance(&tail, convention);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(stream as u64);
        let draw = fitted.distribution.sampler();
        let as_far = (0..replicates).filter(|_| {
            let replicate = replicate_tail(&tail, &draw, &mut rng);
            fit_distribution(&replicate, Model::BoundedPowerLaw)
                .is_ok_and(|fit| ks_distance(&fit.cumulative(), &replicate, convention, limit) >= limit)
        });
        let p_value = Some(as_far.count() as f64 / replicates as f64);
        let alpha = &fitted.parameters[0];
        Ok(Some(MapPoint {
            xmin: fitted.xmin,
            xmax: fitted.xmax,
            n_tail: fitted.n_tail,
            alpha: alpha.value,
            alpha_se: alpha.se,
            ci95: alpha.lower95.zip(alpha.upper95).map(|(lower, upper)| [lower, upper]),
            p_value,
        }))
    };
    let ranges: Vec<Option<MapPoint>> = pairs.par_iter().enumerate().map(one).collect::<Result<_, _>>()?;
    let ranges: Vec<MapPoint> = ranges.into_iter().flatten().collect();
    let width = |point: &&MapPoint| point.xmax.unwrap_or(point.xmin) / point.xmin;
    let accepted = ranges.iter().filter(|point| point.p_value.is_some_and(|p| p > NOT_REJECTED));
    let widest = accepted.max_by(|a, b| width(a).total_cmp(&width(b))).copied();
    Ok(RangeMap { ranges, widest })
}

/// A b-value with its error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct BValue {
    /// b of log10 N = a - b M with M = log10 A; the exponent is tau = 1 + b.
    pub b: f64,
    /// Standard error.
    pub se: f64,
    /// 95 % interval.
    pub ci95: [f64; 2],
    /// Magnitudes (or positive differences) in the estimate.
    pub n: usize,
}

impl BValue {
    fn new(b: f64, se: f64, n: usize) -> Self {
        Self { b, se, ci95: [b - Z95 * se, b + Z95 * se], n }
    }
}

/// The b-values of one catalogue.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct BValues {
    /// Magnitude of completeness in use: the lower edge of the first bin of magnitudes.
    pub completeness: f64,
    /// Aki (1965) with Utsu's correction for bins, error of Shi & Bolt (1982, BSSA 72, 1677-1687).
    pub aki_utsu: BValue,
    /// Tinti & Mulargia (1987, BSSA 77, 2125-2134), unbiased for bins.
    pub tinti_mulargia: BValue,
    /// b-positive of van der Elst (2021, JGR Solid Earth 126): of the positive differences of successive magnitudes, which
    /// changes of completeness do not bias; missing where there are too few.
    pub b_positive: Option<BValue>,
}

/// The b-values of `magnitudes` (in the order of time), which are multiples of `bin` (0 for exact ones).
///
/// `completeness` is the smallest magnitude (centre of its bin) that is complete; where it is not given, that of the fullest bin
/// (maximum curvature; Wiemer & Wyss 2000, BSSA 90, 859-869), in bins of 0.1 for exact magnitudes.
///
/// # Errors
/// A bin below 0, fewer than 20 complete magnitudes, or magnitudes that all agree.
pub fn b_values(magnitudes: &[f64], bin: f64, completeness: Option<f64>) -> Result<BValues, EmissionError> {
    if !(bin.is_finite() && bin >= 0.0) {
        return Err(EmissionError::option("bin", bin, "a finite number of at least 0"));
    }
    let lowest = completeness.unwrap_or_else(|| fullest_bin(magnitudes, if bin > 0.0 { bin } else { 0.1 }, bin > 0.0));
    let edge = lowest - bin / 2.0;
    let slack = 1e-9 * (1.0 + edge.abs());
    let complete: Vec<f64> = magnitudes.iter().copied().filter(|&m| m >= edge - slack).collect();
    let n = complete.len();
    if n < FEWEST {
        return Err(EmissionError::TooFewEvents { what: "a b-value", found: n, needed: FEWEST });
    }
    let centre = mean(&complete);
    let excess = centre - lowest;
    if excess + bin / 2.0 <= 0.0 || excess <= 0.0 {
        return Err(EmissionError::Degenerate { what: "the magnitudes" });
    }
    let log10_e = std::f64::consts::LOG10_E;
    let aki = log10_e / (excess + bin / 2.0);
    let squares: f64 = complete.iter().map(|m| (m - centre) * (m - centre)).sum();
    let shi_bolt = std::f64::consts::LN_10 * aki * aki * (squares / (n as f64 * (n as f64 - 1.0))).sqrt();
    let tinti = binned_b(excess, bin);
    let tinti_se = tinti_error(tinti, bin, n);
    Ok(BValues {
        completeness: edge,
        aki_utsu: BValue::new(aki, shi_bolt, n),
        tinti_mulargia: BValue::new(tinti, tinti_se, n),
        b_positive: b_positive(&complete, bin),
    })
}

/// `ln(1 + bin/excess) / (bin ln 10)`, Aki's formula for bins of no width.
fn binned_b(excess: f64, bin: f64) -> f64 {
    if bin == 0.0 {
        std::f64::consts::LOG10_E / excess
    } else {
        (bin / excess).ln_1p() / (bin * std::f64::consts::LN_10)
    }
}

/// Standard error of a geometric rate, over `bin ln 10`: `2 sinh(y/2) / y` times b over sqrt n, y = b bin ln 10.
fn tinti_error(b: f64, bin: f64, n: usize) -> f64 {
    let half = b * bin * std::f64::consts::LN_10 / 2.0;
    let factor = if half == 0.0 { 1.0 } else { half.sinh() / half };
    b * factor / (n as f64).sqrt()
}

fn b_positive(magnitudes: &[f64], bin: f64) -> Option<BValue> {
    // the smallest difference that counts is one bin
    let floor = if bin > 0.0 { bin } else { 0.0 };
    let differences: Vec<f64> =
        magnitudes.windows(2).map(|pair| pair[1] - pair[0]).filter(|&d| d > 0.0 && d >= floor - 1e-9).collect();
    if differences.len() < FEWEST {
        return None;
    }
    let excess = mean(&differences) - floor;
    let b = binned_b(excess, bin);
    (excess > 0.0).then(|| BValue::new(b, tinti_error(b, bin, differences.len()), differences.len()))
}

/// Centre (lower edge, for exact magnitudes) of the bin that holds most.
fn fullest_bin(magnitudes: &[f64], bin: f64, centred: bool) -> f64 {
    let number = |m: &f64| if centred { (m / bin).round() } else { (m / bin).floor() };
    let mut bins: Vec<f64> = magnitudes.iter().map(number).collect();
    bins.sort_unstable_by(f64::total_cmp);
    let fullest = bins.chunk_by(|a, b| a == b).max_by_key(|same| same.len());
    fullest.and_then(|same| same.first()).map_or(0.0, |number| number * bin)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emission::close;
    use crate::emission::samples::{cutoff_sample, pareto_sample};
    use crate::progress::Unobserved;

    #[test]
    fn the_map_is_flat_for_a_power_law_and_climbs_to_a_cutoff() {
        let flat = exponent_map(&Sample::Exact(pareto_sample(5000, 2.0, 1.0, 1)), Model::PowerLaw, 12).unwrap();
        assert!(flat.iter().all(|point| (point.alpha - 2.0).abs() < 3.5 * point.alpha_se.unwrap()), "{flat:?}");
        let sample = Sample::Exact(cutoff_sample(5000, 1.35, 0.1, 0.003, 1));
        let climbing = exponent_map(&sample, Model::PowerLaw, 12).unwrap();
        // 1 + 1/E[ln(x/xmin)] at xmin = 0.03 cutoff, by mpmath: 1.757; a pure power law is that far off
        close(climbing[0].alpha, 1.757, 0.04);
        assert!(climbing[9].alpha > 2.0);
        let cutoff = exponent_map(&sample, Model::CutoffPowerLaw, 12).unwrap();
        assert!((cutoff[0].alpha - 1.35).abs() < 3.0 * cutoff[0].alpha_se.unwrap());
        assert!(exponent_map(&sample, Model::Lognormal, 12).unwrap_err().to_string().starts_with("model is lognormal"));
    }

    #[test]
    fn the_widest_range_is_the_one_that_was_made() {
        // a power law of exponent 1.5 from 1 to 100, with an exponential body below 1 and nothing above
        let mut x: Vec<f64> = pareto_sample(8000, 1.5, 1.0, 2).into_iter().filter(|&x| x <= 100.0).collect();
        x.extend((0..6000).map(|i| 0.1 + 0.9 * f64::from(i) / 6000.0));
        x.sort_by(f64::total_cmp);
        let map = corral_deluca(&Sample::Exact(x), 10, 50, 1, &Unobserved).unwrap();
        let widest = map.widest.unwrap();
        assert!((0.9..2.5).contains(&widest.xmin) && widest.xmax.unwrap() > 40.0, "{widest:?}");
        close(widest.alpha, 1.5, 3.0 * widest.alpha_se.unwrap() + 0.03);
    }

    #[test]
    fn b_values_of_four_magnitudes_by_hand_and_of_a_power_law() {
        let magnitudes: Vec<f64> = (0..40).map(|i| [1.0, 1.2, 1.1, 1.5][i % 4]).collect();
        let b = b_values(&magnitudes, 0.1, Some(1.0)).unwrap();
        // mean 1.2: b = 0.4342945 / (0.2 + 0.05), ln(1 + 0.1/0.2) / (0.1 ln 10)
        close(b.aki_utsu.b, 1.737_177_927_613_007, 1e-9);
        close(b.tinti_mulargia.b, 1.760_912_590_556_812_5, 1e-9);
        // squares 0.14 a quartet: ln 10 b^2 sqrt(1.4 / (40 x 39))
        close(b.aki_utsu.se, 10f64.ln() * b.aki_utsu.b.powi(2) * (1.4_f64 / 1560.0).sqrt(), 1e-9);
        // differences 0.2, 0.4 (and -0.1, -0.5): mean 0.3 above a floor of 0.1
        close(b.b_positive.unwrap().b, (1.0_f64 + 0.1 / 0.2).ln() / (0.1 * 10f64.ln()), 1e-9);
        let mut sample = pareto_sample(20_000, 2.0, 1.0, 4);
        // any order but the sorted one
        sample.sort_by(|a, b| (a * 1e6).fract().total_cmp(&(b * 1e6).fract()));
        let logs: Vec<f64> = sample.iter().map(|x| x.log10()).collect();
        let exact = b_values(&logs, 0.0, Some(0.0)).unwrap();
        for value in [exact.aki_utsu, exact.tinti_mulargia, exact.b_positive.unwrap()] {
            close(value.b, 1.0, 4.0 * value.se);
        }
        let rounded: Vec<f64> = logs.iter().map(|m| (m * 10.0).round() / 10.0).collect();
        let binned = b_values(&rounded, 0.1, Some(0.1)).unwrap();
        close(binned.tinti_mulargia.b, 1.0, 4.0 * binned.tinti_mulargia.se);
        close(binned.b_positive.unwrap().b, 1.0, 4.0 * binned.b_positive.unwrap().se);
        // below 0.1 only half of the lowest bin is there, so the fullest one is 0.1
        close(b_values(&rounded, 0.1, None).unwrap().completeness, 0.05, 1e-9);
    }
}

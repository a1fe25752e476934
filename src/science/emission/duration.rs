//! Mean duration of avalanches against their amplitude, and the damping behind it.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::error::{EmissionError, positive};
use super::numerics::{Z95, line, mean, quantile, standard_deviation};
use super::special::normal_cdf;
use crate::progress::Progress;

/// Whether averaging the durations of a bin is sensible.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct CentralLimit {
    /// True where the means of subsamples shrink as m^-1/2, are normal at 5 %, and the tail index is above 2.
    pub holds: bool,
    /// Slope of ln(standard deviation of the means of m events) against ln m: -0.5 is to be expected.
    pub shrinkage: f64,
    /// Anderson-Darling statistic of 20 means for a normal distribution of unknown mean and variance, corrected for their number;
    /// above 0.752 it is rejected at 5 % (Stephens 1974, J. Am. Stat. Assoc. 69, 730-737).
    pub anderson_darling: f64,
    /// Hill's tail index of the largest tenth: the variance is finite above 2.
    pub tail_index: f64,
}

/// Durations of the events of one range of amplitudes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct DurationBin {
    /// Lower edge, V.
    pub from_v: f64,
    /// Upper edge, V.
    pub to_v: f64,
    /// Geometric mean of the amplitudes, V.
    pub amplitude_v: f64,
    /// Events.
    pub events: usize,
    /// Mean duration, us.
    pub mean_us: f64,
    /// Standard error of the mean, s/sqrt n, us.
    pub se_us: f64,
    /// Median duration, us: to be used where the central limit theorem does not hold.
    pub median_us: f64,
    /// The verdict; missing for fewer than 80 events.
    pub central_limit: Option<CentralLimit>,
}

/// What [`duration_scaling`] finds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct DurationScaling {
    /// Bins of amplitude with at least the fewest events asked for, rising.
    pub bins: Vec<DurationBin>,
    /// Threshold amplitude A_th in use, V.
    pub threshold_v: f64,
    /// Damping g of d = (1/g) ln(A0/A_th), 1/s.
    pub damping_per_s: f64,
    /// Its standard error.
    pub damping_se_per_s: f64,
    /// 95 % interval of the damping.
    pub ci95: [f64; 2],
    /// Events above the threshold.
    pub events: usize,
}

/// How durations are binned.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(default, deny_unknown_fields)]
pub struct DurationOptions {
    /// Bins a decade of amplitude.
    pub bins_per_decade: u32,
    /// Fewest events of a bin.
    pub fewest: usize,
    /// Threshold A_th, V; none takes that of the metadata, or the smallest amplitude.
    pub threshold_v: Option<f64>,
}

impl Default for DurationOptions {
    fn default() -> Self {
        Self { bins_per_decade: 5, fewest: 20, threshold_v: None }
    }
}

impl DurationOptions {
    pub(super) fn check(&self) -> Result<(), EmissionError> {
        if !(1..=100).contains(&self.bins_per_decade) {
            return Err(EmissionError::option("bins_per_decade", self.bins_per_decade, "1 to 100"));
        }
        if self.fewest < 2 {
            return Err(EmissionError::option("fewest", self.fewest, "a whole number of at least 2"));
        }
        self.threshold_v.map(|value| positive("threshold_v", value)).transpose().map(|_| ())
    }
}

/// Mean duration (us) against amplitude (V), and the damping by least squares through the origin of d against ln(A0/A_th), with
/// a standard error that allows for a spread that grows with the amplitude (White 1980, Econometrica 48, 817-838).
///
/// # Errors
/// Options out of range, fewer than 20 events above the threshold, or [`EmissionError::Cancelled`].
pub fn duration_scaling(
    amplitude_v: &[f64],
    duration_us: &[f64],
    options: &DurationOptions,
    seed: u64,
    progress: &dyn Progress,
) -> Result<DurationScaling, EmissionError> {
    options.check()?;
    let smallest = amplitude_v.iter().copied().fold(f64::INFINITY, f64::min);
    let threshold = options.threshold_v.unwrap_or(smallest);
    let mut pairs: Vec<(f64, f64)> = amplitude_v.iter().copied().zip(duration_us.iter().copied()).collect();
    pairs.retain(|pair| pair.0 > threshold);
    const NEEDED: usize = 20;
    if pairs.len() < NEEDED {
        return Err(EmissionError::TooFewEvents { what: "duration_scaling", found: pairs.len(), needed: NEEDED });
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (damping, se) = damping(&pairs, threshold)?;
    let per_decade = f64::from(options.bins_per_decade);
    let number = |amplitude: f64| ((amplitude / threshold).log10() * per_decade).floor();
    let edge = |number: f64| threshold * 10f64.powf(number / per_decade);
    let groups = pairs.chunk_by(|a, b| number(a.0) == number(b.0));
    let bins = groups.filter(|group| group.len() >= options.fewest).map(|group| {
        if progress.cancelled() {
            return Err(EmissionError::Cancelled);
        }
        let which = number(group[0].0);
        Ok(bin(group, edge(which), edge(which + 1.0), seed))
    });
    Ok(DurationScaling {
        bins: bins.collect::<Result<_, _>>()?,
        threshold_v: threshold,
        damping_per_s: damping,
        damping_se_per_s: se,
        ci95: [damping - Z95 * se, damping + Z95 * se],
        events: pairs.len(),
    })
}

/// Damping (1/s) and its standard error.
fn damping(pairs: &[(f64, f64)], threshold: f64) -> Result<(f64, f64), EmissionError> {
    let logs = || pairs.iter().map(|&(amplitude, duration)| ((amplitude / threshold).ln(), duration * 1e-6));
    let squares: f64 = logs().map(|(log, _)| log * log).sum();
    let slope = logs().map(|(log, duration)| log * duration).sum::<f64>() / squares;
    if !(slope > 0.0 && slope.is_finite()) {
        return Err(EmissionError::Degenerate { what: "the durations" });
    }
    let variance: f64 = logs().map(|(log, duration)| (log * (duration - slope * log)).powi(2)).sum();
    let slope_se = variance.sqrt() / squares;
    Ok((1.0 / slope, slope_se / (slope * slope)))
}

fn bin(group: &[(f64, f64)], from_v: f64, to_v: f64, seed: u64) -> DurationBin {
    let durations: Vec<f64> = group.iter().map(|pair| pair.1).collect();
    let logs: Vec<f64> = group.iter().map(|pair| pair.0.ln()).collect();
    let mut sorted = durations.clone();
    sorted.sort_by(f64::total_cmp);
    let n = durations.len();
    DurationBin {
        from_v,
        to_v,
        amplitude_v: mean(&logs).exp(),
        events: n,
        mean_us: mean(&durations),
        se_us: standard_deviation(&durations) / (n as f64).sqrt(),
        median_us: quantile(&sorted, 0.5),
        central_limit: central_limit(&durations, seed),
    }
}

/// Means in the test for normality; each must hold at least four events.
const MEANS: usize = 20;

/// Whether means of `values` behave as the central limit theorem says; they are shuffled with `seed` first, as neighbours in
/// amplitude or time resemble each other. `None` for fewer than 80 values.
#[must_use]
pub fn central_limit(values: &[f64], seed: u64) -> Option<CentralLimit> {
    if values.len() < 4 * MEANS {
        return None;
    }
    let mut shuffled = values.to_vec();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    for i in (1..shuffled.len()).rev() {
        shuffled.swap(i, rng.random_range(0..=i));
    }
    let means = |m: usize| -> Vec<f64> { shuffled.chunks_exact(m).map(mean).collect() };
    let (mut sizes, mut spreads) = (Vec::new(), Vec::new());
    let mut m = 1;
    while shuffled.len() / m >= MEANS {
        sizes.push((m as f64).ln());
        spreads.push(standard_deviation(&means(m)).ln());
        m *= 2;
    }
    // of k means the logarithm of the spread has the variance 1/(2k)
    let weights: Vec<f64> = sizes.iter().map(|size| (-size).exp()).collect();
    let shrinkage = line(&sizes, &spreads, &weights).map_or(f64::NAN, |line| line.slope);
    let anderson_darling = normality(&means(shuffled.len() / MEANS));
    let tail_index = hill(&shuffled);
    // the last spread, of 20 means, alone is uncertain by 16 %
    let holds = (shrinkage + 0.5).abs() < 0.2 && anderson_darling < 0.752 && tail_index > 2.0;
    Some(CentralLimit { holds, shrinkage, anderson_darling, tail_index })
}

/// Anderson & Darling's statistic for normality with unknown mean and variance, times 1 + 0.75/n + 2.25/n^2 (Stephens 1986).
fn normality(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let (centre, spread) = (mean(values), standard_deviation(values));
    let mut z: Vec<f64> = values.iter().map(|x| (x - centre) / spread).collect();
    z.sort_by(f64::total_cmp);
    let term = |i: usize| {
        let weight = (2 * i + 1) as f64;
        weight * (normal_cdf(z[i]).ln() + normal_cdf(-z[z.len() - 1 - i]).ln())
    };
    let sum: f64 = (0..z.len()).map(term).sum();
    (-n - sum / n) * (1.0 + 0.75 / n + 2.25 / (n * n))
}

/// Hill's estimate of the tail index from the largest tenth (Hill 1975, Ann. Stat. 3, 1163-1174).
fn hill(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(|a, b| b.total_cmp(a));
    let k = (values.len() / 10).max(8).min(values.len() - 1);
    let sum: f64 = sorted[..k].iter().map(|x| (x / sorted[k]).ln()).sum();
    k as f64 / sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emission::catalogue::Column;
    use crate::emission::close;
    use crate::emission::samples::pareto_sample;
    use crate::emission::synthetic::{SyntheticOptions, synthetic};
    use crate::progress::Unobserved;

    #[test]
    fn anderson_darling_agrees_with_scipy() {
        // SciPy 1.17.1: anderson(x, 'norm').statistic, times the factor of Stephens
        let x = [2.1, 3.4, 1.9, 5.6, 4.4, 3.8, 2.7, 9.1, 3.3, 4.0];
        close(normality(&x) / (1.0 + 0.075 + 0.0225), 0.6264315471233033, 1e-9);
    }

    #[test]
    fn the_verdict_knows_finite_from_infinite_variance() {
        // a uniform distribution, and a Pareto of tail index 1.2
        let uniform: Vec<f64> = (0..2000).map(|i| 1.0 + f64::from(i) / 2000.0).collect();
        let verdict = central_limit(&uniform, 1).unwrap();
        assert!(verdict.holds, "{verdict:?}");
        close(verdict.shrinkage, -0.5, 0.1);
        let wild = central_limit(&pareto_sample(2000, 2.2, 1.0, 1), 1).unwrap();
        assert!(!wild.holds && wild.tail_index < 1.6, "{wild:?}");
        assert_eq!(central_limit(&uniform[..79], 1), None);
    }

    #[test]
    fn the_damping_comes_back_within_its_error() {
        for (temperature_c, grain_size_mm) in [(-10.0, None), (-3.0, None), (-10.0, Some(0.26))] {
            let options = SyntheticOptions { events: 20_000, temperature_c, grain_size_mm, ..Default::default() };
            let (catalogue, truth) = synthetic(&options, 1).unwrap();
            let (amplitude, duration) =
                (catalogue.amplitudes_v("x").unwrap(), catalogue.column(Column::DurationUs).unwrap());
            let options = DurationOptions { threshold_v: Some(truth.threshold_v), ..Default::default() };
            let scaling = duration_scaling(&amplitude, duration, &options, 1, &Unobserved).unwrap();
            close(scaling.damping_per_s, truth.damping_per_s, 4.0 * scaling.damping_se_per_s);
            assert!(scaling.damping_se_per_s < 0.02 * truth.damping_per_s);
            assert!(scaling.bins.len() > 5 && scaling.bins.iter().all(|bin| bin.events >= 20));
            assert!(scaling.bins.windows(2).all(|pair| pair[1].mean_us > pair[0].mean_us));
        }
    }

    #[test]
    fn bins_say_mean_error_and_median_by_hand() {
        // 1 V and 3 V events above 0.5 V
        let amplitude: Vec<f64> = (0..60).map(|i| if i % 2 == 0 { 1.0 } else { 3.0 }).collect();
        let duration: Vec<f64> = (0..60).map(|i| if i % 2 == 0 { 10.0 + f64::from(i % 4) } else { 30.0 }).collect();
        let options = DurationOptions { threshold_v: Some(0.5), bins_per_decade: 2, ..Default::default() };
        let scaling = duration_scaling(&amplitude, &duration, &options, 1, &Unobserved).unwrap();
        let bin = scaling.bins[0];
        assert_eq!((bin.events, bin.mean_us, bin.median_us), (30, 11.0, 11.0));
        // fifteen each of 10 and 12: s^2 = 30/29
        close(bin.se_us, (1.0_f64 / 29.0).sqrt(), 1e-12);
        close(bin.from_v, 0.5, 1e-12);
        assert!(duration_scaling(&amplitude[..5], &duration[..5], &options, 1, &Unobserved).is_err());
    }
}

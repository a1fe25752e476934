//! Waiting times between events, and whether they come at random.

use serde::{Deserialize, Serialize};

use super::error::EmissionError;
use super::numerics::{log_spaced, mean, quantile, standard_deviation};
use super::special::chi_square_survival;
use crate::progress::Progress;

/// A point of a density.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct DensityPoint {
    /// Lower edge of the bin.
    pub from: f64,
    /// Upper edge of the bin.
    pub to: f64,
    /// Events in the bin.
    pub events: usize,
    /// Probability density, in the inverse unit of the edges.
    pub density: f64,
    /// Its standard error from the Poisson number of events.
    pub error: f64,
}

/// The density of positive `values` in `per_decade` bins of equal ratio; empty bins are left out, values of 0 count in the total only.
#[must_use]
pub fn log_density(values: &[f64], per_decade: u32) -> Vec<DensityPoint> {
    let total = values.len() as f64;
    let per_decade = f64::from(per_decade.max(1));
    let mut numbers: Vec<f64> =
        values.iter().filter(|&&x| x > 0.0 && x.is_finite()).map(|x| (x.log10() * per_decade).floor()).collect();
    numbers.sort_unstable_by(f64::total_cmp);
    let point = |same: &[f64]| {
        let [from, to] = [same[0], same[0] + 1.0].map(|number| 10f64.powf(number / per_decade));
        let events = same.len() as f64;
        let scale = total * (to - from);
        DensityPoint { from, to, events: same.len(), density: events / scale, error: events.sqrt() / scale }
    };
    numbers.chunk_by(|a, b| a == b).map(point).collect()
}

/// Waiting times between events of at least one amplitude.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct WaitingTimes {
    /// Smallest amplitude, V.
    pub threshold_v: f64,
    /// Waiting times.
    pub intervals: usize,
    /// Mean waiting time, s.
    pub mean_s: f64,
    /// Standard deviation over mean: 1 for a Poisson process, more for clusters.
    pub variation: f64,
    /// Density, s^-1 against s.
    pub density: Vec<DensityPoint>,
    /// Test for a Poisson process of constant rate.
    pub poisson: PoissonTest,
}

/// Whether events come at a constant rate and independently.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct PoissonTest {
    /// Kolmogorov-Smirnov distance of the times from uniform ones: sees a change of rate.
    pub uniform_distance: f64,
    /// Its probability (Stephens 1970, J. R. Stat. Soc. B 32, 115-122).
    pub uniform_p: f64,
    /// Index of dispersion of counts in equal windows of about 10 events: 1 for a Poisson process.
    pub dispersion: f64,
    /// Two-sided probability of such a dispersion, by chi-square.
    pub dispersion_p: f64,
    /// True where neither is rejected at 5 % (each at 2.5 %).
    pub is_poisson: bool,
}

/// Events below which there is nothing to say.
const FEWEST: usize = 30;

/// Waiting times of the events with an amplitude of at least each of `thresholds_v`; thresholds with fewer than 30 events are left out.
///
/// `times_s` do not fall; `thresholds_v` empty takes the quantiles 0, 0.5, 0.75 and 0.9 of the amplitudes.
///
/// # Errors
/// A threshold that is not finite, fewer than 30 events at every threshold, or [`EmissionError::Cancelled`].
pub fn waiting_times(
    times_s: &[f64],
    amplitude_v: &[f64],
    thresholds_v: &[f64],
    progress: &dyn Progress,
) -> Result<Vec<WaitingTimes>, EmissionError> {
    check(thresholds_v)?;
    let mut sorted = amplitude_v.to_vec();
    sorted.sort_by(f64::total_cmp);
    let quantiles = [0.0, 0.5, 0.75, 0.9].map(|q| quantile(&sorted, q));
    let thresholds = if thresholds_v.is_empty() { &quantiles[..] } else { thresholds_v };
    let mut found = Vec::new();
    for &threshold in thresholds {
        if progress.cancelled() {
            return Err(EmissionError::Cancelled);
        }
        found.extend(above(times_s, amplitude_v, threshold));
    }
    if found.is_empty() {
        let most = thresholds.iter().map(|t| amplitude_v.iter().filter(|a| *a >= t).count()).max().unwrap_or(0);
        return Err(EmissionError::TooFewEvents { what: "waiting_times", found: most, needed: FEWEST });
    }
    Ok(found)
}

/// Whether `thresholds_v` can be used.
pub(super) fn check(thresholds_v: &[f64]) -> Result<(), EmissionError> {
    match thresholds_v.iter().find(|value| !value.is_finite()) {
        Some(value) => Err(EmissionError::option("thresholds_v", value, "finite amplitudes")),
        None => Ok(()),
    }
}

fn above(times: &[f64], amplitudes: &[f64], threshold: f64) -> Option<WaitingTimes> {
    let chosen: Vec<f64> = times.iter().zip(amplitudes).filter(|(_, a)| **a >= threshold).map(|pair| *pair.0).collect();
    if chosen.len() < FEWEST || chosen.first() == chosen.last() {
        return None;
    }
    let intervals: Vec<f64> = chosen.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let mean_s = mean(&intervals);
    Some(WaitingTimes {
        threshold_v: threshold,
        intervals: intervals.len(),
        mean_s,
        variation: standard_deviation(&intervals) / mean_s,
        density: log_density(&intervals, 5),
        poisson: poisson_test(&chosen),
    })
}

/// Tests rising `times` (at least three, not all equal), whose first and last mark the observed span.
#[must_use]
pub fn poisson_test(times: &[f64]) -> PoissonTest {
    let (start, end) = (times[0], times[times.len() - 1]);
    let inner = &times[1..times.len() - 1];
    let n = inner.len() as f64;
    let deviation = |(j, time): (usize, &f64)| {
        let f = (time - start) / (end - start);
        (f - j as f64 / n).max((j as f64 + 1.0) / n - f)
    };
    let uniform_distance = inner.iter().enumerate().map(deviation).fold(0.0, f64::max);
    let windows = (inner.len() / 10).max(2);
    let mut counts = vec![0.0; windows];
    for time in inner {
        let window = ((time - start) / (end - start) * windows as f64) as usize;
        counts[window.min(windows - 1)] += 1.0;
    }
    let degrees = windows as f64 - 1.0;
    let dispersion = standard_deviation(&counts).powi(2) / mean(&counts);
    let above = chi_square_survival(dispersion * degrees, degrees);
    let dispersion_p = (2.0 * above.min(1.0 - above)).min(1.0);
    let uniform_p = kolmogorov(uniform_distance * (n.sqrt() + 0.12 + 0.11 / n.sqrt()));
    let is_poisson = uniform_p > 0.025 && dispersion_p > 0.025;
    PoissonTest { uniform_distance, uniform_p, dispersion, dispersion_p, is_poisson }
}

/// Survival function of the Kolmogorov distribution.
pub(super) fn kolmogorov(x: f64) -> f64 {
    if x < 0.2 {
        return 1.0;
    }
    let term = |k: i32| (if k % 2 == 1 { 2.0 } else { -2.0 }) * (-2.0 * f64::from(k * k) * x * x).exp();
    (1..=100).map(term).sum::<f64>().clamp(0.0, 1.0)
}

/// `count` bins in equal ratios that cover positive `values`, for plots of several densities over one another.
#[must_use]
pub fn common_edges(values: &[f64], count: usize) -> Vec<f64> {
    let positive = || values.iter().copied().filter(|x| *x > 0.0 && x.is_finite());
    let (low, high) = (positive().fold(f64::INFINITY, f64::min), positive().fold(0.0, f64::max));
    if high > low { log_spaced(low, high * (1.0 + 1e-9), count + 1) } else { Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emission::catalogue::Column;
    use crate::emission::close;
    use crate::emission::synthetic::{Clustering, SyntheticOptions, synthetic};
    use crate::progress::Unobserved;

    #[test]
    fn the_kolmogorov_distribution_agrees_with_scipy() {
        // SciPy 1.17.1: special.kolmogorov
        for (x, p) in [
            (0.5, 0.9639452436648751),
            (0.8, 0.5441424115741981),
            (1.36, 0.049485876755377876),
            (2.0, 0.0006709252557796953),
        ] {
            close(kolmogorov(x), p, 1e-12);
        }
    }

    #[test]
    fn a_poisson_process_is_kept_and_clusters_are_not() {
        let of = |clustering, hardening, seed| {
            let options = SyntheticOptions { events: 3000, clustering, hardening, ..Default::default() };
            let catalogue = synthetic(&options, seed).unwrap().0;
            let times = catalogue.column(Column::TimeS).unwrap().to_vec();
            waiting_times(&times, &catalogue.amplitudes_v("x").unwrap(), &[], &Unobserved).unwrap()
        };
        let kept = (0..40).filter(|&seed| of(None, 1.0, seed)[0].poisson.is_poisson).count();
        assert!(kept >= 34, "{kept} of 40");
        let poisson = of(None, 1.0, 1);
        assert_eq!(poisson.len(), 4);
        assert!(poisson.iter().all(|w| (w.variation - 1.0).abs() < 0.12), "{poisson:?}");
        close(poisson[0].mean_s, 3600.0 / 3000.0, 0.01);
        let clustering = Some(Clustering { branching_ratio: 0.6, c_s: 0.1, p: 1.3 });
        let clustered = of(clustering, 1.0, 1);
        assert!(!clustered[0].poisson.is_poisson && clustered[0].variation > 1.3, "{:?}", clustered[0].poisson);
        let hardening = of(None, 0.3, 1);
        assert!(hardening[0].poisson.uniform_p < 1e-6);
    }

    #[test]
    fn a_density_integrates_to_one() {
        let values: Vec<f64> = (1..=1000).map(|i| f64::from(i).powi(2)).collect();
        let density = log_density(&values, 5);
        close(density.iter().map(|p| p.density * (p.to - p.from)).sum(), 1.0, 1e-12);
        assert_eq!(density.iter().map(|p| p.events).sum::<usize>(), 1000);
        let edges = common_edges(&values, 10);
        assert!(edges.len() == 11 && edges[0] <= 1.0 && edges[10] >= 1e6);
    }

    #[test]
    fn too_little_is_refused() {
        assert!(waiting_times(&[0.0; 40], &[1.0; 40], &[], &Unobserved).is_err());
        let few = waiting_times(&[0.0, 1.0], &[1.0, 1.0], &[], &Unobserved).unwrap_err();
        assert!(few.to_string().starts_with("waiting_times: 2"));
        assert!(waiting_times(&[0.0], &[1.0], &[f64::NAN], &Unobserved).is_err());
    }
}

//! Correlation integral of positions: how the sources cluster in space.
//!
//! `C(r) = 2 N(r) / (N (N - 1))` with N(r) the pairs at most r apart (Grassberger & Procaccia 1983, Physica D 9, 189-208). Where C ~ r^D
//! the points have the correlation dimension D. A finite sample of any shape bends C; a uniform sample in the same box bends it
//! the same way, and D is read from the ratio of the two.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::error::{EmissionError, positive};
use super::numerics::{line, log_spaced};
use super::pairs::PairCounter;
use crate::progress::Progress;

/// What to compute.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(default, deny_unknown_fields)]
pub struct CorrelationOptions {
    /// Radii, in equal ratios.
    pub radii: usize,
    /// Smallest radius, m; none takes twice the location error, but no less than a thousandth of the largest extent.
    pub r_min_m: Option<f64>,
    /// Largest radius, m; none takes half of the largest extent.
    pub r_max_m: Option<f64>,
    /// Largest radius of the fit, m; none takes a tenth of the largest extent: beyond, the shape of the sample shows.
    pub fit_max_m: Option<f64>,
    /// Uniform samples that the null is averaged over.
    pub nulls: usize,
}

impl Default for CorrelationOptions {
    fn default() -> Self {
        Self { radii: 40, r_min_m: None, r_max_m: None, fit_max_m: None, nulls: 4 }
    }
}

/// The correlation integral at one radius.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct CorrelationPoint {
    /// Radius, m.
    pub r_m: f64,
    /// Radius in mean grain sizes, where that is known.
    pub r_grains: Option<f64>,
    /// Pairs of at most that distance.
    pub pairs: u64,
    /// Correlation integral.
    pub c: f64,
    /// That of the null.
    pub c_null: f64,
    /// d ln C / d ln r; missing where a neighbour holds no pair.
    pub local_slope: Option<f64>,
    /// The same of the null.
    pub null_slope: Option<f64>,
}

/// What [`correlation_integral`] finds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct CorrelationIntegral {
    /// Located events.
    pub events: usize,
    /// Coordinates that have an extent.
    pub embedding: usize,
    /// A line a radius.
    pub points: Vec<CorrelationPoint>,
    /// Correlation dimension: the embedding plus the slope of ln(C / C_null) against ln r.
    pub dimension: f64,
    /// Standard error of that slope from the scatter about the line: neighbouring radii share pairs, so it is too small.
    pub dimension_se: f64,
    /// Slope of ln C against ln r alone.
    pub raw_slope: f64,
    /// Takens' estimate between the smallest and the largest fitted radius (Takens 1985; Theiler 1988, Phys. Lett. A 133, 195).
    pub takens: f64,
    /// Radii of the fit, m.
    pub fitted_m: [f64; 2],
}

/// Points of a null: enough for C(r) at the radii of the fit.
const NULL_POINTS: usize = 10_000;
/// Pairs below which a radius is left out of the fit.
const FEWEST_PAIRS: u64 = 50;
const FEWEST_EVENTS: usize = 50;

/// The correlation integral of `positions` (m), with `location_error_m` (standard error of a coordinate) setting the smallest radius
/// and `grain_size_m` the unit of the results.
///
/// # Errors
/// Options out of range, fewer than 50 positions or positions without an extent, or [`EmissionError::Cancelled`].
pub fn correlation_integral(
    positions: &[[f64; 3]],
    location_error_m: Option<f64>,
    grain_size_m: Option<f64>,
    options: &CorrelationOptions,
    seed: u64,
    progress: &dyn Progress,
) -> Result<CorrelationIntegral, EmissionError> {
    const WHAT: &str = "correlation_integral";
    if positions.len() < FEWEST_EVENTS {
        return Err(EmissionError::TooFewEvents { what: WHAT, found: positions.len(), needed: FEWEST_EVENTS });
    }
    let (low, extent) = bounding_box(positions);
    let largest = extent.iter().copied().fold(0.0, f64::max);
    if largest <= 0.0 {
        return Err(EmissionError::Degenerate { what: "the positions" });
    }
    let radii = radii(options, location_error_m, largest)?;
    let counter = PairCounter::new(&radii);
    let counts = counter.count(positions, progress, "pairs")?;
    let null = null(&counter, low, extent, positions.len(), options.nulls, seed, progress)?;
    let pairs_of = |n: usize| n as f64 * (n as f64 - 1.0) / 2.0;
    let c: Vec<f64> = counts.iter().map(|&count| count as f64 / pairs_of(positions.len())).collect();
    let embedding = extent.iter().filter(|&&extent| extent > 1e-6 * largest).count();
    let (slopes, null_slopes) = (local_slopes(&radii, &c), local_slopes(&radii, &null));
    let points: Vec<CorrelationPoint> = (0..radii.len())
        .map(|k| CorrelationPoint {
            r_m: radii[k],
            r_grains: grain_size_m.map(|grain| radii[k] / grain),
            pairs: counts[k],
            c: c[k],
            c_null: null[k],
            local_slope: slopes[k],
            null_slope: null_slopes[k],
        })
        .collect();
    let fit_max = positive("fit_max_m", options.fit_max_m.unwrap_or(0.1 * largest))?;
    let is_usable = |point: &&CorrelationPoint| {
        point.pairs >= FEWEST_PAIRS && point.c_null > 0.0 && point.r_m <= fit_max * (1.0 + 1e-9)
    };
    let usable: Vec<&CorrelationPoint> = points.iter().filter(is_usable).collect();
    let failed = EmissionError::TooFewEvents { what: "pairs of a slope", found: usable.len(), needed: 3 };
    let (first, last) = usable.first().zip(usable.last()).ok_or_else(|| failed.clone())?;
    let log_r: Vec<f64> = usable.iter().map(|point| point.r_m.ln()).collect();
    // a null of few pairs is uncertain: weights are its number of pairs, up to where that no longer matters
    let weights: Vec<f64> = usable.iter().map(|point| weight(point, positions.len(), options.nulls)).collect();
    let slope = |value: &dyn Fn(&CorrelationPoint) -> f64| {
        let y: Vec<f64> = usable.iter().map(|point| value(point)).collect();
        line(&log_r, &y, &weights)
    };
    let ratio = slope(&|point| (point.c / point.c_null).ln()).ok_or_else(|| failed.clone())?;
    let raw = slope(&|point| point.c.ln()).ok_or(failed)?;
    Ok(CorrelationIntegral {
        events: positions.len(),
        embedding,
        dimension: embedding as f64 + ratio.slope,
        dimension_se: ratio.slope_se,
        raw_slope: raw.slope,
        takens: takens(&usable),
        fitted_m: [first.r_m, last.r_m],
        points,
    })
}

/// Whether `options` can be used on `positions`.
pub(super) fn check(
    positions: &[[f64; 3]],
    location_error_m: Option<f64>,
    options: &CorrelationOptions,
) -> Result<(), EmissionError> {
    let (_, extent) = bounding_box(positions);
    let largest = extent.iter().copied().fold(0.0, f64::max);
    if largest <= 0.0 {
        return Err(EmissionError::Degenerate { what: "the positions" });
    }
    options.fit_max_m.map(|fit_max| positive("fit_max_m", fit_max)).transpose()?;
    radii(options, location_error_m, largest).map(|_| ())
}

fn weight(point: &CorrelationPoint, n: usize, nulls: usize) -> f64 {
    let n = n.min(NULL_POINTS) as f64;
    let null_pairs = point.c_null * n * (n - 1.0) / 2.0 * nulls as f64;
    // relative variances: of Poisson numbers of pairs, and 1e-3 for what the model leaves out
    1.0 / (1e-3 + 1.0 / null_pairs + 1.0 / point.pairs as f64)
}

fn bounding_box(positions: &[[f64; 3]]) -> ([f64; 3], [f64; 3]) {
    let mut low = [f64::INFINITY; 3];
    let mut high = [f64::NEG_INFINITY; 3];
    for position in positions {
        for k in 0..3 {
            low[k] = low[k].min(position[k]);
            high[k] = high[k].max(position[k]);
        }
    }
    (low, [high[0] - low[0], high[1] - low[1], high[2] - low[2]])
}

fn radii(options: &CorrelationOptions, error: Option<f64>, largest: f64) -> Result<Vec<f64>, EmissionError> {
    if !(4..=200).contains(&options.radii) {
        return Err(EmissionError::option("radii", options.radii, "4 to 200"));
    }
    if !(1..=100).contains(&options.nulls) {
        return Err(EmissionError::option("nulls", options.nulls, "1 to 100"));
    }
    let r_min = positive("r_min_m", options.r_min_m.unwrap_or((2.0 * error.unwrap_or(0.0)).max(1e-3 * largest)))?;
    let r_max = positive("r_max_m", options.r_max_m.unwrap_or(0.5 * largest))?;
    if r_max < 1.5 * r_min {
        let accepted = format!("a radius of at least 1.5 times the smallest, {r_min} m");
        return Err(EmissionError::option("r_max_m", r_max, accepted));
    }
    Ok(log_spaced(r_min, r_max, options.radii))
}

/// Mean correlation integral of uniform samples in the box.
fn null(
    counter: &PairCounter,
    low: [f64; 3],
    extent: [f64; 3],
    events: usize,
    nulls: usize,
    seed: u64,
    progress: &dyn Progress,
) -> Result<Vec<f64>, EmissionError> {
    let n = events.min(NULL_POINTS);
    let one = |stream: usize| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(stream as u64);
        let mut point = || [0, 1, 2].map(|k| low[k] + extent[k] * rng.random::<f64>());
        let points: Vec<[f64; 3]> = (0..n).map(|_| point()).collect();
        counter.count(&points, progress, "uniform null")
    };
    let counts: Vec<Vec<u64>> = (0..nulls).into_par_iter().map(one).collect::<Result<_, _>>()?;
    let pairs = n as f64 * (n as f64 - 1.0) / 2.0 * nulls as f64;
    let sum = |k: usize| counts.iter().map(|counts| counts[k]).sum::<u64>() as f64;
    Ok((0..counts[0].len()).map(|k| sum(k) / pairs).collect())
}

fn local_slopes(radii: &[f64], c: &[f64]) -> Vec<Option<f64>> {
    let last = radii.len() - 1;
    let slope = |k: usize| {
        let (a, b) = (k.saturating_sub(1), (k + 1).min(last));
        (c[a] > 0.0).then(|| (c[b] / c[a]).ln() / (radii[b] / radii[a]).ln())
    };
    (0..=last).map(slope).collect()
}

/// `(C(r_1) - C(r_0)) / integral of C(r)/r`, with C a power law between the radii.
fn takens(points: &[&CorrelationPoint]) -> f64 {
    let integral: f64 = points
        .windows(2)
        .map(|pair| {
            let (width, rise) = ((pair[1].r_m / pair[0].r_m).ln(), (pair[1].c / pair[0].c).ln());
            if rise < 1e-9 { pair[0].c * width } else { (pair[1].c - pair[0].c) * width / rise }
        })
        .sum();
    points.first().zip(points.last()).map_or(f64::NAN, |(first, last)| (last.c - first.c) / integral)
}

#[cfg(test)]
mod tests;

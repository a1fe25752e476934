//! Correlation integral of positions: how the sources cluster in space.
//!
//! `C(r) = 2 N(r) / (N (N - 1))` with N(r) the pairs at most r apart (Grassberger & Procaccia 1983, Physica D 9, 189-208). Where C ~ r^D
//! the points have the correlation dimension D. A finite sample of any shape bends C at its borders. The null is a uniform sample
//! of the same box, of which C is known exactly; but its bend is that of a set without gaps, and dividing by it takes a set with
//! gaps for larger in dimension than it is (by 0.05 at D = 2.5 and a tenth of the sample). D is therefore read from the pairs
//! whose first point is at least r away from the border: there the null is a power of r, with the exponent of the embedding, and its
//! slope is taken off without a bend.
//!
//! Pairs share points, so their numbers are not independent: the error is a jackknife over the points (Efron & Stein 1981, Ann.
//! Statist. 9, 586), to which the scatter about the line comes, which is what a set does that is only a power law on the average.

use serde::{Deserialize, Serialize};

use super::error::{EmissionError, positive};
use super::numerics::{Line, line, log_spaced};
use super::pairs::{Blocks, Interior};
use crate::progress::Progress;

/// What to compute.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(default, deny_unknown_fields)]
pub struct CorrelationOptions {
    /// Radii, in equal ratios.
    pub radii: usize,
    /// Smallest radius, m; none takes 4 times the location error, but no less than a thousandth of the largest extent.
    pub r_min_m: Option<f64>,
    /// Largest radius, m; none takes half of the largest extent.
    pub r_max_m: Option<f64>,
    /// Largest radius of the fit, m; none takes a tenth of the largest extent, but no more than a quarter of the smallest.
    pub fit_max_m: Option<f64>,
}

impl Default for CorrelationOptions {
    fn default() -> Self {
        Self { radii: 40, r_min_m: None, r_max_m: None, fit_max_m: None }
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
    /// That of the null: uniform in the same box.
    pub c_null: f64,
    /// The same from the pairs whose first point is at least the radius away from the border; missing beyond the fit.
    pub c_interior: Option<f64>,
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
    /// Correlation dimension: the embedding plus how much steeper ln C of the interior is than that of the null.
    pub dimension: f64,
    /// Its standard error: of the points that happened to be there, and of the scatter about the line.
    pub dimension_se: f64,
    /// Slope of ln C against ln r alone, at the same radii.
    pub raw_slope: f64,
    /// Takens' estimate between the smallest and the largest fitted radius (Takens 1985; Theiler 1988, Phys. Lett. A 133, 195).
    pub takens: f64,
    /// Radii of the fit, m.
    pub fitted_m: [f64; 2],
}

/// Pairs below which a radius is left out of the fit.
const FEWEST_PAIRS: u64 = 50;
/// Points away from the border below which a radius is left out of the fit.
const FEWEST_CENTRES: u64 = 20;
const FEWEST_EVENTS: usize = 50;
/// Relative variance of a number of pairs beyond that of chance: no radius has more weight than 1e4 pairs give it.
const MODEL_VARIANCE: f64 = 1e-4;

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
    let axes: Vec<usize> = (0..3).filter(|&k| extent[k] > FLAT * largest).collect();
    let extents: Vec<f64> = axes.iter().map(|&k| extent[k]).collect();
    let smallest = extents.iter().copied().fold(f64::INFINITY, f64::min);
    let radii = radii(options, location_error_m, largest)?;
    let fit_max = positive("fit_max_m", options.fit_max_m.unwrap_or((0.1 * largest).min(0.25 * smallest)))?;
    let near: Vec<f64> = radii.iter().copied().filter(|&r| r <= fit_max * (1.0 + 1e-9)).collect();
    let border = |point: &[f64; 3]| {
        let to_border = axes.iter().map(|&k| (point[k] - low[k]).min(low[k] + extent[k] - point[k]));
        to_border.fold(f64::INFINITY, f64::min)
    };
    let border: Vec<f64> = positions.iter().map(border).collect();
    let blocks = Blocks::new(positions);
    let interior = blocks.interior(&near, &border, progress)?;
    let pairs = blocks.count(&radii, progress)?;
    let n = positions.len() as f64;
    let c: Vec<f64> = pairs.iter().map(|&pairs| 2.0 * pairs as f64 / (n * (n - 1.0))).collect();
    let c_null: Vec<f64> = radii.iter().map(|&r| uniform_share(&extents, r)).collect();
    let (slopes, null_slopes) = (local_slopes(&radii, &c), local_slopes(&radii, &c_null));
    let of_interior = |k: usize| {
        let (centres, pairs) = (*interior.centres.get(k)?, *interior.pairs.get(k)?);
        (centres > 0).then(|| pairs as f64 / (centres as f64 * (n - 1.0)))
    };
    let points: Vec<CorrelationPoint> = (0..radii.len())
        .map(|k| CorrelationPoint {
            r_m: radii[k],
            r_grains: grain_size_m.map(|grain| radii[k] / grain),
            pairs: pairs[k],
            c: c[k],
            c_null: c_null[k],
            c_interior: of_interior(k),
            local_slope: slopes[k],
            null_slope: null_slopes[k],
        })
        .collect();
    let usable: Vec<usize> = (0..near.len())
        .filter(|&k| interior.centres[k] >= FEWEST_CENTRES && interior.pairs[k] >= 2 * FEWEST_PAIRS)
        .collect();
    let failed = EmissionError::TooFewEvents { what: "pairs of a slope", found: usable.len(), needed: 3 };
    let fit = Fit::new(&near, &usable, &interior).ok_or_else(|| failed.clone())?;
    let raw = fit.slope(&usable.iter().map(|&k| c[k].ln()).collect::<Vec<f64>>()).ok_or(failed)?;
    let chosen: Vec<&CorrelationPoint> = usable.iter().map(|&k| &points[k]).collect();
    let takens = takens(&chosen);
    let fitted_m = [chosen[0].r_m, chosen[chosen.len() - 1].r_m];
    Ok(CorrelationIntegral {
        events: positions.len(),
        embedding: axes.len(),
        dimension: fit.line.slope,
        dimension_se: fit.standard_error(&interior),
        raw_slope: raw.slope,
        takens,
        fitted_m,
        points,
    })
}

/// An extent of less than this share of the largest is none: positions in a plane have only their rounding beside it.
const FLAT: f64 = 1e-9;

/// The line through ln C of the interior.
struct Fit<'a> {
    usable: &'a [usize],
    log_r: Vec<f64>,
    weights: Vec<f64>,
    log_c: Vec<f64>,
    line: Line,
}

impl<'a> Fit<'a> {
    /// The line through the radii that are `usable`; none with fewer than 3.
    fn new(radii: &[f64], usable: &'a [usize], interior: &Interior) -> Option<Self> {
        let log_r: Vec<f64> = usable.iter().map(|&k| radii[k].ln()).collect();
        let weight = |&k: &usize| 1.0 / (MODEL_VARIANCE + 2.0 / interior.pairs[k] as f64);
        let weights: Vec<f64> = usable.iter().map(weight).collect();
        let log = |&k: &usize| (interior.pairs[k] as f64 / interior.centres[k] as f64).ln();
        let log_c: Vec<f64> = usable.iter().map(log).collect();
        let line = line(&log_r, &log_c, &weights)?;
        Some(Self { usable, log_r, weights, log_c, line })
    }

    fn slope(&self, log_c: &[f64]) -> Option<Line> {
        line(&self.log_r, log_c, &self.weights)
    }

    /// Standard error of the slope.
    fn standard_error(&self, interior: &Interior) -> f64 {
        (self.chance(interior) + self.misfit()).sqrt()
    }

    /// By how much the slope grows with ln C at each radius.
    fn leverage(&self) -> Vec<f64> {
        let total: f64 = self.weights.iter().sum();
        let centre = self.log_r.iter().zip(&self.weights).map(|(x, w)| w * x).sum::<f64>() / total;
        let spread: f64 = self.log_r.iter().zip(&self.weights).map(|(x, w)| w * (x - centre) * (x - centre)).sum();
        self.log_r.iter().zip(&self.weights).map(|(x, w)| w * (x - centre) / spread).collect()
    }

    /// Variance of the slope by which points happened to be there: the jackknife over sets of points, to first order, without
    /// the share of single pairs that it counts twice.
    fn chance(&self, interior: &Interior) -> f64 {
        let leverage = self.leverage();
        let of_set = |(centres, pairs): (&Vec<u64>, &Vec<u64>)| {
            let part = |(&k, a): (&usize, &f64)| {
                let (pairs, centres) = (pairs[k] as f64, centres[k] as f64);
                a * (pairs / interior.pairs[k] as f64 - centres / interior.centres[k] as f64)
            };
            self.usable.iter().zip(&leverage).map(part).sum::<f64>().powi(2)
        };
        let sets: f64 = interior.set_centres.iter().zip(&interior.set_pairs).map(of_set).sum();
        // a pair moves ln C of every radius from its distance on
        let mut single = 0.0;
        let mut of_pair = 0.0;
        for (at, (&k, a)) in self.usable.iter().zip(&leverage).enumerate().rev() {
            of_pair += a / interior.pairs[k] as f64;
            let below = if at > 0 { interior.pairs[self.usable[at - 1]] } else { 0 };
            single += 2.0 * interior.pairs[k].saturating_sub(below) as f64 * of_pair * of_pair;
        }
        (sets - single).max(0.5 * sets)
    }

    /// Variance of the slope by the scatter about the line, which is not independent from radius to radius.
    fn misfit(&self) -> f64 {
        let residuals: Vec<f64> =
            (self.log_r.iter().zip(&self.log_c)).map(|(x, y)| y - self.line.intercept - self.line.slope * x).collect();
        let squares: f64 = residuals.iter().map(|r| r * r).sum();
        let products: f64 = residuals.windows(2).map(|pair| pair[0] * pair[1]).sum();
        let correlation = if squares > 0.0 { (products / squares).clamp(0.0, 0.9) } else { 0.0 };
        self.line.slope_se.powi(2) * (1.0 + correlation) / (1.0 - correlation)
    }
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
    let r_min = positive("r_min_m", options.r_min_m.unwrap_or((4.0 * error.unwrap_or(0.0)).max(1e-3 * largest)))?;
    let r_max = positive("r_max_m", options.r_max_m.unwrap_or(0.5 * largest))?;
    if r_max < 1.5 * r_min {
        let accepted = format!("a radius of at least 1.5 times the smallest, {r_min} m");
        return Err(EmissionError::option("r_max_m", r_max, accepted));
    }
    Ok(log_spaced(r_min, r_max, options.radii))
}

/// Intervals of the numerical integrals of [`uniform_share`].
const INTERVALS: usize = 100;

/// Probability that two points, uniform in a box of the edges `extents` (one to three), are at most `r` apart. The difference of two
/// coordinates has a triangular density; one integral a further axis, by Simpson's rule in the angle, which takes the root out.
fn uniform_share(extents: &[f64], r: f64) -> f64 {
    let Some((&extent, others)) = extents.split_first() else { return 1.0 };
    let density = |d: f64| if d < extent { 2.0 * (extent - d) / (extent * extent) } else { 0.0 };
    if others.is_empty() {
        let share = (r / extent).min(1.0);
        return share * (2.0 - share);
    }
    // beyond the edge there is nothing to integrate
    let last = (extent / r).min(1.0).asin();
    let at = |k: usize| {
        let (sine, cosine) = (last * k as f64 / INTERVALS as f64).sin_cos();
        density(r * sine) * uniform_share(others, r * cosine) * r * cosine
    };
    let weight = |k: usize| if k == 0 || k == INTERVALS { 1.0 } else { 2.0 + 2.0 * (k % 2) as f64 };
    let sum: f64 = (0..=INTERVALS).map(|k| weight(k) * at(k)).sum();
    (sum * last / (3.0 * INTERVALS as f64)).min(1.0)
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

//! Several data sets side by side: fits and durations of each, collapse, one exponent for all, one distribution for all, and how
//! cut-off, exponent and damping go with grain size, temperature and stress.

use serde::{Deserialize, Serialize};

use super::distribution::{Fit, fit_sample};
use super::requests::{self, DistributionOptions};
use super::{AnalysisError, Part, durations};
use crate::emission::catalogue::Catalogue;
use crate::emission::duration::{DurationOptions, DurationScaling};
use crate::emission::error::EmissionError;
use crate::emission::numerics::Z95;
use crate::emission::sample::Sample;
use crate::emission::sets::{AndersonDarling, Collapse, CommonExponent, anderson_darling, collapse, common_exponent};
use crate::emission::special::chi_square_survival;
use crate::emission::tails::{Model, Parameter};
use crate::emission::waiting::DensityPoint;
use crate::progress::Progress;

const KIND: &str = "comparison";

/// Most data sets of a comparison.
pub const MOST_SETS: usize = 50;

/// How data sets are compared.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(default, deny_unknown_fields)]
pub struct ComparisonOptions {
    /// The fit of each data set.
    pub fit: DistributionOptions,
    /// The durations of each data set that has them.
    pub duration: DurationOptions,
    /// Smallest amplitude of the collapse and of the common distribution, V; none takes the largest of the smallest amplitudes.
    #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
    pub from_v: Option<f64>,
    /// Bins of the collapse, 2 to 500.
    #[cfg_attr(feature = "schema", schema(minimum = 2, maximum = 500, default = 30))]
    pub bins: usize,
}

impl Default for ComparisonOptions {
    fn default() -> Self {
        let (fit, duration) = (DistributionOptions::default(), DurationOptions::default());
        Self { fit, duration, from_v: None, bins: 30 }
    }
}

/// One data set of a comparison.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct SetSummary {
    /// Events.
    pub events: usize,
    /// Temperature, degC.
    pub temperature_c: Option<f64>,
    /// Mean grain size, mm; none for a single crystal.
    pub grain_size_mm: Option<f64>,
    /// Applied stress, MPa.
    pub stress_mpa: Option<f64>,
    /// Fit of the amplitudes.
    pub fit: Fit,
    /// Its parameters with errors and intervals.
    pub parameters: Vec<Parameter>,
    /// Log-binned density of the amplitudes, 1/V.
    pub density: Vec<DensityPoint>,
    /// Durations; missing without their column or with too few events.
    pub duration: Option<DurationScaling>,
}

/// A quantity of one data set against a condition of its test.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct TrendPoint {
    /// Number of the data set, from 0.
    pub set: usize,
    /// The condition.
    pub x: f64,
    /// The quantity.
    pub y: f64,
    /// Its 95 % interval.
    pub ci95: [f64; 2],
}

/// How a quantity goes with a condition of the tests.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Trend {
    /// cutoff_v, damping_per_s or alpha.
    pub quantity: String,
    /// grain_size_mm, temperature_c or stress_mpa.
    pub against: String,
    /// power (y ~ x^slope), exponential (y ~ exp(slope x)) or linear (y = intercept + slope x).
    pub law: String,
    /// A line a data set that has both.
    pub points: Vec<TrendPoint>,
    /// Weighted least squares: exponent, 1/degC, or units of y a unit of x. Missing with fewer than two different x.
    pub slope: Option<f64>,
    /// Its standard error from the errors of the points.
    pub slope_se: Option<f64>,
    /// 95 % interval; where it holds 0 no trend is seen.
    pub ci95: Option<[f64; 2]>,
    /// ln y, or y, at x = 1 (power) or x = 0.
    pub intercept: Option<f64>,
    /// Probability of such a scatter about the law, by chi-square; missing with two points. Below 0.05 the law does not hold.
    pub scatter_p: Option<f64>,
    /// True where the data sets differ in another condition too: the trend may be its.
    pub others_vary: bool,
}

/// What a comparison of data sets finds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct SetComparison {
    /// The data sets, in the order in which they were named.
    pub sets: Vec<SetSummary>,
    /// n(A)/N in common bins.
    pub collapse: Collapse,
    /// Whether all share one exponent of a pure power law, from the largest xmin on; missing where that cannot be fitted.
    pub common_exponent: Option<CommonExponent>,
    /// The same of a power law with a cut-off that is free in every set.
    pub common_exponent_with_cutoff: Option<CommonExponent>,
    /// Whether the amplitudes from `from_v` on have one distribution.
    pub distribution: AndersonDarling,
    /// Smallest amplitude of collapse and distribution, V.
    pub from_v: f64,
    /// Cut-off, damping and exponent against the conditions of the tests.
    pub trends: Vec<Trend>,
}

/// Whether `catalogues` can be compared, as far as that is known beforehand.
///
/// # Errors
/// Too few or too many data sets, options out of range (index 0), or a set without amplitudes or with too few events (its index).
pub fn check(catalogues: &[&Catalogue], options: &ComparisonOptions) -> Result<(), AnalysisError> {
    let at = |index: usize| move |error: EmissionError| AnalysisError { index, kind: KIND, error };
    let found = catalogues.len();
    if !(2..=MOST_SETS).contains(&found) {
        return Err(at(0)(EmissionError::option("datasets", found, format!("2 to {MOST_SETS} data sets"))));
    }
    requests::fit(&options.fit).and_then(|()| options.duration.check()).map_err(at(0))?;
    if !(2..=500).contains(&options.bins) {
        return Err(at(0)(EmissionError::option("bins", options.bins, "2 to 500")));
    }
    options.from_v.map(|from| crate::emission::error::positive("from_v", from)).transpose().map_err(at(0))?;
    for (index, catalogue) in catalogues.iter().enumerate() {
        let amplitudes = catalogue.amplitudes_v(KIND).map_err(at(index))?;
        const NEEDED: usize = 20;
        let found = amplitudes.iter().filter(|a| options.from_v.is_none_or(|from| **a >= from)).count();
        if found < NEEDED {
            let what = "amplitudes of a data set that is compared";
            return Err(at(index)(EmissionError::TooFewEvents { what, found, needed: NEEDED }));
        }
    }
    Ok(())
}

/// Compares `catalogues`; the same `seed` gives the same bits at any number of threads.
///
/// # Errors
/// As [`check`], a set that cannot be fitted (its index), or [`EmissionError::Cancelled`].
pub fn compare(
    catalogues: &[&Catalogue],
    options: &ComparisonOptions,
    seed: u64,
    progress: &dyn Progress,
) -> Result<SetComparison, AnalysisError> {
    check(catalogues, options)?;
    let failed = |index: usize| move |error: EmissionError| AnalysisError { index, kind: KIND, error };
    let mut sets = Vec::with_capacity(catalogues.len());
    for (index, catalogue) in catalogues.iter().enumerate() {
        let part = Part { whole: progress, index, parts: catalogues.len() };
        sets.push(summary(catalogue, options, seed, &part).map_err(failed(index))?);
        if progress.cancelled() {
            return Err(failed(index)(EmissionError::Cancelled));
        }
    }
    let mut sorted = Vec::with_capacity(catalogues.len());
    for (index, catalogue) in catalogues.iter().enumerate() {
        let mut amplitudes = catalogue.amplitudes_v(KIND).map_err(failed(index))?;
        amplitudes.sort_unstable_by(f64::total_cmp);
        sorted.push(amplitudes);
    }
    let smallest = sorted.iter().filter_map(|set| set.first().copied()).fold(0.0, f64::max);
    let from_v = options.from_v.unwrap_or(smallest);
    let slices: Vec<&[f64]> = sorted.iter().map(Vec::as_slice).collect();
    let above: Vec<&[f64]> = slices.iter().map(|set| &set[set.partition_point(|&x| x < from_v)..]).collect();
    let xmin = sets.iter().map(|set: &SetSummary| set.fit.xmin).fold(0.0, f64::max);
    Ok(SetComparison {
        collapse: collapse(&slices, from_v, options.bins).map_err(failed(0))?,
        common_exponent: common(catalogues, &options.fit, xmin, Model::PowerLaw),
        common_exponent_with_cutoff: common(catalogues, &options.fit, xmin, Model::CutoffPowerLaw),
        distribution: anderson_darling(&above).map_err(failed(0))?,
        from_v,
        trends: trends(&sets),
        sets,
    })
}

fn sample(catalogue: &Catalogue, options: &DistributionOptions) -> Result<Sample, EmissionError> {
    catalogue.amplitude_sample(options.db_step, options.rounding, KIND)
}

fn summary(
    catalogue: &Catalogue,
    options: &ComparisonOptions,
    seed: u64,
    progress: &dyn Progress,
) -> Result<SetSummary, EmissionError> {
    let found = fit_sample(&sample(catalogue, &options.fit)?, &options.fit, seed, progress)?;
    let metadata = &catalogue.metadata;
    Ok(SetSummary {
        events: catalogue.len(),
        temperature_c: metadata.temperature_c,
        grain_size_mm: metadata.grain_size_mm,
        stress_mpa: metadata.stress_mpa,
        fit: found.fit,
        parameters: found.parameters,
        density: found.density,
        duration: durations(catalogue, &options.duration, seed, progress).ok(),
    })
}

fn common(catalogues: &[&Catalogue], options: &DistributionOptions, xmin: f64, model: Model) -> Option<CommonExponent> {
    let tail = |catalogue: &&Catalogue| sample(catalogue, options).ok()?.tail(Some(xmin), options.xmax).ok();
    let tails: Vec<_> = catalogues.iter().map(tail).collect::<Option<_>>()?;
    common_exponent(&tails, model).ok()
}

/// The law that a quantity is drawn against a condition with.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Law {
    Power,
    Exponential,
    Linear,
}

impl Law {
    const fn name(self) -> &'static str {
        match self {
            Self::Power => "power",
            Self::Exponential => "exponential",
            Self::Linear => "linear",
        }
    }

    fn x(self, x: f64) -> f64 {
        if self == Self::Power { x.ln() } else { x }
    }

    fn y(self, y: f64) -> f64 {
        if self == Self::Linear { y } else { y.ln() }
    }
}

/// A condition of a test, by its name.
type Condition = (&'static str, fn(&SetSummary) -> Option<f64>);
/// A quantity of a data set with its 95 % interval, by its name.
type Quantity = (&'static str, fn(&SetSummary) -> Option<(f64, [f64; 2])>);

const CONDITIONS: [Condition; 3] = [
    ("grain_size_mm", |set| set.grain_size_mm),
    ("temperature_c", |set| set.temperature_c),
    ("stress_mpa", |set| set.stress_mpa),
];

fn cutoff(set: &SetSummary) -> Option<(f64, [f64; 2])> {
    let cutoff = set.parameters.iter().find(|parameter| parameter.name == "cutoff")?;
    Some((cutoff.value, [cutoff.lower95?, cutoff.upper95?]))
}

fn damping(set: &SetSummary) -> Option<(f64, [f64; 2])> {
    set.duration.as_ref().map(|duration| (duration.damping_per_s, duration.ci95))
}

fn alpha(set: &SetSummary) -> Option<(f64, [f64; 2])> {
    Some((set.fit.alpha?, set.fit.ci95?))
}

/// Quantities, conditions and laws that are drawn: a power of grain size, an exponential of temperature, as activated processes
/// have over a few degrees, and a line for the exponent, which should not change.
fn trends(sets: &[SetSummary]) -> Vec<Trend> {
    const QUANTITIES: [Quantity; 3] = [("cutoff_v", cutoff), ("damping_per_s", damping), ("alpha", alpha)];
    let mut found = Vec::new();
    for (quantity, of) in QUANTITIES {
        for (condition, x) in CONDITIONS {
            let law = match (quantity, condition) {
                ("alpha", _) | (_, "stress_mpa") => Law::Linear,
                (_, "grain_size_mm") => Law::Power,
                _ => Law::Exponential,
            };
            let point = |(set, summary): (usize, &SetSummary)| {
                let (y, ci95) = of(summary)?;
                Some(TrendPoint { set, x: x(summary)?, y, ci95 })
            };
            let points: Vec<TrendPoint> = sets.iter().enumerate().filter_map(point).collect();
            let differ = points.iter().any(|point| point.x != points[0].x);
            if differ {
                let others_vary = CONDITIONS.iter().any(|other| other.0 != condition && varies(sets, &points, other.1));
                found.push(trend(quantity, condition, law, points, others_vary));
            }
        }
    }
    found
}

/// Whether the sets of `points` differ in a condition.
fn varies(sets: &[SetSummary], points: &[TrendPoint], of: fn(&SetSummary) -> Option<f64>) -> bool {
    let mut values = points.iter().map(|point| of(&sets[point.set]));
    let first = values.next().flatten();
    values.any(|value| value != first)
}

fn trend(quantity: &str, against: &str, law: Law, points: Vec<TrendPoint>, others_vary: bool) -> Trend {
    let mut trend = Trend {
        quantity: quantity.to_owned(),
        against: against.to_owned(),
        law: law.name().to_owned(),
        points,
        slope: None,
        slope_se: None,
        ci95: None,
        intercept: None,
        scatter_p: None,
        others_vary,
    };
    // an interval that reaches 0 has no logarithm: such a point says nothing of a power or an exponential
    let usable = |point: &&TrendPoint| point.y.is_finite() && law.y(point.ci95[0]).is_finite();
    let values: Vec<(f64, f64, f64)> = trend
        .points
        .iter()
        .filter(usable)
        .map(|point| {
            let se = (law.y(point.ci95[1]) - law.y(point.ci95[0])) / (2.0 * Z95);
            (law.x(point.x), law.y(point.y), 1.0 / (se * se))
        })
        .filter(|value| value.2.is_finite() && value.2 > 0.0)
        .collect();
    let total: f64 = values.iter().map(|value| value.2).sum();
    let mean = |of: fn(&(f64, f64, f64)) -> f64| values.iter().map(|value| of(value) * value.2).sum::<f64>() / total;
    let (mx, my) = (mean(|value| value.0), mean(|value| value.1));
    let sxx: f64 = values.iter().map(|value| value.2 * (value.0 - mx).powi(2)).sum();
    let sxy: f64 = values.iter().map(|value| value.2 * (value.0 - mx) * (value.1 - my)).sum();
    if values.len() < 2 || !(sxx > 0.0 && sxx.is_finite()) {
        return trend;
    }
    let (slope, se) = (sxy / sxx, sxx.sqrt().recip());
    let chi_square: f64 = values.iter().map(|value| value.2 * (value.1 - my - slope * (value.0 - mx)).powi(2)).sum();
    trend.slope = Some(slope);
    trend.slope_se = Some(se);
    trend.ci95 = Some([slope - Z95 * se, slope + Z95 * se]);
    trend.intercept = Some(my - slope * mx);
    trend.scatter_p = (values.len() > 2).then(|| chi_square_survival(chi_square, values.len() as f64 - 2.0));
    trend
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emission::close;
    use crate::emission::synthetic::{SyntheticOptions, synthetic};
    use crate::progress::Unobserved;

    fn options() -> ComparisonOptions {
        let fit = DistributionOptions { replicates: Some(0), xmin: Some(0.0032), ..Default::default() };
        ComparisonOptions { fit, ..Default::default() }
    }

    fn catalogues(conditions: &[(f64, Option<f64>)]) -> Vec<Catalogue> {
        let make = |(seed, &(temperature_c, grain_size_mm)): (usize, &(f64, Option<f64>))| {
            let options = SyntheticOptions {
                events: 5000,
                temperature_c,
                grain_size_mm,
                clip_v: 1e9,
                ..SyntheticOptions::default()
            };
            synthetic(&options, seed as u64).unwrap().0
        };
        conditions.iter().enumerate().map(make).collect()
    }

    fn run(conditions: &[(f64, Option<f64>)]) -> SetComparison {
        let sets = catalogues(conditions);
        compare(&sets.iter().collect::<Vec<_>>(), &options(), 1, &Unobserved).unwrap()
    }

    fn of<'a>(found: &'a SetComparison, quantity: &str, against: &str) -> &'a Trend {
        found.trends.iter().find(|trend| trend.quantity == quantity && trend.against == against).unwrap()
    }

    #[test]
    fn the_cutoff_of_polycrystals_grows_with_the_grain_and_their_exponent_does_not() {
        let found = run(&[(-10.0, Some(0.26)), (-10.0, Some(0.87)), (-10.0, Some(1.92)), (-10.0, Some(5.02))]);
        // the generator: A_c = 0.1 V x grain / 0.87 mm, tau = 1.35
        let cutoff = of(&found, "cutoff_v", "grain_size_mm");
        close(cutoff.slope.unwrap(), 1.0, 3.0 * cutoff.slope_se.unwrap());
        assert!(cutoff.slope_se.unwrap() < 0.1 && cutoff.scatter_p.unwrap() > 0.01 && !cutoff.others_vary);
        close(cutoff.intercept.unwrap(), (0.1_f64 / 0.87).ln(), 0.2);
        let common = found.common_exponent_with_cutoff.as_ref().unwrap();
        close(common.alpha, 1.35, 0.05);
        assert!(common.p_value > 0.01, "{common:?}");
        assert!(found.common_exponent.as_ref().unwrap().p_value < 1e-6, "pure power laws would differ");
        assert!(found.collapse.scatter.unwrap() > 3.0 && found.distribution.p_value < 0.01);
        // finer grains damp more: g = 5000 (1 + 0.87 / grain)
        assert!(of(&found, "damping_per_s", "grain_size_mm").ci95.unwrap()[1] < 0.0);
        let alpha = of(&found, "alpha", "grain_size_mm");
        assert!(alpha.ci95.unwrap()[0] < 0.01 && alpha.ci95.unwrap()[1] > -0.01, "{alpha:?}");
    }

    #[test]
    fn single_crystals_collapse_whatever_the_temperature_and_their_damping_does_not() {
        let found = run(&[(-3.0, None), (-10.0, None), (-20.0, None)]);
        let scatter = found.collapse.scatter.unwrap();
        assert!((0.3..2.0).contains(&scatter), "{scatter}");
        let common = found.common_exponent.as_ref().unwrap();
        close(common.alpha, 2.0, 0.06);
        assert!(common.p_value > 0.01 && found.distribution.p_value > 0.01);
        // the generator: g = 5000 exp((T + 10)/20)
        let damping = of(&found, "damping_per_s", "temperature_c");
        close(damping.slope.unwrap(), 0.05, 3.0 * damping.slope_se.unwrap());
        assert_eq!((damping.law.as_str(), damping.points.len()), ("exponential", 3));
        assert!(found.trends.iter().all(|trend| trend.against != "grain_size_mm"));
    }

    #[test]
    fn what_varies_besides_is_said_and_nonsense_is_refused() {
        let found = run(&[(-3.0, Some(0.26)), (-10.0, Some(0.87))]);
        assert!(of(&found, "damping_per_s", "temperature_c").others_vary);
        assert_eq!(of(&found, "damping_per_s", "temperature_c").scatter_p, None);
        let sets = catalogues(&[(-10.0, None)]);
        let one = check(&[&sets[0]], &options()).unwrap_err();
        assert!(one.to_string().contains("datasets is 1: 2 to 50"), "{one}");
        let bins = ComparisonOptions { bins: 1, ..options() };
        assert!(check(&[&sets[0], &sets[0]], &bins).unwrap_err().to_string().contains("bins is 1"));
        let high = ComparisonOptions { from_v: Some(1e6), ..options() };
        let few = check(&[&sets[0], &sets[0]], &high).unwrap_err();
        assert!(few.to_string().contains("0 event(s), at least 20"), "{few}");
    }
}

//! What is drawn of one analysis, and of a data set.

use super::{
    Figure, Plot,
    axes::{Axis, number},
    plot::{Corner, Mark, Point, Series},
};
use crate::science::emission::{
    activity::{Abscissa, Activity},
    aftershocks::Aftershocks,
    analysis::{DistributionResult, MapResult, Outcome, PhaseComparison, WaitingResult, density},
    catalogue::{Catalogue, Column},
    correlation::CorrelationIntegral,
    duration::DurationScaling,
    tails::Rounding,
    waiting::{DensityPoint, log_density},
};

/// Of what the figures are.
struct Of<'a> {
    prefix: &'a str,
    dataset: String,
}

impl Of<'_> {
    fn figure(&self, name: &str, mut plot: Plot) -> Figure {
        plot.subtitle = if plot.subtitle.is_empty() {
            self.dataset.clone()
        } else {
            format!("{}   |   {}", self.dataset, plot.subtitle)
        };
        Figure::new(format!("{}{name}", self.prefix), plot)
    }
}

/// What a data set is called below a title.
pub(super) fn named(name: &str, synthetic: bool) -> String {
    if synthetic { format!("{name} (synthetic)") } else { name.to_owned() }
}

/// The figures of an analysis; `prefix` begins their names.
#[must_use]
pub fn of_outcome(prefix: &str, outcome: &Outcome, dataset: &str, synthetic: bool) -> Vec<Figure> {
    let of = Of { prefix, dataset: named(dataset, synthetic) };
    match outcome {
        Outcome::AmplitudeDistribution(found) => distribution(&of, found, "amplitude", "A₀", "V"),
        Outcome::EnergyDistribution(found) => distribution(&of, found, "energy", "E", "eu"),
        Outcome::DurationScaling(found) => vec![of.figure("duration", duration(found))],
        Outcome::CorrelationIntegral(found) => correlation(&of, found),
        Outcome::WaitingTimes(found) => vec![of.figure("waiting-times", waiting(found))],
        Outcome::Aftershocks(found) => vec![of.figure("aftershocks", aftershocks(found))],
        Outcome::Activity(found) => activity(&of, found),
        Outcome::ExponentMap(found) => map(&of, found),
        Outcome::PhaseComparison(found) => phases(&of, found),
        Outcome::MonteCarloValidation(_) | Outcome::SourceModel(_) | Outcome::Calibration(_) => Vec::new(),
    }
}

/// The middle of a bin on a logarithmic axis.
fn middle(point: &DensityPoint) -> f64 {
    (point.from * point.to).sqrt()
}

pub(super) fn density_points(density: &[DensityPoint]) -> Vec<Point> {
    density.iter().map(|point| Point::with_error(middle(point), point.density, point.error)).collect()
}

/// An estimate with its standard error, in as many digits as that deserves.
pub(super) fn with_error(value: f64, se: Option<f64>) -> String {
    match se {
        Some(se) if se > 0.0 && se.is_finite() => {
            let decimals = (1.0 - se.log10().floor()).clamp(0.0, 6.0) as usize;
            format!("{value:.decimals$} ± {se:.decimals$}")
        }
        _ => format!("{value:.3}"),
    }
}

/// A probability that was found by counting replicates: of none there is only a bound.
fn probability(p: f64, replicates: usize) -> String {
    if p > 0.0 { format!("p = {p:.3}") } else { format!("p < {}", rounded(1.0 / replicates.max(1) as f64)) }
}

/// A number in two significant digits.
fn rounded(value: f64) -> String {
    let power = 10f64.powf(value.abs().log10().floor() - 1.0);
    number(if power > 0.0 { (value / power).round() * power } else { value })
}

fn distribution(of: &Of<'_>, found: &DistributionResult, what: &str, symbol: &str, unit: &str) -> Vec<Figure> {
    let fit = &found.fit;
    let mut told = vec![fit.model.name().replace('_', " ")];
    told.extend(fit.alpha.map(|alpha| format!("exponent {}", with_error(alpha, fit.alpha_se))));
    told.extend(fit.cutoff.map(|cutoff| format!("cut-off {cutoff:.3} {unit}")));
    told.extend(fit.p_value.map(|p| probability(p, fit.replicates)));
    let told = told.join(", ");
    let curve = |of: fn(&crate::science::emission::analysis::CurvePoint) -> Option<f64>| -> Vec<Point> {
        found.curve.iter().filter_map(|point| Some(Point::new(point.x, of(point)?))).collect()
    };
    let ccdf = found.ccdf.iter().map(|point| Point::new(point.x, point.ccdf)).collect();
    let x = || Axis::log(format!("{symbol} ({unit})"));
    let plot = |title: String, y: Axis, series: Vec<Series>| Plot {
        title,
        subtitle: told.clone(),
        x: x(),
        y,
        legend: Corner::UpperRight,
        series,
    };
    vec![
        of.figure(
            &format!("{what}-density"),
            plot(
                format!("Distribution of the {what}"),
                Axis::log(format!("P({symbol}) (1/{unit})")),
                vec![
                    Series::new("hits, log-binned", Mark::Dots, 0, density_points(&found.density)),
                    Series::new("fit", Mark::Line, 1, curve(|point| point.density)),
                ],
            ),
        ),
        of.figure(
            &format!("{what}-ccdf"),
            plot(
                format!("Share of hits with at least that {what}"),
                Axis::log(format!("share with {symbol} or more")),
                vec![
                    Series::new("hits", Mark::Dots, 0, ccdf),
                    Series::new("fit", Mark::Line, 1, curve(|point| Some(point.ccdf))),
                ],
            ),
        ),
    ]
}

/// Mean durations and the law through them, in one colour.
pub(super) fn duration_series(found: &DurationScaling, label: &str, colour: usize) -> Vec<Series> {
    let bins = found.bins.iter().map(|bin| Point::with_error(bin.amplitude_v, bin.mean_us, bin.se_us)).collect();
    let law = |amplitude: f64| 1e6 / found.damping_per_s * (amplitude / found.threshold_v).ln();
    let line = found.bins.iter().map(|bin| Point::new(bin.amplitude_v, law(bin.amplitude_v))).collect();
    vec![Series::new(label, Mark::Dots, colour, bins), Series::new("", Mark::Dashes, colour, line)]
}

fn duration(found: &DurationScaling) -> Plot {
    let mut series = duration_series(found, "mean of a bin ± standard error", 0);
    let median = found
        .bins
        .iter()
        .filter(|bin| bin.central_limit.is_some_and(|verdict| !verdict.holds))
        .map(|bin| Point::new(bin.amplitude_v, bin.median_us))
        .collect::<Vec<Point>>();
    if let Some(law) = series.last_mut() {
        law.label = Some("ln(A₀/A_th)/g".into());
        law.colour = 1;
    }
    if !median.is_empty() {
        series.push(Series::new("median, where means are not to be trusted", Mark::Dots, 3, median));
    }
    Plot {
        title: "Mean duration of avalanches".into(),
        subtitle: format!("damping g = {} 1/s", with_error(found.damping_per_s, Some(found.damping_se_per_s))),
        x: Axis::log("A₀ (V)"),
        y: Axis::linear("mean duration (µs)"),
        legend: Corner::UpperLeft,
        series,
    }
}

fn correlation(of: &Of<'_>, found: &CorrelationIntegral) -> Vec<Figure> {
    let points = |of: &dyn Fn(usize) -> Option<f64>| -> Vec<Point> {
        (0..found.points.len()).filter_map(|at| Some(Point::new(found.points[at].r_m, of(at)?))).collect()
    };
    let told = format!(
        "D = {}, fitted from {:.2} to {:.2} mm",
        with_error(found.dimension, Some(found.dimension_se)),
        found.fitted_m[0] * 1e3,
        found.fitted_m[1] * 1e3
    );
    // the line of the dimension through the middle of the fitted radii
    let inside: Vec<_> = found
        .points
        .iter()
        .filter(|point| (found.fitted_m[0]..=found.fitted_m[1]).contains(&point.r_m) && point.c > 0.0)
        .collect();
    let line = inside.get(inside.len() / 2).map_or_else(Vec::new, |anchor| {
        let c = |r: f64| anchor.c * (r / anchor.r_m).powf(found.raw_slope);
        inside.iter().map(|point| Point::new(point.r_m, c(point.r_m))).collect()
    });
    let slope = format!("slope {:.2} of ln C", found.raw_slope);
    vec![
        of.figure(
            "correlation-integral",
            Plot {
                title: "Correlation integral".into(),
                subtitle: told.clone(),
                x: Axis::log("r (m)"),
                y: Axis::log("C(r)"),
                legend: Corner::LowerRight,
                series: vec![
                    Series::new("hits", Mark::Dots, 0, points(&|at| Some(found.points[at].c))),
                    Series::new(
                        "uniform in the same box",
                        Mark::Dashes,
                        7,
                        points(&|at| Some(found.points[at].c_null)),
                    ),
                    Series::new(slope, Mark::Line, 1, line),
                ],
            },
        ),
        of.figure(
            "correlation-slope",
            Plot {
                title: "Local slope of the correlation integral".into(),
                subtitle: told,
                x: Axis::log("r (m)"),
                y: Axis::linear("d ln C / d ln r"),
                legend: Corner::LowerLeft,
                series: vec![
                    Series::new("hits", Mark::Dots, 0, points(&|at| found.points[at].local_slope)),
                    Series::new("uniform in the same box", Mark::Dashes, 7, points(&|at| found.points[at].null_slope)),
                ],
            },
        ),
    ]
}

fn waiting(found: &WaitingResult) -> Plot {
    let mut series = Vec::new();
    for (colour, times) in found.thresholds.iter().enumerate() {
        // in units of the mean, so that all thresholds fall together where only the rate differs
        let point = |point: &DensityPoint| {
            Point::with_error(middle(point) / times.mean_s, point.density * times.mean_s, point.error * times.mean_s)
        };
        let verdict = if times.poisson.is_poisson { "as at random" } else { "not at random" };
        let label = format!("A₀ ≥ {} V: {} intervals, {verdict}", rounded(times.threshold_v), times.intervals);
        series.push(Series::new(label, Mark::Dots, colour, times.density.iter().map(point).collect()));
    }
    let poisson = (0..=100).map(|step| 10f64.powf(-5.0 + 0.07 * f64::from(step)));
    let poisson = poisson.map(|x| Point::new(x, (-x).exp())).collect();
    series.push(Series::new("Poisson process", Mark::Dashes, 7, poisson));
    Plot {
        title: "Waiting times between hits".into(),
        subtitle: String::new(),
        x: Axis::log("waiting time / mean waiting time"),
        y: Axis::log("probability density × mean waiting time"),
        legend: Corner::UpperRight,
        series,
    }
}

fn aftershocks(found: &Aftershocks) -> Plot {
    let mut series = Vec::new();
    // an empty bin has no place on a logarithmic axis
    let classes = found.classes.iter().filter(|class| class.rate.iter().filter(|bin| bin.events > 0).count() >= 3);
    for (colour, class) in classes.enumerate() {
        let rate = class.rate.iter().filter(|bin| bin.events > 0);
        let points = rate.map(|bin| Point::with_error((bin.from_s * bin.to_s).sqrt(), bin.rate_per_s, bin.error_per_s));
        let to = class.to_v.map_or_else(|| "more".to_owned(), |to| format!("{} V", rounded(to)));
        // without an error the likelihood has its maximum at an end of what was searched: no exponent was found
        let omori = class.omori.filter(|omori| omori.p_se.is_some());
        let p = omori.map_or_else(String::new, |omori| format!(", p = {}", with_error(omori.p, omori.p_se)));
        let label = format!("{} V to {to}: {} main shocks{p}", rounded(class.from_v), class.main_shocks);
        series.push(Series::new(label, Mark::Dots, colour, points.collect()));
        if let Some(omori) = omori {
            let delays = (0..=60).map(|step| found.window_s * 10f64.powf(-4.0 + f64::from(step) / 15.0));
            let law = delays.map(|delay| Point::new(delay, omori.rate_per_s(delay))).collect();
            series.push(Series::new("", Mark::Line, colour, law));
        }
    }
    let exponent = found.productivity_exponent.map(|a| format!("productivity ~ A₀^{a:.2}"));
    Plot {
        title: "Rate of hits after main shocks".into(),
        subtitle: exponent.unwrap_or_default(),
        x: Axis::log("time since the main shock (s)"),
        y: Axis::log("hits a second and main shock"),
        legend: Corner::UpperRight,
        series,
    }
}

fn activity(of: &Of<'_>, found: &Activity) -> Vec<Figure> {
    let x = || match found.against {
        Abscissa::Strain => Axis::linear("strain"),
        Abscissa::Stress => Axis::linear("stress (MPa)"),
        Abscissa::Time => Axis::linear("time (s)"),
    };
    let rate_unit = match found.against {
        Abscissa::Strain => "hits per unit of strain",
        Abscissa::Stress => "hits per MPa",
        Abscissa::Time => "hits per second",
    };
    let told = format!("number ~ x^m, m = {}", with_error(found.exponent, Some(found.exponent_se)));
    let rate = found.points.iter().map(|point| Point::with_error(point.to, point.rate, point.rate_error)).collect();
    let total = found.points.last().map_or(1.0, |last| last.cumulative_events as f64);
    let volts = found.points.last().map_or(1.0, |last| last.cumulative_amplitude_v);
    let events = found.points.iter().map(|point| Point::new(point.to, point.cumulative_events as f64 / total));
    let amplitude = found.points.iter().map(|point| Point::new(point.to, point.cumulative_amplitude_v / volts));
    vec![
        of.figure(
            "activity-rate",
            Plot {
                title: "Activity".into(),
                subtitle: told.clone(),
                x: x(),
                y: Axis::linear(rate_unit),
                legend: Corner::UpperRight,
                series: vec![Series::new("", Mark::Dots, 0, rate)],
            },
        ),
        of.figure(
            "activity-cumulative",
            Plot {
                title: "Cumulative activity".into(),
                subtitle: told,
                x: x(),
                y: Axis::linear("share of the whole test"),
                legend: Corner::UpperLeft,
                series: vec![
                    Series::new(format!("hits ({total})"), Mark::Line, 0, events.collect()),
                    Series::new(format!("sum of amplitudes ({volts:.3} V)"), Mark::Dashes, 1, amplitude.collect()),
                ],
            },
        ),
    ]
}

fn map(of: &Of<'_>, found: &MapResult) -> Vec<Figure> {
    let point = |point: &crate::science::emission::maps::MapPoint| {
        let bar = point.ci95.map(|[low, high]| (low, high));
        Point { x: point.xmin, y: point.alpha, bar }
    };
    let mut figures = vec![of.figure(
        "exponent-map",
        Plot {
            title: "Exponent against the lower bound of the fit".into(),
            subtitle: String::new(),
            x: Axis::log("lower bound (V)"),
            y: Axis::linear("exponent"),
            legend: Corner::UpperLeft,
            series: vec![Series::new(
                "estimate with 95 % interval",
                Mark::Dots,
                0,
                found.map.iter().map(point).collect(),
            )],
        },
    )];
    if let Some(ranges) = &found.ranges {
        let of_range = |kept: bool| -> Vec<Point> {
            let of_kind = ranges.ranges.iter().filter(|range| range.p_value.is_some_and(|p| (p > 0.1) == kept));
            of_kind.filter_map(|range| Some(Point::new(range.xmin, range.xmax?))).collect()
        };
        let widest = ranges.widest.and_then(|widest| Some(Point::new(widest.xmin, widest.xmax?)));
        let told = ranges.widest.map_or_else(
            || "every range is rejected".to_owned(),
            |widest| format!("widest range: exponent {}", with_error(widest.alpha, widest.alpha_se)),
        );
        figures.push(of.figure(
            "exponent-ranges",
            Plot {
                title: "Ranges in which a power law is not rejected".into(),
                subtitle: told,
                x: Axis::log("lower bound (V)"),
                y: Axis::log("upper bound (V)"),
                legend: Corner::LowerRight,
                series: vec![
                    Series::new("rejected (p ≤ 0.1)", Mark::Dots, 7, of_range(false)),
                    Series::new("not rejected", Mark::Dots, 2, of_range(true)),
                    Series::new("the widest of them", Mark::Dots, 1, widest.into_iter().collect()),
                ],
            },
        ));
    }
    figures
}

fn phases(of: &Of<'_>, found: &PhaseComparison) -> Vec<Figure> {
    let durations = [("loading", &found.loading, 0), ("unloading", &found.unloading, 1)];
    let series: Vec<Series> = durations
        .into_iter()
        .filter_map(|(name, phase, colour)| Some(duration_series(phase.duration.as_ref()?, name, colour)))
        .flatten()
        .collect();
    if series.is_empty() {
        return Vec::new();
    }
    vec![of.figure(
        "phases-duration",
        Plot {
            title: "Mean duration while loading and unloading".into(),
            subtitle: String::new(),
            x: Axis::log("A₀ (V)"),
            y: Axis::linear("mean duration (µs)"),
            legend: Corner::UpperLeft,
            series,
        },
    )]
}

/// A picture of a data set: the distribution of its amplitudes, or else of the first column that has one.
#[must_use]
pub fn of_catalogue(catalogue: &Catalogue, name: &str, synthetic: bool) -> Option<Figure> {
    let of = Of { prefix: "", dataset: named(name, synthetic) };
    let subtitle = format!("{} hits", catalogue.len());
    let (title, symbol, points) = match catalogue.amplitude_sample(None, Rounding::Nearest, "picture") {
        Ok(sample) => ("Distribution of the amplitude", "A₀ (V)".to_owned(), density(&sample)),
        Err(_) => {
            let (column, values) = catalogue.columns().find(|(column, _)| !matches!(column, Column::Phase))?;
            ("Distribution of a column", format!("{} ({})", column.name(), column.unit()), log_density(values, 5))
        }
    };
    let points = density_points(&points);
    (!points.is_empty()).then(|| {
        of.figure(
            "picture",
            Plot {
                title: title.into(),
                subtitle,
                x: Axis::log(symbol),
                y: Axis::log("probability density (inverse unit)"),
                legend: Corner::UpperRight,
                series: vec![Series::new("", Mark::Dots, 0, points)],
            },
        )
    })
}

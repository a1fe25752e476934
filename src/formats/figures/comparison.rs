//! What is drawn of a comparison of data sets.

use super::{
    Figure, Plot,
    axes::Axis,
    outcomes::{density_points, duration_series, named, with_error},
    plot::{Corner, Mark, Point, Series},
};
use crate::science::emission::{
    analysis::compare::{SetComparison, Trend},
    sets::Collapse,
};

/// The figures of a comparison; `names` are those of the data sets.
#[must_use]
pub fn of_comparison(found: &SetComparison, names: &[&str], synthetic: bool) -> Vec<Figure> {
    let whole = named(&format!("{} data sets", names.len()), synthetic);
    let name = |set: usize| names.get(set).copied().unwrap_or_default().to_owned();
    let mut figures = vec![densities(found, &name, &whole), collapse(&found.collapse, &name, &whole)];
    figures.extend(durations(found, &name, &whole));
    figures.extend(found.trends.iter().filter(|trend| trend.points.len() > 1).map(|trend| self::trend(trend, &whole)));
    figures
}

fn densities(found: &SetComparison, name: &dyn Fn(usize) -> String, whole: &str) -> Figure {
    let series = found.sets.iter().enumerate().map(|(set, summary)| {
        let fit = summary.fit.alpha.map_or_else(String::new, |alpha| {
            format!(": {} {}", summary.fit.model.name().replace('_', " "), with_error(alpha, summary.fit.alpha_se))
        });
        Series::new(format!("{}{fit}", name(set)), Mark::Dots, set, density_points(&summary.density))
    });
    let plot = Plot {
        title: "Distributions of the amplitude".into(),
        subtitle: whole.to_owned(),
        x: Axis::log("A₀ (V)"),
        y: Axis::log("P(A₀) (1/V)"),
        legend: Corner::UpperRight,
        series: series.collect(),
    };
    Figure::new("densities", plot)
}

fn collapse(found: &Collapse, name: &dyn Fn(usize) -> String, whole: &str) -> Figure {
    let series = found.density.iter().zip(&found.error).enumerate().map(|(set, (density, error))| {
        let bins = found.edges.windows(2).zip(density.iter().zip(error));
        let points = bins.filter_map(|(edge, (density, error))| {
            Some(Point::with_error((edge[0] * edge[1]).sqrt(), (*density)?, (*error)?))
        });
        Series::new(name(set), Mark::Dots, set, points.collect())
    });
    let scatter = found.scatter.map(|scatter| format!("scatter {scatter:.2} of the Poisson one"));
    let plot = Plot {
        title: "Collapse of n(A₀)/N".into(),
        subtitle: [Some(whole.to_owned()), scatter].into_iter().flatten().collect::<Vec<_>>().join("   |   "),
        x: Axis::log("A₀ (V)"),
        y: Axis::log("n(A₀)/N (1/V)"),
        legend: Corner::UpperRight,
        series: series.collect(),
    };
    Figure::new("collapse", plot)
}

fn durations(found: &SetComparison, name: &dyn Fn(usize) -> String, whole: &str) -> Option<Figure> {
    let of = |(set, summary): (usize, &crate::science::emission::analysis::compare::SetSummary)| {
        Some(duration_series(summary.duration.as_ref()?, &name(set), set))
    };
    let series: Vec<Series> = found.sets.iter().enumerate().filter_map(of).flatten().collect();
    let plot = Plot {
        title: "Mean duration of avalanches".into(),
        subtitle: whole.to_owned(),
        x: Axis::log("A₀ (V)"),
        y: Axis::linear("mean duration (µs)"),
        legend: Corner::UpperLeft,
        series,
    };
    (!plot.series.is_empty()).then(|| Figure::new("durations", plot))
}

fn trend(found: &Trend, whole: &str) -> Figure {
    let (quantity, y) = match found.quantity.as_str() {
        "cutoff_v" => ("Cut-off", "cut-off (V)"),
        "damping_per_s" => ("Damping", "damping g (1/s)"),
        _ => ("Exponent", "exponent"),
    };
    let (condition, x) = match found.against.as_str() {
        "grain_size_mm" => ("grain size", "grain size (mm)"),
        "temperature_c" => ("temperature", "temperature (°C)"),
        _ => ("stress", "stress (MPa)"),
    };
    let points = found.points.iter().map(|point| Point { x: point.x, y: point.y, bar: Some(point.ci95.into()) });
    let low = found.points.iter().map(|point| point.x).fold(f64::INFINITY, f64::min);
    let high = found.points.iter().map(|point| point.x).fold(f64::NEG_INFINITY, f64::max);
    // straight on the axes of its law
    let line = found.slope.zip(found.intercept).map_or_else(Vec::new, |(slope, intercept)| {
        let at = |x: f64| match found.law.as_str() {
            "power" => Point::new(x, (intercept + slope * x.ln()).exp()),
            "exponential" => Point::new(x, (intercept + slope * x).exp()),
            _ => Point::new(x, intercept + slope * x),
        };
        vec![at(low), at(high)]
    });
    let law = match found.law.as_str() {
        "power" => "power of the abscissa, exponent",
        "exponential" => "exponential of the abscissa, rate",
        _ => "line, slope",
    };
    let told = found.slope.map(|slope| format!("{law} {}", with_error(slope, found.slope_se)));
    let others = found.others_vary.then(|| "other conditions vary too".to_owned());
    let (is_power, is_linear) = (found.law == "power", found.law == "linear");
    let plot = Plot {
        title: format!("{quantity} against {condition}"),
        subtitle: [Some(whole.to_owned()), told, others].into_iter().flatten().collect::<Vec<_>>().join("   |   "),
        x: if is_power { Axis::log(x) } else { Axis::linear(x) },
        y: if is_linear { Axis::linear(y) } else { Axis::log(y) },
        legend: if found.slope.is_some_and(|slope| slope > 0.0) { Corner::UpperLeft } else { Corner::UpperRight },
        series: vec![
            Series::new("data set with 95 % interval", Mark::Dots, 0, points.collect()),
            Series::new("weighted least squares", Mark::Line, 1, line),
        ],
    };
    Figure::new(format!("{}-against-{}", found.quantity.replace('_', "-"), found.against.replace('_', "-")), plot)
}

//! What is drawn of a feature elimination.

use super::{
    Figure, Plot,
    axes::Axis,
    plot::{Corner, Mark, Point, Series},
};
use crate::science::forecast::{
    day::Label,
    selection::{FeatureSelection, SizeScore},
};

/// The score of held-out seasons against the number of features, with its standard error. `used` is the number of features that
/// a model was trained with, if there is one; `synthetic` says that a generator made the days.
#[must_use]
pub fn of_selection(selection: &FeatureSelection, used: Option<usize>, synthetic: bool) -> Figure {
    let curve = &selection.curve;
    let of_size = |size: usize| curve.iter().find(|score| score.features == size);
    let label = match selection.label {
        Label::Observed => "observed",
        Label::Presumed => "presumed",
    };
    let whole = format!(
        "{} days of {} seasons, label {label}, lead {}, {} groups of seasons held out in turn",
        selection.days,
        selection.seasons,
        selection.lead,
        selection.groups.len()
    );
    let mut series = vec![
        Series::new("mean AUC with its standard error", Mark::Dots, 0, curve.iter().map(point).collect()),
        Series::new("", Mark::Line, 0, curve.iter().map(|score| Point { bar: None, ..point(score) }).collect()),
    ];
    if let (Some(best), Some(last)) = (of_size(selection.best), curve.last()) {
        let enough = best.auc - best.standard_error.unwrap_or(0.0);
        let ends = [1.0, last.features as f64].map(|size| Point::new(size, enough)).to_vec();
        series.push(Series::new("one standard error below the best", Mark::Dashes, 7, ends));
    }
    let mut mark = |words: String, size: usize, colour: usize| {
        if let Some(score) = of_size(size) {
            let at = Point { bar: None, ..point(score) };
            series.push(Series::new(words, Mark::Dots, colour, vec![at]));
        }
    };
    let (best, proposed) = (selection.best, selection.proposed);
    if best == proposed {
        mark(format!("best and proposed: {best}"), best, 1);
    } else {
        mark(format!("best: {best}"), best, 2);
        mark(format!("proposed: {proposed}"), proposed, 1);
    }
    if let Some(size) = used {
        mark(format!("of the model: {size}"), size, 3);
    }
    let plot = Plot {
        title: "How many features it takes".into(),
        subtitle: if synthetic { format!("SYNTHETIC: {whole}") } else { whole },
        x: Axis::linear("number of features"),
        y: Axis::linear("AUC of held-out seasons"),
        legend: Corner::LowerRight,
        series,
    };
    Figure::new("selection", plot)
}

fn point(score: &SizeScore) -> Point {
    let size = score.features as f64;
    score.standard_error.map_or(Point::new(size, score.auc), |error| Point::with_error(size, score.auc, error))
}

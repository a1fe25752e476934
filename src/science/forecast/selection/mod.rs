//! How many features it takes: recursive elimination, cross-validated over seasons at every size.
//!
//! The seasons are dealt to groups. Each group is held out once, and on the others all is learnt anew: medians and scales, C
//! and gamma, and the order in which features go (`RFECV` of scikit-learn does the same with the order). The area under
//! the ROC curve of the held-out seasons at every size, averaged over the groups, is the curve. The ranking is that of one more
//! elimination on all seasons.

use jiff::civil::Date;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::day::{DayRecord, Label};
use super::evaluation::{Done, Part, Samples, Shares, inner_folds};
use super::features::FeatureSetId;
use super::matrix::Matrix;
use super::model::{FeatureChoice, Prepared, TrainingError, TrainingOptions, prepare};
use super::svm::KernelFamily;
use super::verification::auc;
use crate::progress::Progress;

/// What an elimination found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct FeatureSelection {
    /// Which days are avalanche days.
    #[cfg_attr(feature = "schema", schema(value_type = String, pattern = "^(observed|presumed)$"))]
    pub label: Label,
    /// Days from the base day to the day that is forecast.
    pub lead: u8,
    /// The features that there are.
    #[cfg_attr(feature = "schema", schema(value_type = String, pattern = "^(expert|raw-30)$"))]
    pub feature_set: FeatureSetId,
    /// Version of their formulas.
    pub feature_set_version: u32,
    /// Scorable days.
    pub days: usize,
    /// Avalanche days among them.
    pub events: usize,
    /// Seasons.
    pub seasons: usize,
    /// First scorable day.
    pub first: Date,
    /// Last scorable day.
    pub last: Date,
    /// Groups of seasons, each held out once.
    pub groups: Vec<SeasonGroup>,
    /// Score at every number of features, from 1 upwards.
    pub curve: Vec<SizeScore>,
    /// The number of features of the highest mean score; the smaller one where several have it.
    pub best: usize,
    /// The smallest number whose mean score is within one standard error of the highest.
    pub proposed: usize,
    /// The features in the order of the elimination on all seasons: the one that stayed longest first.
    pub ranking: Vec<RankedFeature>,
    /// Cost that the search on all seasons and features chose; the ranking was made with it.
    pub c: f64,
    /// Inverse squared width that it chose.
    pub gamma: f64,
}

/// Seasons that were held out together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct SeasonGroup {
    /// Years in which they begin.
    pub seasons: Vec<i16>,
    /// Cost that was chosen on the others.
    pub c: f64,
    /// Inverse squared width that was chosen on the others.
    pub gamma: f64,
}

/// How well so many features do.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct SizeScore {
    /// Number of features.
    pub features: usize,
    /// Mean over the groups of the area under the ROC curve of the held-out seasons.
    pub auc: f64,
    /// Standard deviation over the groups (n - 1 in the denominator); null with one group.
    pub standard_deviation: Option<f64>,
    /// Standard deviation over the square root of the number of groups.
    pub standard_error: Option<f64>,
    /// The score of each group; null where its seasons hold one class only.
    pub by_group: Vec<Option<f64>>,
}

/// A feature and its rank.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct RankedFeature {
    /// Name of the feature.
    pub feature: String,
    /// In how many of the groups it is among the proposed number of features: how stable the choice is.
    pub groups: usize,
}

/// One elimination, as far as it is told and saved.
#[derive(Clone, Serialize, Deserialize)]
struct Run {
    /// Columns in the order of their removal; the last is the one that stayed.
    order: Vec<usize>,
    /// AUC of the held-out seasons with all columns, then after each removal.
    auc: Vec<Option<f64>>,
    c: f64,
    gamma: f64,
}

impl FeatureSelection {
    /// The names of the `count` features that stayed longest; fewer where there are fewer.
    #[must_use]
    pub fn set(&self, count: usize) -> Vec<String> {
        self.ranking.iter().take(count).map(|ranked| ranked.feature.clone()).collect()
    }
}

/// Eliminates the features of `days` (rising dates, gaps allowed) one after the other, and scores every number of them.
///
/// [`TrainingOptions::features`] must be [`FeatureChoice::All`] or named, the kernel Gaussian; threshold and seed are not used.
/// Uses the current rayon pool; the result has the same bits at any number of threads. What is done is saved group by group.
///
/// # Errors
/// [`TrainingError`], as [`train`](super::model::train).
pub fn select(
    days: &[DayRecord],
    options: &TrainingOptions,
    progress: &dyn Progress,
) -> Result<FeatureSelection, TrainingError> {
    select_pooled(&[days], options, progress)
}

/// The same on the days of several stations, as [`train_pooled`](super::model::train_pooled) takes them; the score is that of
/// days of stations.
///
/// # Errors
/// As [`select`].
pub fn select_pooled(
    stations: &[&[DayRecord]],
    options: &TrainingOptions,
    progress: &dyn Progress,
) -> Result<FeatureSelection, TrainingError> {
    if options.kernel != KernelFamily::Gaussian || matches!(options.features, FeatureChoice::Eliminated { .. }) {
        return Err(TrainingError::EliminationKernel);
    }
    let prepared = prepare(stations, options)?;
    let samples = &prepared.samples;
    let group = inner_folds(&samples.season, &samples.event);
    let groups = group.iter().max().map_or(0, |&last| last + 1);
    // the run on all seasons is the longest and begins first
    let splits: Vec<Option<usize>> = std::iter::once(None).chain((0..groups).map(Some)).collect();
    let weight = |split: &Option<usize>| group.iter().filter(|&&g| Some(g) != *split).count().pow(2) as f64;
    let shares = Shares::new(progress, splits.iter().map(weight).collect());
    let done: Done<Run> = Done::resume(samples, options, splits.len(), progress);
    let runs: Vec<Result<Run, TrainingError>> = splits
        .par_iter()
        .enumerate()
        .with_max_len(1)
        .map(|(i, &held_out)| {
            let name =
                held_out.map_or_else(|| "all seasons".to_owned(), |g| format!("seasons without group {}", g + 1));
            let share = shares.part(i, name);
            if let Some(run) = done.get(i) {
                share.report(1.0, "done before");
                return Ok(run);
            }
            let run = eliminate(samples, &group, held_out, options, &share)?;
            done.set(i, &run, &share);
            Ok(run)
        })
        .collect();
    let mut runs = runs.into_iter().collect::<Result<Vec<_>, _>>()?;
    let whole = runs.remove(0);
    report(&prepared, options, &group, &whole, &runs)
}

/// Eliminates on all seasons but those of a group, which is scored.
fn eliminate(
    samples: &Samples,
    group: &[usize],
    held_out: Option<usize>,
    options: &TrainingOptions,
    progress: &dyn Progress,
) -> Result<Run, TrainingError> {
    if progress.cancelled() {
        return Err(TrainingError::Cancelled);
    }
    let (training, test): (Vec<usize>, Vec<usize>) = (0..samples.len()).partition(|&i| Some(group[i]) != held_out);
    let part = Part::new(samples, &training);
    let prepared: Matrix = part.prepare(&test);
    let shares = Shares::new(progress, vec![1.0, 1.0]);
    let found = part.eliminate(&prepared, 1, options, &shares, 0)?;
    let event: Vec<bool> = test.iter().map(|&i| samples.event[i]).collect();
    let elimination = found.elimination;
    Ok(Run {
        auc: elimination.decision_values.iter().map(|values| auc(values, &event)).collect(),
        order: [elimination.removed, elimination.kept].concat(),
        c: found.best.c,
        gamma: found.best.gamma.unwrap_or(f64::NAN),
    })
}

fn report(
    prepared: &Prepared,
    options: &TrainingOptions,
    group: &[usize],
    whole: &Run,
    runs: &[Run],
) -> Result<FeatureSelection, TrainingError> {
    let Prepared { set, samples, summary } = prepared;
    let curve: Option<Vec<SizeScore>> = (1..=set.len()).map(|size| score(runs, size, set.len())).collect();
    let nothing = TrainingError::Grid(super::svm::GridError::NothingToScore);
    let curve = curve.filter(|curve| !curve.is_empty()).ok_or(nothing)?;
    let (best, proposed) = choose(&curve);
    let among = |run: &Run, column: usize| run.order.iter().rev().take(proposed).any(|&c| c == column);
    let ranked = |&column: &usize| RankedFeature {
        feature: set.features[column].name.clone(),
        groups: runs.iter().filter(|run| among(run, column)).count(),
    };
    let group_of = |(g, run): (usize, &Run)| {
        let mut seasons: Vec<i16> =
            (0..samples.len()).filter(|&i| group[i] == g).map(|i| samples.seasons[samples.season[i]]).collect();
        seasons.dedup();
        SeasonGroup { seasons, c: run.c, gamma: run.gamma }
    };
    Ok(FeatureSelection {
        label: options.label,
        lead: options.lead,
        feature_set: set.id,
        feature_set_version: set.version,
        days: summary.days,
        events: summary.events,
        seasons: summary.seasons,
        first: summary.first,
        last: summary.last,
        groups: runs.iter().enumerate().map(group_of).collect(),
        best,
        proposed,
        ranking: whole.order.iter().rev().map(ranked).collect(),
        curve,
        c: whole.c,
        gamma: whole.gamma,
    })
}

/// The score of `size` of all `features`; `None` where no group can be scored.
fn score(runs: &[Run], size: usize, features: usize) -> Option<SizeScore> {
    let by_group: Vec<Option<f64>> = runs.iter().map(|run| run.auc[features - size]).collect();
    let known: Vec<f64> = by_group.iter().copied().flatten().collect();
    let count = known.len() as f64;
    let mean = known.iter().sum::<f64>() / count;
    let deviation = (known.len() > 1)
        .then(|| (known.iter().map(|auc| (auc - mean) * (auc - mean)).sum::<f64>() / (count - 1.0)).sqrt());
    (!known.is_empty()).then_some(SizeScore {
        features: size,
        auc: mean,
        standard_deviation: deviation,
        standard_error: deviation.map(|deviation| deviation / count.sqrt()),
        by_group,
    })
}

/// The size of the highest mean, and the smallest one within its standard error (Breiman et al. 1984, Classification and
/// Regression Trees, section 3.4.3). `curve` is in rising order of size and not empty.
fn choose(curve: &[SizeScore]) -> (usize, usize) {
    let best = (0..curve.len()).fold(0, |best, i| if curve[i].auc > curve[best].auc { i } else { best });
    let enough = curve[best].auc - curve[best].standard_error.unwrap_or(0.0);
    let proposed = curve.iter().find(|score| score.auc >= enough).unwrap_or(&curve[best]);
    (curve[best].features, proposed.features)
}

#[cfg(test)]
mod tests;

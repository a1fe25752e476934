//! A recipe on more seasons against the same recipe on fewer: what a retraining is worth.
//!
//! Both are judged on the same days. Each season is forecast by machines that have not seen it: the candidate's by all other
//! seasons, the active model's by those that it was trained on, without the one that is held out. A season that the active
//! model never saw is forecast by all of its own.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{
    Difference, Judged, LEVEL, Part, Plan, REPLICATES, Samples, Shares, by_day, first_of, outcomes,
    seasons_of_each_class,
};
use crate::forecast::model::{TrainingError, TrainingOptions};
use crate::forecast::verification::bootstrap::{Interval, SeasonDraws, interval, replicate};
use crate::forecast::verification::{Outcome, Scores};
use crate::progress::Progress;

/// A candidate and the active model on the same seasons, each held out from both.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Comparison {
    /// Seasons on which both were scored, by the year in which they begin.
    pub seasons: Vec<i16>,
    /// Seasons that the candidate was trained on and the active model was not.
    pub new_seasons: Vec<i16>,
    /// Scored days.
    pub days: usize,
    /// Avalanche days among them.
    pub events: usize,
    /// Scores of the candidate. Zero of the Brier skill of both is the climatology of all other seasons.
    pub candidate: Scores,
    /// Scores of the active model.
    pub active: Scores,
    /// Candidate minus active; the interval holds 95 % of the bootstraps over seasons, drawn alike for both.
    pub difference: Differences,
    /// Season by season.
    pub per_season: Vec<SeasonComparison>,
    /// What the intervals say.
    pub verdict: Verdict,
}

/// Differences of scores, null where one of the two is undefined.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Differences {
    /// Of the areas under the ROC curve.
    pub auc: Option<Difference>,
    /// Of the Peirce skill scores.
    pub pss: Option<Difference>,
    /// Of the Brier skills.
    pub brier_skill: Option<Difference>,
}

/// Both on one season.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct SeasonComparison {
    /// Year in which the season begins.
    pub season: i16,
    /// Scored days.
    pub days: usize,
    /// Avalanche days among them.
    pub events: usize,
    /// Scores of the candidate.
    pub candidate: Scores,
    /// Scores of the active model.
    pub active: Scores,
}

/// What the intervals of the differences say.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// An interval lies above 0 and none below.
    Better,
    /// Every interval holds 0, or some lie above and others below.
    NoDifference,
    /// An interval lies below 0 and none above.
    Worse,
}

/// Relative work of [`compare`] beside the candidate's own evaluation: one part a season that it has to fit.
pub(crate) fn work(samples: &Samples, active_seasons: &[i16]) -> Vec<f64> {
    splits(samples, active_seasons).iter().map(|(_, training)| (training.len() as f64).powi(2)).collect()
}

/// Seasons that can be forecast by the active model's recipe without them, and the rows to do it with.
fn splits(samples: &Samples, active_seasons: &[i16]) -> Vec<(usize, Vec<usize>)> {
    let rows = |held_out: usize| {
        let training = samples.rows_of(|s| s != held_out && active_seasons.contains(&samples.seasons[s]));
        let classes = seasons_of_each_class(training.iter().map(|&i| (samples.season[i], samples.event[i])));
        // inner folds need both classes in training
        (classes.0.min(classes.1) >= 2).then_some((held_out, training))
    };
    (0..samples.seasons.len()).filter_map(rows).collect()
}

/// Position of a season, and what the active model's recipe said of its days.
type Judgement = (usize, Vec<Outcome>);

/// Compares the judged seasons of a candidate with the same recipe on `active_seasons`; split `i` reports to part `first + i`
/// of `shares`. `None` where no season can be forecast without it.
pub(super) fn compare(
    samples: &Samples,
    candidate: &[Judged],
    active_seasons: &[i16],
    options: &TrainingOptions,
    shares: &Shares<'_>,
    first: usize,
) -> Result<Option<Comparison>, TrainingError> {
    let is_new = |season: &&i16| !active_seasons.contains(season);
    let new_seasons: Vec<i16> = samples.seasons.iter().filter(is_new).copied().collect();
    let of = |season: usize| candidate.iter().find(|judged| judged.season == season);
    let judged: Vec<Result<Option<Judgement>, TrainingError>> = splits(samples, active_seasons)
        .into_par_iter()
        .enumerate()
        .with_max_len(1)
        .map(|(i, (season, training))| {
            let Some(beside) = of(season) else { return Ok(None) };
            let share = shares.part(first + i, format!("active model without season {}", samples.seasons[season]));
            if new_seasons.is_empty() {
                // the same recipe on the same days: the same machines
                share.report(1.0, "the same");
                return Ok(Some((season, beside.outcomes.svm.clone())));
            }
            let active = judge_alone(samples, season, &training, &beside.outcomes.svm, options, &share)?;
            Ok(Some((season, active)))
        })
        .collect();
    let judged: Vec<Judgement> = judged.into_iter().filter_map(Result::transpose).collect::<Result<_, _>>()?;
    let pairs: Vec<(usize, &[Outcome], &[Outcome])> = judged
        .iter()
        .filter_map(|(season, active)| Some((*season, &of(*season)?.outcomes.svm[..], &active[..])))
        .collect();
    Ok((!pairs.is_empty()).then(|| report(samples, &pairs, new_seasons, options)))
}

/// The machine of a split alone, against the climatology that the candidate is measured against.
fn judge_alone(
    samples: &Samples,
    season: usize,
    training: &[usize],
    beside: &[Outcome],
    options: &TrainingOptions,
    progress: &dyn Progress,
) -> Result<Vec<Outcome>, TrainingError> {
    if progress.cancelled() {
        return Err(TrainingError::Cancelled);
    }
    let part = Part::new(samples, training);
    let svm = part.svm(options, progress)?;
    let learnt = samples.days_of(training);
    let said = by_day(&learnt, &svm.out_of_fold);
    let threshold =
        options.threshold.choose(&said, &first_of(&learnt, part.event())).ok_or(TrainingError::NoThreshold)?;
    let test = samples.rows_of(|s| s == season);
    let probability = by_day(&samples.days_of(&test), &part.speak(&svm, &test).test);
    let event: Vec<bool> = beside.iter().map(|outcome| outcome.event).collect();
    let reference: Vec<f64> = beside.iter().map(|outcome| outcome.reference).collect();
    Ok(outcomes(&probability, threshold, &event, &reference))
}

fn report(
    samples: &Samples,
    pairs: &[(usize, &[Outcome], &[Outcome])],
    new_seasons: Vec<i16>,
    options: &TrainingOptions,
) -> Comparison {
    let cost_loss = options.threshold.cost_loss();
    let candidate: Vec<Outcome> = pairs.iter().flat_map(|(_, candidate, _)| candidate.iter().copied()).collect();
    let active: Vec<Outcome> = pairs.iter().flat_map(|(.., active)| active.iter().copied()).collect();
    // positions among the seasons that are compared, which are those that are drawn
    let season: Vec<usize> =
        pairs.iter().enumerate().flat_map(|(at, (_, candidate, _))| vec![at; candidate.len()]).collect();
    let draws = SeasonDraws::new(pairs.len(), REPLICATES, options.seed);
    let (a, b) = (replicate(&candidate, &season, &draws), replicate(&active, &season, &draws));
    let (candidate_scores, active_scores) = (Scores::of(&candidate, cost_loss), Scores::of(&active, cost_loss));
    let difference = Differences {
        auc: paired(candidate_scores.auc, active_scores.auc, &a.auc, &b.auc),
        pss: paired(candidate_scores.pss, active_scores.pss, &a.pss, &b.pss),
        brier_skill: paired(candidate_scores.brier_skill, active_scores.brier_skill, &a.brier_skill, &b.brier_skill),
    };
    let of_season = |&(season, candidate, active): &(usize, &[Outcome], &[Outcome])| SeasonComparison {
        season: samples.seasons[season],
        days: candidate.len(),
        events: candidate.iter().filter(|outcome| outcome.event).count(),
        candidate: Scores::of(candidate, cost_loss),
        active: Scores::of(active, cost_loss),
    };
    Comparison {
        seasons: pairs.iter().map(|&(season, ..)| samples.seasons[season]).collect(),
        new_seasons,
        days: candidate.len(),
        events: candidate.iter().filter(|outcome| outcome.event).count(),
        candidate: candidate_scores,
        active: active_scores,
        verdict: verdict(&difference),
        difference,
        per_season: pairs.iter().map(of_season).collect(),
    }
}

fn paired(a: Option<f64>, b: Option<f64>, many_a: &[Option<f64>], many_b: &[Option<f64>]) -> Option<Difference> {
    let differences: Vec<Option<f64>> = many_a.iter().zip(many_b).map(|(&a, &b)| Some(a? - b?)).collect();
    let Interval { lower, upper } = interval(&differences, LEVEL)?;
    Some(Difference { estimate: a? - b?, lower, upper })
}

fn verdict(difference: &Differences) -> Verdict {
    let all = [difference.auc, difference.pss, difference.brier_skill];
    let any = |is: fn(&Difference) -> bool| all.iter().flatten().any(is);
    match (any(|d| d.lower > 0.0), any(|d| d.upper < 0.0)) {
        (true, false) => Verdict::Better,
        (false, true) => Verdict::Worse,
        _ => Verdict::NoDifference,
    }
}

/// The parts of the evaluation and of the comparison of a retraining.
pub(crate) fn work_of_both(samples: &Samples, plan: &Plan, active_seasons: &[i16]) -> Vec<f64> {
    [plan.work(), work(samples, active_seasons)].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn difference(lower: f64, upper: f64) -> Option<Difference> {
        Some(Difference { estimate: f64::midpoint(lower, upper), lower, upper })
    }

    #[test]
    fn only_an_interval_beside_zero_is_a_difference() {
        let of = |auc, brier_skill| verdict(&Differences { auc, pss: None, brier_skill });
        assert_eq!(of(difference(0.01, 0.02), difference(-0.1, 0.1)), Verdict::Better);
        assert_eq!(of(difference(-0.1, 0.1), difference(-0.2, -0.1)), Verdict::Worse);
        assert_eq!(of(difference(0.01, 0.02), difference(-0.2, -0.1)), Verdict::NoDifference);
        assert_eq!(of(difference(0.0, 0.0), None), Verdict::NoDifference);
        assert_eq!(of(None, None), Verdict::NoDifference);
    }
}

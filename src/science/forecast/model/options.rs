//! What to train, and whether the days allow it.

use jiff::civil::Date;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::forecast::day::{DayRecord, Label, Variable};
use crate::forecast::evaluation::folds::{SEASONS_NEEDED, seasons_of_each_class};
use crate::forecast::evaluation::{Samples, first_of};
use crate::forecast::features::{FeatureSet, FeatureSetId, History, HistoryError, UnknownFeature};
use crate::forecast::logistic::LogisticError;
use crate::forecast::svm::{CalibrationError, EliminationError, Grid, GridError, KernelFamily, SolverError};
use crate::forecast::verification::ThresholdRule;

/// The longest lead, in days.
pub const LONGEST_LEAD: u8 = 1;

/// What to train.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainingOptions {
    /// Which days are avalanche days.
    pub label: Label,
    /// Days from the base day, whose observations are read, to the day that is forecast: 0 (nowcast) or 1.
    pub lead: u8,
    /// Features.
    pub feature_set: FeatureSetId,
    /// Which of them the machine reads.
    pub features: FeatureChoice,
    /// Kernel of the SVM.
    pub kernel: KernelFamily,
    /// Variables that the station reports; their order does not matter.
    pub reported: Vec<Variable>,
    /// Seed of the bootstrap: the only thing that is random.
    pub seed: u64,
    /// Candidates of cost and gamma.
    pub grid: Grid,
    /// How thresholds are chosen.
    pub threshold: ThresholdRule,
}

/// Which features of a set a machine reads. The models beside it read what they always read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum FeatureChoice {
    /// All of them.
    #[default]
    All,
    /// Those of these names. Where they were chosen on the days that score the model, its scores are flattered.
    Named(Vec<String>),
    /// So many, by recursive elimination on the training days of each split: the choice is judged with the rest.
    Eliminated {
        /// Features to keep.
        count: usize,
    },
}

/// What there is to train on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainingSummary {
    /// Scorable days: the label is known, and the base day and the two before it are recorded in the same season. Of several
    /// stations a day counts once.
    pub days: usize,
    /// Rows to learn from: scorable days of stations, which is [`Self::days`] where there is one station.
    pub station_days: usize,
    /// Avalanche days among them.
    pub events: usize,
    /// Seasons with a scorable day.
    pub seasons: usize,
    /// Share of avalanche days.
    pub base_rate: f64,
    /// First scorable day.
    pub first: Date,
    /// Last scorable day.
    pub last: Date,
}

/// Why no model was trained.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum TrainingError {
    /// The days are not in order.
    #[error("{0}; days must be in rising order of date, each once")]
    Unordered(#[from] HistoryError),
    /// A lead that is not offered.
    #[error("a lead of {lead} days is not offered: 0 (the same day) or 1 (the next day) is accepted")]
    Lead {
        /// The lead asked for.
        lead: u8,
    },
    /// The station reports nothing that a feature is computed from.
    #[error("no reported variable: at least one, other than the cumulative snow index, is needed")]
    NoVariable,
    /// A feature that is not in the set.
    #[error(transparent)]
    Feature(#[from] UnknownFeature),
    /// A number of features that cannot be kept.
    #[error("{count} feature(s) cannot be kept of the {features} of the set: 1 to {features} are accepted")]
    FeatureCount {
        /// Features asked for.
        count: usize,
        /// Features of the set.
        features: usize,
    },
    /// Features are eliminated for a Gaussian kernel alone.
    #[error("features are eliminated with a Gaussian kernel only")]
    EliminationKernel,
    /// Features could not be eliminated.
    #[error("feature elimination: {0}")]
    Elimination(EliminationError),
    /// A cost/loss ratio that no threshold can be.
    #[error("a cost/loss ratio of {ratio} is no threshold: above 0 and below 1 is accepted")]
    CostLoss {
        /// The ratio asked for.
        ratio: f64,
    },
    /// Too few seasons.
    #[error(
        "{found} season(s) with a scorable day: at least {needed} are needed (a day is scorable where its avalanche activity is \
         known and the base day and the two days before it are recorded)"
    )]
    TooFewSeasons {
        /// Seasons with a scorable day.
        found: usize,
        /// Seasons needed.
        needed: usize,
    },
    /// Avalanche days, or days without, in too few seasons to hold one out.
    #[error(
        "avalanche days in {event_seasons} season(s), days without in {quiet_seasons}: both are needed in at least {needed} \
         seasons"
    )]
    OneClass {
        /// Seasons with an avalanche day.
        event_seasons: usize,
        /// Seasons with a day without.
        quiet_seasons: usize,
        /// Seasons needed of each.
        needed: usize,
    },
    /// A grid that cannot be searched, or labels so uneven over the seasons that its folds cannot be scored.
    #[error("grid search: {0}")]
    Grid(GridError),
    /// A machine could not be fitted.
    #[error("support vector machine: {0}")]
    Machine(SolverError),
    /// Decision values could not be turned into probabilities.
    #[error("calibration: {0}")]
    Calibration(#[from] CalibrationError),
    /// The regression beside the machine could not be fitted.
    #[error("logistic regression: {0}")]
    Logistic(#[from] LogisticError),
    /// Out-of-fold probabilities that no threshold can be chosen on.
    #[error("no threshold could be chosen: the training probabilities are undefined")]
    NoThreshold,
    /// The caller no longer wants the model.
    #[error("cancelled")]
    Cancelled,
}

impl From<GridError> for TrainingError {
    fn from(error: GridError) -> Self {
        match error {
            GridError::Cancelled => Self::Cancelled,
            error => Self::Grid(error),
        }
    }
}

impl From<SolverError> for TrainingError {
    fn from(error: SolverError) -> Self {
        match error {
            SolverError::Cancelled => Self::Cancelled,
            error => Self::Machine(error),
        }
    }
}

impl From<EliminationError> for TrainingError {
    fn from(error: EliminationError) -> Self {
        match error {
            EliminationError::Cancelled => Self::Cancelled,
            error => Self::Elimination(error),
        }
    }
}

/// What a training run reads.
pub(crate) struct Prepared {
    pub(crate) set: FeatureSet,
    pub(crate) samples: Samples,
    pub(crate) summary: TrainingSummary,
}

/// Whether a model can be trained on `days` (rising dates, gaps allowed), and what on. It costs milliseconds.
///
/// # Errors
/// What [`train`](super::train) would say before it starts.
pub fn check(days: &[DayRecord], options: &TrainingOptions) -> Result<TrainingSummary, TrainingError> {
    check_pooled(&[days], options)
}

/// The same for the days of several stations.
///
/// # Errors
/// What [`train_pooled`](super::train_pooled) would say before it starts.
pub fn check_pooled(stations: &[&[DayRecord]], options: &TrainingOptions) -> Result<TrainingSummary, TrainingError> {
    prepare(stations, options).map(|prepared| prepared.summary)
}

pub(crate) fn prepare(stations: &[&[DayRecord]], options: &TrainingOptions) -> Result<Prepared, TrainingError> {
    check_options(options)?;
    let set = chosen(FeatureSet::new(options.feature_set, &options.reported), options)?;
    let collect = |days: &&[DayRecord]| -> Result<Samples, TrainingError> {
        Ok(Samples::collect(&History::new(days)?, &set, options.label, options.lead))
    };
    let samples = Samples::pool(stations.iter().map(collect).collect::<Result<_, _>>()?);
    let summary = summarise(&samples)?;
    Ok(Prepared { set, samples, summary })
}

/// The features that the options leave of a set; what is eliminated goes later.
fn chosen(set: FeatureSet, options: &TrainingOptions) -> Result<FeatureSet, TrainingError> {
    match &options.features {
        FeatureChoice::All => Ok(set),
        FeatureChoice::Named(names) if names.is_empty() => {
            Err(TrainingError::FeatureCount { count: 0, features: set.len() })
        }
        FeatureChoice::Named(names) => Ok(set.only(names)?),
        FeatureChoice::Eliminated { .. } if options.kernel != KernelFamily::Gaussian => {
            Err(TrainingError::EliminationKernel)
        }
        FeatureChoice::Eliminated { count } if !(1..=set.len()).contains(count) => {
            Err(TrainingError::FeatureCount { count: *count, features: set.len() })
        }
        FeatureChoice::Eliminated { .. } => Ok(set),
    }
}

fn check_options(options: &TrainingOptions) -> Result<(), TrainingError> {
    if options.lead > LONGEST_LEAD {
        return Err(TrainingError::Lead { lead: options.lead });
    }
    if options.reported.iter().all(|&v| v == Variable::CumulativeSnowIndex) {
        return Err(TrainingError::NoVariable);
    }
    if let ThresholdRule::CostLoss { ratio } = options.threshold
        && !(ratio > 0.0 && ratio < 1.0)
    {
        return Err(TrainingError::CostLoss { ratio });
    }
    let gamma = match options.kernel {
        KernelFamily::Gaussian => options.grid.gamma.as_slice(),
        KernelFamily::Linear => &[1.0],
    };
    for (parameter, values) in [("c", options.grid.c.as_slice()), ("gamma", gamma)] {
        if values.is_empty() {
            return Err(TrainingError::Grid(GridError::EmptyGrid));
        }
        if let Some(&value) = values.iter().find(|v| !(v.is_finite() && **v > 0.0)) {
            return Err(TrainingError::Grid(GridError::InvalidParameter { parameter, value }));
        }
    }
    Ok(())
}

fn summarise(samples: &Samples) -> Result<TrainingSummary, TrainingError> {
    let seasons = samples.seasons.len();
    let too_few = TrainingError::TooFewSeasons { found: seasons, needed: SEASONS_NEEDED };
    let (Some(&first), Some(&last)) = (samples.date.first(), samples.date.last()) else { return Err(too_few) };
    if seasons < SEASONS_NEEDED {
        return Err(too_few);
    }
    let (event_seasons, quiet_seasons) =
        seasons_of_each_class(samples.season.iter().copied().zip(samples.event.iter().copied()));
    if event_seasons.min(quiet_seasons) < SEASONS_NEEDED {
        return Err(TrainingError::OneClass { event_seasons, quiet_seasons, needed: SEASONS_NEEDED });
    }
    let rows: Vec<usize> = (0..samples.len()).collect();
    let known = first_of(&samples.days_of(&rows), &samples.event);
    let (days, events) = (known.len(), known.iter().filter(|&&event| event).count());
    let base_rate = events as f64 / days as f64;
    Ok(TrainingSummary { days, station_days: samples.len(), events, seasons, base_rate, first, last })
}

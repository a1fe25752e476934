//! The list of features of each set, and how each is computed from the days of its season.

use std::f64::consts::TAU;

use super::daily::{Daily, Rain, Sector, Snow};
use super::history::{REACH, Window};
use super::{Feature, FeatureSetId};
use crate::forecast::day::{Activity, Variable, day_of_season};

/// What is done with a daily quantity over the days before the base date `t`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Over {
    /// The value on `t - lag`.
    Lag(usize),
    /// The value on `t` minus the value `n` days earlier.
    Change(usize),
    /// Sum of the `n` days up to `t`.
    Sum(usize),
    /// Mean of the `n` days up to `t`.
    Mean(usize),
    /// Largest value of the `n` days up to `t`.
    Max(usize),
    /// Sum of the `n` days up to `t`, each worth half of the day after it.
    Decayed(usize),
    /// Sum of the known values of the season up to `t`.
    SeasonSum,
    /// Whether `t` and `t-1` lie on different sides of 0.
    Crossing,
    /// Days since the value was last above 0, at most [`REACH`].
    DaysSince,
}

/// How a feature is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Series(Daily, Over),
    /// Code of the avalanche activity on `t - lag`.
    ActivityLag(usize),
    /// Sum of the codes of `t-1` to `t-n`.
    ActivitySum(usize),
    SeasonSine,
    SeasonCosine,
}

impl Kind {
    /// The feature at the base date of `window`; NaN where missing.
    pub(super) fn value(self, window: &Window<'_>) -> f64 {
        match self {
            Self::Series(daily, over) => over.value(daily, window),
            Self::ActivityLag(lag) => activity(window, lag),
            Self::ActivitySum(n) => (1..=n).map(|lag| activity(window, lag)).sum(),
            Self::SeasonSine => season_angle(window).sin(),
            Self::SeasonCosine => season_angle(window).cos(),
        }
    }

    fn describe(self) -> Feature {
        let plain = |name: &str, formula: &str, lag_days: u8| Feature {
            name: name.to_owned(),
            unit: "1",
            formula: formula.to_owned(),
            lag_days,
            inputs: Vec::new(),
            kind: self,
        };
        match self {
            Self::Series(daily, over) => Feature {
                name: over.name(daily),
                unit: over.unit(daily),
                formula: over.formula(daily),
                lag_days: over.newest_lag(),
                inputs: daily.inputs(),
                kind: self,
            },
            Self::ActivityLag(lag) => {
                plain(&format!("activity_t{lag}"), &format!("activity(t-{lag}): {CODES}"), lag as u8)
            }
            Self::ActivitySum(n) => {
                plain(&format!("activity_sum{n}"), &format!("sum over k = 1..{n} of activity(t-k): {CODES}"), 1)
            }
            Self::SeasonSine => plain("day_of_season_sine", "sin(2 pi days since 1 July / 365.25)", 0),
            Self::SeasonCosine => plain("day_of_season_cosine", "cos(2 pi days since 1 July / 365.25)", 0),
        }
    }
}

impl Over {
    fn value(self, daily: Daily, window: &Window<'_>) -> f64 {
        let at = |lag| window.lag(lag).map_or(f64::NAN, |day| daily.at(day));
        match self {
            Self::Lag(lag) => at(lag),
            Self::Change(n) => at(0) - at(n),
            Self::Sum(n) => (0..n).map(at).sum(),
            Self::Mean(n) => (0..n).map(at).sum::<f64>() / n as f64,
            Self::Max(n) => (0..n).map(at).fold(f64::NEG_INFINITY, |m, x| if x > m || x.is_nan() { x } else { m }),
            // Horner's rule from the oldest day
            Self::Decayed(n) => (0..n).rev().fold(0.0, |sum, lag| 0.5 * sum + at(lag)),
            Self::SeasonSum => season_sum(daily, window),
            Self::Crossing => crossing(at(1), at(0)),
            Self::DaysSince => days_since(at),
        }
    }

    fn name(self, daily: Daily) -> String {
        let stem = daily.stem();
        match self {
            Self::Lag(0) => format!("{stem}_t"),
            Self::Lag(lag) => format!("{stem}_t{lag}"),
            Self::Change(n) => format!("{stem}_change{n}"),
            Self::Sum(n) => format!("{stem}_sum{n}"),
            Self::Mean(n) => format!("{stem}_mean{n}"),
            Self::Max(n) => format!("{stem}_max{n}"),
            Self::Decayed(n) => format!("{stem}_decayed{n}"),
            Self::SeasonSum => format!("{stem}_season_sum"),
            Self::Crossing => format!("{stem}_crossing"),
            // of what it counts from there is one a station, whichever variable tells it
            Self::DaysSince => "days_since_snow".to_owned(),
        }
    }

    const fn unit(self, daily: Daily) -> &'static str {
        match self {
            Self::Crossing => "bool",
            Self::DaysSince => "d",
            _ => daily.unit(),
        }
    }

    fn formula(self, daily: Daily) -> String {
        let at = |day: &str| daily.formula(day);
        match self {
            Self::Lag(0) => at("t"),
            Self::Lag(lag) => at(&format!("t-{lag}")),
            Self::Change(n) => format!("{} - {}", at("t"), at(&format!("t-{n}"))),
            Self::Sum(n) => format!("sum over k = 0..{} of {}", n.saturating_sub(1), at("t-k")),
            Self::Mean(n) => format!("mean over k = 0..{} of {}", n.saturating_sub(1), at("t-k")),
            Self::Max(n) => format!("max over k = 0..{} of {}", n.saturating_sub(1), at("t-k")),
            Self::Decayed(n) => format!("sum over k = 0..{} of 0.5^k {}", n.saturating_sub(1), at("t-k")),
            Self::SeasonSum => format!("sum over the known days k of the season up to t of {}", at("k")),
            Self::Crossing => format!("[sign of {} > 0 differs from {} > 0]", at("t"), at("t-1")),
            Self::DaysSince => format!("min(smallest k >= 0 with {} > 0, {REACH})", at("t-k")),
        }
    }

    const fn newest_lag(self) -> u8 {
        match self {
            Self::Lag(lag) => lag as u8,
            _ => 0,
        }
    }
}

/// How the activity features are coded, whichever label the model is trained for.
const CODES: &str = "observed 1, presumed 0.5, none 0, unknown missing";

fn activity(window: &Window<'_>, lag: usize) -> f64 {
    match window.lag(lag).map(|day| day.activity) {
        Some(Activity::Observed) => 1.0,
        Some(Activity::Presumed) => 0.5,
        Some(Activity::None) => 0.0,
        Some(Activity::Unknown) | None => f64::NAN,
    }
}

/// One missed day must not void the rest of a winter, so missing days are skipped; with none known it is missing.
fn season_sum(daily: Daily, window: &Window<'_>) -> f64 {
    let known = window.season.iter().map(|day| daily.at(day)).filter(|x| !x.is_nan());
    known.fold(f64::NAN, |sum, x| if sum.is_nan() { x } else { sum + x })
}

fn crossing(yesterday: f64, today: f64) -> f64 {
    if yesterday.is_nan() || today.is_nan() {
        f64::NAN
    } else {
        f64::from(u8::from((yesterday > 0.0) != (today > 0.0)))
    }
}

/// A missing day on the way back may have had the value, so the count is missing too.
fn days_since(at: impl Fn(usize) -> f64) -> f64 {
    for lag in 0..REACH {
        let x = at(lag);
        if x.is_nan() {
            return f64::NAN;
        }
        if x > 0.0 {
            return lag as f64;
        }
    }
    REACH as f64
}

fn season_angle(window: &Window<'_>) -> f64 {
    TAU * f64::from(day_of_season(window.base)) / 365.25
}

/// The features of `id` that a station can have that reports `reported`.
pub(super) fn features(id: FeatureSetId, reported: &[Variable]) -> Vec<Feature> {
    let mut kinds = raw(reported);
    if id == FeatureSetId::Expert {
        kinds.extend(expert(reported));
    }
    kinds.into_iter().map(Kind::describe).collect()
}

fn raw(reported: &[Variable]) -> Vec<Kind> {
    let daily = |v: &&Variable| **v != Variable::CumulativeSnowIndex;
    let lags = |&v: &Variable| [0, 1, 2].map(|lag| Kind::Series(Daily::Value(v), Over::Lag(lag)));
    reported.iter().filter(daily).flat_map(lags).collect()
}

fn expert(reported: &[Variable]) -> Vec<Kind> {
    let mut list = Vec::new();
    loading(reported, &mut list);
    temperature(reported, &mut list);
    wind(reported, &mut list);
    weather(reported, &mut list);
    list.extend([Kind::ActivityLag(1), Kind::ActivityLag(2), Kind::ActivitySum(5)]);
    list.extend([Kind::SeasonSine, Kind::SeasonCosine]);
    list
}

/// New snow and the snowpack: sums, settling, days since snow.
fn loading(reported: &[Variable], list: &mut Vec<Kind>) {
    if let Some(snow) = Snow::of(reported) {
        let overs = [Over::SeasonSum, Over::Sum(3), Over::Sum(5), Over::Decayed(5)];
        list.extend(overs.map(|over| Kind::Series(Daily::NewSnow(snow), over)));
        list.push(Kind::Series(Daily::SnowFell(snow), Over::Lag(0)));
        list.push(Kind::Series(Daily::NewSnow(snow), Over::DaysSince));
    }
    // the exported sum of the season stands in where its daily terms are not reported
    if reported.contains(&Variable::CumulativeSnowIndex) && !reported.contains(&Variable::NewSnowIndex) {
        list.push(Kind::Series(Daily::Value(Variable::CumulativeSnowIndex), Over::Lag(0)));
    }
    if reported.contains(&Variable::Precipitation24h) {
        list.push(Kind::Series(Daily::Value(Variable::Precipitation24h), Over::Sum(3)));
    }
    for variable in [Variable::FootPenetration, Variable::SnowHeight] {
        changes(variable, reported, list);
    }
}

/// Warming of air and snow.
fn temperature(reported: &[Variable], list: &mut Vec<Kind>) {
    changes(Variable::AirTemperature, reported, list);
    changes(Variable::SnowTemperature, reported, list);
    if !reported.contains(&Variable::AirTemperature) {
        return;
    }
    let air = Daily::Value(Variable::AirTemperature);
    list.extend([Over::Mean(3), Over::Max(3), Over::Crossing].map(|over| Kind::Series(air, over)));
    list.push(Kind::Series(Daily::DegreeDays, Over::Sum(3)));
    if reported.contains(&Variable::SnowTemperature) {
        list.extend([Over::Lag(0), Over::Change(1)].map(|over| Kind::Series(Daily::SnowMinusAir, over)));
    }
}

fn wind(reported: &[Variable], list: &mut Vec<Kind>) {
    let has = |v| reported.contains(&v);
    if has(Variable::WindSpeed) {
        let drift = has(Variable::SnowDrift);
        let transport = if drift { Daily::Transport } else { Daily::PotentialTransport };
        list.extend([Over::Lag(0), Over::Sum(3)].map(|over| Kind::Series(transport, over)));
    }
    if has(Variable::WindDirection) {
        if has(Variable::WindSpeed) {
            list.extend([Daily::WindU, Daily::WindV].map(|daily| Kind::Series(daily, Over::Lag(0))));
        }
        list.extend(Sector::ALL.map(|sector| Kind::Series(Daily::From(sector), Over::Lag(0))));
    }
}

/// Rain and cloud; that snow drifts is told by `snow_drift_t` of the raw set already.
fn weather(reported: &[Variable], list: &mut Vec<Kind>) {
    if let Some(rain) = Rain::of(reported) {
        list.push(Kind::Series(Daily::RainOnSnow(rain), Over::Sum(3)));
    }
    if reported.contains(&Variable::CloudCover) {
        list.push(Kind::Series(Daily::HighCloud, Over::Lag(0)));
    }
}

fn changes(variable: Variable, reported: &[Variable], list: &mut Vec<Kind>) {
    if reported.contains(&variable) {
        list.extend([1, 2].map(|n| Kind::Series(Daily::Value(variable), Over::Change(n))));
    }
}

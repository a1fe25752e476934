//! Acoustic activity along the test: cumulative number and amplitude against strain, stress or time.

use serde::{Deserialize, Serialize};

use super::error::EmissionError;
use super::numerics::{Z95, maximum};

/// What activity is drawn against.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Abscissa {
    /// Strain, 1.
    Strain,
    /// Stress, MPa.
    Stress,
    /// Time, s.
    Time,
}

/// Activity up to one abscissa.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ActivityPoint {
    /// End of the bin.
    pub to: f64,
    /// Events in the bin.
    pub events: usize,
    /// Events a unit of the abscissa.
    pub rate: f64,
    /// Its standard error from the Poisson number of events.
    pub rate_error: f64,
    /// Events so far.
    pub cumulative_events: usize,
    /// Sum of the amplitudes so far, V.
    pub cumulative_amplitude_v: f64,
}

/// What [`activity`] finds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Activity {
    /// Abscissa in use.
    pub against: Abscissa,
    /// Equal bins of the abscissa.
    pub points: Vec<ActivityPoint>,
    /// m of the number of events ~ (abscissa - start)^m, by maximum likelihood: 1 is steady, less is hardening, more is softening.
    pub exponent: f64,
    /// Its standard error.
    pub exponent_se: f64,
    /// 95 % interval.
    pub ci95: [f64; 2],
    /// True where the interval lies below 1: the rate falls, the sample hardens.
    pub hardening: bool,
}

const FEWEST: usize = 20;

/// Activity of events at `position` (strain, MPa or s, any order) with `amplitude_v`, in `bins` equal bins from `start` (where the
/// test begins; none takes 0 or, if smaller, the smallest position) to the largest position.
///
/// # Errors
/// Fewer than 20 events, bins out of range, or a start that is not below the largest position.
pub fn activity(
    position: &[f64],
    amplitude_v: &[f64],
    against: Abscissa,
    start: Option<f64>,
    bins: usize,
) -> Result<Activity, EmissionError> {
    if position.len() < FEWEST {
        return Err(EmissionError::TooFewEvents { what: "activity", found: position.len(), needed: FEWEST });
    }
    if !(1..=10_000).contains(&bins) {
        return Err(EmissionError::option("bins", bins, "1 to 10000"));
    }
    let mut events: Vec<(f64, f64)> = position.iter().copied().zip(amplitude_v.iter().copied()).collect();
    events.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (first, end) = (events[0].0, events[events.len() - 1].0);
    let start = start.unwrap_or(first.min(0.0));
    if !(start.is_finite() && start < end && start <= first) {
        return Err(EmissionError::option("start", start, format!("a number up to the first event, {first}")));
    }
    let width = (end - start) / bins as f64;
    let mut points = Vec::with_capacity(bins);
    let (mut at, mut sum) = (0, 0.0);
    for bin in 1..=bins {
        let to = if bin == bins { end } else { start + bin as f64 * width };
        let before = at;
        while at < events.len() && events[at].0 <= to {
            sum += events[at].1;
            at += 1;
        }
        let count = at - before;
        points.push(ActivityPoint {
            to,
            events: count,
            rate: count as f64 / width,
            rate_error: (count as f64).sqrt() / width,
            cumulative_events: at,
            cumulative_amplitude_v: sum,
        });
    }
    let (exponent, exponent_se) = exponent(&events, start, end);
    let ci95 = [exponent - Z95 * exponent_se, exponent + Z95 * exponent_se];
    Ok(Activity { against, points, exponent, exponent_se, ci95, hardening: ci95[1] < 1.0 })
}

/// The power-law process (Crow 1974): m = n / sum ln((end - start)/(x_i - start)) over all but the last event, standard error
/// m/sqrt n. An event at the very start says nothing about m.
fn exponent(events: &[(f64, f64)], start: f64, end: f64) -> (f64, f64) {
    let logs: Vec<f64> = events
        .iter()
        .filter(|event| event.0 > start && event.0 < end)
        .map(|e| ((end - start) / (e.0 - start)).ln())
        .collect();
    let n = logs.len() as f64;
    let m = n / logs.iter().sum::<f64>();
    (m, m / n.sqrt())
}

/// The strain, stress or time that divides the events into two parts of different rate, with the gain in log likelihood over one
/// rate: where hardening sets in. `None` for fewer than 20 events.
#[must_use]
pub fn change_point(position: &[f64], start: f64) -> Option<(f64, f64)> {
    let mut sorted: Vec<f64> = position.to_vec();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len();
    let end = *sorted.last()?;
    if n < FEWEST || end <= start {
        return None;
    }
    let gain = |x: f64| {
        let before = sorted.partition_point(|&p| p <= x) as f64;
        let part = |count: f64, length: f64| if count > 0.0 { count * (count / length).ln() } else { 0.0 };
        part(before, x - start) + part(n as f64 - before, end - x) - part(n as f64, end - start)
    };
    let margin = 0.02 * (end - start);
    // the gain is not unimodal: the best of the events, then between its neighbours
    let inner = sorted.iter().copied().filter(|x| (start + margin..end - margin).contains(x));
    let best = inner.max_by(|a, b| gain(*a).total_cmp(&gain(*b)))?;
    Some(maximum(gain, best - margin / 10.0, best + margin / 10.0))
        .filter(|found| found.1 >= gain(best))
        .or(Some((best, gain(best))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emission::catalogue::Column;
    use crate::emission::close;
    use crate::emission::synthetic::{SyntheticOptions, synthetic};

    #[test]
    fn hardening_is_told_from_a_steady_rate() {
        for (hardening, seed) in [(1.0, 1), (0.4, 2)] {
            let options = SyntheticOptions { events: 4000, hardening, ..Default::default() };
            let catalogue = synthetic(&options, seed).unwrap().0;
            let times = catalogue.column(Column::TimeS).unwrap();
            let amplitudes = catalogue.amplitudes_v("x").unwrap();
            let found = activity(times, &amplitudes, Abscissa::Time, Some(0.0), 20).unwrap();
            close(found.exponent, hardening, 4.0 * found.exponent_se);
            assert_eq!(found.hardening, hardening < 1.0);
            let last = found.points[19];
            assert_eq!(last.cumulative_events, 4000);
            close(last.cumulative_amplitude_v, amplitudes.iter().sum(), 1e-9);
        }
    }

    #[test]
    fn rates_by_hand() {
        let position: Vec<f64> = (1..=20).map(f64::from).collect();
        let found = activity(&position, &[2.0; 20], Abscissa::Strain, None, 2).unwrap();
        assert_eq!((found.points[0].events, found.points[0].rate), (10, 1.0));
        assert_eq!(found.points[1].cumulative_amplitude_v, 40.0);
        assert!(activity(&position, &[2.0; 20], Abscissa::Strain, Some(5.0), 2).is_err());
        assert!(activity(&position[..3], &[2.0; 3], Abscissa::Strain, None, 2).is_err());
    }

    #[test]
    fn a_change_of_rate_is_found_where_it_is() {
        let mut position: Vec<f64> = (0..300).map(|i| f64::from(i) / 100.0).collect();
        position.extend((0..70).map(|i| 3.0 + f64::from(i) / 10.0));
        let (at, gain) = change_point(&position, 0.0).unwrap();
        close(at, 3.0, 0.1);
        assert!(gain > 50.0);
        assert_eq!(change_point(&position[..5], 0.0), None);
    }
}

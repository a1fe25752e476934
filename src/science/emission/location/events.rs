//! From a catalogue of hits to one of located events.
//!
//! Arrival times are freed of the delays of their sensors, grouped ([`super::grouping`]) and located ([`super::locate`]). Where the
//! error of an arrival time is not given, it is taken from the residuals of all events together: those of one event are too few to
//! say how large its covariance is. An event whose residuals are larger than that error allows keeps no position.

use std::collections::BTreeMap;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::grouping::{ChannelHit, Event, GroupingOptions, group};
use super::{Arrival, Location, LocationOptions, distance, locate};
use crate::emission::catalogue::{Catalogue, Column, Sensor};
use crate::emission::error::{EmissionError, positive};
use crate::emission::numerics::{mean, quantile, standard_deviation};
use crate::emission::special::chi_square_survival;
use crate::progress::Progress;

/// How hits become located events.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(default, deny_unknown_fields)]
pub struct EventOptions {
    /// 1 (x), 2 (x and y) or 3 coordinates; the others are those of the sensor that was hit first.
    #[cfg_attr(feature = "schema", schema(minimum = 1, maximum = 3, default = 3))]
    pub dimensions: usize,
    /// Wave speed, m/s: the truth, or the start where it is fitted; none takes the longitudinal speed of the metadata.
    #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
    pub speed_m_per_s: Option<f64>,
    /// Whether the speed is fitted, for each event.
    pub free_speed: bool,
    /// Standard error of an arrival time, s; none takes it from the residuals of all events.
    #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
    pub arrival_error_s: Option<f64>,
    /// Longest delay of a hit behind the first one of its event, s; none grants each pair of sensors the time that their distance
    /// takes, and `slack_s`.
    #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
    pub window_s: Option<f64>,
    /// Time that is granted beyond the way between two sensors, s; none takes 5 times `arrival_error_s`, or a twentieth of the
    /// longest way where that is not given, and a fifth of it more where the speed is fitted.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub slack_s: Option<f64>,
    /// Fewest channels of an event; none takes as many as a position needs.
    #[cfg_attr(feature = "schema", schema(minimum = 1, maximum = 1000))]
    pub fewest_channels: Option<usize>,
    /// An event whose residuals have less than this probability keeps no position, 0 to 0.5; 0 keeps all.
    #[cfg_attr(feature = "schema", schema(minimum = 0, maximum = 0.5, default = 0.001))]
    pub significance: f64,
}

impl Default for EventOptions {
    fn default() -> Self {
        Self {
            dimensions: 3,
            speed_m_per_s: None,
            free_speed: false,
            arrival_error_s: None,
            window_s: None,
            slack_s: None,
            fewest_channels: None,
            significance: 1e-3,
        }
    }
}

/// What became of the hits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct EventSummary {
    /// Hits of the catalogue.
    pub hits: usize,
    /// Hits of channels that have no sensor in the metadata; they were left out.
    pub hits_without_sensor: usize,
    /// Hits that belong to an event.
    pub hits_grouped: usize,
    /// Events.
    pub events: usize,
    /// Events with a position.
    pub located: usize,
    /// Events whose arrivals fix no position.
    pub not_converged: usize,
    /// Events whose residuals are too large.
    pub misfits: usize,
    /// Standard error of an arrival time, s: given, or of the residuals; null where it is not known.
    pub arrival_error_s: Option<f64>,
    /// Root mean square of all residuals of located events, us.
    pub residual_us: Option<f64>,
    /// Half of the located events have a standard error of at most this, m: the root of the mean variance of the fitted coordinates.
    pub median_se_m: Option<f64>,
    /// Mean of the wave speeds of located events, m/s.
    pub speed_m_per_s: Option<f64>,
    /// Standard deviation of fitted wave speeds, m/s; null where the speed was fixed.
    pub speed_sd_m_per_s: Option<f64>,
}

const WHAT: &str = "location";

/// What a location needs, checked.
struct Plan<'a> {
    sensors: &'a [Sensor],
    times: &'a [f64],
    channels: &'a [f64],
    location: LocationOptions,
    grouping: GroupingOptions,
}

impl<'a> Plan<'a> {
    fn new(catalogue: &'a Catalogue, options: &EventOptions) -> Result<Self, EmissionError> {
        let times = catalogue.require(Column::TimeS, WHAT)?;
        let channels = catalogue.require(Column::Channel, WHAT)?;
        let metadata = &catalogue.metadata;
        let speed = options.speed_m_per_s.or(metadata.longitudinal_speed_m_per_s);
        let speed_m_per_s = speed.ok_or(EmissionError::MissingMetadata {
            item: "the wave speed (speed_m_per_s, or longitudinal_speed_m_per_s of the data set)",
            needed_by: WHAT,
        })?;
        let location = LocationOptions {
            dimensions: options.dimensions,
            speed_m_per_s,
            free_speed: options.free_speed,
            arrival_error_s: options.arrival_error_s,
        };
        location.check()?;
        if !(0.0..=0.5).contains(&options.significance) {
            return Err(EmissionError::option("significance", options.significance, "0 to 0.5"));
        }
        let sensors = metadata.sensors.as_slice();
        let needed = location.unknowns() + usize::from(options.arrival_error_s.is_none());
        if sensors.is_empty() {
            return Err(EmissionError::MissingMetadata { item: "the sensors with their positions", needed_by: WHAT });
        }
        if let Some(twice) = sensors.iter().enumerate().find(|(k, sensor)| of_channel(&sensors[..*k], sensor.channel)) {
            let accepted = "one sensor a channel";
            return Err(EmissionError::option("sensors", format!("channel {} twice", twice.1.channel), accepted));
        }
        if sensors.len() < needed {
            return Err(EmissionError::TooFewEvents { what: "sensors of a location", found: sensors.len(), needed });
        }
        let longest = sensors.iter().flat_map(|a| sensors.iter().map(|b| distance(a.position_m, b.position_m)));
        let longest = longest.fold(0.0, f64::max) / speed_m_per_s;
        let slack = options.arrival_error_s.map_or(longest / 20.0, |error| 5.0 * error);
        let slack = slack + if options.free_speed { longest / 5.0 } else { 0.0 };
        let fewest_channels = options.fewest_channels.unwrap_or(needed);
        if !(1..=sensors.len()).contains(&fewest_channels) {
            let accepted = format!("1 to {}, the number of sensors", sensors.len());
            return Err(EmissionError::option("fewest_channels", fewest_channels, accepted));
        }
        let slack_s = options.slack_s.unwrap_or(slack);
        let grouping = GroupingOptions { speed_m_per_s, slack_s, window_s: options.window_s, fewest_channels };
        // the options alone
        group(&[], sensors, &grouping)?;
        options.arrival_error_s.map(|error| positive("arrival_error_s", error)).transpose()?;
        Ok(Self { sensors, times, channels, location, grouping })
    }

    /// The hits of channels with a sensor, in the order of their times without delays, and their rows.
    fn hits(&self) -> (Vec<ChannelHit>, Vec<usize>) {
        let delay = |channel: f64| {
            let sensor = self.sensors.iter().find(|sensor| f64::from(sensor.channel) == channel)?;
            Some((sensor.channel, sensor.delay_s))
        };
        let rows = self.times.iter().zip(self.channels).enumerate();
        let mut hits: Vec<(ChannelHit, usize)> = rows
            .filter_map(|(row, (time, channel))| {
                let (channel, delay_s) = delay(*channel)?;
                Some((ChannelHit { channel, time_s: time - delay_s }, row))
            })
            .collect();
        hits.sort_by(|a, b| a.0.time_s.total_cmp(&b.0.time_s));
        hits.into_iter().unzip()
    }

    /// Arrivals at sensors; the times hold no delay any more, so that of the sensor is given back to be taken off by [`locate`].
    fn arrivals(&self, event: &Event, hits: &[ChannelHit]) -> Vec<Arrival> {
        let arrival = |&hit: &usize| {
            let sensor = self.sensors.iter().position(|sensor| sensor.channel == hits[hit].channel)?;
            Some(Arrival { sensor, time_s: hits[hit].time_s + self.sensors[sensor].delay_s })
        };
        event.hits.iter().filter_map(arrival).collect()
    }

    /// The position of each event; none where its arrivals fix none.
    fn locate(
        &self,
        arrivals: &[Vec<Arrival>],
        error_s: Option<f64>,
        part: (f64, &dyn Progress),
    ) -> Result<Vec<Option<Location>>, EmissionError> {
        let options = LocationOptions { arrival_error_s: error_s, ..self.location };
        let (from, progress) = part;
        let one = |(number, arrivals): (usize, &Vec<Arrival>)| {
            if progress.cancelled() {
                return Err(EmissionError::Cancelled);
            }
            if number.is_multiple_of(256) {
                progress.report(from + 0.5 * number as f64 / self.times.len().max(1) as f64, "locating events");
            }
            Ok(locate(self.sensors, arrivals, &options).ok())
        };
        arrivals.par_iter().enumerate().map(one).collect()
    }

    fn spare(&self, location: &Location) -> usize {
        location.arrivals.saturating_sub(self.location.unknowns())
    }

    /// Standard error of an arrival time from the residuals of all events; those that do not fit are left out.
    fn pooled_error(&self, found: &[Option<Location>]) -> Option<f64> {
        let squares = |location: &Location| location.residual_s.powi(2) * location.arrivals as f64;
        let with_spare = found.iter().flatten().map(|location| (squares(location), self.spare(location) as f64));
        let with_spare: Vec<(f64, f64)> = with_spare.filter(|(_, spare)| *spare > 0.0).collect();
        // begins at the median of the single estimates, freed of the bias of a median (Wilson & Hilferty 1931)
        let single = |(squares, spare): &(f64, f64)| squares / (spare * (1.0 - 2.0 / (9.0 * spare)).powi(3));
        let mut singles: Vec<f64> = with_spare.iter().map(single).collect();
        singles.sort_by(f64::total_cmp);
        let mut variance = if singles.is_empty() { return None } else { quantile(&singles, 0.5) };
        for _ in 0..50 {
            let fits = |(squares, spare): &&(f64, f64)| {
                variance > 0.0 && chi_square_survival(squares / variance, *spare) > POOLED_FROM
            };
            let (sum, degrees) =
                with_spare.iter().filter(fits).fold((0.0, 0.0), |(s, d), (squares, spare)| (s + squares, d + spare));
            let next = if degrees > 0.0 { sum / degrees } else { variance };
            if (next - variance).abs() <= 1e-12 * variance {
                break;
            }
            variance = next;
        }
        Some(variance.sqrt()).filter(|error| *error > 0.0)
    }
}

/// Events whose residuals are less probable than that do not count for the error of an arrival time.
const POOLED_FROM: f64 = 1e-3;

fn of_channel(sensors: &[Sensor], channel: u32) -> bool {
    sensors.iter().any(|sensor| sensor.channel == channel)
}

/// Whether the events of `catalogue` can be located, as far as that is known beforehand.
///
/// # Errors
/// Missing columns or metadata, or options out of range.
pub fn check(catalogue: &Catalogue, options: &EventOptions) -> Result<(), EmissionError> {
    Plan::new(catalogue, options).map(|_| ())
}

/// The events of a catalogue of hits, in the order of their origin times, and what became of the hits.
///
/// An event has the values of its first hit (amplitude, duration, energy, ...), its origin time, the number of its channels, its
/// position with standard errors and covariances, and the root mean square of its residuals. One without a position has the time
/// of its first hit. `location_error_m` of the metadata is the root of the mean variance of all fitted coordinates.
///
/// # Errors
/// As [`check`]; no events; or [`EmissionError::Cancelled`].
pub fn locate_events(
    catalogue: &Catalogue,
    options: &EventOptions,
    progress: &dyn Progress,
) -> Result<(Catalogue, EventSummary), EmissionError> {
    let plan = Plan::new(catalogue, options)?;
    progress.report(0.0, "grouping hits");
    let (hits, rows) = plan.hits();
    let events = group(&hits, plan.sensors, &plan.grouping)?;
    if events.is_empty() {
        return Err(EmissionError::TooFewEvents { what: "events of enough channels", found: 0, needed: 1 });
    }
    let arrivals: Vec<Vec<Arrival>> = events.iter().map(|event| plan.arrivals(event, &hits)).collect();
    let error_s = match options.arrival_error_s {
        Some(error) => Some(error),
        None => plan.pooled_error(&plan.locate(&arrivals, None, (0.0, progress))?),
    };
    let found = plan.locate(&arrivals, error_s, (0.5, progress))?;
    let not_converged = found.iter().filter(|location| location.is_none()).count();
    let fits = |location: &Location| {
        let spare = plan.spare(location) as f64;
        let squares = error_s.map(|error| location.residual_s.powi(2) * location.arrivals as f64 / (error * error));
        spare == 0.0 || squares.is_none_or(|squares| chi_square_survival(squares, spare) >= options.significance)
    };
    let kept: Vec<Option<Location>> = found.iter().map(|location| location.clone().filter(fits)).collect();
    let located: Vec<&Location> = kept.iter().flatten().collect();
    let summary = EventSummary {
        hits: catalogue.len(),
        hits_without_sensor: catalogue.len() - hits.len(),
        hits_grouped: events.iter().map(|event| event.hits.len()).sum(),
        events: events.len(),
        located: located.len(),
        not_converged,
        misfits: found.len() - not_converged - located.len(),
        arrival_error_s: error_s,
        ..summary_of(&located, options)
    };
    let first_rows: Vec<usize> = events.iter().map(|event| rows[event.hits[0]]).collect();
    let first_times: Vec<f64> = events.iter().map(|event| hits[event.hits[0]].time_s).collect();
    let sizes: Vec<usize> = events.iter().map(|event| event.hits.len()).collect();
    Ok((assemble(catalogue, &first_rows, &first_times, &sizes, &kept, options.dimensions)?, summary))
}

/// Variance of a fitted coordinate, the mean of all, m2.
fn variance(location: &Location, dimensions: usize) -> f64 {
    (0..dimensions).map(|k| location.covariance_m2[k][k]).sum::<f64>() / dimensions as f64
}

/// The numbers about located events; those about hits are 0.
fn summary_of(located: &[&Location], options: &EventOptions) -> EventSummary {
    let some = |value: f64| (!located.is_empty()).then_some(value);
    let squares: f64 = located.iter().map(|location| location.residual_s.powi(2) * location.arrivals as f64).sum();
    let arrivals: usize = located.iter().map(|location| location.arrivals).sum();
    let mut errors: Vec<f64> = located.iter().map(|location| variance(location, options.dimensions).sqrt()).collect();
    errors.sort_by(f64::total_cmp);
    let speeds: Vec<f64> = located.iter().map(|location| location.speed_m_per_s).collect();
    let spread = options.free_speed && located.len() > 1;
    EventSummary {
        hits: 0,
        hits_without_sensor: 0,
        hits_grouped: 0,
        events: 0,
        located: 0,
        not_converged: 0,
        misfits: 0,
        arrival_error_s: None,
        residual_us: some((squares / arrivals as f64).sqrt() * 1e6),
        median_se_m: (!errors.is_empty()).then(|| quantile(&errors, 0.5)),
        speed_m_per_s: some(mean(&speeds)),
        speed_sd_m_per_s: spread.then(|| standard_deviation(&speeds)),
    }
}

/// The catalogue of events.
fn assemble(
    catalogue: &Catalogue,
    first_rows: &[usize],
    first_times: &[f64],
    sizes: &[usize],
    kept: &[Option<Location>],
    dimensions: usize,
) -> Result<Catalogue, EmissionError> {
    let times: Vec<f64> = kept
        .iter()
        .zip(first_times)
        .map(|(location, first)| location.as_ref().map_or(*first, |l| l.origin_s))
        .collect();
    let mut order: Vec<usize> = (0..times.len()).collect();
    order.sort_by(|&a, &b| times[a].total_cmp(&times[b]));
    let mut columns: BTreeMap<Column, Vec<f64>> = BTreeMap::new();
    for (column, values) in catalogue.columns().filter(|(column, _)| !column.is_of_place()) {
        columns.insert(column, order.iter().map(|&event| values[first_rows[event]]).collect());
    }
    columns.insert(Column::TimeS, order.iter().map(|&event| times[event]).collect());
    columns.insert(Column::Channels, order.iter().map(|&event| sizes[event] as f64).collect());
    type Value = fn(&Location) -> f64;
    let values: [(Column, Value); 10] = [
        (Column::XM, |l| l.position_m[0]),
        (Column::YM, |l| l.position_m[1]),
        (Column::ZM, |l| l.position_m[2]),
        (Column::XSeM, |l| l.covariance_m2[0][0].sqrt()),
        (Column::YSeM, |l| l.covariance_m2[1][1].sqrt()),
        (Column::ZSeM, |l| l.covariance_m2[2][2].sqrt()),
        (Column::XyCovM2, |l| l.covariance_m2[0][1]),
        (Column::XzCovM2, |l| l.covariance_m2[0][2]),
        (Column::YzCovM2, |l| l.covariance_m2[1][2]),
        (Column::ResidualUs, |l| l.residual_s * 1e6),
    ];
    for (column, value) in values {
        columns.insert(column, order.iter().map(|&event| kept[event].as_ref().map_or(f64::NAN, value)).collect());
    }
    let mut metadata = catalogue.metadata.clone();
    let variances: Vec<f64> = kept.iter().flatten().map(|location| variance(location, dimensions)).collect();
    metadata.location_error_m = Some(mean(&variances).sqrt()).filter(|error| error.is_finite() && *error > 0.0);
    Catalogue::new(columns, metadata)
}

//! Hits of several channels that belong to one event.

use serde::{Deserialize, Serialize};

use crate::emission::catalogue::Sensor;
use crate::emission::error::{EmissionError, positive};

/// A hit that may belong to an event.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChannelHit {
    /// Channel.
    pub channel: u32,
    /// Arrival time, s.
    pub time_s: f64,
}

/// Hits of one event, by their positions in the list of hits, the first arrival first.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Event {
    /// Positions in the list of hits.
    pub hits: Vec<usize>,
}

/// How hits are grouped.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct GroupingOptions {
    /// Wave speed, m/s: two sensors cannot differ by more than their distance takes.
    pub speed_m_per_s: f64,
    /// Time that is granted beyond that for errors of the arrival times, s.
    pub slack_s: f64,
    /// Longest delay of a hit behind the first one of its event, s; none grants each pair of sensors the time that their distance
    /// takes, and the slack.
    #[serde(default)]
    pub window_s: Option<f64>,
    /// Fewest channels of an event.
    pub fewest_channels: usize,
}

/// Groups `hits` (times not falling) into events: an event begins with a hit and takes the first hit of each other channel that
/// arrives within the window, or else no later than the way between the two sensors (of known position) allows. A hit belongs to
/// one event at most.
///
/// # Errors
/// Options out of range, a channel without a sensor, or times that fall.
pub fn group(hits: &[ChannelHit], sensors: &[Sensor], options: &GroupingOptions) -> Result<Vec<Event>, EmissionError> {
    positive("speed_m_per_s", options.speed_m_per_s)?;
    if !(options.slack_s.is_finite() && options.slack_s >= 0.0) {
        return Err(EmissionError::option("slack_s", options.slack_s, "a finite number of at least 0"));
    }
    options.window_s.map(|window| positive("window_s", window)).transpose()?;
    if options.fewest_channels == 0 {
        return Err(EmissionError::option("fewest_channels", options.fewest_channels, "at least 1"));
    }
    let of_channel = |channel: u32| sensors.iter().position(|sensor| sensor.channel == channel);
    let mut sensor = Vec::with_capacity(hits.len());
    for (row, hit) in hits.iter().enumerate() {
        let falls = row > 0 && hit.time_s < hits[row - 1].time_s;
        if falls || !hit.time_s.is_finite() {
            let accepted = "a finite time not before the row above";
            return Err(EmissionError::Value { column: "time_s", row: row + 1, value: hit.time_s, accepted });
        }
        let refused = || EmissionError::option("channel", hit.channel, "a channel with a sensor");
        sensor.push(of_channel(hit.channel).ok_or_else(refused)?);
    }
    let way = |a: usize, b: usize| {
        if let Some(window) = options.window_s {
            return window;
        }
        let (a, b) = (sensors[a].position_m, sensors[b].position_m);
        let squares: f64 = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum();
        squares.sqrt() / options.speed_m_per_s + options.slack_s
    };
    let longest =
        (0..sensors.len()).flat_map(|a| (0..a).map(move |b| (a, b))).map(|(a, b)| way(a, b)).fold(0.0, f64::max);
    let mut taken = vec![false; hits.len()];
    let mut events = Vec::new();
    for first in 0..hits.len() {
        if taken[first] {
            continue;
        }
        let mut members = vec![first];
        for next in first + 1..hits.len() {
            let delay = hits[next].time_s - hits[first].time_s;
            if delay > longest {
                break;
            }
            let is_new = !taken[next] && members.iter().all(|&member| sensor[member] != sensor[next]);
            if is_new && delay <= way(sensor[first], sensor[next]) {
                members.push(next);
            }
        }
        if members.len() >= options.fewest_channels {
            members.iter().for_each(|&member| taken[member] = true);
            events.push(Event { hits: members });
        }
    }
    Ok(events)
}

//! Catalogues with known truth, for demonstrations and tests: **no measurement**, and called synthetic wherever they show.
//!
//! The distributions have the exponents that Richeton, Weiss & Louchet (2005, Acta Mater. 53; Nature Mater. 4) are quoted with;
//! all other numbers below were chosen for plausibility. With A_th the amplitude of the floor:
//! * single crystal: `P(A) ~ A^-2`, whatever the temperature; damping `g = 5000 exp((T + 10) / 20)` 1/s at T degC (warmer is
//!   shorter);
//! * polycrystal: `P(A) ~ A^-1.35 exp(-A/A_c)` with `A_c = 0.1 V x grain size / 0.87 mm`; `g = 5000 (1 + 0.87 mm / grain size)`
//!   1/s at -10 degC (finer is shorter), with the same factor of temperature;
//! * duration `(1/g) ln(A/A_th)` times a lognormal factor of mean 1 and log standard deviation 0.3; unloading divides g by 1.6
//!   for amplitudes above 10 mV; the power law of unloading polycrystals is that of single crystals;
//! * energy `A^2 / (4 g)` in eu, counts 150 kHz times the duration, rise time a fifth of it;
//! * times: background events whose number grows as t^hardening, and aftershocks: a parent is drawn in proportion to
//!   `(A/A_th)^0.5` and followed after a delay of density `(p - 1) c^(p - 1) / (t + c)^p` (Omori-Utsu);
//! * positions: in each coordinate a random point of a two-piece Cantor set with the ratio 2^(-3/D), whose product has the
//!   correlation dimension D; location errors are added.

use std::collections::BTreeMap;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::catalogue::{Catalogue, Column, Metadata, Phase, Sensor};
use super::error::{EmissionError, positive};
use super::tails::distribution::Distribution;

/// Most events that are made.
pub const MOST_EVENTS: usize = 5_000_000;

/// Aftershocks.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct Clustering {
    /// Share of the events that are aftershocks of others, 0 up to below 1.
    pub branching_ratio: f64,
    /// Omori's c, s.
    pub c_s: f64,
    /// Omori's p, above 1.
    pub p: f64,
}

/// Hits of several sensors in place of events.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct SensorHits {
    /// Wave speed, m/s.
    #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0))]
    pub speed_m_per_s: f64,
    /// Standard error of an arrival time, s.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub arrival_error_s: f64,
}

/// What to make.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(default, deny_unknown_fields)]
pub struct SyntheticOptions {
    /// Events.
    pub events: usize,
    /// Temperature, degC.
    pub temperature_c: f64,
    /// Mean grain size of a polycrystal, mm; none for a single crystal.
    pub grain_size_mm: Option<f64>,
    /// Share of the events, at the end of the test, that happen during unloading, 0 to 1.
    pub unloading_share: f64,
    /// Length of the test, s.
    pub length_s: f64,
    /// Number of background events ~ time^hardening: 1 is steady, less is hardening.
    pub hardening: f64,
    /// Aftershocks; none for independent events.
    pub clustering: Option<Clustering>,
    /// Correlation dimension of the positions, above 0 to 3.
    pub dimension: f64,
    /// Edge of the sample, m.
    pub size_m: f64,
    /// Standard error of a coordinate, m.
    pub location_error_m: f64,
    /// Amplitudes are recorded in whole steps of so many decibels; none records them in V.
    pub db_step: Option<f64>,
    /// Detection threshold, dB_AE.
    pub floor_db: f64,
    /// Largest amplitude that the recorder can hold, V.
    pub clip_v: f64,
    /// Hits of the eight sensors at the corners of the sample in place of events with positions: all sensors record the same
    /// signal (no attenuation), and the sources are those of the events that the same options and seed give without this.
    pub hits: Option<SensorHits>,
}

impl Default for SyntheticOptions {
    fn default() -> Self {
        Self {
            events: 10_000,
            temperature_c: -10.0,
            grain_size_mm: None,
            unloading_share: 0.0,
            length_s: 3600.0,
            hardening: 1.0,
            clustering: None,
            dimension: 2.5,
            size_m: 0.1,
            location_error_m: 1e-4,
            db_step: None,
            floor_db: 30.0,
            clip_v: 10.0,
            hits: None,
        }
    }
}

/// What is true of a synthetic catalogue.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Truth {
    /// Exponent of P(A) while loading.
    pub tau: f64,
    /// Cut-off of P(A) while loading, V; none for a single crystal.
    pub cutoff_v: Option<f64>,
    /// Exponent of P(A) while unloading (a pure power law).
    pub tau_unloading: f64,
    /// Damping while loading, 1/s.
    pub damping_per_s: f64,
    /// Damping while unloading above 10 mV, 1/s.
    pub damping_unloading_per_s: f64,
    /// Exponent x of E ~ A^x.
    pub energy_exponent: f64,
    /// Smallest amplitude, V.
    pub threshold_v: f64,
    /// Correlation dimension of the positions.
    pub dimension: f64,
    /// Aftershocks.
    pub clustering: Option<Clustering>,
    /// Seed.
    pub seed: u64,
    /// Events whose amplitude was clipped.
    pub clipped: usize,
}

/// Gain of the preamplifier, dB.
const GAIN_DB: f64 = 40.0;
/// Amplitude above which unloading is damped less, V.
const UNLOADING_FROM_V: f64 = 0.01;
/// Factor by which unloading is damped less.
const UNLOADING_FACTOR: f64 = 1.6;
/// Exponent of an amplitude in its number of aftershocks.
const PRODUCTIVITY: f64 = 0.5;

/// A catalogue and what is true of it; the same `seed` gives the same bits.
///
/// # Errors
/// [`EmissionError::Option`].
pub fn synthetic(options: &SyntheticOptions, seed: u64) -> Result<(Catalogue, Truth), EmissionError> {
    check(options)?;
    let mut maker = Maker::new(options, seed);
    let unloading: Vec<bool> = maker.phases();
    let amplitudes: Vec<f64> = unloading.iter().map(|&unloading| maker.amplitude(unloading)).collect();
    let times = maker.times(&amplitudes);
    let mut columns: BTreeMap<Column, Vec<f64>> = BTreeMap::new();
    // unloading is at the end of the test, so that rows are ordered by their phase and then by time
    let mut order: Vec<usize> = (0..amplitudes.len()).collect();
    order.sort_by(|&a, &b| times[a].total_cmp(&times[b]));
    let mut clipped = 0;
    let mut add = |column: Column, value: f64| columns.entry(column).or_default().push(value);
    for &event in &order {
        let amplitude = amplitudes[event];
        let damping = maker.damping(amplitude, unloading[event]);
        let duration = (amplitude / maker.truth.threshold_v).ln() / damping * maker.scatter(0.3);
        clipped += usize::from(amplitude > options.clip_v);
        let recorded = amplitude.min(options.clip_v);
        match options.db_step {
            Some(step) => {
                let db = 20.0 * (recorded / 1e-6).log10() - GAIN_DB;
                add(Column::AmplitudeDb, (db / step).round() * step);
            }
            None => add(Column::AmplitudeV, recorded),
        }
        add(Column::TimeS, times[event]);
        add(Column::DurationUs, duration * 1e6);
        add(Column::RiseTimeUs, duration * 1e6 / 5.0);
        add(Column::Counts, (150e3 * duration).round().max(1.0));
        add(Column::EnergyEu, amplitude * amplitude / (4.0 * damping) / 1e-14);
        add(Column::Strain, 0.05 * (times[event] / options.length_s).powf(options.hardening));
        add(Column::Phase, f64::from(u8::from(unloading[event])));
        for (column, coordinate) in [Column::XM, Column::YM, Column::ZM].into_iter().zip(maker.position()) {
            add(column, coordinate);
        }
    }
    let truth = Truth { clipped, ..maker.truth.clone() };
    if let Some(recorded) = &options.hits {
        columns = hits(columns, recorded, options, seed);
    }
    Ok((Catalogue::new(columns, metadata(options, &truth))?, truth))
}

/// The hits of all sensors, in the order of their arrival; what a hit of an event has in common with the others is repeated.
fn hits(
    events: BTreeMap<Column, Vec<f64>>,
    recorded: &SensorHits,
    options: &SyntheticOptions,
    seed: u64,
) -> BTreeMap<Column, Vec<f64>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    // the stream 0 makes the events
    rng.set_stream(1);
    let sensors = corners(options);
    let of = |column: Column, event: usize| events.get(&column).map_or(0.0, |values| values[event]);
    let count = events.values().next().map_or(0, Vec::len);
    let mut arrivals = Vec::with_capacity(count * sensors.len());
    for event in 0..count {
        let source = [Column::XM, Column::YM, Column::ZM].map(|column| of(column, event));
        for sensor in &sensors {
            let squares: f64 = source.iter().zip(sensor.position_m).map(|(a, b)| (a - b) * (a - b)).sum();
            let late = squares.sqrt() / recorded.speed_m_per_s + recorded.arrival_error_s * normal(&mut rng);
            arrivals.push((of(Column::TimeS, event) + late, f64::from(sensor.channel), event));
        }
    }
    arrivals.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut columns: BTreeMap<Column, Vec<f64>> = BTreeMap::new();
    for (column, values) in events.iter().filter(|(column, _)| !column.is_of_place()) {
        columns.insert(*column, arrivals.iter().map(|arrival| values[arrival.2]).collect());
    }
    columns.insert(Column::TimeS, arrivals.iter().map(|arrival| arrival.0).collect());
    columns.insert(Column::Channel, arrivals.iter().map(|arrival| arrival.1).collect());
    columns
}

fn check(options: &SyntheticOptions) -> Result<(), EmissionError> {
    if !(1..=MOST_EVENTS).contains(&options.events) {
        return Err(EmissionError::option("events", options.events, format!("1 to {MOST_EVENTS}")));
    }
    for (name, value) in [("length_s", options.length_s), ("size_m", options.size_m), ("clip_v", options.clip_v)] {
        positive(name, value)?;
    }
    options.grain_size_mm.map(|value| positive("grain_size_mm", value)).transpose()?;
    options.db_step.map(|value| positive("db_step", value)).transpose()?;
    let within = |name, value: f64, ok: bool, accepted: &str| {
        if ok { Ok(()) } else { Err(EmissionError::option(name, value, accepted)) }
    };
    let o = options;
    within("temperature_c", o.temperature_c, (-100.0..=0.0).contains(&o.temperature_c), "-100 to 0 degC")?;
    within("unloading_share", o.unloading_share, (0.0..=1.0).contains(&o.unloading_share), "0 to 1")?;
    within("hardening", o.hardening, o.hardening > 0.0 && o.hardening <= 1.0, "above 0 to 1")?;
    within("dimension", o.dimension, o.dimension > 0.0 && o.dimension <= 3.0, "above 0 to 3")?;
    within("location_error_m", o.location_error_m, (0.0..=o.size_m).contains(&o.location_error_m), "0 to size_m")?;
    within("floor_db", o.floor_db, (0.0..=90.0).contains(&o.floor_db), "0 to 90 dB_AE")?;
    if let Some(SensorHits { speed_m_per_s, arrival_error_s }) = o.hits {
        positive("speed_m_per_s", speed_m_per_s)?;
        let good = arrival_error_s.is_finite() && arrival_error_s >= 0.0;
        within("arrival_error_s", arrival_error_s, good, "a finite number of at least 0")?;
        within("events", o.events as f64, o.events <= MOST_EVENTS / 8, "an eighth of the largest number, with hits")?;
    }
    if let Some(Clustering { branching_ratio, c_s, p }) = o.clustering {
        within("branching_ratio", branching_ratio, (0.0..1.0).contains(&branching_ratio), "0 up to below 1")?;
        positive("c_s", c_s)?;
        within("p", p, p > 1.0 && p <= 5.0, "above 1 to 5")?;
    }
    Ok(())
}

/// Sensors at the corners of the sample.
fn corners(options: &SyntheticOptions) -> Vec<Sensor> {
    let corner = |k: usize, bit: usize| if k >> bit & 1 == 1 { options.size_m } else { 0.0 };
    let sensor = |k: usize| Sensor {
        channel: k as u32 + 1,
        position_m: [corner(k, 0), corner(k, 1), corner(k, 2)],
        sensitivity_v_per_pa: None,
        delay_s: 0.0,
    };
    (0..8).map(sensor).collect()
}

fn metadata(options: &SyntheticOptions, truth: &Truth) -> Metadata {
    Metadata {
        material: Some("ice (synthetic)".to_owned()),
        temperature_c: Some(options.temperature_c),
        grain_size_mm: options.grain_size_mm,
        phase: (options.unloading_share == 0.0).then_some(Phase::Loading),
        preamp_gain_db: Some(GAIN_DB),
        threshold_v: Some(truth.threshold_v),
        location_error_m: Some(options.location_error_m).filter(|&error| error > 0.0 && options.hits.is_none()),
        longitudinal_speed_m_per_s: options.hits.map(|hits| hits.speed_m_per_s),
        sensors: corners(options),
        ..Metadata::default()
    }
}

struct Maker<'a> {
    options: &'a SyntheticOptions,
    truth: Truth,
    loading: super::tails::distribution::Draw,
    unloading: super::tails::distribution::Draw,
    rng: ChaCha8Rng,
}

impl<'a> Maker<'a> {
    fn new(options: &'a SyntheticOptions, seed: u64) -> Self {
        let threshold_v = 1e-6 * 10f64.powf((options.floor_db + GAIN_DB) / 20.0);
        let heat = ((options.temperature_c + 10.0) / 20.0).exp();
        let (tau, cutoff_v, fineness) = match options.grain_size_mm {
            None => (2.0, None, 1.0),
            Some(grain) => (1.35, Some(0.1 * grain / 0.87), 1.0 + 0.87 / grain),
        };
        let damping = 5000.0 * heat * fineness;
        let endless = f64::INFINITY;
        let loading = Distribution::cutoff(tau - 1.0, cutoff_v.map_or(0.0, |cutoff| threshold_v / cutoff), endless);
        let truth = Truth {
            tau,
            cutoff_v,
            tau_unloading: 2.0,
            damping_per_s: damping,
            damping_unloading_per_s: damping / UNLOADING_FACTOR,
            energy_exponent: 2.0,
            threshold_v,
            dimension: options.dimension,
            clustering: options.clustering,
            seed,
            clipped: 0,
        };
        let unloading = Distribution::cutoff(1.0, 0.0, endless).sampler();
        Self { options, truth, loading: loading.sampler(), unloading, rng: ChaCha8Rng::seed_from_u64(seed) }
    }

    fn phases(&self) -> Vec<bool> {
        let loading = ((1.0 - self.options.unloading_share) * self.options.events as f64).round() as usize;
        (0..self.options.events).map(|event| event >= loading).collect()
    }

    fn amplitude(&mut self, unloading: bool) -> f64 {
        let draw = if unloading { &self.unloading } else { &self.loading };
        self.truth.threshold_v * draw.draw(&mut self.rng).exp()
    }

    fn damping(&self, amplitude: f64, unloading: bool) -> f64 {
        if unloading && amplitude > UNLOADING_FROM_V {
            self.truth.damping_unloading_per_s
        } else {
            self.truth.damping_per_s
        }
    }

    /// A lognormal factor with the mean 1.
    fn scatter(&mut self, log_sd: f64) -> f64 {
        (log_sd * self.normal() - log_sd * log_sd / 2.0).exp()
    }

    fn normal(&mut self) -> f64 {
        normal(&mut self.rng)
    }

    /// Times of all events; unloading happens in the last part of the test, as long as its share of events.
    fn times(&mut self, amplitudes: &[f64]) -> Vec<f64> {
        let n = amplitudes.len();
        let loading = self.phases().iter().filter(|unloading| !**unloading).count();
        let turn = self.options.length_s * loading as f64 / n as f64;
        let mut times = self.phase_times(&amplitudes[..loading], 0.0, turn);
        let unloading = self.phase_times(&amplitudes[loading..], turn, self.options.length_s - turn);
        times.extend(unloading);
        times
    }

    fn phase_times(&mut self, amplitudes: &[f64], start: f64, length: f64) -> Vec<f64> {
        let n = amplitudes.len();
        let branching = self.options.clustering.map_or(0.0, |clustering| clustering.branching_ratio);
        let background = ((1.0 - branching) * n as f64).ceil() as usize;
        let mut times = Vec::with_capacity(n);
        let mut weight = Vec::with_capacity(n);
        let mut total = 0.0;
        for (event, amplitude) in amplitudes.iter().enumerate() {
            let time = match self.options.clustering {
                Some(Clustering { c_s, p, .. }) if event >= background => {
                    self.aftershock_time(&times, &weight, total, c_s, p, start + length)
                }
                _ => start + length * self.rng.random::<f64>().powf(1.0 / self.options.hardening),
            };
            times.push(time);
            total += (amplitude / self.truth.threshold_v).powf(PRODUCTIVITY);
            weight.push(total);
        }
        times
    }

    /// A time between that of a parent and the `end` of the phase.
    fn aftershock_time(&mut self, times: &[f64], weight: &[f64], total: f64, c_s: f64, p: f64, end: f64) -> f64 {
        let at = self.rng.random::<f64>() * total;
        let parent = times[weight.partition_point(|&w| w <= at).min(times.len() - 1)];
        let share = 1.0 - (1.0 + (end - parent) / c_s).powf(1.0 - p);
        let delay = c_s * ((1.0 - share * self.rng.random::<f64>()).powf(-1.0 / (p - 1.0)) - 1.0);
        (parent + delay).min(end)
    }

    fn position(&mut self) -> [f64; 3] {
        let ratio = 0.5_f64.powf(3.0 / self.options.dimension);
        let mut point = [0.0; 3];
        for coordinate in &mut point {
            let bits: u64 = self.rng.random();
            // 40 levels resolve more than a double of the whole size could tell apart from the location error
            for level in (0..40).rev() {
                *coordinate = ratio * *coordinate + if bits >> level & 1 == 1 { 1.0 - ratio } else { 0.0 };
            }
        }
        point.map(|coordinate| coordinate * self.options.size_m + self.options.location_error_m * self.normal())
    }
}

/// Standard normal, by Box & Muller.
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

#[cfg(test)]
mod tests;

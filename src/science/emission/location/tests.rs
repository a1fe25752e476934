use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::events::{EventOptions, locate_events};
use super::grouping::{ChannelHit, GroupingOptions, group};
use super::*;
use crate::emission::catalogue::{Catalogue, Column, Metadata};
use crate::emission::close;
use crate::emission::special::chi_square_survival;
use crate::progress::Unobserved;

/// Sensors at the corners of a box, with delays.
fn sensors(size: [f64; 3]) -> Vec<Sensor> {
    (0..8)
        .map(|k: usize| Sensor {
            channel: k as u32 + 1,
            position_m: [0, 1, 2].map(|axis| if k >> axis & 1 == 1 { size[axis] } else { 0.0 }),
            sensitivity_v_per_pa: None,
            delay_s: k as f64 * 1e-7,
        })
        .collect()
}

/// Twelve sensors at irregular places on the faces of a box: with a free speed its corners leave several sources possible.
fn irregular(size: [f64; 3]) -> Vec<Sensor> {
    let place = |k: usize| {
        // additive recurrence of the inverse powers of the plastic number and the golden ratio
        let mut part = [0.6180339887498949, 0.7548776662466927, 0.5698402909980532].map(|g| (k as f64 + 1.0) * g % 1.0);
        part[k % 3] = (k / 3 % 2) as f64;
        [0, 1, 2].map(|axis| part[axis] * size[axis])
    };
    let sensor = |k: usize| Sensor {
        channel: k as u32 + 1,
        position_m: place(k),
        sensitivity_v_per_pa: None,
        delay_s: k as f64 * 1e-7,
    };
    (0..12).map(sensor).collect()
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

fn arrivals(sensors: &[Sensor], source: [f64; 3], speed: f64, error: f64, rng: &mut ChaCha8Rng) -> Vec<Arrival> {
    let arrival = |(k, sensor): (usize, &Sensor)| {
        let travel = distance(source, sensor.position_m) / speed;
        Arrival { sensor: k, time_s: 12.5 + travel + sensor.delay_s + error * normal(rng) }
    };
    sensors.iter().enumerate().map(arrival).collect()
}

fn options(dimensions: usize, free_speed: bool, error: f64) -> LocationOptions {
    LocationOptions { dimensions, speed_m_per_s: 3800.0, free_speed, arrival_error_s: Some(error) }
}

#[test]
fn exact_arrivals_give_back_the_source() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for (dimensions, size) in [(1, [0.2, 0.0, 0.0]), (2, [0.2, 0.1, 0.0]), (3, [0.2, 0.1, 0.15])] {
        for free_speed in [false, true] {
            let sensors = if free_speed { irregular(size) } else { sensors(size) };
            let source = [0, 1, 2].map(|k| size[k] * (0.1 + 0.8 * rng.random::<f64>()));
            let arrivals = arrivals(&sensors, source, 3650.0, 0.0, &mut rng);
            let given = LocationOptions {
                speed_m_per_s: if free_speed { 3800.0 } else { 3650.0 },
                ..options(dimensions, free_speed, 1e-7)
            };
            // with as many different places as unknowns, several sources explain all arrivals
            if dimensions < 3 && free_speed {
                continue;
            }
            let found = locate(&sensors, &arrivals, &given).unwrap();
            for (found, source) in found.position_m.iter().zip(source).take(dimensions) {
                close(*found, source, 1e-7);
            }
            close(found.origin_s, 12.5, 1e-9);
            close(found.speed_m_per_s, 3650.0, 1e-2);
        }
    }
}

#[test]
fn events_lie_within_their_covariance_95_times_of_100() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let error = 2e-7;
    for (dimensions, size, free_speed) in [
        (1, [0.2, 0.0, 0.0], false),
        (2, [0.2, 0.1, 0.0], false),
        (3, [0.2, 0.1, 0.15], false),
        (3, [0.2, 0.1, 0.15], true),
    ] {
        let sensors = if free_speed { irregular(size) } else { sensors(size) };
        let (trials, mut inside) = (1000, 0);
        for _ in 0..trials {
            let source = [0, 1, 2].map(|k| size[k] * (0.15 + 0.7 * rng.random::<f64>()));
            let arrivals = arrivals(&sensors, source, 3800.0, error, &mut rng);
            let found = locate(&sensors, &arrivals, &options(dimensions, free_speed, error));
            let found = found.unwrap_or_else(|error| panic!("{dimensions} {free_speed} {source:?}: {error}"));
            let covariance = DMatrix::from_fn(dimensions, dimensions, |r, c| found.covariance_m2[r][c]);
            let miss = DVector::from_fn(dimensions, |k, _| found.position_m[k] - source[k]);
            let squares = (miss.transpose() * covariance.try_inverse().unwrap() * &miss)[0];
            inside += u32::from(chi_square_survival(squares, dimensions as f64) > 0.05);
        }
        // 95 % of 1000, give or take 0.7 %
        let share = f64::from(inside) / f64::from(trials);
        assert!((0.925..=0.975).contains(&share), "{dimensions} {free_speed}: {share}");
    }
}

#[test]
fn residuals_tell_the_arrival_error_where_it_is_not_given() {
    let (sensors, mut rng) = (sensors([0.2, 0.1, 0.15]), ChaCha8Rng::seed_from_u64(3));
    let mut mean = 0.0;
    for _ in 0..300 {
        let arrivals = arrivals(&sensors, [0.08, 0.06, 0.05], 3800.0, 2e-7, &mut rng);
        let given = LocationOptions { arrival_error_s: None, ..options(3, false, 1.0) };
        let found = locate(&sensors, &arrivals, &given).unwrap();
        // eight arrivals, four unknowns: half of the variance is left in the residuals
        mean += found.residual_s.powi(2) / 300.0;
    }
    close(mean.sqrt() / (2e-7 * 0.5_f64.sqrt()), 1.0, 0.1);
}

#[test]
fn what_the_sensors_cannot_tell_is_refused() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let flat = sensors([0.2, 0.1, 0.0]);
    let arrivals = arrivals(&flat, [0.1, 0.05, 0.0], 3800.0, 0.0, &mut rng);
    let few = locate(&flat, &arrivals[..3], &options(3, false, 1e-7)).unwrap_err().to_string();
    assert_eq!(few, "arrivals of a location: 3 event(s), at least 4 are needed");
    // all sensors in one plane, the source too: the third coordinate has no first-order effect
    let refused = locate(&flat, &arrivals, &options(3, false, 1e-7)).unwrap_err();
    assert_eq!(refused, EmissionError::NotConverged { what: "location" });
    assert!(locate(&flat, &arrivals, &options(4, false, 1e-7)).unwrap_err().to_string().starts_with("dimensions is 4"));
    let stranger = [Arrival { sensor: 9, time_s: 0.0 }; 5];
    assert!(locate(&flat, &stranger, &options(2, false, 1e-7)).unwrap_err().to_string().starts_with("sensor is 9"));
}

#[test]
fn hits_are_grouped_by_the_way_between_sensors() {
    let sensors = sensors([0.2, 0.1, 0.15]);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let (mut hits, mut truth) = (Vec::new(), Vec::new());
    for event in 0..50 {
        let source = [0.2, 0.1, 0.15].map(|size| size * rng.random::<f64>());
        for (k, sensor) in sensors.iter().enumerate() {
            let time_s = f64::from(event) * 1e-3 + distance(source, sensor.position_m) / 3800.0;
            hits.push(ChannelHit { channel: k as u32 + 1, time_s });
            truth.push(event);
        }
    }
    // an echo at one channel, after the event and before the next
    hits.push(ChannelHit { channel: 3, time_s: 0.0104 });
    truth.push(-1);
    let mut order: Vec<usize> = (0..hits.len()).collect();
    order.sort_by(|&a, &b| hits[a].time_s.total_cmp(&hits[b].time_s));
    let sorted: Vec<ChannelHit> = order.iter().map(|&i| hits[i]).collect();
    let given = GroupingOptions { speed_m_per_s: 3800.0, slack_s: 1e-6, window_s: None, fewest_channels: 4 };
    let events = group(&sorted, &sensors, &given).unwrap();
    assert_eq!(events.len(), 50);
    for event in &events {
        let of: Vec<i32> = event.hits.iter().map(|&i| truth[order[i]]).collect();
        assert!(of.len() == 8 && of.iter().all(|&t| t == of[0]), "{of:?}");
    }
    let stranger = [ChannelHit { channel: 77, time_s: 0.0 }];
    assert!(group(&stranger, &sensors, &given).unwrap_err().to_string().starts_with("channel is 77"));
}

/// Sources of known positions, and the catalogue of hits that twelve sensors with delays record of them.
fn recorded(error: f64, sources: &[[f64; 3]], sensors: Vec<Sensor>, rng: &mut ChaCha8Rng) -> Catalogue {
    let mut hits: Vec<(f64, f64, f64)> = Vec::new();
    for (event, source) in sources.iter().enumerate() {
        for sensor in &sensors {
            let late = distance(*source, sensor.position_m) / 3800.0 + sensor.delay_s + error * normal(rng);
            hits.push((event as f64 * 0.01 + late, f64::from(sensor.channel), 0.01 * (event + 1) as f64));
        }
    }
    hits.sort_by(|a, b| a.0.total_cmp(&b.0));
    let columns = [
        (Column::TimeS, hits.iter().map(|hit| hit.0).collect()),
        (Column::Channel, hits.iter().map(|hit| hit.1).collect()),
        (Column::AmplitudeV, hits.iter().map(|hit| hit.2).collect()),
    ];
    let metadata = Metadata { sensors, longitudinal_speed_m_per_s: Some(3800.0), ..Metadata::default() };
    Catalogue::new(columns.into(), metadata).unwrap()
}

/// Share of the located events whose source lies within the ellipsoid of 95 % that the columns state.
fn share_inside(events: &Catalogue, sources: &[[f64; 3]]) -> f64 {
    let of = |column: Column, row: usize| events.column(column).unwrap()[row];
    let mut inside = Vec::new();
    for row in 0..events.len() {
        // the amplitude says which source it was
        let source = sources[(of(Column::AmplitudeV, row) * 100.0).round() as usize - 1];
        let se = [Column::XSeM, Column::YSeM, Column::ZSeM].map(|column| of(column, row));
        let [xy, xz, yz] = [Column::XyCovM2, Column::XzCovM2, Column::YzCovM2].map(|column| of(column, row));
        if se[0].is_nan() {
            continue;
        }
        let [x, y, z] = se.map(|se| se * se);
        let covariance = DMatrix::from_row_slice(3, 3, &[x, xy, xz, xy, y, yz, xz, yz, z]);
        let found = [Column::XM, Column::YM, Column::ZM].map(|column| of(column, row));
        let miss = DVector::from_fn(3, |k, _| found[k] - source[k]);
        let squares = (miss.transpose() * covariance.try_inverse().unwrap() * &miss)[0];
        inside.push(f64::from(u8::from(chi_square_survival(squares, 3.0) > 0.05)));
    }
    crate::emission::numerics::mean(&inside)
}

#[test]
fn hits_of_known_sources_become_events_within_their_stated_covariance() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let size = [0.2, 0.1, 0.15];
    let sources: Vec<[f64; 3]> =
        (0..1500).map(|_| size.map(|size| size * (0.15 + 0.7 * rng.random::<f64>()))).collect();
    for (arrival_error_s, free_speed) in [(Some(2e-7), false), (None, false), (Some(2e-7), true), (None, true)] {
        let catalogue = recorded(2e-7, &sources, irregular(size), &mut rng);
        let options = EventOptions { arrival_error_s, free_speed, ..EventOptions::default() };
        let (events, summary) = locate_events(&catalogue, &options, &Unobserved).unwrap();
        assert_eq!((summary.hits, summary.hits_grouped, summary.events), (18_000, 18_000, 1500));
        assert!(summary.located >= 1490 && events.len() == 1500, "{summary:?}");
        // 95 % of 1500, give or take 0.56 %
        let share = share_inside(&events, &sources);
        assert!((0.93..=0.97).contains(&share), "{arrival_error_s:?} {free_speed}: {share}");
        close(summary.arrival_error_s.unwrap() / 2e-7, 1.0, 0.02);
        close(summary.speed_m_per_s.unwrap(), 3800.0, if free_speed { 5.0 } else { 1e-9 });
        assert_eq!(summary.speed_sd_m_per_s.is_some(), free_speed);
        close(events.metadata.location_error_m.unwrap() / summary.median_se_m.unwrap(), 1.0, 0.5);
    }
}

#[test]
fn a_hit_of_something_else_spoils_one_event_and_no_other() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let size = [0.2, 0.1, 0.15];
    let sources = vec![[0.05, 0.04, 0.06]; 40];
    let catalogue = recorded(1e-7, &sources, irregular(size), &mut rng);
    let mut columns = catalogue.clone().into_columns();
    // the first hit of the third event arrives early by half of the way through the sample
    let times = columns.get_mut(&Column::TimeS).unwrap();
    times[24] -= 1e-5;
    // and one hit is of a channel that has no sensor
    columns.get_mut(&Column::Channel).unwrap()[100] = 99.0;
    let catalogue = Catalogue::new(columns, catalogue.metadata).unwrap();
    let (events, summary) = locate_events(&catalogue, &EventOptions::default(), &Unobserved).unwrap();
    assert_eq!((summary.events, summary.located, summary.misfits), (40, 39, 1));
    assert_eq!((summary.hits_without_sensor, summary.not_converged), (1, 0));
    let lost: Vec<usize> = (0..40).filter(|&row| events.column(Column::XM).unwrap()[row].is_nan()).collect();
    assert_eq!(lost, [2]);
    close(summary.arrival_error_s.unwrap() / 1e-7, 1.0, 0.1);
}

#[test]
fn what_a_location_needs_is_named() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let catalogue = recorded(1e-7, &[[0.05; 3]; 3], irregular([0.2, 0.1, 0.15]), &mut rng);
    let refused = |change: &dyn Fn(&mut Metadata), options: EventOptions| {
        let mut changed = catalogue.clone();
        change(&mut changed.metadata);
        events::check(&changed, &options).unwrap_err().to_string()
    };
    let base = EventOptions::default();
    assert!(refused(&|m| m.sensors.clear(), base).starts_with("the sensors with their positions is not known"));
    assert!(refused(&|m| m.longitudinal_speed_m_per_s = None, base).starts_with("the wave speed"));
    assert!(refused(&|m| m.sensors.truncate(4), base).starts_with("sensors of a location: 4 event(s), at least 5"));
    assert!(refused(&|m| m.sensors[1].channel = 1, base).starts_with("sensors is channel 1 twice"));
    assert!(refused(&|_| (), EventOptions { dimensions: 4, ..base }).starts_with("dimensions is 4"));
    assert!(refused(&|_| (), EventOptions { significance: 0.9, ..base }).starts_with("significance is 0.9"));
    assert!(refused(&|_| (), EventOptions { window_s: Some(0.0), ..base }).starts_with("window_s is 0"));
    assert!(refused(&|_| (), EventOptions { fewest_channels: Some(13), ..base }).starts_with("fewest_channels is 13"));
    let narrow = EventOptions { window_s: Some(1e-9), ..base };
    let none = locate_events(&catalogue, &narrow, &Unobserved).unwrap_err().to_string();
    assert_eq!(none, "events of enough channels: 0 event(s), at least 1 are needed");
}

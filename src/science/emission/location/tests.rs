use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::grouping::{ChannelHit, GroupingOptions, group};
use super::*;
use crate::emission::close;
use crate::emission::special::chi_square_survival;

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
    let given = GroupingOptions { speed_m_per_s: 3800.0, slack_s: 1e-6, fewest_channels: 4 };
    let events = group(&sorted, &sensors, &given).unwrap();
    assert_eq!(events.len(), 50);
    for event in &events {
        let of: Vec<i32> = event.hits.iter().map(|&i| truth[order[i]]).collect();
        assert!(of.len() == 8 && of.iter().all(|&t| t == of[0]), "{of:?}");
    }
    let stranger = [ChannelHit { channel: 77, time_s: 0.0 }];
    assert!(group(&stranger, &sensors, &given).unwrap_err().to_string().starts_with("channel is 77"));
}

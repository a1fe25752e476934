//! Calibration with the Hsu-Nielsen source: breaking pencil leads (ASTM E976, EN 1330-9).

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::error::EmissionError;
use super::numerics::{Z95, mean, standard_deviation};

/// One lead break at one sensor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct LeadBreak {
    /// Number of the break; all its arrivals share it.
    pub number: u32,
    /// Distance of the break from the sensor, m.
    pub distance_m: f64,
    /// Peak amplitude, dB_AE.
    pub amplitude_db: f64,
    /// Arrival time at the sensor, s, on any clock that all sensors share.
    #[serde(default)]
    pub arrival_s: Option<f64>,
}

/// A number with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Estimate {
    /// Value.
    pub value: f64,
    /// Standard error.
    pub se: f64,
    /// 95 % interval.
    pub ci95: [f64; 2],
}

impl Estimate {
    pub(super) fn new(value: f64, se: f64) -> Self {
        Self { value, se, ci95: [value - Z95 * se, value + Z95 * se] }
    }
}

/// What the breaks say.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Calibration {
    /// Arrivals.
    pub arrivals: usize,
    /// Breaks.
    pub breaks: usize,
    /// Mean amplitude, dB_AE.
    pub mean_db: f64,
    /// Largest spread of the amplitudes at one distance (largest less smallest), dB.
    pub spread_db: f64,
    /// Whether that is at most 3 dB: the sensors are coupled well.
    pub spread_is_accepted: bool,
    /// Wave speed from the regression of arrival times on distances, m/s; missing without two distances a break.
    pub speed_m_per_s: Option<Estimate>,
    /// Root mean square of the residuals of the arrival times, s.
    pub arrival_residual_s: Option<f64>,
    /// Attenuation dB = S0 - 20 n log10(d / 1 m) - alpha d; missing with fewer than four different distances.
    pub attenuation: Option<Attenuation>,
}

/// Loss of amplitude with distance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Attenuation {
    /// S0, dB_AE at 1 m without absorption.
    pub source_db: Estimate,
    /// n: 1 for spherical spreading, 0.5 in a plate.
    pub spreading: Estimate,
    /// alpha, dB/m.
    pub absorption_db_per_m: Estimate,
    /// Root mean square of the residuals, dB.
    pub residual_db: f64,
}

/// Breaks needed.
const NEEDED: usize = 3;
/// Accepted spread, dB.
const ACCEPTED_SPREAD_DB: f64 = 3.0;

/// Evaluates lead breaks.
///
/// # Errors
/// Fewer than three breaks, or a value that is not finite (distances above 0).
pub fn calibrate(breaks: &[LeadBreak]) -> Result<Calibration, EmissionError> {
    let mut numbers: Vec<u32> = breaks.iter().map(|b| b.number).collect();
    numbers.sort_unstable();
    numbers.dedup();
    if numbers.len() < NEEDED {
        return Err(EmissionError::TooFewEvents { what: "calibration", found: numbers.len(), needed: NEEDED });
    }
    for (row, b) in breaks.iter().enumerate() {
        let refuse = |column, value, accepted| Err(EmissionError::Value { column, row: row + 1, value, accepted });
        if !(b.distance_m.is_finite() && b.distance_m > 0.0) {
            return refuse("distance_m", b.distance_m, "a finite number above 0");
        }
        if !b.amplitude_db.is_finite() {
            return refuse("amplitude_db", b.amplitude_db, "a finite number");
        }
        if let Some(arrival) = b.arrival_s.filter(|arrival| !arrival.is_finite()) {
            return refuse("arrival_s", arrival, "a finite number");
        }
    }
    let amplitudes: Vec<f64> = breaks.iter().map(|b| b.amplitude_db).collect();
    let spread_db = spread_at_one_distance(breaks);
    let arrivals = arrival_regression(breaks, &numbers);
    Ok(Calibration {
        arrivals: breaks.len(),
        breaks: numbers.len(),
        mean_db: mean(&amplitudes),
        spread_db,
        spread_is_accepted: spread_db <= ACCEPTED_SPREAD_DB,
        speed_m_per_s: arrivals.map(|found| found.0),
        arrival_residual_s: arrivals.map(|found| found.1),
        attenuation: attenuation(breaks),
    })
}

fn spread_at_one_distance(breaks: &[LeadBreak]) -> f64 {
    let mut sorted: Vec<&LeadBreak> = breaks.iter().collect();
    sorted.sort_by(|a, b| a.distance_m.total_cmp(&b.distance_m));
    let spread = |same: &[&LeadBreak]| {
        let high = same.iter().map(|b| b.amplitude_db).fold(f64::NEG_INFINITY, f64::max);
        high - same.iter().map(|b| b.amplitude_db).fold(f64::INFINITY, f64::min)
    };
    sorted.chunk_by(|a, b| (a.distance_m - b.distance_m).abs() < 1e-9).map(spread).fold(0.0, f64::max)
}

/// Speed and residual of `arrival = time of the break + distance / speed`: within each break, so that its time drops out.
fn arrival_regression(breaks: &[LeadBreak], numbers: &[u32]) -> Option<(Estimate, f64)> {
    let (mut sxx, mut sxy, mut points, mut groups) = (0.0, 0.0, Vec::new(), 0);
    for &number in numbers {
        let of_break: Vec<(f64, f64)> = breaks
            .iter()
            .filter(|b| b.number == number)
            .filter_map(|b| b.arrival_s.map(|arrival| (b.distance_m, arrival)))
            .collect();
        if of_break.len() < 2 {
            continue;
        }
        groups += 1;
        let (distances, times): (Vec<f64>, Vec<f64>) = of_break.into_iter().unzip();
        let (md, mt) = (mean(&distances), mean(&times));
        for (d, t) in distances.iter().zip(&times) {
            sxx += (d - md) * (d - md);
            sxy += (d - md) * (t - mt);
            points.push((d - md, t - mt));
        }
    }
    let slowness = sxy / sxx;
    if !(sxx > 0.0 && slowness > 0.0) {
        return None;
    }
    let squares: f64 = points.iter().map(|(d, t)| (t - slowness * d).powi(2)).sum();
    let degrees = points.len() as f64 - f64::from(groups) - 1.0;
    let residual = (squares / points.len() as f64).sqrt();
    let slowness_se = if degrees > 0.0 { (squares / degrees / sxx).sqrt() } else { 0.0 };
    Some((Estimate::new(1.0 / slowness, slowness_se / (slowness * slowness)), residual))
}

fn attenuation(breaks: &[LeadBreak]) -> Option<Attenuation> {
    let mut distances: Vec<f64> = breaks.iter().map(|b| b.distance_m).collect();
    distances.sort_by(f64::total_cmp);
    distances.dedup();
    if distances.len() < 4 {
        return None;
    }
    let design = DMatrix::from_fn(breaks.len(), 3, |row, column| match column {
        0 => 1.0,
        1 => -20.0 * breaks[row].distance_m.log10(),
        _ => -breaks[row].distance_m,
    });
    let amplitudes = DVector::from_iterator(breaks.len(), breaks.iter().map(|b| b.amplitude_db));
    let inverse = (design.transpose() * &design).try_inverse()?;
    let coefficients = &inverse * design.transpose() * &amplitudes;
    let residuals: Vec<f64> = (amplitudes - &design * &coefficients).iter().copied().collect();
    let squares: f64 = residuals.iter().map(|r| r * r).sum();
    let variance = squares / (breaks.len() as f64 - 3.0);
    let estimate = |k: usize| Estimate::new(coefficients[k], (variance * inverse[(k, k)]).sqrt());
    Some(Attenuation {
        source_db: estimate(0),
        spreading: estimate(1),
        absorption_db_per_m: estimate(2),
        residual_db: (squares / breaks.len() as f64).sqrt(),
    })
}

/// Delay of the coupling of each sensor, s: the mean of its arrivals less what the distances and `speed` (m/s) say, relative to the
/// mean of all sensors. `arrivals[i]` holds the arrival times (s) of break i and `distances[i]` its distances (m), a value a sensor.
///
/// # Errors
/// Fewer than three breaks, lists of unequal length, or a speed that is not above 0.
pub fn coupling_delays(
    arrivals: &[Vec<f64>],
    distances: &[Vec<f64>],
    speed: f64,
) -> Result<Vec<Estimate>, EmissionError> {
    super::error::positive("speed_m_per_s", speed)?;
    if arrivals.len() < NEEDED {
        return Err(EmissionError::TooFewEvents { what: "coupling_delays", found: arrivals.len(), needed: NEEDED });
    }
    let sensors = arrivals[0].len();
    let lengths = arrivals.iter().chain(distances).map(Vec::len);
    if let Some(found) = lengths.into_iter().find(|&length| length != sensors) {
        return Err(EmissionError::Length { column: "arrivals", found, expected: sensors });
    }
    let residuals: Vec<Vec<f64>> = arrivals
        .iter()
        .zip(distances)
        .map(|(times, distances)| {
            let late: Vec<f64> = times.iter().zip(distances).map(|(t, d)| t - d / speed).collect();
            let centre = mean(&late);
            late.into_iter().map(|t| t - centre).collect()
        })
        .collect();
    let estimate = |sensor: usize| {
        let late: Vec<f64> = residuals.iter().map(|r| r[sensor]).collect();
        Estimate::new(mean(&late), standard_deviation(&late) / (late.len() as f64).sqrt())
    };
    Ok((0..sensors).map(estimate).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emission::close;

    /// Breaks at known distances: 80 dB - 20 x 0.7 log10 d - 6 d, 3800 m/s, with deviations that the caller gives.
    fn breaks(deviation_db: f64, late_s: f64) -> Vec<LeadBreak> {
        let distances = [0.05, 0.1, 0.2, 0.4, 0.8];
        (0..4)
            .flat_map(|number| {
                distances.into_iter().enumerate().map(move |(k, distance_m)| {
                    let sign = if (k as u32 + number).is_multiple_of(2) { 1.0 } else { -1.0 };
                    LeadBreak {
                        number,
                        distance_m,
                        amplitude_db: 80.0 - 14.0 * f64::log10(distance_m) - 6.0 * distance_m + sign * deviation_db,
                        arrival_s: Some(f64::from(number) + distance_m / 3800.0 + sign * late_s),
                    }
                })
            })
            .collect()
    }

    #[test]
    fn exact_breaks_give_back_their_laws() {
        let found = calibrate(&breaks(0.0, 0.0)).unwrap();
        close(found.speed_m_per_s.unwrap().value, 3800.0, 1e-3);
        let attenuation = found.attenuation.unwrap();
        close(attenuation.source_db.value, 80.0, 1e-9);
        close(attenuation.spreading.value, 0.7, 1e-9);
        close(attenuation.absorption_db_per_m.value, 6.0, 1e-9);
        assert_eq!((found.breaks, found.arrivals, found.spread_is_accepted), (4, 20, true));
    }

    #[test]
    fn disturbed_breaks_do_so_within_their_errors() {
        let found = calibrate(&breaks(1.0, 1e-6)).unwrap();
        let speed = found.speed_m_per_s.unwrap();
        assert!(speed.se > 0.0 && (speed.value - 3800.0).abs() < 3.0 * speed.se, "{speed:?}");
        let spreading = found.attenuation.unwrap().spreading;
        assert!((spreading.value - 0.7).abs() < 3.0 * spreading.se, "{spreading:?}");
        close(found.spread_db, 2.0, 1e-9);
        assert!(!calibrate(&breaks(1.6, 0.0)).unwrap().spread_is_accepted);
    }

    #[test]
    fn a_late_sensor_is_found() {
        let distances = vec![vec![0.1, 0.2, 0.3], vec![0.3, 0.1, 0.2], vec![0.2, 0.3, 0.1]];
        let arrivals: Vec<Vec<f64>> = distances
            .iter()
            .enumerate()
            .map(|(i, d)| d.iter().enumerate().map(|(s, d)| i as f64 + d / 4000.0 + [0.0, 3e-6, 0.0][s]).collect())
            .collect();
        let delays = coupling_delays(&arrivals, &distances, 4000.0).unwrap();
        close(delays[1].value - delays[0].value, 3e-6, 1e-12);
        assert!(coupling_delays(&arrivals[..2], &distances[..2], 4000.0).is_err());
    }

    #[test]
    fn too_few_breaks_are_refused() {
        assert_eq!(
            calibrate(&breaks(0.0, 0.0)[..10]).unwrap_err().to_string(),
            "calibration: 2 event(s), at least 3 are needed"
        );
        let mut bad = breaks(0.0, 0.0);
        bad[3].distance_m = 0.0;
        assert!(calibrate(&bad).unwrap_err().to_string().starts_with("distance_m, row 4: 0"));
    }
}

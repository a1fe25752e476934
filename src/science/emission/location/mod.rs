//! Where events happen: least squares on arrival times, with covariance.
//!
//! `t_i = t_0 + |x - s_i| / v + delay_i`, solved by damped Gauss-Newton steps (Geiger 1910) from several starts. The origin time
//! drops out, as does the mean of the residuals; the covariance is that of the linear problem at the solution times the variance
//! of an arrival time.

pub mod events;
pub mod grouping;
#[cfg(test)]
mod tests;

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::catalogue::Sensor;
use super::error::{EmissionError, positive};

/// In how many dimensions, and with which speed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct LocationOptions {
    /// 1 (x), 2 (x and y) or 3 coordinates; the others are those of the first sensor.
    pub dimensions: usize,
    /// Wave speed, m/s: the truth, or the start where it is fitted.
    pub speed_m_per_s: f64,
    /// Whether the speed is fitted too.
    #[serde(default)]
    pub free_speed: bool,
    /// Standard error of an arrival time, s; none takes it from the residuals, which needs more arrivals than unknowns.
    #[serde(default)]
    pub arrival_error_s: Option<f64>,
}

/// A located event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Location {
    /// Position, m.
    pub position_m: [f64; 3],
    /// Covariance of the coordinates, m2; 0 for a coordinate that was not fitted.
    pub covariance_m2: [[f64; 3]; 3],
    /// Origin time, s.
    pub origin_s: f64,
    /// Wave speed in use or fitted, m/s.
    pub speed_m_per_s: f64,
    /// Standard error of a fitted speed, m/s.
    pub speed_se_m_per_s: Option<f64>,
    /// Root mean square of the residuals of the arrival times, s.
    pub residual_s: f64,
    /// Arrivals.
    pub arrivals: usize,
}

/// An arrival at a sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrival {
    /// Position of the sensor in the list of sensors.
    pub sensor: usize,
    /// Arrival time, s.
    pub time_s: f64,
}

impl LocationOptions {
    fn check(&self) -> Result<(), EmissionError> {
        if !(1..=3).contains(&self.dimensions) {
            return Err(EmissionError::option("dimensions", self.dimensions, "1, 2 or 3"));
        }
        positive("speed_m_per_s", self.speed_m_per_s)?;
        self.arrival_error_s.map(|error| positive("arrival_error_s", error)).transpose().map(|_| ())
    }

    /// Coordinates, origin time, and the speed where it is fitted.
    fn unknowns(&self) -> usize {
        self.dimensions + 1 + usize::from(self.free_speed)
    }
}

/// Locates one event from its `arrivals`, one a sensor.
///
/// # Errors
/// Options out of range, a sensor that is not in the list, fewer arrivals than unknowns (one more without `arrival_error_s`), or
/// sensors whose arrangement does not fix the position.
pub fn locate(sensors: &[Sensor], arrivals: &[Arrival], options: &LocationOptions) -> Result<Location, EmissionError> {
    options.check()?;
    let needed = options.unknowns() + usize::from(options.arrival_error_s.is_none());
    if arrivals.len() < needed {
        return Err(EmissionError::TooFewEvents { what: "arrivals of a location", found: arrivals.len(), needed });
    }
    if let Some(arrival) = arrivals.iter().find(|arrival| arrival.sensor >= sensors.len()) {
        let accepted = format!("0 to {}", sensors.len().saturating_sub(1));
        return Err(EmissionError::option("sensor", arrival.sensor, accepted));
    }
    if let Some(row) = arrivals.iter().position(|arrival| !arrival.time_s.is_finite()) {
        let (value, accepted) = (arrivals[row].time_s, "a finite number");
        return Err(EmissionError::Value { column: "time_s", row: row + 1, value, accepted });
    }
    let problem = Problem::new(sensors, arrivals, options);
    let solutions = problem.starts().into_iter().filter_map(|start| problem.solve(start));
    let located = problem.choose(&solutions.collect::<Vec<_>>()).and_then(|solution| problem.location(solution));
    located.ok_or(EmissionError::NotConverged { what: "location" })
}

struct Problem<'a> {
    options: &'a LocationOptions,
    positions: Vec<[f64; 3]>,
    /// Arrival times without the delays, relative to the first, s.
    times: Vec<f64>,
    first_s: f64,
}

/// Coordinates, then the slowness.
#[derive(Clone, Copy)]
struct Model {
    position: [f64; 3],
    slowness: f64,
}

struct Solution {
    model: Model,
    squares: f64,
}

/// Steps of a solution.
const MOST_STEPS: usize = 200;

impl<'a> Problem<'a> {
    fn new(sensors: &[Sensor], arrivals: &[Arrival], options: &'a LocationOptions) -> Self {
        let times: Vec<f64> = arrivals.iter().map(|arrival| arrival.time_s - sensors[arrival.sensor].delay_s).collect();
        let first_s = times.iter().copied().fold(f64::INFINITY, f64::min);
        Self {
            options,
            positions: arrivals.iter().map(|arrival| sensors[arrival.sensor].position_m).collect(),
            times: times.iter().map(|time| time - first_s).collect(),
            first_s,
        }
    }

    /// The centre of the sensors, and a point towards each of them: of several minima the best is kept.
    fn starts(&self) -> Vec<Model> {
        let n = self.positions.len() as f64;
        let mut centre = [0, 1, 2].map(|k| self.positions.iter().map(|p| p[k]).sum::<f64>() / n);
        centre[self.options.dimensions..].copy_from_slice(&self.positions[0][self.options.dimensions..]);
        let towards = |p: &[f64; 3]| {
            let mut point = centre;
            for k in 0..self.options.dimensions {
                point[k] += 0.7 * (p[k] - centre[k]);
            }
            point
        };
        let points = std::iter::once(centre).chain(self.positions.iter().map(towards));
        points.map(|position| Model { position, slowness: 1.0 / self.options.speed_m_per_s }).collect()
    }

    /// Residuals about their mean, and that mean: the origin time.
    fn residuals(&self, model: &Model) -> (Vec<f64>, f64) {
        let late: Vec<f64> = self
            .positions
            .iter()
            .zip(&self.times)
            .map(|(sensor, time)| time - distance(model.position, *sensor) * model.slowness)
            .collect();
        let origin = late.iter().sum::<f64>() / late.len() as f64;
        (late.into_iter().map(|t| t - origin).collect(), origin)
    }

    /// Derivatives of the travel times in the coordinates (and the slowness), about their means.
    fn design(&self, model: &Model) -> DMatrix<f64> {
        let (rows, dimensions) = (self.positions.len(), self.options.dimensions);
        let columns = dimensions + usize::from(self.options.free_speed);
        let mut design = DMatrix::zeros(rows, columns);
        for (row, sensor) in self.positions.iter().enumerate() {
            // at a sensor the direction is not defined: 0 leaves that arrival out of the step
            let d = distance(model.position, *sensor);
            for k in 0..dimensions {
                design[(row, k)] = if d > 0.0 { model.slowness * (model.position[k] - sensor[k]) / d } else { 0.0 };
            }
            if self.options.free_speed {
                design[(row, dimensions)] = d;
            }
        }
        for mut column in design.column_iter_mut() {
            let mean = column.mean();
            column.add_scalar_mut(-mean);
        }
        design
    }

    /// Levenberg & Marquardt from `start`.
    fn solve(&self, start: Model) -> Option<Solution> {
        let squares_of = |model: &Model| self.residuals(model).0.iter().map(|r| r * r).sum::<f64>();
        let mut model = start;
        let mut squares = squares_of(&model);
        let mut damping = 1e-3;
        for _ in 0..MOST_STEPS {
            let design = self.design(&model);
            let residuals = DVector::from_vec(self.residuals(&model).0);
            let normal = design.transpose() * &design;
            let right = design.transpose() * residuals;
            let mut damped = normal.clone();
            for k in 0..damped.nrows() {
                damped[(k, k)] += damping * normal[(k, k)].max(f64::MIN_POSITIVE);
            }
            let step = damped.lu().solve(&right)?;
            let next = self.moved(&model, &step);
            let next_squares = squares_of(&next);
            if next_squares.is_finite() && next_squares <= squares {
                let moved = distance(next.position, model.position);
                let gain = squares - next_squares;
                (model, squares) = (next, next_squares);
                damping = (damping * 0.2).max(1e-12);
                let scale = self.extent();
                if moved < 1e-12 * scale || (gain <= 1e-15 * squares && moved < 1e-7 * scale) {
                    break;
                }
            } else {
                damping *= 8.0;
                if damping > 1e12 {
                    break;
                }
            }
        }
        squares.is_finite().then_some(Solution { model, squares })
    }

    /// The solution with the smallest residuals; of those that arrivals cannot tell apart (9 times the variance of an arrival time,
    /// a likelihood ratio of 3 standard deviations) the one whose speed is nearest to the given one. Sensors in a regular
    /// arrangement, such as the corners of a box, leave more than one where the speed is free.
    fn choose<'b>(&self, solutions: &'b [Solution]) -> Option<&'b Solution> {
        let best = solutions.iter().map(|solution| solution.squares).fold(f64::INFINITY, f64::min);
        let spare = self.positions.len().saturating_sub(self.options.unknowns()).max(1) as f64;
        let variance = self.options.arrival_error_s.map_or(best / spare, |error| error * error);
        let far = |solution: &Solution| (solution.model.slowness * self.options.speed_m_per_s).ln().abs();
        let same = solutions.iter().filter(|solution| solution.squares <= best + 9.0 * variance);
        same.min_by(|a, b| far(a).total_cmp(&far(b)).then(a.squares.total_cmp(&b.squares)))
    }

    fn moved(&self, model: &Model, step: &DVector<f64>) -> Model {
        let mut moved = *model;
        for k in 0..self.options.dimensions {
            moved.position[k] += step[k];
        }
        if self.options.free_speed {
            // the slowness stays positive
            moved.slowness = (moved.slowness + step[self.options.dimensions]).max(0.1 * model.slowness);
        }
        moved
    }

    fn extent(&self) -> f64 {
        self.positions.iter().map(|p| distance(*p, self.positions[0])).fold(0.0, f64::max)
    }

    fn location(&self, solution: &Solution) -> Option<Location> {
        let n = self.positions.len();
        let unknowns = self.options.unknowns();
        let design = self.design(&solution.model);
        let normal = design.transpose() * &design;
        // a coordinate without effect on any arrival; the eigenvalues below would be undefined
        if !normal.diagonal().iter().all(|&square| square.is_normal() && square > 0.0) {
            return None;
        }
        // sensors on a line or a plane leave a coordinate open: the normal matrix is then singular to rounding
        let scale = DMatrix::from_fn(normal.nrows(), normal.ncols(), |r, c| {
            normal[(r, c)] / (normal[(r, r)] * normal[(c, c)]).sqrt()
        });
        let eigenvalues = scale.symmetric_eigenvalues();
        if eigenvalues.min() <= 1e-10 {
            return None;
        }
        let variance = match self.options.arrival_error_s {
            Some(error) => error * error,
            None => solution.squares / (n - unknowns) as f64,
        };
        let covariance = normal.try_inverse()? * variance;
        let mut covariance_m2 = [[0.0; 3]; 3];
        for (r, row) in covariance_m2.iter_mut().enumerate().take(self.options.dimensions) {
            for (c, value) in row.iter_mut().enumerate().take(self.options.dimensions) {
                *value = covariance[(r, c)];
            }
        }
        let speed = 1.0 / solution.model.slowness;
        let speed_se = self.options.free_speed.then(|| {
            let k = self.options.dimensions;
            covariance[(k, k)].sqrt() * speed * speed
        });
        Some(Location {
            position_m: solution.model.position,
            covariance_m2,
            origin_s: self.first_s + self.residuals(&solution.model).1,
            speed_m_per_s: speed,
            speed_se_m_per_s: speed_se,
            residual_s: (solution.squares / n as f64).sqrt(),
            arrivals: n,
        })
    }
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    let [x, y, z] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    (x * x + y * y + z * z).sqrt()
}

//! Linear machines by a primal-dual interior point method.
//!
//! Where there are more days than features SMO needs ever more steps as the cost grows, and single-precision kernel values no
//! longer carry the solution. An interior point takes a few dozen steps whatever the cost, each linear in the number of days,
//! because the kernel matrix has the rank of the features (Ferris & Munson 2002, SIAM J. Optim. 13, 783-804). Steps after
//! Mehrotra (1992, SIAM J. Optim. 2, 575-601). The last iterate is moved to the bounds that it approaches and then has to
//! fulfil the same optimality conditions as any other machine, in double precision.

use nalgebra::{Cholesky, DVector, Dyn};

use super::columns::Columns;
use super::smo::{Dual, Effort};
use super::solver::{SolverError, SolverOptions};

/// Steps after which a fit is given up; a few dozen are usual.
const MAX_STEPS: usize = 200;

/// Share of the way to the nearest bound that a step may go.
const TO_THE_BOUND: f64 = 0.995;

/// Solves the problem of `dual` for the linear kernel on the samples of `columns`, from any point.
///
/// # Errors
/// [`SolverError::NotFinite`] where kernel values exceed single precision (as for any kernel) or the steps overflow,
/// [`SolverError::TooManyIterations`], [`SolverError::Cancelled`] once `stop` says so.
pub(super) fn solve_linear(
    dual: &mut Dual,
    columns: &Columns,
    options: &SolverOptions,
    stop: &dyn Fn() -> bool,
) -> Result<Effort, SolverError> {
    if !columns.square_norms().iter().all(|norm| (*norm as f32).is_finite()) {
        return Err(SolverError::NotFinite);
    }
    let mut interior = Interior::new(dual, columns);
    let limit = options.max_iterations.min(MAX_STEPS);
    let mut gap = f64::INFINITY;
    for iterations in 1..=limit {
        if stop() {
            return Err(SolverError::Cancelled);
        }
        interior.step().ok_or(SolverError::NotFinite)?;
        if let Some(beta) = interior.at_its_bounds() {
            let normal = columns.combination(&beta);
            gap = dual.place(&beta, &columns.products(&normal));
            if gap < options.epsilon {
                return Ok(Effort { iterations, gap });
            }
        }
    }
    Err(SolverError::TooManyIterations { iterations: limit, gap })
}

/// Least entry of the diagonal `D`, relative to the largest kernel value: below it the difference of two nearly equal numbers
/// would be all that is left of a step. It shortens steps (as a proximal term does) and does not move the optimum.
const LEAST_CURVATURE: f64 = 1e-11;

/// A point strictly inside the bounds with its multipliers; every vector has one entry a sample.
struct Interior<'a> {
    columns: &'a Columns,
    /// The largest kernel value; > 0.
    largest: f64,
    /// +1 for an event, -1 otherwise.
    target: Vec<f64>,
    lower: Vec<f64>,
    upper: Vec<f64>,
    beta: Vec<f64>,
    /// What is left to the lower and to the upper bound, > 0. Not computed from `beta`, whose digits they outlast.
    room: Vec<(f64, f64)>,
    /// Multiplier of `sum beta = 0`.
    balance: f64,
    /// Multipliers of the lower and the upper bounds, > 0.
    at_lower: Vec<f64>,
    at_upper: Vec<f64>,
}

/// A direction in which to go.
struct Direction {
    beta: Vec<f64>,
    balance: f64,
    at_lower: Vec<f64>,
    at_upper: Vec<f64>,
}

impl<'a> Interior<'a> {
    /// The point at which both classes carry the same weight, half of what the smaller can.
    fn new(dual: &Dual, columns: &'a Columns) -> Self {
        let n = columns.rows();
        let (lower, upper) = dual.bounds();
        let (lower, upper) = (lower[..n].to_vec(), upper[..n].to_vec());
        let (least, most): (f64, f64) = (lower.iter().sum(), upper.iter().sum());
        let weight = 0.5 * most.min(-least);
        let beta: Vec<f64> = lower.iter().zip(&upper).map(|(l, u)| weight * (u / most - l / least)).collect();
        Self {
            columns,
            largest: columns.square_norms().into_iter().fold(f64::MIN_POSITIVE, f64::max),
            target: dual.target()[..n].to_vec(),
            room: beta.iter().zip(lower.iter().zip(&upper)).map(|(b, (l, u))| (b - l, u - b)).collect(),
            lower,
            upper,
            beta,
            balance: 0.0,
            at_lower: vec![1.0; n],
            at_upper: vec![1.0; n],
        }
    }

    fn rooms(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.room.iter().copied()
    }

    /// Mean product of a room and its multiplier: 0 at the optimum.
    fn complementarity(&self) -> f64 {
        let products = self.rooms().zip(self.at_lower.iter().zip(&self.at_upper)).map(|((s, t), (z, w))| s * z + t * w);
        products.sum::<f64>() / (2 * self.beta.len()) as f64
    }

    /// One predictor-corrector step; `None` where the numbers overflow.
    fn step(&mut self) -> Option<()> {
        let mu = self.complementarity();
        let system = System::new(self)?;
        let rest = self.stationarity();
        let none = vec![(0.0, 0.0); self.beta.len()];
        let predictor = self.direction(&system, &rest, 0.0, &none);
        let reach = self.reach(&predictor);
        let ahead = self.complementarity_after(&predictor, reach);
        let centring = (ahead / mu).powi(3);
        let bent: Vec<(f64, f64)> = predictor
            .beta
            .iter()
            .zip(predictor.at_lower.iter().zip(&predictor.at_upper))
            .map(|(b, (z, w))| (b * z, -b * w))
            .collect();
        let corrector = self.direction(&system, &rest, centring * mu, &bent);
        let length = (TO_THE_BOUND * self.reach(&corrector)).min(1.0);
        self.advance(&corrector, length);
        self.beta.iter().all(|b| b.is_finite()).then_some(())
    }

    /// What is left of the stationarity conditions, with the sign of a right-hand side.
    fn stationarity(&self) -> Vec<f64> {
        let normal = self.columns.combination(&self.beta);
        let products = self.columns.products(&normal);
        let multipliers = self.at_lower.iter().zip(&self.at_upper);
        let terms = products.iter().zip(&self.target).zip(multipliers);
        terms.map(|((k, y), (z, w))| y - k - self.balance + z - w).collect()
    }

    /// Solves the linearised conditions for products of room and multiplier equal to `mu` less the second-order terms `bent`.
    fn direction(&self, system: &System<'_>, rest: &[f64], mu: f64, bent: &[(f64, f64)]) -> Direction {
        let multipliers: Vec<(f64, f64)> = self.at_lower.iter().copied().zip(self.at_upper.iter().copied()).collect();
        let pulls: Vec<(f64, f64)> = self
            .rooms()
            .zip(&multipliers)
            .zip(bent)
            .map(|(((s, t), (z, w)), (dz, dw))| ((mu - dz) / s - z, (mu - dw) / t - w))
            .collect();
        let right: Vec<f64> = rest.iter().zip(&pulls).map(|(r, (z, w))| r + z - w).collect();
        let (beta, balance) = system.solve(&right, -self.beta.iter().sum::<f64>());
        let lower = self.rooms().zip(&multipliers).zip(pulls.iter().zip(&beta));
        let (at_lower, at_upper) =
            lower.map(|(((s, t), (z, w)), ((pz, pw), b))| (pz - z * b / s, pw + w * b / t)).unzip();
        Direction { beta, balance, at_lower, at_upper }
    }

    /// How far along a direction everything stays inside, 1 at most for a whole step.
    fn reach(&self, direction: &Direction) -> f64 {
        let limit = |value: f64, change: f64| if change < 0.0 { -value / change } else { f64::INFINITY };
        let rooms = self.rooms().zip(&direction.beta).map(|((s, t), &b)| limit(s, b).min(limit(t, -b)));
        let lower = self.at_lower.iter().zip(&direction.at_lower).map(|(&z, &d)| limit(z, d));
        let upper = self.at_upper.iter().zip(&direction.at_upper).map(|(&w, &d)| limit(w, d));
        rooms.chain(lower).chain(upper).fold(1.0 / TO_THE_BOUND, f64::min)
    }

    fn complementarity_after(&self, direction: &Direction, length: f64) -> f64 {
        let multipliers =
            self.at_lower.iter().zip(&direction.at_lower).zip(self.at_upper.iter().zip(&direction.at_upper));
        let products = self.rooms().zip(&direction.beta).zip(multipliers).map(|(((s, t), b), ((z, dz), (w, dw)))| {
            (s + length * b) * (z + length * dz) + (t - length * b) * (w + length * dw)
        });
        products.sum::<f64>() / (2 * self.beta.len()) as f64
    }

    fn advance(&mut self, direction: &Direction, length: f64) {
        add_scaled(&mut self.beta, length, &direction.beta);
        for ((s, t), b) in self.room.iter_mut().zip(&direction.beta) {
            *s += length * b;
            *t -= length * b;
        }
        add_scaled(&mut self.at_lower, length, &direction.at_lower);
        add_scaled(&mut self.at_upper, length, &direction.at_upper);
        self.balance += length * direction.balance;
    }

    /// The point with every variable at its bound where going there changes decision values less than staying away violates the
    /// conditions (the multiplier); what is then missing from a balanced sum goes to the free variable with the most room.
    /// `None` while none could take it.
    fn at_its_bounds(&self) -> Option<Vec<f64>> {
        let mut beta = self.beta.clone();
        let mut roomiest = (0.0, None);
        for (i, (s, t)) in self.rooms().enumerate() {
            if s * self.largest < self.at_lower[i] {
                beta[i] = self.lower[i];
            } else if t * self.largest < self.at_upper[i] {
                beta[i] = self.upper[i];
            } else if s.min(t) > roomiest.0 {
                roomiest = (s.min(t), Some(i));
            }
        }
        let (excess, total) = (beta.iter().sum::<f64>(), beta.iter().map(|b| b.abs()).sum::<f64>());
        match roomiest {
            (room, Some(i)) if excess.abs() < room => beta[i] -= excess,
            _ if excess.abs() <= 1e-12 * total => {}
            _ => return None,
        }
        Some(beta)
    }
}

/// `K + D` of one point with the row and column of the balance, `D` the diagonal of multipliers over rooms: solved through the
/// inverse of the small matrix `I + X' D^-1 X` (Sherman, Morrison & Woodbury).
struct System<'a> {
    columns: &'a Columns,
    diagonal: Vec<f64>,
    small: Cholesky<f64, Dyn>,
    /// `(K + D)^-1 1` and its sum.
    ones: Vec<f64>,
    ones_sum: f64,
}

impl<'a> System<'a> {
    fn new(point: &Interior<'a>) -> Option<Self> {
        let columns = point.columns;
        let multipliers = point.at_lower.iter().zip(&point.at_upper);
        let least = LEAST_CURVATURE * point.largest;
        let curvature = point.rooms().zip(multipliers).map(|((s, t), (z, w))| z / s + w / t);
        let diagonal: Vec<f64> = curvature.map(|d| d.max(least)).collect();
        let weights: Vec<f64> = diagonal.iter().map(|d| d.recip()).collect();
        let small = Cholesky::new(columns.weighted_products(&weights))?;
        let mut system = Self { columns, diagonal, small, ones: Vec::new(), ones_sum: 0.0 };
        system.ones = system.invert(&vec![1.0; columns.rows()]);
        system.ones_sum = system.ones.iter().sum();
        (system.ones_sum.is_finite() && system.ones_sum > 0.0).then_some(system)
    }

    /// `(K + D) x + 1 balance = right` with `sum x = sum`.
    fn solve(&self, right: &[f64], sum: f64) -> (Vec<f64>, f64) {
        let mut x = self.invert(right);
        let balance = (x.iter().sum::<f64>() - sum) / self.ones_sum;
        add_scaled(&mut x, -balance, &self.ones);
        (x, balance)
    }

    /// `(K + D)^-1 right`, once refined: the entries of `D` span many orders of magnitude near the optimum.
    fn invert(&self, right: &[f64]) -> Vec<f64> {
        let mut x = self.invert_once(right);
        let products = self.columns.products(&self.columns.combination(&x));
        let terms = right.iter().zip(&products).zip(self.diagonal.iter().zip(&x));
        let rest: Vec<f64> = terms.map(|((r, k), (d, x))| r - k - d * x).collect();
        add_scaled(&mut x, 1.0, &self.invert_once(&rest));
        x
    }

    fn invert_once(&self, right: &[f64]) -> Vec<f64> {
        let scaled: Vec<f64> = right.iter().zip(&self.diagonal).map(|(r, d)| r / d).collect();
        let inner = self.small.solve(&DVector::from_vec(self.columns.combination(&scaled)));
        let products = self.columns.products(inner.as_slice());
        right.iter().zip(&products).zip(&self.diagonal).map(|((r, k), d)| (r - k) / d).collect()
    }
}

/// `target += scale * direction`, elementwise.
fn add_scaled(target: &mut [f64], scale: f64, direction: &[f64]) {
    for (t, d) in target.iter_mut().zip(direction) {
        *t += scale * d;
    }
}

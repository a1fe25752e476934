//! Sequential minimal optimisation of one dual problem: the state and the inner loop.

use multiversion::multiversion;

use super::lanes::{LANES, padded, subtract_scaled};
use super::rows::Rows;
use super::solver::{Cost, SolverError, SolverOptions};

/// Least curvature of a working pair (Fan, Chen & Lin 2005, eq. 11): pairs of equal rows have none of their own.
const TAU: f64 = 1e-12;

/// Share of its range within which a variable counts as being at a bound when the threshold is computed.
const AT_BOUND: f64 = 1e-12;

/// How often a residual is computed afresh before a fit counts as failed.
const MAX_REFRESHES: usize = 20;

/// Iterations between two looks at whether the caller still wants the result.
const ITERATIONS_A_LOOK: usize = 8192;

/// The dual problem in signed variables (see [`super`]) with a feasible point. Arrays are padded to whole lanes with
/// entries that can neither rise nor fall.
pub(super) struct Dual {
    /// +1 for an event, -1 otherwise; padding 0.
    target: Vec<f64>,
    lower: Vec<f64>,
    upper: Vec<f64>,
    /// `y_i alpha_i`.
    beta: Vec<f64>,
    /// `y_i - sum_j K_ij beta_j`, the gradient of the objective by `beta_i`.
    residual: Vec<f64>,
    /// 0 where `beta` is below its upper bound, else -inf: added to the residual it takes the entry out of a maximum.
    rise: Vec<f64>,
    /// 0 where `beta` is above its lower bound, else +inf.
    fall: Vec<f64>,
}

/// What it took to solve a problem.
#[derive(Clone, Copy, Debug)]
pub(super) struct Effort {
    pub(super) iterations: usize,
    pub(super) gap: f64,
}

impl Dual {
    /// The problem at `beta = 0`.
    pub(super) fn new(labels: &[bool], cost: Cost) -> Self {
        let stride = padded(labels.len());
        let mut target: Vec<f64> = labels.iter().map(|&event| if event { 1.0 } else { -1.0 }).collect();
        target.resize(stride, 0.0);
        let mut dual = Self {
            lower: vec![0.0; stride],
            upper: vec![0.0; stride],
            beta: vec![0.0; stride],
            residual: target.clone(),
            rise: vec![f64::NEG_INFINITY; stride],
            fall: vec![f64::INFINITY; stride],
            target,
        };
        dual.set_bounds(cost);
        dual
    }

    fn set_bounds(&mut self, cost: Cost) {
        for i in 0..self.target.len() {
            self.lower[i] = if self.target[i] < 0.0 { -cost.negative } else { 0.0 };
            self.upper[i] = if self.target[i] > 0.0 { cost.positive } else { 0.0 };
            self.mark_bounds(i);
        }
    }

    #[inline(always)]
    fn mark_bounds(&mut self, i: usize) {
        self.rise[i] = if self.beta[i] < self.upper[i] { 0.0 } else { f64::NEG_INFINITY };
        self.fall[i] = if self.beta[i] > self.lower[i] { 0.0 } else { f64::INFINITY };
    }

    /// `y_i alpha_i` of every row.
    pub(super) fn beta(&self) -> &[f64] {
        &self.beta
    }

    /// Starts from `alpha` made feasible: clipped to the bounds, then the class with the larger sum is reduced, its free
    /// variables first so that those at their bound stay there.
    pub(super) fn start_from(&mut self, alpha: &[f64], rows: &mut dyn Rows) {
        for (i, &a) in alpha.iter().enumerate() {
            self.beta[i] = (a * self.target[i]).clamp(self.lower[i], self.upper[i]);
        }
        let excess: f64 = self.beta.iter().sum();
        if excess != 0.0 {
            self.reduce(excess);
        }
        (0..self.beta.len()).for_each(|i| self.mark_bounds(i));
        self.refresh(rows);
    }

    /// Takes `excess` out of the variables of its own sign.
    fn reduce(&mut self, excess: f64) {
        let at_bound = |b: f64, lower: f64, upper: f64| b == lower || b == upper;
        for free_only in [true, false] {
            let eligible: Vec<usize> = (0..self.beta.len())
                .filter(|&i| self.beta[i] * excess > 0.0)
                .filter(|&i| !free_only || !at_bound(self.beta[i], self.lower[i], self.upper[i]))
                .collect();
            let available: f64 = eligible.iter().map(|&i| self.beta[i]).sum();
            let remaining: f64 = self.beta.iter().sum();
            if remaining * excess <= 0.0 || available == 0.0 {
                continue;
            }
            let keep = (1.0 - remaining / available).max(0.0);
            for i in eligible {
                self.beta[i] *= keep;
            }
        }
    }

    /// Moves to costs that are `ratio` times the present ones, and the point with them: it stays feasible, what is at a
    /// bound stays there, and the residual follows without a look at the kernel.
    pub(super) fn scale(&mut self, cost: Cost, ratio: f64) {
        for i in 0..self.beta.len() {
            let (at_lower, at_upper) = (self.fall[i] != 0.0, self.rise[i] != 0.0);
            self.residual[i] = self.target[i] - ratio * (self.target[i] - self.residual[i]);
            self.beta[i] = match (at_lower, at_upper) {
                (true, _) => {
                    if self.target[i] < 0.0 {
                        -cost.negative
                    } else {
                        0.0
                    }
                }
                (_, true) => {
                    if self.target[i] > 0.0 {
                        cost.positive
                    } else {
                        0.0
                    }
                }
                _ => self.beta[i] * ratio,
            };
        }
        self.set_bounds(cost);
    }

    /// The residual from the definition, in row order.
    fn refresh(&mut self, rows: &mut dyn Rows) {
        self.residual.copy_from_slice(&self.target);
        for j in 0..rows.count() {
            if self.beta[j] != 0.0 {
                subtract_row(&mut self.residual, self.beta[j], rows.row(j));
            }
        }
    }

    /// Largest residual of what can rise and least of what can fall: m and M of Fan, Chen & Lin (2005), eq. 6.
    fn extremes(&self) -> (f64, f64) {
        let most = self.residual.iter().zip(&self.rise).fold(f64::NEG_INFINITY, |m, (r, up)| m.max(r + up));
        let least = self.residual.iter().zip(&self.fall).fold(f64::INFINITY, |m, (r, down)| m.min(r + down));
        (most, least)
    }

    /// `1/2 a'Qa - sum a` at the present point.
    pub(super) fn objective(&self) -> f64 {
        let terms = self.beta.iter().zip(&self.residual).zip(&self.target);
        -0.5 * terms.map(|((b, r), y)| b * (r + y)).sum::<f64>()
    }

    /// The threshold: mean of `-residual` over the free variables, or without any the middle of what the bounds allow.
    ///
    /// A variable within [`AT_BOUND`] of a bound is not free. With balanced weights and a small cost every variable ends at its
    /// bound, but for the rounding of one, which would otherwise fix a threshold that is in truth an interval.
    pub(super) fn rho(&self) -> f64 {
        let (mut sum, mut free) = (0.0, 0_usize);
        let (mut most, mut least) = (f64::NEG_INFINITY, f64::INFINITY);
        for (i, &residual) in self.residual.iter().enumerate() {
            let margin = AT_BOUND * (self.upper[i] - self.lower[i]);
            let (rises, falls) = (self.beta[i] < self.upper[i] - margin, self.beta[i] > self.lower[i] + margin);
            if rises && falls {
                sum += residual;
                free += 1;
            }
            most = if rises { most.max(residual) } else { most };
            least = if falls { least.min(residual) } else { least };
        }
        if free > 0 { -sum / free as f64 } else { -0.5 * (most + least) }
    }

    /// Solves the problem from the present point, whose residual must be up to date.
    ///
    /// # Errors
    /// [`SolverError::TooManyIterations`], [`SolverError::NotConverged`] if the conditions still fail on a residual computed
    /// afresh after several tries, [`SolverError::NotFinite`] on overflow, [`SolverError::Cancelled`] once `stop` says so.
    pub(super) fn solve(
        &mut self,
        rows: &mut dyn Rows,
        options: &SolverOptions,
        stop: &dyn Fn() -> bool,
    ) -> Result<Effort, SolverError> {
        let mut iterations = 0;
        let mut gap = f64::INFINITY;
        for _ in 0..MAX_REFRESHES {
            loop {
                let budget = ITERATIONS_A_LOOK.min(options.max_iterations - iterations);
                let (done, finished) = descend(self, rows, options.epsilon, budget);
                iterations += done;
                if finished {
                    break;
                }
                if stop() {
                    return Err(SolverError::Cancelled);
                }
                if iterations >= options.max_iterations {
                    let (most, least) = self.extremes();
                    return Err(SolverError::TooManyIterations { iterations, gap: most - least });
                }
            }
            self.refresh(rows);
            let (most, least) = self.extremes();
            gap = most - least;
            if gap.is_nan() {
                return Err(SolverError::NotFinite);
            }
            if gap < options.epsilon {
                return Ok(Effort { iterations, gap });
            }
        }
        Err(SolverError::NotConverged { gap })
    }
}

#[multiversion(targets = "simd")]
fn subtract_row(target: &mut [f64], scale: f64, row: &[f32]) {
    subtract_scaled(target, scale, row);
}

/// Where the residual is largest among what can rise, and the two extremes.
struct Scan {
    first: usize,
    most: f64,
    least: f64,
}

impl Scan {
    /// Whether the gap m - M is below `epsilon`, or not a number: the caller then sees that in the fresh residual.
    #[inline(always)]
    fn is_final(&self, epsilon: f64) -> bool {
        let gap = self.most - self.least;
        gap < epsilon || gap.is_nan()
    }
}

/// Up to `budget` iterations; returns how many were made and whether the running gap fell below `epsilon`.
#[multiversion(targets = "simd")]
fn descend(dual: &mut Dual, rows: &mut dyn Rows, epsilon: f64, budget: usize) -> (usize, bool) {
    let diagonal = rows.diagonal().to_vec();
    let still = vec![0.0; diagonal.len()];
    let mut scan = step_and_scan(dual, 0.0, &still, &still);
    for iteration in 0..budget {
        if scan.is_final(epsilon) {
            return (iteration, true);
        }
        let i = scan.first;
        let j = select_second(dual, scan.most, diagonal[i], &diagonal, rows.row(i));
        let (row_i, row_j) = rows.pair(i, j);
        let curvature = f64::from(diagonal[i]) + f64::from(diagonal[j]) - 2.0 * f64::from(row_i[j]);
        let unbounded = (scan.most - dual.residual[j]) / curvature.max(TAU);
        let (room_i, room_j) = (dual.upper[i] - dual.beta[i], dual.beta[j] - dual.lower[j]);
        let step = unbounded.min(room_i).min(room_j);
        dual.beta[i] = if step >= room_i { dual.upper[i] } else { dual.beta[i] + step };
        dual.beta[j] = if step >= room_j { dual.lower[j] } else { dual.beta[j] - step };
        dual.mark_bounds(i);
        dual.mark_bounds(j);
        scan = step_and_scan(dual, step, row_i, row_j);
    }
    (budget, scan.is_final(epsilon))
}

/// The partner that promises the largest decrease, `b^2 / q` of Fan, Chen & Lin (2005), eq. 10 (WSS 2).
///
/// Single precision: it only ranks the partners, the step itself is double.
#[inline(always)]
fn select_second(dual: &Dual, most: f64, diagonal_i: f32, diagonal: &[f32], row: &[f32]) -> usize {
    let mut best = [-1.0_f32; LANES];
    let mut place = [0_u32; LANES];
    let residual = dual.residual.as_chunks::<LANES>().0;
    let fall = dual.fall.as_chunks::<LANES>().0;
    let (diagonal, row) = (diagonal.as_chunks::<LANES>().0, row.as_chunks::<LANES>().0);
    for (chunk, (((r, down), d), k)) in residual.iter().zip(fall).zip(diagonal).zip(row).enumerate() {
        for lane in 0..LANES {
            let violation = (most - (r[lane] + down[lane])) as f32;
            let curvature = diagonal_i + d[lane] - 2.0 * k[lane];
            let decrease = violation * violation / if curvature > TAU as f32 { curvature } else { TAU as f32 };
            let score = if violation > 0.0 { decrease } else { -1.0 };
            let better = score > best[lane];
            best[lane] = if better { score } else { best[lane] };
            place[lane] = if better { chunk as u32 } else { place[lane] };
        }
    }
    let mut winner = (best[0], place[0] as usize * LANES);
    for lane in 1..LANES {
        let candidate = (best[lane], place[lane] as usize * LANES + lane);
        if candidate.0 > winner.0 || (candidate.0 == winner.0 && candidate.1 < winner.1) {
            winner = candidate;
        }
    }
    winner.1
}

/// Moves the residual by a step along `e_i - e_j` and finds the next extremes in the same pass.
#[inline(always)]
fn step_and_scan(dual: &mut Dual, step: f64, row_i: &[f32], row_j: &[f32]) -> Scan {
    let mut best = [f64::NEG_INFINITY; LANES];
    let mut place = [0_u64; LANES];
    let mut least = [f64::INFINITY; LANES];
    let rise = dual.rise.as_chunks::<LANES>().0;
    let fall = dual.fall.as_chunks::<LANES>().0;
    let residual = dual.residual.as_chunks_mut::<LANES>().0;
    let (row_i, row_j) = (row_i.as_chunks::<LANES>().0, row_j.as_chunks::<LANES>().0);
    for (chunk, ((((r, up), down), ki), kj)) in
        residual.iter_mut().zip(rise).zip(fall).zip(row_i).zip(row_j).enumerate()
    {
        for lane in 0..LANES {
            let moved = r[lane] - step * (f64::from(ki[lane]) - f64::from(kj[lane]));
            r[lane] = moved;
            let high = moved + up[lane];
            let better = high > best[lane];
            best[lane] = if better { high } else { best[lane] };
            place[lane] = if better { chunk as u64 } else { place[lane] };
            let low = moved + down[lane];
            least[lane] = if low < least[lane] { low } else { least[lane] };
        }
    }
    let mut scan = Scan { first: place[0] as usize * LANES, most: best[0], least: least[0] };
    for lane in 1..LANES {
        let at = place[lane] as usize * LANES + lane;
        if best[lane] > scan.most || (best[lane] == scan.most && at < scan.first) {
            (scan.most, scan.first) = (best[lane], at);
        }
        scan.least = scan.least.min(least[lane]);
    }
    scan
}

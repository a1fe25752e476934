//! Sequential minimal optimisation of one dual problem: the state and the inner loop.

use multiversion::multiversion;

use super::lanes::{BLOCK, from_order, order, padded, subtract_scaled};
use super::rows::Rows;
use super::solver::{Cost, Solution, SolverError, SolverOptions};

/// Least curvature of a working pair (Fan, Chen & Lin 2005): pairs of equal rows have none of their own.
const TAU: f64 = 1e-12;

/// Share of its range within which a variable counts as being at a bound when the threshold is computed.
const AT_BOUND: f64 = 1e-12;

/// How often a residual is computed afresh before a fit counts as failed.
const MAX_REFRESHES: usize = 20;

/// Most iterations between two looks at whether the caller still wants the result.
const ITERATIONS_A_LOOK: usize = 8192;

/// Multiplications between two looks, about: some hundredths of a second.
const WORK_A_LOOK: usize = 1 << 26;

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

    /// +1 for an event, -1 otherwise; padding 0.
    pub(super) fn target(&self) -> &[f64] {
        &self.target
    }

    /// Lower and upper bounds of `beta`.
    pub(super) fn bounds(&self) -> (&[f64], &[f64]) {
        (&self.lower, &self.upper)
    }

    /// Moves to the feasible `beta` whose decision values without threshold are `products`, and returns m - M there.
    pub(super) fn place(&mut self, beta: &[f64], products: &[f64]) -> f64 {
        self.beta[..beta.len()].copy_from_slice(beta);
        for (i, product) in products.iter().enumerate() {
            self.residual[i] = self.target[i] - product;
            self.mark_bounds(i);
        }
        let (most, least) = self.extremes();
        most - least
    }

    /// Starts from `alpha` made feasible: clipped to the bounds, then the class with the larger sum is reduced, its free
    /// variables first so that those at their bound stay there.
    pub(super) fn start_from(&mut self, alpha: &[f64], rows: &mut dyn Rows) {
        for (i, &a) in alpha.iter().enumerate() {
            self.beta[i] = (a * self.target[i]).clamp(self.lower[i], self.upper[i]);
        }
        self.balance();
        (0..self.beta.len()).for_each(|i| self.mark_bounds(i));
        self.refresh(rows);
    }

    /// Takes the excess of the class with the larger sum out of its variables, one after the other.
    fn balance(&mut self) {
        let mut excess: f64 = self.beta.iter().sum();
        for free_only in [true, false] {
            for i in 0..self.beta.len() {
                let is_free = self.beta[i] != self.lower[i] && self.beta[i] != self.upper[i];
                if self.beta[i] * excess > 0.0 && (is_free || !free_only) {
                    let taken = if self.beta[i].abs() < excess.abs() { self.beta[i] } else { excess };
                    self.beta[i] -= taken;
                    excess -= taken;
                }
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

    /// The residual from the definition, in row order: what makes a point that is kept valid for other `rows`.
    pub(super) fn refresh(&mut self, rows: &mut dyn Rows) {
        self.refresh_unless(rows, &|| false);
    }

    /// [`Self::refresh`] until `stop` says so; whether it came to its end.
    fn refresh_unless(&mut self, rows: &mut dyn Rows, stop: &dyn Fn() -> bool) -> bool {
        self.residual.copy_from_slice(&self.target);
        for j in 0..rows.count() {
            if self.beta[j] != 0.0 {
                if stop() {
                    return false;
                }
                subtract_row(&mut self.residual, self.beta[j], rows.row(j));
            }
        }
        true
    }

    /// The residual from the decision values without threshold of the present point, one a row: what makes a point that is kept
    /// valid for another kernel, of which these are.
    pub(super) fn renew(&mut self, products: &[f64]) {
        for ((residual, target), product) in self.residual.iter_mut().zip(&self.target).zip(products) {
            *residual = target - product;
        }
    }

    /// Largest residual of what can rise and least of what can fall: m and M of Fan, Chen & Lin (2005).
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

    /// The present point as a solution that took `effort`.
    pub(super) fn solution(&self, effort: Effort) -> Solution {
        let alphas = self.beta.iter().zip(&self.target).filter(|(_, target)| **target != 0.0);
        Solution {
            alpha: alphas.map(|(b, _)| b.abs()).collect(),
            rho: self.rho(),
            objective: self.objective(),
            iterations: effort.iterations,
            kkt_gap: effort.gap,
        }
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
        // neither kernel exceeds the larger of two diagonal values, so these vouch for all
        if !rows.diagonal().iter().all(|k| k.is_finite()) {
            return Err(SolverError::NotFinite);
        }
        let mut iterations = 0;
        let mut gap = f64::INFINITY;
        for _ in 0..MAX_REFRESHES {
            self.descend_fully(rows, options, &mut iterations, stop)?;
            if !self.refresh_unless(rows, stop) {
                return Err(SolverError::Cancelled);
            }
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

    /// As [`Self::solve`], from a residual that was just computed afresh: it is computed afresh at the end only where what
    /// rounding may have added on the way could matter.
    ///
    /// # Errors
    /// As [`Self::solve`].
    pub(super) fn solve_fresh(
        &mut self,
        rows: &mut dyn Rows,
        options: &SolverOptions,
        stop: &dyn Fn() -> bool,
    ) -> Result<Effort, SolverError> {
        /// Share of the tolerance that rounding may take.
        const SHARE: f64 = 1e-3;
        let mut iterations = 0;
        self.descend_fully(rows, options, &mut iterations, stop)?;
        // a residual never exceeds 1 and the kernel (at most the diagonal) times all that beta can hold, and a step rounds its
        // entries three times
        let room: f64 = self.upper.iter().zip(&self.lower).map(|(upper, lower)| upper - lower).sum();
        let largest = rows.diagonal().iter().fold(1.0, |most: f64, &k| most.max(f64::from(k)));
        let rounding = 3.0 * iterations as f64 * f64::EPSILON * (1.0 + largest * room);
        let (most, least) = self.extremes();
        if most - least < options.epsilon && rounding < SHARE * options.epsilon {
            return Ok(Effort { iterations, gap: most - least });
        }
        let rest = self.solve(rows, options, stop)?;
        Ok(Effort { iterations: iterations + rest.iterations, ..rest })
    }

    /// Descends until the running gap is below the tolerance; counts the iterations.
    fn descend_fully(
        &mut self,
        rows: &mut dyn Rows,
        options: &SolverOptions,
        iterations: &mut usize,
        stop: &dyn Fn() -> bool,
    ) -> Result<(), SolverError> {
        // an iteration reads two rows, which may have to be computed first
        let a_look = (WORK_A_LOOK / (2 * rows.row_work()).max(1)).clamp(1, ITERATIONS_A_LOOK);
        loop {
            let budget = a_look.min(options.max_iterations - *iterations);
            let (done, finished) = descend(self, rows, options.epsilon, budget);
            *iterations += done;
            if finished {
                return Ok(());
            }
            if stop() {
                return Err(SolverError::Cancelled);
            }
            if *iterations >= options.max_iterations {
                let (most, least) = self.extremes();
                return Err(SolverError::TooManyIterations { iterations: *iterations, gap: most - least });
            }
        }
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
    let mut peaks = vec![i64::MIN; diagonal.len() / BLOCK];
    let mut scan = step_and_scan(&mut dual.residual, &dual.rise, &dual.fall, 0.0, &still, &still, &mut peaks);
    for iteration in 0..budget {
        if scan.is_final(epsilon) {
            return (iteration, true);
        }
        let i = scan.first;
        let second = select_second(&dual.residual, &dual.fall, scan.most, diagonal[i], &diagonal, rows.row(i));
        // none: what is left of the gap vanishes in single precision, and the fresh residual decides
        let Some(j) = second else { return (iteration, true) };
        let (row_i, row_j) = rows.pair(i, j);
        let curvature = f64::from(diagonal[i]) + f64::from(diagonal[j]) - 2.0 * f64::from(row_i[j]);
        let unbounded = (scan.most - dual.residual[j]) / curvature.max(TAU);
        let (room_i, room_j) = (dual.upper[i] - dual.beta[i], dual.beta[j] - dual.lower[j]);
        let step = unbounded.min(room_i).min(room_j);
        dual.beta[i] = if step >= room_i { dual.upper[i] } else { dual.beta[i] + step };
        dual.beta[j] = if step >= room_j { dual.lower[j] } else { dual.beta[j] - step };
        dual.mark_bounds(i);
        dual.mark_bounds(j);
        scan = step_and_scan(&mut dual.residual, &dual.rise, &dual.fall, step, row_i, row_j, &mut peaks);
    }
    (budget, scan.is_final(epsilon))
}

/// The partner that promises the largest decrease, `b^2 / q` (WSS 2 of Fan, Chen & Lin 2005); `None` if none promises any.
#[inline(always)]
fn select_second(
    residual: &[f64],
    fall: &[f64],
    most: f64,
    diagonal_i: f32,
    diagonal: &[f32],
    row: &[f32],
) -> Option<usize> {
    let blocks = || {
        let scores = residual.as_chunks::<BLOCK>().0.iter().zip(fall.as_chunks::<BLOCK>().0);
        scores.zip(diagonal.as_chunks::<BLOCK>().0.iter().zip(row.as_chunks::<BLOCK>().0))
    };
    let mut best = (-1, 0);
    for (block, ((r, down), (d, k))) in blocks().enumerate() {
        let mut peak = i32::MIN;
        for lane in 0..BLOCK {
            peak = peak.max(promise(most, r[lane] + down[lane], diagonal_i, d[lane], k[lane]));
        }
        if peak > best.0 {
            best = (peak, block);
        }
    }
    let (peak, block) = best;
    let ((r, down), (d, k)) = blocks().nth(block)?;
    let lane = (0..BLOCK).find(|&lane| promise(most, r[lane] + down[lane], diagonal_i, d[lane], k[lane]) == peak)?;
    (peak >= 0).then_some(block * BLOCK + lane)
}

/// How much a partner promises, as an integer that orders as the promise does; below 0 for one that promises nothing.
///
/// Single precision: it only ranks the partners, the step itself is double. The bits of a float above 0 order as it does.
#[inline(always)]
fn promise(most: f64, residual: f64, diagonal_i: f32, diagonal_j: f32, k: f32) -> i32 {
    let violation = (most - residual) as f32;
    let curvature = diagonal_i + diagonal_j - 2.0 * k;
    let decrease = violation * violation / if curvature > TAU as f32 { curvature } else { TAU as f32 };
    if violation > 0.0 { decrease.to_bits() as i32 } else { -1 }
}

/// Moves the residual by `step` along `e_i - e_j` and finds the next extremes in the same pass. `peaks` is scratch.
#[inline(always)]
fn step_and_scan(
    residual: &mut [f64],
    rise: &[f64],
    fall: &[f64],
    step: f64,
    row_i: &[f32],
    row_j: &[f32],
    peaks: &mut [i64],
) -> Scan {
    let mut least = i64::MAX;
    let bounds = rise.as_chunks::<BLOCK>().0.iter().zip(fall.as_chunks::<BLOCK>().0);
    let rows = row_i.as_chunks::<BLOCK>().0.iter().zip(row_j.as_chunks::<BLOCK>().0);
    let blocks = residual.as_chunks_mut::<BLOCK>().0.iter_mut().zip(peaks.iter_mut());
    for ((r, peak), ((up, down), (ki, kj))) in blocks.zip(bounds.zip(rows)) {
        let mut most = i64::MIN;
        for lane in 0..BLOCK {
            let moved = r[lane] - step * (f64::from(ki[lane]) - f64::from(kj[lane]));
            r[lane] = moved;
            most = most.max(order(moved + up[lane]));
            least = least.min(order(moved + down[lane]));
        }
        *peak = most;
    }
    let most = peaks.iter().fold(i64::MIN, |most, &peak| most.max(peak));
    let block = peaks.iter().position(|&peak| peak == most).unwrap_or(0);
    let start = block * BLOCK;
    let lane = (0..BLOCK).find(|&lane| order(residual[start + lane] + rise[start + lane]) == most).unwrap_or(0);
    Scan { first: start + lane, most: from_order(most), least: from_order(least) }
}

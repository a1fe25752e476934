//! The two-parameter families `p(u) = exp(-b u - c t(u)) / Z` of `u = ln(x / xmin)`.
//!
//! `t(u) = exp(u) - 1` is the power law with an exponential cut-off (alpha = b + 1, cut-off xmin / c), `t(u) = u^2` the
//! lognormal truncated from below. Both are exponential families with the sufficient statistics u and t(u): the likelihood is
//! concave in (b, c), c >= 0, its observed information is n times their covariance, and c = 0 is the pure power law. The
//! exponent of the density is concave, which serves the quadrature and the sampler alike.
//!
//! Z is `(L xmin)^(alpha - 1) e^(L xmin) Gamma(1 - alpha, L xmin)` for the cut-off model. It and the moments are taken by
//! Gauss-Legendre quadrature in u, where the integrand is smooth for every alpha: integers need no special care.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Which second statistic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shape {
    /// `t = exp(u) - 1`.
    Cutoff,
    /// `t = u^2`.
    Lognormal,
}

impl Shape {
    /// The second sufficient statistic.
    #[inline]
    pub(super) fn statistic(self, u: f64) -> f64 {
        match self {
            Self::Cutoff => u.exp_m1(),
            Self::Lognormal => u * u,
        }
    }

    #[inline]
    fn statistic_slope(self, u: f64) -> f64 {
        match self {
            Self::Cutoff => u.exp(),
            Self::Lognormal => 2.0 * u,
        }
    }
}

/// Drop of the exponent below its maximum beyond which the density is left out: e^-45 is 3e-20.
const DEPTH: f64 = 45.0;

/// Abscissae above 0 and weights of the Gauss-Legendre rule with 20 points (DLMF 3.5(v)).
const RULE: [(f64, f64); 10] = [
    (0.076_526_521_133_497_34, 0.152_753_387_130_725_84),
    (0.227_785_851_141_645_07, 0.149_172_986_472_603_74),
    (0.373_706_088_715_419_55, 0.142_096_109_318_382_04),
    (0.510_867_001_950_827_1, 0.131_688_638_449_176_64),
    (0.636_053_680_726_515, 0.118_194_531_961_518_41),
    (0.746_331_906_460_150_8, 0.101_930_119_817_240_43),
    (0.839_116_971_822_218_8, 0.083_276_741_576_704_75),
    (0.912_234_428_251_326, 0.062_672_048_334_109_07),
    (0.963_971_927_277_913_8, 0.040_601_429_800_386_94),
    (0.993_128_599_185_094_9, 0.017_614_007_139_152_118),
];

/// `Z` and the moments of `(u, t)` over an interval.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moments {
    /// `ln Z`.
    pub(super) log_z: f64,
    /// Means of u and t.
    pub(super) mean: [f64; 2],
    /// Variance of u, covariance, variance of t.
    pub(super) covariance: [f64; 3],
}

/// One member of a family on `lower <= u <= upper`; `upper` may be infinite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Tilted {
    pub(super) shape: Shape,
    pub(super) b: f64,
    pub(super) c: f64,
    pub(super) upper: f64,
}

impl Tilted {
    #[inline]
    fn exponent(&self, u: f64) -> f64 {
        -self.b * u - self.c * self.shape.statistic(u)
    }

    fn exponent_slope(&self, u: f64) -> f64 {
        -self.b - self.c * self.shape.statistic_slope(u)
    }

    /// Where the exponent is largest on `lower..=upper`.
    fn mode(&self, lower: f64, upper: f64) -> f64 {
        let free = match self.shape {
            Shape::Cutoff if self.b < 0.0 => (-self.b / self.c).ln(),
            Shape::Lognormal if self.c > 0.0 => -self.b / (2.0 * self.c),
            _ if self.b < 0.0 => upper,
            _ => lower,
        };
        free.clamp(lower, upper)
    }

    /// The part of `lower..=upper` that holds all but e^-45 of the density.
    fn support(&self, lower: f64, upper: f64) -> (f64, f64) {
        let mode = self.mode(lower, upper);
        let floor = self.exponent(mode) - DEPTH;
        (self.where_exponent_is(floor, mode, lower), self.where_exponent_is(floor, mode, upper))
    }

    /// The point between `mode` and `end` where the exponent has sunk to `floor`; `end` if it does not sink so far.
    fn where_exponent_is(&self, floor: f64, mode: f64, end: f64) -> f64 {
        let direction = if end > mode { 1.0 } else { -1.0 };
        if end.is_finite() && self.exponent(end) >= floor {
            return end;
        }
        let mut step = 1e-3;
        while self.exponent(mode + direction * step) > floor && step < 1e6 {
            step *= 2.0;
        }
        let (mut inside, mut outside) = (step / 2.0, step);
        for _ in 0..20 {
            let middle = 0.5 * (inside + outside);
            if self.exponent(mode + direction * middle) > floor { inside = middle } else { outside = middle }
        }
        let found = mode + direction * outside;
        if direction > 0.0 { found.min(end) } else { found.max(end) }
    }

    /// Moments over `lower..=upper`, of which the part beyond the support of the density is left out.
    pub(super) fn moments(&self, lower: f64, upper: f64) -> Moments {
        let (from, to) = self.support(lower, upper);
        let shift = self.exponent(self.mode(from, to));
        // a panel spans at most 2 in u, where exp(-c e^u) has a scale of 1, and about 6 in the exponent
        let panels = ((to - from) / 2.0).ceil().clamp(8.0, 256.0);
        let half = (to - from) / panels / 2.0;
        // statistics relative to a point inside, so that the covariance does not cancel
        let centre = self.mode(from, to);
        let (u0, t0) = (centre, self.shape.statistic(centre));
        let mut sum = [0.0; 6];
        for panel in 0..panels as usize {
            let middle = from + (2 * panel + 1) as f64 * half;
            for (x, w) in RULE {
                for u in [middle - half * x, middle + half * x] {
                    let t = self.shape.statistic(u);
                    let weight = w * (-self.b * u - self.c * t - shift).exp();
                    let (du, dt) = (u - u0, t - t0);
                    sum[0] += weight;
                    sum[1] += weight * du;
                    sum[2] += weight * dt;
                    sum[3] += weight * du * du;
                    sum[4] += weight * du * dt;
                    sum[5] += weight * dt * dt;
                }
            }
        }
        let [z, u, t, uu, ut, tt] = sum;
        let (u, t) = (u / z, t / z);
        Moments {
            log_z: (z * half).ln() + shift,
            mean: [u0 + u, t0 + t],
            covariance: [uu / z - u * u, ut / z - u * t, tt / z - t * t],
        }
    }

    /// All moments of the distribution.
    pub(super) fn all(&self) -> Moments {
        self.moments(0.0, self.upper)
    }

    /// `ln p(u)`, given `ln Z`.
    #[inline]
    pub(super) fn log_density(&self, u: f64, log_z: f64) -> f64 {
        self.exponent(u) - log_z
    }
}

/// Intervals of a [`Table`].
const KNOTS: usize = 256;
/// Abscissae and weights of the Gauss-Legendre rule with 4 points on 0..1.
const RULE_4: [(f64, f64); 4] = [
    (0.069_431_844_202_973_71, 0.173_927_422_568_726_93),
    (0.330_009_478_207_571_87, 0.326_072_577_431_273_07),
    (0.669_990_521_792_428_1, 0.326_072_577_431_273_07),
    (0.930_568_155_797_026_3, 0.173_927_422_568_726_93),
];

/// The distribution function at equal steps of u, between which a cubic with the right slopes interpolates.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::emission) struct Table {
    from: f64,
    step: f64,
    /// Distribution function and density times the step at each knot.
    knots: Vec<(f64, f64)>,
}

impl Table {
    pub(super) fn new(tilted: &Tilted) -> Self {
        let (from, to) = tilted.support(0.0, tilted.upper);
        let step = (to - from) / KNOTS as f64;
        let shift = tilted.exponent(tilted.mode(from, to));
        let density = |u: f64| (tilted.exponent(u) - shift).exp() * step;
        let mut knots = Vec::with_capacity(KNOTS + 1);
        let mut sum = 0.0;
        for k in 0..=KNOTS {
            let u = from + k as f64 * step;
            knots.push((sum, density(u)));
            sum += RULE_4.into_iter().map(|(x, w)| w * density(u + x * step)).sum::<f64>();
        }
        let total = knots[KNOTS].0;
        for knot in &mut knots {
            *knot = (knot.0 / total, knot.1 / total);
        }
        Self { from, step, knots }
    }

    /// Distribution function, with an absolute error of about 1e-7.
    #[inline]
    pub(super) fn cdf(&self, u: f64) -> f64 {
        let position = (u - self.from) / self.step;
        if position <= 0.0 {
            return 0.0;
        }
        let k = position as usize;
        if k >= KNOTS {
            return 1.0;
        }
        let x = position - k as f64;
        let ((f0, d0), (f1, d1)) = (self.knots[k], self.knots[k + 1]);
        let rise = f1 - f0;
        f0 + x * (d0 + x * (3.0 * rise - 2.0 * d0 - d1 + x * (d0 + d1 - 2.0 * rise)))
    }
}

/// Tangents of the [`Sampler`].
const TANGENTS: usize = 48;

/// Draws exactly from a [`Tilted`] density: rejection below tangents to its concave exponent (Gilks & Wild 1992, Appl.
/// Statist. 41, 337-348, without the adaptation).
#[derive(Clone, Debug)]
pub(in crate::emission) struct Sampler {
    tilted: Tilted,
    pieces: Vec<Piece>,
}

/// A tangent and the interval in which it is the lowest.
#[derive(Clone, Copy, Debug)]
struct Piece {
    /// Share of the envelope up to the end of this piece.
    cumulative: f64,
    start: f64,
    width: f64,
    /// Height of the tangent at the start, and its slope.
    height: f64,
    slope: f64,
}

impl Sampler {
    pub(super) fn new(tilted: &Tilted) -> Self {
        let (from, to) = tilted.support(0.0, tilted.upper);
        let shift = tilted.exponent(tilted.mode(from, to));
        let step = (to - from) / TANGENTS as f64;
        let mut pieces = Vec::with_capacity(TANGENTS);
        let mut total = 0.0;
        for k in 0..TANGENTS {
            let (start, middle) = (from + k as f64 * step, from + (k as f64 + 0.5) * step);
            // each tangent serves its own interval: higher than the lowest hull, but simple, and about 1 % is rejected
            let slope = tilted.exponent_slope(middle);
            let height = tilted.exponent(middle) - shift - slope * step / 2.0;
            total += mass(height, slope, step);
            pieces.push(Piece { cumulative: total, start, width: step, height, slope });
        }
        for piece in &mut pieces {
            piece.cumulative /= total;
        }
        for piece in &mut pieces {
            piece.height += shift;
        }
        Self { tilted: *tilted, pieces }
    }

    /// One value of u.
    pub(super) fn draw(&self, rng: &mut ChaCha8Rng) -> f64 {
        loop {
            let v: f64 = rng.random();
            let k = self.pieces.partition_point(|piece| piece.cumulative <= v).min(self.pieces.len() - 1);
            let piece = self.pieces[k];
            let w: f64 = rng.random();
            let offset = if (piece.slope * piece.width).abs() < 1e-9 {
                w * piece.width
            } else {
                (w * (piece.slope * piece.width).exp_m1()).ln_1p() / piece.slope
            };
            let u = piece.start + offset;
            let envelope = piece.height + piece.slope * offset;
            if rng.random::<f64>().ln() <= self.tilted.exponent(u) - envelope {
                return u;
            }
        }
    }
}

/// `integral of exp(height + slope v), v from 0 to width`.
fn mass(height: f64, slope: f64, width: f64) -> f64 {
    let rise = slope * width;
    height.exp() * width * if rise.abs() < 1e-9 { 1.0 } else { rise.exp_m1() / rise }
}

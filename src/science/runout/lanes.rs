//! Numbers of the dynamics in either precision, with elementary functions that compile to SIMD.
//!
//! Nothing here depends on the width of the machine's registers or on its mathematical library, and multiplications are
//! fused with additions only where it says so, so every instruction set gives the same bits. What is fused is slow where
//! the machine cannot do it: x86-64 before AVX2.

use std::{
    fmt::Debug,
    ops::{Add, AddAssign, Div, Mul, Neg, Sub},
};

use serde::{Serialize, de::DeserializeOwned};

use super::transfer::{Audit, ChunkGrid, Motion, Step};
use super::{
    grid::Reduction,
    particles::{Block, Flip},
};

/// `f32` or `f64`.
pub(super) trait Real:
    Copy
    + Debug
    + Default
    + PartialOrd
    + Send
    + Sync
    + Serialize
    + DeserializeOwned
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + 'static
{
    /// Four of them in a register.
    type V: super::vector::Vector<Self>;

    /// Steps of Halley's method after which a plastic return has converged to this precision, from any trial stress.
    const RETURN_STEPS: usize;

    /// Rounded to this precision.
    fn of(x: f64) -> Self;

    /// The same number.
    fn f64(self) -> f64;

    /// Square root, correctly rounded.
    fn sqrt(self) -> Self;

    /// `self * by + plus`, rounded once.
    fn mul_add(self, by: Self, plus: Self) -> Self;

    /// The nearest integer, as a number and as an integer; `|self| < 2^22`.
    fn nearest(self) -> (Self, i32);

    /// For `y = 1 + x > 0`: the exponent `k` that brings `y / 2^k` between `sqrt(1/2)` and `sqrt 2`, and `y / 2^k - 1`, which
    /// is `x` itself where `k = 0`.
    fn reduced(self) -> (Self, Self);

    /// `atanh(s) / s` of `z = s^2 <= `[`NEAR`].
    fn atanh_ratio(z: Self) -> Self;

    /// `cosh(x) - 1` and `sinh(x) / x` of `z = x^2`, where `tanh(x)^2 <= `[`NEAR`].
    fn cosh_m1_and_sinh_ratio(z: Self) -> (Self, Self);

    /// `exp(x) - 1` for `|x| <= 80`; beyond, that of the bound.
    fn exp_m1(self) -> Self;

    /// One step of the particles of a chunk: see [`super::transfer::step`].
    fn step(
        step: &Step<'_, Self>,
        blocks: &mut [Block<Self>],
        motion: &mut [Motion<Self>],
        flip: &mut [Flip<Self>],
        grid: &mut ChunkGrid<Self>,
    );

    /// The transfer of a chunk without its forces: see [`super::transfer::audit`].
    fn audit(audit: &Audit<'_, Self>, blocks: &[Block<Self>], flip: &[Flip<Self>], grid: &mut ChunkGrid<Self>);

    /// What the grid did not take of a chunk's velocities: see [`super::transfer::remain`].
    fn remain(step: &Step<'_, Self>, share: Self, blocks: &[Block<Self>], flip: &mut [Flip<Self>]);

    /// Velocities of the nodes of a chunk: see [`super::grid::reduce`].
    fn reduce(reduction: &Reduction<'_, Self>, velocity: &mut [[Self; 4]]) -> super::grid::Reduced;
}

/// Squares up to which series are short: a little over that of `(sqrt 2 - 1) / (sqrt 2 + 1)`, which is what a logarithm
/// comes to once the power of 2 is taken out.
pub(super) const NEAR: f64 = 0.0295;

/// `ln 2`.
const LN_2: f64 = std::f64::consts::LN_2;

/// `ln(1 + x)` and `ln(1 + y)` by one division; `x, y > -1`.
#[inline(always)]
pub(super) fn ln_1p_pair<T: Real>(x: T, y: T) -> (T, T) {
    let two = T::of(2.0);
    let ((kx, x), (ky, y)) = (x.reduced(), y.reduced());
    let (dx, dy) = (two + x, two + y);
    let inverse = T::of(1.0) / (dx * dy);
    let (sx, sy) = (x * (dy * inverse), y * (dx * inverse));
    let log = |k: T, s: T| k.mul_add(T::of(LN_2), (s + s) * T::atanh_ratio(s * s));
    (log(kx, sx), log(ky, sy))
}

/// `sinh(x)` for `x` from 0 to 80; beyond, that of 80.
#[inline(always)]
pub(super) fn sinh<T: Real>(x: T) -> T {
    let e = x.exp_m1();
    T::of(0.5) * (e + e / (T::of(1.0) + e))
}

/// The larger of two numbers; the second where one is none.
#[inline(always)]
pub(super) fn max<T: Real>(a: T, b: T) -> T {
    if a > b { a } else { b }
}

/// The smaller of two numbers; the second where one is none.
#[inline(always)]
pub(super) fn min<T: Real>(a: T, b: T) -> T {
    if a < b { a } else { b }
}

macro_rules! real {
    (
        $t:ident, $vector:ty, $signed:ident, $mantissa:literal, $bias:literal, $round:literal, $steps:literal,
        atanh $atanh:expr, cosh $cosh:expr, sinh $sinh:expr, exp $exp:expr, ln_2 ($high:expr, $low:expr),
        $step:ident, $audit:ident, $remain:ident, $reduce:ident
    ) => {
        impl Real for $t {
            type V = $vector;

            const RETURN_STEPS: usize = $steps;

            #[inline(always)]
            fn of(x: f64) -> Self {
                x as $t
            }

            #[inline(always)]
            fn f64(self) -> f64 {
                f64::from(self)
            }

            #[inline(always)]
            fn sqrt(self) -> Self {
                $t::sqrt(self)
            }

            #[inline(always)]
            fn mul_add(self, by: Self, plus: Self) -> Self {
                $t::mul_add(self, by, plus)
            }

            #[inline(always)]
            fn nearest(self) -> (Self, i32) {
                // adding 1.5 * 2^(mantissa bits) leaves the integer in the low bits
                let shifted = self + $round;
                let integer = shifted.to_bits().wrapping_sub(($round as $t).to_bits()) as i32;
                (shifted - $round, integer)
            }

            #[inline(always)]
            fn reduced(self) -> (Self, Self) {
                const ROOT_HALF: $signed = std::$t::consts::FRAC_1_SQRT_2.to_bits() as $signed;
                let bits = (1.0 + self).to_bits() as $signed;
                let k = (bits - ROOT_HALF) >> $mantissa;
                let mantissa = $t::from_bits((bits - (k << $mantissa)) as _);
                (k as i32 as $t, if k == 0 { self } else { mantissa - 1.0 })
            }

            #[inline(always)]
            fn atanh_ratio(z: Self) -> Self {
                let terms = $atanh;
                let mut sum = terms[0];
                for term in &terms[1..] {
                    sum = sum.mul_add(z, *term);
                }
                sum.mul_add(z, 1.0)
            }

            #[inline(always)]
            fn cosh_m1_and_sinh_ratio(z: Self) -> (Self, Self) {
                let (cosh_terms, sinh_terms) = ($cosh, $sinh);
                let (mut cosh, mut sinh) = (cosh_terms[0], sinh_terms[0]);
                for term in &cosh_terms[1..] {
                    cosh = cosh.mul_add(z, *term);
                }
                for term in &sinh_terms[1..] {
                    sinh = sinh.mul_add(z, *term);
                }
                (cosh * z, sinh.mul_add(z, 1.0))
            }

            #[inline(always)]
            fn exp_m1(self) -> Self {
                let x = max(min(self, 80.0), -80.0);
                let shifted = x.mul_add(std::$t::consts::LOG2_E, $round);
                let k = shifted - $round;
                let r = k.mul_add(-$low, k.mul_add(-$high, x));
                let terms = $exp;
                let mut sum = terms[0];
                for term in &terms[1..] {
                    sum = sum.mul_add(r, *term);
                }
                let fraction = (sum * r).mul_add(r, r);
                let integer = shifted.to_bits().wrapping_sub(($round as $t).to_bits());
                let power = $t::from_bits(integer.wrapping_add($bias) << $mantissa);
                power.mul_add(fraction, power - 1.0)
            }

            fn step(
                step: &Step<'_, $t>,
                blocks: &mut [Block<$t>],
                motion: &mut [Motion<$t>],
                flip: &mut [Flip<$t>],
                grid: &mut ChunkGrid<$t>,
            ) {
                super::transfer::$step(step, blocks, motion, flip, grid)
            }

            fn audit(audit: &Audit<'_, $t>, blocks: &[Block<$t>], flip: &[Flip<$t>], grid: &mut ChunkGrid<$t>) {
                super::transfer::$audit(audit, blocks, flip, grid)
            }

            fn remain(step: &Step<'_, $t>, share: $t, blocks: &[Block<$t>], flip: &mut [Flip<$t>]) {
                super::transfer::$remain(step, share, blocks, flip)
            }

            fn reduce(reduction: &Reduction<'_, $t>, velocity: &mut [[$t; 4]]) -> super::grid::Reduced {
                super::grid::$reduce(reduction, velocity)
            }
        }
    };
}

// Taylor series from the last term on: atanh(s)/s = 1 + z/3 + z^2/5 ..., (cosh(x) - 1)/z = 1/2 + z/24 + ...,
// sinh(x)/x = 1 + z/6 + ..., (exp(r) - 1 - r)/r^2 = 1/2 + r/6 + ... with |r| <= ln 2 / 2; ln 2 in two parts, of which the first times a small integer is exact (Cody & Waite 1980)
real!(
    f32, wide::f32x4, i32, 23, 127, 12_582_912.0, 2,
    atanh [1.0 / 9.0, 1.0 / 7.0, 1.0 / 5.0, 1.0 / 3.0],
    cosh [1.0 / 720.0, 1.0 / 24.0, 0.5],
    sinh [1.0 / 120.0, 1.0 / 6.0],
    exp [1.0 / 5_040.0, 1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5],
    ln_2 (355.0 / 512.0, -2.121_944_4e-4),
    step_f32, audit_f32, remain_f32, reduce_f32
);
real!(
    f64, super::vector::Four, i64, 52, 1023, 6_755_399_441_055_744.0, 4,
    atanh [
        1.0 / 21.0, 1.0 / 19.0, 1.0 / 17.0, 1.0 / 15.0, 1.0 / 13.0, 1.0 / 11.0, 1.0 / 9.0, 1.0 / 7.0, 1.0 / 5.0, 1.0 / 3.0
    ],
    cosh [1.0 / 479_001_600.0, 1.0 / 3_628_800.0, 1.0 / 40_320.0, 1.0 / 720.0, 1.0 / 24.0, 0.5],
    sinh [1.0 / 6_227_020_800.0, 1.0 / 39_916_800.0, 1.0 / 362_880.0, 1.0 / 5_040.0, 1.0 / 120.0, 1.0 / 6.0],
    exp [
        1.0 / 6_227_020_800.0, 1.0 / 479_001_600.0, 1.0 / 39_916_800.0, 1.0 / 3_628_800.0, 1.0 / 362_880.0, 1.0 / 40_320.0,
        1.0 / 5_040.0, 1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5
    ],
    ln_2 (f64::from_bits(0x3fe6_2e42_fee0_0000), f64::from_bits(0x3dea_39ef_3579_3c76)),
    step_f64, audit_f64, remain_f64, reduce_f64
);

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest error of `f` against the platform's `g`, in units of the last place of `f64` times `scale`.
    fn worst(range: std::ops::Range<f64>, f: impl Fn(f64) -> f64, g: impl Fn(f64) -> f64) -> f64 {
        (0..200_000)
            .map(|i| range.start + (range.end - range.start) * f64::from(i) / 200_000.0)
            .map(|x| ((f(x) - g(x)) / g(x).abs().max(1e-300)).abs())
            .fold(0.0, f64::max)
    }

    #[test]
    fn logarithms_agree_with_the_platform() {
        // the exact 0 is left out: its relative error is none
        for range in [-0.9..-1e-3, -1e-3..-1e-9, 1e-9..1e-3, 1e-3..4.0] {
            let error = worst(range.clone(), |x| ln_1p_pair(x, 0.5).0, f64::ln_1p);
            assert!(error < 1e-15, "{range:?}: {error:e}");
            let error =
                worst(range.clone(), |x| f64::from(ln_1p_pair(0.5, x as f32).1), |x| f64::from(x as f32).ln_1p());
            assert!(error < 6e-7, "{range:?}: {error:e}");
        }
    }

    #[test]
    fn exponentials_agree_with_the_platform() {
        for range in [-30.0..-1e-3, -1e-3..-1e-9, 1e-9..1e-3, 1e-3..79.0] {
            let error = worst(range.clone(), Real::exp_m1, f64::exp_m1);
            assert!(error < 2e-15, "{range:?}: {error:e}");
            let error = worst(range.clone(), |x| f64::from(Real::exp_m1(x as f32)), |x| f64::from(x as f32).exp_m1());
            assert!(error < 6e-7, "{range:?}: {error:e}");
            let error = worst(range.clone(), |x| sinh(x.abs()), |x| x.abs().sinh());
            assert!(error < 4e-15, "{range:?}: {error:e}");
        }
        assert_eq!(Real::exp_m1(1e9_f64), Real::exp_m1(80.0_f64));
    }

    #[test]
    fn series_agree_with_the_platform() {
        let cosh_m1 = |x: f64| 2.0 * (0.5 * x).sinh().powi(2);
        for range in [1e-9..1e-3, 1e-3..NEAR.sqrt().atanh()] {
            let error = worst(range.clone(), |x| Real::cosh_m1_and_sinh_ratio(x * x).0, cosh_m1);
            assert!(error < 2e-15, "{range:?}: {error:e}");
            let error = worst(range.clone(), |x| Real::cosh_m1_and_sinh_ratio(x * x).1, |x| x.sinh() / x);
            assert!(error < 2e-15, "{range:?}: {error:e}");
            let error = worst(range.clone(), |x| f64::from(Real::cosh_m1_and_sinh_ratio((x * x) as f32).0), cosh_m1);
            assert!(error < 6e-7, "{range:?}: {error:e}");
            let sinh_ratio = |x| f64::from(Real::cosh_m1_and_sinh_ratio((x * x) as f32).1);
            let error = worst(range.clone(), sinh_ratio, |x| x.sinh() / x);
            assert!(error < 6e-7, "{range:?}: {error:e}");
            let error = worst(range.start..NEAR.sqrt(), |x| Real::atanh_ratio(x * x), |x| x.atanh() / x);
            assert!(error < 2e-15, "{range:?}: {error:e}");
        }
    }

    #[test]
    fn the_nearest_integer_is_the_nearest() {
        for (x, nearest) in
            [(0.0, 0), (0.4, 0), (-0.4, 0), (0.6, 1), (-0.6, -1), (1.49, 1), (-1.51, -2), (1000.2, 1000)]
        {
            assert_eq!(f64::nearest(x), (f64::from(nearest), nearest));
            assert_eq!(f32::nearest(x as f32), (nearest as f32, nearest));
        }
    }
}

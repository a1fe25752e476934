//! Inner loops in a form that compiles to SIMD: elementwise, or reduced over a fixed number of lanes.
//!
//! Nothing here depends on the width of the machine's registers, and no multiplication is fused with an addition, so every
//! instruction set gives the same bits.

/// Partial sums of a dot product.
const LANES: usize = 16;

/// Elements that are searched at once; the row length of every padded array is a multiple of it.
pub(super) const BLOCK: usize = 64;

/// `n` rounded up to a multiple of [`BLOCK`].
pub(super) const fn padded(n: usize) -> usize {
    n.div_ceil(BLOCK) * BLOCK
}

/// An integer that orders as `x` does (-0 just below 0): unlike a maximum of floats one of integers may be taken in any
/// order, so the compiler keeps it in registers.
#[inline(always)]
pub(super) const fn order(x: f64) -> i64 {
    let bits = x.to_bits() as i64;
    bits ^ (((bits >> 63) as u64) >> 1) as i64
}

/// The inverse of [`order`].
#[inline(always)]
pub(super) const fn from_order(key: i64) -> f64 {
    f64::from_bits((key ^ (((key >> 63) as u64) >> 1) as i64) as u64)
}

/// `exp(x)` for `x <= 0`, relative error below 1e-15; 0 below -708.
///
/// The operating system's `exp` neither vectorises nor gives the same bits on every platform. Range reduction after Cody &
/// Waite (1980) to |r| <= ln 2 / 2, where the Taylor polynomial of degree 13 has a remainder below 5e-18.
#[inline(always)]
pub(super) fn exp_of_negative(x: f64) -> f64 {
    /// 1.5 * 2^52: adding it rounds to an integer that is then found in the low bits.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    /// ln 2 in two parts; the first has 21 trailing zero bits, so its products with |k| < 2^20 are exact.
    const LN_2_HIGH: f64 = f64::from_bits(0x3fe6_2e42_fee0_0000);
    const LN_2_LOW: f64 = f64::from_bits(0x3dea_39ef_3579_3c76);
    let clamped = if x > -708.0 { x } else { -708.0 };
    let rounded = clamped * std::f64::consts::LOG2_E + ROUND;
    let k = rounded - ROUND;
    let r = (clamped - k * LN_2_HIGH) - k * LN_2_LOW;
    let tail = 1.0 / 6_227_020_800.0;
    let tail = tail * r + 1.0 / 479_001_600.0;
    let tail = tail * r + 1.0 / 39_916_800.0;
    let tail = tail * r + 1.0 / 3_628_800.0;
    let tail = tail * r + 1.0 / 362_880.0;
    let tail = tail * r + 1.0 / 40_320.0;
    let tail = tail * r + 1.0 / 5_040.0;
    let tail = tail * r + 1.0 / 720.0;
    let tail = tail * r + 1.0 / 120.0;
    let tail = tail * r + 1.0 / 24.0;
    let tail = tail * r + 1.0 / 6.0;
    let tail = tail * r + 0.5;
    let mantissa = (tail * r) * r + r + 1.0;
    // the low bits of `rounded` hold k; adding k to the exponent field multiplies by 2^k, and k >= -1022 keeps it normal
    let value = f64::from_bits(mantissa.to_bits().wrapping_add(rounded.to_bits() << 52));
    if x > -708.0 {
        value
    } else if x.is_nan() {
        x
    } else {
        0.0
    }
}

/// `exp(x)` for `x <= 0` in single precision, relative error below 2e-7; 0 below -87. As [`exp_of_negative`], with the
/// polynomial of degree 7, whose remainder is below 6e-9.
#[inline(always)]
pub(super) fn exp_of_negative_single(x: f32) -> f32 {
    /// 1.5 * 2^23: adding it rounds to an integer that is then found in the low bits.
    const ROUND: f32 = 12_582_912.0;
    /// ln 2 in two parts; the first has 9 trailing zero bits, so its products with |k| < 2^8 are exact.
    const LN_2_HIGH: f32 = 0.693_359_4;
    const LN_2_LOW: f32 = -2.121_944_4e-4;
    let clamped = if x > -87.0 { x } else { -87.0 };
    let rounded = clamped * std::f32::consts::LOG2_E + ROUND;
    let k = rounded - ROUND;
    let r = (clamped - k * LN_2_HIGH) - k * LN_2_LOW;
    let tail = r * (1.0 / 5040.0) + 1.0 / 720.0;
    let tail = tail * r + 1.0 / 120.0;
    let tail = tail * r + 1.0 / 24.0;
    let tail = tail * r + 1.0 / 6.0;
    let tail = tail * r + 0.5;
    let mantissa = (tail * r) * r + r + 1.0;
    // as in double precision; k >= -126 keeps the exponent normal
    let value = f32::from_bits(mantissa.to_bits().wrapping_add(rounded.to_bits() << 23));
    if x > -87.0 { value } else { 0.0 }
}

/// `sum a_k b_k`; lengths must be equal multiples of [`LANES`], what exceeds is left out.
#[inline(always)]
pub(super) fn dot<T: Copy + Into<f64>>(a: &[f64], b: &[T]) -> f64 {
    let mut sum = [0.0; LANES];
    for (a, b) in a.as_chunks::<LANES>().0.iter().zip(b.as_chunks::<LANES>().0) {
        for lane in 0..LANES {
            sum[lane] += a[lane] * b[lane].into();
        }
    }
    let mut width = LANES / 2;
    while width > 0 {
        for lane in 0..width {
            sum[lane] += sum[lane + width];
        }
        width /= 2;
    }
    sum[0]
}

/// `target -= scale * row`, elementwise.
#[inline(always)]
pub(super) fn subtract_scaled(target: &mut [f64], scale: f64, row: &[f32]) {
    for (t, &k) in target.iter_mut().zip(row) {
        *t -= scale * f64::from(k);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp_agrees_with_the_platform_over_the_whole_range() {
        let mut worst = 0.0_f64;
        for step in 0..2_000_000_u32 {
            let x = -f64::from(step) * 3.53e-4;
            worst = worst.max((exp_of_negative(x) / x.exp() - 1.0).abs());
        }
        assert!(worst < 1e-15, "relative error {worst:e}");
        assert_eq!(exp_of_negative(0.0), 1.0);
        assert_eq!(exp_of_negative(-1e300), 0.0);
        assert_eq!(exp_of_negative(f64::NEG_INFINITY), 0.0);
        assert!(exp_of_negative(f64::NAN).is_nan());
    }

    #[test]
    fn single_exp_agrees_with_the_platform_over_the_whole_range() {
        let mut worst = 0.0_f64;
        for step in 0..2_000_000_u32 {
            let x = -(step as f32) * 4.349e-5;
            worst = worst.max((f64::from(exp_of_negative_single(x)) / f64::from(x).exp() - 1.0).abs());
        }
        assert!(worst < 2e-7, "relative error {worst:e}");
        assert_eq!(exp_of_negative_single(0.0), 1.0);
        assert_eq!(exp_of_negative_single(-1e30), 0.0);
        assert_eq!(exp_of_negative_single(f32::NEG_INFINITY), 0.0);
    }

    #[test]
    fn order_keeps_order() {
        let values =
            [f64::NEG_INFINITY, -1e300, -2.0, -1.0, -1e-300, -0.0, 0.0, 1e-300, 1.0, 2.0, 1e300, f64::INFINITY];
        assert!(values.windows(2).all(|w| order(w[0]) < order(w[1])));
        assert!(values.iter().all(|&v| from_order(order(v)).to_bits() == v.to_bits()));
    }

    #[test]
    fn dot_sums_every_lane_once() {
        let a: Vec<f64> = (0..64).map(f64::from).collect();
        let b = vec![1.0_f32; 64];
        assert_eq!(dot(&a, &b), 63.0 * 64.0 / 2.0);
    }
}

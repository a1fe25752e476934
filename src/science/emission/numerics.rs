//! Root finding, one-dimensional maximisation and small summaries.

/// 97.5 % quantile of the standard normal distribution.
pub(super) const Z95: f64 = 1.959_963_984_540_054;

/// A root of `f` between `low` and `high`, where its signs differ, to machine precision (Brent 1973, ch. 4).
///
/// `None` where the signs do not differ or a value is NaN.
pub(super) fn root(f: impl Fn(f64) -> f64, low: f64, high: f64) -> Option<f64> {
    let (mut a, mut b) = (low, high);
    let (mut fa, mut fb) = (f(a), f(b));
    if fa.is_nan() || fb.is_nan() || fa * fb > 0.0 {
        return None;
    }
    let (mut c, mut fc) = (a, fa);
    let (mut step, mut before) = (b - a, b - a);
    for _ in 0..200 {
        if fb.signum() == fc.signum() {
            (c, fc) = (a, fa);
            step = b - a;
            before = step;
        }
        if fc.abs() < fb.abs() {
            (a, b, c) = (b, c, b);
            (fa, fb, fc) = (fb, fc, fb);
        }
        let tolerance = 2.0 * f64::EPSILON * b.abs();
        let half = 0.5 * (c - b);
        if half.abs() <= tolerance || fb == 0.0 {
            return Some(b);
        }
        if before.abs() >= tolerance && fa.abs() > fb.abs() {
            let s = fb / fa;
            let (mut p, mut q) = if a == c {
                (2.0 * half * s, 1.0 - s)
            } else {
                let (q, r) = (fa / fc, fb / fc);
                (s * (2.0 * half * q * (q - r) - (b - a) * (r - 1.0)), (q - 1.0) * (r - 1.0) * (s - 1.0))
            };
            if p > 0.0 {
                q = -q
            } else {
                p = -p
            }
            if 2.0 * p < (3.0 * half * q - (tolerance * q).abs()).min((before * q).abs()) {
                before = step;
                step = p / q;
            } else {
                step = half;
                before = half;
            }
        } else {
            step = half;
            before = half;
        }
        (a, fa) = (b, fb);
        b += if step.abs() > tolerance { step } else { tolerance.copysign(half) };
        fb = f(b);
        if fb.is_nan() {
            return None;
        }
    }
    Some(b)
}

/// The abscissa and value of the maximum of a unimodal `f` on `low..=high` by golden sections and parabolas (Brent 1973,
/// ch. 5), to a relative precision of about 1e-9 of the abscissa.
pub(super) fn maximum(f: impl Fn(f64) -> f64, low: f64, high: f64) -> (f64, f64) {
    const GOLDEN: f64 = 0.381_966_011_250_105;
    let (mut a, mut b) = (low, high);
    let mut x = a + GOLDEN * (b - a);
    let (mut w, mut v) = (x, x);
    let mut fx = f(x);
    let (mut fw, mut fv) = (fx, fx);
    let (mut step, mut before) = (0.0_f64, 0.0_f64);
    for _ in 0..200 {
        let middle = 0.5 * (a + b);
        let tolerance = 1e-9 * x.abs() + 1e-12;
        if (x - middle).abs() <= 2.0 * tolerance - 0.5 * (b - a) {
            break;
        }
        let mut golden = true;
        if before.abs() > tolerance {
            let r = (x - w) * (fx - fv);
            let q = (x - v) * (fx - fw);
            let p = (x - v) * q - (x - w) * r;
            let q2 = 2.0 * (q - r);
            let (p, q2) = if q2 > 0.0 { (-p, q2) } else { (p, -q2) };
            if p.abs() < (0.5 * q2 * before).abs() && p > q2 * (a - x) && p < q2 * (b - x) {
                before = step;
                step = p / q2;
                let at = x + step;
                if at - a < 2.0 * tolerance || b - at < 2.0 * tolerance {
                    step = tolerance.copysign(middle - x);
                }
                golden = false;
            }
        }
        if golden {
            before = if x < middle { b - x } else { a - x };
            step = GOLDEN * before;
        }
        let at = if step.abs() >= tolerance { x + step } else { x + tolerance.copysign(step) };
        let value = f(at);
        if value >= fx {
            if at < x {
                b = x
            } else {
                a = x
            }
            (v, fv) = (w, fw);
            (w, fw) = (x, fx);
            (x, fx) = (at, value);
        } else {
            if at < x {
                a = at
            } else {
                b = at
            }
            if value >= fw || w == x {
                (v, fv) = (w, fw);
                (w, fw) = (at, value);
            } else if value >= fv || v == x || v == w {
                (v, fv) = (at, value);
            }
        }
    }
    (x, fx)
}

/// Standard errors of two parameters from the curvature of a log likelihood at its maximum `at`, by central differences.
///
/// `None` where the surface is not curved downwards.
pub(super) fn errors_from_curvature(f: impl Fn([f64; 2]) -> f64, at: [f64; 2]) -> Option<[f64; 2]> {
    let h = at.map(|x| 1e-4 * x.abs().max(1e-8));
    let value = |i: f64, j: f64| f([at[0] + i * h[0], at[1] + j * h[1]]);
    let centre = value(0.0, 0.0);
    let aa = (value(1.0, 0.0) - 2.0 * centre + value(-1.0, 0.0)) / (h[0] * h[0]);
    let bb = (value(0.0, 1.0) - 2.0 * centre + value(0.0, -1.0)) / (h[1] * h[1]);
    let ab = (value(1.0, 1.0) - value(1.0, -1.0) - value(-1.0, 1.0) + value(-1.0, -1.0)) / (4.0 * h[0] * h[1]);
    let determinant = aa * bb - ab * ab;
    (aa < 0.0 && determinant > 0.0).then(|| [(-bb / determinant).sqrt(), (-aa / determinant).sqrt()])
}

/// Arithmetic mean; NaN without values.
pub(super) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Standard deviation with n - 1; NaN for fewer than two values.
pub(super) fn standard_deviation(values: &[f64]) -> f64 {
    let centre = mean(values);
    let squares: f64 = values.iter().map(|v| (v - centre) * (v - centre)).sum();
    (squares / (values.len() as f64 - 1.0)).sqrt()
}

/// Quantile of `sorted` (rising, not empty) with linear interpolation (Hyndman & Fan 1996, type 7); NaN without values.
pub(super) fn quantile(sorted: &[f64], q: f64) -> f64 {
    if sorted.is_empty() {
        return f64::NAN;
    }
    let position = q.clamp(0.0, 1.0) * (sorted.len() - 1) as f64;
    let below = position.floor() as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (position - below as f64) * (sorted[above] - sorted[below])
}

/// `count` points from `low` to `high` in equal ratios.
pub(super) fn log_spaced(low: f64, high: f64, count: usize) -> Vec<f64> {
    let last = count.saturating_sub(1).max(1) as f64;
    let (from, to) = (low.ln(), high.ln());
    (0..count).map(|k| (from + (to - from) * k as f64 / last).exp()).collect()
}

/// Slope, intercept and standard error of the slope of a least-squares line with `weights`; `None` without a spread of `x`.
pub(super) fn line(x: &[f64], y: &[f64], weights: &[f64]) -> Option<Line> {
    let total: f64 = weights.iter().sum();
    let mean = |values: &[f64]| values.iter().zip(weights).map(|(v, w)| v * w).sum::<f64>() / total;
    let (mx, my) = (mean(x), mean(y));
    let points = || x.iter().zip(y).zip(weights);
    let sxx: f64 = points().map(|((x, _), w)| w * (x - mx) * (x - mx)).sum();
    let sxy: f64 = points().map(|((x, y), w)| w * (x - mx) * (y - my)).sum();
    if !(sxx > 0.0 && x.len() > 2) {
        return None;
    }
    let slope = sxy / sxx;
    let intercept = my - slope * mx;
    let residual: f64 = points().map(|((x, y), w)| w * (y - intercept - slope * x).powi(2)).sum();
    let slope_se = (residual / (x.len() as f64 - 2.0) / sxx).sqrt();
    Some(Line { slope, intercept, slope_se })
}

/// What [`line`] finds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Line {
    pub(super) slope: f64,
    pub(super) intercept: f64,
    pub(super) slope_se: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emission::close;

    #[test]
    fn roots_and_maxima_of_known_functions() {
        close(root(|x| x * x - 2.0, 0.0, 2.0).unwrap(), 2.0_f64.sqrt(), 1e-15);
        close(root(|x| x.exp() - 1e-8, -100.0, 3.0).unwrap(), 1e-8_f64.ln(), 1e-13);
        assert_eq!(root(|x| x * x + 1.0, -1.0, 1.0), None);
        let (at, value) = maximum(|x| -(x - 0.3).powi(2) - (x - 0.3).powi(4), -5.0, 9.0);
        close(at, 0.3, 1e-7);
        close(value, 0.0, 1e-14);
    }

    #[test]
    fn curvature_of_a_quadratic_gives_its_errors() {
        // covariance [[4, 1], [1, 2]] has the inverse [[2, -1], [-1, 4]] / 7
        let f = |[x, y]: [f64; 2]| {
            let (x, y) = (x - 3.0, y + 2.0);
            -0.5 * (2.0 * x * x - 2.0 * x * y + 4.0 * y * y) / 7.0
        };
        let errors = errors_from_curvature(f, [3.0, -2.0]).unwrap();
        close(errors[0], 2.0, 1e-5);
        close(errors[1], 2.0_f64.sqrt(), 1e-5);
        assert_eq!(errors_from_curvature(|[x, y]| x * x - y, [1.0, 1.0]), None);
    }

    #[test]
    fn a_line_through_points_with_its_error() {
        // SciPy 1.17.1, linregress([1, 2, 3, 4], [2.1, 3.9, 6.2, 7.8]): slope 1.94, intercept 0.15, stderr 0.09055385138137414
        let fitted = line(&[1.0, 2.0, 3.0, 4.0], &[2.1, 3.9, 6.2, 7.8], &[1.0; 4]).unwrap();
        close(fitted.slope, 1.94, 1e-12);
        close(fitted.intercept, 0.15, 1e-12);
        close(fitted.slope_se, 0.09055385138137414, 1e-12);
    }
}

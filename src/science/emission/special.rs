//! Special functions that the estimators need beyond those of `libm`.

/// Relative size at which a series or continued fraction is cut.
const EPSILON: f64 = 1e-17;

/// Upper incomplete gamma function `integral of t^(s-1) exp(-t), t from x to infinity`, for `x > 0` and every real `s`.
///
/// From x = 1.5 on Legendre's continued fraction (DLMF 8.9.2), which holds for every s. Below, for |s| <= 1/2, the series
/// DLMF 8.7.3 in a form without the pole at s = 0 (Gautschi 1979, ACM Trans. Math. Softw. 5, 466-481), and from there the
/// recurrence DLMF 8.8.2 in s, downwards or upwards: near the poles of Gamma(s) at 0, -1, -2, ... nothing cancels.
/// Relative error below 1e-13; NaN where x is not above 0.
#[must_use]
pub fn upper_gamma(s: f64, x: f64) -> f64 {
    if x.is_nan() || x <= 0.0 || !s.is_finite() {
        return f64::NAN;
    }
    // upwards the recurrence adds positive terms only, so far from s = 0 it is safe; the fraction needs x above s
    if x >= 1.5 && x >= s - 1.0 {
        return (s * x.ln() - x).exp() * legendre_fraction(s, x);
    }
    let steps = s.round();
    let base = s - steps;
    let mut gamma = if x >= 1.5 { (base * x.ln() - x).exp() * legendre_fraction(base, x) } else { near_zero(base, x) };
    let mut order = base;
    while order > s + 0.5 {
        order -= 1.0;
        gamma = (gamma - (order * x.ln() - x).exp()) / order;
    }
    while order < s - 0.5 {
        gamma = order * gamma + (order * x.ln() - x).exp();
        order += 1.0;
    }
    gamma
}

/// `Gamma(s, x) exp(x) x^-s` by the modified Lentz algorithm.
fn legendre_fraction(s: f64, x: f64) -> f64 {
    let mut b = x + 1.0 - s;
    let mut c = 1e300;
    let mut d = 1.0 / b;
    let mut value = d;
    for i in 1..2000 {
        let i = f64::from(i);
        let a = -i * (i - s);
        b += 2.0;
        d = 1.0 / (a * d + b);
        c = b + a / c;
        let factor = c * d;
        value *= factor;
        if (factor - 1.0).abs() < 1e-16 {
            break;
        }
    }
    value
}

/// `Gamma(s, x)` for |s| <= 1/2 and small x: `(Gamma(1+s) - 1)/s - (x^s - 1)/s - x^s sum (-x)^k / (k! (s + k))`.
fn near_zero(s: f64, x: f64) -> f64 {
    let log_x = x.ln();
    let (gamma_part, power_part) =
        if s.abs() < 1e-150 { (-EULER, log_x) } else { (ln_gamma_1p(s).exp_m1() / s, (s * log_x).exp_m1() / s) };
    let (mut term, mut sum) = (1.0, 0.0_f64);
    for k in 1..200 {
        let k = f64::from(k);
        term *= -x / k;
        let add = term / (s + k);
        sum += add;
        if add.abs() < EPSILON * sum.abs() {
            break;
        }
    }
    gamma_part - power_part - (s * log_x).exp() * sum
}

/// Euler's constant.
const EULER: f64 = 0.577_215_664_901_532_9;

/// `ln Gamma(1 + s)` for |s| <= 1/2, with a relative error also near s = 0 (Abramowitz & Stegun 6.1.33).
fn ln_gamma_1p(s: f64) -> f64 {
    let mut power = s * s;
    let mut sum = 0.0;
    for (k, zeta_minus_1) in (2..).zip(ZETA_MINUS_1) {
        sum += if k % 2 == 0 { zeta_minus_1 * power / f64::from(k) } else { -zeta_minus_1 * power / f64::from(k) };
        power *= s;
    }
    -s.ln_1p() + s * (1.0 - EULER) + sum
}

/// `zeta(k) - 1` for k = 2 to 26 (Abramowitz & Stegun, table 23.3).
const ZETA_MINUS_1: [f64; 25] = [
    0.6449340668482264,
    0.2020569031595943,
    0.08232323371113819,
    0.03692775514336993,
    0.01734306198444914,
    0.008349277381922827,
    0.00407735619794434,
    0.0020083928260822143,
    0.0009945751278180853,
    0.0004941886041194645,
    0.0002460865533080483,
    0.00012271334757848915,
    6.124813505870483e-05,
    3.058823630702049e-05,
    1.528225940865187e-05,
    7.637197637899763e-06,
    3.81729326499984e-06,
    1.908212716553939e-06,
    9.539620338727962e-07,
    4.769329867878064e-07,
    2.38450502727733e-07,
    1.1921992596531106e-07,
    5.960818905125948e-08,
    2.980350351465228e-08,
    1.4901554828365043e-08,
];

/// Probability that a chi-square variable with `degrees` of freedom exceeds `x`.
#[must_use]
pub fn chi_square_survival(x: f64, degrees: f64) -> f64 {
    if x <= 0.0 { 1.0 } else { (upper_gamma(degrees / 2.0, x / 2.0) / libm::tgamma(degrees / 2.0)).min(1.0) }
}

/// Two-sided probability of a standard normal deviate as large as `z`.
#[must_use]
pub fn normal_two_sided(z: f64) -> f64 {
    libm::erfc(z.abs() / std::f64::consts::SQRT_2)
}

/// Standard normal distribution function.
#[must_use]
pub fn normal_cdf(z: f64) -> f64 {
    0.5 * libm::erfc(-z / std::f64::consts::SQRT_2)
}

/// The Hurwitz zeta function `sum (k + a)^-s, k = 0, 1, ...` and its first two derivatives in s, for s > 1 and a > 0.
///
/// Euler-Maclaurin summation (DLMF 25.11.7): 16 terms, the integral, and ten Bernoulli terms; relative error of the function
/// below 1e-14.
#[must_use]
pub fn hurwitz_zeta(s: f64, a: f64) -> [f64; 3] {
    /// Bernoulli numbers B_2, B_4, ... over (2j)!.
    const BERNOULLI: [f64; 10] = [
        0.08333333333333333,
        -0.001388888888888889,
        3.306878306878307e-05,
        -8.267195767195768e-07,
        2.08767569878681e-08,
        -5.284190138687493e-10,
        1.3382536530684679e-11,
        -3.3896802963225827e-13,
        8.586062056277845e-15,
        -2.174868698558062e-16,
    ];
    const TERMS: u32 = 16;
    let mut sum = [0.0; 3];
    let mut add = |weight: f64, log: f64, slope: f64, curve: f64| {
        // weight e^(-s log) p(s), with p'/p = slope and (p'/p)' = curve
        let d = slope - log;
        sum[0] += weight;
        sum[1] += weight * d;
        sum[2] += weight * (d * d + curve);
    };
    for k in 0..TERMS {
        let log = (a + f64::from(k)).ln();
        add((-s * log).exp(), log, 0.0, 0.0);
    }
    let n = a + f64::from(TERMS);
    let log = n.ln();
    let power = (-s * log).exp();
    let pole = 1.0 / (s - 1.0);
    add(power * n * pole, log, -pole, pole * pole);
    add(power / 2.0, log, 0.0, 0.0);
    // the j-th Bernoulli term has the rising factorial s (s+1) ... (s + 2j - 2), whose logarithmic derivatives are sums
    let (mut rising, mut slope, mut curve) = (s / n, 1.0 / s, -1.0 / (s * s));
    for (j, bernoulli) in BERNOULLI.into_iter().enumerate() {
        add(bernoulli * power * rising, log, slope, curve);
        for step in [2 * j + 1, 2 * j + 2] {
            let factor = s + step as f64;
            rising *= factor / n;
            slope += 1.0 / factor;
            curve -= 1.0 / (factor * factor);
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emission::close;

    #[test]
    fn upper_gamma_agrees_with_mpmath_also_at_its_poles() {
        // mpmath 1.4.1, gammainc(s, x) with 30 digits
        let table = [
            (-0.35, 0.03, 5.94853279808801),
            (-1.0, 0.03, 29.38906572759566),
            (-0.999999999, 0.03, 29.389065648847165),
            (-2.0, 0.0001, 49990005.066579015),
            (-2.0000001, 0.0001, 49990048.610091517),
            (0.0, 0.5, 0.5597735947761608),
            (1e-12, 0.5, 0.5597735947761311),
            (-0.5, 3.0, 0.006776136001770212),
            (-4.7, 2.0, 0.0007424320714465116),
            (-4.7, 0.9, 0.11542790864775873),
            (2.5, 0.3, 1.3133926142981467),
            (2.5, 7.0, 0.020750227257978492),
            (-1.5, 1e-08, 666666646669.0298),
            (-3.0, 40.0, 1.5116496741077837e-24),
            (0.5, 1.2, 0.2150611317484766),
            (-0.999999, 1.4, 0.05992141351230563),
            (-6.2, 0.001, 6.413432226196484e+17),
        ];
        for (s, x, truth) in table {
            close(upper_gamma(s, x) / truth, 1.0, 1e-13);
        }
        assert!(upper_gamma(1.0, 0.0).is_nan());
    }

    #[test]
    fn upper_gamma_obeys_its_recurrence_where_the_methods_meet() {
        for s in [-2.5, -1.0, -0.5, 0.0, 0.49, 0.51, 1.0, 3.3] {
            for x in [0.2, 1.4999, 1.5, 2.4, 5.0] {
                close(upper_gamma(s + 1.0, x), s * upper_gamma(s, x) + f64::powf(x, s) * (-x).exp(), 1e-13);
            }
        }
    }

    #[test]
    fn hurwitz_zeta_and_its_derivatives_agree_with_mpmath() {
        // mpmath 1.4.1, zeta(s, a) and its numerical derivatives in s with 30 digits
        let table = [
            (1.5, 1.0, 2.612375348685488, -3.9322397374311015, 15.989556371225687),
            (2.0, 1.0, 1.6449340668482264, -0.9375482543158438, 1.989280234298901),
            (2.5, 3.0, 0.1647105619542803, -0.2648096823926416, 0.49703603099629945),
            (1.05, 1.0, 20.580844302036985, -399.92767119173028, 15999.990209835168),
            (3.2, 10.0, 0.00320023152496512, -0.008667223137855753, 0.02413183354820775),
            (8.0, 1.0, 1.0040773561979443, -0.002901952553710673, 0.002099736799781418),
        ];
        for (s, a, value, first, second) in table {
            let zeta = hurwitz_zeta(s, a);
            close(zeta[0] / value, 1.0, 1e-14);
            close(zeta[1] / first, 1.0, 1e-12);
            close(zeta[2] / second, 1.0, 1e-12);
        }
    }

    #[test]
    fn probabilities_agree_with_scipy() {
        // SciPy 1.17.1: chi2.sf and 2 * norm.sf
        let table = [
            (3.84, 1.0, 0.05004352124870519),
            (0.5, 3.0, 0.9188914116546758),
            (12.0, 7.0, 0.10055886850835878),
            (60.0, 4.0, 2.9008631203404573e-12),
        ];
        for (x, degrees, truth) in table {
            close(chi_square_survival(x, degrees) / truth, 1.0, 1e-12);
        }
        close(normal_two_sided(1.96) / 0.04999579029644087, 1.0, 1e-12);
        close(normal_cdf(0.0), 0.5, 1e-16);
    }
}

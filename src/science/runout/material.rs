//! Snow as an elastoplastic solid: Hencky elasticity and cohesive Cam clay (Gaume et al. 2018, Nature Communications 9,
//! 3047, Methods; Li et al. 2020, The Cryosphere 14, section 2).
//!
//! In two dimensions: Kirchhoff stress `tau = 2 mu eps + lambda tr(eps) I`, pressure `p = -tr(tau) / 2 = -K tr(eps)` with
//! `K = lambda + mu`, and `q = c |dev tau|` with `c = sqrt(3/2)`. With `d` half the difference of the principal strains,
//! `|dev tau| = 2 sqrt(2) mu d`. Strains are those of the elastic left Cauchy-Green tensor `b`, kept as `b - I`.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{
    lanes::{Real, max, min, sinh},
    particles::{GROUP, GROUPS},
};

/// How a stress outside the yield surface comes back to it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum FlowRule {
    /// To the closest point in the energy norm, at the hardening of the step's start.
    #[default]
    Associative,
    /// The same, at the hardening of the step's end; for a cohesion of at most 1.
    AssociativeImplicit,
    /// The three cases of Wolper et al. (2019, ACM Trans. Graph. 38, 119): to the ends of the surface where the pressure is
    /// beyond them, else at the same pressure, with the hardening that they give.
    Nacc,
}

/// The factor `c` of `q = c |dev tau|`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ShearNorm {
    /// `sqrt(3/2)`, that of von Mises.
    #[default]
    VonMises,
    /// `sqrt(2)`, so that `q` is the difference of the principal stresses in the plane.
    Plane,
}

impl ShearNorm {
    fn factor(self) -> f64 {
        match self {
            Self::VonMises => 1.5_f64.sqrt(),
            Self::Plane => std::f64::consts::SQRT_2,
        }
    }
}

/// The snow of a release.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Snow {
    /// Slope `M` of the critical state line, dimensionless, above 0: internal friction.
    pub friction: f64,
    /// Cohesion `beta`, tensile over compressive strength, dimensionless, at least 0.
    pub cohesion: f64,
    /// Hardening factor `xi`, dimensionless, above 0.
    pub hardening: f64,
    /// Compressive strength `p0` at release, Pa, above 0.
    pub strength_pa: f64,
    /// Density at release, kg/m3.
    pub density_kg_m3: f64,
    /// Young's modulus, Pa.
    pub youngs_modulus_pa: f64,
    /// Poisson's ratio, dimensionless, at least 0 and below 0.5.
    pub poisson_ratio: f64,
}

/// A parameter outside of what the model means.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[error("{name} = {value}: {accepted} is accepted")]
pub struct ParameterError {
    /// Which one, as the field of [`Snow`] or of the setup is called.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// What is accepted.
    pub accepted: &'static str,
}

/// `Err` unless `value` is finite and `within` holds.
pub(super) fn check(
    name: &'static str,
    value: f64,
    within: bool,
    accepted: &'static str,
) -> Result<(), ParameterError> {
    if value.is_finite() && within { Ok(()) } else { Err(ParameterError { name, value, accepted }) }
}

impl Snow {
    /// Density, Young's modulus and Poisson's ratio of Li et al. (2020), Table 1: 250 kg/m3, 3 MPa, 0.3.
    #[must_use]
    pub fn li_2020(friction: f64, cohesion: f64, hardening: f64, strength_pa: f64) -> Self {
        Self {
            friction,
            cohesion,
            hardening,
            strength_pa,
            density_kg_m3: 250.0,
            youngs_modulus_pa: 3e6,
            poisson_ratio: 0.3,
        }
    }

    /// Lame's first parameter and the shear modulus, Pa.
    #[must_use]
    pub fn lame_pa(&self) -> (f64, f64) {
        let (e, nu) = (self.youngs_modulus_pa, self.poisson_ratio);
        (e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), e / (2.0 * (1.0 + nu)))
    }

    /// Bulk modulus in two dimensions, `lambda + mu`, Pa.
    #[must_use]
    pub fn bulk_modulus_pa(&self) -> f64 {
        let (lambda, mu) = self.lame_pa();
        lambda + mu
    }

    /// Speed of pressure waves, `sqrt((lambda + 2 mu) / rho)`, m/s.
    #[must_use]
    pub fn wave_speed_m_s(&self) -> f64 {
        let (lambda, mu) = self.lame_pa();
        ((lambda + 2.0 * mu) / self.density_kg_m3).sqrt()
    }

    /// Volumetric plastic strain at release, `-asinh(p0 / K) / xi`, dimensionless (Gaume et al. 2018).
    #[must_use]
    pub fn plastic_strain_at_release(&self) -> f64 {
        -(self.strength_pa / self.bulk_modulus_pa()).asinh() / self.hardening
    }

    /// Checks every parameter.
    ///
    /// # Errors
    /// The first one that is outside of the model.
    pub fn validate(&self) -> Result<(), ParameterError> {
        let Self { friction, cohesion, hardening, strength_pa, .. } = *self;
        check("friction", friction, friction > 0.0 && friction <= 10.0, "above 0 and at most 10")?;
        check("cohesion", cohesion, (0.0..=10.0).contains(&cohesion), "from 0 to 10")?;
        check("hardening", hardening, (1e-3..=1e3).contains(&hardening), "from 0.001 to 1000")?;
        let modulus = self.youngs_modulus_pa;
        check("youngs_modulus_pa", modulus, (1e3..=1e11).contains(&modulus), "from 1e3 to 1e11")?;
        check(
            "poisson_ratio",
            self.poisson_ratio,
            (0.0..0.5).contains(&self.poisson_ratio),
            "at least 0 and below 0.5",
        )?;
        check("density_kg_m3", self.density_kg_m3, (1.0..=1000.0).contains(&self.density_kg_m3), "from 1 to 1000")?;
        check(
            "strength_pa",
            strength_pa,
            strength_pa > 0.0 && strength_pa <= modulus,
            "above 0 and at most Young's modulus",
        )
    }
}

/// The snow in the units of the dynamics: stress times `4 dt^2 / (rho dx^2)`, so that `C dt - tau` is what a particle
/// scatters.
#[derive(Clone, Copy, Debug)]
pub(super) struct Material<T> {
    /// `2 mu`.
    pub(super) shear_2: T,
    /// `K`.
    pub(super) bulk: T,
    pub(super) bulk_inverse: T,
    /// `xi`.
    pub(super) hardening: T,
    /// Below this compressive strength a particle carries no stress.
    pub(super) weakest: T,
    /// Half-axis and centre of the yield surface along p, over p0: `(1 + beta) / 2`, `(1 - beta) / 2`.
    pub(super) half_axis: T,
    pub(super) centre: T,
    /// `q / M * sqrt(1 + 2 beta)` of a unit of `d`: the half-axis along q over that along p taken out. And its square.
    pub(super) shear_of_strain: T,
    pub(super) shear_of_strain_2: T,
    /// `A / B` of the secular equation of the return, and its inverse.
    pub(super) ratio: T,
    pub(super) ratio_inverse: T,
    pub(super) rule: FlowRule,
}

/// Trial stresses outside of the yield surface, as elastic strains with the strength that they meet.
#[derive(Clone, Copy, Debug)]
pub(super) struct Trial<T> {
    pub(super) volumetric: [T; GROUP],
    /// Half the difference of the principal strains.
    pub(super) deviatoric: [T; GROUP],
    pub(super) strength: [T; GROUP],
    /// Volumetric plastic strain.
    pub(super) plastic_strain: [T; GROUP],
}

/// Their plastic returns.
#[derive(Clone, Copy, Debug)]
pub(super) struct Returned<T> {
    /// Elastic volumetric strain after the return.
    pub(super) volumetric: [T; GROUP],
    /// What remains of the deviatoric strain, from 0 to 1.
    pub(super) shear: [T; GROUP],
    /// By how much the volumetric plastic strain grows.
    pub(super) plastic: [T; GROUP],
}

/// The equation of the closest point, `P / (1 + t)^2 + Q / (1 + k t)^2 = 1`, scaled so that `P` and `Q` are at most 1 and
/// their sum is at least 1: its root is small and not negative.
#[derive(Clone, Copy, Debug)]
struct Secular<T> {
    /// `p` over its scale; `P` is its square.
    p: [T; GROUP],
    q_2: [T; GROUP],
    k: [T; GROUP],
    /// The half-axis of the yield surface along p over the scales of `p` and `q`.
    shrink_p: [T; GROUP],
    shrink_q: [T; GROUP],
    t: [T; GROUP],
}

/// Room for the returns of a block.
#[derive(Clone, Copy, Debug)]
pub(super) struct Returns<T> {
    pub(super) trials: [Trial<T>; GROUPS],
    secular: [Secular<T>; GROUPS],
    pub(super) returned: [Returned<T>; GROUPS],
}

impl<T: Real> Returns<T> {
    pub(super) fn new() -> Self {
        let zero = [T::of(0.0); GROUP];
        Self {
            trials: [Trial { volumetric: zero, deviatoric: zero, strength: zero, plastic_strain: zero }; GROUPS],
            secular: [Secular { p: zero, q_2: zero, k: zero, shrink_p: zero, shrink_q: zero, t: zero }; GROUPS],
            returned: [Returned { volumetric: zero, shear: zero, plastic: zero }; GROUPS],
        }
    }
}

impl<T: Real> Material<T> {
    /// `scale` is `4 dt^2 / (rho dx^2)`, 1/Pa.
    pub(super) fn new(snow: &Snow, rule: FlowRule, norm: ShearNorm, scale: f64) -> Self {
        let (_, mu) = snow.lame_pa();
        let bulk = snow.bulk_modulus_pa();
        let (m, beta, c) = (snow.friction, snow.cohesion, norm.factor());
        let widening = 1.0 + 2.0 * beta;
        let ratio = 2.0 * mu * c * c * widening / (bulk * m * m);
        let shear_of_strain = c * 2.0 * std::f64::consts::SQRT_2 * mu * scale * widening.sqrt() / m;
        Self {
            shear_2: T::of(2.0 * mu * scale),
            bulk: T::of(bulk * scale),
            bulk_inverse: T::of(1.0 / (bulk * scale)),
            hardening: T::of(snow.hardening),
            weakest: T::of(1e-9 * bulk * scale),
            half_axis: T::of(0.5 * (1.0 + beta)),
            centre: T::of(0.5 * (1.0 - beta)),
            shear_of_strain: T::of(shear_of_strain),
            shear_of_strain_2: T::of(shear_of_strain * shear_of_strain),
            ratio: T::of(ratio),
            ratio_inverse: T::of(1.0 / ratio),
            rule,
        }
    }

    /// Compressive strength `p0 = K sinh(xi max(-eps_v^p, 0))` at a volumetric plastic strain.
    #[inline(always)]
    pub(super) fn strength(&self, plastic_strain: T) -> T {
        self.bulk * sinh(self.hardening * max(-plastic_strain, T::of(0.0)))
    }

    /// `(p - p_c)^2 + (q sqrt(1 + 2 beta) / M)^2 - r^2` of elastic strains, the square of the deviatoric one: above 0 outside
    /// of the yield surface.
    #[inline(always)]
    pub(super) fn yielding(&self, volumetric: T, deviatoric_2: T, strength: T) -> T {
        let p = self.bulk.mul_add(volumetric, self.centre * strength);
        let r = self.half_axis * strength;
        p.mul_add(p, self.shear_of_strain_2.mul_add(deviatoric_2, -(r * r)))
    }

    /// The returns of the first `count` groups of trial stresses.
    #[inline(always)]
    pub(super) fn back(&self, returns: &mut Returns<T>, count: usize) {
        let count = count.min(GROUPS);
        let Returns { trials, returned, .. } = returns;
        match self.rule {
            FlowRule::Associative => self.closest(returns, count),
            FlowRule::AssociativeImplicit => {
                for group in 0..count {
                    self.implicit(&trials[group], &mut returned[group]);
                }
            }
            FlowRule::Nacc => {
                for group in 0..count {
                    self.nacc(&trials[group], &mut returned[group]);
                }
            }
        }
    }

    /// Stress-free where there is no strength, else the closest point; for stresses outside of the yield surface.
    ///
    /// With `x = B D` of `X / (1 + A D)^2 + Y / (1 + B D)^2 = f`, a lower bound of the root is where either term alone is 1;
    /// from there on `1 - 1 / sqrt f = 0`, which is nearly linear, is solved by Halley's method. All groups take each step
    /// before the next one: the processor has them in work together.
    #[inline(always)]
    fn closest(&self, returns: &mut Returns<T>, count: usize) {
        let Returns { trials, secular, returned } = returns;
        for group in 0..count {
            self.scale(&trials[group], &mut secular[group]);
        }
        for _ in 0..T::RETURN_STEPS {
            for secular in &mut secular[..count] {
                secular.halley();
            }
        }
        for group in 0..count {
            self.descend(&trials[group], &secular[group], &mut returned[group]);
        }
    }

    /// The secular equation of trial stresses.
    #[inline(always)]
    fn scale(&self, trial: &Trial<T>, secular: &mut Secular<T>) {
        for k in 0..GROUP {
            let strength = max(trial.strength[k], self.weakest);
            let half_axis = self.half_axis * strength;
            let p = -self.bulk.mul_add(trial.volumetric[k], self.centre * strength);
            let q = self.shear_of_strain * trial.deviatoric[k];
            // both terms at the lower bound of the root
            let along = max(max(p, -p), (q - half_axis).mul_add(self.ratio_inverse, half_axis));
            let along = max(along, half_axis);
            let across = (along - half_axis).mul_add(self.ratio, half_axis);
            let inverse = T::of(1.0) / (along * across);
            let (of_along, of_across) = (inverse * across, inverse * along);
            let q = q * of_across;
            secular.p[k] = p * of_along;
            secular.q_2[k] = q * q;
            secular.k[k] = self.ratio * (along * of_across);
            secular.shrink_p[k] = half_axis * of_along;
            secular.shrink_q[k] = half_axis * of_across;
            secular.t[k] = T::of(0.0);
        }
    }

    /// What the returned strains are at the root.
    #[inline(always)]
    fn descend(&self, trial: &Trial<T>, secular: &Secular<T>, out: &mut Returned<T>) {
        let (zero, one) = (T::of(0.0), T::of(1.0));
        for k in 0..GROUP {
            let (a, b) = (one + secular.t[k], secular.k[k].mul_add(secular.t[k], one));
            let p = secular.p[k] * b;
            // the last error of the root is taken out along the radius: the result lies on the surface
            let onto = one / (p * p + secular.q_2[k] * (a * a)).sqrt();
            let strength = trial.strength[k];
            let strong = strength > self.weakest;
            let elastic = -((self.half_axis * strength).mul_add(p * onto, self.centre * strength) * self.bulk_inverse);
            out.volumetric[k] = if strong { elastic } else { zero };
            out.shear[k] = if strong { min(a * onto * secular.shrink_q[k], one) } else { zero };
            // not a difference of strains, whose sign rounding might turn: the stress comes nearer to the centre
            let nearer = max(one - b * onto * secular.shrink_p[k], zero);
            let plastic = nearer * self.bulk.mul_add(trial.volumetric[k], self.centre * strength) * self.bulk_inverse;
            out.plastic[k] = if strong { plastic } else { trial.volumetric[k] };
        }
    }

    /// The return of Wolper et al. (2019), for stresses outside of the yield surface. The volumetric plastic strain does not
    /// grow by what the elastic one loses.
    #[inline(always)]
    fn nacc(&self, trial: &Trial<T>, out: &mut Returned<T>) {
        let (zero, one) = (T::of(0.0), T::of(1.0));
        for k in 0..GROUP {
            let strength = max(trial.strength[k], self.weakest);
            let strong = trial.strength[k] > self.weakest;
            // with the centre of the yield surface at 0 and its half-axes 1
            let (half_axis, centre) = (self.half_axis * strength, self.centre * strength);
            let inverse = one / half_axis;
            let p = (-(self.bulk * trial.volumetric[k]) - centre) * inverse;
            let q = self.shear_of_strain * trial.deviatoric[k] * inverse;
            let beyond = p * p >= one;
            let end = if p > zero { one } else { -one };
            // at the same pressure down to the surface, the strain below it scaled likewise
            let height = max(one - p * p, zero).sqrt();
            let (p_new, shear) = if beyond { (end, zero) } else { (p, height / max(q, T::of(1e-30))) };
            let radius = (p * p + q * q).sqrt();
            let p_hardening = if beyond { end } else { p / radius };
            let strain = |p: T| -((half_axis * p + centre) * self.bulk_inverse);
            let same = if beyond { strain(p_new) } else { trial.volumetric[k] };
            out.volumetric[k] = if strong { same } else { zero };
            out.shear[k] = if strong { shear } else { zero };
            out.plastic[k] = trial.volumetric[k] - if strong { strain(p_hardening) } else { zero };
        }
    }
}

impl<T: Real> Secular<T> {
    /// One step of Halley's on `1 - 1 / sqrt f`. With `D = (1 + t) (1 + k t)` and `f = N / D^2`, the slope of `f` is
    /// `-2 S / D^3` and its curvature `6 C / D^4`; all of it over one denominator, which cannot vanish.
    #[inline(always)]
    fn halley(&mut self) {
        for k in 0..GROUP {
            let (ratio, t) = (self.k[k], self.t[k]);
            let (a, b) = (T::of(1.0) + t, ratio.mul_add(t, T::of(1.0)));
            let (p, q) = (self.p[k] * b, self.q_2[k] * a * a);
            let p = p * p;
            let n = p + q;
            let (p, q) = (p * b, ratio * (q * a));
            let slope = p + q;
            let curvature = p.mul_add(b, q * (ratio * a));
            let d = a * b;
            let excess = n.sqrt() - d;
            let slope_2 = slope * slope;
            let bend = T::of(1.5) * excess * curvature.mul_add(n, -slope_2);
            let step = n * slope * (d * excess) / slope_2.mul_add(d, -bend);
            self.t[k] = max(t + step, T::of(0.0));
        }
    }
}

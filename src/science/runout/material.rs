//! Snow as an elastoplastic solid: Hencky elasticity and cohesive Cam clay (Gaume et al. 2018, Nature Communications 9,
//! 3047, Methods; Li et al. 2020, The Cryosphere 14, section 2).
//!
//! In two dimensions: Kirchhoff stress `tau = 2 mu eps + lambda tr(eps) I`, pressure `p = -tr(tau) / 2 = -K tr(eps)` with
//! `K = lambda + mu`, and `q = c |dev tau|` with `c = sqrt(3/2)`. With `d` half the difference of the principal strains,
//! `|dev tau| = 2 sqrt(2) mu d`. Strains are those of the elastic left Cauchy-Green tensor `b`, kept as `b - I`.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::lanes::{Real, max, sinh};

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
    /// `q / M * sqrt(1 + 2 beta)` of a unit of `d`: the half-axis along q over that along p taken out.
    pub(super) shear_of_strain: T,
    /// `A / B` of the secular equation of the return, and its inverse.
    pub(super) ratio: T,
    pub(super) ratio_inverse: T,
    pub(super) rule: FlowRule,
}

/// The plastic return of one stress.
#[derive(Clone, Copy, Debug)]
pub(super) struct Returned<T> {
    /// Elastic volumetric strain after the return.
    pub(super) volumetric: T,
    /// What remains of the deviatoric strain, from 0 to 1.
    pub(super) shear: T,
    /// By how much the volumetric plastic strain grows.
    pub(super) plastic: T,
}

impl<T: Real> Material<T> {
    /// `scale` is `4 dt^2 / (rho dx^2)`, 1/Pa.
    pub(super) fn new(snow: &Snow, rule: FlowRule, norm: ShearNorm, scale: f64) -> Self {
        let (_, mu) = snow.lame_pa();
        let bulk = snow.bulk_modulus_pa();
        let (m, beta, c) = (snow.friction, snow.cohesion, norm.factor());
        let widening = 1.0 + 2.0 * beta;
        let ratio = 2.0 * mu * c * c * widening / (bulk * m * m);
        Self {
            shear_2: T::of(2.0 * mu * scale),
            bulk: T::of(bulk * scale),
            bulk_inverse: T::of(1.0 / (bulk * scale)),
            hardening: T::of(snow.hardening),
            weakest: T::of(1e-9 * bulk * scale),
            half_axis: T::of(0.5 * (1.0 + beta)),
            centre: T::of(0.5 * (1.0 - beta)),
            shear_of_strain: T::of(c * 2.0 * std::f64::consts::SQRT_2 * mu * scale * widening.sqrt() / m),
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

    /// `((p - p_c)^2 + (q sqrt(1 + 2 beta) / M)^2 - r^2` of elastic strains: above 0 outside of the yield surface.
    #[inline(always)]
    pub(super) fn yielding(&self, volumetric: T, deviatoric: T, strength: T) -> T {
        let p = -(self.bulk * volumetric) - self.centre * strength;
        let (q, r) = (self.shear_of_strain * deviatoric, self.half_axis * strength);
        p * p + (q * q - r * r)
    }

    /// `p` and `q` with the centre of the yield surface at 0 and its half-axes 1; and its half-axis along p and centre.
    #[inline(always)]
    fn normalised(&self, volumetric: T, deviatoric: T, strength: T) -> (T, T, T, T) {
        let strength = max(strength, self.weakest);
        let (half_axis, centre) = (self.half_axis * strength, self.centre * strength);
        let inverse = T::of(1.0) / half_axis;
        let p = (-(self.bulk * volumetric) - centre) * inverse;
        (p, self.shear_of_strain * deviatoric * inverse, half_axis, centre)
    }

    /// Stress-free where there is no strength, else the closest point; for stresses outside of the yield surface.
    ///
    /// With `x = B D` of `X / (1 + A D)^2 + Y / (1 + B D)^2 = f` it solves `1 - 1 / sqrt f = 0` by Newton, which is nearly
    /// linear in `x`, from a lower bound of the root: where either term alone is 1.
    #[inline(always)]
    pub(super) fn closest<const N: usize>(
        &self,
        volumetric: &[T; N],
        deviatoric: &[T; N],
        strength: &[T; N],
    ) -> [Returned<T>; N] {
        let (zero, one) = (T::of(0.0), T::of(1.0));
        let (mut p, mut q, mut p2, mut q2, mut x) = ([zero; N], [zero; N], [zero; N], [zero; N], [zero; N]);
        for k in 0..N {
            (p[k], q[k], _, _) = self.normalised(volumetric[k], deviatoric[k], strength[k]);
            (p2[k], q2[k]) = (p[k] * p[k], q[k] * q[k]);
            x[k] = max(max(max(p[k], -p[k]) - one, (q[k] - one) * self.ratio_inverse), zero);
        }
        for _ in 0..T::NEWTON_STEPS {
            for k in 0..N {
                let (a, b) = (one + x[k], self.ratio * x[k] + one);
                let inverse = one / (a * b);
                let (u, w) = (inverse * b, inverse * a);
                let (pu, qw) = (p2[k] * (u * u), q2[k] * (w * w));
                let f = pu + qw;
                let slope = pu * u + self.ratio * (qw * w);
                x[k] = max((f / slope) * (f.sqrt() - one) + x[k], zero);
            }
        }
        let mut out = [Returned { volumetric: zero, shear: zero, plastic: zero }; N];
        for k in 0..N {
            let (_, _, half_axis, centre) = self.normalised(volumetric[k], deviatoric[k], strength[k]);
            let (a, b) = (one + x[k], self.ratio * x[k] + one);
            let inverse = one / (a * b);
            let (pu, w) = (p[k] * (inverse * b), inverse * a);
            let qw = q[k] * w;
            // the last error of Newton's is taken out along the radius: the result lies on the surface
            let onto = one / (pu * pu + qw * qw).sqrt();
            let strong = strength[k] > self.weakest;
            let elastic = -((half_axis * (pu * onto) + centre) * self.bulk_inverse);
            let elastic = if strong { elastic } else { zero };
            out[k] = Returned {
                volumetric: elastic,
                shear: if strong { w * onto } else { zero },
                plastic: volumetric[k] - elastic,
            };
        }
        out
    }

    /// The return of Wolper et al. (2019), for stresses outside of the yield surface.
    #[inline(always)]
    pub(super) fn nacc<const N: usize>(
        &self,
        volumetric: &[T; N],
        deviatoric: &[T; N],
        strength: &[T; N],
    ) -> [Returned<T>; N] {
        let (zero, one) = (T::of(0.0), T::of(1.0));
        let mut out = [Returned { volumetric: zero, shear: zero, plastic: zero }; N];
        for k in 0..N {
            let (p, q, half_axis, centre) = self.normalised(volumetric[k], deviatoric[k], strength[k]);
            let strong = strength[k] > self.weakest;
            let beyond = p * p >= one;
            let end = if p > zero { one } else { -one };
            // at the same pressure down to the surface, the strain below it scaled likewise
            let height = max(one - p * p, zero).sqrt();
            let (p_new, shear) = if beyond { (end, zero) } else { (p, height / max(q, T::of(1e-30))) };
            let radius = (p * p + q * q).sqrt();
            let p_hardening = if beyond { end } else { p / radius };
            let strain = |p: T| -((half_axis * p + centre) * self.bulk_inverse);
            let same = if beyond { strain(p_new) } else { volumetric[k] };
            out[k] = Returned {
                volumetric: if strong { same } else { zero },
                shear: if strong { shear } else { zero },
                plastic: volumetric[k] - if strong { strain(p_hardening) } else { zero },
            };
        }
        out
    }
}

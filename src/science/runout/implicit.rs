//! The associative return with the hardening that it brings about itself (implicit hardening), as an option: the yield
//! surface that the stress comes back to is that of the end of the step.

use super::{
    lanes::{Real, max, sinh},
    material::{Material, Returned, Trial},
    particles::GROUP,
};

/// How often the bracket of the pressure is halved: down to the rounding of either precision.
const fn halvings<T>() -> usize {
    if size_of::<T>() == 4 { 30 } else { 62 }
}

/// A trial state outside of the yield surface, in units of K.
#[derive(Clone, Copy, Debug)]
struct Scaled<T> {
    pressure: T,
    /// `q sqrt(1 + 2 beta) / M`.
    shear: T,
    /// Pressure plus the compaction that hardens: `p` below it has a strength of `K sinh(xi (reach - p))`.
    reach: T,
}

/// A stress on the way of the plastic flow, in units of K.
#[derive(Clone, Copy, Debug)]
struct OnWay<T> {
    /// Pressure less that of the centre of the yield surface.
    from_centre: T,
    centre: T,
    half_axis: T,
    /// What remains of the deviatoric strain.
    remains: T,
    /// `from_centre` and the remaining shear, as the yield surface adds them up.
    radius: T,
    /// Whether it lies outside of the yield surface, on the trial's side of its centre.
    outside: bool,
}

impl<T: Real> Material<T> {
    /// The stress at a pressure on the way of associative flow from the trial: as both invariants relax in proportion to the
    /// distance from the centre, `q / q_tr = u / (u + (A / B) (p_tr - p))` with `u = p - p_c` (see [`Material::closest`]).
    #[inline(always)]
    fn on_way(&self, trial: &Scaled<T>, pressure: T) -> OnWay<T> {
        let strength = sinh(self.hardening * max(trial.reach - pressure, T::of(0.0)));
        let (centre, half_axis) = (self.centre * strength, self.half_axis * strength);
        let (u, v) = (pressure - centre, trial.pressure - pressure);
        let absolute = |x: T| max(x, -x);
        let whole = absolute(u) + self.ratio * absolute(v);
        let remains = absolute(u) / max(whole, T::of(1e-30));
        let shear = trial.shear * remains;
        let radius = (u * u + shear * shear).sqrt();
        let passed = u * v < T::of(0.0);
        OnWay { from_centre: u, centre, half_axis, remains, radius, outside: !passed & (radius > half_axis) }
    }

    /// The closest point on the yield surface that the return itself hardens or softens, for stresses outside of the one at
    /// the step's start; stress-free where the strain dilates the snow beyond all strength.
    ///
    /// One unknown is left, the pressure: it has a strength, and so a place on the way of the flow. Between the trial and the
    /// centre of the surface it is found by halving, which no softening leads astray. `cohesion <= 1`, so that the centre
    /// does not lie in tension.
    #[inline(never)] // it is seldom used, and would swell the step that is
    pub(super) fn implicit(&self, trial: &Trial<T>, out: &mut Returned<T>) {
        let (zero, half) = (T::of(0.0), T::of(0.5));
        let Trial { volumetric, deviatoric, plastic_strain, strength } = trial;
        let of_lane = |k: usize| Scaled {
            pressure: -volumetric[k],
            shear: self.shear_of_strain * deviatoric[k] * self.bulk_inverse,
            reach: -volumetric[k] - plastic_strain[k],
        };
        let trials: [Scaled<T>; GROUP] = std::array::from_fn(of_lane);
        let mut outside = trials.map(|trial| trial.pressure);
        let mut inside: [T; GROUP] = std::array::from_fn(|k| {
            let centre = self.centre * strength[k] * self.bulk_inverse;
            // compaction moves the centre up and dilation down: either way it is not beyond these
            if trials[k].pressure > centre { zero } else { centre }
        });
        for _ in 0..halvings::<T>() {
            for k in 0..GROUP {
                let middle = half * (outside[k] + inside[k]);
                let is_outside = self.on_way(&trials[k], middle).outside;
                outside[k] = if is_outside { middle } else { outside[k] };
                inside[k] = if is_outside { inside[k] } else { middle };
            }
        }
        for k in 0..GROUP {
            let state = self.on_way(&trials[k], half * (outside[k] + inside[k]));
            // the last error is taken out along the radius, as in `closest`
            let onto = state.half_axis / max(state.radius, T::of(1e-30));
            let weakest = self.weakest * self.bulk_inverse;
            let strong = (trials[k].reach > zero) & (state.half_axis > weakest);
            out.volumetric[k] = if strong { -(state.centre + state.from_centre * onto) } else { zero };
            out.shear[k] = if strong { state.remains * onto } else { zero };
            out.plastic[k] = volumetric[k] - out.volumetric[k];
        }
    }
}

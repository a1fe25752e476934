//! The flow regime of an avalanche: cold dense, warm shear, warm plug or sliding slab (Li et al. 2020, section 3; the regimes
//! after Köhler et al. 2018).
//!
//! The paper tells regimes apart by eye: by front, free surface and vertical velocity profile. The thresholds here are
//! ours, from the four typical flows of Group II at mesh 0.05 m.

use serde::{Deserialize, Serialize};

use super::GRAVITY_M_S2;
use super::material::Snow;

/// How far a threshold may be moved before the class must hold no longer, as a share of it.
pub const MOVED: f64 = 0.2;

/// A flow regime.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum RegimeClass {
    /// Sheared over its depth, long and continuous.
    ColdDense,
    /// Broken into granules that move as one body or that shear.
    WarmShear,
    /// One unbroken body that glides on the bed.
    WarmPlug,
    /// A slab that glides on the bed and breaks into few pieces.
    SlidingSlab,
    /// Between two of them: moving one threshold by a fifth changes the class.
    Transitional,
}

/// The shape of a flow at one instant, all dimensionless.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct FlowShape {
    /// Mean velocity of the lowest fifth of the flow's mass, bin by bin, over that of the highest fifth; 1 where nothing moves.
    pub slip: f64,
    /// Length along the bed from the 1 % to the 99 % quantile of mass over the length at release.
    pub stretch: f64,
    /// Share of the 0.5 m bins between these quantiles with less than a tenth of their mean mass.
    pub gap: f64,
    /// Standard deviation of the mass of these bins over its mean.
    pub cv: f64,
    /// Share of the mass with volumetric plastic strain above 0, which carries no stress.
    pub broken: f64,
}

/// What a class was found from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Criteria {
    /// Time since release at which the middle of the slope was passed, s.
    pub mid_time_s: f64,
    /// The flow when its centre of mass passed the middle of the slope; at its fastest where it never came that far.
    pub mid: FlowShape,
    /// The flow at its end.
    pub end: FlowShape,
}

/// The thresholds of the classes, in the order in which they are asked.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Thresholds {
    /// Sheared below this slip ...
    slip_mid: f64,
    /// ... if longer than this.
    stretch_mid: f64,
    /// Continuous below this.
    gap_mid: f64,
    /// Whole below this share of broken snow ...
    broken_end: f64,
    /// ... and this one of gaps.
    gap_end: f64,
    /// In granules above this share of broken snow ...
    broken_mid: f64,
    /// ... or above this unevenness.
    cv_mid: f64,
}

const THRESHOLDS: Thresholds = Thresholds {
    slip_mid: 0.7,
    stretch_mid: 2.0,
    gap_mid: 0.05,
    broken_end: 0.05,
    gap_end: 0.02,
    broken_mid: 0.13,
    cv_mid: 0.5,
};

/// One threshold of all.
type Field = fn(&mut Thresholds) -> &mut f64;

const FIELDS: [Field; 7] = [
    |all| &mut all.slip_mid,
    |all| &mut all.stretch_mid,
    |all| &mut all.gap_mid,
    |all| &mut all.broken_end,
    |all| &mut all.gap_end,
    |all| &mut all.broken_mid,
    |all| &mut all.cv_mid,
];

/// A regime and what speaks for it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Regime {
    /// The regime; `transitional` where the class hangs on a threshold.
    pub class: RegimeClass,
    /// The class by the thresholds as they stand, never `transitional`.
    pub nearest: RegimeClass,
    /// What was measured.
    pub criteria: Criteria,
}

/// The regime of a flow.
#[must_use]
pub fn classify(criteria: Criteria) -> Regime {
    let nearest = class_by(&criteria, &THRESHOLDS);
    let holds = |field: &Field| {
        [1.0 - MOVED, 1.0 + MOVED].iter().all(|factor| {
            let mut moved = THRESHOLDS;
            *field(&mut moved) *= factor;
            class_by(&criteria, &moved) == nearest
        })
    };
    let class = if FIELDS.iter().all(holds) { nearest } else { RegimeClass::Transitional };
    Regime { class, nearest, criteria }
}

fn class_by(criteria: &Criteria, limits: &Thresholds) -> RegimeClass {
    let Criteria { mid, end, .. } = criteria;
    if mid.slip < limits.slip_mid && mid.stretch > limits.stretch_mid {
        return if mid.gap < limits.gap_mid { RegimeClass::ColdDense } else { RegimeClass::WarmShear };
    }
    if end.broken < limits.broken_end && end.gap < limits.gap_end {
        return RegimeClass::WarmPlug;
    }
    if mid.broken > limits.broken_mid || mid.cv > limits.cv_mid {
        return RegimeClass::WarmShear;
    }
    RegimeClass::SlidingSlab
}

/// What parameters alone say of a flow, all dimensionless.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Indicators {
    /// Internal friction `M / sqrt 3` over that of the bed: below 1 snow shears more easily than it slides. `null` for a bed
    /// without friction.
    pub friction_ratio: Option<f64>,
    /// Tensile strength `beta p0` over the weight of the slab `rho g h0`: how much cohesion holds together.
    pub cohesion: f64,
    /// Plastic strain `asinh(p0 / K) / xi` from release to loss of all strength: brittle where it is small.
    pub ductility: f64,
}

impl Indicators {
    /// The indicators of snow that lies `thickness_m` metres thick on a bed of that friction coefficient.
    #[must_use]
    pub fn new(snow: &Snow, thickness_m: f64, bed_friction: f64) -> Self {
        Self {
            friction_ratio: (bed_friction > 0.0).then(|| snow.friction / 3_f64.sqrt() / bed_friction),
            cohesion: snow.cohesion * snow.strength_pa / (snow.density_kg_m3 * GRAVITY_M_S2 * thickness_m),
            ductility: -snow.plastic_strain_at_release(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A flow of Group II at mesh 0.05 m as the design of the classes tabulates it: at 5 s, short of mid slope, and at the end.
    /// Unevenness is not in that table; 0.3 and 0.8 are what flows without and with gaps have at least.
    fn tabulated(stretch: f64, slip: f64, gap: [f64; 2], broken: [f64; 2], cv: f64) -> Criteria {
        let mid = FlowShape { slip, stretch, gap: gap[0], cv, broken: broken[0] };
        Criteria { mid_time_s: 5.0, mid, end: FlowShape { gap: gap[1], broken: broken[1], ..mid } }
    }

    fn cold_dense() -> Criteria {
        tabulated(6.1, 0.42, [0.0, 0.02], [0.48, 0.67], 0.3)
    }

    #[test]
    fn the_four_typical_flows_are_what_they_are_called() {
        let warm_shear = tabulated(2.7, 1.0, [0.38, 0.0], [0.17, 0.57], 0.8);
        let sliding_slab = tabulated(0.99, 1.0, [0.0, 0.27], [0.06, 0.33], 0.3);
        let warm_plug = tabulated(0.98, 0.99, [0.0, 0.0], [0.0, 0.0], 0.1);
        for (criteria, class) in [
            (cold_dense(), RegimeClass::ColdDense),
            (warm_shear, RegimeClass::WarmShear),
            (sliding_slab, RegimeClass::SlidingSlab),
            (warm_plug, RegimeClass::WarmPlug),
        ] {
            let regime = classify(criteria);
            assert_eq!((regime.class, regime.nearest), (class, class));
            assert_eq!(regime.criteria, criteria);
        }
    }

    #[test]
    fn a_class_that_hangs_on_any_one_threshold_is_transitional() {
        // each moves one number of a typical flow to within a fifth of its threshold, from both sides
        type Change = fn(&mut Criteria, f64);
        let with = |change: Change, value: f64, base: Criteria| {
            let mut criteria = base;
            change(&mut criteria, value);
            classify(criteria).class
        };
        let slab = tabulated(0.99, 1.0, [0.0, 0.27], [0.06, 0.33], 0.3);
        let plug = tabulated(0.98, 0.99, [0.0, 0.0], [0.0, 0.0], 0.1);
        let cases: [(Change, [f64; 2], Criteria); 7] = [
            (|c, v| c.mid.slip = v, [0.6, 0.8], cold_dense()),
            (|c, v| c.mid.stretch = v, [1.7, 2.3], cold_dense()),
            (|c, v| c.mid.gap = v, [0.041, 0.059], cold_dense()),
            (|c, v| c.end.broken = v, [0.041, 0.059], plug),
            (|c, v| c.end.gap = v, [0.017, 0.023], plug),
            (|c, v| c.mid.broken = v, [0.105, 0.155], slab),
            (|c, v| c.mid.cv = v, [0.41, 0.59], slab),
        ];
        for (change, near, base) in cases {
            for value in near {
                assert_eq!(with(change, value, base), RegimeClass::Transitional, "{value}");
            }
        }
        assert_eq!(with(|c, v| c.mid.slip = v, 0.55, cold_dense()), RegimeClass::ColdDense);
        assert_eq!(with(|c, v| c.mid.gap = v, 0.07, cold_dense()), RegimeClass::WarmShear);
        assert_eq!(with(|c, v| c.mid.broken = v, 0.16, slab), RegimeClass::WarmShear);
    }

    #[test]
    fn indicators_are_their_formulas() {
        // K = E / (2 (1 + nu) (1 - 2 nu)) in two dimensions: 42 kPa here
        let snow = Snow { youngs_modulus_pa: 84_000.0, poisson_ratio: 0.0, ..Snow::li_2020(1.5, 0.5, 2.0, 42_000.0) };
        let indicators = Indicators::new(&snow, 2.0, 0.5);
        assert!((indicators.friction_ratio.unwrap() - 3_f64.sqrt()).abs() < 1e-15);
        assert!((indicators.cohesion - 21_000.0 / 4905.0).abs() < 1e-12);
        // asinh 1 = ln(1 + sqrt 2)
        assert!((indicators.ductility - (1.0 + 2_f64.sqrt()).ln() / 2.0).abs() < 1e-15);
        assert_eq!(Indicators::new(&snow, 2.0, 0.0).friction_ratio, None);
    }
}

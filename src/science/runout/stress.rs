//! What the deformation of a step makes of the particles of a block: elastic strains, plastic return, stress and work.
#![allow(clippy::needless_range_loop, reason = "a lane is a number that indexes many arrays")]

use super::{
    lanes::{NEAR, Real, ln_1p_pair, max},
    material::{FlowRule, Material, Returned, Returns},
    particles::{BLOCK, Block, GROUP, GROUPS},
    transfer::Motion,
};

/// In place of a ratio of strains, which is above 0, until it is found the long way.
const UNKNOWN: f64 = -1.0;

/// Stresses of the particles of a block, and what they are made of.
#[repr(C, align(64))]
pub(super) struct Stress<T> {
    /// Kirchhoff stress.
    pub(super) xx: [T; BLOCK],
    pub(super) zz: [T; BLOCK],
    pub(super) xz: [T; BLOCK],
    /// Plastic work since it was last taken, in the units of stress, of every lane of a group.
    pub(super) work: [f64; GROUP],
    /// Elastic left Cauchy-Green tensor at the step's start, less the identity.
    old_xx: [T; BLOCK],
    old_zz: [T; BLOCK],
    old_xz: [T; BLOCK],
    /// Half the difference of the trial tensor's entries on the diagonal; with the one beside it this is its deviator.
    half: [T; BLOCK],
    /// Trial strains: the volumetric one, the deviatoric one over the deviator of the tensor, and the square of half the
    /// difference of the principal ones.
    volumetric: [T; BLOCK],
    ratio: [T; BLOCK],
    deviatoric_2: [T; BLOCK],
    yielding: [T; BLOCK],
    returns: Returns<T>,
}

impl<T: Real> Stress<T> {
    pub(super) fn new() -> Self {
        let zero = [T::of(0.0); BLOCK];
        Self {
            xx: zero,
            zz: zero,
            xz: zero,
            work: [0.0; GROUP],
            old_xx: zero,
            old_zz: zero,
            old_xz: zero,
            half: zero,
            volumetric: zero,
            ratio: zero,
            deviatoric_2: zero,
            yielding: zero,
            returns: Returns::new(),
        }
    }

    /// The work since it was last taken.
    pub(super) fn take_work(&mut self) -> f64 {
        std::mem::take(&mut self.work).iter().sum()
    }
}

/// Deforms the particles of a block; their stresses and the plastic work are left in `stress`.
#[inline(always)]
pub(super) fn deform<T: Real>(
    material: &Material<T>,
    motion: &Motion<T>,
    block: &mut Block<T>,
    stress: &mut Stress<T>,
) {
    stretch(motion, block, stress);
    strain(block, stress);
    elastic(material, block, stress);
    plastic(material, block, stress);
}

/// The elastic left Cauchy-Green tensor after the deformation of the step, were it elastic.
#[inline(always)]
fn stretch<T: Real>(motion: &Motion<T>, block: &mut Block<T>, stress: &mut Stress<T>) {
    let two = T::of(2.0);
    for k in 0..BLOCK {
        let (xx, zz, xz) = (block.bxx[k], block.bzz[k], block.bxz[k]);
        let (lxx, lxz, lzx, lzz) = (motion.lxx[k], motion.lxz[k], motion.lzx[k], motion.lzz[k]);
        (stress.old_xx[k], stress.old_zz[k], stress.old_xz[k]) = (xx, zz, xz);
        // (I + L) b (I + L)^T - I = B + N + N^T + N L^T with B = b - I and N = L + L B: nothing is ever added to 1
        let nxx = lxz.mul_add(xz, lxx.mul_add(xx, lxx));
        let nxz = lxz.mul_add(zz, lxx.mul_add(xz, lxz));
        let nzx = lzz.mul_add(xz, lzx.mul_add(xx, lzx));
        let nzz = lzz.mul_add(zz, lzx.mul_add(xz, lzz));
        block.bxx[k] = nxz.mul_add(lxz, nxx.mul_add(lxx, two.mul_add(nxx, xx)));
        block.bzz[k] = nzz.mul_add(lzz, nzx.mul_add(lzx, two.mul_add(nzz, zz)));
        block.bxz[k] = nxz.mul_add(lzz, nxx.mul_add(lzx, xz + (nxz + nzx)));
    }
}

/// The Hencky strains of the trial tensor.
#[inline(always)]
fn strain<T: Real>(block: &Block<T>, stress: &mut Stress<T>) {
    let (half, one, two, near) = (T::of(0.5), T::of(1.0), T::of(2.0), T::of(NEAR));
    let mut far = 0_u32;
    for k in 0..BLOCK {
        let (xx, zz, xz) = (block.bxx[k], block.bzz[k], block.bxz[k]);
        let (sum, dxx) = (xx + zz, half * (xx - zz));
        // ln(1 + x) = 2 atanh(x / (2 + x)) of the determinant, and atanh of the deviator over the mean, by one division
        let determinant = (-xz).mul_add(xz, xx.mul_add(zz, sum));
        let (mean, twice) = (half.mul_add(sum, one), two + determinant);
        let inverse = one / (mean * twice);
        let of_mean = inverse * twice;
        let s = determinant * (inverse * mean);
        let radius_2 = dxx.mul_add(dxx, xz * xz);
        let (s_2, r_2) = (s * s, radius_2 * (of_mean * of_mean));
        let ratio = half * of_mean * T::atanh_ratio(r_2);
        stress.half[k] = dxx;
        stress.volumetric[k] = s * T::atanh_ratio(s_2);
        stress.deviatoric_2[k] = radius_2 * (ratio * ratio);
        let within = (s_2 <= near) & (r_2 <= near);
        stress.ratio[k] = if within { ratio } else { T::of(UNKNOWN) };
        far |= u32::from(!within);
    }
    if far != 0 {
        strain_far(block, stress);
    }
}

/// The same where a series is not short and no ratio is known: rare, and so one by one.
#[cold]
fn strain_far<T: Real>(block: &Block<T>, stress: &mut Stress<T>) {
    let half = T::of(0.5);
    for k in 0..BLOCK {
        if stress.ratio[k] >= T::of(0.0) {
            continue;
        }
        let (mean, dxx, xz) = (half * (block.bxx[k] + block.bzz[k]), stress.half[k], block.bxz[k]);
        let radius = (dxx * dxx + xz * xz).sqrt();
        let (first, second) = ln_1p_pair(mean + radius, mean - radius);
        let deviatoric = T::of(0.25) * (first - second);
        stress.volumetric[k] = half * (first + second);
        stress.ratio[k] = deviatoric / max(radius, T::of(1e-18));
        stress.deviatoric_2[k] = deviatoric * deviatoric;
    }
}

/// The stress of the trial strains, and whether it is one that the snow can bear.
#[inline(always)]
fn elastic<T: Real>(material: &Material<T>, block: &Block<T>, stress: &mut Stress<T>) {
    for k in 0..BLOCK {
        let volumetric = stress.volumetric[k];
        stress.yielding[k] = material.yielding(volumetric, stress.deviatoric_2[k], block.strength[k]);
        let (isotropic, shear) = (material.bulk * volumetric, material.shear_2 * stress.ratio[k]);
        stress.xx[k] = shear.mul_add(stress.half[k], isotropic);
        stress.zz[k] = (-shear).mul_add(stress.half[k], isotropic);
        stress.xz[k] = shear * block.bxz[k];
    }
}

/// The first lane of a group, which tells the compiler that all its lanes are in the block.
#[inline(always)]
fn first(group: usize) -> usize {
    GROUP * (group % GROUPS)
}

/// The lanes of a group.
#[inline(always)]
fn window<T: Real>(values: &[T; BLOCK], group: usize) -> [T; GROUP] {
    let mut window = [T::of(0.0); GROUP];
    window.copy_from_slice(&values[first(group)..first(group) + GROUP]);
    window
}

/// Brings the stresses outside of the yield surface back to it.
#[inline(always)]
fn plastic<T: Real>(material: &Material<T>, block: &mut Block<T>, stress: &mut Stress<T>) {
    let implicit = material.rule == FlowRule::AssociativeImplicit;
    let (mut groups, mut count) = ([0; GROUPS], 0);
    // no iterator: what is not inlined is not compiled for the wide registers
    for group in 0..GROUPS {
        let (yielding, strength) = (window(&stress.yielding, group), window(&block.strength, group));
        let (mut any, mut any_strong) = (0_u32, 0_u32);
        for k in 0..GROUP {
            any |= u32::from(yielding[k] > T::of(0.0));
            any_strong |= u32::from((yielding[k] > T::of(0.0)) & (strength[k] > material.weakest));
        }
        // compaction gives strength even to what has none, but only within the step where hardening is implicit
        if any_strong != 0 || (any != 0 && implicit) {
            let trial = &mut stress.returns.trials[count % GROUPS];
            (trial.volumetric, trial.strength) = (window(&stress.volumetric, group), strength);
            trial.plastic_strain = window(&block.plastic_strain, group);
            let deviatoric_2 = window(&stress.deviatoric_2, group);
            for k in 0..GROUP {
                trial.deviatoric[k] = deviatoric_2[k].sqrt();
            }
            groups[count % GROUPS] = group;
            count += 1;
        } else if any != 0 {
            loosen(material, block, stress, group);
        }
    }
    material.back(&mut stress.returns, count);
    for i in 0..count {
        let returned = stress.returns.returned[i];
        settle(material, block, stress, groups[i], &returned);
    }
}

/// Plastic work of a lane: the mean of the stresses at the step's start and end does it. The logarithm of what was elastic
/// then is that of a small strain: `ln(I + B) = B - B^2 / 2`.
#[inline(always)]
fn work<T: Real>(material: &Material<T>, stress: &Stress<T>, i: usize, trial_xz: T, end: (T, T), grown: T) -> T {
    let (half, one) = (T::of(0.5), T::of(1.0));
    let (xx, zz, xz) = (stress.old_xx[i], stress.old_zz[i], stress.old_xz[i]);
    let (volumetric, shear) = end;
    let square = xz * xz;
    let old_xx = half * (-half).mul_add(xx.mul_add(xx, square), xx);
    let old_zz = half * (-half).mul_add(zz.mul_add(zz, square), zz);
    let old_xz = half * (-half).mul_add(xz * (xx + zz), xz);
    let along = stress.ratio[i] * (half * (old_xx - old_zz)).mul_add(stress.half[i], old_xz * trial_xz);
    let isotropic = half * material.bulk * (old_xx + old_zz + volumetric) * grown;
    let deviatoric = shear.mul_add(stress.deviatoric_2[i], along) * (one - shear);
    material.shear_2.mul_add(deviatoric, isotropic)
}

/// Adds the plastic work of a group to that of the block, that of fillers left out.
///
/// A loop of its own: one that writes numbers of two sizes stays scalar.
#[inline(always)]
fn book<T: Real>(len: usize, stress: &mut Stress<T>, group: usize, lost: &[T; GROUP]) {
    for k in 0..GROUP {
        stress.work[k] += if first(group) + k < len { lost[k].f64() } else { 0.0 };
    }
}

/// The stress-free end of a group in which whatever yields has no strength.
#[inline(always)]
fn loosen<T: Real>(material: &Material<T>, block: &mut Block<T>, stress: &mut Stress<T>, group: usize) {
    let zero = T::of(0.0);
    let at = first(group);
    let mut lost = [zero; GROUP];
    let mut packed = 0_u32;
    for k in 0..GROUP {
        let i = at + k;
        let out = stress.yielding[i] > zero;
        let select = |new: T, old: T| if out { new } else { old };
        let grown = stress.volumetric[i];
        lost[k] = select(work(material, stress, i, block.bxz[i], (zero, zero), grown), zero);
        block.bxx[i] = select(zero, block.bxx[i]);
        block.bzz[i] = select(zero, block.bzz[i]);
        block.bxz[i] = select(zero, block.bxz[i]);
        stress.xx[i] = select(zero, stress.xx[i]);
        stress.zz[i] = select(zero, stress.zz[i]);
        stress.xz[i] = select(zero, stress.xz[i]);
        let strain = select(block.plastic_strain[i] + grown, block.plastic_strain[i]);
        block.plastic_strain[i] = strain;
        packed |= u32::from(out & (strain < zero));
    }
    book(block.len, stress, group, &lost);
    if packed != 0 {
        harden(material, block, stress, group);
    }
}

/// The strength of what yielded in a group.
#[inline(always)]
fn harden<T: Real>(material: &Material<T>, block: &mut Block<T>, stress: &Stress<T>, group: usize) {
    for k in first(group)..first(group) + GROUP {
        let strength = material.strength(block.plastic_strain[k]);
        block.strength[k] = if stress.yielding[k] > T::of(0.0) { strength } else { block.strength[k] };
    }
}

/// The state after the return of a group.
#[inline(always)]
fn settle<T: Real>(
    material: &Material<T>,
    block: &mut Block<T>,
    stress: &mut Stress<T>,
    group: usize,
    returned: &Returned<T>,
) {
    let (zero, one, four) = (T::of(0.0), T::of(1.0), T::of(4.0));
    let at = first(group);
    let trial_xz = window(&block.bxz, group);
    let mut lost = [zero; GROUP];
    let mut far = 0_u32;
    for k in 0..GROUP {
        let i = at + k;
        let out = stress.yielding[i] > zero;
        let select = |new: T, old: T| if out { new } else { old };
        let (volumetric, shear) = (returned.volumetric[k], returned.shear[k]);
        let (dxx, xz) = (stress.half[i], trial_xz[k]);
        lost[k] = select(work(material, stress, i, xz, (volumetric, shear), returned.plastic[k]), zero);
        // exp of a tensor: e^v (cosh 2q I + sinh 2q times its direction), less I
        let deviator = shear * stress.ratio[i];
        let square = four * stress.deviatoric_2[i] * (shear * shear);
        let (cosh_m1, sinh_ratio) = T::cosh_m1_and_sinh_ratio(square);
        let growth_m1 = volumetric.exp_m1();
        let growth = one + growth_m1;
        let mean = growth.mul_add(cosh_m1, growth_m1);
        let of_deviator = (growth * sinh_ratio) * (deviator + deviator);
        block.bxx[i] = select(of_deviator.mul_add(dxx, mean), block.bxx[i]);
        block.bzz[i] = select((-of_deviator).mul_add(dxx, mean), block.bzz[i]);
        block.bxz[i] = select(of_deviator * xz, xz);
        let short = square <= T::of(NEAR);
        far |= u32::from(out & !short);
        block.plastic_strain[i] = select(block.plastic_strain[i] + returned.plastic[k], block.plastic_strain[i]);
        let (isotropic, shear) = (material.bulk * volumetric, material.shear_2 * deviator);
        stress.xx[i] = select(shear.mul_add(dxx, isotropic), stress.xx[i]);
        stress.zz[i] = select((-shear).mul_add(dxx, isotropic), stress.zz[i]);
        stress.xz[i] = select(shear * xz, stress.xz[i]);
    }
    book(block.len, stress, group, &lost);
    if far != 0 {
        settle_far(block, stress, group, returned, &trial_xz);
    }
    harden(material, block, stress, group);
}

/// The elastic tensor where its series is not short.
#[cold]
fn settle_far<T: Real>(
    block: &mut Block<T>,
    stress: &Stress<T>,
    group: usize,
    returned: &Returned<T>,
    trial_xz: &[T; GROUP],
) {
    let (half, two, four) = (T::of(0.5), T::of(2.0), T::of(4.0));
    for k in 0..GROUP {
        let i = first(group) + k;
        let (volumetric, shear) = (returned.volumetric[k], returned.shear[k]);
        let near = four * stress.deviatoric_2[i] * (shear * shear) <= T::of(NEAR);
        let yields = stress.yielding[i] > T::of(0.0);
        if near || !yields {
            continue;
        }
        let deviatoric = stress.deviatoric_2[i].sqrt();
        let q = two * shear * deviatoric;
        let (first, second) = ((volumetric + q).exp_m1(), (volumetric - q).exp_m1());
        let (mean, radius) = (half * (first + second), half * (first - second));
        let of_deviator = radius * stress.ratio[i] / deviatoric;
        block.bxx[i] = of_deviator.mul_add(stress.half[i], mean);
        block.bzz[i] = (-of_deviator).mul_add(stress.half[i], mean);
        block.bxz[i] = of_deviator * trial_xz[k];
    }
}

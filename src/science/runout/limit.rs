//! The limiter of affine motion.
#![allow(clippy::needless_range_loop, reason = "a lane is a number that indexes many arrays")]

use super::{
    lanes::{Real, max, min},
    particles::{BLOCK, Block, GROUP, GROUPS, Place},
    transfer::{Motion, Step, bases, run},
    vector::Vector,
};

/// Smallest and largest velocities of the nine nodes of each particle that is limited.
#[repr(C, align(64))]
pub(super) struct Extremes<T> {
    lowest: [[T; 4]; BLOCK],
    highest: [[T; 4]; BLOCK],
}

impl<T: Real> Extremes<T> {
    pub(super) fn new() -> Self {
        Self { lowest: [[T::of(0.0); 4]; BLOCK], highest: [[T::of(0.0); 4]; BLOCK] }
    }
}

/// Limits the affine motion of dilated particles that are nearly in free fall, and of any that are faster, so that no node is
/// given a velocity outside of those of the particle's nodes (after Barth & Jespersen 1989, AIAA paper 89-0366).
///
/// At an unresolved edge the fit overshoots, and a lone particle would hand momentum to nodes that few share, again and
/// again: grains at twice the speed of free fall come of it. What comes near to a frictionless fall from the top of the slab is
/// on its way there; what is slower is left as it is, so that the flow does not feel the limit. Where snow shears easily a
/// whole upper layer overshoots without coming apart: friction at the bed would make it faster than none does.
#[inline(always)]
pub(super) fn limit<T: Real>(step: &Step<'_, T>, block: &Block<T>, motion: &mut Motion<T>, extremes: &mut Extremes<T>) {
    if step.free_fall == T::of(f64::INFINITY) {
        // plain APIC
        return;
    }
    // no iterator: what is not inlined is not compiled for the wide registers
    for group in 0..GROUPS {
        let at = GROUP * group;
        let mut any = 0_u32;
        for k in at..at + GROUP {
            let (square, drop) = square_and_drop(step, block, motion, k);
            any |= u32::from(block.plastic_strain[k] > step.limited_above) | u32::from(square > step.free_fall * drop);
        }
        if any != 0 {
            limit_group(step, block, at, motion, extremes);
        }
    }
}

/// The same for the group that begins at `at`.
#[inline(always)]
fn limit_group<T: Real>(
    step: &Step<'_, T>,
    block: &Block<T>,
    at: usize,
    motion: &mut Motion<T>,
    extremes: &mut Extremes<T>,
) {
    let (mut outruns, mut any) = ([false; GROUP], 0_u32);
    for k in 0..GROUP {
        let (square, drop) = square_and_drop(step, block, motion, at + k);
        let dilated = block.plastic_strain[at + k] > step.limited_above;
        outruns[k] = (dilated & (square > step.fall * drop)) | (square > step.free_fall * drop);
        any |= u32::from(outruns[k]);
    }
    if any == 0 {
        return;
    }
    for (k, outruns) in outruns.iter().enumerate() {
        if *outruns {
            find(step, &block.place, at + k, extremes);
        }
    }
    let Motion { vx, vz, lxx, lxz, lzx, lzz } = motion;
    scale(block, at, &outruns, extremes, 0, (vx, lxx, lxz));
    scale(block, at, &outruns, extremes, 1, (vz, lzx, lzz));
}

/// The square of the speed of particle `k`, and how far it is below the top, in cells and steps.
#[inline(always)]
fn square_and_drop<T: Real>(step: &Step<'_, T>, block: &Block<T>, motion: &Motion<T>, k: usize) -> (T, T) {
    let z = T::of(f64::from(block.place.row[k])) + block.place.gz[k];
    (motion.vx[k] * motion.vx[k] + motion.vz[k] * motion.vz[k], step.top - z)
}

/// Scales the gradient (along x, along z) of one component of the velocity of what outruns free fall.
#[inline(always)]
fn scale<T: Real>(
    block: &Block<T>,
    at: usize,
    outruns: &[bool; GROUP],
    extremes: &Extremes<T>,
    component: usize,
    (v, lx, lz): (&[T; BLOCK], &mut [T; BLOCK], &mut [T; BLOCK]),
) {
    let (zero, one, tiny) = (T::of(0.0), T::of(1.0), T::of(1e-20));
    for (lane, outruns) in outruns.iter().enumerate() {
        let k = at + lane;
        let (gx, gz) = (block.place.gx[k], block.place.gz[k]);
        // the furthest that v + C (x_i - x_p) goes up and down
        let (right, left) = (lx[k] * (one - gx), -(lx[k] * (one + gx)));
        let (above, below) = (lz[k] * (one - gz), -(lz[k] * (one + gz)));
        let up = max(max(right, left) + max(above, below), tiny);
        let down = min(min(right, left) + min(above, below), -tiny);
        // how far it may go; the smaller share of the two by one division
        let may_up = max(extremes.highest[k][component] - v[k], zero);
        let may_down = min(extremes.lowest[k][component] - v[k], zero);
        let (may, goes) = if may_up * down > may_down * up { (may_up, up) } else { (may_down, down) };
        let scale = if *outruns { min(may / goes, one) } else { one };
        lx[k] = lx[k] * scale;
        lz[k] = lz[k] * scale;
    }
}

/// The smallest and largest velocities of the nodes of particle `k`.
#[inline(always)]
fn find<T: Real>(step: &Step<'_, T>, place: &Place<T>, k: usize, extremes: &mut Extremes<T>) {
    let Some([left, middle, right]) = bases(step.offset, place.column[k], place.row[k], 0) else { return };
    let columns = (run(step.velocity, left), run(step.velocity, middle), run(step.velocity, right));
    let (Some(left), Some(middle), Some(right)) = columns else { return };
    let first = T::V::load(&middle[1]);
    let (mut low, mut high) = (first, first);
    for nodes in [left, middle, right] {
        for node in nodes {
            let node = T::V::load(node);
            (low, high) = (node.min(low), node.max(high));
        }
    }
    low.store(&mut extremes.lowest[k]);
    high.store(&mut extremes.highest[k]);
}

//! Particles to grid and back in one pass over the particles: quadratic B-splines and APIC (Jiang et al. 2015, ACM Trans.
//! Graph. 34, 51) with the stress in its moving-least-squares form (Hu et al. 2018, ACM Trans. Graph. 37, 150).
//!
//! A node is four numbers. Of velocity: (x, z), twice, so that sums and moments are made in one register. Of what is given:
//! momentum along x and z, mass, and nothing.

use super::{
    dispatch::dispatched,
    lanes::{Real, ln_1p_pair, max, min},
    material::{FlowRule, Material},
    particles::{BLOCK, Block, Place},
    vector::Vector,
};

/// Lanes that go through the plastic return together.
const GROUP: usize = 16;

/// What a chunk's particles give to the nodes around them.
#[derive(Clone, Debug, Default)]
pub(super) struct ChunkGrid<T> {
    /// Number of the first node.
    pub(super) first: i32,
    /// Momentum along x and z, mass in particles, and 0 of each node.
    pub(super) nodes: Vec<[T; 4]>,
    /// Plastic work, in the units of stress.
    pub(super) plastic: f64,
    /// Particles that were not where the layout of the grid has them: a defect of the caller.
    pub(super) lost: u32,
}

impl<T: Real> ChunkGrid<T> {
    /// Nodes `first..end`, empty.
    pub(super) fn new(first: usize, end: usize) -> Self {
        Self {
            first: i32::try_from(first).unwrap_or(i32::MAX),
            nodes: vec![[T::of(0.0); 4]; end - first],
            plastic: 0.0,
            lost: 0,
        }
    }

    fn clear(&mut self) {
        self.nodes.fill([T::of(0.0); 4]);
        self.plastic = 0.0;
        self.lost = 0;
    }
}

/// Velocities and velocity gradients of the particles of a block, kept where someone wants to see them.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct Motion<T> {
    /// Cells a step.
    pub(super) vx: [T; BLOCK],
    pub(super) vz: [T; BLOCK],
    /// `dt grad v`: `lxz` is that of `vx` along z.
    pub(super) lxx: [T; BLOCK],
    pub(super) lxz: [T; BLOCK],
    pub(super) lzx: [T; BLOCK],
    pub(super) lzz: [T; BLOCK],
}

impl<T: Real> Default for Motion<T> {
    fn default() -> Self {
        let zero = [T::of(0.0); BLOCK];
        Self { vx: zero, vz: zero, lxx: zero, lxz: zero, lzx: zero, lzz: zero }
    }
}

/// What every chunk of a step reads.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step<'a, T> {
    /// Velocities of the nodes along x and z, twice, cells a step.
    pub(super) velocity: &'a [[T; 4]],
    /// For every column the number of its node at row 0, were there one.
    pub(super) offset: &'a [i32],
    pub(super) material: &'a Material<T>,
    /// Volumetric plastic strain above which the affine motion of what is nearly in free fall is limited.
    pub(super) limited_above: T,
    /// `fall (top - z)` is the square of the speed, cells a step, from which on that holds at the row `z`.
    pub(super) fall: T,
    pub(super) top: T,
}

/// What an audit reads: the same.
pub(super) type Audit<'a, T> = Step<'a, T>;

/// Arrays between the stages of a block.
#[repr(C, align(64))]
struct Scratch<T> {
    motion: Motion<T>,
    /// Velocity (x, z) and its moment along z (x, z): weighted sum, and above minus below.
    sums: [[T; 4]; BLOCK],
    /// Its moment along x: right minus left (x, z).
    across: [[T; 4]; BLOCK],
    /// Weights of the three columns and the three rows.
    weight: [[T; BLOCK]; 6],
    /// Smallest and largest velocities of the nine nodes.
    lowest: [[T; 4]; BLOCK],
    highest: [[T; 4]; BLOCK],
    /// Elastic strains and the direction of the deviatoric one.
    volumetric: [T; BLOCK],
    deviatoric: [T; BLOCK],
    axis_xx: [T; BLOCK],
    axis_xz: [T; BLOCK],
    /// Elastic left Cauchy-Green tensor at the step's start, less the identity.
    old_xx: [T; BLOCK],
    old_zz: [T; BLOCK],
    old_xz: [T; BLOCK],
    yielding: [T; BLOCK],
    /// Kirchhoff stress.
    txx: [T; BLOCK],
    tzz: [T; BLOCK],
    txz: [T; BLOCK],
    /// What is scattered: velocity at the nearest node and a mass of 1, and the slopes of the velocity along x and z.
    at_node: [[T; 4]; BLOCK],
    slope_x: [[T; 4]; BLOCK],
    slope_z: [[T; 4]; BLOCK],
}

impl<T: Real> Scratch<T> {
    fn new() -> Self {
        let zero = [T::of(0.0); BLOCK];
        let fours = [[T::of(0.0); 4]; BLOCK];
        Self {
            motion: Motion::default(),
            sums: fours,
            across: fours,
            weight: [zero; 6],
            lowest: fours,
            highest: fours,
            volumetric: zero,
            deviatoric: zero,
            axis_xx: zero,
            axis_xz: zero,
            old_xx: zero,
            old_zz: zero,
            old_xz: zero,
            yielding: zero,
            txx: zero,
            tzz: zero,
            txz: zero,
            at_node: fours,
            slope_x: fours,
            slope_z: fours,
        }
    }
}

/// Quadratic B-spline weights of three nodes in a row, of an offset from the middle one.
#[inline(always)]
pub(super) fn weights<T: Real>(g: T) -> [T; 3] {
    let half = T::of(0.5);
    let (a, b) = (half - g, half + g);
    [half * a * a, T::of(0.75) - g * g, half * b * b]
}

/// Numbers of the lowest of a particle's nodes in its three columns, less `first`.
#[inline(always)]
fn bases(offset: &[i32], column: i32, row: i32, first: i32) -> Option<[usize; 3]> {
    let columns = offset.get((column - 1) as usize..)?.first_chunk::<3>()?;
    let row = row - 1 - first;
    // a negative number becomes one that no slice has
    Some([(columns[0] + row) as usize, (columns[1] + row) as usize, (columns[2] + row) as usize])
}

/// The three nodes from number `base` on.
#[inline(always)]
fn three<T>(nodes: &[[T; 4]], base: usize) -> Option<&[[T; 4]; 3]> {
    nodes.get(base..)?.first_chunk()
}

#[inline(always)]
fn all_weights<T: Real>(place: &Place<T>, weight: &mut [[T; BLOCK]; 6]) {
    let [left, middle, right, below, level, above] = weight;
    for k in 0..BLOCK {
        [left[k], middle[k], right[k]] = weights(place.gx[k]);
        [below[k], level[k], above[k]] = weights(place.gz[k]);
    }
}

/// Sums over the nodes of every particle, from which velocities and gradients follow; returns how many had no nodes.
#[inline(always)]
fn gather<T: Real>(step: &Step<'_, T>, place: &Place<T>, scratch: &mut Scratch<T>) -> u32 {
    all_weights(place, &mut scratch.weight);
    let mut lost = 0;
    for k in 0..BLOCK {
        let Some(bases) = bases(step.offset, place.column[k], place.row[k], 0) else {
            lost += 1;
            continue;
        };
        let columns = (three(step.velocity, bases[0]), three(step.velocity, bases[1]), three(step.velocity, bases[2]));
        let (Some(left), Some(middle), Some(right)) = columns else {
            lost += 1;
            continue;
        };
        let weight = |i: usize| T::V::splat(scratch.weight[i][k]);
        // of a column: (sum, above minus below)
        let rows = [weight(3).flip_upper(), weight(4).lower(), weight(5)];
        let sum = |nodes: &[[T; 4]; 3]| {
            let [below, level, above] = [T::V::load(&nodes[0]), T::V::load(&nodes[1]), T::V::load(&nodes[2])];
            rows[0].mul(below).add(rows[2].mul(above)).add(rows[1].mul(level))
        };
        let (left, middle, right) = (weight(0).mul(sum(left)), weight(1).mul(sum(middle)), weight(2).mul(sum(right)));
        left.add(right).add(middle).store(&mut scratch.sums[k]);
        right.sub(left).store(&mut scratch.across[k]);
    }
    lost
}

/// Velocities and gradients from the sums.
#[inline(always)]
fn rates<T: Real>(place: &Place<T>, scratch: &mut Scratch<T>) {
    let Scratch { motion, sums, across, .. } = scratch;
    let four = T::of(4.0);
    for k in 0..BLOCK {
        let ([vx, vz, above_x, above_z], [right_x, right_z, ..]) = (sums[k], across[k]);
        let (gx, gz) = (place.gx[k], place.gz[k]);
        motion.vx[k] = vx;
        motion.vz[k] = vz;
        motion.lxx[k] = four * (right_x - gx * vx);
        motion.lzx[k] = four * (right_z - gx * vz);
        motion.lxz[k] = four * (above_x - gz * vx);
        motion.lzz[k] = four * (above_z - gz * vz);
    }
}

/// Moves the particles with their velocities.
#[inline(always)]
fn advance<T: Real>(motion: &Motion<T>, place: &mut Place<T>) {
    for k in 0..BLOCK {
        let (x, z) = (place.gx[k] + motion.vx[k], place.gz[k] + motion.vz[k]);
        let ((x_node, columns), (z_node, rows)) = (x.nearest(), z.nearest());
        place.gx[k] = x - x_node;
        place.gz[k] = z - z_node;
        place.column[k] += columns;
        place.row[k] += rows;
    }
}

/// Elastic trial strains of the deformation of the step, and the stress that they give.
#[inline(always)]
fn trial<T: Real>(material: &Material<T>, block: &mut Block<T>, scratch: &mut Scratch<T>) {
    let (half, one) = (T::of(0.5), T::of(1.0));
    let Scratch { motion, volumetric, deviatoric, axis_xx, axis_xz, yielding, txx, tzz, txz, .. } = scratch;
    (scratch.old_xx, scratch.old_zz, scratch.old_xz) = (block.bxx, block.bzz, block.bxz);
    for k in 0..BLOCK {
        let (xx, zz, xz) = (block.bxx[k], block.bzz[k], block.bxz[k]);
        let (lxx, lxz, lzx, lzz) = (motion.lxx[k], motion.lxz[k], motion.lzx[k], motion.lzz[k]);
        // (I + L) b (I + L)^T - I = B + N + N^T + N L^T with B = b - I and N = L + L B: nothing is ever added to 1
        let (nxx, nxz) = (lxx + (lxx * xx + lxz * xz), lxz + (lxx * xz + lxz * zz));
        let (nzx, nzz) = (lzx + (lzx * xx + lzz * xz), lzz + (lzx * xz + lzz * zz));
        let new_xx = xx + ((nxx + nxx) + (nxx * lxx + nxz * lxz));
        let new_zz = zz + ((nzz + nzz) + (nzx * lzx + nzz * lzz));
        let new_xz = xz + ((nxz + nzx) + (nxx * lzx + nxz * lzz));
        (block.bxx[k], block.bzz[k], block.bxz[k]) = (new_xx, new_zz, new_xz);
        // principal values of b - I and their logarithms
        let (mean, dxx) = (half * (new_xx + new_zz), half * (new_xx - new_zz));
        let radius = (dxx * dxx + new_xz * new_xz).sqrt();
        let (first, second) = ln_1p_pair(mean + radius, mean - radius);
        let (volume, shear) = (half * (first + second), T::of(0.25) * (first - second));
        let inverse = one / max(radius, T::of(1e-18));
        let (ax, az) = (dxx * inverse, new_xz * inverse);
        let strength = block.strength[k];
        (volumetric[k], deviatoric[k], axis_xx[k], axis_xz[k]) = (volume, shear, ax, az);
        yielding[k] = material.yielding(volume, shear, strength);
        let (isotropic, shear) = (material.bulk * volume, material.shear_2 * shear);
        (txx[k], tzz[k], txz[k]) = (isotropic + shear * ax, isotropic - shear * ax, shear * az);
    }
}

/// Deforms the particles of a block; returns the plastic work.
#[inline(always)]
fn deform<T: Real>(material: &Material<T>, block: &mut Block<T>, scratch: &mut Scratch<T>) -> f64 {
    trial(material, block, scratch);
    let mut work = 0.0;
    // no iterator: what is not inlined is not compiled for the wide registers
    for group in 0..BLOCK / GROUP {
        work += plastic_return(material, block, scratch, group);
    }
    work
}

/// The Kirchhoff stresses (xx, zz, xz) of a block after a deformation, and the plastic work, as a step computes them.
#[cfg(test)]
pub(super) fn deformed<T: Real>(
    material: &Material<T>,
    block: &mut Block<T>,
    motion: &Motion<T>,
) -> ([[T; BLOCK]; 3], f64) {
    let mut scratch = Scratch::new();
    scratch.motion = *motion;
    let work = deform(material, block, &mut scratch);
    ([scratch.txx, scratch.tzz, scratch.txz], work)
}

/// Brings the stresses of a group back to the yield surface, if any is outside; returns the plastic work.
#[inline(always)]
fn plastic_return<T: Real>(
    material: &Material<T>,
    block: &mut Block<T>,
    scratch: &mut Scratch<T>,
    group: usize,
) -> f64 {
    let (zero, two) = (T::of(0.0), T::of(2.0));
    let at = GROUP * group;
    let window = |values: &[T; BLOCK]| {
        let mut window = [zero; GROUP];
        window.copy_from_slice(&values[at..at + GROUP]);
        window
    };
    let (yielding, strength) = (window(&scratch.yielding), window(&block.strength));
    let (mut any, mut any_strong) = (0_u32, 0_u32);
    for k in 0..GROUP {
        any |= u32::from(yielding[k] > zero);
        any_strong |= u32::from((yielding[k] > zero) & (strength[k] > material.weakest));
    }
    if any == 0 {
        return 0.0;
    }
    let (volumetric, deviatoric) = (window(&scratch.volumetric), window(&scratch.deviatoric));
    let mut volume = [zero; GROUP];
    let mut shear = [zero; GROUP];
    let mut plastic = volumetric;
    let implicit = material.rule == FlowRule::AssociativeImplicit;
    // compaction gives strength even to what has none, but only within the step where hardening is implicit
    if any_strong != 0 || implicit {
        let returned = match material.rule {
            FlowRule::Associative => material.closest(&volumetric, &deviatoric, &strength),
            FlowRule::AssociativeImplicit => {
                material.implicit(&volumetric, &deviatoric, &window(&block.plastic_strain), &strength)
            }
            FlowRule::Nacc => material.nacc(&volumetric, &deviatoric, &strength),
        };
        for k in 0..GROUP {
            (volume[k], shear[k], plastic[k]) = (returned[k].volumetric, returned[k].shear, returned[k].plastic);
        }
    }
    let (axis_xx, axis_xz) = (window(&scratch.axis_xx), window(&scratch.axis_xz));
    let mut lost = [zero; GROUP];
    for k in 0..GROUP {
        let out = yielding[k] > zero;
        let q = shear[k] * deviatoric[k];
        let (first, second) =
            ((two * (volume[k] * T::of(0.5) + q)).exp_m1(), (two * (volume[k] * T::of(0.5) - q)).exp_m1());
        let (mean, radius) = (T::of(0.5) * (first + second), T::of(0.5) * (first - second));
        let i = at + k;
        let select = |new: T, old: T| if out { new } else { old };
        block.bxx[i] = select(mean + radius * axis_xx[k], block.bxx[i]);
        block.bzz[i] = select(mean - radius * axis_xx[k], block.bzz[i]);
        block.bxz[i] = select(radius * axis_xz[k], block.bxz[i]);
        let strain = select(block.plastic_strain[i] + plastic[k], block.plastic_strain[i]);
        block.plastic_strain[i] = strain;
        block.strength[i] = select(material.strength(strain), strength[k]);
        let (isotropic, deviator) = (material.bulk * volume[k], material.shear_2 * q);
        scratch.txx[i] = select(isotropic + deviator * axis_xx[k], scratch.txx[i]);
        scratch.tzz[i] = select(isotropic - deviator * axis_xx[k], scratch.tzz[i]);
        scratch.txz[i] = select(deviator * axis_xz[k], scratch.txz[i]);
        // the mean of the stresses at the step's start and end does the plastic work; the logarithm of what was elastic then
        // is that of a small strain: ln(I + B) = B - B^2 / 2
        let (xx, zz, xz) = (scratch.old_xx[i], scratch.old_zz[i], scratch.old_xz[i]);
        let half = T::of(0.5);
        let old_xx = half * (xx - half * (xx * xx + xz * xz));
        let old_zz = half * (zz - half * (zz * zz + xz * xz));
        let old_xz = half * (xz - half * (xz * (xx + zz)));
        let along_axis = half * (old_xx - old_zz) * axis_xx[k] + old_xz * axis_xz[k];
        let isotropic = half * material.bulk * (old_xx + old_zz + volume[k]) * plastic[k];
        let work = isotropic + material.shear_2 * (along_axis + q) * (deviatoric[k] - q);
        lost[k] = select(work, zero);
    }
    let count = block.len.saturating_sub(at).min(GROUP);
    let mut sum = 0.0;
    for lost in &lost[..count] {
        sum += lost.f64();
    }
    sum
}

/// What is scattered of velocities, gradients and stresses, at the new place.
#[inline(always)]
fn prepare<T: Real>(place: &Place<T>, scratch: &mut Scratch<T>) {
    all_weights(place, &mut scratch.weight);
    let Scratch { motion, txx, tzz, txz, at_node, slope_x, slope_z, .. } = scratch;
    let (zero, one) = (T::of(0.0), T::of(1.0));
    for k in 0..BLOCK {
        let (axx, azx) = (motion.lxx[k] - txx[k], motion.lzx[k] - txz[k]);
        let (axz, azz) = (motion.lxz[k] - txz[k], motion.lzz[k] - tzz[k]);
        let (gx, gz) = (place.gx[k], place.gz[k]);
        let vx = motion.vx[k] - (axx * gx + axz * gz);
        let vz = motion.vz[k] - (azx * gx + azz * gz);
        at_node[k] = [vx, vz, one, zero];
        slope_x[k] = [axx, azx, zero, zero];
        slope_z[k] = [axz, azz, zero, zero];
    }
}

/// Adds the particles' mass and momentum to their nodes; returns how many had none.
///
/// Particles that follow each other lie in one cell; they are visited 16 apart, so that a sum does not wait for the one
/// before it.
#[inline(always)]
fn scatter<T: Real>(
    offset: &[i32],
    place: &Place<T>,
    len: usize,
    scratch: &Scratch<T>,
    grid: &mut ChunkGrid<T>,
) -> u32 {
    let mut lost = 0;
    for visit in 0..BLOCK {
        let k = (visit % 4) * (BLOCK / 4) + visit / 4;
        if k >= len {
            continue;
        }
        let Some(bases) = bases(offset, place.column[k], place.row[k], grid.first) else {
            lost += 1;
            continue;
        };
        let weight = |i: usize| T::V::splat(scratch.weight[i][k]);
        let at_node = T::V::load(&scratch.at_node[k]);
        let (slope_x, slope_z) = (T::V::load(&scratch.slope_x[k]), T::V::load(&scratch.slope_z[k]));
        let rows = [weight(3), weight(4), weight(5)];
        let mut add = |base: usize, weight: T::V, level: T::V| {
            add_column(&mut grid.nodes, base, rows, weight.mul(level), weight.mul(slope_z))
        };
        // written out: a loop would go through memory
        lost += add(bases[0], weight(0), at_node.sub(slope_x));
        lost += add(bases[1], weight(1), at_node);
        lost += add(bases[2], weight(2), at_node.add(slope_x));
    }
    lost
}

/// Adds to the three nodes from `base` on `level`, less and plus `slope` below and above, with the weights of the rows;
/// returns 1 where there are no such nodes.
#[inline(always)]
fn add_column<T: Real>(nodes: &mut [[T; 4]], base: usize, rows: [T::V; 3], level: T::V, slope: T::V) -> u32 {
    let Some([below, middle, above]) = nodes.get_mut(base..).and_then(|rest| rest.first_chunk_mut::<3>()) else {
        return 1;
    };
    T::V::load(below).add(rows[0].mul(level.sub(slope))).store(below);
    T::V::load(middle).add(rows[1].mul(level)).store(middle);
    T::V::load(above).add(rows[2].mul(level.add(slope))).store(above);
    0
}

/// The particles' velocities from the grid, their deformation, stress and new places, and what they give to the grid again.
#[inline(always)]
fn step<T: Real>(step: &Step<'_, T>, blocks: &mut [Block<T>], motion: &mut [Motion<T>], grid: &mut ChunkGrid<T>) {
    grid.clear();
    let mut scratch = Scratch::new();
    let mut keep = motion.iter_mut();
    for block in blocks {
        grid.lost += gather(step, &block.place, &mut scratch);
        rates(&block.place, &mut scratch);
        if let Some(motion) = keep.next() {
            *motion = scratch.motion;
        }
        grid.plastic += deform(step.material, block, &mut scratch);
        limit(step, block, &mut scratch);
        advance(&scratch.motion, &mut block.place);
        prepare(&block.place, &mut scratch);
        grid.lost += scatter(step.offset, &block.place, block.len, &scratch, grid);
    }
}

/// What the particles would give to the grid if they carried no stress; nothing else changes.
#[inline(always)]
fn audit<T: Real>(step: &Audit<'_, T>, blocks: &[Block<T>], grid: &mut ChunkGrid<T>) {
    grid.clear();
    let mut scratch = Scratch::new();
    for block in blocks {
        let mut place = block.place;
        grid.lost += gather(step, &place, &mut scratch);
        rates(&place, &mut scratch);
        limit(step, block, &mut scratch);
        advance(&scratch.motion, &mut place);
        prepare(&place, &mut scratch);
        grid.lost += scatter(step.offset, &place, block.len, &scratch, grid);
    }
}

/// Limits the affine motion of dilated particles that are nearly in free fall, so that no node is given a velocity outside of
/// those of the particle's nodes (after Barth & Jespersen 1989, AIAA paper 89-0366).
///
/// At an unresolved edge the fit overshoots, and a lone particle would hand momentum to nodes that few share, again and
/// again: grains at twice the speed of free fall come of it. What comes near to a frictionless fall from the top of the slab is
/// on its way there; what is slower is left as it is, so that the flow does not feel the limit.
#[inline(always)]
fn limit<T: Real>(step: &Step<'_, T>, block: &Block<T>, scratch: &mut Scratch<T>) {
    let (mut any, mut outruns) = (0_u32, [false; BLOCK]);
    for k in 0..BLOCK {
        let (vx, vz) = (scratch.motion.vx[k], scratch.motion.vz[k]);
        let z = T::of(f64::from(block.place.row[k])) + block.place.gz[k];
        let faster = vx * vx + vz * vz > step.fall * (step.top - z);
        outruns[k] = (block.plastic_strain[k] > step.limited_above) & faster;
        any |= u32::from(outruns[k]);
    }
    if any == 0 {
        return;
    }
    for k in 0..BLOCK {
        if outruns[k] {
            extremes(step, &block.place, k, scratch);
        }
    }
    let (zero, one) = (T::of(0.0), T::of(1.0));
    let Scratch { motion, lowest, highest, .. } = scratch;
    let Motion { vx, vz, lxx, lxz, lzx, lzz } = motion;
    for (component, v, lx, lz) in [(0, vx, lxx, lxz), (1, vz, lzx, lzz)] {
        for k in 0..BLOCK {
            let (gx, gz) = (block.place.gx[k], block.place.gz[k]);
            // the furthest that v + C (x_i - x_p) goes up and down
            let (right, left) = (lx[k] * (one - gx), -(lx[k] * (one + gx)));
            let (above, below) = (lz[k] * (one - gz), -(lz[k] * (one + gz)));
            let up = max(right, left) + max(above, below);
            let down = min(right, left) + min(above, below);
            let tiny = T::of(1e-20);
            let up = max(highest[k][component] - v[k], zero) / max(up, tiny);
            let down = min(lowest[k][component] - v[k], zero) / min(down, -tiny);
            let scale = if outruns[k] { min(min(up, down), one) } else { one };
            lx[k] = lx[k] * scale;
            lz[k] = lz[k] * scale;
        }
    }
}

/// The smallest and largest velocities of the nodes of particle `k`.
#[inline(always)]
fn extremes<T: Real>(step: &Step<'_, T>, place: &Place<T>, k: usize, scratch: &mut Scratch<T>) {
    let Some([left, middle, right]) = bases(step.offset, place.column[k], place.row[k], 0) else { return };
    let columns = (three(step.velocity, left), three(step.velocity, middle), three(step.velocity, right));
    let (Some(left), Some(middle), Some(right)) = columns else { return };
    let first = T::V::load(&middle[1]);
    let (mut low, mut high) = (first, first);
    for node in left.iter().chain(middle).chain(right) {
        let node = T::V::load(node);
        (low, high) = (node.min(low), node.max(high));
    }
    low.store(&mut scratch.lowest[k]);
    high.store(&mut scratch.highest[k]);
}

dispatched!(step_f32 => step(
    input: &Step<'_, f32>, blocks: &mut [Block<f32>], motion: &mut [Motion<f32>], grid: &mut ChunkGrid<f32>
));
dispatched!(step_f64 => step(
    input: &Step<'_, f64>, blocks: &mut [Block<f64>], motion: &mut [Motion<f64>], grid: &mut ChunkGrid<f64>
));
dispatched!(audit_f32 => audit(input: &Audit<'_, f32>, blocks: &[Block<f32>], grid: &mut ChunkGrid<f32>));
dispatched!(audit_f64 => audit(input: &Audit<'_, f64>, blocks: &[Block<f64>], grid: &mut ChunkGrid<f64>));

//! Particles to grid and back in one pass over the particles: quadratic B-splines and APIC (Jiang et al. 2015, ACM Trans.
//! Graph. 34, 51) with the stress in its moving-least-squares form (Hu et al. 2018, ACM Trans. Graph. 37, 150).
//!
//! A node is four numbers. Of velocity: (x, z), twice, so that sums and moments are made in one register. Of what is given:
//! momentum along x and z, mass, and nothing.

use super::{
    dispatch::dispatched,
    lanes::Real,
    limit::{Extremes, limit},
    material::Material,
    particles::{BLOCK, Block, Flip, Place},
    stress::{Stress, deform},
    vector::Vector,
};

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
    /// The same from which on it holds whatever the strain.
    pub(super) free_fall: T,
    pub(super) top: T,
}

/// What an audit reads: the same.
pub(super) type Audit<'a, T> = Step<'a, T>;

/// Arrays between the stages of a block.
#[repr(C, align(64))]
struct Scratch<T> {
    motion: Motion<T>,
    /// Weights of the three columns and the three rows.
    weight: [[T; BLOCK]; 6],
    extremes: Extremes<T>,
    stress: Stress<T>,
    /// What is scattered: velocity at the nearest node and a mass of 1, and the slopes of the velocity along x and z.
    at_node: [[T; 4]; BLOCK],
    slope_x: [[T; 4]; BLOCK],
    slope_z: [[T; 4]; BLOCK],
}

impl<T: Real> Scratch<T> {
    fn new() -> Self {
        let fours = [[T::of(0.0); 4]; BLOCK];
        Self {
            motion: Motion::default(),
            weight: [[T::of(0.0); BLOCK]; 6],
            extremes: Extremes::new(),
            stress: Stress::new(),
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
pub(super) fn bases(offset: &[i32], column: i32, row: i32, first: i32) -> Option<[u32; 3]> {
    let [left, middle, right] = run(offset, (column - 1) as u32)?;
    let row = row - 1 - first;
    // a negative number becomes one that no slice has
    Some([(left + row) as u32, (middle + row) as u32, (right + row) as u32])
}

/// The three from number `base` on.
#[inline(always)]
pub(super) fn run<T>(all: &[T], base: u32) -> Option<&[T; 3]> {
    let base = base as usize;
    all.get(base..base.wrapping_add(3))?.first_chunk()
}

#[inline(always)]
fn all_weights<T: Real>(place: &Place<T>, weight: &mut [[T; BLOCK]; 6]) {
    let [left, middle, right, below, level, above] = weight;
    for k in 0..BLOCK {
        [left[k], middle[k], right[k]] = weights(place.gx[k]);
        [below[k], level[k], above[k]] = weights(place.gz[k]);
    }
}

/// Sums over the nodes of particle `k`: velocity (x, z) and its moment along z, above minus below; and that along x, right
/// minus left.
#[inline(always)]
fn sums<T: Real>(step: &Step<'_, T>, place: &Place<T>, weight: &[[T; BLOCK]; 6], k: usize) -> Option<(T::V, T::V)> {
    let [left, middle, right] = bases(step.offset, place.column[k], place.row[k], 0)?;
    let (left, middle) = (run(step.velocity, left)?, run(step.velocity, middle)?);
    let right = run(step.velocity, right)?;
    let weight = |i: usize| T::V::splat(weight[i][k]);
    // of a column: (sum, above minus below)
    let rows = [weight(3).flip_upper(), weight(4).lower(), weight(5)];
    let sum = |nodes: &[[T; 4]; 3]| {
        let [below, level, above] = [T::V::load(&nodes[0]), T::V::load(&nodes[1]), T::V::load(&nodes[2])];
        rows[2].mul_add(above, rows[1].mul_add(level, rows[0].mul(below)))
    };
    let (left, right) = (weight(0).mul(sum(left)), weight(2).mul(sum(right)));
    Some((weight(1).mul_add(sum(middle), left.add(right)), right.sub(left)))
}

/// Velocities and gradients of the particles; returns how many had no nodes.
#[inline(always)]
fn gather<T: Real>(step: &Step<'_, T>, place: &Place<T>, scratch: &mut Scratch<T>) -> u32 {
    all_weights(place, &mut scratch.weight);
    let Scratch { motion: Motion { vx, vz, lxx, lxz, lzx, lzz }, weight, .. } = scratch;
    let mut lost = 0;
    for four in 0..BLOCK / 4 {
        let mut of_particle = [(T::V::splat(T::of(0.0)), T::V::splat(T::of(0.0))); 4];
        for (i, of_particle) in of_particle.iter_mut().enumerate() {
            match sums(step, place, weight, 4 * four + i) {
                Some(sums) => *of_particle = sums,
                None => lost += 1,
            }
        }
        let [(a, p), (b, q), (c, r), (d, s)] = of_particle;
        let [x, z, above_x, above_z] = T::V::transpose([a, b, c, d]);
        let [right_x, right_z, ..] = T::V::transpose([p, q, r, s]);
        x.store(quarter(vx, four));
        z.store(quarter(vz, four));
        above_x.store(quarter(lxz, four));
        above_z.store(quarter(lzz, four));
        right_x.store(quarter(lxx, four));
        right_z.store(quarter(lzx, four));
    }
    let four = T::of(4.0);
    for k in 0..BLOCK {
        // the offset that the rounded weights mean: what moves as one has no gradient then, and keeps its spin
        let (gx, gz) = (weight[2][k] - weight[0][k], weight[5][k] - weight[3][k]);
        lxx[k] = four * (-gx).mul_add(vx[k], lxx[k]);
        lzx[k] = four * (-gx).mul_add(vz[k], lzx[k]);
        lxz[k] = four * (-gz).mul_add(vx[k], lxz[k]);
        lzz[k] = four * (-gz).mul_add(vz[k], lzz[k]);
    }
    lost
}

/// The four values from `4 * four` on.
#[inline(always)]
fn quarter<T>(values: &mut [T; BLOCK], four: usize) -> &mut [T; 4] {
    &mut values.as_chunks_mut().0[four]
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

/// The Kirchhoff stresses (xx, zz, xz) of a block after a deformation, and the plastic work, as a step computes them.
#[cfg(test)]
pub(super) fn deformed<T: Real>(
    material: &Material<T>,
    block: &mut Block<T>,
    motion: &Motion<T>,
) -> ([[T; BLOCK]; 3], f64) {
    let mut stress = Stress::new();
    deform(material, motion, block, &mut stress);
    ([stress.xx, stress.zz, stress.xz], stress.take_work())
}

/// What is scattered of velocities, gradients and stresses, at the new place.
#[inline(always)]
fn prepare<T: Real>(place: &Place<T>, scratch: &mut Scratch<T>) {
    all_weights(place, &mut scratch.weight);
    let Scratch { motion, weight, stress, at_node, slope_x, slope_z, .. } = scratch;
    let (zero, one) = (T::of(0.0), T::of(1.0));
    for k in 0..BLOCK {
        let (axx, azx) = (motion.lxx[k] - stress.xx[k], motion.lzx[k] - stress.xz[k]);
        let (axz, azz) = (motion.lxz[k] - stress.xz[k], motion.lzz[k] - stress.zz[k]);
        let (gx, gz) = (weight[2][k] - weight[0][k], weight[5][k] - weight[3][k]);
        let vx = (-axz).mul_add(gz, (-axx).mul_add(gx, motion.vx[k]));
        let vz = (-azz).mul_add(gz, (-azx).mul_add(gx, motion.vz[k]));
        at_node[k] = [vx, vz, one, zero];
        slope_x[k] = [axx, azx, zero, zero];
        slope_z[k] = [axz, azz, zero, zero];
    }
}

/// Adds the particles' mass and momentum to their nodes; returns how many had none.
///
/// Particles that follow each other lie in one cell; they are visited a quarter of the block apart, so that a sum does not
/// wait for the one before it.
#[inline(always)]
fn scatter<T: Real>(
    offset: &[i32],
    place: &Place<T>,
    len: usize,
    scratch: &Scratch<T>,
    grid: &mut ChunkGrid<T>,
) -> u32 {
    let mut lost = 0;
    for visit in 0..BLOCK / 4 {
        for quarter in 0..4 {
            let k = quarter * (BLOCK / 4) + visit;
            if k < len && give(offset, place, scratch, k, grid).is_none() {
                lost += 1;
            }
        }
    }
    lost
}

/// Adds the mass and momentum of particle `k` to its nodes, if it has any.
#[inline(always)]
fn give<T: Real>(
    offset: &[i32],
    place: &Place<T>,
    scratch: &Scratch<T>,
    k: usize,
    grid: &mut ChunkGrid<T>,
) -> Option<()> {
    let [left, middle, right] = bases(offset, place.column[k], place.row[k], grid.first)?;
    let weight = |i: usize| T::V::splat(scratch.weight[i][k]);
    let at_node = T::V::load(&scratch.at_node[k]);
    let (slope_x, slope_z) = (T::V::load(&scratch.slope_x[k]), T::V::load(&scratch.slope_z[k]));
    let rows = [weight(3), weight(4), weight(5)];
    // written out: a loop would go through memory
    let weights = weight(0);
    add_column(&mut grid.nodes, left, rows, weights.mul(at_node.sub(slope_x)), weights.mul(slope_z))?;
    let weights = weight(1);
    add_column(&mut grid.nodes, middle, rows, weights.mul(at_node), weights.mul(slope_z))?;
    let weights = weight(2);
    add_column(&mut grid.nodes, right, rows, weights.mul(at_node.add(slope_x)), weights.mul(slope_z))
}

/// Adds to the three nodes from `base` on `level`, less and plus `slope` below and above, with the weights of the rows, if
/// there are such nodes.
#[inline(always)]
fn add_column<T: Real>(nodes: &mut [[T; 4]], base: u32, rows: [T::V; 3], level: T::V, slope: T::V) -> Option<()> {
    let base = base as usize;
    let [below, middle, above] = nodes.get_mut(base..base.wrapping_add(3))?.first_chunk_mut()?;
    // not fused: compilers would put two nodes into one register, and reading them would wait for what wrote one of them
    T::V::load(below).add(rows[0].mul(level.sub(slope))).store(below);
    T::V::load(middle).add(rows[1].mul(level)).store(middle);
    T::V::load(above).add(rows[2].mul(level.add(slope))).store(above);
    Some(())
}

/// Gives the particles of a block back what the grid did not take: their velocities then are the FLIP blend.
#[inline(always)]
fn give_back<T: Real>(flip: &Flip<T>, motion: &mut Motion<T>) {
    for k in 0..BLOCK {
        motion.vx[k] += flip.rx[k];
        motion.vz[k] += flip.rz[k];
    }
}

/// The particles' velocities from the grid, their deformation, stress and new places, and what they give to the grid again.
///
/// `flip` is empty in plain APIC. Else the velocities that particles give are blended with their own (FLIP: Brackbill &
/// Ruppel 1986, J. Comput. Phys. 65, 314); they move with the grid, and give its gradient, in either case.
#[inline(always)]
fn step<T: Real>(
    step: &Step<'_, T>,
    blocks: &mut [Block<T>],
    motion: &mut [Motion<T>],
    flip: &mut [Flip<T>],
    grid: &mut ChunkGrid<T>,
) {
    grid.clear();
    let mut scratch = Scratch::new();
    let (mut keep, mut flip) = (motion.iter_mut(), flip.iter_mut());
    for block in blocks {
        grid.lost += gather(step, &block.place, &mut scratch);
        if let Some(motion) = keep.next() {
            *motion = scratch.motion;
        }
        deform(step.material, &scratch.motion, block, &mut scratch.stress);
        limit(step, block, &mut scratch.motion, &mut scratch.extremes);
        advance(&scratch.motion, &mut block.place);
        if let Some(flip) = flip.next() {
            give_back(flip, &mut scratch.motion);
            (flip.vx, flip.vz) = (scratch.motion.vx, scratch.motion.vz);
        }
        prepare(&block.place, &mut scratch);
        grid.lost += scatter(step.offset, &block.place, block.len, &scratch, grid);
    }
    grid.plastic = scratch.stress.take_work();
}

/// What the particles would give to the grid if they carried no stress; nothing else changes.
#[inline(always)]
fn audit<T: Real>(step: &Audit<'_, T>, blocks: &[Block<T>], flip: &[Flip<T>], grid: &mut ChunkGrid<T>) {
    grid.clear();
    let mut scratch = Scratch::new();
    let mut flip = flip.iter();
    for block in blocks {
        let mut place = block.place;
        grid.lost += gather(step, &place, &mut scratch);
        limit(step, block, &mut scratch.motion, &mut scratch.extremes);
        advance(&scratch.motion, &mut place);
        if let Some(flip) = flip.next() {
            give_back(flip, &mut scratch.motion);
        }
        prepare(&place, &mut scratch);
        grid.lost += scatter(step.offset, &place, block.len, &scratch, grid);
    }
}

/// What the grid did not take of the particles' velocities: `share` of their difference from those of `step`, which are the
/// velocities that the transfer alone gave to the nodes.
#[inline(always)]
fn remain<T: Real>(step: &Step<'_, T>, share: T, blocks: &[Block<T>], flip: &mut [Flip<T>]) {
    let mut scratch = Scratch::new();
    for (block, flip) in blocks.iter().zip(flip) {
        // who has no nodes was counted by the step
        gather(step, &block.place, &mut scratch);
        for k in 0..BLOCK {
            flip.rx[k] = share * (flip.vx[k] - scratch.motion.vx[k]);
            flip.rz[k] = share * (flip.vz[k] - scratch.motion.vz[k]);
        }
    }
}

dispatched!(step_f32 => step(
    input: &Step<'_, f32>, blocks: &mut [Block<f32>], motion: &mut [Motion<f32>], flip: &mut [Flip<f32>],
    grid: &mut ChunkGrid<f32>
));
dispatched!(step_f64 => step(
    input: &Step<'_, f64>, blocks: &mut [Block<f64>], motion: &mut [Motion<f64>], flip: &mut [Flip<f64>],
    grid: &mut ChunkGrid<f64>
));
dispatched!(audit_f32 => audit(
    input: &Audit<'_, f32>, blocks: &[Block<f32>], flip: &[Flip<f32>], grid: &mut ChunkGrid<f32>
));
dispatched!(audit_f64 => audit(
    input: &Audit<'_, f64>, blocks: &[Block<f64>], flip: &[Flip<f64>], grid: &mut ChunkGrid<f64>
));
dispatched!(remain_f32 => remain(input: &Step<'_, f32>, share: f32, blocks: &[Block<f32>], flip: &mut [Flip<f32>]));
dispatched!(remain_f64 => remain(input: &Step<'_, f64>, share: f64, blocks: &[Block<f64>], flip: &mut [Flip<f64>]));

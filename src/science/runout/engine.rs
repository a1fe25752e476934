//! The dynamics: explicit symplectic steps of particles and grid, in units of cells and steps.
//!
//! Between two steps the engine holds the particles at time `n` and the grid velocities that move them to `n + 1`.

use rayon::prelude::*;

use super::{
    grid::{BedColumn, DRIFT, Layout, NoLayout, Reduced, Reduction, STRIDE, Stage},
    lanes::Real,
    material::Material,
    particles::{BLOCK, Block, Flip, Particle},
    sort::sort,
    transfer::{ChunkGrid, Motion, Step, weights},
};

/// Every so many steps the losses of the transfer and at the bed are measured; between, they are taken to change linearly.
pub(super) const AUDIT_STEPS: u64 = 16;

/// Physical and numerical constants of a run.
#[derive(Clone, Debug)]
pub(super) struct Frame<T> {
    /// Cell size, m.
    pub(super) mesh_m: f64,
    pub(super) time_step_s: f64,
    /// Position of column 0, m; row 0 lies at height 0.
    pub(super) origin_m: f64,
    /// The bed in every column of the domain.
    pub(super) bed: Vec<BedColumn<T>>,
    /// Height from which potential energy counts, m.
    pub(super) lowest_m: f64,
    pub(super) material: Material<T>,
    /// Volumetric plastic strain at release.
    pub(super) plastic_strain_at_release: f64,
    pub(super) density_kg_m3: f64,
    /// Area of snow of a particle, m2.
    pub(super) particle_area_m2: f64,
    /// Acceleration of gravity, downwards, m/s2.
    pub(super) gravity_m_s2: f64,
    pub(super) friction: f64,
    pub(super) sticky: bool,
    /// Volumetric plastic strain above which the affine motion of what is nearly in free fall is limited, and the share of its
    /// speed from which on that holds; what is faster than free fall is limited whatever its strain.
    pub(super) limited_above: f64,
    pub(super) limited_beyond: f64,
    /// The share of FLIP in the velocities that particles give to the grid; 0 is APIC.
    pub(super) flip: f64,
    /// Height of the highest snow at release, m.
    pub(super) top_m: f64,
}

impl<T> Frame<T> {
    /// What a height in cells is multiplied with for the square of a share of the speed of free fall, in cells a step.
    fn fall(&self, share: f64) -> f64 {
        let unit = self.time_step_s * self.time_step_s / self.mesh_m;
        2.0 * self.gravity_m_s2 * unit * share * share
    }

    /// The same for all of that speed; in plain APIC no speed is too large.
    fn free_fall(&self) -> f64 {
        if self.limited_above.is_finite() { self.fall(1.0) } else { f64::INFINITY }
    }
}

/// A particle as it is released.
#[derive(Clone, Copy, Debug)]
pub(super) struct Released {
    /// Position, m.
    pub(super) position_m: [f64; 2],
    /// Velocity, m/s.
    pub(super) velocity_m_s: [f64; 2],
    /// Velocity gradient, 1/s: `[dvx/dx, dvx/dz, dvz/dx, dvz/dz]`.
    pub(super) gradient_1_s: [f64; 4],
}

/// Particles of a chunk, their motion where it was kept, and their own velocities where FLIP is blended in.
#[derive(Clone, Debug, Default)]
pub(super) struct ChunkParticles<T> {
    pub(super) blocks: Vec<Block<T>>,
    pub(super) motion: Vec<Motion<T>>,
    pub(super) flip: Vec<Flip<T>>,
}

/// Energies in particle masses times (cells a step)^2, summed over the steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct Ledger {
    pub(super) plastic: f64,
    /// Lost at the bed and by the transfer up to the step of the last measurement.
    pub(super) measured: [f64; 2],
    /// The same in that step.
    pub(super) rate: [f64; 2],
    /// Kinetic energy of the grid now.
    pub(super) grid: f64,
}

impl Ledger {
    /// Lost at the bed and by the transfer up to now.
    pub(super) fn lost(&self, steps: u64) -> [f64; 2] {
        let since = steps - steps.saturating_sub(1) / AUDIT_STEPS * AUDIT_STEPS;
        std::array::from_fn(|i| self.measured[i] + since as f64 * self.rate[i])
    }

    /// Takes the losses of a step that was measured.
    fn measure(&mut self, rate: [f64; 2], steps: u64) {
        if steps > 0 {
            for ((measured, before), now) in self.measured.iter_mut().zip(self.rate).zip(rate) {
                *measured += AUDIT_STEPS as f64 * 0.5 * (before + now);
            }
        }
        self.rate = rate;
    }
}

/// Why a run cannot go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Halt {
    /// The flow is at the edge of the domain.
    LeftDomain,
    /// Something is not finite, or moves by more than a cell a step.
    Diverged,
    /// The grid would have too many nodes.
    TooLarge,
}

impl From<NoLayout> for Halt {
    fn from(reason: NoLayout) -> Self {
        match reason {
            NoLayout::LeftDomain => Self::LeftDomain,
            NoLayout::TooLarge => Self::TooLarge,
        }
    }
}

/// The state of a run.
#[derive(Clone, Debug)]
pub(super) struct Engine<T> {
    pub(super) frame: Frame<T>,
    pub(super) layout: Layout,
    pub(super) chunks: Vec<ChunkParticles<T>>,
    pub(super) grids: Vec<ChunkGrid<T>>,
    /// Velocities of the nodes along x and z, twice, cells a step.
    pub(super) velocity: Vec<[T; 4]>,
    /// Cells that a particle may have moved since the particles were sorted.
    pub(super) drift: f64,
    /// The largest velocity component on the grid, cells a step.
    pub(super) fastest: f64,
    pub(super) steps: u64,
    pub(super) ledger: Ledger,
    /// Memory of the sorting before.
    spare: Vec<ChunkParticles<T>>,
}

impl<T: Real> Engine<T> {
    /// Particles at the nodes of the grid, at time 0.
    pub(super) fn new(frame: Frame<T>, released: &[Released]) -> Result<Self, Halt> {
        let strength = frame.material.strength(T::of(frame.plastic_strain_at_release));
        let particles: Vec<Particle<T>> = released
            .iter()
            .enumerate()
            .map(|(id, released)| {
                let place =
                    [(released.position_m[0] - frame.origin_m) / frame.mesh_m, released.position_m[1] / frame.mesh_m];
                let node = place.map(f64::round);
                Particle {
                    id: id as u32,
                    column: node[0] as i32,
                    row: node[1] as i32,
                    gx: T::of(place[0] - node[0]),
                    gz: T::of(place[1] - node[1]),
                    bxx: T::of(0.0),
                    bzz: T::of(0.0),
                    bxz: T::of(0.0),
                    plastic_strain: T::of(frame.plastic_strain_at_release),
                    strength,
                }
            })
            .collect();
        let mut engine = Self::assemble(frame);
        engine.arrange(&particles)?;
        let speed = engine.frame.time_step_s / engine.frame.mesh_m;
        let dt = engine.frame.time_step_s;
        for chunk in &mut engine.chunks {
            chunk.motion = vec![Motion::default(); chunk.blocks.len()];
            for (block, motion) in chunk.blocks.iter().zip(&mut chunk.motion) {
                for k in 0..block.len {
                    let Released { velocity_m_s: v, gradient_1_s: l, .. } = released[block.id[k] as usize];
                    (motion.vx[k], motion.vz[k]) = (T::of(v[0] * speed), T::of(v[1] * speed));
                    let l = l.map(|l| T::of(l * dt));
                    (motion.lxx[k], motion.lxz[k], motion.lzx[k], motion.lzz[k]) = (l[0], l[1], l[2], l[3]);
                }
            }
            if engine.frame.flip > 0.0 {
                let of_block = |motion: &Motion<T>| Flip { vx: motion.vx, vz: motion.vz, ..Flip::default() };
                chunk.flip = chunk.motion.iter().map(of_block).collect();
            }
        }
        engine.give_motion();
        if engine.frame.flip > 0.0 {
            let mut given = vec![[T::of(0.0); 4]; engine.layout.nodes()];
            engine.reduce_into(&mut given, Stage::Transferred);
            engine.keep_remainders(&given);
        }
        let reduced = engine.reduce(None);
        engine.settle(reduced)?;
        Ok(engine)
    }

    /// An engine without particles.
    pub(super) fn assemble(frame: Frame<T>) -> Self {
        Self {
            frame,
            layout: Layout::default(),
            chunks: Vec::new(),
            grids: Vec::new(),
            velocity: Vec::new(),
            drift: 0.0,
            fastest: 0.0,
            steps: 0,
            ledger: Ledger::default(),
            spare: Vec::new(),
        }
    }

    /// Number of particles.
    pub(super) fn particles(&self) -> usize {
        self.layout.chunks.last().map_or(0, |chunk| chunk.particles[1] as usize)
    }

    /// One step; keeps the particles' motion where `keep`.
    pub(super) fn step(&mut self, keep: bool) -> Result<(), Halt> {
        if self.drift + self.fastest > DRIFT {
            self.sort()?;
        }
        if self.fastest > STRIDE {
            return Err(Halt::Diverged);
        }
        self.drift += self.fastest;
        let (measured, blended) = (self.steps.is_multiple_of(AUDIT_STEPS), self.frame.flip > 0.0);
        let audited = (measured || blended).then(|| self.audit());
        self.move_particles(keep);
        if let Some((transferred, _)) = audited.as_ref().filter(|_| blended) {
            self.keep_remainders(transferred);
        }
        let audited = audited.filter(|_| measured);
        let reduced = self.reduce(audited.as_ref().map(|(transferred, _)| transferred.as_slice()));
        if let Some((_, transfer)) = audited {
            self.ledger.measure([reduced.bed, transfer], self.steps);
        }
        self.steps += 1;
        self.settle(reduced)
    }

    /// Books a step.
    fn settle(&mut self, reduced: Reduced) -> Result<(), Halt> {
        self.fastest = reduced.fastest;
        self.ledger.grid = reduced.kinetic;
        for grid in &self.grids {
            self.ledger.plastic += grid.plastic / 4.0;
        }
        let lost: u32 = self.grids.iter().map(|grid| grid.lost).sum();
        if reduced.kinetic.is_finite() && lost == 0 { Ok(()) } else { Err(Halt::Diverged) }
    }

    fn move_particles(&mut self, keep: bool) {
        let step = step_input(&self.frame, &self.layout, &self.velocity);
        self.chunks.par_iter_mut().zip(&mut self.grids).for_each(|(chunk, grid)| {
            let kept = if keep { chunk.blocks.len() } else { 0 };
            chunk.motion.resize(kept, Motion::default());
            T::step(&step, &mut chunk.blocks, &mut chunk.motion, &mut chunk.flip, grid);
        });
    }

    /// Keeps what the grid did not take of the particles' velocities; `transferred` are those of the nodes before any force.
    fn keep_remainders(&mut self, transferred: &[[T; 4]]) {
        let step = step_input(&self.frame, &self.layout, transferred);
        let share = T::of(self.frame.flip);
        self.chunks.par_iter_mut().for_each(|chunk| T::remain(&step, share, &chunk.blocks, &mut chunk.flip));
    }

    /// The velocities that the coming transfer alone gives to the nodes, and the energy that it loses.
    fn audit(&mut self) -> (Vec<[T; 4]>, f64) {
        let mut grids = std::mem::take(&mut self.grids);
        let step = step_input(&self.frame, &self.layout, &self.velocity);
        let chunks = self.chunks.par_iter().zip(&mut grids);
        chunks.for_each(|(chunk, grid)| T::audit(&step, &chunk.blocks, &chunk.flip, grid));
        self.grids = grids;
        let mut velocity = vec![[T::of(0.0); 4]; self.velocity.len()];
        let transferred = self.reduce_into(&mut velocity, Stage::Transferred);
        (velocity, self.ledger.grid - transferred.kinetic)
    }

    /// Velocities of all nodes from what the chunks gave, after the forces; `transferred` are those before.
    fn reduce(&mut self, transferred: Option<&[[T; 4]]>) -> Reduced {
        let mut velocity = std::mem::take(&mut self.velocity);
        let reduced = self.reduce_into(&mut velocity, Stage::Forced(transferred));
        self.velocity = velocity;
        reduced
    }

    fn reduce_into(&self, velocity: &mut [[T; 4]], stage: Stage<'_, T>) -> Reduced {
        let Self { frame, layout, grids, .. } = self;
        let gravity = frame.gravity_m_s2 * frame.time_step_s * frame.time_step_s / frame.mesh_m;
        let mut rest = velocity;
        let mut parts = Vec::with_capacity(layout.chunks.len());
        for span in &layout.chunks {
            let [from, to] = span.columns.map(|column| layout.start[column as usize] as usize);
            let (own, after) = rest.split_at_mut(to - from);
            parts.push((from..to, own));
            rest = after;
        }
        let of_chunk = |(chunk, (own, velocity)): (usize, (std::ops::Range<usize>, &mut [[T; 4]]))| {
            let stage = match stage {
                Stage::Forced(Some(transferred)) => Stage::Forced(transferred.get(own)),
                other => other,
            };
            let reduction = Reduction {
                layout,
                chunk,
                grids,
                bed: &frame.bed,
                gravity: T::of(gravity),
                friction: T::of(frame.friction),
                sticky: frame.sticky,
                stage,
            };
            T::reduce(&reduction, velocity)
        };
        let reduced: Vec<Reduced> = parts.into_par_iter().enumerate().map(of_chunk).collect();
        reduced.iter().fold(Reduced::default(), |sum, part| Reduced {
            kinetic: sum.kinetic + part.kinetic,
            bed: sum.bed + part.bed,
            fastest: sum.fastest.max(part.fastest),
        })
    }

    /// Sorts the particles by cell and lays the grid out around them.
    fn sort(&mut self) -> Result<(), Halt> {
        let mut sorted = std::mem::take(&mut self.spare);
        let layout = sort(&self.chunks, self.frame.bed.len(), self.frame.material.weakest, &mut sorted)?;
        self.velocity = layout.carry(&self.layout, &self.velocity);
        self.spare = std::mem::replace(&mut self.chunks, sorted);
        self.adopt(layout);
        Ok(())
    }

    /// Puts particles in the order of release into cells.
    fn arrange(&mut self, particles: &[Particle<T>]) -> Result<(), Halt> {
        let released = [ChunkParticles { blocks: blocks_of(particles), ..ChunkParticles::default() }];
        let layout = sort(&released, self.frame.bed.len(), self.frame.material.weakest, &mut self.chunks)?;
        self.velocity = vec![[T::of(0.0); 4]; layout.nodes()];
        self.adopt(layout);
        Ok(())
    }

    /// Takes a layout over, with empty grids.
    pub(super) fn adopt(&mut self, layout: Layout) {
        let of_span = |nodes: [u32; 2]| ChunkGrid::new(nodes[0] as usize, nodes[1] as usize);
        self.grids = layout.chunks.iter().map(|chunk| of_span(chunk.nodes)).collect();
        self.layout = layout;
        self.drift = 0.0;
    }

    pub(super) fn blocks(&self) -> impl Iterator<Item = &Block<T>> {
        self.chunks.iter().flat_map(|chunk| &chunk.blocks)
    }

    /// Gives the kept motion of the particles to the grid, as it is released: without stress.
    fn give_motion(&mut self) {
        for (chunk, grid) in self.chunks.iter().zip(&mut self.grids) {
            for (block, motion) in chunk.blocks.iter().zip(&chunk.motion) {
                for k in 0..block.len {
                    give(&self.layout, block, motion, k, grid);
                }
            }
        }
    }
}

/// What every chunk reads of a grid with these velocities.
fn step_input<'a, T: Real>(frame: &'a Frame<T>, layout: &'a Layout, velocity: &'a [[T; 4]]) -> Step<'a, T> {
    Step {
        velocity,
        offset: &layout.offset,
        material: &frame.material,
        limited_above: T::of(frame.limited_above),
        fall: T::of(frame.fall(frame.limited_beyond)),
        free_fall: T::of(frame.free_fall()),
        top: T::of(frame.top_m / frame.mesh_m),
    }
}

/// Gives the mass and momentum of one particle to the grid.
fn give<T: Real>(layout: &Layout, block: &Block<T>, motion: &Motion<T>, k: usize, grid: &mut ChunkGrid<T>) {
    let (gx, gz) = (block.place.gx[k], block.place.gz[k]);
    let (wx, wz) = (weights(gx), weights(gz));
    for (i, &wx) in wx.iter().enumerate() {
        for (j, &wz) in wz.iter().enumerate() {
            let (dx, dz) = (T::of(i as f64 - 1.0) - gx, T::of(j as f64 - 1.0) - gz);
            let node = layout.node(block.place.column[k] + i as i32 - 1, block.place.row[k] + j as i32 - 1);
            let w = wx * wz;
            let node = &mut grid.nodes[node - grid.first as usize];
            node[0] += w * (motion.vx[k] + motion.lxx[k] * dx + motion.lxz[k] * dz);
            node[1] += w * (motion.vz[k] + motion.lzx[k] * dx + motion.lzz[k] * dz);
            node[2] += w;
        }
    }
}

/// Particles one after the other in blocks.
pub(super) fn blocks_of<T: Real>(particles: &[Particle<T>]) -> Vec<Block<T>> {
    let block_of = |particles: &[Particle<T>]| {
        let mut block = Block::empty(particles[0].column, particles[0].row);
        for (k, particle) in particles.iter().enumerate() {
            block.set(k, particle);
        }
        block.len = particles.len();
        block
    };
    particles.chunks(BLOCK).map(block_of).collect()
}

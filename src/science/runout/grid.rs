//! The grid: of every column only the span of nodes around its particles, one column packed after the other.
//!
//! A layout holds from one sorting of the particles to the next, in which no particle moves by more than [`DRIFT`] cells.
//! Chunks are runs of columns; a chunk's particles give to a grid of its own, and the grids are added in a fixed order.

use serde::{Deserialize, Serialize};

use super::{
    dispatch::dispatched,
    lanes::{Real, max},
    particles::{BLOCK, Particle},
    transfer::ChunkGrid,
    vector::Vector,
};

/// Cells that a particle may move in a step.
pub(super) const STRIDE: f64 = 0.95;
/// Cells that a particle may move before the particles are sorted again.
pub(super) const DRIFT: f64 = 1.95;
/// Columns and rows beyond a particle's cell that it may reach: two by drift, one by its spline.
const REACH: usize = 3;
/// Columns that a chunk has at least, so that only neighbours share nodes.
const NARROWEST: usize = 2 * REACH + 2;
/// Particles of a chunk, about: few enough that two cores share a small run, so many that shared columns cost little.
const CHUNK: usize = 16_384;
/// Nodes whose energies are summed in the precision of the run; the sums of so many are summed in `f64`.
const TALLY: usize = 256;

/// The bed as a column of nodes meets it.
#[derive(Clone, Copy, Debug)]
pub(super) struct BedColumn<T> {
    /// The highest row inside of the bed.
    pub(super) row: i32,
    /// Unit normal, out of the bed.
    pub(super) nx: T,
    pub(super) nz: T,
}

/// A run of columns with its particles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct ChunkSpan {
    /// Columns, from and up to.
    pub(super) columns: [u32; 2],
    /// Particles, from and up to in sorted order.
    pub(super) particles: [u32; 2],
    /// Nodes that its particles may reach, from and up to.
    pub(super) nodes: [u32; 2],
}

impl ChunkSpan {
    pub(super) fn blocks(&self) -> usize {
        ((self.particles[1] - self.particles[0]) as usize).div_ceil(BLOCK)
    }
}

/// Where the nodes are.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Layout {
    /// For every column the number of its node at row 0, were there one.
    pub(super) offset: Vec<i32>,
    /// For every column its lowest row.
    pub(super) lowest: Vec<i32>,
    /// For every column the number of its first node; one entry more than columns.
    pub(super) start: Vec<u32>,
    pub(super) chunks: Vec<ChunkSpan>,
}

/// What is in a column.
#[derive(Clone, Copy, Debug)]
pub(super) struct Occupied {
    pub(super) particles: u32,
    /// Rows of its particles.
    lowest: i32,
    highest: i32,
}

impl Default for Occupied {
    fn default() -> Self {
        Self { particles: 0, lowest: i32::MAX, highest: i32::MIN }
    }
}

impl Occupied {
    /// One more particle.
    #[inline(always)]
    pub(super) fn add(&mut self, row: i32) {
        self.particles += 1;
        self.lowest = self.lowest.min(row);
        self.highest = self.highest.max(row);
    }

    /// All that are in the same column elsewhere.
    pub(super) fn merge(&mut self, other: &Self) {
        self.particles += other.particles;
        self.lowest = self.lowest.min(other.lowest);
        self.highest = self.highest.max(other.highest);
    }
}

/// Why there is no layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NoLayout {
    /// A particle is at the edge of the domain.
    LeftDomain,
    /// The nodes cannot be numbered.
    TooLarge,
}

impl Layout {
    /// Number of nodes.
    pub(super) fn nodes(&self) -> usize {
        self.start.last().map_or(0, |&end| end as usize)
    }

    /// Nodes of a column, from and up to.
    pub(super) fn column(&self, column: usize) -> std::ops::Range<usize> {
        self.start[column] as usize..self.start[column + 1] as usize
    }

    /// Number of the node that is nearest to a particle; it is one of the layout's for every particle that made it.
    pub(super) fn node(&self, column: i32, row: i32) -> usize {
        (self.offset[column as usize] + row) as usize
    }

    /// The layout for particles in these columns.
    pub(super) fn around(occupied: &[Occupied]) -> Result<Self, NoLayout> {
        let columns = occupied.len();
        let edge = REACH.min(columns);
        if occupied[..edge].iter().chain(&occupied[columns - edge..]).any(|column| column.particles > 0) {
            return Err(NoLayout::LeftDomain);
        }
        let (mut offset, mut lowest, mut start) = (Vec::new(), Vec::new(), vec![0]);
        let mut nodes = 0_i32;
        let reach = REACH as i32;
        for column in 0..columns {
            let near = &occupied[column.saturating_sub(REACH)..(column + REACH + 1).min(columns)];
            let (low, high) = near.iter().fold((i32::MAX, i32::MIN), |(l, h), c| (l.min(c.lowest), h.max(c.highest)));
            let empty = low > high;
            let low = if empty { 0 } else { low.saturating_sub(reach) };
            let length = if empty { 0 } else { high.saturating_add(reach + 1).saturating_sub(low) };
            offset.push(nodes.saturating_sub(low));
            lowest.push(low);
            nodes = nodes.checked_add(length).filter(|&nodes| nodes < 1 << 28).ok_or(NoLayout::TooLarge)?;
            start.push(nodes as u32);
        }
        let mut layout = Self { offset, lowest, start, chunks: Vec::new() };
        layout.cut(occupied);
        Ok(layout)
    }

    /// Cuts the columns into chunks of about [`CHUNK`] particles.
    ///
    /// How many there are depends on the particles alone, so that sums have one order on every machine.
    fn cut(&mut self, occupied: &[Occupied]) {
        let columns = occupied.len();
        let mut before = vec![0; columns + 1];
        for (column, occupied) in occupied.iter().enumerate() {
            before[column + 1] = before[column] + occupied.particles as usize;
        }
        let particles = before[columns];
        let wanted = (particles / CHUNK).max(1);
        let mut chunks: Vec<ChunkSpan> = Vec::with_capacity(wanted);
        let mut from = 0;
        while from < columns {
            let target = particles * (chunks.len() + 1) / wanted;
            let mut to = (from + NARROWEST).min(columns);
            while to < columns && before[to] < target {
                to += 1;
            }
            if columns - to < NARROWEST || chunks.len() + 1 == wanted {
                to = columns;
            }
            let nodes = [self.start[from.saturating_sub(REACH)], self.start[(to + REACH).min(columns)]];
            let particles = [before[from] as u32, before[to] as u32];
            chunks.push(ChunkSpan { columns: [from as u32, to as u32], particles, nodes });
            from = to;
        }
        self.chunks = chunks;
    }

    /// Velocities of nodes, brought from the layout `old` to this one; 0 where `old` has no node.
    pub(super) fn carry<T: Real>(&self, old: &Self, values: &[[T; 4]]) -> Vec<[T; 4]> {
        let mut out = vec![[T::of(0.0); 4]; self.nodes()];
        for column in 0..self.lowest.len().min(old.lowest.len()) {
            let (new_span, old_span) = (self.column(column), old.column(column));
            let (new_low, old_low) = (self.lowest[column], old.lowest[column]);
            let low = new_low.max(old_low);
            let high = (new_low + new_span.len() as i32).min(old_low + old_span.len() as i32);
            if low < high && !new_span.is_empty() && !old_span.is_empty() {
                let count = (high - low) as usize;
                let to = new_span.start + (low - new_low) as usize;
                let from = old_span.start + (low - old_low) as usize;
                out[to..to + count].copy_from_slice(&values[from..from + count]);
            }
        }
        out
    }

    /// Whether this is a layout that particles in these cells may use, so that nothing can reach beyond it.
    pub(super) fn fits<T>(&self, particles: &[Particle<T>], columns: usize) -> bool {
        let shaped = self.offset.len() == columns && self.lowest.len() == columns && self.start.len() == columns + 1;
        let rising = self.start.first() == Some(&0) && self.start.windows(2).all(|pair| pair[0] <= pair[1]);
        if !shaped || !rising || self.nodes() >= 1 << 28 {
            return false;
        }
        let chained = |values: fn(&ChunkSpan) -> [u32; 2], end: u32| {
            let ends = self.chunks.last().is_some_and(|chunk| values(chunk)[1] == end);
            let first = self.chunks.first().is_some_and(|chunk| values(chunk)[0] == 0);
            ends && first && self.chunks.windows(2).all(|pair| values(&pair[0])[1] == values(&pair[1])[0])
        };
        let spans = self.chunks.iter().all(|chunk| {
            chunk.columns[0] <= chunk.columns[1]
                && chunk.particles[0] <= chunk.particles[1]
                && chunk.nodes[0] <= chunk.nodes[1]
                && chunk.nodes[1] as usize <= self.nodes()
                && self.start.get(chunk.columns[0] as usize).is_some_and(|first| chunk.nodes[0] <= *first)
                && self.start.get(chunk.columns[1] as usize).is_some_and(|end| *end <= chunk.nodes[1])
        });
        let numbered = (0..columns).all(|c| self.offset[c] == (self.start[c] as i32).saturating_sub(self.lowest[c]));
        let placed = particles.iter().all(|particle| {
            (REACH as i32..columns as i32 - REACH as i32).contains(&particle.column) && {
                let column = particle.column as usize;
                let row = i64::from(particle.row) - i64::from(self.lowest[column]);
                (0..self.column(column).len() as i64).contains(&row)
            }
        });
        spans
            && numbered
            && placed
            && chained(|chunk| chunk.columns, columns as u32)
            && chained(|chunk| chunk.particles, particles.len() as u32)
    }
}

/// What a chunk reads to find the velocities of its nodes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reduction<'a, T> {
    pub(super) layout: &'a Layout,
    pub(super) chunk: usize,
    pub(super) grids: &'a [ChunkGrid<T>],
    pub(super) bed: &'a [BedColumn<T>],
    /// Cells a step a step.
    pub(super) gravity: T,
    pub(super) friction: T,
    /// The bed holds what touches it.
    pub(super) sticky: bool,
    /// What is asked for.
    pub(super) stage: Stage<'a, T>,
}

/// What is made of the momenta of a chunk's nodes.
#[derive(Clone, Copy, Debug)]
pub(super) enum Stage<'a, T> {
    /// Their velocities, without any force.
    Transferred,
    /// Their velocities after gravity and the bed. Where the velocities are known that they had before all forces of the
    /// step, those of stress included, the work of the bed is measured.
    Forced(Option<&'a [[T; 4]]>),
}

/// What a chunk's nodes amount to; energies in particle masses times (cells a step)^2.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Reduced {
    /// Kinetic energy.
    pub(super) kinetic: f64,
    /// Energy lost at the bed, where it was measured: its impulse times the mean velocity of the step.
    pub(super) bed: f64,
    /// The largest velocity component of any node, before or after it met the bed, cells a step.
    pub(super) fastest: f64,
}

/// Adds the chunk grids over the columns of one chunk, makes velocities of momenta and applies gravity and the bed.
///
/// `velocity` has the chunk's own nodes.
#[inline(always)]
fn reduce_nodes<T: Real>(input: &Reduction<'_, T>, velocity: &mut [[T; 4]]) -> Reduced {
    let Reduction { layout, chunk, grids, .. } = *input;
    let columns = layout.chunks[chunk].columns.map(|column| column as usize);
    let from = layout.start[columns[0]] as usize;
    let gravity = if matches!(input.stage, Stage::Transferred) { T::of(0.0) } else { input.gravity };
    let mut mass = Vec::with_capacity(velocity.len() + 4);
    let mut momenta = [[T::of(0.0); 4]; TALLY];
    let mut reduced = Reduced::default();
    for (part, nodes) in velocity.chunks_mut(TALLY).enumerate() {
        let at = from + TALLY * part;
        sum_of_chunks(layout, chunk, grids, at, &mut momenta[..nodes.len()]);
        let (kinetic, fastest) = divide(&momenta, nodes, &mut mass, gravity);
        reduced.kinetic += kinetic;
        reduced.fastest = reduced.fastest.max(fastest.f64());
    }
    if let Stage::Forced(before) = input.stage {
        contact(input, velocity, &mass, before, &mut reduced);
    }
    reduced
}

/// What a chunk and its neighbours gave to the nodes from number `at` on, which are the chunk's own.
#[inline(always)]
fn sum_of_chunks<T: Real>(layout: &Layout, chunk: usize, grids: &[ChunkGrid<T>], at: usize, momenta: &mut [[T; 4]]) {
    // what the chunk itself gave covers all of its nodes
    let own = at - layout.chunks[chunk].nodes[0] as usize;
    momenta.copy_from_slice(&grids[chunk].nodes[own..own + momenta.len()]);
    for (other, grid) in grids.iter().enumerate().take(chunk + 2).skip(chunk.saturating_sub(1)) {
        let [first, end] = layout.chunks[other].nodes.map(|node| node as usize);
        let (low, high) = (first.max(at), end.min(at + momenta.len()));
        if other == chunk || low >= high {
            continue;
        }
        let given = &grid.nodes[low - first..high - first];
        for (sum, given) in momenta[low - at..high - at].iter_mut().zip(given) {
            *sum = [sum[0] + given[0], sum[1] + given[1], sum[2] + given[2], T::of(0.0)];
        }
    }
}

/// Velocities of at most [`TALLY`] nodes, which fall; appends their masses. Returns their kinetic energy and largest velocity
/// component.
#[inline(always)]
fn divide<T: Real>(momenta: &[[T; 4]; TALLY], nodes: &mut [[T; 4]], mass: &mut Vec<T>, gravity: T) -> (f64, T) {
    let (zero, one) = (T::V::splat(T::of(0.0)), T::V::splat(T::of(1.0)));
    // nothing falls where nothing is
    let (tiny, huge) = (T::V::splat(T::of(1e-30)), T::V::splat(T::of(1e30)));
    let (gravity, half) = (T::V::splat(gravity), T::V::splat(T::of(0.5)));
    let (mut kinetic, mut fastest) = (zero, zero);
    let mut four_of = |momenta: &[[T; 4]; 4], nodes: &mut [[T; 4]; 4]| {
        let [px, pz, m, _] = T::V::transpose([
            T::V::load(&momenta[0]),
            T::V::load(&momenta[1]),
            T::V::load(&momenta[2]),
            T::V::load(&momenta[3]),
        ]);
        let inverse = one.div(m.max(tiny));
        let (vx, vz) = (px.mul(inverse), pz.mul(inverse).sub(gravity.mul(m.mul(huge).min(one))));
        kinetic = m.mul(half).mul_add(vx.mul_add(vx, vz.mul(vz)), kinetic);
        fastest = vx.max(zero.sub(vx)).max(vz.max(zero.sub(vz))).max(fastest);
        let rows = T::V::transpose([vx, vz, vx, vz]);
        rows[0].store(&mut nodes[0]);
        rows[1].store(&mut nodes[1]);
        rows[2].store(&mut nodes[2]);
        rows[3].store(&mut nodes[3]);
        let mut masses = [T::of(0.0); 4];
        m.store(&mut masses);
        mass.extend_from_slice(&masses);
    };
    let (momenta, _) = momenta.as_chunks::<4>();
    let (fours, rest) = nodes.as_chunks_mut::<4>();
    let whole = fours.len();
    for (momenta, nodes) in momenta.iter().zip(fours) {
        four_of(momenta, nodes);
    }
    if !rest.is_empty() {
        // beyond the last node lie the momenta of others, or none
        let (mut given, mut last) = ([[T::of(0.0); 4]; 4], [[T::of(0.0); 4]; 4]);
        given[..rest.len()].copy_from_slice(&momenta[whole][..rest.len()]);
        four_of(&given, &mut last);
        rest.copy_from_slice(&last[..rest.len()]);
    }
    let (mut sums, mut largest) = ([T::of(0.0); 4], [T::of(0.0); 4]);
    kinetic.store(&mut sums);
    fastest.store(&mut largest);
    let sum = sums.iter().map(|sum| sum.f64()).sum();
    (sum, max(max(largest[0], largest[1]), max(largest[2], largest[3])))
}

/// Lets the nodes inside of the bed meet it and corrects what they amount to; the energy that is lost is measured where the
/// velocities `before` all forces are known.
#[inline(always)]
fn contact<T: Real>(
    input: &Reduction<'_, T>,
    velocity: &mut [[T; 4]],
    mass: &[T],
    before: Option<&[[T; 4]]>,
    reduced: &mut Reduced,
) {
    let Reduction { layout, chunk, .. } = *input;
    let columns = layout.chunks[chunk].columns.map(|column| column as usize);
    let from = layout.start[columns[0]] as usize;
    for column in columns[0]..columns[1] {
        let rows = layout.column(column);
        let inside = (input.bed[column].row - layout.lowest[column] + 1).clamp(0, rows.len() as i32) as usize;
        let (mut slower, mut fastest) = (T::of(0.0), T::of(0.0));
        for node in rows.start - from..rows.start - from + inside {
            let (free, mass) = ([velocity[node][0], velocity[node][1]], mass[node]);
            if mass == T::of(0.0) {
                continue;
            }
            let held = meet(free, &input.bed[column], input.friction, input.sticky);
            velocity[node] = [held[0], held[1], held[0], held[1]];
            let square = |v: [T; 2]| v[0] * v[0] + v[1] * v[1];
            slower += mass * (square(free) - square(held));
            fastest = max(max(max(held[0], -held[0]), max(held[1], -held[1])), fastest);
            if let Some(before) = before {
                let work = (held[0] - free[0]) * (held[0] + before[node][0])
                    + (held[1] - free[1]) * (held[1] + before[node][1]);
                reduced.bed -= 0.5 * (mass * work).f64();
            }
        }
        reduced.kinetic -= 0.5 * slower.f64();
        reduced.fastest = reduced.fastest.max(fastest.f64());
    }
}

/// The velocity of a node inside of the bed after its contact: Coulomb friction of what moves into the bed, nothing where it
/// moves out, and rest where the bed is sticky.
#[inline(always)]
fn meet<T: Real>(v: [T; 2], bed: &BedColumn<T>, friction: T, sticky: bool) -> [T; 2] {
    let zero = T::of(0.0);
    let normal = v[0] * bed.nx + v[1] * bed.nz;
    if sticky {
        return [zero; 2];
    }
    if normal >= zero {
        return v;
    }
    let along = v[0] * bed.nz - v[1] * bed.nx;
    let braked = friction * normal;
    // the impulse of the bed brakes by at most what there is
    let along = if along > zero {
        if along + braked > zero { along + braked } else { zero }
    } else if along - braked < zero {
        along - braked
    } else {
        zero
    };
    [along * bed.nz, -(along * bed.nx)]
}

dispatched!(reduce_f32 => reduce_nodes(input: &Reduction<'_, f32>, velocity: &mut [[f32; 4]]) -> Reduced);
dispatched!(reduce_f64 => reduce_nodes(input: &Reduction<'_, f64>, velocity: &mut [[f64; 4]]) -> Reduced);

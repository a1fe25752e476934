//! Sorting of the particles by cell, into chunks of columns that threads fill side by side.
//!
//! In each column the particles that carry no stress come after the others, so that most groups of lanes have either the
//! whole plastic return before them or none of it.

use rayon::prelude::*;

use super::{
    engine::ChunkParticles,
    grid::{ChunkSpan, Layout, NoLayout, Occupied},
    lanes::Real,
    particles::{BLOCK, Block, Flip},
};

/// Columns that the particles of a chunk are in, and of each its rows and number of particles.
struct Census {
    first: i32,
    columns: Vec<Occupied>,
}

/// Least and largest column of a block's lanes, fillers included.
#[inline]
fn reach<T>(block: &Block<T>) -> (i32, i32) {
    block.place.column.iter().fold((i32::MAX, i32::MIN), |(low, high), &c| (low.min(c), high.max(c)))
}

impl Census {
    /// Particles whose columns are within `0..limit`, or none.
    fn new<T: Real>(particles: &ChunkParticles<T>, limit: usize) -> Option<Self> {
        let (first, last) = particles.blocks.iter().fold((i32::MAX, i32::MIN), |(low, high), block| {
            let of_block = reach(block);
            (low.min(of_block.0), high.max(of_block.1))
        });
        if first > last {
            return Some(Self { first: 0, columns: Vec::new() });
        }
        if first < 0 || last as usize >= limit {
            return None;
        }
        let mut columns = vec![Occupied::default(); (last - first) as usize + 1];
        for block in &particles.blocks {
            for k in 0..block.len.min(BLOCK) {
                columns[(block.place.column[k] - first) as usize].add(block.place.row[k]);
            }
        }
        Some(Self { first, columns })
    }
}

/// Sorts particles, in any chunks, into the chunks of a layout around them. What has at most the strength `weakest` carries
/// no stress; `sorted` lends its memory. The order depends on that of the particles alone.
pub(super) fn sort<T: Real>(
    particles: &[ChunkParticles<T>],
    columns: usize,
    weakest: T,
    sorted: &mut Vec<ChunkParticles<T>>,
) -> Result<Layout, NoLayout> {
    let censuses: Option<Vec<Census>> = particles.par_iter().map(|chunk| Census::new(chunk, columns)).collect();
    let censuses = censuses.ok_or(NoLayout::LeftDomain)?;
    let mut occupied = vec![Occupied::default(); columns];
    for census in &censuses {
        for (sum, column) in occupied[census.first as usize..].iter_mut().zip(&census.columns) {
            sum.merge(column);
        }
    }
    let layout = Layout::around(&occupied)?;
    sorted.resize_with(layout.chunks.len(), ChunkParticles::default);
    sorted.par_iter_mut().zip(&layout.chunks).for_each(|(chunk, span)| {
        let near = particles.iter().zip(&censuses).filter(|(_, census)| {
            let [from, to] = span.columns.map(|column| column as i32);
            census.first < to && from < census.first + census.columns.len() as i32
        });
        fill(&layout, span, weakest, &near.map(|(particles, _)| particles).collect::<Vec<_>>(), chunk);
    });
    Ok(layout)
}

/// Places of the particles of a chunk: for every column what to add to a row, with and without strength.
struct Keys<T> {
    first: i32,
    of_column: Vec<[i32; 2]>,
    weakest: T,
}

impl<T: Real> Keys<T> {
    fn new(layout: &Layout, span: &ChunkSpan, weakest: T) -> Self {
        let [from, to] = span.columns.map(|column| column as usize);
        let of_column = (from..to).map(|column| {
            let nodes = layout.column(column);
            // wraps where rows are near the ends of their type; the row that is added wraps it back
            let strong = (2 * (nodes.start - layout.start[from] as usize) as i32).wrapping_sub(layout.lowest[column]);
            [strong, strong.wrapping_add(nodes.len() as i32)]
        });
        Self { first: from as i32, of_column: of_column.collect(), weakest }
    }

    /// The key of particle `k`, if it belongs to the chunk.
    #[inline(always)]
    fn of(&self, block: &Block<T>, k: usize) -> Option<usize> {
        let keys = self.of_column.get((block.place.column[k] - self.first) as usize)?;
        let weak = block.strength[k] <= self.weakest;
        Some(keys[usize::from(weak)].wrapping_add(block.place.row[k]) as usize)
    }
}

/// Collects the particles of a chunk from those around it.
fn fill<'a, T: Real>(
    layout: &Layout,
    span: &ChunkSpan,
    weakest: T,
    around: &[&'a ChunkParticles<T>],
    chunk: &mut ChunkParticles<T>,
) {
    let [from, to] = span.columns.map(|column| column as usize);
    let inside = |block: &&Block<T>| {
        let (low, high) = reach(block);
        high >= from as i32 && low < to as i32
    };
    let keys = Keys::new(layout, span, weakest);
    let mut next = vec![0_u32; 2 * (layout.start[to] - layout.start[from]) as usize + 1];
    for block in around.iter().flat_map(|particles| &particles.blocks).filter(inside) {
        for k in 0..block.len.min(BLOCK) {
            if let Some(key) = keys.of(block, k) {
                next[key] += 1;
            }
        }
    }
    let mut before = 0;
    for count in &mut next {
        before += std::mem::replace(count, before);
    }
    chunk.motion.clear();
    chunk.blocks.resize(span.blocks(), Block::empty(0, 0));
    let blended = around.iter().any(|particles| !particles.flip.is_empty());
    chunk.flip.clear();
    chunk.flip.resize(if blended { span.blocks() } else { 0 }, Flip::default());
    let with_flip = |particles: &&'a ChunkParticles<T>| {
        let particles = *particles;
        particles.blocks.iter().enumerate().map(|(index, block)| (block, particles.flip.get(index)))
    };
    for (block, flip) in around.iter().flat_map(with_flip).filter(|(block, _)| inside(block)) {
        for k in 0..block.len.min(BLOCK) {
            if let Some(key) = keys.of(block, k) {
                let at = next[key] as usize;
                next[key] += 1;
                chunk.blocks[at / BLOCK].set(at % BLOCK, &block.get(k));
                if let Some(flip) = flip {
                    chunk.flip[at / BLOCK].set(at % BLOCK, flip.get(k));
                }
            }
        }
    }
    let mut left = (span.particles[1] - span.particles[0]) as usize;
    for block in &mut chunk.blocks {
        block.len = left.min(BLOCK);
        left -= block.len;
        let filler = Block::empty(block.place.column[0], block.place.row[0]).get(0);
        for k in block.len..BLOCK {
            block.set(k, &filler);
        }
    }
}

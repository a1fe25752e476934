//! Where the solver gets its kernel rows from: a whole Gram matrix, or a cache of the most recent rows.

use super::columns::Columns;
use super::gram::Gram;
use super::kernel::Kernel;
use super::lanes::padded;
use crate::forecast::matrix::Matrix;

/// Kernel rows of one problem. Both implementations hand out the same bits.
pub(super) trait Rows {
    /// Number of rows.
    fn count(&self) -> usize;

    /// `k(x_i, x_i)` of every row, padded with zeros to whole lanes.
    fn diagonal(&self) -> &[f32];

    /// Multiplications that one row takes at most.
    fn row_work(&self) -> usize;

    /// Row `i`, padded with zeros to whole lanes.
    fn row(&mut self, i: usize) -> &[f32];

    /// Rows `i` and `j`.
    fn pair(&mut self, i: usize, j: usize) -> (&[f32], &[f32]);
}

/// Rows of a Gram matrix in memory.
pub(super) struct WholeRows<'a> {
    gram: &'a Gram,
    diagonal: Vec<f32>,
}

impl<'a> WholeRows<'a> {
    /// The rows of `gram`.
    pub(super) fn new(gram: &'a Gram) -> Self {
        let mut diagonal: Vec<f32> = (0..gram.rows()).map(|i| gram.padded_row(i)[i]).collect();
        diagonal.resize(gram.stride(), 0.0);
        Self { gram, diagonal }
    }
}

impl Rows for WholeRows<'_> {
    fn count(&self) -> usize {
        self.gram.rows()
    }

    fn diagonal(&self) -> &[f32] {
        &self.diagonal
    }

    fn row_work(&self) -> usize {
        self.gram.rows()
    }

    #[inline(always)]
    fn row(&mut self, i: usize) -> &[f32] {
        self.gram.padded_row(i)
    }

    #[inline(always)]
    fn pair(&mut self, i: usize, j: usize) -> (&[f32], &[f32]) {
        (self.gram.padded_row(i), self.gram.padded_row(j))
    }
}

/// Rows computed when asked for, the least recently used of which make way for new ones.
pub(super) struct CachedRows {
    kernel: Kernel,
    columns: Columns,
    points: Vec<Vec<f64>>,
    diagonal: Vec<f32>,
    pairs: Vec<f64>,
    slots: Vec<Slot>,
    capacity: usize,
    slot_of_row: Vec<Option<usize>>,
    clock: u64,
}

struct Slot {
    row: usize,
    used: u64,
    values: Vec<f32>,
}

impl CachedRows {
    /// Rows of the samples of `x` named by `index`, of which as many are kept as `memory_limit_bytes` hold (two at least).
    pub(super) fn new(x: &Matrix, index: &[usize], kernel: Kernel, memory_limit_bytes: usize) -> Self {
        let columns = Columns::of_rows(x, index.iter().copied());
        let stride = columns.stride();
        let mut diagonal = vec![0.0; stride];
        for (value, &i) in diagonal.iter_mut().zip(index) {
            *value = kernel.value(x.row(i), x.row(i)) as f32;
        }
        Self {
            kernel,
            diagonal,
            points: index.iter().map(|&i| x.row(i).to_vec()).collect(),
            pairs: vec![0.0; stride],
            slots: Vec::new(),
            capacity: (memory_limit_bytes / (stride * size_of::<f32>()).max(1)).clamp(2, index.len().max(2)),
            slot_of_row: vec![None; index.len()],
            clock: 0,
            columns,
        }
    }

    /// The features of the rows.
    pub(super) const fn columns(&self) -> &Columns {
        &self.columns
    }

    /// Makes row `i` present and the most recently used, and returns its slot.
    fn fetch(&mut self, i: usize) -> usize {
        self.clock += 1;
        if let Some(slot) = self.slot_of_row[i] {
            self.slots[slot].used = self.clock;
            return slot;
        }
        let slot = self.free_slot();
        self.slot_of_row[i] = Some(slot);
        let entry = &mut self.slots[slot];
        (entry.row, entry.used) = (i, self.clock);
        self.columns.kernel_row(&self.kernel, &self.points[i], &mut self.pairs, &mut entry.values);
        slot
    }

    /// An unused slot while there is room, else the one not used for longest.
    fn free_slot(&mut self) -> usize {
        if self.slots.len() < self.capacity {
            let values = vec![0.0; padded(self.points.len())];
            self.slots.push(Slot { row: usize::MAX, used: 0, values });
            return self.slots.len() - 1;
        }
        // linear search: a miss costs rows x features anyway
        let oldest =
            self.slots.iter().enumerate().min_by_key(|(_, slot)| slot.used).map_or(0, |(position, _)| position);
        self.slot_of_row[self.slots[oldest].row] = None;
        oldest
    }
}

impl Rows for CachedRows {
    fn count(&self) -> usize {
        self.columns.rows()
    }

    fn diagonal(&self) -> &[f32] {
        &self.diagonal
    }

    fn row_work(&self) -> usize {
        self.columns.rows() * self.points.first().map_or(1, Vec::len)
    }

    fn row(&mut self, i: usize) -> &[f32] {
        let slot = self.fetch(i);
        &self.slots[slot].values
    }

    fn pair(&mut self, i: usize, j: usize) -> (&[f32], &[f32]) {
        // two slots at least, so fetching j never evicts i, which is the most recent
        let (first, second) = (self.fetch(i), self.fetch(j));
        (&self.slots[first].values, &self.slots[second].values)
    }
}

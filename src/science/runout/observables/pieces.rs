//! What a flow has broken into: granules of whole snow, and surges along the track.

use serde::{Deserialize, Serialize};

use super::Scene;
use super::profiles::{BIN_M, Bins};
use crate::runout::snapshot::Snapshot;

/// Cells of the mesh that a granule has at least; what is smaller is dust.
const SMALLEST_CELLS: usize = 4;
/// Between two surges the mass of a bin falls below this share of the one before and rises again to its inverse.
const TROUGH: f64 = 0.5;
/// Share of the largest mass of a bin that a surge has at least.
const LOWEST_SURGE: f64 = 0.1;

/// What a flow has broken into at one instant. The definitions are this project's own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Pieces {
    /// Time since release, s.
    pub time_s: f64,
    /// Granules: connected pieces of whole snow (volumetric plastic strain at most 0) of at least four cells of the mesh; a slab
    /// that has not broken is one.
    pub granules: u32,
    /// Share of the mass that is in granules.
    pub granule_share: f64,
    /// Size of a typical granule, m: the root of the area, at the density of release, of the one at the middle of the granules'
    /// mass; `null` where there is none.
    pub granule_size_m: Option<f64>,
    /// Size of the largest granule, m.
    pub largest_granule_m: Option<f64>,
    /// Surges: crests of the mass along the bed, between which it falls to less than half and doubles again.
    pub surges: u32,
    /// Mean distance of neighbouring surges along the bed, m; `null` where there are less than two.
    pub surge_spacing_m: Option<f64>,
}

impl Pieces {
    pub(super) fn new(snapshot: &Snapshot, scene: &Scene, bins: &Bins) -> Self {
        let particles = snapshot.x_m.len() as f64;
        let area_m2 = scene.slab.length_m * scene.slab.thickness_m / particles;
        let mut granules = granules(snapshot, scene.mesh_m);
        granules.sort_unstable();
        let whole: usize = granules.iter().sum();
        let size = |count: &usize| (*count as f64 * area_m2).sqrt();
        let mut below = 0;
        let typical = granules.iter().find(|&&count| {
            below += count;
            2 * below >= whole
        });
        let crests = crests(bins.masses());
        let spacing_m = match crests.as_slice() {
            [first, .., last] => Some((last - first) as f64 * BIN_M / (crests.len() - 1) as f64),
            _ => None,
        };
        Self {
            time_s: snapshot.time_s,
            granules: granules.len() as u32,
            granule_share: whole as f64 / particles,
            granule_size_m: typical.map(size),
            largest_granule_m: granules.last().map(size),
            surges: crests.len() as u32,
            surge_spacing_m: spacing_m,
        }
    }
}

/// Particles of every granule, in no order.
fn granules(snapshot: &Snapshot, mesh_m: f64) -> Vec<usize> {
    let cell = |x: f32| (f64::from(x) / mesh_m).floor() as i64;
    let places = snapshot.x_m.iter().zip(&snapshot.z_m).zip(&snapshot.plastic_strain);
    let whole = places.filter(|(_, strain)| **strain <= 0.0);
    let mut cells: Vec<(i64, i64)> = whole.map(|((&x, &z), _)| (cell(x), cell(z))).collect();
    cells.sort_unstable();
    let counted: Vec<((i64, i64), usize)> = cells.chunk_by(|a, b| a == b).map(|same| (same[0], same.len())).collect();
    // a forest of cells: each points to one of its piece, the root to itself
    let mut above: Vec<usize> = (0..counted.len()).collect();
    for index in 0..counted.len() {
        let (column, row) = counted[index].0;
        for neighbour in [(column, row + 1), (column + 1, row - 1), (column + 1, row), (column + 1, row + 1)] {
            if let Ok(other) = counted.binary_search_by_key(&neighbour, |(place, _)| *place) {
                let (a, b) = (root(&mut above, index), root(&mut above, other));
                above[a.max(b)] = a.min(b);
            }
        }
    }
    let mut pieces = vec![(0, 0); counted.len()];
    for (index, (_, count)) in counted.iter().enumerate() {
        let piece = &mut pieces[root(&mut above, index)];
        *piece = (piece.0 + 1, piece.1 + count);
    }
    pieces.into_iter().filter(|(cells, _)| *cells >= SMALLEST_CELLS).map(|(_, count)| count).collect()
}

/// The root of a tree, with the way to it shortened.
fn root(above: &mut [usize], mut index: usize) -> usize {
    while above[index] != index {
        above[index] = above[above[index]];
        index = above[index];
    }
    index
}

/// Places of the crests of a row of masses.
fn crests(masses: impl Iterator<Item = f64> + Clone) -> Vec<usize> {
    let least = LOWEST_SURGE * masses.clone().fold(0.0, f64::max);
    let (mut crests, mut crest, mut trough) = (Vec::new(), None, 0.0_f64);
    for (place, mass) in masses.enumerate() {
        match crest {
            None if mass >= least && mass > 0.0 && TROUGH * mass >= trough => crest = Some((place, mass)),
            None => trough = trough.min(mass),
            Some((_, highest)) if mass > highest => crest = Some((place, mass)),
            Some((at, highest)) if mass < TROUGH * highest => {
                crests.push(at);
                (crest, trough) = (None, mass);
            }
            Some(_) => {}
        }
    }
    crests.extend(crest.map(|(place, _)| place));
    crests
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crests_are_separated_by_troughs() {
        let of = |masses: &[f64]| crests(masses.iter().copied());
        assert!(of(&[]).is_empty() && of(&[0.0, 0.0]).is_empty());
        assert_eq!(of(&[1.0, 3.0, 2.0, 3.5, 1.0]), [3], "a dip to more than half is none");
        assert_eq!(of(&[1.0, 4.0, 1.0, 1.9, 1.0]), [1], "what does not double is no crest");
        assert_eq!(of(&[1.0, 4.0, 1.0, 2.0, 0.5, 3.0]), [1, 3, 5]);
        assert_eq!(of(&[100.0, 0.0, 9.0, 0.0, 11.0]), [0, 4], "nor is a tenth of the largest");
    }
}

//! The snow that is released: a slab on the bed, filled with particles.

use thiserror::Error;

use super::terrain::{BedPoint, Stretch, Terrain};

/// Free bed that is asked for at both ends of a slab, in its lengths: it may shake back when it breaks loose.
pub const MARGIN: f64 = 0.25;

/// A slab of snow: all points that lie within its thickness above a stretch of the bed. Its ends stand normal to the bed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slab {
    /// Where the bed below its middle lies, m along the track.
    pub x_m: f64,
    /// Length along the bed, m.
    pub length_m: f64,
    /// Thickness normal to the bed, m.
    pub thickness_m: f64,
}

/// Why a slab cannot be released.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum ReleaseError {
    /// A length, a thickness, a position or a spacing that is none.
    #[error(
        "a slab of {length_m} by {thickness_m} m at {x_m} m: its length and thickness must be finite and at least {least_m} m, \
         twice the distance of its particles"
    )]
    Size {
        /// Position, m.
        x_m: f64,
        /// Length, m.
        length_m: f64,
        /// Thickness, m.
        thickness_m: f64,
        /// The least length and thickness, m.
        least_m: f64,
    },
    /// A slab that reaches over an end of the terrain.
    #[error(
        "the slab does not lie on the terrain: with a margin of a quarter of its length at both ends it reaches from {from_m} to \
         {to_m} m along the bed, which is {bed_m} m long"
    )]
    OffTerrain {
        /// Arc length of its upper end less the margin, m.
        from_m: f64,
        /// Arc length of its lower end and the margin, m.
        to_m: f64,
        /// Arc length of the bed, m.
        bed_m: f64,
    },
    /// A slab that is too thick for the hollow that it lies in.
    #[error(
        "a slab of {thickness_m} m is too thick for the hollow below it: at most {most_m} m, half of its radius, is accepted"
    )]
    TooThick {
        /// Thickness, m.
        thickness_m: f64,
        /// The most that fits, m.
        most_m: f64,
    },
}

/// The particles of a slab at rest, row by row from the bed up, each row down the track.
#[derive(Clone, Debug, PartialEq)]
pub struct Placement {
    /// Position along the track, m, one entry a particle.
    pub x_m: Vec<f64>,
    /// Height, m, one entry a particle.
    pub z_m: Vec<f64>,
    /// Area of snow that each particle stands for, m2 (a volume a metre of width); the same for all.
    pub particle_area_m2: f64,
}

impl Slab {
    /// The slab whose centre, at mid thickness, lies at `centre_m` = `[x, z]` in m: `(-L0, H0)` of Li et al. (2020), Table 1.
    #[must_use]
    pub fn centred(terrain: &Terrain, centre_m: [f64; 2], length_m: f64, thickness_m: f64) -> Self {
        Self { x_m: terrain.project(centre_m[0], centre_m[1]).x_m, length_m, thickness_m }
    }

    /// Its upper end on the bed, `[x, z]` in m.
    #[must_use]
    pub fn crown_m(&self, terrain: &Terrain) -> [f64; 2] {
        let crown = terrain.at_arc_length(self.middle_s(terrain) - 0.5 * self.length_m);
        [crown.x_m, crown.z_m]
    }

    /// Height of its highest point, m.
    #[must_use]
    pub fn top_m(&self, terrain: &Terrain) -> f64 {
        const LOOKS: u32 = 64;
        let (middle, half) = (self.middle_s(terrain), 0.5 * self.length_m);
        let place = |look: u32| middle - half + self.length_m * f64::from(look) / f64::from(LOOKS);
        let heights = (0..=LOOKS).map(|look| above(&terrain.at_arc_length(place(look)), self.thickness_m)[1]);
        heights.fold(f64::NEG_INFINITY, f64::max)
    }

    /// Its centre at mid length and mid thickness, `[x, z]` in m.
    #[must_use]
    pub fn centre_m(&self, terrain: &Terrain) -> [f64; 2] {
        let middle = terrain.at_arc_length(self.middle_s(terrain));
        above(&middle, 0.5 * self.thickness_m)
    }

    /// Whether the slab can be released on `terrain` with particles `spacing_m` metres apart.
    ///
    /// # Errors
    /// A size that is none, a slab that reaches over an end of the terrain, or one that is too thick for its hollow.
    pub fn check(&self, terrain: &Terrain, spacing_m: f64) -> Result<(), ReleaseError> {
        let Self { x_m, length_m, thickness_m } = *self;
        let least_m = 2.0 * spacing_m;
        let is_size = |value: f64| value.is_finite() && value >= least_m;
        if !(x_m.is_finite() && spacing_m > 0.0 && is_size(length_m) && is_size(thickness_m)) {
            return Err(ReleaseError::Size { x_m, length_m, thickness_m, least_m });
        }
        let (middle, half) = (self.middle_s(terrain), 0.5 * length_m);
        let (from_m, to_m) = (middle - half - MARGIN * length_m, middle + half + MARGIN * length_m);
        if from_m < 0.0 || to_m > terrain.length_m() {
            return Err(ReleaseError::OffTerrain { from_m, to_m, bed_m: terrain.length_m() });
        }
        let sharpest =
            terrain.between(middle - half, middle + half).map(|stretch| stretch.curvature).fold(0.0, f64::max);
        if sharpest * thickness_m > 0.5 {
            return Err(ReleaseError::TooThick { thickness_m, most_m: 0.5 / sharpest });
        }
        Ok(())
    }

    /// Fills the slab with particles `spacing_m` metres apart: a square lattice that follows the bed, its lowest row half a
    /// spacing above it, so that the slab touches the bed and each cell of twice the spacing gets 4 particles.
    ///
    /// Counts are rounded, and distances adapted to them. Where the bed is curved, each row has the count of its own length,
    /// so that the density is even to half a particle a row. There are about `length thickness / spacing^2` particles.
    ///
    /// # Errors
    /// What [`Slab::check`] says.
    pub fn place(&self, terrain: &Terrain, spacing_m: f64) -> Result<Placement, ReleaseError> {
        self.check(terrain, spacing_m)?;
        let (middle, half) = (self.middle_s(terrain), 0.5 * self.length_m);
        let stretches: Vec<Stretch> = terrain.between(middle - half, middle + half).collect();
        let rows = (self.thickness_m / spacing_m).round();
        let mut points = Vec::new();
        for row in 0..rows as usize {
            let y = (row as f64 + 0.5) * self.thickness_m / rows;
            place_row(terrain, &stretches, y, spacing_m, &mut points);
        }
        let area = self.thickness_m * row_length(&stretches, 0.5 * self.thickness_m);
        let particle_area_m2 = area / points.len() as f64;
        let (x_m, z_m) = points.into_iter().map(|[x, z]| (x, z)).unzip();
        Ok(Placement { x_m, z_m, particle_area_m2 })
    }

    /// Arc length of the bed below its middle, m.
    fn middle_s(&self, terrain: &Terrain) -> f64 {
        terrain.arc_length_m(self.x_m)
    }
}

/// The point `y` metres above a point of the bed, along its normal.
fn above(bed: &BedPoint, y: f64) -> [f64; 2] {
    [bed.x_m + y * bed.normal[0], bed.z_m + y * bed.normal[1]]
}

/// Length of the row `y` metres above some stretches of bed, m.
fn row_length(stretches: &[Stretch], y: f64) -> f64 {
    stretches.iter().map(|stretch| stretch.length_at(y)).sum()
}

/// Adds the particles of the row `y` metres above the bed, evenly and about `spacing` metres apart.
fn place_row(terrain: &Terrain, stretches: &[Stretch], y: f64, spacing: f64, points: &mut Vec<[f64; 2]>) {
    let total = row_length(stretches, y);
    let count = (total / spacing).round().max(1.0);
    let step = total / count;
    // length of the row before the stretch
    let mut before = 0.0;
    let mut place = 0.0;
    for (index, stretch) in stretches.iter().enumerate() {
        let end = if index + 1 == stretches.len() { f64::INFINITY } else { before + stretch.length_at(y) };
        while place < count && (place + 0.5) * step <= end {
            let on_bed = ((place + 0.5) * step - before) / (1.0 - stretch.curvature * y);
            points.push(above(&terrain.at_arc_length(stretch.from_s + on_bed), y));
            place += 1.0;
        }
        before = end;
    }
}

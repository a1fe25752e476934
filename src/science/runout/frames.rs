//! Frames of an animation as a few bytes a particle.
//!
//! A frame stands alone. All numbers are little endian:
//!
//! | byte | type | what |
//! |---|---|---|
//! | 0 | 8 bytes | `FIRNFRM1` |
//! | 8 | u32 | number of particles `n` |
//! | 12 | 4 x u8 | bytes a number in the columns x, z, speed, class: `w`, 1 to 4 |
//! | 16 | f64 | time since release, s |
//! | 24 | f64 | origin of x, m |
//! | 32 | f64 | origin of z, m |
//! | 40 | f64 | resolution of x and z, m |
//! | 48 | f64 | resolution of speed, m/s |
//! | 56 | | the columns in the zlib format (RFC 1950), which browsers read as `DecompressionStream("deflate")` |
//!
//! The columns follow one another in the order above. A column is `w` planes of `n` bytes: the lowest byte of all its
//! numbers, then the next one. Its numbers are differences: from 0 for the first particle, else from the particle before,
//! in the order of release; a difference `d` is stored as `2 d` where it is not negative and as `-2 d - 1` where it is. The
//! running sums, times the resolution and plus the origin, are the values; the sums of the last column are the classes of
//! [`StrainClass`].

use miniz_oxide::deflate::compress_to_vec_zlib;
use miniz_oxide::inflate::decompress_to_vec_zlib_with_limit;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::snapshot::Snapshot;

/// Resolution of positions, m: they are rounded to the nearest multiple.
pub const POSITION_RESOLUTION_M: f64 = 0.01;
/// Resolution of speeds, m/s: they are rounded to the nearest multiple.
pub const SPEED_RESOLUTION_M_S: f64 = 0.05;
/// The most particles of a frame that is read.
pub const MOST_PARTICLES: usize = 1 << 24;

const MAGIC: &[u8; 8] = b"FIRNFRM1";
const HEADER: usize = 56;
const COLUMNS: usize = 4;
/// Of 1 to 10: more costs more time than it saves bytes.
const COMPRESSION: u8 = 3;
/// Volumetric plastic strain above which a broken particle is a lone grain.
const DISPERSED: f64 = 0.5;
/// The largest magnitude of a quantised value: differences of two then fit into 4 bytes with their sign.
const LARGEST: f64 = (1 << 29) as f64;

/// What has become of the snow of a particle, by its volumetric plastic strain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum StrainClass {
    /// 0: it carries stress (strain at most 0).
    Whole,
    /// 1: broken (strain above 0).
    Broken,
    /// 2: broken and widely dispersed (strain above 0.5).
    Dispersed,
}

impl StrainClass {
    fn of(plastic_strain: f32) -> Self {
        match f64::from(plastic_strain) {
            strain if strain > DISPERSED => Self::Dispersed,
            strain if strain > 0.0 => Self::Broken,
            _ => Self::Whole,
        }
    }

    fn from_number(number: i64) -> Option<Self> {
        match number {
            0 => Some(Self::Whole),
            1 => Some(Self::Broken),
            2 => Some(Self::Dispersed),
            _ => None,
        }
    }
}

/// A frame as it is drawn; every vector has one entry a particle, in the order of release.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Frame {
    /// Time since release, s.
    pub time_s: f64,
    /// Position along the track, m, to 0.01 m.
    pub x_m: Vec<f64>,
    /// Height, m, to 0.01 m.
    pub z_m: Vec<f64>,
    /// Speed, m/s, to 0.05 m/s.
    pub speed_m_s: Vec<f64>,
    /// What has become of the snow.
    pub class: Vec<StrainClass>,
}

/// Why a frame cannot be written or read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum FrameError {
    /// A position or a speed that is not finite, or that is too large.
    #[error("particle {particle} of the frame has no position or speed that can be stored")]
    Unstorable {
        /// Its place in the order of release.
        particle: usize,
    },
    /// Vectors of different lengths, or more than [`MOST_PARTICLES`].
    #[error("a frame has one entry a particle in every vector, and at most {MOST_PARTICLES} particles")]
    Shape,
    /// Bytes that are no frame.
    #[error("these bytes are no frame: {0}")]
    Damaged(&'static str),
}

/// The frame of a snapshot in the layout of this module.
///
/// # Errors
/// A particle that is nowhere, or vectors of different lengths.
pub fn encode(snapshot: &Snapshot) -> Result<Vec<u8>, FrameError> {
    let particles = snapshot.x_m.len();
    let others = [&snapshot.z_m, &snapshot.vx_m_s, &snapshot.vz_m_s, &snapshot.plastic_strain];
    if others.iter().any(|column| column.len() != particles) || particles > MOST_PARTICLES {
        return Err(FrameError::Shape);
    }
    let origin = |values: &[f32]| values.first().map_or(0.0, |&first| f64::from(first));
    let origins = [origin(&snapshot.x_m), origin(&snapshot.z_m)];
    let speeds = snapshot.vx_m_s.iter().zip(&snapshot.vz_m_s).map(|(&vx, &vz)| f64::from(vx).hypot(f64::from(vz)));
    let columns = [
        quantised(snapshot.x_m.iter().map(|&x| f64::from(x) - origins[0]), POSITION_RESOLUTION_M)?,
        quantised(snapshot.z_m.iter().map(|&z| f64::from(z) - origins[1]), POSITION_RESOLUTION_M)?,
        quantised(speeds, SPEED_RESOLUTION_M_S)?,
        snapshot.plastic_strain.iter().map(|&strain| StrainClass::of(strain) as i64).collect(),
    ];
    let columns = columns.map(|column| differences(&column));
    let widths = columns.each_ref().map(|column| width(column));
    let mut bytes = Vec::with_capacity(HEADER + 4 * particles);
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&(particles as u32).to_le_bytes());
    bytes.extend(widths.map(|width| width as u8));
    for number in [snapshot.time_s, origins[0], origins[1], POSITION_RESOLUTION_M, SPEED_RESOLUTION_M_S] {
        bytes.extend_from_slice(&number.to_le_bytes());
    }
    let mut planes = Vec::with_capacity(particles * widths.iter().sum::<usize>());
    for (column, width) in columns.iter().zip(widths) {
        for plane in 0..width {
            planes.extend(column.iter().map(|number| number.to_le_bytes()[plane]));
        }
    }
    bytes.extend(compress_to_vec_zlib(&planes, COMPRESSION));
    Ok(bytes)
}

/// The frame of some bytes.
///
/// # Errors
/// Bytes that [`encode`] did not write.
pub fn decode(bytes: &[u8]) -> Result<Frame, FrameError> {
    let (header, packed) = bytes.split_at_checked(HEADER).ok_or(FrameError::Damaged("they are too few"))?;
    if !header.starts_with(MAGIC) {
        return Err(FrameError::Damaged("they begin otherwise"));
    }
    let particles = u32::from_le_bytes([header[8], header[9], header[10], header[11]]) as usize;
    let widths: [usize; COLUMNS] = std::array::from_fn(|column| usize::from(header[12 + column]));
    if particles > MOST_PARTICLES || widths.iter().any(|width| !(1..=4).contains(width)) {
        return Err(FrameError::Damaged("their header is impossible"));
    }
    let number = |at: usize| f64::from_le_bytes(std::array::from_fn(|byte| header[at + byte]));
    let [time_s, origin_x, origin_z, position, speed] = [16, 24, 32, 40, 48].map(number);
    let size = particles * widths.iter().sum::<usize>();
    let planes =
        decompress_to_vec_zlib_with_limit(packed, size).map_err(|_| FrameError::Damaged("they do not unpack"))?;
    if planes.len() != size {
        return Err(FrameError::Damaged("they unpack to another size"));
    }
    let mut rest = planes.as_slice();
    let [x, z, speeds, classes] = widths.map(|width| {
        let (column, after) = rest.split_at(particles * width);
        rest = after;
        sums(column, particles, width)
    });
    let values = |column: Vec<i64>, resolution: f64, origin: f64| {
        column.into_iter().map(|value| value as f64 * resolution + origin).collect::<Vec<f64>>()
    };
    let class = classes.into_iter().map(StrainClass::from_number).collect::<Option<Vec<StrainClass>>>();
    Ok(Frame {
        time_s,
        x_m: values(x, position, origin_x),
        z_m: values(z, position, origin_z),
        speed_m_s: values(speeds, speed, 0.0),
        class: class.ok_or(FrameError::Damaged("a class is unknown"))?,
    })
}

fn quantised(values: impl Iterator<Item = f64>, resolution: f64) -> Result<Vec<i64>, FrameError> {
    let quantise = |(particle, value): (usize, f64)| {
        let steps = (value / resolution).round();
        // a comparison with NaN is false
        if steps.abs() <= LARGEST { Ok(steps as i64) } else { Err(FrameError::Unstorable { particle }) }
    };
    values.enumerate().map(quantise).collect()
}

/// Differences from one number to the next, signs folded into the lowest bit.
fn differences(column: &[i64]) -> Vec<u32> {
    let mut before = 0;
    let fold = |&value: &i64| {
        let difference = value - before;
        before = value;
        // |difference| <= 2^30, so that it fits
        ((difference << 1) ^ (difference >> 63)) as u32
    };
    column.iter().map(fold).collect()
}

/// The values whose differences stand in the planes of a column.
fn sums(planes: &[u8], particles: usize, width: usize) -> Vec<i64> {
    let mut sum = 0;
    let unfold = |particle: usize| {
        let folded = (0..width)
            .fold(0_i64, |folded, plane| folded | i64::from(planes[plane * particles + particle]) << (8 * plane));
        sum += (folded >> 1) ^ -(folded & 1);
        sum
    };
    (0..particles).map(unfold).collect()
}

/// Bytes that the largest number of a column takes, at least 1.
fn width(column: &[u32]) -> usize {
    let largest = column.iter().copied().max().unwrap_or(0);
    (4 - largest.leading_zeros() as usize / 8).max(1)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Half a step, and what rounding to `f64` adds.
    fn within(stored: f64, value: f64, resolution: f64) -> bool {
        (stored - value).abs() <= 0.5 * resolution + 1e-9 * (1.0 + value.abs())
    }

    fn check(snapshot: &Snapshot) {
        let frame = decode(&encode(snapshot).unwrap()).unwrap();
        assert_eq!(frame.time_s.to_bits(), snapshot.time_s.to_bits());
        assert_eq!(frame.x_m.len(), snapshot.x_m.len());
        for particle in 0..snapshot.x_m.len() {
            assert!(within(frame.x_m[particle], f64::from(snapshot.x_m[particle]), POSITION_RESOLUTION_M));
            assert!(within(frame.z_m[particle], f64::from(snapshot.z_m[particle]), POSITION_RESOLUTION_M));
            let speed = f64::from(snapshot.vx_m_s[particle]).hypot(f64::from(snapshot.vz_m_s[particle]));
            assert!(within(frame.speed_m_s[particle], speed, SPEED_RESOLUTION_M_S));
            let strain = snapshot.plastic_strain[particle];
            let class = [StrainClass::Whole, StrainClass::Broken, StrainClass::Dispersed];
            assert_eq!(frame.class[particle], class[usize::from(strain > 0.0) + usize::from(strain > 0.5)]);
        }
    }

    fn snapshot(particles: &[[f32; 5]]) -> Snapshot {
        let column = |place: usize| particles.iter().map(|particle| particle[place]).collect();
        Snapshot {
            time_s: 8.3,
            x_m: column(0),
            z_m: column(1),
            vx_m_s: column(2),
            vz_m_s: column(3),
            density_kg_m3: vec![250.0; particles.len()],
            plastic_strain: column(4),
        }
    }

    #[test]
    fn a_frame_has_the_bytes_that_its_layout_says() {
        let bytes = encode(&snapshot(&[[1.0, 2.0, 3.0, 4.0, -0.1], [0.98, 5.0, 0.0, 0.0, 0.7]])).unwrap();
        assert_eq!(&bytes[..8], b"FIRNFRM1");
        assert_eq!(&bytes[8..16], [2, 0, 0, 0, 1, 2, 1, 1]);
        let number = |at: usize| f64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
        assert_eq!([16, 24, 32, 40, 48].map(number), [8.3, 1.0, 2.0, 0.01, 0.05]);
        let planes = decompress_to_vec_zlib_with_limit(&bytes[56..], 100).unwrap();
        // x: 0, -2 steps; z: 0, +300 in two planes; speed: 100, then 100 less; class: 0, then 2
        assert_eq!(planes, [0, 3, 0, 600_u16 as u8, 0, 2, 200, 199, 0, 4]);
    }

    #[test]
    fn a_particle_that_is_nowhere_is_refused() {
        for bad in [f32::NAN, f32::INFINITY, -f32::INFINITY, 1e9] {
            for place in 0..4 {
                let mut particles = [[0.0; 5]; 3];
                particles[1][place] = bad;
                assert_eq!(encode(&snapshot(&particles)), Err(FrameError::Unstorable { particle: 1 }), "{bad} {place}");
            }
        }
        let mut uneven = snapshot(&[[0.0; 5]; 3]);
        uneven.z_m.pop();
        assert_eq!(encode(&uneven), Err(FrameError::Shape));
    }

    #[test]
    fn no_particles_are_a_frame() {
        check(&snapshot(&[]));
    }

    proptest! {
        #[test]
        fn what_is_stored_is_within_half_of_the_resolution(
            particles in prop::collection::vec(
                prop::array::uniform5(prop_oneof![-20_000_f32..20_000.0, -1_f32..1.0, Just(0.0)]), 0..300,
            ),
        ) {
            check(&snapshot(&particles));
        }

        #[test]
        fn damaged_bytes_are_refused_or_read_but_never_panic(
            particles in prop::collection::vec(prop::array::uniform5(-9_f32..9.0), 1..50),
            at in 0_usize..200, byte: u8, kept in 0_usize..400,
        ) {
            let mut bytes = encode(&snapshot(&particles)).unwrap();
            let at = at % bytes.len();
            bytes[at] = byte;
            let _ = decode(&bytes);
            bytes.truncate(kept);
            let _ = decode(&bytes);
        }

        #[test]
        fn any_bytes_are_refused_or_read_but_never_panic(bytes: Vec<u8>) {
            let _ = decode(&bytes);
            let _ = decode(&[MAGIC.as_slice(), bytes.as_slice()].concat());
        }
    }
}

//! The bed: straight pieces joined by circular arcs, so that height, normal, curvature and arc length are exact.
//!
//! The ideal slope of Li et al. (2020), Figure 1, is one slope, one arc and one flat. Any other profile is a polyline whose
//! corners are rounded by arcs, so both are the same kind of curve. Beyond its ends the bed goes on straight.

use thiserror::Error;

/// The steepest piece of bed that is accepted, degrees.
pub const STEEPEST_DEG: f64 = 80.0;
/// The largest absolute coordinate of a profile, m: there a position in `f32` is still good to 2 mm.
pub const LARGEST_COORDINATE_M: f64 = 20_000.0;
/// The shortest rounding of a corner, m: a kink has no normal.
pub const LEAST_SMOOTHING_M: f64 = 0.1;
/// The least distance in x between two points of a profile, m.
pub const CLOSEST_M: f64 = 1e-3;
/// The most points of a profile.
pub const MOST_POINTS: usize = 100_000;
/// The distance from a corner of a profile at which its rounding begins, m, unless it is said.
pub const SMOOTHING_M: f64 = 10.0;

/// Corners that turn by less than this, in radians, are none.
const STRAIGHT: f64 = 1e-9;

/// Why there is no such bed.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum TerrainError {
    /// Too few points for a line, or too many.
    #[error("a profile of {found} point(s): from 2 to {MOST_POINTS} are accepted")]
    Points {
        /// Points given.
        found: usize,
    },
    /// A coordinate that is not finite or too far away.
    #[error("point {index} of the profile: coordinates must be finite and within {LARGEST_COORDINATE_M} m of 0")]
    Coordinate {
        /// Its place in the profile, from 0.
        index: usize,
    },
    /// A point that does not lie beyond the one before it.
    #[error(
        "point {index} of the profile: x must be at least {CLOSEST_M} m beyond the {previous_m} m of the point before it, got \
         {x_m} m"
    )]
    NotIncreasing {
        /// Its place in the profile, from 0.
        index: usize,
        /// Its x, m.
        x_m: f64,
        /// The x before it, m.
        previous_m: f64,
    },
    /// A point that the bed reaches too steeply.
    #[error("point {index} of the profile: the bed before it is steeper than {STEEPEST_DEG} degrees")]
    TooSteep {
        /// Its place in the profile, from 0.
        index: usize,
    },
    /// A smoothing length that is none.
    #[error("a smoothing of {smoothing_m} m: from {LEAST_SMOOTHING_M} to {LARGEST_COORDINATE_M} m is accepted")]
    Smoothing {
        /// The length given, m.
        smoothing_m: f64,
    },
    /// An ideal slope that cannot be built.
    #[error(
        "an ideal slope of {angle_deg} degrees with an arc of {radius_m} m from {top_m} to {end_m} m: the angle must be above 0 \
         and at most {STEEPEST_DEG} degrees, the radius above 0, the top left of the arc, the end right of 0, and all within \
         {LARGEST_COORDINATE_M} m"
    )]
    IdealSlope {
        /// Slope angle, degrees.
        angle_deg: f64,
        /// Radius of the arc, m.
        radius_m: f64,
        /// Where the slope begins, m.
        top_m: f64,
        /// Where the flat ends, m.
        end_m: f64,
    },
}

/// The bed as a curve in the plane of `x` (down the track) and `z` (up), in m; its arc length `s` begins at its left end.
#[derive(Clone, Debug, PartialEq)]
pub struct Terrain {
    /// From left to right without a gap; the first and the last are straight.
    pieces: Vec<Piece>,
}

/// The point of the bed next to some point of the plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BedPoint {
    /// Arc length from the left end of the bed, m; below 0 on its extension to the left.
    pub s_m: f64,
    /// Position along the track, m.
    pub x_m: f64,
    /// Height, m.
    pub z_m: f64,
    /// Unit normal that points out of the bed.
    pub normal: [f64; 2],
    /// Curvature, 1/m: above 0 in a hollow, below 0 on a ridge.
    pub curvature_1_m: f64,
    /// Distance of the point from the bed along the normal, m; below 0 inside of the bed.
    pub distance_m: f64,
}

impl BedPoint {
    /// Unit tangent, down the track.
    #[must_use]
    pub const fn tangent(&self) -> [f64; 2] {
        [self.normal[1], -self.normal[0]]
    }
}

/// A part of the bed of one curvature.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Stretch {
    /// Arc length where it begins and where it ends, m.
    pub(super) from_s: f64,
    pub(super) to_s: f64,
    /// 1/m.
    pub(super) curvature: f64,
}

impl Stretch {
    /// Its length `y` metres above the bed, m.
    pub(super) fn length_at(&self, y: f64) -> f64 {
        (self.to_s - self.from_s) * (1.0 - self.curvature * y)
    }
}

/// A circular arc, or a straight piece where its curvature is 0.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Piece {
    /// Arc length at its start, m.
    from_s: f64,
    /// Its own arc length, m.
    length: f64,
    start: [f64; 2],
    /// Angle of the tangent at its start, radians, within (-pi/2, pi/2).
    angle: f64,
    /// 1/m.
    curvature: f64,
}

impl Piece {
    fn angle_at(&self, t: f64) -> f64 {
        self.angle + self.curvature * t
    }

    /// The point `t` metres of arc after the start.
    fn point_at(&self, t: f64) -> [f64; 2] {
        let [x, z] = self.start;
        if self.curvature == 0.0 {
            return [x + t * self.angle.cos(), z + t * self.angle.sin()];
        }
        let angle = self.angle_at(t);
        let along = (angle.sin() - self.angle.sin()) / self.curvature;
        [x + along, z + (self.angle.cos() - angle.cos()) / self.curvature]
    }

    fn height_at(&self, x: f64) -> f64 {
        let along = x - self.start[0];
        if self.curvature == 0.0 {
            return self.start[1] + along * self.angle.tan();
        }
        let sine = (self.angle.sin() + self.curvature * along).clamp(-1.0, 1.0);
        self.start[1] + (self.angle.cos() - (1.0 - sine * sine).sqrt()) / self.curvature
    }

    /// Arc length from the start to the point above `x`, m.
    fn arc_to(&self, x: f64) -> f64 {
        let along = x - self.start[0];
        if self.curvature == 0.0 {
            return along / self.angle.cos();
        }
        let sine = (self.angle.sin() + self.curvature * along).clamp(-1.0, 1.0);
        (sine.asin() - self.angle) / self.curvature
    }

    /// Arc length from the start to the foot of `point`, m, at most `before` left and `after` right of the piece.
    fn foot(&self, point: [f64; 2], before: f64, after: f64) -> f64 {
        let [dx, dz] = [point[0] - self.start[0], point[1] - self.start[1]];
        let (sine, cosine) = self.angle.sin_cos();
        if self.curvature == 0.0 {
            return (dx * cosine + dz * sine).clamp(-before, self.length + after);
        }
        // from the centre of the circle to the point; on the bed it is (sin, -cos) / curvature
        let [cx, cz] = [dx + sine / self.curvature, dz - cosine / self.curvature];
        let side = self.curvature.signum();
        let t = ((side * cx).atan2(-side * cz) - self.angle) / self.curvature;
        if (0.0..=self.length).contains(&t) {
            return t;
        }
        let away = |t: f64| squared_distance(self.point_at(t), point);
        if away(0.0) <= away(self.length) { 0.0 } else { self.length }
    }

    fn bed_point(&self, t: f64, point: [f64; 2]) -> BedPoint {
        let [x, z] = self.point_at(t);
        let (sine, cosine) = self.angle_at(t).sin_cos();
        BedPoint {
            s_m: self.from_s + t,
            x_m: x,
            z_m: z,
            normal: [-sine, cosine],
            curvature_1_m: self.curvature,
            distance_m: (point[1] - z) * cosine - (point[0] - x) * sine,
        }
    }
}

fn squared_distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)
}

/// Pieces of a curve, laid one after the other.
struct Builder {
    pieces: Vec<Piece>,
    s: f64,
}

impl Builder {
    const fn new() -> Self {
        Self { pieces: Vec::new(), s: 0.0 }
    }

    fn line(&mut self, from: [f64; 2], to: [f64; 2], angle: f64) {
        let length = squared_distance(from, to).sqrt();
        if length > 0.0 {
            self.push(Piece { from_s: self.s, length, start: from, angle, curvature: 0.0 });
        }
    }

    fn arc(&mut self, from: [f64; 2], angle: f64, turn: f64, curvature: f64) {
        self.push(Piece { from_s: self.s, length: turn / curvature, start: from, angle, curvature });
    }

    fn push(&mut self, piece: Piece) {
        self.s += piece.length;
        self.pieces.push(piece);
    }

    fn build(self) -> Terrain {
        Terrain { pieces: self.pieces }
    }
}

impl Terrain {
    /// The ideal slope of Li et al. (2020), Figure 1: a slope of `angle_deg` degrees from `top_m` on, a circular arc of
    /// `radius_m` with its centre at (0, `radius_m`), which ends at (0, 0), and a flat up to `end_m`.
    ///
    /// # Errors
    /// An angle, a radius or an extent that makes no such bed.
    pub fn slope_arc_flat(angle_deg: f64, radius_m: f64, top_m: f64, end_m: f64) -> Result<Self, TerrainError> {
        let refused = TerrainError::IdealSlope { angle_deg, radius_m, top_m, end_m };
        let angle = angle_deg.to_radians();
        let (sine, cosine) = angle.sin_cos();
        let arc = [-radius_m * sine, radius_m * (1.0 - cosine)];
        let top = [top_m, arc[1] + (arc[0] - top_m) * angle.tan()];
        let inside = top.iter().chain(&[end_m]).all(|value| value.abs() <= LARGEST_COORDINATE_M);
        let shaped = angle_deg > 0.0 && angle_deg <= STEEPEST_DEG && radius_m > 0.0;
        // a comparison with NaN is false, so NaN is refused as well
        if !(inside && shaped && top_m < arc[0] && end_m > 0.0) {
            return Err(refused);
        }
        let mut builder = Builder::new();
        builder.line(top, arc, -angle);
        builder.arc(arc, -angle, angle, radius_m.recip());
        builder.line([0.0, 0.0], [end_m, 0.0], 0.0);
        Ok(builder.build())
    }

    /// Any profile as a polyline of points `[x, z]` in m, with x growing by at least [`CLOSEST_M`] a point.
    ///
    /// Every corner is replaced by the circular arc that touches both of its segments `smoothing_m` from the corner, or at
    /// the middle of the shorter one where that is nearer: the bed has no kink, stays between the points and keeps what is
    /// straight. A corner is cut by at most half of its touching distance times the tangent of half of its turn.
    ///
    /// # Errors
    /// The place of the first point that makes no bed.
    pub fn from_profile(points: &[[f64; 2]], smoothing_m: f64) -> Result<Self, TerrainError> {
        check_profile(points, smoothing_m)?;
        let segments: Vec<Segment> = points.windows(2).map(|pair| Segment::new(pair[0], pair[1])).collect();
        let mut builder = Builder::new();
        let mut at = points[0];
        for (segment, next) in segments.iter().zip(&segments[1..]) {
            let turn = next.angle - segment.angle;
            let touch = smoothing_m.min(0.5 * segment.length).min(0.5 * next.length);
            let arc = segment.point_at(segment.length - touch);
            builder.line(at, arc, segment.angle);
            at = next.point_at(touch);
            if turn.abs() > STRAIGHT {
                builder.arc(arc, segment.angle, turn, (0.5 * turn).tan() / touch);
            } else {
                builder.line(arc, at, segment.angle);
            }
        }
        if let Some(last) = segments.last() {
            builder.line(at, last.point_at(last.length), last.angle);
        }
        Ok(builder.build())
    }

    /// The first and the last x of the bed, m.
    #[must_use]
    pub fn extent_m(&self) -> (f64, f64) {
        let (first, last) = (&self.pieces[0], &self.pieces[self.pieces.len() - 1]);
        (first.start[0], last.point_at(last.length)[0])
    }

    /// Arc length of the bed, m.
    #[must_use]
    pub fn length_m(&self) -> f64 {
        let last = &self.pieces[self.pieces.len() - 1];
        last.from_s + last.length
    }

    /// Height of the lowest point, m.
    #[must_use]
    pub fn lowest_m(&self) -> f64 {
        let of_piece = |piece: &Piece| {
            let [start, end] = [piece.start[1], piece.point_at(piece.length)[1]];
            let bottom = -piece.angle / piece.curvature;
            let hollow = piece.curvature > 0.0 && (0.0..=piece.length).contains(&bottom);
            if hollow { piece.point_at(bottom)[1] } else { start.min(end) }
        };
        self.pieces.iter().map(of_piece).fold(f64::INFINITY, f64::min)
    }

    /// Height of the bed at `x_m`, m.
    #[must_use]
    pub fn height_m(&self, x_m: f64) -> f64 {
        self.piece_at(x_m).height_at(x_m)
    }

    /// Arc length from the left end of the bed to its point at `x_m`, m.
    #[must_use]
    pub fn arc_length_m(&self, x_m: f64) -> f64 {
        let piece = self.piece_at(x_m);
        piece.from_s + piece.arc_to(x_m)
    }

    /// Unit normal, out of the bed, at the point of the bed next to (`x_m`, `z_m`).
    #[must_use]
    pub fn normal(&self, x_m: f64, z_m: f64) -> [f64; 2] {
        self.project(x_m, z_m).normal
    }

    /// The point of the bed `s_m` metres of arc after its left end.
    #[must_use]
    pub fn at_arc_length(&self, s_m: f64) -> BedPoint {
        let after = self.pieces.partition_point(|piece| piece.from_s <= s_m);
        let piece = &self.pieces[after.saturating_sub(1)];
        let t = s_m - piece.from_s;
        piece.bed_point(t, piece.point_at(t))
    }

    /// The point of the bed next to (`x_m`, `z_m`).
    #[must_use]
    pub fn project(&self, x_m: f64, z_m: f64) -> BedPoint {
        let point = [x_m, z_m];
        // the nearest point is no farther than the one below
        let reach = (z_m - self.height_m(x_m)).abs();
        let last = self.pieces.len() - 1;
        let first = self.index_at(x_m - reach);
        let mut best = (f64::INFINITY, 0, 0.0);
        for index in first..=last {
            let piece = &self.pieces[index];
            if index > first && piece.start[0] > x_m + reach {
                break;
            }
            let before = if index == 0 { f64::INFINITY } else { 0.0 };
            let after = if index == last { f64::INFINITY } else { 0.0 };
            let t = piece.foot(point, before, after);
            let away = squared_distance(piece.point_at(t), point);
            if away < best.0 {
                best = (away, index, t);
            }
        }
        self.pieces[best.1].bed_point(best.2, point)
    }

    /// What of the bed lies between two arc lengths, piece by piece.
    pub(super) fn between(&self, from_s: f64, to_s: f64) -> impl Iterator<Item = Stretch> {
        let last = self.pieces.len() - 1;
        self.pieces.iter().enumerate().filter_map(move |(index, piece)| {
            let begin = if index == 0 { from_s } else { piece.from_s.max(from_s) };
            let end = if index == last { to_s } else { (piece.from_s + piece.length).min(to_s) };
            (begin < end).then_some(Stretch { from_s: begin, to_s: end, curvature: piece.curvature })
        })
    }

    fn piece_at(&self, x: f64) -> &Piece {
        &self.pieces[self.index_at(x)]
    }

    fn index_at(&self, x: f64) -> usize {
        self.pieces.partition_point(|piece| piece.start[0] <= x).saturating_sub(1)
    }
}

/// A straight piece between two points of a profile.
struct Segment {
    start: [f64; 2],
    length: f64,
    angle: f64,
}

impl Segment {
    fn new(from: [f64; 2], to: [f64; 2]) -> Self {
        let angle = (to[1] - from[1]).atan2(to[0] - from[0]);
        Self { start: from, length: squared_distance(from, to).sqrt(), angle }
    }

    fn point_at(&self, t: f64) -> [f64; 2] {
        [self.start[0] + t * self.angle.cos(), self.start[1] + t * self.angle.sin()]
    }
}

fn check_profile(points: &[[f64; 2]], smoothing_m: f64) -> Result<(), TerrainError> {
    if !(LEAST_SMOOTHING_M..=LARGEST_COORDINATE_M).contains(&smoothing_m) {
        return Err(TerrainError::Smoothing { smoothing_m });
    }
    if !(2..=MOST_POINTS).contains(&points.len()) {
        return Err(TerrainError::Points { found: points.len() });
    }
    let inside = |value: &f64| value.abs() <= LARGEST_COORDINATE_M;
    if let Some(index) = points.iter().position(|point| !point.iter().all(inside)) {
        return Err(TerrainError::Coordinate { index });
    }
    for (index, pair) in points.windows(2).enumerate() {
        let (index, [previous_m, before], [x_m, z]) = (index + 1, pair[0], pair[1]);
        if x_m - previous_m < CLOSEST_M {
            return Err(TerrainError::NotIncreasing { index, x_m, previous_m });
        }
        if (z - before).abs() > (x_m - previous_m) * STEEPEST_DEG.to_radians().tan() {
            return Err(TerrainError::TooSteep { index });
        }
    }
    Ok(())
}

//! Pieces of a robot's curve: arcs of circles and segments, as rational quadratic Bezier curves.

use crate::vector::Vector;

/// Widest arc that is one piece, rad. Wider ones have control points that are far from them.
const ARC_MAX_RAD: f64 = std::f64::consts::FRAC_PI_3;

/// Sights, from where the robot may be after the step to the predicted target, along a parameter `u` from 0 to 1:
/// `sight_m = P(u) / W(u)`, and their squared lengths, `L(u) / W(u)`.
///
/// All are quadratics in the scaled Bernstein basis `(1 - u)^2`, `u (1 - u)`, `u^2`: a product of two is the convolution of
/// their coefficients.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Piece {
    pub(super) sight: [Vector; 3],
    pub(super) square: [f64; 3],
    pub(super) weight: [f64; 3],
}

impl Piece {
    /// The segment from one sight to another.
    pub(super) fn segment(from: Vector, to: Vector) -> Self {
        let square = [from.norm_squared(), 2.0 * from.dot(to), to.norm_squared()];
        Self { sight: [from, from + to, to], square, weight: [1.0, 2.0, 1.0] }
    }

    /// The arc of the circle round `centre` through these directions: `cos` is that of half its angle, which is at most a quarter
    /// turn.
    fn arc(centre: Vector, radius_m: f64, [from, middle, to]: [Vector; 3], cos: f64) -> Self {
        let weight = [1.0, 2.0 * cos, 1.0];
        let circle = [from, middle * 2.0, to];
        let squares_m2 = centre.norm_squared() + radius_m * radius_m;
        let sight = [0, 1, 2].map(|k| centre * weight[k] + circle[k] * radius_m);
        let square = [0, 1, 2].map(|k| squares_m2 * weight[k] + 2.0 * radius_m * centre.dot(circle[k]));
        Self { sight, square, weight }
    }

    /// Pieces that make up the arc of the circle round `centre` between two angles. Each turns the last direction on, since sines
    /// take long.
    pub(super) fn arcs(centre: Vector, radius_m: f64, from_rad: f64, to_rad: f64) -> impl Iterator<Item = Self> {
        let count = ((to_rad - from_rad).abs() / ARC_MAX_RAD - 1e-9).ceil().max(1.0);
        let mut from = Vector::from_angle(from_rad);
        let turn = Vector::from_angle(0.5 * (to_rad - from_rad) / count);
        (0..count as usize).map(move |_| {
            let middle = from.rotated_by(turn);
            let to = middle.rotated_by(turn);
            let piece = Self::arc(centre, radius_m, [from, middle, to], turn.x);
            from = to;
            piece
        })
    }

    /// The sight at a parameter, m.
    pub(super) fn sight_m(&self, u: f64) -> Vector {
        let (p, w) = self.at(u);
        p * (1.0 / w)
    }

    /// `P` and `W` at a parameter.
    pub(super) fn at(&self, u: f64) -> (Vector, f64) {
        let v = 1.0 - u;
        let [a, b, c] = [v * v, u * v, u * u];
        let weight = self.weight[0] * a + self.weight[1] * b + self.weight[2] * c;
        (self.sight[0] * a + self.sight[1] * b + self.sight[2] * c, weight)
    }

    /// The derivatives of `P` and `W` at a parameter.
    pub(super) fn change_at(&self, u: f64) -> (Vector, f64) {
        let [a, b, c] = [2.0 * u - 2.0, 1.0 - 2.0 * u, 2.0 * u];
        let weight = self.weight[0] * a + self.weight[1] * b + self.weight[2] * c;
        (self.sight[0] * a + self.sight[1] * b + self.sight[2] * c, weight)
    }

    /// The part of the curve between two parameters.
    pub(super) fn part(&self, low: f64, high: f64) -> Self {
        let ends = |at: f64| [(1.0 - at) * (1.0 - at), at * (1.0 - at), at * at];
        let (first, last) = (ends(low), ends(high));
        let middle = [2.0 * (1.0 - low) * (1.0 - high), low * (1.0 - high) + high * (1.0 - low), 2.0 * low * high];
        let number =
            |c: [f64; 3]| [first, middle, last].map(|basis| c[0] * basis[0] + c[1] * basis[1] + c[2] * basis[2]);
        let vector =
            |c: [Vector; 3]| [first, middle, last].map(|basis| c[0] * basis[0] + c[1] * basis[1] + c[2] * basis[2]);
        Self { sight: vector(self.sight), square: number(self.square), weight: number(self.weight) }
    }

    /// The parts of the curve that are at most `limit_m` from the target.
    pub(super) fn parts_within(&self, limit_m: f64) -> impl Iterator<Item = Self> {
        let excess = [0, 1, 2].map(|k| self.square[k] - limit_m * limit_m * self.weight[k]);
        // excess(u) = c0 (1-u)^2 + c1 u (1-u) + c2 u^2 = a u^2 + b u + c0.
        let [c0, c1, c2] = excess;
        let (a, b) = (c0 - c1 + c2, c1 - 2.0 * c0);
        let root = (b * b - 4.0 * a * c0).max(0.0).sqrt();
        // Free of cancellation; a root that is none is not between 0 and 1.
        let q = -0.5 * (b + root.copysign(b));
        let inside = |u: f64| if u > 0.0 && u < 1.0 { u } else { 0.0 };
        let mut cuts = [0.0, inside(q / a), inside(c0 / q), 1.0];
        cuts.sort_unstable_by(f64::total_cmp);
        let piece = *self;
        (0..3).map(move |k| (cuts[k], cuts[k + 1])).filter_map(move |(low, high)| {
            let middle = 0.5 * (low + high);
            let value = (a * middle + b) * middle + c0;
            (high > low && value <= 0.0).then(|| piece.part(low, high))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn an_arc_is_on_its_circle_and_its_square_is_that_of_its_sight(
            x in -9.0..9.0_f64, y in -9.0..9.0_f64, radius in 0.1..5.0_f64, from in -3.0..3.0_f64, width in -6.0..6.0_f64,
            u in 0.0..1.0_f64, low in 0.0..0.5_f64, high in 0.5..1.0_f64,
        ) {
            let centre = Vector::new(x, y);
            for piece in Piece::arcs(centre, radius, from, from + width).chain([Piece::segment(centre, Vector::new(y, x))]) {
                let at = piece.sight_m(u);
                let basis = [(1.0 - u) * (1.0 - u), u * (1.0 - u), u * u];
                let [square, weight] = [piece.square, piece.weight].map(|c| c[0] * basis[0] + c[1] * basis[1] + c[2] * basis[2]);
                prop_assert!((square / weight - at.norm_squared()).abs() < 1e-9);
                let part = piece.part(low, high);
                prop_assert!((part.sight_m(u) - piece.sight_m(low + (high - low) * u)).norm() < 10.0 * (high - low));
                prop_assert!((part.sight_m(0.0) - piece.sight_m(low)).norm() < 1e-9);
                prop_assert!((part.sight_m(1.0) - piece.sight_m(high)).norm() < 1e-9);
                for near in piece.parts_within(4.0) {
                    prop_assert!(near.sight_m(u).norm() <= 4.0 + 1e-9);
                }
                if at.norm() < 4.0 - 1e-6 {
                    let gap_m = |part: Piece| {
                        (0..=400).map(|k| (part.sight_m(f64::from(k) / 400.0) - at).norm()).fold(f64::INFINITY, f64::min)
                    };
                    prop_assert!(piece.parts_within(4.0).map(gap_m).fold(f64::INFINITY, f64::min) < 0.05);
                }
            }
            let arcs: Vec<Piece> = Piece::arcs(centre, radius, from, from + width).collect();
            prop_assert!(arcs.iter().all(|arc| ((arc.sight_m(u) - centre).norm() - radius).abs() < 1e-9));
            let end = centre + Vector::from_angle(from + width) * radius;
            prop_assert!((arcs[arcs.len() - 1].sight_m(1.0) - end).norm() < 1e-9);
        }
    }
}

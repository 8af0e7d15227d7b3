//! Bounds on what the places of a part of a curve tell.
//!
//! Along a piece, with `P`, `L` and `W` of [`Piece`], the covariance `Pi` of the robot's position and `J` a quarter turn,
//!
//! ```text
//! Q_r = (A W + B L) L + P^T Pi P         sigma_r(d)^2 >= A + B d^2, equal at the ends
//! Q_b = sigma_b^2 L^2 + (J P)^T Pi J P
//! T = L W (1 / Q_r + 1 / Q_b),   S = P^2 (1 / Q_r - 1 / Q_b)
//! ```
//!
//! is a rational Bezier curve: it lies in the convex hull of its control points wherever the coefficients of the denominator
//! are positive.

use super::noise::Noise;
use super::piece::Piece;
use crate::vector::Vector;

/// Control points of a curve of degree 8, the highest: ranges and bearings of a robot whose position is uncertain.
const POINTS_MAX: usize = 9;

/// Steps of Newton's method at most, towards a maximum.
const STEPS_MAX: usize = 6;

/// Points whose convex hull holds what the places of a piece tell, and their weights: the coefficients of the denominator.
#[derive(Debug, Clone, Copy)]
pub(super) struct Leaf {
    /// True if its bound also holds for each of its parts, and is exact in the limit: the noise is constant, and the weights positive.
    pub(super) is_divisible: bool,
    pub(super) count: usize,
    weight: [f64; POINTS_MAX],
    t: [f64; POINTS_MAX],
    x: [f64; POINTS_MAX],
    y: [f64; POINTS_MAX],
}

/// `T + m . S` along a part of a piece, for one `m`: a quotient of two polynomials with `N` coefficients. Each `N` has loops of
/// its own, which are unrolled.
#[derive(Debug, Clone, Copy)]
pub(super) struct Section<const N: usize> {
    /// Coefficients of numerator and denominator.
    points: [[f64; 2]; N],
}

/// `N` coefficients in the scaled Bernstein basis.
#[derive(Clone, Copy)]
struct Polynomial<const N: usize>([f64; N]);

impl<const N: usize> Polynomial<N> {
    /// The product, whose degree `P - 1` is the sum of both.
    #[inline]
    fn times<const M: usize, const P: usize>(&self, other: &Polynomial<M>) -> Polynomial<P> {
        const { assert!(P + 1 == N + M) };
        let mut product = [0.0; P];
        for i in 0..N {
            for j in 0..M {
                product[i + j] += self.0[i] * other.0[j];
            }
        }
        Polynomial(product)
    }

    /// `a self + b other`.
    #[inline]
    fn combine(&self, a: f64, other: &Self, b: f64) -> Self {
        Self(std::array::from_fn(|k| a * self.0[k] + b * other.0[k]))
    }
}

impl Leaf {
    /// Of a piece.
    pub(super) fn of(noise: &Noise, part: &Piece) -> Self {
        let (w, l) = (Polynomial(part.weight), Polynomial(part.square));
        let x = Polynomial(part.sight.map(|sight| sight.x));
        let y = Polynomial(part.sight.map(|sight| sight.y));
        let (xx, yy, xy): (Polynomial<5>, Polynomial<5>, Polynomial<5>) = (x.times(&x), y.times(&y), x.times(&y));
        // P^2 as a complex number.
        let (real, imaginary) = (xx.combine(1.0, &yy, -1.0), xy.combine(2.0, &xy, 0.0));
        let p = &noise.position_m2;
        let is_exact = *p == nalgebra::Matrix2::zeros();
        let pose = |xx_m2: f64, yy_m2: f64, xy_m2: f64| xx.combine(xx_m2, &yy, yy_m2).combine(1.0, &xy, 2.0 * xy_m2);
        // Q_r and Q_b without the pose's part, over L.
        let range = noise.range.map(|(std_m, std_per_m)| {
            let (constant_m2, share) = chord(std_m, std_per_m, part);
            w.combine(constant_m2, &l, share)
        });
        let bearing = noise.bearing_rad2.map(|rad2| l.combine(rad2, &l, 0.0));
        let with_pose = |over_l: &Polynomial<3>, pose: Polynomial<5>| l.times::<3, 5>(over_l).combine(1.0, &pose, 1.0);
        let of_range = |range| with_pose(range, pose(p[(0, 0)], p[(1, 1)], p[(0, 1)]));
        let of_bearing = |bearing| with_pose(bearing, pose(p[(1, 1)], p[(0, 0)], -p[(0, 1)]));
        let is_constant = noise.range.is_none_or(|(_, std_per_m)| std_per_m == 0.0);
        let lw: Polynomial<5> = l.times(&w);
        match (range, bearing) {
            (None, None) => Self::nothing(),
            (Some(range), None) => Self::over(&of_range(&range), [&lw, &real, &imaginary], is_constant),
            (None, Some(bearing)) => {
                let [real, imaginary] = [real, imaginary].map(|s| s.combine(-1.0, &s, 0.0));
                Self::over(&of_bearing(&bearing), [&lw, &real, &imaginary], is_constant)
            }
            // Without an uncertain position a factor L cancels.
            (Some(range), Some(bearing)) if is_exact => {
                let (sum, difference) = (range.combine(1.0, &bearing, 1.0), bearing.combine(1.0, &range, -1.0));
                let denominator: Polynomial<7> = l.times::<3, 5>(&range).times(&bearing);
                let numerators = [&lw.times(&sum), &real.times(&difference), &imaginary.times(&difference)];
                Self::over(&denominator, numerators, is_constant)
            }
            (Some(range), Some(bearing)) => {
                let (range, bearing) = (of_range(&range), of_bearing(&bearing));
                let (sum, difference) = (range.combine(1.0, &bearing, 1.0), bearing.combine(1.0, &range, -1.0));
                let denominator: Polynomial<9> = range.times(&bearing);
                let numerators = [&lw.times(&sum), &real.times(&difference), &imaginary.times(&difference)];
                Self::over(&denominator, numerators, is_constant)
            }
        }
    }

    /// The quotients of the numerators of `T` and `S` and their common denominator.
    fn over<const N: usize>(
        denominator: &Polynomial<N>,
        [t, real, imaginary]: [&Polynomial<N>; 3],
        is_constant: bool,
    ) -> Self {
        let is_hull = denominator.0.iter().all(|weight| *weight > 0.0);
        let mut leaf = Self::nothing();
        (leaf.is_divisible, leaf.count) = (is_hull && is_constant, N);
        for k in 0..N {
            leaf.weight[k] = denominator.0[k] / binomial(N - 1, k);
            (leaf.t[k], leaf.x[k], leaf.y[k]) = if is_hull {
                let share = 1.0 / denominator.0[k];
                (t.0[k] * share, real.0[k] * share, imaginary.0[k] * share)
            } else {
                (f64::INFINITY, 0.0, 0.0)
            };
        }
        leaf
    }

    fn nothing() -> Self {
        let [t, x, y] = [[0.0; POINTS_MAX]; 3];
        Self { is_divisible: true, count: 1, weight: [1.0; POINTS_MAX], t, x, y }
    }

    /// `T + m . S` at a control point.
    fn along(&self, k: usize, m: Vector) -> f64 {
        self.t[k] + m.x * self.x[k] + m.y * self.y[k]
    }

    /// No place of this piece has a lesser `T`.
    pub(super) fn least_t(&self) -> f64 {
        if self.is_divisible { self.t[..self.count].iter().copied().fold(f64::INFINITY, f64::min) } else { 0.0 }
    }

    /// The most that `T + m . S` can be at a place of this piece, and where about that is.
    pub(super) fn bound(&self, m: Vector) -> (f64, f64) {
        greatest(self.count, |k| self.along(k, m))
    }

    /// Of the part between two parameters of a piece.
    pub(super) fn part(&self, noise: &Noise, piece: &Piece, low: f64, high: f64) -> Self {
        if !self.is_divisible {
            return Self::of(noise, &piece.part(low, high));
        }
        let mut points: [[f64; 4]; POINTS_MAX] =
            std::array::from_fn(|k| [1.0, self.t[k], self.x[k], self.y[k]].map(|number| number * self.weight[k]));
        between(&mut points[..self.count], low, high);
        let mut part = *self;
        for (k, [weight, t, x, y]) in points[..self.count].iter().copied().enumerate() {
            let share = 1.0 / weight;
            (part.weight[k], part.t[k], part.x[k], part.y[k]) = (weight, t * share, x * share, y * share);
        }
        part
    }

    /// True if `f(u) + g(u) T + h(u) . S` is nowhere negative, given the three coefficients of the quadratics `f`, `g` and `h`.
    pub(super) fn is_never_negative(&self, quadratics: &[(f64, f64, Vector); 3]) -> bool {
        // The coefficients of the product with the denominator.
        let mut product = [0.0; POINTS_MAX + 2];
        for (j, (f, g, h)) in quadratics.iter().enumerate() {
            let twice = if j == 1 { 2.0 } else { 1.0 };
            for k in 0..self.count {
                let value = f + g * self.t[k] + h.x * self.x[k] + h.y * self.y[k];
                product[j + k] += twice * binomial(self.count - 1, k) * self.weight[k] * value;
            }
        }
        product[..self.count + 2].iter().all(|coefficient| *coefficient >= 0.0)
    }

    /// True if `T + m . S` is at most so much at all places of this piece.
    pub(super) fn is_at_most(&self, most: f64, m: Vector) -> bool {
        // Without branches.
        (0..self.count).fold(true, |is_low, k| is_low & (self.along(k, m) <= most))
    }

    /// `T + m . S` along a part of the piece, which must have `N` control points.
    #[inline]
    pub(super) fn section<const N: usize>(&self, m: Vector, low: f64, high: f64) -> Section<N> {
        let mut points = std::array::from_fn(|k| [self.weight[k] * self.along(k, m), self.weight[k]]);
        between(&mut points, low, high);
        Section { points }
    }
}

impl<const N: usize> Section<N> {
    /// The most that it can be, and where about that is.
    pub(super) fn bound(&self) -> (f64, f64) {
        greatest(N, |k| self.points[k][0] / self.points[k][1])
    }

    /// A maximum near a guess, but for a quarter of `slack`, and the parts before and after it; `None` if Newton's method does
    /// not find one.
    pub(super) fn summit(&self, guess: f64, slack: f64) -> Option<(f64, Halves<N>)> {
        let mut u = guess;
        for _ in 0..STEPS_MAX {
            let halves = self.halves(u);
            let (slope, bend) = halves.slope_and_bend();
            if bend >= 0.0 {
                return None;
            }
            // A parabola rises by so much from here.
            if slope * slope <= -0.5 * bend * slack {
                return Some((u, halves));
            }
            u -= slope / bend;
            if !(u > 0.0 && u < 1.0) {
                return None;
            }
        }
        None
    }

    /// The parts before and after a parameter, by de Casteljau's algorithm.
    #[inline]
    pub(super) fn halves(&self, u: f64) -> Halves<N> {
        let mut points = self.points;
        let (mut before, mut after) = (points, points);
        let [mut first, mut second] = [[0.0; 2]; 2];
        let degree = N as f64 - 1.0;
        for last in (0..N).rev() {
            (before[last], after[last]) = (points[0], points[last]);
            if last == 2 {
                let scale = degree * (degree - 1.0);
                second = [0, 1].map(|i| scale * (points[0][i] - 2.0 * points[1][i] + points[2][i]));
            }
            if last == 1 {
                first = [0, 1].map(|i| degree * (points[1][i] - points[0][i]));
            }
            for k in 0..last {
                points[k] = [0, 1].map(|i| (1.0 - u) * points[k][i] + u * points[k + 1][i]);
            }
        }
        Halves { before, after, first, second }
    }
}

/// The two parts of a [`Section`] before and after a parameter.
#[derive(Debug, Clone, Copy)]
pub(super) struct Halves<const N: usize> {
    /// Coefficients from the cut on, of numerator and denominator.
    before: [[f64; 2]; N],
    after: [[f64; 2]; N],
    /// Derivatives at the cut.
    first: [f64; 2],
    second: [f64; 2],
}

impl<const N: usize> Halves<N> {
    /// First and second derivative of the quotient at the cut.
    #[inline]
    fn slope_and_bend(&self) -> (f64, f64) {
        let [numerator, denominator] = self.after[0];
        let share = 1.0 / denominator;
        let value = numerator * share;
        let slope = (self.first[0] - value * self.first[1]) * share;
        let bend = (self.second[0] - value * self.second[1] - 2.0 * slope * self.first[1]) * share;
        (slope, bend)
    }

    /// Whether each part is at most so much.
    #[inline]
    pub(super) fn is_at_most(&self, most: f64) -> [bool; 2] {
        [is_at_most(&self.before, most), is_at_most(&self.after, most)]
    }
}

/// True if a quotient is at most so much, given the coefficients of its numerator and denominator.
#[inline]
fn is_at_most<const N: usize>(points: &[[f64; 2]; N], most: f64) -> bool {
    let mut left: [f64; N] = std::array::from_fn(|k| most * points[k][1] - points[k][0]);
    // Without branches.
    let is_low = left.iter().fold(true, |is_low, c| is_low & (*c >= 0.0));
    is_low || is_above_square(&left) || {
        left.reverse();
        is_above_square(&left)
    }
}

/// True if a polynomial is nowhere less than the square of a line `a (1 - u) + b u`, and so not negative: the first two
/// coefficients are those of the square, and none of the others is less than its.
///
/// It may have its minimum near the start, where the second coefficient would be negative by the first power of the distance.
#[inline]
fn is_above_square<const N: usize>(c: &[f64; N]) -> bool {
    let degree = N as f64 - 1.0;
    if N < 3 || c[0] <= 0.0 {
        return false;
    }
    let a2 = c[0];
    let ab = 0.5 * (degree * c[1] - (degree - 2.0) * a2);
    let b2 = ab * ab / a2;
    let scale = 1.0 / (degree * (degree - 1.0));
    (2..N).all(|index| {
        let k = index as f64;
        let left = degree - k;
        c[index] >= (left * (left - 1.0) * a2 + 2.0 * k * left * ab + k * (k - 1.0) * b2) * scale
    })
}

/// The coefficients of polynomials on the part after a parameter, by de Casteljau's algorithm; `before` is called with those
/// on the part before it.
fn cut<const N: usize>(points: &mut [[f64; N]], u: f64, mut before: impl FnMut([f64; N])) {
    before(points[0]);
    for last in (0..points.len() - 1).rev() {
        for k in 0..=last {
            points[k] = std::array::from_fn(|i| (1.0 - u) * points[k][i] + u * points[k + 1][i]);
        }
        before(points[0]);
    }
}

/// The coefficients on the part between two parameters.
fn between<const N: usize>(points: &mut [[f64; N]], low: f64, high: f64) {
    if high < 1.0 {
        points.reverse();
        cut(points, 1.0 - high, |_| ());
        points.reverse();
    }
    if low > 0.0 {
        cut(points, low / high, |_| ());
    }
}

/// The greatest of the values of control points, and the share of the way at which its control point is.
fn greatest(count: usize, value: impl Fn(usize) -> f64) -> (f64, f64) {
    let mut best = (f64::NEG_INFINITY, 0);
    for k in 0..count {
        let value = value(k);
        if value > best.0 {
            best = (value, k);
        }
    }
    (best.0, if count > 1 { best.1 as f64 / (count - 1) as f64 } else { 0.0 })
}

/// `n` choose `k`, of the degrees that there are.
fn binomial(n: usize, k: usize) -> f64 {
    const ROWS: [[f64; POINTS_MAX]; 4] = [
        [1.0, 4.0, 6.0, 4.0, 1.0, 0.0, 0.0, 0.0, 0.0],
        [1.0, 6.0, 15.0, 20.0, 15.0, 6.0, 1.0, 0.0, 0.0],
        [1.0, 8.0, 28.0, 56.0, 70.0, 56.0, 28.0, 8.0, 1.0],
        [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    ];
    ROWS[if n == 0 { 3 } else { (n - 4) / 2 }][k]
}

/// `A` and `B` of a line through the ends below `sigma_r(d)^2` as a function of `d^2`, by that below `d`, which is concave
/// in it.
fn chord(std_m: f64, std_per_m: f64, part: &Piece) -> (f64, f64) {
    let variance_m2 = std_m * std_m;
    if std_per_m == 0.0 {
        return (variance_m2, 0.0);
    }
    // The middle coefficient is scaled by two, in both.
    let squares = [0, 1, 2].map(|k| part.square[k] / part.weight[k]);
    let least_m = squares.iter().copied().fold(f64::INFINITY, f64::min).max(0.0).sqrt();
    let most_m = squares.iter().copied().fold(0.0, f64::max).sqrt();
    let (constant_m, slope_per_m) = match least_m + most_m {
        0.0 => (0.0, 0.0),
        sum_m => (least_m * most_m / sum_m, 1.0 / sum_m),
    };
    let growth = 2.0 * std_m * std_per_m;
    (variance_m2 + growth * constant_m, std_per_m * std_per_m + growth * slope_per_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::array::uniform5;
    use proptest::prelude::*;

    /// The value of a polynomial with these Bernstein coefficients.
    fn value<const N: usize>(mut c: [f64; N], u: f64) -> f64 {
        for last in (0..N).rev() {
            (0..last).for_each(|k| c[k] = (1.0 - u) * c[k] + u * c[k + 1]);
        }
        c[0]
    }

    proptest! {
        /// A polynomial that counts as not negative is not, and one with a minimum near its start and above 0 counts as that.
        #[test]
        fn a_polynomial_above_a_square_is_not_negative(
            first in 1e-9..1.0_f64, slope in -1.0..1.0_f64, others in uniform5(0.0..1.0_f64), u in 0.0..1.0_f64,
        ) {
            let [a, b, c, d, e] = others;
            let polynomial = [first, first + slope * first.sqrt(), a, b, c, d, e];
            prop_assert!(!is_above_square(&polynomial) || value(polynomial, u) >= -1e-15, "{polynomial:?}");
            // (u - v)^2 plus a little, with its minimum at a small v.
            let (v, little) = (1e-3 * a, 1e-9 * (0.1 + b));
            let square: [f64; 5] = std::array::from_fn(|k| {
                let k = k as f64;
                v * v - 0.5 * v * k + k * (k - 1.0) / 12.0
            });
            prop_assert!(square.iter().any(|c| *c < 0.0) || v == 0.0);
            prop_assert!(is_above_square(&square.map(|c| c + little)) && !is_above_square(&square.map(|c| c - little)));
        }

        /// Newton's method ends at a maximum, and a part's coefficients tell what its places have at most.
        #[test]
        fn a_section_is_cut_at_its_maximum(
            numerator in uniform5(0.0..1.0_f64), denominator in uniform5(0.5..2.0_f64), guess in 0.01..0.99_f64,
            u in 0.0..1.0_f64,
        ) {
            let section = Section::<5> { points: std::array::from_fn(|k| [numerator[k], denominator[k]]) };
            let quotient = |u: f64| value(numerator, u) / value(denominator, u);
            if let Some((cut, halves)) = section.summit(guess, 1e-9) {
                prop_assert!(quotient(cut) >= quotient(cut - 1e-3).max(quotient(cut + 1e-3)) - 1e-9);
                let places = [u * cut, cut + u * (1.0 - cut)];
                for most in [quotient(cut) + 1e-9, quotient(cut) + 0.01 * u] {
                    for (is_low, at) in halves.is_at_most(most).into_iter().zip(places) {
                        prop_assert!(!is_low || quotient(at) <= most + 1e-12, "{at}: {} {most}", quotient(at));
                    }
                }
            }
        }
    }
}

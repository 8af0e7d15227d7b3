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

/// Points whose convex hull holds what the places of a piece tell, and their weights: the coefficients of the denominator.
#[derive(Debug, Clone, Copy)]
pub(super) struct Leaf {
    /// True if its bound also holds for each of its parts, and is exact in the limit: the noise is constant, and the weights positive.
    pub(super) is_divisible: bool,
    count: usize,
    weight: [f64; POINTS_MAX],
    t: [f64; POINTS_MAX],
    x: [f64; POINTS_MAX],
    y: [f64; POINTS_MAX],
}

/// `T + m . S` along a part of a piece, for one `m`: a quotient of two polynomials.
#[derive(Debug, Clone, Copy)]
pub(super) struct Section {
    count: usize,
    /// Coefficients of numerator and denominator.
    points: [[f64; 2]; POINTS_MAX],
}

/// Coefficients in the scaled Bernstein basis, as many as the degree and one.
#[derive(Clone, Copy)]
struct Polynomial {
    count: usize,
    c: [f64; POINTS_MAX],
}

impl Polynomial {
    fn new(coefficients: [f64; 3]) -> Self {
        let [a, b, c] = coefficients;
        Self { count: 3, c: [a, b, c, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0] }
    }

    fn times(&self, other: &Self) -> Self {
        let mut c = [0.0; POINTS_MAX];
        for i in 0..self.count {
            for j in 0..other.count {
                c[i + j] += self.c[i] * other.c[j];
            }
        }
        Self { count: self.count + other.count - 1, c }
    }

    /// `a self + b other`, of equal degree.
    fn combine(&self, a: f64, other: &Self, b: f64) -> Self {
        Self { count: self.count, c: std::array::from_fn(|k| a * self.c[k] + b * other.c[k]) }
    }
}

impl Leaf {
    /// Of a piece.
    pub(super) fn of(noise: &Noise, part: &Piece) -> Self {
        let (w, l) = (Polynomial::new(part.weight), Polynomial::new(part.square));
        let x = Polynomial::new(part.sight.map(|sight| sight.x));
        let y = Polynomial::new(part.sight.map(|sight| sight.y));
        let (xx, yy, xy) = (x.times(&x), y.times(&y), x.times(&y));
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
        let range_pose = || pose(p[(0, 0)], p[(1, 1)], p[(0, 1)]);
        let bearing_pose = || pose(p[(1, 1)], p[(0, 0)], -p[(0, 1)]);
        let lw = l.times(&w);
        let [denominator, t, real, imaginary] = match (range, bearing) {
            (None, None) => return Self::nothing(),
            (Some(range), None) => [l.times(&range).combine(1.0, &range_pose(), 1.0), lw, real, imaginary],
            (None, Some(bearing)) => {
                let denominator = l.times(&bearing).combine(1.0, &bearing_pose(), 1.0);
                [denominator, lw, real.combine(-1.0, &real, 0.0), imaginary.combine(-1.0, &imaginary, 0.0)]
            }
            // Without an uncertain position a factor L cancels.
            (Some(range), Some(bearing)) if is_exact => {
                let (sum, difference) = (range.combine(1.0, &bearing, 1.0), bearing.combine(1.0, &range, -1.0));
                let denominator = l.times(&range).times(&bearing);
                [denominator, lw.times(&sum), real.times(&difference), imaginary.times(&difference)]
            }
            (Some(range), Some(bearing)) => {
                let range = l.times(&range).combine(1.0, &range_pose(), 1.0);
                let bearing = l.times(&bearing).combine(1.0, &bearing_pose(), 1.0);
                let (sum, difference) = (range.combine(1.0, &bearing, 1.0), bearing.combine(1.0, &range, -1.0));
                [range.times(&bearing), lw.times(&sum), real.times(&difference), imaginary.times(&difference)]
            }
        };
        let count = denominator.count;
        let is_hull = denominator.c[..count].iter().all(|weight| *weight > 0.0);
        let over = |numerator: Polynomial, unbounded: f64| {
            std::array::from_fn(|k| match k < count {
                true if is_hull => numerator.c[k] / denominator.c[k],
                true => unbounded,
                false => 0.0,
            })
        };
        Self {
            is_divisible: is_hull && noise.range.is_none_or(|(_, std_per_m)| std_per_m == 0.0),
            count,
            weight: std::array::from_fn(|k| if k < count { denominator.c[k] / binomial(count - 1, k) } else { 0.0 }),
            t: over(t, f64::INFINITY),
            x: over(real, 0.0),
            y: over(imaginary, 0.0),
        }
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

    /// `T + m . S` along the piece.
    pub(super) fn section(&self, m: Vector) -> Section {
        let points = std::array::from_fn(|k| [self.weight[k] * self.along(k, m), self.weight[k]]);
        Section { count: self.count, points }
    }
}

impl Section {
    /// The part between two parameters.
    pub(super) fn part(mut self, low: f64, high: f64) -> Self {
        between(&mut self.points[..self.count], low, high);
        self
    }

    /// The most that it can be, and where about that is.
    pub(super) fn bound(&self) -> (f64, f64) {
        greatest(self.count, |k| self.points[k][0] / self.points[k][1])
    }

    /// Whether it is at most so much before and after a parameter.
    pub(super) fn is_at_most(mut self, most: f64, u: f64) -> [bool; 2] {
        let is_low = |[value, weight]: [f64; 2]| value <= most * weight;
        let points = &mut self.points[..self.count];
        let mut is_low_before = true;
        cut(points, u, |before| is_low_before &= is_low(before));
        [is_low_before, points.iter().copied().all(is_low)]
    }
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

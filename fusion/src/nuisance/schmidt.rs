//! The update of the Schmidt filter in O(M).
//!
//! With the measurements of each robot whitened by their own noise and nuisances, `D = n P_i n^T + R`, each has a row
//! `h` on the position and `c = C_1i n^T`, its covariance with the position's error: `S = I + U K U^T` with `U = [h c]` and
//! `K = [[P_11, I], [I, 0]]`. With `A = U^T U` and
//!
//! ```text
//! Q = P_11 - A_22,   B = I + A_12,   W = K^-1 + A = [[A_11, B], [B^T, -Q]],   E = W^-1
//! ```
//!
//! the posterior covariance of the position is `E_11 = (A_11 + B Q^-1 B^T)^-1`, a sum of positive terms, and the gain on
//! the position is `[E_11 E_12] U^T`. Nothing cancels, however vague the prior is. The other states follow by their
//! regression `b = P_x1 P_11^-1` on the position, and by what the measurements tell beyond it: `g = C_i n^T - b c` of each,
//! with `L = sum g u^T`. Without nuisances this is the update of [`Gaussian::update`](crate::filter::Gaussian::update).

use nalgebra::{Matrix2, Matrix4, SMatrix, SVector, Vector2, Vector4};

use super::{Chain, Cross, NUISANCES, Row};
use crate::filter::{Gaussian, conditioned, determinant, posterior_covariance, set_position};

/// Least determinant of `B` with which the position's covariance is computed without an inverse.
const WELL_CONDITIONED: f64 = 0.1;

/// Least variance of `Q`, relative to the position's.
const REST_MIN: f64 = 1e-12;

/// A measurement, divided by the square root of its variance.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Whitened<const N: usize> {
    robot: usize,
    /// `[h c]`.
    u: Vector4<f64>,
    /// `g`: zero for the position.
    g: SVector<f64, N>,
    /// `n P_i`.
    own: SVector<f64, NUISANCES>,
    innovation: f64,
}

/// The sums over the measurements, and what follows from them.
struct Solved<const N: usize> {
    /// `E`.
    e: Matrix4<f64>,
    /// `L`.
    l: SMatrix<f64, N, 4>,
    /// `sum g nu`.
    g_nu: SVector<f64, N>,
    /// `sum g g^T`.
    g_g: SMatrix<f64, N, N>,
    /// `E U^T nu`.
    solution: Vector4<f64>,
    nis: f64,
}

/// The posterior of the target and its normalised innovation squared; updates the cross-covariances.
pub(super) fn update<'a, const N: usize>(
    prior: &Gaussian<N>,
    crosses: &mut [Cross<N>],
    chain: &Chain,
    rows: impl Iterator<Item = &'a Row> + Clone,
    whitened: &mut Vec<Whitened<N>>,
) -> (Gaussian<N>, f64) {
    let b = regression(prior);
    whiten(&b, crosses, chain, rows, whitened);
    let Solved { e, l, g_nu, g_g, solution, nis } = solve(prior, whitened);
    let (e_upper, e_right) = (e.fixed_rows::<2>(0).into_owned(), e.fixed_columns::<2>(2).into_owned());
    let position = e.fixed_view::<2, 2>(0, 0).into_owned();

    let mut x = prior.x + b * solution.fixed_rows::<2>(0) + g_nu - l * solution;
    x[0] = prior.x[0] + solution[0];
    x[1] = prior.x[1] + solution[1];
    // Covariance of the position with what the other states have beyond their regression on it.
    let beyond = -(l * e.fixed_columns::<2>(0));
    let mixed = beyond * b.transpose();
    let mut p = prior.p + b * (position - prior.position_covariance()) * b.transpose() + mixed + mixed.transpose()
        - g_g
        + l * e * l.transpose();
    let with_position = b * position + beyond;
    set_position(&mut p, &position, &with_position, &prior.p);

    let gain = b * e_upper - l * e;
    let gain_h = b * (Matrix2::identity() - e.fixed_view::<2, 2>(0, 2)) + l * e_right;
    for cross in crosses.iter_mut() {
        let of_position = cross.fixed_rows::<2>(0).into_owned();
        *cross -= gain_h * of_position;
    }
    for row in whitened.iter() {
        if let Some(cross) = crosses.get_mut(row.robot) {
            *cross -= (gain * row.u + row.g) * row.own.transpose();
        }
    }
    (Gaussian { x, p: conditioned(&p) }, nis)
}

/// Regression of the state on the position, `P_x1 P_11^-1`: the identity for the position itself.
fn regression<const N: usize>(prior: &Gaussian<N>) -> SMatrix<f64, N, 2> {
    let position = prior.position_covariance();
    let mut b = prior.p.fixed_columns::<2>(0) * adjugate(&position) / determinant(&position).max(f64::MIN_POSITIVE);
    b.fixed_rows_mut::<2>(0).copy_from(&Matrix2::identity());
    b
}

/// The normalised innovation squared alone.
pub(super) fn nis<'a, const N: usize>(
    prior: &Gaussian<N>,
    crosses: &[Cross<N>],
    chain: &Chain,
    rows: impl Iterator<Item = &'a Row> + Clone,
    whitened: &mut Vec<Whitened<N>>,
) -> f64 {
    whiten(&regression(prior), crosses, chain, rows, whitened);
    solve(prior, whitened).nis
}

/// Whitens the measurements of each robot, which share its nuisances.
fn whiten<'a, const N: usize>(
    b: &SMatrix<f64, N, 2>,
    crosses: &[Cross<N>],
    chain: &Chain,
    rows: impl Iterator<Item = &'a Row> + Clone,
    whitened: &mut Vec<Whitened<N>>,
) {
    whitened.clear();
    // The previous row of the same robot, and its covariance with the nuisances.
    let mut first: Option<(&Row, SVector<f64, NUISANCES>)> = None;
    for row in rows {
        let Some(cross) = crosses.get(row.robot) else { continue };
        let own = chain.covariance(row.robot).times(&row.nuisance);
        let with_state = cross * row.nuisance;
        let (h, c) = (row.innovation.gradient, Vector2::new(with_state[0], with_state[1]));
        let mut white = Whitened {
            robot: row.robot,
            u: Vector4::new(h.x, h.y, c.x, c.y),
            g: with_state - b * c,
            own,
            innovation: row.innovation.innovation,
        };
        let mut variance = own.dot(&row.nuisance) + row.innovation.noise_variance;
        match (first, whitened.last()) {
            (Some((before, before_own)), Some(before_white)) if before.robot == row.robot => {
                let before_std = (before_own.dot(&before.nuisance) + before.innovation.noise_variance).sqrt();
                let shared = before_own.dot(&row.nuisance) / before_std;
                white.u -= before_white.u * shared;
                white.g -= before_white.g * shared;
                white.own -= before_white.own * shared;
                white.innovation -= before_white.innovation * shared;
                variance -= shared * shared;
            }
            _ => first = Some((row, own)),
        }
        let scale = variance.max(row.innovation.noise_variance).sqrt().recip();
        white.u *= scale;
        white.g *= scale;
        white.own *= scale;
        white.innovation *= scale;
        whitened.push(white);
    }
}

fn solve<const N: usize>(prior: &Gaussian<N>, whitened: &[Whitened<N>]) -> Solved<N> {
    let mut a = Matrix4::zeros();
    let mut l = SMatrix::<f64, N, 4>::zeros();
    let mut g_nu = SVector::<f64, N>::zeros();
    let mut g_g = SMatrix::<f64, N, N>::zeros();
    let mut u_nu = Vector4::zeros();
    for row in whitened {
        a += row.u * row.u.transpose();
        l += row.g * row.u.transpose();
        g_nu += row.g * row.innovation;
        g_g += row.g * row.g.transpose();
        u_nu += row.u * row.innovation;
    }
    let p = prior.position_covariance();
    let (a11, a12) = (a.fixed_view::<2, 2>(0, 0).into_owned(), a.fixed_view::<2, 2>(0, 2).into_owned());
    let b = Matrix2::identity() + a12;
    let mut q = p - a.fixed_view::<2, 2>(2, 2);
    for i in 0..2 {
        // Rounding must not make it indefinite.
        q[(i, i)] = q[(i, i)].max(0.0) + REST_MIN * p[(i, i)];
    }
    let q_inverse = adjugate(&q) / determinant(&q).max(f64::MIN_POSITIVE);
    let det_b = b[(0, 0)] * b[(1, 1)] - b[(0, 1)] * b[(1, 0)];
    let e11 = match b.try_inverse() {
        Some(b_inverse) if det_b > WELL_CONDITIONED => {
            let effective = b_inverse.transpose() * q * b_inverse;
            posterior_covariance(&effective, determinant(&effective), &a11)
        }
        _ => {
            let information = a11 + b * q_inverse * b.transpose();
            adjugate(&information) / determinant(&information).max(f64::MIN_POSITIVE)
        }
    };
    let e11 = (e11 + e11.transpose()) * 0.5;
    let e12 = e11 * b * q_inverse;
    let e22 = q_inverse * (b.transpose() * e12) - q_inverse;
    let mut e = Matrix4::zeros();
    e.fixed_view_mut::<2, 2>(0, 0).copy_from(&e11);
    e.fixed_view_mut::<2, 2>(0, 2).copy_from(&e12);
    e.fixed_view_mut::<2, 2>(2, 0).copy_from(&e12.transpose());
    e.fixed_view_mut::<2, 2>(2, 2).copy_from(&((e22 + e22.transpose()) * 0.5));

    let solution: Vector4<f64> = e * u_nu;
    let (y, z) = (Vector2::new(solution[0], solution[1]), Vector2::new(solution[2], solution[3]));
    let residuals = whitened.iter().map(|row| row.innovation - row.u.dot(&solution));
    let nis = residuals.map(|residual| residual * residual).sum::<f64>() + 2.0 * y.dot(&z) - z.dot(&(p * z));
    Solved { e, l, g_nu, g_g, solution, nis: nis.max(0.0) }
}

fn adjugate(m: &Matrix2<f64>) -> Matrix2<f64> {
    Matrix2::new(m[(1, 1)], -m[(0, 1)], -m[(1, 0)], m[(0, 0)])
}

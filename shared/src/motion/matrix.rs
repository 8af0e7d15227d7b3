//! Square matrices of scenario files: checked row by row, stored row-major.

use nalgebra::{DMatrix, SMatrix, SymmetricEigen};
use serde::{Deserialize, Serialize};

/// A dense matrix of run-time size, row-major: used in a scenario, before the state dimension
/// becomes part of a type.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Matrix {
    rows: usize,
    columns: usize,
    values: Vec<f64>,
}

impl Matrix {
    /// The matrix with these rows, or `None` if there are no rows, their lengths differ, or a
    /// value is not finite.
    #[must_use]
    pub fn from_rows(rows: &[Vec<f64>]) -> Option<Self> {
        let columns = rows.first()?.len();
        if columns == 0 || rows.iter().any(|row| row.len() != columns) {
            return None;
        }
        let values: Vec<f64> = rows.iter().flatten().copied().collect();
        values.iter().all(|value| value.is_finite()).then_some(Self { rows: rows.len(), columns, values })
    }

    /// The diagonal matrix with this diagonal.
    #[must_use]
    pub fn from_diagonal(diagonal: &[f64]) -> Self {
        let n = diagonal.len();
        let mut values = vec![0.0; n * n];
        for (i, value) in diagonal.iter().enumerate() {
            values[i * n + i] = *value;
        }
        Self { rows: n, columns: n, values }
    }

    /// (rows, columns).
    #[must_use]
    pub fn shape(&self) -> (usize, usize) {
        (self.rows, self.columns)
    }

    /// True if it is n x n of finite numbers. Every matrix made here has a consistent size.
    pub(crate) fn is_complete(&self, n: usize) -> bool {
        (self.rows, self.columns, self.values.len()) == (n, n, n.saturating_mul(n))
            && self.values.iter().all(|value| value.is_finite())
    }

    /// Converts to a matrix of fixed size; entries outside this matrix are zero.
    #[must_use]
    pub fn to_static<const R: usize, const C: usize>(&self) -> SMatrix<f64, R, C> {
        SMatrix::from_fn(|i, j| if i < self.rows && j < self.columns { self.values[i * self.columns + j] } else { 0.0 })
    }

    /// `G Q G^T` for this `Q`; symmetric to the bit.
    #[must_use]
    pub fn congruence(&self, g: &Self) -> Self {
        let (g, q) = (g.to_dynamic(), self.to_dynamic());
        let product = &g * q * g.transpose();
        let n = product.nrows();
        let values = (0..n * n).map(|k| (product[(k / n, k % n)] + product[(k % n, k / n)]) * 0.5).collect();
        Self { rows: n, columns: n, values }
    }

    /// Smallest eigenvalue relative to the largest, or `None` if the matrix is not symmetric (to
    /// 1e-9 of its largest entry) or not square. Positive definite: above zero.
    #[must_use]
    pub fn relative_min_eigenvalue(&self) -> Option<f64> {
        if self.rows != self.columns {
            return None;
        }
        let m = self.to_dynamic();
        let scale = m.amax();
        if (&m - m.transpose()).amax() > 1e-9 * scale {
            return None;
        }
        let eigenvalues = SymmetricEigen::new(m).eigenvalues;
        Some(if scale > 0.0 { eigenvalues.min() / scale } else { 0.0 })
    }

    fn to_dynamic(&self) -> DMatrix<f64> {
        DMatrix::from_row_slice(self.rows, self.columns, &self.values)
    }
}

/// The symmetric square root `B` of a positive semi-definite matrix, `B B^T = A`: turns standard
/// normal draws into draws with covariance `A`, singular `A` included.
#[must_use]
pub fn square_root<const N: usize>(a: &SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
    // The dynamic decomposition: the static one needs bounds that a generic N cannot state.
    let eigen = SymmetricEigen::new(DMatrix::from_fn(N, N, |i, j| a[(i, j)]));
    SMatrix::from_fn(|i, j| {
        (0..N)
            .map(|k| eigen.eigenvectors[(i, k)] * eigen.eigenvalues[k].max(0.0).sqrt() * eigen.eigenvectors[(j, k)])
            .sum()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_square_root_squares_back_even_when_singular() {
        let a = SMatrix::<f64, 3, 3>::new(4.0, 2.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0, 9.0);
        let b = square_root(&a);
        assert!((b * b.transpose() - a).amax() < 1e-12);
    }

    #[test]
    fn ragged_empty_and_non_finite_rows_are_no_matrix() {
        assert!(Matrix::from_rows(&[]).is_none());
        assert!(Matrix::from_rows(&[vec![]]).is_none());
        assert!(Matrix::from_rows(&[vec![1.0, 2.0], vec![3.0]]).is_none());
        assert!(Matrix::from_rows(&[vec![f64::NAN]]).is_none());
    }

    #[test]
    fn definiteness_is_told_apart() {
        let of = |rows: &[[f64; 2]]| {
            Matrix::from_rows(&rows.iter().map(|r| r.to_vec()).collect::<Vec<_>>()).unwrap().relative_min_eigenvalue()
        };
        assert!(of(&[[2.0, 1.0], [1.0, 2.0]]).unwrap() > 0.0);
        assert!(of(&[[1.0, 2.0], [2.0, 1.0]]).unwrap() < 0.0);
        assert_eq!(of(&[[1.0, 2.0], [0.0, 1.0]]), None);
    }
}

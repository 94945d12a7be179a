//! Linear least squares with some unknowns not negative.

use nalgebra::{DMatrix, DVector};

/// Share of its own sum of squares that is added to each unknown's, the preferred ones' and the others': columns that are alike share
/// what they explain, and what a preferred one and another explain alike goes to the preferred one.
const RIDGE: [f64; 2] = [1.0e-9, 1.0e-7];

/// Unknowns that solve `normal * x = right`, none negative. Where `preferred` ones turn negative, the last of the others goes.
///
/// Unknowns that turn negative are left out one at a time, the most negative first. Lawson and Hanson's active set (Solving Least
/// Squares Problems, 1974, chapter 23) would take some of them in again; between neighbouring stop operators, which are nearly
/// the same, that changes which of two carries a strength and not what they do together. The crates that have it want the
/// whole matrix of equations, which a session of minutes makes large; the normal equations are 17 by 17.
pub(super) fn non_negative(
    normal: &DMatrix<f64>,
    right: &DVector<f64>,
    preferred: impl Fn(usize) -> bool,
) -> DVector<f64> {
    let columns = normal.ncols();
    let mut used: Vec<usize> = (0..columns).filter(|&i| normal[(i, i)] > 0.0).collect();
    loop {
        let n = used.len();
        let a = DMatrix::from_fn(n, n, |i, j| {
            let share = RIDGE[usize::from(!preferred(used[i]))];
            let ridge = if i == j { share * normal[(used[i], used[i])] } else { 0.0 };
            normal[(used[i], used[j])] + ridge
        });
        let b = DVector::from_fn(n, |i, _| right[used[i]]);
        let x = a.cholesky().map_or_else(|| DVector::zeros(n), |a| a.solve(&b));
        let worst = (0..n)
            .filter(|&i| !preferred(used[i]) && x[i] < 0.0)
            .min_by(|&i, &j| x[i].total_cmp(&x[j]))
            .or_else(|| {
                let negative = (0..n).find(|&i| x[i] < 0.0)?;
                (0..n).rfind(|&i| !preferred(used[i])).or(Some(negative))
            });
        match worst {
            Some(i) => {
                used.remove(i);
            }
            None => {
                let mut all = DVector::zeros(columns);
                for (value, &column) in x.iter().zip(&used) {
                    all[column] = *value;
                }
                return all;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_would_be_negative_is_zero() {
        // y = 2 a - b: the best is a alone, or with b preferred nothing but b, which is then zero too.
        let rows = [[1.0, 0.5], [0.3, 1.0], [-0.7, 0.2], [0.4, -1.0]];
        let matrix = DMatrix::from_fn(4, 2, |i, j| rows[i][j]);
        let right = DVector::from_fn(4, |i, _| 2.0 * rows[i][0] - rows[i][1]);
        let (normal, projected) = (matrix.transpose() * &matrix, matrix.transpose() * right);
        let found = non_negative(&normal, &projected, |i| i == 0);
        assert_eq!(found[1], 0.0);
        assert!((found[0] - projected[0] / normal[(0, 0)]).abs() < 1.0e-6, "{found}");
        let found = non_negative(&normal, &projected, |i| i == 1);
        assert!(found[0] == 0.0 && found[1] >= 0.0, "{found}");
    }
}

//! A custom target model: prints a scenario whose target moves by this model.
//!
//! ```sh
//! cargo run --release -p rangehound-shared --example own_motion_model > singer.toml
//! rangehound run singer.toml
//! ```
//!
//! Any linear model `dx = A x dt + dw` with position first works. This one is Singer's: the driver keeps an acceleration for
//! some seconds and then changes it. A model that the tool should know by name goes into
//! `shared/src/motion/mod.rs`.

use nalgebra::SMatrix;

/// `[x y vx vy ax ay]`.
type Matrix = SMatrix<f64, 6, 6>;

/// How long a manoeuvre lasts, s.
const MANOEUVRE_S: f64 = 4.0;
/// Strength of a manoeuvre: standard deviation of the acceleration on each axis, m/s^2.
const ACCELERATION_STD_MPS2: f64 = 0.8;
const DT_S: f64 = 0.1;

/// Doublings of a very short step that give the full step.
const DOUBLINGS: i32 = 20;

fn main() {
    let mut a = Matrix::zeros();
    let mut psd = Matrix::zeros();
    for axis in 0..2 {
        a[(axis, 2 + axis)] = 1.0;
        a[(2 + axis, 4 + axis)] = 1.0;
        a[(4 + axis, 4 + axis)] = -1.0 / MANOEUVRE_S;
        psd[(4 + axis, 4 + axis)] = 2.0 * ACCELERATION_STD_MPS2.powi(2) / MANOEUVRE_S;
    }
    let (phi, qd) = discretised(&a, &psd, DT_S);
    println!(
        "# Singer's model: an acceleration of {ACCELERATION_STD_MPS2} m/s^2 that is kept for about {MANOEUVRE_S} s."
    );
    println!("name = \"singer\"\nticks = 300\ndt_s = {DT_S}\nclock = \"lockstep\"\n");
    println!("[target]\nmodel = \"custom\"\nstart = [0.0, 0.0, 2.0, 1.0, 0.0, 0.0]");
    println!("phi = {}\nqd = {}\n", rows(&phi), rows(&qd));
    println!("[prior]\ncovariance = [4.0, 4.0, 1.0, 1.0, 0.5, 0.5]\n");
    println!("[robots]\ncount = 3\nstart_m = [10.0, 0.0]\nring_radius_m = 5.0\nspeed_mps = 6.0\nrange_std_m = 0.5");
}

/// `Phi = exp(A dt)` and `Qd`, the covariance that white noise of this spectral density leaves after a step.
fn discretised(a: &Matrix, psd: &Matrix, dt_s: f64) -> (Matrix, Matrix) {
    let short_s = dt_s / 2.0_f64.powi(DOUBLINGS);
    let step = a * short_s;
    let mut phi = Matrix::identity() + step + step * step * 0.5;
    // Noise at the middle of the short step: exact to the square of its length.
    let half = Matrix::identity() + step * 0.5;
    let mut qd = half * psd * half.transpose() * short_s;
    for _ in 0..DOUBLINGS {
        qd += phi * qd * phi.transpose();
        phi *= phi;
    }
    // Rounding must not break the symmetry.
    (phi, (qd + qd.transpose()) * 0.5)
}

/// A matrix in TOML.
fn rows(matrix: &Matrix) -> String {
    let rows = matrix.row_iter().map(|row| format!("    {:?},\n", row.iter().collect::<Vec<_>>()));
    format!("[\n{}]", rows.collect::<String>())
}

//! The filter against a reference on which Stone Soup, filterpy and 50-digit arithmetic agree.

use nalgebra::{SMatrix, SVector, Vector2};
use rangehound_fusion::filter::{Gaussian, Information};
use rangehound_shared::motion::MotionModel;
use serde_json::Value;

const TOLERANCE: f64 = 1e-9;

/// Computed by all three; they agree in all digits that are compared.
fn reference() -> Value {
    serde_json::from_str(include_str!("../data/ekf.json")).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

fn state(value: &Value) -> SVector<f64, 4> {
    SVector::from_row_slice(&numbers(value))
}

fn covariance(value: &Value) -> SMatrix<f64, 4, 4> {
    let rows: Vec<f64> = value.as_array().unwrap().iter().flat_map(numbers).collect();
    SMatrix::from_row_slice(&rows)
}

fn step(before: Gaussian<4>, sensors: &Value, ranges: &Value) -> (Gaussian<4>, Gaussian<4>) {
    let model = MotionModel::IntegratorChain { order: 2, noise_psd: 10.0 };
    let predicted = before.predict(&model.transition(0.1));
    let mut information = Information::default();
    for (sensor, range_m) in sensors.as_array().unwrap().iter().zip(numbers(ranges)) {
        information.add(&predicted.innovation(Vector2::from_row_slice(&numbers(sensor)), range_m, 1.0));
    }
    (predicted, predicted.update(&information))
}

fn assert_close(estimate: &Gaussian<4>, expected: &Value, what: &str) {
    let error = (estimate.x - state(&expected["x"])).amax().max((estimate.p - covariance(&expected["P"])).amax());
    assert!(error < TOLERANCE, "{what}: off by {error:e}");
}

#[test]
fn one_step_and_a_sequence_match_the_reference() {
    let reference = reference();
    let start = Gaussian { x: state(&reference["x0"]), p: SMatrix::identity() * 10.0 };
    let (predicted, updated) = step(start, &reference["sensors"], &reference["z"]);
    assert_close(&predicted, &reference["predicted"], "prediction");
    assert_close(&updated, &reference["updated_joint"], "joint update");

    let sequence = &reference["sequence_20_steps"];
    let mut estimate = Gaussian { x: state(&sequence["x0"]), p: SMatrix::identity() * 10.0 };
    let steps = sequence["steps"].as_array().unwrap();
    assert_eq!(steps.len(), 20);
    for expected in steps {
        estimate = step(estimate, &expected["sensors"], &expected["z"]).1;
        assert_close(&estimate, expected, &format!("step {}", expected["k"]));
    }
}

//! The optimum of two robots at once, in closed form. It leaves minima that no single robot can leave.

use super::arm::{Arm, Extent};
use crate::vector::Vector;

/// The directions of two arms for which `|rest + lambda_1 u_1 + lambda_2 u_2|` is least.
///
/// There are two kinds of optimum. One arm may stand at an end of its arc; the other then follows from the closed form of one
/// robot ([`Arm::nearest`]). Or both are inside their arcs. The gradient is then zero: the sum vanishes (the triangle of sides
/// `|rest|`, `lambda_1`, `lambda_2`), or both lie on the line of `rest`. All candidates are compared; the first of equal ones
/// is taken.
#[must_use]
pub fn best_pair(rest: Vector, first: &Arm, second: &Arm) -> [Vector; 2] {
    let mut best = [first.centre, second.centre];
    let mut least = f64::INFINITY;
    let mut try_out = |u1: Vector, u2: Vector| {
        let value = (rest + u1 * first.lambda + u2 * second.lambda).norm_squared();
        if value < least {
            least = value;
            best = [u1, u2];
        }
    };
    for (u1, u2) in triangle(rest, first.lambda, second.lambda).into_iter().flatten() {
        if first.contains(u1) && second.contains(u2) {
            try_out(u1, u2);
        }
    }
    for u1 in [first.low, first.high] {
        try_out(u1, second.nearest(-(rest + u1 * first.lambda), second.centre));
    }
    for u2 in [second.low, second.high] {
        try_out(first.nearest(-(rest + u2 * second.lambda), first.centre), u2);
    }
    // A rest of length zero has no direction: any will do.
    let along = rest.normalised().unwrap_or(Vector::new(1.0, 0.0));
    for u1 in [along, -along] {
        if first.extent == Extent::Circle || first.contains(u1) {
            for u2 in [along, -along] {
                if second.contains(u2) {
                    try_out(u1, u2);
                }
            }
        }
    }
    best
}

/// The two ways to close the triangle `rest + lambda_1 u_1 + lambda_2 u_2 = 0`, if it closes.
fn triangle(rest: Vector, lambda_1: f64, lambda_2: f64) -> Option<[(Vector, Vector); 2]> {
    let length = rest.norm();
    if length == 0.0
        || length > lambda_1 + lambda_2
        || length < (lambda_1 - lambda_2).abs()
        || lambda_1 * lambda_2 == 0.0
    {
        return None;
    }
    // Law of cosines, in the frame in which the rest points along the first axis.
    let along = rest * (1.0 / length);
    let cos_1 = (lambda_2 * lambda_2 - lambda_1 * lambda_1 - length * length) / (2.0 * lambda_1 * length);
    let cos_1 = cos_1.clamp(-1.0, 1.0);
    let sin_1 = ((1.0 - cos_1) * (1.0 + cos_1)).sqrt();
    let with = |u1: Vector| {
        let u1 = along.rotated_by(u1);
        let u2 = -(rest + u1 * lambda_1);
        (u1, u2.normalised().unwrap_or(-along))
    };
    Some([with(Vector::new(cos_1, sin_1)), with(Vector::new(cos_1, -sin_1))])
}

/// Directions of free arms (all full circles) for which `|rest + sum lambda_i u_i|` is least.
///
/// If no length (`|rest|` among them) exceeds the sum of the others, rest and arms form a closed polygon, whose sum is zero.
/// Each arm but the last two is turned so that the arms after it can still close the remaining chord; the last two close the
/// triangle. Otherwise all others point against the longest. O(M).
/// Returns false, with `directions` unchanged, if an arm is not free.
pub fn best_of_free(rest: Vector, arms: &[Arm], directions: &mut [Vector]) -> bool {
    if arms.iter().any(|arm| arm.extent != Extent::Circle) {
        return false;
    }
    // For each arm the longest and the sum of the arms after it, stored where its direction will be written.
    let (mut longest, mut left) = (0.0_f64, 0.0);
    for (arm, direction) in arms.iter().zip(directions.iter_mut()).rev() {
        *direction = Vector::new(longest, left);
        longest = longest.max(arm.lambda);
        left += arm.lambda;
    }
    let (mut rest, mut length) = (rest, rest.norm());
    for (arm, direction) in arms.iter().zip(directions.iter_mut()) {
        let Vector { x: longest, y: left } = *direction;
        // The arms after this one can close chords from `2 longest - sum` to `sum`. The middle of the feasible interval is
        // taken: at its ends the triangle is flat and its angles are badly conditioned.
        let least = (2.0 * longest - left).max((length - arm.lambda).abs());
        let most = left.min(length + arm.lambda);
        let chord = if least <= most { 0.5 * (least + most) } else { most.max((length - arm.lambda).abs()) };
        *direction = match rest.normalised() {
            Some(along) => along.rotated_by(turn_to_chord(length, arm.lambda, chord)),
            None => arm.centre,
        };
        rest += *direction * arm.lambda;
        // The exact chord, not the rounded sum: so no arm's triangle depends on the one before.
        length = if length > 0.0 { chord } else { arm.lambda };
    }
    true
}

/// The direction, relative to the rest's, of an arm that changes the rest's length from this one to `chord`.
fn turn_to_chord(length: f64, lambda: f64, chord: f64) -> Vector {
    let double_area = 2.0 * length * lambda;
    if double_area < f64::MIN_POSITIVE {
        return Vector::new(1.0, 0.0);
    }
    let cos = ((chord - length) * (chord + length) - lambda * lambda) / double_area;
    let cos = cos.clamp(-1.0, 1.0);
    Vector::new(cos, ((1.0 - cos) * (1.0 + cos)).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::PI;

    fn arm(lambda: f64, centre: f64, half_width: f64) -> Arm {
        Arm::with_half_width(lambda, Vector::from_angle(centre), Vector::from_angle(half_width))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2_000))]

        /// Against a search over one direction with the other in closed form.
        #[test]
        fn no_pair_of_directions_is_better(
            (x, y) in (-12.0..12.0_f64, -12.0..12.0_f64),
            lambdas in (0.1..10.0_f64, 0.1..10.0_f64),
            centres in (-PI..PI, -PI..PI),
            half_widths in (0.0..PI, 0.0..PI),
        ) {
            let rest = Vector::new(x, y);
            let (first, second) = (arm(lambdas.0, centres.0, half_widths.0), arm(lambdas.1, centres.1, half_widths.1));
            let [u1, u2] = best_pair(rest, &first, &second);
            let value = |u1: Vector, u2: Vector| (rest + u1 * first.lambda + u2 * second.lambda).norm();
            prop_assert!(u1.dot(first.centre) >= half_widths.0.cos() - 1e-12);
            prop_assert!(u2.dot(second.centre) >= half_widths.1.cos() - 1e-12);
            let steps = 400;
            for k in 0..=steps {
                let share = 2.0 * f64::from(k) / f64::from(steps) - 1.0;
                let probe = Vector::from_angle(centres.0 + share * half_widths.0);
                let other = second.nearest(-(rest + probe * first.lambda), second.centre);
                prop_assert!(value(u1, u2) <= value(probe, other) + 1e-9, "{} {}", value(u1, u2), value(probe, other));
            }
        }
    }

    #[test]
    fn two_free_robots_close_the_triangle_of_the_worked_example() {
        let free = Arm::circle(1.0, Vector::new(1.0, 0.0));
        let [u1, u2] = best_pair(Vector::new(std::f64::consts::SQRT_2, 0.0), &free, &free);
        assert!((u1.angle_rad().abs() - 0.75 * PI).abs() < 1e-12);
        assert!((u1.angle_rad() + u2.angle_rad()).abs() < 1e-12);
    }

    proptest! {
        /// The polygon closes, or is as short as the longest side leaves it.
        #[test]
        fn free_arms_reach_what_their_lengths_allow(
            prior in 0.0..20.0_f64, lambdas in proptest::collection::vec(prop_oneof![0.1..10.0_f64, Just(1.0)], 0..12),
        ) {
            let arms: Vec<Arm> = lambdas.iter().map(|&lambda| Arm::circle(lambda, Vector::new(0.6, 0.8))).collect();
            let mut directions = vec![Vector::default(); arms.len()];
            prop_assert!(best_of_free(Vector::new(0.0, prior), &arms, &mut directions));
            let sum = arms.iter().zip(&directions).fold(Vector::new(0.0, prior), |sum, (arm, u)| sum + *u * arm.lambda);
            let total = prior + lambdas.iter().sum::<f64>();
            let longest = lambdas.iter().fold(prior, |longest, lambda| longest.max(*lambda));
            let least = (2.0 * longest - total).max(0.0);
            prop_assert!((sum.norm() - least).abs() < 1e-7 * total, "{} {least}", sum.norm());
            prop_assert!(directions.iter().all(|u| (u.norm() - 1.0).abs() < 1e-12));
        }
    }

    #[test]
    fn equal_free_robots_without_a_rest_cancel() {
        let free = Arm::circle(2.0, Vector::new(0.6, 0.8));
        let [u1, u2] = best_pair(Vector::default(), &free, &free);
        assert!((u1 + u2).norm() < 1e-15);
    }
}

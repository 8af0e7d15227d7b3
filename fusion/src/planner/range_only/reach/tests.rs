use std::f64::consts::PI;

use nalgebra::Matrix2;
use proptest::prelude::*;

use super::super::{Extent, Problem};
use super::*;
use crate::belief::Belief;
use crate::planner::Situation;

const DT_S: f64 = 0.1;

fn reach(x: f64, y: f64, speed_mps: f64, stand_off_m: f64) -> Reach {
    Reach::new(&TeamMember::ranging(Vector::new(x, y), speed_mps, 1.0), Vector::default(), DT_S, stand_off_m)
}

/// The problem of a team round a target that is known equally well in all directions.
fn problem(positions_m: &[Vector], speed_mps: f64, target_m: Vector, clearance: Clearance) -> Problem {
    Problem::of(&Situation {
        belief: Belief::of_position(target_m, &Matrix2::identity()),
        team: positions_m.iter().map(|at_m| TeamMember::ranging(*at_m, speed_mps, 1.0)).collect(),
        clearance,
        step_s: DT_S,
        ..Situation::default()
    })
}

/// How far a robot moves to get into this direction.
fn offset_m(problem: &Problem, i: usize, direction: Vector) -> Vector {
    let (heading, speed_mps) = problem.reaches[i].motion(direction, &problem.corners_m);
    heading * (speed_mps * DT_S)
}

/// The vector from the robot's position after this motion to the target.
fn sight_after(reach: &Reach, (heading, speed_mps): (Vector, f64)) -> Vector {
    reach.to_target_m - heading * (speed_mps * DT_S)
}

/// A direction in the arc: -1 is its clockwise end, 1 the other.
fn direction_at(arm: &Arm, fraction: f64) -> Vector {
    let half_rad = match arm.extent {
        Extent::Circle => PI,
        Extent::Narrow => arm.low.cross(arm.centre).atan2(arm.low.dot(arm.centre)),
        Extent::Wide => PI - (-arm.centre).cross(arm.low).atan2((-arm.centre).dot(arm.low)).abs(),
    };
    arm.centre.rotated_by(Vector::from_angle(fraction * half_rad))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    /// Eq. 16: the move ends on the line through the target along the bearing, at full speed.
    #[test]
    fn a_heading_realises_its_bearing(
        x in -30.0..30.0_f64, y in -30.0..30.0_f64, speed in 0.0..200.0_f64, fraction in -1.0..1.0_f64,
    ) {
        let reach = reach(x, y, speed, 0.0);
        let direction = direction_at(&reach.arm(1.0, &[]), fraction);
        let motion = reach.motion(direction, &[]);
        prop_assert!((motion.0.norm() - 1.0).abs() < 1e-9);
        prop_assert_eq!(motion.1, speed);
        // The bearing is ill-defined where the step ends on the target itself.
        let sight_m = sight_after(&reach, motion);
        let after = sight_m.normalised().unwrap_or(direction).doubled();
        prop_assert!((after - direction).norm() * sight_m.norm() < 1e-6, "{after:?} {direction:?}");
    }

    /// Whatever its bearing in the arc, a robot ends outside the stand-off if it can get there.
    #[test]
    fn every_bearing_of_the_arc_keeps_the_stand_off(
        distance in 0.0..12.0_f64, angle in -PI..PI, speed in 0.1..60.0_f64, stand_off in 0.1..10.0_f64,
        fraction in -1.0..=1.0_f64,
    ) {
        let at = Vector::from_angle(angle) * distance;
        let reach = reach(at.x, at.y, speed, stand_off);
        let direction = direction_at(&reach.arm(1.0, &[]), fraction);
        let motion = reach.motion(direction, &[]);
        prop_assert!(motion.1 <= speed);
        let sight_m = sight_after(&reach, motion);
        let most_m = stand_off.min(distance + reach.step_m);
        prop_assert!(sight_m.norm() >= most_m - 1e-9, "{} {}", sight_m.norm(), most_m);
        let after = sight_m.normalised().unwrap_or(direction).doubled();
        prop_assert!((after - direction).norm() < 1e-6, "{after:?} {direction:?}");
    }

    /// No place that the robot can get to outside the stand-off has a bearing outside the arc.
    #[test]
    fn the_arc_leaves_nothing_out(
        distance in 0.1..12.0_f64, speed in 0.1..60.0_f64, kept in 0.0..1.0_f64,
        heading in -PI..PI, share in 0.0..1.0_f64,
    ) {
        let motion = (Vector::from_angle(heading), speed * share);
        let sight_m = sight_after(&reach(distance, 0.0, speed, 0.0), motion);
        let arm = reach(distance, 0.0, speed, kept * sight_m.norm()).arm(1.0, &[]);
        let direction = sight_m.normalised().unwrap_or(arm.centre).doubled();
        prop_assert!((arm.nearest(direction, direction) - direction).norm() < 1e-6, "{arm:?} {direction:?}");
    }

    /// Neighbours that are apart stay apart, and neighbours that are too close do not come closer.
    #[test]
    fn robots_stay_apart(
        places in proptest::collection::vec((-4.0..4.0_f64, -4.0..4.0_f64), 2..9),
        fractions in proptest::collection::vec(-1.0..=1.0_f64, 8),
        separation in 0.1..2.0_f64, stand_off in prop_oneof![Just(0.0), 0.5..4.0_f64], speed in 1.0..30.0_f64,
    ) {
        let clearance = Clearance { stand_off_m: stand_off, stand_off_sigma: 0.0, separation_m: separation };
        let positions: Vec<Vector> = places.iter().map(|&(x, y)| Vector::new(x, y)).collect();
        let target = Vector::new(0.3, 0.2);
        let problem = problem(&positions, speed, target, clearance);
        let ends: Vec<Vector> = positions.iter().enumerate().map(|(i, at)| {
            *at + offset_m(&problem, i, direction_at(&problem.arms()[i], fractions[i]))
        }).collect();
        // A robot too close to another moves away as far as the others leave room.
        let crowded = positions.iter().enumerate().any(|(k, at)| {
            positions[..k].iter().any(|other| (*at - *other).norm() < separation)
        });
        for i in 0..ends.len() {
            let (before_m, after_m) = ((target - positions[i]).norm(), (target - ends[i]).norm());
            prop_assert!(after_m >= stand_off.min(before_m) - 1e-9, "{i}: {before_m} {after_m}");
            for j in 0..i {
                let (before_m, after_m) = ((positions[i] - positions[j]).norm(), (ends[i] - ends[j]).norm());
                // Even where they are many, and near the target.
                prop_assert!(after_m >= separation.min(before_m) - 1e-9, "{i} {j}: {before_m} {after_m}");
                if crowded && ends.len() == 2 && stand_off == 0.0 {
                    prop_assert!(after_m >= separation.min(before_m + 2.0 * speed * DT_S * 0.997) - 1e-9);
                }
            }
        }
    }
}

/// Two robots that are too close; one is between the other and the target.
#[test]
fn a_robot_that_makes_way_keeps_its_stand_off() {
    let mut positions_m = [Vector::new(5.2, 0.0), Vector::new(6.2, 0.0)];
    let clearance = Clearance { stand_off_m: 5.0, stand_off_sigma: 0.0, separation_m: 4.0 };
    for _ in 0..20 {
        let problem = problem(&positions_m, 10.0, Vector::default(), clearance);
        for (i, position_m) in positions_m.iter_mut().enumerate() {
            *position_m += offset_m(&problem, i, problem.arms()[i].centre);
            assert!(position_m.norm() >= 5.0 - 1e-9, "{i}: {position_m:?}");
        }
    }
    assert!((positions_m[0] - positions_m[1]).norm() >= 4.0 - 1e-9, "{positions_m:?}");
}

/// A negligible stand-off counts as none: the motion reaches the arc's bearing.
#[test]
fn a_stand_off_of_next_to_nothing_changes_nothing() {
    for stand_off_m in [1e-300, 1e-15, 1e-9, 1e-6, 1e-4] {
        let reach = reach(0.3, 0.1, 10.0, stand_off_m);
        let arm = reach.arm(1.0, &[]);
        for k in 0..=40 {
            let direction = direction_at(&arm, f64::from(k) / 20.0 - 1.0);
            let sight_m = sight_after(&reach, reach.motion(direction, &[]));
            assert!(sight_m.norm() >= stand_off_m - 1e-9);
            let after = sight_m.normalised().unwrap().doubled();
            assert!((after - direction).norm() < 1e-8, "{stand_off_m}: {after:?} {direction:?}");
        }
    }
}

#[test]
fn of_the_two_headings_the_nearer_end_is_taken() {
    let reach = reach(-3.0, 0.0, 10.0, 0.0);
    let bearing = Vector::from_angle(0.2);
    let end_m = sight_after(&reach, reach.motion(bearing.doubled(), &[])).norm();
    let xi = bearing.cross(reach.to_target_m) / reach.step_m;
    let other_end = sight_after(&reach, (Vector::from_angle(0.2 + PI - xi.asin()), 10.0));
    assert!(bearing.cross(other_end).abs() < 1e-12, "the other solution is a solution");
    assert!(end_m < other_end.norm());
}

#[test]
fn a_robot_exactly_one_step_away_does_not_end_on_the_target() {
    let reach = reach(1.0, 0.0, 10.0, 0.0);
    let direction = Vector::from_angle(0.7);
    let sight_m = sight_after(&reach, reach.motion(direction, &[]));
    assert!((sight_m.normalised().unwrap().doubled() - direction).norm() < 1e-9, "{sight_m:?}");
}

#[test]
fn a_robot_inside_the_stand_off_moves_straight_out() {
    let reach = reach(0.5, 0.0, 10.0, 4.0);
    let arm = reach.arm(1.0, &[]);
    assert_eq!(arm.low, arm.high);
    let (heading, speed_mps) = reach.motion(arm.centre, &[]);
    assert!((heading - Vector::new(1.0, 0.0)).norm() < 1e-12);
    assert_eq!(speed_mps, 10.0);
}

#[test]
fn robots_on_one_spot_part_in_all_directions() {
    let clearance = Clearance { separation_m: 1.0, ..Clearance::default() };
    let problem = problem(&[Vector::new(15.0, 0.0); 5], 10.0, Vector::default(), clearance);
    let ends: Vec<Vector> = (0..5).map(|i| offset_m(&problem, i, problem.arms()[i].centre)).collect();
    for i in 0..5 {
        for j in 0..i {
            assert!((ends[i] - ends[j]).norm() > 0.9, "{ends:?}");
        }
    }
}

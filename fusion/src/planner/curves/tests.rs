use std::f64::consts::{PI, TAU};

use nalgebra::Matrix2;
use proptest::prelude::*;
use rangehound_shared::scenario::{Clearance, RangeNoise, SensorSpec};

use super::curve::Curve;
use super::*;
use crate::belief::Belief;
use crate::planner::{TeamMember, for_team};

const CERTIFIED: PlannerSpec = PlannerSpec::Certified { nodes: 5_000 };

pub(in crate::planner) fn covariance_m2() -> impl Strategy<Value = Matrix2<f64>> {
    (0.1..10.0_f64, 0.1..10.0_f64, -0.9..0.9_f64).prop_map(|(a, c, correlation)| {
        let b = correlation * (a * c).sqrt();
        Matrix2::new(a, b, b, c)
    })
}

pub(in crate::planner) fn maybe<T: std::fmt::Debug + Clone + 'static>(
    none: T,
    some: impl Strategy<Value = T> + 'static,
) -> impl Strategy<Value = T> {
    prop_oneof![Just(none), some]
}

fn sensor() -> impl Strategy<Value = SensorSpec> {
    let range = (0.3..2.0_f64, maybe(0.0, 0.01..0.1_f64));
    let range = range.prop_map(|(std_m, std_per_m)| Some(RangeNoise { std_m, std_per_m })).boxed();
    let bearing = (0.02..0.2_f64).prop_map(Some).boxed();
    let both = prop_oneof![(Just(None), bearing.clone()), (range.clone(), maybe(None, bearing)),];
    (both, proptest::option::of(5.0..40.0_f64), proptest::option::of(0.5..5.0_f64)).prop_map(
        |((range, bearing_std_rad), max_range_m, field_of_view_rad)| SensorSpec {
            range,
            bearing_std_rad,
            max_range_m,
            field_of_view_rad,
        },
    )
}

pub(in crate::planner) fn member() -> impl Strategy<Value = TeamMember> {
    let place = (-40.0..40.0_f64, -40.0..40.0_f64).prop_map(|(x, y)| Vector::new(x, y));
    (place, maybe(Matrix2::zeros(), covariance_m2()), maybe(0.0, 0.01..0.1_f64), maybe(0.0, 0.1..30.0_f64), sensor())
        .prop_map(|(position_m, position_covariance_m2, heading_std_rad, max_speed_mps, sensor)| TeamMember {
            position_m,
            position_covariance_m2,
            heading_std_rad,
            max_speed_mps,
            sensor,
            is_fused: true,
        })
}

fn situation(robots: std::ops::Range<usize>) -> impl Strategy<Value = Situation> {
    let clearance = (maybe(0.0, 1.0..6.0_f64), maybe(0.0, 0.5..3.0_f64));
    let criterion = proptest::sample::select(Criterion::ALL.to_vec());
    (covariance_m2(), proptest::collection::vec(member(), robots), clearance, criterion).prop_map(
        |(prior_m2, team, (stand_off_m, separation_m), criterion)| Situation {
            belief: Belief::of_position(Vector::default(), &prior_m2),
            team,
            clearance: Clearance { stand_off_m, stand_off_sigma: 0.0, separation_m },
            criterion,
            step_s: 1.0,
            ..Situation::default()
        },
    )
}

/// A place that a robot can reach, relative to where it is, by two shares.
fn reachable(problem: &Problem, robot: usize, heading: f64, share: f64) -> Option<Vector> {
    let reach = &problem.reaches[robot];
    let offset_m = Vector::from_angle(heading * TAU) * (reach.step_m * share);
    let keeps_off = (reach.to_target_m - offset_m).norm() >= reach.stand_off_m().max(1e-2 * reach.step_m);
    (keeps_off && reach.holds(offset_m, &problem.corners_m)).then_some(offset_m)
}

/// The information of the robot's measurement from there, if the target is in its field of view.
fn added(curve: &Curve, member: &TeamMember, problem: &Problem, robot: usize, offset_m: Vector) -> Information {
    let sight_m = problem.reaches[robot].to_target_m - offset_m;
    let turn_rad = offset_m.cross(sight_m).abs().atan2(offset_m.dot(sight_m));
    let is_seen = offset_m == Vector::default() || turn_rad <= 0.5 * member.sensor.view_rad();
    let is_near = sight_m.norm() <= member.sensor.reach_m();
    if is_seen && is_near { curve.noise.information(sight_m) } else { Information::default() }
}

fn plan(spec: PlannerSpec, situation: &Situation) -> Plan {
    let mut plan = Plan::default();
    for_team(spec, situation.team.len(), 1).unwrap().plan(3, situation, &mut plan);
    plan
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(5_000))]

    /// No place that a robot can reach tells more than the curve's support, and the support is reached.
    #[test]
    fn the_support_of_a_curve_bounds_all_places_that_a_robot_can_reach(
        situation in situation(1..3), angle in 0.0..TAU, length in 0.0..1.0_f64,
        heading in 0.0..1.0_f64, share in 0.0..1.0_f64, near in -1.0..8.0_f64,
    ) {
        let problem = Problem::of(&situation);
        let m = Vector::from_angle(angle) * length;
        for (i, member) in situation.team.iter().enumerate() {
            let curve = Curve::of(member, &problem.reaches[i], &problem.corners_m);
            let support = curve.support((0.0, curve.end()), m, 1e-9, near);
            let reached = curve.information(support.at).along(m);
            prop_assert!(support.bound >= reached * (1.0 - 1e-12));
            prop_assert!(support.bound <= reached + 1e-6 * (1.0 + reached.abs()), "{support:?} {reached}");
            let last = (curve.end() - 1.0) / 2.0;
            let (low, high) = (2.0 * (0.3 * last).floor() + 0.25, 2.0 * (0.8 * last).floor() + 0.75);
            let part = curve.support((low, high), m, 1e-9, near);
            prop_assert!(part.bound <= support.bound + 1e-6 * (1.0 + support.bound.abs()));
            for k in 0..=50 {
                let at = low + (high - low) * f64::from(k) / 50.0;
                if curve.cut_at(at).0 != at {
                    continue;
                }
                let value = curve.information(at).along(m);
                prop_assert!(value <= part.bound + 1e-9 * (1.0 + value.abs()), "{at}: {value} {part:?}");
            }
            // A bearing's view is cut with the heading; at rest that is unknown.
            if let Some(offset_m) = reachable(&problem, i, heading, share)
                && (offset_m != Vector::default() || member.sensor.view_rad() >= TAU)
            {
                let value = added(&curve, member, &problem, i, offset_m).along(m);
                prop_assert!(value <= support.bound + 1e-6 * (1.0 + value.abs()), "{offset_m:?}: {value} {support:?}");
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1_000))]

    /// The certified plan predicts what its commands lead to, is proven, and no other plan beats its bound.
    #[test]
    fn no_plan_beats_the_certified_bound(
        situation in situation(1..6), shares in proptest::collection::vec((0.0..1.0_f64, 0.0..1.0_f64), 40 * 6),
    ) {
        let best = plan(CERTIFIED, &situation);
        if situation.is_range_only() {
            return Ok(());
        }
        let certificate = best.certificate.unwrap();
        let problem = Problem::of(&situation);
        let mut team = Team::default();
        team.pose(&situation, &problem);
        let total = commanded(&situation, team.curves.iter().map(|curve| curve.noise), &best.commands);
        // One bearing from next to the target outweighs all else by far.
        let is_lopsided = best.predicted.position_trace_m2 * total.t > 1e2;
        prop_assert!(certificate.is_optimal || is_lopsided, "{:?} {certificate:?}", best.predicted);
        prop_assert!(certificate.lower_bound <= best.predicted.objective);
        prop_assert!(certificate.least_trace_m2 <= best.predicted.position_trace_m2 * (1.0 + 1e-12));
        let off = (situation.criterion.cost(total) / best.predicted.objective - 1.0).abs();
        prop_assert!(off < 1e-5, "{off} {best:?}");
        for spec in [PlannerSpec::Greedy, PlannerSpec::Pursue, PlannerSpec::Adaptive { iterations: 9, alpha: 0.5 }, PlannerSpec::Random] {
            let other = plan(spec, &situation);
            prop_assert_eq!(other.certificate, None);
            // Others may stop nearer to the target than the certified planner counts.
            let is_beaten = other.predicted.objective < certificate.lower_bound * (1.0 - 1e-9);
            prop_assert!(!is_beaten || is_lopsided, "{spec:?}");
            let hull = crate::planner::hull_certificate(&situation, &other);
            prop_assert!(hull.lower_bound <= best.predicted.objective * (1.0 + 1e-9));
        }
        for sample in shares.chunks(situation.team.len()).filter(|sample| sample.len() == situation.team.len()) {
            let mut total = team.prior;
            for (i, member) in situation.team.iter().enumerate() {
                if let Some(offset_m) = reachable(&problem, i, sample[i].0, sample[i].1) {
                    total += added(&team.curves[i], member, &problem, i, offset_m);
                }
            }
            prop_assert!(situation.criterion.cost(total) >= certificate.lower_bound * (1.0 - 1e-9));
        }
    }

    /// Where the cost is bounded by multipliers that follow a robot, no plan costs less.
    #[test]
    fn no_plan_is_better_where_a_robot_has_been_followed(
        situation in situation(1..5), robot in any::<prop::sample::Index>(), factor in 0.3..1.0_f64,
        shares in proptest::collection::vec(0.0..1.0_f64, 5 * 12),
    ) {
        let problem = Problem::of(&situation);
        let mut team = Team::default();
        team.pose(&situation, &problem);
        let whole = team.whole.clone();
        let robot = robot.index(team.curves.len());
        let mut plans = shares.chunks(5).map(|shares| {
            let mut at: Vec<f64> = whole.iter().zip(shares).map(|((_, end), share)| end * share).collect();
            let total = team.descend(&whole, &mut at);
            (at, total)
        });
        let (at, total) = plans.next().unwrap();
        let cost = team.criterion.cost(total);
        let rest = total - team.curves[robot].information(at[robot]);
        let aim = cost * factor;
        let answer = search::Answer { at, cost, ..search::Answer::default() };
        let left = follow::open_part(&team, &whole, robot, rest, &answer, aim, &mut Vec::new());
        for (at, total) in plans {
            let is_followed = left.is_none_or(|(low, high)| at[robot] < low || at[robot] > high);
            let cost = team.criterion.cost(total);
            prop_assert!(!is_followed || cost >= aim * (1.0 - 1e-9), "{cost} {aim} {left:?} {at:?}");
        }
    }

    /// The information along a curve and its derivative belong to one function.
    #[test]
    fn the_change_along_a_curve_is_that_of_what_is_known(situation in situation(1..2), share in 0.0..1.0_f64) {
        let problem = Problem::of(&situation);
        let curve = Curve::of(&situation.team[0], &problem.reaches[0], &problem.corners_m);
        let (piece, u) = curve.piece_at(share * curve.end());
        let (u, step) = (u.clamp(0.01, 0.99), 1e-4);
        let (here, change) = curve.information_along(piece, u);
        let [before, exact, after] = [u - step, u, u + step].map(|u| curve.information_on(piece, u));
        // Next to the target it changes too fast for differences.
        prop_assume!((after - before).t.abs() < 0.01 * exact.t && (after - before).s.norm() < 0.01 * exact.t);
        let off = |a: Information, b: Information| (a - b).t.abs() + (a - b).s.norm();
        prop_assert!(off(here, exact) <= 1e-12 * exact.t);
        let difference = (after - before) * (0.5 / step);
        prop_assert!(off(change, difference) <= 1e-4 * (exact.t + change.t.abs() + change.s.norm()), "{change:?} {difference:?}");
    }

    /// Teams of ranges alone have the same optimum as by the planner that is made for them.
    #[test]
    fn ranges_alone_give_the_optimum_of_the_sum_of_vectors(
        prior_m2 in covariance_m2(),
        robots in proptest::collection::vec((-30.0..30.0_f64, -30.0..30.0_f64, 0.1..9.0_f64, 0.3..3.0_f64), 1..8),
        stand_off_m in maybe(0.0, 1.0..6.0_f64),
    ) {
        let member = |&(x, y, speed_mps, std_m): &(f64, f64, f64, f64)| TeamMember::ranging(Vector::new(x, y), speed_mps, std_m);
        let situation = Situation {
            belief: Belief::of_position(Vector::default(), &prior_m2),
            team: robots.iter().map(member).collect(),
            clearance: Clearance { stand_off_m, ..Clearance::default() },
            step_s: 1.0,
            ..Situation::default()
        };
        let vectors = plan(CERTIFIED, &situation);
        let mut over_curves = Plan::default();
        let mut range_only = RangeOnly::new(crate::planner::range_only::solver(CERTIFIED, robots.len(), 1).unwrap());
        Curves::new(CERTIFIED).plan(0, &situation, &mut range_only, &mut over_curves);
        let (a, b) = (vectors.predicted.position_trace_m2, over_curves.predicted.position_trace_m2);
        prop_assert!((a / b - 1.0).abs() < 2e-6, "{a} {b}");
        let bound = over_curves.certificate.unwrap();
        prop_assert!(bound.is_optimal && bound.least_trace_m2 <= a * (1.0 + 1e-9), "{bound:?} {a} {b}");
    }
}

fn lone(sensor: SensorSpec, position_m: Vector) -> Situation {
    Situation {
        belief: Belief::of_position(Vector::default(), &Matrix2::identity()),
        team: vec![TeamMember { sensor, ..TeamMember::ranging(position_m, 5.0, 1.0) }],
        step_s: 1.0,
        ..Situation::default()
    }
}

/// The hull of a robot's curve says little about a robot that has most of the information: it must not take many cuts.
#[test]
fn one_robot_that_outweighs_the_others_takes_few_nodes() {
    let both = |bearing_std_rad: f64| SensorSpec { bearing_std_rad: Some(bearing_std_rad), ..SensorSpec::range(1.0) };
    for criterion in Criterion::ALL {
        let mut situation = lone(both(0.01), Vector::new(12.0, 5.0));
        situation.team[0].max_speed_mps = 9.0;
        situation.team.extend(
            [(-30.0, 10.0), (20.0, 40.0), (5.0, -35.0)]
                .map(|(x, y)| TeamMember { sensor: both(0.1), ..TeamMember::ranging(Vector::new(x, y), 2.0, 1.0) }),
        );
        situation.criterion = criterion;
        let problem = Problem::of(&situation);
        let mut team = Team::default();
        team.pose(&situation, &problem);
        let answer = search::search(&team, vec![0.0; 4], 2_000, &mut Memory::default());
        assert!(answer.cost - answer.bound <= search::GAP_MAX * answer.cost, "{answer:?}");
        assert!(answer.nodes <= 5, "{criterion:?}: {answer:?}");
    }
}

/// A camera goes across to where its bearing cuts the longer axis; a robot out of its sensor's range comes nearer.
#[test]
fn a_camera_comes_nearer_and_a_robot_out_of_range_goes_straight_to_the_target() {
    let camera = SensorSpec { range: None, bearing_std_rad: Some(0.05), ..SensorSpec::range(1.0) };
    for sensor in [camera, SensorSpec { max_range_m: Some(10.0), ..camera }] {
        let situation = lone(sensor, Vector::new(20.0, 0.0));
        let plan = plan(CERTIFIED, &situation);
        let end =
            Vector::new(20.0, 0.0) + Vector::from_angle(plan.commands[0].heading_rad) * plan.commands[0].speed_mps;
        assert!((end - Vector::new(15.0, 0.0)).norm() < 1e-3, "{end:?}");
        let is_in_range = sensor.reach_m() > 15.0;
        assert_eq!(plan.predicted.position_trace_m2 < 1.999, is_in_range, "{plan:?}");
    }
}

/// It is sent to where its measurement would add most, and is not counted.
#[test]
fn a_robot_that_is_not_fused_is_placed_and_not_counted() {
    let camera = SensorSpec { range: None, bearing_std_rad: Some(0.05), ..SensorSpec::range(1.0) };
    let mut situation = lone(camera, Vector::new(20.0, 3.0));
    let alone = plan(CERTIFIED, &situation);
    situation.team.push(TeamMember { is_fused: false, ..situation.team[0] });
    let both = plan(CERTIFIED, &situation);
    assert_eq!(both.predicted, alone.predicted);
    assert_eq!(both.commands[0], alone.commands[0]);
    assert!(both.commands[1].speed_mps > 0.0);
    situation.team.remove(0);
    let none = plan(CERTIFIED, &situation);
    assert_eq!(none.predicted.position_trace_m2, 2.0);
    assert!(none.certificate.unwrap().is_optimal);
}

#[test]
fn a_robot_on_the_target_or_within_a_step_has_a_finite_plan() {
    let both = SensorSpec { bearing_std_rad: Some(0.05), ..SensorSpec::range(1.0) };
    for place in [Vector::default(), Vector::new(5.0, 0.0), Vector::new(1e-9, 0.0), Vector::new(-2.0, 1.0)] {
        for spec in [CERTIFIED, PlannerSpec::Greedy, PlannerSpec::Pursue, PlannerSpec::Random] {
            let plan = plan(spec, &lone(both, place));
            let trace_m2 = plan.predicted.position_trace_m2;
            assert!(trace_m2 > 0.0 && trace_m2.is_finite() && plan.commands[0].heading_rad.abs() <= PI, "{plan:?}");
        }
    }
}

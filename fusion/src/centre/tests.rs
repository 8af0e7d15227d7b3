use rangehound_shared::measurement::Pose;

use super::*;
use crate::past::LATE_TICKS_MAX;
use crate::planner::range_only::certified::Certified;
use crate::planner::range_only::{Problem, Solution, Solver as _};
use rangehound_shared::scenario::{Prior, ScenarioFile};

/// A state that doubles each tick is reported long before numbers overflow.
#[test]
fn an_estimate_that_leaves_all_bounds_is_reported() {
    let text = "[target]\nmodel = \"custom\"\nstart = [0.0, 0.0]\nphi = [[2.0, 0.0], [0.0, 2.0]]\n\
                qd = [[1.0, 0.0], [0.0, 1.0]]\n";
    let file = ScenarioFile::parse(text, "test").unwrap();
    let scenario = Scenario::from_file(&file, "test").unwrap();
    let mut centre = Centre::new(&scenario).unwrap();
    let diverged = (0..1_000).find_map(|_| centre.update(0.0, &[None; 3]).err()).unwrap();
    assert!((20..100).contains(&diverged.tick), "{diverged}");
}

#[test]
fn a_state_that_no_centre_can_have_is_refused() {
    let scenario = Scenario::from_file(&ScenarioFile::default(), "test").unwrap();
    let heard = Some(Measurement::new(Pose::at([15.0, 0.0]), None));
    let corruptions: [fn(&mut Centre, &mut Body); 6] = [
        |centre, _| centre.commands[1].heading_rad = f64::NAN,
        |_, body| body.position_m.x = f64::INFINITY,
        |_, body| body.stds[0] = Some(0.0),
        |_, body| body.stds[1] = Some(f64::NAN),
        |_, body| body.covariance_m2[1] = f64::NAN,
        |_, body| body.heard_at = 1,
    ];
    for corrupt in corruptions {
        let mut centre = Centre::new(&scenario).unwrap();
        centre.update(0.0, &[heard; 3]).unwrap();
        centre.plan();
        assert!(Centre::new(&scenario).unwrap().restore(centre.saved().unwrap()).is_ok());
        let mut body = centre.bodies[1].unwrap();
        corrupt(&mut centre, &mut body);
        centre.bodies[1] = Some(body);
        assert!(Centre::new(&scenario).unwrap().restore(centre.saved().unwrap()).is_err());
    }
}

/// A silent robot is planned for as if it obeyed, for some ticks, and then commanded to stop.
#[test]
fn a_silent_robot_is_commanded_to_stop_after_some_ticks() {
    let scenario = Scenario::from_file(&ScenarioFile::default(), "test").unwrap();
    let mut centre = Centre::new(&scenario).unwrap();
    let heard = Some(Measurement::new(Pose::at([15.0, 0.0]), None));
    centre.update(0.0, &[heard; 3]).unwrap();
    assert!(centre.plan().iter().all(|command| command.speed_mps == 10.0));
    for tick in 1..=SILENCE_TICKS_MAX + 1 {
        centre.update(0.0, &[heard, None, heard]).unwrap();
        assert_eq!(centre.estimate().missing, 1);
        let commands = centre.plan();
        assert_eq!(commands[0].speed_mps, 10.0);
        assert_eq!(commands[1].speed_mps > 0.0, tick <= SILENCE_TICKS_MAX, "tick {tick}");
    }
}

fn of(text: &str) -> Centre {
    let file = ScenarioFile::parse(text, "test").unwrap();
    let scenario = Scenario::from_file(&file, "test").unwrap();
    Centre::new(&scenario).unwrap().with_history()
}

fn kalman() -> Centre {
    of("[filter]\ngate_sigma = 4.0\n")
}

/// With the tracker of recordings.
fn from_ranges() -> Centre {
    let mut scenario = Scenario::from_file(&ScenarioFile::default(), "test").unwrap();
    (scenario.prior, scenario.gate_sigma) = (Prior::FromRanges, Some(4.0));
    Centre::new(&scenario).unwrap().with_history()
}

/// A target that drives straight on, and three robots on a circle round its start.
fn report(tick: u64, id: usize, error_m: f64) -> Option<Measurement> {
    let (time_s, noise_m) = (0.1 * tick as f64, 0.8 * (7.3 * tick as f64 + 2.1 * id as f64).sin());
    let position_m = Vector::from_angle(2.1 * id as f64 + 0.02 * tick as f64) * 20.0;
    let to_target = Vector::new(-8.0 * time_s, 4.0 * time_s) - position_m;
    let range_m = (tick > 0).then_some((to_target.norm() + noise_m + error_m, 1.0));
    Some(Measurement::new(Pose::at([position_m.x, position_m.y]), range_m))
}

fn tick(centre: &mut Centre, reports: &[Option<Measurement>]) {
    centre.update(0.1 * centre.next_tick() as f64, reports).unwrap();
    centre.plan();
}

fn team(tick: u64) -> [Option<Measurement>; 3] {
    [0, 1, 2].map(|id| report(tick, id, 0.0))
}

/// A radio, a camera and a robot with both. Two robots do not know well where they are.
const MIXED: &str = "[sensor.radio]\nrange_std_m = 1.0\n[sensor.camera]\nbearing_std_rad = 0.05\n[sensor.both]\n\
    range_std_m = 1.0\nbearing_std_rad = 0.05\n[localiser.gps]\nstd_m = 0.5\ncorrelation_s = 10.0\n\
    heading_std_rad = 0.02\n[localiser.odometry]\nstd_m = 0.1\ndrift_m = 0.1\n[[robot]]\nstart_m = [20.0, 0.0]\n\
    sensor = \"radio\"\nlocaliser = \"odometry\"\n[[robot]]\nstart_m = [0.0, 20.0]\nsensor = \"camera\"\n\
    localiser = \"gps\"\n[[robot]]\nstart_m = [-20.0, 0.0]\nsensor = \"both\"\n";

fn mixed() -> Centre {
    of(&format!("{MIXED}[filter]\ngate_sigma = 4.0\n"))
}

fn estimating_poses() -> Centre {
    of(&format!("{MIXED}[filter]\ngate_sigma = 4.0\nestimate = [\"pose\"]\n"))
}

/// The reports of the team of [`MIXED`].
fn mixed_report(tick: u64, id: usize) -> Option<Measurement> {
    let Measurement { pose, kinds, range_m, range_std_m, .. } = report(tick, id, 0.0)?;
    let (variance_m2, heading_std_rad) = [(0.01 + 0.001 * tick as f64, 0.0), (0.25, 0.02), (0.0, 0.0)][id];
    let pose = Pose { covariance_m2: [variance_m2, 0.0, variance_m2], heading_std_rad, ..pose };
    let range = (kinds != 0 && id != 1).then_some((range_m, range_std_m));
    let measurement = Measurement::new(pose, range);
    if tick == 0 || id == 0 {
        return Some(measurement);
    }
    let time_s = 0.1 * tick as f64;
    let noise_rad = 0.04 * (5.1 * tick as f64 + 1.7 * id as f64).sin();
    let to_target = Vector::new(-8.0 * time_s - pose.x_m, 4.0 * time_s - pose.y_m);
    Some(measurement.with_bearing(Some((to_target.y.atan2(to_target.x) + noise_rad, 0.05))))
}

/// Centres with what their teams report.
type Case = (fn() -> Centre, fn(u64, usize) -> Option<Measurement>);

const CASES: [Case; 4] = [
    (kalman, |tick, id| report(tick, id, 0.0)),
    (from_ranges, |tick, id| report(tick, id, 0.0)),
    (mixed, mixed_report),
    (estimating_poses, mixed_report),
];

/// State, covariance and trust to the bit, and all that the next ticks depend on.
fn bits(centre: &mut Centre) -> (Vec<u8>, Trust) {
    let saved = centre.saved().unwrap();
    (saved.tracker.to_vec(), saved.trust.into_owned())
}

#[test]
fn a_late_report_is_fused_as_if_it_had_come_in_time() {
    for (centre, report) in CASES {
        let team = |tick| [0, 1, 2].map(|id| report(tick, id));
        for (late_by, robot) in [(1, 0), (3, 1), (LATE_TICKS_MAX as u64, 2)] {
            let (mut in_time, mut late) = (centre(), centre());
            for k in 0..40 {
                tick(&mut in_time, &team(k));
                let mut reports = team(k);
                if k == 30 {
                    reports[robot] = None;
                }
                tick(&mut late, &reports);
                let published = late.estimate();
                if k + 1 == 30 + late_by {
                    assert_ne!(bits(&mut late), bits(&mut in_time));
                    let report = report(30, robot).unwrap();
                    assert_eq!(late.take_late(30, robot, report), Late::Fused, "{late_by}");
                    assert_eq!(late.take_late(30, robot, report), Late::Missed, "once");
                    assert_eq!(late.report_at(30, robot), Some(report));
                    assert_eq!(late.estimate().digest, published.digest, "what was published stays");
                }
            }
            assert_eq!(bits(&mut late), bits(&mut in_time), "{late_by}");
        }
    }
}

#[test]
fn several_late_reports_in_any_order_do_as_well() {
    for (centre, report) in CASES {
        let (mut in_time, mut late) = (centre(), centre());
        for k in 0..30 {
            let team = [0, 1, 2].map(|id| report(k, id));
            tick(&mut in_time, &team);
            tick(&mut late, &if (25..29).contains(&k) { [None; 3] } else { team });
        }
        for (k, robot) in [(27, 2), (25, 1), (28, 0), (27, 0), (25, 2), (26, 1), (28, 1)] {
            assert_eq!(late.take_late(k, robot, report(k, robot).unwrap()), Late::Fused);
        }
        assert_ne!(bits(&mut late), bits(&mut in_time));
        for (k, robot) in [(25, 0), (26, 0), (26, 2), (27, 1), (28, 2)] {
            assert_eq!(late.take_late(k, robot, report(k, robot).unwrap()), Late::Fused);
        }
        assert_eq!(bits(&mut late), bits(&mut in_time));
    }
}

#[test]
fn a_range_that_is_too_late_or_an_outlier_changes_no_estimate() {
    let mut centre = kalman();
    for k in 0..30 {
        let [a, b, _] = team(k);
        tick(&mut centre, &[a, b, if k == 10 || k > 20 { None } else { report(k, 2, 0.0) }]);
    }
    let before = centre.state().to_vec();
    for (k, outcome) in [(0, Late::Missed), (10, Late::Missed), (24, Late::Missed), (31, Late::Missed)] {
        assert_eq!(centre.take_late(k, 2, report(k, 2, 0.0).unwrap()), outcome, "{k}");
    }
    assert_eq!(centre.take_late(26, 2, report(26, 2, 90.0).unwrap()), Late::Rejected);
    assert_eq!(centre.take_late(27, 2, Measurement::new(report(27, 2, 0.0).unwrap().pose, None)), Late::Nothing);
    assert_eq!(centre.state(), before);
    // A restarted centre has no past.
    let mut after = kalman();
    after.restore(centre.saved().unwrap()).unwrap();
    assert_eq!(after.take_late(28, 2, report(28, 2, 0.0).unwrap()), Late::Missed);
    assert_eq!(after.state(), before);
}

/// A late report has the robot's position of its own tick; since then the robot has followed its commands.
#[test]
fn a_late_position_counts_for_the_plan_if_it_is_newer() {
    let mut centre = of("");
    let stands = |x| Some(Measurement::new(Pose::at([x, 0.0]), None));
    tick(&mut centre, &[stands(15.0); 3]);
    for _ in 1..=3 {
        tick(&mut centre, &[stands(15.0), None, stands(15.0)]);
    }
    let commands: Vec<Command> = [2, 3].map(|k| centre.past.as_ref().unwrap().at(k).unwrap().commands[1]).into();
    centre.take_late(2, 1, stands(40.0).unwrap());
    let expected = commands.iter().fold(Vector::new(40.0, 0.0), |at, command| moved(at, *command, 0.1));
    assert_eq!(centre.bodies[1], Some(Body::of(&stands(0.0).unwrap(), expected, 2, None)));
    centre.take_late(1, 1, stands(70.0).unwrap());
    assert_eq!(centre.bodies[1].map(|body| body.heard_at), Some(2), "older than what is known");
}

#[test]
fn a_robot_whose_ranges_fail_is_distrusted_until_they_pass_again() {
    let team_of_four = "[prior]\nmean = \"start\"\n[robots]\ncount = 4\n[filter]\ngate_sigma = 4.0\n";
    let mut centre = of(team_of_four);
    let mut distrusted = Vec::new();
    for k in 0..90 {
        let error_m = if (20..60).contains(&k) { 12.0 } else { 0.0 };
        let reports = [0, 1, 2, 3].map(|id| report(k, id, if id == 2 { error_m } else { 0.0 }));
        tick(&mut centre, &reports);
        let estimate = centre.estimate();
        let is_out = !RobotSet::from_bits(estimate.distrusted[0]).is_empty();
        if is_out {
            assert!(centre.distrusted()[0].iter().eq([2]), "tick {k}");
            distrusted.push(k);
        }
        // At its last two ticks of distrust a range passes, but is still not fused.
        assert_eq!(
            (estimate.fused, estimate.rejected),
            if (20..68).contains(&k) { (3, 1) } else { (if k == 0 { 0 } else { 4 }, 0) }
        );
        // A kill in the middle of it changes nothing.
        if k == 23 || k == 65 {
            let mut after = of(team_of_four);
            after.restore(centre.saved().unwrap()).unwrap();
            centre = after;
        }
    }
    assert_eq!((distrusted.first(), distrusted.last()), (Some(&24), Some(&66)), "{distrusted:?}");
}

/// Each member's `lambda` in the problem of the last plan.
fn lambdas(centre: &Centre) -> Vec<f64> {
    Problem::of(centre.situation()).arms().iter().map(|arm| arm.lambda).collect()
}

#[test]
fn the_plan_takes_the_standard_deviation_that_the_last_message_reported() {
    let mut centre = of("[prior]\nmean = \"start\"\n");
    tick(&mut centre, &team(0));
    assert_eq!(lambdas(&centre), [1.0; 3], "before any range, what the scenario says");
    let mut reports = team(1);
    if let Some(report) = &mut reports[1] {
        report.range_std_m = 4.0;
    }
    tick(&mut centre, &reports);
    assert_eq!(lambdas(&centre), [1.0, 1.0 / 16.0, 1.0]);
    // A silent robot is planned for with its last report, after a kill too.
    let mut after = of("[prior]\nmean = \"start\"\n");
    after.restore(centre.saved().unwrap()).unwrap();
    let [a, _, c] = team(2);
    tick(&mut after, &[a, None, c]);
    assert_eq!(lambdas(&after), [1.0, 1.0 / 16.0, 1.0]);
    let late = Measurement::new(report(2, 1, 0.0).unwrap().pose, Some((20.0, 2.0)));
    after.take_late(2, 1, late);
    after.plan();
    assert_eq!(lambdas(&after), [1.0, 0.25, 1.0]);
}

#[test]
fn a_distrusted_robot_is_planned_for_without_information_and_still_led() {
    let mut centre = of("[prior]\nmean = \"start\"\n[robots]\ncount = 4\n[filter]\ngate_sigma = 4.0\n");
    for k in 0..40 {
        let reports = [0, 1, 2, 3].map(|id| report(k, id, if id == 2 && k > 20 { 12.0 } else { 0.0 }));
        tick(&mut centre, &reports);
    }
    assert!(centre.distrusted()[0].iter().eq([2]));
    assert_eq!(lambdas(&centre), [1.0, 1.0, 0.0, 1.0]);
    // The certificate is that of the problem of the other three.
    let plan = centre.last_plan();
    let proven = plan.certificate.unwrap();
    assert!(proven.is_optimal && proven.lower_bound <= plan.predicted.objective);
    let (problem, mut solution) = (Problem::of(centre.situation()), Solution::default());
    Certified::new(2_000).solve(0, &problem, &mut solution);
    assert_eq!(solution.commands, plan.commands);
    let directions = solution.directions;
    let trusted = [0, 1, 3].map(|id| (problem.arms()[id].lambda, directions[id]));
    let sum = problem.sum(&directions);
    let prior = sum + trusted.iter().fold(Vector::default(), |sum, (lambda, u)| sum + *u * -*lambda);
    assert!((prior.norm() - (problem.lambda_sum() - 3.0)).abs() < 1e-9, "{prior:?}");
    // It is sent to where its range would add most information to theirs.
    let best = problem.arms()[2].nearest(-sum, directions[2]);
    assert!((directions[2] - best).norm() < 1e-6 && centre.commands()[2].speed_mps > 0.0);
    // Its range is still tested, and rejected.
    assert!(centre.estimate().rejected == 1 && centre.estimate().tested == 4);
}

/// For each tick from 1 on, the trace and the proven least trace, with robots that follow their commands. Robot 0 does
/// not report at tick `missed`.
fn traces_m2(planner: &str, missed: u64) -> Vec<(f64, f64)> {
    let mut centre = of(&format!("[prior]\nmean = \"start\"\n[planner]\nname = \"{planner}\"\n"));
    let mut positions_m = [0.0, 2.0, 4.0].map(|angle_rad| Vector::from_angle(angle_rad) * 20.0);
    let (mut traces_m2, mut least_m2) = (Vec::new(), 0.0);
    for k in 0..=60 {
        let mut reports = positions_m.map(|position_m| {
            let range_m = (k > 0).then(|| (position_m.norm() + 0.5 * (k as f64).sin(), 1.0));
            Some(Measurement::new(Pose::at([position_m.x, position_m.y]), range_m))
        });
        reports[0] = reports[0].filter(|_| k != missed);
        tick(&mut centre, &reports);
        let trace_m2 = centre.covariance()[0] + centre.covariance()[5];
        traces_m2.push((trace_m2, least_m2));
        // The certificate survives a kill.
        let mut after = of("");
        after.restore(centre.saved().unwrap()).unwrap();
        least_m2 = after.estimate().least_trace_m2;
        assert_eq!(after.estimate(), centre.estimate());
        for (position_m, command) in positions_m.iter_mut().zip(centre.commands()) {
            *position_m = moved(*position_m, *command, 0.1);
        }
    }
    traces_m2.split_off(1)
}

#[test]
fn a_certified_team_reaches_the_least_trace_unless_a_range_is_missing() {
    for (tick, (trace_m2, least_m2)) in (1..).zip(traces_m2("certified", 30)) {
        let above = trace_m2 / least_m2 - 1.0;
        if tick == 30 {
            assert!(above > 1e-3, "{above}");
        } else {
            assert!(above.abs() < 1e-5, "tick {tick}: {above}");
        }
    }
}

#[test]
fn a_planner_without_proof_has_no_least_trace() {
    assert!(traces_m2("adaptive", u64::MAX).iter().all(|(_, least_m2)| *least_m2 == 0.0));
}

/// All four robots are much noisier than they report: none is distrusted, and more noise is assumed.
#[test]
fn noise_of_all_sensors_distrusts_no_robot() {
    let text = "[prior]\nmean = \"start\"\n[robots]\ncount = 4\n[filter]\ngate_sigma = 4.0\n";
    let mut centre = of(text);
    let mut widened = 0;
    for k in 0..200 {
        let reports = [0, 1, 2, 3].map(|id| report(k, id, 6.0 * (12.9 * k as f64 + 4.1 * id as f64).sin()));
        tick(&mut centre, &reports);
        widened += u64::from(centre.estimate().noise_scale[0] > 1.0);
        if k > 60 {
            assert!(centre.distrusted()[0].is_empty() && centre.noise_scales()[0] > 1.0, "tick {k}");
        }
        // A kill in the middle of it changes nothing.
        if k == 100 {
            let mut after = of(text);
            after.restore(centre.saved().unwrap()).unwrap();
            assert_eq!(bits(&mut after), bits(&mut centre));
            centre = after;
        }
    }
    assert!(widened > 130, "{widened}");
}

/// A target that jumps: the covariance is inflated, and the filter finds the target again.
#[test]
fn a_lost_estimate_is_widened_until_it_finds_the_target() {
    let mut centre = of("[prior]\nmean = \"start\"\n[robots]\ncount = 4\n[filter]\ngate_sigma = 4.0\n");
    let jumped = |k: u64| Vector::new(if k < 40 { 0.0 } else { 15.0 }, 0.0);
    for k in 0..120 {
        let reports = [0, 1, 2, 3].map(|id| {
            let report = report(k, id, 0.0).unwrap();
            let target = Vector::new(-0.8 * k as f64, 0.4 * k as f64) + jumped(k);
            let range_m = (target - Vector::from(report.pose)).norm();
            Some(Measurement::new(report.pose, report.range().map(|_| (range_m, 1.0))))
        });
        tick(&mut centre, &reports);
    }
    let truth = Vector::new(-0.8 * 119.0, 0.4 * 119.0) + jumped(119);
    let error_m = (Vector::new(centre.state()[0], centre.state()[1]) + truth * -1.0).norm();
    assert!(error_m < 2.0 && centre.distrusted()[0].is_empty(), "{error_m}");
}

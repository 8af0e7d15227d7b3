//! Once its buffers have their sizes, a tick of the fusion centre allocates nothing.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on should panic")]

use rangehound_fusion::Centre;
use rangehound_fusion::centre::Late;
use rangehound_fusion::planner::{Plan, Situation, TeamMember, for_team};
use rangehound_fusion::vector::Vector;
use rangehound_shared::measurement::{Measurement, Pose};
use rangehound_shared::motion::MotionModel;
use rangehound_shared::scenario::{PlannerSpec, PlannerTable, RobotsTable, Scenario, ScenarioFile, SensorSpec};

fn scenario(planner: &str, robots: u64) -> Scenario {
    let file = ScenarioFile {
        planner: Some(PlannerTable { name: Some(planner.to_owned()), step_rad: Some(0.3), ..PlannerTable::default() }),
        robots: Some(RobotsTable { count: Some(robots), ..RobotsTable::default() }),
        ..ScenarioFile::default()
    };
    Scenario::from_file(&file, "test").unwrap()
}

/// Ticks with robots on a circle round the origin, the target at its centre.
fn tick(centre: &mut Centre, reports: &mut [Option<Measurement>]) {
    let k = centre.next_tick() as f64;
    for (i, report) in reports.iter_mut().enumerate() {
        let position_m = Vector::from_angle(i as f64 + 0.01 * k) * 12.0;
        let pose = Pose::at([position_m.x, position_m.y]);
        *report = Some(Measurement::new(pose, (k > 0.0).then_some((12.0, 1.0))));
    }
    // The last robot's range comes a tick late.
    let late = reports.last_mut().and_then(Option::take);
    centre.update(0.1 * k, reports).unwrap();
    centre.plan();
    if let (Some(report), Some(last)) = (late, reports.len().checked_sub(1)) {
        let expected = if k > 0.0 { Late::Fused } else { Late::Missed };
        assert_eq!(centre.take_late(k as u64, last, report), expected);
    }
}

#[test]
fn a_tick_allocates_nothing() {
    for (planner, robots) in [
        ("adaptive", 3),
        ("standard", 100),
        ("random", 10),
        ("grid", 3),
        ("certified", 3),
        ("certified", 40),
        ("greedy", 10),
        ("pursue", 10),
        ("horizon", 3),
    ] {
        let mut centre = Centre::new(&scenario(planner, robots)).unwrap().with_history();
        let mut reports = vec![None; robots as usize];
        for _ in 0..50 {
            tick(&mut centre, &mut reports);
        }
        let counted = allocation_counter::measure(|| {
            for _ in 0..200 {
                tick(&mut centre, &mut reports);
            }
        });
        assert_eq!(counted.count_total, 0, "{planner}, {robots} robots");
    }
}

/// The same for robots with cameras that do not know exactly where they are.
#[test]
fn a_tick_of_cameras_and_uncertain_robots_allocates_nothing() {
    for planner in ["adaptive", "certified", "greedy", "horizon"] {
        let text = format!(
            "[robots]\ncount = 3\nsensor = \"both\"\nlocaliser = \"gps\"\n[sensor.both]\nrange_std_m = 1.0\n\
             bearing_std_rad = 0.05\n[localiser.gps]\nstd_m = 0.5\ncorrelation_s = 20.0\n[planner]\nname = \"{planner}\"\n"
        );
        let scenario = Scenario::from_file(&ScenarioFile::parse(&text, "test").unwrap(), "test").unwrap();
        let mut centre = Centre::new(&scenario).unwrap().with_history();
        let mut reports = vec![None; 3];
        let mut ticks = |count: usize| {
            for _ in 0..count {
                let k = centre.next_tick() as f64;
                for (i, report) in reports.iter_mut().enumerate() {
                    // They go to and fro, so that later ticks are like earlier ones.
                    let position_m = Vector::from_angle(i as f64 + 0.2 * (0.1 * k).sin()) * 12.0;
                    let pose = Pose { covariance_m2: [0.25, 0.0, 0.25], ..Pose::at([position_m.x, position_m.y]) };
                    let bearing_rad = (-position_m.y).atan2(-position_m.x);
                    let has_measured = k > 0.0;
                    let range = has_measured.then_some((12.0, 1.0));
                    *report =
                        Some(Measurement::new(pose, range).with_bearing(has_measured.then_some((bearing_rad, 0.05))));
                }
                centre.update(0.1 * k, &reports).unwrap();
                centre.plan();
            }
        };
        ticks(200);
        assert_eq!(allocation_counter::measure(|| ticks(100)).count_total, 0, "{planner}");
    }
}

/// The planners alone: a lone robot, which has most courses to try, and teams, of ranges alone and with cameras.
#[test]
fn a_plan_allocates_nothing_whatever_the_robots_measure() {
    let (camera, both) = (
        SensorSpec { range: None, bearing_std_rad: Some(0.05), ..SensorSpec::range(1.0) },
        SensorSpec { bearing_std_rad: Some(0.05), ..SensorSpec::range(1.0) },
    );
    let ranging = SensorSpec::range(1.0);
    let specs = [
        PlannerSpec::Horizon { steps: 20, blocks: 2 },
        PlannerSpec::Certified { nodes: 100_000 },
        PlannerSpec::Standard { iterations: 5 },
        PlannerSpec::Greedy,
        PlannerSpec::Pursue,
    ];
    let teams = [&[ranging][..], &[ranging; 3], &[camera], &[camera, camera], &[ranging, camera, both]];
    for (spec, sensors) in specs.into_iter().flat_map(|spec| teams.map(|sensors| (spec, sensors))) {
        let robots = sensors.len();
        let mut planner = for_team(spec, robots, 1).unwrap();
        let mut situation = Situation {
            motion: MotionModel::IntegratorChain { order: 2, noise_psd: 1.0 },
            step_s: 0.1,
            ..Situation::default()
        };
        (0..4).for_each(|i| situation.belief.covariance[(i, i)] = 2.0);
        let mut plan = Plan::default();
        let mut plans = |ticks: std::ops::Range<u64>| {
            for tick in ticks {
                let place_m = |i: usize| Vector::from_angle(i as f64 + 0.1 * tick as f64) * 12.0;
                situation.team.clear();
                let member = |(i, sensor): (usize, &SensorSpec)| TeamMember {
                    sensor: *sensor,
                    ..TeamMember::ranging(place_m(i), 10.0, 1.0)
                };
                situation.team.extend(sensors.iter().enumerate().map(member));
                planner.plan(tick, &situation, &mut plan);
            }
        };
        plans(0..40);
        let counted = allocation_counter::measure(|| plans(0..40));
        assert_eq!(counted.count_total, 0, "{spec:?}, {sensors:?}");
    }
}

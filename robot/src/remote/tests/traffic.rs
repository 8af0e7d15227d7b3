//! The traffic of a team's links: the tables of docs/machines.md, made of the frames that the two ends exchange.

use super::*;
use crate::remote::wire::{FRAME_LEN_MAX, MEASUREMENTS_MAX};

const BOOK: &str = include_str!("../../../../docs/machines.md");

/// IPv4, UDP, and of QUIC the short header, an acknowledgement, the head of a datagram and the tag of the encryption: as measured on a
/// link that has carried 20 000 packets. Before that they are up to 5 bytes shorter, as the numbers in them are.
const HEADERS_LEN: usize = 71;

/// A packet with an acknowledgement alone.
const ACKNOWLEDGEMENT_LEN: usize = HEADERS_LEN - 3;

/// Heads of Wi-Fi: MAC, LLC, encryption, check sum.
const WIFI_HEADERS_LEN: usize = 26 + 8 + 16 + 4;

/// Bits of a symbol at 54 Mbit/s.
const SYMBOL_BITS: usize = 216;

/// The frames of one robot in one tick of real time over a good link: their lengths to the robot and to the gateway.
fn frames_of_a_tick(ticks_per_s: u64) -> [Vec<usize>; 2] {
    let mut bench = Bench::new("realtime", 3, Link::default());
    bench.scenario.dt_s = 1.0 / ticks_per_s as f64;
    bench.machine = Machine::new(&bench.scenario, ROBOT, 0).unwrap();
    for tick in 0..30 {
        bench.lens = [Vec::new(), Vec::new()];
        bench.send_world(1, tick);
        for step in 0..1_000_000_000 / ticks_per_s / STEP_NS {
            if step == 4 {
                bench.send_heading(tick);
            }
            bench.step();
        }
    }
    bench.lens
}

/// Time of a packet on a channel of 802.11a with 54 Mbit/s, us: wait, mean back-off, preamble, symbols, pause, acknowledgement.
fn airtime_us(ip_len: usize) -> f64 {
    let symbols = (16 + 6 + 8 * (ip_len + WIFI_HEADERS_LEN)).div_ceil(SYMBOL_BITS);
    34.0 + 67.5 + 20.0 + 4.0 * symbols as f64 + 16.0 + 28.0
}

/// A number with groups of three digits.
fn grouped(number: f64) -> String {
    let digits = format!("{number:.0}");
    let groups: Vec<&str> =
        digits.as_bytes().rchunks(3).rev().map(|group| std::str::from_utf8(group).unwrap()).collect();
    groups.join(" ")
}

fn assert_in_book(row: &str) {
    assert!(BOOK.lines().any(|line| line == row), "docs/machines.md lacks the row\n{row}");
}

#[test]
fn frames_have_the_lengths_that_the_book_says() {
    let [to_robot, to_gateway] = frames_of_a_tick(5);
    let ([world, heading, alive], [measured, driven, answer]) = (&to_robot[..], &to_gateway[..]) else {
        panic!("{to_robot:?} {to_gateway:?}");
    };
    for (what, len) in [
        ("to the robot | a world", world),
        ("to the robot | a heading", heading),
        ("to the robot | nothing new, every 120 ms", alive),
        ("to the gateway | a measurement, and what the robot drives until the heading comes", measured),
        ("to the gateway | what the robot drives", driven),
        ("to the gateway | the answer to a frame with nothing new", answer),
    ] {
        assert_in_book(&format!("| {what} | {len} | {} |", len + HEADERS_LEN));
    }
    let measured_len = measured - answer;
    assert!(MEASUREMENTS_MAX * measured_len + driven + answer < FRAME_LEN_MAX);
}

#[test]
fn teams_have_the_traffic_that_the_book_says() {
    for ticks_per_s in [1, 5, 10, 20] {
        let lens: Vec<usize> = frames_of_a_tick(ticks_per_s).concat();
        // The gateway acknowledges the last frame of a tick, and each answer to a frame with nothing new, by a packet of its own.
        let acknowledgements = lens.len() / 2 - 1;
        let packets = lens.iter().map(|len| len + HEADERS_LEN);
        let packets: Vec<usize> = packets.chain(vec![ACKNOWLEDGEMENT_LEN; acknowledgements]).collect();
        for robots in [10, 100, 1_000] {
            let of_team = |of_robot: f64| of_robot * robots as f64 * ticks_per_s as f64;
            let packets_per_s = of_team(packets.len() as f64);
            let kilobytes_per_s = of_team(packets.iter().sum::<usize>() as f64 / 1e3);
            let share = of_team(packets.iter().map(|len| airtime_us(*len)).sum::<f64>() / 1e6);
            assert_in_book(&format!(
                "| {ticks_per_s} | {} | {} | {} | {} % |",
                grouped(robots.into()),
                grouped(packets_per_s),
                grouped(kilobytes_per_s),
                grouped(100.0 * share),
            ));
        }
    }
}

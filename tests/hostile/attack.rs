//! Many cases against one target: none may panic, hang, or take memory that its length does not explain.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use super::mutation::Dice;

/// Cases of each attack, unless [`CASES`] says another number.
const CASES_DEFAULT: u64 = 20_000;

/// Environment variable: cases of each attack, such as 2000000.
const CASES: &str = "RANGEHOUND_HOSTILE_CASES";

/// Environment variable: where the seeds of the cases start, so that another night finds other things.
const SEED: &str = "RANGEHOUND_HOSTILE_SEED";

/// A case takes microseconds: only one that would not end runs into this.
const LIMIT: Duration = Duration::from_secs(60);

/// Memory that anything may take, and more for each byte of input. A damaged length in a sealed file may claim as
/// much as the longest value that can be sealed, 16 MiB.
const BYTES_FREE: u64 = 20 << 20;
const BYTES_FOR_ONE: u64 = 400;

/// Longest complaint, bytes: file names and what was found are in it, files are not.
const COMPLAINT_MAX: usize = 600;

fn from_environment(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |text| text.parse().expect("a whole number"))
}

/// What a case came to.
pub(crate) enum Verdict {
    Taken,
    Refused(String),
}

/// Runs the cases of one attack; `share` is the part of the usual number that a slow target gets. Each case
/// follows from its number alone and shows its input.
pub(crate) fn attack(name: &str, share: f64, case: impl Fn(&mut Dice, &Cell<Vec<u8>>) -> Verdict) {
    let cases = (from_environment(CASES, CASES_DEFAULT) as f64 * share).ceil() as u64;
    let first = from_environment(SEED, 1) << 32;
    let watchdog = Watchdog::start(name);
    let (mut taken, mut bytes_most, began) = (0, 0, Instant::now());
    for number in first..first + cases {
        watchdog.is_at(number);
        let input = Cell::new(Vec::new());
        let mut verdict = Ok(Verdict::Taken);
        let memory = allocation_counter::measure(|| {
            verdict = catch_unwind(AssertUnwindSafe(|| case(&mut Dice::new(number), &input)));
        });
        let input = input.into_inner();
        let told = || format!("{name}, case {number}: {:?}", String::from_utf8_lossy(&input[..input.len().min(4_000)]));
        match verdict {
            Ok(Verdict::Taken) => taken += 1,
            Ok(Verdict::Refused(complaint)) => {
                let is_one_line = complaint.lines().count() == 1 && complaint.len() <= COMPLAINT_MAX;
                assert!(is_one_line, "{}\nis refused by {complaint:?}", told());
            }
            Err(panic) => {
                eprintln!("panic in {}", told());
                resume_unwind(panic);
            }
        }
        let explained = BYTES_FREE + BYTES_FOR_ONE * input.len() as u64;
        assert!(memory.bytes_max <= explained, "{}\ntakes {} bytes of memory", told(), memory.bytes_max);
        bytes_most = bytes_most.max(memory.bytes_max);
    }
    let refused = cases - taken;
    println!(
        "{name}: {cases} cases in {:.1} s: {taken} taken, {refused} refused, at most {bytes_most} bytes",
        began.elapsed().as_secs_f64()
    );
    // Damage that only ever does one of both would test half of a parser.
    assert!(taken > 0, "{name}: none of {cases} cases was taken");
}

/// Feeds damaged documents to a parser.
pub(crate) fn attack_parser(name: &str, share: f64, documents: &[Vec<u8>], parse: impl Fn(&[u8]) -> Verdict) {
    attack(name, share, |dice, input| {
        let bytes = dice.damaged(documents);
        input.set(bytes.clone());
        parse(&bytes)
    });
}

/// Ends the whole test if a case does not.
struct Watchdog(Arc<AtomicU64>);

impl Watchdog {
    fn start(name: &str) -> Self {
        let state = Arc::new(AtomicU64::new(0));
        let (watched, name) = (Arc::downgrade(&state), name.to_owned());
        std::thread::spawn(move || {
            let mut seen = (u64::MAX, Instant::now());
            while let Some(state) = watched.upgrade() {
                let number = state.load(Ordering::Relaxed);
                if number != seen.0 {
                    seen = (number, Instant::now());
                } else if seen.1.elapsed() > LIMIT {
                    eprintln!("{name}: case {number} has not ended in {LIMIT:?}");
                    std::process::abort();
                }
                drop(state);
                std::thread::sleep(Duration::from_millis(200));
            }
        });
        Self(state)
    }

    fn is_at(&self, number: u64) {
        self.0.store(number, Ordering::Relaxed);
    }
}

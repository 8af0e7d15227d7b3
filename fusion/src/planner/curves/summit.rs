//! Where a function of one variable has a maximum, by its slope.

/// Slopes at most; near a maximum few are needed.
const STEPS_MAX: usize = 40;

/// A local maximum of a function within an interval, or the end at which it rises out of it, near a guess: the secant method
/// on its slope, which stays between the places that are known to enclose a maximum. It ends where the slope is no greater
/// than `flat`.
pub(super) fn summit(
    mut slope: impl FnMut(f64) -> f64,
    (mut low, mut high): (f64, f64),
    guess: f64,
    step: f64,
    flat: f64,
) -> f64 {
    let mut at = guess.clamp(low, high);
    let mut now = slope(at);
    let mut stride = step.copysign(now);
    // Ends at which the slope is not known.
    let (mut is_low_open, mut is_high_open) = (true, true);
    for _ in 0..STEPS_MAX {
        if now.abs() <= flat {
            break;
        }
        let (end, is_open) = if now > 0.0 {
            (low, is_low_open) = (at, false);
            (high, is_high_open)
        } else {
            (high, is_high_open) = (at, false);
            (low, is_low_open)
        };
        let aim = at + stride;
        let next = match aim > low && aim < high {
            true => aim,
            false if is_open => end,
            false => 0.5 * (low + high),
        };
        if next == at {
            break;
        }
        let then = slope(next);
        // Where the line through both slopes is 0; if they diverge from it, farther on.
        let (way, fall) = (next - at, now - then);
        stride = if fall * way > 0.0 { then * way / fall } else { (2.0 * way).abs().copysign(then) };
        (at, now) = (next, then);
    }
    at
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_summit_is_found_inside_and_at_the_ends() {
        for (goal, guess) in [(0.3, 0.8), (0.3, 0.3), (0.0, 0.5), (1.0, 0.0), (-2.0, 0.9), (0.999, 0.1), (7.0, 1.0)] {
            for step in [1e-3, 0.1, 3.0] {
                let at = summit(|u| (goal - u) * (1.0 + u * u), (0.0, 1.0), guess, step, 1e-9);
                assert!((at - goal.clamp(0.0, 1.0)).abs() < 1e-8, "{goal} {guess}: {at}");
            }
        }
        // Between two valleys, and from a place where the slope's own slope misleads.
        let at = summit(|u| -(6.0 * (u - 0.4)).sin(), (0.0, 1.0), 0.85, 0.05, 1e-9);
        assert!((at - 0.4).abs() < 1e-8, "{at}");
        assert_eq!(summit(|_| 1.0, (0.5, 0.5), 0.2, 0.1, 0.0), 0.5);
    }
}

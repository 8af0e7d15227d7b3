//! The minimum of a function of one variable near a guess.

/// Steps at most; a parabola needs few.
const STEPS_MAX: usize = 40;

const GOLDEN: f64 = 0.381_966_011_250_105_1;

/// Where a function has a local minimum within an interval: Brent's method, which starts at the guess. The accuracy is relative
/// to the interval.
pub(super) fn minimum(
    mut value: impl FnMut(f64) -> f64,
    (mut low, mut high): (f64, f64),
    guess: f64,
    accuracy: f64,
) -> f64 {
    let tolerance = accuracy * (high - low) + 1e-14;
    if high - low <= 2.0 * tolerance {
        return guess.clamp(low, high);
    }
    // The guess may be an end, and the end the minimum.
    let inner = (1e-6 * (high - low)).max(tolerance);
    let mut best = guess.clamp(low + inner, high - inner);
    let (first, last) = (low, high);
    let (first_value, last_value) = (value(first), value(last));
    let mut best_value = value(best);
    let (mut second, mut third) = if first_value <= last_value { (first, last) } else { (last, first) };
    let (mut second_value, mut third_value) = (first_value.min(last_value), first_value.max(last_value));
    let (mut step, mut before) = (high - low, high - low);
    for _ in 0..STEPS_MAX {
        let middle = 0.5 * (low + high);
        if (best - middle).abs() <= 2.0 * tolerance - 0.5 * (high - low) {
            break;
        }
        // The minimum of the parabola through the three best.
        let r = (best - second) * (best_value - third_value);
        let q = (best - third) * (best_value - second_value);
        let (mut p, mut q) = ((best - third) * q - (best - second) * r, 2.0 * (q - r));
        if q > 0.0 {
            p = -p;
        }
        q = q.abs();
        let is_trusted = p.abs() < (0.5 * q * before).abs() && p > q * (low - best) && p < q * (high - best);
        before = step;
        step = if is_trusted {
            p / q
        } else {
            before = if best < middle { high - best } else { low - best };
            GOLDEN * before
        };
        let at = if step.abs() >= tolerance { best + step } else { best + tolerance.copysign(step) };
        let at_value = value(at);
        if at_value <= best_value {
            *if at < best { &mut high } else { &mut low } = best;
            (third, third_value, second, second_value) = (second, second_value, best, best_value);
            (best, best_value) = (at, at_value);
        } else {
            *if at < best { &mut low } else { &mut high } = at;
            if at_value <= second_value || second == best {
                (third, third_value, second, second_value) = (second, second_value, at, at_value);
            } else if at_value <= third_value || third == best || third == second {
                (third, third_value) = (at, at_value);
            }
        }
    }
    if first_value <= best_value && first_value <= last_value {
        first
    } else if last_value < best_value {
        last
    } else {
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_minimum_is_found_inside_and_at_the_ends() {
        for (goal, guess) in [(0.3, 0.8), (0.3, 0.3), (0.0, 0.5), (1.0, 0.0), (-2.0, 0.9), (0.999, 0.1)] {
            let at = minimum(|u| (u - goal) * (u - goal) * (1.0 + u * u), (0.0, 1.0), guess, 1e-9);
            assert!((at - goal.clamp(0.0, 1.0)).abs() < 1e-6, "{goal} {guess}: {at}");
        }
        assert_eq!(minimum(|u| u, (0.5, 0.5), 0.2, 1e-9), 0.5);
    }
}

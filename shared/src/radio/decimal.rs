//! Numbers of a fixed form, so that a truncated number is detected.

use super::Refusal;

/// Most digits before the point.
const WHOLE_LEN_MAX: usize = 6;

/// The decimals of one line: all have the same number of digits after the point, 2 to 4, as `printf` writes them.
#[derive(Debug, Default)]
pub(super) struct Decimals {
    fraction_len: Option<usize>,
}

impl Decimals {
    /// Reads `-12.34`.
    pub(super) fn read(&mut self, text: &str) -> Result<f64, Refusal> {
        let (whole, fraction) = text.split_once('.').ok_or(Refusal::Malformed)?;
        let digits = whole.strip_prefix('-').unwrap_or(whole);
        let is_number = is_complete(digits) && (2..=4).contains(&fraction.len()) && is_digits(fraction);
        if !is_number || *self.fraction_len.get_or_insert(fraction.len()) != fraction.len() {
            return Err(Refusal::Malformed);
        }
        text.parse().map_err(|_| Refusal::Malformed)
    }

    /// Reads a point `x,y,z`, each part of it a decimal.
    pub(super) fn point<'a>(&mut self, parts: &mut impl Iterator<Item = &'a str>) -> Result<[f64; 3], Refusal> {
        let mut point = [0.0; 3];
        for coordinate in &mut point {
            *coordinate = self.read(parts.next().ok_or(Refusal::Malformed)?)?;
        }
        Ok(point)
    }
}

/// Reads an integer without sign or leading zeros.
pub(super) fn whole(text: &str) -> Result<u32, Refusal> {
    if !is_complete(text) {
        return Err(Refusal::Malformed);
    }
    text.parse().map_err(|_| Refusal::Malformed)
}

fn is_complete(text: &str) -> bool {
    is_digits(text) && text.len() <= WHOLE_LEN_MAX && (text == "0" || !text.starts_with('0'))
}

pub(super) fn is_digits(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decimals_of_a_line_are_all_of_one_form() {
        let mut decimals = Decimals::default();
        assert_eq!(decimals.read("-12.34"), Ok(-12.34));
        for bad in
            ["12.345", "12.3", "12.", "12", ".12", "012.34", "+1.00", "1e1.00", "1.-1", "--1.00", "1.2.3", "", "-"]
        {
            assert_eq!(decimals.read(bad), Err(Refusal::Malformed), "{bad}");
        }
        assert_eq!(Decimals::default().read("1.5"), Err(Refusal::Malformed), "it may be cut");
        assert_eq!(Decimals::default().read("0.125"), Ok(0.125));
        assert_eq!((whole("0"), whole("42")), (Ok(0), Ok(42)));
        assert_eq!((whole("04"), whole("-1")), (Err(Refusal::Malformed), Err(Refusal::Malformed)));
    }
}

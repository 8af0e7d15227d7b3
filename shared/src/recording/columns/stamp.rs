//! Stamps by date and time of day.

use jiff::Timestamp;
use jiff::civil::DateTime;
use jiff::tz::TimeZone;

/// Seconds since 1970 of an ISO 8601 stamp such as `2024-05-01T12:00:00.25+02:00`. A stamp without a zone counts as UTC.
pub(in crate::recording) fn seconds(text: &[u8]) -> Option<f64> {
    // Jiff also reads dates alone, which here would be stamps of complete days.
    let text = std::str::from_utf8(text).ok().filter(|text| text.contains(':'))?;
    let timestamp = text.parse::<Timestamp>().ok().or_else(|| {
        let civil: DateTime = text.parse().ok()?;
        Some(civil.to_zoned(TimeZone::UTC).ok()?.timestamp())
    })?;
    let whole_s = timestamp.as_second();
    let rest_ns = timestamp.subsec_nanosecond();
    Some(whole_s as f64 + f64::from(rest_ns) / 1e9)
}

#[cfg(test)]
mod tests {
    use super::seconds;

    #[test]
    fn stamps_with_and_without_a_zone_are_read() {
        for (text, expected_s) in [
            ("1970-01-01T00:00:01Z", 1.0),
            ("1970-01-01 00:00:01.25", 1.25),
            ("1970-01-01T01:00:01,5+01:00", 1.5),
            ("1970-01-01T00:00:01.000000001", 1.000_000_001),
            ("2024-05-01T12:00:00.123456789-0700", 1_714_590_000.123_456_8),
        ] {
            assert_eq!(seconds(text.as_bytes()), Some(expected_s), "{text}");
        }
    }

    #[test]
    fn an_invalid_stamp_is_refused() {
        for text in
            ["", "12", "2024-05-01", "01.05.2024 12:00:00", "05/01/2024 12:00", "12:00:00", "2024-13-01T00:00:00Z"]
        {
            assert_eq!(seconds(text.as_bytes()), None, "{text}");
        }
    }
}

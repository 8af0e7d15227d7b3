//! The keys of a problem, and the error messages for lines that do not fit.

use std::fmt;
use std::marker::PhantomData;

use serde::de::value::MapAccessDeserializer;
use serde::de::{Deserialize, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};

/// A line with the right types; its values are not checked yet.
#[derive(Debug, Default, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProblemLine {
    /// Covariance of the predicted target position, m^2.
    #[serde(default, deserialize_with = "given")]
    pub prior_position_covariance: Option<Pair<Pair<Number>>>,
    /// Predicted position of the target, m.
    #[serde(default, deserialize_with = "given")]
    pub target: Option<Pair<Number>>,
    /// How long the robots move before they measure, s.
    #[serde(default, deserialize_with = "given")]
    pub time_step_s: Option<Number>,
    /// The team.
    #[serde(default, deserialize_with = "given")]
    pub robots: Option<Vec<Object<RobotLine>>>,
    /// Least distance of the robots to the predicted target, m.
    #[serde(default, deserialize_with = "given")]
    pub stand_off_m: Option<Number>,
    /// The same as a multiple of the square root of the position trace; the larger distance counts.
    #[serde(default, deserialize_with = "given")]
    pub stand_off_sigma: Option<Number>,
    /// Least distance of robots to each other, m.
    #[serde(default, deserialize_with = "given")]
    pub separation_m: Option<Number>,
    /// Name of the planner.
    #[serde(default, deserialize_with = "given")]
    pub planner: Option<String>,
    /// Name of what is made small.
    #[serde(default, deserialize_with = "given")]
    pub criterion: Option<String>,
}

/// One of `robots`.
#[derive(Debug, Default, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotLine {
    /// Its position, m.
    #[serde(default, deserialize_with = "given")]
    pub position: Option<Pair<Number>>,
    /// Its speed limit, m/s.
    #[serde(default, deserialize_with = "given")]
    pub max_speed: Option<Number>,
    /// Standard deviation of its range, m; none if it measures bearings alone.
    #[serde(default, deserialize_with = "given")]
    pub range_std: Option<Number>,
    /// Growth of that with the distance.
    #[serde(default, deserialize_with = "given")]
    pub range_std_per_m: Option<Number>,
    /// Standard deviation of its bearing, rad; none if it measures no bearing.
    #[serde(default, deserialize_with = "given")]
    pub bearing_std_rad: Option<Number>,
    /// Distance up to which it measures, m.
    #[serde(default, deserialize_with = "given")]
    pub max_range_m: Option<Number>,
    /// Angle in which it measures, rad.
    #[serde(default, deserialize_with = "given")]
    pub field_of_view_rad: Option<Number>,
    /// Covariance of its position, m^2.
    #[serde(default, deserialize_with = "given")]
    pub position_covariance: Option<Pair<Pair<Number>>>,
    /// Standard deviation of its heading, rad.
    #[serde(default, deserialize_with = "given")]
    pub heading_std_rad: Option<Number>,
}

/// `null` is not the same as no key: some programs write it for NaN.
fn given<'de, D: Deserializer<'de>, T: Deserialize<'de>>(deserializer: D) -> Result<Option<T>, D::Error> {
    T::deserialize(deserializer).map(Some)
}

impl ProblemLine {
    /// Reads a line. The error is one line that says what is wrong and what was expected.
    pub fn parse(line: &[u8]) -> Result<Self, String> {
        let text = std::str::from_utf8(line).map_err(|error| {
            format!("bytes that are not UTF-8 at column {}: expected UTF-8", error.valid_up_to() + 1)
        })?;
        match serde_json::from_str(text) {
            Ok(Object(problem)) => Ok(problem),
            // Only the second reading tracks the path of the key.
            Err(error) => Err(complaint(text, &error)),
        }
    }
}

fn complaint(text: &str, error: &serde_json::Error) -> String {
    let mut deserializer = serde_json::Deserializer::from_str(text);
    let tracked = serde_path_to_error::deserialize::<_, Object<ProblemLine>>(&mut deserializer);
    // A line that ends before a key has the path "?".
    let path = tracked.err().map(|tracked| tracked.path().to_string()).unwrap_or_default();
    let path = path.trim_end_matches('?').trim_end_matches('.');
    let place = if path.is_empty() { String::new() } else { format!(" in {path}") };
    let message = error.to_string();
    let message = message.rsplit_once(" at line ").map_or(message.as_str(), |(message, _)| message);
    if message.starts_with("number out of range") {
        format!("number out of range{place}: expected a finite number")
    } else if !error.is_data() {
        format!("{message}{place} at column {}: expected valid JSON", error.column())
    } else if message.starts_with("duplicate field") {
        format!("{message}{place}: expected each key once")
    } else {
        let message = message.replace("a sequence", "a list");
        let (problem, expected) = message.split_once(", expected ").unwrap_or((&message, "another value"));
        format!("{problem}{place}: expected {expected}")
    }
}

/// A JSON number.
#[derive(Debug, Clone, Copy)]
pub struct Number(pub f64);

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Reader;
        impl Visitor<'_> for Reader {
            type Value = Number;
            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("a number")
            }
            fn visit_f64<E: Error>(self, value: f64) -> Result<Number, E> {
                Ok(Number(value))
            }
            fn visit_i64<E: Error>(self, value: i64) -> Result<Number, E> {
                Ok(Number(value as f64))
            }
            fn visit_u64<E: Error>(self, value: u64) -> Result<Number, E> {
                Ok(Number(value as f64))
            }
        }
        deserializer.deserialize_f64(Reader)
    }
}

/// An element of a [`Pair`].
pub trait Element {
    /// Name of a pair of such elements.
    const PAIR: &'static str;
}

impl Element for Number {
    const PAIR: &'static str = "a list of two numbers";
}

impl Element for Pair<Number> {
    const PAIR: &'static str = "a list of two rows of two numbers";
}

/// A list of two.
#[derive(Debug, Clone, Copy)]
pub struct Pair<T>(pub [T; 2]);

impl<'de, T: Deserialize<'de> + Element> Deserialize<'de> for Pair<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Reader<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de> + Element> Visitor<'de> for Reader<T> {
            type Value = Pair<T>;
            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str(T::PAIR)
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Pair<T>, A::Error> {
                let first = list.next_element()?.ok_or_else(|| Error::invalid_length(0, &self))?;
                let second = list.next_element()?.ok_or_else(|| Error::invalid_length(1, &self))?;
                match list.next_element::<IgnoredAny>()? {
                    None => Ok(Pair([first, second])),
                    Some(_) => Err(Error::invalid_length(3, &self)),
                }
            }
        }
        deserializer.deserialize_seq(Reader(PhantomData))
    }
}

/// Accepts only JSON objects: the derived structs would also accept a list of their values.
#[derive(Debug)]
pub struct Object<T>(pub T);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Object<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Reader<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for Reader<T> {
            type Value = Object<T>;
            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("a JSON object")
            }
            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Object<T>, A::Error> {
                T::deserialize(MapAccessDeserializer::new(map)).map(Object)
            }
        }
        deserializer.deserialize_map(Reader(PhantomData))
    }
}

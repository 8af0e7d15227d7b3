//! Which fields of a message are a stamp, a measurement or a place, and their values.

use rangehound_shared::recording::ColumnMap;

use super::{BEARING, Fix, NUMBERS, RANGE};
use crate::files::bag::cdr::{self, CdrError, Value};
use crate::files::bag::definition::{Kind, ROOT, Types};
use crate::files::bag::interfaces;
use crate::files::bag::path::{Path, fields_named};
use crate::files::bag::storage::Topic;

/// Largest time, ns: 200 years, of which two can be subtracted.
const TIME_MAX_NS: i128 = i64::MAX as i128 / 2 - 1;

/// Where a message's time is.
pub(super) enum Stamp {
    /// Seconds, and nanoseconds of the second.
    Time([Path; 2]),
    /// A number, and its unit in ns.
    Number(Path, f64),
    /// The time of recording.
    Log,
}

impl Stamp {
    /// The field that the user chose, else the header's stamp. A type without one has the time of recording.
    pub(super) fn of(types: &Types, map: &ColumnMap) -> Result<Self, String> {
        let (field, unit) = match map.given("time") {
            Some(("log", _)) => return Ok(Self::Log),
            Some(given) => given,
            None if Path::parse(types, "header.stamp.nanosec").is_ok() => ("header.stamp", None),
            None => return Ok(Self::Log),
        };
        let path = Path::parse(types, field)?;
        let parts = ["sec", "nanosec"].map(|part| path.then(types, part).ok());
        if let [Some(sec), Some(nanosec)] = parts
            && !path.is_of_each()
        {
            return Ok(Self::Time([sec, nanosec]));
        }
        if !is_number(&path) || path.is_of_each() {
            return Err(format!(
                "{field} is no time: expected a field of builtin_interfaces/Time, a number, or log (--columns time=)"
            ));
        }
        let unit_ns = match unit {
            Some("s") => 1e9,
            Some("ms") => 1e6,
            Some("us") => 1e3,
            Some("ns") => 1.0,
            _ => {
                return Err(format!(
                    "{field} has no unit: expected --columns time={field}:s with the right one of s, ms, us, ns"
                ));
            }
        };
        Ok(Self::Number(path, unit_ns))
    }

    /// The time of a message, ns.
    pub(super) fn read(&self, types: &Types, message: &[u8], log_ns: i64) -> Result<i64, CdrError> {
        let whole = |path: &Path| match one(types, message, path)? {
            Value::Whole(whole) => Ok(whole),
            _ => Err(CdrError::Cut),
        };
        let time_ns = match self {
            Self::Log => log_ns.into(),
            Self::Time([sec, nanosec]) => whole(sec)? * 1_000_000_000 + whole(nanosec)?,
            Self::Number(path, unit_ns) => match one(types, message, path)? {
                Value::Whole(whole) => whole * *unit_ns as i128,
                value => (value.number() * unit_ns) as i128,
            },
        };
        Ok(time_ns.clamp(-TIME_MAX_NS, TIME_MAX_NS) as i64)
    }
}

/// Where a number of a measurement is.
enum Number {
    Field(Path),
    /// The direction of a vector, x and y.
    Direction([Path; 2]),
    /// The turn about the vertical of an orientation, x, y, z and w.
    Orientation([Path; 4]),
}

/// Where a sensor's name is.
enum Name {
    /// It is the same for all messages of the topic.
    Fixed(String),
    /// The place in the array.
    Index,
    Field(Path),
}

/// Where the measurements of a message are.
pub(super) struct Measures {
    sensor: Name,
    target: Option<Path>,
    numbers: [Option<Number>; NUMBERS.len()],
    /// Least and greatest range.
    limits: Option<[Path; 2]>,
    /// The units of the numbers, if their types tell them.
    units: [Option<&'static str>; NUMBERS.len()],
}

impl Measures {
    /// The fields that the user chose, else those that the type is known for.
    pub(super) fn of(
        types: &Types,
        &Topic { name: topic, type_name, .. }: &Topic<'_>,
        part: Option<&str>,
        map: &ColumnMap,
    ) -> Result<Self, String> {
        let is_range = type_name == interfaces::RANGE.name;
        let by_type = |key: &str| match key {
            "range" if is_range => Some("range"),
            "bearing" if type_name == interfaces::VECTOR.name => Some("vector"),
            "bearing" if type_name == "geometry_msgs/msg/QuaternionStamped" => Some("quaternion"),
            _ => None,
        };
        // Of several topics, one may have the ranges and another the bearings.
        let is_known = by_type("range").or(by_type("bearing")).is_some();
        let mut numbers = [const { None }; NUMBERS.len()];
        let mut units = [None; NUMBERS.len()];
        for ((number, unit), (key, _)) in numbers.iter_mut().zip(&mut units).zip(NUMBERS) {
            let found = match (map.given(key), by_type(key)) {
                (Some((field, _)), None) if is_known && ["range", "bearing"].contains(&key) => {
                    number_of(types, field).ok()
                }
                (Some((field, _)), None) => Some(number_of(types, field)?),
                (Some((field, _)), Some(known)) => {
                    Some(number_of(types, field).or_else(|problem| number_of(types, known).map_err(|_| problem))?)
                }
                (None, Some(known)) => Some(number_of(types, known)?),
                (None, None) => None,
            };
            *unit = match (&found, map.given(key)) {
                (Some(Number::Direction(_) | Number::Orientation(_)), _) => Some("rad"),
                (Some(Number::Field(_)), Some((field, _))) => unit_in_name(field),
                _ => None,
            };
            *number = found;
        }
        let [range, bearing, ..] = &numbers;
        if range.is_none() && bearing.is_none() {
            let fields = measured(types);
            let fields = if fields.is_empty() { String::new() } else { format!(", as {}", fields.join(", ")) };
            return Err(format!("{type_name} has no known field of a range: expected --field with one{fields}"));
        }
        let is_own_range = is_range
            && matches!(range, Some(Number::Field(path)) if Some(path) == Path::parse(types, "range").as_ref().ok());
        let limits = ["min_range", "max_range"].map(|name| Path::parse(types, name).ok());
        let limits = match limits {
            [Some(least), Some(most)] if is_own_range => Some([least, most]),
            _ => None,
        };
        let sensor = match map.given("sensor") {
            Some(("topic", _)) => Name::Fixed(topic.to_owned()),
            Some(("index", _)) => Name::Index,
            Some((field, _)) => Name::Field(text_of(types, field)?),
            None => match part {
                Some(part) => Name::Fixed(part.to_owned()),
                None if is_known => Name::Field(text_of(types, "header.frame_id")?),
                None => {
                    return Err(format!(
                        "{type_name} has no known field of the sensor's name: expected --columns sensor=FIELD, or topic or index (the place in the array) as FIELD"
                    ));
                }
            },
        };
        let target = map.given("target").map(|(field, _)| text_of(types, field)).transpose()?;
        if is_own_range {
            units[RANGE] = Some("m");
        }
        Ok(Self { sensor, target, numbers, limits, units })
    }

    /// The unit of a number that its type tells; `None` if there is no such number.
    pub(super) fn unit(&self, index: usize) -> Option<Option<&'static str>> {
        self.numbers.get(index)?.as_ref().and(self.units.get(index).copied())
    }

    /// The measurements of a message.
    pub(super) fn read(&self, types: &Types, message: &[u8]) -> Result<Found, CdrError> {
        let mut found = Found { count: 1, sensor: Vec::new(), target: Vec::new(), numbers: Default::default() };
        for (values, number) in found.numbers.iter_mut().zip(&self.numbers) {
            if let Some(number) = number {
                *values = number.read(types, message)?;
            }
        }
        let is_array = |number: &Option<Number>| number.as_ref().is_some_and(Number::is_of_each);
        let [range, bearing, ..] = &self.numbers;
        if is_array(range) {
            found.count = found.numbers[RANGE].len();
        } else if is_array(bearing) {
            found.count = found.numbers[BEARING].len();
        }
        if let Some(limits) = &self.limits {
            let [least_m, most_m] = [number(types, message, &limits[0])?, number(types, message, &limits[1])?];
            // Some drivers leave both at 0.
            let is_out = |range_m: f64| most_m > least_m && !(least_m..=most_m).contains(&range_m);
            found.numbers[RANGE].iter_mut().filter(|range_m| is_out(**range_m)).for_each(|range_m| *range_m = 0.0);
        }
        // As loggers write for "nothing was heard".
        let is_nothing = |range_m: &f64| !range_m.is_finite() || *range_m < 0.0;
        found.numbers[RANGE].iter_mut().filter(|range_m| is_nothing(range_m)).for_each(|range_m| *range_m = 0.0);
        found.sensor = match &self.sensor {
            Name::Fixed(name) => vec![name.clone()],
            Name::Index => (0..found.count).map(|index| index.to_string()).collect(),
            Name::Field(path) => texts(types, message, path)?,
        };
        if let Some(path) = &self.target {
            found.target = texts(types, message, path)?;
        }
        Ok(found)
    }
}

/// The measurements of one message: of each kind one value for all, one for each, or none.
pub(super) struct Found {
    /// Number of measurements.
    pub(super) count: usize,
    sensor: Vec<String>,
    target: Vec<String>,
    numbers: [Vec<f64>; NUMBERS.len()],
}

impl Found {
    /// The first contradiction, if any.
    pub(super) fn problem(&self) -> Option<String> {
        let lens = [("sensor", self.sensor.len()), ("target", self.target.len())];
        let numbers = NUMBERS.iter().zip(&self.numbers).map(|((key, _), values)| (*key, values.len()));
        let is_wrong = |(_, len): &(&str, usize)| ![0, 1, self.count].contains(len);
        let (key, len) = lens.into_iter().chain(numbers).find(is_wrong)?;
        Some(format!("{len} values of {key} for {} measurements", self.count))
    }

    pub(super) fn sensor(&self, index: usize) -> String {
        of_each(&self.sensor, index).cloned().unwrap_or_default()
    }

    pub(super) fn target(&self, index: usize) -> String {
        of_each(&self.target, index).cloned().unwrap_or_default()
    }

    pub(super) fn numbers(&self, index: usize) -> [f64; NUMBERS.len()] {
        self.numbers.each_ref().map(|values| of_each(values, index).copied().unwrap_or(f64::NAN))
    }
}

fn of_each<T>(values: &[T], index: usize) -> Option<&T> {
    if values.len() == 1 { values.first() } else { values.get(index) }
}

impl Number {
    fn is_of_each(&self) -> bool {
        match self {
            Self::Field(path) => path.is_of_each(),
            Self::Direction([path, _]) | Self::Orientation([path, ..]) => path.is_of_each(),
        }
    }

    fn read(&self, types: &Types, message: &[u8]) -> Result<Vec<f64>, CdrError> {
        let all = |path: &Path| {
            let mut values = Vec::new();
            cdr::read(types, message, path, &mut values)?;
            Ok(values.iter().map(Value::number).collect::<Vec<f64>>())
        };
        Ok(match self {
            Self::Field(path) => all(path)?,
            Self::Direction([x, y]) => all(x)?.into_iter().zip(all(y)?).map(|(x, y)| y.atan2(x)).collect(),
            Self::Orientation([x, y, z, w]) => {
                let (x, y, z, w) = (all(x)?, all(y)?, all(z)?, all(w)?);
                let turn =
                    |index: usize| Some(yaw_rad([*x.get(index)?, *y.get(index)?, *z.get(index)?, *w.get(index)?]));
                (0..x.len()).filter_map(turn).collect()
            }
        })
    }
}

/// The turn about the vertical of an orientation x, y, z, w, rad.
fn yaw_rad([x, y, z, w]: [f64; 4]) -> f64 {
    (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z))
}

fn number_of(types: &Types, field: &str) -> Result<Number, String> {
    let path = Path::parse(types, field)?;
    let parts = ["x", "y", "z", "w"].map(|part| path.then(types, part).ok());
    match parts {
        _ if is_number(&path) => Ok(Number::Field(path)),
        [Some(x), Some(y), Some(z), Some(w)] => Ok(Number::Orientation([x, y, z, w])),
        [Some(x), Some(y), ..] => Ok(Number::Direction([x, y])),
        _ => Err(format!("{field} is no number: expected a field of numbers")),
    }
}

/// The unit at the end of a field's name, as in `distances_m[]`.
fn unit_in_name(field: &str) -> Option<&'static str> {
    let last = field.rsplit('.').next()?;
    let (_, unit) = last.split('[').next()?.rsplit_once('_')?;
    ["m", "cm", "mm", "rad", "deg"].into_iter().find(|known| unit.eq_ignore_ascii_case(known))
}

fn text_of(types: &Types, field: &str) -> Result<Path, String> {
    let path = Path::parse(types, field)?;
    match path.kind {
        Kind::Message(_) => Err(format!("{field} is a message: expected a field of text or numbers")),
        _ => Ok(path),
    }
}

fn is_number(path: &Path) -> bool {
    matches!(path.kind, Kind::Unsigned(_) | Kind::Signed(_) | Kind::Real(_))
}

fn one(types: &Types, message: &[u8], path: &Path) -> Result<Value, CdrError> {
    let mut values = Vec::new();
    cdr::read(types, message, path, &mut values)?;
    values.pop().ok_or(CdrError::Cut)
}

fn number(types: &Types, message: &[u8], path: &Path) -> Result<f64, CdrError> {
    Ok(one(types, message, path)?.number())
}

fn texts(types: &Types, message: &[u8], path: &Path) -> Result<Vec<String>, CdrError> {
    let mut values = Vec::new();
    cdr::read(types, message, path, &mut values)?;
    Ok(values.iter().map(Value::text).collect())
}

/// The fields of a type whose names look like those of ranges or bearings.
pub(super) fn measured(types: &Types) -> Vec<String> {
    fields_named(types, &|name| {
        let name = name.to_ascii_lowercase();
        let base =
            ["_m", "_cm", "_mm", "_rad", "_deg"].iter().find_map(|unit| name.strip_suffix(unit)).unwrap_or(&name);
        let base = base.strip_suffix('s').unwrap_or(base);
        let is_limit = ["min_", "max_"].iter().any(|start| name.starts_with(start));
        !is_limit && ["range", "dist", "distance", "ranging", "bearing"].iter().any(|known| base.ends_with(known))
    })
}

/// Where a place is in a message.
pub(super) struct Place {
    position: [Path; 2],
    height: Option<Path>,
    orientation: Option<[Path; 4]>,
    /// Variances of x, y and heading.
    covariance: Option<[Path; 3]>,
}

impl Place {
    /// The field that the user chose, else the first that is a pose or a point.
    pub(super) fn of(types: &Types, field: Option<&str>) -> Result<Self, String> {
        let given = match field {
            Some(field) => vec![Path::parse(types, field)?],
            None => types.fields(ROOT).iter().filter_map(|field| Path::parse(types, &field.name).ok()).collect(),
        };
        if let Some(place) = given.iter().find_map(|path| Self::at(types, path)) {
            return Ok(place);
        }
        let expected = "expected a field with x and y: a pose, a point, odometry (TOPIC:FIELD)";
        Err(match field {
            Some(field) => format!("{field} is no place: {expected}"),
            None => format!("{} has no place: {expected}", types.name(ROOT)),
        })
    }

    fn at(types: &Types, path: &Path) -> Option<Self> {
        let then = |field: &str| path.then(types, field).ok().filter(is_number);
        let (position, orientation) =
            [("pose.position", "pose.orientation"), ("position", "orientation"), ("translation", "rotation"), ("", "")]
                .into_iter()
                .find(|(position, _)| then(&dotted(position, "x")).is_some())?;
        let axis = |name: &str| then(&dotted(position, name));
        let turn = |name: &str| then(&dotted(orientation, name));
        let orientation = match ["x", "y", "z", "w"].map(turn) {
            [Some(x), Some(y), Some(z), Some(w)] => Some([x, y, z, w]),
            _ => None,
        };
        let covariance = match ["covariance[0]", "covariance[7]", "covariance[35]"].map(then) {
            [Some(xx), Some(yy), Some(turn)] => Some([xx, yy, turn]),
            _ => None,
        };
        Some(Self { position: [axis("x")?, axis("y")?], height: axis("z"), orientation, covariance })
    }

    /// The place in a message, if its numbers are finite.
    pub(super) fn read(&self, types: &Types, message: &[u8], time_ns: i64) -> Result<Option<Fix>, CdrError> {
        let [x_m, y_m] = [number(types, message, &self.position[0])?, number(types, message, &self.position[1])?];
        let z_m = self.height.as_ref().map_or(Ok(f64::NAN), |path| number(types, message, path))?;
        let mut heading_rad = f64::NAN;
        if let Some(orientation) = &self.orientation {
            let mut turn = [0.0; 4];
            for (value, path) in turn.iter_mut().zip(orientation) {
                *value = number(types, message, path)?;
            }
            heading_rad = yaw_rad(turn);
        }
        let mut stds = [f64::NAN; 2];
        if let Some([xx, yy, turn]) = &self.covariance {
            let [xx_m2, yy_m2, turn_rad2] =
                [number(types, message, xx)?, number(types, message, yy)?, number(types, message, turn)?];
            // 0 stands for unknown as well as for exact.
            stds = [0.5 * (xx_m2 + yy_m2), turn_rad2]
                .map(|variance| if variance > 0.0 { variance.sqrt() } else { f64::NAN });
        }
        let [position_std_m, heading_std_rad] = stds;
        let fix = Fix { time_ns, position_m: [x_m, y_m, z_m], heading_rad, position_std_m, heading_std_rad };
        Ok((x_m.is_finite() && y_m.is_finite()).then_some(fix))
    }
}

fn dotted(before: &str, name: &str) -> String {
    if before.is_empty() { name.to_owned() } else { format!("{before}.{name}") }
}

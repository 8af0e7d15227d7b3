//! Message definitions of ROS 2, as bags hold them (`ros2msg`): the fields of a type and of all types in it.

use std::collections::HashMap;

use super::interfaces;

/// Deepest nesting of types.
const DEPTH_MAX: usize = 32;

/// Most types in one definition.
const TYPES_MAX: usize = 4_096;

/// The type of a field, or of each element if it is an array.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A truth value, one byte.
    Bool,
    /// A whole number without a sign, of so many bytes.
    Unsigned(usize),
    /// A whole number with a sign, of so many bytes.
    Signed(usize),
    /// A floating-point number of so many bytes.
    Real(usize),
    /// A text.
    Text,
    /// A message: its index in [`Types`].
    Message(usize),
}

/// How many elements a field has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Count {
    /// It is no array.
    One,
    /// An array of this length.
    Fixed(usize),
    /// An array that begins with its length.
    Sequence,
}

/// A field of a message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Field {
    /// Its name.
    pub name: String,
    /// Its type.
    pub kind: Kind,
    /// How many it has.
    pub count: Count,
}

/// A message type: `package/Name`, and its fields.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Type {
    name: String,
    fields: Vec<Field>,
}

/// A message type with all types in it. No type contains itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Types(Vec<Type>);

/// The index of the message type itself.
pub const ROOT: usize = 0;

impl Types {
    /// Parses a definition: the fields of the type `name` (`package/msg/Name`), then those of the types in it, each below a
    /// line of `=` and a line `MSG: package/Name`. Types that the text lacks may be standard ones.
    ///
    /// # Errors
    /// One line: what is wrong.
    pub fn parse(name: &str, text: &str) -> Result<Self, String> {
        let mut sections: HashMap<String, Vec<&str>> = HashMap::new();
        let mut lines = Vec::new();
        let mut of = short(name);
        for line in text.lines() {
            if line.len() > 2 && line.bytes().all(|byte| byte == b'=') {
                sections.entry(std::mem::take(&mut of)).or_insert(std::mem::take(&mut lines));
            } else if let Some(name) = line.strip_prefix("MSG:") {
                of = short(name.trim());
            } else {
                lines.push(line);
            }
        }
        sections.entry(of).or_insert(lines);
        let mut parser = Parser { sections, types: Vec::new(), indices: HashMap::new() };
        parser.index_of(&short(name), 0)?;
        Ok(Self(parser.types))
    }

    /// The fields of a type.
    #[must_use]
    pub fn fields(&self, index: usize) -> &[Field] {
        self.0.get(index).map_or(&[], |found| &found.fields)
    }

    /// The name of a type: `package/Name`.
    #[must_use]
    pub fn name(&self, index: usize) -> &str {
        self.0.get(index).map_or("", |found| &found.name)
    }

    /// The names of all types in order of first use, the message itself first.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(|found| found.name.as_str())
    }
}

/// `package/msg/Name` as `package/Name`.
#[must_use]
pub fn short(name: &str) -> String {
    name.replacen("/msg/", "/", 1)
}

struct Parser<'a> {
    sections: HashMap<String, Vec<&'a str>>,
    types: Vec<Type>,
    /// `None` while the type's own fields are being parsed.
    indices: HashMap<String, Option<usize>>,
}

impl Parser<'_> {
    fn index_of(&mut self, name: &str, depth: usize) -> Result<usize, String> {
        match self.indices.get(name) {
            Some(Some(index)) => return Ok(*index),
            Some(None) => return Err(format!("the type {name} contains itself")),
            None if depth > DEPTH_MAX || self.types.len() == TYPES_MAX => {
                return Err(format!("more than {DEPTH_MAX} types in each other, or {TYPES_MAX} in all"));
            }
            None => {}
        }
        let lines: Vec<&str> = match self.sections.get(name) {
            Some(lines) => lines.clone(),
            None => match interfaces::definition(name) {
                Some(text) => text.lines().collect(),
                None => return Err(format!("no definition of the type {name}")),
            },
        };
        self.indices.insert(name.to_owned(), None);
        let index = self.types.len();
        self.types.push(Type { name: name.to_owned(), fields: Vec::new() });
        let package = name.split('/').next().unwrap_or_default();
        let mut fields: Vec<Field> = Vec::new();
        for line in lines {
            let line = line.split('#').next().unwrap_or_default().trim();
            let Some((of_type, rest)) = line.split_once(char::is_whitespace) else {
                if line.is_empty() {
                    continue;
                }
                return Err(format!("{line:?} is no field of {name}"));
            };
            let rest = rest.trim_start();
            let end = rest.find(|c: char| !c.is_ascii_alphanumeric() && c != '_').unwrap_or(rest.len());
            let (field, after) = rest.split_at(end);
            if field.is_empty() {
                return Err(format!("{line:?} is no field of {name}"));
            }
            if after.trim_start().starts_with('=') {
                // A constant.
                continue;
            }
            let (kind, count) = self.kind(of_type, package, depth)?;
            fields.push(Field { name: field.to_owned(), kind, count });
        }
        self.types[index].fields = fields;
        self.indices.insert(name.to_owned(), Some(index));
        Ok(index)
    }

    /// A type as a field has it: `float32`, `string<=10`, `Point[3]`, `uint8[<=4]`, `geometry_msgs/Pose[]`.
    fn kind(&mut self, text: &str, package: &str, depth: usize) -> Result<(Kind, Count), String> {
        let (base, count) = match text.strip_suffix(']').and_then(|open| open.rsplit_once('[')) {
            None => (text, Count::One),
            Some((base, "")) => (base, Count::Sequence),
            Some((base, most)) if most.starts_with("<=") => (base, Count::Sequence),
            Some((base, fixed)) => {
                (base, Count::Fixed(fixed.parse().map_err(|_| format!("{text:?} is no type of an array"))?))
            }
        };
        let kind = match base.split("<=").next().unwrap_or_default() {
            "bool" => Kind::Bool,
            "byte" | "char" | "uint8" => Kind::Unsigned(1),
            "uint16" => Kind::Unsigned(2),
            "uint32" => Kind::Unsigned(4),
            "uint64" => Kind::Unsigned(8),
            "int8" => Kind::Signed(1),
            "int16" => Kind::Signed(2),
            "int32" => Kind::Signed(4),
            "int64" => Kind::Signed(8),
            "float32" => Kind::Real(4),
            "float64" => Kind::Real(8),
            "string" => Kind::Text,
            "wstring" => return Err("wide texts (wstring) are not supported".to_owned()),
            name => {
                let name = match name.contains('/') {
                    true => short(name),
                    false if name == "Header" => "std_msgs/Header".to_owned(),
                    // As in ROS 1, whose definitions some tools write.
                    false if name == "time" => "builtin_interfaces/Time".to_owned(),
                    false if name == "duration" => "builtin_interfaces/Duration".to_owned(),
                    false => format!("{package}/{name}"),
                };
                Kind::Message(self.index_of(&name, depth + 1)?)
            }
        };
        Ok((kind, count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_constants_arrays_and_nested_types_are_parsed() {
        let text = "# a comment\nuint8 KIND=1\nstring NAME = \"a b\"\nstd_msgs/Header header\nOne[<=3] ranges  # each\n\
                    float32[2] pair 1.0\nstring<=10 label\nbyte[] raw\n=====\nMSG: uwb_msgs/One\nint64 id 5\n";
        let types = Types::parse("uwb_msgs/msg/Many", text).unwrap();
        let fields = types.fields(ROOT);
        let listed: Vec<_> = fields.iter().map(|field| (field.name.as_str(), field.count)).collect();
        let expected = [
            ("header", Count::One),
            ("ranges", Count::Sequence),
            ("pair", Count::Fixed(2)),
            ("label", Count::One),
            ("raw", Count::Sequence),
        ];
        assert_eq!(listed, expected);
        let Kind::Message(one) = fields[1].kind else { panic!("{fields:?}") };
        assert_eq!((types.name(one), types.fields(one)[0].kind), ("uwb_msgs/One", Kind::Signed(8)));
        assert_eq!((fields[3].kind, fields[4].kind), (Kind::Text, Kind::Unsigned(1)));
        let names: Vec<&str> = types.names().collect();
        assert_eq!(names, ["uwb_msgs/Many", "std_msgs/Header", "builtin_interfaces/Time", "uwb_msgs/One"]);
    }

    #[test]
    fn definitions_without_sense_are_refused_in_one_line() {
        for (text, expected) in [
            ("A a", "no definition of the type p/A"),
            ("B b\n===\nMSG: p/B\nT back\n", "p/T contains itself"),
            ("float32", "is no field"),
            ("float32 =", "is no field"),
            ("float32[x] a", "no type of an array"),
            ("wstring a", "wstring"),
        ] {
            let error = Types::parse("p/msg/T", text).map(|types| types.names().count());
            let error = error.unwrap_err();
            assert!(error.contains(expected) && error.lines().count() == 1, "{text}: {error}");
        }
    }
}

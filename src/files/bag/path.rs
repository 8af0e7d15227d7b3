//! Fields of messages by path: `header.stamp`, `ranges[].distance` (each element of an array), `distances[2]` (one of them).

use super::definition::{Count, Kind, ROOT, Types};

/// Which elements of an array.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Index {
    /// Each.
    Each,
    /// The one of this number, from 0.
    At(usize),
}

/// From a message to one of its fields.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Step {
    /// The field's place in the message.
    pub field: usize,
    /// Its elements, if it is an array.
    pub index: Option<Index>,
}

/// From a message to a field in it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Path {
    pub(super) steps: Vec<Step>,
    /// The type of the field.
    pub kind: Kind,
}

impl Path {
    /// Finds the field of a message.
    ///
    /// # Errors
    /// One line: what is wrong, and what was expected.
    pub fn parse(types: &Types, text: &str) -> Result<Self, String> {
        Self { steps: Vec::new(), kind: Kind::Message(ROOT) }.then(types, text)
    }

    /// Finds a field of this field.
    ///
    /// # Errors
    /// As [`Self::parse`].
    pub fn then(&self, types: &Types, text: &str) -> Result<Self, String> {
        let mut path = self.clone();
        for part in text.split('.') {
            let (name, index) = match part.strip_suffix(']').and_then(|open| open.split_once('[')) {
                None => (part, None),
                Some((name, "")) => (name, Some(Index::Each)),
                Some((name, number)) => match number.parse() {
                    Ok(number) => (name, Some(Index::At(number))),
                    Err(_) => {
                        return Err(format!(
                            "{text:?} is no field: expected one as in header.stamp or ranges[].distance"
                        ));
                    }
                },
            };
            let Kind::Message(of) = path.kind else {
                return Err(format!("{text:?} is no field: what is before {name:?} has no fields of its own"));
            };
            let fields = types.fields(of);
            let Some(place) = fields.iter().position(|field| field.name == name) else {
                let names: Vec<&str> = fields.iter().map(|field| field.name.as_str()).collect();
                return Err(format!(
                    "no field {name:?} in {}: expected one of its fields {}",
                    types.name(of),
                    names.join(", ")
                ));
            };
            match (fields[place].count, index) {
                (Count::One, Some(_)) => {
                    return Err(format!("the field {name} is no array: expected {name} without []"));
                }
                (Count::Fixed(_) | Count::Sequence, None) => {
                    return Err(format!(
                        "the field {name} is an array: expected {name}[] for each element, or {name}[0] for one"
                    ));
                }
                _ => {}
            }
            path.steps.push(Step { field: place, index });
            path.kind = fields[place].kind;
        }
        Ok(path)
    }

    /// True if it leads to a value for each element of an array.
    #[must_use]
    pub fn is_of_each(&self) -> bool {
        self.steps.iter().any(|step| step.index == Some(Index::Each))
    }
}

/// The paths of fields of numbers for which `is_wanted` holds, by name: the first few.
#[must_use]
pub fn fields_named(types: &Types, is_wanted: &dyn Fn(&str) -> bool) -> Vec<String> {
    let mut listing = Listing { types, is_wanted, found: Vec::new(), left: Listing::LOOKS };
    listing.visit(ROOT, "", 0);
    listing.found
}

struct Listing<'a> {
    types: &'a Types,
    is_wanted: &'a dyn Fn(&str) -> bool,
    found: Vec<String>,
    /// A definition can have more fields in fields than could ever be looked at.
    left: usize,
}

impl Listing<'_> {
    const DEPTH: usize = 4;
    const LOOKS: usize = 1_000;
    const FOUND: usize = 8;

    fn visit(&mut self, of: usize, before: &str, depth: usize) {
        for field in self.types.fields(of) {
            if self.left == 0 || self.found.len() == Self::FOUND {
                return;
            }
            self.left -= 1;
            let array = if field.count == Count::One { "" } else { "[]" };
            let path = format!("{before}{}{array}", field.name);
            match field.kind {
                Kind::Message(inner) if depth < Self::DEPTH => self.visit(inner, &format!("{path}."), depth + 1),
                Kind::Unsigned(_) | Kind::Signed(_) | Kind::Real(_) if (self.is_wanted)(&field.name) => {
                    self.found.push(path)
                }
                _ => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_that_lead_nowhere_are_refused_with_what_is_there() {
        let types = Types::parse("p/msg/T", "std_msgs/Header header\nfloat32[] ranges\nfloat32 range\n").unwrap();
        for (path, expected) in [
            ("x", "expected one of its fields header, ranges, range"),
            ("header..x", "expected one of its fields stamp, frame_id"),
            ("ranges", "expected ranges[] for each element"),
            ("range[]", "expected range without []"),
            ("range.x", "before \"x\" has no fields"),
            ("ranges[a]", "expected one as in"),
        ] {
            let error = Path::parse(&types, path).unwrap_err();
            assert!(error.contains(expected), "{path}: {error}");
        }
        assert!(Path::parse(&types, "ranges[]").unwrap().is_of_each());
        assert_eq!(fields_named(&types, &|name| name.starts_with("range")), ["ranges[]", "range"]);
    }
}

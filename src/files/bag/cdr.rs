//! Messages as bytes: CDR, the encoding of ROS 2 (OMG's XCDR1). A message begins with four bytes, the second of which tells the byte order. Each
//! number is aligned to its own size, counted from there.

use super::definition::{Count, Field, Kind, ROOT, Types};
use super::path::{Index, Path, Step};

/// The bytes before a message, little-endian.
const HEADER: [u8; 4] = [0, 1, 0, 0];

/// Why a message cannot be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum CdrError {
    /// The bytes end before the message does, or a length in it is wrong.
    #[error("the message is cut short or damaged")]
    Cut,
    /// Another encoding.
    #[error("the message is not plain CDR")]
    Encoding,
    /// An array has no element of this number.
    #[error("an array has no element [{0}]")]
    NoElement(usize),
}

/// A value of a message.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// A whole number, or a truth value as 0 or 1.
    Whole(i128),
    /// Another number.
    Real(f64),
    /// A text.
    Text(String),
}

impl Value {
    /// Its number; NaN for a text.
    #[must_use]
    pub fn number(&self) -> f64 {
        match self {
            Self::Whole(whole) => *whole as f64,
            Self::Real(real) => *real,
            Self::Text(_) => f64::NAN,
        }
    }

    /// Its text: numbers without loss.
    #[must_use]
    pub fn text(&self) -> String {
        match self {
            Self::Whole(whole) => whole.to_string(),
            Self::Real(real) => real.to_string(),
            Self::Text(text) => text.clone(),
        }
    }
}

/// Appends the values of a field of a message: one, or one for each element of an array.
///
/// # Errors
/// [`CdrError`].
pub fn read(types: &Types, message: &[u8], path: &Path, values: &mut Vec<Value>) -> Result<(), CdrError> {
    let (header, bytes) = message.split_first_chunk::<4>().ok_or(CdrError::Cut)?;
    let is_little = match header[..2] {
        [0, 0] => false,
        [0, 1] => true,
        _ => return Err(CdrError::Encoding),
    };
    Reader { types, bytes, at: 0, is_little }.message(ROOT, &path.steps, false, values)
}

struct Reader<'a> {
    types: &'a Types,
    bytes: &'a [u8],
    at: usize,
    is_little: bool,
}

impl<'a> Reader<'a> {
    /// Reads a message to the field of the first step; to its end if another message may follow.
    fn message(
        &mut self,
        of: usize,
        steps: &[Step],
        to_its_end: bool,
        values: &mut Vec<Value>,
    ) -> Result<(), CdrError> {
        let types = self.types;
        let fields = types.fields(of);
        if fields.is_empty() {
            // Such a message has a byte that means nothing.
            self.take(1, 1)?;
        }
        for (index, field) in fields.iter().enumerate() {
            match steps.split_first().filter(|(step, _)| step.field == index) {
                Some((step, rest)) => {
                    self.field(field, step.index, rest, to_its_end, values)?;
                    if !to_its_end {
                        break;
                    }
                }
                None => self.skip(field)?,
            }
        }
        Ok(())
    }

    fn field(
        &mut self,
        field: &Field,
        wanted: Option<Index>,
        rest: &[Step],
        to_its_end: bool,
        values: &mut Vec<Value>,
    ) -> Result<(), CdrError> {
        let count = self.count(field)?;
        if let Some(Index::At(index)) = wanted
            && index >= count
        {
            return Err(CdrError::NoElement(index));
        }
        let is_one = wanted.is_none();
        for index in 0..count {
            let is_wanted = match wanted {
                Some(Index::At(at)) => at == index,
                Some(Index::Each) | None => true,
            };
            match field.kind {
                Kind::Message(of) if is_wanted => self.message(of, rest, to_its_end || !is_one, values)?,
                Kind::Message(of) => self.message(of, &[], true, values)?,
                kind => {
                    let value = self.value(kind)?;
                    if is_wanted {
                        values.push(value);
                    }
                }
            }
        }
        Ok(())
    }

    /// The number of a field's elements, each of which takes a byte at least.
    fn count(&mut self, field: &Field) -> Result<usize, CdrError> {
        let count = match field.count {
            Count::One => 1,
            Count::Fixed(count) => count,
            Count::Sequence => self.u32()? as usize,
        };
        if count > self.bytes.len() - self.at { Err(CdrError::Cut) } else { Ok(count) }
    }

    fn skip(&mut self, field: &Field) -> Result<(), CdrError> {
        let count = self.count(field)?;
        match field.kind {
            Kind::Bool => drop(self.take(1, count)?),
            Kind::Unsigned(size) | Kind::Signed(size) | Kind::Real(size) => drop(self.take(size, count)?),
            Kind::Text => {
                for _ in 0..count {
                    self.text()?;
                }
            }
            Kind::Message(of) => {
                for _ in 0..count {
                    self.message(of, &[], true, &mut Vec::new())?;
                }
            }
        }
        Ok(())
    }

    fn value(&mut self, kind: Kind) -> Result<Value, CdrError> {
        Ok(match kind {
            Kind::Bool => Value::Whole(i128::from(self.number(1)? != 0)),
            Kind::Unsigned(size) => Value::Whole(self.number(size)?.into()),
            Kind::Signed(size) => {
                let unused = 64 - 8 * size as u32;
                Value::Whole(((self.number(size)? << unused).cast_signed() >> unused).into())
            }
            Kind::Real(4) => Value::Real(f32::from_bits(self.number(4)? as u32).into()),
            Kind::Real(_) => Value::Real(f64::from_bits(self.number(8)?)),
            Kind::Text => Value::Text(String::from_utf8_lossy(self.text()?).into_owned()),
            // Messages are read by `field`.
            Kind::Message(_) => return Err(CdrError::Encoding),
        })
    }

    /// The bits of a number of so many bytes.
    fn number(&mut self, size: usize) -> Result<u64, CdrError> {
        let mut bytes = [0; 8];
        let taken = self.take(size, 1)?;
        bytes[..size].copy_from_slice(taken);
        if !self.is_little {
            bytes[..size].reverse();
        }
        Ok(u64::from_le_bytes(bytes))
    }

    fn u32(&mut self) -> Result<u32, CdrError> {
        Ok(self.number(4)? as u32)
    }

    /// A text without the zero at its end.
    fn text(&mut self) -> Result<&'a [u8], CdrError> {
        let len = self.u32()? as usize;
        let text = self.take(1, len)?;
        Ok(text.strip_suffix(&[0]).unwrap_or(text))
    }

    /// The bytes of so many numbers of one size.
    fn take(&mut self, size: usize, count: usize) -> Result<&'a [u8], CdrError> {
        if count == 0 {
            return Ok(&[]);
        }
        let start = self.at.next_multiple_of(size);
        let end = size.checked_mul(count).and_then(|len| start.checked_add(len)).ok_or(CdrError::Cut)?;
        let taken = self.bytes.get(start..end).ok_or(CdrError::Cut)?;
        self.at = end;
        Ok(taken)
    }
}

/// Writes the fields of a message in order.
#[derive(Debug, Default)]
pub struct Writer(Vec<u8>);

impl Writer {
    /// Begins a message.
    pub fn begin(&mut self) {
        self.0.clear();
        self.0.extend(HEADER);
    }

    /// The message so far.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.0
    }

    /// Appends a byte.
    pub fn u8(&mut self, number: u8) {
        self.0.push(number);
    }

    /// Appends a number.
    pub fn i32(&mut self, number: i32) {
        self.put(number.to_le_bytes());
    }

    /// Appends a number, or the length of an array.
    pub fn u32(&mut self, number: u32) {
        self.put(number.to_le_bytes());
    }

    /// Appends a number.
    pub fn f32(&mut self, number: f32) {
        self.put(number.to_le_bytes());
    }

    /// Appends numbers.
    pub fn f64s(&mut self, numbers: &[f64]) {
        for number in numbers {
            self.put(number.to_le_bytes());
        }
    }

    /// Appends a text.
    pub fn text(&mut self, text: &str) {
        self.u32(text.len() as u32 + 1);
        self.0.extend(text.bytes().chain([0]));
    }

    fn put<const N: usize>(&mut self, bytes: [u8; N]) {
        let end = (self.0.len() - HEADER.len()).next_multiple_of(N) + HEADER.len();
        self.0.resize(end, 0);
        self.0.extend(bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn types() -> Types {
        let text = "bool flag\nint8 small\nOne[] ones\nuint16[3] fixed\nfloat64 real\nstring label\nint64 large\n===\nMSG: p/One\n\
                    string name\nfloat32 value\nEmpty nothing\n===\nMSG: p/Empty\n";
        Types::parse("p/msg/T", text).unwrap()
    }

    fn message() -> Vec<u8> {
        let mut writer = Writer::default();
        writer.begin();
        writer.u8(1);
        writer.u8(0xFE);
        writer.u32(2);
        for (name, value) in [("a", 1.5), ("long", -2.5)] {
            writer.text(name);
            writer.f32(value);
            writer.u8(0);
        }
        for number in [7_u16, 8, 9] {
            writer.put(number.to_le_bytes());
        }
        writer.f64s(&[0.125]);
        writer.text("");
        writer.put((-5_i64).to_le_bytes());
        writer.bytes().to_vec()
    }

    fn values(message: &[u8], path: &str) -> Result<Vec<Value>, CdrError> {
        let types = types();
        let mut values = Vec::new();
        read(&types, message, &Path::parse(&types, path).unwrap(), &mut values).map(|()| values)
    }

    #[test]
    fn each_field_is_read_where_it_is() {
        let message = message();
        for (path, expected) in [
            ("flag", vec![Value::Whole(1)]),
            ("small", vec![Value::Whole(-2)]),
            ("ones[].name", vec![Value::Text("a".to_owned()), Value::Text("long".to_owned())]),
            ("ones[].value", vec![Value::Real(1.5), Value::Real(-2.5)]),
            ("ones[1].value", vec![Value::Real(-2.5)]),
            ("fixed[]", vec![Value::Whole(7), Value::Whole(8), Value::Whole(9)]),
            ("fixed[2]", vec![Value::Whole(9)]),
            ("real", vec![Value::Real(0.125)]),
            ("label", vec![Value::Text(String::new())]),
            ("large", vec![Value::Whole(-5)]),
        ] {
            assert_eq!(values(&message, path), Ok(expected), "{path}");
        }
        assert_eq!(values(&message, "ones[2].name"), Err(CdrError::NoElement(2)));
    }

    #[test]
    fn a_message_that_is_cut_or_of_another_encoding_is_refused() {
        let message = message();
        for len in 0..message.len() {
            assert_eq!(values(&message[..len], "large"), Err(CdrError::Cut), "{len}");
        }
        for header in [[0, 2], [0, 3], [0, 7], [1, 1]] {
            let mut other = message.clone();
            other[..2].copy_from_slice(&header);
            assert_eq!(values(&other, "flag"), Err(CdrError::Encoding));
        }
        let mut huge = message;
        huge[8..12].fill(0xFF);
        assert_eq!(values(&huge, "ones[].value"), Err(CdrError::Cut));
    }

    #[test]
    fn big_endian_messages_are_read() {
        let types = Types::parse("p/msg/T", "uint8 a\nint16 b\nfloat32 c\nstring d\n").unwrap();
        let bytes = [&[0, 0, 0, 0, 9, 0, 0xFF, 0xFE][..], &1.5_f32.to_be_bytes(), &[0, 0, 0, 2, b'x', 0]].concat();
        for (path, expected) in [
            ("a", Value::Whole(9)),
            ("b", Value::Whole(-2)),
            ("c", Value::Real(1.5)),
            ("d", Value::Text("x".to_owned())),
        ] {
            let mut values = Vec::new();
            read(&types, &bytes, &Path::parse(&types, path).unwrap(), &mut values).unwrap();
            assert_eq!(values, [expected], "{path}");
        }
    }
}

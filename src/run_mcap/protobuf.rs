//! Protocol buffers, as much as a recording takes: one table of fields gives a message its struct, its bytes, and the
//! schema that goes into the file beside them.

/// Bytes that are not the message they should be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("not the protobuf message that its schema says")]
pub struct Malformed;

/// A message.
pub trait Message: Default {
    /// Its full name, package first.
    const NAME: &'static str;

    /// Puts its fields after what is there.
    fn encode(&self, out: &mut Vec<u8>);

    /// Takes a field of its bytes.
    ///
    /// # Errors
    /// If the field has another type.
    fn take(&mut self, number: u64, wire: Wire<'_>) -> Result<(), Malformed>;

    /// Describes it, and the messages that it holds, each before who holds it.
    fn describe(types: &mut Types);

    /// Decodes one. What it does not know it passes over.
    ///
    /// # Errors
    /// [`Malformed`].
    fn decode(bytes: &[u8]) -> Result<Self, Malformed> {
        let mut message = Self::default();
        message.merge(bytes)?;
        Ok(message)
    }

    /// Takes all fields of some bytes.
    ///
    /// # Errors
    /// [`Malformed`].
    fn merge(&mut self, mut bytes: &[u8]) -> Result<(), Malformed> {
        while !bytes.is_empty() {
            let key = varint(&mut bytes)?;
            let wire = match key & 7 {
                0 => Wire::Varint(varint(&mut bytes)?),
                1 => Wire::Fixed64(*take_chunk(&mut bytes)?),
                2 => {
                    let len = usize::try_from(varint(&mut bytes)?).map_err(|_| Malformed)?;
                    let (inside, rest) = bytes.split_at_checked(len).ok_or(Malformed)?;
                    bytes = rest;
                    Wire::Bytes(inside)
                }
                5 => Wire::Fixed32(*take_chunk(&mut bytes)?),
                _ => return Err(Malformed),
            };
            self.take(key >> 3, wire)?;
        }
        Ok(())
    }
}

/// A field's value as it travels.
#[derive(Debug, Clone, Copy)]
pub enum Wire<'a> {
    /// A whole number of variable length.
    Varint(u64),
    /// Eight bytes.
    Fixed64([u8; 8]),
    /// Bytes of a length of their own.
    Bytes(&'a [u8]),
    /// Four bytes.
    Fixed32([u8; 4]),
}

fn take_chunk<'a, const N: usize>(bytes: &mut &'a [u8]) -> Result<&'a [u8; N], Malformed> {
    let (chunk, rest) = bytes.split_first_chunk().ok_or(Malformed)?;
    *bytes = rest;
    Ok(chunk)
}

fn varint(bytes: &mut &[u8]) -> Result<u64, Malformed> {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let [byte] = *take_chunk(bytes)?;
        value |= u64::from(byte & 0x7f) << shift;
        if byte & 0x80 == 0 {
            return Ok(value);
        }
    }
    Err(Malformed)
}

fn put_varint(mut value: u64, out: &mut Vec<u8>) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

fn put_key(number: u64, wire_type: u64, out: &mut Vec<u8>) {
    put_varint(number << 3 | wire_type, out);
}

/// Puts what `inside` puts as bytes with their length before them.
fn put_inside(number: u64, out: &mut Vec<u8>, inside: impl FnOnce(&mut Vec<u8>)) {
    put_key(number, 2, out);
    let start = out.len();
    inside(out);
    let mut len = Vec::with_capacity(10);
    put_varint((out.len() - start) as u64, &mut len);
    out.splice(start..start, len);
}

/// What a field is, with its type's number in a descriptor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// One value.
    One(u64),
    /// One value, or none.
    Optional(u64),
    /// Any number of values.
    Repeated(u64),
}

/// A field as it is described.
#[derive(Debug)]
pub struct FieldType {
    /// Its name.
    pub name: &'static str,
    /// Its number.
    pub number: u64,
    /// What it is.
    pub kind: Kind,
    /// Full name of its type, if that is a message or an enumeration.
    pub type_name: Option<&'static str>,
}

/// A type that a field may have. As in proto3, what is zero is not written, unless it is optional.
pub trait Field {
    /// What it is in a descriptor.
    const KIND: Kind;

    /// Puts it after what is there.
    fn put(&self, number: u64, out: &mut Vec<u8>);

    /// Takes it, or one more of it.
    ///
    /// # Errors
    /// If it is of another type.
    fn take(&mut self, wire: Wire<'_>) -> Result<(), Malformed>;

    /// Describes its type, if that is a message or an enumeration, and gives its full name.
    fn describe(_types: &mut Types) -> Option<&'static str> {
        None
    }
}

const DOUBLE: u64 = 1;
const INT64: u64 = 3;
const UINT64: u64 = 4;
const INT32: u64 = 5;
const FIXED32: u64 = 7;
const BOOL: u64 = 8;
const STRING: u64 = 9;
const MESSAGE: u64 = 11;
const BYTES: u64 = 12;
const ENUM: u64 = 14;

impl Field for f64 {
    const KIND: Kind = Kind::One(DOUBLE);

    fn put(&self, number: u64, out: &mut Vec<u8>) {
        // Minus zero is a value like any other.
        if self.to_bits() != 0 {
            Some(*self).put(number, out);
        }
    }

    fn take(&mut self, wire: Wire<'_>) -> Result<(), Malformed> {
        let Wire::Fixed64(bytes) = wire else { return Err(Malformed) };
        *self = Self::from_le_bytes(bytes);
        Ok(())
    }
}

/// Whole numbers of variable length.
macro_rules! whole {
    ($($number:ty = $kind:expr,)*) => {$(
        impl Field for $number {
            const KIND: Kind = Kind::One($kind);

            fn put(&self, number: u64, out: &mut Vec<u8>) {
                if *self != 0 {
                    put_key(number, 0, out);
                    put_varint(*self as u64, out);
                }
            }

            fn take(&mut self, wire: Wire<'_>) -> Result<(), Malformed> {
                let Wire::Varint(value) = wire else { return Err(Malformed) };
                *self = value as $number;
                Ok(())
            }
        }
    )*};
}

whole! {
    u64 = UINT64,
    i64 = INT64,
    i32 = INT32,
}

impl Field for u32 {
    const KIND: Kind = Kind::One(FIXED32);

    fn put(&self, number: u64, out: &mut Vec<u8>) {
        if *self != 0 {
            put_key(number, 5, out);
            out.extend(self.to_le_bytes());
        }
    }

    fn take(&mut self, wire: Wire<'_>) -> Result<(), Malformed> {
        let Wire::Fixed32(bytes) = wire else { return Err(Malformed) };
        *self = Self::from_le_bytes(bytes);
        Ok(())
    }
}

impl Field for bool {
    const KIND: Kind = Kind::One(BOOL);

    fn put(&self, number: u64, out: &mut Vec<u8>) {
        u64::from(*self).put(number, out);
    }

    fn take(&mut self, wire: Wire<'_>) -> Result<(), Malformed> {
        let Wire::Varint(value) = wire else { return Err(Malformed) };
        *self = value != 0;
        Ok(())
    }
}

impl Field for Option<f64> {
    const KIND: Kind = Kind::Optional(DOUBLE);

    fn put(&self, number: u64, out: &mut Vec<u8>) {
        if let Some(value) = self {
            put_key(number, 1, out);
            out.extend(value.to_le_bytes());
        }
    }

    fn take(&mut self, wire: Wire<'_>) -> Result<(), Malformed> {
        self.insert(0.0).take(wire)
    }
}

impl Field for Option<u64> {
    const KIND: Kind = Kind::Optional(UINT64);

    fn put(&self, number: u64, out: &mut Vec<u8>) {
        if let Some(value) = self {
            put_key(number, 0, out);
            put_varint(*value, out);
        }
    }

    fn take(&mut self, wire: Wire<'_>) -> Result<(), Malformed> {
        self.insert(0).take(wire)
    }
}

impl Field for String {
    const KIND: Kind = Kind::One(STRING);

    fn put(&self, number: u64, out: &mut Vec<u8>) {
        if !self.is_empty() {
            put_inside(number, out, |out| out.extend(self.as_bytes()));
        }
    }

    fn take(&mut self, wire: Wire<'_>) -> Result<(), Malformed> {
        let Wire::Bytes(bytes) = wire else { return Err(Malformed) };
        std::str::from_utf8(bytes).map_err(|_| Malformed)?.clone_into(self);
        Ok(())
    }
}

impl Field for Vec<u8> {
    const KIND: Kind = Kind::One(BYTES);

    fn put(&self, number: u64, out: &mut Vec<u8>) {
        if !self.is_empty() {
            put_inside(number, out, |out| out.extend(self));
        }
    }

    fn take(&mut self, wire: Wire<'_>) -> Result<(), Malformed> {
        let Wire::Bytes(bytes) = wire else { return Err(Malformed) };
        bytes.clone_into(self);
        Ok(())
    }
}

impl Field for Vec<f64> {
    const KIND: Kind = Kind::Repeated(DOUBLE);

    fn put(&self, number: u64, out: &mut Vec<u8>) {
        if !self.is_empty() {
            put_inside(number, out, |out| out.extend(self.iter().flat_map(|value| value.to_le_bytes())));
        }
    }

    fn take(&mut self, wire: Wire<'_>) -> Result<(), Malformed> {
        match wire {
            Wire::Fixed64(bytes) => self.push(f64::from_le_bytes(bytes)),
            Wire::Bytes(bytes) => {
                let (chunks, rest) = bytes.as_chunks::<8>();
                if !rest.is_empty() {
                    return Err(Malformed);
                }
                self.extend(chunks.iter().map(|chunk| f64::from_le_bytes(*chunk)));
            }
            _ => return Err(Malformed),
        }
        Ok(())
    }
}

impl Field for Vec<u32> {
    const KIND: Kind = Kind::Repeated(FIXED32);

    fn put(&self, number: u64, out: &mut Vec<u8>) {
        if !self.is_empty() {
            put_inside(number, out, |out| out.extend(self.iter().flat_map(|value| value.to_le_bytes())));
        }
    }

    fn take(&mut self, wire: Wire<'_>) -> Result<(), Malformed> {
        match wire {
            Wire::Fixed32(bytes) => self.push(u32::from_le_bytes(bytes)),
            Wire::Bytes(bytes) => {
                let (chunks, rest) = bytes.as_chunks::<4>();
                if !rest.is_empty() {
                    return Err(Malformed);
                }
                self.extend(chunks.iter().map(|chunk| u32::from_le_bytes(*chunk)));
            }
            _ => return Err(Malformed),
        }
        Ok(())
    }
}

impl Field for Vec<u64> {
    const KIND: Kind = Kind::Repeated(UINT64);

    fn put(&self, number: u64, out: &mut Vec<u8>) {
        if !self.is_empty() {
            put_inside(number, out, |out| self.iter().for_each(|value| put_varint(*value, out)));
        }
    }

    fn take(&mut self, wire: Wire<'_>) -> Result<(), Malformed> {
        match wire {
            Wire::Varint(value) => self.push(value),
            Wire::Bytes(mut bytes) => {
                while !bytes.is_empty() {
                    self.push(varint(&mut bytes)?);
                }
            }
            _ => return Err(Malformed),
        }
        Ok(())
    }
}

impl<M: Message> Field for Option<M> {
    // A message always says whether it is there.
    const KIND: Kind = Kind::One(MESSAGE);

    fn put(&self, number: u64, out: &mut Vec<u8>) {
        if let Some(message) = self {
            put_inside(number, out, |out| message.encode(out));
        }
    }

    fn take(&mut self, wire: Wire<'_>) -> Result<(), Malformed> {
        let Wire::Bytes(bytes) = wire else { return Err(Malformed) };
        self.get_or_insert_default().merge(bytes)
    }

    fn describe(types: &mut Types) -> Option<&'static str> {
        types.message::<M>();
        Some(M::NAME)
    }
}

impl<M: Message> Field for Vec<M> {
    const KIND: Kind = Kind::Repeated(MESSAGE);

    fn put(&self, number: u64, out: &mut Vec<u8>) {
        for message in self {
            put_inside(number, out, |out| message.encode(out));
        }
    }

    fn take(&mut self, wire: Wire<'_>) -> Result<(), Malformed> {
        let Wire::Bytes(bytes) = wire else { return Err(Malformed) };
        self.push(M::decode(bytes)?);
        Ok(())
    }

    fn describe(types: &mut Types) -> Option<&'static str> {
        types.message::<M>();
        Some(M::NAME)
    }
}

/// The number of one of an enumeration's names.
pub trait Enumeration {
    /// Its full name, package first.
    const NAME: &'static str;

    /// Its values' names, from 0 on.
    const VALUES: &'static [&'static str];
}

/// A field that holds one of an enumeration.
#[derive(Debug, PartialEq, Eq)]
pub struct Enum<E> {
    /// Its number.
    pub number: u64,
    of: std::marker::PhantomData<E>,
}

impl<E> Enum<E> {
    /// The field with this number.
    #[must_use]
    pub fn new(number: u64) -> Self {
        Self { number, of: std::marker::PhantomData }
    }
}

impl<E> Default for Enum<E> {
    fn default() -> Self {
        Self::new(0)
    }
}

impl<E> Clone for Enum<E> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<E> Copy for Enum<E> {}

impl<E: Enumeration> Field for Enum<E> {
    const KIND: Kind = Kind::One(ENUM);

    fn put(&self, number: u64, out: &mut Vec<u8>) {
        self.number.put(number, out);
    }

    fn take(&mut self, wire: Wire<'_>) -> Result<(), Malformed> {
        self.number.take(wire)
    }

    fn describe(types: &mut Types) -> Option<&'static str> {
        types.enumeration::<E>();
        Some(E::NAME)
    }
}

/// The types of a schema, each once: bytes of a `FileDescriptorSet` in the making.
#[derive(Debug, Default)]
pub struct Types {
    /// Full names of what has been described.
    known: Vec<&'static str>,
    /// Package, and bytes of a `FileDescriptorProto` but for its head.
    files: Vec<(&'static str, Vec<u8>)>,
}

impl Types {
    /// The schema of a message, as an MCAP file holds it.
    #[must_use]
    pub fn schema_of<M: Message>() -> Vec<u8> {
        let mut types = Self::default();
        types.message::<M>();
        let mut out = Vec::new();
        let packages: Vec<&str> = types.files.iter().map(|(package, _)| *package).collect();
        for (index, (package, described)) in types.files.iter().enumerate() {
            put_inside(1, &mut out, |out| {
                file_name(package).put(1, out);
                (*package).to_owned().put(2, out);
                // What a package needs is described before it.
                packages[..index].iter().for_each(|needed| file_name(needed).put(3, out));
                out.extend(described);
                "proto3".to_owned().put(12, out);
            });
        }
        out
    }

    fn message<M: Message>(&mut self) {
        if !self.known.contains(&M::NAME) {
            self.known.push(M::NAME);
            M::describe(self);
        }
    }

    fn enumeration<E: Enumeration>(&mut self) {
        if self.known.contains(&E::NAME) {
            return;
        }
        self.known.push(E::NAME);
        let (package, name) = split(E::NAME);
        put_inside(5, self.file(package), |out| {
            name.to_owned().put(1, out);
            for (number, value) in E::VALUES.iter().enumerate() {
                put_inside(2, out, |out| {
                    (*value).to_owned().put(1, out);
                    Some(number as u64).put(2, out);
                });
            }
        });
    }

    /// Describes a message of these fields.
    pub fn put_message(&mut self, name: &'static str, fields: &[FieldType]) {
        let (package, name) = split(name);
        put_inside(4, self.file(package), |out| {
            name.to_owned().put(1, out);
            let mut optional = Vec::new();
            for FieldType { name, number, kind, type_name } in fields {
                // A raw identifier's name is what stands after the r#.
                let name = name.trim_start_matches("r#");
                let (label, type_number) = match kind {
                    Kind::One(type_number) | Kind::Optional(type_number) => (1_u64, type_number),
                    Kind::Repeated(type_number) => (3, type_number),
                };
                put_inside(2, out, |out| {
                    name.to_owned().put(1, out);
                    number.put(3, out);
                    label.put(4, out);
                    type_number.put(5, out);
                    type_name.map(|name| format!(".{name}")).unwrap_or_default().put(6, out);
                    if matches!(kind, Kind::Optional(_)) {
                        Some(optional.len() as u64).put(9, out);
                        true.put(17, out);
                        optional.push(name);
                    }
                });
            }
            // As the compiler of protocol buffers has it, what is optional is one of a group of one.
            for name in optional {
                put_inside(8, out, |out| format!("_{name}").put(1, out));
            }
        });
    }

    fn file(&mut self, package: &'static str) -> &mut Vec<u8> {
        let index = self.files.iter().position(|(known, _)| *known == package).unwrap_or_else(|| {
            self.files.push((package, Vec::new()));
            self.files.len() - 1
        });
        &mut self.files[index].1
    }
}

fn split(name: &'static str) -> (&'static str, &'static str) {
    name.rsplit_once('.').unwrap_or(("", name))
}

fn file_name(package: &str) -> String {
    format!("{}.proto", package.replace('.', "/"))
}

/// Makes messages of tables of their fields: `number name: type`.
macro_rules! messages {
    ($($(#[$doc:meta])* $name:ident = $full:literal { $($(#[$field_doc:meta])* $number:literal $field:ident: $type:ty,)* })*) => {$(
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq, Default)]
        pub struct $name {
            $($(#[$field_doc])* pub $field: $type,)*
        }

        impl $crate::run_mcap::protobuf::Message for $name {
            const NAME: &'static str = $full;

            fn encode(&self, out: &mut Vec<u8>) {
                $($crate::run_mcap::protobuf::Field::put(&self.$field, $number, out);)*
            }

            fn take(
                &mut self,
                number: u64,
                wire: $crate::run_mcap::protobuf::Wire<'_>,
            ) -> Result<(), $crate::run_mcap::protobuf::Malformed> {
                match number {
                    $($number => $crate::run_mcap::protobuf::Field::take(&mut self.$field, wire),)*
                    _ => Ok(()),
                }
            }

            fn describe(types: &mut $crate::run_mcap::protobuf::Types) {
                let fields = [$($crate::run_mcap::protobuf::FieldType {
                    name: stringify!($field),
                    number: $number,
                    kind: <$type as $crate::run_mcap::protobuf::Field>::KIND,
                    type_name: <$type as $crate::run_mcap::protobuf::Field>::describe(types),
                },)*];
                types.put_message(Self::NAME, &fields);
            }
        }
    )*};
}
pub(crate) use messages;

#[cfg(test)]
#[allow(unreachable_pub, reason = "the table makes public messages")]
mod tests {
    use super::*;

    messages! {
        Inner = "test.Inner" {
            1 x: f64,
        }
        Outer = "test.Outer" {
            1 number: u64,
            2 maybe: Option<f64>,
            3 inner: Option<Inner>,
            4 all: Vec<Inner>,
            5 numbers: Vec<u64>,
            20 text: String,
        }
    }

    #[test]
    fn a_message_comes_back_from_its_bytes_to_the_bit() {
        let outer = Outer {
            number: u64::MAX,
            maybe: Some(0.0),
            inner: Some(Inner { x: -0.0 }),
            all: vec![Inner { x: 1.5 }, Inner::default()],
            numbers: vec![0, 1, 300],
            text: "a".repeat(200),
        };
        let mut bytes = Vec::new();
        outer.encode(&mut bytes);
        let decoded = Outer::decode(&bytes).unwrap();
        assert_eq!(decoded, outer);
        assert!(decoded.inner.unwrap().x.is_sign_negative());
        let cut = (0..bytes.len()).filter(|len| Outer::decode(&bytes[..*len]).is_ok()).count();
        assert_eq!(cut, 7, "only between fields is there a shorter message");
        assert_eq!(Outer::decode(&[0x08, 0x96, 0x01]).unwrap().number, 150, "the specification's example");
    }
}

//! The records of an MCAP file, field by field.

use std::io::Read;

/// Marks the recordings of this program: the MCAP profile, and the name of the metadata record.
pub const PROFILE: &str = "rangehound";

/// Reads once, whatever signals come.
///
/// # Errors
/// The system's.
pub fn read(input: &mut impl Read, buffer: &mut [u8]) -> std::io::Result<usize> {
    loop {
        match input.read(buffer) {
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            done => return done,
        }
    }
}

/// A schema: the definition of a type in a language.
#[derive(Debug, Clone, Copy)]
pub struct Schema<'a> {
    /// Its number.
    pub id: u16,
    /// The name of the type.
    pub name: &'a [u8],
    /// The language.
    pub language: &'a [u8],
    /// The definition.
    pub text: &'a [u8],
}

/// Reads the fields of a record in order. The library's own parser allocates as much memory as a damaged length claims.
pub struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    /// The fields of a record.
    #[must_use]
    pub fn of(record: &'a [u8]) -> Self {
        Self(record)
    }

    fn take(&mut self, len: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(len)?;
        self.0 = rest;
        Some(taken)
    }

    /// A number.
    pub fn u16(&mut self) -> Option<u16> {
        self.take(2)?.try_into().ok().map(u16::from_le_bytes)
    }

    /// A text or bytes with their length before them.
    pub fn string(&mut self) -> Option<&'a [u8]> {
        let len = u32::from_le_bytes(self.take(4)?.try_into().ok()?);
        self.take(len as usize)
    }

    /// Name and data.
    pub fn attachment(mut self) -> Option<(&'a [u8], &'a [u8])> {
        self.take(16)?;
        let name = self.string()?;
        self.string()?;
        let len = u64::from_le_bytes(self.take(8)?.try_into().ok()?);
        Some((name, self.take(usize::try_from(len).ok()?)?))
    }

    /// Id, schema, topic and encoding.
    pub fn channel(mut self) -> Option<(u16, u16, &'a [u8], &'a [u8])> {
        Some((self.u16()?, self.u16()?, self.string()?, self.string()?))
    }

    /// A schema.
    pub fn schema(mut self) -> Option<Schema<'a>> {
        Some(Schema { id: self.u16()?, name: self.string()?, language: self.string()?, text: self.string()? })
    }

    /// Channel id, time of recording (ns) and data.
    pub fn message(mut self) -> Option<(u16, u64, &'a [u8])> {
        let channel = self.u16()?;
        self.take(4)?;
        let log_ns = u64::from_le_bytes(self.take(8)?.try_into().ok()?);
        self.take(8)?;
        Some((channel, log_ns, self.0))
    }
}

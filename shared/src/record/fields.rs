//! Fixed-width records: one list of a record's fields describes, writes and reads it.

/// The data recorded of a tick, in a fixed number of words.
pub trait Record {
    /// Visits its fields in order. Vectors keep their length.
    fn fields(&mut self, fields: &mut impl Fields);
}

/// An operation on each field of a [`Record`].
pub trait Fields: Sized {
    /// An integer: a count, an id, a stamp.
    fn whole(&mut self, name: &str, value: &mut u64);

    /// A floating-point number.
    fn number(&mut self, name: &str, value: &mut f64);

    /// Consecutive integers.
    fn wholes(&mut self, name: &str, values: &mut [u64]) {
        values.iter_mut().for_each(|value| self.whole(name, value));
    }

    /// Consecutive floating-point numbers.
    fn numbers(&mut self, name: &str, values: &mut [f64]) {
        values.iter_mut().for_each(|value| self.number(name, value));
    }

    /// The same fields for each of several items.
    fn each<T>(&mut self, _name: &str, items: &mut [T], mut fields_of: impl FnMut(&mut T, &mut Self)) {
        items.iter_mut().for_each(|item| fields_of(item, self));
    }
}

/// Appends a record's words, little-endian.
pub fn put(record: &mut impl Record, bytes: &mut Vec<u8>) {
    record.fields(&mut Put(bytes));
}

/// Reads a record from the words that [`put`] wrote of one with the same description; missing words are zero.
pub fn take(record: &mut impl Record, bytes: &[u8]) {
    record.fields(&mut Take(bytes.as_chunks().0.iter()));
}

/// Names and types of a record's fields, as JSON in the form of a NumPy `dtype`: `["time_s","<f8"],["state","<f8",[4]]`.
pub fn describe(record: &mut impl Record) -> String {
    let mut description = Describe(String::new());
    record.fields(&mut description);
    description.0
}

struct Put<'a>(&'a mut Vec<u8>);

impl Fields for Put<'_> {
    fn whole(&mut self, _name: &str, value: &mut u64) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    fn number(&mut self, _name: &str, value: &mut f64) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }
}

struct Take<'a>(std::slice::Iter<'a, [u8; 8]>);

impl Take<'_> {
    fn word(&mut self) -> [u8; 8] {
        self.0.next().copied().unwrap_or_default()
    }
}

impl Fields for Take<'_> {
    fn whole(&mut self, _name: &str, value: &mut u64) {
        *value = u64::from_le_bytes(self.word());
    }

    fn number(&mut self, _name: &str, value: &mut f64) {
        *value = f64::from_le_bytes(self.word());
    }
}

struct Describe(String);

impl Describe {
    fn add(&mut self, field: &str) {
        if !self.0.is_empty() {
            self.0.push(',');
        }
        self.0.push_str(field);
    }
}

impl Fields for Describe {
    fn whole(&mut self, name: &str, _value: &mut u64) {
        self.add(&format!(r#"["{name}","<u8"]"#));
    }

    fn number(&mut self, name: &str, _value: &mut f64) {
        self.add(&format!(r#"["{name}","<f8"]"#));
    }

    fn wholes(&mut self, name: &str, values: &mut [u64]) {
        self.add(&format!(r#"["{name}","<u8",[{}]]"#, values.len()));
    }

    fn numbers(&mut self, name: &str, values: &mut [f64]) {
        self.add(&format!(r#"["{name}","<f8",[{}]]"#, values.len()));
    }

    fn each<T>(&mut self, name: &str, items: &mut [T], mut fields_of: impl FnMut(&mut T, &mut Self)) {
        let count = items.len();
        let Some(first) = items.first_mut() else { return };
        let mut inner = Self(String::new());
        fields_of(first, &mut inner);
        self.add(&format!(r#"["{name}",[{}],[{count}]]"#, inner.0));
    }
}

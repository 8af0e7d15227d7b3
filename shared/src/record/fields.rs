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
    fn integers(&mut self, name: &str, values: &mut [u64]) {
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

/// Number of a record's words.
#[must_use]
pub fn count(record: &mut impl Record) -> usize {
    let mut count = Count(0);
    record.fields(&mut count);
    count.0
}

/// Writes a record's words, little-endian; those for which there is no room are left out.
pub fn put(record: &mut impl Record, bytes: &mut [u8]) {
    record.fields(&mut Put(bytes.as_chunks_mut().0.iter_mut()));
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

struct Count(usize);

impl Fields for Count {
    fn whole(&mut self, _name: &str, _value: &mut u64) {
        self.0 += 1;
    }

    fn number(&mut self, _name: &str, _value: &mut f64) {
        self.0 += 1;
    }
}

// A node writes some hundred words in each tick: a call for each would cost more than the words.
struct Put<'a>(std::slice::IterMut<'a, [u8; 8]>);

impl Put<'_> {
    #[inline]
    fn word(&mut self, word: [u8; 8]) {
        if let Some(place) = self.0.next() {
            *place = word;
        }
    }
}

impl Fields for Put<'_> {
    #[inline]
    fn whole(&mut self, _name: &str, value: &mut u64) {
        self.word(value.to_le_bytes());
    }

    #[inline]
    fn number(&mut self, _name: &str, value: &mut f64) {
        self.word(value.to_le_bytes());
    }
}

struct Take<'a>(std::slice::Iter<'a, [u8; 8]>);

impl Take<'_> {
    #[inline]
    fn word(&mut self) -> [u8; 8] {
        self.0.next().copied().unwrap_or_default()
    }
}

impl Fields for Take<'_> {
    #[inline]
    fn whole(&mut self, _name: &str, value: &mut u64) {
        *value = u64::from_le_bytes(self.word());
    }

    #[inline]
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

    fn integers(&mut self, name: &str, values: &mut [u64]) {
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

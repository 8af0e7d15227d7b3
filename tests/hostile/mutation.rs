//! Damage to sound documents: what a broken disk, a broken program or an enemy would hand in.

use rangehound_shared::draws::{Draws, Stream};

/// In place of a number or a word.
const TOKENS: [&str; 36] = [
    "nan",
    "NaN",
    "-nan",
    "inf",
    "-inf",
    "Infinity",
    "1e308",
    "-1e308",
    "1e309",
    "1e-320",
    "-0",
    "-0.0",
    "0",
    "1",
    "-1",
    "0.5",
    "256",
    "257",
    "1000000000000",
    "9007199254740993",
    "18446744073709551615",
    "18446744073709551616",
    "-9223372036854775808",
    "99999999999999999999999999999999",
    "0x10",
    "1_000",
    "+7",
    "true",
    "null",
    "\"\"",
    "[]",
    "{}",
    "[[]]",
    "\"forever\"",
    "[nan]",
    "1979-05-27T07:32:00Z",
];

/// Anywhere.
const BYTES: [&[u8]; 22] = [
    b"\xff",
    b"\xc3\x28",
    b"\xed\xa0\x80",
    b"\xef\xbb\xbf",
    b"\0",
    b"\n",
    b"\r",
    b"\r\n",
    b"\"",
    b"'",
    b"\"\"\"",
    b",",
    b"=",
    b"[",
    b"]",
    b"{",
    b"}",
    b"#",
    b"\\u0000",
    "\u{2028}\u{202e}".as_bytes(),
    b"\x1b[2J",
    b" ",
];

/// Random numbers of one attack, from its seed alone.
pub(crate) struct Dice {
    draws: Draws,
    tick: u64,
}

impl Dice {
    pub(crate) fn new(seed: u64) -> Self {
        Self { draws: Draws::new(seed, Stream::Faults), tick: 0 }
    }

    /// Uniform on [0, 1).
    fn uniform(&mut self) -> f64 {
        let mut out = [0.0];
        self.draws.uniform(self.tick, &mut out);
        self.tick += 1;
        out[0]
    }

    /// A number below `count`; 0 if there is none.
    pub(crate) fn below(&mut self, count: usize) -> usize {
        ((self.uniform() * count as f64) as usize).min(count.saturating_sub(1))
    }

    pub(crate) fn chance(&mut self, probability: f64) -> bool {
        self.uniform() < probability
    }

    pub(crate) fn one_of<'a, T: ?Sized>(&mut self, list: &[&'a T]) -> &'a T {
        list[self.below(list.len())]
    }

    /// A number as hostile as one can be, or a sound one.
    pub(crate) fn number(&mut self) -> f64 {
        const NUMBERS: [f64; 16] = [
            f64::NAN,
            f64::INFINITY,
            f64::NEG_INFINITY,
            f64::MAX,
            f64::MIN,
            f64::MIN_POSITIVE,
            5e-324,
            -0.0,
            0.0,
            1.0,
            -1.0,
            1e18,
            -1e18,
            1e100,
            1e-100,
            3.5,
        ];
        if self.chance(0.2) { f64::from_bits(self.word()) } else { NUMBERS[self.below(NUMBERS.len())] }
    }

    /// Any 64 bits, the extremes often.
    pub(crate) fn word(&mut self) -> u64 {
        const WORDS: [u64; 8] = [0, 1, 2, 255, 1 << 32, i64::MAX as u64, u64::MAX - 1, u64::MAX];
        if self.chance(0.5) {
            WORDS[self.below(WORDS.len())]
        } else {
            (self.below(1 << 32) as u64) << 32 | self.below(1 << 32) as u64
        }
    }

    /// One of these documents, damaged in 1 to 4 ways.
    pub(crate) fn damaged(&mut self, documents: &[Vec<u8>]) -> Vec<u8> {
        let mut bytes = documents[self.below(documents.len())].clone();
        for _ in 0..=self.below(4) {
            self.damage(&mut bytes, documents);
        }
        bytes
    }

    fn damage(&mut self, bytes: &mut Vec<u8>, documents: &[Vec<u8>]) {
        let at = self.below(bytes.len() + 1);
        let end = (at + 1 + self.below(40)).min(bytes.len());
        match self.below(16) {
            0 => bytes.truncate(at),
            1 => drop(bytes.drain(at..end)),
            2..=3 => {
                if let Some(byte) = bytes.get_mut(at) {
                    *byte ^= 1 << self.below(8);
                }
            }
            4 => insert(bytes, at, self.one_of(&BYTES)),
            5..=8 => self.replace_token(bytes),
            9 => {
                let again = bytes[at..end].to_vec();
                insert(bytes, at, &again);
            }
            10..=11 => self.move_line(bytes, documents),
            12 => {
                let other = &documents[self.below(documents.len())];
                let from = self.below(other.len() + 1);
                bytes.truncate(at);
                bytes.extend(&other[from..]);
            }
            13 => {
                let word = self.word().to_le_bytes();
                bytes.truncate(bytes.len().max(at));
                for (byte, new) in bytes[at..].iter_mut().zip(word) {
                    *byte = new;
                }
            }
            14 if self.chance(0.2) => {
                let piece = self.one_of(&BYTES).repeat(1 + self.below(3_000));
                insert(bytes, at, &piece);
            }
            14 => {
                let depth = 1 + self.below(300);
                let open = self.one_of(&["[", "{\"a\":", "a.", "{a=", "[["]);
                insert(bytes, at, open.repeat(depth).as_bytes());
            }
            _ => {
                let noise: Vec<u8> = (0..self.below(30)).map(|_| self.below(256) as u8).collect();
                insert(bytes, at, &noise);
            }
        }
    }

    /// Puts something else in the place of a number or a word.
    fn replace_token(&mut self, bytes: &mut Vec<u8>) {
        let is_part = |byte: &u8| byte.is_ascii_alphanumeric() || b"+-._".contains(byte);
        let mut start = self.below(bytes.len());
        while start < bytes.len() && !is_part(&bytes[start]) {
            start += 1;
        }
        while start > 0 && is_part(&bytes[start - 1]) {
            start -= 1;
        }
        let end = start + bytes[start..].iter().take_while(|byte| is_part(byte)).count();
        let token = self.one_of(&TOKENS.map(str::as_bytes));
        bytes.splice(start..end, token.iter().copied());
    }

    /// Doubles, drops or swaps lines, or takes one of another document.
    fn move_line(&mut self, bytes: &mut Vec<u8>, documents: &[Vec<u8>]) {
        let mut lines: Vec<Vec<u8>> = bytes.split(|byte| *byte == b'\n').map(<[u8]>::to_vec).collect();
        let (i, j) = (self.below(lines.len()), self.below(lines.len()));
        match self.below(4) {
            0 => lines.insert(j, lines[i].clone()),
            1 => drop(lines.remove(i)),
            2 => lines.swap(i, j),
            _ => {
                let other: Vec<&[u8]> = documents[self.below(documents.len())].split(|byte| *byte == b'\n').collect();
                let line = self.one_of(&other).to_vec();
                lines.insert(i, line);
            }
        }
        *bytes = lines.join(&b'\n');
    }
}

fn insert(bytes: &mut Vec<u8>, at: usize, piece: &[u8]) {
    bytes.splice(at..at, piece.iter().copied());
}

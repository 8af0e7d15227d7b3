//! The token of a page: it permits viewing and acting.

/// 128 random bits, as text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::live) struct Token(String);

impl Token {
    /// A new token, from the system's random source.
    pub(in crate::live) fn new() -> std::io::Result<Self> {
        let mut bytes = [0; 16];
        // Up to 256 bytes are returned completely or not at all.
        let filled = rustix::rand::getrandom(&mut bytes[..], rustix::rand::GetRandomFlags::empty())?;
        if filled != bytes.len() {
            return Err(std::io::Error::other("the system has given too few random bytes"));
        }
        Ok(Self(bytes.iter().map(|byte| format!("{byte:02x}")).collect()))
    }

    /// A token that another process of this run made.
    pub(in crate::live) fn from_text(text: &str) -> Option<Self> {
        (text.len() == 32 && text.bytes().all(|byte| byte.is_ascii_hexdigit())).then(|| Self(text.to_owned()))
    }

    /// Compares in constant time.
    pub(in crate::live) fn is(&self, text: &str) -> bool {
        let pairs = self.0.bytes().zip(text.bytes());
        text.len() == self.0.len() && pairs.fold(0, |different, (ours, given)| different | (ours ^ given)) == 0
    }
}

impl std::fmt::Display for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_is_new_each_time_and_must_match_completely() {
        let (token, other) = (Token::new().unwrap(), Token::new().unwrap());
        let text = token.to_string();
        assert!(text.len() == 32 && token != other && token.is(&text) && !other.is(&text));
        assert!(!token.is("") && !token.is(&text[1..]) && !token.is(&format!("{text}0")));
        assert_eq!(Token::from_text(&text), Some(token));
        assert_eq!((Token::from_text("short"), Token::from_text(&"x".repeat(32))), (None, None));
    }
}

//! The user's selection of a bag's contents: topics, fields, definitions.

use super::Fault;

/// The name of a topic, or of several: `*` stands for any part of a name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pattern(String);

impl Pattern {
    /// The part of a topic's name for which `*` stands; empty if the pattern has none. `None` for other topics.
    #[must_use]
    pub fn part<'a>(&self, topic: &'a str) -> Option<&'a str> {
        match self.0.split_once('*') {
            None => (self.0 == topic).then_some(""),
            Some((before, after)) => {
                let part = topic.strip_prefix(before)?.strip_suffix(after)?;
                (!part.is_empty()).then_some(part)
            }
        }
    }

    /// True if it can stand for several topics.
    #[must_use]
    pub fn has_star(&self) -> bool {
        self.0.contains('*')
    }

    /// Its text.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.0
    }

    fn parse(text: &str) -> Result<Self, Fault> {
        let text = text.trim();
        if text.is_empty() || text.matches('*').count() > 1 {
            let hint = "expected the name of a topic, as in /uwb/range, with at most one *";
            return Err(Fault::new(format!("the topic {text:?}"), hint));
        }
        Ok(Self(text.to_owned()))
    }
}

/// Topics, and a field of their messages: `/odom:pose.pose`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TopicField {
    /// The topics.
    pub topic: Pattern,
    /// The field; `None` for the one that fits.
    pub field: Option<String>,
}

impl TopicField {
    /// Parses `TOPIC[:FIELD]`.
    ///
    /// # Errors
    /// [`Fault`] if there is no topic.
    pub fn parse(text: &str) -> Result<Self, Fault> {
        let (topic, field) = match text.split_once(':') {
            Some((topic, field)) => (topic, Some(field.trim().to_owned())),
            None => (text, None),
        };
        Ok(Self { topic: Pattern::parse(topic)?, field })
    }
}

/// The topics of a list with commas.
///
/// # Errors
/// [`Fault`] for one that is no name.
pub fn patterns(text: &str) -> Result<Vec<Pattern>, Fault> {
    text.split(',').map(Pattern::parse).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_star_stands_for_a_part_of_a_name() {
        let all = patterns("/robot_*/range, /uwb").unwrap();
        assert_eq!(all[0].part("/robot_12/range"), Some("12"));
        assert_eq!(all[0].part("/robot_/range"), None);
        assert_eq!(all[0].part("/robot_1/pose"), None);
        assert_eq!((all[1].part("/uwb"), all[1].part("/uwb2")), (Some(""), None));
        assert_eq!(Pattern::parse("/aa*a").unwrap().part("/aa"), None);
        for text in ["", "/a*b*", "/a,,/b"] {
            assert!(patterns(text).is_err(), "{text}");
        }
        let field = TopicField::parse("/odom:pose.pose").unwrap();
        assert_eq!((field.topic.text(), field.field.as_deref()), ("/odom", Some("pose.pose")));
    }
}

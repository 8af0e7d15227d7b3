//! Joining and leaving: messages of JSON with their length before them, on the one stream of a connection.

use quinn::{ReadExactError, RecvStream, SendStream};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// Longest message, bytes: the description of the largest run is shorter.
const MESSAGE_LEN_MAX: u32 = 4 << 20;

/// Longest message of a peer that has not joined, bytes.
pub(crate) const REQUEST_LEN_MAX: u32 = 4 << 10;

/// A robot asks for its role.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Request {
    /// The protocol of its build.
    pub protocol: u32,
    /// The version of its build, for display.
    pub program: String,
    /// Its number in the team.
    pub robot: usize,
    /// A random number of its process: it tells a robot that comes back from another that claims its role.
    pub process: u64,
    /// The run that it wants; any if it names none.
    pub run: Option<String>,
    /// True if it obeys [`Notice::Kill`] and [`Notice::End`].
    #[serde(default)]
    pub allows_control: bool,
    /// The id of the last run in which it took part, if any.
    #[serde(default)]
    pub took_part_in: Option<u64>,
}

/// The gateway's answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Answer {
    /// It has the role.
    Welcome {
        /// The sealed description of the run.
        description: String,
        /// Which life of the run it is: a resumed run has another one.
        life: u64,
        /// How often the lead has been taken.
        fusion_incarnation: u64,
    },
    /// It does not get the role.
    Refused {
        /// Why.
        text: String,
        /// True if it may get it later.
        may_change: bool,
    },
    /// The run in which it took part is over.
    Finished,
}

/// A message of either end after that.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Notice {
    /// The gateway: the run is over.
    Finished,
    /// The robot: it leaves in order.
    Leaving,
    /// The gateway: the robot's process is to end at once, as in a crash. The robot says the same when it does so.
    Kill,
    /// The gateway: the robot's process is to end in order.
    End,
}

/// Why a message did not come or could not be sent.
#[derive(Debug, thiserror::Error)]
pub enum JoinError {
    /// The connection has ended.
    #[error("the connection has ended")]
    Ended,
    /// The peer ended the stream within it, or before.
    #[error("a message that is cut")]
    Cut,
    /// The peer sent something else.
    #[error("not a message of rangehound")]
    Malformed,
    /// The peer sent too much.
    #[error("a message of {0} bytes: at most {1} are allowed")]
    TooLong(u32, u32),
}

/// Sends a message.
///
/// # Errors
/// [`JoinError`].
pub async fn write(stream: &mut SendStream, message: &impl Serialize) -> Result<(), JoinError> {
    let text = serde_json::to_vec(message).map_err(|_| JoinError::Malformed)?;
    let len = u32::try_from(text.len()).map_err(|_| JoinError::Malformed)?;
    stream.write_all(&len.to_le_bytes()).await.map_err(|_| JoinError::Ended)?;
    stream.write_all(&text).await.map_err(|_| JoinError::Ended)
}

/// Receives a message of at most this length.
///
/// # Errors
/// [`JoinError`].
pub async fn read<T: DeserializeOwned>(stream: &mut RecvStream, len_max: Option<u32>) -> Result<T, JoinError> {
    let len_max = len_max.unwrap_or(MESSAGE_LEN_MAX);
    let failed = |error: ReadExactError| match error {
        ReadExactError::FinishedEarly(_) => JoinError::Cut,
        ReadExactError::ReadError(_) => JoinError::Ended,
    };
    let mut len = [0; 4];
    stream.read_exact(&mut len).await.map_err(failed)?;
    let len = u32::from_le_bytes(len);
    if len > len_max {
        return Err(JoinError::TooLong(len, len_max));
    }
    let mut text = vec![0; len as usize];
    stream.read_exact(&mut text).await.map_err(failed)?;
    serde_json::from_slice(&text).map_err(|_| JoinError::Malformed)
}

#[cfg(test)]
mod tests {
    use rangehound_shared::protocol::PROTOCOL;

    use super::*;

    /// A host with another version must get its answer: a change needs a new number, and new lines here.
    #[test]
    fn joining_changes_only_with_the_protocol() {
        let request = Request {
            protocol: 0,
            program: "0".to_owned(),
            robot: 0,
            process: 0,
            run: None,
            allows_control: false,
            took_part_in: None,
        };
        let welcome = Answer::Welcome { description: "d".to_owned(), life: 0, fusion_incarnation: 0 };
        let refused = Answer::Refused { text: "t".to_owned(), may_change: false };
        let answers = [welcome, refused, Answer::Finished];
        let notices = [Notice::Finished, Notice::Leaving, Notice::Kill, Notice::End];
        let text = serde_json::to_string(&(request, answers, notices)).unwrap();
        let expected = concat!(
            r#"[{"protocol":0,"program":"0","robot":0,"process":0,"run":null,"allows_control":false,"took_part_in":null},"#,
            r#"[{"Welcome":{"description":"d","life":0,"fusion_incarnation":0}},"#,
            r#"{"Refused":{"text":"t","may_change":false}},"Finished"],["Finished","Leaving","Kill","End"]]"#,
        );
        assert_eq!((PROTOCOL, text.as_str()), (9, expected));
    }
}

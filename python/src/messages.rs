//! The messages of a live run, encoded as in `run.mcap`, for viewers.

use pyo3::prelude::*;
use pyo3::types::PyBytes;
use rangehound::results::frame::{Frame, LoggedTick};
use rangehound::results::run_mcap::encode::{self, Encoder};
use rangehound_shared::scenario::Scenario;

use crate::errors::failed;
use crate::live::Observer;

/// Ticks that are passed over before Python can act on signals.
const TICKS_AT_ONCE: u64 = 256;

/// A channel: topic, encoding of its messages, and name, encoding and data of their schema.
type Channel<'py> = (&'static str, String, String, String, Bound<'py, PyBytes>);

/// The messages of a tick: the time of the run, ns, and for each message its channel and its bytes.
type Messages<'py> = (u64, Vec<(usize, Bound<'py, PyBytes>)>);

/// The channels of `run.mcap`. A message names its channel by its place here.
#[pyfunction]
pub(crate) fn channels(py: Python<'_>) -> Vec<Channel<'_>> {
    let channel = |channel: encode::Channel| {
        let schema = channel.schema?;
        Some((channel.topic, channel.message_encoding, schema.name, schema.encoding, PyBytes::new(py, &schema.data)))
    };
    encode::channels().into_iter().filter_map(channel).collect()
}

/// Iterates over the messages of a live run, tick by tick from its first one.
#[pyclass(module = "rangehound._native")]
pub(crate) struct MessageStream {
    observer: Observer,
    encoder: Encoder,
}

/// The frame of a tick; `None` if a node has not logged it.
fn frame(_: &Scenario, logged: LoggedTick<'_>) -> Option<Frame> {
    Some(Frame { tick: logged.tick, fusion: logged.fusion?.clone(), world: logged.world?.clone() })
}

#[pymethods]
impl MessageStream {
    /// Waits for the run up to `timeout_s`.
    #[new]
    fn new(py: Python<'_>, name: &str, timeout_s: f64) -> PyResult<Self> {
        // A tick is complete once the simulator has recorded it, which it does with the truth.
        let observer = Observer::new(py, name, true, true, timeout_s)?;
        let encoder = Encoder::new(observer.scenario());
        Ok(Self { observer, encoder })
    }

    /// True once the run has ended.
    fn is_over(&mut self) -> bool {
        self.observer.is_over()
    }

    /// Passes over the ticks that are logged already.
    fn skip(&mut self, py: Python<'_>) -> PyResult<()> {
        let (mut skipped, mut newest) = (0_u64, None);
        while let Some(frame) = self.observer.look(false, frame).map_err(failed)? {
            // A run in lock step may log as fast as they are read.
            let newest = *newest.get_or_insert(self.observer.newest_tick());
            if let Some(frame) = frame {
                // The encoder knows the run from its first tick on, as that of the file does: so the bytes are the same.
                self.encoder
                    .encode(&frame, |_| Ok::<_, std::io::Error>(()))
                    .map_err(|error| failed(anyhow::Error::from(error)))?;
                if newest.is_none_or(|newest| frame.tick >= newest) {
                    break;
                }
            }
            skipped += 1;
            if skipped.is_multiple_of(TICKS_AT_ONCE) {
                py.check_signals()?;
            }
        }
        Ok(())
    }

    fn __iter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    /// The messages of the next complete tick; none at the end of the run.
    fn __next__<'py>(&mut self, py: Python<'py>) -> PyResult<Option<Messages<'py>>> {
        loop {
            let Some(frame) = self.observer.wait(py, frame)? else { return Ok(None) };
            // A tick that is not complete after a kill is not in the file either.
            let Some(frame) = frame else { continue };
            let (mut time_ns, mut messages) = (0, Vec::new());
            let put = |encoded: encode::Encoded<'_>| {
                time_ns = encoded.log_time_ns;
                messages.push((encoded.channel, PyBytes::new(py, encoded.bytes)));
                Ok::<_, std::io::Error>(())
            };
            self.encoder.encode(&frame, put).map_err(|error| failed(anyhow::Error::from(error)))?;
            return Ok(Some((time_ns, messages)));
        }
    }
}

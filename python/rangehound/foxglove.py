"""A live run in Foxglove: `python -m rangehound.foxglove --name RUN`.

The topics, schemas and messages are those of `run.mcap`. The package `foxglove-sdk` serves them.
"""

from __future__ import annotations

import argparse
import threading
import time
from typing import Any

from . import _command, _native

#: While no client has subscribed to a topic: interval at which it looks whether the run has ended, s.
LOOK_S = 0.5

#: Time in which the clients get the last messages, s. One that does not read is left after the same time once more.
LINGER_S = 0.5

#: The most messages that wait for one client. If it reads too slowly, it misses the oldest.
BACKLOG = 4096


def parser() -> _command.Parser:
    flags = _command.Parser(
        "foxglove",
        "Shows a live run in Foxglove, with the topics and schemas of run.mcap. It ends with the run.",
        "example:\n  rangehound run --name demo --ticks 3000 & python -m rangehound.foxglove --name demo\n"
        "Then open the printed address in Foxglove, and add a 3D panel with the topic /scene.",
    )
    flags.add_argument("--host", default="127.0.0.1", help="address to listen on (default: 127.0.0.1, this machine only; 0.0.0.0: all who can reach it, without a password)")
    flags.add_argument("--port", type=int, default=8765, help="port to listen on (default: 8765; 0: a free one)")
    return flags


def serve(flags: argparse.Namespace) -> None:
    """Serves a run until its end."""
    sdk = _command.needed("foxglove", "foxglove")
    stream = _native.MessageStream(flags.name, _command.WAIT_S)
    _command.give_way()
    subscribed = threading.Event()

    class Listener(sdk.websocket.ServerListener):  # type: ignore[name-defined, misc]
        def on_subscribe(self, client: Any, channel: Any) -> None:
            subscribed.set()

    channels = [
        sdk.Channel(topic, message_encoding=encoding, schema=sdk.Schema(name=name, encoding=schema_encoding, data=data))
        for topic, encoding, name, schema_encoding, data in _native.channels()
    ]
    try:
        server = sdk.start_server(
            name=f"rangehound {flags.name}",
            host=flags.host,
            port=flags.port,
            capabilities=[sdk.Capability.Time],
            server_listener=Listener(),
            message_backlog_size=BACKLOG,
        )
    except (OSError, OverflowError, RuntimeError, ValueError) as error:
        raise _native.InputError(f"cannot listen on {flags.host}:{flags.port}: {error}: expected a free port of this machine") from error
    host = f"[{flags.host}]" if ":" in flags.host else flags.host
    print(f"run {flags.name}: in Foxglove, open the connection ws://{host}:{server.port}, or {server.app_url()}", flush=True)
    try:
        while not stream.is_over():
            # The event may come before the client counts as a sink.
            if subscribed.wait(LOOK_S) or is_wanted(channels):
                subscribed.clear()
                send(stream, channels, server)
    finally:
        time.sleep(LINGER_S)
        # In a thread, because it waits for clients that do not read.
        stopping = threading.Thread(target=server.stop, daemon=True)
        stopping.start()
        stopping.join(LINGER_S)


def is_wanted(channels: list[Any]) -> bool:
    """True if a client has subscribed to a topic."""
    return any(channel.has_sinks() for channel in channels)


def send(stream: _native.MessageStream, channels: list[Any], server: Any) -> None:
    """Sends tick by tick, from the next one on, until no client has subscribed to a topic or the run ends."""
    stream.skip()
    for time_ns, messages in stream:
        if not is_wanted(channels):
            return
        server.broadcast_time(time_ns)
        for channel, message in messages:
            channels[channel].log(message, log_time=time_ns)


if __name__ == "__main__":
    _command.run(parser(), serve)

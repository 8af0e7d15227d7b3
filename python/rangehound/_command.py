"""The common parts of the commands `python -m rangehound.NAME`: flags, exit codes, and packages that may be missing."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import os
import signal
import sys
from typing import Any, Callable, NoReturn

from ._native import InputError, RunError

#: How long a command waits for its run, s.
WAIT_S = 10.0


class Parser(argparse.ArgumentParser):
    """Flags of a command; an error in them is one line."""

    def __init__(self, name: str, description: str, epilog: str) -> None:
        form = argparse.RawDescriptionHelpFormatter
        super().__init__(prog=f"python -m rangehound.{name}", description=description, epilog=epilog, formatter_class=form)
        self.add_argument("--name", required=True, metavar="RUN", help="name of the run, which must have been started")

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}\n")


def needed(module: str, extra: str) -> Any:
    """A module of a package that only one command needs."""
    package = module.partition(".")[0]
    try:
        importlib.import_module(package)
    except ModuleNotFoundError as error:
        if error.name != package:
            raise
        raise InputError(f"{package} is not installed: install it with pip install 'rangehound[{extra}]'") from error
    return importlib.import_module(module)


def give_way() -> None:
    """The lowest priority for all threads, those of libraries too: an observer must not disturb the run."""
    for number in os.listdir("/proc/self/task"):
        # A thread may end meanwhile.
        with contextlib.suppress(ProcessLookupError):
            os.setpriority(os.PRIO_PROCESS, int(number), 19)


def on_signals(handler: Any) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, handler)


def asked_to_end(*_: object) -> NoReturn:
    """Ends a command in order, as a signal asks. A second signal ends it at once."""
    on_signals(signal.SIG_DFL)
    sys.exit(0)


def run(parser: Parser, command: Callable[[argparse.Namespace], None]) -> NoReturn:
    """Runs a command: exit code 0 at the end of the run or on a signal, 2 for invalid input, 1 for a failure."""
    flags = parser.parse_args()
    on_signals(asked_to_end)
    try:
        command(flags)
    except (InputError, RunError) as error:
        parser.exit(2 if isinstance(error, InputError) else 1, f"{parser.prog}: {error}\n")
    sys.exit(0)

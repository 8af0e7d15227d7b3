"""Progress of long calls: on a terminal and in a notebook, nowhere else."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from typing import Callable, Iterator

#: Calls that take less show nothing, s.
DELAY_S = 0.5


def _is_shown() -> bool:
    shell = sys.modules.get("IPython")
    shell = shell.get_ipython() if shell is not None and hasattr(shell, "get_ipython") else None
    return type(shell).__name__ == "ZMQInteractiveShell" or (sys.stderr is not None and sys.stderr.isatty())


@contextmanager
def progress(unit: str, show: bool | None) -> Iterator[Callable[[int, int], None] | None]:
    """A function of (done, all) that shows them; `show=None` decides by where the output goes."""
    if not (_is_shown() if show is None else show):
        yield None
        return
    from tqdm.auto import tqdm

    bar = tqdm(total=0, unit=unit, delay=DELAY_S, leave=False)

    def report(done: int, everything: int) -> None:
        bar.total = everything
        bar.update(done - bar.n)

    try:
        yield report
    finally:
        bar.close()

"""Progress of long calls: on a terminal and in a notebook, nowhere else."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any, Callable, Iterator

#: The unit of files that are read.
BYTES = "B"

#: Calls that take less show nothing, s.
DELAY_S = 0.5


def _is_notebook() -> bool:
    shell = sys.modules.get("IPython")
    shell = shell.get_ipython() if shell is not None and hasattr(shell, "get_ipython") else None
    return type(shell).__name__ == "ZMQInteractiveShell"


def _bar() -> Any:
    """The kind of bar: a widget in notebooks that have widgets, a line of text elsewhere."""
    if _is_notebook() and find_spec("ipywidgets"):
        from tqdm.notebook import tqdm
    else:
        from tqdm import tqdm
    return tqdm


@contextmanager
def progress(unit: str, show: bool | None) -> Iterator[Callable[[int, int], None] | None]:
    """A function of (done, all) that shows them, in `unit`, of which B are bytes; `show=None` decides by where the output goes."""
    if show is None:
        show = _is_notebook() or (sys.stderr is not None and sys.stderr.isatty())
    if not show:
        yield None
        return
    bar = _bar()(total=0, unit=unit, unit_scale=unit == BYTES, delay=DELAY_S, leave=False)

    def report(done: int, everything: int) -> None:
        bar.total = everything
        bar.update(done - bar.n)
        if done == everything:
            # Something else may be shown next.
            bar.close()

    try:
        yield report
    finally:
        bar.close()

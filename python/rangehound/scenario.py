"""Scenarios: from a file, a dict or keywords."""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING, Any, Mapping

from . import _native
from ._native import InputError

if TYPE_CHECKING:
    from typing_extensions import Self


def to_json(keys: Mapping[str, Any]) -> str:
    """The keys of a scenario as JSON; arrays become lists, paths become texts, and `None` is no key."""

    def plain(value: Any) -> Any:
        if hasattr(value, "tolist"):
            return value.tolist()
        if isinstance(value, os.PathLike):
            return os.fspath(value)
        raise InputError(f"a {type(value).__name__} is given: expected numbers, texts, lists, arrays and dicts")

    def given(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {key: given(entry) for key, entry in value.items() if entry is not None}
        return value

    try:
        return json.dumps(given(keys), default=plain, allow_nan=False)
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError("a value is NaN or infinite: expected finite numbers") from None


class Scenario(_native.Scenario):
    """One experiment, checked once. It cannot be changed; `replace` makes another.

    `Scenario()` is the paper's experiment, as of `rangehound run`. `Scenario("file.toml")` reads a file, and
    `Scenario({...})` takes a dict with the keys of a file. Keywords replace keys: whole values, or parts of tables.

    >>> Scenario(ticks=500, robots={"count": 4, "range_std_m": 0.5}, planner="certified")

    `planner="greedy"` stands for `planner={"name": "greedy"}`, and `robots=4` for `robots={"count": 4}`.

    Raises `InputError` with one line that names key and file.
    """

    __slots__ = ()

    def __new__(
        cls, source: str | os.PathLike[str] | Mapping[str, Any] | _native.Scenario | None = None, /, **keys: Any
    ) -> Self:
        over = to_json(_tables(keys)) if keys else None
        if source is None:
            return super().__new__(cls, over=over)
        if isinstance(source, Mapping):
            return super().__new__(cls, keys=to_json(_tables(source)), over=over)
        if isinstance(source, _native.Scenario):
            return super().__new__(cls, keys=source.keys(), over=over, folder=source.folder)
        return super().__new__(cls, path=os.fspath(source), over=over)

    def replace(self, **keys: Any) -> "Scenario":
        """The same scenario with other values of these keys."""
        return Scenario(self, **keys)

    def to_dict(self) -> dict[str, Any]:
        """The keys that were given, as of a scenario file."""
        return json.loads(self.keys())

    def __reduce__(self) -> tuple[Any, ...]:
        return (_restored, (self.keys(), os.fspath(self.folder)))

    def __repr__(self) -> str:
        return f"Scenario({self.name!r}, robots={self.robots}, ticks={self.ticks}, seed={self.seed}, planner={self.planner!r})"


def _restored(keys: str, folder: str) -> Scenario:
    return _native.Scenario.__new__(Scenario, keys=keys, folder=folder)


def _tables(keys: Mapping[str, Any]) -> dict[str, Any]:
    keys = dict(keys)
    if isinstance(keys.get("planner"), str):
        keys["planner"] = {"name": keys["planner"]}
    if isinstance(keys.get("robots"), int):
        keys["robots"] = {"count": keys["robots"]}
    return keys


def scenario_of(value: Any) -> Scenario:
    """The scenario itself, or what `Scenario` makes of the value."""
    return value if isinstance(value, Scenario) else Scenario(value)

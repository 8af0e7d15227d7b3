"""What the tests share."""

import os
import pathlib
import subprocess
import sys

import pytest

#: The project's folder.
ROOT = pathlib.Path(__file__).parents[2]


@pytest.fixture
def root():
    return ROOT


@pytest.fixture
def python():
    """Runs a script in an interpreter of its own; fails after a time far above what it takes."""

    def run(script, *args, **more):
        return subprocess.run([sys.executable, "-c", script, *args], capture_output=True, text=True, timeout=120, cwd="/", **more)

    return run


@pytest.fixture
def program():
    """The program `rangehound`, if it has been built."""
    path = pathlib.Path(os.environ.get("RANGEHOUND", ROOT / "target/release/rangehound"))
    if not path.exists():
        pytest.skip(f"{path} has not been built")
    return path

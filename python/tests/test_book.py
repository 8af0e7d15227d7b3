"""The Python of the book does what it says, and what is public is documented."""

import inspect
import os
import pathlib
import re
import subprocess
import sys

import pytest
import rangehound as rh

ROOT = pathlib.Path(__file__).parents[2]


def blocks():
    text = (ROOT / "docs/python.md").read_text()
    return re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("number", range(len(blocks())))
def test_the_python_of_the_book_runs(number, python, program, tmp_path):
    text = blocks()[number]
    (tmp_path / "scenarios").symlink_to(ROOT / "scenarios")
    name = f"book-{os.getpid()}"
    script = f"import os; os.chdir({str(tmp_path)!r})\n" + text.replace("from-python", name)
    done = python(script, env={**os.environ, "RANGEHOUND": str(program)})
    assert done.returncode == 0, done.stderr
    # A verdict may be that a result is not valid.
    assert "False" not in done.stdout.replace("'valid': False", "").replace("'sound': False", "")


def test_all_that_is_public_has_a_docstring():
    for name in rh.__all__:
        thing = getattr(rh, name)
        assert name == "__version__" or inspect.getdoc(thing), name
        members = vars(thing).items() if inspect.isclass(thing) else ()
        for member, value in members:
            if not member.startswith("_") and (callable(value) or isinstance(value, property)):
                assert inspect.getdoc(value), f"{name}.{member}"


def test_the_package_is_typed_without_a_contradiction(tmp_path):
    mypy = pytest.importorskip("mypy.api")
    folder = pathlib.Path(rh.__file__).parent
    assert (folder / "py.typed").exists()
    said, problem, code = mypy.run(["--cache-dir", str(tmp_path), "--ignore-missing-imports", "--disable-error-code=import-untyped", str(ROOT / "python/rangehound")])
    assert code == 0, said + problem


def test_the_stubs_have_the_signatures_of_the_native_half(tmp_path):
    pytest.importorskip("mypy.stubtest")
    # A stub needs no list of its names.
    (tmp_path / "allowed").write_text("rangehound._native.__all__\n")
    done = subprocess.run([sys.executable, "-m", "mypy.stubtest", "--ignore-disjoint-bases", "--allowlist", str(tmp_path / "allowed"), "rangehound._native"], capture_output=True, text=True, timeout=600, cwd="/")
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("thing", "said"),
    [
        (rh.plan, ["(2, 2)", "(M, 2)", "rad", "m^2", "^-1"]),
        (rh.Filter, ["(n,)", "(n, n)", "P'^-1"]),
        (rh.Filter.step, ["(M,)", "(M, 2)", "(M, 2, 2)"]),
        (rh.Run, ["(T, n, n)", "(T, M, 2)", "rad", "m^2"]),
        (rh.Situation.worth, ["(M,)", "rad", "m/s"]),
        (rh.calibrate, ["(1 + scale) true + bias_m"]),
    ],
    ids=lambda thing: getattr(thing, "__name__", ""),
)
def test_docstrings_have_shapes_units_and_equations(thing, said):
    text = inspect.getdoc(thing)
    assert [part for part in said if part not in text] == []

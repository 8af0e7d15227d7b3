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


#: Pages with blocks of Python.
PAGES = ("docs/python.md", "docs/report.md", "docs/recording.md")


def blocks(page, language):
    return re.findall(rf"^```{language}\n(.*?)^```", (ROOT / page).read_text(), re.MULTILINE | re.DOTALL)


@pytest.fixture
def runs(program, monkeypatch, tmp_path_factory):
    """The run folders that the pages read."""
    monkeypatch.setenv("RANGEHOUND", str(program))
    folder = tmp_path_factory.mktemp("runs")
    with rh.run(name=f"book-runs-{os.getpid()}", ticks=20, clock="lockstep", out=folder / "recorded", record=True) as run:
        run.report()
    (folder / "results").symlink_to("recorded")
    return folder


@pytest.mark.parametrize(("page", "number"), [(page, number) for page in PAGES for number in range(len(blocks(page, "python")))])
def test_the_python_of_the_book_runs(page, number, python, program, runs, tmp_path):
    text = blocks(page, "python")[number]
    (tmp_path / "scenarios").symlink_to(ROOT / "scenarios")
    (tmp_path / "runs").symlink_to(runs)
    name = f"book-{os.getpid()}"
    script = f"import os; os.chdir({str(tmp_path)!r})\n" + text.replace("from-python", name)
    done = python(script, env={**os.environ, "RANGEHOUND": str(program)})
    assert done.returncode == 0, done.stderr
    assert done.stdout
    # A verdict may be that a result is not valid.
    assert "False" not in done.stdout.replace("'valid': False", "").replace("'sound': False", "")


#: Commands that need more than the package: a network, a workspace of ROS, a screen, real robots, or another program.
NEEDS_MORE = ("pip install", "source ", "python3 -m venv", "rviz2", "starts the viewer", "--name team", "--connect")


@pytest.mark.parametrize(
    ("page", "needs", "writes"),
    [
        ("docs/python.md", "numpy", "runs/demo/estimate.ticks"),
        ("docs/viewers.md", "rerun", "demo.rrd"),
        ("docs/ros2.md", "rclpy", "runs/demo/report.json"),
    ],
)
def test_the_shell_commands_of_the_book_run(page, needs, writes, program, name, tmp_path):
    pytest.importorskip(needs)
    (tmp_path / "scenarios").symlink_to(ROOT / "scenarios")
    lines = [line for block in blocks(page, "sh") for line in block.splitlines()]
    commands = "\n".join(line for line in lines if not any(words in line for words in NEEDS_MORE))
    # In a shell each command starts at once, and the page's runs are long.
    commands = re.sub(r"^(python3 -m [^#&\n]*)(#.*)?$", r"\1 &", commands, flags=re.MULTILINE)
    commands = re.sub(r"--ticks \d+", "--ticks 100", commands.replace("demo", name))
    script = f"{commands}\nfor job in $(jobs -p); do wait $job || exit 1; done"
    # A watchdog for each process, because one that hangs would outlive its shell.
    script = f"rangehound() {{ timeout 100 {program} \"$@\"; }}\npython3() {{ timeout 100 {sys.executable} \"$@\"; }}\n{script}"
    done = subprocess.run(["bash", "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, commands + done.stderr
    assert (tmp_path / writes.replace("demo", name)).stat().st_size > 0


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
    output, problem, code = mypy.run(["--cache-dir", str(tmp_path), "--ignore-missing-imports", "--disable-error-code=import-untyped", str(ROOT / "python/rangehound")])
    assert code == 0, output + problem


def test_the_stubs_have_the_signatures_of_the_native_half(tmp_path):
    pytest.importorskip("mypy.stubtest")
    # A stub needs no list of its names.
    (tmp_path / "allowed").write_text("rangehound._native.__all__\n")
    done = subprocess.run([sys.executable, "-m", "mypy.stubtest", "--ignore-disjoint-bases", "--allowlist", str(tmp_path / "allowed"), "rangehound._native"], capture_output=True, text=True, timeout=600, cwd="/")
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("thing", "expected"),
    [
        (rh.plan, ["(2, 2)", "(M, 2)", "rad", "m^2", "^-1"]),
        (rh.Filter, ["(n,)", "(n, n)", "P'^-1"]),
        (rh.Filter.step, ["(M,)", "(M, 2)", "(M, 2, 2)"]),
        (rh.Run, ["(T, n, n)", "(T, M, 2)", "rad", "m^2"]),
        (rh.Situation.evaluate, ["(M,)", "rad", "m/s"]),
        (rh.calibrate, ["(1 + scale) true + bias_m"]),
    ],
    ids=lambda thing: getattr(thing, "__name__", ""),
)
def test_docstrings_have_shapes_units_and_equations(thing, expected):
    text = inspect.getdoc(thing)
    assert [part for part in expected if part not in text] == []

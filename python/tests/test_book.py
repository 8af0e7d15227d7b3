"""The Python of the book does what it says, and what is public is documented."""

import importlib.util
import inspect
import os
import pathlib
import re
import socket
import subprocess
import sys

import pytest
import rangehound as rh

ROOT = pathlib.Path(__file__).parents[2]


#: What is before each block that is run here.
MARK = "<!-- run by: python/tests/test_book.py -->"

#: Pages with blocks of Python.
PAGES = ("docs/python.md", "docs/report.md", "docs/recording.md")

#: Pages with commands: what they need, how many blocks they have, and a file that they write.
COMMANDS = (
    ("docs/python.md", "numpy", 2, "runs/demo/estimate.ticks"),
    ("docs/viewers.md", "rerun", 2, "demo.rrd"),
    ("docs/ros2.md", "rclpy", 1, "runs/demo/report.json"),
)


def blocks(page, language):
    return re.findall(rf"^{MARK}\n```{language}\n(.*?)^```", (ROOT / page).read_text(), re.MULTILINE | re.DOTALL)


def test_no_marked_block_is_forgotten():
    pages = [str(path.relative_to(ROOT)) for path in (ROOT / "README.md", *ROOT.glob("docs/*.md"))]
    marked = {page: (ROOT / page).read_text().count(MARK) for page in pages}
    counts = {page: count for page, _, count, _ in COMMANDS}
    counts["docs/recording.md"] = 1
    run = {page: counts.get(page, 0) + (len(blocks(page, "python")) if page in PAGES else 0) for page in pages}
    assert marked == run


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


@pytest.fixture
def viewer():
    """A viewer of Rerun without a screen: its port. It has no port where Rerun is not installed."""
    if importlib.util.find_spec("rerun") is None:
        yield None
        return
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    script = (
        "import sys, rerun\n"
        "recording = rerun.RecordingStream('viewer')\n"
        f"print(recording.serve_grpc(grpc_port={port}), flush=True)\n"
        "sys.stdin.read()\n"
    )
    with subprocess.Popen([sys.executable, "-c", script], cwd="/", stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as server:
        assert str(port) in server.stdout.readline()
        yield port
        server.stdin.close()


@pytest.mark.parametrize(("page", "needs", "count", "writes"), COMMANDS)
def test_the_shell_commands_of_the_book_run(page, needs, count, writes, book, viewer, name, tmp_path):
    pytest.importorskip(needs)
    commands = "".join(book.blocks(page))
    assert len(book.blocks(page)) == count
    commands = re.sub(r"--ticks \d+", "--ticks 100", commands).replace("127.0.0.1:9876", f"127.0.0.1:{viewer}")
    # In a terminal each command starts at once, and the page's runs are long.
    commands = re.sub(r"^(python3 -m [^#&\n]*)(#.*)?$", r"\1 &", commands, flags=re.MULTILINE)
    script = book.script(commands)
    done = subprocess.run(["bash", "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, script + done.stderr
    assert (tmp_path / writes.replace("demo", name)).stat().st_size > 0
    # It ends in order only if the viewer has taken all ticks.
    assert ("sends to the viewer" in done.stdout) == ("--connect" in commands), done


def test_rerun_opens_the_file_of_a_run(book, runs, tmp_path):
    reader = pytest.importorskip("rerun.chunk", reason="rerun-sdk is not installed").RrdReader
    (commands,) = book.blocks("docs/recording.md")
    (tmp_path / "runs").symlink_to(runs)
    # It gets a file in place of a screen, and a home of its own for what it stores there.
    viewer = f"HOME={tmp_path} timeout 100 {pathlib.Path(sys.executable).with_name('rerun')}"
    script = f'rerun() {{ {viewer} "$@" --port auto --save shown.rrd; }}\n{commands}'
    done = subprocess.run(["bash", "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    shown = {chunk.entity_path for chunk in reader(tmp_path / "shown.rrd").stream().to_chunks()}
    assert {"/estimate", "/range", "/heading", "/truth", "/scene/target"} <= shown


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

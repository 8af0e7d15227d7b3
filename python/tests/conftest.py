"""The fixtures of the tests."""

import os
import pathlib
import re
import signal
import subprocess
import sys
from types import SimpleNamespace

import pytest
import rangehound as rh

#: The project's folder.
ROOT = pathlib.Path(__file__).parents[2]

#: Ends a test that hangs, s: far above what it takes.
WATCHDOG_S = 120


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


@pytest.fixture
def watchdog(request):
    """Ends a test that hangs: after `WATCHDOG_S` of its module, if it has one."""
    limit_s = getattr(request.module, "WATCHDOG_S", WATCHDOG_S)

    def hangs(*_):
        raise TimeoutError(f"the test did not end in {limit_s} s")

    before = signal.signal(signal.SIGALRM, hangs)
    signal.alarm(limit_s)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture
def name(request):
    """A name of its own for the test's run; nothing of the run may be left."""
    name = f"py-{os.getpid()}-{abs(hash(request.node.name)) % 10_000}"
    yield name
    left = [file for file in os.listdir("/dev/shm") if name in file]
    assert not left, left


@pytest.fixture
def by_hand(program, name, tmp_path):
    """Starts nodes of a run by hand, and Python nodes beside them; ends what is left of them."""
    started = []

    def start(*nodes, scripts=(), scenario=None, **keys):
        (tmp_path / "scenario.toml").write_text(rh.Scenario(scenario, **keys).to_toml())
        for args in nodes:
            first = ["scenario.toml", "--out", "out"] if args[0] == "sim" else []
            started.append(subprocess.Popen([program, *args, *first, "--name", name], cwd=tmp_path, stderr=subprocess.DEVNULL))
        for script in scripts:
            pipes = dict(stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            text = f"import rangehound as rh\nname = {name!r}\n{script}"
            started.append(subprocess.Popen([sys.executable, "-c", text], cwd="/", **pipes))
        return started

    yield start
    # The last node to end in order removes what the run has in shared memory.
    subprocess.run([program, "stop", "--name", name], capture_output=True, timeout=60)
    for process in started:
        try:
            process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


@pytest.fixture
def command():
    """Starts `python -m rangehound.NAME` with flags; ends what is left of them."""
    started = []

    def start(name, *args):
        pipes = dict(stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        started.append(subprocess.Popen([sys.executable, "-m", f"rangehound.{name}", *map(str, args)], cwd="/", **pipes))
        return started[-1]

    yield start
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()


@pytest.fixture
def traceless():
    """Removes what the tracing of ROS leaves."""
    tracing = lambda: {file for file in os.listdir("/dev/shm") if file.startswith("lttng-ust-wait-")}  # noqa: E731
    before = tracing()
    yield
    for file in tracing() - before:
        (pathlib.Path("/dev/shm") / file).unlink(missing_ok=True)


#: Lines of the book that are not typed, and why.
NOT_TYPED = {
    "pip install": "the tests run where .ci/python has installed the package",
    "python3 -m venv": "the same",
    "source ": "ROS comes as wheels, which need no set-up",
    "rviz2": "needs a screen",
    "# or starts the viewer": "needs a screen",
}


@pytest.fixture
def book(request, program, name, tmp_path, traceless):
    """The blocks of a page that are marked for the test's file, and a script that types commands with the test's own run."""

    def blocks(page):
        mark = re.escape(f"<!-- run by: python/tests/{request.path.name} -->")
        found = re.findall(rf"^{mark}\n```sh\n(.*?)^```", (ROOT / page).read_text(), re.MULTILINE | re.DOTALL)
        is_typed = lambda line: not any(words in line for words in NOT_TYPED)  # noqa: E731
        return ["".join(filter(is_typed, block.splitlines(keepends=True))) for block in found]

    def script(commands, run="demo"):
        (tmp_path / "scenarios").symlink_to(ROOT / "scenarios")
        typed = re.sub(rf"\b{run}\b", name, commands)
        # A watchdog for each process, because one that hangs would outlive its shell.
        programs = f"rangehound() {{ timeout 100 {program} \"$@\"; }}\npython3() {{ timeout 100 {sys.executable} \"$@\"; }}\n"
        return f"{programs}{typed}for job in $(jobs -p); do wait $job || exit 1; done"

    return SimpleNamespace(blocks=blocks, script=script)

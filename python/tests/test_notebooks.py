"""The notebooks of the book run from their first cell to their last."""

import pathlib
import time

import pytest

NOTEBOOKS = sorted((pathlib.Path(__file__).parents[2] / "docs/notebooks").glob("*.ipynb"))


def test_there_are_three():
    assert [path.stem for path in NOTEBOOKS] == ["kill_a_robot", "own_planner", "paper"]


@pytest.fixture(scope="module")
def times():
    """How long each notebook takes, s; printed at the end."""
    taken_s = {}
    yield taken_s
    print(f"\nnotebooks: {sum(taken_s.values()):.1f} s together: {taken_s}")


@pytest.mark.parametrize("has_widgets", [True, False], ids=["widgets", "text"])
def test_a_long_call_shows_a_bar(has_widgets):
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    pytest.importorskip("ipywidgets")
    hide = "" if has_widgets else "import sys; sys.modules['ipywidgets'] = None\n"
    cell = nbformat.v4.new_code_cell(hide + "import rangehound as rh\nrh.simulate(ticks=600_000, planner='greedy').digest")
    notebook = nbformat.v4.new_notebook(cells=[cell])
    nbclient.NotebookClient(notebook, timeout=120, kernel_name="python3").execute(cwd="/")
    shown = "".join(output["text"] for output in cell.outputs if output.get("name") == "stderr")
    bars = [output for output in cell.outputs if "application/vnd.jupyter.widget-view+json" in output.get("data", {})]
    assert (len(bars) == 1 and not shown) if has_widgets else ("/600000" in shown and not bars), cell.outputs


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_is_stored_without_output(path, program, monkeypatch, times):
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert all(not cell.outputs and cell.execution_count is None for cell in notebook.cells if cell.cell_type == "code")
    monkeypatch.setenv("RANGEHOUND", str(program))
    monkeypatch.setenv("MPLBACKEND", "agg")
    began_s = time.monotonic()
    nbclient.NotebookClient(notebook, timeout=120, kernel_name="python3").execute(cwd="/")
    times[path.stem] = round(time.monotonic() - began_s, 1)
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    shown = "".join(output["text"] for output in outputs if output.get("name") == "stderr")
    assert "Warning" not in shown and "Error" not in shown, shown
    assert path.stem != "paper" or sum(cell.cell_type == "code" for cell in notebook.cells) == 10

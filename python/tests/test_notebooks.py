"""The notebooks of the book run from their first cell to their last."""

import pathlib

import pytest

NOTEBOOKS = sorted((pathlib.Path(__file__).parents[2] / "docs/notebooks").glob("*.ipynb"))


def test_there_are_three():
    assert [path.stem for path in NOTEBOOKS] == ["kill_a_robot", "own_planner", "paper"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_is_stored_without_output(path, program, monkeypatch):
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert all(not cell.outputs and cell.execution_count is None for cell in notebook.cells if cell.cell_type == "code")
    monkeypatch.setenv("RANGEHOUND", str(program))
    monkeypatch.setenv("MPLBACKEND", "agg")
    nbclient.NotebookClient(notebook, timeout=120, kernel_name="python3").execute(cwd="/")
    said = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    # Long calls show a bar.
    shown = "".join(output["text"] for output in said if output.get("name") == "stderr")
    assert "Warning" not in shown and "Error" not in shown, shown
    assert path.stem != "paper" or sum(cell.cell_type == "code" for cell in notebook.cells) == 10

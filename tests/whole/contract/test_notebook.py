"""The example notebook: its cells in this process, and with what they show, in its own kernel."""

import matplotlib
import nbclient
import nbformat
import pytest
from cases import in_full
from places import ROOT
from waiting import TIMEOUT_S

# a delay of 0.1 s and, at 50 Hz, 0 to 0.02 s until the message is used
NEWS = "uav2 used news of the leader that were 0.1"
NOTEBOOK = ROOT / "examples" / "look_at_a_run.ipynb"


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """Run the notebook; its cells have outputs."""
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    folder = str(tmp_path_factory.mktemp("notebook"))
    nbclient.NotebookClient(
        notebook, timeout=TIMEOUT_S, resources={"metadata": {"path": folder}}
    ).execute()
    return notebook


def outputs(notebook):
    return [output for cell in notebook.cells for output in cell.get("outputs", [])]


def test_notebook_is_stored_without_outputs():
    assert outputs(nbformat.read(NOTEBOOK, as_version=4)) == []


def test_notebook_cells_run_here(tmp_path, monkeypatch, capsys):
    """As Python, where each warning is an error."""
    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for cell in nbformat.read(NOTEBOOK, as_version=4).cells:
        if cell.cell_type == "code":
            exec(cell.source, names)
    assert len(names["fig"].axes) == 2
    assert NEWS in capsys.readouterr().out
    assert names["flown"].outcome == "completed" and names["joined"]


# The kernel: tests of the progress in a cell and of pictures do not need it.
@in_full
def test_notebook_cells_have_output_without_warnings(ran):
    code = [cell for cell in ran.cells if cell.cell_type == "code"]
    assert len(code) >= 6
    for cell in code:
        assert cell.outputs, cell.source
        for output in cell.outputs:
            assert output.output_type in ("execute_result", "display_data", "stream")
            assert output.get("name") != "stderr", output.text


@in_full
def test_notebook_has_picture_and_message_age(ran):
    assert any("image/png" in output.get("data", {}) for output in outputs(ran))
    texts = [output.text for output in outputs(ran) if output.output_type == "stream"]
    assert any(NEWS in text and " s old" in text for text in texts), texts


@in_full
def test_notebook_shows_the_progress_of_a_flight(ran):
    """One line of the cell's output, which says at the end how long the flight took."""
    first = next(cell for cell in ran.cells if cell.cell_type == "code")
    lines = [
        output["data"]["text/plain"]
        for output in first.outputs
        if output.output_type == "display_data"
    ]
    assert len(lines) == 1 and "simulation-3: 60 s simulated in " in lines[0], lines

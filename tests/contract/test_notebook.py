"""The example notebook, run in a kernel of its own."""

from pathlib import Path

import nbclient
import nbformat
import pytest
from patience import PATIENCE_S

NOTEBOOK = Path(__file__).parents[2] / "examples" / "look_at_a_run.ipynb"


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """The notebook with what its cells gave."""
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    folder = str(tmp_path_factory.mktemp("desk"))
    nbclient.NotebookClient(
        notebook, timeout=PATIENCE_S, resources={"metadata": {"path": folder}}
    ).execute()
    return notebook


def outputs(notebook):
    return [output for cell in notebook.cells for output in cell.get("outputs", [])]


def test_the_notebook_is_kept_without_outputs():
    assert outputs(nbformat.read(NOTEBOOK, as_version=4)) == []


def test_every_cell_shows_something_and_warns_of_nothing(ran):
    code = [cell for cell in ran.cells if cell.cell_type == "code"]
    assert len(code) >= 6
    for cell in code:
        assert cell.outputs, cell.source
        for output in cell.outputs:
            assert output.output_type in ("execute_result", "display_data", "stream")
            assert output.get("name") != "stderr", output.text


def test_there_is_a_picture_and_the_news_is_as_old_as_the_page_says(ran):
    assert any("image/png" in output.get("data", {}) for output in outputs(ran))
    said = [output.text for output in outputs(ran) if output.output_type == "stream"]
    # 0.1 s on the way and, at 50 Hz, 0 to 0.02 s until it is used
    assert any("were 0.1" in text and " s old" in text for text in said), said

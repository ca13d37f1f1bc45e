"""The progress of pip in `make run`."""

import importlib
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LINES = """\
Looking in indexes: https://pypi.org/simple
Ignoring colorama: markers 'sys_platform == "win32"' don't match your environment
Collecting numpy==2.3.0 (from -r requirements.lock (line 7))
  Downloading numpy-2.3.0-cp311-cp311-manylinux_2_28_x86_64.whl (16.5 MB)
Processing /wheels/scipy-1.16.0-py3-none-any.whl (from -r requirements.lock (line 12))
"""


@pytest.fixture
def install(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "release"))
    yield importlib.import_module("install")
    sys.modules.pop("install", None)


def test_progress_counts_what_pip_does(install, tmp_path):
    (tmp_path / "pip-25.0.dist-info").mkdir()
    progress = install.PipProgress(3, tmp_path)
    said = []
    for line in LINES.splitlines(keepends=True):
        progress.read(line)
        said.append(progress.text().rstrip())
    assert said == [
        "fetched 0 of 3", "fetched 0 of 2", "fetched 1 of 2", "fetched 1 of 2  numpy, 16.5 MB",
        "fetched 2 of 2",
    ]  # fmt: skip
    progress.read("Installing collected packages: numpy, scipy")
    (tmp_path / "numpy-2.3.0.dist-info").mkdir()
    assert progress.text() == "installed 1 of 2 packages"
    assert len(install.shown_line("a" * 200, 12.3)) < 80


def test_failing_pip_is_shown_with_its_code(install, tmp_path, capfd):
    lock = tmp_path / "some.lock"
    lock.write_text("numpy==2.3.0 \\\n    --hash=sha256:0\nscipy==1.16.0\n")
    code = (
        "import sys; print('no such package'); sys.exit(7 if '--progress-bar' in sys.argv else 0)"
    )
    assert install.main(str(lock), sys.executable, "-c", code) == 7
    assert "no such package" in capfd.readouterr().err
    assert install.main(str(lock), sys.executable, "-c", "print('quiet')") == 0
    shown = capfd.readouterr().err
    assert "2 packages in 0 s" in shown and "quiet" not in shown

"""Compare printed text with a file in tests/snapshots; TESTBED_SNAPSHOTS=1 rewrites the files."""

import os

from places import TESTS

FOLDER = TESTS / "snapshots"


def check_snapshot(name, text):
    """Compare text with tests/snapshots/<name>.txt, without spaces at the ends of lines."""
    path = FOLDER / f"{name}.txt"
    lines = [line.rstrip() for line in text.splitlines()]
    if os.environ.get("TESTBED_SNAPSHOTS"):
        FOLDER.mkdir(exist_ok=True)
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert lines == path.read_text(encoding="utf-8").splitlines()

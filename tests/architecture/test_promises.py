"""Every promise of docs/contributing/promises.md names an existing test."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROMISE = re.compile(r"^\| .+ \| \[[\w.]+\]\(\.\./\.\./(tests/[\w/]+\.py)\) `(\w+)` \|$")


def test_every_promise_names_an_existing_test():
    page = (ROOT / "docs" / "contributing" / "promises.md").read_text(encoding="utf-8")
    lines = [
        line
        for line in page.splitlines()
        if line.startswith("|") and not line.startswith(("|---", "| promise", "| what"))
    ]
    assert len(lines) > 20
    for line in lines:
        found = PROMISE.match(line)
        assert found, line
        file, name = found.groups()
        text = (ROOT / file).read_text(encoding="utf-8")
        assert re.search(rf"^def {name}\(", text, re.M), f"{file} has no {name}"

"""Every larger sample belongs to a part of `make check-all`."""

import re
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests"))

import check_all  # noqa: E402

# not of a sample: written, set by a test for its own processes, looked at by a person, the shard,
# that the seconds of files are written, or a program that is in no environment of the tests
OTHERS = {
    *("TESTBED_SNAPSHOTS", "TESTBED_PICTURES", "TESTBED_SOCKET", "TESTBED_TEST_MARK"),
    *("TESTBED_SHARD", "TESTBED_SECONDS", "TESTBED_ECOS"),
}


def sizes():
    """Return the variables that tests read, with a file of each."""
    found = {}
    for path in [*ROOT.glob("tests/**/*.py"), *ROOT.glob("paper/tests/*.py")]:
        if path.name != Path(__file__).name:
            for line in path.read_text("utf-8").splitlines():
                if "environ" in line or "getenv" in line:
                    found |= {name: path.name for name in re.findall(r'"(TESTBED_\w+)"', line)}
    return {name: file for name, file in found.items() if name not in OTHERS}


def test_every_larger_sample_is_run():
    commands = " ".join(part.command for part in check_all.PARTS)
    assert len(sizes()) > 20
    missing = {name: file for name, file in sizes().items() if name + "=" not in commands}
    assert missing == {}


def test_parts_name_files_that_exist():
    words = [word for part in check_all.PARTS for word in part.command.split()]
    places = [word for word in words if word.startswith(("tests/", "paper/"))]
    assert len(places) > 20
    assert [place for place in places if not (ROOT / place).exists()] == []


def test_rows_of_other_parts_are_kept(tmp_path, monkeypatch):
    page = tmp_path / "page.md"
    page.write_text(
        f"a\n{check_all.BEGIN}\n\n{check_all.table({})}\n\n{check_all.END}\nb\n", "utf-8"
    )
    monkeypatch.setattr(check_all, "PAGE", page)
    check_all.write_rows({"theorem": ["6 passed", "0.8 min", "abc1234", "2026-11-29"]})
    rows = check_all.read_rows(page.read_text("utf-8"))
    assert rows["theorem"] == ["6 passed", "0.8 min", "abc1234", "2026-11-29"]
    rows["release"] = ["passed", "1.0 min", "abc1234", "2026-11-29"]
    check_all.write_rows(rows)
    text = page.read_text("utf-8")
    assert check_all.read_rows(text)["theorem"] == rows["theorem"]
    assert text.startswith("a\n") and text.endswith("\nb\n") and "| abc1234 |" in text

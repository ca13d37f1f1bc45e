"""The golden tables that come with the testbed: of pages that are there, whole, and with reasons.

`testbed check` flies them; here nothing flies.
"""

from __future__ import annotations

import pytest

from testbed.scenario import library, list_scenarios, load
from testbed.study.golden import KEPT_SEEDS
from testbed.study.golden_table import RULES, read_table

FOLDER = library() / "scenarios" / "golden"
NAMES = [path.stem for path in sorted(FOLDER.glob("*.json"))]


@pytest.mark.parametrize("name", NAMES)
def test_a_table_is_of_its_page_and_says_why(name):
    assert name in list_scenarios(), "a table without a page"
    table, page = read_table(FOLDER / f"{name}.json"), load(name)
    assert table.scenario == page.name
    for portion in page.scenario.portions:
        for follower in page.fleet:
            # who is broken may be lost before a portion, and has no error in it
            assert f"rms_m/{portion}/{follower.name}" in table.rows or follower.faults
    assert table.reason.strip()
    assert set(table.rules) == set(RULES)
    assert all(rule.reason for rule in table.rules.values())
    assert len(table.seeds) == (KEPT_SEEDS if table.random else 2)
    for row in table.rows.values():
        assert len(row.by_seed) == len(table.seeds)


NEEDS_A_PROGRAM = {"simulation-3-ardupilot"}  # that is no part of the testbed


def test_every_page_with_portions_has_a_table():
    if not NAMES:
        pytest.skip("no golden tables are kept")
    with_portions = {name for name in list_scenarios() if load(name).scenario.portions}
    assert with_portions - NEEDS_A_PROGRAM == set(NAMES)

"""Golden tables of the library: complete, one for each scenario with windows; no flights."""

from __future__ import annotations

import pytest

from testbed.golden.golden import DETERMINISTIC_SEEDS, RANDOM_SEEDS
from testbed.golden.golden_table import read_table
from testbed.scenario import library, list_scenarios, load_scenario

FOLDER = library() / "scenarios" / "golden"
NAMES = [path.stem for path in sorted(FOLDER.glob("*.json"))]
NEEDS_EXTERNAL_PROGRAM = {"simulation-3-ardupilot"}


@pytest.mark.parametrize("name", NAMES)
def test_table_belongs_to_its_scenario(name):
    """It has a reason and a number for each seed, window and follower."""
    assert name in list_scenarios(), "a table without a scenario"
    table, scenario = read_table(FOLDER / f"{name}.json"), load_scenario(name)
    assert table.scenario == scenario.name
    for window in scenario.scenario.windows:
        for follower in scenario.fleet:
            # a follower with a fault may be lost before a window, and has no error in it
            assert f"rms_m/{window}/{follower.name}" in table.rows or follower.faults
    assert table.reason.strip()
    assert len(table.seeds) == (RANDOM_SEEDS if table.random else DETERMINISTIC_SEEDS)
    for row in table.rows.values():
        assert len(row.by_seed) == len(table.seeds)


def test_every_scenario_with_windows_has_a_table():
    if not NAMES:
        pytest.skip("there are no golden tables")
    with_windows = {name for name in list_scenarios() if load_scenario(name).scenario.windows}
    assert with_windows - NEEDS_EXTERNAL_PROGRAM == set(NAMES)

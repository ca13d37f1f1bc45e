"""Numbers in text are read by one grammar, which is narrower than Python's."""

import pytest
from commands import refuse_all

from testbed.core.csv_table import read_table
from testbed.core.errors import InputError
from testbed.core.numbers import parse_number, parse_whole
from testbed.core.ranges import CLOCK
from testbed.scenario import ScenarioError, load_scenario

STRANGE = ("1_0", "nan", "infinity", "1e999", "0x10", "١٠", "１０", "1 0", "", ".", "e5", "1,5")


@pytest.mark.parametrize("text", STRANGE)
def test_strange_numbers_are_refused(text, tmp_path):
    assert parse_number(text) is None
    assert parse_whole(text) is None
    table = tmp_path / "table.csv"
    table.write_text(f'x,y\n"{text}",1\n', encoding="utf-8")
    with pytest.raises(InputError, match=r"table\.csv:2: "):
        read_table(table).numbers({"x": CLOCK})
    if text:
        with pytest.raises(ScenarioError, match=r"scenario\.duration_s: is "):
            load_scenario("simulation-3", [f"scenario.duration_s={text}"])


@pytest.mark.parametrize(
    ("text", "value"), [("4", 4.0), ("-.5", -0.5), ("+2.", 2.0), ("1e-3", 1e-3), ("007", 7.0)]
)
def test_decimal_numbers_are_read(text, value):
    assert parse_number(text) == value


def test_strange_numbers_of_options_are_refused(tmp_path):
    refuse_all("numbers", tmp_path)

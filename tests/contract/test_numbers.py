"""Numbers in text are read by one grammar, which is narrower than Python's."""

import pytest
from commands import call_command

from testbed.core.csv_table import read_table
from testbed.core.errors import InputError
from testbed.core.numbers import parse_number, parse_whole
from testbed.scenario import ScenarioError, load_scenario

STRANGE = ("1_0", "nan", "infinity", "1e999", "0x10", "١٠", "１０", "1 0", "", ".", "e5", "1,5")


@pytest.mark.parametrize("text", STRANGE)
def test_strange_numbers_are_refused(text, tmp_path):
    assert parse_number(text) is None
    assert parse_whole(text) is None
    table = tmp_path / "table.csv"
    table.write_text(f'x,y\n"{text}",1\n', encoding="utf-8")
    with pytest.raises(InputError, match=r"table\.csv:2: "):
        read_table(table).numbers(["x"])
    if text:
        with pytest.raises(ScenarioError, match=r"scenario\.duration_s: is "):
            load_scenario("simulation-3", [f"scenario.duration_s={text}"])


@pytest.mark.parametrize("reader", ["core.csv_table", "scenario.yaml_io"])
def test_wider_grammar_of_numbers_is_found(reader, tmp_path, monkeypatch):
    """A negative control of the test above: it fails where one reader has Python's grammar."""

    def parse_wider(text):
        try:
            return float(text)
        except ValueError:
            return None

    monkeypatch.setattr(f"testbed.{reader}.parse_number", parse_wider)
    with pytest.raises((pytest.fail.Exception, AssertionError)):
        test_strange_numbers_are_refused("1_0", tmp_path)


@pytest.mark.parametrize(
    ("text", "value"), [("4", 4.0), ("-.5", -0.5), ("+2.", 2.0), ("1e-3", 1e-3), ("007", 7.0)]
)
def test_decimal_numbers_are_read(text, value):
    assert parse_number(text) == value


@pytest.mark.parametrize(
    "arguments",
    [
        ("trim", "rascal110", "--airspeed", "1_0"),
        ("trim", "rascal110", "--airspeed=１０"),
        ("run", "simulation-3", "--seed", "1_0"),
        ("margins", "simulation-3", "--bank", "1_0"),
        *(
            ("respond", "rascal110", option, "nan", "in.csv", "out.csv")
            for option in ("--airspeed", "--altitude", "--origin-elevation")
        ),
    ],
)
def test_strange_numbers_of_options_are_refused(arguments, tmp_path):
    done = call_command(*arguments, cwd=tmp_path, code=2, columns=100)
    assert f"error: {arguments[2].partition('=')[0]} " in done.stderr

"""The command law: control functions and barriers of the paper and of a scenario."""

import pytest
from commands import call_command

from testbed.cli.law import _of_paper, _of_scenario
from testbed.logs.file_record import RECORD_NAME
from testbed.reports.figures_law import half_way, law_figures

TABLE = """\
 control function                 mu at 0  rho_bar  half of it at, m
 example 1, ν₁ = ν₂ = 1, m = 0.5        1        1             0.581
 example 2                              1        1             0.501
 example 3                              1        1             0.437
 barrier              speeds, m/s  h midway  h' at the bounds, s/m
 example 4, ν = 1/50     10 to 30         2              0.4, -0.4
 example 5, ν = 1/20     10 to 30         1                  1, -1
 example 6, ν = 1        10 to 30         1                  2, -2
"""


def test_command_writes_figures_1_and_2(tmp_path):
    arguments = ("law", "--figures", "drawn", "--format", "svg")
    done = call_command(*arguments, cwd=tmp_path, code=0, columns=100)
    lines = [line.rstrip() for line in done.stdout.splitlines()]
    assert lines[:-1] == TABLE.splitlines() and "2 in drawn" in lines[-1]
    drawn = {path.name for path in (tmp_path / "drawn").iterdir()}
    assert drawn == {"control-functions.svg", "barriers.svg", RECORD_NAME}
    text = (tmp_path / "drawn" / "control-functions.svg").read_text("utf-8")
    assert "example 2 -->" in text and "STIX" not in text


def test_figures_have_the_paper_s_curves():
    """μ of example 3 is above 1 from z = 0.1 to 1 only, and no ‖ρ‖ is above 1."""
    functions, barriers = _of_paper()
    left, right = next(law_figures(functions, barriers, "")).grid.rows[0]
    third = left.lines[2]
    inside = (third.x > 0.11) & (third.x < 0.99)
    assert (third.y[inside] > 1.0).all() and (third.y[third.x > 1.01] < 1.0).all()
    for line in right.lines:
        assert line.y.max() <= 1.0 + 1e-12
    # example 1 with ν₁ = ν₂ = 1: r/√(1 + r²) = 1/2
    first = next(iter(functions.values()))
    assert half_way(first) == pytest.approx(3.0**-0.5, rel=0.01)


def test_followers_with_equal_functions_share_a_row():
    change = "formation.agents={uav2: {barrier: {example: 6, nu: 1}, speed_mps: [17, 29]}}"
    functions, barriers = _of_scenario("simulation-3", [change])
    assert list(functions) == ["uav1, uav2, uav3"]
    assert {name: each[1:] for name, each in barriers.items()} == {
        "uav1, uav3": (16.0, 30.0),
        "uav2": (17.0, 29.0),
    }

"""Numbers beside golden ones, without a table: the limits, and refusals."""

import math

import pytest

from testbed.core.errors import InputError
from testbed.golden.golden_compare import compare_numbers
from testbed.golden.golden_table import RULES
from testbed.golden.golden_tolerance import Tolerances

GOLDEN = {"mean_rms_m/circles": 0.4, "min_separation_m": 8.0, "joined_at_s/uav1": 20.0}


@pytest.mark.parametrize("key", GOLDEN)
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_limits_are_those_of_the_rules(key, side):
    allowed = RULES[key.split("/")[0]].allowed(GOLDEN[key])
    inside = GOLDEN | {key: GOLDEN[key] + 0.99 * side * allowed}
    assert compare_numbers(GOLDEN, inside) == []
    outside = GOLDEN | {key: GOLDEN[key] + 1.01 * side * allowed}
    (found,) = compare_numbers(GOLDEN, outside)
    assert (found.key, found.measured, found.golden) == (key, outside[key], GOLDEN[key])
    improves = -1.0 if RULES[key.split("/")[0]].better == "lower" else 1.0
    assert found.better == (side == improves)
    assert found.deviation == pytest.approx(1.01)


def test_a_tolerance_widens_one_quantity():
    worse = {key: 1.04 * value for key, value in GOLDEN.items()}
    found = compare_numbers(GOLDEN, worse, Tolerances({"mean_rms_m": "5%"}))
    assert [each.key for each in found] == ["min_separation_m", "joined_at_s/uav1"]


def test_what_is_not_finite_is_outside():
    (found,) = compare_numbers(GOLDEN, GOLDEN | {"min_separation_m": math.nan})
    assert found.key == "min_separation_m"


@pytest.mark.parametrize(
    ("golden", "measured", "said"),
    [
        (GOLDEN, {"min_separation_m": 8.0}, "joined_at_s/uav1, mean_rms_m/circles: in one"),
        ({"height": 1.0}, {"height": 1.0}, "height: no rule"),
    ],
)
def test_tables_that_do_not_match_are_refused(golden, measured, said):
    with pytest.raises(InputError, match=said):
        compare_numbers(golden, measured)

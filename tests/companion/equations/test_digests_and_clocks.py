"""Digests of scenario and parameters, and the offset of another aircraft's clock."""

import math
import random

import pytest
from companion_flights import GOOD_PARAMETERS

from testbed.companion.clock_offset import WINDOW_S, ClockOffset
from testbed.companion.scenario_digest import (
    AGREED_PARAMETERS,
    NEEDED_PARAMETERS,
    join_digests,
    parameter_digest,
    scenario_digest,
    split_digests,
)

FILES = [("scenario", b"formation: 1"), ("law.py", b"def law(): ...")]


def test_digest_is_of_contents_in_any_order():
    assert scenario_digest(FILES) == scenario_digest(FILES[::-1])
    others = [
        [FILES[0], ("law.py", b"def law(): ... ")],
        [FILES[0], ("laws.py", FILES[1][1])],
        [("scenario", b"formation: 1law.py"), ("", FILES[1][1])],  # the same bytes, cut elsewhere
        FILES[:1],
        [],
    ]
    digests = {scenario_digest(each) for each in (FILES, *others)}
    assert len(digests) == 6 and all(0 <= each < 2**32 for each in digests)


def test_digest_of_parameters_is_of_limits_and_trims():
    assert set(NEEDED_PARAMETERS) <= set(AGREED_PARAMETERS)
    one = parameter_digest(GOOD_PARAMETERS)
    same = dict(reversed(GOOD_PARAMETERS.items())) | {
        "SYSID_THISMAV": 3.0,
        "PTCH_TRIM_DEG": math.nan,
    }
    assert parameter_digest(same) == one
    assert parameter_digest(GOOD_PARAMETERS | {"AIRSPEED_MIN": 14.0000001}) == one  # of a float32
    for name in GOOD_PARAMETERS:
        assert parameter_digest(GOOD_PARAMETERS | {name: 14.1}) != one
        assert parameter_digest({k: v for k, v in GOOD_PARAMETERS.items() if k != name}) != one
    zero = [parameter_digest(GOOD_PARAMETERS | {"THR_MIN": each}) for each in (0.0, -0.0, 1.0)]
    assert zero[0] == zero[1] != zero[2]


def test_both_digests_pass_through_custom_state():
    one, two = scenario_digest(FILES), parameter_digest(GOOD_PARAMETERS)
    state = join_digests(one, two)
    assert 0 <= state < 2**64 and split_digests(state) == (one, two)
    assert split_digests(join_digests(0, 2**32 - 1)) == (0, 2**32 - 1)


@pytest.mark.parametrize("offset_s", [0.0, 0.4, -0.4])
def test_offset_is_that_of_the_least_delayed_message(offset_s):
    """With delays of 5 to 400 ms, of messages in any order: within the least delay of 5 s."""
    draw, clock = random.Random(3), ClockOffset()
    assert math.isnan(clock.offset_s)
    received = sorted((0.04 * k + draw.choice((0.005, 0.05, 0.4)), 0.04 * k) for k in range(500))
    for k, (receipt, sent) in enumerate(received):
        found = clock.add(sent + offset_s, receipt)
        window = [s + offset_s - r for r, s in received[: k + 1] if r >= receipt - WINDOW_S]
        assert found == clock.offset_s == max(window)
    assert found == pytest.approx(offset_s - 0.005, abs=1e-9)


def test_jump_of_another_clock_is_found_in_seconds():
    clock = ClockOffset()
    for k in range(500):
        now = 0.04 * k
        found = clock.add(now - 0.01 - (1.0 if now > 10.0 else 0.0), now)
        if 10.0 < now <= 10.0 + WINDOW_S - 0.05:
            assert found == pytest.approx(-0.01)
    assert found == pytest.approx(-1.01)

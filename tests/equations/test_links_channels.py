"""Stick pulses and the angles they ask for, against hand arithmetic."""

import math

import numpy as np
import pytest

from testbed.links.channels import (
    Limits,
    Range,
    Scales,
    pitch_of,
    pulses,
    roll_of,
    scales,
    share,
    throttle_of,
    within,
)
from testbed.streams import stream

LIMITS = Limits(math.radians(50.0), math.radians(20.0), math.radians(-15.0))
EVEN = Scales(Range(), Range(), Range(), LIMITS)
# a worn radio: trims off centre, ends that differ
WORN = Scales(Range(1100, 1480, 1950), Range(1050, 1530, 1900), Range(1010, 1010, 1930), LIMITS)


@pytest.mark.parametrize(
    ("pulse_us", "bank_deg"),
    [(1500, 0), (2000, 50), (1000, -50), (1750, 25), (1300, -20), (2400, 50), (600, -50)],
)
def test_a_pulse_is_its_share_of_the_bank_limit(pulse_us, bank_deg):
    assert math.degrees(roll_of(pulse_us, EVEN)) == pytest.approx(bank_deg, abs=1e-12)


@pytest.mark.parametrize(
    ("pulse_us", "pitch_deg"), [(1500, 0), (2000, 20), (1750, 10), (1000, -15), (1400, -3)]
)
def test_pitch_has_a_limit_for_each_side(pulse_us, pitch_deg):
    assert math.degrees(pitch_of(pulse_us, EVEN)) == pytest.approx(pitch_deg, abs=1e-12)


@pytest.mark.parametrize(("pulse_us", "throttle"), [(1000, 0), (1500, 0.5), (2000, 1), (900, 0)])
def test_throttle_goes_from_end_to_end(pulse_us, throttle):
    assert throttle_of(pulse_us, EVEN) == throttle


def test_each_side_of_the_trim_has_its_own_scale():
    assert share(1480, WORN.roll) == 0.0
    assert share(1950, WORN.roll) == 1.0
    assert share(1290, WORN.roll) == pytest.approx(-0.5)  # 190 of 380 µs
    assert share(1715, WORN.roll) == pytest.approx(0.5)  # 235 of 470 µs


@pytest.mark.parametrize("scale", [EVEN, WORN], ids=["even", "worn"])
def test_pulses_ask_for_what_they_were_made_from(scale):
    dice = stream(11, "links")
    for _ in range(200):
        roll = dice.uniform(-LIMITS.roll, LIMITS.roll)
        pitch = dice.uniform(LIMITS.down, LIMITS.up)
        throttle = dice.uniform()
        one, two, three = pulses(roll, pitch, throttle, scale)
        back = (roll_of(one, scale), pitch_of(two, scale), throttle_of(three, scale))
        assert back == pytest.approx((roll, pitch, throttle), abs=1e-12)


def test_a_command_beyond_the_limits_is_at_the_end_of_the_stick():
    assert pulses(2.0, 2.0, 2.0, WORN) == (1950, 1900, 1930)
    assert pulses(-2.0, -2.0, -2.0, WORN) == (1100, 1050, 1010)
    assert within(2.0, -2.0, LIMITS) == (LIMITS.roll, LIMITS.down)
    assert within(-0.1, 0.1, LIMITS) == (-0.1, 0.1)


def test_a_stick_without_a_way_asks_for_nothing():
    stuck = Scales(Range(1500, 1500, 1500), Range(1500, 1500, 1500), Range(1, 1, 1), LIMITS)
    for pulse_us in (1000, 1500, 2000):
        assert roll_of(pulse_us, stuck) == pitch_of(pulse_us, stuck) == 0.0
        assert throttle_of(pulse_us, stuck) == 0.0
    still = EVEN._replace(limits=Limits(0.0, 0.0, 0.0))
    assert pulses(0.3, -0.3, 0.5, still) == (1500, 1500, 1500)


def test_scales_come_from_parameters_or_are_arduplanes_defaults():
    assert scales({}) == Scales(
        Range(1000, 1500, 2000),
        Range(1000, 1500, 2000),
        Range(1000, 1500, 2000),
        Limits(*np.radians([45.0, 20.0, -25.0])),
    )
    given = {"RC2_MIN": 1050.0, "RC2_TRIM": 1530.0, "RC2_MAX": 1900.0, "ROLL_LIMIT_DEG": 50.0}
    given |= {"PTCH_LIM_MAX_DEG": 20.0, "PTCH_LIM_MIN_DEG": -15.0}
    assert scales(given) == EVEN._replace(pitch=WORN.pitch)

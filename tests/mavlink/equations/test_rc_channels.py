"""RC pulses and the commands they stand for, against hand arithmetic."""

import math

import numpy as np
import pytest

from testbed.core.random import named_stream
from testbed.core.records import FbwaCommand
from testbed.mavlink.rc_channels import AngleLimits, PwmRange, RcScaling, rc_scaling

LIMITS = AngleLimits(math.radians(50.0), math.radians(20.0), math.radians(-15.0))
EVEN = RcScaling(PwmRange(), PwmRange(), PwmRange(), LIMITS)
# a worn radio: trims off centre, unequal sides
WORN = RcScaling(
    PwmRange(1100, 1480, 1950), PwmRange(1050, 1530, 1900), PwmRange(1010, 1010, 1930), LIMITS
)


@pytest.mark.parametrize(
    ("pulse_us", "bank_deg"),
    [(1500, 0), (2000, 50), (1000, -50), (1750, 25), (1300, -20), (2400, 50), (600, -50)],
)
def test_roll_pulse_is_share_of_roll_limit(pulse_us, bank_deg):
    assert math.degrees(EVEN.roll_angle(pulse_us)) == pytest.approx(bank_deg, abs=1e-12)


@pytest.mark.parametrize(
    ("pulse_us", "pitch_deg"), [(1500, 0), (2000, 20), (1750, 10), (1000, -15), (1400, -3)]
)
def test_pitch_pulse_has_a_limit_on_each_side(pulse_us, pitch_deg):
    assert math.degrees(EVEN.pitch_angle(pulse_us)) == pytest.approx(pitch_deg, abs=1e-12)


@pytest.mark.parametrize(("pulse_us", "throttle"), [(1000, 0), (1500, 0.5), (2000, 1), (900, 0)])
def test_throttle_pulse_is_share_of_range(pulse_us, throttle):
    assert EVEN.throttle_share(pulse_us) == throttle


def test_each_side_of_trim_has_its_own_scale():
    roll = WORN.roll
    assert roll.signed_from_pwm(1480) == 0.0
    assert roll.signed_from_pwm(1950) == 1.0
    assert roll.signed_from_pwm(1290) == pytest.approx(-0.5)  # 190 of 380 µs
    assert roll.signed_from_pwm(1715) == pytest.approx(0.5)  # 235 of 470 µs


@pytest.mark.parametrize("reversed_", [False, True])
def test_pwm_range_conversions_are_inverse(reversed_):
    pwm = PwmRange(1100, 1480, 1950, reversed_)
    for share in (-1.0, -0.3, 0.0, 0.7, 1.0):
        assert pwm.signed_from_pwm(pwm.pwm_from_signed(share)) == pytest.approx(share, abs=1e-12)
        part = abs(share)
        assert pwm.unsigned_from_pwm(pwm.pwm_from_unsigned(part)) == pytest.approx(part, abs=1e-12)
    assert pwm.pwm_from_signed(1.0) == pwm.pwm_from_unsigned(1.0) == (1100 if reversed_ else 1950)
    assert pwm.pwm_from_signed(math.nan) == 1100
    assert pwm.pwm_from_unsigned(0.0) == (1950 if reversed_ else 1100)


def pulses(scaling, roll, pitch, throttle):
    return scaling.pulses(FbwaCommand(roll=roll, pitch=pitch, throttle=throttle))


@pytest.mark.parametrize("scale", [EVEN, WORN], ids=["even", "worn"])
def test_pulses_and_commands_are_inverse(scale):
    rng = named_stream(11, "links")
    for _ in range(200):
        roll = rng.uniform(-LIMITS.roll, LIMITS.roll)
        pitch = rng.uniform(LIMITS.pitch_min, LIMITS.pitch_max)
        throttle = rng.uniform()
        one, two, three = pulses(scale, roll, pitch, throttle)
        back = (scale.roll_angle(one), scale.pitch_angle(two), scale.throttle_share(three))
        assert back == pytest.approx((roll, pitch, throttle), abs=1e-12)


def test_command_beyond_limits_is_clamped():
    assert pulses(WORN, 2.0, 2.0, 2.0) == (1950, 1900, 1930)
    assert pulses(WORN, -2.0, -2.0, -2.0) == (1100, 1050, 1010)
    assert LIMITS.clamp(2.0, -2.0) == (LIMITS.roll, LIMITS.pitch_min)
    assert LIMITS.clamp(-0.1, 0.1) == (-0.1, 0.1)


def test_empty_range_gives_neutral_command():
    stuck = RcScaling(
        PwmRange(1500, 1500, 1500), PwmRange(1500, 1500, 1500), PwmRange(1, 1, 1), LIMITS
    )
    for pulse_us in (1000, 1500, 2000):
        assert stuck.roll_angle(pulse_us) == stuck.pitch_angle(pulse_us) == 0.0
        assert stuck.throttle_share(pulse_us) == 0.0
    still = EVEN._replace(limits=AngleLimits(0.0, 0.0, 0.0))
    assert pulses(still, 0.3, -0.3, 0.5) == (1500, 1500, 1500)


def test_scaling_from_parameters_or_defaults():
    assert rc_scaling({}) == RcScaling(
        PwmRange(1000, 1500, 2000),
        PwmRange(1000, 1500, 2000),
        PwmRange(1000, 1500, 2000),
        AngleLimits(*np.radians([45.0, 20.0, -25.0])),
    )
    args = {"RC2_MIN": 1050.0, "RC2_TRIM": 1530.0, "RC2_MAX": 1900.0, "ROLL_LIMIT_DEG": 50.0}
    args |= {"PTCH_LIM_MAX_DEG": 20.0, "PTCH_LIM_MIN_DEG": -15.0}
    assert rc_scaling(args) == EVEN._replace(pitch=WORN.pitch)

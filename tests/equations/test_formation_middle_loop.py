"""The middle loop, [HBH23] eqs. (19)-(21): worked arithmetic, limits and anti-windup."""

import numpy as np
import pytest
from formation_cases import middle_gains

from testbed.formation.flags import Saturation
from testbed.formation.middle_loop import MiddleLoopMemory, middle_loop, zero_memory

DT = 0.04
# Straight and level at trim: every error is zero.
CALM = {
    "climb": 0.0,
    "climb_rate": 0.0,
    "climb_desired": 0.0,
    "climb_rate_desired": 0.0,
    "course": 0.0,
    "course_rate": 0.0,
    "course_desired": 0.0,
    "course_rate_desired": 0.0,
    "speed": 20.0,
    "bank": 0.0,
    "airspeed": 22.0,
    "airspeed_command": 22.0,
    "airspeed_error": 0.0,
}


def step(memory=None, gains=None, **changes):
    """One step of one agent: pitch, roll, throttle, integrals, flags."""
    values = {name: np.array([value]) for name, value in {**CALM, **changes}.items()}
    command, integrals, flags = middle_loop(
        memory or zero_memory(1), gains or middle_gains(1), DT, **values
    )
    assert flags.dtype == np.uint8
    return command, integrals, Saturation(int(flags[0]))


def integrals(climb=0.0, course=0.0, speed=0.0):
    return MiddleLoopMemory(np.array([climb]), np.array([course]), np.array([speed]))


def test_nothing_to_do_is_trim():
    command, memory, flags = step()
    assert (command.pitch[0], command.roll[0], command.throttle[0]) == (0.0, 0.0, 0.22)
    assert memory == zero_memory(1)
    assert not flags


def test_19_by_hand():
    # 0.10 − 1.5 (0.04 − 0.10) − 0.2·0.3 − 0.1 (0.05 − 0.02) = 0.10 + 0.09 − 0.06 − 0.003
    command, memory, _ = step(
        integrals(climb=0.3),
        climb=0.04,
        climb_desired=0.10,
        climb_rate=0.05,
        climb_rate_desired=0.02,
    )
    assert command.pitch[0] == pytest.approx(0.127, abs=1e-15)
    assert memory.climb[0] == pytest.approx(0.3 - 0.04 * 0.06, abs=1e-16)


def test_20_by_hand():
    # tan φ = 0.1·20·cos(0.2)/9.81; then − 4 (0.02 − 0.05) − 0.02·1.5 − 0.5 (0.08 − 0.10)
    command, memory, _ = step(
        integrals(course=1.5),
        climb=0.2,
        climb_desired=0.2,
        course=0.02,
        course_desired=0.05,
        course_rate=0.08,
        course_rate_desired=0.10,
    )
    turning = np.arctan(2.0 * 0.9800665778 / 9.81)
    assert command.roll[0] == pytest.approx(turning + 0.12 - 0.03 + 0.01, abs=1e-10)
    assert memory.course[0] == pytest.approx(1.5 - 0.04 * 0.03, abs=1e-15)


def test_a_steady_turn_needs_no_feedback():
    # tan φ = V σ̇/g: 120 m radius at 22 m/s is 22.35°
    command, _, _ = step(speed=22.0, course_rate=22.0 / 120.0, course_rate_desired=22.0 / 120.0)
    assert np.degrees(command.roll[0]) == pytest.approx(22.35, abs=0.01)


def test_21_by_hand():
    # 0.22 + 0.12 (1/cos² 60° − 1) + 0.1 (24 − 22) − 0.15·(−0.4) − 0.02·3
    command, memory, _ = step(
        integrals(speed=3.0), bank=np.pi / 3.0, airspeed_command=24.0, airspeed_error=-0.4
    )
    assert command.throttle[0] == pytest.approx(0.22 + 0.36 + 0.2 + 0.06 - 0.06, abs=1e-14)
    assert memory.speed[0] == pytest.approx(3.0 - 0.04 * 0.4, abs=1e-15)


def test_the_course_error_takes_the_short_way_round():
    # 179° and −179° are 2° apart, whichever is which
    near, far = np.radians(179.0), np.radians(-179.0)
    command, memory, _ = step(course=near, course_desired=far)
    assert command.roll[0] == pytest.approx(4.0 * np.radians(2.0), abs=1e-14)
    assert memory.course[0] == pytest.approx(-0.04 * np.radians(2.0), abs=1e-15)
    command, _, _ = step(course=far, course_desired=near)
    assert command.roll[0] == pytest.approx(-4.0 * np.radians(2.0), abs=1e-14)


CASES = {  # of each command its integral, its flag, its limits, and the error that lowers it
    "pitch": ("climb", Saturation.PITCH, -np.pi / 9.0, np.pi / 9.0, "climb"),
    "roll": ("course", Saturation.ROLL, -5 * np.pi / 18, 5 * np.pi / 18, "course"),
    "throttle": ("speed", Saturation.THROTTLE, 0.0, 1.0, "airspeed_error"),
}


@pytest.mark.parametrize("channel", CASES)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_commands_saturate_and_their_integrals_wait(channel, sign):
    integral, flag, low, high, error = CASES[channel]
    size = 10.0 if channel == "throttle" else 0.5
    command, memory, flags = step(**{error: -sign * size})
    assert getattr(command, channel)[0] == (high if sign > 0.0 else low)
    assert flags == flag
    assert getattr(memory, integral)[0] == 0.0  # it would have pushed further


@pytest.mark.parametrize("channel", CASES)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_integral_that_holds_a_command_at_its_limit_unwinds(channel, sign):
    integral, flag, low, high, error = CASES[channel]
    wound = integrals(**{integral: -sign * 1000.0})
    command, memory, flags = step(wound, **{error: sign * 0.01})
    assert getattr(command, channel)[0] == (high if sign > 0.0 else low)
    assert flags == flag
    assert getattr(memory, integral)[0] == pytest.approx(sign * (-1000.0 + 0.04 * 0.01), abs=1e-12)


def test_flags_add_up():
    _, _, flags = step(climb=-1.0, course=-1.0, airspeed_error=20.0)
    assert flags == Saturation.PITCH | Saturation.ROLL | Saturation.THROTTLE


def test_the_derivative_acts_on_the_error_of_the_rate():
    # a rate that is as desired costs nothing, however large
    command, _, _ = step(climb_rate=0.3, climb_rate_desired=0.3)
    assert command.pitch[0] == 0.0

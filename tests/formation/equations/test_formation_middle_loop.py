"""The middle loop, [HBH23] eqs. (19)-(21): worked arithmetic, limits, filters and anti-windup."""

import numpy as np
import pytest
from formation_cases import (
    DT,
    HIGH,
    LOW,
    choose,
    leaves,
    make_middle,
    middle,
    middle_states,
    results,
)
from reference.formation_middle_loop import MiddleLoopMemory
from reference.frames import velocity_frame

from testbed.core.flags import LimiterFlag, Saturation
from testbed.core.records import UnicycleCommand, VehicleState
from testbed.formation.middle_loop import initial_memory

# Straight and level at trim: every error is zero.
CALM = {
    "gamma": 0.0,
    "gamma_dot": 0.0,
    "gamma_desired": 0.0,
    "gamma_dot_desired": 0.0,
    "course": 0.0,
    "chi_dot": 0.0,
    "course_desired": 0.0,
    "chi_dot_desired": 0.0,
    "speed": 20.0,
    "bank": 0.0,
    "attitude": 0.0,
    "altitude": 100.0,
    "airspeed": 22.0,
    "airspeed_command": 22.0,
    "limiter_flags": 0,
}


def along(gamma, course):
    return np.array(
        [[np.cos(gamma) * np.cos(course), np.cos(gamma) * np.sin(course), -np.sin(gamma)]]
    )


def flying(**changes):
    """The state and the command of one agent that flies like this."""
    it = {**CALM, **changes}
    velocity = it["speed"] * along(it["gamma"], it["course"])
    (_, right, down) = velocity_frame(velocity)[0].T
    turning = it["chi_dot"] * np.cos(it["gamma"]) * right - it["gamma_dot"] * down
    own = VehicleState(
        position_ned=np.array([[0.0, 0.0, -it["altitude"]]]),
        velocity_ned=velocity,
        acceleration_ned=it["speed"] * turning[None],
        euler=np.array([[it["bank"], it["attitude"], 0.0]]),
        rates_body=np.zeros((1, 3)),
        airspeed=np.array([it["airspeed"]]),
        equivalent_airspeed=np.array([it["airspeed"]]),
    )
    yawing = it["chi_dot_desired"] * np.cos(it["gamma"])
    inputs = UnicycleCommand(
        speed=np.array([it["airspeed_command"] - it["airspeed"] + it["speed"]]),
        omega=np.array([[0.0, it["gamma_dot_desired"], yawing]]),
        speed_desired=np.array([21.5]),
        direction=along(it["gamma_desired"], it["course_desired"]),
        limiter_flags=np.array([it["limiter_flags"]], dtype=np.uint8),
    )
    return own, inputs


def run(middle, memory=None, loop=None, **changes):
    """One step of one agent: pitch, roll, throttle, memory, flags."""
    loop = loop or make_middle(1)
    command, after, diagnosis = middle(loop, *flying(**changes), memory or loop.start())
    assert diagnosis.saturations.dtype == diagnosis.limiter_flags.dtype == np.uint8
    return command, after, Saturation(int(diagnosis.saturations[0]))


def integrals(**args):
    memory = make_middle(1).start()
    return memory._replace(**{name: np.array([value]) for name, value in args.items()})


def test_nothing_to_do_is_trim():
    command, memory, flags = run(middle)
    assert (command.pitch[0], command.roll[0], command.throttle[0]) == (0.0, 0.0, 0.22)
    assert all(float(value[0]) == 0.0 for value in memory)
    assert not flags


def test_19_by_hand():
    # 0.10 − 1.5 (0.04 − 0.10) − 0.2·0.3 − 0.1 (0.05 − 0.02) = 0.10 + 0.09 − 0.06 − 0.003
    command, memory, _ = run(
        middle,
        integrals(gamma=0.3),
        gamma=0.04,
        gamma_desired=0.10,
        gamma_dot=0.05,
        gamma_dot_desired=0.02,
    )
    assert command.pitch[0] == pytest.approx(0.127, abs=1e-15)
    assert memory.gamma[0] == pytest.approx(0.3 - 0.04 * 0.06, abs=1e-16)


def test_20_by_hand():
    # tan φ = 0.1·20·cos(0.2)/9.81; then − 4 (0.02 − 0.05) − 0.02·1.5 − 0.5 (0.08 − 0.10)
    command, memory, _ = run(
        middle,
        integrals(course=1.5),
        gamma=0.2,
        gamma_desired=0.2,
        course=0.02,
        course_desired=0.05,
        chi_dot=0.08,
        chi_dot_desired=0.10,
    )
    turning = np.arctan(2.0 * 0.9800665778 / 9.81)
    assert command.roll[0] == pytest.approx(turning + 0.12 - 0.03 + 0.01, abs=1e-10)
    assert memory.course[0] == pytest.approx(1.5 - 0.04 * 0.03, abs=1e-15)


def test_a_steady_turn_needs_no_feedback():
    # tan φ = V σ̇/g: 120 m radius at 22 m/s is 22.35°
    turn = 22.0 / 120.0
    command, _, _ = run(middle, speed=22.0, chi_dot=turn, chi_dot_desired=turn)
    assert np.degrees(command.roll[0]) == pytest.approx(22.35, abs=0.01)


def test_21_by_hand():
    # 0.22 + 0.12 (1/cos² 60° − 1) + 0.1 (24 − 22) − 0.15·(−0.4) − 0.02·3
    command, memory, _ = run(
        middle, integrals(speed=3.0), bank=np.pi / 3.0, airspeed=23.6, airspeed_command=24.0
    )
    assert command.throttle[0] == pytest.approx(0.22 + 0.36 + 0.2 + 0.06 - 0.06, abs=1e-14)
    assert memory.speed[0] == pytest.approx(3.0 - 0.04 * 0.4, abs=1e-15)


def test_the_course_error_takes_the_short_way_round():
    # 179° and −179° are 2° apart, whichever is which
    near, far = np.radians(179.0), np.radians(-179.0)
    command, memory, _ = run(middle, course=near, course_desired=far)
    assert command.roll[0] == pytest.approx(4.0 * np.radians(2.0), abs=1e-14)
    assert memory.course[0] == pytest.approx(-0.04 * np.radians(2.0), abs=1e-15)
    command, _, _ = run(middle, course=far, course_desired=near)
    assert command.roll[0] == pytest.approx(-4.0 * np.radians(2.0), abs=1e-14)


# saturation


# of each command its integral, its flag, its limits, and the error that lowers it
CASES = {
    "pitch": ("gamma", Saturation.PITCH, -np.pi / 9.0, np.pi / 9.0, "gamma"),
    "roll": ("course", Saturation.ROLL, -5 * np.pi / 18, 5 * np.pi / 18, "course"),
    "throttle": ("speed", Saturation.THROTTLE, 0.0, 1.0, "airspeed"),
}
HELD = make_middle(1, altitude_p=0.026, altitude_i=0.0017, altitude_d=0.0105, altitude=100.0)
HOLDING = ("altitude", Saturation.PITCH, -np.pi / 9.0, np.pi / 9.0, "altitude")


def saturating(channel):
    if channel == "altitude":
        return "pitch", HELD, *HOLDING
    return channel, make_middle(1), *CASES[channel]


every_channel = pytest.mark.parametrize("channel", [*CASES, "altitude"])
LARGE = {"airspeed": 10.0, "altitude": 50.0, "gamma": 0.5, "course": 0.5}


@every_channel
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_commands_saturate_and_their_integrals_wait(channel, sign):
    channel, loop, integral, flag, low, high, error = saturating(channel)
    wrong = {error: CALM[error] - sign * LARGE[error]}
    command, memory, flags = run(middle, loop=loop, **wrong)
    assert getattr(command, channel)[0] == (high if sign > 0.0 else low)
    assert flags == flag
    assert getattr(memory, integral)[0] == 0.0  # it would have pushed further


@every_channel
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_integral_at_a_command_limit_unwinds(channel, sign):
    channel, loop, integral, flag, low, high, error = saturating(channel)
    wound = integrals(**{integral: -sign * 1000.0})
    command, memory, flags = run(middle, wound, loop, **{error: CALM[error] + sign * 0.01})
    assert getattr(command, channel)[0] == (high if sign > 0.0 else low)
    assert flags == flag
    assert getattr(memory, integral)[0] == pytest.approx(sign * (-1000.0 + 0.04 * 0.01), abs=1e-12)


def test_flags_add_up():
    _, _, flags = run(middle, gamma=-1.0, course=-1.0, airspeed=42.0)
    assert flags == Saturation.PITCH | Saturation.ROLL | Saturation.THROTTLE


def test_saturated_commands_are_flagged():
    rng = np.random.default_rng(34)
    command, _, diagnosis = middle(make_middle(200, roll_limit=0.3), *middle_states(200, rng))
    rolled = (diagnosis.saturations & Saturation.ROLL) != 0
    assert (rolled == (abs(command.roll) == 0.3)).all()
    assert 0 < rolled.sum() < 200


def test_the_derivative_acts_on_the_error_of_the_rate():
    # a rate that is as desired costs nothing, however large
    command, _, _ = run(middle, gamma_dot=0.3, gamma_dot_desired=0.3)
    assert command.pitch[0] == pytest.approx(0.0, abs=1e-16)


# the guard on the commanded airspeed


def test_the_commanded_airspeed_stays_in_the_bounds():
    rng = np.random.default_rng(25)
    own, inputs, memory = middle_states(400, rng)
    _, _, diagnosis = middle(make_middle(400), own, inputs, memory)
    wanted = inputs.speed + own.airspeed - np.linalg.norm(own.velocity_ned, axis=1)
    assert diagnosis.airspeed_command == pytest.approx(np.clip(wanted, LOW, HIGH), abs=1e-12)
    assert diagnosis.airspeed_command.min() == LOW and diagnosis.airspeed_command.max() == HIGH
    clipped = (diagnosis.limiter_flags & LimiterFlag.SPEED_COMMAND_CLIPPED) != 0
    at_bound = (diagnosis.airspeed_command == LOW) | (diagnosis.airspeed_command == HIGH)
    assert (clipped == at_bound).all()
    assert 0 < clipped.sum() < 400
    # the flags of the law are kept
    assert (
        diagnosis.limiter_flags & ~LimiterFlag.SPEED_COMMAND_CLIPPED == inputs.limiter_flags
    ).all()
    assert np.array_equal(diagnosis.speed_desired, inputs.speed_desired)


def test_the_command_is_what_throttle_flies():
    # at a command of 40 m/s both parts of (21) see the bound of 30
    gentle = make_middle(1, speed_p=0.01, eta_speed=0.02)
    command, memory, _ = run(middle, loop=gentle, airspeed=29.0, airspeed_command=40.0)
    assert command.throttle[0] == pytest.approx(0.22 + 0.02 * 8.0 + 0.01 * 1.0, abs=1e-15)
    assert memory.speed[0] == pytest.approx(-0.04, abs=1e-15)


@pytest.mark.parametrize("wind", [0.0, 5.0])
def test_the_two_readings_of_21_differ_by_the_wind(wind):
    """As printed, s_a − u asks for u in the air; the other asks for u over the ground."""
    p_only = {"speed_i": 0.0, "speed_p": 0.01, "eta_speed": 0.0, "eta_bank": 0.0}
    flight = {"airspeed": 20.0 + wind, "airspeed_command": 21.0 + wind}
    ground, _, _ = run(middle, loop=make_middle(1, **p_only), **flight)
    printed, _, _ = run(middle, loop=make_middle(1, as_printed=True, **p_only), **flight)
    assert ground.throttle[0] == pytest.approx(0.22 + 0.01, abs=1e-14)
    # s_a − u = s − u + wind
    assert printed.throttle[0] == pytest.approx(0.22 + 0.01 - 0.01 * wind, abs=1e-14)


# what the paper has not


def test_the_altitude_hold_by_hand():
    # 4 m too high, climbing 20 sin 0.1: − 0.026·4 − 0.0017·2 − 0.0105·20 sin 0.1
    command, memory, flags = run(middle, integrals(altitude=2.0), HELD, altitude=104.0, gamma=0.1)
    sinking = -0.026 * 4.0 - 0.0017 * 2.0 - 0.0105 * 20.0 * np.sin(0.1)
    assert command.pitch[0] == pytest.approx(sinking, abs=1e-15)
    assert memory.altitude[0] == pytest.approx(2.0 + 0.04 * 4.0, abs=1e-14)
    assert not flags


def test_altitude_hold_ignores_the_laws_pitch():
    """What the law says of climbing changes no pitch, and its integral of (19) stays at rest."""
    calm, memory, _ = run(middle, integrals(gamma=0.7), HELD, altitude=103.0)
    asked, _, _ = run(
        middle,
        integrals(gamma=0.7),
        HELD,
        altitude=103.0,
        gamma_desired=0.3,
        gamma_dot_desired=0.2,
    )
    assert asked.pitch[0] == calm.pitch[0] == pytest.approx(-0.026 * 3.0, abs=1e-15)
    assert memory.gamma[0] == 0.0
    # without altitude hold its integral stays zero
    _, memory, _ = run(middle, integrals(altitude=3.0))
    assert memory.altitude[0] == 3.0


def test_the_incidence_is_fed_forward():
    # θ = γ + 3°: the pitch that is held is the pitch that is asked for, and errors come on top
    loop = make_middle(1, incidence=1.0)
    attitude = 0.1 + np.radians(3.0)
    level = {"gamma": 0.1, "gamma_desired": 0.1, "attitude": attitude}
    command, _, _ = run(middle, loop=loop, **level)
    assert command.pitch[0] == pytest.approx(attitude, abs=1e-15)
    command, _, _ = run(middle, loop=loop, **{**level, "gamma_desired": 0.15})
    assert command.pitch[0] == pytest.approx(attitude + 0.05 + 1.5 * 0.05, abs=1e-15)


def test_a_bank_takes_more_incidence():
    # 60° of bank is one load factor more than level
    loop = make_middle(1, turn_incidence=np.radians(4.0))
    command, _, _ = run(middle, loop=loop, bank=-np.pi / 3.0)
    assert command.pitch[0] == pytest.approx(np.radians(4.0), abs=1e-14)


def test_a_climb_takes_more_throttle():
    # 0.4 of throttle per sine of the angle that is asked for, whatever is flown
    loop = make_middle(1, eta_climb=0.4)
    command, _, _ = run(middle, loop=loop, gamma_desired=np.pi / 6.0, gamma=0.5)
    assert command.throttle[0] == pytest.approx(0.22 + 0.2, abs=1e-15)


def bank_of(turn, speed=20.0):
    return np.arctan(turn * speed / 9.81)


@pytest.mark.parametrize("time_constant", [0.0, 0.12])
def test_the_bank_of_a_turn_is_led(time_constant):
    """By hand: the first step knows no rate, the second takes its filtered part of it."""
    loop = make_middle(1, roll_lead=0.5, lead_filter=time_constant, course_d=0.0)
    command, memory, _ = run(middle, loop=loop, chi_dot_desired=0.10)
    assert command.roll[0] == pytest.approx(bank_of(0.10), abs=1e-15)
    assert memory.turn_bank_rate[0] == 0.0
    command, memory, _ = run(middle, memory, loop, chi_dot_desired=0.11)
    part = DT / (DT + time_constant)
    rate = part * (bank_of(0.11) - bank_of(0.10)) / DT
    assert memory.turn_bank_rate[0] == pytest.approx(rate, abs=1e-14)
    assert command.roll[0] == pytest.approx(bank_of(0.11) + 0.5 * rate, abs=1e-14)
    command, memory, _ = run(middle, memory, loop, chi_dot_desired=0.11)
    assert memory.turn_bank_rate[0] == pytest.approx((1.0 - part) * rate, abs=1e-14)


def test_a_lead_is_the_turn_of_later():
    """A bank that grows steadily is commanded as it will be roll_lead later."""
    lead, roll_rate = 0.3, 0.4
    loop = make_middle(1, roll_lead=lead, lead_filter=0.1, course_d=0.0)
    memory = loop.start()
    for k in range(60):
        turn = 9.81 / 20.0 * np.tan(roll_rate * k * DT)
        command, memory, _ = run(middle, memory, loop, chi_dot_desired=turn)
        if k == 30:
            # the initial state of the filter has decayed to (0.1/0.14)^30, some 4e-5
            later = roll_rate * (k * DT + lead)
            assert command.roll[0] == pytest.approx(later, abs=1e-5)


def test_measured_rates_are_averaged_from_the_first_on():
    # 0.04/(0.04 + 0.06) of a new sample
    loop = make_middle(1, rate_filter=0.06)
    _, memory, _ = run(middle, loop=loop, chi_dot=0.2, gamma_dot=-0.1)
    assert (memory.chi_dot[0], memory.gamma_dot[0]) == pytest.approx((0.2, -0.1), abs=1e-15)
    command, memory, _ = run(middle, memory, loop, chi_dot=0.3, gamma_dot=0.1)
    assert memory.chi_dot[0] == pytest.approx(0.6 * 0.2 + 0.4 * 0.3, abs=1e-15)
    assert memory.gamma_dot[0] == pytest.approx(-0.6 * 0.1 + 0.4 * 0.1, abs=1e-15)
    assert command.roll[0] == pytest.approx(-0.5 * 0.24, abs=1e-15)
    assert command.pitch[0] == pytest.approx(-0.1 * -0.02, abs=1e-15)


def test_without_a_filter_rates_are_those_measured_now():
    memory = integrals(chi_dot=5.0, gamma_dot=-5.0)
    _, memory, _ = run(middle, memory, chi_dot=0.3, gamma_dot=0.1)
    assert (memory.chi_dot[0], memory.gamma_dot[0]) == pytest.approx((0.3, 0.1), abs=1e-15)


# agents


def test_middle_loop_starts_with_zero_integrals():
    begun = ("gamma", "course", "speed", "altitude", "turn_bank_rate")
    records = initial_memory(3)
    for name in MiddleLoopMemory._fields:
        for value in (getattr(make_middle(3).start(), name), records[name]):
            assert value.shape == (3,)
            assert (value == 0.0).all() if name in begun else np.isnan(value).all(), name


def mixed(n, rng):
    holds = np.where(rng.random(n) < 0.4, rng.normal(0.0, 10.0, n), np.nan)
    extras = ("altitude_p", "altitude_i", "altitude_d", "turn_incidence", "roll_lead", "eta_climb")
    more = {name: rng.uniform(0.0, 0.1, n) for name in extras}
    more["course_inside"] = rng.integers(0, 2, n)
    return make_middle(n, altitude=holds, rate_filter=rng.uniform(0.0, 0.1, n), **more)


def test_an_agent_alone_is_the_same_agent_in_a_crowd():
    rng = np.random.default_rng(29)
    loop, args = mixed(7, rng), middle_states(7, rng)
    together = results(middle(loop, *args))
    for i in range(7):
        alone = results(middle(choose(loop, [i]), *(choose(each, [i]) for each in args)))
        for name, array in alone.items():
            np.testing.assert_array_equal(array[0], together[name][i], err_msg=name)


def test_step_does_not_write_its_arguments():
    rng = np.random.default_rng(31)
    args = (mixed(4, rng), *middle_states(4, rng))
    before = [{name: np.copy(a) for name, a in leaves(record)} for record in args]
    middle(*args)
    for record, copies in zip(args, before, strict=True):
        for name, array in leaves(record):
            np.testing.assert_array_equal(array, copies[name], err_msg=name)

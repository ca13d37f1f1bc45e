"""Fly-by-wire A and its parameters: worked arithmetic, limits, and a plain second route."""

import math
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cases import ALL, in_full
from places import ROOT
from reference import adapters
from reference import fbwa as reference
from reference.adapters import reference_gains
from reference.fbwa import fresh
from reference.fbwa_tables import MEMORY
from scipy import signal

from testbed.autopilot.fbwa import fly_by_wire_a, initial_autopilots, settled_autopilots
from testbed.autopilot.parameters import (
    RANGES,
    AutopilotTiming,
    FbwaParams,
    ParamError,
    make_gains,
    ramp_invariant_butterworth,
    read_params,
    sitl_gyro_cutoff,
    unusual_values,
    with_param,
)
from testbed.core.records import (
    AIRCRAFT,
    ActuatorCommand,
    FbwaCommand,
    VehicleState,
    allocate,
    write_fields,
)
from testbed.scenario import library

DT = 0.02
PROMPT = AutopilotTiming(command_latency=0.0)
# Unfiltered, whole servo travel, scaled at the speed flown: numbers that can be followed by hand.
PLAIN = FbwaParams(
    airspeed_min=10.0,
    airspeed_max=30.0,
    scaling_speed=20.0,
    roll_limit_deg=50.0,
    ptch_lim_min_deg=-20.0,
    trim_throttle=50.0,
    rll_rate_fltt=0.0,
    rll_rate_fltd=0.0,
    ptch_rate_fltt=0.0,
    ptch_rate_fltd=0.0,
    rll_rate_p=0.0,
    rll_rate_i=0.0,
    rll_rate_ff=0.3,
    ptch_rate_p=0.0,
    ptch_rate_i=0.0,
    ptch_rate_ff=0.4,
    servo1_min=1000.0,
    servo1_max=2000.0,
    servo2_min=1000.0,
    servo2_max=2000.0,
    servo4_min=1000.0,
    servo4_max=2000.0,
    ins_gyro_filter=0.0,
)


def _state(
    roll: float = 0.0, pitch: float = 0.0, p: float = 0.0, q: float = 0.0, eas: float = 20.0
) -> VehicleState:
    zero = np.zeros((1, 3))
    return VehicleState(
        position_ned=zero,
        velocity_ned=zero,
        acceleration_ned=zero,
        euler=np.radians([[roll, pitch, 0.0]]),
        rates_body=np.radians([[p, q, 0.0]]),
        airspeed=np.array([eas * 1.02]),
        equivalent_airspeed=np.array([eas]),
    )


def _command(roll: float = 0.0, pitch: float = 0.0, throttle: float = 0.5) -> FbwaCommand:
    return FbwaCommand(np.radians([pitch]), np.radians([roll]), np.array([throttle]))


def _once(params: FbwaParams, state: VehicleState, command: FbwaCommand) -> ActuatorCommand:
    return adapters.fbwa(state, command, fresh(1), gains=make_gains([params], DT, PROMPT))[0]


def _flown(*, guided: bool, down_deg: float, throttle: float) -> list[float]:
    """Return the surfaces of one period, with STAB_PITCH_DOWN, deg."""
    params = replace(PLAIN, stab_pitch_down=down_deg, trim_throttle=40.0)
    autopilots = initial_autopilots(make_gains([params], DT, PROMPT))
    aircraft = allocate(AIRCRAFT, 1)
    write_fields(aircraft["estimate"], _state())
    write_fields(aircraft["command"], _command(pitch=3.0, throttle=throttle))
    aircraft["guided"] = guided
    fly_by_wire_a(np.arange(1), *autopilots, aircraft)
    return list(aircraft["surfaces"][0])


def test_guided_does_not_lower_the_nose() -> None:
    """By STAB_PITCH_DOWN, which FBWA does below the trim throttle."""
    given = {"guided": True, "down_deg": 4.0, "throttle": 0.1}
    assert _flown(**given) == _flown(**given | {"guided": False, "down_deg": 0.0})
    assert _flown(**given) != _flown(**given | {"guided": False})
    # above the trim throttle both are the same
    given["throttle"] = 0.5
    assert _flown(**given) == _flown(**given | {"guided": False})


def test_feed_forward_by_hand() -> None:
    # 10° to go at 0.5 s: 20 °/s; × 0.3 / EAS2TAS 1.02 = 5.882 of 45 degrees of aileron.
    surfaces = _once(PLAIN, _state(roll=5.0), _command(roll=15.0))
    assert surfaces.aileron[0] == pytest.approx(20.0 * 0.3 / 1.02 / 45.0, rel=1e-12)
    # Rudder: half the aileron.
    assert surfaces.rudder[0] == pytest.approx(0.5 * surfaces.aileron[0])


def test_gains_scale_with_airspeed() -> None:
    slow, fast = _state(p=-10.0, eas=16.0), _state(p=-10.0, eas=25.0)
    hold = _command()
    p_only = replace(PLAIN, rll_rate_ff=0.0, rll_rate_p=0.2)
    # Target 0, rate −10 °/s: P × 10 × s², s = 20/EAS.
    assert _once(p_only, slow, hold).aileron[0] == pytest.approx(0.2 * 10 * (20 / 16) ** 2 / 45)
    assert _once(p_only, fast, hold).aileron[0] == pytest.approx(0.2 * 10 * (20 / 25) ** 2 / 45)
    roll = _command(roll=10.0)
    ratio = _once(PLAIN, slow, roll).aileron[0] / _once(PLAIN, fast, roll).aileron[0]
    assert ratio == pytest.approx(25.0 / 16.0)


def test_speed_scaler_stays_in_its_limits() -> None:
    # Highest: max(2, 20/(0.7·10)) = 2.857; lowest: min(0.5, 20/60) = 1/3.
    p_only = replace(PLAIN, rll_rate_ff=0.0, rll_rate_p=0.02)
    slow, fast = _state(p=-10.0, eas=2.0), _state(p=-10.0, eas=100.0)
    assert _once(p_only, slow, _command()).aileron[0] == pytest.approx(0.2 * (2 / 0.7) ** 2 / 45)
    assert _once(p_only, fast, _command()).aileron[0] == pytest.approx(0.2 / 9.0 / 45)


def test_low_throttle_lowers_the_nose() -> None:
    # 30 % of 50 %: 2° × 20/50 = 0.8° off a 2° command, at 0.5 s: 2.4 °/s.
    surfaces = _once(PLAIN, _state(), _command(pitch=2.0, throttle=0.3))
    assert surfaces.elevator[0] == pytest.approx(1.2 / 0.5 * 0.4 / 1.02 / 45.0)
    assert surfaces.throttle[0] == 0.3


def test_sticks_are_limited() -> None:
    assert _once(PLAIN, _state(roll=50.0), _command(roll=80.0)).aileron[0] == pytest.approx(0.0)
    up = _once(replace(PLAIN, ptch2srv_rll=0.0), _state(pitch=20.0), _command(pitch=60.0))
    assert up.elevator[0] == pytest.approx(0.0)
    limited = replace(PLAIN, thr_max=75.0)
    assert _once(limited, _state(), _command(throttle=1.0)).throttle[0] == 0.75
    assert _once(limited, _state(), _command(throttle=-1.0)).throttle[0] == 0.0


def test_roll_demand_shrinks_with_pitch() -> None:
    """The stick commands a share of ROLL_LIMIT_DEG cos θ; at 60° of pitch that is half."""
    level = _once(PLAIN, _state(), _command(roll=20.0))
    steep = _once(PLAIN, _state(pitch=60.0), _command(roll=20.0))
    assert steep.aileron[0] == pytest.approx(0.5 * level.aileron[0])
    limit = _once(PLAIN, _state(roll=25.0, pitch=60.0), _command(roll=80.0))
    assert limit.aileron[0] == pytest.approx(0.0, abs=1e-12)


def test_nose_down_demand_shrinks_with_bank() -> None:
    """The stick commands a share of PTCH_LIM_MIN_DEG cos φ; up, of PTCH_LIM_MAX_DEG."""
    flat = replace(PLAIN, ptch2srv_rll=0.0, roll_limit_deg=70.0)

    def elevator(pitch: float, command: float, throttle: float = 0.5) -> float:
        state, wanted = _state(roll=-60.0, pitch=pitch), _command(-60.0, command, throttle)
        return float(_once(flat, state, wanted).elevator[0])

    assert elevator(-5.0, -10.0) == pytest.approx(0.0, abs=1e-12)
    assert elevator(10.0, 10.0) == pytest.approx(0.0, abs=1e-12)
    # STAB_PITCH_DOWN comes after it: −10° cos 60° − 1°; and the limit after that: −20° cos 60°
    assert elevator(-6.0, -10.0, throttle=0.25) == pytest.approx(0.0, abs=1e-12)
    assert elevator(-10.0, -20.0, throttle=0.0) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("eas", "limit"),
    [
        (9.0, 25.0),  # too slow for any load factor
        (10.2, 25.0),  # acos(1/1.0404) = 16°, never below 25°
        (12.0, math.degrees(math.acos(1.0 / 1.44))),  # 46.0°
        (20.0, 50.0),  # n = 4: 75°, so ROLL_LIMIT_DEG
    ],
)
def test_load_factor_limits_the_bank(eas: float, limit: float) -> None:
    at_limit = _once(PLAIN, _state(roll=limit, eas=eas), _command(roll=89.0))
    assert at_limit.aileron[0] == pytest.approx(0.0, abs=1e-12)
    stalls_at_8 = replace(PLAIN, airspeed_stall=8.0)
    more = _once(stalls_at_8, _state(roll=limit, eas=eas), _command(roll=-89.0))
    assert more.aileron[0] < 0.0


def test_turns_are_coordinated_in_pitch() -> None:
    # q = g/V tan φ sin φ cos θ at 40°, 5°: 9.80665/20.4 · 0.83910 · 0.64279 · 0.99619 rad/s.
    level = _once(PLAIN, _state(roll=40.0, pitch=5.0), _command(roll=40.0, pitch=5.0))
    rate = math.degrees(9.80665 / 20.4 * 0.8390996 * 0.6427876 * 0.9961947)
    assert level.elevator[0] == pytest.approx(rate * 0.4 / 1.02 / 45.0, rel=1e-6)


def test_pitch_is_given_up_beyond_the_roll_limit() -> None:
    def elevator(roll: float) -> float:
        wanted = _command(roll=roll, pitch=10.0)
        return float(_once(replace(PLAIN, ptch2srv_rll=0.0), _state(roll=roll), wanted).elevator[0])

    assert elevator(55.0) == pytest.approx(elevator(0.0))
    assert elevator(72.5) == pytest.approx(0.5 * elevator(0.0))  # half way from 55° to 90°
    assert elevator(90.0) == pytest.approx(0.0, abs=1e-12)


def test_pitch_fades_from_85_degrees_at_most() -> None:
    """As in ArduPlane, with a roll limit of 83°, and only below 70° of pitch."""
    params = replace(PLAIN, roll_limit_deg=83.0, ptch2srv_rll=0.0, ptch_lim_max_deg=80.0)

    def elevator(roll: float, pitch: float) -> float:
        state, wanted = _state(roll=roll, pitch=pitch), _command(roll=roll, pitch=pitch + 5.0)
        return float(_once(params, state, wanted).elevator[0])

    whole = elevator(0.0, 0.0)
    assert elevator(84.9, 0.0) == pytest.approx(whole)
    assert elevator(87.5, 0.0) == pytest.approx(0.5 * whole)
    assert elevator(87.5, 69.0) == pytest.approx(0.5 * whole)
    assert elevator(87.5, 71.0) == pytest.approx(whole)


def test_turns_are_not_coordinated_when_steep() -> None:
    up = replace(PLAIN, ptch_lim_max_deg=80.0)
    for pitch, coordinated in ((69.0, True), (71.0, False)):
        state, wanted = _state(roll=40.0, pitch=pitch), _command(roll=40.0, pitch=pitch)
        assert (_once(up, state, wanted).elevator[0] > 1e-6) == coordinated


def test_rates_are_limited_on_each_side() -> None:
    params = replace(
        PLAIN, rll2srv_rmax=30.0, ptch2srv_rmax_up=12.0, ptch2srv_rmax_dn=6.0, ptch2srv_rll=0.0
    )
    up = _once(params, _state(), _command(roll=45.0, pitch=15.0))
    assert up.aileron[0] == pytest.approx(30.0 * 0.3 / 1.02 / 45.0)
    assert up.elevator[0] == pytest.approx(12.0 * 0.4 / 1.02 / 45.0)
    down = _once(params, _state(), _command(roll=-45.0, pitch=-15.0))
    assert down.aileron[0] == pytest.approx(-30.0 * 0.3 / 1.02 / 45.0)
    assert down.elevator[0] == pytest.approx(-6.0 * 0.4 / 1.02 / 45.0)


def test_integral_grows_is_limited_and_freezes() -> None:
    params = replace(PLAIN, rll_rate_ff=0.0, rll_rate_i=1.0, rll_rate_imax=0.1)
    gains = make_gains([params], DT, PROMPT)
    rolling = _state(p=-10.0)
    _, memory = adapters.fbwa(rolling, _command(), fresh(1), gains=gains)
    # 1 × 10° × 0.02 s of 45°
    assert memory.each["integral"][0, 0] == pytest.approx(10.0 * 0.02 / 45.0)
    for _ in range(200):
        _, memory = adapters.fbwa(rolling, _command(), memory, gains=gains)
    assert memory.each["integral"][0, 0] == pytest.approx(math.degrees(0.1) / 45.0)


@pytest.mark.parametrize(
    ("eas", "grows"), [(10.1, (True, True)), (10.0, (False, True)), (5.0, (False, False))]
)
def test_integral_freezes_at_low_airspeed(eas: float, grows: Any) -> None:
    """At AIRSPEED_MIN, 10 m/s, that of roll, and at half of it that of pitch."""
    params = replace(PLAIN, rll_rate_i=1.0, ptch_rate_i=1.0)
    gains = make_gains([params], DT, PROMPT)
    _, memory = adapters.fbwa(_state(p=-10.0, q=-10.0, eas=eas), _command(), fresh(1), gains=gains)
    assert tuple(memory.each["integral"][0] > 0.0) == grows


def test_airspeed_is_read_and_filtered_at_10_hz() -> None:
    """A step from 16 to 25 m/s; feed-forward is 1 over the speed scaler, whose cut-off is 2 Hz."""
    gains, memory = make_gains([PLAIN], DT, PROMPT), fresh(1)
    ailerons = []
    for k in range(16):
        state = _state(eas=16.0 if k < 3 else 25.0)
        surfaces, memory = adapters.fbwa(state, _command(roll=10.0), memory, gains=gains)
        ailerons.append(surfaces.aileron[0])
    pressure, scaler, weight = 16.0**2, 20.0 / 16.0, 0.1 / (0.1 + 1.0 / (4.0 * math.pi))
    for k, aileron in enumerate(ailerons):
        if k in (5, 10, 15):
            pressure = 0.7 * pressure + 0.3 * 25.0**2
            scaler += weight * (20.0 / math.sqrt(pressure) - scaler)
        # the target is scaled by the square, the feed-forward undoes one
        assert aileron == pytest.approx(20.0 * 0.3 * scaler / 1.02 / 45.0, rel=1e-12)


def test_stall_prevention_smooths_the_airspeed() -> None:
    """At 12 m/s the bank is limited to 46°, from 9 m/s to 25° until the smoothed airspeed rises."""
    gains, memory = make_gains([PLAIN], DT, PROMPT), fresh(1)
    smoothed, pressure = 9.0, 81.0
    for k in range(200):
        eas = 9.0 if k == 0 else 12.0
        surfaces, memory = adapters.fbwa(
            _state(roll=25.0, eas=eas), _command(roll=89.0), memory, gains=gains
        )
        if k and k % 5 == 0:
            pressure = 0.7 * pressure + 0.3 * 144.0
            smoothed = 0.8 * smoothed + 0.2 * math.sqrt(pressure)
        load = (smoothed / 10.0) ** 2
        limit = max(25.0, math.degrees(math.acos(1.0 / max(load, 1.0))))
        assert (surfaces.aileron[0] > 1e-9) == (limit > 25.0)
    assert limit == pytest.approx(math.degrees(math.acos(1.0 / 1.44)), rel=1e-3)


def test_airspeed_of_zero_gives_finite_surfaces() -> None:
    gains, memory = make_gains([PLAIN], DT, PROMPT), fresh(1)
    for k in range(20):
        state = _state(roll=20.0, eas=0.0 if k < 6 or k > 11 else 20.0)
        surfaces, memory = adapters.fbwa(state, _command(roll=10.0), memory, gains=gains)
        assert np.isfinite(surfaces).all()


def test_integral_is_zero_without_its_gain() -> None:
    """As in ArduPlane, also where a parameter is changed in flight."""
    params = replace(PLAIN, rll_rate_i=1.0)
    gains = make_gains([params], DT, PROMPT)
    _, memory = adapters.fbwa(_state(p=-10.0), _command(), fresh(1), gains=gains)
    assert memory.each["integral"][0, 0] > 0.0
    gains = make_gains([PLAIN], DT, PROMPT)
    _, memory = adapters.fbwa(_state(p=-10.0), _command(), memory, gains=gains)
    assert memory.each["integral"][0, 0] == 0.0


def _slewed(rates: np.ndarray, smax: float) -> np.ndarray:
    """Fly body roll rates (K,), deg/s, with a gain P of 0.5 only; return the ailerons (K,)."""
    p_only = replace(PLAIN, rll_rate_ff=0.0, rll_rate_p=0.5, rll_rate_smax=smax)
    gains, memory = make_gains([p_only], DT, PROMPT), fresh(1)
    ailerons = []
    for rate in rates:
        surfaces, memory = adapters.fbwa(_state(p=-rate), _command(), memory, gains=gains)
        ailerons.append(surfaces.aileron[0])
    return np.array(ailerons)


def test_slew_limiter_reduces_an_oscillation() -> None:
    """A steady wave comes to S / (S + 1.5 (m − S)), m the slope of P + D after that factor.

    m is f times the slope of the free P + D after difference and low-pass at 25 Hz, and decays
    to 0.8 of it until a steeper sample comes.
    """
    smax, omega = 100.0, 2.0 * math.pi * 3.0
    rates = 60.0 * np.sin(omega * DT * np.arange(500))
    free = _slewed(rates, 0.0)
    assert free == pytest.approx(0.5 * rates / 45.0, rel=1e-12)
    held = _slewed(rates, smax)
    amplitude = 45.0 * 0.5 * math.radians(60.0)
    alpha, z = DT / (DT + 1.0 / (50.0 * math.pi)), np.exp(-1j * omega * DT)
    slope = amplitude * abs(alpha * (1.0 - z) / DT / (1.0 - (1.0 - alpha) * z))
    low, high = (
        # f = S / (S + 1.5 (f m − S)): 1.5 m f² − 0.5 S f − S = 0
        (0.5 * smax + math.sqrt(0.25 * smax * smax + 6.0 * m * smax)) / (3.0 * m)
        for m in (slope, 0.8 * slope)
    )
    last = slice(-100, None)  # six waves
    flown = np.sqrt(np.mean(held[last] ** 2) / np.mean(free[last] ** 2))
    assert 0.4 < low < flown < high < 0.5


def test_slew_limiter_leaves_a_step_alone() -> None:
    """One fast slope, or a slow wave, is no oscillation."""
    step = np.where(np.arange(200) < 50, 0.0, 60.0)
    assert np.array_equal(_slewed(step, 100.0), _slewed(step, 0.0))
    slow = 60.0 * np.sin(2.0 * math.pi * 0.5 * DT * np.arange(300))
    assert np.array_equal(_slewed(slow, 100.0), _slewed(slow, 0.0))


def test_integral_shrinks_only_at_full_deflection() -> None:
    params = replace(PLAIN, rll_rate_ff=0.0, rll_rate_p=2.0, rll_rate_i=0.5)
    gains = make_gains([params], DT, PROMPT)
    memory = fresh(1)
    for _ in range(3):
        surfaces, memory = adapters.fbwa(_state(p=-60.0), _command(), memory, gains=gains)
    assert surfaces.aileron[0] == 1.0
    stuck = memory.each["integral"][0, 0]
    _, memory = adapters.fbwa(_state(p=-60.0), _command(), memory, gains=gains)
    assert memory.each["integral"][0, 0] == stuck
    _, memory = adapters.fbwa(_state(p=60.0), _command(), memory, gains=gains)
    assert memory.each["integral"][0, 0] < stuck


def test_the_loop_against_plain_scalar_arithmetic() -> None:
    """Second route: the rate loop of one axis in scalars, over 50 periods of a moving aircraft."""
    params = read_params(ROOT / "aircraft" / "rascal110" / "recorded.param")
    params = replace(params, ins_gyro_filter=0.0)
    gains, memory = make_gains([params], DT, PROMPT), fresh(1)
    target = error = derivative = integral = output = 0.0
    a_target = DT / (DT + 1.0 / (2.0 * math.pi * params.rll_rate_fltt))
    a_derivative = DT / (DT + 1.0 / (2.0 * math.pi * params.rll_rate_fltd))
    for k in range(50):
        roll, p = 30.0 * math.sin(0.1 * k), 25.0 * math.cos(0.15 * k)
        state = _state(roll=roll, p=p, eas=18.0)
        surfaces, memory = adapters.fbwa(state, _command(roll=20.0), memory, gains=gains)
        s = 15.0 / 18.0
        wanted = math.radians(max(-90.0, min(90.0, (20.0 - roll) / params.rll2srv_tconst))) * s * s
        last = error
        target = wanted if k == 0 else target + a_target * (wanted - target)
        error = target - math.radians(p) * s * s
        if k > 0:
            derivative += a_derivative * ((error - last) / DT - derivative)
        growth = params.rll_rate_i * error * DT
        if abs(output) < 45.0 or integral * growth < 0.0:
            integral = max(-0.666, min(0.666, integral + growth))
        output = math.degrees(
            params.rll_rate_ff * target / (s * 1.02)
            + params.rll_rate_p * error
            + integral
            + params.rll_rate_d * derivative
        )
        expected = 0.8 * max(-45.0, min(45.0, output)) / 45.0
        assert surfaces.aileron[0] == pytest.approx(expected, abs=1e-12)


def test_commands_act_after_their_latency() -> None:
    gains = make_gains([PLAIN], DT, AutopilotTiming(command_latency=0.03))
    _, memory = adapters.fbwa(_state(), _command(), fresh(1), gains=gains)
    ailerons = []
    for _ in range(3):
        surfaces, memory = adapters.fbwa(_state(), _command(roll=10.0), memory, gains=gains)
        ailerons.append(surfaces.aileron[0])
    # 1.5 periods: nothing, then half way between two samples, then all.
    assert ailerons[0] == 0.0
    assert ailerons[1] == pytest.approx(0.5 * ailerons[2])
    assert ailerons[2] == pytest.approx(10.0 / 0.5 * 0.3 / 1.02 / 45.0)


def _analog(frequency: Any, cutoff: float) -> Any:
    """Return the response of the continuous second-order Butterworth low-pass."""
    s = 1j * frequency / cutoff
    return 1.0 / (1.0 + math.sqrt(2.0) * s + s * s)


def _flown_response(
    params: FbwaParams, rate_hz: int, frequency: float, timing: AutopilotTiming
) -> complex:
    """Fly a wave of roll rate through a gain P of 0.1 alone; return the gyro filter's response."""
    dt, p_only = 1.0 / rate_hz, replace(params, rll_rate_ff=0.0, rll_rate_p=0.1)
    gains, memory = make_gains([p_only], dt, timing), fresh(1)
    phases = 2.0 * math.pi * frequency * dt * np.arange(2 * rate_hz)
    ailerons = []
    for phase in phases:
        surfaces, memory = adapters.fbwa(
            _state(p=-10.0 * math.cos(phase)), _command(), memory, gains=gains
        )
        ailerons.append(surfaces.aileron[0])
    wave = np.array(ailerons[rate_hz:]) * 45.0  # 0.1 × 10° is 1° of aileron
    return complex(2.0 * np.mean(wave * np.exp(-1j * phases[rate_hz:])))


def _lag_ms(response: complex, frequency: float) -> float:
    return -1e3 * float(np.angle(response)) / (2.0 * math.pi * frequency)


@pytest.mark.parametrize(
    ("rate_hz", "frequency"),
    [(400, 5.0), (200, 1.0), (100, 5.0), (50, 1.0), (50, 5.0), (40, 5.0), (25, 5.0), (10, 1.0)],
)
def test_gyro_filter_has_an_aircrafts_lag(rate_hz: int, frequency: float) -> None:
    """Within 1 ms of 11.25 ms up to 5 Hz; below 25 Hz up to an eighth of the autopilot's rate."""
    params = replace(PLAIN, ins_gyro_filter=20.0)
    flown = _flown_response(params, rate_hz, frequency, PROMPT)
    assert _lag_ms(flown, frequency) == pytest.approx(11.25, abs=1.0)
    assert _lag_ms(_analog(frequency, 20.0), frequency) == pytest.approx(11.25, abs=0.25)
    # straight lines between samples are the wave and its aliases, each times sinc² (f dt)
    aliases = frequency + rate_hz * np.arange(-300, 301)
    exact = np.sum(_analog(aliases, 20.0) * np.sinc(aliases / rate_hz) ** 2)
    assert flown == pytest.approx(exact, abs=1e-5)
    assert abs(flown) / abs(_analog(frequency, 20.0)) > (0.85 if rate_hz == 25 else 0.94)
    # the bilinear transform, as of SITL with physics at 1000 Hz, has 4.6 ms at 50 Hz
    if rate_hz == 50:
        b, a = signal.butter(2, 20.0, fs=rate_hz)
        _, bilinear = signal.freqz(b, a, [frequency], fs=rate_hz)
        assert _lag_ms(bilinear[0], frequency) < 5.0


@pytest.mark.parametrize("rate_hz", [10, 50, 400])
@pytest.mark.parametrize("cutoff", [1.0, 20.0, 250.0])
def test_gyro_filter_equals_the_continuous_one(rate_hz: int, cutoff: float) -> None:
    """Second route: the continuous filter, fed with straight lines between samples."""
    b, a = ramp_invariant_butterworth(cutoff, 1.0 / rate_hz)
    samples = np.random.default_rng(5).normal(size=60).cumsum()
    samples[:2] = 0.0
    times = np.arange(60) / rate_hz
    omega = 2.0 * math.pi * cutoff
    filters = ([omega**2], [1.0, math.sqrt(2.0) * omega, omega**2])
    _, exact, _ = signal.lsim(filters, samples, times)  # interpolates linearly
    ours = signal.lfilter(b, (1.0, *a), samples)
    assert ours == pytest.approx(exact, abs=1e-9 * np.abs(samples).max())
    assert np.all(np.abs(np.roots([1.0, *a])) < 1.0)
    assert sum(b) == pytest.approx(1.0 + sum(a), abs=1e-15)


def test_sitl_gyro_filter_by_its_frames() -> None:
    """20 Hz of 1000 Hz act at 4 Hz with physics at 200 Hz, by the bilinear transform."""
    timing = AutopilotTiming(command_latency=0.0, sitl_physics_hz=200.0)
    params = replace(PLAIN, ins_gyro_filter=20.0)
    gains = make_gains([params], DT, timing)
    b, a = signal.butter(2, 4.0, fs=50.0)
    assert gains["gyro_b"][0] == pytest.approx(b, rel=1e-12)
    assert gains["gyro_a"][0] == pytest.approx(a[1:], rel=1e-12)
    flown = _flown_response(params, 50, 4.0, timing)
    assert abs(flown) == pytest.approx(1.0 / math.sqrt(2.0), rel=1e-3)
    cutoffs = [sitl_gyro_cutoff(params, hz) for hz in (100.0, 200.0, 400.0, 1000.0, 1200.0)]
    assert cutoffs == [2.0, 4.0, 8.0, 20.0, 20.0]
    # SITL's usual 1200 Hz have the filter of an aircraft
    fast = make_gains([params], DT, replace(timing, sitl_physics_hz=1200.0))
    own = make_gains([params], DT, PROMPT)
    for name in ("gyro_a", "gyro_b"):
        assert np.array_equal(fast[name], own[name])


def test_gyro_filter_starts_settled() -> None:
    p_only = replace(PLAIN, rll_rate_ff=0.0, rll_rate_p=0.1, ins_gyro_filter=20.0)
    gains, memory = make_gains([p_only], DT, PROMPT), fresh(1)
    for _ in range(5):
        surfaces, memory = adapters.fbwa(_state(p=10.0), _command(), memory, gains=gains)
        assert surfaces.aileron[0] == pytest.approx(-0.1 * 10.0 / 45.0, rel=1e-12)


def test_settled_memory_holds_the_surfaces() -> None:
    params = replace(PLAIN, servo1_min=1100.0, servo1_max=1900.0, rll_rate_i=0.1, ptch_rate_i=0.1)
    gains = make_gains([params], DT, PROMPT)
    held = ActuatorCommand(np.array([0.05]), np.array([-0.2]), np.zeros(1), np.array([0.5]))
    surfaces, _ = adapters.fbwa(_state(), _command(), adapters.settled(held, gains), gains=gains)
    assert surfaces.aileron[0] == pytest.approx(0.05)
    assert surfaces.elevator[0] == pytest.approx(-0.2)
    # as in ArduPlane, a loop without an integral gain has no integral
    gains = make_gains([replace(params, ptch_rate_i=0.0)], DT, PROMPT)
    surfaces, _ = adapters.fbwa(_state(), _command(), adapters.settled(held, gains), gains=gains)
    assert (surfaces.aileron[0], surfaces.elevator[0]) == (pytest.approx(0.05), 0.0)


def test_a_fleet_is_its_members() -> None:
    """Two aircraft with different tunes at once equal each alone, to the bit."""
    tunes = [PLAIN, replace(PLAIN, rll_rate_p=0.3, rll2srv_tconst=0.2, roll_limit_deg=30.0)]
    one, two = _state(roll=10.0, p=4.0), _state(roll=-20.0, q=3.0, eas=17.0)
    both = VehicleState(
        **{
            name: np.concatenate([getattr(one, name), getattr(two, name)])
            for name in VehicleState._fields
        }
    )
    command = FbwaCommand(np.radians([5.0, -3.0]), np.radians([40.0, 20.0]), np.array([0.3, 0.6]))
    together, _ = adapters.fbwa(both, command, fresh(2), gains=make_gains(tunes, DT))
    for i, (tune, state) in enumerate(zip(tunes, (one, two), strict=True)):
        mine = FbwaCommand(command.pitch[[i]], command.roll[[i]], command.throttle[[i]])
        alone, _ = adapters.fbwa(state, mine, fresh(1), gains=make_gains([tune], DT))
        for name in ("aileron", "elevator", "rudder", "throttle"):
            assert getattr(together, name)[i] == getattr(alone, name)[0]


@pytest.mark.parametrize(
    ("name", "latency"),
    [
        *[("recorded", 0.0), ("autopilot", 0.02), ("recorded", 0.05)],
        *[pytest.param("autopilot", each, marks=in_full) for each in (0.0, 0.05)],
        pytest.param("recorded", 0.02, marks=in_full),
    ],
)
def test_the_kernel_does_what_the_reference_does(name: str, latency: float) -> None:
    """Over 150 or 400 periods of noise that reaches every limit they differ by rounding alone."""
    tune = read_params(ROOT / "aircraft" / "rascal110" / f"{name}.param")
    gains = make_gains([tune, PLAIN, tune], DT, AutopilotTiming(command_latency=latency))
    rng = np.random.default_rng(7)
    ours = theirs = fresh(3)
    autopilots, aircraft = initial_autopilots(gains), allocate(AIRCRAFT, 5)
    rows = np.array([3, 0, 4])
    for _ in range(400 if ALL else 150):
        eas = rng.uniform(8.0, 35.0, 3)
        vectors = rng.normal(0.0, 1.0, (5, 3, 3))
        state = VehicleState(*vectors, airspeed=1.03 * eas, equivalent_airspeed=eas)
        command = FbwaCommand(
            rng.normal(0.0, 0.3, 3), rng.normal(0.0, 1.0, 3), rng.uniform(-0.2, 1.2, 3)
        )
        one, ours = reference.fbwa(state, command, ours, reference_gains(gains))
        two, theirs = adapters.fbwa(state, command, theirs, gains)
        # the same in some rows of the records of more aircraft
        mine = allocate(AIRCRAFT, 3)
        write_fields(mine["estimate"], state)
        write_fields(mine["command"], command)
        aircraft[rows] = mine
        fly_by_wire_a(rows, *autopilots, aircraft)
        for field in ActuatorCommand._fields:
            assert getattr(two, field) == pytest.approx(getattr(one, field), abs=1e-11)
            assert np.array_equal(aircraft["surfaces"][field][rows], getattr(two, field))
            assert not aircraft["surfaces"][field][[1, 2]].any()
    assert theirs.commands == pytest.approx(ours.commands, abs=1e-11)
    for field in MEMORY.names or ():
        assert theirs.each[field] == pytest.approx(ours.each[field], rel=1e-9, abs=1e-9)
        assert np.array_equal(autopilots.memory[field], theirs.each[field])


def test_a_frozen_autopilot_keeps_servos_and_memory() -> None:
    gains = make_gains([PLAIN, PLAIN], DT, PROMPT)
    held = ActuatorCommand(*np.full((4, 2), 0.1))
    autopilots, aircraft = settled_autopilots(gains, held), allocate(AIRCRAFT, 2)

    def step(**command: float) -> list[float]:
        for row in range(2):
            one = aircraft[row : row + 1]
            write_fields(one["estimate"], _state())
            write_fields(one["command"], _command(**command))
        fly_by_wire_a(np.arange(2), *autopilots, aircraft)
        return aircraft["surfaces"]["aileron"].tolist()

    # frozen from the start its servos stay at the trim, and its filters settle all the same
    aircraft["faults"]["frozen"][1] = True
    free, frozen = step(roll=20.0)
    assert free != 0.1
    assert frozen == 0.1
    assert autopilots.memory["period"].tolist() == [1, 1]
    before = autopilots.memory[1].copy()
    again, frozen = step(roll=-20.0)
    assert again != free
    assert frozen == 0.1
    assert autopilots.memory[1] == before
    # and freed it flies on
    aircraft["faults"]["frozen"][1] = False
    assert step(roll=-20.0)[1] != 0.1


def test_an_unfit_timing_is_refused() -> None:
    with pytest.raises(ValueError, match="negative"):
        make_gains([PLAIN], DT, AutopilotTiming(command_latency=-0.01))


def test_param_formats_and_defaults(tmp_path: Path) -> None:
    path = tmp_path / "a.param"
    path.write_text("# a tune\nRLL_RATE_P 0.3\nRLL_RATE_I,0.2 # comma\n\tPTCH_RATE_FF\t1.5\r\n\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_params(path) == FbwaParams(rll_rate_p=0.3, rll_rate_i=0.2, ptch_rate_ff=1.5)


def test_names_before_4_5_are_converted(tmp_path: Path) -> None:
    path = tmp_path / "old.param"
    path.write_text(
        "LIM_ROLL_CD 5500\nLIM_PITCH_MAX 2200\nLIM_PITCH_MIN -1800\nTRIM_PITCH_CD 150\n"
        "TRIM_ARSPD_CM 1900\nARSPD_FBW_MIN 13\nARSPD_FBW_MAX 28\n"
    )
    assert read_params(path) == FbwaParams(
        roll_limit_deg=55.0,
        ptch_lim_max_deg=22.0,
        ptch_lim_min_deg=-18.0,
        ptch_trim_deg=1.5,
        airspeed_cruise=19.0,
        airspeed_min=13.0,
        airspeed_max=28.0,
    )


@pytest.mark.parametrize(
    "text",
    [
        "RLL_RATE_P = 0.3",
        "RLL_RATE_P=.3e0",
        "RLL_RATE_P 0.3 @READONLY",
        "RLL_RATE_P,0.3,9",
        "rll_rate_p\t+0.3 roll // gain",
        "// tune\r\rRLL_RATE_P,0.3#gain\r\n",
        "# Stack: ArduPilot\n1\t1\tRLL_RATE_P\t0.3\t9\n1 1 PTCH_RATE_P 0.04 9",
    ],
)
def test_lines_follow_arduplanes_grammar(tmp_path: Path, text: str) -> None:
    path = tmp_path / "plane.params"
    path.write_text(text, newline="")
    assert read_params(path) == FbwaParams(rll_rate_p=0.3)


@pytest.mark.parametrize(
    ("text", "note"),
    [
        (
            "RLL_RATE_P 0.2\nrll_rate_p 0.3",
            "line 2: rll_rate_p 0.3 replaces RLL_RATE_P 0.2 of line",
        ),
        ("RLL_RATE_P 0.3\nRLL_RATE_P_OF_ROLL 9", "line 2: RLL_RATE_P_OF_ROLL is ignored"),
        ("1 1 RLL_RATE_P 0.3 9\n1 154 RLL_RATE_P 9 9", "of MAVLink component 154 are ignored"),
    ],
)
def test_values_without_effect_are_notes(tmp_path: Path, text: str, note: str) -> None:
    path = tmp_path / "plane.param"
    path.write_text(text)
    with pytest.warns(UserWarning, match=note) as caught:
        assert read_params(path) == FbwaParams(rll_rate_p=0.3)
    assert len(caught) == 1


def test_travel_is_that_of_the_assigned_output(tmp_path: Path) -> None:
    path = tmp_path / "a.param"
    path.write_text(
        "SERVO1_FUNCTION 0\nSERVO5_FUNCTION 4\nSERVO5_MIN 1000\nSERVO5_MAX 2000\n"
        "SERVO1_MIN 1200\nSERVO2_MAX 1800\n"
    )
    assert read_params(path) == FbwaParams(servo1_min=1000.0, servo1_max=2000.0, servo2_max=1800.0)


def test_travel_of_elevons_is_that_of_their_mixing(tmp_path: Path) -> None:
    path = tmp_path / "wing.param"
    elevons = "SERVO1_FUNCTION 78\nSERVO2_FUNCTION 77\nSERVO1_MIN 900\n"
    for text, half in (("", 200.0), ("MIXING_GAIN 1\n", 400.0)):
        path.write_text(elevons + text)
        low, high = 1500.0 - half, 1500.0 + half
        assert read_params(path) == FbwaParams(
            servo1_min=low, servo1_max=high, servo2_min=low, servo2_max=high
        )
    path.write_text("MIXING_GAIN 0.7\n")  # no elevons
    assert read_params(path) == FbwaParams()


def test_gains_of_older_laws_are_an_error(tmp_path: Path) -> None:
    path = tmp_path / "old.param"
    path.write_text("NAVL1_PERIOD 17\nRLL2SRV_P 2.5\n")
    with pytest.raises(ParamError, match="old.param:2: RLL2SRV_P is a gain of versions before 4.1"):
        read_params(path)


def test_unknown_names_are_counted_once(tmp_path: Path) -> None:
    path = tmp_path / "a.param"
    path.write_text("RLL_RATE_P 0.3\nARMING_CHECK 1\nEK3_ENABLE 1\nEK3_ENABLE 0\n")
    with pytest.warns(UserWarning, match="ignored 2 parameters") as caught:
        assert read_params(path).rll_rate_p == 0.3
    assert len(caught) == 1


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("RLL_RATE_P 0.3\nRLL_RATE_I\n", 2),
        ("RLL_RATE_P 0.3 0.4\n", 1),
        ("\n\nRLL_RATE_P abc\n", 3),
        ("RLL_RATE_P nan\n", 1),
        ("RLL_RATE_P 1_0\n", 1),
        ("RLL_RATE_P 0x1\n", 1),
        ("RLL_RATE_P ١\n", 1),
        ("RLL_RATE_P 0,3\n", 1),
        ("RLL_RATE_P_é 0.3\n", 1),
        ("1 1 RLL_RATE_P 0.3 9\n2 1 RLL_RATE_P 0.3 9\n", 2),
        ("# Stack: PX4 Pro\n1 1 FW_RR_P 0.3 9\n", 1),
        ("0.3 RLL_RATE_P\n", 1),
        ("root:x:0:0:secret:/root:/bin/bash\n", 1),
        ("RLL_RATE_P secret secret\n", 1),
        ("AIRSPEED_MIN 0\n", 1),
        ("AIRSPEED_MIN 20\nAIRSPEED_MAX 15\n", 2),
    ],
)
def test_malformed_lines_are_named(tmp_path: Path, text: str, line: int) -> None:
    path = tmp_path / "bad.param"
    path.write_text(text)
    with pytest.raises(ParamError) as error:
        read_params(path)
    assert f"{path}:{line}: " in str(error.value)
    assert "secret" not in str(error.value)  # the path may name a file of something else


ABSURD = {
    "PTCH_RATE_P": (-1.0, "is -1; it must be 0 to 20"),
    "THR_MAX": (-100.0, "is -100 %; it must be 0 to 100"),
    "RLL_RATE_D": (-5.0, "is -5 s; it must be 0 to 1"),
    "TRIM_THROTTLE": (5000.0, "is 5000 %; it must be 0 to 100"),
    "RLL2SRV_TCONST": (0.0, "is 0 s; it must be 0.05 to 10"),
    "PTCH2SRV_TCONST": (1e-12, "is 1e-12 s; it must be 0.05 to 10"),
    "SERVO1_MIN": (700.0, "is 700 µs; it must be 800 to 2200"),
    "RLL_RATE_I": (1e-300, "is 1e-300 1/s; it must be 0 to 20"),
}


@pytest.mark.parametrize("name", ABSURD)
def test_absurd_value_is_refused_at_every_entry(tmp_path: Path, name: str) -> None:
    value, message = ABSURD[name]
    path = tmp_path / "absurd.param"
    path.write_text(f"AIRSPEED_CRUISE 12\n{name} {value!r}\n")
    with pytest.raises(ParamError, match=f"absurd.param:2: {name} {message}$"):
        read_params(path)
    with pytest.raises(ParamError, match=f"^{name} {message}$"):
        with_param(FbwaParams(), name, value)
    with pytest.raises(ParamError, match=f"^{name} {message}$"):
        FbwaParams(**{name.lower(): value})


def test_ranges_of_parameters_hold_the_defaults() -> None:
    for name, (_, usual, flyable) in RANGES.items():
        default = getattr(FbwaParams(), name)
        assert flyable[0] <= usual[0] <= default <= usual[1] <= flyable[1], name
        for wrong in (math.nextafter(flyable[0], -math.inf), flyable[1] * 1.01 + 1.0, math.nan):
            with pytest.raises(ParamError):
                with_param(FbwaParams(), name.upper(), wrong)
    assert list(unusual_values(FbwaParams())) == []


@pytest.mark.parametrize(
    ("planted", "range_", "error"),
    [
        ("usual without the default", {"usual": (0.1, 2.0)}, AssertionError),
        ("usual beyond the flyable", {"usual": (0.0, 30.0)}, AssertionError),
        ("flyable without end", {"flyable": (0.0, math.inf)}, pytest.fail.Exception),
    ],
)
def test_wrong_range_of_a_parameter_is_found(
    monkeypatch: pytest.MonkeyPatch, planted: str, range_: dict[str, Any], error: type[Exception]
) -> None:
    """A negative control of the test above: it fails for each planted fault."""
    monkeypatch.setitem(RANGES, "rll_rate_p", RANGES["rll_rate_p"]._replace(**range_))
    with pytest.raises(error):
        test_ranges_of_parameters_hold_the_defaults()


@pytest.mark.parametrize("path", sorted(library().glob("aircraft/*/*.param")), ids=lambda p: p.name)
def test_tunes_of_the_aircraft_are_usual(path: Path) -> None:
    assert list(unusual_values(read_params(path))) == []


def test_misspelt_name_has_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "a.param"
    path.write_text("RLL_RATE_P 0.3\nPTCH_RATEI 0.1\nSERVO3_MIN 1100\nYAW_RATE_P 1\n")
    with pytest.warns(UserWarning) as caught:
        assert read_params(path) == FbwaParams(rll_rate_p=0.3)
    misspelt, counted = (str(each.message) for each in caught)
    assert misspelt == (
        f"{path}:2: PTCH_RATEI is no parameter of fly-by-wire A: did you mean PTCH_RATE_I? It is "
        "ignored"
    )
    assert f"{path}: ignored 2 parameters" in counted

"""Fits of airframes to recordings whose aircraft are known, and to that of the real ArduPlane.

The recordings are flown by `testbed.Aircraft`, which has a loop of its own, with the errors of its
sensors: a navigation filter, offsets of airspeed and attitude, drifts.
"""

import os
from dataclasses import replace

import numpy as np
import pytest
from places import ROOT
from scipy.signal import lfilter

import testbed
from testbed.autopilot.parameters import AutopilotTiming, read_params
from testbed.commissioning.airframe_fit import PARAMETERS, block_covariance, fit_airframe
from testbed.commissioning.airframe_variant import copy_with_factors
from testbed.commissioning.command_files import read_commands
from testbed.commissioning.replay_commands import ReplaySetup, replay_one
from testbed.commissioning.response_comparison import compare_response
from testbed.vehicle import jsbsim_adapter

RASCAL = ROOT / "aircraft" / "rascal110"
RECORDING = ROOT / "tests" / "data" / "arduplane_fbwa_rascal_steps.csv"
FITS = int(os.environ.get("TESTBED_FITS", "1"))
PLANTED = {"mass": 1.15, "latency": 0.08}
if FITS > 1:  # factors of the aerodynamics, whose model takes seconds to compile
    PLANTED |= {"drag": 0.8, "aileron": 0.9, "elevator": 1.1}
SITL = AutopilotTiming(sitl_physics_hz=200.0)
PERIOD_S, BEGIN_S, AIRSPEED = 0.02, 2.015, 24.6  # of a row of the recording


def record(path, folder, seed, seconds, sensors="pixhawk"):
    """Fly the commands of the recording from BEGIN_S on; write what the autopilot estimates."""
    commands = read_commands(RECORDING)
    aircraft = testbed.Aircraft(
        str(folder),
        airspeed_mps=AIRSPEED,
        sensors=sensors,
        tune=str(RASCAL / "recorded.param"),
        seed=seed,
        physics_hz=200,
        duration_s=seconds + 1.0,
    )
    late = PLANTED["latency"] - AutopilotTiming().command_latency  # of which it has the rest
    columns = (
        "phi_rad,theta_rad,p_radps,q_radps,r_radps,airspeed_mps,altitude_m,v_down_mps,"
        "pwm_ail,pwm_ele,pwm_thr,pwm_rud"
    )
    lines = [f"t_s,theta_cmd_rad,phi_cmd_rad,throttle_cmd,{columns}"]

    def command(time):
        row = np.searchsorted(commands.time_s, BEGIN_S + time + 1e-9, side="right") - 1
        return commands.values[max(row, 0), 1:]

    for tick in range(round(seconds / PERIOD_S)):
        time = tick * PERIOD_S
        now = aircraft.estimate
        aircraft.step(*command(time - late))
        if tick % 2 == 0:
            out = aircraft.surfaces
            pulses = 1500.0 + 500.0 * np.array([out.aileron, -out.elevator, 0.0, -out.rudder])
            pulses[2] = 1000.0 + 1000.0 * out.throttle
            values = (
                *(time, *command(time), *now.euler[:2], *now.rates_body, now.airspeed),
                *(-now.position_ned[2], now.velocity_ned[2], *np.rint(pulses)),
            )
            lines.append(",".join(f"{each:.8g}" for each in values))
    path.write_text("\n".join(lines) + "\n")
    return read_commands(path)


@pytest.fixture(scope="module")
def planted(tmp_path_factory):
    folder = tmp_path_factory.mktemp("aircraft") / "planted"
    factors = {name: value for name, value in PLANTED.items() if name != "latency"}
    copy_with_factors(RASCAL, folder, factors)
    return folder


@pytest.fixture(scope="module")
def setup():
    return ReplaySetup(read_params(RASCAL / "recorded.param"))


def test_model_with_planted_values_repeats_a_flight(planted, setup, tmp_path):
    """Without sensor errors the two loops differ by rounding."""
    commands = record(tmp_path / "exact.csv", planted, 1, 10.0, "truth")
    same = replace(setup, timing=AutopilotTiming(command_latency=PLANTED["latency"]))
    found = compare_response(commands, replay_one(planted, commands, same)).quantities
    assert found["roll"].rms < 1e-4 and found["airspeed"].rms < 1e-3
    assert found["aileron"].rms < 0.5  # µs; whole ones are recorded


def test_fit_finds_planted_values(planted, setup, tmp_path, monkeypatch):
    """TESTBED_FITS=20: of each parameter at least 17 intervals of 20 contain the planted value.

    Without it, of mass and latency, and the traits of the candidates are not determined anew:
    factors do not change them.
    """
    if FITS == 1:
        traits = jsbsim_adapter._find_traits(RASCAL)
        assert jsbsim_adapter._find_traits(planted) == traits
        monkeypatch.setattr(jsbsim_adapter._find_traits, "_function", lambda folder: traits)
    inside, errors = dict.fromkeys(PLANTED, 0), []
    for seed in range(1, FITS + 1):
        seconds = 148.0 if FITS > 1 else 50.0
        commands = record(tmp_path / f"{seed}.csv", planted, seed, seconds)
        for each in fit_airframe(RASCAL, commands, setup, tuple(PLANTED)).parameters:
            true = PLANTED[each.name]
            inside[each.name] += each.low <= true <= each.high
            errors.append((seed, each.name, round(each.value - true, 5), round(each.half_width, 5)))
            assert each.half_width < 0.1 * true, errors[-1]
            assert abs(each.value - true) < 0.1 * true, errors[-1]
    print(inside, *errors, sep="\n")
    assert all(count >= -(-17 * FITS // 20) for count in inside.values()), (inside, errors)


@pytest.mark.skipif(FITS == 1, reason="TESTBED_FITS=20: two fits to the whole recording")
def test_fit_to_the_recording_undoes_planted_errors(tmp_path):
    """A model with 1.25 times the mass and 0.75 of the drag, and commands 80 ms earlier."""
    setup = ReplaySetup(read_params(RASCAL / "recorded.param"), timing=SITL)
    commands = read_commands(RECORDING)
    whole = {
        each.name: each for each in fit_airframe(RASCAL, commands, setup, PARAMETERS).parameters
    }
    earlier = commands.values.copy()
    earlier[:-2, 1:] = earlier[2:, 1:]  # two rows of 40 ms
    wrong = {"mass": 1.25, "drag": 0.75}
    copy_with_factors(RASCAL, tmp_path / "wrong", wrong)
    commands = replace(commands, values=earlier)
    for each in fit_airframe(tmp_path / "wrong", commands, setup, PARAMETERS).parameters:
        print(each, whole[each.name])
        factor, late = wrong.get(each.name, 1.0), 0.08 * (each.name == "latency")
        assert abs(each.value * factor - late - whole[each.name].value) < each.half_width, each
        assert each.half_width < 0.1 * each.value, each


def test_intervals_allow_for_correlated_residuals():
    """Of a mean: residuals with a correlation of 0.95 have an error 6 times that of white noise."""
    rng, means, sigmas = np.random.default_rng(1), [], []
    for _ in range(200):
        noise = lfilter([1.0], [1.0, -0.95], rng.standard_normal(2000))
        mean = noise.mean()
        residual = (noise - mean)[:, None]
        sigmas.append(np.sqrt(block_covariance(residual, np.ones((2000, 1, 1)))[0, 0]))
        means.append(mean)
    inside = np.abs(means) < 2.365 * np.array(sigmas)  # t of 7 degrees of freedom
    assert 0.90 < inside.mean() < 0.99
    white = np.std(residual) / np.sqrt(2000)
    assert np.mean(np.abs(means) < 1.96 * white) < 0.6  # negative control

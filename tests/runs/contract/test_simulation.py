"""Stepping from Python: the flight of the command line to the bit, and commands that are flown."""

import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest
from cases import some
from forked import run_program
from run_flight import Collector, first_minute

import testbed
from testbed.commissioning import replay_commands
from testbed.commissioning.replay_commands import respond
from testbed.core.errors import InputError
from testbed.core.records import FbwaCommand
from testbed.core.samples import copy_sample
from testbed.logs.read import read_log
from testbed.logs.run_directory import LOG_NAME, SCENARIO_NAME
from testbed.runs.recover import recover
from testbed.scenario import find_aircraft, load_scenario, set_duration

NOISY = ["fleet.*.sensors=gps-ins", "network.loss=0.1"]
PUFF = "{kind: time, name: puff, velocity_mps: [1, 0, -2], at_s: 0, ramp_s: 1}"
FAULTS = [
    "fleet.uav1.faults=[{kind: battery-low, state_of_charge: 0.4, at_s: 0.5}, "
    "{kind: thrust-loss, remaining: 0.5, when: {quantity: state_of_charge, below: 0.5}}]",
    "fleet.uav3.faults=[{kind: surface-floating, surface: elevator, at_s: 0.7}]",
]


def short(*overrides, seconds=4.0):
    return set_duration(load_scenario("simulation-3", overrides), seconds)


def steps(simulation, **options):
    while simulation.outcome is None:
        yield simulation.step(**options)


def positions(simulation):
    return np.array([sample.truth.position_ned.copy() for sample in steps(simulation)])


FLIGHTS = {
    "noisy": ("simulation-3", [*NOISY, "rates.synchronous=false"]),
    "coherent": ("turbulence-moderate", []),
    "von-karman": ("simulation-3", ["air.turbulence.model=von-karman"]),
    "shear": ("wind-8ms", []),
    "wake": ("close-formation-wake", []),
    "unicycles": ("wind-8ms", ["fleet.*.vehicle=unicycle", "air.turbulence.model=dryden"]),
    "faults": ("mixed-fleet", [*FAULTS, "air.turbulence.model=dryden"]),
    "own-law": ("own-law-integral", ["air.turbulence.model=dryden"]),
}
AIR = ("coherent", "von-karman", "shear")  # beside the model that other flights have


@pytest.mark.parametrize("case", [each for each in FLIGHTS if each not in {*AIR} - {*some(AIR, 1)}])
def test_uneven_steps_write_the_log_of_a_run(tmp_path, case):
    """Log, events and metrics to the bit, wherever state and metrics are read in between."""
    scenario = set_duration(load_scenario(*FLIGHTS[case]), 2.0)
    run = testbed.run(scenario, out=tmp_path / "run")
    pieces = itertools.cycle([0.0, 0.05, 0.0, 0.13, 0.31])  # s; 0: to the next tick
    with testbed.Simulation(scenario, out=tmp_path / "stepped") as simulation:
        while simulation.outcome is None:
            simulation.step(until=simulation.time_s + next(pieces))
            assert simulation.state.time_s == simulation.time_s
            assert simulation.metrics["outcome"] in ("interrupted", "completed")
    assert (simulation.outcome, simulation.time_s) == (run.outcome, 2.0)
    for file in (LOG_NAME, SCENARIO_NAME):
        ours, flown = ((tmp_path / each / file).read_bytes() for each in ("stepped", "run"))
        assert ours == flown, file
    stepped = json.loads((tmp_path / "stepped" / "metrics.json").read_text())
    wall = {"wall_s": None, "real_time_factor": None}
    assert stepped | wall == dict(run.metrics) | wall


def test_samples_have_the_wind_of_their_tick(tmp_path):
    """Against the closed form of a gust in time, for every kind of vehicle, at every tick."""
    overrides = [f"air.gusts=[{PUFF}]", "fleet.uav1.vehicle=unicycle", *first_minute(tmp_path)]
    scenario = set_duration(load_scenario("simulation-3-recorded-leader", overrides), 1.0)
    logged = Collector()
    simulation = testbed.Simulation(scenario, observers=[logged])
    states = [copy_sample(simulation.state), *map(copy_sample, steps(simulation))]
    assert [len(states), len(logged.frames)] == [51, 26]
    for sample in (*states, *logged.frames):
        rise = 0.5 - 0.5 * math.cos(math.pi * sample.time_s)
        expected = np.tile(rise * np.array([1.0, 0.0, -2.0]), (4, 1))
        np.testing.assert_allclose(sample.air.wind_ned, expected, atol=1e-12)


def test_samples_have_the_wind_at_their_position():
    """Against u = 8 ln(h/z₀) / ln(100/z₀), and its gradient at the start, with level wings.

    Heights change by up to 0.02 m in an autopilot period.
    """
    logged = Collector()
    testbed.run(set_duration(load_scenario("wind-8ms"), 0.8), write=False, observers=[logged])
    downwind = math.radians(240.0 - 180.0)
    for sample in logged.frames:
        height = -sample.truth.position_ned[:, 2]
        speed = 8.0 * np.log(height / 0.03) / math.log(100.0 / 0.03)
        expected = np.outer(speed, [math.cos(downwind), math.sin(downwind), 0.0])
        np.testing.assert_allclose(sample.air.wind_ned, expected, atol=2e-6)
    first = logged.frames[0]
    _, pitch, yaw = first.truth.euler.T
    slope = 8.0 / math.log(100.0 / 0.03) / -first.truth.position_ned[:, 2]  # 1/s, du/dh
    along, across = slope * np.sin(pitch) * [np.cos(downwind - yaw), np.sin(downwind - yaw)]
    expected = np.stack([0.0 * along, -np.sin(pitch) * along, across], axis=1)
    np.testing.assert_allclose(first.air.wind_gradient_rates, expected, atol=1e-12)


def test_state_between_samples_is_present():
    """Slots and errors belong to the positions beside them, also at ticks that are not logged."""
    simulation = testbed.Simulation(short(seconds=1.0))
    for sample in steps(simulation):
        errors = sample.truth.position_ned[1:] - sample.formation.slot_ned
        np.testing.assert_allclose(sample.formation.error_ned, errors, atol=1e-9)
    assert repr(simulation) == "<Simulation: simulation-3; 1 of 1 s; completed>"


def test_commands_fly_external_aircraft_only():
    simulation = testbed.Simulation(short("fleet.uav2.commanded_by=external"))
    assert simulation.names == ("leader", "uav1", "uav2", "uav3")
    sample = simulation.step({"uav2": FbwaCommand(roll=0.4, pitch=0.1, throttle=0.5)}, until=2.5)
    command = [each[2] for each in sample.command]
    assert command == [0.1, 0.4, 0.5]
    assert sample.truth.euler[2, 0] == pytest.approx(0.4, abs=0.05)
    assert abs(sample.truth.euler[1, 0]) < 0.2
    held = simulation.step()
    assert [each[2] for each in held.command] == command
    assert simulation.metrics["outcome"] == "interrupted"


def test_first_command_is_the_trim_without_failsafe():
    simulation = testbed.Simulation(short("fleet.uav2.commanded_by=external"))
    sample = simulation.step(until=3.5)  # longer than failsafe_s
    assert abs(sample.truth.euler[2, 0]) < 0.01
    assert not simulation.events


def test_reset_repeats_the_flight_and_takes_a_seed():
    simulation = testbed.Simulation(short(*NOISY, seconds=1.0))
    first = positions(simulation)
    assert simulation.reset().time_s == 0.0
    assert np.array_equal(positions(simulation), first)
    simulation.reset(seed=7)
    assert simulation.scenario.scenario.seed == 7
    assert not np.array_equal(positions(simulation), first)


UNCLOSED = """
import gc, os, sys, warnings
import testbed
from testbed.logs.mcap_file import LogError
from testbed.scenario import load_scenario, set_duration

warnings.simplefilter("always", ResourceWarning)
simulation = testbed.Simulation(set_duration(load_scenario("simulation-3"), 4.0), out="run")
simulation.step(until=1.0)
if sys.argv[2] == "dropped":
    del simulation
    gc.collect()
elif sys.argv[2] == "forked":
    if not os.fork():
        for use in (lambda: simulation.step(until=9.0), simulation.close):
            try:
                use()
            except LogError as error:
                print(error)
        sys.exit()
    os.wait()
    simulation.step(until=9.0)
    simulation.close()
"""


@pytest.mark.parametrize("ending", ["dropped", "program ends", "forked"])
def test_unclosed_or_forked_flight_keeps_its_log(tmp_path, ending):
    """It is finished with a warning; a fork is refused, and does not change its parent's log."""
    code, printed, errors = run_program(UNCLOSED, ending, folder=tmp_path)
    assert code == 0 and "Traceback" not in errors, errors
    log = read_log(tmp_path / "run" / LOG_NAME)
    if ending == "forked":
        error = "run/run.mcap: this process is a fork of the one that writes the log"
        assert printed.count(error) == 2
        assert log.finished and log.metrics["outcome"] == "completed"
    else:
        assert "ResourceWarning: run/run.mcap: its Simulation was not closed" in errors
        assert log.finished and log.metrics is None and log.time_s[-1] >= 0.96
        assert recover(tmp_path / "run").metrics["simulated_s"] >= 0.96


@pytest.mark.parametrize("kind", [str, Path])
def test_out_is_text_or_a_path(tmp_path, monkeypatch, kind):
    monkeypatch.chdir(tmp_path)
    scenario = short("log.mcap=false", seconds=0.1)
    assert testbed.run(scenario, out=kind("run")).directory == Path("run")
    with testbed.Simulation(scenario, out=kind("stepped")) as simulation:
        simulation.step()
    assert (tmp_path / "stepped" / "metrics.json").is_file()


def test_closed_flight_has_log_and_metrics(tmp_path):
    with testbed.Simulation(short(), out=tmp_path / "run") as simulation:
        simulation.step(until=1.0)
        with pytest.raises(RuntimeError, match="radar"):
            raise RuntimeError("radar")
    assert json.loads((tmp_path / "run" / "metrics.json").read_text())["outcome"] == "interrupted"
    assert testbed.load_run(tmp_path / "run").time_s[-1] == pytest.approx(0.96)
    with pytest.raises(InputError, match="holds one flight"):
        simulation.reset()


@pytest.fixture(scope="module")
def commanded():
    return testbed.Simulation(short("fleet.uav2.commanded_by=external", seconds=1.0))


@pytest.mark.parametrize(
    ("commands", "message"),
    [
        ({"uav1": (0, 0, 0)}, r"write fleet\.uav1\.commanded_by=external"),
        ({"leader": (0, 0, 0)}, r"write leader\.commanded_by=external"),
        ({"uav9": (0, 0, 0)}, "no such aircraft"),
        ({"uav2": (0, 0)}, "uav2: write three numbers: pitch and roll in rad"),
        ({"uav2": (math.nan, 0, 0)}, r"uav2: pitch: is nan \(write a finite number"),
        ({"uav2": (3, 17, 60)}, "uav2: pitch: is 3 .*; 3° is 0.0524 rad"),
        ({"uav2": (0, 0, 60)}, "uav2: throttle: is 60 .*; 60 % is 0.6"),
        ({"uav2": (0.1, 0.1, 0.1), "uav9": (0, 0, 0)}, "no such aircraft"),
        (3, "commands: is 3"),
    ],
)
def test_wrong_commands_are_refused(commands, message, commanded):
    with pytest.raises(InputError, match=message):
        commanded.step(commands)
    assert commanded.time_s == 0.0


def test_ended_flight_takes_no_step():
    simulation = testbed.Simulation(short(seconds=0.1))
    for _ in steps(simulation):
        pass
    with pytest.raises(InputError, match="has ended: completed at 0.1 s"):
        simulation.step()


def test_arduplanes_are_refused():
    with pytest.raises(InputError, match="uav1 has autopilot: ardupilot"):
        testbed.Simulation(short("fleet.uav1.autopilot=ardupilot"))


def test_aircraft_flies_as_replayed_commands(tmp_path, monkeypatch):
    """Against `testbed respond`, which has a loop of its own."""
    airframe = find_aircraft("skywalker_x8")
    rows = [(0.0, 0.05, 0.0, 0.5), (1.0, 0.1, 0.5, 0.6), (2.5, -0.05, -0.3, 0.4)]
    text = "t_s,theta_cmd_rad,phi_cmd_rad,throttle_cmd\n"
    times = np.arange(201) * 0.02
    commands = [max(row for row in rows if row[0] <= t) for t in times]
    text += "".join(
        f"{t:.2f},{p},{r},{h}\n" for t, (_, p, r, h) in zip(times, commands, strict=True)
    )
    (tmp_path / "commands.csv").write_text(text)
    param, out = airframe / "autopilot.param", tmp_path / "out.csv"
    monkeypatch.setattr(replay_commands, "BASE_RATE_HZ", 100)  # that of the aircraft
    respond(airframe, tmp_path / "commands.csv", out, param=param, airspeed=18.0)
    expected = np.genfromtxt(out, delimiter=",", names=True)

    aircraft = testbed.Aircraft("skywalker_x8", airspeed_mps=18)
    roll, airspeed = [], []
    for _, *command in commands[:-1]:
        motion = aircraft.step(*command)
        roll.append(motion.euler[0])
        airspeed.append(float(motion.airspeed))
    np.testing.assert_allclose(roll, expected["phi_rad"][1:], atol=1e-4)
    np.testing.assert_allclose(airspeed, expected["airspeed_mps"][1:], atol=1e-2)
    assert repr(aircraft) == "<Aircraft: skywalker_x8; 4 s; flying>"


def test_aircraft_has_wind_and_sensors():
    wind = {"wind": {"speed_mps": 5, "from_deg": 270}}
    aircraft = testbed.Aircraft("rascal110", airspeed_mps=20, air=wind, sensors="pixhawk", seed=3)
    motion = aircraft.truth
    start = motion.position_ned
    assert motion.airspeed == pytest.approx(20.0, abs=1e-9)
    np.testing.assert_allclose(motion.velocity_ned, [math.sqrt(20.0**2 - 5.0**2), 0, 0], atol=1e-9)
    aircraft.step(0.02, 0.0, 0.3, until=1.0)
    assert aircraft.air.wind_ned[1] == pytest.approx(5.0, abs=1e-6)
    assert not np.array_equal(aircraft.estimate.position_ned, aircraft.truth.position_ned)
    assert np.array_equal(aircraft.reset().position_ned, start)
    np.testing.assert_allclose(start, [0.0, 0.0, -100.0], atol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"aircraft": "rascal111"}, "aircraft: there is no aircraft 'rascal111': did you mean"),
        ({"airspeed_mps": 5}, "airspeed_mps: 5 m/s, 100 m above the ground: no level flight: "),
        ({"airspeed_mps": -1}, "airspeed_mps: is -1 (write a number at least 0.1)"),
        ({"airspeed_mps": math.nan}, "airspeed_mps: is nan (write a finite number)"),
        (
            {"air": {"wind": {"speed_mps": 19, "from_deg": 0}}},
            "airspeed_mps: 18 m/s, 100 m above the ground: no level flight: wind of 19 m/s: at",
        ),
        ({"altitude_m": -3}, "altitude_m: aircraft starts 3 m below the ground"),
        ({"sensors": "pix"}, "sensors: 'pix' is not a preset of sensors"),
        ({"tune": "nope"}, "tune: there is no tune of skywalker_x8 'nope'"),
        ({"air": {"winds": 1}}, "air.winds: is not a key of this section"),
        ({"course_deg": 500}, "course_deg: is 500"),
    ],
)
def test_aircraft_error_names_the_argument(arguments, message):
    arguments = {"aircraft": "skywalker_x8", "airspeed_mps": 18} | arguments
    with pytest.raises(InputError) as caught:
        testbed.Aircraft(**arguments)
    assert str(caught.value).startswith(message) and "\n" not in str(caught.value)


def test_sample_repr_is_one_short_line():
    aircraft = testbed.Aircraft("skywalker_x8", airspeed_mps=18)
    assert repr(aircraft.simulation.state) == "<Sample: 0 s; 1 aircraft, 0 lost>"

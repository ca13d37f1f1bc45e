"""Damping and margins by kicks in steady flight, and `testbed margins`."""

import io
import json
import math
import re
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest
from cases import ALL, some
from cheap_steady_flights import cheap_steady_flights  # noqa: F401 - for all tests
from commands import call_command, refuse_all
from figure_texts import write_texts
from rich.console import Console
from slow_control import RATES
from small_study import in_this_process

from testbed.cli.margins import _table
from testbed.cli.output import MISSING
from testbed.core.errors import InputError
from testbed.core.records import AIRCRAFT, allocate
from testbed.flight.schedule import make_clock
from testbed.linear import flown_margins as margins
from testbed.linear.flown_margins import (
    Copies,
    FlownMargins,
    FollowerMargins,
    Margins,
    independent_groups,
    worse_of,
)
from testbed.linear.held_flight import COMMANDS, HeldFlight, InputChanges
from testbed.linear.linear_formation import join
from testbed.linear.linear_system import Mode
from testbed.linear.loop_margins import CommandMargins
from testbed.linear.pooled_margins import _predict, predicted_margins_of
from testbed.linear.predicted_margins import (
    PredictedMargins,
    Prediction,
    _check_linearisable,
    linearise,
)
from testbed.linear.steady_flight import (
    MarginsError,
    banks_deg,
    fly_steadily,
    look_at_limits,
    steady_scenario,
    suitable_banks,
)
from testbed.plan import vehicles
from testbed.plan.world import build
from testbed.pool.flight_task import FlightTask, run_task
from testbed.scenario import load_scenario
from testbed.tuning.tune_constraints import measurements
from testbed.tuning.tune_schema import Constraint

FIRST = np.array([True, False, False])
ROLL = COMMANDS.index("roll")


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("simulation-3", RATES)


@pytest.fixture(scope="module")
def turn(scenario):
    """A clockwise circle with the highest bank at 30 degrees, and its linearised formation."""
    flight, problem = fly_steadily(scenario, 30.0, 0.0, "compiled")
    assert not problem
    return flight, join(linearise(flight))


@pytest.fixture(scope="module")
def copies(scenario, turn):
    return Copies(turn[0], independent_groups(scenario))


def test_steady_flight_banks_as_its_circle_needs(turn):
    """Slots farther out fly faster and bank more; the highest bank is the one asked for."""
    uav1, uav2, uav3 = banks_deg(turn[0])
    assert uav1 < uav2 - 2.0 and uav2 == pytest.approx(uav3, abs=0.1)
    assert uav2 == pytest.approx(30.0, abs=0.5)


def test_copies_differ_by_the_change(copies):
    """Two copies are equal; half a kick is half the response; that of uav3 moves no other."""
    still = copies.respond(2.0, copies.unchanged)
    assert (copies.respond(2.0, copies.unchanged) == still).all()
    full = copies.respond(2.0, copies.unchanged, FIRST[::-1]) - still
    assert not full[:, :2].any() and 0.001 < np.degrees(np.abs(full[:, 2, 0]).max()) < 0.05
    with pytest.MonkeyPatch.context() as halved:
        halved.setattr(margins, "KICK_DEG", 0.5 * margins.KICK_DEG)
        halved.setattr(margins, "KICK_THROTTLE", 0.5 * margins.KICK_THROTTLE)
        half = copies.respond(2.0, copies.unchanged, FIRST[::-1]) - still
    assert half == pytest.approx(0.5 * full, abs=0.01 * np.abs(full).max())


def test_gain_and_latency_move_nothing_alone(copies):
    """Without a kick the deviations that they change are zero, but for a slow drift."""
    still = copies.respond(2.0, copies.unchanged)
    gain, late = copies.unchanged
    for change in ((gain + 0.5, late), (gain, late + 0.05)):
        moved = copies.respond(2.0, change) - still
        assert np.degrees(np.abs(moved[..., :2]).max()) < 0.02


@pytest.mark.parametrize("command", some(COMMANDS, 1))
def test_flown_margins_are_those_predicted(turn, copies, command):
    """A kick decays at 0.97 times the predicted factor and latency, and grows at 1.03 times."""
    k = COMMANDS.index(command)
    expected = turn[1].loop(f"uav1.{command}").margins()
    assert expected.gain > 2.0 and 0.2 < expected.latency_s < 0.95
    for share, decays in ((0.97, True), (1.03, False)):
        changes = (share * expected.gain, 0.0), (1.0, share * expected.latency_s)
        for gain, late in changes if ALL else changes[:1]:  # a latency: test_phases
            found = copies.dampings(k, np.full(3, gain), np.full(3, late), FIRST)[0]
            assert bool(found > 0.0) is decays, (share, gain, late, found)


_WRITE = InputChanges._write


def write_what_is_there(self, records):
    """Change a command as if control had given what is there, in each period of the autopilots."""
    self._read(records.aircraft["command"])
    _WRITE(self, records)


def test_margins_need_the_command_as_given(turn, copies, monkeypatch):
    """A factor that acts again on a held command is squared in each second period of autopilots."""
    margin = turn[1].loop("uav1.roll").margins().gain
    factor = 0.65 * margin
    assert 0.5 * (factor + factor**2) > 1.2 * margin
    changed = ROLL, np.full(3, factor), np.zeros(3), FIRST
    assert copies.dampings(*changed)[0] > 0.02
    monkeypatch.setattr(InputChanges, "_write", write_what_is_there)
    assert copies.dampings(*changed)[0] <= 0.0


CLOCKS = {
    "25 Hz": ({"control_hz": 25}, False),
    "10 Hz": ({"control_hz": 10}, False),
    "phases": ({"control_hz": 10, "phases": (0.0, 0.33, 0.7)}, False),
    "as fast as autopilots": ({"control_hz": 50}, False),
    "companions": ({"control_hz": 10}, True),
}


def commands_read(clock, changes, given, each_period):
    """Return the roll commands (K, 2) that autopilots read, where control gives `given(tick)`."""
    aircraft = allocate(AIRCRAFT, 3)
    records, read = SimpleNamespace(aircraft=aircraft, followers=None, links=None), []
    for tick in range(60):
        now = clock.time_s(tick)
        changes._change_held(now, records)
        phases = 0, *clock.control_phases
        control = [(tick - phase) % clock.control == 0 or not tick for phase in phases]
        for i, due in enumerate(control):
            if due:
                aircraft["control"]["roll"][i] = given(tick)
        if any(control) or (each_period and tick % clock.autopilot == 0):
            aircraft["command"]["roll"] = aircraft["control"]["roll"]
            changes._change_given(now, records)
        if tick % clock.autopilot == 0:
            read.append(aircraft["command"]["roll"][1:].copy())
    return np.array(read)


@pytest.mark.parametrize("name", CLOCKS)
def test_a_held_command_is_changed_once(name):
    """At all rates and phases: a factor is no power of itself, a latency is as long as it is."""
    rates, each_period = CLOCKS[name]
    clock = make_clock(
        **{"physics_hz": 100, "autopilot_hz": 50, "broadcast_hz": 10, "log_hz": 10, **rates},
        aircraft=3,
    )

    def fly(gain, latency_s, kick=0.0):
        changes = InputChanges(2, clock, each_period=each_period)
        changes.gain[:], changes.latency_s[:] = gain, latency_s
        changes.added[:] = kick
        changes.begin(np.full((2, 3), 0.5))
        return commands_read(clock, changes, lambda tick: 0.5 + math.sin(tick), each_period)

    plain = fly(1.0, 0.0)
    assert np.unique(plain[:, 0]).size == np.unique(plain[:, 0].round(12)).size > 5
    assert fly(3.0, 0.0) - 0.5 == pytest.approx(3.0 * (plain - 0.5))
    assert fly(1.0, 0.0, kick=0.1) == pytest.approx(plain + 0.1)
    late = fly(2.0, 0.06)
    assert late[3:] - 0.5 == pytest.approx(2.0 * (plain[:-3] - 0.5))
    assert late[:3] == pytest.approx(0.5)  # the steady command, before
    between = fly(1.0, 0.05)
    assert between[3:] == pytest.approx(0.5 * (plain[:-3] + plain[1:-2]))


def test_changing_what_is_there_acts_twice(monkeypatch):
    """The negative control of the test before."""
    monkeypatch.setattr(InputChanges, "_write", write_what_is_there)
    clock = make_clock(
        physics_hz=100, autopilot_hz=50, control_hz=25, broadcast_hz=25, log_hz=25, aircraft=3
    )
    changes = InputChanges(2, clock)
    changes.gain[:] = 3.0
    changes.begin(np.zeros((2, 3)))
    read = commands_read(clock, changes, lambda tick: math.sin(tick + 1.0), False)
    assert read[1::2] == pytest.approx(3.0 * read[::2])


def test_displacement_is_that_of_both_engines(scenario):
    """Each follower is moved to its right and down; nothing else of its motion changes."""
    moved = []
    for engine in ("compiled", "jsbsim"):
        flight = HeldFlight(build(steady_scenario(scenario, 30.0, engine)))
        before = flight.world.aircraft["truth"][1:].copy()
        flight.displace(2.0)
        after = flight.world.aircraft["truth"][1:]
        moved.append(after["position_ned"] - before["position_ned"])
        for name in ("velocity_ned", "euler", "rates_body"):
            assert after[name] == pytest.approx(before[name], abs=1e-3)
    compiled, jsbsim = moved
    assert np.abs(compiled[:, 2]) == pytest.approx(2.0, abs=1e-3)
    assert np.linalg.norm(compiled, axis=1) == pytest.approx(2.0 * math.sqrt(2.0), abs=1e-3)
    # JSBSim moves it down along the radius of the Earth, 0.2° from the vertical
    assert jsbsim == pytest.approx(compiled, abs=1e-2)


def test_largest_is_bisected_for_each_follower():
    """The first value at which the damping is no longer positive; inf beyond the highest."""
    limits = np.array([0.0, 0.31, 0.77, 2.0])
    asked = []

    def dampings(values, of):
        asked.append(of.copy())
        return limits - values

    found = margins._largest(4, 1.0, 0.01, dampings)
    assert found[:3] == pytest.approx(limits[:3], abs=0.01) and np.isinf(found[3])
    assert (found[:3] <= limits[:3]).all()
    assert not asked[-1][3]  # what is beyond is not flown again


def test_damping_of_a_limit_cycle_is_not_positive():
    """The fit alone says that it decays; a fast decay to rest is no limit cycle."""
    times = np.arange(0.0, 12.0, 0.04)
    cycle = np.clip(0.05 * np.exp(times), 0.0, 1.0) * np.sin(6.1 * times)
    decay = np.exp(-0.8 * times) * np.sin(5.0 * times)
    assert margins._damping(np.stack((cycle, cycle), axis=1), 0.04) <= 0.0
    assert margins._damping(np.stack((decay, decay), axis=1), 0.04) == pytest.approx(
        0.158, abs=1e-3
    )
    assert margins._damping(np.full((100, 2), np.nan), 0.04) == -1.0
    # one that has reached its limit within the first quarter, and shrinks a little from there
    soon = 1e-3 * np.sin(6.1 * times) * np.minimum(np.exp(2.0 * times), 1e3) * 0.999**times
    assert margins._damping(np.stack((soon, soon), axis=1), 0.04) <= 0.0


def test_settling_is_that_of_the_displaced_formation(copies, monkeypatch):
    """Five per cent of a displacement of √2 m are left; sooner it is more."""
    if not ALL:
        monkeypatch.setattr(margins, "LONG_RECORD_S", 45.0)
    flown, respond = [], copies.respond

    def keep(*arguments, **displaced):
        flown.append(respond(*arguments, **displaced))
        return flown[-1]

    monkeypatch.setattr(copies, "respond", keep)
    times = margins._settling(copies)
    still, moved = flown
    error = np.linalg.norm((moved - still)[..., 2:], axis=-1)
    assert error[0] == pytest.approx(math.sqrt(2.0), rel=0.02)
    for i, settled in enumerate((times / copies.flight.dt).round().astype(int)):
        assert error[settled - 1, i] > 0.05 * math.sqrt(2.0) >= error[settled:, i].max()


def test_independent_groups_follow_the_graph():
    chain = load_scenario("simulation-3")
    assert [each.tolist() for each in independent_groups(chain)] == [[0], [1], [2]]
    gains = {"neighbour_gains": {"uav3": {"uav1": 1.0}}}
    fork = chain.model_copy(update={"formation": chain.formation.model_copy(update=gains)})
    assert [each.tolist() for each in independent_groups(fork)] == [[0, 1], [2]]
    own = load_scenario("own-law-repulsion")
    assert [each.tolist() for each in independent_groups(own)] == [[0], [1], [2]]


def test_margins_worse_of_both_directions():
    same = {name: FlownMargins(3.0, 0.5) for name in ("pitch", "throttle")}
    left = FollowerMargins(
        "uav1",
        -29.0,
        margins.Oscillation(0.9, 0.2),
        8.0,
        same | {"roll": FlownMargins(2.0, math.inf)},
    )
    right = FollowerMargins(
        "uav1",
        30.0,
        margins.Oscillation(1.4, 0.3),
        None,
        same | {"roll": FlownMargins(math.inf, 0.1)},
    )
    turns = [Margins(30.0, (right,), "", ""), Margins(-30.0, (left,), "", "")]
    [worse] = worse_of(turns).followers
    assert (worse.bank_deg, worse.least_damped.damping) == (30.0, 0.2)
    assert (worse.settling_s, worse.commands["roll"]) == (None, (2.0, 0.1))
    assert worse.commands["pitch"] == (3.0, 0.5)
    rings = worse_of([Margins(30.0, (), "not steady", ""), turns[1]])
    assert rings.followers == () and rings.problem == "clockwise: not steady"


def test_margins_required_are_measured_by_a_worker():
    """The same numbers as by hand, in one direction; what is not required is left out."""
    of = Constraint(bank_deg=30.0, damping=0.2, roll_gain=3.0)
    clockwise, _ = measurements([of])
    result = run_task(FlightTask(0, load_scenario("simulation-3", RATES), measure=clockwise))
    assert result.outcome == "completed", result.error
    assert set(result.metrics) == {"problem", "damping", "damping_at_roll_gain"}
    assert result.metrics["damping"] > result.metrics["damping_at_roll_gain"] > 0.0


def test_margins_command_refuses(tmp_path):
    with in_this_process():
        refuse_all("margins", tmp_path)


def test_banks_are_below_the_limits_of_the_followers():
    """Known before the first flight: default banks are lowered, and those asked for refused."""
    low = load_scenario("simulation-3", ["controller.gains={limits: {roll_deg: 45}}"])
    assert suitable_banks(low, (0.0, 30.0, 45.0), asked=False) == [0.0, 30.0, pytest.approx(43.0)]
    with pytest.raises(MarginsError, match=r"limit of uav1, 45°, .*write at most 43"):
        suitable_banks(low, (0.0, 30.0, 45.0), asked=True)
    assert suitable_banks(low, (0.0, 43.0), asked=True) == [0.0, 43.0]  # the remedy


def test_a_turn_at_the_limit_has_no_room_for_kicks(turn, monkeypatch):
    """The commands are looked at, too: with sideslip they are higher than the bank."""
    assert look_at_limits(turn[0]) == ("", "")
    uav1, uav2, _ = np.degrees(turn[0].inputs.computed[:, ROLL])
    reserve = "testbed.linear.steady_flight.ROLL_RESERVE_DEG"
    monkeypatch.setattr(reserve, 50.0 - 0.5 * (uav1 + uav2))
    problem, _ = look_at_limits(turn[0])
    assert problem == "uav2, uav3 are too near the limit of the bank for kicks"


@pytest.mark.parametrize(
    ("override", "about", "remedy", "texts"),
    [
        (
            "controller.companion={state_latency_s: 0.02}",
            "companion computers",
            "(write controller.companion: {state_latency_s: 0, command_latency_s: 0, "
            "link: direct})",
            ["controller.companion={state_latency_s: 0, command_latency_s: 0, link: direct}"],
        ),
        (
            "rates={broadcast_hz: 5, synchronous: false}",
            "messages are not sent",
            "(write rates.broadcast_hz as control_hz, and no network.tdma or network.broadcast)",
            ["rates.broadcast_hz=25"],
        ),
        (
            "network.loss=0.1",
            "the network is random",
            "(write a network without chance: delay_s alone)",
            ["network.loss=0", "network.delay_s=0.1"],
        ),
    ],
)
def test_remedies_of_what_cannot_be_linearised(override, about, remedy, texts):
    """What the error says to write is written, and the formation can be linearised."""

    def check(overrides):
        world = build(steady_scenario(load_scenario("simulation-3", overrides), 0.0, "auto"))
        _check_linearisable(world)

    with pytest.raises(MarginsError, match=about) as caught:
        check([override])
    assert str(caught.value).endswith(remedy)
    check([override, *texts])


def test_law_that_sends_numbers_is_refused(scenario, monkeypatch):
    """The linear model does not have them; flights measure it."""
    world = build(steady_scenario(scenario, 0.0, "auto"))
    _check_linearisable(world)
    monkeypatch.setattr(world.formation.built_control.outputs, "sent", ("leader_m",))
    with pytest.raises(MarginsError, match="the laws of others send.*--method flown"):
        _check_linearisable(world)


def test_remedy_of_margins_is_the_flown_method(monkeypatch):
    """An aircraft that JSBSim flies: the error names why, and a method that accepts it."""
    why = "aircraft/GBSap.xml:58: <sensor> is not translated; the aircraft is flown by JSBSim"
    monkeypatch.setattr(vehicles, "make_compiled_fleet", lambda *_: (None, why))
    scenario = load_scenario("simulation-3")
    with pytest.raises(InputError, match="--method flown") as caught:
        _predict(0.0, 0.0, scenario)
    assert str(caught.value).startswith(f"{why}, so the formation cannot be linearised (")
    assert not re.search("engine: auto", str(caught.value))
    world = build(steady_scenario(scenario, 0.0, scenario.scenario.engine))
    assert HeldFlight(world).world.fleet.engine == "jsbsim"  # as measured


def test_predicted_margins_are_beside_flown_ones():
    """Of `--method both`, in 80 columns; what is beyond the largest value tried is "> 10"."""
    mode = Mode(2.4, 0.34, complex(-5.0, 15.0), "uav1", "pitch")
    margins = {name: CommandMargins(9.6754, 0.0, 0.6027, 60.0, 0.7) for name in COMMANDS}
    other = {name: FlownMargins(math.inf, 0.5982) for name in COMMANDS}
    predicted = Prediction(30.0, (PredictedMargins("uav1", 27.5, mode, margins, (mode,)),), "", ())
    flown = Margins(30.0, (FollowerMargins("uav1", -27.5, None, None, other),), "", "")
    console = Console(width=80, file=io.StringIO())
    console.print(_table([flown], [predicted]))
    text = console.file.getvalue()
    rows = [line.split() for line in text.splitlines() if "roll" in line]
    assert rows == [["roll", "9.68", ">", "10", "0.603", "0.598"]]
    assert all(word in text for word in ("> 90", "pred.", "flown", "throttle"))
    console = Console(width=80, file=io.StringIO())
    console.print(_table([flown], []))
    assert "9.68" not in console.file.getvalue() and "-27.5" in console.file.getvalue()


def test_margins_that_are_not_predicted_are_no_numbers():
    """Of `--method both`, at a bank at which the prediction has a problem."""
    other = {name: FlownMargins(9.5, 0.5982) for name in COMMANDS}
    flown = Margins(30.0, (FollowerMargins("uav1", -27.5, None, None, other),), "", "")
    console = Console(width=80, file=io.StringIO())
    console.print(_table([flown], [Prediction(30.0, (), "not steady", ())]))
    rows = [line.split() for line in console.file.getvalue().splitlines() if "roll" in line]
    assert rows == [["roll", MISSING, "9.50", MISSING, "0.598"]]


@pytest.fixture(scope="module")
def predicted(tmp_path_factory):
    """Return what `testbed margins` prints of a chain, the folder of its files, its numbers."""
    folder, found = tmp_path_factory.mktemp("predicted"), []

    def keep(*arguments):
        found.append(predicted_margins_of(*arguments))
        return found[-1]

    words = ["margins", "simulation-2", "--bank", "0", "--jobs", "1"]
    words += [word for each in RATES for word in ("--set", each)]
    known = "testbed.linear.pooled_margins.predicted_margins_of"
    with in_this_process(), patch(known, keep), pytest.MonkeyPatch.context() as drawn:
        write_texts(drawn)
        done = call_command(
            *words, "--json", "m.json", "--plot", "p.svg", cwd=folder, code=0, columns=80
        )
    return done.stdout, folder, found[0]


def test_margins_command_predicts(predicted):
    """A table, a figure of the poles, and all poles as JSON; a chain bears every message delay."""
    printed, folder, _ = predicted
    assert "stable at every message delay" in printed
    assert "uav3" in (folder / "p.svg").read_text("utf-8").splitlines()
    [straight] = json.loads((folder / "m.json").read_text())["predicted"]
    assert straight["message_delays"] == []
    for follower in straight["followers"]:
        oscillations = [mode for mode in follower["modes"] if mode["frequency_hz"] > 0.0]
        assert oscillations[0] == follower["least_damped"] and len(oscillations) > 3
        assert follower["commands"]["pitch"]["gain"] > 2.0  # 6 dB


def test_margins_command_draws_a_loop(predicted, tmp_path, monkeypatch):
    """The poles of the open and the closed loop are marked, and the curve of all factors."""
    grids = []
    monkeypatch.setattr(
        "testbed.views.matplotlib_backend.save_figure", lambda grid, *_: grids.append(grid)
    )
    if not ALL:  # of a coarser curve
        monkeypatch.setattr("testbed.cli.margins.FACTORS", (0.02, 10.0, 12))
    known = "testbed.linear.pooled_margins.predicted_margins_of"
    monkeypatch.setattr(known, lambda *_: predicted[2])
    words = ["--bank", "0", "--jobs", "1", "--plot", "p.svg", "--figure", "root-locus"]
    words += [word for each in RATES for word in ("--set", each)]
    with in_this_process():
        call_command("margins", "simulation-2", *words, cwd=tmp_path, code=0, columns=80)
    [[panel]] = grids[0].rows
    assert panel.title == "straight" and "roll command" in grids[0].subtitle
    labels = [line.label for line in panel.lines if line.label]
    assert labels[2:] == ["uav1", "uav2", "uav3", "factor 0", "factor 1"]
    open_, closed = (
        next(line for line in panel.lines if line.label == name)
        for name in ("factor 0", "factor 1")
    )
    [straight] = json.loads((predicted[1] / "m.json").read_text())["predicted"]
    modes = straight["followers"][0]["modes"]
    least = next(each for each in modes if each["frequency_hz"] > 0.1 and each["motion"] == "bank")
    turn, damping = 2.0 * math.pi * least["frequency_hz"], least["damping"]
    pole = complex(-turn * damping / math.sqrt(1.0 - damping**2), turn)
    near = np.abs(closed.x + 2j * np.pi * closed.y - pole)
    assert np.nanmin(near) < 1e-3
    assert np.nanmin(np.abs(open_.x + 2j * np.pi * open_.y - pole)) > 0.05

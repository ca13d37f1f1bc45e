"""Laws of users linearised, beside flights: their memory, their messages and their margins.

TESTBED_LAW_MARGINS=1 flies all commands of both laws, straight and in a turn.
"""

import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cases import ALL, in_full
from cheap_steady_flights import cheap_steady_flights  # noqa: F401 - for all tests
from scipy.signal import dlsim
from slow_control import RATES
from user_laws import FILTERED

import testbed
from testbed.core.errors import InputError
from testbed.formation.compiled_law import CompiledLaw
from testbed.linear import (
    delay_margin,
    follower_state,
    loop_margins,
    period_map,
    predicted_margins,
    straight_formation,
)
from testbed.linear.delay_margin import delay_margins
from testbed.linear.flown_margins import independent_groups
from testbed.linear.follower_state import held_fields, problem_of_memory
from testbed.linear.held_flight import COMMANDS, KICK_S
from testbed.linear.limit_cycle import find_limit_cycle
from testbed.linear.linear_formation import join
from testbed.linear.predicted_margins import (
    fly_linearisable,
    linearise,
    with_later_messages,
)
from testbed.linear.straight_formation import linearise_straight, shares
from testbed.linear.string_gain import hop_gains
from testbed.scenario import load_scenario
from testbed.studies.predicted_numbers import predict_numbers

EXAMPLE = Path(__file__).parents[3] / "examples" / "leader-follower-kernel.yaml"
WHOLE = bool(os.environ.get("TESTBED_LAW_MARGINS"))
KICK = math.radians(0.02)
KICK_THROTTLE = 1e-3
SHARES = {"gain": 0.05, "latency_s": 0.03}  # by which a predicted margin may be wrong
SLOW = () if WHOLE else RATES

# towards a weighted mean of the slots that leader and neighbours show, whose stamps it uses itself
MEAN = """
import numpy as np
import testbed
from testbed.law import FbwaCommand

@testbed.kernel(memory=[("speed_m", float), ("height_ms", float)])
def mean(now, own, inbox, memory, config, closing=0.9, course=3.0, field=0.06):
    velocity = inbox.velocity_ned[0]
    if not np.isfinite(velocity[0]):
        return FbwaCommand(0.0, 0.0, config.trim_throttle)
    level = np.hypot(velocity[0], velocity[1])
    north, east = velocity[0] / level, velocity[1] / level
    slot = config.offsets[config.agents]
    along, across, below, weights = 0.0, 0.0, 0.0, 0.0
    for j in range(config.gains.shape[0]):
        weight = config.gains[j, 0]
        if weight == 0.0 or not np.isfinite(inbox.stamp_s[j]):
            continue
        moved = (now - inbox.stamp_s[j]) * inbox.velocity_ned[j]
        offset = inbox.position_ned[j] + moved - own.position_ned
        apart = slot - config.offsets[j]
        along += weight * (offset[0] * north + offset[1] * east + apart[0])
        across += weight * (offset[1] * north - offset[0] * east + apart[1])
        below += weight * (offset[2] + apart[2])
        weights += weight
    along, across, below = along / weights, across / weights, below / weights
    ground = np.hypot(own.velocity_ned[0], own.velocity_ned[1])
    wanted = min(max(level + closing * along, config.airspeed_min), config.airspeed_max)
    bearing = np.arctan2(velocity[1], velocity[0]) + 0.7 * np.arctan(field * across)
    error = bearing - np.arctan2(own.velocity_ned[1], own.velocity_ned[0])
    error = (error + np.pi) % (2.0 * np.pi) - np.pi
    throttle = config.trim_throttle + 0.3 * (wanted - ground) + 0.02 * memory.speed_m
    pitch = -velocity[2] / level - 0.05 * (below + 0.05 * memory.height_ms)
    memory.speed_m += config.dt * (wanted - ground)
    memory.height_ms += config.dt * below
    return FbwaCommand(pitch, course * error, throttle)
"""


@pytest.fixture(scope="module")
def laws(tmp_path_factory):
    """Return scenarios by the name of their law."""
    folder = tmp_path_factory.mktemp("laws")

    def write(name, text, base):
        (folder / f"law_{name}.py").write_text(text, "utf-8")
        law = next(each for each in ("filtered", "mean") if f"def {each}(" in text)
        lines = (
            f"extends: {base}",
            f"scenario: {{name: {name}}}",
            f'controller: {{law: "law_{name}:{law}"}}',
        )
        (folder / f"{name}.yaml").write_text("\n".join(lines), "utf-8")
        return str(folder / f"{name}.yaml")

    return {
        "filtered": write("filtered", FILTERED, "simulation-3"),
        "mean": write("mean", MEAN, "simulation-1"),
        "example": str(EXAMPLE),
    }


class Flown:
    """A steady flight of a law and its linearised formation."""

    def __init__(self, scenario, bank_deg, settings=()):
        self.flight, problem = fly_linearisable(load_scenario(scenario, settings), bank_deg)
        assert not problem
        self.start = self.flight.save()
        self.maps = linearise(self.flight)
        self.formation = join(self.maps)

    def without_memory(self):
        """Return the formation as it would be if the memory of its law was no state."""
        a = self.formation.a.copy()
        a[[".law/" in name for name in self.formation.states]] = 0.0
        return replace(self.formation, a=a)

    def respond(self, periods, command=0, **changes):
        """Return the response (K, 5) of uav1 to a kick with a factor or a latency of a command."""
        inputs, kick = self.flight.inputs, np.zeros((3, 3))
        kick[0] = KICK, KICK, KICK_THROTTLE
        rows = []
        for each in (kick, None):
            inputs.end()
            for name, value in changes.items():
                getattr(inputs, name)[0, command] = value
            rows.append(self.flight.respond(self.start, periods, each)[:, 0])
        inputs.end()
        return rows[0] - rows[1]

    def grows(self, command, **changes):
        """Return whether a kick grows in 150 s, or has grown into a limit cycle."""
        response = np.abs(self.respond(round(150.0 / self.flight.dt), command, **changes)[:, :2])
        eighths = [each.max() for each in np.array_split(response, 8)]
        return eighths[-1] > eighths[1] or max(eighths) > 15.0 * KICK


@pytest.fixture(scope="module")
def turns(laws):
    """Return a function of a law and a bank, each flown once."""
    known = {}

    def turn(name, bank_deg):
        if (name, bank_deg) not in known:
            known[name, bank_deg] = Flown(laws[name], bank_deg, SLOW)
        return known[name, bank_deg]

    return turn


@pytest.fixture(scope="module")
def scan(laws):
    """Return a straight flight of the example, in which options are changed."""
    return testbed.GainScan(laws["example"], RATES)


def predicted(formation, periods):
    """Return roll and pitch (K, 2) of uav1 after a kick of its commands for 0.2 s."""
    kicked = formation.select(
        [f"uav1.{each}" for each in COMMANDS], ["uav1.attitude.roll", "uav1.attitude.pitch"]
    )
    inputs = np.zeros((periods, 3))
    inputs[: round(KICK_S / formation.dt)] = KICK, KICK, KICK_THROTTLE
    return dlsim(kicked.to_scipy(), inputs)[1]


def test_memory_of_a_law_is_a_state(turns):
    """By its names; whole numbers are held, and named."""
    turn = turns("filtered", 30.0)
    own = [name for name in turn.formation.states if name.startswith("uav2.law/")]
    assert own == [f"uav2.law/pull_ned[{k}]" for k in range(3)]
    [group] = turn.flight.world.formation.built_control.groups
    assert held_fields(group.law) == ("steps",)
    note = predicted_margins._describe_held(turn.flight.world)
    assert note == "held, as whole numbers and flags have no derivatives: memory steps"


@pytest.mark.parametrize("name", ["filtered", "example"] if ALL else ["filtered"])
def test_response_needs_the_memory_of_a_law(turns, name):
    """The response to a kick is that of a flight, and another one without the memory."""
    turn = turns(name, 30.0)
    periods = round(20.0 / turn.flight.dt)
    flown = turn.respond(periods)[:, :2]
    errors = [
        np.linalg.norm(predicted(each, periods) - flown) / np.linalg.norm(flown)
        for each in (turn.formation, turn.without_memory())
    ]
    assert errors[0] < 0.01 < 0.02 < errors[1]


CASES = [("filtered", 30.0, "roll", "gain"), ("filtered", 30.0, "roll", "latency_s")]
if WHOLE:
    CASES = [
        (name, bank_deg, command, what)
        for name in ("filtered", "example")
        for bank_deg in (0.0, 30.0)
        for command in COMMANDS
        for what in SHARES
    ]


@in_full  # responses of these laws, and margins of the built-in one, are compared with flights
@pytest.mark.parametrize(("name", "bank_deg", "command", "what"), CASES)
def test_margins_of_a_law_are_those_of_flights(turns, name, bank_deg, command, what, monkeypatch):
    """Oscillations decay just below a predicted margin, and grow just above it."""
    monkeypatch.setattr(loop_margins, "MAX_GAIN", 40.0)
    monkeypatch.setattr(loop_margins, "MAX_LATENCY_S", 3.0)
    turn, share = turns(name, bank_deg), SHARES[what]
    margin = getattr(turn.formation.loop(f"uav1.{command}").margins(), what)
    if math.isinf(margin):
        pytest.skip("beyond the largest value that is reported")
    number = COMMANDS.index(command)
    assert not turn.grows(number, **{what: (1.0 - share) * margin})
    assert turn.grows(number, **{what: (1.0 + share) * margin})


def test_margins_need_the_memory_of_a_law(turns):
    """Without it as a state the predicted latency is wrong by more than that."""
    turn = turns("filtered", 30.0)
    right, wrong = (
        each.loop("uav1.roll").margins().latency_s
        for each in (turn.formation, turn.without_memory())
    )
    assert abs(wrong / right - 1.0) > 1.5 * SHARES["latency_s"]


def test_memory_in_wrong_axes_is_refused(turns, monkeypatch):
    """A vector that turns with the aircraft and is not known as one by the end of its name.

    Its derivatives change in a turn.
    """
    found = []
    check = period_map._check_memory

    def record(flight, states, followers, group, turned):
        after = period_map._control_maps(flight, states, group)
        for old, new in zip(followers, after, strict=True):
            own = np.array([label.startswith("law/") for label in old.labels])
            before = old.a[0][own][:, ~own]
            found.append(np.abs(new.a[own][:, ~own] - before).max() / np.abs(before).max())
        check(flight, states, followers, group, turned)

    monkeypatch.setattr(period_map, "_check_memory", record)
    if ALL:  # else it is right as far as the formation above is linearised
        linearise(turns("filtered", 30.0).flight)
        assert max(found) < 1e-4
        found.clear()
    for module in (follower_state, period_map):
        monkeypatch.setattr(module, "NED", "_axes")
    text = r"memory pull_ned of uav1 changes .*\(write pull_ned_axes if"
    with pytest.raises(InputError, match=text):
        linearise(turns("filtered", 30.0).flight)
    assert max(found) > 0.02


def test_numbers_that_nothing_reads_are_not_checked():
    """As one that is only logged: whether they change in a turn is of no importance.

    Of these three the first has an effect on a command, the second on the first.
    """
    own = np.array([False, True, True, True])
    a, command = np.zeros((1, 4, 4)), np.zeros((1, 3, 4))
    command[0, 1, 1] = a[0, 1, 2] = a[0, 3, 1] = 0.1
    follower = period_map.FollowerMap("uav1", (), a, command, *[np.zeros(0)] * 3, {}, {})
    assert period_map._used(follower, own).tolist() == [True, True, False]


def memory_problem(*fields):
    """Return the problem of a law with this memory, which is not compiled."""
    law = CompiledLaw.__new__(CompiledLaw)
    law._memory = np.zeros(2, dtype=np.dtype(list(fields), align=True))
    return problem_of_memory(law)


def test_memory_that_cannot_be_linearised():
    """Coarse numbers, and vectors that are none; each with what to write."""
    problem, remedy = memory_problem(("speed", float), ("mean", np.float32))
    assert "mean of the law is float32" in problem and remedy == "write float in its declaration"
    problem, remedy = memory_problem(("wind_ned", float, 2))
    assert "wind_ned of the law is no vector" in problem and "3 numbers" in remedy
    assert memory_problem(("winds_ned", float, (4, 3)), ("steps", int)) == ("", "")


def test_messages_without_effect_are_not_received(scan):
    """Each follower of a user's law gets the messages of all; the example uses the leader's."""
    scenario, flight = load_scenario(str(EXAMPLE), RATES), scan._flight
    assert flight.world.formation.built_control.neighbours["used"].all()
    assert [set(each.b_message) for each in scan._maps.followers] == [{0}] * 3
    assert join(scan._maps).coupled_parts() == (("uav1",), ("uav2",), ("uav3",))
    # so all are kicked in one flight where margins are flown, and the flight is as before
    start = flight.save()
    assert [each.tolist() for each in independent_groups(scenario, flight)] == [[0, 1, 2]]
    assert [each.tolist() for each in independent_groups(scenario)] == [[0], [1], [2]]
    again = flight.record(50)
    start.restore()
    assert np.array_equal(again, flight.record(50))
    start.restore()


def test_scan_of_a_law_has_its_options(laws, scan):
    """One flight; margins with other options are those of a flight with them."""
    memory = [name for name in scan.formation().states if "uav1.law" in name]
    assert memory == ["uav1.law/speed_m", "uav1.law/height_ms"]
    changed = "controller.options={closing: 0.6, course: 3.5}"
    found = scan.margins([changed])["uav2"]["roll"]
    if ALL:  # those of the built-in law are compared in test_gain_scan
        own = testbed.linearise(laws["example"], [*RATES, changed])
        expected = own.loop("uav2.roll").margins()
        assert found.latency_s == pytest.approx(expected.latency_s, rel=0.01)
    before = scan.margins()["uav2"]["roll"]
    assert found.latency_s < 0.9 * before.latency_s
    with pytest.raises(InputError, match="keys of controller but its law"):
        scan.margins(["controller.law=hbh23", "controller.options={}"])


@in_full  # the margins of a law by command, and those of the built-in one by studies, are tested
def test_study_predicts_a_law(laws):
    """`predict: {margins_at_deg: 0}`, as for the built-in law."""
    found = predict_numbers(0.0, load_scenario(laws["example"]))["margins"]
    assert found["damping"] == pytest.approx(0.42, abs=0.01)
    assert found["roll_latency_s"] == pytest.approx(0.92, abs=0.01)


@in_full  # responses of laws of users, and limit cycles of the built-in one, are tested
def test_limit_cycle_of_a_law_is_that_of_a_flight(turns):
    """Near the limit of the bank, and 7 % later than the roll command bears."""
    turn, uav2 = turns("example", 47.5), 1
    world = turn.flight.world
    turn.start.restore()
    limit = world.formation.built_control.config.roll_limit[uav2]
    room_deg = math.degrees(limit - world.aircraft["control"]["roll"][1 + uav2])
    latency_s = 1.07 * turn.formation.loop("uav2.roll").margins().latency_s
    found = find_limit_cycle(turn.formation, "uav2", latency_s, room_deg)
    kick = np.zeros((3, 3))
    kick[uav2, 1] = math.radians(5.0)
    turn.flight.inputs.end()
    turn.flight.inputs.latency_s[uav2, 1] = latency_s
    rows = turn.flight.respond(turn.start, 2000, kick)[-500:, uav2, 0]
    turn.flight.inputs.end()
    bank = np.degrees(rows - rows.mean())
    spectrum = np.abs(np.fft.rfft(bank * np.hanning(len(bank)), 2**16))
    largest = int(spectrum.argmax())
    assert found.frequency_hz == pytest.approx(largest / (2**16 * turn.flight.dt), rel=0.05)
    assert found.roll_deg == pytest.approx(4.0 * spectrum[largest] / len(bank), rel=0.1)


@pytest.fixture(scope="module")
def straight(laws):
    """Return the law whose followers receive from each other, in straight flight."""
    return Flown(laws["mean"], 0.0, SLOW)


def flown_rate(scenario, delay_s):
    """Return the growth of a kick over the last quarter of 120 s, with later messages."""
    flight, problem = fly_linearisable(with_later_messages(load_scenario(scenario), delay_s), 0.0)
    assert not problem
    start, kick = flight.save(), np.zeros((3, 3))
    kick[0] = KICK, 0.0, KICK_THROTTLE
    periods = round(120.0 / flight.dt)
    moved = flight.respond(start, periods, kick) - flight.respond(start, periods)
    third, last = np.array_split(np.abs(moved[..., :2]).max(axis=(1, 2)), 4)[2:]
    return last.max() / third.max()


@in_full  # test_delay_margin: the search and the maps with later messages, of the built-in law
def test_message_delay_of_a_law_is_that_of_flights(laws, straight, monkeypatch):
    """Linearised anew at each delay, which needs no knowledge of how a law uses a message."""
    monkeypatch.setattr(delay_margin, "MAX_DELAY_S", 1.2)
    monkeypatch.setattr(delay_margin, "SEARCHED", 4)
    later = predicted_margins._LaterMessages(load_scenario(laws["mean"], SLOW), 0.0, straight.maps)
    [margin] = delay_margins(straight.maps, later)
    assert margin.followers == ("uav1", "uav2", "uav3")
    assert 0.3 < margin.delay_s < 0.9
    assert flown_rate(laws["mean"], 0.92 * margin.delay_s) < 0.98
    assert flown_rate(laws["mean"], 1.08 * margin.delay_s) > 1.02
    # as for a law that extrapolates from the time of receipt, the default of the built-in one
    [wrong] = delay_margins(straight.maps)
    assert wrong.delay_s > 1.2 * margin.delay_s


def test_shares_are_those_of_gains(laws, turns, monkeypatch):
    """Of a law without gains, from the linearised followers: those of the paper's law are β / B."""
    maps = []

    def keep(flight):
        maps.append(linearise(flight))
        return maps[-1]

    monkeypatch.setattr(straight_formation, "linearise", keep)
    if not ALL:  # what integrals still move is the same for all
        monkeypatch.setattr(straight_formation, "SETTLED_S", 75.0)
    formation = linearise_straight(load_scenario("simulation-1", RATES))
    whole = formation.gains.sum(axis=1, keepdims=True)
    found = shares(formation, maps[0])
    assert found == pytest.approx(formation.gains / whole, abs=1e-3)
    if ALL:
        own = linearise_straight(load_scenario(laws["mean"], RATES))
        assert own.gains == pytest.approx(formation.gains / whole, abs=1e-3)
    else:  # of a law that uses the leader alone, in a turn that is flown anyway
        own, turn = replace(formation, gains=found), turns("filtered", 30.0)
        monkeypatch.setattr(straight_formation, "_fly_straight", lambda _: turn.flight)
        monkeypatch.setattr(straight_formation, "linearise", lambda _: turn.maps)
        alone = linearise_straight(load_scenario(laws["filtered"], RATES)).gains
        assert alone[:, 0] == pytest.approx(1.0) and not alone[:, 1:].any()
    uav1, uav2, uav3 = hop_gains(own, 1)
    assert uav1.leader_share == pytest.approx(0.5, abs=1e-3)
    assert uav2.leader_share == uav3.leader_share == 0.0

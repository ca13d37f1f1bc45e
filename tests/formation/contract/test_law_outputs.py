"""What a law of a user's sends, logs and tells, and what it reads besides motions."""

import csv
import io
import shutil
from pathlib import Path

import numpy as np
import pytest
from cases import in_full

import testbed
from testbed.core.errors import InputError
from testbed.law import HBH23_MEMORY, Outputs
from testbed.logs.flight_data import write_csv
from testbed.plan.world import build
from testbed.scenario import load_scenario

EXAMPLES = Path(__file__).parents[3] / "examples"
# Each law sends and logs its number of steps and its position; a kernel, and a class.
LAWS = """
import numpy as np
import testbed
from testbed.law import FbwaCommand, Outputs

MEMORY = [("steps", int), ("sent_ned", float, 3), ("count", float), ("late", float, 4),
          ("wind_ned", float, 3), ("turn_rate", float), ("failed", int)]
MORE = {
    "send": ["sent_ned", "count"],
    "log": ["late", "steps", "wind_ned", "turn_rate", "failed"],
    "events": {"steps": ["", "one"]},
}


@testbed.kernel(memory=MEMORY, **MORE)
def kernel(now, own, inbox, memory, config):
    for j in range(len(inbox.payload)):
        memory.late[j] = memory.count - inbox.payload[j, 3]
    memory.steps += 1
    memory.count += 1.0
    for k in range(3):  # slices take numba seconds to compile
        memory.sent_ned[k], memory.wind_ned[k] = own.position_ned[k], own.wind_ned[k]
    memory.turn_rate = inbox.turn_rate[0]
    memory.failed = np.sum(inbox.failed)
    return FbwaCommand(0.03, 0.0, config.trim_throttle)


class Class:
    outputs = Outputs(MEMORY, **MORE)

    def __init__(self, config):
        self.config = config

    def start(self, own):
        return np.zeros(len(self.config.names), self.outputs.memory)

    def step(self, now, own, inbox, memory):
        memory = memory.copy()
        memory["late"] = memory["count"][:, None] - inbox.payload[:, :, 3]
        memory["steps"] += 1
        memory["count"] += 1.0
        memory["sent_ned"] = own.position_ned
        memory["wind_ned"] = own.wind_ned
        memory["turn_rate"] = inbox.turn_rate[:, 0]
        memory["failed"] = inbox.failed.sum(axis=1)
        level = np.zeros(len(memory))
        return FbwaCommand(level + 0.03, level, self.config.trim_throttle), memory


class Other(Class):
    def start(self, own):
        return {"steps": 0}

    def step(self, now, own, inbox, memory):
        level = np.zeros(len(own.airspeed))
        return FbwaCommand(level, level, level), memory
"""
PAGE = """
extends: simulation-3
scenario: {name: own, duration_s: 2, windows: {rectangles: null, circles: null}}
network: {delay_s: 0.12}
controller: {law: "laws:%s"}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("outputs")
    (folder / "laws.py").write_text(LAWS)
    for name in ("kernel", "Class", "Other"):
        (folder / f"{name}.yaml").write_text(PAGE % name)
    return folder


@pytest.fixture(scope="module")
def flights(folder):
    return {name: fly(folder / f"{name}.yaml", folder / name) for name in ("kernel", "Class")}


def fly(path, out, *overrides, duration_s=None):
    return testbed.run(path, overrides, out=out, duration_s=duration_s).data


def test_a_kernel_and_a_class_have_equal_outputs(flights):
    kernel, other = flights["kernel"], flights["Class"]
    own = {name for name in kernel.keys() if name.startswith("law_")}
    axes = "north", "east", "down"
    late, wind = (f"law_late_{k}" for k in range(4)), (f"law_wind_{axis}" for axis in axes)
    assert own == {*late, "law_steps", "law_turn_rate", "law_failed", *wind}
    for name in kernel.keys():
        assert np.array_equal(kernel[name], other[name], equal_nan=True), name
    assert kernel.events[1:] == other.events[1:]  # the first names the code


def test_payloads_are_as_late_as_their_messages(flights):
    """0.12 s are three control periods, and a message has what was written the period before.

    The leader has no law, and one's own message is never late.
    """
    late = np.stack([flights["kernel"][f"law_late_{k}"] for k in range(4)], axis=-1)
    assert np.isnan(late[:, 0]).all() and np.isnan(late[:, 1:, 0]).all()
    settled = late[20:, 1:, 1:]
    own = np.eye(3, dtype=bool)
    assert (settled[:, own] == 0.0).all() and (settled[:, ~own] == 3.0).all()


def test_numbers_of_a_law_are_in_exports(flights):
    flight = flights["kernel"]
    file = io.BytesIO()
    write_csv(flight, file)
    rows = list(csv.DictReader(file.getvalue().decode().splitlines()))
    steps = [row["law_steps"] for row in rows if row["aircraft"] == "uav2"]
    assert [float(each) for each in steps] == flight["law_steps"][:, 2].tolist()
    assert [row["law_steps"] for row in rows if row["aircraft"] == "leader"] == [""] * len(steps)
    table = flight.to_pandas()
    assert table["law_steps"].xs("uav2", level="aircraft").tolist() == [*map(float, steps)]


def test_a_changed_value_is_an_event(flights):
    found = [each for each in flights["kernel"].events if each.source == "uav1"]
    assert [each.text for each in found[:3]] == ["one", "steps is 2", "steps is 3"]
    assert [each.time_s for each in found[:3]] == pytest.approx([0.0, 0.04, 0.08])


def test_a_memory_that_is_not_declared_is_refused(folder):
    with pytest.raises(InputError, match=r"np\.zeros\(3, outputs\.memory\)"):
        build(load_scenario(str(folder / "Other.yaml")))


WRONG = [
    ({"send": ["x"]}, r"send: the memory has no field 'x' \(it has steps, mean, kept"),
    ({"send": ["steps"]}, "send: steps is int64 .declare it as float"),
    ({"log": ["kept"]}, "log: kept is float32 .declare it as float or int"),
    ({"log": "mean"}, "log is 'mean' .write a list of names"),
    ({"send": ["large"]}, "send has 40 numbers .a message carries 31 at most"),
    ({"events": {"mean": ["a"]}}, "events: mean is float64 .declare it as int"),
    ({"events": {"steps": "ab"}}, "events is .* .write"),
    ({"events": ["steps"]}, "events is .* .write"),
]


@pytest.mark.parametrize(("outputs", "message"), WRONG)
def test_wrong_outputs_are_errors(outputs, message):
    memory = [("steps", int), ("mean", float), ("kept", "f4"), ("large", float, 40)]
    with pytest.raises(ValueError, match=message):
        testbed.kernel(memory=memory, **outputs)
    with pytest.raises(ValueError, match="has no field 'x' .write memory="):
        Outputs(send=["x"])


def test_a_kernel_wraps_the_built_in_law(tmp_path):
    """As the class does from which it was written, up to rounding."""
    kernel = fly(EXAMPLES / "integral-kernel.yaml", tmp_path / "kernel", duration_s=10.0)
    other = fly("own-law-integral", tmp_path / "class", duration_s=10.0)
    apart = kernel["state_position_east_m"] - other["state_position_east_m"]
    assert 0.0 < abs(apart).max() < 1e-6 or not apart.any()
    moved = kernel["law_moved_m_0"][:, 1:]
    assert 1.0 < np.nanmax(abs(moved)) <= 3.0


def test_a_timeout_that_holds_has_no_place_in_a_kernel(tmp_path):
    for name in ("integral_kernel.py", "integral-kernel.yaml"):
        shutil.copy(EXAMPLES / name, tmp_path)
    hold = ["controller.on_neighbour_timeout=hold-relative-position"]
    with pytest.raises(InputError, match="has no place in a kernel that steps config.hbh23"):
        build(load_scenario(str(tmp_path / "integral-kernel.yaml"), hold))
    assert HBH23_MEMORY.names == ("leader", "started")


@in_full
def test_what_is_told_replaces_the_leader(tmp_path):
    """A follower that never hears the leader holds its slot; one that hears nobody does not.

    What laws send is in `test_payloads_are_as_late_as_their_messages`, too.
    """
    flight = fly(EXAMPLES / "relayed-leader.yaml", tmp_path / "told", duration_s=60.0)
    errors = flight["formation_error_east_m"][-500:, 3]
    assert abs(errors).max() < 5.0
    texts = [each.text for each in flight.events if each.source == "uav3"]
    assert "is told where the leader is" in texts
    assert np.nanmax(flight["law_age_s"][100:, 3]) <= 0.13
    silent = "network.links={leader: {uav3: {loss: 1}}, uav1: {uav3: {loss: 1}}, "
    silent += "uav2: {uav3: {loss: 1}}}"
    alone = fly(EXAMPLES / "relayed-leader.yaml", tmp_path / "alone", silent, duration_s=60.0)
    assert abs(alone["formation_error_east_m"][-1, 3]) > 100.0


def test_a_law_is_told_turn_rate_and_failures(folder, tmp_path):
    """The leader turns at 30° of bank; the engine of uav2 stops at 1 s, declared 0.5 s later."""
    fault = "fleet.uav2.faults=[{kind: engine-out, at_s: 1}]"
    changes = (fault, "formation.on_failure.declared_after_s=0.5", "limits.on_loss=continue")
    start = "leader.start={north_m: 640, east_m: 530, altitude_m: 100, course_deg: 90}"
    flight = fly(folder / "kernel.yaml", tmp_path / "run", *changes, start, duration_s=4.0)
    failed = flight["law_failed"][:, 1:]
    assert (failed[: round(1.4 * 25)] == 0).all() and (failed[round(1.9 * 25) :] == 1).all()
    v, a = (
        np.stack([flight[f"state_{name}_{axis}_{unit}"][:, 0] for axis in ("north", "east")])
        for name, unit in (("velocity", "mps"), ("acceleration", "mps2"))
    )
    turn = (v[0] * a[1] - v[1] * a[0]) / (v**2).sum(axis=0)
    assert flight["law_turn_rate"][3:, 1] == pytest.approx(turn[:-3], abs=1e-9)
    assert abs(turn).max() > 0.2


@in_full
def test_a_law_reads_wind_turn_rate_and_failures(tmp_path):
    """The engine of uav2 stops at 125 s, and its neighbours climb by 10 m from 127 s on.

    Each input is in a test of its own, too.
    """
    flight = fly(EXAMPLES / "arc-follower.yaml", tmp_path / "arc", duration_s=150.0)
    climbs = [each for each in flight.events if each.text == "climbs to make room"]
    assert [(each.source, round(each.time_s, 1)) for each in climbs] == [
        ("uav1", 127.0),
        ("uav3", 127.0),
    ]
    down = flight["formation_error_down_m"][-50:]
    assert down[:, [1, 3]].mean() == pytest.approx(-10.0, abs=1.0)


def test_saved_flight_has_what_is_on_its_way(folder):
    """Numbers of messages that arrive after a return are those before it."""
    with testbed.Simulation(folder / "kernel.yaml") as flight:
        for _ in range(5):
            flight.step()
        saved, found = flight.save(), []
        for _ in range(2):
            found.append([flight.step().law.tobytes() for _ in range(5)])
            flight.restore(saved)
    assert found[0] == found[1] and len(set(found[0])) > 2


@pytest.mark.parametrize("sensors", ["exact", "pixhawk"])
def test_wind_is_that_of_the_estimate(folder, tmp_path, sensors):
    """Without sensors that of the air; of a navigation filter its own, off by its errors."""
    chosen = ["air.wind={speed_mps: 8, from_deg: 240}"]
    chosen += [] if sensors == "exact" else ["fleet.*.sensors=pixhawk"]
    flight = fly(folder / "kernel.yaml", tmp_path / "run", *chosen)
    axes = "north", "east", "down"
    apart = np.stack([flight[f"law_wind_{a}"] - flight[f"state_wind_{a}_mps"] for a in axes])
    if sensors == "exact":
        assert abs(apart[:, 2:, 1:]).max() < 1e-9
    else:
        assert 0.05 < abs(apart[:2, 2:, 1:]).mean() < 1.5

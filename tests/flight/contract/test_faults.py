"""Faults of a scenario: begin and end, events, responses of the others, and losses."""

import json
from collections import Counter

import numpy as np
import pytest
from cases import some
from run_flight import Collector, arrays, fly_with_recorder, recorder
from typer.testing import CliRunner

import testbed
from testbed.cli.main import app
from testbed.core.errors import InputError
from testbed.core.velocity_frame import velocity_frame
from testbed.flight.tick_loop import TickLoop
from testbed.plan.world import build
from testbed.scenario import load_scenario, loads

# Simulation 3 before the first lap, with all followers in their slots from the start.
SCENARIO = """
extends: simulation-3
scenario: {name: faults, duration_s: 8, windows: null, published: null}
log: {mcap: false}
fleet:
  - {name: uav1, aircraft: rascal110, start_m: [-5, 5, 0]}
  - {name: uav2, aircraft: rascal110, start_m: [-5, -5, -4]}
  - {name: uav3, aircraft: rascal110, start_m: [-5, -5, 4]}
"""
LEADER, UAV1, UAV2, UAV3 = range(4)
PERIOD = 0.04  # s, between messages and between frames


def scenario(*changes):
    return loads(SCENARIO, changes)


def flown(*changes):
    """Return the samples, events and result of a flight."""
    seen = Collector()
    run = testbed.run(scenario(*changes), write=False, observers=[seen])
    return seen.frames, events_of(seen.frames), run


def events_of(frames):
    """Return all events except those of followers that join."""
    events = [(e.time_s, e.level, e.source, e.text) for frame in frames for e in frame.events]
    return [event for event in events if not event[3].startswith("joined")]


def faults(number, text):
    return f"fleet.{number}.faults=[{text}]"


def differences(one, other):
    """Return the names of the arrays in which two samples differ."""
    pairs = zip(arrays(one), arrays(other), strict=True)
    return [name for (name, a), (_, b) in pairs if not np.array_equal(a, b, equal_nan=True)]


def column(frames, record, name):
    return np.array([getattr(getattr(frame, record), name) for frame in frames])


# begin and end


def test_fault_acts_between_its_times():
    # a slow throttle
    slow = "controller.gains.speed={p: 0.15, i: 0.02}"
    frames, events, run = flown(
        faults(0, "{kind: thrust-loss, remaining: 0.5, at_s: 2, duration_s: 3}"), slow
    )
    assert events == [
        (2.0, "warning", "uav1", "thrust loss, 50 % of the throttle remains"),
        (5.0, "info", "uav1", "thrust loss, 50 % of the throttle remains: ended"),
    ]
    assert run.outcome == "completed"
    usual, _, _ = flown(slow)
    time = np.array([frame.time_s for frame in frames])
    different = [differences(one, other) for one, other in zip(frames, usual, strict=True)]
    # surfaces change in the same sample as the fault
    at = int(np.argmax(time >= 2.0))
    assert not any(different[:at])
    assert different[at] == ["surfaces.throttle"]
    throttle = column(frames, "surfaces", "throttle")
    command = column(frames, "command", "throttle")
    assert throttle[at, UAV1] == 0.5 * usual[at].surfaces.throttle[UAV1]
    ratio = throttle[:, UAV1] / command[:, UAV1]
    active = (time >= 2.0) & (time < 5.0)
    # the command of the sample is newer by an autopilot period, in which it changes by a tenth
    assert ratio[active] == pytest.approx(0.5, abs=0.15)
    assert ratio[~active] == pytest.approx(1.0, abs=0.15)


def test_event_of_each_kind():
    """One after another, in one flight."""
    kinds = {
        "kind: engine-out": "engine out",
        "kind: surface-stuck, surface: rudder": "rudder stuck",
        "kind: surface-stuck, surface: aileron, position: 0.1": "aileron stuck at 0.1",
        "kind: surface-floating, surface: elevator": "elevator floating",
        "kind: airspeed-blocked": "pitot tube blocked, drain blocked",
        "kind: airspeed-blocked, drain: open": "pitot tube blocked, drain open",
        "kind: gps-lost": "GPS lost",
        "kind: gps-jump, offset_m: [1, -2.5, 3]": "GPS off by 1, -2.5, 3 m north, east, down",
        "kind: autopilot-frozen": "autopilot frozen",
        "kind: transmitter-off": "transmitter off",
    }
    begin_s = [round(0.4 * k, 1) for k in range(1, 11)]
    each = zip(kinds, begin_s, strict=True)
    texts = ", ".join(f"{{{kind}, at_s: {at}, duration_s: 0.2}}" for kind, at in each)
    _, events, _ = flown(faults(1, texts), "fleet.1.sensors=pixhawk", "scenario.duration_s=4.4")
    expected = []
    for at, text in zip(begin_s, kinds.values(), strict=True):
        expected.append((at, "warning", "uav2", text))
        expected.append((round(at + 0.2, 1), "info", "uav2", f"{text}: ended"))
    assert events == [(pytest.approx(at), *rest) for at, *rest in expected]


def test_condition_begins_a_fault_once_after_its_time():
    """The airspeed is always below 100 m/s."""
    when = "when: {quantity: airspeed_mps, below: 100}"
    _, events, _ = flown(faults(0, f"{{kind: transmitter-off, at_s: 1.5, {when}, duration_s: 1}}"))
    assert [(time, text) for time, _, _, text in events if "transmitter" in text] == [
        (1.5, "transmitter off"),
        (2.5, "transmitter off: ended"),
    ]


def test_condition_is_evaluated_on_the_truth():
    """All aircraft bank by more than 10 degrees in the first corner; estimates do not count."""
    when = "when: {quantity: bank_deg, above: 10}"
    frames, events, _ = flown(
        faults(2, f"{{kind: transmitter-off, {when}}}"),
        "fleet.2.sensors={attitude: {sigma_deg: 5, time_constant_s: 1}}",
        "scenario.duration_s=40",
        "leader.path.legs=[{kind: loiter, centre_m: [500, 200], radius_m: 120, "
        "levels: [{altitude_m: 100, turns: 9}]}]",
    )
    bank = np.abs(np.degrees(column(frames, "truth", "euler")[:, UAV3, 0]))
    first = frames[int(np.argmax(bank > 10.0))].time_s
    begun = [time for time, _, _, text in events if text == "transmitter off"]
    assert len(begun) == 1
    # faults are evaluated at the autopilot rate, twice per sample
    assert first - PERIOD < begun[0] <= first


def test_fault_without_effect_is_a_warning():
    _, events, _ = flown(faults(0, "{kind: gps-lost, at_s: 1}"), "scenario.duration_s=1")
    assert [(time, source) for time, _, source, text in events if "has no effect" in text] == [
        (0.0, "uav1")
    ]
    said = [text for time, _, _, text in events if time > 0.0 and "GPS" in text]
    assert said == ["GPS lost: no effect, because the estimate uses no GPS"]


# stages in Python

X8 = "fleet.1.aircraft=skywalker_x8", "leader.sensors=pixhawk", "fleet.*.sensors=pixhawk"
OF_EACH_KIND = (
    "kind: engine-out",
    "kind: thrust-loss, remaining: 0.9",
    "kind: surface-stuck, surface: left-elevon",
    "kind: surface-floating, surface: right-elevon",
    "kind: airspeed-blocked",
    "kind: gps-lost",
    "kind: gps-jump, offset_m: [0, 0, 1]",
    "kind: autopilot-frozen",
    "kind: transmitter-off",
    "kind: battery-low, state_of_charge: 0.5",
)


@pytest.fixture
def asked(monkeypatch):
    """Return how often each stage has asked for Python, by its name."""
    seen, run = Counter(), TickLoop.run

    def count(loop, found=None):
        stage = run(loop, found)
        if stage is not None:
            seen[stage.name] += 1
        return stage

    monkeypatch.setattr(TickLoop, "run", count)
    return seen


WITHOUT = []  # how often stages ask in a flight without faults, which is flown once


@pytest.mark.parametrize(
    ("when", "response"),
    [
        ("at_s: 7, when: {quantity: bank_deg, above: 89}", "ignore"),
        ("when: {quantity: altitude_m, below: 0}", "reassign-slots"),
        ("when: {quantity: state_of_charge, below: 0}", "reassign-slots"),
    ],
)
def test_fault_that_has_not_begun_needs_no_python(asked, when, response):
    """Ten faults with a time or condition that does not come change nothing."""
    if not WITHOUT:
        flown(*X8)
        WITHOUT.append(dict(asked))
        asked.clear()
    waiting = ", ".join(f"{{{each}, {when}}}" for each in OF_EACH_KIND)
    flown(*X8, f"formation.on_failure.response={response}", f"fleet.1.faults=[{waiting}]")
    assert asked == WITHOUT[0]


@pytest.mark.parametrize("fault", [*some(OF_EACH_KIND[:-1], 3), OF_EACH_KIND[-1]])
def test_fault_needs_python_as_it_begins_and_ends(asked, fault):
    """It is declared at 2 s; a battery that drops does not end, and drops at one tick."""
    battery = "battery" in fault
    flown(
        *X8,
        faults(1, f"{{{fault}, at_s: 1{'' if battery else ', duration_s: 1.5'}}}"),
        "formation.on_failure={response: reassign-slots, declared_after_s: 1}",
        "scenario.duration_s=4",
        "network.delay_s=0",
    )
    assert asked["begin and end faults"] == 2
    assert asked["apply actuator faults"] == battery
    assert asked["respond to declared failures"] <= 2


# transmissions and servos


@pytest.mark.parametrize("kind", ["transmitter-off", "autopilot-frozen"])
def test_transmissions_stop_during_the_fault(kind):
    frames, events, _ = flown(
        faults(1, f"{{kind: {kind}, at_s: 2, duration_s: 2}}"),
        "formation.on_failure.response=reassign-slots",
    )
    time, sent = np.array([f.time_s for f in frames]), column(frames, "links", "sent")
    to_uav3 = sent[:, UAV3 - 1, UAV2].astype(int)
    silent = (time >= 2.0) & (time < 4.0)
    assert (np.diff(to_uav3)[silent[1:]] == 0).all()
    assert (np.diff(to_uav3)[~silent[1:]] == 1).all()
    others = sent[:, UAV3 - 1, [LEADER, UAV1]].astype(int)
    assert (np.diff(others, axis=0) == 1).all()
    assert not [text for *_, text in events if "has failed" in text], "no message declared it"


def test_frozen_autopilot_holds_its_servos():
    frames, _, _ = flown(faults(1, "{kind: autopilot-frozen, at_s: 2, duration_s: 2}"))
    time = np.array([frame.time_s for frame in frames])
    frozen = (time >= 2.0) & (time < 4.0)
    for name in ("aileron", "elevator", "rudder", "throttle"):
        moved = np.diff(column(frames, "surfaces", name)[:, [UAV1, UAV2]], axis=0) != 0.0
        assert not moved[frozen[1:] & frozen[:-1], 1].any(), name
        if name != "rudder":  # a Rascal's may be constant in straight flight
            assert moved[~frozen[1:], 1].any() and moved[:, 0].any(), name


# responses of the others

OUT = "{kind: engine-out, at_s: 1}"


def test_failure_is_declared_by_message():
    """uav1 receives the first declaration; uav3 misses the first three."""
    _, events, _ = flown(
        faults(1, OUT),
        "formation.on_failure={response: drop, declared_after_s: 2}",
        f"network.links.uav2.uav3={{drop: {[75, 76, 77]}}}",  # those of 3.00, 3.04 and 3.08 s
    )
    assert events == [
        (1.0, "warning", "uav2", "engine out"),
        (3.0, "warning", "uav1", "uav2 has failed"),
        (3.12, "warning", "uav3", "uav2 has failed: excluded"),
    ]


def test_declaration_is_delayed_by_the_network():
    _, events, _ = flown(
        faults(1, OUT),
        "formation.on_failure={response: drop, declared_after_s: 1}",
        "network.delay_s=0.2",
    )
    learnt = [(time, source) for time, _, source, text in events if "has failed" in text]
    assert learnt == [(2.2, "uav1"), (2.2, "uav3")]


@pytest.mark.parametrize(
    ("fault", "declared", "response"),
    [
        ("kind: engine-out", True, "drop"),
        ("kind: engine-out", True, "reassign-slots"),
        ("kind: engine-out", False, "ignore"),
        ("kind: engine-out, declared: false", False, "reassign-slots"),
        ("kind: airspeed-blocked", False, "drop"),
        ("kind: airspeed-blocked, declared: true", True, "reassign-slots"),
        ("kind: airspeed-blocked, declared: true", False, "ignore"),
        ("kind: gps-jump, offset_m: [0, 0, 0]", False, "drop"),
    ],
)
def test_declaration_by_fault_and_response(fault, declared, response):
    _, events, _ = flown(
        faults(1, f"{{{fault}, at_s: 0.2}}"),
        f"formation.on_failure={{response: {response}, declared_after_s: 0.4}}",
        "scenario.duration_s=1",
    )
    learnt = {source for *_, source, text in events if "has failed" in text}
    assert learnt == ({"uav1", "uav3"} if declared else set())


def test_slots_are_taken_in_fleet_order():
    """With a clearance of 1 mm the failed aircraft is clear of its slot at once."""
    frames, events, _ = flown(
        faults(0, "{kind: thrust-loss, remaining: 0.9, at_s: 1, duration_s: 3}"),
        "formation.on_failure={response: reassign-slots, declared_after_s: 1, clearance_m: 0.001}",
    )
    assert events == [
        (1.0, "warning", "uav1", "thrust loss, 90 % of the throttle remains"),
        (2.0, "warning", "uav2", "uav1 has failed: excluded"),
        (2.0, "warning", "uav3", "uav1 has failed"),
        (2.0, "warning", "uav1", "leaves the formation"),
        (2.0, "warning", "uav2", "uav1 has left its slot, takes the slot of uav1"),
        (2.0, "warning", "uav3", "uav1 has left its slot, takes the slot of uav2"),
        (4.0, "info", "uav1", "thrust loss, 90 % of the throttle remains: ended"),
    ]
    offsets = np.array([(0, 0, 0), (-5, 5, 0), (-5, -5, -4), (-5, -5, 4)], dtype=float)
    for frame in frames:
        held = [1, 1, 2] if 2.0 <= frame.time_s else [1, 2, 3]
        assert frame.formation.slot_index.tolist() == held
        frame_of_leader = velocity_frame(frame.truth.velocity_ned[:1])[0]
        slots = frame.truth.position_ned[0] + offsets[held] @ frame_of_leader.T
        np.testing.assert_allclose(frame.formation.slot_ned, slots, rtol=0, atol=1e-9)


def test_slot_stays_taken_while_it_is_not_clear():
    """UAV 2 keeps nearly all of its thrust and flies straight on, until the leader turns."""
    _, events, run = flown(
        "limits={collision_m: 2.8}",
        faults(1, "{kind: thrust-loss, remaining: 0.95, at_s: 1}"),
        "formation.on_failure={response: reassign-slots}",
        "scenario.duration_s=60",
    )
    left = [time for time, _, source, text in events if source == "uav3" and "has left" in text]
    turning = [time for time, _, source, text in events if source == "uav2" and "leaves" in text]
    assert turning == [3.0]
    assert left[0] > 10.0  # the first corner comes at some 25 s
    assert run.outcome == "completed"
    assert run.metrics["min_separation_m"] > 4.0


def neighbours_after_failure(*changes):
    """Return the NEIGHBOUR records before a failure of uav1 and after all know of it."""
    world = build(scenario(*changes))
    assert world.faults.bind(world.aircraft)(1.0)
    assert list(world.faults.changes(1.0))
    # all receive the same messages, and uav1 is far below its slot
    for name in ("position_ned", "velocity_ned"):
        world.links[name] = world.aircraft["truth"][name]
    world.links["position_ned"][:, UAV1, 2] += 50.0
    world.links["measured_s"] = 4.0
    before = world.formation.built_control.neighbours.copy()
    assert world.formation.control.update_membership(0, 4.0)
    return before, world.formation.built_control.neighbours


def test_slot_has_its_gains_for_any_aircraft():
    """UAV 1 failed: UAV 2 uses the leader alone, and UAV 3 the leader and UAV 2, as UAV 2 did."""
    changes = faults(0, OUT), "formation.on_failure.response=reassign-slots"
    before, after = neighbours_after_failure(*changes)
    assert after["gain"][1:, :, 0].tolist() == [[1, 0, 0, 0], [1, 0, 1, 0]]
    assert after["used"][1:].tolist() == [[True, False, False, False], [True, False, True, False]]
    offsets = after["offset"]  # (n, N, 3), the slots as each follower knows them
    assert offsets[2, [LEADER, UAV2, UAV3]].tolist() == [[0, 0, 0], [-5, 5, 0], [-5, -5, -4]]
    # a failed follower learns of no failure
    for name in ("gain", "offset"):
        assert np.array_equal(after[name][0], before[name][0])


def test_response_drop_excludes_and_keeps_the_slots():
    changes = faults(0, OUT), "formation.on_failure.response=drop"
    before, after = neighbours_after_failure(*changes)
    gains = before["gain"].copy()
    gains[1:, UAV1] = 0.0
    assert np.array_equal(after["gain"], gains)
    assert np.array_equal(after["offset"], before["offset"])


def test_own_law_receives_no_message_of_excluded(tmp_path):
    changes = faults(0, OUT), "formation.on_failure={response: drop, declared_after_s: 2}"
    _, received = fly_with_recorder(scenario(recorder(tmp_path), *changes))
    assert received
    for now, _, inbox in received:
        received_from = np.isfinite(inbox.stamp_s)
        expected = np.ones((3, 4), dtype=bool)
        if now >= 3.0:
            expected[1:, UAV1] = False
        assert np.array_equal(received_from, expected), now
        assert np.array_equal(np.isfinite(inbox.position_ned).all(axis=2), expected)


def test_own_law_cannot_reassign_slots():
    changes = (faults(0, OUT), "formation.on_failure.response=reassign-slots")
    with pytest.raises(InputError, match=r"on_failure\.response.*write drop, or law: hbh23"):
        build(load_scenario("own-law-integral", changes))


def test_follower_without_reference_is_a_warning():
    _, events, _ = flown(
        faults(1, OUT),
        "formation.on_failure={response: drop, declared_after_s: 9}",
        "formation.leader_gains.uav3=0",
        "scenario.duration_s=1",
    )
    (warning,) = (each for each in events if "without uav2" in each[3])
    assert warning[:3] == (0.0, "warning", "uav3")


# losses

# UAV 1's slot lies below the ground, UAV 2 flies beside the leader.
DIVE = """
scenario: {schema: 2, name: dive, duration_s: 15}
log: {mcap: false}
leader:
  aircraft: rascal110
  start: {altitude_m: 20}
  path:
    kind: mission
    airspeed_mps: 22
    legs: [{kind: waypoints, points_m: [[2000, 0, 20], [4000, 0, 20]]}]
fleet:
  - {name: uav1, aircraft: rascal110, start_m: [-10, 5, 0]}
  - {name: uav2, aircraft: rascal110, start_m: [-10, -5, 0]}
formation:
  offsets_m: {uav1: [-10, 5, 40], uav2: [-10, -5, 0]}
  leader_gains: {uav1: 1, uav2: 1}
"""
GROUND = "lost: on the ground, at 2.8 m"


@pytest.mark.parametrize(
    ("changes", "code", "whole"),
    [
        ((), 1, False),
        (("limits.on_loss=continue",), 1, True),
        (("limits.on_loss=continue", faults(1, "{kind: transmitter-off, at_s: 0}")), 1, True),
        (("limits.on_loss=continue", faults(0, "{kind: transmitter-off, at_s: 0}")), 0, True),
        (("limits.on_loss=continue", faults(0, "{kind: transmitter-off, at_s: 14.5}")), 1, True),
        ((faults(0, "{kind: transmitter-off, at_s: 0}"),), 1, False),
    ],
    ids=["stop", "continue", "other fault", "fault", "later fault", "fault, stop"],
)
def test_exit_code_of_a_loss(changes, code, whole, tmp_path):
    """0 only if the lost aircraft had an active fault, and the run continued."""
    path = tmp_path / "dive.yaml"
    path.write_text(DIVE)
    sets = [word for change in changes for word in ("--set", change)]
    where = tmp_path / "metrics.json"
    words = ("run", path, *sets, "--json", where, "--out", tmp_path / "out")
    done = CliRunner().invoke(app, list(map(str, words)))
    assert done.exit_code == code, done.output
    assert "uav1: lost" in done.output
    metrics = json.loads(where.read_text())
    assert metrics["outcome"] == ("lost" if code else "completed")
    assert (metrics["simulated_s"] == 15.0) == whole
    assert metrics["lost_at_s"]["uav1"] < 14.0
    assert metrics["lost_at_s"]["uav2"] is None


def test_lost_aircraft_stays_and_transmits_nothing():
    seen = Collector()
    testbed.run(loads(DIVE, ["limits.on_loss=continue"]), write=False, observers=[seen])
    lost = np.array([frame.lost for frame in seen.frames])
    at = int(np.argmax(lost[:, UAV1]))
    assert lost[at:, UAV1].all() and not lost[:at, UAV1].any()
    assert not lost[:, [LEADER, UAV2]].any()
    assert [event[1:] for event in events_of(seen.frames)][0] == ("error", "uav1", GROUND)
    after = seen.frames[at:]
    place = column(after, "truth", "position_ned")
    assert (place[:, UAV1] == place[0, UAV1]).all()
    assert abs(place[0, UAV1, 2]) < 3.0
    flown_m = np.linalg.norm(np.diff(place[:, UAV2], axis=0), axis=1)
    assert (flown_m > 0.5).all(), "20 m/s for 0.04 s"
    # the message of the tick of the loss was sent before the loss was detected
    sent = column(after, "links", "sent").astype(int)
    assert (sent[:, UAV2 - 1, UAV1] == sent[0, UAV2 - 1, UAV1]).all()
    assert (np.diff(sent[:, UAV2 - 1, LEADER]) == 1).all()


def test_collided_aircraft_are_lost_others_continue():
    """UAV 1 and UAV 2 exchange sides at the same altitude."""
    across = (
        "formation.offsets_m={uav1: [-5, -5, 0], uav2: [-5, 5, 0], uav3: [-5, -5, 20]}",
        "formation.neighbour_gains=null",
        "rates={autopilot_hz: 100, log_hz: 100}",  # as often as losses are checked
        "fleet.0.start_m=[-5, 5, 0]",
        "fleet.1.start_m=[-5, -5, 0]",
        "fleet.2.start_m=[-5, -5, 20]",
    )
    limits = "limits={collision_m: 2, separation_m: 4, min_separation_m: 0, on_loss: continue}"
    frames, events, run = flown(*across, limits)
    assert [(level, source) for _, level, source, _ in events] == [
        ("warning", "uav1"),
        ("error", "uav1"),
        ("error", "uav2"),
    ]
    assert events[0][3].startswith("within 4 m of uav2: ")
    assert events[1][3].startswith("collided with uav2: ")
    assert events[2][3].startswith("collided with uav1: ")
    lost = np.array([frame.lost for frame in frames])
    at = int(np.argmax(lost.any(axis=1)))
    assert 0.0 <= frames[at].time_s - events[1][0] < PERIOD
    assert lost[at].tolist() == [False, True, True, False]
    place = column(frames, "truth", "position_ned")
    distance = np.linalg.norm(place[:, UAV1] - place[:, UAV2], axis=1)
    assert int(np.argmax(distance < 2.0)) == at
    assert distance[at] == pytest.approx(2.0, abs=0.05)
    assert (place[at:, [UAV1, UAV2]] == place[at, [UAV1, UAV2]]).all()
    assert (run.outcome, run.exit_code) == ("lost", 1)
    assert run.metrics["simulated_s"] == 8.0
    # without limits they pass
    _, _, unlimited = flown(*across, "limits.min_separation_m=0")
    assert unlimited.outcome == "completed"
    assert unlimited.metrics["min_separation_m"] < 2.0


def test_collision_ends_the_run_by_default():
    _, events, run = flown("limits.collision_m=7.5", "scenario.duration_s=2")
    assert (run.outcome, run.metrics["simulated_s"]) == ("lost", 0.0)
    # the leader is 7.07 m from UAV 1 and 8.12 m from the others, which are 8 m apart
    assert [event[:3] for event in events] == [(0.0, "error", "leader"), (0.0, "error", "uav1")]
